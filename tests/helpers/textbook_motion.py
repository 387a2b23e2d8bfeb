"""The equations of motion with R and L in world axes, as textbooks have them, solved by SciPy."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.magnetic_dipole import MagneticDipole
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
    TorsionSpring,
)

WrenchAt: TypeAlias = Callable[[float, Array, Array, Array, Array], tuple[Array, Array]]
"""(t, x, R, v, omega) -> force and torque (3,) about the centre of mass; all in world axes."""


def solved_end(body: RigidBody, start: State, wrench: WrenchAt, duration_s: float) -> State:
    """x' = v, m v' = F, R' = [omega]x R, L' = tau, by DOP853 at a relative tolerance of 1e-13."""
    inverse = np.linalg.inv(body.inertia)

    def rates(t: float, y: Array) -> Array:
        x, v, momentum, rotation = y[:3], y[3:6], y[6:9], y[9:].reshape(3, 3)
        omega = rotation @ inverse @ rotation.T @ momentum
        force, torque = wrench(t, x, rotation, v, omega)
        return np.concatenate([v, force / body.mass, torque, np.cross(omega, rotation.T).T.ravel()])

    rotation = Rotation.from_quat(start.quaternion, scalar_first=True).as_matrix()
    momentum = rotation @ body.inertia @ start.omega_body
    y0 = np.concatenate([start.position, start.velocity, momentum, rotation.ravel()])
    y = solve_ivp(rates, (0.0, duration_s), y0, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    turn = Rotation.from_matrix(y[9:].reshape(3, 3))
    omega_body = inverse @ turn.apply(y[6:9], inverse=True)
    return State(y[:3], turn.as_quat(scalar_first=True), y[3:6], omega_body)


def wrench_at(scene: Scene, t: float, x: Array, r: Array, v: Array, omega: Array) -> tuple[Array, Array]:
    """Return the sum of the loads of a scene and the weight, as `WrenchAt`."""
    force, torque = scene.body.mass * scene.gravity, np.zeros(3)
    for load in scene.loads:
        match load:
            case Torque():
                torque = torque + (r @ load.value if load.axes == "body" else load.value)
            case PointForce():
                push = r @ load.value if load.axes == "body" else load.value
                force, torque = force + push, torque + np.cross(r @ load.at, push)
            case SineTorque():
                value = load.amplitude * np.sin(load.rate * t + load.phase)
                torque = torque + (r @ value if load.axes == "body" else value)
            case Drag():
                force, torque = force - load.linear * v, torque - r @ (load.angular @ r.T @ omega)
            case Spring():
                d = x + r @ load.at - load.anchor
                length = float(np.linalg.norm(d))
                pull = -load.stiffness * (length - load.rest_length) / length * d
                force, torque = force + pull, torque + np.cross(r @ load.at, pull)
            case TorsionSpring():
                turn = Rotation.from_matrix(r @ scene.initial.rotation.T).as_rotvec()
                torque = torque - load.stiffness * turn
            case GravityGradient():
                u = np.array([-np.sin(load.rate * t), 0.0, -np.cos(load.rate * t)])
                torque = torque + 3.0 * load.rate**2 * np.cross(u, r @ scene.body.inertia @ r.T @ u)
            case MagneticDipole():
                torque = torque + np.cross(r @ load.moment, load.field)
            case CallbackLoad():
                push, turn = load.function(t, x, r, v, omega)
                force, torque = force + push, torque + turn
            case _:
                raise NotImplementedError(f"wrench_at has no formula of {load.kind}")
    return force, torque
