"""The largest stable step of a method as the page shows it: a mark in the map, a sentence in the cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bodycheck.reports.states import STATES
from bodycheck.reports.wording import number


@dataclass(frozen=True)
class Limit:
    """The mark of a method in the stability map, its tint, and the same as a sentence."""

    mark: str
    tint: str
    sentence: str


def limit_of(row: Mapping[str, Any] | None) -> Limit:
    """Return what a row of stability.csv comes to; None is of a method that is told no step."""
    if row is None:
        return Limit("", "", "no largest stable step was looked for")
    if row["outcome"] != "ok":
        state = STATES[row["outcome"]]
        return Limit(state.symbol, state.tint, f"{state.word}: {row['message']}")
    stable, unstable = _known(row["dt_stable_s"]), _known(row["dt_unstable_s"])
    if stable is None:
        return Limit("none", "bad", f"unstable at every step tried: {row['reason']}")
    shown = number(stable, 3)
    if unstable is None:
        return Limit(f"≥ {shown}", "good", f"stable up to dt = {shown} s, where the search ended")
    why = f"stable up to dt = {shown} s, not at {number(unstable, 3)} s: {row['reason']}"
    return Limit(shown, "open", why)


def _known(value: float) -> float | None:
    return value if value == value else None
