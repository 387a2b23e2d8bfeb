"""A plain function as something that can be timed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Call:
    """A call that needs no way back: the same work each time."""

    function: Callable[[], object]

    def reset(self) -> None:
        """Nothing to go back from."""

    def run(self) -> None:
        """Call it."""
        self.function()
