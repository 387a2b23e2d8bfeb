"""One quantity that differs between two runs, its class, and the threshold from which it matters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal["case", "outcome", "verdict", "order", "stability", "accuracy", "speed"]
Status: TypeAlias = Literal["worse", "missing", "improved", "moved", "new"]

FAILING: tuple[Status, ...] = ("worse", "missing")
"""The changes that fail a comparison or a nightly run."""


@dataclass(frozen=True)
class Change:
    """What a case, or a method on a scenario, was before, and what it is after.

    quantity: the measure, or `outcome`, `verdict of <quantity>`, `order of <quantity>`, `dt_stable_s`,
    `stable step: search`, `relative_cpu`; of a case that only one run has, `case`. status: worse or improved
    beyond the threshold, moved by less, new or missing. control, fineness: the step or the tolerance; None where all
    of a method's are meant. scenario: None where all of them are meant. before, after: None where there is
    nothing. decades: log10 of after over before, of what has a size.
    """

    kind: Kind
    scenario: str | None
    engine: str
    method: str
    quantity: str
    before: float | str | None
    after: float | str | None
    status: Status
    control: str | None = None
    fineness: float | None = None
    decades: float | None = None

    @property
    def size(self) -> float:
        """How far it went, by which changes are sorted: in decades; what has no size comes first."""
        return math.inf if self.decades is None else abs(self.decades)

    @property
    def relative(self) -> float | None:
        """The larger over the smaller value, less 1; None of what has no size."""
        return None if self.decades is None else math.expm1(abs(self.decades) * math.log(10.0))


def by_rank(before: int, after: int) -> Status:
    """Return the status of going from one rank to another, of which the higher is the better."""
    return "moved" if before == after else "improved" if after > before else "worse"
