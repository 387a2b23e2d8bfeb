"""What is simulated and what it is measured with, and what an engine says it was given, in words."""

from __future__ import annotations

from typing import Any

import numpy as np

from bodycheck.adapters.contract import ReadBack, Reading
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports import wording
from bodycheck.reports.subject import Subject
from bodycheck.scenarios.body import Body, GivenBody, MeshBody, ShapeBody
from bodycheck.scenarios.forcings import Forcing


def scenario_facts(subject: Subject) -> list[tuple[str, str]]:
    """Return what is simulated and what it is measured with, as terms and their texts."""
    scenario, scene, truth = subject.scenario, subject.scenario.scene, subject.truth
    bounds = {
        "rad": truth.bound_rad,
        "of the energy": truth.bound_energy,
        "of the angular momentum": truth.bound_momentum,
        "rad/s": truth.bound_omega_rad_s,
        "m": truth.bound_m,
        "m/s": truth.bound_m_s,
    }
    bound = ", ".join(f"{wording.number(subject.largest(b), 2)} {unit}" for unit, b in bounds.items())
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


def read_back_facts(held: ReadBack) -> list[tuple[str, str]]:
    """Return what an engine says it was given, as terms and their texts."""
    facts = [
        ("Mass", f"{wording.number(held.mass, 6)} kg"),
        ("Inertia", f"{', '.join(wording.vector(row) for row in held.inertia)} kg m²"),
        ("Step", "" if held.dt_s is None else f"{wording.step(held.dt_s)} s"),
        ("Gravity", f"{wording.vector(held.gravity)} m/s²"),
        ("Start", _state_words(held.state)),
    ]
    return [(term, text) for term, text in facts if text]


def _state_words(state: Reading) -> str:
    words = []
    if state.quaternion is not None:
        words.append(f"quaternion {wording.vector(state.quaternion)}")
    if state.rotation is not None:
        words.append(f"R {', '.join(wording.vector(row) for row in state.rotation)}")
    if state.omega_body is not None:
        words.append(f"ω {wording.vector(state.omega_body)} rad/s in body axes")
    if state.omega_world is not None:
        words.append(f"ω {wording.vector(state.omega_world)} rad/s in world axes")
    words.append(f"velocity {wording.vector(state.velocity)} m/s")
    words.append(f"position {wording.vector(state.position)} m")
    return ", ".join(words)
