"""Compute the constants of the motion from a state at t = 0, as one row."""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation.classification import (
    is_certainly_tumbling,
    is_resolved,
    separation_of,
)
from bodycheck.reference_impl.free_rotation.constants_row import Steady, Tumbling, put_steady, put_tumbling
from bodycheck.reference_impl.free_rotation.principal_state import TumblingConstants, state_at
from bodycheck.reference_impl.free_rotation.tensor_axes import PrincipalAxes, principal, quaternion_of
from bodycheck.reference_impl.free_rotation.tumbling_constants import (
    FOUR_PI,
    NumberedAxes,
    Separation,
    hypotenuse,
    numbered,
    tumbling_constants,
)
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels import small_vectors
from bodycheck.reference_impl.kernels.jit import exact_kernel, long_exact_kernel
from bodycheck.reference_impl.kernels.small_vectors import Quat, Vec, matrix_at, vector_at

_NEGLIGIBLE = 2.0**-960  # of omega's largest component: smaller ones would leave the range of doubles


@exact_kernel
def unit(q: Quat) -> Quat:
    """q / |q| for |q| > 0 whose square neither overflows nor underflows."""
    shrink = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * shrink, q[1] * shrink, q[2] * shrink, q[3] * shrink


@exact_kernel
def _exponent(values: Array) -> int:
    """Return e with the largest |value| in [2^e, 2^(e + 1)), or 0 where all are zero."""
    largest = 0.0
    for value in values:
        largest = max(largest, abs(value))
    return math.frexp(largest)[1] - 1 if largest > 0.0 else 0


@exact_kernel
def _scaled(values: Array) -> Array:
    """Return the values divided by a power of two, the largest in [1, 2)."""
    exponent = _exponent(values)
    scaled = np.empty(len(values))
    for i in range(len(values)):
        scaled[i] = math.ldexp(values[i], -exponent)
    return scaled


@exact_kernel
def _frequency(omega: Array) -> float:
    """Return the power of two that divides omega."""
    return math.ldexp(1.0, _exponent(omega))


@exact_kernel
def _without_negligible(omega: Vec) -> Vec:
    x, y, z = omega
    return (
        x if abs(x) >= _NEGLIGIBLE else 0.0,
        y if abs(y) >= _NEGLIGIBLE else 0.0,
        z if abs(z) >= _NEGLIGIBLE else 0.0,
    )


@exact_kernel
def _scaled_rest(omega: Array, rest: Array) -> Vec:
    """Return the low part of omega, divided by the same power of two."""
    back = -_exponent(omega)
    return math.ldexp(rest[0], back), math.ldexp(rest[1], back), math.ldexp(rest[2], back)


@exact_kernel
def frame_of(inertia: Array, omega: Array, rest: Array) -> PrincipalAxes:
    """Return the principal frame of the scaled state: inertia (9,), omega (3,), rest (3,)."""
    spin = _without_negligible(vector_at(_scaled(omega), 0))
    return principal(matrix_at(_scaled(inertia), 0), spin, _scaled_rest(omega, rest))


@exact_kernel
def _attitude(quaternion: Array) -> Quat:
    q = _scaled(quaternion)
    return unit((q[0], q[1], q[2], q[3]))


@exact_kernel
def _conjugate(q: Quat) -> Quat:
    return q[0], -q[1], -q[2], -q[3]


@exact_kernel
def placed(motion: TumblingConstants, axes: NumberedAxes, omega: Array, quaternion: Array) -> Tumbling:
    """Return the motion that starts from the quaternion (4,); omega (3,) sets the time unit."""
    principal_axes = unit(quaternion_of(axes.columns))
    relative = unit(state_at(motion, dd.ZERO)[0])
    left = small_vectors.exact_quaternion_times(
        small_vectors.exact_quaternion_times(_attitude(quaternion), principal_axes), _conjugate(relative)
    )
    return Tumbling(motion, _frequency(omega), left, _conjugate(principal_axes), axes.columns)


@long_exact_kernel
def estimate_separations(inertia: Array, omega: Array, rest: Array, separations: Array) -> None:
    """Fill separations (m, 4), as `set_up_tumbling` takes them, where floating point resolves 2^-40."""
    for k in range(len(separations)):
        axes = numbered(frame_of(inertia[k], omega[k], rest[k]), False)
        if is_certainly_tumbling(axes) and is_resolved(axes):
            _, separation = separation_of(axes)
            separations[k, 0] = -1.0 if separation.descending else 1.0
            separations[k, 1], separations[k, 2] = separation.size
            separations[k, 3] = separation.exponent


@long_exact_kernel
def set_up_tumbling(
    inertia: Array,
    quaternion: Array,
    omega: Array,
    rest: Array,
    separations: Array,
    rows: Array,
    undecided: Array,
) -> None:
    """Fill the rows (m, WIDTH) of the bodies that certainly tumble, and mark the others in undecided (m,).

    inertia (m, 9), symmetric; quaternion (m, 4), not zero; omega (m, 3), body axes; rest (m, 3): the low part
    of omega. separations (m, 4): side, size, low part of the size, exponent; for a side of 0, floating point
    determines the separation.
    """
    for k in range(len(rows)):
        frame = frame_of(inertia[k], omega[k], rest[k])
        axes = numbered(frame, False)
        side, high, low, exponent = (
            separations[k, 0],
            separations[k, 1],
            separations[k, 2],
            separations[k, 3],
        )
        certain, separation = True, Separation(side < 0.0, (high, low), int(exponent))
        if side == 0.0:
            certain, separation = separation_of(axes)
            certain = certain and is_certainly_tumbling(axes)
        undecided[k] = not certain
        if certain:
            axes = numbered(frame, separation.descending)
            put_tumbling(rows[k], placed(tumbling_constants(axes, separation), axes, omega[k], quaternion[k]))


@exact_kernel
def set_up_steady(quaternion: Array, omega: Array, rest: Array, row: Array) -> None:
    """Fill one row with a rotation about a fixed axis, or with rest if omega = 0; omega + rest, (3,) each."""
    x, y, z = vector_at(_scaled(omega), 0)
    a, b, c = _scaled_rest(omega, rest)
    norm = hypotenuse(hypotenuse((x, a), (y, b)), (z, c))
    size = norm[0] if norm[0] > 0.0 else 1.0
    axis = (x / size, y / size, z / size)
    turn_rate = dd.divide(norm, FOUR_PI)
    put_steady(row, Steady(_frequency(omega), turn_rate, axis, _attitude(quaternion), vector_at(omega, 0)))
