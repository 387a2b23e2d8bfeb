"""One thing that is different in two runs, and which way it went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["case", "outcome", "verdict", "order", "stability", "accuracy", "speed"]
Direction: TypeAlias = Literal["worse", "better", "other"]


@dataclass(frozen=True)
class Change:
    """What a case, or a method on a scenario, was before, and what it is after.

    what: the measure, or `outcome`, `verdict of <quantity>`, `order of <quantity>`, `dt_stable_s`, `stable
    step: search`, `relative_cpu`; of a case that only one run has, `case`. control, fineness: the step or the
    tolerance; None where all of a method's are meant. scenario: None where all of them are meant. before,
    after: None where there is nothing. decades: log10 of after over before, of what has a size.
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
    def size(self) -> float:
        """How far it went, by which changes are sorted: in decades; what has no size comes first."""
        return math.inf if self.decades is None else abs(self.decades)


def by_rank(before: int, after: int) -> Direction:
    """Return the direction from one rank to another, of which the higher is the better."""
    return "other" if before == after else "better" if after > before else "worse"
