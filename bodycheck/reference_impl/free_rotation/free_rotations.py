"""The torque-free rotation of bodies: set up once, evaluated at any time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation.classification import (
    ExactState,
    is_certainly_tumbling,
    separation_of,
)
from bodycheck.reference_impl.free_rotation.constants_row import (
    HORIZON,
    QUARTER_PERIOD,
    WIDTH,
    Steady,
    Tumbling,
    is_steady,
    put_tumbling,
    steady_in,
    tumbling_in,
)
from bodycheck.reference_impl.free_rotation.initial_constants import (
    estimate_separations,
    frame_of,
    placed,
    set_up_steady,
    set_up_tumbling,
    unit,
)
from bodycheck.reference_impl.free_rotation.principal_state import phase_sine_cosine, state_at
from bodycheck.reference_impl.free_rotation.tensor_axes import PrincipalAxes
from bodycheck.reference_impl.free_rotation.tumbling_constants import numbered, tumbling_constants
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
        s, c = phase_sine_cosine(motion.turn_rate, (frequency * high[i], frequency * low[i]), 0.0)
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


_SYMMETRY_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class FreeRotations:
    """I omega' = (I omega) x omega, q' = q omega / 2: q(t) and omega(t) of m bodies, without stepping."""

    _rows: Array
    """(m, WIDTH)."""

    @classmethod
    def from_states(cls, inertia: ArrayLike, quaternion: ArrayLike, omega_body: ArrayLike) -> FreeRotations:
        """Set up the motions through states at t = 0.

        inertia (m, 3, 3): about the centre of mass, in body axes, kg m^2; any positive multiple gives the
        same motion. quaternion (m, 4): scalar first, body to world, of any non-zero norm. omega_body (m, 3):
        body axes, rad/s; components below 1e-288 of the largest are taken as zero. All other numbers are
        taken as exact.

        Raises ValueError for other shapes, NaN, infinities, a zero quaternion, and an inertia that is not
        positive definite or not symmetric to 1e-12 of its largest element (its symmetric part is used).
        """
        tensors = np.asarray(inertia, dtype=np.float64)
        m = len(tensors) if tensors.ndim else 0
        tensors = _checked("inertia", tensors, (m, 3, 3))
        attitudes = _checked("quaternion", quaternion, (m, 4))
        omegas = _checked("omega_body", omega_body, (m, 3))
        return cls.from_checked(tensors, attitudes, omegas, np.zeros((m, 3)))

    @classmethod
    def from_checked(
        cls, inertia: Array, quaternion: Array, omega: Array, rest: Array, *, approximate: bool = False
    ) -> FreeRotations:
        """Set up the motions from arrays already checked for shape and finiteness.

        inertia (m, 3, 3), quaternion (m, 4), omega (m, 3); rest (m, 3): the low part of omega. approximate:
        let floating point determine the distance from the separatrix wherever it resolves it to 2^-40,
        without exact integers. That is several times faster near the separatrix; the errors are then up to
        1e-12.
        """
        if not quaternion.any(axis=1).all():
            raise ValueError(f"quaternion must not be zero, got {[0.0] * 4}")
        tensors = _symmetric(inertia).reshape(-1, 9)
        m = len(tensors)
        rows, undecided = np.empty((m, WIDTH)), np.empty(m, dtype=np.bool_)
        separations = np.zeros((m, 4))
        if approximate:
            estimate_separations(tensors, omega, rest, separations)
        set_up_tumbling(tensors, quaternion, omega, rest, separations, rows, undecided)
        for k in np.flatnonzero(undecided):
            state = ExactState.of(tensors[k], omega[k], rest[k])
            if not state.is_positive_definite:
                raise ValueError(f"inertia must be positive definite, got {inertia[k].tolist()}")
            if state.is_steady:
                set_up_steady(quaternion[k], omega[k], rest[k], rows[k])
            else:
                one, (descending, size, exponent) = slice(k, k + 1), state.separation
                separations[k] = -1.0 if descending else 1.0, *size, exponent
                set_up_tumbling(
                    tensors[one],
                    quaternion[one],
                    omega[one],
                    rest[one],
                    separations[one],
                    rows[one],
                    undecided[one],
                )
        return cls(rows)

    @property
    def quarter_period_s(self) -> Array:
        """K / lambda (m,) in s, where 4 K / lambda is the period of omega_body.

        Infinite if the motion is steady or on the separatrix.
        """
        return self._rows[:, QUARTER_PERIOD].copy()

    def at(self, t_s: ArrayLike) -> tuple[Array, Array]:
        """Return (quaternion (m, n, 4), omega_body (m, n, 3)) at the times t_s (n,).

        Times may be negative and in any order. The unit quaternions are scalar first, map body to world and
        are continuous in t; omega is in body axes, in rad/s.
        The error of the attitude is below 4e-15 rad, that of omega below 4e-15 of its size.

        Raises ValueError for another shape, NaN or infinite times, and times more than some 1e16 rad away,
        where 106 bits no longer suffice for that accuracy.
        """
        t = np.asarray(t_s, dtype=np.float64, order="C")
        if t.ndim != 1:
            raise ValueError(f"t_s must have shape (n,), got {t.shape}")
        return self.at_pairs(t, np.zeros(len(t)))

    def at_pairs(self, high: Array, low: Array) -> tuple[Array, Array]:
        """Return the same at times that are sums of two doubles, high and low (n,)."""
        horizon = float(np.min(self._rows[:, HORIZON], initial=math.inf))
        within = np.abs(high) < horizon
        if not within.all():
            first = float(high[~within][0])
            limit = f"within {horizon:.1e} s" if math.isfinite(first) else "finite"
            raise ValueError(f"t_s must be {limit}, got {first}")
        m, n = len(self._rows), len(high)
        quaternion, omega = np.empty((m, n, 4)), np.empty((m, n, 3))
        evaluate(self._rows, high, low, quaternion, omega)
        return quaternion, omega


@dataclass(frozen=True, eq=False)
class FreeRotation:
    """q(t) and omega(t) of one body: `FreeRotations`, without the first axis of each array."""

    _alone: FreeRotations

    @classmethod
    def from_state(cls, inertia: ArrayLike, quaternion: ArrayLike, omega_body: ArrayLike) -> FreeRotation:
        """Set up the motion through a state at t = 0: inertia (3, 3), quaternion (4,), omega_body (3,)."""
        return cls.from_pairs(inertia, quaternion, omega_body, np.zeros(3))

    @classmethod
    def from_pairs(
        cls, inertia: ArrayLike, quaternion: ArrayLike, high: ArrayLike, low: ArrayLike
    ) -> FreeRotation:
        """Set up the motion as `from_state`, with omega_body = high + low, (3,) each."""
        tensor = _checked("inertia", inertia, (3, 3))
        attitude = _checked("quaternion", quaternion, (4,))
        omega, rest = _checked("omega_body", high, (3,)), _checked("omega_body", low, (3,))
        return cls(FreeRotations.from_checked(tensor[None], attitude[None], omega[None], rest[None]))

    @property
    def quarter_period_s(self) -> float:
        """K / lambda in s, where 4 K / lambda is the period of omega_body.

        Infinite if the motion is steady or on the separatrix.
        """
        return float(self._alone.quarter_period_s[0])

    def at(self, t_s: ArrayLike) -> tuple[Array, Array]:
        """Return (quaternion (n, 4), omega_body (n, 3)) at the times t_s (n,)."""
        quaternion, omega = self._alone.at(t_s)
        return quaternion[0], omega[0]

    def at_pairs(self, high: Array, low: Array) -> tuple[Array, Array]:
        """Return the same at times that are sums of two doubles, high and low (n,)."""
        quaternion, omega = self._alone.at_pairs(high, low)
        return quaternion[0], omega[0]


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.asarray(value, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"{name} must be finite, got {array[tuple(where)]} at {where}")
    return array


def _symmetric(tensors: Array) -> Array:
    """(A + A^T) / 2 of each (m, 3, 3)."""
    transpose = tensors.transpose(0, 2, 1)
    if (tensors == transpose).all():
        return tensors
    gap, size = np.abs(tensors - transpose).max(axis=(1, 2)), np.abs(tensors).max(axis=(1, 2))
    skew = gap > _SYMMETRY_TOLERANCE * size
    if skew.any():
        raise ValueError(f"inertia must be symmetric, got {tensors[skew][0].tolist()}")
    return 0.5 * tensors + 0.5 * transpose


_INERTIA, _OMEGA, _QUATERNION = (
    np.diag([1.0, 2.0, 3.0]).ravel(),
    np.array([0.1, 2.0, 0.1]),
    np.array([1.0, 0.0, 0.0, 0.0]),
)


def compile_frame_and_evaluation() -> None:
    """Compile the kernels from a tensor to its principal frame, and from a row to the motion at times."""
    frame_of(_INERTIA, _OMEGA, np.zeros(3))
    nothing = np.zeros(0)
    evaluate(np.zeros((0, WIDTH)), nothing, nothing, np.zeros((0, 0, 4)), np.zeros((0, 0, 3)))


def compile_tumbling() -> None:
    """Compile the kernels from the principal frame to a row."""
    frame = PrincipalAxes(
        moments=((1.0, 0.0), (2.0, 0.0), (3.0, 0.0)),
        gaps=((1.0, 0.0), (2.0, 0.0), (1.0, 0.0)),
        omega=((0.1, 0.0), (2.0, 0.0), (0.1, 0.0)),
        axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    )
    axes = numbered(frame, False)
    is_certainly_tumbling(axes)
    _, separation = separation_of(axes)
    axes = numbered(frame, separation.descending)
    put_tumbling(np.empty(WIDTH), placed(tumbling_constants(axes, separation), axes, _OMEGA, _QUATERNION))
