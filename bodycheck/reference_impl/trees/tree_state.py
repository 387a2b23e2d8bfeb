"""The state of a tree in the series of `tree_terms.py`, and the motion of its bodies."""

from __future__ import annotations

from typing import Any

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    add_product,
    by_double,
    exactly,
    high_part,
    minus,
    nothing,
    over,
    phase,
    plus,
    put,
    renorm,
    root,
    sine_and_cosine,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.taylor.taylor_terms import added, put_vector, subtracted, vector_terms
from bodycheck.reference_impl.trees.prepared_tree import (
    AT_BODY,
    AT_PARENT,
    INERTIA,
    MASS,
    PARENT,
    RATE,
    REST,
    ROTATION,
    STIFFNESS,
    TRANSLATION,
    TURN,
    TURN_QUATERNION,
    ZERO,
    ZERO_QUATERNION,
)
from bodycheck.reference_impl.trees.tree_numbers import (
    AXIS,
    BALL,
    CARRIED,
    MOMENT,
    OMEGA,
    PLACE,
    ROWS,
    SLIDE,
    SPACE,
    SPEED,
    SPIN,
    TURNED,
    F,
    Structure,
    add_vector,
    back,
    constant,
    cross,
    dot,
    from_world,
    opposite,
    put_row,
    scaled,
    through,
    to_child_now,
    to_world,
)
from bodycheck.reference_impl.trees.tree_terms import put_omega, put_rotation

POSITION, QUATERNION, VELOCITY, BODY_OMEGA, JOINT_FORCE, JOINT_MOMENT, POSE = 0, 3, 7, 10, 13, 16, 19
"""Columns of a body: position and velocity of the centre in world axes; omega, and the wrench of the joint
about its point, in body axes."""
KINETIC, POTENTIAL, MOMENTUM, ANGULAR, TOTALS = 0, 1, 2, 5, 8
"""Rows of the totals: energies, momentum and angular momentum about the origin, in world axes."""

Quaternion = tuple[Any, Any, Any, Any]


@kernel
def put_state(
    structure: Structure, constants: Numbers, sines: Array, q: Numbers, u: Numbers, t: float, series: Numbers
) -> None:
    """Set the constant terms from q (coordinates, 1), with quaternions of any norm, u (rates, 1) and t."""
    none, place = nothing(series), 0
    for i in range(len(structure)):
        own, row = ROWS * i, structure[i, RATE]
        for j in range((0, 1, 3)[structure[i, TRANSLATION]]):
            put(series, own + PLACE + j, 0, term(q, place, 0))
            put(series, own + SPEED + j, 0, term(u, row, 0))
            place, row = place + 1, row + 1
        put_vector(series, own + SPIN, 0, (none, none, none))
        if structure[i, ROTATION] == AXIS:
            sine, cosine = sine_and_cosine(term(q, place, 0))
            put_vector(series, own + TURNED, 0, (term(q, place, 0), cosine, sine))
            put(series, own + SPIN + 2, 0, term(u, row, 0))
            place += 1
        elif structure[i, ROTATION] == BALL:
            square = times(term(q, place, 0), term(q, place, 0))
            for j in range(1, 4):
                square = add_product(square, term(q, place + j, 0), term(q, place + j, 0))
            norm = root(renorm(square))
            for j in range(4):
                put(series, own + TURNED + j, 0, over(term(q, place + j, 0), norm))
            put_rotation(series, own, 0)
            put_vector(series, own + SPIN, 0, vector_terms(u, row, 0))
            place += 4
        put_omega(structure, constants, series, i, 0)
    for j in range(len(sines)):
        sine, cosine = sine_and_cosine(phase(exactly(series, sines[j, 1]), t, sines[j, 2]))
        put(series, ROWS * len(structure) + 2 * j, 0, sine)
        put(series, ROWS * len(structure) + 2 * j + 1, 0, cosine)


@kernel
def put_motion(
    structure: Structure, constants: Numbers, series: Numbers, work: Numbers, poses: Numbers
) -> None:
    """Set the motion in poses (n, POSE); needs `put_world_axes` at order 0, and overwrites work (n, 7)."""
    none = nothing(series)
    for i in range(len(structure)):
        own, parent = ROWS * i, structure[i, PARENT]
        rotation, translation = structure[i, ROTATION], structure[i, TRANSLATION]
        omega = vector_terms(series, own + OMEGA, 0)
        at_body = constant(constants, i, AT_BODY)
        quaternion = quaternion_of(constants, i, ZERO_QUATERNION)
        position = constant(constants, i, AT_PARENT)
        v = none, none, none
        if parent >= 0:
            above = ROWS * parent
            quaternion = composed(quaternion_of(work, parent, 0), quaternion)
            v = added(constant(work, parent, 4), cross(vector_terms(series, above + OMEGA, 0), position))
            v = back(constants, i, ZERO, v)
            position = added(constant(poses, parent, POSITION), to_world(series, above, position))
        if translation == SLIDE:
            place = term(series, own + PLACE, 0)
            x, y = term(series, own + CARRIED, 0), term(series, own + CARRIED + 1, 0)
            v = added(v, (times(place, y), opposite(times(place, x)), term(series, own + SPEED, 0)))
            # the axis in world axes: e_z, also in child axes
            position = added(position, to_world(series, own, (none, none, place)))
        v = subtracted(to_child_now(series, rotation, own, v), cross(omega, at_body))
        position = subtracted(position, to_world(series, own, at_body))
        velocity = to_world(series, own, v)
        if translation == SPACE:
            position = vector_terms(series, own + PLACE, 0)
            velocity = vector_terms(series, own + SPEED, 0)
            v = from_world(series, own, velocity, 0)
        quaternion = composed(quaternion, joint_quaternion(series, rotation, own))
        put_row(poses, i, POSITION, position)
        put_row(poses, i, VELOCITY, velocity)
        put_row(poses, i, BODY_OMEGA, through(constants, i, TURN, omega))
        put_quaternion(work, i, 0, quaternion)
        put_row(work, i, 4, v)
        w, x, y, z = quaternion_of(constants, i, TURN_QUATERNION)
        to_turned = w, opposite(x), opposite(y), opposite(z)
        put_quaternion(poses, i, QUATERNION, composed(quaternion, to_turned))


@kernel
def quaternion_of(numbers: Numbers, i: int, j: int) -> Quaternion:
    """Return the four numbers from [i, j]."""
    return term(numbers, i, j), term(numbers, i, j + 1), term(numbers, i, j + 2), term(numbers, i, j + 3)


@kernel
def put_quaternion(numbers: Numbers, i: int, j: int, q: Quaternion) -> None:
    """Set the four numbers from [i, j]."""
    put(numbers, i, j, q[0])
    put_row(numbers, i, j + 1, (q[1], q[2], q[3]))


@kernel
def composed(p: Quaternion, q: Quaternion) -> Quaternion:
    """p q: the rotation by q, then by p."""
    a, b = (p[1], p[2], p[3]), (q[1], q[2], q[3])
    x, y, z = added(cross(a, b), added(scaled(p[0], b), scaled(q[0], a)))
    return minus(times(p[0], q[0]), dot(a, b)), x, y, z


@kernel
def joint_quaternion(series: Numbers, rotation: int, own: int) -> Quaternion:
    """E_0 as a quaternion."""
    if rotation == BALL:
        return term(series, own + TURNED, 0), *vector_terms(series, own + TURNED + 1, 0)
    half = by_double(term(series, own + TURNED, 0), 0.5 if rotation == AXIS else 0.0)
    sine, cosine = sine_and_cosine(half)
    return cosine, nothing(series), nothing(series), sine


@kernel
def put_totals(
    structure: Structure,
    constants: Numbers,
    gravity: Numbers,
    series: Numbers,
    poses: Numbers,
    totals: Numbers,
) -> None:
    """Set totals (TOTALS, 1) from poses; the potential is 0 at the origin and for springs at rest."""
    for row in range(TOTALS):
        put(totals, row, 0, nothing(series))
    weight = vector_terms(gravity, 0, 0)
    for i in range(len(structure)):
        own, mass = ROWS * i, term(constants, i, MASS)
        position, velocity = constant(poses, i, POSITION), constant(poses, i, VELOCITY)
        omega = vector_terms(series, own + OMEGA, 0)
        spin = through(constants, i, INERTIA, omega)
        twice = plus(times(mass, dot(velocity, velocity)), dot(omega, spin))
        put(totals, KINETIC, 0, plus(term(totals, KINETIC, 0), by_double(twice, 0.5)))
        is_turned = structure[i, ROTATION] == AXIS
        stretch = minus(term(series, own + (TURNED if is_turned else PLACE), 0), term(constants, i, REST))
        spring = times(times(term(constants, i, STIFFNESS), stretch), by_double(stretch, 0.5))
        spring = minus(spring, times(mass, dot(weight, position)))
        put(totals, POTENTIAL, 0, plus(term(totals, POTENTIAL, 0), spring))
        momentum = scaled(mass, velocity)
        add_vector(totals, MOMENTUM, 0, momentum)
        add_vector(totals, ANGULAR, 0, added(cross(position, momentum), to_world(series, own, spin)))


@kernel
def put_in_world_axes(structure: Structure, series: Numbers, numbers: Numbers, column: int) -> None:
    """Turn the rows of the free bodies' translations in one column from body axes to world axes."""
    for i in range(len(structure)):
        if structure[i, TRANSLATION] == SPACE:
            row = structure[i, RATE]
            put_vector(numbers, row, column, to_world(series, ROWS * i, vector_terms(numbers, row, column)))


@kernel
def put_wrenches(structure: Structure, constants: Numbers, series: Numbers, poses: Numbers) -> None:
    """Set the force and the moment of each joint on the child, 0 for free bodies."""
    none = nothing(series)
    for i in range(len(structure)):
        force = moment = none, none, none
        if structure[i, TRANSLATION] != SPACE:
            force = through(constants, i, TURN, vector_terms(series, ROWS * i + F, 0))
            moment = through(constants, i, TURN, vector_terms(series, ROWS * i + MOMENT, 0))
        put_row(poses, i, JOINT_FORCE, force)
        put_row(poses, i, JOINT_MOMENT, moment)


@kernel
def put_free_fall(structure: Structure, gravity: Numbers, series: Numbers, x: Numbers) -> None:
    """Set x (rates, 1) to the rates' derivatives of free fall: R^T g for free bodies, else 0."""
    for row in range(len(high_part(x))):
        put(x, row, 0, nothing(series))
    for i in range(len(structure)):
        if structure[i, TRANSLATION] == SPACE:
            weight = from_world(series, ROWS * i, vector_terms(gravity, 0, 0), 0)
            put_vector(x, structure[i, RATE], 0, weight)


@kernel
def add_column(x: Numbers, y: Numbers, factor: float) -> None:
    """x + factor y in place, both (rates, 1)."""
    for row in range(len(high_part(x))):
        put(x, row, 0, plus(term(x, row, 0), by_double(term(y, row, 0), factor)))
