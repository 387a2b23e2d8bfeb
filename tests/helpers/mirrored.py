"""What a comparison has to say when its two runs change places."""

from __future__ import annotations

from dataclasses import replace

from bodycheck.reports.comparison.change import Change, Direction

_TURNED: dict[Direction, Direction] = {"worse": "better", "better": "worse", "other": "other"}


def mirrored(change: Change) -> Change:
    """Return the same change as seen from the other run."""
    return replace(
        change,
        before=change.after,
        after=change.before,
        direction=_TURNED[change.direction],
        decades=None if change.decades is None else -change.decades,
    )
