"""Limits of velocities and angles that an engine applies, and sleep."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal

import numpy as np

from bodycheck.examine.diagnosis.engine_model import ClampAxes, Model
from bodycheck.examine.diagnosis.faults.fault import Fault, FaultContext, Parameter, assigned
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle


def _largest_of(which: Literal["v", "w"], axes: ClampAxes, at: FaultContext) -> float:
    """Return the largest component, or norm, after the first sample."""
    v, w_world, w, v_body = at.later
    if axes == "norm":
        return float(np.max(np.linalg.norm(v if which == "v" else w, axis=-1)))
    values = {("v", "world"): v, ("v", "body"): v_body, ("w", "world"): w_world, ("w", "body"): w}
    return float(np.max(np.abs(values[which, axes])))


def _clamp(which: Literal["v", "w"], axes: ClampAxes, *, first: bool) -> Fault:
    noun, unit = ("the velocity", "m/s") if which == "v" else ("omega", "rad/s")
    part = "the norm of" if axes == "norm" else "each component of"
    tail = ("" if axes == "norm" else f" in {axes} axes") + ("" if first else " after the pose is updated")

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        setattr(model, f"clamp_{which}", (axes, abs(float(values[0]))))
        model.clamped_first = first

    def applies(at: FaultContext) -> bool:
        return bool(_largest_of(which, axes, at) > 0.0) and (which == "w" or at.shows_translation)

    return Fault(
        f"{'speed' if which == 'v' else 'omega'}-clamped-{axes}{'' if first else '-after'}",
        "limit",
        f"{part} {noun} is clamped at {{0}} {unit}{tail}",
        plant,
        (Parameter("limit", unit, math.inf, 0.0, 1e9, 1.0),),
        lambda at: [(_largest_of(which, axes, at),)],
        applies,
        confirm="start above and below the limit: only the motion above it must be wrong",
    )


def _both_clamped(model: Model, values: Array, at: FaultContext) -> None:
    limit = abs(float(values[0]))
    model.clamp_v, model.clamp_w = ("world", limit), ("world", limit)


def _quiet_speed(at: FaultContext) -> float:
    """Return the largest speed, in m/s or rad/s, at which the body does not move; 0 if it always does."""
    path = at.transitions.trajectory
    still = np.all(path.attitude[1:] == path.attitude[:-1], axis=-1)
    still &= np.all(path.position_m[1:] == path.position_m[:-1], axis=-1)
    if not still.any():
        return 0.0
    v, w = np.linalg.norm(path.velocity_m_s, axis=-1), np.linalg.norm(path.omega_body, axis=-1)
    return float(np.max(np.maximum(v, w)[:-1][still])) * (1.0 + 1e-9)


def _largest_turn(at: FaultContext) -> float:
    """Return the largest angle, in rad, by which the attitude turns in a step."""
    q = at.transitions.trajectory.attitude
    return float(np.max(geodesic_angle(q[:-1], q[1:]))) / at.transitions.grid.stride


def limit_faults() -> Iterator[Fault]:
    """Yield the limits."""
    everywhere: tuple[ClampAxes, ...] = ("world", "body", "norm")
    for first in (True, False):
        yield from (_clamp("w", axes, first=first) for axes in everywhere)
        yield from (_clamp("v", axes, first=first) for axes in everywhere)
    yield Fault(
        "velocities-clamped",
        "limit",
        "each component of the velocity and of omega in world axes is clamped at {0} m/s or rad/s",
        _both_clamped,
        (Parameter("limit", "m/s or rad/s", math.inf, 0.0, 1e9, 1.0),),
        lambda at: [(max(_largest_of("w", "world", at), _largest_of("v", "world", at)),)],
        lambda at: (
            at.shows_translation
            and _largest_of("w", "world", at) > 0.0
            and _largest_of("v", "world", at) > 0.0
        ),
        confirm="start above and below the limit: only the motion above it must be wrong",
    )
    yield Fault(
        "turn-clamped",
        "limit",
        "the rotation in one step is limited to {0} rad",
        assigned("largest_turn"),
        (Parameter("limit", "rad", math.inf, 1e-6, math.pi),),
        lambda at: [(math.pi / 4.0,), (_largest_turn(at),)],
        lambda at: (
            at.stepped
            and bool(
                np.max(at.transitions.grid.dt_s)
                * np.max(np.linalg.norm(at.transitions.trajectory.omega_body, axis=-1))
                > 0.5
            )
        ),
        confirm="halve the step: the error must vanish",
    )
    yield Fault(
        "asleep",
        "limit",
        "the body sleeps: it stands still below {0} m/s and rad/s",
        assigned("asleep"),
        (Parameter("threshold", "m/s and rad/s", 0.0, 0.0),),
        lambda at: [(_quiet_speed(at),)],
        lambda at: _quiet_speed(at) > 0.0,
        confirm="disable sleeping and run the case again",
    )
