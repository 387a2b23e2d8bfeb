"""One thing that is different in two runs, and which way it went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["case", "outcome", "verdict", "order", "stability", "accuracy", "speed"]
Direction: TypeAlias = Literal["worse", "better", "other"]

_TURNED: dict[Direction, Direction] = {"worse": "better", "better": "worse", "other": "other"}


@dataclass(frozen=True)
class Change:
    """What a case, or a method on a scenario, was before, and what it is after.

    what: the measure, or `outcome`, `verdict of <quantity>`, `order of <quantity>`, `relative_cpu`; of a case
    that only one run has, `case`. control, fineness: the step or the tolerance; None where all of a method's
    are meant. scenario: None where all of them are meant. before, after: None where there is nothing.
    decades: log10 of after over before, of what has a size.
    """

    kind: Kind
    scenario: str | None
    engine: str
    method: str
    what: str
    before: float | str | None
    after: float | str | None
    direction: Direction
    control: str | None = None
    fineness: float | None = None
    decades: float | None = None

    @property
    def mirrored(self) -> Change:
        """The same change as seen from the other run."""
        return Change(
            self.kind,
            self.scenario,
            self.engine,
            self.method,
            self.what,
            self.after,
            self.before,
            _TURNED[self.direction],
            self.control,
            self.fineness,
            None if self.decades is None else -self.decades,
        )

    @property
    def size(self) -> float:
        """How far it went, by which changes are sorted: in decades; what has no size comes first."""
        return math.inf if self.decades is None else abs(self.decades)


def by_rank(before: int, after: int) -> Direction:
    """Return the direction from one rank to another, of which the higher is the better."""
    return "other" if before == after else "better" if after > before else "worse"
