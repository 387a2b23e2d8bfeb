"""The motion that starts at the first sample of a recording, and how well that sample determines it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bodycheck.examine.diagnosis.quantity_resolution import Resolution
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle, normalised
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.truths import known_truth
from bodycheck.scenarios.model import Initial, Scenario

_RESOLVED = 1e-14  # rad or rad/s: finer resolutions are those of doubles


def started_at_first_sample(scenario: Scenario, path: Trajectory, known: frozenset[str]) -> Scenario:
    """Return the scenario with the state of the first sample, as far as this is known, as its start.

    The attitude is normalised, as the truth starts from q / |q|.
    """
    initial, start = scenario.initial, scenario.scene.initial
    position = path.position_m[0] if "position" in known else start.position
    attitude = normalised(path.attitude[0]) if "attitude" in known else start.quaternion
    omega = path.omega_body[0] if "omega" in known else start.omega_body
    velocity = initial.velocity_m_s
    if "velocity" in known and scenario.scene.pivot is None:
        velocity = tuple(path.velocity_m_s[0].tolist())
    changed = Initial(
        position_m=tuple(position.tolist()),
        quaternion=tuple(attitude.tolist()),
        velocity_m_s=velocity,
        omega_body_rad_s=tuple(omega.tolist()),
    )
    return Scenario.model_construct(**{**dict(scenario), "initial": changed})  # its scene is cached


def start_bound_rad(scene: Scene, t_s: Array, resolution: Resolution, cache: Cache | None) -> Array:
    """Return how far the attitude of the truth may be off (n,), in rad, because its start was rounded.

    To first order in half the resolution: that of the attitude, and those of the components of omega, each
    taken with the motion that it leads to.
    """
    bound = np.full(len(t_s), 0.5 * resolution.attitude)
    if resolution.omega > _RESOLVED:
        truth = known_truth(scene, t_s, cache).trajectory.attitude
        for axis in np.eye(3):
            initial = scene.initial
            omega = initial.omega_body + 0.5 * resolution.omega * axis
            moved = replace(scene, initial=replace(initial, omega_body=omega, exact_omega_world=None))
            bound = bound + geodesic_angle(truth, known_truth(moved, t_s, None).trajectory.attitude)
    return bound
