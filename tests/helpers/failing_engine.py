"""An engine whose solver raises an error; it is imported by its workers, so it imports little."""

from __future__ import annotations

from collections.abc import Mapping

from bodycheck.adapters.contract import Method, Simulation
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.scene import Scene


class Failing:
    """The reference under another name; its solver raises an error at a long step if a torque acts."""

    name = "failing"
    version = "1"

    def __init__(self) -> None:
        self._sound = Reference()
        self.methods: Mapping[str, Method] = {"m1": self._sound.methods["m1"]}

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Support every scene."""
        del scene, method
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a correct simulation, or raise an error."""
        if scene.loads and dt_s > 0.015:
            raise RuntimeError("the solver gave up | it said <so>")
        return self._sound.build(scene, method, dt_s)
