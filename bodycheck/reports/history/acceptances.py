"""Accepted deteriorations: which values, why, by whom and when; each can be withdrawn."""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from getpass import getuser
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck._util.formatting import count
from bodycheck._util.untrusted import from_outside, read_json
from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import unversioned
from bodycheck.reports.document import json_text
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import machine_class, readable_runs
from bodycheck.reports.history.levels import Levels, LevelSource, read_levels
from bodycheck.reports.history.open_regressions import (
    NightlyState,
    Regression,
    open_lines,
    read_state,
)
from bodycheck.reports.run_files.run_reader import read_manifest, read_tables
from bodycheck.scenarios.reader import fault_lines

FILE = "acceptances.json"
"""The file in the folder of a history with all acceptances, withdrawn ones included."""


@dataclass(frozen=True)
class Accepted:
    """One accepted value: its change, and the cells of its level before and after the acceptance."""

    change: Change
    before: dict[str, Any]
    after: dict[str, Any]
    previous: LevelSource


@dataclass(frozen=True)
class Acceptance:
    """Deteriorations of one nightly run, accepted together.

    run_id: the nightly run whose values are accepted. machine: its class of machines. date, withdrawn: ISO
    8601; withdrawn: "" if it counts.
    """

    id: str
    date: str
    author: str
    reason: str
    run_id: str
    machine: str
    values: tuple[Accepted, ...]
    withdrawn: str = ""


@cache
def _adapter() -> TypeAdapter[tuple[Acceptance, ...]]:
    return TypeAdapter(tuple[Acceptance, ...])


def read_acceptances(history: History) -> tuple[Acceptance, ...]:
    """Return all acceptances of a history, the oldest first; raises InputError if the file is damaged."""
    path = history.folder / FILE
    try:
        return _adapter().validate_python(read_json(path))
    except FileNotFoundError:
        return ()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        raise InputError(f"{path}: is damaged: {fault_lines(error)[0]}") from None


def with_acceptances(
    levels: Levels, state: NightlyState, acceptances: Iterable[Acceptance]
) -> tuple[Levels, NightlyState]:
    """Return the levels and what is open, after the acceptances and withdrawals since the last nightly run.

    An acceptance that was withdrawn returns its values to the levels before it, unless they have changed
    since.
    """
    included = list(state.acceptances)
    for one in acceptances:
        if one.id in included and one.withdrawn:
            included.remove(one.id)
            for value in one.values:
                setting = levels.settings.get(value.change.key)
                if setting is not None and setting.acceptance == one.id:
                    undone = LevelSource(value.previous.run_id, "withdrawn", one.id)
                    levels = levels.with_cells(value.change, value.before, undone)
        elif one.id not in included and not one.withdrawn:
            included.append(one.id)
            for value in one.values:
                levels = levels.with_cells(
                    value.change, value.after, LevelSource(one.run_id, "accepted", one.id)
                )
            accepted = {value.change.key for value in one.values}
            state = replace(
                state,
                regressions=tuple(open_ for open_ in state.regressions if open_.change.key not in accepted),
            )
    return levels, replace(state, acceptances=tuple(included))


def open_runs(history: History) -> dict[Path, NightlyState]:
    """Return what is open in the newest readable nightly run of each class of machines, the newest first."""
    found: dict[str, tuple[Path, NightlyState]] = {}
    future = history.dated_in_future()
    readable, _ = readable_runs([run for run in history.runs() if run not in future])
    acceptances = read_acceptances(history)
    for folder in reversed(readable):
        with from_outside(folder):
            machine = machine_class(read_manifest(folder))
            if machine not in found:
                mine = [one for one in acceptances if one.machine == machine]
                state = read_state(folder)
                found[machine] = folder, with_acceptances(Levels(), state, mine)[1]
    return dict(found.values())


def accept(
    history: History, *, run_id: str | None, ids: Sequence[str], reason: str, author: str | None
) -> list[Acceptance]:
    """Accept open regressions, and return one acceptance per class of machines.

    run_id: accept what is open after this nightly run; None: of the newest ones. ids: of changes; empty: all.
    The next nightly run compares with the accepted values. Raises InputError if nothing is accepted.
    """
    if not reason.strip():
        raise InputError("--reason: must say why")
    with history.locked():
        found = [
            _acceptance(folder, regressions, reason.strip(), author or _author())
            for folder, regressions in _accepted_regressions(history, run_id, ids)
        ]
        _write(history, (*read_acceptances(history), *found))
    return found


def _accepted_regressions(
    history: History, run_id: str | None, ids: Sequence[str]
) -> list[tuple[Path, list[Regression]]]:
    """Return the regressions with these ids, of changes or of lines, each with the run that measured it."""
    folder = None if run_id is None else _run(history, run_id)
    newest = open_runs(history)
    by_id = {run: _by_id(state) for run, state in newest.items()}
    for one in ids:
        if not any(one in known for known in by_id.values()):
            lines = [line.id for state in newest.values() for line in open_lines(state.regressions)]
            raise InputError(f"--change {one}: is not open (open: {', '.join(lines) or 'none'})")
    found = []
    for run, known in by_id.items():
        wanted = {one.id: one for name in (ids or known) for one in known.get(name, ())}
        if folder is not None:
            if machine_class(read_manifest(folder)) != machine_class(read_manifest(run)):
                continue
            run, then = folder, {one.id: one for one in read_state(folder).regressions}
            wanted = {name: then[name] for name in wanted if name in then}
        if wanted:
            found.append((run, list(wanted.values())))
    if not found:
        raise InputError(f"{history.folder}: no open regression" + (f" of {run_id}" if run_id else ""))
    return found


def _by_id(state: NightlyState) -> dict[str, Sequence[Regression]]:
    lines: dict[str, tuple[Regression, ...]] = {}
    for line in open_lines(state.regressions):  # a map may have changed with an error: one id for both
        lines[line.id] = (*lines.get(line.id, ()), *line.regressions)
    return {**{one.id: (one,) for one in state.regressions}, **lines}


def _run(history: History, run_id: str) -> Path:
    """Return the folder of a nightly run, given by its run id or by the unique beginning of one."""
    found = [run for run in history.runs() if run.name.startswith(run_id)]
    if len(found) != 1:
        fault = f"{len(found)} nightly runs begin with it" if found else "no such nightly run"
        raise InputError(f"--run {run_id}: {fault}; `bodycheck history list {history.folder}` lists them")
    return found[0]


def _acceptance(folder: Path, regressions: Iterable[Regression], reason: str, author: str) -> Acceptance:
    """Accept regressions of a nightly run, with its values and the levels before.

    What it could not measure keeps its level, so that it counts again if it comes back as it was.
    """
    tables = read_tables(folder)
    levels, own = read_levels(folder, tables), Levels.of(tables)
    names = unversioned((*tables.manifest["engines"], *levels.engines))
    levels, own = levels.renamed(names), own.renamed(names)
    values = []
    for one in regressions:
        previous = levels.setting(one.change) or LevelSource(tables.run_id, "first value")
        before = dict(levels.cells(one.change))
        after = dict(own.cells(one.change)) if one.measured else before
        values.append(Accepted(one.change, before, after, previous))
    return Acceptance(
        id=secrets.token_hex(4),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        author=author,
        reason=reason,
        run_id=tables.run_id,
        machine=machine_class(tables.manifest),
        values=tuple(values),
    )


def withdraw(history: History, acceptance: str) -> Acceptance:
    """Withdraw an acceptance: the next nightly run compares with the levels before it.

    Raises InputError if there is no such acceptance or it was withdrawn before.
    """
    with history.locked():
        known = read_acceptances(history)
        found = next((one for one in known if one.id == acceptance and not one.withdrawn), None)
        if found is None:
            counting = ", ".join(one.id for one in known if not one.withdrawn) or "none"
            raise InputError(f"{acceptance}: no such acceptance (available: {counting})")
        withdrawn = replace(found, withdrawn=datetime.now(UTC).isoformat(timespec="seconds"))
        _write(history, tuple(withdrawn if one is found else one for one in known))
    return withdrawn


def _write(history: History, acceptances: tuple[Acceptance, ...]) -> None:
    write_file(history.folder / FILE, (json_text(acceptances) + "\n").encode())


def _author() -> str:
    with suppress(KeyError, OSError, ImportError):
        return getuser()
    return "unknown"


def acceptance_text(one: Acceptance) -> str:
    """Return what was accepted, when, by whom and why, in one line."""
    which = ", ".join(dict.fromkeys(f"{v.change.engine}:{v.change.method}" for v in one.values))
    what = f"{count(len(one.values), 'value')} of {which} in {one.run_id}"
    withdrawn = f" (withdrawn on {one.withdrawn[:10]})" if one.withdrawn else ""
    return f"{one.id}: {what}, accepted on {one.date[:10]} by {one.author}: {one.reason}{withdrawn}"
