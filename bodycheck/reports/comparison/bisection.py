"""Where a measure changed within an ordered list: by measuring few of its members, or every one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

Found = TypeVar("Found")


def changes(
    members: Sequence[str],
    measured: Callable[[str], Found | None],
    differ: Callable[[Found, Found], bool],
) -> tuple[tuple[str, str], ...]:
    """Return each change as the last member before it and the first after it, in the order of the list.

    members: ordered and distinct. measured: None where one cannot be; those are stepped around, and may lie
    between the two of a pair. differ: whether two findings are different.

    The ends are measured, then halves, until two neighbours differ; then the same from there to the end. So
    each difference between the ends is found, in 2 + log2(n) measurements a change; what changed and changed
    back between two that were measured is not seen. No member is measured twice.
    """
    known: dict[str, Found | None] = {}

    def found(place: int) -> Found | None:
        member = members[place]
        if member not in known:
            known[member] = measured(member)
        return known[member]

    def first_of(places: Sequence[int]) -> int | None:
        return next((place for place in places if found(place) is not None), None)

    def apart(one: int, other: int) -> bool:
        a, b = found(one), found(other)
        assert a is not None
        assert b is not None
        return differ(a, b)

    start, end = first_of(range(len(members))), first_of(range(len(members) - 1, -1, -1))
    pairs = []
    while start is not None and end is not None and apart(start, end):
        low, high = start, end
        while (middle := first_of(_from_the_middle(low, high))) is not None:
            if apart(start, middle):
                high = middle
            else:
                low = middle
        pairs.append((members[low], members[high]))
        start = high
    return tuple(pairs)


def _from_the_middle(low: int, high: int) -> list[int]:
    """Return the places between two others, the middle first."""
    return sorted(range(low + 1, high), key=lambda place: abs(2 * place - low - high))


def every_change(
    members: Sequence[str],
    measured: Callable[[str], Found | None],
    differ: Callable[[Found, Found], bool],
) -> tuple[tuple[str, str], ...]:
    """Return each change as `changes` does, with every member measured once.

    Each is compared with the first after the last change, so that small differences cannot add up unseen.
    """
    pairs = []
    level: Found | None = None
    before = ""
    for member in members:
        found = measured(member)
        if found is None:
            continue
        if level is None or differ(level, found):
            if level is not None:
                pairs.append((before, member))
            level = found
        before = member
    return tuple(pairs)
