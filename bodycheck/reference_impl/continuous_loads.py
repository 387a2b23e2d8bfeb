"""F, tau = sum of the continuous loads at (t, x, R, v, omega): the loads that vary with time and motion.

Force and torque about the centre of mass, both in world axes. Each load that has a kernel here is a row of
eleven numbers, its kind and its constants. The rows follow one another in one array:

    sine torque        0, axes (0 body, 1 world), amplitude (3,), rate, phase
    drag               1, linear, angular (9,)
    spring             2, anchor (3,), at (3,), stiffness, rest length
    torsion spring     3, stiffness, R(0) (9,)
    gravity gradient   4, orbit rate, inertia (9,)

All other loads share one last row of any length:

    recorded loads     5, the operations of recorded_formula.py that sum them, five numbers each
"""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Vec,
    add,
    cross,
    matrix_at,
    scaled_add,
    times,
    transposed_times,
    vector_at,
)
from bodycheck.reference_impl.loads.load import ContinuousLoad, checked_continuous, total_wrench
from bodycheck.reference_impl.loads.recorded_formula import (
    CONSTANT,
    COSINE,
    DIFFERENCE,
    OMEGA,
    OPERATION,
    OPERATIONS,
    POSITION,
    PRODUCT,
    QUOTIENT,
    RESULTS,
    ROOT,
    ROTATION,
    SCALED,
    SHIFTED,
    SINE,
    SUM,
    TIME,
    VELOCITY,
    recorded,
)
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    Scene,
    SineTorque,
    Spring,
    TorsionSpring,
)


@kernel
def recorded_wrench(
    t: float, position: Vec, rotation: Mat, velocity: Vec, omega_world: Vec, loads: Array, first: int
) -> tuple[Vec, Vec]:
    """Force in N and torque about the centre of mass in N m, by the operations from loads[first]."""
    count = (len(loads) - first) // OPERATION
    values = np.empty(OPERATIONS + count)
    for i in range(3):
        values[POSITION + i] = position[i]
        values[VELOCITY + i] = velocity[i]
        values[OMEGA + i] = omega_world[i]
    for i in range(9):
        values[ROTATION + i] = rotation[i]
    for i in range(count):
        values[OPERATIONS + i] = _value(t, values, loads, first + OPERATION * i)
    last = OPERATIONS + count - RESULTS
    force = (values[last], values[last + 1], values[last + 2])
    return force, (values[last + 3], values[last + 4], values[last + 5])


@kernel
def _value(t: float, values: Array, loads: Array, row: int) -> float:
    """The result of one operation, whose constant is rounded to a double."""
    code, a, b, c = int(loads[row]), values[int(loads[row + 1])], values[int(loads[row + 2])], loads[row + 3]
    if code == TIME:
        value = t
    elif code == CONSTANT:
        value = c
    elif code == SUM:
        value = a + b
    elif code == DIFFERENCE:
        value = a - b
    elif code == PRODUCT:
        value = a * b
    elif code == QUOTIENT:
        value = a / b
    elif code == SCALED:
        value = a * c
    elif code == SHIFTED:
        value = a + c
    elif code == ROOT:
        value = math.sqrt(a)
    elif code == SINE:
        value = math.sin(a)
    elif code == COSINE:
        value = math.cos(a)
    else:  # never recorded
        value = math.nan
    return value


_ROW = 11
_SINE, _DRAG, _SPRING, _TORSION, _GRADIENT, _RECORDED = range(6)
_ZERO = (0.0, 0.0, 0.0)
_UNKNOWN = (math.nan, math.nan, math.nan)


def packed_continuous_loads(scene: Scene) -> Array:
    """Return the rows of the scene's continuous loads (11 n,), then the record of those without a row."""
    rows: list[float] = []
    others: list[ContinuousLoad] = []
    for load in scene.continuous_loads:
        constants = _constants(load, scene)
        if constants is None:
            others.append(checked_continuous(load, "the table of continuous loads"))
        else:
            rows += constants + [0.0] * (_ROW - len(constants))
    if others:
        rows += [_RECORDED, *recorded(lambda _, at: total_wrench(others, scene, at)).ravel()]
    return np.array(rows, dtype=np.float64)


def _constants(load: object, scene: Scene) -> list[float] | None:
    """Return the row of a load, or None for a kind without a row."""
    match load:
        case SineTorque():
            return [_SINE, 0.0 if load.axes == "body" else 1.0, *load.amplitude, load.rate, load.phase]
        case Drag():
            return [_DRAG, load.linear, *load.angular.ravel()]
        case Spring():
            return [_SPRING, *load.anchor, *load.at, load.stiffness, load.rest_length]
        case GravityGradient():
            return [_GRADIENT, load.rate, *scene.body.inertia.ravel()]
        case TorsionSpring():
            return [_TORSION, load.stiffness, *scene.initial.rotation.ravel()]
        case CallbackLoad():
            raise ValueError(f"{load.name} is known by its function alone, not by constants")
        case _:
            return None


@kernel
def continuous_wrench(
    t: float, position: Vec, rotation: Mat, velocity: Vec, omega_world: Vec, loads: Array
) -> tuple[Vec, Vec]:
    """Return force (3,) in N and torque (3,) about the centre of mass in N m, world axes.

    position (3,), velocity (3,) and omega_world (3,) in world axes; rotation (9,), body to world.
    """
    force, torque = _ZERO, _ZERO
    for row in range(0, len(loads), _ROW):
        kind = loads[row]
        if kind == _SINE:
            torque = add(torque, _sine(t, rotation, loads, row))
        elif kind == _DRAG:
            force = scaled_add(force, -loads[row + 1], velocity)
            slowing = times(matrix_at(loads, row + 2), transposed_times(rotation, omega_world))
            torque = scaled_add(torque, -1.0, times(rotation, slowing))
        elif kind == _SPRING:
            arm = times(rotation, vector_at(loads, row + 4))
            pull = _spring(add(position, arm), loads, row)
            force, torque = add(force, pull), add(torque, cross(arm, pull))
        elif kind == _TORSION:
            rotvec = rotation_vector(_product_with_transposed(rotation, matrix_at(loads, row + 2)))
            torque = scaled_add(torque, -loads[row + 1], rotvec)
        elif kind == _GRADIENT:
            torque = add(torque, _gravity_gradient(t, rotation, loads, row))
        elif kind == _RECORDED:  # the last row, of any length
            push, couple = recorded_wrench(t, position, rotation, velocity, omega_world, loads, row + 1)
            return add(force, push), add(torque, couple)
        else:  # a kind that packed_continuous_loads never writes
            return _UNKNOWN, _UNKNOWN
    return force, torque


@kernel
def _sine(t: float, rotation: Mat, loads: Array, row: int) -> Vec:
    """amplitude sin(rate t + phase), in world axes."""
    amplitude = vector_at(loads, row + 2)
    if loads[row + 1] == 0.0:
        amplitude = times(rotation, amplitude)
    return scaled_add(_ZERO, math.sin(loads[row + 5] * t + loads[row + 6]), amplitude)


@kernel
def _spring(point: Vec, loads: Array, row: int) -> Vec:
    """-stiffness (|d| - rest_length) d / |d|, d = point - anchor; 0 at d = 0."""
    d = scaled_add(point, -1.0, vector_at(loads, row + 1))
    length = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    if length == 0.0:
        return _ZERO
    return scaled_add(_ZERO, -loads[row + 7] * (length - loads[row + 8]) / length, d)


@kernel
def _gravity_gradient(t: float, rotation: Mat, loads: Array, row: int) -> Vec:
    """3 n^2 u x (I u), u = (-sin n t, 0, -cos n t) in world axes."""
    rate = loads[row + 1]
    u = (-math.sin(rate * t), 0.0, -math.cos(rate * t))
    inertial = times(rotation, times(matrix_at(loads, row + 2), transposed_times(rotation, u)))
    return scaled_add(_ZERO, 3.0 * rate * rate, cross(u, inertial))


@kernel
def _product_with_transposed(a: Mat, b: Mat) -> Mat:
    """a b^T, in row-major order."""
    rows = (
        times(b, (a[0], a[1], a[2])),
        times(b, (a[3], a[4], a[5])),
        times(b, (a[6], a[7], a[8])),
    )
    return rows[0] + rows[1] + rows[2]


@kernel
def rotation_vector(r: Mat) -> Vec:
    """2 atan2(|v|, w) v / |v| with (w, v) the quaternion of R, from its largest component (Shepperd 1978)."""
    trace = r[0] + r[4] + r[8]
    x, y, z = r[7] - r[5], r[2] - r[6], r[3] - r[1]
    w = 1.0 + trace
    if r[0] > trace and r[0] >= r[4] and r[0] >= r[8]:
        w, x, y, z = x, 1.0 + 2.0 * r[0] - trace, r[1] + r[3], r[2] + r[6]
    elif r[4] > trace and r[4] >= r[8]:
        w, x, y, z = y, r[1] + r[3], 1.0 + 2.0 * r[4] - trace, r[5] + r[7]
    elif r[8] > trace:
        w, x, y, z = z, r[2] + r[6], r[5] + r[7], 1.0 + 2.0 * r[8] - trace
    length = math.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return _ZERO
    # q and -q are the same rotation; take the angle of at most pi
    scale = math.copysign(2.0 * math.atan2(length, abs(w)) / length, w)
    return scale * x, scale * y, scale * z


@kernel
def continuous_wrench_at(
    t: float, position: Array, rotation: Array, velocity: Array, omega_world: Array, loads: Array
) -> Array:
    """Return force and torque (6,) as `continuous_wrench`, from arrays; rotation (3, 3) is contiguous."""
    force, torque = continuous_wrench(
        t,
        vector_at(position, 0),
        matrix_at(rotation.reshape(9), 0),
        vector_at(velocity, 0),
        vector_at(omega_world, 0),
        loads,
    )
    return np.array([force[0], force[1], force[2], torque[0], torque[1], torque[2]])
