"""MJX by itself, in float64 on the CPU."""

from __future__ import annotations

import jax
import mujoco
from exact import SPIN, TOP, angle, of_quaternion, order, top
from mujoco import mjx

_BODY = """<mujoco><option timestep="{dt}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
<body name="b"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="{moments}"/>
</body></worldbody></mujoco>"""


def _error(integrator: str, dt: float) -> float:
    """Return the error of the free symmetric top after 1 s."""
    jax.config.update("jax_enable_x64", True)
    text = _BODY.format(dt=dt, integrator=integrator, moments=" ".join(map(str, TOP)))
    model = mujoco.MjModel.from_xml_string(text)
    state = mujoco.MjData(model)
    state.qvel[3:] = SPIN
    device = mjx.put_model(model)
    steps = round(1.0 / dt)
    run = jax.jit(lambda data: jax.lax.fori_loop(0, steps, lambda _, one: mjx.step(device, one), data))
    found = run(mjx.put_data(model, state))
    return angle(top(1.0), of_quaternion(*map(float, found.qpos[3:])))


def rk4_order() -> list[float]:
    """Order of RK4 on a symmetric top, from 2e-2 to 1e-2 s, and its error at 1e-2 s."""
    errors = [_error("RK4", dt) for dt in (2e-2, 1e-2)]
    return [order(*errors), errors[1]]


def implicitfast() -> list[float]:
    """Error at 1e-2 s of Euler and of implicitfast."""
    return [_error(name, 1e-2) for name in ("Euler", "implicitfast")]
