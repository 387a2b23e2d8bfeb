"""The constants of a tree in the axes of the kernels, which are turned so that a joint's axis is e_z.

Computed in rational arithmetic and rounded once, to doubles or to double-doubles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import Numbers, high_part
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rational import (
    Vector,
    cross,
    dot,
    fractions,
    pair,
    rotation_of,
    times,
    transposed,
    unit,
)
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    JointSineTorque,
    JointTorque,
    TreeBody,
    TreeScene,
    interval,
)

MASS, INERTIA, ZERO, AT_PARENT, AT_BODY = 0, 1, 10, 19, 22
"""Columns of the constants: mass, inertia, Q (9) and the joint's points, in turned axes."""
STIFFNESS, REST, DAMPING, ARMATURE = 25, 26, 27, 28
ZERO_QUATERNION, TURN_QUATERNION, TURN, CONSTANTS = 29, 33, 37, 46
"""Further columns: Q and T as quaternions, and T (9), from turned axes to body axes."""
PARENT, ROTATION, TRANSLATION, RATE, RATES = 0, 1, 2, 3, 4
"""Columns of the structure: the parent, the parts of the joint, its first place in u, its number of rates."""
FORCE, TORQUE, POINT = 0, 3, 6
"""Columns of a load on a body: force and torque, in turned or in world axes, and the point of the force."""


@dataclass(frozen=True, eq=False)
class PreparedTree:
    """The numbers of a scene for the kernels of `tree_terms.py`, of n bodies and nu rates.

    structure (n, 5); constants (n, CONSTANTS); gravity (3, 1). pushes (m, 9) and pushed (m, 2): the loads on
    bodies that act, with the body and whether their axes are the world's; torques (nu, 1): the constant
    generalised forces that act; sines (s, 3): amplitude, rate and phase, at the rates sine_rates (s,).
    """

    structure: NDArray[np.int64]
    constants: Numbers
    gravity: Numbers
    pushes: Numbers
    pushed: NDArray[np.int64]
    torques: Numbers
    sines: Array
    sine_rates: NDArray[np.int64]

    def rounded(self) -> PreparedTree:
        """Return the same in doubles."""
        names = ("constants", "gravity", "pushes", "torques")
        return replace(self, **{name: high_part(getattr(self, name)) for name in names})


def prepared_tree(scene: TreeScene, t_s: float) -> PreparedTree:
    """Return the numbers of a scene with the loads that act at a time, in double-doubles."""
    turns = [_turn(body) for body in scene.bodies]
    rows = [_constants(body, turns, i) for i, body in enumerate(scene.bodies)]
    acting = [load for load in scene.loads if interval(load)[0] <= t_s < interval(load)[1]]
    pushes = [load for load in acting if isinstance(load, BodyLoad)]
    sines = [load for load in acting if isinstance(load, JointSineTorque)]
    torques = [Fraction(0)] * len(scene.u0)
    for load in acting:
        if isinstance(load, JointTorque):
            for k, value in enumerate(fractions(load.value), scene.rate_slices[load.body].start):
                torques[k] += value
    return PreparedTree(
        np.array([_structure(scene, i) for i in range(len(rows))], dtype=np.int64),
        _numbers(rows),
        _numbers([[g] for g in fractions(scene.gravity)]),
        _numbers([_push(load, turns) for load in pushes]),
        np.array([(load.body, load.load.axes == "world") for load in pushes], np.int64).reshape(-1, 2),
        _numbers([[torque] for torque in torques]),
        np.array([(load.amplitude, load.rate, load.phase) for load in sines]).reshape(-1, 3),
        np.array([scene.rate_slices[load.body].start for load in sines], dtype=np.int64),
    )


def _structure(scene: TreeScene, i: int) -> tuple[int, ...]:
    joint = scene.bodies[i].joint
    kind = joint.of_kind
    return joint.parent, int(kind.rotation), int(kind.translation), scene.rate_slices[i].start, kind.rates


def _numbers(rows: list[list[Fraction | tuple[float, float]]]) -> Numbers:
    """Return exact rows (m, columns) rounded; no rows give (0, 9)."""
    pairs = np.array(
        [[x if isinstance(x, tuple) else pair(x) for x in row] for row in rows] or np.empty((0, 9, 2))
    )
    return np.ascontiguousarray(pairs[..., 0]), np.ascontiguousarray(pairs[..., 1])


def _turn(body: TreeBody) -> Vector:
    """Return the quaternion, of any norm, of the rotation from turned axes to body axes: e_z to the axis."""
    if not body.joint.of_kind.has_axis:
        return fractions(np.array([1.0, 0.0, 0.0, 0.0]))
    x, y, z = axis = fractions(body.joint.axis)
    length = _root(dot(axis, axis))
    if z >= 0:
        return [length + z, -y, x, Fraction(0)]
    return [-y, length - z, Fraction(0), x]  # half a turn about e_x first, which avoids 0 at -e_z


def _root(square: Fraction) -> Fraction:
    """sqrt(square) to 2^-160, relative."""
    shift = 320 + 2 * abs(square.numerator.bit_length() - square.denominator.bit_length())
    return Fraction(isqrt((square.numerator << shift) // square.denominator), 1 << shift // 2)


def _constants(body: TreeBody, turns: list[Vector], i: int) -> list[Fraction | tuple[float, float]]:
    joint = body.joint
    turn, zero = turns[i], fractions(joint.zero)
    parent_turn = turns[joint.parent] if joint.parent >= 0 else [Fraction(1), *[Fraction(0)] * 3]
    turned_zero = _composed(_conjugate(parent_turn), _composed(zero, turn))
    to_body = rotation_of(turn)
    return [
        Fraction(body.mass),
        *_product(transposed(to_body), _product(fractions(body.inertia), to_body)),
        *rotation_of(turned_zero),
        *times(transposed(rotation_of(parent_turn)), fractions(joint.at_parent)),
        *times(transposed(to_body), fractions(joint.at_body)),
        *map(Fraction, (joint.stiffness, joint.rest, joint.damping, joint.armature)),
        *unit(turned_zero),
        *unit(turn),
        *to_body,
    ]


def _push(load: BodyLoad, turns: list[Vector]) -> list[Fraction | tuple[float, float]]:
    to_turned = transposed(rotation_of(turns[load.body]))
    value = fractions(load.load.value)
    if load.load.axes == "body":
        value = times(to_turned, value)
    nothing = [Fraction(0)] * 3
    if isinstance(load.load, Torque):
        return [*nothing, *value, *nothing]
    return [*value, *nothing, *times(to_turned, fractions(load.load.at))]


def _product(a: Vector, b: Vector) -> Vector:
    """A B."""
    return [dot(a[3 * i : 3 * i + 3], b[j::3]) for i in range(3) for j in range(3)]


def _conjugate(q: Vector) -> Vector:
    return [q[0], -q[1], -q[2], -q[3]]


def _composed(p: Vector, q: Vector) -> Vector:
    """P q, the rotation by q, then by p."""
    a, b = p[1:], q[1:]
    across = cross(a, b)
    return [p[0] * q[0] - dot(a, b), *(p[0] * y + q[0] * x + z for x, y, z in zip(a, b, across, strict=True))]
