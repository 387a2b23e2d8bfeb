"""The releases of an engine between which a measure changed: the search, its findings and its report."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from glob import escape
from typing import Any, TypeVar

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count, names, number
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.gates.gate import Gate, GateMeasure, measure_of
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.gates.verdict import rows_of
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.reports.table_layout import Column

_Result = TypeVar("_Result")


def changes(
    members: Sequence[str],
    measured: Callable[[str], _Result | None],
    differ: Callable[[_Result, _Result], bool],
) -> tuple[tuple[str, str], ...]:
    """Bisect for changes; return each as the last member before it and the first after it, in order.

    Both ends are measured, then the interval is halved until two neighbours differ; then the same from there
    to the end. This finds every difference between the ends in 2 + log2(n) measurements per change. A change
    that was undone between two measured members is missed. No member is measured twice.

    members: ordered and distinct. measured: returns None for a member that cannot be measured; such members
    are skipped, and may lie between the two of a pair. differ: whether two findings are different.
    """
    known: dict[str, _Result | None] = {}

    def found(index: int) -> _Result | None:
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
    measured: Callable[[str], _Result | None],
    differ: Callable[[_Result, _Result], bool],
) -> tuple[tuple[str, str], ...]:
    """Return the changes as `changes` does, but measure every member once.

    Each member is compared with the first one after the last change, so that slow drifts are detected.
    """
    pairs = []
    level: _Result | None = None
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


_ABSOLUTE = "_abs"


def comparable(name: str) -> GateMeasure:
    """Return the measure of that name; names are those of gates.

    Raises InputError if the measure is unknown, or if runs are not compared by it.
    """
    try:
        measure = measure_of(name)
    except ValueError as error:
        raise InputError(f"--measure {name}: {error}") from None
    if measure.is_speed:
        raise InputError(f"--measure {name}: cannot search by speed: it varies from run to run")
    in_results = measure.source == "results" and not measure.choices
    if measure.source == "laws" or (in_results and name.removesuffix(_ABSOLUTE) not in MEASURES):
        raise InputError(f"--measure {name}: runs are not compared by it; see bodycheck list measures")
    return measure


@dataclass(frozen=True, eq=False)
class ReleaseFinding:
    """The value of a measure in one run: a finite number or a word; None if there is none, and then why."""

    value: float | str | None
    why: str
    tables: Tables | None = None


@dataclass(frozen=True)
class OneMeasure:
    """One measure of one method on one scenario.

    fineness: the step or the tolerance; None if the measure covers all of them. thresholds: the sizes above
    which a change counts.
    """

    scenario: str
    engine: str
    method: str
    name: str
    control: str
    fineness: float | None
    thresholds: Thresholds = DEFAULT_THRESHOLDS

    def finding(self, tables: Tables) -> ReleaseFinding:
        """Return the value of the measure in a run."""
        of_case = comparable(self.name).source == "results"
        gate = Gate(
            scenario=escape(self.scenario),
            engine=self.engine,
            method=self.method,
            dt_s=self.fineness if of_case and self.control == "dt" else None,
            tolerance=self.fineness if of_case and self.control == "tolerance" else None,
            measure=self.name,
            reason="requested",
        )
        for row in rows_of(gate, tables):
            return ReleaseFinding(row.obtained, row.why, tables)
        # a scene that the method does not support is not run at the finer steps
        first = next(case.columns for case in tables.cases if case.columns["method"] == self.method)
        return ReleaseFinding(None, f"{first['outcome']}: {first['message']}", tables)

    def differ(self, before: ReleaseFinding, after: ReleaseFinding) -> bool:
        """Whether two runs differ in this measure: words by equality, numbers as in `compare`.

        A change below the threshold is not a difference. Two missing values are equal; a missing value
        differs from any other.
        """
        a, b = before.value, after.value
        if isinstance(a, str) or isinstance(b, str) or a is None or b is None:
            return a != b
        assert before.tables is not None
        assert after.tables is not None
        return any(
            (change.scenario, change.engine, change.method) == (self.scenario, self.engine, self.method)
            and change.quantity in self._quantities_of
            and self._is_of(change.fineness)
            for change in compare(before.tables, after.tables, self.thresholds).of_status("worse", "improved")
        )

    @property
    def _quantities_of(self) -> tuple[str, ...]:
        """The quantities under which a comparison reports changes of this measure, if it is a number."""
        measure = comparable(self.name)
        if measure.quantity is not None:
            return (f"order of {measure.quantity}",)
        return (measure.column, measure.column.removesuffix(_ABSOLUTE))

    def _is_of(self, fineness: float | None) -> bool:
        return fineness is None or fineness == self.fineness


_FEWEST_DIGITS, _ALL_DIGITS = 3, 17


@dataclass(frozen=True, eq=False)
class Track:
    """One method across releases: the findings of those that were run, and the changes between them."""

    method: str
    findings: Mapping[str, ReleaseFinding]
    changes: tuple[tuple[str, str], ...]


@dataclass(frozen=True, eq=False)
class Found:
    """The result of a search through releases.

    versions: all releases, oldest first. failed: release -> reason. every: whether every release was run.
    """

    engine: str
    scenario: str
    measure: str
    versions: tuple[str, ...]
    tracks: tuple[Track, ...]
    failed: Mapping[str, str]
    every: bool = False


def found_document(found: Found) -> Document:
    """Return one line per method, the releases that were run, oldest first, and the failed ones."""
    texts = {track.method: _texts(found, track) for track in found.tracks}
    run = [version for version in found.versions if any(version in known for known in texts.values())]
    amounts = f"{count(len(found.versions), 'release')} from {found.versions[0]} to {found.versions[-1]}"
    columns = tuple(Column(head, "fixed") for head in (found.engine, *texts))
    rows = tuple((version, *(known.get(version, "") for known in texts.values())) for version in run)
    about = f"{found.measure} on {found.scenario}; {amounts}, {len(run)} of them run"
    failed = [f"not run: {version}: {why}" for version, why in found.failed.items()]
    return Document(
        f"bodycheck: releases of {found.engine}",
        (*map(Sentence, (*found_sentences(found), about)), Table(columns, rows), *map(Sentence, failed)),
    )


def found_data(found: Found) -> dict[str, Any]:
    """Return the search as data: its findings, changes and sentences."""
    return {**vars(found), "sentences": found_sentences(found)}


def found_sentences(found: Found) -> list[str]:
    """Return where each method changed, those that did first; first of all the releases, if all were run.

    The first sentence names the measure.
    """
    lines = [
        f"{found.engine}:{track.method}: {sentence(found, track, _texts(found, track))}"
        for track in sorted(found.tracks, key=lambda track: not track.changes)
    ]
    if found.every:
        return [f"{found.measure} {_changed_in(found)}", *lines]
    return [f"{found.measure} of {line}" if line is lines[0] else line for line in lines]


def sentence(found: Found, track: Track, texts: Mapping[str, str]) -> str:
    """Return where the measure of a method changed, as "2.00 up to 3.17.0, 4.00 from 4.0.0"."""
    run = [version for version in found.versions if version in texts]
    if not track.changes:
        if len(run) == 1:
            return f"{texts[run[0]]} in {run[0]}, the only release run"
        if found.every:
            return f"{texts[run[-1]]} in all {len(run)} releases run"
        same = f"{texts[run[-1]]} in {run[-1]}, as in {run[0]}"
        return f"{same}; a change that was undone between them would be missed"
    before, after = zip(*track.changes, strict=True)
    parts = [f"{texts[run[0]]} up to {before[0]}"]
    parts += [f"{texts[start]} from {start} to {end}" for start, end in zip(after, before[1:], strict=False)]
    parts.append(f"{texts[after[-1]]} from {after[-1]}")
    return "; ".join([", ".join(parts), *_unresolved(found, track)])


def _changed_in(found: Found) -> str:
    """Return the releases in which any method changed, with these methods."""
    changed = {
        version: [track.method for track in found.tracks if version in (after for _, after in track.changes)]
        for version in found.versions
    }
    parts = [f"{version} ({', '.join(methods)})" for version, methods in changed.items() if methods]
    return f"changed in {', '.join(parts)}" if parts else "changed in no release"


def _unresolved(found: Found, track: Track) -> list[str]:
    """Return which releases between two that differ could not be run; empty if there are none."""
    indices = {version: index for index, version in enumerate(found.versions)}
    unknown = [
        version
        for before, after in track.changes
        for version in found.versions[indices[before] + 1 : indices[after]]
    ]
    return [f"{names(unknown)} between them could not be run"] if unknown else []


def _texts(found: Found, track: Track) -> dict[str, str]:
    """Return the value of each release, with as many digits as distinguish both sides of each change."""
    for digits in range(_FEWEST_DIGITS, _ALL_DIGITS + 1):
        texts = {
            version: _text(finding, digits, is_order=found.measure.startswith("order."))
            for version, finding in track.findings.items()
        }
        if all(texts[before] != texts[after] for before, after in track.changes):
            break
    return texts


def _text(finding: ReleaseFinding, digits: int, *, is_order: bool) -> str:
    if finding.value is None:
        return f"none ({finding.why})"
    if isinstance(finding.value, str):
        return finding.value
    return f"{finding.value:.{digits - 1}f}" if is_order else number(finding.value, digits)
