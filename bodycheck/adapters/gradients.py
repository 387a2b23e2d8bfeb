"""The derivative of a motion's end by the body and its start, as a differentiable engine computes it.

An adapter of such an engine has `gradients(scene, method, dt_s) -> Gradients`, or raises UnreportedError,
which says why a method has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, cross, quaternion_product, rotate

PARAMETERS = 6
"""Three moments of a body whose principal axes are its own, and omega at the start, in body axes."""


@dataclass(frozen=True, eq=False)
class Gradients:
    """Derivatives (3, 6) by PARAMETERS of the attitude and of omega at the end, both in body axes.

    That of the attitude is the rotation vector theta by which the body is turned further, R exp([theta]x).
    """

    attitude: Array
    omega: Array

    @classmethod
    def of(cls, quaternion: Array, d_quaternion: Array, d_omega_body: Array) -> Gradients:
        """theta = 2 vec(conj(q) dq) / |q|^2, of dq (4, 6) and d omega (3, 6)."""
        turned = quaternion_product(conjugate(quaternion), np.moveaxis(d_quaternion, 0, -1))
        return cls(2.0 * turned[:, 1:].T / float(quaternion @ quaternion), np.asarray(d_omega_body))

    @classmethod
    def of_world(cls, quaternion: Array, d_quaternion: Array, omega: Array, d_omega: Array) -> Gradients:
        """d(R^T omega) = R^T d omega - theta x R^T omega, of omega in world axes."""
        back = conjugate(quaternion / np.linalg.norm(quaternion))
        in_body = rotate(back, omega)
        turned = cls.of(quaternion, d_quaternion, rotate(back, d_omega.T).T)
        return cls(turned.attitude, turned.omega - cross(turned.attitude.T, in_body).T)

    @property
    def matrix(self) -> Array:
        """(6, 6): attitude above omega."""
        return np.concatenate([self.attitude, self.omega])
