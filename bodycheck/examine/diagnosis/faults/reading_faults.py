"""Faults of steps, of states that are set and read, and of the precision."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import permutations, product

import numpy as np

from bodycheck.examine.diagnosis.engine_model import (
    Model,
    ReportedStates,
    conjugated,
    matrix_of,
    times,
    transposed_times,
)
from bodycheck.examine.diagnosis.faults.fault import (
    FACTOR,
    Fault,
    FaultContext,
    Misread,
    Parameter,
    Plant,
    assigned,
    constant,
    near,
)
from bodycheck.reference_impl.arrays import Array


def _quaternions(
    given: Callable[[Array], Array],
    back: Callable[[Array], Array],
    as_set: Callable[[Array], Array] | None = None,
) -> Misread:
    """Return what changes quaternions that are read; back: undoes it; as_set: changes those that are set."""
    return Misread(
        lambda r, _, __: replace(r, q=given(r.q)), lambda r, _, __: replace(r, q=back(r.q)), as_set
    )


def _as_read(q: Array) -> Array:
    return q


def _rolled(places: int) -> Callable[[Array], Array]:
    return lambda q: np.roll(q, places, axis=0)


def _scaled_reading(name: str, axis: int | None = None) -> Plant:
    """Return what multiplies a quantity that is read, or one of its components, by a factor."""

    def factors(r: ReportedStates, factor: float) -> Array:
        chosen = np.where((np.arange(3) == axis) | (axis is None), factor, 1.0)
        return chosen.reshape(3, *(1,) * (getattr(r, name).ndim - 1))

    return Misread(
        lambda r, s, _: replace(r, **{name: factors(r, s[0]) * getattr(r, name)}),
        lambda r, s, _: replace(r, **{name: getattr(r, name) / factors(r, s[0])}),
    )


def _with_omega(r: ReportedStates, *, in_world: bool) -> ReportedStates:
    """Return the reading with omega multiplied by R, into world axes, or by R^T, into body axes."""
    rotated = times if in_world else transposed_times
    return replace(r, w=rotated(matrix_of(r.q), r.w))


_DEGREES = (
    (180.0 / math.pi, "omega is read in degrees per second, not rad/s"),
    (math.pi / 180.0, "omega is read in rad/s as if it were in degrees per second, and converted again"),
    (0.5 / math.pi, "omega is read in revolutions per second, not rad/s"),
    (30.0 / math.pi, "omega is read in revolutions per minute, not rad/s"),
    (-1.0, "omega is read with the opposite sign"),
)


_COMPONENTS = {
    "omega": ("w", "omega_body", "omega about", "compare omega with the derivative of the attitude"),
    "velocity": ("v", "velocity_m_s", "the velocity along", "compare it with the derivative of the position"),
    "position": ("x", "position_m", "the position along", "compare its derivative with the velocity"),
}
"""Quantity -> its names in a reading, in a trajectory and with an axis, and what confirms a wrong reading."""


def _omega_axes(matrix: Array, how: str, applies: Callable[[FaultContext], bool]) -> Fault:
    """Return the fault that omega is multiplied by a matrix (3, 3) of one 1 or -1 per row when it is read."""
    named = [f"{'-' if min(row) < 0.0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in matrix]
    return Fault(
        f"omega-axes-{''.join(named)}",
        "reading",
        f"the axes of omega are {how} when it is read: x, y, z as {', '.join(named)}",
        Misread(
            lambda r, _, __: replace(r, w=np.einsum("ij,j...->i...", matrix, r.w)),
            lambda r, _, __: replace(r, w=np.einsum("ji,j...->i...", matrix, r.w)),
        ),
        applies=applies,
        confirm="compare omega with the derivative of the attitude",
    )


def _other_axes_of_omega() -> Iterator[Fault]:
    """Yield the permutations of the axes of omega, and their turns by right angles.

    Such as from forward, left, up to forward, right, down, or from z upwards to y upwards.
    """

    def turns_about_all(at: FaultContext) -> bool:
        """Whether each axis differs from its opposite."""
        return at.rotates and bool(np.all(np.any(at.transitions.trajectory.omega_body, axis=0)))

    orders = [np.eye(3)[list(order)] for order in permutations(range(3))]
    for matrix in orders[1:]:
        yield _omega_axes(matrix, "permuted", lambda at: at.rotates)
    for signs, order in product(list(product((1.0, -1.0), repeat=3))[1:], orders):
        matrix = np.array(signs)[:, None] * order
        if np.linalg.det(matrix) > 0.0:
            yield _omega_axes(matrix, "turned", turns_about_all)


def _axis_scaled(quantity: str, axis: int) -> Fault:
    """Return the fault that one component of a quantity is multiplied by a factor when it is read."""
    name, array, of_axis, confirm = _COMPONENTS[quantity]
    letter = "xyz"[axis]
    component = f"{of_axis} {letter}"

    def applies(at: FaultContext) -> bool:
        moves = np.any(getattr(at.transitions.trajectory, array), axis=0)
        is_one_of_several = bool(moves[axis] and np.any(np.delete(moves, axis)))  # else all are scaled
        return is_one_of_several and (quantity == "omega" or at.shows_translation)

    return Fault(
        f"{quantity}-{letter}-read-scaled",
        "reading",
        f"{component} is multiplied by {{0}} when it is read",
        _scaled_reading(name, axis),
        (FACTOR,),
        near(1.0, -1.0),
        applies,
        ((-1.0, f"{component} is read with the opposite sign"),),
        confirm=confirm,
    )


def _late(name: str, quantities: str, noun: str) -> Fault:
    def plant(model: Model, values: Array, at: FaultContext) -> None:
        model.stale, model.lateness = frozenset(quantities), float(values[0])

    def applies(at: FaultContext) -> bool:
        return at.stepped and (at.shows_translation or bool(set(quantities) & {"q", "w"}))

    return Fault(
        name,
        "reading",
        f"{noun} read {{0}} steps late",
        plant,
        (Parameter("delay", "steps", 0.0, 0.01, 1.0),),
        near(0.5, 1.0),
        applies,
        ((1.0, f"{noun} read one step late"), (0.5, f"{noun} read half a step late")),
        confirm="read the state twice in a row, and again after a step of length 0 if the engine allows it",
    )


def reading_faults() -> Iterator[Fault]:
    """Yield the faults of steps, readings and the precision."""
    yield Fault(
        "step-scaled",
        "step",
        "the step is multiplied by {0}: time passes at another rate",
        assigned("step_factor"),
        (Parameter("factor", low=0.0, high=100.0),),
        near(1.0, 0.5, 2.0),
        special=((0.5, "each step lasts half of its length"), (2.0, "each step lasts twice its length")),
        confirm="let the body fly without loads: its path must be v t",
    )
    yield Fault(
        "step-made-twice",
        "step",
        "each step is made twice",
        constant(repeats=1.0),
        applies=lambda at: at.stepped,
        confirm="let the body fly without loads: its path must be v t",
    )
    yield _late("state-late", "xvqw", "the state is")
    yield _late("attitude-late", "q", "the attitude is")
    yield _late("omega-late", "w", "omega is")
    yield _late("position-late", "x", "the position is")
    yield _late("velocity-late", "v", "the velocity is")
    yield _late("pose-late", "xq", "the pose is")
    yield _late("velocities-late", "vw", "the velocities are")
    yield Fault(
        "quaternion-conjugated",
        "reading",
        "the quaternion is world to body, conjugated in and out",
        _quaternions(conjugated, conjugated, as_set=conjugated),
        confirm="start from an attitude other than identity",
    )
    yield Fault(
        "quaternion-conjugated-when-read",
        "reading",
        "the quaternion that is read is world to body",
        _quaternions(conjugated, conjugated),
        confirm="compare q with the rotation matrix of the engine",
    )
    yield Fault(
        "quaternion-order",
        "reading",
        "the quaternion is scalar last, (x, y, z, w), in and out",
        _quaternions(_rolled(-1), _rolled(1), as_set=_rolled(1)),
        confirm="start from a rotation by 90 degrees about one axis",
    )
    yield Fault(
        "quaternion-order-when-read",
        "reading",
        "the quaternion that is read is scalar last, (x, y, z, w)",
        _quaternions(_rolled(-1), _rolled(1)),
        confirm="read the attitude at t = 0",
    )
    yield Fault(
        "quaternion-order-when-set",
        "reading",
        "the quaternion that is set is taken as scalar last, (x, y, z, w)",
        _quaternions(_as_read, _as_read, as_set=_rolled(1)),
        confirm="read the attitude at t = 0",
    )
    yield Fault(
        "quaternion-conjugated-when-set",
        "reading",
        "the quaternion that is set is taken as world to body",
        _quaternions(_as_read, _as_read, as_set=conjugated),
        confirm="read the attitude at t = 0",
    )
    yield Fault(
        "omega-read-in-wrong-axes",
        "reading",
        "omega is read in the other axes, world for body or body for world",
        Misread(
            lambda r, _, world: _with_omega(r, in_world=not world),
            lambda r, _, world: _with_omega(r, in_world=world),
        ),
        applies=lambda at: at.rotates,
        confirm="compare omega with the derivative of the attitude",
    )
    for axis in range(3):
        yield _axis_scaled("omega", axis)
    yield from _other_axes_of_omega()
    yield Fault(
        "omega-read-scaled",
        "reading",
        "omega is multiplied by {0} when it is read",
        _scaled_reading("w"),
        (FACTOR,),
        near(1.0, *(value for value, _ in _DEGREES)),
        lambda at: at.rotates,
        _DEGREES,
        confirm="compare omega with the derivative of the attitude",
    )
    yield Fault(
        "velocity-read-scaled",
        "reading",
        "the velocity is multiplied by {0} when it is read",
        _scaled_reading("v"),
        (FACTOR,),
        near(1.0, -1.0, 1e3, 1e-3),
        lambda at: at.shows_translation,
        (
            (-1.0, "the velocity is read with the opposite sign"),
            (1e3, "the velocity is read in mm/s"),
            (1e-3, "the velocity is read in km/s"),
        ),
        confirm="compare it with the derivative of the position",
    )
    yield Fault(
        "position-read-scaled",
        "reading",
        "the position is multiplied by {0} when it is read",
        _scaled_reading("x"),
        (FACTOR,),
        near(1.0, -1.0, 1e3, 1e-3),
        lambda at: at.shows_translation,
        (
            (-1.0, "the position is read with the opposite sign"),
            (1e3, "the position is read in mm"),
            (1e-3, "the position is read in km"),
        ),
        confirm="compare its derivative with the velocity",
    )
    for quantity in ("velocity", "position"):
        for axis in range(3):
            yield _axis_scaled(quantity, axis)
    yield Fault(
        "velocity-read-in-body-axes",
        "reading",
        "the velocity is read in body axes",
        Misread(
            lambda r, _, __: replace(r, v=transposed_times(matrix_of(r.q), r.v)),
            lambda r, _, __: replace(r, v=times(matrix_of(r.q), r.v)),
        ),
        applies=lambda at: at.shows_translation,
        confirm="compare it with the derivative of the position",
    )
    yield Fault(
        "single-precision-stage",
        "precision",
        "omega is rounded to float32 in each stage",
        constant(single_stage=1.0),
        applies=lambda at: at.rotates and not at.transitions.is_single,
        confirm="scan the engine's build for float32, and halve the step: the error must not decrease",
    )
    yield Fault(
        "float32",
        "precision",
        "the state is held in float32",
        constant(single_state=1.0),
        confirm="halve the step: the error must not decrease",
    )
