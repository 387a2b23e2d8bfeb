"""Faults that contain others as special cases, or whose parameters fit much."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bodycheck.examine.diagnosis.engine_model import Loads, ReportedStates, cross, matrix_of, times
from bodycheck.examine.diagnosis.faults.fault import (
    Changed,
    Fault,
    FaultContext,
    Misread,
    Parameter,
    Plant,
    changed_loads,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_matrix


def _vector(unit: str) -> tuple[Parameter, ...]:
    return tuple(Parameter(axis, unit, 0.0) for axis in "xyz")


def _from_zero(_: FaultContext) -> list[tuple[float, float, float]]:
    return [(0.0, 0.0, 0.0)]


def _at_point(
    r: ReportedStates, point: Array, world: bool, *, position: bool, velocity: bool
) -> ReportedStates:
    """Return the reading with position or velocity of a point (3,) of the body, relative to those read."""
    rotation = matrix_of(r.q)
    arm = times(rotation, np.broadcast_to(point[:, None], r.x.shape))
    spin = r.w if world else times(rotation, r.w)
    return replace(r, x=r.x + arm if position else r.x, v=r.v + cross(spin, arm) if velocity else r.v)


def _other_point(*, position: bool, velocity: bool) -> Plant:
    return Misread(
        lambda r, point, world: _at_point(r, point, world, position=position, velocity=velocity),
        lambda r, point, world: _at_point(r, -point, world, position=position, velocity=velocity),
    )


def _rotated(inertia: Array, values: Array) -> Array:
    turn = exp_matrix(values)
    return np.asarray(turn @ inertia @ turn.T)


def _any_inertia(inertia: Array, values: Array) -> Array:
    a, b, c, d, e, f = values
    return np.asarray(inertia + np.trace(inertia) / 3.0 * np.array([[a, d, e], [d, b, f], [e, f, c]]))


def _inertia_of_same_trace(inertia: Array, values: Array) -> Array:
    xx, yy, xy, xz, yz = values
    return _any_inertia(inertia, np.array([xx, yy, -xx - yy, xy, xz, yz]))


def _is_scaled_by_loads(at: FaultContext) -> bool:
    """Whether loads turn the body, so that its inertia is determined, and not only up to a factor."""
    return at.has_torque or at.has_moment or bool(at.scene.continuous_loads) or not at.is_free


def _arms_shifted(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {
        "lever": loads.lever + values[:, None] * loads.force_body[:, None, :],
        "moment": loads.moment + values[:, None] * loads.force_world[:, None, :],
    }


def general_faults() -> Iterator[Fault]:
    """Yield the faults that contain others as special cases, or whose parameters fit much."""
    confirm = "compare the momentum gained with the impulse of the loads"
    yield Fault(
        "velocity-of-another-point",
        "reading",
        "the velocity is that of the point ({0}, {1}, {2}) m of the body",
        _other_point(position=False, velocity=True),
        _vector("m"),
        _from_zero,
        lambda at: at.rotates and at.shows_translation,
        is_general=True,
        confirm="compare it with the derivative of the position",
    )
    yield Fault(
        "position-of-another-point",
        "reading",
        "the position is that of the point ({0}, {1}, {2}) m of the body",
        _other_point(position=True, velocity=False),
        _vector("m"),
        _from_zero,
        lambda at: at.rotates and at.shows_translation,
        is_general=True,
        confirm="spin the body about its centre of mass: the position must not change",
    )
    yield Fault(
        "state-of-another-point",
        "reading",
        "position and velocity are those of the point ({0}, {1}, {2}) m of the body",
        _other_point(position=True, velocity=True),
        _vector("m"),
        _from_zero,
        lambda at: at.rotates and at.shows_translation,
        is_general=True,
        confirm="spin the body about its centre of mass: the position must not change",
    )
    yield Fault(
        "arm-shifted",
        "loads",
        "the arms of forces are off by ({0}, {1}, {2}) m in body axes",
        changed_loads(_arms_shifted),
        _vector("m"),
        _from_zero,
        lambda at: at.has_force,
        is_general=True,
        confirm="push the body at its centre of mass: it must not rotate",
    )
    yield Fault(
        "omega-read-shifted",
        "reading",
        "omega is read with an offset of ({0}, {1}, {2}) rad/s, as from a gyro with a bias",
        Misread(
            lambda r, offset, _: replace(r, w=r.w + offset[:, None]),
            lambda r, offset, _: replace(r, w=r.w - offset[:, None]),
        ),
        _vector("rad/s"),
        _from_zero,
        lambda at: at.rotates,
        is_general=True,
        confirm="read omega of a body at rest",
    )
    yield Fault(
        "inertia-axes-rotated",
        "body",
        "the principal axes are rotated by ({0}, {1}, {2}) rad",
        Changed("inertia", _rotated),
        tuple(Parameter(axis, "rad", 0.0, -math.pi, math.pi) for axis in "xyz"),
        _from_zero,
        is_general=True,
        confirm="read the inertia back from the engine",
    )
    yield Fault(
        "gravity-vector",
        "gravity",
        "gravity is off by ({0}, {1}, {2}) m/s^2",
        Changed("gravity", lambda g, d: g + d),
        _vector("m/s^2"),
        _from_zero,
        lambda at: at.has_gravity,
        is_general=True,
        confirm="drop the body from rest",
    )
    for noun, unit in (("torque", "N m"), ("force", "N")):
        for axes in ("body", "world"):
            yield Fault(
                f"spurious-{noun}-{axes}",
                "loads",
                f"a spurious constant {noun} of ({{0}}, {{1}}, {{2}}) {unit} in {axes} axes acts",
                Changed(f"spurious_{noun}_{axes}", lambda _, values: values),
                _vector(unit),
                _from_zero,
                (lambda _: True) if noun == "torque" else (lambda at: at.shows_translation),
                is_general=True,
                confirm=confirm,
            )
    yield Fault(
        "inertia-tensor",
        "body",
        "the inertia tensor is off by xx {0}, yy {1}, zz {2}, xy {3}, xz {4}, yz {5} of its mean moment",
        Changed("inertia", _any_inertia),
        tuple(Parameter(name, "", 0.0, -2.0, 2.0) for name in ("xx", "yy", "zz", "xy", "xz", "yz")),
        lambda _: [(0.0,) * 6],
        _is_scaled_by_loads,
        is_general=True,
        confirm="read the inertia back from the engine",
    )
    yield Fault(
        "inertia-tensor-up-to-a-factor",
        "body",
        "the inertia tensor is another one, up to a factor that a free motion does not determine: at the "
        "same trace, off by xx {0}, yy {1}, xy {2}, xz {3}, yz {4} of its mean moment",
        Changed("inertia", _inertia_of_same_trace),
        tuple(Parameter(name, "", 0.0, -2.0, 2.0) for name in ("xx", "yy", "xy", "xz", "yz")),
        lambda _: [(0.0,) * 5],
        lambda at: at.rotates and not _is_scaled_by_loads(at),
        is_general=True,
        confirm="read the inertia back from the engine, or apply a known torque",
    )
