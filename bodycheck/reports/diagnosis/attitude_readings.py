"""Wrong readings of an attitude, recognised without omega: by comparing the whole log with the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, geodesic_angle, normalised
from bodycheck.reports.diagnosis.diagnosis import Diagnosis, FittedFault
from bodycheck.reports.diagnosis.faults import FAULTS
from bodycheck.reports.diagnosis.flow import EXACT

_EXPLAINED = 0.95  # share of the error
_SAME = 3.0  # multiples of the resolution, or of the smallest error that a reading leaves

_UNDONE: Mapping[str, Callable[[Array], Array]] = {
    "quaternion-conjugated-when-read": conjugate,
    "quaternion-order-when-read": lambda q: np.roll(q, 1, axis=-1),
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
    same = [name for name, error in after.items() if error <= max(_SAME * resolution_rad, _SAME * least)]
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


def _error(attitude: Array, truth: Array) -> float:
    """Return the root mean square of the angle between attitudes (n, 4)."""
    return float(np.sqrt(np.mean(geodesic_angle(normalised(attitude), normalised(truth)) ** 2)))
