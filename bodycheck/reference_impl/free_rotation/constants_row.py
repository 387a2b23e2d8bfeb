"""Pack a motion's constants into one row of an array, so that one compiled loop handles many bodies."""

from __future__ import annotations

import math
from typing import NamedTuple

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.elliptic import Quotients
from bodycheck.reference_impl.free_rotation.principal_state import CayleyKlein, TumblingConstants
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel, inlined_kernel
from bodycheck.reference_impl.kernels.small_vectors import Mat, Quat, Vec, matrix_at


class Steady(NamedTuple):
    """A constant angular velocity: q(t) = q(0) exp(axis |omega| t / 2)."""

    frequency: float
    """The power of two, in 1/s, that sets the time unit, so that squares neither overflow nor underflow."""
    turn_rate: DoubleDouble
    """|omega| / 4 pi: turns of the half angle per time unit."""
    axis: Vec
    quaternion: Quat
    omega: Vec


class Tumbling(NamedTuple):
    """q(body to world) = left * q(principal axes to the momentum's frame) * right."""

    motion: TumblingConstants
    frequency: float
    """As in `Steady`."""
    left: Quat
    right: Quat
    axes: Mat
    """The principal axes in body axes, as columns."""


WIDTH = 56
QUARTER_PERIOD = 1
"""K / lambda in s; infinite if steady or on the separatrix."""
HORIZON = 2
"""Time in s in which the common phase makes 2^50 turns or the body-frame momentum 2^50 half periods."""
_KIND, _FREQUENCY, _TURN_RATE = 0, 3, 4
_STEADY, _TUMBLING = 1.0, 2.0
_MAX_TURNS = 2.0**50


@inlined_kernel
def _pair(row: Array, i: int) -> DoubleDouble:
    return row[i], row[i + 1]


@inlined_kernel
def _four(row: Array, i: int) -> Quat:
    return row[i], row[i + 1], row[i + 2], row[i + 3]


@inlined_kernel
def _put_pair(row: Array, i: int, x: DoubleDouble) -> None:
    row[i], row[i + 1] = x


@inlined_kernel
def _put_vector(row: Array, i: int, x: Vec) -> None:
    row[i], row[i + 1], row[i + 2] = x


@inlined_kernel
def _put_four(row: Array, i: int, x: Quat) -> None:
    row[i], row[i + 1], row[i + 2], row[i + 3] = x


@exact_kernel
def put_steady(row: Array, motion: Steady) -> None:
    """Write a steady motion into a row."""
    turn_rate = motion.turn_rate[0]
    row[_KIND], row[_FREQUENCY], row[QUARTER_PERIOD] = _STEADY, motion.frequency, math.inf
    row[HORIZON] = _MAX_TURNS / turn_rate / motion.frequency if turn_rate > 0.0 else math.inf
    _put_pair(row, _TURN_RATE, motion.turn_rate)
    _put_vector(row, 6, motion.axis)
    _put_four(row, 9, motion.quaternion)
    _put_vector(row, 13, motion.omega)


@exact_kernel
def is_steady(row: Array) -> bool:
    """Return whether the row holds a steady motion."""
    return bool(row[_KIND] == _STEADY)


@exact_kernel
def steady_in(row: Array) -> Steady:
    """Read a steady motion from a row."""
    return Steady(
        row[_FREQUENCY],
        _pair(row, _TURN_RATE),
        (row[6], row[7], row[8]),
        _four(row, 9),
        (row[13], row[14], row[15]),
    )


@exact_kernel
def put_tumbling(row: Array, tumbling: Tumbling) -> None:
    """Write a tumbling motion into a row."""
    motion, f, series = tumbling.motion, tumbling.motion.functions, tumbling.motion.series
    half_period_rate = 0.5 * motion.rate[0] / f.quarter_period[0]
    row[_KIND], row[_FREQUENCY] = _TUMBLING, tumbling.frequency
    row[QUARTER_PERIOD] = f.quarter_period[0] / motion.rate[0] / tumbling.frequency
    row[HORIZON] = _MAX_TURNS / max(abs(motion.turn_rate[0]), half_period_rate) / tumbling.frequency
    _put_pair(row, _TURN_RATE, motion.turn_rate)
    _put_pair(row, 6, motion.rate)
    _put_pair(row, 8, motion.start)
    _put_pair(row, 10, f.quarter_period)
    _put_pair(row, 12, f.rate)
    row[14] = 1.0 if f.trigonometric else 0.0
    _put_four(row, 15, (f.nome, f.sn, f.cn, f.dn))
    row[19] = series.twist
    _put_four(row, 20, series.alpha_real)
    _put_four(row, 24, series.alpha_imag)
    _put_four(row, 28, series.beta_real)
    _put_four(row, 32, series.beta_imag)
    _put_vector(row, 36, motion.omega)
    _put_four(row, 39, tumbling.left)
    _put_four(row, 43, tumbling.right)
    for i in range(9):
        row[47 + i] = tumbling.axes[i]


@exact_kernel
def tumbling_in(row: Array) -> Tumbling:
    """Read a tumbling motion from a row."""
    functions = Quotients(row[14] == 1.0, _pair(row, 10), _pair(row, 12), row[15], row[16], row[17], row[18])
    series = CayleyKlein(_four(row, 20), _four(row, 24), _four(row, 28), _four(row, 32), row[19])
    motion = TumblingConstants(
        functions,
        _pair(row, 8),
        _pair(row, 6),
        _pair(row, _TURN_RATE),
        series,
        (row[36], row[37], row[38]),
    )
    return Tumbling(motion, row[_FREQUENCY], _four(row, 39), _four(row, 43), matrix_at(row, 47))
