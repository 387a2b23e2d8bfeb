"""What is told of a run while it goes on, and to whom."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Protocol, TypeAlias


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


class _Silence:
    def phase(self, what: str) -> None:
        pass

    def truth_begun(self, scenario: str) -> None:
        pass

    def case_done(self) -> None:
        pass

    def speed_measured(self) -> None:
        pass


SILENCE: Progress = _Silence()
"""For a run of which nothing is told."""

Watching: TypeAlias = Callable[[int], AbstractContextManager[Progress]]
"""How a run is watched, given the number of cases that are listed."""
