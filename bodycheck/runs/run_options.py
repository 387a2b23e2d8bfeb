"""Options of a run that do not depend on what it measures, and the interface for its progress."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from bodycheck._util.errors import InputError
from bodycheck.reports.cache.reuse import Reuse

TIMEOUT_S = 120.0
"""Default time limit of one case."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run that do not depend on what it measures.

    speed: whether to measure CPU time. jobs: number of cases to run in parallel, None for one per core.
    timeout_s: time limit of one case in s. reuse: which results of earlier runs to reuse. stable_steps:
    whether to search the largest stable step of each method. speed_passes: how often to time every case.
    """

    speed: bool = True
    jobs: int | None = None
    timeout_s: float = TIMEOUT_S
    reuse: Reuse = "installed"
    stable_steps: bool = True
    speed_passes: int = 1

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise InputError(f"jobs must be 1 or more, not {self.jobs}")
        if not 0.0 < self.timeout_s < float("inf"):
            raise InputError(f"timeout_s must be a positive number of seconds, not {self.timeout_s!r}")

    @property
    def workers(self) -> int:
        """The number of cases to run in parallel."""
        return self.jobs or len(os.sched_getaffinity(0))


class Progress(Protocol):
    """Callbacks that report the progress of a run."""

    def phase(self, what: str) -> None:
        """Report the start of a phase: compilation, truths, motions or speeds."""

    def truth_begun(self, scenario: str) -> None:
        """Report that a truth that is not in the cache is being solved, which may take long."""

    def case_done(self) -> None:
        """Report that another case has ended."""

    def speed_measured(self) -> None:
        """Report that another case was timed."""


class _NullProgress:
    def phase(self, what: str) -> None:
        pass

    def truth_begun(self, scenario: str) -> None:
        pass

    def case_done(self) -> None:
        pass

    def speed_measured(self) -> None:
        pass


NULL_PROGRESS: Progress = _NullProgress()
"""Reports nothing."""

ProgressFactory: TypeAlias = Callable[[int], AbstractContextManager[Progress]]
"""number of listed cases -> context manager that yields the run's Progress."""
