"""The run's end of a worker process, which may crash, hang, flood its output or exhaust memory."""

from __future__ import annotations

import os
import selectors
import signal
import subprocess
import sys
import time
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from bodycheck._util.child_python import child_python
from bodycheck._util.errors import UnavailableError, WorkerLostError
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.engine_names import Program
from bodycheck.adapters.workers import launcher, protocol, received_messages, worker_bootstrap
from bodycheck.adapters.workers.launcher import RUN_PID
from bodycheck.adapters.workers.protocol import Message

_START_S = 120.0  # time limit for an engine to be imported and announced
_LAST_OUTPUT = 4096  # bytes of the engine's last output that are stored
_MAX_OUTPUT = 400  # characters of it in a message
_PIECE = 1 << 20
_EXIT_WAIT_S = 5.0
_LONGEST_WAIT_S = 3600.0  # per select, because selectors limit their timeout
_MIN_MEMORY = 2 << 30


class WorkerProcess:
    """An engine in its own process, with limits on memory and on the time of each request.

    python: the interpreter of an environment, which need not have bodycheck; None for the current one.
    program: a program that speaks the protocol itself, in place of bodycheck's worker.
    Raises WorkerLostError if the system cannot start a process.
    """

    def __init__(
        self,
        engine: str,
        first_line: bytes = b"",
        *,
        python: Path | None = None,
        program: Program | None = None,
    ) -> None:
        environment = {**os.environ, RUN_PID: str(os.getpid())}
        memory = str(_memory_bytes())
        if program is not None:
            environment |= program.environment
            command = [sys.executable, "-I", str(Path(launcher.__file__).resolve()), memory, *program.command]
        elif python is None:
            # the worker must import what this process can: an engine may lie next to the user's script
            command, variables = child_python("bodycheck.adapters.workers.worker", engine, memory)
            environment |= variables
        else:
            environment.pop("PYTHONPATH", None)  # it may contain another version of the engine
            command = [str(python), "-P", str(Path(worker_bootstrap.__file__).resolve()), engine, memory]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=environment,
                start_new_session=True,  # only the run receives Ctrl-C; it then ends its workers
            )
        except OSError as error:  # no more processes, or no more memory
            raise WorkerLostError(f"no worker can be started: {error.strerror or error}") from None
        self.pid = self._process.pid
        # watch the process itself, because a process that it left behind may hold its pipes open
        self._ending = os.pidfd_open(self.pid) if hasattr(os, "pidfd_open") else None
        process: Any = self._process  # has all three pipes, which its type leaves optional
        self._pipes: list[Any] = [process.stdin, process.stdout, process.stderr]
        for pipe in self._pipes:
            os.set_blocking(pipe.fileno(), False)
        self._selector = selectors.DefaultSelector()
        for source in (*self._pipes[1:], self._ending):
            if source is not None:
                self._selector.register(source, selectors.EVENT_READ)
        self._unread, self._last_output, self._request_id = bytearray(), b"", 0
        self._first_line, self._open = first_line, True

    @cached_property
    def engine(self) -> Engine:
        """The announced engine; the first access waits for the announcement.

        Raises UnavailableError if the engine cannot be imported, WorkerLostError if nothing is announced.
        """
        message = self._exchange(self._first_line, _START_S, protocol.LONGEST_ANNOUNCEMENT)
        if message.get("bodycheck") != protocol.VERSION:
            received = protocol.one_line(repr(message.get("bodycheck")))
            raise WorkerLostError(f"the worker uses another protocol version: {received}")
        if "unavailable" in message:
            raise UnavailableError(protocol.one_line(protocol.text_of(message, "unavailable")))
        try:
            engine, self._max_request = received_messages.engine_of(message)
        except protocol.ProtocolError as error:
            raise WorkerLostError(str(error)) from None
        return engine

    def ask(self, request: Message, timeout_s: float) -> Message:
        """Return the answer to a request; raises UnavailableError or WorkerLostError if there is none."""
        self.engine  # noqa: B018 - wait for the announcement first
        self._request_id += 1
        self._last_output = b""
        line = protocol.line_of({"id": self._request_id, **request})
        if len(line) > self._max_request:
            return {
                "outcome": "failed",
                "message": f"a request of {len(line)} bytes (limit: {self._max_request})",
            }
        answer = self._exchange(line, timeout_s, protocol.answer_limit_of(request))
        if answer.get("id") != self._request_id:
            received = protocol.one_line(repr(answer.get("id")))
            raise WorkerLostError(f"the worker answered request {received}, not {self._request_id}")
        answer.setdefault("build", self.engine.build.id)
        if answer.get("outcome") == "failed":
            answer["message"] = self._with_output(protocol.text_of(answer, "message"))
        return answer

    def close(self) -> None:
        """Kill the process and all that it started; a second call does nothing."""
        if self._open:
            self.kill()
            self._open = False
            self._process.wait()
            self._selector.close()
            for pipe in self._pipes:
                pipe.close()
            if self._ending is not None:
                os.close(self._ending)

    def kill(self) -> None:
        """Kill the process group of the worker, which includes all that it started, from any thread."""
        if not self._open:
            return  # its process id may have been reused
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)

    def _exchange(self, sent: bytes, timeout_s: float, max_bytes: int) -> Message:
        """Send a line, and wait for one line of at most `max_bytes` bytes.

        Meanwhile read what the engine prints, because a full pipe would block it.
        """
        to_worker, answers, output = (pipe.fileno() for pipe in self._pipes)
        end = time.monotonic() + timeout_s
        unsent = self._left_of(memoryview(sent), to_worker)
        if unsent and to_worker not in self._selector.get_map():  # it is if an earlier exchange timed out
            self._selector.register(to_worker, selectors.EVENT_WRITE)
        while not self._unread.endswith(b"\n"):
            left = end - time.monotonic()
            if left <= 0.0:
                late = self._with_output(f"no answer within {timeout_s:g} s")
                raise WorkerLostError(late, timed_out=True)
            ready = {key.fd for key, _ in self._selector.select(min(left, _LONGEST_WAIT_S))}
            if to_worker in ready:
                unsent = self._left_of(unsent, to_worker)
                if not unsent:
                    self._selector.unregister(to_worker)
            if output in ready and not self._read_output():
                self._selector.unregister(output)
            if answers in ready:
                self._read_answer(answers, max_bytes)
            elif self._ending in ready:
                raise self._end_error()
        line, self._unread = bytes(self._unread), bytearray()
        self._read_output()  # output printed before the answer
        try:
            return protocol.message_of(line)
        except protocol.ProtocolError as error:
            raise WorkerLostError(self._with_output(str(error))) from None

    def _left_of(self, data: memoryview, fd: int) -> memoryview:
        """Write what the pipe accepts and return the rest as a view; copying would take quadratic time."""
        try:
            return data[os.write(fd, data[:_PIECE]) :]
        except BlockingIOError:
            return data
        except BrokenPipeError:
            return data[:0]  # the end of its output will show how it died

    def _read_output(self) -> bool:
        """Store the end of what the engine prints; return False once its output has ended."""
        try:
            piece = os.read(self._pipes[2].fileno(), _PIECE)
        except BlockingIOError:
            return True
        self._last_output = (self._last_output + piece)[-_LAST_OUTPUT:]
        return bool(piece)

    def _read_answer(self, fd: int, max_bytes: int) -> None:
        piece = os.read(fd, _PIECE)
        if not piece:
            raise self._end_error()
        if len(self._unread) + len(piece) > max_bytes:
            raise WorkerLostError(f"an answer of more than {max_bytes} bytes")
        self._unread += piece

    def _end_error(self) -> WorkerLostError:
        """Return an error that says how the worker ended."""
        try:
            code = self._process.wait(_EXIT_WAIT_S)
        except subprocess.TimeoutExpired:
            return WorkerLostError(self._with_output("the worker closed its output and kept running"))
        self.kill()  # processes that it left behind, which could keep printing
        self._read_output()
        if code < 0:
            how = f"the worker was killed by {signal.Signals(-code).name}"
            return WorkerLostError(self._with_output(how), killed=-code == signal.SIGKILL)
        return WorkerLostError(self._with_output(f"the worker exited with status {code}"))

    def _with_output(self, message: str) -> str:
        text = protocol.one_line(self._last_output.decode("utf-8", "replace"))[-_MAX_OUTPUT:]
        return f"{message}; its last output: {text}" if text else message


def _memory_bytes() -> int:
    """Return the memory limit of a worker: half of the machine's memory over the number of cores."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return max(memory // (2 * (os.cpu_count() or 1)), _MIN_MEMORY)
