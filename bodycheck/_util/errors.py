"""The exceptions that bodycheck raises for misuse; the outcome of a case is data, not an exception."""

from __future__ import annotations


def error_text(error: BaseException) -> str:
    """Return the type and the message of an exception; its type alone where it has no valid message."""
    try:
        return f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - __str__ of an exception may raise
        return type(error).__name__


class BodycheckError(Exception):
    """An error that the caller can correct; the message has one line per error."""


class InputError(BodycheckError, ValueError):
    """Wrong input: a file, a name, a number. The command line exits with status 2."""


class UnavailableError(BodycheckError, ImportError):
    """A requested engine or library cannot be imported; the message says why."""


class InsideWorkerError(BodycheckError):
    """A run was started within a worker process, which holds one engine: see adapters/workers/worker.py."""


class WorkerLostError(BodycheckError):
    """A worker process died, hung or violated the protocol; the message says how, with its last output.

    killed: by SIGKILL, which users and the out-of-memory killer send, but no engine sends to itself.
    """

    def __init__(self, message: str, *, timed_out: bool = False, killed: bool = False) -> None:
        super().__init__(message)
        self.timed_out, self.killed = timed_out, killed


INPUT = 2
"""Exit status for wrong input."""

FAULT = 70
"""Exit status for an unexpected exception: EX_SOFTWARE of sysexits.h."""

SIGNALLED = 128
"""Shells report a command that a signal ended as this status plus the signal's number."""

INTERRUPTED = 130
"""Exit status that shells expect of a command interrupted by Ctrl-C."""


class StoppedError(BodycheckError):
    """The user interrupted a run; the message says how to continue it."""
