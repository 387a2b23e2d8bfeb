"""A spinning body, free or under a constant torque, given by a few numbers, as a scenario file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, vector
from bodycheck.scenarios.reader import parse_members

_MIN_SPIN, _MAX_SPIN = 1e-30, 1e30  # rad/s: energies and times of faster and slower ones may overflow
_ROTATIONS = 10.0  # of the default duration
_LEADING = (1.0, 2.0, 5.0, 10.0)
_MAX_SAMPLES = 10_001
_STRIDES = (2, 5, 20, 50, 200, 500, 1000)  # steps per sample: methods of order 1 need the finest ones
_MAX_STEPS = 200_000  # of one case


@dataclass(frozen=True)
class FreeBody:
    """A rigid body: mass in kg, principal moments (3,) in kg m^2, omega (3,) in body axes.

    spin_rad_s: omega_body in rad/s, or one number, |omega|, for equal components. torque_body_n_m: a constant
    torque (3,) in body axes, in N m; none if empty.
    """

    mass_kg: float
    inertia_kg_m2: Sequence[float]
    spin_rad_s: Sequence[float]
    torque_body_n_m: Sequence[float] = ()

    @property
    def omega_body(self) -> tuple[float, ...]:
        """The angular velocity (3,) in rad/s in body axes."""
        if len(self.spin_rad_s) == 1:
            return (self.spin_rad_s[0] / math.sqrt(3.0),) * 3
        return tuple(self.spin_rad_s)

    @property
    def spins_steadily(self) -> bool:
        """Whether omega is constant: no torque acts, and omega x I omega = 0."""
        return not any(self.torque_body_n_m) and not np.any(
            np.cross(self.omega_body, np.multiply(self.inertia_kg_m2, self.omega_body))
        )

    def duration_s(self, horizon_s: float | None) -> float:
        """Return the horizon in s, or else the next of 1, 2, 5, 10, ... s that is at least 10 rotations."""
        if horizon_s is not None:
            return horizon_s
        return _round_up(_ROTATIONS * 2.0 * math.pi / math.hypot(*self.omega_body))


def scenario_text(body: FreeBody, horizon_s: float | None, name: str) -> str:
    """Return the TOML of a body's rotation, sampled about once per radian.

    Raises InputError with one line per error if no body has these numbers.
    """
    _check(body, horizon_s)
    duration_s = body.duration_s(horizon_s)
    tag = "forced" if any(body.torque_body_n_m) else "torque-free"
    gained = math.hypot(*body.torque_body_n_m) / min(body.inertia_kg_m2) * duration_s
    interval = _round_up(0.5 / (math.hypot(*body.omega_body) + gained))
    samples = min(max(round(duration_s / interval), 2) + 1, _MAX_SAMPLES)
    strides = [n for n in _STRIDES if n * (samples - 1) <= _MAX_STEPS] or [1]
    steps = [float(f"{duration_s / (samples - 1) / n:.12g}") for n in strides]
    text = "\n".join(
        [
            f'name = "{name}"',
            f'summary = "rotation with omega_body = {vector(body.omega_body)} rad/s"',
            'source = "bodycheck advise"',
            f'tags = ["{tag}"]',
            f"duration_s = {float(duration_s)!r}",
            f"samples = {samples}",
            f"steps_s = {steps}",
            "",
            "[body]",
            f"mass_kg = {float(body.mass_kg)!r}",
            f"inertia_kg_m2 = {[float(moment) for moment in body.inertia_kg_m2]}",
            "",
            "[initial]",
            f"omega_body_rad_s = {[float(omega) for omega in body.omega_body]}",
            "",
            *_torque_table(body.torque_body_n_m),
        ]
    )
    parse_members(text, where="the body", folder=Path())
    return text


def _torque_table(torque_n_m: Sequence[float]) -> list[str]:
    if not any(torque_n_m):
        return []
    value = f"value_n_m = {[float(value) for value in torque_n_m]}"
    return ["[[forcing]]", 'kind = "torque"', 'axes = "body"', value, ""]


def _check(body: FreeBody, horizon_s: float | None) -> None:
    faults = []
    if len(body.torque_body_n_m) not in (0, 3) or not all(map(math.isfinite, body.torque_body_n_m)):
        faults.append("--torque-body-n-m: must be three finite components")
    if len(body.inertia_kg_m2) != 3:
        faults.append(f"--inertia-kg-m2: must be three principal moments, not {len(body.inertia_kg_m2)}")
    if len(body.spin_rad_s) not in (1, 3):
        faults.append(f"--spin-rad-s: must be one number or three components, not {len(body.spin_rad_s)}")
    at_rest = not any(body.spin_rad_s) and any(body.torque_body_n_m)
    if at_rest and horizon_s is None:
        faults.append("--horizon-s: is required for a body that starts at rest")
    if not at_rest and not _MIN_SPIN <= math.hypot(*body.spin_rad_s) <= _MAX_SPIN:
        faults.append(f"--spin-rad-s: |omega| must be from {number(_MIN_SPIN)} to {number(_MAX_SPIN)} rad/s")
    if faults:
        raise InputError("\n".join(faults))


def _round_up(value: float) -> float:
    """Return the next of 1, 2, 5, 10, 20, ... times a power of ten."""
    decade = 10.0 ** math.floor(math.log10(value))
    return float(f"{next(lead for lead in _LEADING if lead * decade >= value) * decade:.1g}")
