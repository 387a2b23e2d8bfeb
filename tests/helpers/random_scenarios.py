"""Random scenarios as users may write them: any body, motion and loads, at steps that resolve it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array

Forcing: TypeAlias = dict[str, Any]

_INTERVALS = 20
_STEPS_PER_COARSEST = (1, 2, 4, 8)
_TURN = 0.1  # rad, in the coarsest step
_COARSEST_S = 0.02


@dataclass(frozen=True)
class _Motion:
    """The scales of loads: mass, length, least and largest moment, spin in rad/s, duration."""

    mass: float
    length: float
    least: float
    largest: float
    spin: float
    duration_s: float

    @property
    def torque(self) -> float:
        """Return the torque that adds the spin over the whole duration."""
        return self.least * self.spin / self.duration_s


def write_scenario(seed: int, folder: Path) -> Path:
    """Write the scenario of this seed into the folder, as `random-SEED.toml`."""
    path = folder / f"random-{seed}.toml"
    path.write_text(_toml(random_scenario(seed)))
    return path


def random_scenario(seed: int) -> dict[str, Any]:
    """Return the tables of a scenario file; consecutive seeds go through the kinds of load.

    Lengths over two decades, masses over five, moments of a body of any shape; omega up to 20 rad/s, or in
    one of ten scenarios up to 300 rad/s. The coarsest step rotates the body, and changes the phase of a load,
    by about 0.1 rad.
    """
    rng = np.random.default_rng([16, seed])
    mass, length = 10.0 ** rng.uniform(-2.0, 3.0), 10.0 ** rng.uniform(-1.3, 0.7)
    moments = mass * length**2 * _moments(rng)
    spin = 10.0 ** (rng.uniform(1.3, 2.5) if rng.uniform() < 0.1 else rng.uniform(-1.0, 1.3))
    duration = round(rng.uniform(1.0, 5.0) * min(1.0, 5.0 / spin), 3)
    motion = _Motion(mass, length, float(np.min(moments)), float(np.max(moments)), spin, duration)
    kind = list(KINDS)[seed % len(KINDS)]
    loads, rate = KINDS[kind](rng, motion)
    if rng.uniform() < 0.6 or kind == "pivot":
        loads = [*loads, _gravity(rng)]
    body: dict[str, Any] = {"mass_kg": mass, "inertia_kg_m2": _tensor(rng, moments)}
    initial = {"quaternion": _unit(rng, 4), "omega_body_rad_s": spin * _unit(rng, 3)}
    if kind != "pivot":
        initial["position_m"] = length * rng.normal(size=3)
        initial["velocity_m_s"] = length * min(spin, 10.0) * rng.normal(size=3)
        if rng.uniform() < 0.2:
            body |= {"link_offset_m": 0.3 * length * rng.normal(size=3), "link_quaternion": _unit(rng, 4)}
    coarsest = min(_TURN / max(spin, rate), _COARSEST_S)
    steps = math.ceil(duration / _INTERVALS / coarsest)
    return {
        "name": f"random-{seed}",
        "summary": kind,
        "duration_s": duration,
        "samples": _INTERVALS + 1,
        "steps_s": [duration / _INTERVALS / (steps * finer) for finer in _STEPS_PER_COARSEST],
        "body": body,
        "initial": initial,
        "forcing": loads,
    }


def _toml(tables: dict[str, Any]) -> str:
    """Return the text of a file: keys, then [tables], then [[forcing]]."""
    lines = [f"{key} = {_value(value)}" for key, value in tables.items() if not _is_table(key)]
    for name in ("body", "initial"):
        lines += [f"[{name}]", *(f"{key} = {_value(value)}" for key, value in tables[name].items())]
    for load in tables["forcing"]:
        lines += ["[[forcing]]", *(f"{key} = {_value(value)}" for key, value in load.items())]
    return "\n".join(lines) + "\n"


def _is_table(key: str) -> bool:
    return key in ("body", "initial", "forcing")


def _value(value: Any) -> str:
    return json.dumps(value.tolist() if isinstance(value, np.ndarray) else value)


def _unit(rng: np.random.Generator, size: int) -> Array:
    vector = rng.normal(size=size)
    return np.asarray(vector / np.linalg.norm(vector))


def _moments(rng: np.random.Generator) -> Array:
    """Return the moments of a body of any shape over m l^2, in any order."""
    shapes: list[Array] = [
        np.sort(rng.uniform(1.0, 1.9, size=3)),
        np.array([1.0, 1.0, 1.0]),
        np.array([1.0, 1.0, rng.uniform(0.1, 1.9)]),
        np.array([1.0, 1.0 + 10.0 ** rng.uniform(-8.0, -2.0), 1.5]),
        np.array([rng.uniform(0.01, 0.1), 1.0, 1.0]),
        np.array([1.0, rng.uniform(1.0, 3.0), 0.0]),
    ]
    chosen = shapes[rng.integers(len(shapes))]
    if chosen[2] == 0.0:  # a thin plate: I3 = I1 + I2, except for a small thickness
        chosen[2] = (chosen[0] + chosen[1]) * (1.0 - 1e-3)
    return np.asarray(0.3 * rng.permutation(chosen))


def _tensor(rng: np.random.Generator, moments: Array) -> Array:
    if rng.uniform() < 0.4:
        return moments
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tensor = axes @ np.diag(moments) @ axes.T
    return np.asarray(0.5 * (tensor + tensor.T))


def _axes(rng: np.random.Generator) -> str:
    return "body" if rng.uniform() < 0.5 else "world"


def _gravity(rng: np.random.Generator) -> Forcing:
    return {"kind": "gravity", "acceleration_m_s2": 10.0 ** rng.uniform(-1.0, 1.3) * _unit(rng, 3)}


def _free(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    del rng, motion
    return [], 0.0


def _torque(rng: np.random.Generator, motion: _Motion) -> Forcing:
    size = rng.uniform(0.1, 1.0) * motion.torque
    return {"kind": "torque", "axes": _axes(rng), "value_n_m": size * _unit(rng, 3)}


def _force(rng: np.random.Generator, motion: _Motion) -> Forcing:
    at = 0.3 * motion.length * rng.normal(size=3)
    size = rng.uniform(0.1, 1.0) * motion.torque / float(np.linalg.norm(at))
    return {"kind": "force", "axes": _axes(rng), "value_n": size * _unit(rng, 3), "at_m": at}


def _constant(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    make = (_torque, _force)
    return [make[rng.integers(2)](rng, motion) for _ in range(rng.integers(1, 4))], 0.0


def _switched(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    """Return loads that start and end at sample times."""
    loads, _ = _constant(rng, motion)
    for load in loads:
        begin, end = sorted(rng.choice(_INTERVALS, size=2, replace=False))
        load |= {
            "from_s": motion.duration_s * begin / _INTERVALS,
            "until_s": motion.duration_s * end / _INTERVALS,
        }
    return loads, 0.0


def _off_grid(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    """Return loads that start and end within a step."""
    loads, _ = _constant(rng, motion)
    for load in loads:
        begin, end = sorted(rng.uniform(0.0, motion.duration_s, size=2))
        load |= {"from_s": begin, "until_s": end}
    return loads, 0.0


def _sines(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    rate = rng.uniform(0.3, 1.0) * max(motion.spin, 1.0)
    loads = [
        {
            "kind": "sine-torque",
            "axes": _axes(rng),
            "amplitude_n_m": rng.uniform(0.05, 0.5) * motion.least * motion.spin * rate * _unit(rng, 3),
            "rate_rad_s": rate,
            "phase_rad": rng.normal(),
        }
        for _ in range(rng.integers(1, 3))
    ]
    return loads, rate


def _drag(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    root = rng.normal(size=(3, 3))
    angular = rng.uniform(0.02, 0.3) * motion.least * root @ root.T
    linear = rng.uniform(0.05, 1.0) * motion.mass
    return [{"kind": "drag", "linear_n_s_m": linear, "angular_n_m_s": 0.5 * (angular + angular.T)}], 2.0


def _spring(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    rate = rng.uniform(0.5, 3.0)
    load = {
        "kind": "spring",
        "anchor_m": 4.0 * motion.length * _unit(rng, 3),
        "at_m": 0.3 * motion.length * rng.normal(size=3),
        "stiffness_n_m": motion.least / motion.length**2 * rate**2,
        "rest_length_m": rng.uniform(0.0, 2.0) * motion.length,
    }
    return [load], rate


def _torsion_spring(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    """Return a spring that the motion twists by 2 rad at most."""
    stiffness = rng.uniform(0.3, 2.0) * motion.largest * motion.spin**2
    return [{"kind": "torsion-spring", "stiffness_n_m": stiffness}], math.sqrt(stiffness / motion.least)


def _gravity_gradient(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    rate = rng.uniform(0.1, 0.5) * motion.spin
    return [{"kind": "gravity-gradient", "orbit_rate_rad_s": rate}], 2.0 * rate


def _pivot(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    loads = [{"kind": "pivot", "at_m": motion.length * _unit(rng, 3)}]
    if rng.uniform() < 0.5:
        loads.append(_torque(rng, motion))
    return loads, math.sqrt(20.0 / motion.length)


def _several(rng: np.random.Generator, motion: _Motion) -> tuple[list[Forcing], float]:
    made = [make(rng, motion) for make in (_constant, _sines, _drag)]
    return [load for loads, _ in made for load in loads], max(rate for _, rate in made)


KINDS: dict[str, Callable[[np.random.Generator, _Motion], tuple[list[Forcing], float]]] = {
    "free": _free,
    "constant loads": _constant,
    "loads that come and go": _switched,
    "loads that come and go within a step": _off_grid,
    "sine torques": _sines,
    "drag": _drag,
    "spring": _spring,
    "torsion spring": _torsion_spring,
    "gravity gradient": _gravity_gradient,
    "pivot": _pivot,
    "several": _several,
}
