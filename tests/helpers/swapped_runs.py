"""The changes of a comparison whose two runs are swapped."""

from __future__ import annotations

from dataclasses import replace

from bodycheck.reports.comparison.change import Change, Status

SWAPPED_STATUS: dict[Status, Status] = {
    "worse": "improved",
    "improved": "worse",
    "moved": "moved",
    "new": "missing",
    "missing": "new",
}
"""Status -> the status as seen from the other run."""


def swapped(change: Change) -> Change:
    """Return the same change as seen from the other run."""
    return replace(
        change,
        before=change.after,
        after=change.before,
        status=SWAPPED_STATUS[change.status],
        decades=None if change.decades is None else -change.decades,
    )
