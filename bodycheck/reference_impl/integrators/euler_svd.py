"""Forward Euler on the rotation matrix, projected onto SO(3) by an SVD after every step."""

from __future__ import annotations

import math

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.euler import step
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import Mat, Vec, dot, matrix_at

_EPS = 2.0**-52
_MAX_SWEEPS = 30  # three or four suffice; more are needed only if the state is not finite


@kernel
def _rotated(a: Vec, b: Vec, c: float, s: float) -> tuple[Vec, Vec]:
    """c a - s b and s a + c b."""
    return (
        (c * a[0] - s * b[0], c * a[1] - s * b[1], c * a[2] - s * b[2]),
        (s * a[0] + c * b[0], s * a[1] + c * b[1], s * a[2] + c * b[2]),
    )


@kernel
def _made_orthogonal(a: Vec, b: Vec, v: Vec, w: Vec) -> tuple[Vec, Vec, Vec, Vec, bool]:
    """Rotate the columns a, b, and v, w with them, so that a . b = 0; True if that already holds."""
    aa, bb, ab = dot(a, a), dot(b, b), dot(a, b)
    if abs(ab) <= _EPS * math.sqrt(aa * bb):
        return a, b, v, w, True
    ratio = (bb - aa) / (2.0 * ab)
    tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
    c = 1.0 / math.sqrt(1.0 + tangent * tangent)
    a, b = _rotated(a, b, c, c * tangent)
    v, w = _rotated(v, w, c, c * tangent)
    return a, b, v, w, False


@kernel
def nearest_rotation(m: Mat) -> Mat:
    """U V^T of the SVD m = U S V^T, for det m > 0, by one-sided Jacobi rotations (Hestenes 1958)."""
    a, b, c = (m[0], m[3], m[6]), (m[1], m[4], m[7]), (m[2], m[5], m[8])
    u, v, w = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    for _ in range(_MAX_SWEEPS):
        a, b, u, v, done_ab = _made_orthogonal(a, b, u, v)
        a, c, u, w, done_ac = _made_orthogonal(a, c, u, w)
        b, c, v, w, done_bc = _made_orthogonal(b, c, v, w)
        if done_ab and done_ac and done_bc:
            break
    p, q, r = 1.0 / math.sqrt(dot(a, a)), 1.0 / math.sqrt(dot(b, b)), 1.0 / math.sqrt(dot(c, c))
    return (
        p * a[0] * u[0] + q * b[0] * v[0] + r * c[0] * w[0],
        p * a[0] * u[1] + q * b[0] * v[1] + r * c[0] * w[1],
        p * a[0] * u[2] + q * b[0] * v[2] + r * c[0] * w[2],
        p * a[1] * u[0] + q * b[1] * v[0] + r * c[1] * w[0],
        p * a[1] * u[1] + q * b[1] * v[1] + r * c[1] * w[1],
        p * a[1] * u[2] + q * b[1] * v[2] + r * c[1] * w[2],
        p * a[2] * u[0] + q * b[2] * v[0] + r * c[2] * w[0],
        p * a[2] * u[1] + q * b[2] * v[1] + r * c[2] * w[1],
        p * a[2] * u[2] + q * b[2] * v[2] + r * c[2] * w[2],
    )


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place; each ends with R = U V^T of the SVD U S V^T.

    state (18,), body (19,) and load (21,) as for euler.step. det U V^T = +1 needs no correction:
    det (I + dt [omega]x) = 1 + dt^2 omega^2 > 0.
    """
    for _ in range(steps):
        step(state, body, load, dt)
        rotation = nearest_rotation(matrix_at(state, 9))
        for i in range(9):
            state[9 + i] = rotation[i]


METHOD = Integrator(
    name="euler-svd",
    formula="R+ = the rotation nearest to R + dt [omega]x R, L+ = L + dt tau",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="L exactly where no torque acts; orthogonality of R",
    preserves=frozenset({"angular momentum", "rotation group"}),
    source="Baraff and Witkin (1997), part 1; projection: Higham (1986)",
    step_angle=math.atan,
    position_weight=0.0,
    attitude="matrix",
    spin="angular_momentum",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "angular_momentum"),
)
