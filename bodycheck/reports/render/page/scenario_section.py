"""The report's section on one scenario: facts, methods, plots, and a part for each method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any
from urllib.parse import quote

import numpy as np

from bodycheck._util import formatting
from bodycheck._util.formatting import number
from bodycheck._util.untrusted import shell_quote
from bodycheck.adapters.contract import ReadBack, Reading, TreeReadBack
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trees.tree_scene import TreeBody
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.verdicts import FAULTS, STATES
from bodycheck.reports.render.page.cheapest_settings import START, cell_data
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, Cheapest, cheapest_cases
from bodycheck.reports.render.page.played_motions import motion_view
from bodycheck.reports.render.page.plots import growth_text, overlapping_methods, plot_data
from bodycheck.reports.render.styles import Style
from bodycheck.reports.run_files.run_tables import (
    MethodKey,
    Run,
    cases_by_method,
    common_step,
    key_of,
    shown_case,
)
from bodycheck.reports.summary.cells import Cell
from bodycheck.reports.summary.error_curve import finest_first
from bodycheck.scenarios.body import Body, FileBody, GivenBody, MeshBody, ShapeBody
from bodycheck.scenarios.forcings import Forcing
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import AnyScenario


@dataclass(frozen=True)
class StableStepEntry:
    """The symbol of a method in the stability map, its tint, and a sentence that explains it."""

    mark: str
    tint: str
    sentence: str


def limit_of(row: Mapping[str, Any] | None) -> StableStepEntry:
    """Return the entry of a row of stability.csv; None is for a method without a step."""
    if row is None:
        return StableStepEntry("", "", "no search for the largest stable step")
    if row["outcome"] != "ok":
        state = STATES[row["outcome"]]
        return StableStepEntry(state.symbol, state.tint, f"{state.word}: {row.get('message', '')}")
    stable, unstable = row.get("dt_stable_s"), row.get("dt_unstable_s")
    if stable is None:
        return StableStepEntry("none", "bad", f"unstable at every step tried: {row.get('reason', '')}")
    shown = number(stable, 3)
    if unstable is None:
        return StableStepEntry(f"≥ {shown}", "good", f"stable up to dt = {shown} s, where the search ended")
    sentence = f"stable up to dt = {shown} s, not at {number(unstable, 3)} s: {row.get('reason', '')}"
    return StableStepEntry(shown, "open", sentence)


def scenario_facts(problem: Problem) -> list[tuple[str, str]]:
    """Return the facts of a scenario and its truth, as terms and texts."""
    scenario, scene, truth = problem.scenario, problem.scenario.scene, problem.truth
    bounds = {
        "rad": truth.bound_rad,
        "of the energy": truth.bound_energy,
        "of the angular momentum": truth.bound_momentum,
        "rad/s": truth.bound_omega_rad_s,
        "m": truth.bound_m,
        "m/s": truth.bound_m_s,
    }
    bound = ", ".join(f"{formatting.number(problem.largest(b), 2)} {unit}" for unit, b in bounds.items())
    facts = [
        ("Source", scenario.source),
        ("Tags", ", ".join(scenario.tags)),
        *_facts_of(scenario),
        ("Loads", "; ".join(map(_forcing_text, scenario.forcing)) or "none"),
        ("Duration", f"{formatting.number(scene.duration_s, 6)} s, {scene.samples} samples"),
        ("Truth", f"{truth.kind}, bound {bound}"),
    ]
    return [(term, text) for term, text in facts if text]


def _facts_of(scenario: AnyScenario) -> list[tuple[str, str]]:
    if not isinstance(scenario, Scenario):
        return [("Bodies", "; ".join(map(_tree_body_text, scenario.scene.bodies)))]
    scene = scenario.scene
    return [
        ("Shape", _shape_text(scenario.body)),
        ("Body", _body_words(scene)),
        ("Start", _start_text(scene)),
    ]


def _tree_body_text(body: TreeBody) -> str:
    joint = body.joint
    start, rate = formatting.vector(joint.coordinates), formatting.vector(joint.rates)
    return f"{body.name}: {joint.kind}, {formatting.number(body.mass, 6)} kg, q {start}, u {rate}"


def _shape_text(body: Body) -> str:
    """Return the source of a body's mass properties and its repairs; "" if they were given as numbers."""
    match body:
        case MeshBody():
            shape = f"mesh {body.mesh.name}"
        case ShapeBody():
            shape = f"{body.shape}, sizes {formatting.vector(np.array(body.size_m))} m"
        case FileBody():
            return "; ".join([f"link {body.of_file.name} of {body.urdf or body.mjcf}", *body.notes])
        case GivenBody():
            return ""
    return "; ".join([f"{shape}, {formatting.number(body.density_kg_m3, 6)} kg/m³", *body.notes])


def _body_words(scene: Scene) -> str:
    body = scene.body
    mass = f"{formatting.number(body.mass, 6)} kg"
    moments = np.diag(body.inertia)
    if np.array_equal(np.diag(moments), body.inertia):
        return f"{mass}, principal moments {formatting.vector(moments)} kg m²"
    return f"{mass}, inertia {', '.join(formatting.vector(row) for row in body.inertia)} kg m²"


def _start_text(scene: Scene) -> str:
    initial = scene.initial
    parts = [f"ω {formatting.vector(initial.omega_body)} rad/s in body axes"]
    if np.any(initial.velocity):
        parts.append(f"velocity {formatting.vector(initial.velocity)} m/s")
    if not np.array_equal(initial.quaternion, [1.0, 0.0, 0.0, 0.0]):
        parts.append(f"quaternion {formatting.vector(initial.quaternion)}")
    return ", ".join(parts)


def _forcing_text(forcing: Forcing) -> str:
    """Return a forcing as in its scenario file: kind, then each key with its value."""
    facts = forcing.model_dump(exclude_defaults=True)
    kind = facts.pop("kind")
    return f"{kind}: {', '.join(f'{key} {_value_text(value)}' for key, value in facts.items())}"


def _value_text(value: Any) -> str:
    match value:
        case float() | int():
            return formatting.number(value, 6)
        case tuple() | list():
            return f"({', '.join(_value_text(part) for part in value)})"
    return str(value)


def read_back_facts(read_back: ReadBack | TreeReadBack) -> list[tuple[str, str]]:
    """Return the values read back from an engine, as terms and texts."""
    if isinstance(read_back, TreeReadBack):
        shown = ("mass", "damping", "gravity", "q", "u")
        held = {name: read_back.numbers[name] for name in shown if name in read_back.numbers}
        return [
            (name.capitalize() if len(name) > 1 else name, formatting.vector(v)) for name, v in held.items()
        ]
    facts = [
        ("Mass", f"{formatting.number(read_back.mass, 6)} kg"),
        ("Inertia", f"{', '.join(formatting.vector(row) for row in read_back.inertia)} kg m²"),
        ("Step", "" if read_back.dt_s is None else f"{formatting.step(read_back.dt_s)} s"),
        ("Gravity", f"{formatting.vector(read_back.gravity)} m/s²"),
        ("Start", _state_text(read_back.state)),
    ]
    return [(term, text) for term, text in facts if text]


def _state_text(state: Reading) -> str:
    parts = []
    if state.quaternion is not None:
        parts.append(f"quaternion {formatting.vector(state.quaternion)}")
    if state.rotation is not None:
        parts.append(f"R {', '.join(formatting.vector(row) for row in state.rotation)}")
    if state.omega_body is not None:
        parts.append(f"ω {formatting.vector(state.omega_body)} rad/s in body axes")
    if state.omega_world is not None:
        parts.append(f"ω {formatting.vector(state.omega_world)} rad/s in world axes")
    parts.append(f"velocity {formatting.vector(state.velocity)} m/s")
    parts.append(f"position {formatting.vector(state.position)} m")
    return ", ".join(parts)


_CASE_MEASURES = (
    "orientation_error_rad",
    "joint_error_rad",
    "joint_error_m",
    "omega_error",
    "energy_drift",
    "angular_momentum_drift",
    "position_error",
    "orthogonality_error",
    "quaternion_norm_error",
    "cpu_s",
    "ns_per_step",
)
"""The columns of results.csv that the table of a cell shows, if the scenario has them."""

_METHOD_MEASURES = (
    *("orientation_error_rad", "joint_error_rad", "joint_error_m"),
    *("energy_drift", "angular_momentum_drift", "omega_error", "cpu_s"),
)
"""The columns of results.csv by which the table of methods compares them."""

_ORDER_COLUMNS = (
    *("quantity", "verdict", "order", "order_low", "order_high", "points", "floor"),
    *("best_dt_s", "least_error", "predicted_floor", "measured_floor"),
    *("growth", "growth_exponent"),
)
"""The columns of methods.csv that the page shows."""

_GROWING = ("energy_drift", "angular_momentum_drift")
"""The drifts whose growth the table of methods shows."""


_UNMET_TINTS = ("bad", "fault", "none")
"""The tints that stay, whatever error is chosen."""


@dataclass(frozen=True, eq=False)
class CellPart:
    """One method on one scenario: its verdict, its cases, and the commands that reproduce them.

    shown: the case at the common step, or its substitute. orders: its rows of methods.csv. limit: its largest
    stable step.
    """

    scenario: str
    key: MethodKey
    cell: Cell
    cases: tuple[CaseResult, ...]
    shown: CaseResult | None
    orders: tuple[Mapping[str, Any], ...]
    limit: StableStepEntry

    @property
    def anchor(self) -> str:
        """The id of the part: unique, without spaces."""
        return anchor_of(self.scenario, self.key)

    @cached_property
    def map_data(self) -> dict[str, Any]:
        """The numbers of the part's cell in the heat map."""
        return {**cell_data(finest_first(self.cases)), "tint": STATES[self.cell.state].tint}

    @property
    def tint(self) -> str:
        """The tint of its cell in the heat map when the page opens: good if it meets the slider's error."""
        own = STATES[self.cell.state].tint
        if own in _UNMET_TINTS:
            return own
        return "open" if self.map_data["met"][START] is None else "good"

    @property
    def read_back(self) -> list[tuple[str, str]]:
        """The values read back from the engine, for the shown case or the first case that has them."""
        tried = [case for case in (self.shown, *self.cases) if case is not None]
        read_back = next((case.read_back for case in tried if case.read_back is not None), None)
        return [] if read_back is None else read_back_facts(read_back)

    @property
    def map_cell(self) -> MapCell:
        """What the maps of all scenarios show of it."""
        return MapCell(self.cell, self.limit, self.tint, self.map_data)

    @property
    def growths(self) -> list[str]:
        """The growth of the drifts, in the order of the table's columns."""
        by_quantity = {row["quantity"]: growth_text(row) for row in self.orders}
        return [by_quantity.get(quantity, "") for quantity in _GROWING]

    def measured(self, name: str) -> float | None:
        """Return a column of the shown case; None if it was not measured or the case did not end well."""
        if self.shown is None or not self.shown.ok:
            return None
        value: float | None = self.shown.columns.get(name)
        return value


@dataclass(frozen=True, eq=False)
class MapCell:
    """One method on one scenario in the maps of all scenarios: the fields are those of `CellPart`."""

    cell: Cell
    limit: StableStepEntry
    tint: str
    map_data: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class MapRow:
    """One scenario in the maps; at_s: its common step."""

    name: str
    at_s: float | None
    parts: Mapping[MethodKey, MapCell]


@dataclass(frozen=True, eq=False)
class Section:
    """The section of one scenario; motion, and the drifts in plots: None if the page shows no motions."""

    problem: Problem
    parts: Mapping[MethodKey, CellPart]
    at_s: float | None
    plots: Mapping[str, Any]
    cheapest: Mapping[str, Sequence[Cheapest[CaseResult]]]
    motion: Mapping[str, Any] | None

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.problem.scenario.name

    @property
    def anchor(self) -> str:
        """The section's id."""
        return anchor_of(self.name)

    @property
    def row(self) -> MapRow:
        """Its row in the maps of all scenarios."""
        return MapRow(self.name, self.at_s, {key: part.map_cell for key, part in self.parts.items()})

    @property
    def argument(self) -> str:
        """Its name as an argument on a command line."""
        return shell_quote(self.name)

    @property
    def facts(self) -> list[tuple[str, str]]:
        """The facts of the scenario and its truth, as terms and texts."""
        return scenario_facts(self.problem)

    @cached_property
    def cases(self) -> list[CaseResult]:
        """All cases, in the order of results.csv."""
        return [case for part in self.parts.values() for case in part.cases]

    @cached_property
    def case_measures(self) -> list[str]:
        """The columns of the tables of cases: those that any case has."""
        return self._measured(_CASE_MEASURES)

    @cached_property
    def method_measures(self) -> list[str]:
        """The columns of the table of methods: those that any case has."""
        return self._measured(_METHOD_MEASURES)

    def _measured(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if any(name in case.columns for case in self.cases)]

    @property
    def growing(self) -> tuple[str, ...]:
        """The drifts whose growth is shown; empty if no growth was found."""
        return _GROWING if any(any(part.growths) for part in self.parts.values()) else ()

    @property
    def noted(self) -> bool:
        """Whether anything went wrong that no verdict reports."""
        return any(part.cell.notes for part in self.parts.values())

    @property
    def overlapping_methods(self) -> list[list[MethodKey]]:
        """The groups of methods whose lines overlap."""
        return overlapping_methods(self.problem, self.cases)

    @property
    def has_faults(self) -> bool:
        """Whether any case did not end well."""
        return any(case.columns["outcome"] in FAULTS for case in self.cases)

    @property
    def has_speed(self) -> bool:
        """Whether the processor time of any case was measured."""
        return "cpu_s" in self.case_measures


def anchor_of(scenario: str, key: MethodKey | None = None) -> str:
    """Return the id of a scenario's section, or of the part of one of its methods."""
    if key is None:
        return "scenario-" + quote(scenario, safe="")
    return f"cell-{quote(scenario, safe='')}--{quote(':'.join(key), safe=':')}"


def method_anchor(key: MethodKey) -> str:
    """Return the id of a method's row in the table of all methods."""
    return f"method-{quote(':'.join(key), safe=':')}"


def sections_of(
    run: Run,
    cells: Mapping[str, Mapping[MethodKey, Cell]],
    drawn: Mapping[MethodKey, Style],
    tracks: Mapping[str, int],
) -> Iterator[Section]:
    """Yield the sections of a run, in its order.

    drawn: the style of each method. tracks: the largest number of motions of each scenario; motions of others
    are not read.
    """
    cases: dict[str, dict[MethodKey, list[CaseResult]]] = {s.scenario.name: {} for s in run.problems}
    cases |= cases_by_method(run.cases)
    rows: dict[str, list[Mapping[str, Any]]] = {name: [] for name in cases}
    for row in run.rows("methods"):
        rows[row["scenario"]].append(row)
    stable: dict[str, dict[MethodKey, Mapping[str, Any]]] = {name: {} for name in cases}
    for row in run.rows("stability"):
        stable[row["scenario"]][key_of(row)] = row
    for problem in run.problems:
        name = problem.scenario.name
        yield _section(
            *(problem, cells[name], cases[name], rows[name], stable[name], drawn), tracks.get(name, 0)
        )


def _section(
    problem: Problem,
    cells: Mapping[MethodKey, Cell],
    by_method: Mapping[MethodKey, Sequence[CaseResult]],
    rows: Sequence[Mapping[str, Any]],
    stable: Mapping[MethodKey, Mapping[str, Any]],
    drawn: Mapping[MethodKey, Style],
    tracks: int,
) -> Section:
    # a copy, so that the motions that are read for the section do not stay in memory after it
    by_method = {key: [replace(case) for case in own] for key, own in by_method.items()}
    all_cases = [case for own in by_method.values() for case in own]
    at_s = common_step(all_cases)
    sequences = {key: finest_first(own) for key, own in by_method.items()}
    parts = {
        key: CellPart(
            scenario=problem.scenario.name,
            key=key,
            cell=cells[key],
            cases=tuple(own),
            shown=shown_case(own, at_s),
            orders=tuple(
                {name: row.get(name) for name in _ORDER_COLUMNS} for row in rows if key_of(row) == key
            ),
            limit=limit_of(stable.get(key)),
        )
        for key, own in by_method.items()
    }
    return Section(
        problem=problem,
        parts=parts,
        at_s=at_s,
        plots=plot_data(problem, all_cases, rows, drawn, at_s, with_drifts=tracks > 0),
        cheapest={error: cheapest_cases(problem, sequences, error) for error in ERRORS},
        motion=motion_view(problem, all_cases, {key: style.number for key, style in drawn.items()}, tracks)
        if tracks
        else None,
    )
