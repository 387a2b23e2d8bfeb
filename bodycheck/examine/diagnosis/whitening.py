"""Weigh the defects of a whole log with the resolution of its numbers.

A recorded state is off the true one by e(k), of the size of the resolution. With the recorded states as the
nodes of multiple shooting, e(k + 1) = A(k) e(k) - d(k) + w(k), where d(k) is what a candidate misses from
row k to row k + 1, A(k) the derivative of its map and w(k) the round-off of the program. The innovations of
a Kalman filter of e, over their standard deviations, have size 1 where the candidate is right, and their
sum of squares is the minimum over all states that could have been recorded: rounding to the nearest number
leaves at most sqrt(3). A defect far below the resolution shows as soon as it has moved the log beyond it.

Source: Kailath, Sayed and Hassibi (2000), Linear Estimation, chapter 9; Bock (1981).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array

_GROWN = 1e8  # of the variance of a state relative to that of a row: the filter then begins again
_STEEPEST = 1e5  # of a derivative, in units of the spreads: doubles hold the sum with the variance of a row


@dataclass(frozen=True, eq=False)
class Whitening:
    """The gains of the filter over s transitions: derivative, 1 - gain and inverse root, each (s, n, n).

    begins: (s,) whether a transition does not follow the one before it.
    """

    derivatives: Array
    kept: Array
    inverse_roots: Array
    begins: Array

    @classmethod
    def of(cls, derivatives: Array, spread: Array, noise: Array, follows: Array) -> Whitening:
        """Return the filter.

        derivatives: (s, n, n) of each state after a transition with respect to the one before. spread, noise:
        (n,) standard deviations of a recorded state, and of the round-off of a transition. follows: (s,)
        whether a transition starts where the one before it ends.
        """
        count, size = derivatives.shape[:2]
        kept, roots = np.empty((2, count, size, size))
        begins = np.empty(count, dtype=bool)
        steepest = _STEEPEST * np.outer(spread, 1.0 / spread)
        derivatives = np.clip(np.nan_to_num(derivatives), -steepest, steepest)
        recorded, added, unit = np.diag(spread**2), np.diag(noise**2), np.eye(size)
        variance, scale = recorded, 1.0 / spread
        for k, derivative in enumerate(derivatives):
            grown = np.max(np.diag(variance) * scale**2) > _GROWN
            begins[k] = not follows[k] or grown
            if begins[k]:
                variance = recorded
            predicted = derivative @ variance @ derivative.T + added
            total = predicted + recorded
            inverse = np.linalg.inv(scale[:, None] * total * scale) * np.outer(scale, scale)
            gain = predicted @ inverse
            kept[k] = unit - gain
            variance = kept[k] @ predicted @ kept[k].T + gain @ recorded @ gain.T
            variance = 0.5 * (variance + variance.T)  # an asymmetric part of round-off would grow
            roots[k] = np.linalg.inv(np.linalg.cholesky(scale[:, None] * total * scale)) * scale
        return cls(derivatives, kept, roots, begins)

    def whitened(self, defects: Array) -> Array:
        """Return the innovations of defects (c, n, s) over their standard deviations, (c, n, s)."""
        found = np.empty_like(defects)
        off = np.zeros((defects.shape[1], defects.shape[0]))
        for k, begins in enumerate(self.begins):
            predicted = -defects[:, :, k].T
            if not begins:
                predicted = predicted + self.derivatives[k] @ off
            found[:, :, k] = -(self.inverse_roots[k] @ predicted).T
            off = self.kept[k] @ predicted
        return found
