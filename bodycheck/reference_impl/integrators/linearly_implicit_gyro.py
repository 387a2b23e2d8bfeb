"""Map M3: the gyroscopic term by a linearised implicit solve, the torque explicit."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.evaluated_loads import with_zero_order_hold
from bodycheck.reference_impl.integrators.facts import Integrator, exact_step_angle
from bodycheck.reference_impl.integrators.linearly_implicit import advance_linearised
from bodycheck.reference_impl.kernels.jit import kernel


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Advance the state by the steps, in place. omega is in body axes."""
    advance_linearised(state, body, load, dt, steps, False)


METHOD = Integrator(
    name="m3",
    formula="omega+ = omega - (I + dt D)^-1 dt omega x I omega + dt I^-1 tau, q+ = q exp(dt omega+ / 2)",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| to round-off",
    preserves=frozenset({"rotation group"}),
    source="measured to be the map of Bullet's btRigidBody",
    step_angle=exact_step_angle,
    position_weight=1.0,
    attitude="quaternion",
    spin="omega_body",
    advance=advance,
    advance_forced=with_zero_order_hold(advance, "omega_body"),
)
