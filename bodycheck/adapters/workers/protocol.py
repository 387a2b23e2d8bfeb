"""The worker protocol, version 1: messages between a run and the worker process of an engine.

Each message is one JSON object per line, UTF-8, over the worker's standard input and output. This module has
the worker's messages, case_messages.py the requests; docs/workers.md documents all of them. Arrays are
{"shape": [n, 3], "base64": little-endian doubles}.
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

from bodycheck.adapters.batches import BatchAnswer
from bodycheck.adapters.contract import Adapter, Build, Engine, Method, ReadBack, Reading
from bodycheck.adapters.execution import Answer
from bodycheck.adapters.stable_step import StableStep
from bodycheck.adapters.workers.message_check import (
    AnnouncementMessage,
    AnswerMessage,
    ArrayMessage,
    BatchAnswerMessage,
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
"""Maximum bytes of a line: a million samples of all quantities."""
LONGEST_ANNOUNCEMENT = 1 << 22
"""Maximum bytes of a line without a trajectory."""
_BYTES_PER_SAMPLE = 512  # all quantities in base64 take 283; the rest is margin
_LONGEST_TEXT = 1000
_STATE_SHAPES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "velocity": (3,),
    "quaternion": (4,),
    "rotation": (3, 3),
    "omega_world": (3,),
    "omega_body": (3,),
}
_STORED_KEYS = ("trajectory", "read_back", "stepping", "steps", "stable_s", "unstable_s", "reason")
_STORED_TEXTS = ("build", "run")

Message: TypeAlias = dict[str, Any]


def line_of(message: Mapping[str, Any]) -> bytes:
    """Return a message as its line, newline included.

    Raises ProtocolError if JSON cannot represent it or it exceeds the maximum length.
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

    Raises ProtocolError if it is not a JSON object.
    """
    try:
        message = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"a line that is not JSON: {error}: {line[:80]!r}") from None
    if not isinstance(message, dict):
        raise ProtocolError(f"a line that is not a JSON object: {line[:80]!r}")
    return message


def one_line(text: str) -> str:
    """Return an engine's text as one printable line of bounded length, for tables."""
    start = text[: 4 * _LONGEST_TEXT]
    line = "".join(c if c.isprintable() else "?" for c in " ".join(start.split()))
    return line if len(line) <= _LONGEST_TEXT else f"{line[:_LONGEST_TEXT]}..."


# -------------------------------------------------------------------------------------------------- arrays


def packed(array: Array) -> Message:
    """Encode an array (...) as its shape and its little-endian doubles in base64.

    Raises ProtocolError if it does not hold real numbers; strings of digits are not numbers.
    """
    data = np.asarray(array)
    if data.dtype.kind not in "fiu":
        raise ProtocolError(f"an array of {data.dtype}, not of real numbers")
    doubles = data.astype("<f8").tobytes()
    return {"shape": list(data.shape), "base64": base64.b64encode(doubles).decode("ascii")}


def unpacked(value: Message | ArrayMessage) -> Array:
    """Decode an array (...).

    Raises ProtocolError, before decoding, if shape and data do not agree.
    """
    parsed = value if isinstance(value, ArrayMessage) else checked(ArrayMessage, value, "invalid array")
    size = 8 * math.prod(parsed.shape)
    if len(parsed.base64) != 4 * -(-size // 3):
        raise ProtocolError(
            f"invalid array: shape {parsed.shape} with {len(parsed.base64)} characters of base64"
        )
    try:
        data = np.frombuffer(base64.b64decode(parsed.base64, validate=True), dtype="<f8")
        return data.reshape(parsed.shape).astype(np.float64)
    except (ValueError, binascii.Error) as error:
        raise ProtocolError(f"invalid array: {error}") from None


def _unpacked_as(value: ArrayMessage, name: str, *shape: int) -> Array:
    """Decode an array; raises ProtocolError if it does not have this shape."""
    if tuple(value.shape) != shape:
        raise ProtocolError(f"{name} has the shape {value.shape}, not {list(shape)}")
    return unpacked(value)


def _number(value: float) -> float | None:
    """Return a number, or None (JSON null) if it is not finite."""
    return float(value) if math.isfinite(value) else None


def _packed_fields(holder: Any) -> Message:
    values = ((field.name, getattr(holder, field.name)) for field in fields(holder))
    return {name: packed(value) for name, value in values if value is not None}


# ------------------------------------------------------------------------------------------------- answers


def announcement(adapter: Adapter, build: Build) -> Message:
    """Return a worker's first message: protocol version, engine, version, methods, limits, build."""
    return {
        "bodycheck": VERSION,
        "engine": adapter.name,
        "version": adapter.version,
        "methods": [asdict(method) for method in adapter.methods.values()],
        "limits": {"message_bytes": LARGEST_MESSAGE},
        **build_message(build),
    }


def build_message(build: Build) -> Message:
    """Return a build as plain data."""
    parts = {name: one_line(text) for name, text in build.parts.items()}
    return {"build": build.id, "kind": build.kind, "loaded": parts}


def engine_of(message: Message) -> tuple[Engine, int]:
    """Return the engine of an announcement, and the maximum bytes of a request that its worker accepts.

    Raises ProtocolError if the announcement is invalid.
    """
    parsed = checked(AnnouncementMessage, message, "invalid announcement")
    if repeated := [
        name for name, times in Counter(method.name for method in parsed.methods).items() if times > 1
    ]:
        raise ProtocolError(f"invalid announcement: the method {repeated[0]} is named twice")
    methods = {method.name: _method(method) for method in parsed.methods}
    build = Build(parsed.build, parsed.kind, {name: one_line(text) for name, text in parsed.loaded.items()})
    max_bytes = min(parsed.limits.message_bytes, LARGEST_MESSAGE)
    return Engine(parsed.engine, parsed.version, methods, build), max_bytes


def check_engine(adapter: Adapter) -> None:
    """Raise ProtocolError if an adapter's attributes would make an invalid announcement."""
    try:
        facts = {
            "engine": adapter.name,
            "version": adapter.version,
            "methods": [asdict(method) for method in adapter.methods.values()],
            "limits": {"message_bytes": LARGEST_MESSAGE},
        }
    except (TypeError, AttributeError) as error:
        raise ProtocolError(f"invalid methods of an adapter: {error}") from None
    checked(AnnouncementMessage, facts, "invalid adapter")


def answer_limit_of(request: Message) -> int:
    """Return the maximum bytes of a valid answer to a request."""
    if request.get("do") == "batch":
        rows = request["bodies"]["moments"]["shape"][0]
        samples = request["case"]["scene"]["samples"]
        return min(LONGEST_ANNOUNCEMENT + rows * (_LONGEST_TEXT * 6 + 80 * samples), LARGEST_MESSAGE)
    has_samples = request.get("do") in ("record", "replay") and "case" in request
    samples = request["case"]["scene"]["samples"] if has_samples else 0
    return min(LONGEST_ANNOUNCEMENT + _BYTES_PER_SAMPLE * samples, LARGEST_MESSAGE)


def _method(parsed: MethodMessage) -> Method:
    facts: Any = {name: tuple(v) if isinstance(v, list) else v for name, v in parsed.model_dump().items()}
    return Method(**facts)


def answer_message(answer: Answer) -> Message:
    """Return an answer as plain data."""
    message: Message = {"outcome": answer.outcome, "message": one_line(answer.message)}
    if answer.trajectory is not None:
        message["trajectory"] = _packed_fields(answer.trajectory)
    if answer.read_back is not None:
        message["read_back"] = read_back_message(answer.read_back)
    steps = None if answer.steps is None else int(answer.steps)
    return {**message, "stepping": answer.stepping, "steps": steps}


def answer_of(message: Message, t_s: Array) -> Answer:
    """Return the answer to a case that is sampled at t_s (n,).

    Raises ProtocolError or ValueError, which say what is wrong, if the message is not an answer to that case.
    """
    outcome, text = message.get("outcome"), one_line(text_of(message, "message"))
    if outcome in ("unsupported", "failed", "timeout"):
        return Answer(outcome, text)
    if outcome != "ok":
        raise ProtocolError(f"an answer whose outcome is {outcome!r:.80}")
    parsed = checked(AnswerMessage, message, "invalid answer")
    try:
        trajectory = Trajectory(**{name: unpacked(array) for name, array in parsed.trajectory.items()})
    except TypeError as error:
        raise ProtocolError(f"incomplete answer: {error}") from None
    if not np.array_equal(trajectory.t_s, t_s):
        raise ProtocolError("a trajectory that is not at the scene's samples")
    return Answer("ok", text, trajectory, _read_back(parsed.read_back), parsed.stepping, parsed.steps)


def batch_answer_message(answer: BatchAnswer) -> Message:
    """Return the answer to a batch as plain data."""
    return {
        "outcome": "ok",
        "quaternion": packed(answer.quaternion),
        "omega_body": packed(answer.omega_body),
        "endings": list(answer.endings),
        "messages": [one_line(text) for text in answer.messages],
    }


def batch_answer_of(message: Message, rows: int, samples: int) -> BatchAnswer:
    """Return the answer to a batch of so many bodies and samples.

    Raises ProtocolError if the message is not one.
    """
    parsed = checked(BatchAnswerMessage, message, "invalid answer to a batch")
    if len(parsed.endings) != rows or len(parsed.messages) != rows:
        raise ProtocolError(f"an answer with {len(parsed.endings)} endings, not {rows}")
    return BatchAnswer(
        _unpacked_as(parsed.quaternion, "quaternion", rows, samples, 4),
        _unpacked_as(parsed.omega_body, "omega_body", rows, samples, 3),
        tuple(parsed.endings),
        tuple(one_line(text) for text in parsed.messages),
    )


def stored_part(message: Message, answer: Answer | StableStep) -> Message:
    """Return the part of a message that is stored: the checked keys, and nothing else."""
    checked_keys = _STORED_KEYS if answer.outcome == "ok" else ()
    texts = {name: message[name] for name in _STORED_TEXTS if isinstance(message.get(name), str)}
    found = {name: message[name] for name in checked_keys if name in message}
    return {"outcome": answer.outcome, "message": answer.message, **texts, **found}


def read_back_message(read_back: ReadBack) -> Message:
    """Return a model that was read back as plain data."""
    return {
        "mass": _number(read_back.mass),
        "inertia": packed(read_back.inertia),
        "dt_s": None if read_back.dt_s is None else _number(read_back.dt_s),
        "gravity": packed(read_back.gravity),
        "state": _packed_fields(read_back.state),
    }


def read_back_of(read_back: Message) -> ReadBack:
    """Return the model that was read back.

    Raises ProtocolError if the message is invalid.
    """
    return _read_back(checked(ReadBackMessage, read_back, "invalid read-back"))


def _read_back(read_back: ReadBackMessage) -> ReadBack:
    if unknown := read_back.state.keys() - _STATE_SHAPES.keys():
        raise ProtocolError(f"unknown quantity {min(unknown)} of a state (known: {', '.join(_STATE_SHAPES)})")
    state: Any = {
        name: _unpacked_as(array, name, *_STATE_SHAPES[name]) for name, array in read_back.state.items()
    }
    if missing := [name for name in ("position", "velocity") if name not in state]:
        raise ProtocolError(f"a state without {missing[0]}")
    return ReadBack(
        mass=math.nan if read_back.mass is None else read_back.mass,
        inertia=_unpacked_as(read_back.inertia, "inertia", 3, 3),
        dt_s=read_back.dt_s,
        gravity=_unpacked_as(read_back.gravity, "gravity", 3),
        state=Reading(**state),
    )


def lap_of(message: Message) -> float:
    """Return the CPU time in s of an answer to `lap`.

    Raises ProtocolError if there is none.
    """
    return checked(LapMessage, message, "invalid lap").cpu_s


def stable_step_message(found: StableStep) -> Message:
    """Return the result of a search as plain data."""
    data = {**asdict(found), "message": one_line(found.message)}
    return {name: value for name, value in data.items() if name not in ("build", "reused")}


def stable_step_of(message: Message) -> StableStep:
    """Return the result of a search.

    Raises ProtocolError if the message is invalid.
    """
    outcome, text = message.get("outcome"), one_line(text_of(message, "message"))
    if outcome in ("unsupported", "failed", "timeout"):
        return StableStep(outcome, text)
    if outcome != "ok":
        raise ProtocolError(f"a search whose outcome is {outcome!r:.80}")
    parsed = checked(StableStepMessage, message, "invalid search result")
    steps = [step for step in (parsed.stable_s, parsed.unstable_s) if step is not None]
    if not steps:
        raise ProtocolError("a search result with neither a stable nor an unstable step")
    if steps[0] > steps[-1]:
        raise ProtocolError(f"a stable step of {steps[0]!r} above the unstable step of {steps[-1]!r}")
    return StableStep("ok", text, parsed.stable_s, parsed.unstable_s, one_line(parsed.reason))
