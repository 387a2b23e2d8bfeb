"""A method of an engine through bodycheck's own adapter, so that what is timed here is what a run times."""

from __future__ import annotations

from benchmarks.contenders.contender import Contender, step_counts
from benchmarks.problems import End, Problem
from bodycheck.adapters.contract import Adapter, Simulation
from bodycheck.reference_impl.wrench import wrench_between


class _Stepping:
    """All the steps from start to end in one call of the engine."""

    def __init__(self, simulation: Simulation, problem: Problem, steps: int) -> None:
        self._simulation, self._steps = simulation, steps
        self._wrench = wrench_between(problem.scene, 0.0, problem.scene.duration_s)

    def reset(self) -> None:
        """Go back to the initial state, the load acting."""
        self._simulation.reset()
        self._simulation.apply(self._wrench)

    def run(self) -> None:
        """Make the steps."""
        self._simulation.advance(self._steps)

    def end(self) -> End:
        """Read the engine's state."""
        reading = self._simulation.read()
        assert reading.quaternion is not None
        assert reading.omega_body is not None
        return reading.quaternion, reading.omega_body


def engine_contender(name: str, adapter: Adapter, method: str, fewest: int, most: int) -> Contender:
    """Tune a method by its number of equal steps."""

    def prepare(problem: Problem, steps: float) -> _Stepping:
        dt_s = problem.scene.duration_s / steps
        return _Stepping(adapter.build(problem.scene, method, dt_s), problem, int(steps))

    return Contender(name, adapter.version, "steps", step_counts(fewest, most), prepare)
