"""Forward Euler on the rotation matrix, taken back to SO(3) by the SVD after every step."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.euler import step
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.jit import kernel


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Make the steps in place; each ends with R = U V^T of the SVD U S V^T.

    det U V^T = +1 needs no repair here: det (I + dt [omega]x) = 1 + dt^2 omega^2 > 0.
    """
    for _ in range(steps):
        step(state, body, load, dt)
        if not np.all(np.isfinite(state[9:18])):
            return  # no SVD has an answer for it, and the state tells by itself
        u, _, vt = np.linalg.svd(state[9:18].copy().reshape(3, 3))
        state[9:18] = (u @ vt).ravel()


EULER_SVD = Integrator(
    name="euler-svd",
    formula="R+ = the rotation nearest to R + dt [omega]x R, L+ = L + dt tau",
    order=1,
    evaluations=1,
    torque="held over the step",
    keeps="L exactly where no torque acts; orthogonality of R",
    source="Baraff and Witkin (1997), part 1; projection: Higham (1986)",
    attitude="matrix",
    spin="angular_momentum",
    advance=advance,
)
