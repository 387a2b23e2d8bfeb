"""Engines behind a concurrent.futures.Executor: one picklable case in, one answer out."""

from __future__ import annotations

import platform
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, InvalidStateError, wait
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from bodycheck._util.errors import InputError, UnavailableError, WorkerLostError
from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.engine_names import Program
from bodycheck.adapters.registry import program_file, program_of, register_program
from bodycheck.adapters.workers import case_messages, protocol
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reference_impl.precompile import compile_kernels
from bodycheck.reference_impl.trees.tree_scene import TreeScene

_compiling = threading.Lock()
_compiled: set[tuple[str, bool, bool]] = set()


@dataclass(frozen=True)
class CaseRequest:
    """A request to an engine, which must have the version that the run announces.

    program: the engine's, if it is one, which the run was allowed to start.
    """

    engine: str
    version: str
    request: Message
    timeout_s: float
    program: Program | None = None

    @property
    def kind(self) -> tuple[str, str, str]:
        """Cases of one kind take a time that is proportional to their steps."""
        return self.engine, str(self.request["do"]), str(self.request["case"]["method"])

    @property
    def steps(self) -> float:
        """The number of steps of a case; 1 for a method without steps."""
        case = self.request["case"]
        return 1.0 if case["dt_s"] is None else float(case["scene"]["duration_s"] / case["dt_s"])


class _Thread:
    """Lives as long as a thread."""


class _Engines(threading.local):
    """The engines of one thread of an executor's worker, which end with the thread."""

    def __init__(self) -> None:
        self.pool, self._thread = EnginePool(), _Thread()
        weakref.finalize(self._thread, self.pool.close)


_engines = _Engines()


def answer_case(case_request: CaseRequest) -> Message:
    """Return an engine's answer with the build that gave it; runs in a worker of the executor.

    The engine runs in a process of its own, which is kept for the next case.
    """
    if case_request.engine == "reference":
        compile_for(case_request.request["case"])
    pool = _engines.pool
    found = announced_as(pool, case_request.engine, case_request.version, case_request.program)
    if isinstance(found, str):
        return {"outcome": "failed", "message": found}
    return {
        "build": found.build.id,
        **pool.ask(case_request.engine, case_request.request, case_request.timeout_s),
    }


def announced_as(engine_pool: EnginePool, name: str, version: str, program: Program | None) -> Engine | str:
    """Return the engine of this machine, or why it is not the one of the run; program: the engine's."""
    if program is not None:
        register_program(name, program, program_file(name))
    try:
        engine = engine_pool.announced(name)
    except (UnavailableError, WorkerLostError) as error:
        return str(error)
    if engine.version != version:
        return f"{name} {engine.version} on {platform.node()}, but {version} in the run"
    return engine


def compile_for(case: Message) -> None:
    """Compile the reference's kernels of a case, which would count towards its time limit otherwise."""
    scene = case_messages.scene_of(case["scene"])
    if isinstance(scene, TreeScene):
        return
    continuous = bool(scene.continuous_loads)
    stepped = case["dt_s"] is not None
    kind = (case["method"], continuous, not stepped and scene.is_free_rotation)
    with _compiling:
        if kind in _compiled:
            return
        if not stepped:
            compile_kernels([scene], [] if case["tolerance"] is None else [case["method"]])
        elif continuous:
            compile_kernels([scene], [case["method"]], unsolved=[])
        else:
            compile_kernels([], [case["method"]])
        _compiled.add(kind)


class ExecutorEngines:
    """The engines of a run on the workers of an executor.

    methods: those of the run, whose engines have the announced versions.
    """

    def __init__(self, executor: Executor, methods: Iterable[tuple[Engine, Method]]) -> None:
        self._executor = executor
        self._versions = {engine.name: engine.version for engine, _ in methods}
        self._stopped: Future[None] = Future()

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the answer to a request; whatever the executor raises makes this case fail.

        Raises WorkerLostError if the run was stopped, InputError if the executor is broken.
        """
        version = self._versions[engine]
        case_request = CaseRequest(engine, version, request, timeout_s, program_of(engine))
        try:
            future = self._executor.submit(answer_case, case_request)
            pending: list[Future[Any]] = [future, self._stopped]
            wait(pending, return_when=FIRST_COMPLETED)
            if not future.done():
                future.cancel()
                raise WorkerLostError("the run was stopped")
            # as from a worker: a mapping of plain data; whoever uses it checks its content
            return protocol.message_of(protocol.line_of(future.result()))
        except BrokenExecutor as error:
            raise InputError(f"the executor cannot run any more cases: {error}") from None
        except WorkerLostError:
            raise
        except Exception as error:  # noqa: BLE001 - an executor may raise anything; only this case fails
            text = protocol.one_line(f"{type(error).__name__}: {error}")
            return {"outcome": "failed", "message": f"executor: {text}"}

    def stop(self) -> None:
        """End the waiting for answers."""
        with suppress(InvalidStateError):  # a second call changes nothing
            self._stopped.set_result(None)


def run_batch(
    function: Callable[[Any], Any], arguments: Sequence[Any]
) -> list[tuple[float, Any, Exception | None]]:
    """Return (seconds, result, error) of a call for each argument; runs in a worker of a cluster."""
    results: list[tuple[float, Any, Exception | None]] = []
    for argument in arguments:
        begin = time.perf_counter()
        try:
            result, error = function(argument), None
        except Exception as raised:  # noqa: BLE001 - the error belongs to one call of the batch
            result, error = None, raised
        results.append((time.perf_counter() - begin, result, error))
    return results
