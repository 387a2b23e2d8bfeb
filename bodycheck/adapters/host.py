"""The run's side of an engine: a worker process that may crash, hang, flood or swell, or a Python object."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import cached_property
from typing import Any, Protocol

from bodycheck.adapters import protocol
from bodycheck.adapters.contract import Adapter, Engine
from bodycheck.adapters.protocol import Message
from bodycheck.adapters.registry import registered_adapter
from bodycheck.adapters.worker import HANDED_OVER, Desk, handed_over
from bodycheck.errors import UnavailableError, WorkerLostError

INSIDE_WORKER = "BODYCHECK_WORKER"
"""Set in a worker's environment: a run must not be started from within one."""

_START_S = 120.0  # for an engine to be imported and announced
_LAST_OUTPUT = 4096  # bytes of what the engine printed that are kept
_SHOWN_OUTPUT = 400  # characters of it in a message
_PIECE = 1 << 20
_DYING_S = 5.0


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

    def close(self) -> None:
        """End it; calling it twice does nothing."""


def open_host(engine: str) -> Host:
    """Start a worker for the engine; one that cannot leave this process stays in it."""
    adapter = registered_adapter(engine)
    if adapter is None:
        return WorkerProcess(engine)
    line = handed_over(adapter)
    if line is None:
        return InProcess(adapter)
    host = WorkerProcess(HANDED_OVER, line)
    try:
        host.engine  # noqa: B018 - waits for the announcement
    except UnavailableError:
        return InProcess(adapter)
    except WorkerLostError:
        pass  # it is told to whoever asks next
    return host


def announced(engines: Sequence[str]) -> dict[str, Engine | str]:
    """Return the engines as their workers announce them, started side by side; or why one does not."""
    hosts = {name: open_host(name) for name in engines}
    found: dict[str, Engine | str] = {}
    for name, host in hosts.items():
        try:
            found[name] = host.engine
        except (UnavailableError, WorkerLostError) as error:
            found[name] = str(error)
        finally:
            host.close()
    return found


class Hosts:
    """The engines of one strand of a run: each is started when first needed, and again after it was lost."""

    def __init__(self) -> None:
        self._open: dict[str, Host] = {}
        self._lock, self._closed = threading.Lock(), False

    def __contains__(self, engine: str) -> bool:
        return engine in self._open

    def get(self, engine: str) -> Host:
        """Return the engine's host; WorkerLostError once this was stopped."""
        if engine not in self._open:
            host = open_host(engine)
            with self._lock:
                if not self._closed:
                    self._open[engine] = host
                    return host
            host.close()
        if self._closed:
            raise WorkerLostError("the run was stopped")
        return self._open[engine]

    def ask(self, engine: str, request: Message, timeout_s: float) -> Message:
        """Return the engine's answer; a lost worker and an engine that does not start are answers too.

        Raises WorkerLostError only where this was stopped meanwhile.
        """
        try:
            return self.get(engine).ask(request, timeout_s)
        except (WorkerLostError, UnavailableError) as lost:
            if self._closed:
                raise
            if host := self._open.pop(engine, None):
                host.close()
            timed_out = isinstance(lost, WorkerLostError) and lost.timed_out
            return {"outcome": "timeout" if timed_out else "failed", "message": str(lost)}

    def stop(self) -> None:
        """Kill the workers, from any thread: what is being asked of them ends with WorkerLostError."""
        with self._lock:
            self._closed = True
            for host in self._open.values():
                if host.pid is not None:
                    _kill(host.pid)

    def close(self) -> None:
        """End them all, from the thread that uses them."""
        self.stop()
        for host in self._open.values():
            host.close()


class InProcess:
    """An engine that exists in this process alone: the same requests, but nothing shields the run from it."""

    pid = None

    def __init__(self, adapter: Adapter) -> None:
        self.engine = Engine(adapter.name, adapter.version, adapter.methods, code="")
        self._desk = Desk(adapter)

    def ask(self, request: Message, timeout_s: float) -> Message:  # noqa: ARG002 - there is no way to stop it
        """Answer at once."""
        return self._desk.answer(request)

    def close(self) -> None:
        """Free what was prepared."""
        self._desk.close()


class WorkerProcess:
    """An engine in a process of its own, spawned, with limits on memory and on the time of each request."""

    def __init__(self, engine: str, first_line: bytes = b"") -> None:
        # the worker imports what this process can: a third party's engine may lie beside the user's script
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
            INSIDE_WORKER: "1",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "bodycheck.adapters.worker", engine, str(_memory_bytes())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            start_new_session=True,  # a Ctrl-C is for the run alone, which then ends its workers
        )
        self.pid = self._process.pid
        process: Any = self._process  # which has all three pipes, as it was asked to
        self._pipes: list[Any] = [process.stdin, process.stdout, process.stderr]
        for pipe in self._pipes:
            os.set_blocking(pipe.fileno(), False)
        self._unread, self._last_output, self._asked = bytearray(), b"", 0
        self._first_line = first_line

    @cached_property
    def engine(self) -> Engine:
        """What the worker announced, waited for when first asked for.

        Raises UnavailableError where the engine cannot be imported, WorkerLostError where nothing comes.
        """
        message = self._exchange(self._first_line, _START_S)
        if message.get("bodycheck") != protocol.VERSION:
            raise WorkerLostError(f"the worker speaks another protocol: {message.get('bodycheck')!r}")
        if "unavailable" in message:
            raise UnavailableError(str(message["unavailable"]))
        try:
            return protocol.engine_of(message)
        except protocol.ProtocolError as error:
            raise WorkerLostError(str(error)) from None

    def ask(self, request: Message, timeout_s: float) -> Message:
        """Return the answer to one request; UnavailableError or WorkerLostError where there is none."""
        assert self.engine  # announced before it is asked
        self._asked += 1
        self._last_output = b""
        answer = self._exchange(protocol.line_of({"id": self._asked, **request}), timeout_s)
        if answer.get("id") != self._asked:
            raise WorkerLostError(f"the worker answered request {answer.get('id')!r}, not {self._asked}")
        return answer

    def close(self) -> None:
        """Kill the process and all that it started."""
        if self._process.returncode is None:
            _kill(self._process.pid)
            self._process.wait()
        for pipe in self._pipes:
            pipe.close()

    def _exchange(self, sent: bytes, timeout_s: float) -> Message:
        """Send, and wait for one line; meanwhile drain what the engine prints, or it would block."""
        to_worker, answers, chatter = self._pipes
        end = time.monotonic() + timeout_s
        with selectors.DefaultSelector() as waiting:
            waiting.register(answers, selectors.EVENT_READ)
            waiting.register(chatter, selectors.EVENT_READ)
            if sent:
                waiting.register(to_worker, selectors.EVENT_WRITE)
            while not self._unread.endswith(b"\n"):
                left = end - time.monotonic()
                if left <= 0.0:
                    raise WorkerLostError(
                        self._with_output(f"no answer within {timeout_s:g} s"), timed_out=True
                    )
                for key, _ in waiting.select(left):
                    if key.fd == to_worker.fileno():
                        sent = self._sent(key.fd, sent)
                        if not sent:
                            waiting.unregister(to_worker)
                    elif key.fd == chatter.fileno():
                        if not self._heard(key.fd):
                            waiting.unregister(chatter)
                    else:
                        self._received(key.fd)
        line, self._unread = bytes(self._unread), bytearray()
        try:
            return protocol.message_of(line)
        except protocol.ProtocolError as error:
            raise WorkerLostError(self._with_output(str(error))) from None

    def _sent(self, fd: int, data: bytes) -> bytes:
        """Write what the pipe takes; return what is left."""
        try:
            return data[os.write(fd, data[:_PIECE]) :]
        except BlockingIOError:
            return data
        except BrokenPipeError:
            return b""  # the end of its output will tell how it died

    def _heard(self, fd: int) -> bool:
        """Keep the end of what the engine prints; False at its end."""
        try:
            piece = os.read(fd, _PIECE)
        except BlockingIOError:
            return True
        self._last_output = (self._last_output + piece)[-_LAST_OUTPUT:]
        return bool(piece)

    def _received(self, fd: int) -> None:
        piece = os.read(fd, _PIECE)
        if not piece:
            raise WorkerLostError(self._with_output(self._death()))
        if len(self._unread) + len(piece) > protocol.LARGEST_MESSAGE:
            raise WorkerLostError(f"an answer of more than {protocol.LARGEST_MESSAGE} bytes")
        self._unread += piece

    def _death(self) -> str:
        """Say how the worker ended."""
        try:
            code = self._process.wait(_DYING_S)
        except subprocess.TimeoutExpired:
            return "the worker closed its output and went on"
        while self._heard_last():
            pass
        if code < 0:
            return f"the worker died of {signal.Signals(-code).name}"
        return f"the worker ended itself with status {code}"

    def _heard_last(self) -> bool:
        chatter = self._pipes[2].fileno()
        before = self._last_output
        return self._heard(chatter) and self._last_output != before

    def _with_output(self, message: str) -> str:
        shown = " ".join(self._last_output.decode("utf-8", "replace").split())[-_SHOWN_OUTPUT:]
        return f"{message}; its last output: {shown}" if shown else message


def _kill(pid: int) -> None:
    """Kill a worker, which leads a process group of its own, and all that it started."""
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


def _memory_bytes() -> int:
    """What a worker may allocate: half of what the machine has."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
