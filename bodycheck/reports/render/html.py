"""Render the report of a run as one self-contained HTML page."""

from __future__ import annotations

from dataclasses import asdict

from markupsafe import Markup

from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, cost_sentences, costs, fronts
from bodycheck.reports.render.page.plots import overall_data
from bodycheck.reports.render.page.scenario_section import anchor_of, sections_of
from bodycheck.reports.render.styles import styles
from bodycheck.reports.run_files.run_tables import Run, key_of
from bodycheck.reports.summary.cells import faults_of, summary_cells
from bodycheck.reports.summary.sentences import verdict_sentences
from bodycheck.reports.summary.worst_results import worst_methods
from bodycheck.reports.templating import asset, environment

_SCRIPTS = ("page", "looks", "plots", "overall", "sections", "turning", "drawing", "motion", "links")
"""In order of dependence: each may use those before it."""


def render_report(run: Run) -> str:
    """Return the report of a run as one HTML page that needs no other file and no network."""
    cells = summary_cells(run)
    drawn = styles(key_of(case.columns) for case in run.cases)
    by_error = {error: costs(run.problems, run.cases, error) for error in ERRORS}
    front = {error: fronts(found) for error, found in by_error.items()}
    return (
        environment()
        .get_template("report.html")
        .render(
            run=run,
            sentences=[*verdict_sentences(run, cells), *cost_sentences(front)],
            states=STATES,
            anchor=anchor_of,
            styles=drawn,
            styles_data=[asdict(style) for style in drawn.values()],
            sections=sections_of(run, cells, drawn),
            worst=worst_methods(run),
            shown_states={cell.state for methods in cells.values() for cell in methods.values()},
            faults=faults_of(run.cases),
            fronts=front,
            has_speed=any("cpu_s" in case.columns for case in run.cases),
            overall=overall_data(by_error, drawn),
            css=asset("templates/report.css"),
            js=Markup("\n").join(asset(f"templates/{name}.js") for name in _SCRIPTS),
            plotly=asset("vendor/plotly-basic.min.js"),
        )
    )
