"""Where the engines of a run are: each in a worker process, or, where it cannot leave this one, in it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Protocol, TypeAlias

from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.errors import UnavailableError, WorkerLostError
from bodycheck.adapters.contract import Adapter, Build, Engine
from bodycheck.adapters.registry import registered_adapter
from bodycheck.adapters.versions.environments import python_of
from bodycheck.adapters.versions.pins import pin_of
from bodycheck.adapters.workers import protocol
from bodycheck.adapters.workers.protocol import Message
from bodycheck.adapters.workers.worker import HANDED_OVER, RequestHandler, handed_over
from bodycheck.adapters.workers.worker_process import WorkerProcess


class Host(Protocol):
    """Where an engine's cases are run."""

    @property
    def engine(self) -> Engine:
        """What the engine announced; UnavailableError or WorkerLostError where it did not."""

    @property
    def pid(self) -> int | None:
        """The worker's process; None where there is none."""

    def ask(self, request: Message, timeout_s: float) -> Message:
        """Return the answer to one request; UnavailableError or WorkerLostError where there is none."""

    def kill(self) -> None:
        """End its process, if it has one, from any thread."""

    def close(self) -> None:
        """End it; calling it twice does nothing."""


Announcement: TypeAlias = Callable[[], dict[str, Engine | str]]
"""Waits for the engines as their workers announce them; or why one does not."""


def announced(engines: Sequence[str]) -> dict[str, Engine | str]:
    """Return the engines as their workers announce them, started side by side; or why one does not."""
    with announcing(engines) as announcement:
        return announcement()


@contextmanager
def announcing(engines: Sequence[str]) -> Iterator[Announcement]:
    """Start the engines' workers, which import them while other things are done, and end them at the end.

    One in a version of its own is started when it is waited for: its environment may have to be made first.
    """
    cache_directory()  # before any worker: where the cache cannot be written, they share what stands for it
    engine_pool = EnginePool()

    def announcement() -> dict[str, Engine | str]:
        return {name: _announced(engine_pool, name) for name in engines}

    try:
        for name in engines:
            if pin_of(name) is None:
                engine_pool.start(name)
        yield announcement
    finally:
        engine_pool.close()


def _announced(engine_pool: EnginePool, name: str) -> Engine | str:
    try:
        engine = engine_pool.announced(name)
    except UnavailableError as error:
        told = str(error)
        return told if told.startswith(name) else f"{name}: {told}"  # a worker does not know of its version
    except WorkerLostError as error:
        return f"{name} cannot be started: {error}"
    pin = pin_of(name)
    if engine.name != (name if pin is None else pin.engine):
        return f"{name} announces itself as {engine.name!r}"
    if pin is None:
        return engine
    if engine.version != pin.version:
        return f"{name} announces version {engine.version}: ask for {engine.name}=={engine.version}"
    return replace(engine, name=name)


class EnginePool:
    """The engines of one strand of a run: each is started when first needed, and again after it failed.

    core: the only one that they may use; None for any. turn: held by the thread that uses the pool, and
    released while an engine works, so that another thread measures meanwhile.
    """

    def __init__(self, core: int | None = None, turn: threading.Lock | None = None) -> None:
        self._core, self._turn = core, turn
        self._open: dict[str, Host] = {}
        self._lock, self._closed = threading.Lock(), False

    def __contains__(self, engine: str) -> bool:
        return engine in self._open

    def start(self, engine: str) -> Host:
        """Return the engine's host, without waiting for its announcement.

        Raises WorkerLostError once this was stopped and where no process can be started, UnavailableError
        where an engine in a version of its own has no environment and none can be made.
        """
        if engine in self._open:
            return self._open[engine]
        if pin := pin_of(engine):
            return self._kept(engine, WorkerProcess(pin.engine, python=python_of(pin)))
        adapter = registered_adapter(engine)
        if adapter is None:
            return self._kept(engine, WorkerProcess(engine))
        line = handed_over(adapter)
        return self._kept(engine, InProcess(adapter) if line is None else WorkerProcess(HANDED_OVER, line))

    def announced(self, engine: str) -> Engine:
        """Return what the engine announces; one that a worker cannot import is taken into this process.

        Raises UnavailableError where it cannot be imported at all, WorkerLostError where nothing comes.
        """
        try:
            return self.start(engine).engine
        except UnavailableError:
            adapter = registered_adapter(engine)
            if adapter is None:
                raise
            self._dismiss(engine)
            return self._kept(engine, InProcess(adapter)).engine

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the engine's answer; a lost worker and an engine that does not start are answers too.

        What fails in a worker that has served other cases may be their doing, and a worker that somebody
        killed was not at fault: both are asked once more, of a new worker. Raises WorkerLostError only where
        this was stopped meanwhile.
        """
        with released(self._turn):
            return self._asked_twice(engine, request, timeout_s)

    def _asked_twice(self, engine: str, request: Message, timeout_s: float) -> Message:
        used = engine in self._open
        answer, killed = self._asked(engine, request, timeout_s)
        if answer.get("outcome") != "failed" or not (used or killed) or request["do"] == "lap":
            return answer
        again, _ = self._asked(engine, request, timeout_s)
        if again.get("outcome") == "ok" and not killed:
            again["message"] = f"asked twice; first, in a worker that had served others: {answer['message']}"
        return again

    def _asked(self, engine: str, request: Message, timeout_s: float) -> tuple[Message, bool]:
        """Return the answer, and whether the worker was killed; one that failed is not kept."""
        try:
            self.announced(engine)
            host = self.start(engine)
            answer, killed = host.ask(request, timeout_s), False
            spoilt = answer.get("outcome") == "failed" and host.pid is not None
        except (WorkerLostError, UnavailableError) as lost:
            if self._closed:
                raise
            spoilt, killed = True, isinstance(lost, WorkerLostError) and lost.killed
            timed_out = isinstance(lost, WorkerLostError) and lost.timed_out
            answer = {"outcome": "timeout" if timed_out else "failed", "message": str(lost)}
        if spoilt:
            self._dismiss(engine)
        return answer, killed

    def _kept(self, engine: str, host: Host) -> Host:
        with self._lock:
            if not self._closed:
                self._open[engine] = host
                if self._core is not None and host.pid is not None:
                    with suppress(ProcessLookupError):
                        os.sched_setaffinity(host.pid, {self._core})
                return host
        host.close()
        raise WorkerLostError("the run was stopped")

    def _dismiss(self, engine: str) -> None:
        with self._lock:
            host = self._open.pop(engine, None)
        if host is not None:
            host.close()

    def stop(self) -> None:
        """Kill the workers, from any thread: what is being asked of them ends with WorkerLostError."""
        with self._lock:
            self._closed = True
            for host in self._open.values():
                host.kill()

    def close(self) -> None:
        """End them all, from the thread that uses them."""
        self.stop()
        for host in self._open.values():
            host.close()


@contextmanager
def released(lock: threading.Lock | None) -> Iterator[None]:
    """Release a lock that this thread holds, and take it again at the end."""
    if lock is None:
        yield
        return
    lock.release()
    try:
        yield
    finally:
        lock.acquire()


class InProcess:
    """An engine that exists in this process alone: the same requests, but nothing shields the run from it."""

    pid = None

    def __init__(self, adapter: Adapter) -> None:
        try:
            protocol.check_engine(adapter)
        except protocol.ProtocolError as error:
            raise UnavailableError(str(error)) from None
        self.engine = Engine(adapter.name, adapter.version, adapter.methods, Build(kind="handed over"))
        self._desk = RequestHandler(adapter, interruptible=True)

    def ask(self, request: Message, timeout_s: float) -> Message:  # noqa: ARG002 - there is no way to stop it
        """Answer at once."""
        return self._desk.answer(request)

    def kill(self) -> None:
        """Do nothing: it lives and dies with the run."""

    def close(self) -> None:
        """Free what was prepared."""
        self._desk.close()
