"""A run that leaves a folder: what it finds is on disk at once, and a run that was stopped can go on."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated

from pydantic import (
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Field,
    StrictBool,
    StrictFloat,
    StrictInt,
    StrictStr,
    ValidationError,
)

from bodycheck._util.errors import InputError, StoppedError
from bodycheck._util.files import atomic_write
from bodycheck._util.untrusted import quoted, read_json
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.cache.reuse import reuse_of
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.writer import check_output, write_files
from bodycheck.runs.manifest import Identity
from bodycheck.runs.run_options import TIMEOUT_S, ProgressFactory, RunOptions
from bodycheck.runs.runner import run_selection
from bodycheck.runs.selection import Selection, select
from bodycheck.scenarios.reader import fault_lines

RUNS = Path("bodycheck-runs")
"""Where runs go for which no other folder is named."""

_REQUEST = "request.json"


@dataclass(frozen=True)
class RunRequest:
    """What was asked of a run, as plain data: enough to ask it again."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    scenarios: list[StrictStr] = field(default_factory=lambda: ["standard"])
    engines: list[StrictStr] | None = None
    dt_s: list[StrictFloat] | None = None
    tolerances: list[StrictFloat] | None = None
    speed: StrictBool = True
    jobs: StrictInt | None = None
    timeout_s: StrictFloat = TIMEOUT_S
    fresh: StrictBool | None = None
    allow_code: StrictBool = False

    @property
    def selection(self) -> Selection:
        """The same, resolved and checked; InputError where it is wrong."""
        return select(self.scenarios, self.engines, self.dt_s, self.tolerances, allow_code=self.allow_code)

    @property
    def options(self) -> RunOptions:
        """How the run is made; InputError where that is wrong."""
        reuse = reuse_of(self.fresh, "installed")
        return RunOptions(speed=self.speed, jobs=self.jobs, timeout_s=self.timeout_s, reuse=reuse)


class _Description(BaseModel):
    """What request.json holds; a run's name is part of the names of files."""

    run_id: Annotated[str, Field(strict=True, pattern=r"^[0-9A-Za-z-]{1,100}$")]
    created: AwareDatetime
    asked: RunRequest


def run_to_folder(asked: RunRequest, out: Path | None, watching: ProgressFactory) -> tuple[Run, Path]:
    """Run what is asked and write it to `out`; return the run and its report's path.

    Until all is done the folder is `out` with .partial after its name. Raises InputError where something is
    wrong or the disk is full, StoppedError where the user stops it: then `resume` goes on.
    """
    identity = Identity.new()
    out = out or RUNS / identity.run_id
    options = asked.options
    check_output(out)
    partial = partial_of(out)
    if (partial / _REQUEST).exists():
        raise InputError(f"{partial}: is of a run that was stopped: go on with --resume {out}, or remove it")
    try:
        selection = asked.selection
    except KeyboardInterrupt:
        raise StoppedError("stopped, before anything was measured") from None
    _describe(partial, asked, identity, out)
    return _carried_out(selection, options, identity, out, watching)


def _describe(partial: Path, asked: RunRequest, identity: Identity, out: Path) -> None:
    """Write down what was asked, whole or not at all: a folder without it is of no run."""
    description = {
        "run_id": identity.run_id,
        "created": identity.created.isoformat(),
        "asked": asdict(asked),
    }
    try:
        partial.mkdir(parents=True, exist_ok=True)
        try:
            atomic_write(partial / _REQUEST, (json.dumps(description, indent=2) + "\n").encode())
        except OSError:
            shutil.rmtree(partial, ignore_errors=True)
            raise
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None


def resume(out: Path, watching: ProgressFactory) -> tuple[Run, Path]:
    """Go on with a run that was stopped, as it was asked; nothing that it found is asked for again.

    Raises InputError where there is none, and as run_to_folder does.
    """
    partial = partial_of(out)
    try:
        asked, identity = _description(partial / _REQUEST)
    except FileNotFoundError:
        state = "that run is complete" if _run_id(out) else "no run was stopped there"
        raise InputError(f"--resume {out}: {state}") from None
    except InputError as error:
        raise InputError(f"--resume {out}: {error}") from None
    if _run_id(out) == identity.run_id:  # stopped between its last two strokes
        shutil.rmtree(partial, ignore_errors=True)
        raise InputError(f"--resume {out}: that run is complete")
    try:
        selection = asked.selection
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; {_go_on(out)}") from None
    return _carried_out(selection, asked.options, identity, out, watching)


def _description(path: Path) -> tuple[RunRequest, Identity]:
    """Read what was asked of a run; FileNotFoundError where nothing was, InputError where it is damaged."""
    try:
        told = _Description.model_validate(read_json(path, escape=False))
    except ValidationError as error:
        raise InputError("\n".join(f"{path}: {line}" for line in fault_lines(error))) from None
    return told.asked, Identity(told.run_id, told.created)


def _run_id(out: Path) -> str | None:
    """Return the name of the run whose results are there, if there are any."""
    try:
        manifest = read_json(out / "manifest.json")
    except (OSError, InputError):
        return None
    return str(manifest["run_id"]) if isinstance(manifest, dict) and "run_id" in manifest else None


def partial_of(out: Path) -> Path:
    """Return the folder of a run that is not yet complete."""
    return out.with_name(f"{out.name}.partial")


def _carried_out(
    selection: Selection, options: RunOptions, identity: Identity, out: Path, watching: ProgressFactory
) -> tuple[Run, Path]:
    partial = partial_of(out)
    journal: Journal | None = None
    try:
        with Journal(partial / "journal") as journal, watching(selection.cases_listed()) as progress:
            measured = run_selection(selection, options, identity, journal=journal, progress=progress)
            report = write_run(measured, out, beside=partial)
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; {_go_on(out)}") from None
    except InputError as error:
        if journal is not None and journal.is_empty:  # there is nothing to go on with
            shutil.rmtree(partial, ignore_errors=True)
            raise
        raise InputError(f"{error}; {_go_on(out)}") from None
    shutil.rmtree(partial, ignore_errors=True)
    return measured, report


def _go_on(out: Path) -> str:
    return f"go on with: bodycheck run --resume {quoted(str(out))}"


def write_run(run: Run, out: str | Path, *, beside: Path | None = None) -> Path:
    """Write the tables, trajectories/, manifest.json and report.html; return the report's path.

    Everything is written under a temporary name, in the folder `beside` [default: the one that `out` is in],
    and renamed at the end. Raises InputError where `out` is in use or cannot be written.
    """
    from bodycheck.reports.render.html import render_report  # late: Jinja is needed only now

    check_output(Path(out))
    return write_files(run, render_report(run), Path(out), beside=beside)
