"""CPU time: each case alone on one core, lap by lap, alternating with the reference measurement."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Engine, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.workers import case_messages, protocol
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem

_LAPS = 5
_LAPS_OF_ONE_OF_MANY = 2
_YARDSTICK = ("reference", "rk4")


@dataclass(frozen=True)
class MachineNoise:
    """The noise of the machine while speeds were measured.

    core: the core that everything ran on; None where processes cannot be pinned. spread: interquartile range
    over median of the reference measurement, as the median over the cases; smaller differences are noise.
    """

    core: int | None
    spread: float | None


def measure_speeds(
    problems: Sequence[Problem],
    cases: Sequence[CaseResult],
    engines: Mapping[str, Engine],
    answers: Answers,
    *,
    timeout_s: float,
    passes: int,
    case_done: Callable[[], None],
) -> tuple[tuple[CaseResult, ...], MachineNoise]:
    """Return the cases, with the speed of those that ended well; nothing else runs meanwhile.

    passes: how often all cases are timed, one pass after another. On a shared core the load of other
    processes makes everything take 1.5 or 2 times as long, for a second or for minutes at a time; the fastest
    lap is nearly undisturbed if one pass was. case_done: called once per case, evenly over the passes.

    The reference measurement is the reference's rk4 on the same scenario at its finest listed step.
    relative_cpu is the case's fastest lap over the fastest lap of the reference, with the laps of both
    alternating. A disturbance can only lengthen a lap: on a busy machine the fastest laps of two runs differ
    half as much as their medians.
    """
    by_name = {problem.scenario.name: problem for problem in problems}
    found: dict[int, Message] = {}
    core = _last_core()
    laps_each = _LAPS if passes == 1 else _LAPS_OF_ONE_OF_MANY
    with closing(_Clock(core, laps_each, timeout_s)) as clock:
        for done, (number, (place, result)) in enumerate(product(range(passes), enumerate(cases)), start=1):
            if result.ok:
                problem, engine = by_name[result.columns["scenario"]], engines[result.columns["engine"]]
                laps = _laps(problem, engine, result, answers, clock, again=number > 0)
                found[place] = _together(found.get(place), laps)
            if done % passes == 0:
                case_done()
    timed = [
        _with_speed(result, found[place]) if place in found else result for place, result in enumerate(cases)
    ]
    yardsticks = [laps["yardstick_s"] for laps in found.values() if "lost" not in laps]
    spreads = [_spread(seconds) for seconds in yardsticks if min(seconds, default=0.0) > 0.0]
    return tuple(timed), MachineNoise(core, float(np.median(spreads)) if spreads else None)


def _laps(
    problem: Problem, engine: Engine, result: CaseResult, answers: Answers, clock: _Clock, *, again: bool
) -> Message:
    """Return the laps of a case, from this run's journal or measured now; `again`: always measure."""
    case = Case(problem.scenario.scene, result.columns["method"], result.setting)
    laps = None if again else answers.laps(engine, case)
    if laps is None:
        laps = clock.laps(problem, engine, case)
        answers.keep_laps(engine, case, laps)
    return laps


def _together(before: Message | None, laps: Message) -> Message:
    """Return the laps of a case in all passes so far; a pass that failed does not discard the others."""
    if before is None or "lost" in before:
        return laps
    if "lost" in laps:
        return before
    return {name: [*before[name], *laps[name]] for name in ("own_s", "yardstick_s")}


_LAP: Message = {"do": "lap"}


def _preparation(case: Case) -> Message:
    return {"do": "prepare", "case": case_messages.case_message(case)}


class _Clock:
    """Engines on one core, timed lap by lap, alternating with the reference measurement."""

    def __init__(self, core: int | None, laps: int, timeout_s: float) -> None:
        self._engine_pool, self._laps, self._timeout_s = EnginePool(core), laps, timeout_s
        self._yardstick = _Yardstick(core, timeout_s)

    def laps(self, problem: Problem, engine: Engine, case: Case) -> Message:
        """Return the times in s of the case's laps and of the reference laps between them, or why none exist.

        A failure is retried once: a worker killed from outside is not at fault.
        """
        self._yardstick.prepare(problem)
        laps, failed = self._tried(engine, case)
        return self._tried(engine, case)[0] if failed else laps

    def _tried(self, engine: Engine, case: Case) -> tuple[Message, bool]:
        answer = self._engine_pool.ask(engine.name, _preparation(case), self._timeout_s)
        own: list[float] = []
        others: list[float] = []
        while answer.get("outcome") == "ok" and len(own) < self._laps:
            if (other := self._yardstick.lap()) is not None:
                others.append(other)
            answer = self._engine_pool.ask(engine.name, _LAP, self._timeout_s)
            if answer.get("outcome") == "ok":
                try:
                    own.append(protocol.lap_of(answer))
                except protocol.ProtocolError as error:
                    answer = {"outcome": "failed", "message": str(error)}
        if answer.get("outcome") != "ok":
            return {"lost": protocol.shown(protocol.text_of(answer, "message"))}, answer.get(
                "outcome"
            ) == "failed"
        return {"own_s": own, "yardstick_s": others}, False

    def close(self) -> None:
        """End the workers."""
        self._engine_pool.close()
        self._yardstick.close()


class _Yardstick:
    """The reference measurement: the reference's rk4 on the scenario being timed."""

    def __init__(self, core: int | None, timeout_s: float) -> None:
        self._engine_pool, self._timeout_s = EnginePool(core), timeout_s
        self._prepared: Problem | None = None

    def prepare(self, problem: Problem) -> None:
        """Prepare the reference for this scenario, unless that is done already."""
        if self._prepared is not problem:
            engine, method = _YARDSTICK
            case = Case(problem.scenario.scene, method, Setting(dt_s=min(problem.scenario.steps)))
            answer = self._engine_pool.ask(engine, _preparation(case), self._timeout_s)
            self._prepared = problem if answer.get("outcome") == "ok" else None

    def lap(self) -> float | None:
        """Return the time of one lap in s; None on a scenario that the reference method cannot run."""
        if self._prepared is None:
            return None
        try:
            return protocol.lap_of(self._engine_pool.ask(_YARDSTICK[0], _LAP, self._timeout_s))
        except protocol.ProtocolError:
            self._prepared = None
            return None

    def close(self) -> None:
        """End the worker."""
        self._engine_pool.close()


def _with_speed(result: CaseResult, laps: Message) -> CaseResult:
    columns: dict[str, Any] = dict(result.columns)
    if "lost" in laps:
        notes = [columns["message"], f"speed not measured: {laps['lost']}"]
        return replace(result, columns={**columns, "message": "; ".join(note for note in notes if note)})
    low, median, high = np.quantile(laps["own_s"], [0.25, 0.5, 0.75]).tolist()
    columns |= {"cpu_s": median, "cpu_s_low": low, "cpu_s_high": high}
    if result.dt_s is not None:
        columns["ns_per_step"] = 1e9 * median / columns["steps"]
    if (yardstick_s := min(laps["yardstick_s"], default=0.0)) > 0.0:  # a coarse clock may measure 0
        columns["relative_cpu"] = min(laps["own_s"]) / yardstick_s
    return replace(result, columns=columns)


def _spread(seconds: Sequence[float]) -> float:
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75]).tolist()
    return float((high - low) / median)


def _last_core() -> int | None:
    """Return the core to measure on: the last one allowed, since the system prefers the first ones."""
    return max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
