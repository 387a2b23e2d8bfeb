"""Write a run atomically as files: the tables, the trajectories, the manifest and the report."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.files import atomic_write, check_folder, unfinished_name
from bodycheck.adapters.workers.protocol import Message, read_back_message
from bodycheck.reference_impl.truth.truth import QUANTITIES
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.run_files.report_files import write_pages
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.run_files.sentinels import write_sentinels
from bodycheck.reports.run_files.tables import TABLES, as_csv
from bodycheck.reports.run_files.trajectory_files import npz, stored_arrays


def check_output(out: Path) -> None:
    """Raise InputError where a run could not be written to `out`; called before anything is run."""
    try:
        in_place = out.is_symlink() or out.resolve() == Path.cwd()
        if in_place or (out.exists() and (not out.is_dir() or any(out.iterdir()))):
            raise InputError(f"--out {out}: already exists; choose a new or an empty folder")
        check_folder(f"--out {out}", out.absolute().parent)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror or error}") from None


@contextmanager
def atomic_folder(out: Path, *, temp_dir: Path | None = None) -> Iterator[Path]:
    """Yield an empty folder that becomes `out` when the block ends, and is removed if it raises.

    temp_dir: its parent until then [default: the parent of `out`]. Raises InputError where `out` is in use or
    cannot be written.
    """
    check_output(out)
    temp_dir = out.absolute().parent if temp_dir is None else temp_dir
    try:
        temp_dir.mkdir(parents=True, exist_ok=True)
        unfinished = unfinished_name(temp_dir / out.absolute().name)
        try:
            unfinished.mkdir()  # not mkdtemp, which ignores the umask and excludes other users
            yield unfinished
            unfinished.replace(out)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror or error}") from None


def write_files(
    run: Run, report: Iterable[tuple[str, str]], out: Path, *, temp_dir: Path | None = None
) -> Path:
    """Write the tables, trajectories/, manifest.json and the pages of the report; return that of report.html.

    Everything is written under a temporary name in the folder `temp_dir` [default: the parent of `out`] and
    renamed at the end. Raises InputError where `out` is in use or cannot be written.
    """
    with atomic_folder(out, temp_dir=temp_dir) as folder:
        write_tables(run, folder)
        write_trajectories(run, folder / "trajectories")
        write_sentinels(run.sentinels, folder)
        write_pages(report, folder)
    return out / "report.html"


def write_tables(run: Run, folder: Path) -> None:
    """Write the tables, manifest.json and read_back.json: all that read_tables needs, and the read-backs."""
    for name in TABLES:
        (folder / f"{name}.csv").write_bytes(as_csv(getattr(run, name)))
    write_manifest(run, folder)
    (folder / "read_back.json").write_text(json.dumps(_read_backs(run)) + "\n", encoding="utf-8")


def write_manifest(run: Run, folder: Path) -> None:
    """Write manifest.json, also over an earlier one."""
    atomic_write(folder / "manifest.json", (json.dumps(run.manifest, indent=2) + "\n").encode())


def write_trajectories(run: Run, trajectories: Path) -> None:
    """Write the motions of a run, and the truths of its scenarios, into a new folder."""
    for problem in run.problems:
        folder = trajectories / file_name(problem.scenario.name)
        folder.mkdir(parents=True)
        truth = problem.truth
        bounds = {name: getattr(truth, name) for name in (f"bound_{q}" for q in QUANTITIES)}
        (folder / "truth.npz").write_bytes(npz({**stored_arrays(truth.trajectory), **bounds}))
    for case in run.cases:
        if case.trajectory is not None:
            (trajectories / trajectory_file(case)).write_bytes(npz(stored_arrays(case.trajectory)))


def _read_backs(run: Run) -> dict[str, Message]:
    """Return the parameters read back from the engines, and the builds, by trajectory file of the case."""
    return {
        str(trajectory_file(case)): {
            **read_back_message(case.read_back),
            "build": case.columns.get("build") or None,
        }
        for case in run.cases
        if case.read_back is not None
    }


def trajectory_file(case: CaseResult) -> Path:
    """Return scenario/engine_method_step.npz or ..._tolerance.npz, relative to the run's trajectories/."""
    columns = case.columns
    fineness = case.setting.fineness
    step = "" if fineness is None else f"_{fineness!r}"
    name = file_name(f"{columns['engine']}_{columns['method']}{step}")
    return Path(file_name(columns["scenario"]), f"{name}.npz")


def file_name(name: str) -> str:
    """Return a safe file name: the name itself if it is safe, else a sanitised one with a hash."""
    safe = re.sub(r"[^A-Za-z0-9+_.-]+", "-", name).lstrip(".")[:80]
    return safe if safe == name else f"{safe}-{sha256(name.encode()).hexdigest()[:8]}"
