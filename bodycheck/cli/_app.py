"""Carrying a command line out: however it ends, it ends in one place, with a line and a status of its own."""

from __future__ import annotations

import io
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from bodycheck._util.errors import FAULT, INPUT, INTERRUPTED, BodycheckError, InputError, StoppedError
from bodycheck._util.untrusted import printable, printable_lines

if TYPE_CHECKING:
    import typer

_SIGNALLED = 128  # what a shell adds to the number of the signal that ended a command
_PART = 140  # characters of what was being done, and of why it failed: the rest of the line says what to do
_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def carry_out(app: typer.Typer, name: str) -> None:
    """Run an app under a name and exit with its status.

    2 for wrong input, 130 for an interrupt, 143 and 129 for SIGTERM and SIGHUP, each with its message on
    standard error; 70 for an exception that nobody expected, with one line that says where its traceback is.
    """
    received: list[int] = []
    _open_output()
    with _ended_like_an_interrupt(received):
        status = _ended(lambda: _status_of(app, name), name)
        status = _ended(_flushed, name) or status
    if status == INTERRUPTED and received:
        status = _SIGNALLED + received[0]
    if status:
        sys.exit(status)


class _Output(io.TextIOWrapper):
    """Standard output: a path that is not UTF-8 is printed as the bytes that it is, a full disk is named."""

    def write(self, text: str) -> int:
        """Write as any stream does."""
        with _named_output():
            return super().write(text)

    def flush(self) -> None:
        """Flush as any stream does."""
        with _named_output():
            super().flush()


@contextmanager
def _named_output() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        _drop_output()
        raise InputError(f"standard output: cannot be written: {error.strerror or error}") from None


def _open_output() -> None:
    """Put an _Output in the place of an ordinary standard output, which may have been closed."""
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - until the command ends
    elif type(sys.stdout) is io.TextIOWrapper:
        before = sys.stdout
        encoding, buffered = before.encoding, before.line_buffering
        before.flush()
        sys.stdout = _Output(before.detach(), encoding, "surrogateescape", line_buffering=buffered)


@contextmanager
def _ended_like_an_interrupt(received: list[int]) -> Iterator[None]:
    """Have SIGTERM and SIGHUP stop a command as Ctrl-C does; a second one kills it."""

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of a handler
        received.append(number)
        signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING_SIGNALS}
    for number, handler in before.items():
        if handler is signal.SIG_DFL:  # nohup has it ignored
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _status_of(app: typer.Typer, name: str) -> int:
    """Run the app; its status, wrong usage being the input's fault."""
    from typer import Abort, BadParameter

    # click's own base class, whether typer has click beside or within it
    usage_error: Any = next(base for base in BadParameter.__mro__ if base.__name__ == "ClickException")
    try:
        return int(app(prog_name=name, standalone_mode=False) or 0)
    except usage_error as error:
        said = io.StringIO()
        error.show(file=said)
        _say(said.getvalue().rstrip("\n"))
        return int(error.exit_code)
    except Abort as error:  # made of an EOFError
        raise (error.__cause__ or error) from None


def _flushed() -> int:
    sys.stdout.flush()
    return 0


def _ended(command: Callable[[], int], name: str) -> int:
    """Return the status of a command, and say on standard error what ended it if it did not end by itself."""
    try:
        status = command()
        if status == INTERRUPTED:
            _say("stopped")
        return status
    except KeyboardInterrupt:
        _say("stopped")
        return INTERRUPTED
    except BodycheckError as error:
        _say("; ".join([str(error), *getattr(error, "__notes__", ())]))
        return INTERRUPTED if isinstance(error, StoppedError) else INPUT
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):
            return _reader_left()
        raise
    except BrokenPipeError:
        return _reader_left()
    except Exception as error:  # noqa: BLE001 - whatever nobody expected has a status of its own
        return report_fault(error, name)


def _say(text: str) -> None:
    with suppress(OSError, ValueError):  # there may be nobody left to hear it
        print(printable_lines(text), file=sys.stderr)


def _reader_left() -> int:
    """Drop what nobody reads; the status is that of a program which SIGPIPE ended."""
    _drop_output()
    return _SIGNALLED + signal.SIGPIPE


def _drop_output() -> None:
    """Let what is still to be written vanish, or the interpreter would try again as it ends."""
    stdout: Any = sys.stdout
    with suppress(OSError, ValueError, AttributeError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stdout.fileno())
        os.close(nothing)


def report_fault(error: BaseException, name: str) -> int:
    """Keep the traceback of an unexpected exception in a file, say so in one line, and return the status."""
    notes = "; ".join(getattr(error, "__notes__", ()))
    doing = " ".join([name, *sys.argv[1:]]) + (f" ({notes})" if notes else "")
    kept = _kept("".join(traceback.format_exception(error)), doing)
    where = "its traceback could not be kept" if kept is None else f"its traceback is kept in {kept}"
    what, why = (printable(" ".join(text.split()), _PART) for text in (doing, _words(error)))
    _say(f"unexpected fault in {what}: {why}; {where}; please report it, with that file, to the developers")
    return FAULT


def _words(error: BaseException) -> str:
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - not every error can be printed
        return type(error).__name__


def _kept(trace: str, doing: str) -> Path | None:
    """Return the file that a traceback was written to: beside the caches, else among the temporary files."""
    from bodycheck._util.cache_dir import cache_home

    content = f"{doing}\nPython {sys.version}\n\n{trace}".encode(errors="backslashreplace")
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    for folder in (cache_home() / "faults", Path(tempfile.gettempdir())):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            descriptor, path = tempfile.mkstemp(".txt", f"bodycheck-fault-{stamp}-", folder)
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
            return Path(path)
    return None
