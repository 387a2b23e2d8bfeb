"""The result of a case: the states at the sample times, exactly as the engine stores them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import matrix_to_quaternion, project_to_so3, quaternion_to_matrix


@dataclass(frozen=True, eq=False)
class Trajectory:
    """n samples of one body's motion, which adapters store without normalising or projecting them.

    t_s (n,); position_m and velocity_m_s (n, 3) of the centre of mass, world axes; quaternion (n, 4),
    scalar first, and/or rotation (n, 3, 3), body to world; omega_world_rad_s and/or omega_body_rad_s
    (n, 3), whichever the engine itself stores. specific_force_m_s2 and gyro_rad_s (n, 3), body axes: what
    its accelerometer and its gyro at `imu.imu_point` read, if it has any. Of a tree of b bodies, the arrays
    are (n, b, ...), and there are q (n, coordinates) and u (n, rates) as `TreeScene` orders them. Derived
    quantities are computed once. Raises ValueError for a wrong shape and for a missing attitude or omega.
    """

    t_s: Array
    position_m: Array
    velocity_m_s: Array
    quaternion: Array | None = None
    rotation: Array | None = None
    omega_world_rad_s: Array | None = None
    omega_body_rad_s: Array | None = None
    q: Array | None = None
    u: Array | None = None
    specific_force_m_s2: Array | None = None
    gyro_rad_s: Array | None = None

    def __post_init__(self) -> None:
        n = (len(self.t_s), *np.shape(self.position_m)[1:-1])  # and the number of bodies, if a tree
        shapes = {
            "position_m": (*n, 3),
            "velocity_m_s": (*n, 3),
            "quaternion": (*n, 4),
            "rotation": (*n, 3, 3),
            "omega_world_rad_s": (*n, 3),
            "omega_body_rad_s": (*n, 3),
            "specific_force_m_s2": (*n, 3),
            "gyro_rad_s": (*n, 3),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != shape:
                raise ValueError(f"{name} has the shape {np.shape(value)}, not {shape}")
        if self.quaternion is None and self.rotation is None:
            raise ValueError("a trajectory needs a quaternion or a rotation")
        if self.omega_world_rad_s is None and self.omega_body_rad_s is None:
            raise ValueError("a trajectory needs omega_world_rad_s or omega_body_rad_s")

    @cached_property
    def attitude(self) -> Array:
        """The orientation as quaternions (n, 4): as stored, else those of the matrices' polar factors."""
        if self.quaternion is not None:
            return self.quaternion
        return matrix_to_quaternion(self.rotation_matrices)

    @cached_property
    def rotation_matrices(self) -> Array:
        """The orientation as proper rotation matrices (n, 3, 3): those of q / |q|, else the polar factors."""
        if self.quaternion is not None:
            return quaternion_to_matrix(self.quaternion)
        assert self.rotation is not None
        return project_to_so3(self.rotation)

    @cached_property
    def omega_body(self) -> Array:
        """Angular velocity in body axes (n, 3), rad/s."""
        if self.omega_body_rad_s is not None:
            return self.omega_body_rad_s
        assert self.omega_world_rad_s is not None
        return np.einsum("...ji,...j->...i", self.rotation_matrices, self.omega_world_rad_s)

    @cached_property
    def omega_world(self) -> Array:
        """Angular velocity in world axes (n, 3), rad/s."""
        if self.omega_world_rad_s is not None:
            return self.omega_world_rad_s
        assert self.omega_body_rad_s is not None
        return np.einsum("...ij,...j->...i", self.rotation_matrices, self.omega_body_rad_s)
