"""R = R_e A^T: the axes in which an engine holds the body, where they are not the body's own."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import (
    conjugate,
    matrix_to_quaternion,
    quaternion_product,
    right_factor,
)


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
