"""A tree in several states: the exact values of all readings, and how far other values are from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bodycheck.examine.dynamics.batch_dynamics import batch_dynamics
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_dynamics import TreeDynamics, tree_dynamics
from bodycheck.reference_impl.trees.tree_scene import TreeScene

EXACT: dict[str, Callable[[TreeDynamics], Array]] = {
    "mass_matrix": lambda at: at.mass_matrix,
    "bias": lambda at: at.bias - at.applied,
    "gravity_bias": lambda at: at.gravity_bias,
    "accelerations": lambda at: at.accelerations,
    "wrenches": lambda at: np.hstack([at.joint_force, at.joint_moment]),
    "energy": lambda at: np.array([at.kinetic, at.potential]),
    "momenta": lambda at: np.concatenate([at.momentum, at.angular_momentum]),
    "poses": lambda at: np.hstack([at.position, at.quaternion]),
}
"""Reading -> its exact value. Loads on a tree, which only planted faults have, count as bias."""
PARTS = {
    "wrenches": (slice(0, 3), slice(3, 6)),
    "momenta": (slice(0, 3), slice(3, 6)),
    "poses": (slice(0, 3),),
}
"""Reading -> the parts of its last axis that have units of their own; other components have a scale of 1."""


@dataclass(frozen=True, eq=False)
class TreeState:
    """A tree, coordinates (nq,) and rates (nu,), and the dynamics there where they are known already."""

    scene: TreeScene
    q: Array
    u: Array
    known: TreeDynamics | None = None

    @cached_property
    def dynamics(self) -> TreeDynamics:
        """The exact dynamics."""
        return tree_dynamics(self.scene, self.q, self.u) if self.known is None else self.known


@dataclass(frozen=True, eq=False)
class TreeCase:
    """A named tree in k states; masses_were: how many times as large its masses were when it was built."""

    name: str
    states: tuple[TreeState, ...]
    masses_were: float = 1.0

    @property
    def scene(self) -> TreeScene:
        """The tree."""
        return self.states[0].scene

    @cached_property
    def _exact(self) -> dict[str, Array]:
        return {}

    def exact(self, reading: str) -> Array:
        """Return the exact values (k, ...) of a reading."""
        if reading not in self._exact:
            self._exact[reading] = np.array([EXACT[reading](state.dynamics) for state in self.states])
        return self._exact[reading]

    def changed(self, change: Callable[[TreeState], TreeState]) -> TreeCase:
        """Return the case with all its states changed, for hypotheses: its values are those of doubles."""
        states = [change(state) for state in self.states]
        q, u = np.array([state.q for state in states]), np.array([state.u for state in states])
        known = batch_dynamics([state.scene for state in states], q, u)
        pairs = zip(states, known, strict=True)
        return replace(self, states=tuple(TreeState(one.scene, one.q, one.u, at) for one, at in pairs))

    @cached_property
    def resting(self) -> TreeCase:
        """The same states at rest."""
        return self.changed(lambda state: TreeState(state.scene, state.q, np.zeros_like(state.u)))

    @cached_property
    def largest_condition(self) -> float:
        """The largest condition number of M."""
        return max(float(np.linalg.cond(state.dynamics.mass_matrix)) for state in self.states)

    def scales(self, reading: str) -> Array:
        """Return what deviations of a reading are relative to: the largest exact component over all states.

        Shaped like the last axis. Wrenches, which may all vanish, are at least the weight, or the mass times
        1 m/s^2.
        """
        exact = self.exact(reading)
        scales = np.full(exact.shape[-1], float(np.max(np.abs(exact))))
        if reading in PARTS:
            scales[:] = 1.0
            for part in PARTS[reading]:
                scales[part] = np.max(np.abs(exact[..., part]))
        if reading == "wrenches":
            mass = sum(body.mass for body in self.scene.bodies)
            scales = np.maximum(scales, mass * max(1.0, float(np.linalg.norm(self.scene.gravity))) * 1e-3)
        return np.where(scales > 0.0, scales, 1.0)

    def differences(self, reading: str, found: Array, exact: Array | None = None) -> Array:
        """Return found values (k, ...) less the exact ones, relative to the scales; quaternions of any sign.

        Values of another shape are infinitely far away.
        """
        exact = self.exact(reading) if exact is None else exact
        if found.shape != exact.shape:
            return np.full_like(exact, np.inf)
        if reading == "poses":
            signs = np.sign(np.sum(found[..., 3:] * exact[..., 3:], axis=-1, keepdims=True))
            found = np.concatenate(
                [found[..., :3], np.where(signs < 0.0, -1.0, 1.0) * found[..., 3:]], axis=-1
            )
        with np.errstate(all="ignore"):
            return (found - exact) / self.scales(reading)

    def deviation(self, reading: str, found: Array, exact: Array | None = None) -> float:
        """Return the largest relative difference; infinite for values that are not numbers."""
        worst = float(np.max(np.abs(self.differences(reading, found, exact)), initial=0.0))
        return worst if np.isfinite(worst) else float("inf")
