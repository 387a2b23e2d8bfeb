"""Worker processes of a run, and their descendants, that are still alive."""

from __future__ import annotations

import time
from pathlib import Path

from bodycheck.adapters.workers.launcher import RUN_PID


def workers_of(run: int) -> set[int]:
    """Return the processes, except zombies, whose environment names a run by its process id."""
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
    """Return whether no worker of a run is left, now or within a time limit."""
    end = time.monotonic() + within_s
    while workers_of(run):
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
