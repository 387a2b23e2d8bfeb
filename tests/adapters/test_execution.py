"""Execution of a case: everything built for a case is closed, however the case ends."""

from __future__ import annotations

import resource

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting, Simulation, Solver
from bodycheck.adapters.execution import Case, stopwatch
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import case_messages
from bodycheck.adapters.workers.worker import RequestHandler
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from tests.helpers.child_process import run_in_child

START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 1.0, 0.2]))
SCENE = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), START, (), np.zeros(3), 1.0, 3)


class FailsWhenTimed(Reference):
    """The reference, which raises an error when a motion starts and counts closed simulations."""

    def __init__(self) -> None:
        super().__init__()
        self.closed = 0

    def _close(self) -> None:
        self.closed += 1

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a simulation that raises an error when it is reset."""
        simulation = super().build(scene, method, dt_s)
        simulation.reset = self._fail  # type: ignore[method-assign]
        simulation.close = self._close  # type: ignore[method-assign]
        return simulation

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:
        """Build a solver that raises an error when it solves."""
        solver = super().solver(scene, method, tolerance)
        solver.solve = self._fail  # type: ignore[assignment]
        solver.close = self._close  # type: ignore[method-assign]
        return solver

    def _fail(self) -> None:
        raise RuntimeError("singular")


@pytest.mark.parametrize(("method", "dt_s"), [("m1", 0.1), ("exact", None)])
def test_engine_that_fails_in_the_untimed_pass_is_closed(method: str, dt_s: float | None) -> None:
    """An engine that fails in the untimed pass is closed."""
    adapter = FailsWhenTimed()
    with pytest.raises(RuntimeError, match="singular"):
        stopwatch(adapter, Case(SCENE, method, Setting(dt_s)))
    assert adapter.closed == 1


@pytest.mark.parametrize(("method", "dt_s"), [("m1", 0.01), ("exact", None)])
def test_laps_are_timed_where_the_processor_time_is_limited(method: str, dt_s: float | None) -> None:
    """A lap of some microseconds has a time under `ulimit -t` too, where Linux counts whole ticks."""

    def shortest_lap() -> float:
        resource.setrlimit(resource.RLIMIT_CPU, (3600, 3600))
        watch = stopwatch(Reference(), Case(SCENE, method, Setting(dt_s)))
        return min(watch.lap() for _ in range(10))

    child = run_in_child(shortest_lap, 120.0)
    assert child.error is None
    assert child.value > 0.0


@pytest.mark.parametrize("do", ["record", "replay"])
def test_unknown_method_is_unsupported(do: str) -> None:
    """A request for a method of another version of the engine is refused in the same way by every request."""
    case = Case(SCENE, "none", Setting(0.1))
    answer = RequestHandler(Reference()).answer({"do": do, "case": case_messages.case_message(case)})
    assert (answer["outcome"], answer["message"]) == ("unsupported", "no method 'none'")
