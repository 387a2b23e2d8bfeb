"""The frames in which engines hold a body: R = R_e A^T, and p_link = R_l^T (p - offset)."""

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
from bodycheck.reference_impl.scene import Scene


class EngineAxes:
    """What turns a state from the engine's axes into the body's, and back; nothing where they are the same.

    matrix A (3, 3): the engine's axes as columns, in body axes. An engine's states are turned at every
    sample, so that the many bodies whose axes are the engine's are worth being told apart.
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
    """Where an engine's own frame of the body lies.

    offset (3,) in m: its origin from the centre of mass in body axes; quaternion (4,), rotation (3, 3): link
    axes to body axes.
    """

    offset: Array
    quaternion: Array
    rotation: Array

    def point(self, at: Array) -> Array:
        """Return a point given from the centre of mass in body axes, in the link's frame: (3,), m."""
        return np.asarray((at - self.offset) @ self.rotation)

    def turned(self, quaternion: Array) -> Array:
        """Return a quaternion to body axes as one to link axes: (4,)."""
        return quaternion_product(conjugate(self.quaternion), quaternion)


def link_frame(scene: Scene) -> LinkFrame:
    """Return the scene's link frame; the centre of mass and the body axes where it has none."""
    if scene.link is None:
        return LinkFrame(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.eye(3))
    quaternion = scene.link.quaternion
    return LinkFrame(scene.link.offset, quaternion, quaternion_to_matrix(quaternion))


def pivot_place(scene: Scene) -> Array:
    """x + R pivot: where in the world the pivot stays, (3,), m."""
    assert scene.pivot is not None
    return np.asarray(scene.initial.position + scene.initial.rotation @ scene.pivot)
