"""Evaluate the attitude and angular velocity of many bodies at many times, in one loop."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation.packing import (
    Steady,
    Tumbling,
    is_steady,
    steady_in,
    tumbling_in,
)
from bodycheck.reference_impl.free_rotation.principal_state import state_at, turned
from bodycheck.reference_impl.free_rotation.set_up import unit
from bodycheck.reference_impl.kernels.jit import exact_kernel, long_exact_kernel
from bodycheck.reference_impl.kernels.small_vectors import exact_quaternion_times as quaternion_times
from bodycheck.reference_impl.kernels.small_vectors import exact_times as times


@exact_kernel
def _tumbling_at(tumbling: Tumbling, high: Array, low: Array, quaternion: Array, omega: Array) -> None:
    frequency = tumbling.frequency
    for i in range(len(high)):
        relative, omega_axes = state_at(tumbling.motion, (frequency * high[i], frequency * low[i]))
        q = unit(quaternion_times(quaternion_times(tumbling.left, relative), tumbling.right))
        w = times(tumbling.axes, omega_axes)
        for j in range(4):
            quaternion[i, j] = q[j]
        for j in range(3):
            omega[i, j] = frequency * w[j]


@exact_kernel
def _steady_at(motion: Steady, high: Array, low: Array, quaternion: Array, omega: Array) -> None:
    axis, frequency = motion.axis, motion.frequency
    for i in range(len(high)):
        s, c = turned(motion.turn_rate, (frequency * high[i], frequency * low[i]), 0.0)
        q = unit(quaternion_times(motion.quaternion, (c, s * axis[0], s * axis[1], s * axis[2])))
        for j in range(4):
            quaternion[i, j] = q[j]
        for j in range(3):
            omega[i, j] = motion.omega[j]


@long_exact_kernel
def evaluate(rows: Array, high: Array, low: Array, quaternion: Array, omega: Array) -> None:
    """Fill quaternion (m, n, 4) and omega (m, n, 3) of m bodies at times high + low, (n,) each, in s."""
    for k in range(len(rows)):
        if is_steady(rows[k]):
            _steady_at(steady_in(rows[k]), high, low, quaternion[k], omega[k])
        else:
            _tumbling_at(tumbling_in(rows[k]), high, low, quaternion[k], omega[k])
