"""Render the report of a run as HTML: one self-contained page, or several linked ones for a large run."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from itertools import accumulate
from pathlib import Path
from typing import Any
from urllib.parse import quote

from markupsafe import Markup

from bodycheck._util.formatting import step
from bodycheck.adapters.engine_names import REFERENCE
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.render.page.cheapest_settings import START, TOLERANCES, CheapestSettings
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, cost_sentences, costs, fronts
from bodycheck.reports.render.page.played_motions import TRACKS
from bodycheck.reports.render.page.plots import overall_data
from bodycheck.reports.render.page.scenario_section import (
    MapRow,
    Section,
    anchor_of,
    method_anchor,
    sections_of,
)
from bodycheck.reports.render.styles import Style, engine_colour, heading, styles
from bodycheck.reports.run_files.report_files import further_pages
from bodycheck.reports.run_files.run_tables import MethodKey, Run, key_of
from bodycheck.reports.run_files.tables import Row
from bodycheck.reports.summary.cells import Cell, faults_of
from bodycheck.reports.summary.method_identity import known_map_text, laws_text, rows_by_method
from bodycheck.reports.summary.sentences import Summary, verdict_sentences
from bodycheck.reports.summary.worst_results import faulty
from bodycheck.reports.templating import asset, rendered

_SCRIPTS = (
    *(
        "page",
        "state",
        "plot_style",
        "lines",
        "plots",
        "overall",
        "legend",
        "sections",
        "quaternions",
        "drawing",
        "motion",
    ),
    *("answers", "tables", "links"),
)
"""In order of dependence: each may use those before it."""


_WITHOUT_CASES = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>bodycheck</title><p>This run has no cases.</p></html>
"""

_ONE_PAGE = 12_000_000
"""The largest total of sections and rows of maps, in bytes, on one page: with the rest it has 15 MB."""

_NEXT_PAGES = 4_000_000
"""The same for each page of a run that is too large for one."""

_ROW, _CELL = 3_000, 900
"""Bytes of a scenario, and of a method on it, in the maps and answers of a page, rounded up."""

_MOST_CELLS = 15_000
"""The largest number of cells in the map on the first page of a run that has several."""

_MOST_ROWS = 500
"""The largest number of rows in a table of cases."""

_MOST_TRACKS = 500
"""The largest number of motions in the report of a run: reading and measuring them takes the longest."""

_BATCH = 50  # scenarios whose sections are prepared together


@dataclass(frozen=True)
class ReportPart:
    """One of the pages with the scenarios of a run that is too large for one page.

    first, last: its scenarios. scenarios: their number. folder: of the pages, next to the first page.
    """

    number: int
    first: str
    last: str
    scenarios: int
    folder: str

    @property
    def path(self) -> str:
        """The path of the page, from the folder of the first one."""
        return f"{self.folder}/{self.file()}"

    @property
    def href(self) -> str:
        """The address of the page, from the first one."""
        return quote(self.path)

    def file(self, further: int = 0) -> str:
        """Return the name of the page, or of another one `further` after it."""
        return f"{self.number + further}.html"


def report_pages(run: Run, name: str = "report.html") -> Iterator[tuple[str, str]]:
    """Yield the pages of the report of a run, each with its path relative to the first one, which is last.

    Each page needs no network, and no other file. name: of the first page.
    """
    if not run.cases:
        yield name, _WITHOUT_CASES
        return
    report = _Report(run)
    folder = further_pages(Path(name)).name
    rows: list[MapRow] = []
    parts: list[ReportPart] = []
    held: list[_Rendered] = []
    limit = _ONE_PAGE

    def next_page(*, last: bool) -> tuple[str, str]:
        sizes = list(accumulate(one.size for one in held))
        amount = max(bisect_right(sizes, _NEXT_PAGES), 1)
        own = held[:amount]
        del held[:amount]
        parts.append(ReportPart(len(parts) + 1, own[0].row.name, own[-1].row.name, amount, folder))
        more = not last or bool(held)
        return parts[-1].path, report.part(parts[-1], own, home=f"../{quote(name)}", more=more)

    for section in report.sections():
        new = _Rendered(section.row, report.section(section))
        rows.append(new.row)
        while held and sum(one.size for one in held) + new.size > limit:
            limit = _NEXT_PAGES
            yield next_page(last=False)
        held.append(new)
    while parts and held:
        yield next_page(last=True)
    yield name, report.first(rows, [one.html for one in held], parts)


@dataclass(frozen=True, eq=False)
class _Rendered:
    """A section as HTML, and its row in the maps."""

    row: MapRow
    html: Markup

    @cached_property
    def size(self) -> int:
        """The bytes that it adds to a page, at most."""
        return len(self.html.encode()) + _ROW + _CELL * len(self.row.parts)


class _Report:
    """What the pages of a report share."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._summary = Summary.of(run)
        self._drawn = styles(key_of(case.columns) for case in run.cases)
        self._styles = _engines_first(self._drawn)
        self._by_scenario: dict[str, list[CaseResult]] = {}
        for case in run.cases:
            self._by_scenario.setdefault(case.columns["scenario"], []).append(case)
        self._studies = {table: _by_scenario(run.tables.get(table, ())) for table in ("methods", "stability")}
        self._tracks = _tracks(self._summary.cells)
        self._shared = {
            "run": run,
            "states": STATES,
            "method_anchor": method_anchor,
            "heading": heading,
            "engine_colour": engine_colour,
            "styles": self._styles,
            "own": _own(run, self._drawn),
            "sparse": _sparse(self._summary.cells, self._drawn),
            "first_order": _first_order(run, self._styles),
            "styles_data": [asdict(style) for style in self._drawn.values()],
            "tolerances": TOLERANCES,
            "start": START,
            "known_map": partial(known_map_text, rows_by_method(run.rows("fingerprints"))),
            "laws": partial(laws_text, rows_by_method(run.rows("laws"))),
            "errors": ERRORS,
            "most_rows": _MOST_ROWS,
            "with_motions": len(self._tracks),
            "js": Markup("\n").join(asset(f"templates/{name}.js") for name in _SCRIPTS),
            "plotly": asset("vendor/plotly-basic.min.js"),
        }

    def sections(self) -> Iterator[Section]:
        """Yield the sections of all scenarios, some of them at a time in memory."""
        names = [problem.scenario.name for problem in self._run.problems]
        for start in range(0, len(names), _BATCH):
            batch = self._run_of(names[start : start + _BATCH])
            yield from sections_of(batch, self._summary.cells, self._drawn, self._tracks)

    def section(self, section: Section) -> Markup:
        """Return the HTML of a section."""
        return Markup(rendered("scenario.html", self._shared, section=section))

    def part(self, part: ReportPart, own: Sequence[_Rendered], *, home: str, more: bool) -> str:
        """Return a page of some scenarios; home: the address of the first page; more: whether one follows."""
        run = self._run_of([one.row.name for one in own])
        return self._page(
            run,
            [one.row for one in own],
            sections=[one.html for one in own],
            link=_local_link,
            title=f"bodycheck {run.run_id}, {part.first} to {part.last}",
            answers=CheapestSettings(run),
            part=part,
            home=home,
            more=more,
        )

    def first(self, rows: Sequence[MapRow], sections: Sequence[Markup], parts: Sequence[ReportPart]) -> str:
        """Return the first page: that of the whole run, with its sections unless these are on `parts`."""
        run = self._run
        by_error = {error: costs(run.problems, run.cases, error) for error in ERRORS}
        front = {error: fronts(found) for error, found in by_error.items()}
        cells = sum(len(self._styles) for _ in rows)
        tried = {key_of(case.columns) for case in run.cases if case.columns["outcome"] != "unsupported"}
        return self._page(
            run,
            [] if parts and cells > _MOST_CELLS else rows,
            sections=sections,
            link=_link_to(parts, rows) if parts else _local_link,
            title=f"bodycheck {run.run_id}",
            answers=CheapestSettings(run, each=not parts),
            part=None,
            parts=parts,
            conclusion=self._summary.conclusion,
            failed=self._summary.failed,
            findings=faulty(self._summary.worst),
            alike=self._summary.shared,
            sentences=[*verdict_sentences(self._summary.cells, self._summary.worst), *cost_sentences(front)],
            worst=self._summary.worst,
            fronts=front,
            has_speed=any("cpu_s" in case.columns for case in run.cases),
            overall=overall_data(by_error, {key: own for key, own in self._drawn.items() if key in tried}),
        )

    def _page(self, run: Run, rows: Sequence[MapRow], **own: Any) -> str:
        """Return a page with the maps of some scenarios; run: with these scenarios."""
        cells = [row.parts.get(key) for row in rows for key in self._styles]
        return rendered(
            "report.html",
            self._shared,
            rows=rows,
            map_data={
                "rows": [step(row.at_s) for row in rows],
                "cells": [None if cell is None else cell.map_data for cell in cells],
            },
            shown_states={
                cell.state
                for problem in run.problems
                for cell in self._summary.cells[problem.scenario.name].values()
            },
            faults=faults_of(run.cases),
            **own,
        )

    def _run_of(self, names: Sequence[str]) -> Run:
        """Return the run with only some of its scenarios."""
        if len(names) == len(self._run.problems):
            return self._run
        known = set(names)
        run = replace(
            self._run,
            problems=tuple(problem for problem in self._run.problems if problem.scenario.name in known),
            cases=tuple(case for name in names for case in self._by_scenario.get(name, ())),
        )
        return run.with_rows(
            **{
                table: [row for name in names for row in rows.get(name, ())]
                for table, rows in self._studies.items()
            }
        )


def _by_scenario(rows: Iterable[Row]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["scenario"], []).append(row)
    return found


def _local_link(scenario: str, key: MethodKey | None = None) -> str:
    return f"#{anchor_of(scenario, key)}"


def _link_to(parts: Sequence[ReportPart], rows: Sequence[MapRow]) -> Callable[..., str]:
    """Return the function that gives the address of a scenario, or of a method on it, on its page."""
    names = iter(row.name for row in rows)
    pages = {next(names): part.href for part in parts for _ in range(part.scenarios)}

    def link(scenario: str, key: MethodKey | None = None) -> str:
        return f"{pages[scenario]}{_local_link(scenario, key)}"

    return link


def _tracks(cells: Mapping[str, Mapping[MethodKey, Cell]]) -> dict[str, int]:
    """Return the largest number of motions of each scenario; scenarios with findings come first."""
    engines = {engine for methods in cells.values() for engine, _ in methods}
    each = max(min(TRACKS, _MOST_TRACKS // max(len(cells), 1)), len(engines))
    ordered = sorted(
        cells, key=lambda name: not any(cell.wrong or cell.faults for cell in cells[name].values())
    )
    return dict.fromkeys(ordered[: max(_MOST_TRACKS // max(each, 1), 1)], each)


def _own(run: Run, drawn: Mapping[MethodKey, Style]) -> list[int]:
    """Return the numbers of the reference's methods that were not requested by name, beside engines."""
    named = run.manifest.get("request", {}).get("engines") or ()
    own = [style.number for style in drawn.values() if style.engine == REFERENCE and style.name not in named]
    return own if len(own) < len(drawn) else []


def _sparse(cells: Mapping[str, Mapping[MethodKey, Cell]], drawn: Mapping[MethodKey, Style]) -> list[int]:
    """Return the numbers of the methods that ran on less than half of the scenarios: maps fold them."""
    amounts = Counter(key for methods in cells.values() for key in methods)
    return [style.number for key, style in drawn.items() if 2 * amounts[key] < len(cells)]


def _first_order(run: Run, drawn: Mapping[MethodKey, Style]) -> list[int]:
    """Return the numbers of the engines' methods of order 1; empty if they have no others."""
    orders = {
        style.number: run.manifest["engines"][engine]["methods"][method]["order"]
        for (engine, method), style in drawn.items()
        if engine != REFERENCE
    }
    found = [number for number, order in orders.items() if order == 1]
    return found if 0 < len(found) < len(orders) else []


def _engines_first(drawn: Mapping[MethodKey, Style]) -> dict[MethodKey, Style]:
    """Return the styles with the methods of an engine next to each other, and the reference's own last."""
    engines = list(dict.fromkeys(engine for engine, _ in drawn))
    ordered = sorted(drawn, key=lambda key: (key[0] == REFERENCE, engines.index(key[0])))
    return {key: drawn[key] for key in ordered}
