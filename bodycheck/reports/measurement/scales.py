"""Scales of a scene's true motion, which make drifts and errors dimensionless."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import largest_norm
from bodycheck.reference_impl.dynamics import angular_momentum, gyration_radius
from bodycheck.reference_impl.pivot import kinetic_energies, rotational_inertia
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_bodies import tree_momenta
from bodycheck.reference_impl.trees.tree_scene import TreeScene


@dataclass(frozen=True)
class Scales:
    """Maxima over the truth's samples. A scale is 0 where nothing moves, and then it is not divided by."""

    length_scale_m: float
    speed_scale_m_s: float
    omega_scale_rad_s: float
    energy_scale_j: float
    rotational_energy_scale_j: float
    angular_momentum_scale_kg_m2_s: float
    linear_momentum_scale_kg_m_s: float


def scene_scales(scene: Scene | TreeScene, truth: Trajectory) -> Scales:
    """Return the scales: length = max(max |x - x(0)|, gyration radius), and so on.

    For a body with a pivot, inertia, energy and angular momentum are taken about the pivot. Of a tree, each
    is the largest of any body; the momentum is that of all masses at the largest speed, and the angular
    momentum, which may vanish, at least that at the length.
    """
    if isinstance(scene, TreeScene):
        return _tree_scales(scene, truth)
    body, inertia = scene.body, rotational_inertia(scene)
    radius = gyration_radius(body.mass, inertia)
    omega = largest_norm(truth.omega_body)
    speed = max(largest_norm(truth.velocity_m_s), omega * radius)
    kinetic, rotational = kinetic_energies(scene, truth)
    return Scales(
        length_scale_m=max(largest_norm(truth.position_m - scene.initial.position), radius),
        speed_scale_m_s=speed,
        omega_scale_rad_s=omega,
        energy_scale_j=float(kinetic.max()),
        rotational_energy_scale_j=float(rotational.max()),
        angular_momentum_scale_kg_m2_s=largest_norm(
            angular_momentum(truth.rotation_matrices, inertia, truth.omega_body)
        ),
        linear_momentum_scale_kg_m_s=body.mass * speed,
    )


def _tree_scales(scene: TreeScene, truth: Trajectory) -> Scales:
    masses = [body.mass for body in scene.bodies]
    radii = [gyration_radius(body.mass, body.inertia) for body in scene.bodies if body.mass]
    arms = [float(np.linalg.norm(body.joint.at_body)) for body in scene.bodies]
    length = max(largest_norm(truth.position_m - truth.position_m[:1]), *radii, *arms)
    omega = largest_norm(truth.omega_body)
    speed = max(largest_norm(truth.velocity_m_s), omega * max([*radii, *arms]))
    kinetic, rotational = kinetic_energies(scene, truth)
    momentum = sum(masses) * speed
    return Scales(
        length_scale_m=length,
        speed_scale_m_s=speed,
        omega_scale_rad_s=omega,
        energy_scale_j=float(kinetic.max()),
        rotational_energy_scale_j=float(rotational.max()),
        angular_momentum_scale_kg_m2_s=max(largest_norm(tree_momenta(scene, truth)[1]), momentum * length),
        linear_momentum_scale_kg_m_s=momentum,
    )
