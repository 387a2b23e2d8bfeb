"""The worker process of one engine: announces it, then answers requests until its input ends.

Run as `python -m bodycheck.adapters.workers.worker ENGINE MEMORY_BYTES`. Standard output is reserved for the
protocol; what the engine prints there goes to standard error instead. For the ENGINE `-`, the first line of
the input holds an adapter object of the run's process, pickled by that process.
"""

from __future__ import annotations

import base64
import importlib.util
import os
import pickle
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from bodycheck._util.errors import BodycheckError, InsideWorkerError, UnavailableError, error_text
from bodycheck.adapters.batches import record_batch
from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.execution import Answer, Stopwatch, record, stopwatch
from bodycheck.adapters.importers import answered
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.stable_step import stable_step
from bodycheck.adapters.workers import case_messages, protocol
from bodycheck.adapters.workers.build_identity import Loaded
from bodycheck.adapters.workers.launcher import die_with_the_run, limit_memory
from bodycheck.adapters.workers.protocol import Message

HANDED_OVER = "-"
"""The ENGINE argument for an adapter object that only the run's process can import."""


class RequestHandler:
    """Answers the requests of a run with one engine, one after the other.

    interruptible: whether a KeyboardInterrupt comes from the user and not from the engine.
    """

    def __init__(self, adapter: Adapter, *, interruptible: bool = False) -> None:
        self._adapter, self._interruptible = adapter, interruptible
        self._stopwatch: Stopwatch | None = None

    def answer(self, request: Message) -> Message:
        """Return the answer; an exception of the engine becomes the outcome `failed`."""
        try:
            return {"id": request.get("id"), **self._done(request)}
        except BaseException as error:  # an engine may raise anything; only this case fails
            if self._interruptible and isinstance(error, KeyboardInterrupt):
                raise
            return _failed(request, error)

    def _done(self, request: Message) -> Message:
        match request.get("do"):
            case "record" | "replay" as do:
                case = case_messages.case_of(request["case"])
                return protocol.answer_message(record(self._adapter, case, again=do == "replay"))
            case "batch":
                found = record_batch(self._adapter, case_messages.batch_of(request))
                return protocol.batch_answer_message(found)
            case "prepare":
                self.close()
                self._stopwatch = stopwatch(self._adapter, case_messages.case_of(request["case"]))
                return {"outcome": "ok"}
            case "stable-step":
                search_result = stable_step(self._adapter, case_messages.search_of(request))
                return protocol.stable_step_message(search_result)
            case "import":
                return answered(self._adapter.name, request)
            case "dynamics":
                from bodycheck.adapters.workers.tree_readings import answered_dynamics

                return answered_dynamics(self._adapter, request)
            case "gradients":
                from bodycheck.adapters.workers.gradient_messages import answered_gradients

                return answered_gradients(self._adapter, request)
            case "lap" if self._stopwatch is not None:
                return {"outcome": "ok", "cpu_s": self._stopwatch.lap()}
            case unknown:
                raise protocol.ProtocolError(f"unexpected request {unknown!r}")

    def close(self) -> None:
        """Free the prepared case."""
        if self._stopwatch is not None:
            running, self._stopwatch = self._stopwatch, None
            running.close()


def _failed(request: Message, error: BaseException) -> Message:
    return {
        "id": request.get("id"),
        **protocol.answer_message(Answer("failed", protocol.one_line(error_text(error)))),
    }


def main() -> None:
    """Serve standard input and output until the input ends."""
    try:
        engine, memory_bytes = sys.argv[1], int(sys.argv[2])
    except (IndexError, ValueError):
        sys.exit("usage: python -m bodycheck.adapters.workers.worker ENGINE MEMORY_BYTES")
    die_with_the_run()
    limit_memory(memory_bytes)
    requests, answers = _private_channel()
    try:
        handed = engine == HANDED_OVER
        adapter = _handed_over(requests.readline()) if handed else get_adapter(engine)
        loaded = Loaded(adapter, handed_over=handed)
        announcement = protocol.announcement(adapter, loaded.build)
    except BodycheckError as error:
        _send(answers, {"bodycheck": protocol.VERSION, "engine": engine, "unavailable": str(error)})
        return
    _send(answers, announcement)
    handler = RequestHandler(adapter)
    for line in requests:
        _answer(answers, handler, loaded, line)


def _answer(answers: BinaryIO, handler: RequestHandler, loaded: Loaded, line: bytes) -> None:
    request: Message = {}
    try:
        request = protocol.message_of(line)
        answer = handler.answer(request)
        if build := loaded.later():
            answer |= protocol.build_message(build)
        _send(answers, answer)
    except protocol.ProtocolError as error:
        _send(answers, _failed(request, error))


def _send(answers: BinaryIO, message: Message) -> None:
    line = protocol.line_of(message)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):  # the engine may have closed it
            stream.flush()
    answers.write(line)
    answers.flush()


def _private_channel() -> tuple[BinaryIO, BinaryIO]:
    """Reserve standard input and output for the protocol; the engine's standard input is empty."""
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return requests, answers


def handed_over(adapter: Adapter) -> bytes | None:
    """Return the line that passes this adapter to a worker; None if it cannot be pickled."""
    module = type(adapter).__module__
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        return None
    try:
        encoded = base64.b64encode(pickle.dumps(adapter)).decode("ascii")
        return protocol.line_of({"adapter": encoded, "module": module, "file": str(Path(file).resolve())})
    except Exception:  # noqa: BLE001 - pickling a user's object may raise anything
        return None


def _handed_over(line: bytes) -> Adapter:
    message = protocol.message_of(line)
    module, file = message["module"], Path(message["file"])
    try:
        if module == "__main__":
            _run_script(file)
        else:
            _import(module, file)
        adapter: Adapter = pickle.loads(base64.b64decode(message["adapter"]))
    except Exception as error:  # noqa: BLE001 - a user's module may raise anything
        why = protocol.one_line(error_text(error))
        raise UnavailableError(f"{module} cannot be imported by a worker: {why}") from None
    return adapter


def _import(module: str, file: Path) -> None:
    """Import by name, or else from the file under that name: a test's module is not on the path."""
    try:
        importlib.import_module(module)
    except ImportError:
        spec = importlib.util.spec_from_file_location(module, file)
        if spec is None or spec.loader is None:
            raise
        found = importlib.util.module_from_spec(spec)
        sys.modules[module] = found
        spec.loader.exec_module(found)


def _run_script(path: Path) -> None:
    """Execute the user's script up to the line in which it starts a run."""
    script = ModuleType("__main__")
    script.__dict__["__file__"] = str(path)
    script.__dict__["__name__"] = "__mp_main__"  # skip `if __name__ == "__main__"`
    sys.modules["__main__"] = sys.modules["__mp_main__"] = script
    with suppress(InsideWorkerError, SystemExit):
        exec(compile(path.read_bytes(), str(path), "exec"), script.__dict__)


if __name__ == "__main__":
    main()
