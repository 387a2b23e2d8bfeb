"""A worker with wrong replies, in one of many seeded ways; `python -m tests.helpers.faulty_worker SEED`."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from typing import Any, BinaryIO

from bodycheck.adapters.contract import Build
from bodycheck.adapters.workers import protocol
from bodycheck.adapters.workers.worker import RequestHandler
from tests.helpers.file_mutations import any_bytes, changed
from tests.helpers.misbehaving_engine import Misbehaving

METHOD = "raise"  # sound, like all methods of a sound Misbehaving


def _line(message: Any) -> bytes:
    return json.dumps(message).encode() + b"\n"


def _killed(number: int) -> Callable[[BinaryIO, bytes], None]:
    return lambda _out, _line: os.kill(os.getpid(), number)


def _written(change: Callable[[bytes], bytes]) -> Callable[[BinaryIO, bytes], None]:
    return lambda out, line: out.write(change(line)) and None


def _flood(out: BinaryIO, _: bytes) -> None:
    piece = b"x" * (1 << 20)
    for _ in range(700):
        out.write(piece)


def _sleep(out: BinaryIO, line: bytes) -> None:
    out.write(line[:10])
    out.flush()
    time.sleep(1000.0)


def _cut_off(out: BinaryIO, line: bytes) -> None:
    out.write(line[: len(line) // 2])
    out.flush()
    os._exit(0)


RAW: dict[str, Callable[[BinaryIO, bytes], None]] = {
    "nothing": _written(lambda _: b"\n"),
    "cut off, and the end": _cut_off,
    "two answers": _written(lambda line: line + line),
    "no UTF-8": _written(lambda line: line.replace(b'"', b'"\xff\xfe', 1)),
    "zeros": _written(lambda _: bytes(1000) + b"\n"),
    "nested without end": _written(lambda _: b"[" * 200_000 + b"\n"),
    "nested in an answer": _written(
        lambda line: line[:-2] + b', "more": ' + b"[" * 900 + b"]" * 900 + b"}\n"
    ),
    "a number of 5000 digits": _written(lambda line: line[:-2] + b', "id": ' + b"9" * 5000 + b"}\n"),
    "a key twice": _written(lambda line: line[:-2] + b', "id": 77}\n'),
    "a text without end": _written(lambda line: line[:-2] + b', "message": "' + b"m" * 3_000_000 + b'"}\n'),
    "a flood": _flood,
    "late": _sleep,
    "killed": _killed(signal.SIGKILL),
    "segfault": _killed(signal.SIGSEGV),
    "stopped": _killed(signal.SIGSTOP),
    "status 70": lambda _out, _line: os._exit(70),
    "closed": lambda _out, _line: os.closerange(0, 64),
}


def main() -> None:
    """Serve standard input, with wrong replies to one kind of request per process."""
    dice = random.Random(sys.argv[1])
    aim = dice.choice(
        ["announcement", "announcement", "record", "record", "record", "stable-step", "prepare", "lap"]
    )
    way = dice.choice(["value", "value", "value", "values", "bytes", "raw"])
    adapter = Misbehaving(sound=True)
    adapter.name = "liar"
    adapter.methods = {METHOD: adapter.methods[METHOD]}
    out, desk = os.fdopen(os.dup(1), "wb"), RequestHandler(adapter)
    os.dup2(2, 1)
    announcement = protocol.announcement(adapter, Build())
    _say(out, announcement, dice, way if aim == "announcement" else None)
    for line in sys.stdin.buffer:
        request = protocol.message_of(line)
        _say(out, desk.answer(request), dice, way if aim == request.get("do") else None)


def _say(out: BinaryIO, message: dict[str, Any], dice: random.Random, way: str | None) -> None:
    line = _line(message)
    if way == "raw":
        RAW[dice.choice(sorted(RAW))](out, line)
    elif way == "bytes":
        out.write(any_bytes(line[:-1], dice).replace(b"\n", b" ") + b"\n")
    else:
        for _ in range({"value": 1, "values": 4}.get(way or "", 0)):
            message = changed(message, dice)
        out.write(_line(message))
    out.flush()


if __name__ == "__main__":
    main()
