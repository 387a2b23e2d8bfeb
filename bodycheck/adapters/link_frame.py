"""p_link = R_l^T (p - offset): the frame of the body in which an engine is to be built."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene


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
