"""Whether the largest stable step of a method changed: by more than the search leaves open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bodycheck.reports.comparison.change import Change, Status, by_rank


def stability_change(before: Mapping[str, Any], after: Mapping[str, Any], threshold: float) -> Change | None:
    """Return how the largest stable step of one method on one scenario changed; None where it did not.

    before, after: rows of stability.csv without what is empty. The limit lies between the last stable and the
    first unstable step: where two such spans meet, it may be one and the same. threshold: the relative change
    of the last stable step from which on it is worse or improved.
    """
    old, new = before["outcome"], after["outcome"]
    if old != new:
        return _change(after, "stable step: search", old, new, by_rank(old == "ok", new == "ok"))
    if old != "ok":
        return None
    (low_a, high_a), (low_b, high_b) = _span(before), _span(after)
    if low_b >= high_a or high_b <= low_a:
        up = low_b >= high_a
        decades = math.log10(max(low_a, low_b) / min(low_a, low_b)) if low_a and low_b else None
        matters = decades is None or decades > math.log10(1.0 + threshold)
        status: Status = "moved" if not matters else "improved" if up else "worse"
        signed = decades if decades is None or up else -decades
        texts = (before.get("dt_stable_s", "none"), after.get("dt_stable_s", "none"))
        return _change(after, "dt_stable_s", *texts, status, signed)
    return None


def _change(
    row: Mapping[str, Any],
    what: str,
    before: float | str,
    after: float | str,
    status: Status,
    decades: float | None = None,
) -> Change:
    who = row["scenario"], row["engine"], row["method"]
    return Change("stability", *who, what, before, after, status, decades=decades)


def _span(row: Mapping[str, Any]) -> tuple[float, float]:
    """Return the last stable step and the first unstable one: 0 and infinity where there is none."""
    return row.get("dt_stable_s", 0.0), row.get("dt_unstable_s", math.inf)
