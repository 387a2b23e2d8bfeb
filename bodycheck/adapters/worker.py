"""The process that holds one engine: announces it, then answers case after case until its input ends.

Run as `python -m bodycheck.adapters.worker ENGINE MEMORY_BYTES`. What the engine prints on standard output
goes to standard error instead: the channel is the worker's alone. For the ENGINE `-` the first line of the
input holds an adapter that exists in the run's own process, pickled by that process.
"""

from __future__ import annotations

import base64
import ctypes
import importlib.util
import os
import pickle
import resource
import signal
import sys
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import BinaryIO

from bodycheck.adapters import protocol
from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.drive import Answer, Stopwatch, record, stopwatch
from bodycheck.adapters.protocol import Message
from bodycheck.adapters.registry import code_of, get_adapter
from bodycheck.errors import BodycheckError, InsideWorkerError, UnavailableError

_PR_SET_PDEATHSIG = 1
HANDED_OVER = "-"
"""What names an engine that no process but the run's can import by itself."""


class Desk:
    """Answers the requests of a run with one engine, one after the other."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self._watch: Stopwatch | None = None

    def answer(self, request: Message) -> Message:
        """Return the answer; what the engine raises becomes the outcome `failed`."""
        try:
            return {"id": request.get("id"), **self._done(request)}
        except (Exception, SystemExit) as error:  # noqa: BLE001 - an engine may raise anything; it costs this case alone
            return {"id": request.get("id"), **protocol.answer_message(failure(error))}

    def _done(self, request: Message) -> Message:
        match request.get("do"):
            case "record":
                return protocol.answer_message(record(self._adapter, protocol.case_of(request["case"])))
            case "prepare":
                self.close()
                self._watch = stopwatch(self._adapter, protocol.case_of(request["case"]))
                return {"outcome": "ok"}
            case "lap" if self._watch is not None:
                return {"outcome": "ok", "cpu_s": self._watch.lap()}
            case unknown:
                raise protocol.ProtocolError(f"nothing to do for {unknown!r} here")

    def close(self) -> None:
        """Free what was prepared."""
        if self._watch is not None:
            watch, self._watch = self._watch, None
            watch.close()


def failure(error: BaseException) -> Answer:
    """Return the answer to a case that raised."""
    return Answer("failed", " ".join(f"{type(error).__name__}: {error}".split()))


def main() -> None:
    """Serve standard input and output until the input ends."""
    engine, memory_bytes = sys.argv[1], int(sys.argv[2])
    _die_with_parent()
    resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    requests, answers = _private_channel()
    try:
        adapter = _handed_over(requests.readline()) if engine == HANDED_OVER else get_adapter(engine)
    except BodycheckError as error:
        unavailable = {"bodycheck": protocol.VERSION, "engine": engine, "unavailable": str(error)}
        _say(answers, unavailable)
        return
    # one that was handed over is being worked on: what it answered before is never taken for an answer
    code = "" if engine == HANDED_OVER else code_of(adapter)
    _say(answers, protocol.announcement(adapter, code))
    desk = Desk(adapter)
    for line in requests:
        _say(answers, desk.answer(protocol.message_of(line)))


def _say(answers: BinaryIO, message: Message) -> None:
    answers.write(protocol.line_of(message))
    answers.flush()


def _private_channel() -> tuple[BinaryIO, BinaryIO]:
    """Take standard input and output for the protocol; an engine finds nothing to read there."""
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    return requests, answers


def handed_over(adapter: Adapter) -> bytes | None:
    """Return the line that gives a worker this very adapter; None where it cannot leave its process."""
    try:
        pickled = pickle.dumps(adapter)
    except (pickle.PicklingError, TypeError, AttributeError):
        return None
    module = type(adapter).__module__
    file = getattr(sys.modules[module], "__file__", None)
    if file is None:
        return None
    encoded = base64.b64encode(pickled).decode("ascii")
    return protocol.line_of({"adapter": encoded, "module": module, "file": str(Path(file).resolve())})


def _handed_over(line: bytes) -> Adapter:
    message = protocol.message_of(line)
    module, file = message["module"], Path(message["file"])
    try:
        if module == "__main__":
            _run_script(file)
        else:
            _import(module, file)
        adapter: Adapter = pickle.loads(base64.b64decode(message["adapter"]))
    except (ImportError, AttributeError, OSError) as error:
        raise UnavailableError(f"{module} cannot be imported: {error}") from None
    return adapter


def _import(module: str, file: Path) -> None:
    """Import by name, else from the file, under that name: a test's module is on no path."""
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
    """Define what the user's script defines, as far as the line in which it starts a run."""
    script = ModuleType("__main__")
    script.__dict__["__file__"] = str(path)
    script.__dict__["__name__"] = "__mp_main__"  # no `if __name__ == "__main__"` is to run
    sys.modules["__main__"] = sys.modules["__mp_main__"] = script
    with suppress(InsideWorkerError):
        exec(compile(path.read_bytes(), str(path), "exec"), script.__dict__)


def _die_with_parent() -> None:
    """Ask Linux to kill this process when the run dies: a hanging engine would never see its input end."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    main()
