"""Read a run from its folder: its tables alone, or the whole run with every motion measured again."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import (
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    StrictBool,
    Tag,
    ValidationError,
)

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import nearest
from bodycheck._util.untrusted import read_json, shell_split
from bodycheck.adapters.registry import register_announced
from bodycheck.adapters.workers.received_messages import MethodMessage, read_back_of
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion, measured_by, scenario_spec
from bodycheck.reports.measurement.case_columns import SPEEDS
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION, SIGNED
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.removed_motions import motion_again
from bodycheck.reports.run_files.run_tables import Run, Tables, announced_of, case_of, study_key
from bodycheck.reports.run_files.tables import TABLES, Row, TableKind, read_rows
from bodycheck.reports.run_files.trajectory_files import read_arrays
from bodycheck.reports.run_files.writer import file_name, trajectory_file
from bodycheck.scenarios.library import scenario_names
from bodycheck.scenarios.reader import fault_lines
from bodycheck.scenarios.serialization import deserialized

MANIFEST = "manifest.json"
_MAX_INSIDE = 1000
_SAME = 1e-6  # relative tolerance between an error measured again and the one in the table


def read_tables(folder: Path) -> Tables:
    """Read the tables (those of methods and diagnoses if there are any) and manifest.json of a run.

    Raises InputError with one line where the folder is not a run, or its files are damaged or do not belong
    together.
    """
    manifest = read_manifest(folder)
    for command, name in announced_of(manifest).items():
        register_announced(name, command)
    tables = {name: _read_table(folder / f"{name}.csv", kind) for name, kind in TABLES.items()}
    results, methods = tables["results"], tables["methods"]
    _check_settings(folder / "results.csv", results)
    _check_measures(folder / "results.csv", results)
    _check_speeds(folder / "results.csv", results)
    run_id = manifest["run_id"]
    if others := {row["run_id"] for rows in tables.values() for row in rows} - {run_id}:
        raise InputError(f"{folder}: manifest.json is of run {run_id}, but the tables of {', '.join(others)}")
    if Counter(row["outcome"] for row in results) != manifest["outcomes"]:
        raise InputError(
            f"{folder / 'results.csv'}: cases do not match the counts in manifest.json; {folder} is damaged"
        )
    rows = [row for name, kind in TABLES.items() if kind.is_of_studies for row in tables[name]]
    if unknown := {row["scenario"] for row in rows} - manifest["scenarios"].keys():
        raise InputError(f"{folder}: manifest.json has no scenario {', '.join(sorted(unknown))}")
    judged = {study_key(row) for row in methods}
    if unjudged := [row for row in results if row["outcome"] == "ok" and study_key(row) not in judged]:
        name = "{scenario}, {engine}:{method}".format_map(unjudged[0])
        raise InputError(f"{folder / 'methods.csv'}: has no row of {name}; {folder} is damaged")
    engines = manifest["engines"]
    known = {(name, method) for name, entry in engines.items() for method in entry.get("methods", ())}
    if unknown := {(row["engine"], row["method"]) for row in rows} - known:
        raise InputError(f"{folder}: manifest.json has no method {':'.join(min(unknown))}")
    return Tables(
        run_id=run_id, manifest=manifest, cases=tuple(_cases(results)), tables={**tables, "results": ()}
    )


def _cases(results: list[Row]) -> Iterator[CaseResult]:
    """Yield the cases of results.csv; its rows are removed, so that a large run is not in memory twice."""
    results.reverse()
    while results:
        yield case_of(results.pop())


def _read_table(path: Path, kind: TableKind) -> list[Row]:
    """Read the rows of a table; runs of earlier versions lack some tables."""
    if not kind.in_every_run and not path.exists():
        return []
    rows = read_rows(path, kind)
    for column, known in kind.choices.items():
        _check_choices(path, rows, column, known)
    for column in kind.intervals:
        _check_intervals(path, rows, column)
    if "reproduce" in kind.needed:
        _check_commands(path, rows)
    return rows


def _runs_in(folder: Path, places: Sequence[str] = ("*",)) -> list[Path]:
    """Return the runs in a folder, which ensembles, audits and others may be in too."""
    found = chain.from_iterable(folder.glob(f"{place}/results.csv") for place in places)
    return [path.parent for path in islice(found, _MAX_INSIDE)]


def _json(folder: Path, name: str) -> Any:
    try:
        return read_json(folder / name)
    except FileNotFoundError:
        scenario = not folder.exists() and str(folder) in scenario_names()
        hint = f"; to run the scenario: bodycheck run {folder} --out {folder}" if scenario else ""
        if inside := _runs_in(folder, ("*", "*/*")):  # as the pytest plugin stores them
            newest = max(inside, key=lambda run: (run / "results.csv").stat().st_mtime)
            hint = (
                f"; the newest of {len(inside)} runs in it is {newest}"
                if len(inside) > 1
                else f"; {newest} is one"
            )
        elif near := nearest(folder.name, [one.name for one in _runs_in(folder.parent)]):
            hint = hint or f"; did you mean {folder.parent / near}?"
        raise InputError(f"{folder / name}: missing: not a run folder{hint}") from None


def read_manifest(folder: Path) -> dict[str, Any]:
    """Read manifest.json of a run; raise InputError with one line where it is missing or damaged."""
    return check_manifest(folder / MANIFEST, _json(folder, MANIFEST))


def _check_choices(path: Path, rows: Iterable[dict[str, Any]], column: str, known: Collection[str]) -> None:
    """Raise InputError where a row has a word that this version does not write."""
    if unknown := {row[column] for row in rows}.difference(known):
        raise InputError(f"{path}: unknown {column} {sorted(unknown)[0]!r} (available: {', '.join(known)})")


def _check_intervals(path: Path, rows: Iterable[dict[str, Any]], column: str) -> None:
    """Raise InputError where an estimate lacks an end of its interval, or lies outside."""
    low, high = f"{column}_low", f"{column}_high"
    for row in rows:
        if column in row and not {low, high} <= row.keys():
            raise InputError(f"{path}: {column} {row[column]:g} without {low} and {high}")
        if column in row and not row[low] <= row[column] <= row[high]:
            ends = f"{low} {row[low]:g} and {high} {row[high]:g}"
            raise InputError(f"{path}: {column} {row[column]:g} is not between {ends}")


def _check_speeds(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Raise InputError where a time, or a ratio of times, is negative or not finite."""
    for row in rows:
        for column in SPEEDS:
            if column in row and not 0.0 <= row[column] < math.inf:
                raise InputError(f"{path}: {column} is {row[column]!r}, not a finite number from 0 on")


def _check_settings(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Raise InputError where a step or a tolerance is not positive and finite."""
    for row in rows:
        for column in ("dt_s", "tolerance"):
            if column in row and not 0.0 < row[column] < math.inf:
                raise InputError(f"{path}: {column} is {row[column]!r}, not a positive number")


def _check_measures(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Raise InputError where a measure, which is a maximum of sizes, is negative or not finite.

    With its sign, it has the same size.
    """
    names = [name for measure in MEASURES.values() for name in measure.columns]
    for row in rows:
        for name in (name for name in names if name in row):
            unsigned = row.get(name.removesuffix(SIGNED)) if name.endswith(SIGNED) else row[name]
            if unsigned is None or not 0.0 <= unsigned < math.inf:
                raise InputError(f"{path}: {name} is {row[name]!r}, not a finite number from 0 on")
            if abs(row[name]) != unsigned:
                measure = name.removesuffix(SIGNED)
                raise InputError(f"{path}: {name} is {row[name]!r}, but {measure} is {unsigned!r}")
        if row["outcome"] == "ok" and ORIENTATION not in row:
            raise InputError(f"{path}: a case with outcome ok has no {ORIENTATION}")


def _check_commands(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    for command in {row["reproduce"] for row in rows}:
        try:
            shell_split(command)
        except ValueError as error:
            raise InputError(f"{path}: reproduce is not a command: {error}: {command!r:.80}") from None


def read_run(folder: Path, *, allow_code: bool, cache: Cache | None) -> Run:
    """Read a whole run: solve its truths again, and measure a motion again when it is first needed.

    allow_code: the run's scenarios may name functions, whose code is executed. Raises InputError as
    read_tables does; the trajectory of a case raises it where its file is damaged or does not match its row.
    """
    tables = read_tables(folder)
    cases = _with_read_backs(folder, tables.cases)
    solved = _problems(folder, tables, cache, allow_code=allow_code)
    problems = {problem.scenario.name: problem for problem in solved}
    return Run(
        run_id=tables.run_id,
        manifest=tables.manifest,
        tables=tables.tables,
        problems=tuple(problems.values()),
        cases=tuple(
            _with_motion(folder, problems[case.columns["scenario"]], case, cache, allow_code=allow_code)
            for case in cases
        ),
    )


def _problems(folder: Path, tables: Tables, cache: Cache | None, *, allow_code: bool) -> Iterator[Problem]:
    commands = {case.columns["scenario"]: case.columns["reproduce"] for case in tables.cases}
    for name, facts in tables.manifest["scenarios"].items():
        file = folder / MANIFEST
        scenario = deserialized(facts, f"{file}: scenarios.{name}", allow_code=allow_code, file=file)
        problem = Problem.of(scenario, scenario_spec(commands.get(name, "")) or name, cache)
        path = folder / "trajectories" / file_name(name) / "truth.npz"
        if not path.exists() and _is_nightly(folder):  # removed; it is the same as solved now or no case fits
            yield problem
            continue
        stored = read_arrays(path)
        if "quaternion" not in stored or len(stored["t_s"]) != len(problem.truth.trajectory.t_s):
            raise InputError(f"{path}: not a truth of {name}")
        gap = geodesic_angle(stored["quaternion"], problem.truth.trajectory.attitude)[: problem.compared]
        bound = problem.truth.bound_rad[: problem.compared]
        if not np.all(gap.reshape(len(bound), -1) <= 2.0 * bound[:, None]):
            raise InputError(f"{path}: differs from the truth of {name} as solved now")
        yield problem


def _with_read_backs(folder: Path, cases: Iterable[CaseResult]) -> Iterator[CaseResult]:
    """Yield the cases with the parameters that were read back from their engines."""
    stored = _json(folder, "read_back.json")
    if not isinstance(stored, dict):
        raise InputError(f"{folder / 'read_back.json'}: must be an object with one entry per case")
    for case in cases:
        message = stored.get(str(trajectory_file(case)))
        if isinstance(message, dict):
            message.pop("build", None)  # written for human readers; the row of the case has it too
        try:
            yield replace(case, read_back=None if message is None else read_back_of(message))
        except (KeyError, TypeError, ValueError) as error:
            where = f"{folder / 'read_back.json'}: {trajectory_file(case)}"
            raise InputError(f"{where}: not a valid read-back: {error!r}") from None


def _is_nightly(folder: Path) -> bool:
    """Whether a run is one of a history, which removes the motions of unchanged cases after some runs."""
    return (folder / "night.json").exists()


def _with_motion(
    folder: Path, problem: Problem, case: CaseResult, cache: Cache | None, *, allow_code: bool
) -> CaseResult:
    """Return a case whose motion is read when it is needed; the case itself if it has none."""
    path = folder / "trajectories" / trajectory_file(case)
    if path.exists() or not _is_nightly(folder):
        if not case.ok and not path.exists():
            return case
        return replace(case, motion=lambda: _motion(path, problem, case, _trajectory(path)))
    if not case.ok:
        return case
    again = partial(motion_again, path, problem, case, cache, allow_code=allow_code)
    return replace(case, motion=lambda: _motion(path, problem, case, again()))


def _trajectory(path: Path) -> Trajectory:
    arrays = read_arrays(path)
    try:
        return Trajectory(**arrays)
    except (TypeError, ValueError) as error:
        raise InputError(f"{path}: not the trajectory of a case: {error}") from None


def _motion(path: Path, problem: Problem, case: CaseResult, trajectory: Trajectory) -> MeasuredMotion:
    """Return a trajectory, with its measures over time if the case ended well."""
    if not case.ok:
        return MeasuredMotion(trajectory)
    if not np.array_equal(trajectory.t_s, problem.truth.trajectory.t_s):
        raise InputError(f"{path}: t_s differs from the sample times of {problem.scenario.name}")
    columns, motion = measured_by(
        problem, trajectory, EnergyAndMomentum.of(problem.scenario.scene, trajectory)
    )
    angle, stored_error = columns[ORIENTATION], case.columns[ORIENTATION]
    slack = 2.0 * problem.largest(problem.truth.bound_rad)
    if not math.isclose(angle, stored_error, rel_tol=_SAME, abs_tol=slack):
        raise InputError(f"{path}: its error is {angle:.4g} rad, but results.csv has {stored_error:.4g} rad")
    return motion


_Text: TypeAlias = Annotated[str, Field(strict=True, max_length=100_000)]
_Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_MAX_FAULTS = 3
_Count: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=10**12)]


class _Method(MethodMessage):
    """The facts of a method as the engine announced them; keys of other versions are ignored."""

    model_config = ConfigDict(extra="ignore")


class _Engine(BaseModel):
    """An engine that ran."""

    version: _Text
    methods: dict[_Text, _Method]
    command: Annotated[_Text, Field(pattern="^cmd:")] | None = None


class _Unavailable(BaseModel):
    """An engine that did not run, with the reason."""

    unavailable: _Text


class _Load(BaseModel):
    """A load of a scenario."""

    model_config = ConfigDict(extra="allow")

    from_s: _Number | None = None
    until_s: _Number | None = None


class _Body(BaseModel):
    """The body of a scenario."""

    model_config = ConfigDict(extra="allow")

    notes: list[_Text] = []


class _Scenario(BaseModel):
    """A scenario; reading a whole run checks all of it."""

    model_config = ConfigDict(extra="allow")

    duration_s: Annotated[_Number, Field(gt=0.0)]
    samples: Annotated[int, Field(strict=True, ge=2, le=10**9)]
    body: Annotated[
        Annotated[_Body, Tag("body")] | Annotated[list[_Body], Tag("tree")],
        Discriminator(lambda value: "tree" if isinstance(value, list) else "body"),
    ]
    forcing: list[_Load] = []


def _kind(entry: Any) -> str:
    return "unavailable" if isinstance(entry, dict) and "unavailable" in entry else "ran"


_Entry: TypeAlias = Annotated[
    Annotated[_Engine, Tag("ran")] | Annotated[_Unavailable, Tag("unavailable")], Discriminator(_kind)
]


class ManifestFile(BaseModel):
    """The keys of a manifest that comparison, gates and summaries read; other keys are allowed."""

    model_config = ConfigDict(extra="allow")

    run_id: _Text
    created: AwareDatetime
    bodycheck: _Text
    cpu: _Text
    cores: _Count | None
    system: _Text
    python: _Text
    platform: _Text
    libraries: dict[_Text, _Text]
    engines: dict[_Text, _Entry]
    outcomes: dict[_Text, _Count]
    scenarios: dict[_Text, _Scenario]
    dt_s: list[_Number] | None
    tolerances: list[_Number] | None
    speed: StrictBool
    jobs: _Count | None = None
    timeout_s: _Number | None = None
    speed_core: _Count | None
    speed_noise: _Number | None
    compile_s: _Number | None
    truths_s: _Number | None = None
    motions_s: _Number | None = None
    speeds_s: _Number | None = None
    run_s: _Number | None
    failed_checks: list[_Text] = []
    failed_cases: list[_Text] = []


def check_manifest(path: Path, manifest: Any) -> dict[str, Any]:
    """Return a valid manifest unchanged; raise InputError with one line that lists the faults otherwise."""
    try:
        ManifestFile.model_validate(manifest)
    except ValidationError as error:
        faults = "; ".join(line.lstrip(": ") for line in fault_lines(error)[:_MAX_FAULTS])
        raise InputError(f"{path}: not a manifest of a run: {faults}") from None
    return dict(manifest)
