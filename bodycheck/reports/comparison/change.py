"""One quantity that differs between two runs, its status, and the threshold that decides it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

Kind: TypeAlias = Literal[
    "case", "outcome", "verdict", "order", "stability", "accuracy", "speed", "fingerprint"
]
Status: TypeAlias = Literal["worse", "missing", "improved", "moved", "new"]

FAILING: tuple[Status, ...] = ("worse", "missing")
"""The statuses that fail a comparison or a nightly run."""


@dataclass(frozen=True)
class Change:
    """One quantity of a case, or of a method on a scenario, before and after.

    quantity: the measure, or `outcome`, `verdict of <quantity>`, `order of <quantity>`, `dt_stable_s`,
    `stable step: search`, `relative_cpu`; `case` for a case that only one run has. status: worse or improved
    beyond the threshold, moved by less, new or missing. control, fineness: the step or the tolerance; None
    for all of a method's. scenario: None for all scenarios. before, after: None if there is no value.
    decades: log10(after / before); None for a quantity without a size.
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
        """The sort key of changes: the size in decades; infinite without a size, which sorts first."""
        return math.inf if self.decades is None else abs(self.decades)

    @property
    def relative(self) -> float | None:
        """The larger over the smaller value, minus 1; None without a size."""
        return None if self.decades is None else math.expm1(abs(self.decades) * math.log(10.0))


def by_rank(before: int, after: int) -> Status:
    """Return the status of a change from one rank to another; a higher rank is better."""
    return "moved" if before == after else "improved" if after > before else "worse"
