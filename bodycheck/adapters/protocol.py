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
from typing import Any, TypeAlias, get_args

import numpy as np

from bodycheck.adapters.contract import Adapter, Control, Engine, Method, ReadBack, Reading, Setting
from bodycheck.adapters.drive import Answer, Case
from bodycheck.adapters.stable_step import Search, StableStep
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import (
    BlackBox,
    Drag,
    GravityGradient,
    Link,
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
from bodycheck.scenarios.user_functions import UserWrench, user_function

VERSION = 1
LARGEST_MESSAGE = 1 << 29
"""Bytes of a line: a million samples of all quantities."""
_LONGEST_TEXT = 1000
_CONTROLS = get_args(Control)

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
_CALLABLE = "callable"
_KINDS = {load: kind for kind, load in _LOADS.items()}


class ProtocolError(ValueError):
    """A message that is none of the protocol's."""


def line_of(message: Mapping[str, Any]) -> bytes:
    """Return a message as its line, newline included.

    Raises ProtocolError where it holds what JSON has not, or is longer than a message may be.
    """
    try:
        line = json.dumps(message, separators=(",", ":"), allow_nan=False).encode() + b"\n"
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"a message that JSON cannot hold: {error}") from None
    if len(line) > LARGEST_MESSAGE:
        raise ProtocolError(f"a message of {len(line)} bytes, more than {LARGEST_MESSAGE}")
    return line


def message_of(line: bytes) -> Message:
    """Return the message of a line.

    Raises ProtocolError where it is no JSON object.
    """
    try:
        message = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"a line that is not JSON: {error}: {line[:80]!r}") from None
    if not isinstance(message, dict):
        raise ProtocolError(f"a line that is no JSON object: {line[:80]!r}")
    return message


def shown(text: str) -> str:
    """Return a text of an engine as one line that a table can hold: printable, and not without end."""
    begin = text[: 4 * _LONGEST_TEXT]
    line = "".join(c if c.isprintable() else "?" for c in " ".join(begin.split()))
    return line if len(line) <= _LONGEST_TEXT else f"{line[:_LONGEST_TEXT]}..."


# -------------------------------------------------------------------------------------------------- arrays


def packed(array: Array) -> Message:
    """Return an array as its shape and its doubles, little-endian, in base64.

    Raises ProtocolError where it does not hold real numbers: a text that reads like one is none.
    """
    data = np.asarray(array)
    if data.dtype.kind not in "fiu":
        raise ProtocolError(f"an array of {data.dtype}, not of real numbers")
    doubles = data.astype("<f8").tobytes()
    return {"shape": list(data.shape), "base64": base64.b64encode(doubles).decode("ascii")}


def unpacked(value: Message) -> Array:
    """Return the array.

    Raises ProtocolError where shape and data do not agree.
    """
    try:
        data = np.frombuffer(base64.b64decode(value["base64"], validate=True), dtype="<f8")
        return data.reshape(value["shape"]).astype(np.float64)
    except (KeyError, TypeError, ValueError, binascii.Error) as error:
        raise ProtocolError(f"an array that is none: {error}") from None


def _number(value: float) -> float | None:
    """Return a number as JSON has it: one that is not finite as null."""
    return float(value) if math.isfinite(value) else None


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


def search_bounds(search: Search) -> dict[str, float | None]:
    """Return within what the largest stable step of a case is looked for, as plain data."""
    return {
        "lowest_s": search.lowest_s,
        "highest_s": search.highest_s,
        "kinetic_limit_j": _number(search.kinetic_limit_j),
    }


def search_message(search: Search) -> Message:
    """Return a search for the largest stable step as plain data."""
    return {"case": case_message(search.case), **search_bounds(search)}


def search_of(message: Message) -> Search:
    """Return the search of a message."""
    limit = message["kinetic_limit_j"]
    return Search(
        case_of(message["case"]),
        message["lowest_s"],
        message["highest_s"],
        math.inf if limit is None else limit,
    )


def scene_message(scene: Scene) -> Message:
    """Return a scene as plain data, in SI units, loads by the kinds of the scenario format.

    A pivot and a link frame stand there only where the scene has them.
    """
    message = {
        "body": _plain(scene.body),
        "initial": _plain(scene.initial),
        "loads": [_load_message(load) for load in scene.loads],
        "gravity": scene.gravity.tolist(),
        "duration_s": scene.duration_s,
        "samples": scene.samples,
    }
    if scene.pivot is not None:
        message["pivot"] = scene.pivot.tolist()
    if scene.link is not None:
        message["link"] = _plain(scene.link)
    return message


def scene_of(message: Message) -> Scene:
    """Return the scene of a message."""
    return Scene(
        body=RigidBody(**_arrays(message["body"])),
        initial=State(**_arrays(message["initial"])),
        loads=tuple(_load(load) for load in message["loads"]),
        gravity=np.array(message["gravity"], dtype=np.float64),
        duration_s=message["duration_s"],
        samples=message["samples"],
        pivot=np.array(message["pivot"], dtype=np.float64) if "pivot" in message else None,
        link=Link(**_arrays(message["link"])) if "link" in message else None,
    )


def _load_message(load: Load) -> Message:
    """Return a load as plain data; a function travels as its name."""
    if isinstance(load, BlackBox):
        return {"kind": _CALLABLE, "name": load.name}
    return {"kind": _KINDS[type(load)], **_plain(load)}


def _load(message: Message) -> Load:
    if message["kind"] == _CALLABLE:
        # the run that sends it was allowed to run code
        return BlackBox(
            message["name"], UserWrench(message["name"], user_function(message["name"], allow_code=True))
        )
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
        name, version, code = message["engine"], message["version"], message["code"]
    except (KeyError, TypeError, AttributeError) as error:
        raise ProtocolError(f"an announcement without its parts: {error}") from None
    if not all(isinstance(text, str) for text in (name, version, code, *methods)):
        raise ProtocolError("an announcement whose names, version or code are no texts")
    if wrong := [method.control for method in methods.values() if method.control not in _CONTROLS]:
        raise ProtocolError(f"an announcement with the control {wrong[0]!r}, none of {', '.join(_CONTROLS)}")
    return Engine(name, version, methods, code)


def request_limit_of(message: Message) -> int:
    """Return the bytes of the longest request that the worker of an announcement takes.

    Raises ProtocolError where it does not say.
    """
    limits: Any = message.get("limits")
    most = limits.get("message_bytes") if isinstance(limits, dict) else None
    if type(most) is not int or most < 1:
        raise ProtocolError(f"an announcement whose limits are {limits!r}")
    return min(most, LARGEST_MESSAGE)


def _method(message: Message) -> Method:
    facts: Any = {name: tuple(v) if isinstance(v, list) else v for name, v in message.items()}
    return Method(**facts)


def answer_message(answer: Answer) -> Message:
    """Return an answer as plain data."""
    message: Message = {"outcome": answer.outcome, "message": shown(answer.message)}
    if answer.trajectory is not None:
        message["trajectory"] = _packed_fields(answer.trajectory)
    if answer.read_back is not None:
        message["read_back"] = read_back_message(answer.read_back)
    steps = None if answer.steps is None else int(answer.steps)
    return {**message, "stepping": answer.stepping, "steps": steps}


def answer_of(message: Message, t_s: Array) -> Answer:
    """Return the answer of a message to a case that is sampled at t_s (n,).

    Raises ProtocolError or ValueError, which say what is wrong, where it is no answer to that.
    """
    outcome, text = message.get("outcome"), shown(str(message.get("message", "")))
    if outcome in ("unsupported", "failed", "timeout"):
        return Answer(outcome, text)
    if outcome != "ok":
        raise ProtocolError(f"an answer whose outcome is {outcome!r}")
    try:
        arrays = {name: unpacked(value) for name, value in message["trajectory"].items()}
        trajectory, read_back = Trajectory(**arrays), read_back_of(message["read_back"])
        stepping, steps = message["stepping"], message["steps"]
    except (KeyError, TypeError, AttributeError) as error:
        raise ProtocolError(f"an answer without its parts: {type(error).__name__}: {error}") from None
    if not np.array_equal(trajectory.t_s, t_s):
        raise ProtocolError("a trajectory that is not at the scene's samples")
    if stepping not in ("native", "python"):
        raise ProtocolError(f"an answer whose stepping is {stepping!r}, not native or python")
    if steps is not None and (type(steps) is not int or steps < 0):
        raise ProtocolError(f"an answer whose steps are {steps!r}, no count")
    return Answer("ok", text, trajectory, read_back, stepping, steps)


def read_back_message(held: ReadBack) -> Message:
    """Return what an engine says it was given as plain data."""
    return {
        "mass": _number(held.mass),
        "inertia": packed(held.inertia),
        "dt_s": None if held.dt_s is None else _number(held.dt_s),
        "gravity": packed(held.gravity),
        "state": _packed_fields(held.state),
    }


def read_back_of(held: Message) -> ReadBack:
    """Return what an engine says it was given, of a message of it.

    Raises KeyError, TypeError or ValueError where it is none.
    """
    return ReadBack(
        mass=math.nan if held["mass"] is None else float(held["mass"]),
        inertia=unpacked(held["inertia"]),
        dt_s=None if held["dt_s"] is None else float(held["dt_s"]),
        gravity=unpacked(held["gravity"]),
        state=Reading(**{name: unpacked(value) for name, value in held["state"].items()}),
    )


def lap_of(message: Message) -> float:
    """Return the processor time in s of an answer to `lap`.

    Raises ProtocolError where there is none.
    """
    seconds: Any = message.get("cpu_s")
    if type(seconds) not in (int, float) or not 0.0 <= seconds < math.inf:
        raise ProtocolError(f"a lap whose cpu_s is {seconds!r}")
    return float(seconds)


def stable_step_message(found: StableStep) -> Message:
    """Return what a search found as plain data."""
    return {**asdict(found), "message": shown(found.message)}


def stable_step_of(message: Message) -> StableStep:
    """Return what a search found.

    Raises ProtocolError where the message does not say that.
    """
    outcome, text = message.get("outcome"), shown(str(message.get("message", "")))
    if outcome in ("unsupported", "failed", "timeout"):
        return StableStep(outcome, text)
    stable, unstable = message.get("stable_s"), message.get("unstable_s")
    steps = [step for step in (stable, unstable) if step is not None]
    if outcome != "ok" or not steps or any(type(step) not in (int, float) for step in steps):
        raise ProtocolError(f"a search that ended {outcome!r} with the steps {stable!r} and {unstable!r}")
    if not 0.0 < steps[0] <= steps[-1] < math.inf:
        raise ProtocolError(f"a stable step of {stable!r} below an unstable one of {unstable!r}")
    return StableStep("ok", text, stable, unstable, shown(str(message.get("reason", ""))))
