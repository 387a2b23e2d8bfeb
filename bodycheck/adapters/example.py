"""The example engine: semi-implicit steps of one free body, and the template of `bodycheck new-adapter`."""

from __future__ import annotations

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Stepping
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench


class Example:
    """The engine, as bodycheck knows it."""

    name, version = "example", "0.1.0"
    # The package that NAME==VERSION installs: that of the engine, if it is another than this one.
    distribution = "bodycheck-example"
    facts = Method("euler", "semi-implicit Euler", 1, 1, "zero-order hold", "|q| = 1", "its manual")
    methods = {facts.name: facts}  # noqa: RUF012 - never changed

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract
        """Refuse what the engine cannot represent; ignoring it would be a wrong motion."""
        return "no pivot" if scene.pivot is not None else None

    def build(self, scene: Scene, method: str, dt_s: float) -> ExampleSimulation:  # noqa: ARG002
        """Build a minimal model: nothing that is not in the scene."""
        return ExampleSimulation(scene, dt_s)


class ExampleSimulation:
    """One scene in the engine. The attributes stand for the engine's own model and state."""

    stepping: Stepping = "python"  # native, where one call makes many steps

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self.scene, self.dt_s, self.loads = scene, dt_s, StageLoads(scene)
        self.mass, self.inertia = scene.body.mass, scene.body.inertia.copy()
        self.reset()

    def reset(self) -> None:
        """Restore the initial state at t = 0, without loads."""
        start = self.scene.initial
        self.x, self.v = start.position.copy(), start.velocity.copy()
        self.q, self.omega, self.steps = start.quaternion.copy(), start.omega_body.copy(), 0
        self.apply(NO_WRENCH)

    def read_back(self) -> ReadBack:
        """Return what the engine holds, never what this adapter was given."""
        return ReadBack(self.mass, self.inertia, self.dt_s, self.scene.gravity, self.read())

    def apply(self, wrench: Wrench) -> None:
        """Replace the constant loads."""
        self.loads.wrench = wrench

    def advance(self, steps: int) -> None:
        """Step the engine. Loads come from `loads.at`, here once per step, else at every stage."""
        for _ in range(steps):
            R = quaternion_to_matrix(self.q)
            force, torque = self.loads.at(self.steps * self.dt_s, self.x, R, self.v, R @ self.omega)
            momentum = self.inertia @ self.omega
            self.omega += self.dt_s * np.linalg.solve(self.inertia, torque - np.cross(self.omega, momentum))
            self.v += self.dt_s * force / self.mass
            self.x += self.dt_s * self.v
            self.q = quaternion_product(self.q, exp_quaternion(self.dt_s * self.omega))
            self.steps += 1

    def read(self) -> Reading:
        """Return copies of the state as the engine holds it, never normalised."""
        return Reading(self.x.copy(), self.v.copy(), quaternion=self.q.copy(), omega_body=self.omega.copy())

    def close(self) -> None:
        """Free what the engine holds."""
