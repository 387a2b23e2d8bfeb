"""Rapier's wheel by itself."""

from __future__ import annotations

import numpy as np
import rapier3d as r


def _free(moments: np.ndarray, omega: np.ndarray, velocity: np.ndarray, dt: float, *, fair: bool) -> tuple:
    world = r.PhysicsWorld(gravity=r.Vec3(0.0, 0.0, 0.0))
    world.integration_parameters.dt = dt
    solid = r.MassProperties(
        r.Vec3(0.0, 0.0, 0.0), 1.0, r.Vec3(*map(float, moments)), r.Rotation3(1.0, 0.0, 0.0, 0.0)
    )
    built = r.RigidBody.dynamic().additional_mass_properties(solid)
    if fair:
        built = built.can_sleep(False).gyroscopic_forces(True).allow_fast_rotation(True)
    body = world.rigid_bodies[world.add_body(built)]
    body.recompute_mass_properties_from_colliders(world.colliders)
    body.angvel = r.Vec3(*map(float, omega))
    body.linvel = r.Vec3(*map(float, velocity))
    return world, body


def angular_cap() -> list[float]:
    """Omega after two steps of 1e-2 s of a spin of 400 rad/s about a principal axis; pi / 4 / dt is 78.54."""
    world, body = _free(np.ones(3), np.array([0.0, 0.0, 400.0]), np.zeros(3), 1e-2, fair=False)
    for _ in range(2):
        world.step()
    return [float(body.angvel.to_tuple()[2])]


def speed_cap() -> list[float]:
    """Speed after two steps of 1e-2 s of a body at 1000 m/s, without loads."""
    world, body = _free(np.ones(3), np.zeros(3), np.array([1000.0, 0.0, 0.0]), 1e-2, fair=False)
    for _ in range(2):
        world.step()
    return [float(body.linvel.to_tuple()[0])]


def spin_up() -> list[float]:
    """Growth of the rate of a free ball per step, relative, at 2e-3 and 2e-4 s; true: 0."""
    found = []
    for dt in (2e-3, 2e-4):
        world, body = _free(np.ones(3), np.array([0.0, 0.0, 3.0]), np.zeros(3), dt, fair=True)
        for _ in range(1000):
            world.step()
        found.append((float(body.angvel.to_tuple()[2]) / 3.0 - 1.0) / 1000)
    return found
