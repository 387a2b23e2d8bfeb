"""The explicit midpoint rule for the quaternion, not normalised, and Euler's equations."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.integrators.facts import Tableau
from bodycheck.reference_impl.integrators.runge_kutta import runge_kutta

METHOD = runge_kutta(
    name="midpoint",
    formula="y+ = y + dt f(y + dt/2 f(y)), y = (x, v, omega, q)",
    order=2,
    tableau=Tableau(a=np.array([[0.0, 0.0], [0.5, 0.0]]), b=np.array([0.0, 1.0]), c=np.array([0.0, 0.5])),
    conserves="nothing exactly; |q| to order 3",
    source="Runge (1895); Hairer, Norsett and Wanner (1993), Solving ODEs I, section II.1",
)
