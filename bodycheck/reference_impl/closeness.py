"""How near two motions of one scene are: in angle, in energy, in angular momentum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, gravity_potential
from bodycheck.reference_impl.pivot import kinetic_energies, turning_inertia
from bodycheck.reference_impl.rotations import (
    conjugate,
    geodesic_angle,
    log_quaternion,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import Scene, Spring, TorsionSpring
from bodycheck.reference_impl.trajectory import Trajectory

_SHIFT = 2.0**-24  # large beside the round-off of a double, small beside 1
_HALF_ULP = 2.0**-53
_MOST_ROWS = 1 << 18  # states whose distances are taken at once: some 170 MB of them


def potential_energy(scene: Scene, motion: Trajectory) -> Array:
    """U of gravity, zero at the start, and of the springs, zero where they are relaxed: (n,) in J."""
    energy = gravity_potential(scene.body.mass, scene.gravity, motion.position_m - scene.initial.position)
    for load in scene.lasting_loads:
        match load:
            case Spring():
                arm = quaternion_to_matrix(motion.attitude) @ load.at
                length = np.linalg.norm(motion.position_m + arm - load.anchor, axis=-1)
                energy = energy + 0.5 * load.stiffness * (length - load.rest_length) ** 2
            case TorsionSpring():
                turned = quaternion_product(conjugate(scene.initial.quaternion), motion.attitude)
                angle = np.linalg.norm(log_quaternion(turned), axis=-1)
                energy = energy + 0.5 * load.stiffness * angle**2
    return energy


def distances(scene: Scene, one: Trajectory, other: Trajectory) -> Array:
    """(3, n): angle in rad, and the differences of E and of L over the largest K and |L| of `one`."""
    inertia = turning_inertia(scene)
    momenta = [
        angular_momentum(quaternion_to_matrix(motion.attitude), inertia, motion.omega_body)
        for motion in (one, other)
    ]
    kinetic = [kinetic_energies(scene, motion)[0] for motion in (one, other)]
    energies = [k + potential_energy(scene, motion) for k, motion in zip(kinetic, (one, other), strict=True)]
    energy_scale = np.max(np.abs(kinetic[0]), initial=0.0) or 1.0
    momentum_scale = np.max(np.linalg.norm(momenta[0], axis=-1), initial=0.0) or 1.0
    return np.stack(
        [
            geodesic_angle(one.attitude, other.attitude),
            np.abs(energies[1] - energies[0]) / energy_scale,
            np.linalg.norm(momenta[1] - momenta[0], axis=-1) / momentum_scale,
        ]
    )


def small_distances(scene: Scene, motion: Trajectory, change: Array) -> Array:
    """(3, n): `distances` of a motion and the same changed by (n, 13), however small the change.

    The change, of q, omega_body, v and x, is magnified until doubles can show it, and the result reduced.
    """
    sizes = np.max(np.abs(change), axis=-1)
    scale = np.max([np.max(np.abs(part), axis=-1) for part in _parts(motion)], axis=0)
    factor = np.where(sizes > _SHIFT * scale, 1.0, _SHIFT * scale / np.where(sizes == 0.0, 1.0, sizes))
    return distances(scene, motion, _changed(motion, factor[:, None] * change)) / factor


def rounding(scene: Scene, motion: Trajectory) -> Array:
    """(3, n): the distances that half an ulp in each number of the motion makes, summed."""
    states = np.concatenate(_parts(motion), axis=-1)
    n, width = states.shape
    together = min(max(_MOST_ROWS // max(n, 1), 1), width)
    columns = [range(first, min(first + together, width)) for first in range(0, width, together)]
    found = [_distances_of_shifts(scene, motion, states, some) for some in columns]
    return np.concatenate(found, axis=1).sum(axis=1) * (_HALF_ULP / _SHIFT)


def _distances_of_shifts(scene: Scene, motion: Trajectory, states: Array, columns: Sequence[int]) -> Array:
    """(3, k, n): the distances that the shift of one number in each of k columns of the states makes."""
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
    return distances(scene, repeated, shifted).reshape(3, k, n)


def _changed(motion: Trajectory, change: Array) -> Trajectory:
    """Return the motion with (n, 13) added to q, omega_body, v and x."""
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
