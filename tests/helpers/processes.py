"""Who is still alive of the workers of a run, and of what they started."""

from __future__ import annotations

import time
from pathlib import Path

from bodycheck.adapters.workers.worker import RUN_PID


def workers_of(run: int) -> set[int]:
    """Return the processes, but zombies, whose environment names the run of that process id as theirs."""
    mark = f"{RUN_PID}={run}".encode()
    found = set()
    for place in Path("/proc").iterdir():
        if place.name.isdigit():
            try:
                environment = (place / "environ").read_bytes()
            except OSError:
                continue
            if mark in environment.split(b"\0"):
                found.add(int(place.name))
    return found


def all_gone(run: int, within_s: float = 20.0) -> bool:
    """Whether no worker of a run is left, now or within a while: the system may take its time to end one."""
    end = time.monotonic() + within_s
    while workers_of(run):
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
