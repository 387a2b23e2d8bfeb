"""A function in a forked child process: its result, its time and its memory."""

from __future__ import annotations

import gc
import math
import os
import pickle
import resource
import signal
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_MEGABYTE = 1 << 20


@dataclass(frozen=True)
class ChildResult:
    """The outcome of a child; value: what the function returned; error: its traceback, or how it ended.

    megabytes: the largest resident size, including what the child shares with this process. growth_megabytes:
    the same without what it began with; NaN if it was killed.
    """

    value: Any
    error: str | None
    seconds: float
    megabytes: float
    growth_megabytes: float = math.nan


def run_in_child(act: Callable[[], Any], limit_s: float, limit_megabytes: int = 4096) -> ChildResult:
    """Run a function in a child, which is killed after a time limit and has limited memory."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "ended")
        gc.collect()  # a child needs room for all that its parent holds
        child = os.fork()
        if child == 0:
            _carry_out(act, place, limit_megabytes)
        status, usage, late = _waited(child, begin + limit_s)
        seconds, megabytes = time.monotonic() - begin, usage.ru_maxrss / 1024.0
        if late:
            return ChildResult(None, f"hang: not ended within {limit_s:g} s", seconds, megabytes)
        try:
            value, error, began = pickle.loads(place.read_bytes())
        except (OSError, EOFError, pickle.UnpicklingError):
            return ChildResult(None, f"ended with the wait status {status}", seconds, megabytes)
        return ChildResult(value, error, seconds, megabytes, megabytes - began)


def _carry_out(act: Callable[[], Any], place: Path, limit_megabytes: int) -> None:
    """Run the function in the child, which never returns."""
    try:
        os.setpgid(0, 0)
        began = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / _MEGABYTE
        resource.setrlimit(resource.RLIMIT_DATA, (limit_megabytes * _MEGABYTE,) * 2)
        try:
            ended: tuple[Any, str | None] = (act(), None)
        except BaseException:  # noqa: BLE001 - any exception is a result
            ended = (None, traceback.format_exc())
        place.write_bytes(pickle.dumps((*ended, began)))
    finally:
        os._exit(0)


def _waited(child: int, end: float) -> tuple[int, resource.struct_rusage, bool]:
    """Wait for the child; kill it with its descendants at the time limit."""
    pause = 0.001
    while True:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage, False
        if time.monotonic() > end:
            os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return status, usage, True
        time.sleep(pause)
        pause = min(2.0 * pause, 0.05)
