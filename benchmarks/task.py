"""A function as a task that can be timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Call:
    """A call that does the same work each time, and needs no reset."""

    function: Callable[[], object]

    def reset(self) -> None:
        """Do nothing."""

    def run(self) -> None:
        """Call the function."""
        self.function()
