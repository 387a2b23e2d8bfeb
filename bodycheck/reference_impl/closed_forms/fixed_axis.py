"""J w' = tau(t) - d w: rotation about a principal axis along which omega and all torques remain."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.flight import DecayingMotion
from bodycheck.reference_impl.closed_forms.piecewise_constant_loads import PiecewiseLoads
from bodycheck.reference_impl.free_rotation.initial_constants import unit
from bodycheck.reference_impl.free_rotation.principal_state import phase_sine_cosine
from bodycheck.reference_impl.free_rotation.tumbling_constants import FOUR_PI
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble, sine_and_cosine
from bodycheck.reference_impl.kernels.jit import exact_kernel
from bodycheck.reference_impl.kernels.small_vectors import Quat, Vec
from bodycheck.reference_impl.kernels.small_vectors import exact_quaternion_times as quaternion_times
from bodycheck.reference_impl.rational import (
    Vector,
    added,
    cross,
    dot,
    fractions,
    pair,
    rotation_of,
    start_omega,
    times,
    transposed,
    unit_quaternion,
)
from bodycheck.reference_impl.scene import Scene

_SERIES_BELOW = 0.5
_TERMS = 13  # 0.5^26 / 28! < 2^-123
_EVEN = tuple(pair(Fraction((-1) ** j, math.factorial(2 * j + 2))) for j in range(_TERMS + 1))
_ODD = tuple(pair(Fraction((-1) ** j, math.factorial(2 * j + 3))) for j in range(_TERMS + 1))


@exact_kernel
def _sine_means(z: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble]:
    """sin z / z, (1 - cos z) / z^2, (z - sin z) / z^2; error some 2^-100 of their largest values near z."""
    square = dd.multiply(z, z)
    if abs(z[0]) < _SERIES_BELOW:
        even, odd = _EVEN[_TERMS], _ODD[_TERMS]
        for j in range(_TERMS - 1, -1, -1):
            even = dd.add(_EVEN[j], dd.multiply(square, even))
            odd = dd.add(_ODD[j], dd.multiply(square, odd))
        return dd.subtract(dd.ONE, dd.multiply(square, odd)), even, dd.multiply(z, odd)
    sine, cosine = sine_and_cosine(z)
    return (
        dd.divide(sine, z),
        dd.divide(dd.subtract(dd.ONE, cosine), square),
        dd.divide(dd.subtract(z, sine), square),
    )


@exact_kernel
def swing(amplitude: DoubleDouble, rate: float, phase: float, t: float) -> tuple[DoubleDouble, DoubleDouble]:
    """theta = a t^2 (sin p (1 - cos z) / z^2 + cos p (z - sin z) / z^2) and w, with z = r t.

    w = a t (sin p sin z / z + cos p (1 - cos z) / z).
    """
    sine, cosine = sine_and_cosine((phase, 0.0))
    z = dd.two_product(rate, t)
    mean0, mean1, mean2 = _sine_means(z)
    gained = dd.multiply(amplitude, (t, 0.0))
    w = dd.add(dd.multiply(sine, mean0), dd.multiply(cosine, dd.multiply(z, mean1)))
    angle = dd.add(dd.multiply(sine, mean1), dd.multiply(cosine, mean2))
    return dd.multiply(dd.multiply(gained, (t, 0.0)), angle), dd.multiply(gained, w)


_MAX_RADIANS = 2.0**50  # in all: beyond it, 106 bits no longer resolve the angle to 4e-15


@exact_kernel
def _add_swings(swings: Array, t_s: Array, angle: tuple[Array, Array], rate: tuple[Array, Array]) -> None:
    """Add the contribution of the sine torques (k, 4) to angle (n,) and rate (n,), high and low parts."""
    for i in range(len(t_s)):
        theta, w = (angle[0][i], angle[1][i]), (rate[0][i], rate[1][i])
        for sine in swings:
            more, faster = swing((sine[0], sine[1]), sine[2], sine[3], t_s[i])
            theta, w = dd.add(theta, more), dd.add(w, faster)
        angle[0][i], angle[1][i] = theta
        rate[0][i], rate[1][i] = w


@exact_kernel
def _rotate(start: Quat, axis: Vec, angle: tuple[Array, Array], quaternion: Array) -> None:
    """Fill quaternion (n, 4) with start exp(axis angle / 2), angle (n,) in high and low parts."""
    for i in range(len(quaternion)):
        turns = dd.divide((angle[0][i], angle[1][i]), FOUR_PI)
        s, c = phase_sine_cosine(turns, dd.ONE, 0.0)
        q = unit(quaternion_times(start, (c, s * axis[0], s * axis[1], s * axis[2])))
        for j in range(4):
            quaternion[i, j] = q[j]


@dataclass(frozen=True, eq=False)
class FixedAxisRotation:
    """q(t) = q(0) exp(axis theta / 2), omega = axis w, with theta and w in double-double arithmetic."""

    _start: Quat
    _axis: Vec
    _motion: DecayingMotion
    _swings: Array
    """(k, 4): for each sine torque the angular acceleration (high and low part), rate and phase."""

    @classmethod
    def of(cls, scene: Scene, loads: PiecewiseLoads) -> FixedAxisRotation | None:
        """Set up the motion, or return None where omega, the torques and the drag share no principal axis.

        Also returns None for a body at rest whose torques cancel, which has no axis, and for sine torques
        together with drag, which other methods solve. Rational arithmetic decides all of this: an axis that
        is principal only up to rounding does not count.
        """
        if any(any(piece.arms) for piece in loads.pieces) or (loads.sines and any(loads.angular_drag)):
            return None
        inertia = fractions(scene.body.inertia)
        to_body = transposed(rotation_of(fractions(scene.initial.quaternion)))
        torques = [added(piece.torque_body, times(to_body, piece.torque_world)) for piece in loads.pieces]
        amplitudes = [
            fractions(sine.amplitude) if sine.axes == "body" else times(to_body, fractions(sine.amplitude))
            for sine in loads.sines
        ]
        omega = start_omega(scene.initial)
        axis = _principal_axis_of([omega, *torques, *amplitudes], inertia, loads.angular_drag)
        if axis is None:
            return None
        square = dot(axis, axis)
        moment = dot(axis, times(inertia, axis)) / square
        length = dd.square_root(pair(square))

        def about(vector: Vector) -> DoubleDouble:
            """Return the component along the axis."""
            return dd.divide(pair(dot(axis, vector)), length)

        def acceleration(torque: Vector) -> DoubleDouble:
            return about([component / moment for component in torque])

        pieces = [
            (piece.begin_s, [acceleration(torque)])
            for piece, torque in zip(loads.pieces, torques, strict=True)
        ]
        drag = dot(axis, times(loads.angular_drag, axis)) / square
        swings = [
            (*acceleration(amplitude), sine.rate, sine.phase)
            for sine, amplitude in zip(loads.sines, amplitudes, strict=True)
        ]
        w, x, y, z = (high for high, _ in unit_quaternion(scene.initial.quaternion))
        first, second, third = (dd.divide(pair(component), length)[0] for component in axis)
        return cls(
            (w, x, y, z),
            (first, second, third),
            DecayingMotion.of([dd.ZERO], [about(omega)], pieces, pair(drag / moment)),
            np.array(swings, dtype=np.float64).reshape(-1, 4),
        )

    @property
    def axis(self) -> Array:
        """The rotation axis (3,), a unit vector in body axes."""
        return np.array(self._axis)

    def angle(self, t_s: Array) -> Array:
        """Return theta (n,), rounded, in rad, at times t_s >= 0 (n,)."""
        return self._angles_and_rates(t_s)[0][0]

    def _angles_and_rates(self, t_s: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Return theta and w at times t_s (n,), each as high (n,) and low (n,) parts."""
        angles, rates = self._motion.at(t_s)
        angle = np.ascontiguousarray(angles[0][:, 0]), np.ascontiguousarray(angles[1][:, 0])
        rate = np.ascontiguousarray(rates[0][:, 0]), np.ascontiguousarray(rates[1][:, 0])
        _add_swings(self._swings, t_s, angle, rate)
        return angle, rate

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return (quaternion (n, 4), omega_body (n, 3)) at times t_s >= 0 (n,).

        Raises ValueError where the body has rotated by some 1e15 rad: 106 bits no longer resolve the angle.
        """
        angle, rate = self._angles_and_rates(t_s)
        phases = np.max(np.abs(self._swings[:, 2]), initial=0.0)
        path_angle = t_s * (self.largest_rate(t_s) + np.abs(rate[0]) + phases)
        for t in t_s[~(path_angle < _MAX_RADIANS)]:
            raise ValueError(f"the body rotates by more than {_MAX_RADIANS:.0e} rad by t = {float(t)!r} s")
        quaternion = np.empty((len(t_s), 4))
        _rotate(self._start, self._axis, angle, quaternion)
        return quaternion, rate[0][:, None] * np.array(self._axis)

    def largest_rate(self, t_s: Array) -> Array:
        """Bound |w| up to t (n,): the largest where a piece begins, plus a min(t, 2 / r) of each sine."""
        amplitude, _, rate, _ = np.abs(self._swings.T)[:, :, None]
        # for r = 0 the minimum is t
        with np.errstate(divide="ignore"):
            largest = amplitude * np.minimum(t_s, 2.0 / rate)
        return np.asarray(self._motion.largest_rate + np.sum(largest, axis=0))


def _principal_axis_of(vectors: list[Vector], inertia: Vector, drag: Vector) -> Vector | None:
    """Return the principal axis, also of the drag, that all vectors (3,) are parallel to, or None."""
    axis = next((vector for vector in vectors if any(vector)), None)
    if axis is None:
        return None
    along = (*vectors, times(inertia, axis), times(drag, axis))
    return None if any(any(cross(axis, vector)) for vector in along) else axis
