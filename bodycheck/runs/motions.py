"""Run the motions of a selection on parallel threads: studies of scenarios, examinations of methods."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.workers.engine_pool import EnginePool, RemoteEngines
from bodycheck.adapters.workers.executors import ExecutorEngines
from bodycheck.adapters.workers.protocol import Message
from bodycheck.examine.probes.examination import examined, replayed
from bodycheck.reports.cache.answers import Answers, EngineClient, scene_key
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.study import Study, restored, stored_form, study
from bodycheck.reports.run_files.run_tables import MethodKey
from bodycheck.reports.run_files.sentinels import Sentinel
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import Progress
from bodycheck.runs.selection import Selection
from bodycheck.scenarios.reader import AnyScenario


@dataclass(frozen=True, eq=False)
class Task:
    """Work with one engine: its expected cost, in any unit, and what to do with a thread's engine pool."""

    engine: str
    cost: float
    do: Callable[[EnginePool], None]


class _ThreadEngines(EnginePool):
    """The engines of one thread, which holds the lock and releases it while an engine works."""

    def __init__(self, lock: threading.Lock, remote: RemoteEngines | None) -> None:
        super().__init__(remote=remote)
        self._measuring = lock

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        self._measuring.release()
        try:
            return super().ask(engine, request, timeout_s)
        finally:
            self._measuring.acquire()


class _TaskQueue:
    """The remaining tasks, most expensive first; tasks of an engine that the thread already runs go first."""

    def __init__(self, tasks: Sequence[Task]) -> None:
        self._open = sorted(tasks, key=lambda task: task.cost)
        self._lock = threading.Lock()

    def next(self, engine_pool: EnginePool) -> Task | None:
        with self._lock:
            if not self._open:
                return None
            running = [i for i, task in enumerate(self._open) if task.engine in engine_pool]
            return self._open.pop(running[-1] if running else self._farthest_behind())

    def _farthest_behind(self) -> int:
        """Return the index of the most expensive task of the engine with the most work left."""
        left: dict[str, float] = {}
        for task in self._open:
            left[task.engine] = left.get(task.engine, 0.0) + task.cost
        behind = max(left, key=lambda engine: left[engine])
        return max(i for i, task in enumerate(self._open) if task.engine == behind)

    def clear(self) -> None:
        with self._lock:
            self._open.clear()


def run_tasks(tasks: Sequence[Task], jobs: int, remote: RemoteEngines | None) -> None:
    """Run all tasks, `jobs` at a time; remote: engines elsewhere, which answer instead of worker processes.

    An exception in one task ends the others and is raised here, and so is a keyboard interrupt.
    """
    queue, raised = _TaskQueue(tasks), []
    # with the GIL, two threads that measure would only take turns within each sample
    measuring = threading.Lock()
    engine_pools = [_ThreadEngines(measuring, remote) for _ in range(max(1, min(jobs, len(tasks))))]
    ended = threading.Semaphore(0)

    def work(engine_pool: EnginePool) -> None:
        try:
            while task := queue.next(engine_pool):
                with measuring:
                    task.do(engine_pool)
        except BaseException as error:  # noqa: BLE001 - raised again by the waiting thread
            raised.append(error)
            queue.clear()
        finally:
            engine_pool.close()
            ended.release()

    threads = [
        threading.Thread(target=work, args=(engine_pool,), daemon=True) for engine_pool in engine_pools
    ]
    for thread in threads:
        thread.start()
    try:
        for _ in threads:
            ended.acquire()
    finally:
        queue.clear()
        if remote is not None:
            remote.stop()
        for engine_pool in engine_pools:
            engine_pool.stop()
        for thread in threads:
            thread.join()
    if raised:
        raise raised[0]


_WEIGHTS = {"reference": 0.02}
"""Cost of a right-hand side relative to a typical engine's; used only to order the tasks."""


@dataclass(frozen=True)
class RecordedMotions:
    """The studies of all scenarios by all methods, rows of methods alone by table, a shard's sentinels."""

    studies: list[Study]
    rows: dict[str, list[dict[str, Any]]]
    sentinels: list[Sentinel]


def run_motions(
    selection: Selection,
    problems: Sequence[Problem],
    answers: Answers,
    options: Request,
    progress: Progress,
) -> RecordedMotions:
    """Run every scenario by every method, and each method's probes, fingerprint and laws, in parallel."""
    pairs = [
        (problem, engine, method)
        for problem in problems
        for engine, method in selection.methods
        if selection.runs_on(problem.scenario, engine, method)
    ]
    probed = [pair for pair in selection.methods if selection.probes(*pair)]
    studies, full = _Studies(selection, answers, options, progress), selection.full
    done: dict[int, Study] = {}
    rows: dict[MethodKey, Message] = {}
    replays: dict[str, Message] = {}
    compared: dict[int, Sentinel] = {}

    def measure(index: int, problem: Problem, engine: Engine, method: Method) -> Task:
        def do(engine_pool: EnginePool) -> None:
            progress.task_started(f"{engine.name}:{method.name} on {problem.scenario.name}")
            done[index] = studies.make(engine_pool, problem, engine, method)

        return Task(engine.name, studies.cost(problem, engine, method), do)

    def examine(engine: Engine, method: Method) -> Task:
        topic = f"examination of {method.name}{' with laws' if options.laws else ''}"

        def do(engine_pool: EnginePool) -> None:
            progress.task_started(f"examining {engine.name}:{method.name}")
            derive = partial(examined, engine, method, laws=options.laws)
            rows[engine.name, method.name] = answers.derived(engine_pool, engine, topic, derive)

        return Task(engine.name, 0.0, do)  # cheap, so it runs late

    def replay(engine: Engine) -> Task:
        methods = [method for of, method in probed if of is engine]
        topic = f"replays of {', '.join(method.name for method in methods)}"

        def do(engine_pool: EnginePool) -> None:
            progress.task_started(f"repeating motions of {engine.name}")
            derive = partial(replayed, engine, methods)
            replays[engine.name] = answers.derived(engine_pool, engine, topic, derive)

        return Task(engine.name, -1.0, do)  # last of all, as it ends the engine's worker

    def repeat(index: int, scenario: AnyScenario, engine: Engine, method: Method, setting: Setting) -> Task:
        def do(engine_pool: EnginePool) -> None:
            answer = answers.sentinel(engine_pool, engine, Case(scenario.scene, method.name, setting))
            compared[index] = Sentinel.of(scenario.name, engine, method, setting, answer)

        return Task(engine.name, 0.0, do)

    tasks = [measure(index, *pair) for index, pair in enumerate(pairs)]
    tasks += [examine(*pair) for pair in probed]
    tasks += [replay(engine) for engine in dict.fromkeys(engine for engine, _ in probed if options.laws)]
    tasks += [repeat(index, *case) for index, case in enumerate([] if full is None else full.sentinels())]
    remote = None if options.executor is None else ExecutorEngines(options.executor, selection.methods)
    run_tasks(tasks, options.workers, remote)

    def of_methods(table: str) -> Iterator[dict[str, Any]]:
        for engine, method in probed:
            yield from rows[engine.name, method.name][table]
            if table == "laws" and options.laws:
                yield from replays[engine.name][method.name]

    return RecordedMotions(
        [done[index] for index in range(len(pairs))],
        {table: list(of_methods(table)) for table in ("probes", "fingerprints", "laws")},
        [compared[index] for index in sorted(compared)],
    )


@dataclass(frozen=True, eq=False)
class _Studies:
    """How the studies of a run are made."""

    selection: Selection
    answers: Answers
    options: Request
    progress: Progress

    def cost(self, problem: Problem, engine: Engine, method: Method) -> float:
        """Return the cost of a study relative to the others."""
        settings = self.selection.settings(problem.scenario, engine, method)
        steps = sum(problem.scenario.duration_s / one.dt_s for one in settings if one.dt_s is not None)
        return steps * (method.evaluations or 1) * _WEIGHTS.get(engine.name, 1.0)

    def make(self, engine_pool: EnginePool, problem: Problem, engine: Engine, method: Method) -> Study:
        """Study a method on a scenario, or take what an earlier run measured on the same motions."""
        client, scenario, adaptive = (
            EngineClient(self.answers, engine_pool),
            problem.scenario,
            self.selection.is_adaptive,
        )
        settings = self.selection.settings(scenario, engine, method)
        topic = {
            "study": method.name,
            "scenario": [problem.scenario_spec, scenario.name, scenario.family],
            "scene": scene_key(scenario.scene),
            "settings": [vars(setting) for setting in settings],
            "adaptive": adaptive,
        }
        kwargs: dict[str, Any] = {
            "adaptive": adaptive,
            "ask": client.ask,
            "search": partial(self.answers.search, engine_pool) if self.options.stable_steps else None,
            "case_done": self.progress.case_done,
        }
        stored = self.answers.known(engine, topic)
        found = None if stored is None else restored(stored, problem, engine, method, **kwargs)
        if found is None:
            found = study(problem, engine, method, settings, **kwargs)
            self.answers.keep(engine, topic, stored_form(found), client)
        return found
