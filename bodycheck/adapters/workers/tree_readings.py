"""The worker's request `dynamics`: a tree, states, and what an engine reports of them and after two steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Adapter, Precision
from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.tree_contract import TreeModel, UnreportedError, tree_model_of
from bodycheck.adapters.workers import case_messages, protocol
from bodycheck.adapters.workers.protocol import Message
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_scene import TreeScene

STAGE_STEP_S = 1e-3


@dataclass(frozen=True, eq=False)
class TreeReadings:
    """What an engine reports of one tree.

    values: reading -> (k, ...) at the k states. after: reading -> its value after two steps from the last
    state. q, u: the states (3, ...) before these, between them and after them. reasons: reading, or "build"
    or "step" -> why it is not reported. native: reading -> the engine's own axes and order. resolution:
    reading -> its relative accuracy where the engine only gives it approximately. known_faults: reading ->
    a fault of the engine itself.
    """

    values: Mapping[str, Array]
    after: Mapping[str, Array]
    q: Array
    u: Array
    reasons: Mapping[str, str]
    native: Mapping[str, str]
    resolution: Mapping[str, float]
    known_faults: Mapping[str, str]
    precision: Precision


def without_loads(scene: TreeScene) -> TreeScene:
    """Return a tree whose M, bias and accelerations are those of its bodies and joints alone."""
    bodies = tuple(
        replace(body, link=None, joint=replace(body.joint, stiffness=0.0, damping=0.0, armature=0.0))
        for body in scene.bodies
    )
    return replace(scene, bodies=bodies, loads=())


def dynamics_request(
    scene: TreeScene, q: Array, u: Array, masses_were: float = 1.0, readings: Sequence[str] = READINGS
) -> Message:
    """Return the request; q (k, nq) and u (k, nu): the states."""
    states = {"q": protocol.packed(q), "u": protocol.packed(u)}
    return {
        "do": "dynamics",
        "scene": case_messages.scene_message(without_loads(scene)),
        **states,
        "masses_were": masses_were,
        "readings": list(readings),
    }


def answered_dynamics(adapter: Adapter, request: Message) -> Message:
    """Return a worker's answer to a request `dynamics`."""
    model_class = tree_model_of(adapter)
    if model_class is None:
        return {"outcome": "unsupported", "message": f"the adapter of {adapter.name} builds no trees"}
    q, u = (protocol.unpacked(request[name]) for name in ("q", "u"))
    try:
        scene = case_messages.scene_of(request["scene"])
        assert isinstance(scene, TreeScene)
        model = model_class(scene, request["masses_were"])
        model.set_state(q[0], u[0])
    except UnreportedError as error:
        return {"outcome": "unsupported", "message": str(error)}
    values: dict[str, list[Array]] = {name: [] for name in request["readings"]}
    reasons: dict[str, str] = {}
    for at in zip(q, u, strict=True):
        for name in [name for name in values if name not in reasons]:
            model.set_state(*at)
            if (found := _read(model, name, reasons)) is not None:
                values[name].append(found)
    states, after = _after_two_steps(model, (q[-1], u[-1]), list(request["readings"]), reasons)
    return {
        "outcome": "ok",
        "message": "",
        "values": {name: protocol.packed(np.array(rows)) for name, rows in values.items() if rows},
        "after": {name: protocol.packed(found) for name, found in after.items()},
        "q": protocol.packed(np.array([one for one, _ in states])),
        "u": protocol.packed(np.array([one for _, one in states])),
        "reasons": reasons,
        "native": dict(model_class.native),
        "resolution": dict(model_class.resolution),
        "known_faults": dict(model_class.known_faults),
        "precision": model_class.precision,
    }


def _read(model: TreeModel, name: str, reasons: dict[str, str]) -> Array | None:
    try:
        return np.array(getattr(model, name)(), dtype=np.float64)
    except UnreportedError as error:
        reasons[name] = protocol.one_line(str(error))
        return None


def _after_two_steps(
    model: TreeModel, start: tuple[Array, Array], readings: Sequence[str], reasons: dict[str, str]
) -> tuple[list[tuple[Array, Array]], dict[str, Array]]:
    """Return the states before, between and after two steps, and the readings after them."""
    states = [start]
    model.set_state(*start)
    try:
        states += [model.step(STAGE_STEP_S), model.step(STAGE_STEP_S)]
    except UnreportedError as error:
        reasons["step"] = protocol.one_line(str(error))
        return states, {}
    after: dict[str, Array] = {}
    # a reading of another state than the present one would change what those after it return
    for name in (name for name in readings if name not in (*reasons, "gravity_bias")):
        try:
            after[name] = np.array(getattr(model, name)(), dtype=np.float64)
        except UnreportedError as error:
            reasons[f"{name} after a step"] = protocol.one_line(str(error))
    return states, after


def readings_of(answer: Message) -> TreeReadings:
    """Return the readings of a worker's answer; raises ValueError, TypeError or KeyError if it has none."""

    def arrays(name: str) -> dict[str, Array]:
        return {str(key): protocol.unpacked(one) for key, one in answer[name].items() if key in READINGS}

    def texts(name: str) -> dict[str, Any]:
        return {str(key): str(text) for key, text in answer[name].items()}

    return TreeReadings(
        arrays("values"),
        arrays("after"),
        protocol.unpacked(answer["q"]),
        protocol.unpacked(answer["u"]),
        texts("reasons"),
        texts("native"),
        {str(key): float(value) for key, value in answer["resolution"].items()},
        texts("known_faults"),
        answer["precision"],
    )
