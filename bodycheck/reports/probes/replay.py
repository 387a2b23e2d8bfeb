"""Whether a method gives the same bits again: after reset, and in another process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.execution import Answer, Case
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.probes.laws import LAWS, REPLAY, STATES, Break, Checked

Asking: TypeAlias = Callable[[Engine, Case], Answer]
Ways: TypeAlias = Iterable[tuple[str, Asking]]
"""How a case is run again, in words and as a function; each serves all methods before the next begins."""

SAME_BITS, OTHER_BITS = "same bits", "other bits"

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


def check_replays(engine: Engine, methods: Sequence[Method], ask: Asking, ways: Ways) -> dict[str, Checked]:
    """Return by method whether a case has the same bits in each further run."""
    found: dict[str, _First | str] = {method.name: _first_run(engine, method, ask) for method in methods}
    for words, way in ways:
        for name, first in found.items():
            if isinstance(first, str):
                continue
            answer = way(engine, first.case)
            if answer.trajectory is None:
                found[name] = f"{words}: {answer.outcome}: {answer.message}"
            else:
                first.breaks[words] = _difference(first, answer.trajectory)
    return {name: _checked(first) for name, first in found.items()}


def _first_run(engine: Engine, method: Method, ask: Asking) -> _First | str:
    """Run a method on the first state that it supports; return why where it supports none."""
    reason = ""
    tolerance = min(method.tolerances, default=None) if method.control == "tolerance" else None
    for name, (scene, dt_s) in _STATES.items():
        case = Case(scene, method.name, Setting(dt_s if method.control == "dt" else None, tolerance))
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
            apart = np.max(np.abs(a - b).reshape(len(t_s), -1), axis=1) / np.max(np.abs(a))
            at = int(np.argmax(apart))
            # two zeros of different sign are different bits too
            size = max(float(apart[at]), np.finfo(np.float64).tiny)
            if not size <= worst.size:
                worst = Break(size, 0.0, quantity, first.state, dt_s, float(t_s[at]))
    return worst


def _checked(first: _First | str) -> Checked:
    if isinstance(first, str):
        return Checked(_LAW, "not-measured", message=first)
    words, worst = max(first.breaks.items(), key=lambda item: item[1].size)
    if worst.size == 0.0:
        return Checked(_LAW, "holds", worst)
    where = f"{worst.quantity} differs by {worst.size:.3g} at t = {worst.t_s:.4g} s {words}"
    return Checked(_LAW, "property", worst, f"{where}; equal bits are not required of an engine")
