"""A motion's constants as one row of an array, so that one compiled loop can take many bodies."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.elliptic import Quotients
from bodycheck.reference_impl.equations import matrix_at, vector_at
from bodycheck.reference_impl.free_rotation.series import CayleyKlein
from bodycheck.reference_impl.free_rotation.state import Tumble
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.registers import Mat, Quat, Vec


class Steady(NamedTuple):
    """A constant angular velocity: q(t) = q(0) exp(axis |omega| t / 2)."""

    frequency: float
    """The power of two, in 1/s, that makes the time unit: then all that is squared is of ordinary size."""
    turn_rate: DoubleDouble
    """|omega| / 4 pi: turns of the half angle per time unit."""
    axis: Vec
    quaternion: Quat
    omega: Vec


class Tumbling(NamedTuple):
    """q(body to world) = left * q(principal axes to the momentum's frame) * right."""

    motion: Tumble
    frequency: float
    """As for a steady motion."""
    left: Quat
    right: Quat
    axes: Mat
    """The principal axes in body axes, as columns."""


WIDTH = 54
_MOST_TURNS = 2.0**50
_KIND, _FREQUENCY, _TURN_RATE = 0, 1, 2
_STEADY, _TUMBLING = 1.0, 2.0


@kernel
def _put(row: Array, i: int, values: Any) -> int:
    """Write numbers from row[i] on, and return where they end."""
    for value in values:
        row[i] = value
        i += 1
    return i


@kernel
def _pair(row: Array, i: int) -> DoubleDouble:
    return row[i], row[i + 1]


@kernel
def _four(row: Array, i: int) -> Quat:
    return row[i], row[i + 1], row[i + 2], row[i + 3]


@kernel
def put_steady(row: Array, motion: Steady) -> None:
    """Write a steady motion."""
    row[_KIND] = _STEADY
    row[_FREQUENCY] = motion.frequency
    i = _put(row, _TURN_RATE, motion.turn_rate)
    i = _put(row, i, motion.axis)
    i = _put(row, i, motion.quaternion)
    _put(row, i, motion.omega)


@kernel
def is_steady(row: Array) -> bool:
    """Whether a steady motion stands there."""
    return bool(row[_KIND] == _STEADY)


@kernel
def steady_in(row: Array) -> Steady:
    """Read a steady motion."""
    return Steady(
        row[_FREQUENCY], _pair(row, _TURN_RATE), vector_at(row, 4), _four(row, 7), vector_at(row, 11)
    )


@kernel
def put_tumbling(row: Array, tumbling: Tumbling) -> None:
    """Write a tumbling motion."""
    motion, f = tumbling.motion, tumbling.motion.functions
    row[_KIND] = _TUMBLING
    row[_FREQUENCY] = tumbling.frequency
    i = _put(row, _TURN_RATE, motion.turn_rate)
    i = _put(row, i, motion.rate)
    i = _put(row, i, motion.start)
    i = _put(row, i, f.quarter_period)
    i = _put(row, i, f.rate)
    row[i] = 1.0 if f.trigonometric else 0.0
    i = _put(row, i + 1, (f.nome, f.sn, f.cn, f.dn, motion.series.twist))
    i = _put(row, i, motion.series.alpha_real)
    i = _put(row, i, motion.series.alpha_imag)
    i = _put(row, i, motion.series.beta_real)
    i = _put(row, i, motion.series.beta_imag)
    i = _put(row, i, motion.omega)
    i = _put(row, i, tumbling.left)
    i = _put(row, i, tumbling.right)
    _put(row, i, tumbling.axes)


@kernel
def tumbling_in(row: Array) -> Tumbling:
    """Read a tumbling motion."""
    functions = Quotients(row[12] == 1.0, _pair(row, 8), _pair(row, 10), row[13], row[14], row[15], row[16])
    series = CayleyKlein(_four(row, 18), _four(row, 22), _four(row, 26), _four(row, 30), row[17])
    motion = Tumble(
        functions, _pair(row, 6), _pair(row, 4), _pair(row, _TURN_RATE), series, vector_at(row, 34)
    )
    return Tumbling(motion, row[_FREQUENCY], _four(row, 37), _four(row, 41), matrix_at(row, 45))


@kernel
def quarter_period(row: Array) -> float:
    """K / lambda in s; infinite if steady or on the separatrix."""
    if is_steady(row):
        return math.inf
    motion = tumbling_in(row).motion
    return motion.functions.quarter_period[0] / motion.rate[0] / row[_FREQUENCY]


@kernel
def least_horizon(rows: Array) -> float:
    """Time in s in which a common phase or a momentum in the body makes 2^50 turns or half periods."""
    least = math.inf
    for row in rows:
        turn_rate = abs(row[_TURN_RATE])
        if not is_steady(row):
            motion = tumbling_in(row).motion
            turn_rate = max(turn_rate, 0.5 * motion.rate[0] / motion.functions.quarter_period[0])
        if turn_rate > 0.0:
            least = min(least, _MOST_TURNS / turn_rate / row[_FREQUENCY])
    return least
