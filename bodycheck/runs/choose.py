"""Choose a run: the named one, or else the newest stored one with the scenarios, or else a new one."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.reports.run_files.run_reader import Tables, read_manifest, read_tables
from bodycheck.runs.directory import RUNS, RunRequest, run_to_folder
from bodycheck.runs.run_options import ProgressFactory
from bodycheck.scenarios.library import load_scenarios
from bodycheck.scenarios.serialization import serialized


def chosen_run(
    folder: Path | None,
    requested: Sequence[str],
    *,
    allow_code: bool,
    make_progress: ProgressFactory,
) -> tuple[Path, Tables, list[str]]:
    """Return a run's folder, its tables, and the names of the requested scenarios [default: all of the run].

    Without a folder, take the newest run under bodycheck-runs/ that has exactly these scenarios, or an older
    one that has all its methods and more; if there is none, run them. allow_code: scenarios may name
    functions, whose code runs. Raises InputError if the folder is not that of a run or lacks a scenario.
    """
    if folder is not None:
        return _named(folder, requested, allow_code=allow_code)
    loaded = load_scenarios(requested, allow_code=allow_code)
    scenarios_written = {scenario.name: serialized(scenario) for _, scenario in loaded}
    # a user's function may have changed under the same name, so no stored run is known to match
    own_code = any(scenario.scene.has_callback_load for _, scenario in loaded)
    stored = [] if own_code else _newest_first()
    complete = [
        (path, manifest)
        for path, manifest in stored
        if scenarios_written.items() <= manifest["scenarios"].items()
    ]
    for path, manifest in _most_complete_first(complete):
        try:
            return path, read_tables(path), list(scenarios_written or manifest["scenarios"])
        except InputError as error:
            _warn_left_out(error)
    scenarios = list(requested) or ["standard"]
    print(f"no stored run in {RUNS}/ has these scenarios; running {' '.join(scenarios)}", file=sys.stderr)
    _, report = run_to_folder(RunRequest(scenarios=scenarios, allow_code=allow_code), None, make_progress)
    return _named(report.parent, requested, allow_code=allow_code)


def _named(folder: Path, requested: Sequence[str], *, allow_code: bool) -> tuple[Path, Tables, list[str]]:
    tables = read_tables(folder)
    known = list(tables.manifest["scenarios"])
    names: list[str] = []
    for name in requested:
        loaded = [] if name in known else load_scenarios([name], allow_code=allow_code)
        names += [scenario.name for _, scenario in loaded] or [name]
    if missing := [name for name in names if name not in known]:
        raise InputError(f"{folder}: has no scenario {', '.join(missing)}{suggestion(missing[0], known)}")
    return folder, tables, list(dict.fromkeys(names)) or known


def _most_complete_first(
    runs: Sequence[tuple[Path, dict[str, Any]]],
) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield runs, newest first, but each after the newest older one that has all its methods and more.

    A run of one case, to confirm an answer, must not replace the run that the answer came from.
    """
    for index, (path, manifest) in enumerate(runs):
        more_complete = (run for run in runs[index + 1 :] if _methods(run[1]) > _methods(manifest))
        yield from islice(more_complete, 1)
        yield path, manifest


def _methods(manifest: dict[str, Any]) -> set[tuple[str, str | None, str]]:
    return {
        (engine, entry.get("version"), method)
        for engine, entry in manifest["engines"].items()
        for method in entry.get("methods", ())
    }


def _newest_first() -> list[tuple[Path, dict[str, Any]]]:
    """Return the folders and manifests of complete runs in bodycheck-runs/; warn about damaged runs."""
    found = []
    for path in RUNS.glob("*/manifest.json"):
        try:
            found.append((path.parent, read_manifest(path.parent)))
        except InputError as error:
            _warn_left_out(error)
    return sorted(found, key=lambda run: (run[1]["created"], run[0]), reverse=True)


def _warn_left_out(error: InputError) -> None:
    print(f"warning: a damaged run is ignored: {error}", file=sys.stderr)
