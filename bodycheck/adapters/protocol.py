"""The worker protocol, version 1: what is said between a run and the process that holds an engine.

One JSON object a line, UTF-8, over the worker's standard input and output: here what a worker says, in
case_messages.py what it is asked. docs/workers.md has every message. Arrays are {"shape": [n, 3], "base64":
little-endian doubles}.
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

from bodycheck.adapters.contract import Adapter, Control, Engine, Method, ReadBack, Reading
from bodycheck.adapters.drive import Answer
from bodycheck.adapters.stable_step import StableStep
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

VERSION = 1
LARGEST_MESSAGE = 1 << 29
"""Bytes of a line: a million samples of all quantities."""
_LONGEST_TEXT = 1000
_CONTROLS = get_args(Control)

Message: TypeAlias = dict[str, Any]


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
