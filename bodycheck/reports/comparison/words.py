"""A comparison in words: what was compared, what changed, alike changes together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from bodycheck.reports.comparison.change import Change, Direction, Kind
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.stored import Tables
from bodycheck.reports.wording import count, names, number, setting

HEADINGS: dict[Direction, str] = {"worse": "Worse", "better": "Better", "other": "Otherwise different"}
_KINDS: tuple[Kind, ...] = ("outcome", "verdict", "order", "stability", "accuracy", "speed", "case")


@dataclass(frozen=True)
class Group:
    """Changes of one kind and direction, of one method on one scenario, the largest first."""

    direction: Direction
    kind: Kind
    scenario: str | None
    method: str
    changes: tuple[Change, ...]

    @property
    def where(self) -> str:
        """The scenario; all, where the method as a whole is meant."""
        return "all scenarios" if self.scenario is None else self.scenario

    @property
    def text(self) -> str:
        """The largest change, and how many more there are."""
        first, *others = self.changes
        if not others:
            return change_text(first)
        cases = {(change.control, change.fineness) for change in self.changes}
        more = f"{count(len(others), 'more change')}, in {count(len(cases), 'case')}"
        return f"{change_text(first)}; {count(len(cases) - 1, 'more case') if self.kind == 'case' else more}"


def groups(changes: Iterable[Change]) -> list[Group]:
    """Return the changes in groups, worse ones first, then by kind, then by size."""
    found: dict[tuple[Direction, Kind, str | None, str], list[Change]] = {}
    for change in changes:
        key = (change.direction, change.kind, change.scenario, f"{change.engine}:{change.method}")
        found.setdefault(key, []).append(change)
    made = [Group(*key, tuple(alike)) for key, alike in found.items()]
    directions = list(HEADINGS)
    return sorted(
        made,
        key=lambda group: (
            directions.index(group.direction),
            _KINDS.index(group.kind),
            -group.changes[0].size,
        ),
    )


def change_text(change: Change) -> str:
    """Return one change in words, but for whose it is."""
    at = _at(change)
    if change.kind == "speed":
        assert change.decades is not None
        how = "slow" if change.decades > 0.0 else "fast"
        return f"{number(10.0 ** abs(change.decades), 3)} times as {how}"
    if change.kind == "case":
        which, outcome = ("after", change.after) if change.before is None else ("before", change.before)
        return f"only in the run {which}{at} ({outcome})"
    before, after = _apart(change.before, change.after)
    decades = "" if change.decades is None else f" ({_decades(change.decades)} decades)"
    return f"{change.what} {before} -> {after}{decades}{at}"


def _at(change: Change) -> str:
    """Return the step or tolerance of a change, if it is that of one case."""
    return "" if change.fineness is None else f" at {setting(change.control, change.fineness)}"


def _apart(before: float | str | None, after: float | str | None) -> tuple[str, str]:
    """Return both to as many digits as tell them apart, but at least four."""
    for digits in range(4, 18):
        texts = tuple(_value(value, digits) for value in (before, after))
        if texts[0] != texts[1]:
            break
    return texts[0], texts[1]


def _value(value: float | str | None, digits: int) -> str:
    if value is None:
        return "not measured"
    return value if isinstance(value, str) else number(value, digits)


def _decades(decades: float) -> str:
    return f"{decades:+.2f}" if abs(decades) >= 0.01 else f"{decades:+.0e}".replace("e-0", "e-")


def identity(tables: Tables) -> str:
    """Return which run it is."""
    manifest = tables.manifest
    return f"{tables.run_id}, {manifest['created']}, bodycheck {manifest['bodycheck']}"


def sentences(comparison: Comparison) -> list[str]:
    """Return under what circumstances, how much was compared, and how much changed."""
    changes = comparison.changes
    came = sum(change.kind == "case" and change.before is None for change in changes)
    went = sum(change.kind == "case" and change.after is None for change in changes)
    found = [
        f"Different circumstances: {'; '.join(comparison.circumstances)}."
        if comparison.circumstances
        else "The same machine, versions and settings."
    ]
    if comparison.redefined:
        found.append(f"Not compared, as the name means another scenario: {names(comparison.redefined)}.")
    compared = f"{count(comparison.paired, 'case')} compared, {comparison.timed} of them by their speed too"
    found.append(f"{compared}; {came} only in the run after, {went} only in the run before.")
    found.append(_told(changes) if changes else _nothing(comparison))
    return found


def _nothing(comparison: Comparison) -> str:
    if not comparison.paired:
        return "There is nothing that could be compared."
    return "Nothing changed beyond round-off and the noise of the machines."


def _told(changes: Iterable[Change]) -> str:
    made = groups(changes)
    parts = []
    for direction, heading in HEADINGS.items():
        alike = [group for group in made if group.direction == direction and group.kind != "case"]
        if alike:
            methods = list(dict.fromkeys(group.method for group in alike))
            parts.append(f"{heading}: {names(methods)}")
    return f"{'. '.join(parts)}." if parts else "The cases that both runs have did not change."
