"""The errors that bodycheck raises for misuse; how a case ended is data (its outcome), not an exception."""

from __future__ import annotations


class BodycheckError(Exception):
    """Anything that the caller can put right: its message is one clear line, or one line a fault."""


class InputError(BodycheckError, ValueError):
    """The input was wrong: a file, a name, a number. The command line ends with status 2."""


class UnavailableError(BodycheckError, ImportError):
    """An engine or library that was asked for cannot be imported here; the message says why."""


class InsideWorkerError(BodycheckError):
    """A run was started within a worker process, which holds one engine: see adapters/workers/worker.py."""


class WorkerLostError(BodycheckError):
    """A worker process died, hung, or said what is none of the protocol's; says how, with its last output.

    killed: by SIGKILL, which no engine brings upon itself, but users and a machine out of memory do.
    """

    def __init__(self, message: str, *, timed_out: bool = False, killed: bool = False) -> None:
        super().__init__(message)
        self.timed_out, self.killed = timed_out, killed


INPUT = 2
"""The status of a command whose input was wrong."""

FAULT = 70
"""The status of a command that met an exception which nobody expected: EX_SOFTWARE of sysexits.h."""

INTERRUPTED = 130
"""The status that a shell expects of a command that Ctrl-C ended."""


class StoppedError(BodycheckError):
    """The user stopped a run; says how it can go on."""
