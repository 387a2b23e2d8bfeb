"""The frames in which engines store a body: R = R_e A^T, and p_link = R_l^T (p - offset)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import (
    conjugate,
    matrix_to_quaternion,
    quaternion_product,
    quaternion_to_matrix,
    right_factor,
)
from bodycheck.reference_impl.scene import Scene, State


class EngineAxes:
    """Rotate states between the engine's axes and body axes; skip the rotation where the axes coincide.

    matrix A (3, 3): the engine's axes as columns, in body axes. States are rotated at every sample, and for
    many bodies the axes coincide, so that the shortcut is worthwhile.
    """

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self._same = np.array_equal(matrix, np.eye(3))
        if not self._same:
            self._quaternion = matrix_to_quaternion(matrix)
            self._to_body = right_factor(conjugate(self._quaternion))

    def body_vector(self, vector: Array) -> Array:
        """A v: (3,) in the engine's axes -> (3,) in body axes."""
        return vector if self._same else self.matrix @ vector

    def engine_vector(self, vector: Array) -> Array:
        """A^T v: (3,) in body axes -> (3,) in the engine's axes."""
        return vector if self._same else vector @ self.matrix

    def body_rotation(self, rotation: Array) -> Array:
        """R_e A^T: (3, 3) engine's axes to world -> (3, 3) body to world."""
        return rotation if self._same else rotation @ self.matrix.T

    def body_quaternion(self, quaternion: Array) -> Array:
        """q_e a^-1: (4,) engine's axes to world -> (4,) body to world; a is A as a quaternion."""
        return quaternion if self._same else self._to_body @ quaternion

    def engine_quaternion(self, quaternion: Array) -> Array:
        """q a: (4,) body to world -> (4,) engine's axes to world."""
        return quaternion if self._same else quaternion_product(quaternion, self._quaternion)


@dataclass(frozen=True, eq=False)
class LinkFrame:
    """The engine's own frame of the body.

    offset (3,) in m: its origin from the centre of mass in body axes; quaternion (4,), rotation (3, 3): link
    axes to body axes.
    """

    offset: Array
    quaternion: Array
    rotation: Array

    def point(self, at: Array) -> Array:
        """R_l^T (p - offset): (3,) from the centre of mass in body axes -> (3,) in the link frame, m."""
        return np.asarray((at - self.offset) @ self.rotation)

    def rotated(self, quaternion: Array) -> Array:
        """q_l^-1 q: (4,) quaternion to body axes -> (4,) to link axes."""
        return quaternion_product(conjugate(self.quaternion), quaternion)

    def of_origin(self, state: State) -> tuple[Array, Array, Array]:
        """Return position (3,), quaternion (4,) and velocity (3,) of the link of a body, world axes."""
        arm = state.rotation @ self.offset
        velocity = state.velocity + np.cross(state.omega_world, arm)
        return state.position + arm, quaternion_product(state.quaternion, self.quaternion), velocity

    def of_body(
        self, position: Array, quaternion: Array, velocity: Array, omega_world: Array
    ) -> tuple[Array, Array, Array]:
        """Return position, quaternion and velocity of the body, from those of its link; all in world axes."""
        attitude = quaternion_product(quaternion, conjugate(self.quaternion))
        arm = quaternion_to_matrix(attitude) @ self.offset
        return position - arm, attitude, velocity - np.cross(omega_world, arm)


def link_frame(scene: Scene) -> LinkFrame:
    """Return the scene's link frame [default: origin at the centre of mass, body axes]."""
    if scene.link is None:
        return LinkFrame(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.eye(3))
    quaternion = scene.link.quaternion
    return LinkFrame(scene.link.offset, quaternion, quaternion_to_matrix(quaternion))


def pivot_place(scene: Scene) -> Array:
    """x + R pivot: the fixed position (3,) of the pivot in the world, m."""
    assert scene.pivot is not None
    return np.asarray(scene.initial.position + scene.initial.rotation @ scene.pivot)
