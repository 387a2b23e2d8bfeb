"""Measure the cost of a case in addition to its stepping: messages to a worker, building, reading, measuring.

    python tools/overhead.py standard

Each method's case at its coarsest step goes through a run's own code with a worker, one at a time and without
a cache; then the same case is stepped in this process, and that time alone is subtracted. Workers are started
and their kernels loaded before. Truths and searches for the largest stable step are left out. Prints
milliseconds of processor time, the run's and the worker's, as the lowest tenth of fifty passes, because other
work on the machine can only increase it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from trials import command

from bodycheck.adapters.contract import Adapter, Engine
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.measurement.case import run_case
from bodycheck.reports.measurement.problem import Problem
from bodycheck.runs.selection import select

_PASSES = 50


class Stepped:
    """An adapter that measures the seconds its simulations and solvers spend stepping."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter, self.seconds = adapter, 0.0

    def __getattr__(self, name: str) -> Any:
        """Return the adapter's own attribute."""
        return getattr(self._adapter, name)

    def build(self, *requested: Any) -> Any:
        """Return a simulation that is timed."""
        return self._timed(self._adapter.build(*requested), "apply", "advance")

    def solver(self, *requested: Any) -> Any:
        """Return a solver that is timed."""
        return self._timed(self._adapter.solver(*requested), "solve")  # type: ignore[attr-defined]

    def _timed(self, held: Any, *names: str) -> Any:
        for name in names:
            setattr(held, name, self._clocked(getattr(held, name)))
        return held

    def _clocked(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def clocked(*given: Any) -> Any:
            begin = time.process_time()
            found = call(*given)
            self.seconds += time.process_time() - begin
            return found

        return clocked


def stepping(adapter: Adapter, case: Case) -> float:
    """Return the seconds of stepping alone."""
    passes = []
    for _ in range(_PASSES):
        stepped = Stepped(adapter)
        record(stepped, case)
        passes.append(stepped.seconds)
    return _undisturbed(passes)


def _undisturbed(passes: list[float]) -> float:
    """Return the lowest tenth, not the minimum: Linux sometimes counts a part of one pass with the next."""
    return float(np.quantile(passes, 0.1))


def spent(engine_pool: EnginePool, engine: Engine) -> float:
    """Return the processor time in s of this process and of the engine's worker, as Linux counts it."""
    worker = Path(f"/proc/{engine_pool.start(engine.name).pid}/schedstat").read_text(encoding="ascii")
    return time.process_time() + 1e-9 * int(worker.split()[0])


def overheads(scenarios: Sequence[str], engines: list[str] | None) -> dict[str, list[tuple[float, float]]]:
    """Return the milliseconds per case in addition to its stepping, by engine: all, and those of messages."""
    selection = select(scenarios, engines)
    engine_pool, answers = EnginePool(), Answers(None, None, 120.0)
    found: dict[str, list[tuple[float, float]]] = {}
    requested: list[tuple[float, Case]] = []

    def ask(engine: Engine, case: Case) -> Answer:
        begin = spent(engine_pool, engine)
        answer = answers.ask(engine_pool, engine, case)
        requested.append((spent(engine_pool, engine) - begin, case))
        return answer

    try:
        for how, scenario in selection.scenarios:
            problem = Problem.of(scenario, how)
            for engine, method in selection.methods:
                setting = selection.settings(scenario, engine, method)[0]
                passes = []
                requested.clear()
                for _ in range(1 + _PASSES):  # the first pass starts the worker and loads its kernels
                    begin = spent(engine_pool, engine)
                    result = run_case(problem, engine, method, setting, ask)
                    passes.append(spent(engine_pool, engine) - begin)
                if not result.ok:
                    continue
                whole, asking = (
                    _undisturbed(passes[1:]),
                    _undisturbed([seconds for seconds, _ in requested[1:]]),
                )
                alone = stepping(get_adapter(engine.name), requested[-1][1])
                found.setdefault(engine.name, []).append((1e3 * (whole - alone), 1e3 * (asking - alone)))
    finally:
        engine_pool.close()
    return found


def main(*scenarios: str, engine: str | None = None) -> None:
    """Print one line per engine, and one for all; engine: separated by commas, all by default."""
    found = overheads(scenarios or ("standard",), engine.split(",") if engine else None)
    print(f"{'engine':12s} {'cases':>5s} {'median':>7s} {'mean':>7s} {'90 %':>7s}   of it asking, median")
    for name, cases in [*found.items(), ("all", [case for each in found.values() for case in each])]:
        whole, asking = np.array(cases).T
        figures = (np.median(whole), np.mean(whole), np.quantile(whole, 0.9), np.median(asking))
        print(f"{name:12s} {len(cases):5d}" + "".join(f" {figure:7.2f}" for figure in figures))


if __name__ == "__main__":
    command(main)
