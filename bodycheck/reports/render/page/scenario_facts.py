"""Describe scenarios, read-back values and largest stable steps in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bodycheck._util import formatting
from bodycheck._util.formatting import number
from bodycheck.adapters.contract import ReadBack, Reading
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.scenarios.body import Body, FileBody, GivenBody, MeshBody, ShapeBody
from bodycheck.scenarios.forcings import Forcing


@dataclass(frozen=True)
class Limit:
    """The symbol of a method in the stability map, its tint, and a sentence that explains it."""

    mark: str
    tint: str
    sentence: str


def limit_of(row: Mapping[str, Any] | None) -> Limit:
    """Return the entry of a row of stability.csv; None is for a method without a step."""
    if row is None:
        return Limit("", "", "no search for the largest stable step")
    if row["outcome"] != "ok":
        state = STATES[row["outcome"]]
        return Limit(state.symbol, state.tint, f"{state.word}: {row['message']}")
    stable, unstable = _known(row["dt_stable_s"]), _known(row["dt_unstable_s"])
    if stable is None:
        return Limit("none", "bad", f"unstable at every step tried: {row['reason']}")
    shown = number(stable, 3)
    if unstable is None:
        return Limit(f"≥ {shown}", "good", f"stable up to dt = {shown} s, where the search ended")
    sentence = f"stable up to dt = {shown} s, not at {number(unstable, 3)} s: {row['reason']}"
    return Limit(shown, "open", sentence)


def _known(value: float) -> float | None:
    return value if value == value else None


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
        ("Shape", _shape_text(scenario.body)),
        ("Body", _body_words(scene)),
        ("Start", _start_text(scene)),
        ("Loads", "; ".join(map(_forcing_text, scenario.forcing)) or "none"),
        ("Duration", f"{formatting.number(scene.duration_s, 6)} s, {scene.samples} samples"),
        ("Truth", f"{truth.kind}, bound {bound}"),
    ]
    return [(term, text) for term, text in facts if text]


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


def read_back_facts(read_back: ReadBack) -> list[tuple[str, str]]:
    """Return the values read back from an engine, as terms and texts."""
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
