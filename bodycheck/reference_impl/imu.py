"""What an accelerometer and a gyro at a point of the body read, and readings with a term missing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import gyration_radius
from bodycheck.reference_impl.rotations import cross
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory

_DIRECTION = np.array([0.6, -0.48, 0.64])


def imu_point(scene: Scene) -> Array:
    """Return where the sensors are (3,): a gyration radius from the centre of mass, in body axes, m."""
    return _DIRECTION * gyration_radius(scene.body.mass, scene.body.inertia)


def has_imu(scene: Scene) -> bool:
    """Whether the readings are defined at all samples: no pivot, and no load that comes or goes."""
    switches = any(True for _ in scene.switches_before(scene.duration_s))
    return scene.pivot is None and not switches and not scene.has_callback_load


@dataclass(frozen=True, eq=False)
class ImuReadings:
    """specific_force (n, 3) = a, m/s^2, and rate (n, 3) = omega, rad/s, both in body axes.

    a = R^T (x'' - g) + omega' x r + omega x (omega x r), r = `imu_point`. velocity (n, 3): of the centre of
    mass in body axes; gravity (n, 3): R^T g; turning and centripetal (n, 3): the last two terms.
    """

    specific_force: Array
    rate: Array
    velocity: Array
    gravity: Array
    turning: Array
    centripetal: Array

    @classmethod
    def of(cls, scene: Scene, motion: Trajectory) -> ImuReadings:
        """Return the readings along a motion of a scene that has them."""
        # imports numba, which the worker of an engine with sensors does not need
        from bodycheck.reference_impl.one_step_maps.one_step_map import back, scene_loads, times

        rotation, omega, at = motion.rotation_matrices, motion.omega_body, imu_point(scene)
        inertia = scene.body.inertia
        world = motion.omega_world
        force, torque = scene_loads(scene)(
            motion.t_s, motion.position_m, rotation, motion.velocity_m_s, world
        )
        gyroscopic = cross(omega, times(inertia, omega))
        spin_up = times(np.asarray(np.linalg.inv(inertia), dtype=np.float64), torque - gyroscopic)
        arm = np.broadcast_to(at, omega.shape)
        gravity = back(rotation, np.broadcast_to(scene.gravity, omega.shape))
        turning, centripetal = cross(spin_up, arm), cross(omega, cross(omega, arm))
        pushed = back(rotation, np.broadcast_to(force / scene.body.mass, omega.shape)) - gravity
        velocity = back(rotation, motion.velocity_m_s)
        return cls(pushed + turning + centripetal, omega, velocity, gravity, turning, centripetal)

    def departure(self, other: Trajectory) -> Array | None:
        """Return (n, 6) of another's readings: of a over max |a|, of the rate over max |omega|.

        None where the other has no readings, or a part of the true ones is 0 throughout.
        """
        if other.specific_force_m_s2 is None or other.gyro_rad_s is None:
            return None
        parts = ((other.specific_force_m_s2, self.specific_force), (other.gyro_rad_s, self.rate))
        sizes = [float(np.max(np.linalg.norm(true, axis=-1))) for _, true in parts]
        if min(sizes) == 0.0:
            return None
        apart = [(found - true) / size for (found, true), size in zip(parts, sizes, strict=True)]
        return np.concatenate(apart, axis=-1)

    def mistakes(self) -> Iterator[tuple[str, ImuReadings]]:
        """Yield readings with one mistake, and its name."""
        a = self.specific_force
        forces = {
            "omega x v is missing": a - cross(self.rate, self.velocity),
            "gravity is missing": a + self.gravity,
            "gravity has the other sign": a + 2.0 * self.gravity,
            "omega' x r is missing": a - self.turning,
            "omega x (omega x r) is missing": a - self.centripetal,
            "both terms of the point are missing": a - self.turning - self.centripetal,
            "the sign is reversed": -a,
        }
        for name, force in forces.items():
            yield f"accelerometer: {name}", replace(self, specific_force=force)
        yield "gyro: the sign is reversed", replace(self, rate=-self.rate)


_EXPLAINED = 0.01  # of the departure
_SMALLEST = 1e-4  # a departure that is searched for mistakes, above the round-off of float32


def imu_mistake(scene: Scene, found: Trajectory) -> str:
    """Return the mistake that explains 99 % of how readings depart from those of their own motion, or ""."""
    if found.specific_force_m_s2 is None or not has_imu(scene):
        return ""
    true = ImuReadings.of(scene, found)
    apart = true.departure(found)
    if apart is None or float(np.max(np.abs(apart))) < _SMALLEST:
        return ""
    left = {name: true_with.departure(found) for name, true_with in true.mistakes()}
    sizes = {name: float(np.max(np.abs(rest))) for name, rest in left.items() if rest is not None}
    best = min(sizes, key=lambda name: sizes[name])
    return best if sizes[best] <= _EXPLAINED * float(np.max(np.abs(apart))) else ""
