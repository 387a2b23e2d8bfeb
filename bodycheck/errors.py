"""The errors that bodycheck raises for misuse; how a case ended is data (its outcome), not an exception."""

from __future__ import annotations


class BodycheckError(Exception):
    """Anything that the caller can put right: its message is one clear line, or one line a fault."""


class InputError(BodycheckError, ValueError):
    """The input was wrong: a file, a name, a number. The command line ends with status 2."""


class UnavailableError(BodycheckError, ImportError):
    """An engine or library that was asked for cannot be imported here; the message says why."""
