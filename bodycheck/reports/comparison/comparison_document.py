"""Describe a comparison: sentences on what was compared and what changed, tables of changes, searches."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, get_args

from bodycheck._util.formatting import count, names, number, setting
from bodycheck._util.source_commit import commit_range, comparison_url
from bodycheck.adapters.engine_names import is_version, pin_of
from bodycheck.adapters.registry import distribution_of
from bodycheck.reports.alerts import Alert
from bodycheck.reports.comparison.change import FAILING, Change, Kind, Status
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.environment_diff import BUILD_OF
from bodycheck.reports.comparison.headlines import (
    Headline,
    distinct,
    factor,
    headlines,
    largest_error,
    lines_of,
    moved_text,
    moved_texts,
)
from bodycheck.reports.comparison.overlays import overlays_of
from bodycheck.reports.document import Command, Document, Sentence, Table, page
from bodycheck.reports.measurement.case import scenario_spec
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.render.styles import engine_colour, heading
from bodycheck.reports.run_files.run_tables import Tables, study_key
from bodycheck.reports.table_layout import MEDIA, Column, Span

HEADINGS: dict[Status, str] = {
    "worse": "Worse",
    "missing": "No longer measured",
    "improved": "Improved",
    "moved": "Moved",
    "new": "New",
}
"""Status -> heading, the most severe first."""

_TINTS: dict[Status, str] = {
    "worse": "bad",
    "missing": "bad",
    "improved": "good",
    "moved": "open",
    "new": "open",
}
_MAX_LINES = 20


@dataclass(frozen=True)
class ChangeGroup:
    """The changes of one kind and status, for one method on one scenario, the largest first."""

    status: Status
    kind: Kind
    scenario: str | None
    method: str
    changes: tuple[Change, ...]

    @property
    def where(self) -> str:
        """The scenario, or "all scenarios" if the change is of the method as a whole."""
        return "all scenarios" if self.scenario is None else self.scenario

    @property
    def text(self) -> str:
        """The first change and the number of further ones."""
        if len(self.changes) == 1:
            return change_text(self.first)
        cases = {(change.control, change.fineness) for change in self.changes}
        more = f"{count(len(self.changes) - 1, 'more change')}, in {count(len(cases), 'case')}"
        more = count(len(cases) - 1, "more case") if self.kind == "case" else more
        return f"{change_text(self.first)}; {more}"

    @property
    def first(self) -> Change:
        """The change that the headlines name: the largest of the orientation error, else the largest."""
        return largest_error(self.changes) or self.changes[0]

    @property
    def row(self) -> tuple[str, str, Span, str, Span]:
        """The cells of a table of changes; a page unfolds every single change of the group."""
        others = tuple(change_text(change) for change in self.changes) if len(self.changes) > 1 else ()
        kind = Span(self.kind, _TINTS[self.status])
        return self.where, self.method, kind, factor(self.first), Span(self.text, items=others)


def groups(changes: Iterable[Change]) -> list[ChangeGroup]:
    """Return the changes in groups, failing ones first, then by kind, then by size."""
    found: dict[tuple[Status, Kind, str | None, str], list[Change]] = {}
    for change in changes:
        key = (change.status, change.kind, change.scenario, f"{change.engine}:{change.method}")
        found.setdefault(key, []).append(change)
    made = [ChangeGroup(*key, tuple(members)) for key, members in found.items()]
    statuses, kinds = list(HEADINGS), get_args(Kind)
    return sorted(
        made,
        key=lambda group: (
            statuses.index(group.status),
            kinds.index(group.kind),
            -group.changes[0].size,
        ),
    )


def change_text(change: Change) -> str:
    """Return one change as text, without its scenario and method."""
    at = "" if change.fineness is None else f" at {setting(change.control, change.fineness)}"
    if change.kind == "speed":
        assert change.decades is not None
        word = "slow" if change.decades > 0.0 else "fast"
        return f"{number(10.0 ** abs(change.decades), 3)} times as {word}"
    if change.kind == "case":
        kind, outcome = ("new", change.after) if change.before is None else ("missing", change.before)
        return f"{kind} case{at} ({outcome})"
    before, after = distinct(change, 4)
    size = factor(change)
    return f"{change.quantity} {before} -> {after}{f' ({size})' * bool(size)}{at}"


def identity(tables: Tables) -> str:
    """Return the run's id, its time and its bodycheck version."""
    manifest = tables.manifest
    return f"{tables.run_id}, {manifest['created']}, bodycheck {manifest['bodycheck']}"


def sentences(comparison: Comparison) -> list[str]:
    """Return what changed, one sentence per method, then the environment and how much was compared."""
    lines = lines_of(comparison)
    changed = [*headlines(lines), *(f"{text}." for text in moved_texts(comparison, lines))]
    is_changed = any(change.status != "new" for change in comparison.changes)
    return [*(changed if is_changed else [nothing(comparison)]), *scope(comparison, lines)]


def scope(comparison: Comparison, lines: Iterable[Headline]) -> list[str]:
    """Return how much else changed, the environment, and how much was compared.

    A different build under the same version comes first, because no version number shows it.
    """
    found = []
    if collapsed := _collapsed(comparison, lines):
        found.append(collapsed)
    if not comparison.environment:
        found.append("The same machine, versions and settings.")
    else:
        rebuilt = any(one.startswith(BUILD_OF) for one in comparison.environment)
        found.insert(
            0 if rebuilt else len(found),
            f"Different environment: {'; '.join(comparison.environment)}.",
        )
    if commits := commits_of(comparison):
        found.append(f"Commits {commits}")
    if comparison.redefined:
        found.append(f"Not compared (scenario definition changed): {names(comparison.redefined)}.")
    came, went = (
        sum(change.kind == "case" for change in comparison.of_status(status)) for status in ("new", "missing")
    )
    timed = f", {comparison.timed} of them also by speed" if comparison.timed else ""
    compared = f"{count(comparison.paired, 'case')} compared{timed}"
    refined = (
        f"; {comparison.refined} not compared, because only one of the runs chose their steps"
        if comparison.refined
        else ""
    )
    return [*found, f"{compared}; {count(came, 'new case')}, {count(went, 'missing case')}{refined}."]


def commits_of(comparison: Comparison) -> str:
    """Return the range of commits between the runs, with the address that shows it; "" if unknown."""
    manifests = comparison.before.manifest, comparison.after.manifest
    url = comparison_url(*manifests)
    return commit_range(*manifests) + (f": {url}" if url else "")


def _collapsed(comparison: Comparison, lines: Iterable[Headline]) -> str:
    """Return how many values changed, of which consoles list those that fail."""
    failing = ((status, comparison.of_status(status)) for status in FAILING)
    parts = [f"{len(changes)} {status}" for status, changes in failing if changes]
    better = (one for line in lines if line.direction == "improved" for one in line.changes)
    if improved := [one for one in better if one.status == "improved"]:
        parts.append(f"{len(improved)} improved")
    if moved := comparison.of_status("moved"):
        parts.append(f"{len(moved)} moved{moved_text(moved, comparison.thresholds)}")
    if parts and (new := comparison.of_status("new")):
        parts.append(f"{len(new)} new")
    return f"Changed values: {', '.join(parts)}." if parts else ""


def nothing(comparison: Comparison) -> str:
    """Return the sentence of a comparison without changes."""
    if not comparison.paired:
        return "Nothing could be compared."
    return "Nothing changed beyond round-off and the noise of the machines."


def change_tables(changes: Iterable[Change], rest: str) -> tuple[Table, ...]:
    """Return one table per status, the largest factors first and before them changes without a size.

    Consoles and Markdown show only the failing ones, shortened. rest: text that says where the rest of a long
    table is.
    """
    made = sorted(groups(changes), key=lambda group: -group.changes[0].size)
    columns = (
        Column("scenario", "name"),
        Column("engine:method", "name"),
        Column("kind", "fixed", only=("page",)),
        Column("size", "number", only=("page",)),
        Column("change"),
    )
    return tuple(
        Table(
            columns,
            tuple(group.row for group in made if group.status == status),
            heading,
            _TINTS[status],
            max_rows=_MAX_LINES,
            rest=rest,
            folded=status not in FAILING,
            only=MEDIA if status in FAILING else ("page",),
        )
        for status, heading in HEADINGS.items()
    )


def searches(comparison: Comparison) -> list[Command]:
    """Return the commands that find the releases of the changes."""
    return [Command(line, "To find the release") for line in release_searches(comparison)]


def comparison_document(comparison: Comparison) -> Document:
    """Return the largest change, the other sentences, the searches, the tables of changes, and the runs."""
    runs = (("before", identity(comparison.before)), ("after", identity(comparison.after)))
    first, *others = sentences(comparison)
    return Document(
        "bodycheck: what changed between two runs",
        (
            Sentence(first, "bad" if comparison.failing else "none", strong=True),
            *(Sentence(sentence) for sentence in others),
            *searches(comparison),
            *change_tables(comparison.changes, "--html FILE lists all"),
            Table((Column("", "fixed"), Column("")), runs),
        ),
    )


def alerts_of(comparison: Comparison, statuses: Collection[Status]) -> list[Alert]:
    """Return one alert per method that fails, or of several with one cause: an error, or else a warning.

    statuses: those of changes that fail; empty for worse and missing ones, which then only warn.
    """
    if not comparison.paired:
        texts = [nothing(comparison)]
    else:
        listed = [line for line in lines_of(comparison) if line.direction in ("worse", *statuses)]
        texts = [line.text for line in listed]
        texts += moved_texts(comparison, listed) if "moved" in statuses else []
    return [Alert("regression", text, "error" if statuses else "warning") for text in texts]


def comparison_data(comparison: Comparison) -> dict[str, Any]:
    """Return the comparison as data: the runs, the sentences and every single change."""
    return {
        "before": {key: comparison.before.manifest[key] for key in ("run_id", "created", "bodycheck")},
        "after": {key: comparison.after.manifest[key] for key in ("run_id", "created", "bodycheck")},
        "sentences": sentences(comparison),
        "commits": commits_of(comparison),
        "cases_compared": comparison.paired,
        "cases_compared_by_speed": comparison.timed,
        "changes": comparison.changes,
    }


def comparison_page(comparison: Comparison) -> str:
    """Return all changes as one self-contained HTML page, with the errors of both runs over each other."""
    named, others = overlays_of(comparison)
    return page(
        comparison_document(comparison),
        "compare.html",
        threshold=100.0 * comparison.thresholds.default,
        overlays=named,
        more_overlays=others,
        change_text=change_text,
        engine_colour=engine_colour,
        heading=heading,
    )


_PREFIXES = {"order": "order.", "verdict": "verdict."}
_STATUSES = ("worse", "improved", "moved")


def release_searches(comparison: Comparison) -> Iterator[str]:
    """Yield a `bodycheck versions ...` command for each engine whose release and measures both changed.

    The command searches for the change with the largest factor among the worse ones, else among the improved,
    else among the moved ones.
    """
    engines = [one.engine for one in lines_of(comparison)]
    for engine in dict.fromkeys([*engines, *(one.engine for one in comparison.changes)]):
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
    own_row = next(row for row in rows if study_key(row) == key)
    measure = _PREFIXES.get(change.kind, "") + change.quantity.rpartition(" ")[2]
    arguments = ["bodycheck", "versions", change.engine, "--since", since, "--until", until]
    arguments += ["--scenario", scenario_spec(own_row["reproduce"]) or str(change.scenario)]
    arguments += ["--method", change.method, "--measure", measure]
    if change.control == "dt" and change.fineness is not None:
        arguments += ["--dt", repr(change.fineness)]
    if change.status == "moved":
        arguments += ["--threshold", "0"]
    return shlex.join(arguments)
