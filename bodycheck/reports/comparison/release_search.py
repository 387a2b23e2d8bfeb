"""Search an ordered list of releases for changes of a measure; suggest the command that does so."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from bodycheck.adapters.registry import distribution_of
from bodycheck.adapters.versions.pins import is_version, pin_of
from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.headlines import ORIENTATION, by_method
from bodycheck.reports.measurement.case import scenario_spec
from bodycheck.reports.run_files.run_reader import Tables

Found = TypeVar("Found")


def changes(
    members: Sequence[str],
    measured: Callable[[str], Found | None],
    differ: Callable[[Found, Found], bool],
) -> tuple[tuple[str, str], ...]:
    """Bisect for changes; return each as the last member before it and the first after it, in order.

    Both ends are measured, then the interval is halved until two neighbours differ; then the same from there
    to the end. This finds every difference between the ends in 2 + log2(n) measurements per change. A change
    that was undone between two measured members is missed. No member is measured twice.

    members: ordered and distinct. measured: returns None for a member that cannot be measured; such members
    are skipped, and may lie between the two of a pair. differ: whether two findings are different.
    """
    known: dict[str, Found | None] = {}

    def found(index: int) -> Found | None:
        member = members[index]
        if member not in known:
            known[member] = measured(member)
        return known[member]

    def first_of(indices: Sequence[int]) -> int | None:
        return next((index for index in indices if found(index) is not None), None)

    def different(one: int, other: int) -> bool:
        a, b = found(one), found(other)
        assert a is not None
        assert b is not None
        return differ(a, b)

    start, end = first_of(range(len(members))), first_of(range(len(members) - 1, -1, -1))
    pairs = []
    while start is not None and end is not None and different(start, end):
        low, high = start, end
        while (middle := first_of(_from_middle(low, high))) is not None:
            if different(start, middle):
                high = middle
            else:
                low = middle
        pairs.append((members[low], members[high]))
        start = high
    return tuple(pairs)


def _from_middle(low: int, high: int) -> list[int]:
    """Return the indices between two others, from the middle outwards."""
    return sorted(range(low + 1, high), key=lambda index: abs(2 * index - low - high))


def every_change(
    members: Sequence[str],
    measured: Callable[[str], Found | None],
    differ: Callable[[Found, Found], bool],
) -> tuple[tuple[str, str], ...]:
    """Return the changes as `changes` does, but measure every member once.

    Each member is compared with the first one after the last change, so that slow drifts are detected.
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


_PREFIXES = {"order": "order.", "verdict": "verdict."}
_STATUSES = ("worse", "improved", "moved")


def release_searches(comparison: Comparison) -> Iterator[str]:
    """Yield a `bodycheck versions ...` command for each engine whose release and measures both changed.

    The command searches for the change with the largest factor among the worse ones, else among the improved,
    else among the moved ones.
    """
    for engine in dict.fromkeys(one.engine for one in by_method(comparison.changes)):
        versions = [_version(run, engine) for run in (comparison.before, comparison.after)]
        since, until = versions
        if since is None or until is None or since == until or _distribution(engine) is None:
            continue
        if (
            change := _best_change(change for change in comparison.changes if change.engine == engine)
        ) is not None:
            yield _command(comparison.after, change, *sorted((since, until), key=_numbers))


def _version(run: Tables, engine: str) -> str | None:
    version = run.manifest["engines"].get(engine, {}).get("version")
    return version if isinstance(version, str) and is_version(version) else None


def _distribution(engine: str) -> str | None:
    pin = pin_of(engine)
    return distribution_of(engine) if pin is None else None


def _numbers(version: str) -> list[int]:
    return [int(number) for number in version.split(".") if number.isdecimal()]


def _best_change(changes: Iterable[Change]) -> Change | None:
    """Return the change to search for: of a measure, else of an order or a verdict."""
    kinds = ("accuracy", "order", "verdict")
    found = [one for one in changes if one.kind in kinds and one.status in _STATUSES]

    def rank(one: Change) -> tuple[int, int, bool, float]:
        size = one.size if one.kind == "accuracy" else 0.0
        return _STATUSES.index(one.status), kinds.index(one.kind), one.quantity != ORIENTATION, -size

    return min(found, key=rank, default=None)


def _command(run: Tables, change: Change, since: str, until: str) -> str:
    key = change.scenario, change.engine, change.method
    rows = (case.columns for case in run.cases)
    own_row = next(row for row in rows if (row["scenario"], row["engine"], row["method"]) == key)
    measure = _PREFIXES.get(change.kind, "") + change.quantity.rpartition(" ")[2]
    arguments = ["bodycheck", "versions", change.engine, "--since", since, "--until", until]
    arguments += ["--scenario", scenario_spec(own_row["reproduce"]) or str(change.scenario)]
    arguments += ["--method", change.method, "--measure", measure]
    if change.control == "dt" and change.fineness is not None:
        arguments += ["--dt", repr(change.fineness)]
    if change.status == "moved":
        arguments += ["--threshold", "0"]
    return shlex.join(arguments)
