"""The engines of a run: each in a worker process, or in this process if it cannot be moved to a worker."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Protocol, TypeAlias

from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.errors import UnavailableError, WorkerLostError
from bodycheck.adapters.contract import Adapter, Build, Engine
from bodycheck.adapters.engine_names import announced_names, is_command, is_program, pin_of
from bodycheck.adapters.registry import program_of, registered_adapter
from bodycheck.adapters.versions.environments import needed_environment, program_in, python_of
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.protocol import Message
from bodycheck.adapters.workers.worker import HANDED_OVER, RequestHandler, handed_over
from bodycheck.adapters.workers.worker_process import WorkerProcess


class Host(Protocol):
    """Runs the cases of one engine."""

    @property
    def engine(self) -> Engine:
        """The announced engine; raises UnavailableError or WorkerLostError if there is no announcement."""

    @property
    def pid(self) -> int | None:
        """The process id of the worker; None if there is no worker."""

    def ask(self, request: Message, timeout_s: float) -> Message:
        """Return the answer to a request; raises UnavailableError or WorkerLostError if there is none."""

    def kill(self) -> None:
        """Kill the worker process, if there is one, from any thread."""

    def close(self) -> None:
        """End the host; a second call does nothing."""


class RemoteEngines(Protocol):
    """Engines on other machines, or in the processes of an executor; used by several threads."""

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the engine's answer as EnginePool.ask does; raises WorkerLostError once stopped."""

    def stop(self) -> None:
        """End the waiting for answers, from any thread."""


Announcement: TypeAlias = Callable[[], dict[str, Engine | str]]
"""Waits for the announcements and returns name -> engine, or why it is unavailable."""


def announced(engines: Sequence[str]) -> dict[str, Engine | str]:
    """Start the engines' workers in parallel, and return name -> engine, or why it is unavailable."""
    with announcing(engines) as announcement:
        return announcement()


@contextmanager
def announcing(engines: Sequence[str]) -> Iterator[Announcement]:
    """Start the engines' workers, which import them in the background, and end them with the with block.

    An engine in an environment starts only when waited for, because that may have to be made.
    """
    cache_directory()  # before any worker, so that all share the temporary folder of an unwritable cache
    engine_pool = EnginePool()

    def announcement() -> dict[str, Engine | str]:
        found = {name: _announced(engine_pool, name) for name in engines}
        started = {name: engine for name, engine in found.items() if isinstance(engine, Engine)}
        own = {name: engine_pool.announced(name).name for name in started if is_command(name)}
        named = {name: replace(started[name], name=own) for name, own in announced_names(own).items()}
        return {**found, **named}

    try:
        for name in engines:
            if needed_environment(name) is None:
                engine_pool.start(name)
        yield announcement
    finally:
        engine_pool.close()


def _without_zeros(version: str | None) -> str:
    """4.6.0 -> 4.6, the same release."""
    return re.sub(r"(\.0)+$", "", version or "")


def _announced(engine_pool: EnginePool, name: str) -> Engine | str:
    """Return the engine, started once more if its worker was killed from outside, or why there is none."""
    try:
        try:
            engine = engine_pool.announced(name)
        except WorkerLostError as lost:
            if not lost.killed:
                raise
            engine_pool.restart(name)
            engine = engine_pool.announced(name)
    except UnavailableError as error:
        message = str(error)
        return message if message.startswith(name) else f"{name}: {message}"  # a worker does not know its pin
    except WorkerLostError as error:
        return f"{name} cannot be started: {error}"
    pin = pin_of(name)
    if pin is None and is_program(name):  # its claim to be a release is not verified
        kind = "plug-in" if engine.build.kind == "installed" else engine.build.kind
        return replace(engine, name=name, build=replace(engine.build, kind=kind))
    if engine.name != (name if pin is None else pin.engine):
        return f"{name} announces itself as {engine.name!r}"
    if pin is None:
        return engine
    if _without_zeros(engine.version) != _without_zeros(pin.version):
        return f"{name} announces version {engine.version}; request {engine.name}=={engine.version}"
    return replace(engine, name=name)


def is_only_here(engine: str) -> bool:
    """Whether an engine was passed to register_adapter, so that other machines do not have it."""
    return registered_adapter(engine) is not None


class EnginePool:
    """The engines of one thread of a run: each starts when first needed, and again after a failure.

    core: the only processor core that they may use; None for any. remote: answers for all engines but those
    that were passed to register_adapter, which only this process has.
    """

    def __init__(self, core: int | None = None, remote: RemoteEngines | None = None) -> None:
        self._core, self._remote = core, remote
        self._open: dict[str, Host] = {}
        self._lock, self._closed = threading.Lock(), False

    def __contains__(self, engine: str) -> bool:
        return engine in self._open

    def start(self, engine: str) -> Host:
        """Return the engine's host, without waiting for its announcement.

        Raises WorkerLostError if the pool was stopped or no process can be started, UnavailableError if the
        environment of an engine cannot be made.
        """
        if engine in self._open:
            return self._open[engine]
        if pin := needed_environment(engine):
            program = program_in(pin)
            python = None if program else python_of(pin)
            return self._registered(engine, WorkerProcess(pin.engine, python=python, program=program))
        adapter = registered_adapter(engine)
        if adapter is None:
            return self._registered(engine, WorkerProcess(engine, program=program_of(engine)))
        line = handed_over(adapter)
        return self._registered(
            engine, InProcess(adapter) if line is None else WorkerProcess(HANDED_OVER, line)
        )

    def announced(self, engine: str) -> Engine:
        """Return the announced engine; run a registered one that no worker can import in this process.

        Raises UnavailableError if the engine cannot be imported, WorkerLostError if nothing is announced.
        """
        try:
            return self.start(engine).engine
        except UnavailableError:
            adapter = registered_adapter(engine)
            if adapter is None:
                raise
            self.restart(engine)
            return self._registered(engine, InProcess(adapter)).engine

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the engine's answer; a lost worker or an engine that does not start gives a failed answer.

        Run a failed case once more in a new worker if the worker had run other cases, which may have caused
        the failure, or was killed from outside. Raises WorkerLostError only if the pool was stopped.
        """
        if self._remote is not None and not is_only_here(engine):
            return self._remote.ask(engine, request, timeout_s)
        used = engine in self._open
        answer, killed = self._request(engine, request, timeout_s)
        if answer.get("outcome") != "failed" or not (used or killed) or request["do"] == "lap":
            return answer
        again, _ = self._request(engine, request, timeout_s)
        if again.get("outcome") == "ok" and not killed:
            again["message"] = f"ran twice; failed in a worker that had run other cases: {answer['message']}"
        return again

    def _request(self, engine: str, request: Message, timeout_s: float) -> tuple[Message, bool]:
        """Return the answer and whether the worker was killed; end a worker that failed."""
        try:
            self.announced(engine)
            host = self.start(engine)
            answer, killed = host.ask(request, timeout_s), False
            must_restart = answer.get("outcome") == "failed" and host.pid is not None
        except (WorkerLostError, UnavailableError) as lost:
            if self._closed:
                raise
            must_restart, killed = True, isinstance(lost, WorkerLostError) and lost.killed
            timed_out = isinstance(lost, WorkerLostError) and lost.timed_out
            answer = {"outcome": "timeout" if timed_out else "failed", "message": str(lost)}
        if must_restart:
            self.restart(engine)
        return answer, killed

    def _registered(self, engine: str, host: Host) -> Host:
        with self._lock:
            if not self._closed:
                self._open[engine] = host
                if self._core is not None and host.pid is not None:
                    with suppress(ProcessLookupError):
                        os.sched_setaffinity(host.pid, {self._core})
                return host
        host.close()
        raise WorkerLostError("the run was stopped")

    def restart(self, engine: str) -> None:
        """End the engine's worker, so that its next case runs in a new process."""
        with self._lock:
            host = self._open.pop(engine, None)
        if host is not None:
            host.close()

    def stop(self) -> None:
        """Kill the workers, from any thread; pending requests raise WorkerLostError."""
        with self._lock:
            self._closed = True
            for host in self._open.values():
                host.kill()

    def close(self) -> None:
        """End all hosts, from the thread that uses them."""
        self.stop()
        for host in self._open.values():
            host.close()


class InProcess:
    """An engine that exists in this process only: the same requests, but without isolation from the run.

    One answers at a time, whichever thread asks: its functions may keep work arrays between their calls.
    """

    pid = None
    _answering = threading.Lock()

    def __init__(self, adapter: Adapter) -> None:
        try:
            received_messages.check_engine(adapter)
        except protocol.ProtocolError as error:
            raise UnavailableError(str(error)) from None
        self.engine = Engine(adapter.name, adapter.version, adapter.methods, Build(kind="handed over"))
        self._handler, self._killed = RequestHandler(adapter, interruptible=True), False

    def ask(self, request: Message, timeout_s: float) -> Message:  # noqa: ARG002 - it cannot be stopped
        """Return the answer; the time limit has no effect."""
        with self._answering:
            if self._killed:
                raise WorkerLostError("the run was stopped")
            return self._handler.answer(request)

    def kill(self) -> None:
        """Answer no further request: there is no process to kill."""
        self._killed = True

    def close(self) -> None:
        """Free the prepared case."""
        self._handler.close()
