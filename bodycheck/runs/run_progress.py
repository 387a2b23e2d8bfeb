"""The interface for the progress of a run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol, TypeAlias


class Progress(Protocol):
    """Callbacks that report the progress of a run."""

    def phase(self, name: str) -> None:
        """Report the start of a phase."""

    def compiling(self, done: int, total: int) -> None:
        """Report that kernels are being compiled, and how many of the compilations are done."""

    def truth_started(self, scenario: str) -> None:
        """Report that a truth that is not in the cache is being solved, which may take long."""

    def motions_started(self) -> None:
        """Report that the cases begin."""

    def task_started(self, name: str) -> None:
        """Report what a thread has begun: a method on a scenario, or its examination."""

    def case_done(self) -> None:
        """Report that another case has ended."""

    def speeds_started(self) -> None:
        """Report that the timing of the cases begins."""

    def speed_measured(self) -> None:
        """Report that another case was timed."""


class _NullProgress:
    def _ignore(self, *_: object) -> None:
        pass

    phase = compiling = truth_started = motions_started = task_started = _ignore
    case_done = speeds_started = speed_measured = _ignore


NULL_PROGRESS: Progress = _NullProgress()
"""Reports nothing."""

ProgressFactory: TypeAlias = Callable[[int], AbstractContextManager[Progress]]
"""number of listed cases -> context manager that yields the run's Progress."""


def no_progress(cases_listed: int) -> AbstractContextManager[Progress]:  # noqa: ARG001 - a ProgressFactory
    """Report nothing."""
    return nullcontext(NULL_PROGRESS)
