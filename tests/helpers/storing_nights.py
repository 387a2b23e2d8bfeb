"""Nights that processes of their own store, which find these functions here by name."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from bodycheck.reports.history.archive import History


def name(number: int) -> str:
    """Return the name of a run."""
    return f"20260101T{number:06d}Z-{number:06x}"


def write(folder: Path, number: int) -> None:
    """Store a night of two files."""
    with History.at(folder).new_night(name(number)) as night:
        (night / "results.csv").write_text(f"{number}\n")
        (night / "manifest.json").write_text("{}")


def write_some(folder: Path, numbers: range) -> None:
    """Store some nights, one after the other."""
    for number in numbers:
        write(folder, number)


def write_and_die(folder: Path, number: int) -> None:
    """Begin a night, and be killed half-way."""
    with History.at(folder).new_night(name(number)) as night:
        (night / "results.csv").write_text("half")
        os.kill(os.getpid(), signal.SIGKILL)
