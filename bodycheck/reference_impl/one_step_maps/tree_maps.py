"""The steps of trees: what engines are compared with where bodies are connected by joints."""

from __future__ import annotations

from dataclasses import dataclass

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_scene import TreeScene


@dataclass(frozen=True)
class TreeMap:
    """One integration step of a tree.

    description: its formula, with a = u', c the bias with gravity, D damping, K stiffness, and tau of
    springs, dampers and loads; (+) turns attitudes by exp. one_body: the map of MAPS that a free body makes.
    """

    name: str
    description: str
    order: int
    one_body: str

    def step(
        self, scene: TreeScene, t_s: float, q: Array, u: Array, dt_s: float, steps: int = 1
    ) -> tuple[Array, Array]:
        """Return q (nq,) and u (nu,) after some steps from a time, under the loads that act at it."""
        from bodycheck.reference_impl.trees.tree_stepper import TreeStepper  # imports numba

        stepper = TreeStepper(scene, self.name)
        stepper.q[:, 0], stepper.u[:, 0] = q, u
        stepper.advance(t_s, dt_s, steps)
        return stepper.q[:, 0], stepper.u[:, 0]


TREE_MAPS = {
    one.name: one
    for one in (
        TreeMap("M1", "M a = tau - c; u+ = u + dt a; q+ = q (+) dt u+", 1, "M1"),
        TreeMap("M1d", "(M + dt D) a = tau - c; u+ = u + dt a; q+ = q (+) dt u+", 1, "M1"),
        TreeMap("M2s", "(M + dt D + dt^2 K) a = tau - c - dt K u; u+ = u + dt a; q+ = q (+) dt u+", 1, "M1"),
        TreeMap("M2", "(M + dt D + dt dc/du) a = tau - c; u+ = u + dt a; q+ = q (+) dt u+", 1, "M2"),
        TreeMap(
            "RK4",
            "stages q (+) dt a_i k, u + dt a_i u'; k by the inverse of the derivative of exp",
            4,
            "RK4 Munthe-Kaas",
        ),
    )
}
"""The maps of trees by name. Without damping and springs M1, M1d and M2s are the same."""
