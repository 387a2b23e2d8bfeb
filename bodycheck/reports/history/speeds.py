"""Which methods became slower or faster, beside the reference of the same night."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.history.levels import Step, level_steps
from bodycheck.reports.history.series import Key, Series, series_of

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False)
class Speeds:
    """The times of all methods, night by night, and where they moved to another level."""

    series: Series
    steps: dict[Key, list[Step]]

    @property
    def changes(self) -> Iterator[Change]:
        """The moves that are told on the last night."""
        tonight = len(self.series.nights) - 1
        for (engine, method), steps in self.steps.items():
            if steps and steps[-1].told == tonight:
                size = steps[-1].size
                status: Status = "worse" if size > 0.0 else "improved"
                yield Change("speed", None, engine, method, "relative_cpu", None, None, status, decades=size)


def speeds_of(nights: Sequence[str], cases: pd.DataFrame) -> Speeds:
    """Return how long each method took: the median over its cases, so that what most of them did is told.

    nights: their names, the oldest first. cases: one row a case and night, with its relative_cpu.
    """
    series = series_of(nights, cases, "relative_cpu", lambda decades: float(decades.median()))
    return Speeds(series, dict(zip(series.methods, level_steps(series.decades), strict=True)))
