"""Render the report of a run as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial

from markupsafe import Markup

from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.render.page.cheapest_settings import START, TOLERANCES, CheapestSettings
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, cost_sentences, costs, fronts
from bodycheck.reports.render.page.plots import overall_data
from bodycheck.reports.render.page.scenario_section import anchor_of, method_anchor, sections_of
from bodycheck.reports.render.styles import REFERENCE, Style, engine_colour, heading, styles
from bodycheck.reports.run_files.run_tables import MethodKey, Run, key_of
from bodycheck.reports.summary.cells import faults_of
from bodycheck.reports.summary.method_identity import known_map_text, laws_text, rows_by_method
from bodycheck.reports.summary.sentences import Summary
from bodycheck.reports.summary.worst_results import faulty
from bodycheck.reports.templating import asset, environment

_SCRIPTS = (
    *(
        "page",
        "state",
        "looks",
        "lines",
        "plots",
        "overall",
        "legend",
        "sections",
        "turning",
        "drawing",
        "motion",
    ),
    *("answers", "tables", "links"),
)
"""In order of dependence: each may use those before it."""


_WITHOUT_CASES = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>bodycheck</title><p>This run has no cases.</p></html>
"""


def render_report(run: Run) -> str:
    """Return the report of a run as one HTML page that needs no other file and no network."""
    if not run.cases:
        return _WITHOUT_CASES
    summary = Summary.of(run)
    drawn = styles(key_of(case.columns) for case in run.cases)
    by_error = {error: costs(run.problems, run.cases, error) for error in ERRORS}
    front = {error: fronts(found) for error, found in by_error.items()}
    columns = _engines_first(drawn)
    sections = sections_of(run, summary.cells, drawn)
    return (
        environment()
        .get_template("report.html")
        .render(
            run=run,
            title=f"bodycheck {run.run_id}",
            findings=faulty(summary.worst),
            sentences=[*summary.sentences, *cost_sentences(front)],
            states=STATES,
            anchor=anchor_of,
            method_anchor=method_anchor,
            heading=heading,
            engine_colour=engine_colour,
            reference=REFERENCE,
            styles=columns,
            first_order=_first_order(run, columns),
            styles_data=[asdict(style) for style in drawn.values()],
            answers=CheapestSettings(run),
            tolerances=TOLERANCES,
            start=START,
            sections=sections,
            known_map=partial(known_map_text, rows_by_method(run.rows("fingerprints"))),
            laws=partial(laws_text, rows_by_method(run.rows("laws"))),
            map_data=[
                section.parts[key].map_data if key in section.parts else None
                for section in sections
                for key in columns
            ],
            worst=summary.worst,
            shown_states={cell.state for methods in summary.cells.values() for cell in methods.values()},
            faults=faults_of(run.cases),
            errors=ERRORS,
            fronts=front,
            has_speed=any("cpu_s" in case.columns for case in run.cases),
            overall=overall_data(by_error, drawn),
            css=asset("templates/report.css"),
            js=Markup("\n").join(asset(f"templates/{name}.js") for name in _SCRIPTS),
            plotly=asset("vendor/plotly-basic.min.js"),
        )
    )


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
