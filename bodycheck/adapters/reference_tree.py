"""Trees by the reference's own methods: the maps M1 and RK4 of the catalogue, and the Taylor series."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bodycheck.adapters.contract import TreeReadBack
from bodycheck.adapters.tree_contract import TreeModel, UnreportedError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.taylor.solution import resolution_for
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reference_impl.trees.tree_motion import TreeSeries
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, JointTorque, TreeLoad, TreeScene
from bodycheck.reference_impl.trees.tree_stepper import TreeStepper

_MAPS = {"m1": "M1", "rk4": "RK4"}
_SERIES = "taylor"


class ReferenceTree(TreeModel):
    """A tree stepped by a map of the catalogue."""

    stepping = "native"

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:  # noqa: ARG002 - of readings
        self._scene = scene

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse the methods for one body."""
        moving = (*_MAPS, _SERIES)
        return None if method in moving else f"trees are moved by {', '.join(moving)}, not by {method}"

    def set_state(self, q: Array, u: Array) -> None:  # noqa: ARG002
        """Refuse to report the exact values that readings are compared with."""
        raise UnreportedError("the reference only moves trees: its own readings are the exact ones")

    def start(self, method: str, dt_s: float) -> None:
        """Go back to the start."""
        self._stepper, self._dt_s, self._steps = TreeStepper(self._scene, _MAPS[method]), dt_s, 0

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Record the equations with these loads."""
        self._stepper.push(tuple(_scaled(load, share) for load, share in loads))

    def advance(self, steps: int) -> None:
        """Make the steps in one compiled call."""
        self._stepper.advance(self._steps * self._dt_s, self._dt_s, steps)
        self._steps += steps

    def state(self) -> tuple[Array, Array]:
        """Return copies of q and u."""
        return self._stepper.q[:, 0].copy(), self._stepper.u[:, 0].copy()

    def held(self) -> TreeReadBack:
        """Return the scene's own numbers, as there is no engine between, and the state."""
        q, u = self.state()
        return _read_back(self._scene, self._dt_s, q, u)


class TreeSeriesSolver:
    """A tree by the Taylor integrator in doubles: packed once when built."""

    steps: int | None = None

    def __init__(self, scene: TreeScene, tolerance: float) -> None:
        self._scene, self._series = scene, TreeSeries(scene, resolution_for(tolerance))

    def read_back(self) -> TreeReadBack:
        """Return the scene's own numbers: there is no engine between."""
        return _read_back(self._scene, None, self._scene.q0, self._scene.u0)

    def solve(self) -> Trajectory:
        """Follow the motion through all samples."""
        scene = self._scene
        q, u = (scene.q0, np.zeros_like(scene.q0)), (scene.u0, np.zeros_like(scene.u0))
        found = self._series.solve(q, u, scene.sample_times)
        self.steps = found.steps
        return tree_trajectory(scene, scene.sample_times, found.q[0], found.u[0])

    def close(self) -> None:
        """Nothing to free."""


def _read_back(scene: TreeScene, dt_s: float | None, q: Array, u: Array) -> TreeReadBack:
    numbers = {
        "mass": np.array([body.mass for body in scene.bodies]),
        "inertia": np.array([body.inertia for body in scene.bodies]),
        "gravity": scene.gravity,
    }
    return TreeReadBack(dt_s, {**numbers, "q": q, "u": u})


def _scaled(load: TreeLoad, share: float) -> TreeLoad:
    if share == 1.0:
        return load
    if isinstance(load, BodyLoad):
        return replace(load, load=replace(load.load, value=share * load.load.value))
    assert isinstance(load, JointTorque)  # sines act at all times
    return replace(load, value=share * load.value)
