"""What a comparison has to say when its two runs change places."""

from __future__ import annotations

from dataclasses import replace

from bodycheck.reports.comparison.change import Change, Status

TURNED: dict[Status, Status] = {
    "worse": "improved",
    "improved": "worse",
    "moved": "moved",
    "new": "missing",
    "missing": "new",
}
"""Status -> the status as seen from the other run."""


def mirrored(change: Change) -> Change:
    """Return the same change as seen from the other run."""
    return replace(
        change,
        before=change.after,
        after=change.before,
        status=TURNED[change.status],
        decades=None if change.decades is None else -change.decades,
    )
