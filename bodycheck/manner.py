"""How a run is made, whatever it measures."""

from __future__ import annotations

import os
from dataclasses import dataclass

from bodycheck.errors import InputError
from bodycheck.reports.storage.reuse import Reuse

TIMEOUT_S = 120.0
"""What one case may take unless told otherwise."""


@dataclass(frozen=True, kw_only=True)
class Manner:
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
    def strands(self) -> int:
        """How many cases run side by side."""
        return self.jobs or len(os.sched_getaffinity(0))
