"""m v' = F + m g - c v with F constant in world axes between switches, in closed form in double-double."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.piecewise_constant_loads import PiecewiseLoads
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel
from bodycheck.reference_impl.rational import pair
from bodycheck.reference_impl.scene import Scene

_LN2: DoubleDouble = (0.6931471805599453, 2.3190468138462996e-17)
_LARGEST, _SMALLEST = 709.0, -745.0  # outside, e^x leaves the range of doubles
_SERIES_BELOW = 0.5
_TERMS = 26  # 0.5^26 / 26! < 2^-114
_RECIPROCAL_FACTORIALS = tuple(pair(Fraction(1, math.factorial(j))) for j in range(_TERMS + 1))


@exact_kernel
def exponential(x: DoubleDouble) -> DoubleDouble:
    """Return e^x with relative error (1 + |x|) 2^-102; infinite above 709, zero below -745."""
    if x[0] > _LARGEST:
        return math.inf, 0.0
    if x[0] < _SMALLEST:
        return 0.0, 0.0
    n = np.rint(x[0] / _LN2[0])
    rest = dd.subtract(x, dd.two_product(n, _LN2[0]))
    rest = dd.subtract(rest, dd.two_product(n, _LN2[1]))
    total = _RECIPROCAL_FACTORIALS[_TERMS]
    for j in range(_TERMS - 1, -1, -1):
        total = dd.add(dd.multiply(rest, total), _RECIPROCAL_FACTORIALS[j])
    return math.ldexp(total[0], int(n)), math.ldexp(total[1], int(n))


@exact_kernel
def decay_means(z: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble]:
    """Return e^-z, (1 - e^-z) / z and (z - 1 + e^-z) / z^2, for any z, each to a relative 2^-100 or so.

    The second, m1(z), is the mean of e^-s over s in [0, z]; the third is int_0^z s m1(s) ds / z^2.
    """
    if z[0] == 0.0:
        return dd.ONE, dd.ONE, (0.5, 0.0)
    if abs(z[0]) < _SERIES_BELOW:
        mean2 = _RECIPROCAL_FACTORIALS[_TERMS]
        for j in range(_TERMS - 1, 1, -1):
            mean2 = dd.subtract(_RECIPROCAL_FACTORIALS[j], dd.multiply(z, mean2))
        mean1 = dd.subtract(dd.ONE, dd.multiply(z, mean2))
        return dd.subtract(dd.ONE, dd.multiply(z, mean1)), mean1, mean2
    decayed = exponential((-z[0], -z[1]))
    mean1 = dd.divide(dd.subtract(dd.ONE, decayed), z)
    return decayed, mean1, dd.divide(dd.subtract(dd.ONE, mean1), z)


@exact_kernel
def _advanced(
    x: DoubleDouble,
    v: DoubleDouble,
    a: DoubleDouble,
    t: DoubleDouble,
    means: tuple[DoubleDouble, DoubleDouble, DoubleDouble],
) -> tuple[DoubleDouble, DoubleDouble]:
    """x + t (v m1 + a t m2) and v e^-ct + a t m1, with the means m1, m2 of the decay e^-ct."""
    decayed, mean1, mean2 = means
    gained = dd.multiply(a, t)
    displacement = dd.multiply(t, dd.add(dd.multiply(v, mean1), dd.multiply(gained, mean2)))
    return dd.add(x, displacement), dd.add(dd.multiply(v, decayed), dd.multiply(gained, mean1))


@exact_kernel
def _move(
    state: Array, acceleration: Array, decay: DoubleDouble, begin: float, end: float, target: Array
) -> None:
    """Advance a state (2, k, 2), high and low parts of x and v, under acceleration (k, 2) into target."""
    t = dd.two_sum(end, -begin)
    means = decay_means(dd.multiply(decay, t))
    for j in range(len(acceleration)):
        a = (acceleration[j, 0], acceleration[j, 1])
        x, v = (state[0, j, 0], state[0, j, 1]), (state[1, j, 0], state[1, j, 1])
        x, v = _advanced(x, v, a, t, means)
        target[0, j, 0], target[0, j, 1] = x
        target[1, j, 0], target[1, j, 1] = v


@exact_kernel
def _follow_switches(starts: Array, accelerations: Array, decay: DoubleDouble, states: Array) -> None:
    """Fill the states (p, 2, k, 2) at the beginnings of the pieces (p,), given the first state."""
    for i in range(len(starts) - 1):
        _move(states[i], accelerations[i], decay, starts[i], starts[i + 1], states[i + 1])


@exact_kernel
def _follow(
    starts: Array, accelerations: Array, decay: DoubleDouble, states: Array, t_s: Array, out: Array
) -> None:
    """Fill out (n, 2, k, 2) with the states at the times t_s (n,) >= 0."""
    for i in range(len(t_s)):
        piece = np.searchsorted(starts, t_s[i], side="right") - 1
        _move(states[piece], accelerations[piece], decay, starts[piece], t_s[i], out[i])


@dataclass(frozen=True, eq=False)
class DecayingMotion:
    """x(t) and v(t), k components each, of v' = a(t) - c v.

    Errors are some 2^-100 of the largest terms: for doubles, only the rounding of the results remains.
    """

    _starts: Array
    _accelerations: Array
    _decay: DoubleDouble
    _states: Array

    @classmethod
    def of(
        cls,
        x: Sequence[DoubleDouble],
        v: Sequence[DoubleDouble],
        pieces: Sequence[tuple[float, Sequence[DoubleDouble]]],
        decay: DoubleDouble,
    ) -> DecayingMotion:
        """Set up from x and v at t = 0 and (begin, acceleration) of each piece; the first begins at 0."""
        starts = np.array([begin for begin, _ in pieces])
        accelerations = np.array([acceleration for _, acceleration in pieces], dtype=np.float64)
        states = np.empty((len(pieces), 2, len(x), 2))
        states[0] = x, v
        _follow_switches(starts, accelerations, decay, states)
        return cls(starts, accelerations, decay, states)

    @property
    def largest_rate(self) -> float:
        """The largest |v| at the beginning of a piece; within a piece v lies between its end values."""
        return float(np.abs(self._states[:, 1, :, 0]).max())

    def errors(self, t_s: Array, rates: Array) -> tuple[Array, Array]:
        """Return the errors (n,) of x and (n,) of v before rounding: 2^-96 of the terms of each piece.

        rates: |v| at t_s (n,). No term of v exceeds twice the largest |v| up to then, and no term of x the
        distance that v covers.
        """
        largest = 4.0 * self._share * np.maximum(rates, self.largest_rate)
        return self._share * float(np.abs(self._states[0, 0, :, 0]).max()) + largest * t_s, largest

    @property
    def _share(self) -> float:
        return len(self._starts) * 2.0**-96

    def at(self, t_s: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Return x and v, each as high (n, k) and low (n, k) parts, at times t_s >= 0 (n,)."""
        out = np.empty((len(t_s), *self._states.shape[1:]))
        _follow(self._starts, self._accelerations, self._decay, self._states, t_s, out)
        return (out[:, 0, :, 0], out[:, 0, :, 1]), (out[:, 1, :, 0], out[:, 1, :, 1])


@dataclass(frozen=True, eq=False)
class Flight:
    """x(t) and v(t), correctly rounded up to some 2^-100 of their largest terms."""

    _motion: DecayingMotion

    @classmethod
    def of(cls, scene: Scene, loads: PiecewiseLoads) -> Flight | None:
        """Set up the flight, or return None if a body-fixed force rotates with the body."""
        if any(any(piece.force_body) for piece in loads.pieces):
            return None
        mass, initial = Fraction(scene.body.mass), scene.initial
        pieces = [(piece.begin_s, [pair(f / mass) for f in piece.force_world]) for piece in loads.pieces]
        x, v = ([(float(c), 0.0) for c in vector] for vector in (initial.position, initial.velocity))
        return cls(DecayingMotion.of(x, v, pieces, pair(loads.linear_drag / mass)))

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return position (n, 3) in m and velocity (n, 3) in m/s, world axes, at times t_s >= 0 (n,)."""
        (position, _), (velocity, _) = self._motion.at(t_s)
        return position, velocity

    def errors(self, t_s: Array, velocity: Array) -> tuple[Array, Array]:
        """Return the errors (n,) of position and (n,) of velocity before rounding; velocity (n, 3)."""
        speeds = np.abs(velocity).max(axis=-1, initial=0.0)
        return self._motion.errors(t_s, speeds)
