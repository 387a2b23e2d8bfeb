"""Find the baseline runs of a nightly run: same machine class, undamaged, not dated in the future."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from io import BufferedReader
from pathlib import Path
from typing import Any, cast

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import escaped, from_outside, open_input, read_json
from bodycheck.reports.comparison.environment_diff import redefined
from bodycheck.reports.history.archive import TRAJECTORIES, History
from bodycheck.reports.history.levels import Levels, read_levels
from bodycheck.reports.history.open_regressions import NightlyState, read_state
from bodycheck.reports.history.step_detection import FIRST_RUNS
from bodycheck.reports.run_files.run_reader import read_manifest, read_tables
from bodycheck.reports.run_files.run_tables import Tables


def machine_class(manifest: Mapping[str, Any]) -> str:
    """Return processor, cores, system and architecture, which two nightly runs must share to be compared.

    Versions of the system, of Python and of libraries are not part of it: their effect should be visible.
    """
    return f"{manifest['cpu']}, {manifest['cores']} cores, {manifest['system']}"


SUMMARY_FILE = "night.json"
NOT_JUDGED = "not judged"
"""The status of a run whose judgement failed."""

_SUMS, _SEAL = "sha256", "seal"


def seal_run(folder: Path) -> None:
    """Add the SHA-256 sums of all files of a nightly run, and a seal, to its night.json."""
    path = folder / SUMMARY_FILE
    summary = json.loads(path.read_bytes())
    files = (file for file in sorted(folder.rglob("*")) if file.is_file() and file != path)
    names = ((file, file.relative_to(folder).as_posix()) for file in files)
    # trajectories are removed later, and each is checked against its row when it is read
    summary[_SUMS] = {name: _sum(file) for file, name in names if not name.startswith(f"{TRAJECTORIES}/")}
    summary[_SEAL] = _seal(summary)
    path.write_bytes(f"{json.dumps(summary, indent=2)}\n".encode())


def read_summary_file(folder: Path) -> dict[str, Any]:
    """Read night.json of a nightly run; raise InputError if it is unreadable or was changed."""
    path = folder / SUMMARY_FILE
    try:
        summary = read_json(path, escape=False)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not isinstance(summary, dict):
        raise InputError(f"{path}: is damaged: must be a JSON object")
    if summary.get(_SEAL) != _seal(summary):
        raise InputError(f"{path}: is damaged: changed after it was written")
    return {name: value for name, value in escaped(summary).items() if name != _SEAL}


def check_files(folder: Path, summary: dict[str, Any], names: Iterable[str] | None = None) -> None:
    """Raise InputError, naming the file, if a file of a nightly run was changed after it was written.

    summary: the content of its night.json. names: the files to check [default: all].
    """
    sums = summary[_SUMS]
    for name in sums if names is None else names:
        path = folder / name
        try:
            found = _sum(path)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
        if found != sums.get(name):
            raise InputError(f"{path}: is damaged: changed after it was written")


def _sum(path: Path) -> str:
    with open_input(path) as file:
        return hashlib.file_digest(cast(BufferedReader, file), "sha256").hexdigest()


def _seal(summary: dict[str, Any]) -> str:
    content = {name: value for name, value in summary.items() if name != _SEAL}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


_MAX_RUNS = 60
"""How many baseline runs are used at most."""

_COUNTS = ("worse", "missing", "improved", "moved", "new", "open")
SUMMARY_KEYS = ("run_id", "status", *_COUNTS, "cases", "engines", "machine")
"""The keys of night.json, in the order in which they are listed."""
_NEEDED = (*(name for name in SUMMARY_KEYS if name not in _COUNTS[1:]), _SUMS)
_FORMER_COUNTS = {"improved": "better", "moved": "other"}


@dataclass(frozen=True, eq=False)
class NightlyRun:
    """A stored nightly run: its folder, its manifest, and its report in night.json."""

    folder: Path
    manifest: dict[str, Any]
    summary: dict[str, Any]

    @property
    def name(self) -> str:
        """The run id."""
        return self.folder.name

    @cached_property
    def tables(self) -> Tables:
        """The tables of the run; InputError if they are damaged."""
        return read_tables(self.folder)

    @cached_property
    def levels(self) -> Levels:
        """The accepted levels after the run; InputError if they are damaged."""
        return read_levels(self.folder, self.tables)

    @property
    def state(self) -> NightlyState:
        """What is open after the run; InputError if it is damaged."""
        return read_state(self.folder)

    def same_scenarios(self, manifest: Mapping[str, Any]) -> set[str]:
        """Return the scenarios whose definitions are the same as in another run."""
        return self.manifest["scenarios"].keys() - set(redefined(self.manifest, manifest))


@dataclass(frozen=True)
class Baseline:
    """The baseline runs on one machine class, the newest first, and why others were left out.

    other: the newest run on another class of machines, if there is none on this one. first: the oldest runs,
    oldest first, from whose speeds a method may have crept away; empty while `runs` has them.
    """

    runs: tuple[NightlyRun, ...]
    left_out: tuple[str, ...]
    other: NightlyRun | None = None
    first: tuple[NightlyRun, ...] = ()


def baseline_of(history: History, manifest: Mapping[str, Any]) -> Baseline:
    """Return the baseline runs of a run, given by its manifest: earlier ones on the same machine class.

    A damaged run is left out: it must neither count nor prevent the new run from being stored. So is one that
    was not judged, because its changes were never reported.
    """
    runs: list[NightlyRun] = []
    others: list[NightlyRun] = []
    left_out: list[str] = []
    future = history.dated_in_future(manifest["run_id"])
    left_out += [f"{folder}: is dated in the future" for folder in future]
    for folder in reversed(history.runs()[: -len(future) or None]):
        try:
            with from_outside(folder):
                run = NightlyRun(folder, read_manifest(folder), read_summary(folder))
                if machine_class(run.manifest) != machine_class(manifest):
                    others.append(run)
                    continue
                _check(run, complete=not runs)
                runs.append(run)
        except InputError as error:
            left_out.append(str(error))
        if len(runs) == _MAX_RUNS:
            break
    other = None
    while not runs and others and other is None:
        run = others.pop(0)
        try:
            _check(run, complete=True)
            other = run
        except InputError as error:
            left_out.append(str(error))
    first: list[NightlyRun] = []
    for folder in history.runs() if len(runs) == _MAX_RUNS else ():
        if folder == runs[-1].folder or len(first) == FIRST_RUNS:
            break
        try:
            with from_outside(folder):
                run = NightlyRun(folder, read_manifest(folder), read_summary(folder))
                if machine_class(run.manifest) == machine_class(manifest):
                    _check(run, complete=False)
                    first.append(run)
        except InputError as error:
            left_out.append(str(error))
    return Baseline(tuple(runs), tuple(left_out), other, tuple(first))


def _check(run: NightlyRun, *, complete: bool) -> None:
    """Raise InputError if a run cannot be a baseline; complete: all its tables will be compared."""
    if run.summary["status"] == NOT_JUDGED:
        raise InputError(f"{run.folder}: was not judged")
    check_files(run.folder, run.summary)
    if complete:
        _ = run.levels, run.state


def readable_runs(runs: Sequence[Path], tables: Sequence[str] = ()) -> tuple[list[Path], list[str]]:
    """Return the readable nightly runs, and for each other one its damaged file and the fault.

    runs: their folders. tables: names of tables whose files are checked too, where a run has them. Raises
    InputError if none is readable.
    """
    readable: list[Path] = []
    left_out: list[str] = []
    for folder in runs:
        try:
            with from_outside(folder):
                summary = read_summary(folder)
                files = [f"{table}.csv" for table in tables]
                check_files(folder, summary, [file for file in files if file in summary[_SUMS]])
                readable.append(folder)
        except InputError as error:
            left_out.append(str(error))
    if not readable:
        raise InputError("\n".join(left_out))
    return readable, left_out


def read_summary(folder: Path) -> dict[str, Any]:
    """Return night.json of a nightly run: status and counts of changes; InputError if it is unreadable."""
    path, summary = folder / SUMMARY_FILE, read_summary_file(folder)
    if missing := [name for name in _NEEDED if name not in summary]:
        raise InputError(f"{path}: is damaged: missing key {missing[0]}")
    if invalid := [name for name in SUMMARY_KEYS if isinstance(summary.get(name), list | dict)]:
        raise InputError(f"{path}: is damaged: {invalid[0]} must be text or a number")
    if not isinstance(summary[_SUMS], dict):
        raise InputError(f"{path}: is damaged: {_SUMS} must be a JSON object")
    return {**{name: summary.get(_FORMER_COUNTS.get(name, name), 0) for name in _COUNTS}, **summary}
