"""An engine whose gyroscopic term may be multiplied by a factor, to be broken on purpose between runs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bodycheck.adapters.contract import Method
from bodycheck.adapters.example import ExampleSimulation
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reference_impl.scene import Scene


class WeakenedSimulation(ExampleSimulation):
    """omega += h I^-1 (- factor omega x I omega), then q = q exp(h omega); a free body without loads."""

    factor = 1.0

    def advance(self, steps: int) -> None:
        """Make steps with the multiplied gyroscopic term."""
        for _ in range(steps):
            torque = -self.factor * np.cross(self.omega, self.inertia @ self.omega)
            self.omega += self.dt_s * np.linalg.solve(self.inertia, torque)
            self.x += self.dt_s * self.v
            self.q = quaternion_product(self.q, exp_quaternion(self.dt_s * self.omega))
            self.steps += 1


class Weakened:
    """The example engine for free bodies, with its gyroscopic term multiplied by a factor."""

    name = "weakened"
    version = "1"
    facts = Method("euler", "semi-implicit Euler", 1, 1, "zero-order hold", "|q| = 1", "this module")
    methods: Mapping[str, Method] = {facts.name: facts}

    def __init__(self, factor: float = 1.0) -> None:
        self._factor = factor

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse loads and pivots."""
        del method
        return "only free bodies without loads" if scene.loads or scene.pivot is not None else None

    def build(self, scene: Scene, method: str, dt_s: float) -> WeakenedSimulation:
        """Build a simulation with the factor."""
        del method
        made = WeakenedSimulation(scene, dt_s)
        made.factor = self._factor
        return made
