"""Trees in the example engine: exact dynamics, and the template of `bodycheck new-adapter --tree`."""

from __future__ import annotations

import numpy as np

from bodycheck.adapters.tree_contract import TreeModel, UnreportedError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_dynamics import tree_dynamics
from bodycheck.reference_impl.trees.tree_scene import TreeScene


class ExampleTree(TreeModel):
    """One tree. Replace `self.at` by calls of the engine; leave out what it does not report."""

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        if masses_were != 1.0:
            raise UnreportedError("masses do not change once the tree is built")
        self.scene = scene

    def set_state(self, q: Array, u: Array) -> None:
        """Set the state; in most engines, also compute what depends on it."""
        self.at = tree_dynamics(self.scene, q, u)

    def mass_matrix(self) -> Array:
        """Return M, with the rates of a free body in the order v in world axes, omega in body axes."""
        return self.at.mass_matrix

    def bias(self) -> Array:
        """Return Coriolis, centrifugal and gyroscopic terms and gravity."""
        return self.at.bias

    def accelerations(self) -> Array:
        """Return u' without joint forces."""
        return self.at.accelerations

    def wrenches(self) -> Array:
        """Return force and moment of each joint on its child, at the joint, in the child's axes."""
        return np.hstack([self.at.joint_force, self.at.joint_moment])

    def poses(self) -> Array:
        """Return places of the centres of mass, and quaternions, scalar first."""
        return np.hstack([self.at.position, self.at.quaternion])
