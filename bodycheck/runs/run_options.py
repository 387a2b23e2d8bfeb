"""Options of a run that do not depend on what it measures, and the interface for its progress."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

from bodycheck._util.errors import InputError

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from bodycheck.reports.cache.answers import Reuse

TIMEOUT_S = 120.0
"""Default time limit of one case."""


_IN_FLIGHT = 512
"""Cases that an executor has at most at a time: enough to fill batches for many workers."""


@dataclass(frozen=True, eq=False)
class Timing:
    """An executor that times cases, and the facts of its machines, all of one class, for the manifest."""

    executor: Executor
    machine: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of a run that do not depend on what it measures.

    speed: whether to measure CPU time. jobs: number of cases to run in parallel, None for one per core.
    timeout_s: time limit of one case in s. reuse: which results of earlier runs to reuse. stable_steps:
    whether to search the largest stable step of each method. speed_passes: how often to time every case.
    executor: runs the cases elsewhere. timing: times them elsewhere.
    laws: whether to compare each method with the known one-step maps, and to check the laws.
    commit: what is measured [default: the commit that continuous integration names].
    """

    speed: bool = True
    jobs: int | None = None
    timeout_s: float = TIMEOUT_S
    reuse: Reuse = "installed"
    stable_steps: bool = True
    speed_passes: int = 1
    executor: Executor | None = None
    timing: Timing | None = None
    laws: bool = True
    commit: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and (not isinstance(self.jobs, Integral) or self.jobs < 1):
            raise InputError(f"jobs must be a whole number, 1 or more, not {self.jobs!r}")
        if not isinstance(self.timeout_s, Real) or not 0.0 < self.timeout_s < float("inf"):
            raise InputError(f"timeout_s must be a positive number of seconds, not {self.timeout_s!r}")

    @property
    def workers(self) -> int:
        """The number of cases to run in parallel."""
        return self.jobs or (len(os.sched_getaffinity(0)) if self.executor is None else _IN_FLIGHT)

    @property
    def timing_executor(self) -> Executor | None:
        """The executor that times cases; None to time them in this process."""
        return None if self.timing is None else self.timing.executor


def reuse_of(fresh: bool | None, default: Reuse) -> Reuse:
    """Return the setting of --fresh or --reuse [default: that of the command]."""
    return default if fresh is None else "nothing" if fresh else "everything"


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

    def case_done(self) -> None:
        """Report that another case has ended."""

    def speeds_started(self) -> None:
        """Report that the timing of the cases begins."""

    def speed_measured(self) -> None:
        """Report that another case was timed."""


class _NullProgress:
    def _ignore(self, *_: object) -> None:
        pass

    phase = compiling = truth_started = motions_started = case_done = speeds_started = speed_measured = (
        _ignore
    )


NULL_PROGRESS: Progress = _NullProgress()
"""Reports nothing."""

ProgressFactory: TypeAlias = Callable[[int], AbstractContextManager[Progress]]
"""number of listed cases -> context manager that yields the run's Progress."""


def no_progress(cases_listed: int) -> AbstractContextManager[Progress]:  # noqa: ARG001 - a ProgressFactory
    """Report nothing."""
    return nullcontext(NULL_PROGRESS)
