"""Scales of a scene's true motion, which make drifts and errors dimensionless."""

from __future__ import annotations

from dataclasses import dataclass

from bodycheck.reference_impl.arrays import largest_norm
from bodycheck.reference_impl.dynamics import angular_momentum, gyration_radius
from bodycheck.reference_impl.pivot import kinetic_energies, rotational_inertia
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory


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


def scene_scales(scene: Scene, truth: Trajectory) -> Scales:
    """Return the scales: length = max(max |x - x(0)|, gyration radius), and so on.

    For a body with a pivot, inertia, energy and angular momentum are taken about the pivot.
    """
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
