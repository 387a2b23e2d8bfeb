"""How a number of each method went, night by night, over what is usual for it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

Key: TypeAlias = tuple[str, str]
"""Engine and method."""

_CASE = ["engine", "method", "scenario", "control", "dt_s", "tolerance"]


@dataclass(frozen=True, eq=False)
class Series:
    """log10 of a number over the usual one, (nights, methods), NaN where it was not measured.

    nights: their names, the oldest first.
    """

    nights: tuple[str, ...]
    methods: tuple[Key, ...]
    decades: Array

    @property
    def measured(self) -> int:
        """On how many nights anything was measured."""
        return int(np.sum(~np.all(np.isnan(self.decades), axis=1))) if self.methods else 0


def series_of(
    nights: Sequence[str], cases: pd.DataFrame, measure: str, of_cases: Callable[[pd.Series], float]
) -> Series:
    """Return of_cases(log10(x / median of x over the nights)) of each method on each night, x of each case.

    nights: their names, the oldest first. cases: one row a case and night, with `night` and the measure.
    of_cases: one number for the decades of a method's cases on one night.
    """
    there = cases[cases[measure] > 0.0]
    if there.empty:
        return Series(tuple(nights), (), np.empty((len(nights), 0)))
    logs = there.assign(log=np.log10(there[measure]))
    logs["log"] -= logs.groupby(_CASE, dropna=False)["log"].transform("median")
    table = logs.groupby(["night", "engine", "method"])["log"].agg(of_cases).unstack(["engine", "method"])
    table = table.reindex(list(nights)).sort_index(axis=1)
    methods = tuple(zip(*(table.columns.get_level_values(level) for level in (0, 1)), strict=True))
    return Series(tuple(nights), methods, table.to_numpy(dtype=np.float64))
