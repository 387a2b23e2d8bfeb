"""The weights of the defects of a whole log."""

from __future__ import annotations

import numpy as np
import pytest

from bodycheck.examine.diagnosis.whitening import Whitening
from bodycheck.reference_impl.arrays import Array

COUNT = 1000


def turned_and_stretched(growth: float) -> Array:
    """Return derivatives (1000, 6, 6) that turn and stretch errors of omega, and add them to others."""
    dice = np.random.default_rng(5)
    found = np.zeros((COUNT, 6, 6))
    for one in found:
        turns = [np.linalg.qr(dice.normal(size=(3, 3)))[0] for _ in range(3)]
        one[:3, :3], one[:3, 3:] = turns[:2]
        one[3:, 3:] = turns[2] @ np.diag([growth, 1.0, 1.0 / growth])
    return found


@pytest.mark.parametrize("growth", [3.0, 1e9, 1e300, np.inf])
def test_a_filter_stays_positive_whatever_a_map_makes_of_errors(growth: float) -> None:
    """Errors that 1,000 transitions stretch, and derivatives that are not finite, have finite weights."""
    spread, follows = np.repeat([8.66e-5, 2.08e-7], 3), np.arange(COUNT) > 0
    with np.errstate(invalid="ignore"):
        derivatives = turned_and_stretched(growth)
    found = Whitening.of(derivatives, spread, np.full(6, 1e-16), follows)
    assert np.isfinite(found.whitened(spread[:, None] * np.ones((1, 6, COUNT)))).all()
