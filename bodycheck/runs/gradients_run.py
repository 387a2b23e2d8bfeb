"""Ask differentiable engines for the derivatives of three motions, and for the motions next to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.gradients import PARAMETERS, Gradients
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.adapters.workers.gradient_messages import gradients_of, gradients_request
from bodycheck.examine.gradients.engine_gradients import (
    NUDGES,
    STENCIL,
    CaseGradients,
    MethodGradients,
    difference_matrix,
    method_gradients,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Torque
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.answers import Answers, EngineClient
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.table_layout import Column, Span
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import PROBES

STEP_S = 4e-3
_DURATION_S = 0.8


def _scene(moments: tuple[float, float, float], torque: tuple[float, float, float]) -> Scene:
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 2.0, 0.4]))
    loads = (Torque("world", np.array(torque)),) if any(torque) else ()
    return Scene(RigidBody(1.0, np.diag(moments)), start, loads, np.zeros(3), _DURATION_S, samples=2)


SCENES = {
    "free body": _scene((1.0, 2.0, 2.5), (0.0, 0.0, 0.0)),
    "free sphere": _scene((1.0, 1.0, 1.0), (0.0, 0.0, 0.0)),
    "torque in world axes": _scene((1.0, 2.0, 2.5), (0.6, -0.4, 0.5)),
}


@dataclass(frozen=True)
class EngineGradients:
    """The derivatives of one engine, by method."""

    engine: str
    version: str
    methods: tuple[MethodGradients, ...]

    @property
    def wrong(self) -> bool:
        """Whether a derivative is wrong, or failed."""
        return any(one.wrong or one.outcome not in ("ok", "unsupported") for one in self.methods)


class _LostError(Exception):
    """A request had another outcome than ok: (outcome, message)."""


def gradients(names: Sequence[str], timeout_s: float, *, allow_code: bool = False) -> list[EngineGradients]:
    """Return the derivatives of NAME[==VERSION][:METHOD], ...; raises InputError for an unknown engine."""
    selection = select(PROBES[:1], names, allow_code=allow_code)
    if not selection.methods:
        raise InputError(f"{','.join(names)}: no method to check")
    found = []
    with closing(EnginePool()) as pool:
        client = EngineClient(Answers(None, None, timeout_s), pool)
        for engine, pairs in groupby(selection.methods, key=lambda pair: pair[0]):
            rows = [_of_method(pool, client, engine, method, timeout_s) for _, method in pairs]
            found.append(EngineGradients(engine.name, engine.version, tuple(rows)))
    return found


def _of_method(
    pool: EnginePool,
    client: EngineClient,
    engine: Engine,
    method: Method,
    timeout_s: float,
) -> MethodGradients:
    if method.control != "dt":
        return MethodGradients(method.name, outcome="unsupported", reason="the method has no steps")
    cases: list[CaseGradients] = []
    try:
        for name, scene in SCENES.items():
            coarse, fine = (
                _asked(pool, engine, method, scene, step, timeout_s).matrix for step in (STEP_S, STEP_S / 2)
            )
            own = _own(client, engine, method, scene)
            cases.append(CaseGradients(name, scene, coarse, fine, own))
    except _LostError as lost:
        return MethodGradients(method.name, outcome=lost.args[0], reason=lost.args[1])
    return method_gradients(method.name, method.precision, cases)


def _asked(
    pool: EnginePool, engine: Engine, method: Method, scene: Scene, dt_s: float, timeout_s: float
) -> Gradients:
    answer = pool.ask(engine.name, gradients_request(scene, method.name, dt_s), timeout_s)
    if answer["outcome"] != "ok":
        raise _LostError(answer["outcome"], str(answer.get("message", "")))
    try:
        return gradients_of(answer)
    except ValueError as error:
        raise _LostError("failed", str(error)) from None


def _own(client: EngineClient, engine: Engine, method: Method, scene: Scene) -> Array:
    """Return the derivative of the engine's own motion, by differences."""
    moments, omega = np.diag(scene.body.inertia), scene.initial.omega_body
    nudge = NUDGES[method.precision]
    steps = [nudge * float(np.max(values)) for values in (moments, omega) for _ in range(3)]
    ends = [
        [_end(client, engine, method, nudged(scene, parameter, k * steps[parameter])) for k in STENCIL]
        for parameter in range(PARAMETERS)
    ]
    return difference_matrix(_end(client, engine, method, scene), ends, steps)


def nudged(scene: Scene, parameter: int, by: float) -> Scene:
    """Return a scene with a larger moment of inertia, or omega, by one of PARAMETERS."""
    change = by * np.eye(3)[parameter % 3]
    if parameter < 3:
        return replace(scene, body=replace(scene.body, inertia=scene.body.inertia + np.diag(change)))
    return replace(scene, initial=replace(scene.initial, omega_body=scene.initial.omega_body + change))


def _end(client: EngineClient, engine: Engine, method: Method, scene: Scene) -> Trajectory:
    answer = client.ask(engine, Case(scene, method.name, Setting(STEP_S)))
    if answer.trajectory is None:
        raise _LostError(answer.outcome, answer.message)
    return answer.trajectory


_HEADS = (
    Column("method", "fixed"),
    Column("derivative", "fixed"),
    Column("", "fixed"),
    Column("own motion", "number"),
    Column("exact", "number"),
    Column("half step", "number"),
)


def gradients_document(found: Sequence[EngineGradients]) -> Document:
    """Return one sentence per engine, causes, and a row per method and block."""
    sentences, rows, missing = [], [], []
    for engine in found:
        name = f"{engine.engine} {engine.version}"
        measured = [one for one in engine.methods if one.blocks]
        wrong = [one for one in measured if one.wrong]
        if not measured:
            sentences.append(Sentence(f"{name} computes no derivatives", "open", strong=True))
        elif wrong:
            text = f"{name}: wrong derivatives in {', '.join(one.method for one in wrong)}"
            sentences.append(Sentence(text, "bad", strong=True))
        else:
            largest = max(block.own for one in measured for block in one.blocks)
            text = f"{name}: derivatives are those of its own motions, to a relative {number(largest, 2)}"
            sentences.append(Sentence(text, "good", strong=True))
        for one in wrong:
            cause = one.cause or "no known fault explains the deviations"
            sentences.append(
                Sentence(f"{engine.engine}:{one.method}: {cause}", "bad" if one.cause else "open")
            )
        rows += [row for one in measured for row in _rows(engine.engine, one)]
        missing += [(f"{engine.engine}:{one.method}", one.reason) for one in engine.methods if one.reason]
    table = Table(_HEADS, tuple(rows), f"Relative deviations, in steps of {STEP_S:g} s")
    lost = Table((Column("engine:method", "fixed"), Column("why")), tuple(missing), "Without derivatives")
    return Document("bodycheck gradients", (*sentences, table, lost))


def _rows(engine: str, found: MethodGradients) -> Iterator[tuple[str | Span, ...]]:
    for block in found.blocks:
        verdict = Span("right", "good") if block.right else Span("wrong", "bad")
        numbers = (number(value, 2) for value in (block.own, block.coarse, block.fine))
        yield f"{engine}:{found.method}", block.block, verdict, *numbers
