"""The report of a run: one page of HTML that holds all it shows and fetches nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Any
from urllib.parse import quote

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from bodycheck.reference_impl.scene import Scene
from bodycheck.reports import wording
from bodycheck.reports.case import CaseResult, Subject
from bodycheck.reports.figures import Style, coinciding, plot_data, styles
from bodycheck.reports.run import Run
from bodycheck.reports.summary import (
    STATES,
    Cell,
    MethodKey,
    common_step,
    faults_of,
    key_of,
    summary_cells,
    verdict_sentences,
)
from bodycheck.scenarios.body import Body, GivenBody, MeshBody, ShapeBody
from bodycheck.scenarios.forcings import Forcing

_TABLE_MEASURES = (
    "orientation_error_rad",
    "omega_error",
    "energy_drift",
    "angular_momentum_drift",
    "position_error",
    "orthogonality",
    "quaternion_norm_error",
    "cpu_s",
    "ns_per_step",
)
"""The columns of results.csv that the page's tables repeat, where a scenario has them."""


@dataclass(frozen=True, eq=False)
class Section:
    """What the page shows of one scenario."""

    subject: Subject
    cells: Mapping[MethodKey, Cell]
    cases: tuple[CaseResult, ...]
    at_s: float | None
    plots: Mapping[str, Any]

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.subject.scenario.name

    @property
    def anchor(self) -> str:
        """The section's id: one a name, without blanks."""
        return "scenario-" + quote(self.name, safe="")

    @property
    def facts(self) -> list[tuple[str, str]]:
        """What is simulated and what it is measured with, as terms and their texts."""
        return scenario_facts(self.subject)

    @property
    def measures(self) -> list[str]:
        """The columns of its table: those that any case has."""
        return [name for name in _TABLE_MEASURES if any(name in case.columns for case in self.cases)]

    @property
    def coinciding(self) -> list[list[MethodKey]]:
        """The groups of methods whose lines cannot be told apart."""
        return coinciding(self.cases)

    @property
    def has_speed(self) -> bool:
        """Whether the processor time of any case was measured."""
        return "cpu_s" in self.measures


def render_report(run: Run) -> str:
    """Return the report of a run as one HTML page that needs nothing else, not even a network."""
    cells = summary_cells(run)
    method_styles = styles(key_of(case.columns) for case in run.cases)
    return (
        _environment()
        .get_template("report.html")
        .render(
            run=run,
            sentences=verdict_sentences(run, cells),
            states=STATES,
            styles=method_styles,
            styles_data=[asdict(style) for style in method_styles.values()],
            sections=_sections(run, cells, method_styles),
            faults=faults_of(run.cases),
            css=_asset("report.css"),
            js=_asset("report.js"),
            plotly=_plotly(),
        )
    )


def _sections(
    run: Run, cells: Mapping[str, Mapping[MethodKey, Cell]], drawn: Mapping[MethodKey, Style]
) -> list[Section]:
    cases: dict[str, list[CaseResult]] = {subject.scenario.name: [] for subject in run.subjects}
    for case in run.cases:
        cases[case.columns["scenario"]].append(case)
    sections = []
    for subject in run.subjects:
        own = tuple(cases[subject.scenario.name])
        at_s = common_step(own)
        plots = plot_data(subject, own, drawn, at_s)
        sections.append(Section(subject, cells[subject.scenario.name], own, at_s, plots))
    return sections


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
    environment.globals |= {"count": wording.count}
    return environment


def _asset(name: str) -> Markup:
    """Return a file of ours that goes into the page as it stands."""
    text = (files("bodycheck.reports") / "templates" / name).read_text(encoding="utf-8")
    return Markup(text)


def _plotly() -> Markup:
    """Return plotly.js with the plots of lines alone, a quarter of the whole."""
    text = (files("bodycheck.reports") / "vendor" / "plotly-basic.min.js").read_text(encoding="utf-8")
    return Markup(text)


def scenario_facts(subject: Subject) -> list[tuple[str, str]]:
    """Return what is simulated and what it is measured with, as terms and their texts."""
    scenario, scene, truth = subject.scenario, subject.scenario.scene, subject.truth
    bounds = {
        "rad": truth.bound_rad,
        "of the energy": truth.bound_energy,
        "of the angular momentum": truth.bound_momentum,
    }
    bound = ", ".join(f"{wording.number(float(b.max()), 2)} {unit}" for unit, b in bounds.items())
    facts = [
        ("Source", scenario.source),
        ("Tags", ", ".join(scenario.tags)),
        ("Shape", _shape_words(scenario.body)),
        ("Body", _body_words(scene)),
        ("Start", _start_words(scene)),
        ("Acts on it", "; ".join(map(_forcing_words, scenario.forcing)) or "nothing"),
        ("Watched", f"{wording.number(scene.duration_s, 6)} s, {scene.samples} samples"),
        ("Truth", f"{truth.kind}, bound {bound}"),
    ]
    return [(term, text) for term, text in facts if text]


def _shape_words(body: Body) -> str:
    """Return what a body's numbers came from, and what was put right in it; nothing of a body by numbers."""
    match body:
        case MeshBody():
            what = f"mesh {body.mesh.name}"
        case ShapeBody():
            what = f"{body.shape}, sizes {wording.vector(np.array(body.size_m))} m"
        case GivenBody():
            return ""
    return "; ".join([f"{what}, {wording.number(body.density_kg_m3, 6)} kg/m³", *body.notes])


def _body_words(scene: Scene) -> str:
    body = scene.body
    mass = f"{wording.number(body.mass, 6)} kg"
    moments = np.diag(body.inertia)
    if np.array_equal(np.diag(moments), body.inertia):
        return f"{mass}, principal moments {wording.vector(moments)} kg m²"
    return f"{mass}, inertia {', '.join(wording.vector(row) for row in body.inertia)} kg m²"


def _start_words(scene: Scene) -> str:
    initial = scene.initial
    words = [f"ω {wording.vector(initial.omega_body)} rad/s in body axes"]
    if np.any(initial.velocity):
        words.append(f"velocity {wording.vector(initial.velocity)} m/s")
    if not np.array_equal(initial.quaternion, [1.0, 0.0, 0.0, 0.0]):
        words.append(f"quaternion {wording.vector(initial.quaternion)}")
    return ", ".join(words)


def _forcing_words(forcing: Forcing) -> str:
    """Return a forcing as its file says it: kind, then each key with its value."""
    told = forcing.model_dump(exclude_defaults=True)
    kind = told.pop("kind")
    return f"{kind}: {', '.join(f'{key} {_value_words(value)}' for key, value in told.items())}"


def _value_words(value: Any) -> str:
    match value:
        case float() | int():
            return wording.number(value, 6)
        case tuple() | list():
            return f"({', '.join(_value_words(part) for part in value)})"
    return str(value)
