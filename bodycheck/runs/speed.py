"""CPU time: each case alone on one core, lap by lap, alternating with the reference measurement."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError, UnavailableError, WorkerLostError
from bodycheck.adapters.contract import Engine, Setting
from bodycheck.adapters.engine_names import Program
from bodycheck.adapters.execution import Case
from bodycheck.adapters.registry import program_of
from bodycheck.adapters.workers import case_messages, protocol, received_messages
from bodycheck.adapters.workers.engine_pool import EnginePool, is_only_here
from bodycheck.adapters.workers.executors import announced_as, compile_for
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.scenarios.reader import AnyScenario

_LAPS = 5
_LAPS_OF_ONE_OF_MANY = 2
_REPEATED_LAPS, _REPEATED = 3, 0.02  # after how many laps, and within what, a second lap confirms the fastest
_REFERENCE = ("reference", "rk4")
_WARM_UP_S = 120.0  # time limit of starting the reference and compiling its method


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
    clock: Clock,
    *,
    timeout_s: float,
    passes: int,
    case_done: Callable[[], None],
    executor: Executor | None = None,
) -> tuple[tuple[CaseResult, ...], MachineNoise]:
    """Return the cases, with the speed of those that ended well; nothing else runs meanwhile.

    passes: how often all cases are timed, one pass after another. On a shared core the load of other
    processes makes everything take 1.5 or 2 times as long, for a second or for minutes at a time; the fastest
    lap is nearly undisturbed if one pass was. case_done: called once per case, evenly over the passes.
    executor: times the cases elsewhere, by workers that do nothing else meanwhile.

    The reference measurement is the reference's rk4 on the same scenario at its finest listed step.
    relative_cpu is the case's fastest lap over the fastest lap of the reference. The laps of both alternate;
    the last reference lap of a case also counts for the next case on the scenario. A disturbance can only
    lengthen a lap: on a busy machine the fastest laps of two runs differ half as much as their medians. Once
    a second lap of both confirms the fastest one, no more are timed.
    """
    by_name = {problem.scenario.name: problem for problem in problems}
    laps_each = _LAPS if passes == 1 else _LAPS_OF_ONE_OF_MANY
    timed = {
        index: _Timed.of(by_name[row["scenario"]], engines[row["engine"]], result, laps_each, timeout_s)
        for index, (row, result) in enumerate((result.columns, result) for result in cases)
        if result.ok
    }
    pairs = [(one.engine, one.case) for one in timed.values()]
    stored = answers.laps(pairs)
    found: dict[int, Message] = {} if stored is None else dict(zip(timed, stored, strict=True))
    done = 0
    for _ in range(passes if stored is None else 0):
        for index, laps in _one_pass(timed, found, clock, executor):
            found[index] = laps
            done += 1
            if done % passes == 0:
                case_done()
    if stored is None:
        answers.keep_laps(pairs, [found[index] for index in timed])
    for _ in range(len(cases) - done // passes):
        case_done()
    measured = tuple(
        _with_speed(result, found[index]) if index in found else result for index, result in enumerate(cases)
    )
    references = [laps["reference_s"] for laps in found.values() if "lost" not in laps]
    spreads = [_spread(seconds) for seconds in references if min(seconds, default=0.0) > 0.0]
    return measured, MachineNoise(clock.core, float(np.median(spreads)) if spreads else None)


@dataclass(frozen=True)
class TimingRequest:
    """A case to be timed, alternating with a case of the reference, as picklable data.

    version: of the engine, which must have it. laps: at most. timeout_s: time limit of one answer. program:
    the engine's, if it is one, which the run was allowed to start.
    """

    engine: str
    version: str
    case: Message
    reference: Message
    laps: int
    timeout_s: float
    program: Program | None = None


@dataclass(frozen=True, eq=False)
class _Timed:
    """A case of a run that is timed."""

    engine: Engine
    case: Case
    request: TimingRequest

    @classmethod
    def of(cls, problem: Problem, engine: Engine, result: CaseResult, laps: int, timeout_s: float) -> _Timed:
        scene = problem.scenario.scene
        case = Case(scene, result.columns["method"], result.setting)
        cases = case_messages.case_message(case), _reference_case(problem.scenario)
        program = program_of(engine.name)
        request = TimingRequest(engine.name, engine.version, *cases, laps, timeout_s, program)
        return cls(engine, case, request)


def _reference_case(scenario: AnyScenario) -> Message:
    case = Case(scenario.scene, _REFERENCE[1], Setting(dt_s=min(scenario.steps)))
    return case_messages.case_message(case)


def _one_pass(
    timed: Mapping[int, _Timed], found: Mapping[int, Message], clock: Clock, executor: Executor | None
) -> Iterator[tuple[int, Message]]:
    """Yield the laps of each case in all passes so far.

    found: the laps of the earlier passes.
    """

    def started(one: _Timed) -> Callable[[], Message]:
        if executor is None or is_only_here(one.engine.name):
            return partial(clock.laps, one.request)
        return partial(_laps_of, executor.submit(time_case, one.request))

    running = ((index, started(one)) for index, one in timed.items())
    for index, laps in running if executor is None else list(running):
        yield index, _merged(found.get(index), laps())


def _laps_of(future: Future[Any]) -> Message:
    """Return the laps of a case that an executor timed, whose answer may be anything; else why none exist."""
    try:
        found = protocol.message_of(protocol.line_of(future.result()))
        if "lost" not in found:
            return {
                name: [received_messages.lap_of({"outcome": "ok", "cpu_s": cpu_s}) for cpu_s in found[name]]
                for name in ("own_s", "reference_s")
            }
        return {"lost": protocol.one_line(protocol.text_of(found, "lost"))}
    except BrokenExecutor as error:
        raise InputError(f"the executor cannot time any more cases: {error}") from None
    except Exception as error:  # noqa: BLE001 - an executor may raise anything; only this case has no speed
        return {"lost": protocol.one_line(f"executor: {type(error).__name__}: {error}")}


def _merged(before: Message | None, laps: Message) -> Message:
    """Return the laps of a case in all passes so far; a pass that failed does not discard the others."""
    if before is None or "lost" in before:
        return laps
    if "lost" in laps:
        return before
    return {name: [*before[name], *laps[name]] for name in ("own_s", "reference_s")}


_LAP: Message = {"do": "lap"}


_timing = threading.Lock()


def time_case(request: TimingRequest) -> Message:
    """Return the laps of a case as a run's journal has them; runs in a worker of an executor.

    The engines are kept for the next case. Cases that are requested at the same time wait for one another.
    """
    compile_for(request.reference)
    if request.engine == _REFERENCE[0]:
        compile_for(request.case)
    with _timing:
        clock = _clock_of_this_process()
        found = clock.announced(request)
        return {"lost": protocol.one_line(found)} if isinstance(found, str) else clock.laps(request)


@cache
def _clock_of_this_process() -> Clock:
    return Clock(last_core())


class Clock:
    """Engines on one core, timed lap by lap, alternating with the reference measurement.

    core: None for any core.
    """

    def __init__(self, core: int | None) -> None:
        self.core = core
        self._engine_pool, self._reference = EnginePool(core), _Reference(core)

    def warm_up(self, scenario: AnyScenario) -> None:
        """Start the reference, and compile its method, while the run does something else.

        The first laps wait until that is done, so that nothing is compiled next to a case being timed.
        """
        self._reference.warm_up(_reference_case(scenario))

    def announced(self, request: TimingRequest) -> Engine | str:
        """Return the engine of a case, or why this machine does not have it."""
        return announced_as(self._engine_pool, request.engine, request.version, request.program)

    def laps(self, request: TimingRequest) -> Message:
        """Return the times in s of the case's laps and of the reference laps between them, or why none exist.

        A failure is retried once: a worker killed from outside is not at fault.
        """
        self._reference.prepare(request.reference, request.timeout_s)
        laps, failed = self._tried(request)
        return self._tried(request)[0] if failed else laps

    def _tried(self, request: TimingRequest) -> tuple[Message, bool]:
        message: Message = {"do": "prepare", "case": request.case}
        answer = self._engine_pool.ask(request.engine, message, request.timeout_s)
        own: list[float] = []
        others = self._reference.last_lap()
        while (
            answer.get("outcome") == "ok"
            and len(own) < request.laps
            and not (_is_repeated(own) and (_is_repeated(others) or not others))
        ):
            if len(others) <= len(own) and (other := self._reference.lap()) is not None:
                others.append(other)
            answer = self._engine_pool.ask(request.engine, _LAP, request.timeout_s)
            if answer.get("outcome") == "ok":
                try:
                    own.append(received_messages.lap_of(answer))
                except protocol.ProtocolError as error:
                    answer = {"outcome": "failed", "message": str(error)}
        if answer.get("outcome") != "ok":
            return {"lost": protocol.one_line(protocol.text_of(answer, "message"))}, answer.get(
                "outcome"
            ) == "failed"
        return {"own_s": own, "reference_s": others}, False

    def close(self) -> None:
        """End the workers."""
        self._engine_pool.close()
        self._reference.close()


class _Reference:
    """The reference measurement: the reference's rk4 on the scenario being timed."""

    def __init__(self, core: int | None) -> None:
        self._engine_pool, self._timeout_s = EnginePool(core), 0.0
        self._prepared: Message | None = None
        self._last: list[float] = []
        self._warming_up: threading.Thread | None = None

    def warm_up(self, case: Message) -> None:
        """Prepare the reference for this case in the background."""

        def prepare() -> None:
            with suppress(WorkerLostError):  # the run has ended meanwhile
                self._prepare(case, _WARM_UP_S)

        # started here, because a worker ends with the thread that started it
        with suppress(WorkerLostError, UnavailableError):  # reported when the first lap is requested
            self._engine_pool.start(_REFERENCE[0])
        self._warming_up = threading.Thread(target=prepare, daemon=True)
        self._warming_up.start()

    def prepare(self, case: Message, timeout_s: float) -> None:
        """Prepare the reference for this case, unless that is done already."""
        if self._warming_up is not None:
            self._warming_up.join()
            self._warming_up = None
        self._prepare(case, timeout_s)

    def _prepare(self, case: Message, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        if self._prepared != case:
            message: Message = {"do": "prepare", "case": case}
            answer = self._engine_pool.ask(_REFERENCE[0], message, timeout_s)
            self._prepared = case if answer.get("outcome") == "ok" else None
            self._last = []

    def last_lap(self) -> list[float]:
        """Return the time in s of the last lap of the prepared scenario, if there was one."""
        return list(self._last)

    def lap(self) -> float | None:
        """Return the time of one lap in s; None on a scenario that the reference method cannot run."""
        if self._prepared is None:
            return None
        try:
            seconds = received_messages.lap_of(self._engine_pool.ask(_REFERENCE[0], _LAP, self._timeout_s))
        except protocol.ProtocolError:
            self._prepared, self._last = None, []
            return None
        self._last = [seconds]
        return seconds

    def close(self) -> None:
        """End the worker."""
        self._engine_pool.stop()
        if self._warming_up is not None:
            self._warming_up.join()
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
    if (reference_s := min(laps["reference_s"], default=0.0)) > 0.0:  # a coarse clock may measure 0
        columns["relative_cpu"] = min(laps["own_s"]) / reference_s
    return replace(result, columns=columns)


def _is_repeated(seconds: Sequence[float]) -> bool:
    """Whether a second lap took as long as the fastest."""
    if len(seconds) < _REPEATED_LAPS:
        return False
    first, second, *_ = sorted(seconds)
    return second <= (1.0 + _REPEATED) * first


def _spread(seconds: Sequence[float]) -> float:
    low, median, high = np.quantile(seconds, [0.25, 0.5, 0.75]).tolist()
    return float((high - low) / median)


def last_core() -> int | None:
    """Return the core to measure on: the last one allowed, since the system prefers the first ones."""
    return max(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None
