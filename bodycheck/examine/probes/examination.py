"""Examine an engine without a truth: probes, the known map, laws and replays, as rows of tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.execution import Case
from bodycheck.examine.probes.fingerprint import fingerprint_of, fingerprint_row
from bodycheck.examine.probes.laws import LAWS, STATES, Break, Checked, check_laws, law_rows
from bodycheck.examine.probes.probe import probe_rows
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.answers import EngineClient
from bodycheck.reports.measurement.case import RunCase
from bodycheck.reports.run_files.method_words import REPLAY

Reruns: TypeAlias = Iterable[tuple[str, RunCase]]
"""How a case is run again, in words and as a function; each serves all methods before the next begins."""

_LAW = next(law for law in LAWS if law.name == REPLAY)
_QUANTITIES = {
    "position_m": "position",
    "velocity_m_s": "velocity",
    "quaternion": "attitude",
    "rotation": "attitude",
    "omega_world_rad_s": "omega",
    "omega_body_rad_s": "omega",
}
_STATES = {
    # longer than the motions of the other laws, and first the state that shows most
    name: (replace(scene, duration_s=2.0 * scene.duration_s, samples=2 * scene.samples - 1), dt_s)
    for name, (scene, dt_s) in reversed(tuple(STATES.items()))
}


@dataclass(frozen=True, eq=False)
class _First:
    """The first run of a method, and how the others differ, in words."""

    state: str
    case: Case
    motion: Trajectory
    breaks: dict[str, Break] = field(default_factory=dict)


def check_replays(
    engine: Engine, methods: Sequence[Method], ask: RunCase, reruns: Reruns
) -> dict[str, Checked]:
    """Return by method whether a case has the same bits in each further run."""
    found: dict[str, _First | str] = {method.name: _first_run(engine, method, ask) for method in methods}
    for label, run_again in reruns:
        for name, first in found.items():
            if isinstance(first, str):
                continue
            answer = run_again(engine, first.case)
            if answer.trajectory is None:
                found[name] = f"{label}: {answer.outcome}: {answer.message}"
            else:
                first.breaks[label] = _difference(first, answer.trajectory)
    return {name: _checked(first) for name, first in found.items()}


def _first_run(engine: Engine, method: Method, ask: RunCase) -> _First | str:
    """Run a method on the first state that it supports; return why where it supports none."""
    reason = ""
    for name, (scene, dt_s) in _STATES.items():
        case = Case(scene, method.name, method.setting(dt_s))
        answer = ask(engine, case)
        if answer.trajectory is not None:
            return _First(name, case, answer.trajectory)
        reason = f"{answer.outcome}: {answer.message}"
        if answer.outcome != "unsupported":
            break
    return reason


def _difference(first: _First, other: Trajectory) -> Break:
    """Return the largest difference of a quantity over its own largest value; 0 for the same bits."""
    dt_s, t_s = first.case.setting.dt_s, other.t_s
    worst = Break(0.0, 0.0, "", first.state, dt_s, 0.0)
    for name, quantity in _QUANTITIES.items():
        a, b = getattr(first.motion, name), getattr(other, name)
        if a is None or b is None:
            if a is not b:
                return Break(np.inf, 0.0, quantity, first.state, dt_s, 0.0)
        elif a.tobytes() != b.tobytes():
            difference = np.max(np.abs(a - b).reshape(len(t_s), -1), axis=1) / np.max(np.abs(a))
            at = int(np.argmax(difference))
            # two zeros of different sign are different bits too
            size = max(float(difference[at]), np.finfo(np.float64).tiny)
            if not size <= worst.size:
                worst = Break(size, 0.0, quantity, first.state, dt_s, float(t_s[at]))
    return worst


def _checked(first: _First | str) -> Checked:
    if isinstance(first, str):
        return Checked(_LAW, "not-measured", message=first)
    label, worst = max(first.breaks.items(), key=lambda item: item[1].size)
    if worst.size == 0.0:
        return Checked(_LAW, "holds", worst)
    where = f"{worst.quantity} differs by {worst.size:.3g} at t = {worst.t_s:.4g} s {label}"
    return Checked(_LAW, "property", worst, f"{where}; equal bits are not required of an engine")


def examined(engine: Engine, method: Method, client: EngineClient, *, laws: bool) -> dict[str, Any]:
    """Return the rows of probes.csv and, with laws, of fingerprints.csv and laws.csv, by table."""
    probes = probe_rows(engine, method, client.ask)
    others = map_and_laws(engine, method, client) if laws else {"fingerprints": [], "laws": []}
    return {"probes": probes, **others}


def map_and_laws(engine: Engine, method: Method, client: EngineClient) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of fingerprints.csv and laws.csv by table, but those of the law `replay`.

    The known map decides whether the method must be reversible.
    """
    found = fingerprint_of(engine, method, client.ask)
    checked = check_laws(
        engine, method, client.ask, client.replay, reversible=found.reversible, residual=found.residual
    )
    return {
        "fingerprints": [fingerprint_row(engine, method, found)],
        "laws": law_rows(engine, method, checked),
    }


def replayed(engine: Engine, methods: Sequence[Method], client: EngineClient) -> dict[str, Any]:
    """Return the rows of the law `replay` by method; it restarts the engine."""
    found = check_replays(engine, methods, client.ask, client.again(engine))
    return {method.name: law_rows(engine, method, [found[method.name]]) for method in methods}
