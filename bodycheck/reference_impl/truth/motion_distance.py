"""Distances between two motions of one scene: angle, energy, momentum, omega, position and velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.dynamics import angular_momentum, gravity_potential, gyration_radius
from bodycheck.reference_impl.loads.load import checked_continuous
from bodycheck.reference_impl.pivot import kinetic_energies, rotational_inertia
from bodycheck.reference_impl.rotations import geodesic_angle, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory

_SHIFT = 2.0**-24  # large compared with the round-off of a double, small compared with 1
_HALF_ULP = 2.0**-53
_UNDERFLOW = 2.0**-1072  # absolute, for numbers too small for a relative ulp
_MAX_ROWS = 1 << 18  # states per batch of distances: some 170 MB
_MAX_ROTATION = 2.0**-12  # quaternion change up to which the angle is proportional to it


def potential_energy(scene: Scene, motion: Trajectory) -> Array:
    """U of gravity, zero at the start, plus that of the loads with a potential: (n,) in J."""
    energy = gravity_potential(scene.body.mass, scene.gravity, motion.position_m - scene.initial.position)
    for load in scene.continuous_loads:
        if checked_continuous(load, "the potential energy").potential_needs:
            energy = energy + load.potential(scene, motion)
    return energy


def distances(scene: Scene, one: Trajectory, other: Trajectory) -> Array:
    """Return the distances (6, n) between two motions, one row per quantity.

    Angle in rad; differences of E and L over the largest K and |L| of `one`; |omega - omega'| in body axes,
    |x - x'| and |v - v'| in SI units.
    """
    inertia = rotational_inertia(scene)
    momenta = [
        angular_momentum(quaternion_to_matrix(motion.attitude), inertia, motion.omega_body)
        for motion in (one, other)
    ]
    kinetic = [kinetic_energies(scene, motion)[0] for motion in (one, other)]
    energies = [k + potential_energy(scene, motion) for k, motion in zip(kinetic, (one, other), strict=True)]
    energy_scale = np.max(np.abs(kinetic[0]), initial=0.0) or 1.0
    momentum_scale = largest_norm(momenta[0]) or 1.0
    return np.stack(
        [
            geodesic_angle(one.attitude, other.attitude),
            np.abs(energies[1] - energies[0]) / energy_scale,
            np.linalg.norm(momenta[1] - momenta[0], axis=-1) / momentum_scale,
            np.linalg.norm(other.omega_body - one.omega_body, axis=-1),
            np.linalg.norm(other.position_m - one.position_m, axis=-1),
            np.linalg.norm(other.velocity_m_s - one.velocity_m_s, axis=-1),
        ]
    )


def scales(scene: Scene, motion: Trajectory) -> Array:
    """Return the scales (6, 1) that make `distances` dimensionless; 1 where nothing moves.

    1 for the first three; the largest |omega|; the largest distance from the start or the gyration radius,
    whichever is larger; the largest |v| or |omega| times the gyration radius, whichever is larger.
    """
    radius = gyration_radius(scene.body.mass, rotational_inertia(scene))
    omega, distance, speed = (
        largest_norm(part)
        for part in (motion.omega_body, motion.position_m - scene.initial.position, motion.velocity_m_s)
    )
    found = np.array([1.0, 1.0, 1.0, omega, max(distance, radius), max(speed, omega * radius)])
    return np.where(found > 0.0, found, 1.0)[:, None]


def small_distances(scene: Scene, motion: Trajectory, change: Array) -> Array:
    """Return `distances` (6, n) between a motion and the same motion changed by (n, 13), however little.

    The change of q, omega_body, v and x is magnified until doubles resolve it, and the result is divided by
    the same factor.
    """
    sizes = np.max(np.abs(change), axis=-1)
    scale = np.max([np.max(np.abs(part), axis=-1) for part in _parts(motion)], axis=0)
    factor = np.where(sizes > _SHIFT * scale, 1.0, _SHIFT * scale / np.where(sizes == 0.0, 1.0, sizes))
    rotation = np.max(np.abs(change[:, 0:4]), axis=-1)
    # large numbers elsewhere must not magnify a small rotation into a full turn
    factor = np.where(
        factor * rotation > _MAX_ROTATION,
        np.maximum(_MAX_ROTATION / np.where(rotation == 0.0, 1.0, rotation), 1.0),
        factor,
    )
    found = distances(scene, motion, _changed(motion, factor[:, None] * change)) / factor
    for row, part in zip((3, 4, 5), (slice(4, 7), slice(10, 13), slice(7, 10)), strict=True):
        found[row] = np.linalg.norm(change[:, part], axis=-1)
    return found


def rounding(scene: Scene, motion: Trajectory) -> Array:
    """Return the sum (6, n) of the distances caused by half an ulp in each number of the motion."""
    states = np.concatenate(_parts(motion), axis=-1)
    n, width = states.shape
    per_batch = min(max(_MAX_ROWS // max(n, 1), 1), width)
    columns = [range(first, min(first + per_batch, width)) for first in range(0, width, per_batch)]
    found = [_distances_of_shifts(scene, motion, states, part) for part in columns]
    return np.concatenate(found, axis=1).sum(axis=1) * (_HALF_ULP / _SHIFT) + _UNDERFLOW


def _distances_of_shifts(scene: Scene, motion: Trajectory, states: Array, columns: Sequence[int]) -> Array:
    """Return the distances (6, k, n) caused by shifting each of k columns of the states (n, 13) alone."""
    k, (n, width) = len(columns), states.shape
    change = np.zeros((k, n, width))
    for i, column in enumerate(columns):
        change[i, :, column] = _SHIFT * states[:, column]
    repeated = Trajectory(
        t_s=np.tile(motion.t_s, k),
        position_m=np.tile(motion.position_m, (k, 1)),
        velocity_m_s=np.tile(motion.velocity_m_s, (k, 1)),
        quaternion=np.tile(motion.attitude, (k, 1)),
        omega_body_rad_s=np.tile(motion.omega_body, (k, 1)),
    )
    shifted = _changed(repeated, change.reshape(k * n, width))
    return distances(scene, repeated, shifted).reshape(6, k, n)


def _changed(motion: Trajectory, change: Array) -> Trajectory:
    """Return the motion with change (n, 13) added to q, omega_body, v and x."""
    q, omega, velocity, position = _parts(motion)
    return replace(
        motion,
        quaternion=q + change[:, 0:4],
        omega_body_rad_s=omega + change[:, 4:7],
        velocity_m_s=velocity + change[:, 7:10],
        position_m=position + change[:, 10:13],
    )


def _parts(motion: Trajectory) -> tuple[Array, Array, Array, Array]:
    return motion.attitude, motion.omega_body, motion.velocity_m_s, motion.position_m
