"""Map M2: the gyroscopic term and the torque in one linearised implicit solve, then the pose."""

from __future__ import annotations

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.integrators.held import held_over_steps
from bodycheck.reference_impl.integrators.linearised import advance_linearised
from bodycheck.reference_impl.jit import kernel


@kernel
def advance(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
    """Make the steps in place, omega in body axes."""
    advance_linearised(state, body, load, dt, steps, True)


M2 = Integrator(
    name="m2",
    formula="omega+ = omega + (I + dt D)^-1 dt (tau - omega x I omega), q+ = q exp(dt omega+ / 2)",
    order=1,
    evaluations=1,
    torque="held over the step",
    keeps="|q| to round-off",
    source="measured to be the map of MuJoCo implicit, implicitfast, discrete; D = [omega]x I - [I omega]x",
    attitude="quaternion",
    spin="omega_body",
    advance=advance,
    advance_under=held_over_steps(advance, "omega_body"),
)
