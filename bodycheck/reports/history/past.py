"""The nights that tonight can be compared with: of the same machine class, and whole."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bodycheck.errors import InputError
from bodycheck.reports.comparison.circumstances import redefined
from bodycheck.reports.history.machine_class import machine_class
from bodycheck.reports.history.nights import History
from bodycheck.reports.stored import Tables, read_manifest, read_tables

_MOST_NIGHTS = 60
"""How far back speeds are looked at, and a case that did not end well for a while."""
_PARQUET = b"PAR1"  # a whole file begins and ends with it

TOLD = ("run_id", "status", "worse", "better", "other", "cases", "engines", "machine")
"""What night.json has to say of a night, in the order in which it is listed."""


@dataclass(frozen=True, eq=False)
class Night:
    """A night of the past: where it is, what it found, and what was told of it."""

    folder: Path
    manifest: dict[str, Any]
    told: dict[str, Any]

    @property
    def name(self) -> str:
        """The run's name."""
        return self.folder.name

    @property
    def tables(self) -> Tables:
        """What it found; InputError where that is damaged."""
        return read_tables(self.folder)

    def same_scenarios(self, manifest: Mapping[str, Any]) -> set[str]:
        """Return the scenarios that are what another run means by their names."""
        return self.manifest["scenarios"].keys() - set(redefined(self.manifest, manifest))


@dataclass(frozen=True)
class Past:
    """The nights of a machine class, the newest first, and why others were left out."""

    nights: tuple[Night, ...]
    left_out: tuple[str, ...]


def past_of(history: History, manifest: Mapping[str, Any]) -> Past:
    """Return the nights before a run, given by its manifest, on machines like its own.

    A night that is damaged is left out: it must neither count nor keep tonight from being stored.
    """
    nights: list[Night] = []
    left_out: list[str] = []
    for folder in reversed(history.nights()):
        try:
            night = Night(folder, read_manifest(folder), told_of(folder))
            if machine_class(night.manifest) == machine_class(manifest):
                _check_parquet(folder / "results.parquet")
                _ = nights or night.tables  # the newest is compared in full
                nights.append(night)
        except InputError as error:
            left_out.append(str(error))
        if len(nights) == _MOST_NIGHTS:
            break
    return Past(tuple(nights), tuple(left_out))


def readable_nights(nights: Sequence[Path], tables: Sequence[str] = ()) -> tuple[list[Path], list[str]]:
    """Return the nights that can be read, and of each other which file is damaged, and how.

    nights: their folders. tables: of which the Parquet files are looked at too. Raises InputError where none
    can be read.
    """
    readable: list[Path] = []
    left_out: list[str] = []
    for folder in nights:
        try:
            told_of(folder)
            for table in tables:
                _check_parquet(folder / f"{table}.parquet")
            readable.append(folder)
        except InputError as error:
            left_out.append(str(error))
    if not readable:
        raise InputError("\n".join(left_out))
    return readable, left_out


def told_of(folder: Path) -> dict[str, Any]:
    """Return night.json of a night: status, and how much changed; InputError where it cannot be read."""
    path = folder / "night.json"
    try:
        told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path}: is damaged: {error}") from None
    if lacking := [name for name in TOLD if not isinstance(told, dict) or name not in told]:
        raise InputError(f"{path}: is damaged: it has no {lacking[0]}")
    return told


def _check_parquet(path: Path) -> None:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not (len(content) > 2 * len(_PARQUET) and content.startswith(_PARQUET) and content.endswith(_PARQUET)):
        raise InputError(f"{path}: is damaged")
