"""SAPIEN by itself."""

from __future__ import annotations

import numpy as np
import sapien
from sapien import physx


def _free(moments: np.ndarray, omega: np.ndarray, dt: float, *, fair: bool) -> tuple:
    settings = physx.PhysxSceneConfig()
    settings.gravity = np.zeros(3)
    physx.set_scene_config(settings)
    system = physx.PhysxCpuSystem()
    system.timestep = dt
    scene, entity = sapien.Scene([system]), sapien.Entity()
    body = physx.PhysxRigidDynamicComponent()
    body.mass, body.inertia = 1.0, moments
    if fair:
        body.linear_damping = body.angular_damping = body.sleep_threshold = 0.0
        body.max_angular_velocity = 1e6
    entity.add_component(body)
    scene.add_entity(entity)
    body.angular_velocity = omega
    return system, scene, entity, body


def _spin(omega: float, steps: int, dt: float, *, fair: bool = False) -> float:
    system, _scene, _entity, body = _free(np.ones(3), np.array([0.0, 0.0, omega]), dt, fair=fair)
    for _ in range(steps):
        system.step()
    return float(body.angular_velocity[2])


def damping() -> list[float]:
    """Omega after 1 s of a spin of 1 rad/s about a principal axis, without loads."""
    return [_spin(1.0, 1000, 1e-3)]


def clamp() -> list[float]:
    """Omega after one step of 1e-6 s of a spin of 150 rad/s about a principal axis."""
    return [_spin(150.0, 1, 1e-6)]


def spin_up() -> list[float]:
    """Growth of the rate of a free ball per step, relative, at 2e-3 and 2e-4 s; true: 0."""
    return [(_spin(3.0, 1000, dt, fair=True) / 3.0 - 1.0) / 1000 for dt in (2e-3, 2e-4)]
