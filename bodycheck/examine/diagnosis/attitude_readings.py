"""Attitudes without omega: its derivation from them, and wrong readings, from the truth of the whole log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import EXACT
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, FittedFault
from bodycheck.examine.diagnosis.engine_model import ReportedStates
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.wrong_readings import WrongReading, wrong_readings
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum
from bodycheck.reference_impl.rotations import (
    conjugate,
    geodesic_angle,
    log_quaternion,
    normalised,
    quaternion_product,
    quaternion_to_matrix,
)

_HALF_WIDTHS = (2, 3, 4, 6, 8, 12, 16, 24, 32)  # samples on each side
_DEGREES = (4, 6)
_FEWEST = 3
_DECIMALS = 12
LARGEST_TURN_RAD = 2.5
"""The largest turn between attitudes that is used: beyond pi, rotation vectors are ambiguous."""


def turns_between(attitude: Array) -> Array:
    """Return the rotation vectors (n - 1, 3) from each unit quaternion to the next, in body axes."""
    return log_quaternion(quaternion_product(conjugate(attitude[:-1]), attitude[1:]))


def derived_rates(t_s: Array, attitude: Array, resolution_rad: float) -> tuple[Array, float] | None:
    """Return omega (n, 3) in body axes, rad/s, of attitudes (n, 4), and the spacing of its components.

    About sample k the rotation vectors log(q_k* q_j) are fitted by polynomials of the time; their slope at
    t_k is omega in body axes. A wider window leaves less of the rounding of the attitudes, and more of what
    the polynomial does not follow, which the difference of two degrees shows; the best window of both is
    taken. resolution_rad: the spacing of the attitudes. None for fewer than three samples.

    Source: Savitzky and Golay (1964), Analytical Chemistry 36, 1627.
    """
    n, q = len(t_s), normalised(attitude)
    if n < _FEWEST:
        return None
    best: tuple[Array, float] | None = None
    for half in _HALF_WIDTHS:
        width = min(2 * half + 1, n)
        first = np.clip(np.arange(n) - half, 0, n - width)
        window = first[:, None] + np.arange(width)
        turned = log_quaternion(quaternion_product(conjugate(q)[:, None], q[window]))
        if best is not None and np.max(np.linalg.norm(turned, axis=-1)) > LARGEST_TURN_RAD:
            break
        away_s = t_s[window] - t_s[:, None]
        low, high = (min(degree, width - 2 + index) for index, degree in enumerate(_DEGREES))
        weights = _slope_weights(away_s, low)
        coarser = np.einsum("nw,nwi->ni", weights, turned)
        finer = np.einsum("nw,nwi->ni", _slope_weights(away_s, high), turned)
        rounding = resolution_rad * np.linalg.norm(weights, axis=-1)
        missed = math.sqrt(12.0) * np.max(np.abs(finer - coarser), axis=-1)
        spacing = float(np.max(np.hypot(rounding, missed)))
        if best is None or spacing < best[1]:
            best = coarser, spacing
        if width == n:
            break
    return best


def _slope_weights(away_s: Array, degree: int) -> Array:
    """Return the weights (n, w) with which values at times (n, w) from 0 give their slope at 0."""
    scale = np.max(np.abs(away_s), axis=-1, keepdims=True)
    # where stamps are even, most windows are the same
    windows, which = np.unique(np.round(away_s / scale, _DECIMALS), axis=0, return_inverse=True)
    slopes = np.linalg.pinv(windows[..., None] ** np.arange(degree + 1))[:, 1]
    return np.asarray(slopes[which.ravel()] / scale)


_EXPLAINED = 0.95  # share of the error
_SAME = 3.0  # multiples of the resolution, or of the smallest error that a reading leaves


def _undone(one: WrongReading) -> Callable[[Array], Array]:
    none = np.zeros((3, 1))
    return lambda q: one.undo(ReportedStates(none, none, q.T, none), world_omega=False).q.T


_UNDONE: Mapping[str, Callable[[Array], Array]] = {
    **{one.name: _undone(one) for one in wrong_readings("q")},
    # a scalar-first quaternion whose columns are named as if the scalar were last
    "quaternion-order-when-set": lambda q: np.roll(q, -1, axis=-1),
}
"""Fault -> the attitude (n, 4) that was meant by one that is read with it."""


def attitude_diagnosis(read: Array, truth: Array, resolution_rad: float) -> Diagnosis | None:
    """Return the reading that brings attitudes (n, 4) to the true ones, or that they are the true ones.

    None where no reading does.
    """
    before = _error(read, truth)
    if before <= _SAME * resolution_rad:
        return Diagnosis("healthy", EXACT.name, "the exact flow, as far as the attitude alone shows it")
    after = {name: _error(undo(read), truth) for name, undo in _UNDONE.items()}
    least = min(after.values())
    if least > (1.0 - _EXPLAINED) * before:
        return None
    return _explained(before, after, _SAME * resolution_rad, resolution_rad)


def _explained(before: float, after: Mapping[str, float], small: float, resolution_rad: float) -> Diagnosis:
    """Return the diagnosis with the readings that leave least; small: what they leave if all is explained."""
    least = min(after.values())
    same = [name for name, error in after.items() if error <= max(small, _SAME * least)]
    named = [fault for fault in FAULTS if fault.name in same]
    first, *others = (FittedFault(one.name, one.kind, one.text(()), (), one.confirm) for one in named)
    return Diagnosis(
        "explained",
        EXACT.name,
        "the true attitude",
        (first,),
        1.0 - least / before,
        tuple(one.sentence for one in others),
        tuple((one.name,) for one in others),
        before=before,
        after=least,
        round_off=resolution_rad,
    )


def conserving_reading(t_s: Array, read: Array, inertia: Array, resolution_rad: float) -> Diagnosis | None:
    """Return the reading with which attitudes (n, 4) of a free body conserve its angular momentum.

    inertia: (3, 3) in body axes. None where the attitudes conserve it as they are read, and where no reading
    does so.
    """
    before, floor = _momentum_change(t_s, read, inertia, resolution_rad)
    if before <= _SAME * floor:
        return None
    after = {}
    for name, undo in _UNDONE.items():
        change, floor = _momentum_change(t_s, undo(read), inertia, resolution_rad)
        if change <= min(_SAME * floor, (1.0 - _EXPLAINED) * before):
            after[name] = change
    return _explained(before, after, 0.0, resolution_rad) if after else None


def _momentum_change(
    t_s: Array, attitude: Array, inertia: Array, resolution_rad: float
) -> tuple[float, float]:
    """Return max |L - L(0)| / |L(0)| in world axes, omega from the attitudes, and what it leaves open."""
    derived = derived_rates(t_s, attitude, resolution_rad)
    if derived is None:
        return 0.0, 0.0
    omega, spacing = derived
    momentum = angular_momentum(quaternion_to_matrix(normalised(attitude)), inertia, omega)
    size = float(np.linalg.norm(momentum[0]))
    if size == 0.0:
        return 0.0, 0.0
    floor = float(np.linalg.norm(inertia, 2)) * math.sqrt(3.0) * spacing / size + resolution_rad
    return float(np.max(np.linalg.norm(momentum - momentum[0], axis=-1))) / size, floor


def _error(attitude: Array, truth: Array) -> float:
    """Return the root mean square of the angle between attitudes (n, 4)."""
    return float(np.sqrt(np.mean(geodesic_angle(normalised(attitude), normalised(truth)) ** 2)))
