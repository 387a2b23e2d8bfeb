"""Forward Euler on the rotation matrix, taken back to SO(3) by the SVD after every step."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.equations import vector_at
from bodycheck.reference_impl.integrators.euler import step
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.registers import cross


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Make the steps in place; each ends with R = U diag(1, 1, det(U V^T)) V^T."""
    for _ in range(steps):
        step(state, body, load, dt)
        u, _, vt = np.linalg.svd(state[9:18].copy().reshape(3, 3))
        nearest = (u @ vt).ravel()
        normal = cross(vector_at(nearest, 0), vector_at(nearest, 3))
        if normal[0] * nearest[6] + normal[1] * nearest[7] + normal[2] * nearest[8] < 0.0:
            u[:, 2] *= -1.0
            nearest = (u @ vt).ravel()
        state[9:18] = nearest


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
