"""Render the report of a run as one self-contained HTML page."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.render import formatting
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, cost_sentences, costs, fronts
from bodycheck.reports.render.page.plots import overall_data
from bodycheck.reports.render.page.scenario_section import anchor_of, sections_of
from bodycheck.reports.render.styles import styles
from bodycheck.reports.summary.cells import faults_of, summary_cells
from bodycheck.reports.summary.run_tables import Run, key_of
from bodycheck.reports.summary.sentences import verdict_sentences
from bodycheck.reports.summary.worst_results import worst_methods


@cache
def environment() -> Environment:
    """Return the template environment: values are escaped, undefined names are errors."""
    environment = Environment(
        loader=PackageLoader("bodycheck.reports.render"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,  # avoids a disk access for each of about a thousand includes
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters |= {
        "number": formatting.number,
        "scientific": formatting.scientific,
        "step": formatting.step,
    }
    environment.globals |= {"count": formatting.count}
    return environment


def asset(path: str) -> Markup:
    """Return a file of this package that goes into the page unchanged."""
    return Markup((files("bodycheck.reports.render") / path).read_text(encoding="utf-8"))


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
