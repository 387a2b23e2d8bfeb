"""The nights that tonight can be compared with: of the same machine class, and whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bodycheck.errors import InputError
from bodycheck.outside import from_outside
from bodycheck.reports.comparison.circumstances import redefined
from bodycheck.reports.history.accepted import read_accepted
from bodycheck.reports.history.machine_class import machine_class
from bodycheck.reports.history.nights import History
from bodycheck.reports.history.sums import NIGHT_FILE, check_files, read_night_file
from bodycheck.reports.stored import Tables, read_manifest, read_tables

_MOST_NIGHTS = 60
"""How far back speeds are looked at, and a case that did not end well for a while."""

_COUNTS = ("worse", "missing", "improved", "moved", "new")
TOLD = ("run_id", "status", *_COUNTS, "cases", "engines", "machine")
"""What night.json says of a night, in the order in which it is listed."""
_NEEDED = tuple(name for name in TOLD if name not in _COUNTS[1:])
_FORMER_COUNTS = {"improved": "better", "moved": "other"}


@dataclass(frozen=True, eq=False)
class Night:
    """An earlier nightly run: its folder, its tables, and what was reported about it."""

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

    @property
    def accepted(self) -> Tables:
        """The accepted levels after it; InputError where they are damaged."""
        return read_accepted(self.folder, self.tables)

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
    coming = history.dated_in_future(manifest["run_id"])
    left_out += [f"{folder}: is dated in the future" for folder in coming]
    for folder in reversed(history.nights()[: -len(coming) or None]):
        try:
            with from_outside(folder):
                night = Night(folder, read_manifest(folder), told_of(folder))
                if machine_class(night.manifest) == machine_class(manifest):
                    check_files(folder, night.told)
                    _ = nights or night.accepted  # the newest is compared in full
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
            with from_outside(folder):
                told = told_of(folder)
                check_files(folder, told, [f"{table}.parquet" for table in tables])
                readable.append(folder)
        except InputError as error:
            left_out.append(str(error))
    if not readable:
        raise InputError("\n".join(left_out))
    return readable, left_out


def told_of(folder: Path) -> dict[str, Any]:
    """Return night.json of a night: status, and how much changed; InputError where it cannot be read."""
    path, told = folder / NIGHT_FILE, read_night_file(folder)
    if lacking := [name for name in _NEEDED if not isinstance(told, dict) or name not in told]:
        raise InputError(f"{path}: is damaged: it has no {lacking[0]}")
    if strange := [name for name in TOLD if isinstance(told.get(name), list | dict)]:
        raise InputError(f"{path}: is damaged: {strange[0]} is neither text nor a number")
    return {**{name: told.get(_FORMER_COUNTS.get(name, name), 0) for name in _COUNTS}, **told}
