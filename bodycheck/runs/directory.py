"""Run into a folder: each result is stored as soon as it is known, and an interrupted run can be resumed."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from operator import or_
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError, create_model

from bodycheck._util.code_gate import check_code
from bodycheck._util.errors import InputError, StoppedError
from bodycheck._util.files import atomic_write
from bodycheck._util.formatting import names
from bodycheck._util.shard import Shard
from bodycheck._util.source_commit import source_commit
from bodycheck._util.untrusted import read_json, shell_join
from bodycheck.adapters.engine_names import admit, is_program, split_method
from bodycheck.adapters.registry import program_file
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.measurement.case import ALLOW_CODE, ENGINES_FILE
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.writer import check_output, write_files
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request, stored_fields
from bodycheck.runs.run_progress import ProgressFactory
from bodycheck.runs.runner import connected_to_cluster, run_selection
from bodycheck.runs.selection import Selection, select
from bodycheck.scenarios.reader import fault_lines
from bodycheck.scenarios.serialization import serialized

RUNS = Path("bodycheck-runs")
"""The default parent folder of runs."""

_REQUEST = "request.json"
_PARTIAL = ".partial"
_Stored = TypeVar("_Stored")


def _stored_type(kind: Any) -> Any:
    """Return the type in request.json of a field of a request, with lists, and text for paths."""
    if get_origin(kind) is UnionType:
        return reduce(or_, map(_stored_type, get_args(kind)))
    if get_origin(kind) in (Sequence, Iterable):
        (of,) = get_args(kind)
        return list[float] if of is float else list[str]
    return kind


_StoredRequest: Any = create_model(
    "_StoredRequest",
    __config__=ConfigDict(extra="forbid", strict=True),
    **{one.name: (_stored_type(one.type), one.default) for one in stored_fields()},  # type: ignore[call-overload]
)


def selected(request: Request, file: Path | None = None) -> Selection:
    """Resolve and check scenarios, engines, steps and tolerances; raises InputError if any is wrong.

    file: the one that stores the request, unless it is the user's.
    """
    shard = None if request.shard is None else Shard.parse(request.shard)
    selection = select(
        *(request.scenarios, request.engines, request.dt_s, request.tolerances),
        allow_code=request.allow_code,
        file=file,
        partial=True,
    )
    return selection if shard is None else selection.of_shard(shard)


class _Description(BaseModel):
    """The content of request.json; run_id is restricted because it becomes part of file names."""

    run_id: Annotated[str, Field(strict=True, pattern=r"^[0-9A-Za-z-]{1,100}$")]
    created: AwareDatetime
    request: _StoredRequest
    definitions: dict[str, str] = {}


def _definitions(selection: Selection) -> dict[str, str]:
    """Return a hash of the definition of each scenario, by its name."""
    texts = ((scenario.name, json.dumps(serialized(scenario))) for _, scenario in selection.scenarios)
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts}


def run_to_folder(request: Request, out: Path | None, make_progress: ProgressFactory) -> tuple[Run, Path]:
    """Carry out a request, write the results to `out`, and return the run and its report's path.

    Until the run is complete, the folder is `out` with the suffix .partial. Raises InputError if the input is
    wrong or the disk is full, StoppedError if the user interrupts the run; `resume` continues it.
    """
    identity = Identity.new()
    out = out or RUNS / identity.run_id
    return begin(request, identity, out, make_progress, _storage(out))


@dataclass(frozen=True)
class Storage(Generic[_Stored]):
    """What becomes of a run that is complete.

    store: writes it to its folder, and returns what its caller needs. again: the command that continues the
    run if it is interrupted. phase: what is shown meanwhile.
    """

    store: Callable[[Run], _Stored]
    again: tuple[str, ...]
    phase: str = "writing the report"


def _storage(out: Path) -> Storage[tuple[Run, Path]]:
    def store(run: Run) -> tuple[Run, Path]:
        return run, write_run(run, out, temp_dir=partial_of(out))

    return Storage(store, ("run", "--resume", str(out)))


def begin(
    request: Request,
    identity: Identity,
    out: Path,
    make_progress: ProgressFactory,
    storage: Storage[_Stored],
) -> _Stored:
    """Carry out a request with a journal in `out`.partial, and store the run.

    Raises the errors of run_to_folder.
    """
    source_commit(request.commit)  # checks it
    check_output(out)
    partial = partial_of(out)
    if (partial / _REQUEST).exists():
        raise InputError(f"{partial}: holds an interrupted run; continue with --resume {out}, or remove it")
    try:
        with make_progress(0):
            selection = selected(request)
    except KeyboardInterrupt:
        raise StoppedError("stopped before anything was measured") from None
    with connected_to_cluster(request) as request:
        _describe(partial, request, identity, selection, out)
        return _run_journaled(request, selection, identity, out, make_progress, storage)


def _describe(partial: Path, request: Request, identity: Identity, selection: Selection, out: Path) -> None:
    """Write request.json atomically, without which a folder does not count as a run."""
    description = {
        "run_id": identity.run_id,
        "created": identity.created.isoformat(),
        "request": request.data,
        "definitions": _definitions(selection),
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


def resume(out: Path, make_progress: ProgressFactory, *, allow_code: bool = False) -> tuple[Run, Path]:
    """Continue an interrupted run with its original settings, without repeating finished cases.

    allow_code: scenarios and the stored request may name functions, programs and a cluster, whose code runs;
    the request itself permits nothing. Raises InputError if there is no interrupted run or a scenario has
    changed, and the errors of run_to_folder.
    """
    return proceed(out, make_progress, _storage(out), allow_code=allow_code)


def proceed(
    out: Path, make_progress: ProgressFactory, storage: Storage[_Stored], *, allow_code: bool
) -> _Stored:
    """Continue an interrupted run, and store it. Parameters and errors as for `resume`."""
    partial = partial_of(out)
    file = partial / _REQUEST
    try:
        description = _description(file)
    except FileNotFoundError:
        state = "that run is complete" if _run_id(out) else "there is no interrupted run"
        raise InputError(f"--resume {out}: {state}") from None
    except InputError as error:
        raise InputError(f"--resume {out}: {error}") from None
    request = Request(**{**description.request.model_dump(), "allow_code": allow_code})
    identity = Identity(description.run_id, description.created)
    if _run_id(out) == identity.run_id:  # interrupted after renaming the results
        shutil.rmtree(partial, ignore_errors=True)
        raise InputError(f"--resume {out}: that run is complete")
    admit(request.engines or (), allow_code=allow_code, file=file)
    if request.cluster is not None:
        check_code(request.cluster, "a cluster can run code here", allow_code=allow_code, file=file)
    try:
        selection = selected(request, file)
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; {_continue_hint(storage.again, request)}") from None
    now = _definitions(selection)
    if changed := [name for name, was in description.definitions.items() if now.get(name) != was]:
        raise InputError(
            f"--resume {out}: changed since the run began: {names(changed)}; restore it, or remove {partial}"
        )
    with connected_to_cluster(request) as request:
        return _run_journaled(request, selection, identity, out, make_progress, storage)


def _description(path: Path) -> _Description:
    """Read request.json; raises FileNotFoundError if it does not exist, InputError if it is damaged."""
    try:
        return _Description.model_validate(read_json(path, escape=False))
    except ValidationError as error:
        raise InputError("\n".join(f"{path}: {line}" for line in fault_lines(error))) from None


def _run_id(out: Path) -> str | None:
    """Return the id of the complete run in this folder; None if there is none."""
    try:
        manifest = read_json(out / "manifest.json")
    except (OSError, InputError):
        return None
    return str(manifest["run_id"]) if isinstance(manifest, dict) and "run_id" in manifest else None


def partial_of(out: Path) -> Path:
    """Return the folder of a run until it is complete."""
    return out.with_name(f"{out.name}{_PARTIAL}")


def interrupted_in(folder: Path) -> list[Path]:
    """Return the folders, without .partial, of the interrupted runs in a folder, sorted by name."""
    found = (path for path in folder.glob(f"*{_PARTIAL}") if (path / _REQUEST).exists())
    return sorted(path.with_name(path.name.removesuffix(_PARTIAL)) for path in found)


def remove_interrupted(out: Path) -> None:
    """Remove what an interrupted run left, unless a process still works on it."""
    partial = partial_of(out)
    with suppress(InputError), Journal(partial / "journal"):
        shutil.rmtree(partial, ignore_errors=True)


def _run_journaled(
    request: Request,
    selection: Selection,
    identity: Identity,
    out: Path,
    make_progress: ProgressFactory,
    storage: Storage[_Stored],
) -> _Stored:
    partial = partial_of(out)
    journal: Journal | None = None
    try:
        with Journal(partial / "journal") as journal, make_progress(selection.cases_listed()) as progress:
            measured = run_selection(selection, request, identity, journal=journal, progress=progress)
            progress.phase(storage.phase)
            stored = storage.store(measured)
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; {_continue_hint(storage.again, request)}") from None
    except InputError as error:
        if journal is not None and journal.is_empty:  # there is nothing to continue
            shutil.rmtree(partial, ignore_errors=True)
            raise
        raise InputError(f"{error}; {_continue_hint(storage.again, request)}") from None
    except MemoryError:
        raise InputError(f"out of memory; {_continue_hint(storage.again, request)}") from None
    except Exception as error:
        error.add_note(_continue_hint(storage.again, request))
        raise
    shutil.rmtree(partial, ignore_errors=True)
    return stored


def _continue_hint(again: Sequence[str], request: Request) -> str:
    names = [split_method(name)[0] for name in request.engines or ()]
    files = dict.fromkeys(str(file) for name in names if (file := program_file(name)) is not None)
    words = [*again, *(word for file in files for word in (ENGINES_FILE, file))]
    if request.allow_code or request.cluster is not None or any(map(is_program, names)):
        words.append(ALLOW_CODE)
    return f"continue with: bodycheck {shell_join(words)}"


def write_run(run: Run, out: str | Path, *, temp_dir: Path | None = None) -> Path:
    """Write the tables, trajectories/, manifest.json and the report; return the path of report.html.

    Everything is written under a temporary name in the folder `temp_dir` [default: the parent of `out`],
    and renamed at the end. Raises InputError where `out` is in use or cannot be written.
    """
    from bodycheck.reports.render.html import report_pages  # imported here: Jinja is needed only now

    return write_files(run, report_pages(run), Path(out), temp_dir=temp_dir)
