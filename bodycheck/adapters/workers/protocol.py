"""The worker protocol, version 1: messages between a run and the worker process of an engine.

Each message is one JSON object per line, UTF-8, over the worker's standard input and output. Arrays are
{"shape": [n, 3], "base64": little-endian doubles}; a worker may also list their numbers. This module encodes
the worker's messages, received_messages.py decodes them, case_messages.py has the requests; docs/workers.md
documents all of them.
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

from bodycheck.adapters.batches import BatchAnswer
from bodycheck.adapters.contract import Adapter, Build, ReadBack, TreeReadBack
from bodycheck.adapters.execution import Answer
from bodycheck.adapters.stable_step import StableStep
from bodycheck.adapters.tree_contract import tree_model_of
from bodycheck.reference_impl.arrays import Array

VERSION = 1
LARGEST_MESSAGE = 1 << 29
"""Maximum bytes of a line: a million samples of all quantities."""
LONGEST_ANNOUNCEMENT = 1 << 22
"""Maximum bytes of a line without a trajectory."""
_BYTES_PER_SAMPLE = 1024  # all quantities as decimal numbers take 750; the rest is margin
_LONGEST_TEXT = 1000

Message: TypeAlias = dict[str, Any]


class ProtocolError(ValueError):
    """A message that does not follow the protocol."""


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


def text_of(message: Mapping[str, Any], key: str) -> str:
    """Return the string under a key of a message; empty if there is none."""
    value = message.get(key)
    return value if isinstance(value, str) else ""


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


def unpacked(message: Message) -> Array:
    """Decode an array (...).

    Raises ProtocolError, before decoding, if the message is not an array or shape and data do not agree.
    """
    match message:
        case {"shape": [*shape], "base64": str(data)} if all(type(n) is int and n >= 0 for n in shape):
            pass
        case _:
            raise ProtocolError('invalid array: expected {"shape": [n, ...], "base64": "..."}')
    size = 8 * math.prod(shape)
    if len(data) != 4 * -(-size // 3):
        raise ProtocolError(f"invalid array: shape {shape} with {len(data)} characters of base64")
    try:
        doubles = np.frombuffer(base64.b64decode(data, validate=True), dtype="<f8")
        return doubles.reshape(shape).astype(np.float64)
    except (ValueError, binascii.Error) as error:
        raise ProtocolError(f"invalid array: {error}") from None


def _number(value: float) -> float | None:
    """Return a number, or None (JSON null) if it is not finite."""
    return float(value) if math.isfinite(value) else None


def _packed_fields(holder: Any) -> Message:
    values = ((field.name, getattr(holder, field.name)) for field in fields(holder))
    return {name: packed(value) for name, value in values if value is not None}


# ------------------------------------------------------------------------------------- the worker's messages


def announcement(adapter: Adapter, build: Build) -> Message:
    """Return a worker's first message: protocol version, engine, version, methods, limits, build."""
    return {
        "bodycheck": VERSION,
        "engine": adapter.name,
        "version": adapter.version,
        "methods": [asdict(method) for method in adapter.methods.values()],
        "limits": {"message_bytes": LARGEST_MESSAGE},
        "trees": tree_model_of(adapter) is not None,
        **build_message(build),
    }


def build_message(build: Build) -> Message:
    """Return a build as plain data."""
    parts = {name: one_line(text) for name, text in build.parts.items()}
    return {"build": build.id, "kind": build.kind, "loaded": parts}


def answer_limit_of(request: Message) -> int:
    """Return the maximum bytes of a valid answer to a request."""
    if request.get("do") == "batch":
        rows = request["bodies"]["moments"]["shape"][0]
        samples = request["case"]["scene"]["samples"]
        return min(LONGEST_ANNOUNCEMENT + rows * (_LONGEST_TEXT * 6 + 80 * samples), LARGEST_MESSAGE)
    has_samples = request.get("do") in ("record", "replay") and "case" in request
    samples = request["case"]["scene"]["samples"] if has_samples else 0
    bodies = len(request["case"]["scene"].get("bodies", "1")) if has_samples else 1
    return min(LONGEST_ANNOUNCEMENT + _BYTES_PER_SAMPLE * samples * bodies, LARGEST_MESSAGE)


def answer_message(answer: Answer) -> Message:
    """Return an answer as plain data."""
    message: Message = {"outcome": answer.outcome, "message": one_line(answer.message)}
    if answer.trajectory is not None:
        message["trajectory"] = _packed_fields(answer.trajectory)
    if answer.read_back is not None:
        message["read_back"] = read_back_message(answer.read_back)
    steps = None if answer.steps is None else int(answer.steps)
    return {**message, "stepping": answer.stepping, "steps": steps}


def batch_answer_message(answer: BatchAnswer) -> Message:
    """Return the answer to a batch as plain data."""
    return {
        "outcome": "ok",
        "quaternion": packed(answer.quaternion),
        "omega_body": packed(answer.omega_body),
        "endings": list(answer.endings),
        "messages": [one_line(text) for text in answer.messages],
    }


def read_back_message(read_back: ReadBack | TreeReadBack) -> Message:
    """Return a model that was read back as plain data."""
    if isinstance(read_back, TreeReadBack):
        return {"dt_s": read_back.dt_s, "tree": {name: packed(n) for name, n in read_back.numbers.items()}}
    return {
        "mass": _number(read_back.mass),
        "inertia": packed(read_back.inertia),
        "dt_s": None if read_back.dt_s is None else _number(read_back.dt_s),
        "gravity": packed(read_back.gravity),
        "state": _packed_fields(read_back.state),
    }


def stable_step_message(found: StableStep) -> Message:
    """Return the result of a search as plain data."""
    data = {**asdict(found), "message": one_line(found.message)}
    return {name: value for name, value in data.items() if name not in ("build", "reused")}
