"""How a run is carried out, whatever it measures, and to whom its progress is reported."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from bodycheck._util.errors import InputError
from bodycheck.reports.cache.reuse import Reuse

TIMEOUT_S = 120.0
"""What one case may take unless told otherwise."""


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """How a run is made, whatever it measures.

    speed: whether processor time is measured. jobs: how many cases run side by side, None for as many as
    there are cores. timeout_s: what one case may take. reuse: what is used of earlier runs.
    stable_steps: whether the largest stable step of each method is looked for. speed_passes: how often all
    cases are timed.
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
        """How many cases run side by side."""
        return self.jobs or len(os.sched_getaffinity(0))


class Progress(Protocol):
    """What is told of a run while it goes on."""

    def phase(self, what: str) -> None:
        """Something has begun: compiling, the truths, the motions, the speeds."""

    def truth_begun(self, scenario: str) -> None:
        """A truth that is not known yet is solved, which may take long."""

    def case_done(self) -> None:
        """One more case has ended."""

    def speed_measured(self) -> None:
        """One more case was timed."""


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
"""For a run of which nothing is told."""

ProgressFactory: TypeAlias = Callable[[int], AbstractContextManager[Progress]]
"""How a run is watched, given the number of cases that are listed."""
