"""The report of a run: one page of HTML that holds all it shows and fetches nothing."""

from __future__ import annotations

from dataclasses import asdict
from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bodycheck.reports import wording
from bodycheck.reports.figures import overall_data, styles
from bodycheck.reports.page.front import ERRORS, cost_sentences, costs, fronts
from bodycheck.reports.page.section import anchor_of, sections_of
from bodycheck.reports.run import Run
from bodycheck.reports.summary import (
    STATES,
    faults_of,
    key_of,
    summary_cells,
    verdict_sentences,
    worst_state,
)

_SCRIPTS = ("page", "looks", "plots", "overall", "sections", "turning", "drawing", "motion", "links")
"""In the order in which they build on one another."""


def render_report(run: Run) -> str:
    """Return the report of a run as one HTML page that needs nothing else, not even a network."""
    cells = summary_cells(run)
    drawn = styles(key_of(case.columns) for case in run.cases)
    by_error = {error: costs(run.subjects, run.cases, error) for error in ERRORS}
    front = {error: fronts(found) for error, found in by_error.items()}
    return (
        _environment()
        .get_template("report.html")
        .render(
            run=run,
            sentences=[*verdict_sentences(run, cells), *cost_sentences(front)],
            states=STATES,
            styles=drawn,
            styles_data=[asdict(style) for style in drawn.values()],
            sections=sections_of(run, cells, drawn),
            worst={
                (scenario, key): worst_state(run, key, cell)
                for scenario, methods in cells.items()
                for key, cell in methods.items()
            },
            faults=faults_of(run.cases),
            fronts=front,
            has_speed=any("cpu_s" in case.columns for case in run.cases),
            overall=overall_data(by_error, drawn),
            css=_asset("templates/report.css"),
            js=Markup("\n").join(_asset(f"templates/{name}.js") for name in _SCRIPTS),
            plotly=_asset("vendor/plotly-basic.min.js"),
        )
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("bodycheck.reports"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters |= {
        "number": wording.number,
        "scientific": wording.scientific,
        "step": wording.step,
    }
    environment.globals |= {"count": wording.count, "anchor": anchor_of}
    return environment


def _asset(path: str) -> Markup:
    """Return a file of ours, or of plotly's, that goes into the page as it stands."""
    return Markup((files("bodycheck.reports") / path).read_text(encoding="utf-8"))
