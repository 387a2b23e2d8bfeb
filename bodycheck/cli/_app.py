"""Run a command line app, and convert every exception and signal to a message and an exit status."""

from __future__ import annotations

import gc
import io
import os
import re
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

from bodycheck._util.errors import (
    FAULT,
    INPUT,
    INTERRUPTED,
    SIGNALLED,
    BodycheckError,
    InputError,
    StoppedError,
    error_text,
)
from bodycheck._util.formatting import nearest, suggestion
from bodycheck._util.untrusted import printable, printable_lines

if TYPE_CHECKING:
    import typer

_MAX_PART = 140  # characters of the command and of the error, so that the line has room for what to do
_TRACEBACK = "BODYCHECK_TRACEBACK"  # if set, an unexpected error also prints its traceback
_COLLECTED_AFTER = 50_000  # objects: large tables are many objects without cycles
_ENDING_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


def run_app(app: typer.Typer, name: str) -> None:
    """Run an app under a name and exit with its status.

    The status is 2 for wrong input, 130 for an interrupt, 143 and 129 for SIGTERM and SIGHUP, each with a
    message on standard error. It is 70 for an unexpected exception, with one line that names the file of its
    traceback.
    """
    received: list[int] = []
    gc.set_threshold(_COLLECTED_AFTER)
    _open_output()
    with _interrupted_by_signals(received):
        status = _status_after(lambda: _status_of(app, name), name)
        status = _status_after(_flushed, name) or status
    if status == INTERRUPTED and received:
        status = SIGNALLED + received[0]
    if status:
        sys.exit(status)


class _Output(io.TextIOWrapper):
    """Standard output that prints non-UTF-8 paths as their bytes and reports a full disk as an InputError."""

    def write(self, text: str) -> int:
        """Write text; raises InputError if the output cannot be written."""
        with _named_output():
            return super().write(text)

    def flush(self) -> None:
        """Flush the buffer; raises InputError if the output cannot be written."""
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
    """Replace an ordinary standard output by an _Output, and a closed one by the null device."""
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - open until the command ends
    elif type(sys.stdout) is io.TextIOWrapper:
        before = sys.stdout
        encoding, buffered = before.encoding, before.line_buffering
        before.flush()
        sys.stdout = _Output(before.detach(), encoding, "surrogateescape", line_buffering=buffered)


@contextmanager
def _interrupted_by_signals(received: list[int]) -> Iterator[None]:
    """Make SIGTERM and SIGHUP stop a command as Ctrl-C does; a second signal kills it."""

    def stop(number: int, frame: FrameType | None) -> None:  # noqa: ARG001 - the signature of a handler
        received.append(number)
        signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in _ENDING_SIGNALS}
    for number, handler in before.items():
        if handler is signal.SIG_DFL:  # nohup ignores SIGHUP, which must stay so
            signal.signal(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _status_of(app: typer.Typer, name: str) -> int:
    """Run the app and return its status; report wrong usage as wrong input."""
    from typer import Abort, BadParameter

    # click's base class, whether typer depends on click or contains a copy of it
    usage_error: Any = next(base for base in BadParameter.__mro__ if base.__name__ == "ClickException")
    try:
        return int(app(prog_name=name, standalone_mode=False) or 0)
    except usage_error as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else name
        if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help of a group of commands
            _print_error(f"{command}: give one of its commands\n\n{error.format_message()}")
            return int(error.exit_code)
        message = _unknown_option(error) or " ".join(error.format_message().split())
        _print_error(f"{_with_suggestion(message)} (help: {command} --help)")
        return int(error.exit_code)
    except Abort as error:  # typer raises it from an EOFError
        raise (error.__cause__ or error) from None


def _unknown_option(error: Any) -> str | None:
    """Return the message for an option that the command does not have; None for another usage error."""
    if not hasattr(error, "possibilities") or not hasattr(error, "option_name") or error.ctx is None:
        return None
    parameters = error.ctx.command.get_params(error.ctx)
    for one in parameters:
        label = str(one.metavar or one.name)
        if one.param_type_name == "argument" and f"--{label.lower()}" == error.option_name:
            return f"No such option: {error.option_name}; write {error.ctx.command_path} {label}"
    known = [name for one in parameters for name in one.opts if name.startswith("--") and name != "--help"]
    return f"No such option: {error.option_name}{suggestion(error.option_name, known)}"


def _with_suggestion(message: str) -> str:
    """Append the choice that resembles what was typed, and remove the words of the validator."""
    found = re.search(r"'([^']*)' is not one of (.*)\.$", message)
    suggestion = nearest(found[1], re.findall(r"'([^']*)'", found[2])) if found else None
    plain = re.sub(
        "Input should be (a valid [a-z]+), unable.*", r"must be \1", message.replace("Value error, ", "")
    )
    return plain + (f" Did you mean '{suggestion}'?" if suggestion else "")


def _flushed() -> int:
    sys.stdout.flush()
    return 0


def _status_after(command: Callable[[], int], name: str) -> int:
    """Return the status of a command; if an exception ended it, report that on standard error."""
    try:
        status = command()
        if status == INTERRUPTED:
            _print_error("stopped")
        return status
    except KeyboardInterrupt:
        _print_error("stopped")
        return INTERRUPTED
    except BodycheckError as error:
        _print_error("; ".join([str(error), *getattr(error, "__notes__", ())]))
        return INTERRUPTED if isinstance(error, StoppedError) else INPUT
    except SystemExit as error:
        if isinstance(error.__context__, BrokenPipeError):
            return _closed_pipe()
        raise
    except BrokenPipeError:
        return _closed_pipe()
    except MemoryError:
        _print_error("out of memory")
        return INPUT
    except Exception as error:  # noqa: BLE001 - unexpected exceptions have their own status
        return report_fault(error, name)


def _print_error(text: str) -> None:
    with suppress(OSError, ValueError):  # standard error may be closed
        print(printable_lines(text), file=sys.stderr)


def _closed_pipe() -> int:
    """Discard the remaining output and return the status of a program that SIGPIPE killed."""
    _drop_output()
    return SIGNALLED + signal.SIGPIPE


def _drop_output() -> None:
    """Discard the output still to be written, which the interpreter would otherwise flush at exit."""
    stdout: Any = sys.stdout
    with suppress(OSError, ValueError, AttributeError):
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, stdout.fileno())
        os.close(nothing)


def report_fault(error: BaseException, name: str) -> int:
    """Store the traceback of an unexpected exception, report it in one line, and return the status."""
    notes = "; ".join(getattr(error, "__notes__", ()))
    doing = " ".join([name, *sys.argv[1:]]) + (f" ({notes})" if notes else "")
    path = _store_traceback("".join(traceback.format_exception(error)), doing)
    location = "its traceback could not be stored" if path is None else f"its traceback is stored in {path}"
    what, why = (printable(" ".join(text.split()), _MAX_PART) for text in (doing, error_text(error)))
    if os.environ.get(_TRACEBACK):
        _print_error("".join(traceback.format_exception(error)).rstrip())
    _print_error(
        f"unexpected error in {what}: {why}; {location}; please report it with that file and the output of "
        f"`bodycheck doctor --json` at {_tracker()}"
    )
    return FAULT


def _tracker() -> str:
    """Return the address of the issues, which pyproject.toml states."""
    from importlib.metadata import metadata

    found = (line.partition(", ") for line in metadata("bodycheck").get_all("Project-URL", ()))
    return next((address for name, _, address in found if name == "Issues"), "the developers")


def _store_traceback(trace: str, doing: str) -> Path | None:
    """Write a traceback to the cache folder, or else to the temporary folder, and return the file."""
    from bodycheck._util.cache_dir import cache_dir

    content = f"{doing}\nPython {sys.version}\n\n{trace}".encode(errors="backslashreplace")
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    for folder in (cache_dir() / "faults", Path(tempfile.gettempdir())):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            descriptor, path = tempfile.mkstemp(".txt", f"bodycheck-fault-{stamp}-", folder)
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
            return Path(path)
    return None
