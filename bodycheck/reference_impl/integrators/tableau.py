"""The coefficients of an explicit Runge-Kutta method."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bodycheck.reference_impl.arrays import Array


class Tableau(NamedTuple):
    """k_i = f(t + c_i dt, y + dt sum a_ij k_j), y+ = y + dt sum b_i k_i."""

    a: Array
    """(s, s), strictly lower triangular."""
    b: Array
    """(s,)."""
    c: Array
    """(s,), the row sums of a."""

    def stability_function(self, z: complex) -> complex:
        """R(z) = 1 + z b (1 - z a)^-1 (1, ..., 1): a step of y' = lambda y with z = lambda dt is y+ = R(z) y.

        Hairer and Wanner (1996), Solving ODEs II, section IV.3.
        """
        slopes = np.linalg.solve(np.eye(len(self.b)) - z * self.a, np.ones(len(self.b)))
        return complex(1.0 + z * (self.b @ slopes))
