"""How fast: each case alone on one core, lap by lap, in turn with a yardstick of the reference."""

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
    """What is known of the machine while speeds were measured.

    core: the one that all of it ran on, None where processes cannot be pinned. spread: the yardstick's
    interquartile range over its median, the median over the cases: what is below it is noise.
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
    """Return the cases with their speed, those that ended well; nothing else runs meanwhile.

    passes: how often all of them are timed, one pass after the other. Where another machine's load shares the
    core, everything takes half as long again, or twice as long, for a second or for minutes, and then again
    does not: the quickest lap is as good as undisturbed if one of the passes was. case_done: told as
    often as there are cases, evenly over the passes.

    The yardstick is the reference's rk4 on the same scenario, at its finest listed step: relative_cpu is a
    case's quickest lap over the yardstick's, both measured in turn. What disturbs a lap makes it longer: on a
    busy machine the quickest laps of two runs differ by half as much as the medians do.
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
    """Return the laps of a case, measured now, or before this run was stopped; `again`: in any case now."""
    case = Case(problem.scenario.scene, result.columns["method"], result.setting)
    laps = None if again else answers.laps(engine, case)
    if laps is None:
        laps = clock.laps(problem, engine, case)
        answers.keep_laps(engine, case, laps)
    return laps


def _together(before: Message | None, laps: Message) -> Message:
    """Return the laps of a case in all passes so far; one pass without any does not spoil the others."""
    if before is None or "lost" in before:
        return laps
    if "lost" in laps:
        return before
    return {name: [*before[name], *laps[name]] for name in ("own_s", "yardstick_s")}


_LAP: Message = {"do": "lap"}


def _preparation(case: Case) -> Message:
    return {"do": "prepare", "case": case_messages.case_message(case)}


class _Clock:
    """Engines on one core, timed lap by lap, in turn with the yardstick."""

    def __init__(self, core: int | None, laps: int, timeout_s: float) -> None:
        self._engine_pool, self._laps, self._timeout_s = EnginePool(core), laps, timeout_s
        self._yardstick = _Yardstick(core, timeout_s)

    def laps(self, problem: Problem, engine: Engine, case: Case) -> Message:
        """Return the times of the case's laps and of the yardstick's between them, or why there are none.

        What fails is tried once more: a worker that somebody killed was not at fault.
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
    """The reference on the scenario that is being timed."""

    def __init__(self, core: int | None, timeout_s: float) -> None:
        self._engine_pool, self._timeout_s = EnginePool(core), timeout_s
        self._prepared: Problem | None = None

    def prepare(self, problem: Problem) -> None:
        """Make it ready, unless it is."""
        if self._prepared is not problem:
            engine, method = _YARDSTICK
            case = Case(problem.scenario.scene, method, Setting(dt_s=min(problem.scenario.steps)))
            answer = self._engine_pool.ask(engine, _preparation(case), self._timeout_s)
            self._prepared = problem if answer.get("outcome") == "ok" else None

    def lap(self) -> float | None:
        """Return one lap's time in s; None on a scenario that the yardstick cannot run."""
        if self._prepared is None:
            return None
        try:
            return protocol.lap_of(self._engine_pool.ask(_YARDSTICK[0], _LAP, self._timeout_s))
        except protocol.ProtocolError:
            self._prepared = None
            return None

    def close(self) -> None:
        """End its worker."""
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
    if (yardstick_s := min(laps["yardstick_s"], default=0.0)) > 0.0:  # a coarse clock may have shown nothing
        columns["relative_cpu"] = min(laps["own_s"]) / yardstick_s
    return replace(result, columns=columns)


def _spread(seconds: Sequence[float]) -> float:
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75]).tolist()
    return float((high - low) / median)


def _last_core() -> int | None:
    """Return the core to measure on: the last that this process may use; the system favours the first."""
    return max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
