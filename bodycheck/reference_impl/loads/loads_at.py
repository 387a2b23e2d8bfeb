"""What a load does at one moment: its force and its torque about the centre of mass, in world axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import log_matrix
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    Load,
    PointForce,
    Scene,
    SineTorque,
    Spring,
    Torque,
    TorsionSpring,
    Wrenching,
    unknown_load,
)


@dataclass(frozen=True, eq=False)
class Instants:
    """Moments of a motion: t (...), rotation (..., 3, 3) body to world; the rest (..., 3) in world axes."""

    t: Array
    position: Array
    rotation: Array
    velocity: Array
    omega: Array

    def turned(self, vector: Array) -> Array:
        """R v (..., 3)."""
        return self.rotation @ vector


def wrench_at(load: Load, scene: Scene, moment: Instants) -> tuple[Array, Array]:
    """Return force and torque (..., 3) about the centre of mass, in N and N m, world axes.

    A load that comes and goes is taken as acting. The formulas are those of the loads' docstrings.
    """
    none = np.zeros_like(moment.omega)
    match load:
        case Torque():
            return none, _in_world(load.axes, load.value, moment)
        case PointForce():
            force = _in_world(load.axes, load.value, moment)
            return force, np.cross(moment.turned(load.at), force)
        case SineTorque():
            swing = np.sin(load.rate * moment.t + load.phase)[..., None]
            return none, swing * _in_world(load.axes, load.amplitude, moment)
        case Drag():
            turned = moment.rotation @ load.angular @ np.swapaxes(moment.rotation, -1, -2)
            return -load.linear * moment.velocity, -_product(turned, moment.omega)
        case Spring():
            arm = moment.turned(load.at)
            stretch = moment.position + arm - load.anchor
            length = np.linalg.norm(stretch, axis=-1, keepdims=True)
            shortfall = np.divide(load.rest_length, length, out=np.ones_like(length), where=length > 0.0)
            force = -load.stiffness * (1.0 - shortfall) * stretch
            return force, np.cross(arm, force)
        case TorsionSpring():
            turned = moment.rotation @ scene.initial.rotation.T
            return none, -load.stiffness * log_matrix(turned)
        case GravityGradient():
            angle = load.rate * moment.t
            u = np.stack([-np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
            inertia = moment.rotation @ scene.body.inertia @ np.swapaxes(moment.rotation, -1, -2)
            return none, 3.0 * load.rate**2 * np.cross(u, _product(inertia, u))
        case CallbackLoad():
            return _asked(load.function, moment)
        case _:
            raise unknown_load(load, "the sum of forces and torques")


def _in_world(axes: str, value: Array, moment: Instants) -> Array:
    return moment.turned(value) if axes == "body" else np.broadcast_to(value, moment.omega.shape)


def _product(matrix: Array, vector: Array) -> Array:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _asked(function: Wrenching, moment: Instants) -> tuple[Array, Array]:
    parts = (moment.position, moment.rotation, moment.velocity, moment.omega)
    if moment.omega.ndim == 1:
        force, torque = function(float(moment.t), *parts)
        return np.asarray(force, dtype=np.float64), np.asarray(torque, dtype=np.float64)
    answers = [function(float(t), *part) for t, *part in zip(moment.t, *parts, strict=True)]
    force, torque = (np.array([answer[i] for answer in answers], dtype=np.float64) for i in (0, 1))
    return force, torque


def sum_of_wrenches(loads: Sequence[Load], scene: Scene) -> Wrenching:
    """Return the sum of these loads and the weight as one function of the motion."""

    def wrench(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        moment = Instants(np.array(t), position, rotation, velocity, omega)
        force, torque = scene.body.mass * scene.gravity, np.zeros(3)
        for load in loads:
            push, turn = wrench_at(load, scene, moment)
            force, torque = force + push, torque + turn
        return force, torque

    return wrench


def lasting_wrench_of(scene: Scene) -> Wrenching:
    """Return the sum of the scene's lasting loads as one function of the motion, those of functions too.

    Force and torque are NaN where the motion is not finite: no function is asked about that.
    """
    wrench = sum_of_wrenches(scene.lasting_loads, replace(scene, gravity=np.zeros(3)))

    def lasting(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        if not np.isfinite([*position, *rotation.flat, *velocity, *omega]).all():
            return np.full(3, np.nan), np.full(3, np.nan)
        return wrench(t, position, rotation, velocity, omega)

    return lasting
