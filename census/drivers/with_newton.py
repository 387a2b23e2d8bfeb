"""Newton by itself, on the CPU."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp
from exact import SPIN, TOP, angle, of_quaternion, order, top

wp.config.quiet = True


def _run(
    solver: str, dt: float, time: float, omega: np.ndarray, moments: np.ndarray, **options: object
) -> tuple:
    """Return attitude (3, 3) and omega in world axes after a time."""
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_body(mass=1.0, inertia=[float(x) for x in np.diag(moments).ravel()], lock_inertia=True)
    model = builder.finalize(device="cpu", skip_validation_inertia=True)
    stepper = getattr(newton.solvers, solver)(model, **options)
    now, after = model.state(), model.state()
    for one in (now, after):
        one.body_q.assign(np.array([[0, 0, 0, 0, 0, 0, 1.0]]))
        one.body_qd.assign(np.concatenate([np.zeros(3), omega])[np.newaxis])
        newton.eval_ik(model, one, one.joint_q, one.joint_qd)
    for _ in range(round(time / dt)):
        stepper.step(now, after, None, None, dt)
        now, after = after, now
    x, y, z, w = (float(c) for c in now.body_q.numpy()[0][3:])
    return of_quaternion(w, x, y, z), np.array(now.body_qd.numpy()[0][3:], dtype=float)


_SPIN = np.array([0.0, 0.0, 1.0])


def damping() -> list[float]:
    """Omega after 1 s of a spin of 1 rad/s about a principal axis by SemiImplicit: its default, and 0."""
    return [
        float(_run("SolverSemiImplicit", 1e-2, 1.0, _SPIN, np.ones(3), **options)[1][2])
        for options in ({}, {"angular_damping": 0.0})
    ]


def unused_damping() -> list[float]:
    """The same by Featherstone with an angular_damping of 0.05, its default, and of 50."""
    return [
        float(_run("SolverFeatherstone", 1e-2, 1.0, _SPIN, np.ones(3), angular_damping=value)[1][2])
        for value in (0.05, 50.0)
    ]


def spin_up() -> list[float]:
    """Growth of the rate of a free ball per step, relative, at 2e-3 and 2e-4 s, by SemiImplicit; true: 0."""
    found = []
    for dt in (2e-3, 2e-4):
        _, omega = _run("SolverSemiImplicit", dt, 1000 * dt, 3.0 * _SPIN, np.ones(3), angular_damping=0.0)
        found.append((float(omega[2]) / 3.0 - 1.0) / 1000)
    return found


def rk4_order() -> list[float]:
    """Order of SolverMuJoCo's rk4 on a symmetric top, from 1e-1 to 5e-2 s, and its error at 5e-2 s."""
    errors = [
        angle(top(1.0), _run("SolverMuJoCo", dt, 1.0, SPIN, TOP, integrator="rk4")[0]) for dt in (1e-1, 5e-2)
    ]
    return [order(*errors), errors[1]]


def corrected_inertia() -> list[float]:
    """Moments that finalize holds of 1, 2, 5 kg m^2, which no body has, by default."""
    builder = newton.ModelBuilder()
    builder.add_body(mass=1.0, inertia=[1.0, 0, 0, 0, 2.0, 0, 0, 0, 5.0], lock_inertia=True)
    model = builder.finalize(device="cpu")
    return [float(x) for x in np.diag(model.body_inertia.numpy()[0])]


def mjcf_damping() -> list[float]:
    """Rate of a hinge of 1 kg m^2 with damping 0.5 N m s in MJCF after 1 s by Featherstone, and exp(-1/2)."""
    builder = newton.ModelBuilder(gravity=0.0)
    builder.add_mjcf(
        """<mujoco><worldbody><body><joint type="hinge" axis="0 1 0" damping="0.5"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    )
    model = builder.finalize(device="cpu")
    stepper, control = newton.solvers.SolverFeatherstone(model), model.control()
    now, after = model.state(), model.state()
    for one in (now, after):
        one.joint_qd.assign(np.ones(1))
        newton.eval_fk(model, one.joint_q, one.joint_qd, one)
    for _ in range(1000):
        stepper.step(now, after, control, None, 1e-3)
        now, after = after, now
    return [float(now.joint_qd.numpy()[0]), float(np.exp(-0.5))]


def spinning_centre() -> list[float]:
    """How far the centre of mass of a free body moves in 1 s by Featherstone; true: 0.

    The body turns at 1 rad/s about a principal axis, and its centre is at rest: 0.2 m off the origin of the
    body, which is that of the world; then at the origin of the body, 5 m off that of the world.
    """
    return [_moved_centre(0.2, 0.0), _moved_centre(0.0, 5.0)]


def _moved_centre(centre: float, origin: float) -> float:
    builder = newton.ModelBuilder(gravity=0.0)
    builder.add_body(mass=1.0, com=wp.vec3(centre, 0.0, 0.0), inertia=wp.mat33(np.eye(3)), lock_inertia=True)
    model = builder.finalize(device="cpu")
    stepper = newton.solvers.SolverFeatherstone(model)
    now, after = model.state(), model.state()
    for one in (now, after):
        one.body_q.assign(np.array([[origin, 0, 0, 0, 0, 0, 1.0]]))
        one.body_qd.assign(np.array([[0, 0, 0, 0, 0, 1.0]]))
        newton.eval_ik(model, one, one.joint_q, one.joint_qd)
    for _ in range(1000):
        stepper.step(now, after, None, None, 1e-3)
        now, after = after, now
    x, y, z, w = (float(c) for c in now.body_q.numpy()[0][3:])
    place = np.array(now.body_q.numpy()[0][:3], dtype=float) + of_quaternion(w, x, y, z) @ [centre, 0.0, 0.0]
    return float(np.linalg.norm(place - [origin + centre, 0.0, 0.0]))
