"""The worker protocol, version 1: what is said between a run and the process that holds an engine.

One JSON object a line, UTF-8, over the worker's standard input and output. docs/workers.md has every
message. Numbers of a scene are JSON numbers, which Python and all serious parsers read back to the last
bit; arrays are {"shape": [n, 3], "base64": little-endian doubles}.
"""

from __future__ import annotations

import base64
import binascii
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Adapter, Engine, Method, ReadBack, Reading, Setting
from bodycheck.adapters.drive import Answer, Case
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
    TorsionSpring,
)
from bodycheck.reference_impl.trajectory import Trajectory

VERSION = 1
LARGEST_MESSAGE = 1 << 29
"""Bytes of a line: a million samples of all quantities."""

Message: TypeAlias = dict[str, Any]

_LOADS: dict[str, type[Any]] = {
    "torque": Torque,
    "force": PointForce,
    "sine-torque": SineTorque,
    "drag": Drag,
    "spring": Spring,
    "torsion-spring": TorsionSpring,
    "gravity-gradient": GravityGradient,
}
_KINDS = {load: kind for kind, load in _LOADS.items()}


class ProtocolError(ValueError):
    """A message that is none of the protocol's."""


def line_of(message: Mapping[str, Any]) -> bytes:
    """Return a message as its line, newline included."""
    return json.dumps(message, separators=(",", ":")).encode() + b"\n"


def message_of(line: bytes) -> Message:
    """Return the message of a line.

    Raises ProtocolError where it is no JSON object.
    """
    try:
        message = json.loads(line)
    except ValueError as error:
        raise ProtocolError(f"a line that is not JSON: {error}: {line[:80]!r}") from None
    if not isinstance(message, dict):
        raise ProtocolError(f"a line that is no JSON object: {line[:80]!r}")
    return message


# -------------------------------------------------------------------------------------------------- arrays


def packed(array: Array) -> Message:
    """Return an array as its shape and its doubles, little-endian, in base64."""
    data = np.ascontiguousarray(array, dtype="<f8")
    return {"shape": list(data.shape), "base64": base64.b64encode(data.tobytes()).decode("ascii")}


def unpacked(value: Message) -> Array:
    """Return the array.

    Raises ProtocolError where shape and data do not agree.
    """
    try:
        data = np.frombuffer(base64.b64decode(value["base64"], validate=True), dtype="<f8")
        return data.reshape(value["shape"]).astype(np.float64)
    except (KeyError, TypeError, ValueError, binascii.Error) as error:
        raise ProtocolError(f"an array that is none: {error}") from None


def _packed_fields(holder: Any) -> Message:
    values = ((field.name, getattr(holder, field.name)) for field in fields(holder))
    return {name: packed(value) for name, value in values if value is not None}


# --------------------------------------------------------------------------------------------------- cases


def case_message(case: Case) -> Message:
    """Return a case as plain data."""
    return {
        "scene": scene_message(case.scene),
        "method": case.method,
        "dt_s": case.setting.dt_s,
        "tolerance": case.setting.tolerance,
    }


def case_of(message: Message) -> Case:
    """Return the case of a message."""
    setting = Setting(message["dt_s"], message["tolerance"])
    return Case(scene_of(message["scene"]), message["method"], setting)


def scene_message(scene: Scene) -> Message:
    """Return a scene as plain data, in SI units, loads by the kinds of the scenario format."""
    return {
        "body": _plain(scene.body),
        "initial": _plain(scene.initial),
        "loads": [{"kind": _KINDS[type(load)], **_plain(load)} for load in scene.loads],
        "gravity": scene.gravity.tolist(),
        "duration_s": scene.duration_s,
        "samples": scene.samples,
    }


def scene_of(message: Message) -> Scene:
    """Return the scene of a message."""
    return Scene(
        body=RigidBody(**_arrays(message["body"])),
        initial=State(**_arrays(message["initial"])),
        loads=tuple(_load(load) for load in message["loads"]),
        gravity=np.array(message["gravity"], dtype=np.float64),
        duration_s=message["duration_s"],
        samples=message["samples"],
    )


def _load(message: Message) -> Load:
    values = _arrays({name: value for name, value in message.items() if name != "kind"})
    if "until_s" in values and values["until_s"] is None:
        values["until_s"] = math.inf
    load: Load = _LOADS[message["kind"]](**values)
    return load


def _plain(holder: Any) -> Message:
    """Return the fields as JSON has them: infinity, which it has not, as null."""
    plain = {}
    for field in fields(holder):
        value = getattr(holder, field.name)
        value = value.tolist() if isinstance(value, np.ndarray) else value
        plain[field.name] = None if value == math.inf else value
    return plain


def _arrays(message: Message) -> Message:
    return {
        name: np.array(value, dtype=np.float64) if isinstance(value, list) else value
        for name, value in message.items()
    }


# ------------------------------------------------------------------------------------------------- answers


def announcement(adapter: Adapter, code: str) -> Message:
    """Return a worker's first message: protocol, engine, version, methods, limits, a hash of its code."""
    return {
        "bodycheck": VERSION,
        "engine": adapter.name,
        "version": adapter.version,
        "methods": [asdict(method) for method in adapter.methods.values()],
        "limits": {"message_bytes": LARGEST_MESSAGE},
        "code": code,
    }


def engine_of(message: Message) -> Engine:
    """Return the engine of an announcement.

    Raises ProtocolError where it lacks what an announcement has, or has more.
    """
    try:
        methods = {method["name"]: _method(method) for method in message["methods"]}
        code = message.get("code", "")
        return Engine(message["engine"], message["version"], methods, code)
    except (KeyError, TypeError, AttributeError) as error:
        raise ProtocolError(f"an announcement without its parts: {error}") from None


def _method(message: Message) -> Method:
    facts: Any = {name: tuple(v) if isinstance(v, list) else v for name, v in message.items()}
    return Method(**facts)


def answer_message(answer: Answer) -> Message:
    """Return an answer as plain data."""
    message: Message = {"outcome": answer.outcome, "message": answer.message}
    if answer.trajectory is not None:
        message["trajectory"] = _packed_fields(answer.trajectory)
    if (held := answer.read_back) is not None:
        message["read_back"] = {
            "mass": held.mass,
            "inertia": packed(held.inertia),
            "dt_s": held.dt_s,
            "gravity": packed(held.gravity),
            "state": _packed_fields(held.state),
        }
    return {**message, "stepping": answer.stepping, "steps": answer.steps}


def answer_of(message: Message, t_s: Array) -> Answer:
    """Return the answer of a message to a case that is sampled at t_s (n,).

    Raises ProtocolError or ValueError, which say what is wrong, where it is no answer to that.
    """
    outcome = message.get("outcome")
    if outcome in ("unsupported", "failed", "timeout"):
        return Answer(outcome, str(message.get("message", "")))
    if outcome != "ok":
        raise ProtocolError(f"an answer whose outcome is {outcome!r}")
    try:
        arrays = {name: unpacked(value) for name, value in message["trajectory"].items()}
        held = message["read_back"]
        read_back = ReadBack(
            mass=float(held["mass"]),
            inertia=unpacked(held["inertia"]),
            dt_s=held["dt_s"],
            gravity=unpacked(held["gravity"]),
            state=Reading(**{name: unpacked(value) for name, value in held["state"].items()}),
        )
        trajectory = Trajectory(**arrays)
        stepping, steps = message["stepping"], message["steps"]
    except (KeyError, TypeError, AttributeError) as error:
        raise ProtocolError(f"an answer without its parts: {type(error).__name__}: {error}") from None
    if not np.array_equal(trajectory.t_s, t_s):
        raise ProtocolError("a trajectory that is not at the scene's samples")
    return Answer("ok", "", trajectory, read_back, stepping, steps)
