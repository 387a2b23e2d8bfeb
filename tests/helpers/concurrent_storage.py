"""Nightly runs stored by separate processes, which import these functions by name."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from bodycheck.reports.history.archive import History


def name(number: int) -> str:
    """Return the name of a run."""
    return f"20260101T{number:06d}Z-{number:06x}"


def write(folder: Path, number: int) -> None:
    """Store a nightly run of two files."""
    with History.at(folder).new_run(name(number)) as night:
        (night / "results.csv").write_text(f"{number}\n")
        (night / "manifest.json").write_text("{}")


def write_some(folder: Path, numbers: range) -> None:
    """Store nightly runs one after the other."""
    for number in numbers:
        write(folder, number)


def write_and_die(folder: Path, number: int) -> None:
    """Start to store a nightly run, and kill this process half-way."""
    with History.at(folder).new_run(name(number)) as night:
        (night / "results.csv").write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
