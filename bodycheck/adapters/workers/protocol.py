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
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Adapter, Build, Engine, Method, ReadBack, Reading
from bodycheck.adapters.execution import Answer
from bodycheck.adapters.stable_step import StableStep
from bodycheck.adapters.workers.message_check import (
    AnnouncementMessage,
    AnswerMessage,
    ArrayMessage,
    LapMessage,
    MethodMessage,
    ReadBackMessage,
    StableStepMessage,
    checked,
)
from bodycheck.adapters.workers.message_check import ProtocolError as ProtocolError
from bodycheck.adapters.workers.message_check import text_of as text_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

VERSION = 1
LARGEST_MESSAGE = 1 << 29
"""Bytes of a line: a million samples of all quantities."""
LONGEST_ANNOUNCEMENT = 1 << 22
"""Bytes of a line that holds no trajectory."""
_BYTES_PER_SAMPLE = 512  # of all quantities in base64: 283, and air
_LONGEST_TEXT = 1000
_STATE_SHAPES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "velocity": (3,),
    "quaternion": (4,),
    "rotation": (3, 3),
    "omega_world": (3,),
    "omega_body": (3,),
}
_KEPT = ("trajectory", "read_back", "stepping", "steps", "stable_s", "unstable_s", "reason")
_KEPT_TEXTS = ("build", "run")

Message: TypeAlias = dict[str, Any]


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


def unpacked(value: Message | ArrayMessage) -> Array:
    """Return the array.

    Raises ProtocolError where shape and data do not agree, before anything is decoded.
    """
    told = value if isinstance(value, ArrayMessage) else checked(ArrayMessage, value, "an array that is none")
    size = 8 * math.prod(told.shape)
    if len(told.base64) != 4 * -(-size // 3):
        raise ProtocolError(
            f"an array that is none: of the shape {told.shape} with {len(told.base64)} letters of base64"
        )
    try:
        data = np.frombuffer(base64.b64decode(told.base64, validate=True), dtype="<f8")
        return data.reshape(told.shape).astype(np.float64)
    except (ValueError, binascii.Error) as error:
        raise ProtocolError(f"an array that is none: {error}") from None


def _unpacked_as(value: ArrayMessage, name: str, *shape: int) -> Array:
    """Return an array of this shape; ProtocolError where it has another."""
    if tuple(value.shape) != shape:
        raise ProtocolError(f"{name} has the shape {value.shape}, not {list(shape)}")
    return unpacked(value)


def _number(value: float) -> float | None:
    """Return a number as JSON has it: one that is not finite as null."""
    return float(value) if math.isfinite(value) else None


def _packed_fields(holder: Any) -> Message:
    values = ((field.name, getattr(holder, field.name)) for field in fields(holder))
    return {name: packed(value) for name, value in values if value is not None}


# ------------------------------------------------------------------------------------------------- answers


def announcement(adapter: Adapter, build: Build) -> Message:
    """Return a worker's first message: protocol, engine, version, methods, limits, what it has loaded."""
    return {
        "bodycheck": VERSION,
        "engine": adapter.name,
        "version": adapter.version,
        "methods": [asdict(method) for method in adapter.methods.values()],
        "limits": {"message_bytes": LARGEST_MESSAGE},
        **build_message(build),
    }


def build_message(build: Build) -> Message:
    """Return what a worker has loaded as plain data."""
    parts = {name: shown(text) for name, text in build.parts.items()}
    return {"build": build.id, "kind": build.kind, "loaded": parts}


def engine_of(message: Message) -> Engine:
    """Return the engine of an announcement.

    Raises ProtocolError where it lacks what an announcement has, or has more.
    """
    said = checked(AnnouncementMessage, message, "an announcement that is none")
    if repeated := [
        name for name, times in Counter(method.name for method in said.methods).items() if times > 1
    ]:
        raise ProtocolError(f"an announcement that names the method {repeated[0]} twice")
    methods = {method.name: _method(method) for method in said.methods}
    build = Build(said.build, said.kind, {name: shown(text) for name, text in said.loaded.items()})
    return Engine(said.engine, said.version, methods, build)


def check_engine(adapter: Adapter) -> None:
    """Raise ProtocolError where an adapter's own facts are none that a worker may announce."""
    try:
        facts = {
            "engine": adapter.name,
            "version": adapter.version,
            "methods": [asdict(method) for method in adapter.methods.values()],
            "limits": {"message_bytes": LARGEST_MESSAGE},
        }
    except (TypeError, AttributeError) as error:
        raise ProtocolError(f"an adapter whose methods are none: {error}") from None
    checked(AnnouncementMessage, facts, "an adapter that is none")


def request_limit_of(message: Message) -> int:
    """Return the bytes of the longest request that the worker of an announcement takes.

    Raises ProtocolError where it does not say.
    """
    most = checked(AnnouncementMessage, message, "an announcement that is none").limits.message_bytes
    return min(most, LARGEST_MESSAGE)


def answer_limit_of(request: Message) -> int:
    """Return the bytes of the longest answer to a request that can be meant."""
    samples = (
        request["case"]["scene"]["samples"] if request.get("do") == "record" and "case" in request else 0
    )
    return min(LONGEST_ANNOUNCEMENT + _BYTES_PER_SAMPLE * samples, LARGEST_MESSAGE)


def _method(said: MethodMessage) -> Method:
    facts: Any = {name: tuple(v) if isinstance(v, list) else v for name, v in said.model_dump().items()}
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
    outcome, text = message.get("outcome"), shown(text_of(message, "message"))
    if outcome in ("unsupported", "failed", "timeout"):
        return Answer(outcome, text)
    if outcome != "ok":
        raise ProtocolError(f"an answer whose outcome is {outcome!r:.80}")
    said = checked(AnswerMessage, message, "an answer that is none")
    try:
        trajectory = Trajectory(**{name: unpacked(array) for name, array in said.trajectory.items()})
    except TypeError as error:
        raise ProtocolError(f"an answer without its parts: {error}") from None
    if not np.array_equal(trajectory.t_s, t_s):
        raise ProtocolError("a trajectory that is not at the scene's samples")
    return Answer("ok", text, trajectory, _read_back(said.read_back), said.stepping, said.steps)


def kept(message: Message, said: Answer | StableStep) -> Message:
    """Return what of a message is stored: what was checked, and nothing that else stood in it."""
    checked_keys = _KEPT if said.outcome == "ok" else ()
    texts = {name: message[name] for name in _KEPT_TEXTS if isinstance(message.get(name), str)}
    found = {name: message[name] for name in checked_keys if name in message}
    return {"outcome": said.outcome, "message": said.message, **texts, **found}


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

    Raises ProtocolError where it is none.
    """
    return _read_back(checked(ReadBackMessage, held, "what an engine holds"))


def _read_back(held: ReadBackMessage) -> ReadBack:
    if unknown := held.state.keys() - _STATE_SHAPES.keys():
        raise ProtocolError(f"a state with {min(unknown)}; known are {', '.join(_STATE_SHAPES)}")
    state: Any = {name: _unpacked_as(array, name, *_STATE_SHAPES[name]) for name, array in held.state.items()}
    if missing := [name for name in ("position", "velocity") if name not in state]:
        raise ProtocolError(f"a state without {missing[0]}")
    return ReadBack(
        mass=math.nan if held.mass is None else held.mass,
        inertia=_unpacked_as(held.inertia, "inertia", 3, 3),
        dt_s=held.dt_s,
        gravity=_unpacked_as(held.gravity, "gravity", 3),
        state=Reading(**state),
    )


def lap_of(message: Message) -> float:
    """Return the processor time in s of an answer to `lap`.

    Raises ProtocolError where there is none.
    """
    return checked(LapMessage, message, "a lap that is none").cpu_s


def stable_step_message(found: StableStep) -> Message:
    """Return what a search found as plain data."""
    told = {**asdict(found), "message": shown(found.message)}
    return {name: value for name, value in told.items() if name not in ("build", "reused")}


def stable_step_of(message: Message) -> StableStep:
    """Return what a search found.

    Raises ProtocolError where the message does not say that.
    """
    outcome, text = message.get("outcome"), shown(text_of(message, "message"))
    if outcome in ("unsupported", "failed", "timeout"):
        return StableStep(outcome, text)
    if outcome != "ok":
        raise ProtocolError(f"a search whose outcome is {outcome!r:.80}")
    said = checked(StableStepMessage, message, "a search that is none")
    steps = [step for step in (said.stable_s, said.unstable_s) if step is not None]
    if not steps:
        raise ProtocolError("a search without a stable or an unstable step")
    if steps[0] > steps[-1]:
        raise ProtocolError(f"a stable step of {steps[0]!r} above an unstable one of {steps[-1]!r}")
    return StableStep("ok", text, said.stable_s, said.unstable_s, shown(said.reason))
