"""Judge trajectories written by any program, with all measures that their quantities allow, and rank them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, scientific, step
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.rotations import geodesic_angle, matrix_to_quaternion, project_to_so3, rotate
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.diagnosis.diagnosis import obstacle
from bodycheck.reports.diagnosis.explain import ExplainedCase
from bodycheck.reports.diagnosis.quantity_resolution import Resolution
from bodycheck.reports.diagnosis.recorded import diagnosed_recording
from bodycheck.reports.document import Column, Document, Sentence, Table
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion, stable_motion
from bodycheck.reports.measurement.convergence import Convergence, Criteria, Point, convergence_of
from bodycheck.reports.measurement.invariants import invariants_of, worst_drift
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS
from bodycheck.reports.measurement.measures import (
    MEASURES,
    ORIENTATION,
    QUANTITIES,
    SCALES,
    Compared,
    Motion,
    departures_of,
    reduced,
    series_of,
)
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.scales import Scales
from bodycheck.reports.measurement.study import limit
from bodycheck.reports.recordings.column_map import ColumnMap
from bodycheck.reports.recordings.conversion import RecordedMotion, recorded_motion
from bodycheck.reports.recordings.first_sample import start_bound_rad, started_at_first_sample
from bodycheck.scenarios.model import Scenario

Start: TypeAlias = Literal["scenario", "first-sample"]
"""Where the truth of a recording starts: at the start of the scenario, or at the first row of the file."""

FROM_START = "_from_start"
"""Suffix of an energy drift relative to the first sample of the file, instead of relative to the truth."""

_TOO_MANY_STEPS = "there are too many steps between two samples"
_SAME = 1e-9  # relative difference of two times that count as equal
_REDUNDANT = 1e-3  # difference in rad, or relative, of what a file states twice: more than rounding of digits
_PREFERRED = (ORIENTATION, "omega_error", "position_error", "velocity_error")


@dataclass(frozen=True)
class Ranking:
    """Judged files, best first.

    rows: file, dt_s where given, outcome, message and measures, like a row of results.csv, and the last time
    in s that was compared, `compared_until_s`. quantity: the measure that they are ranked by, "" where they
    have none in common. orders: measure -> its convergence over the steps.
    """

    rows: tuple[dict[str, Any], ...]
    quantity: str
    orders: Mapping[str, Convergence]

    @property
    def data(self) -> dict[str, Any]:
        """The answer as plain data: the columns of a single file, else the files, their rank and orders."""
        if len(self.rows) == 1 and not self.orders:
            return {name: value for name, value in self.rows[0].items() if name != "file"}
        files = [{"rank": rank, **row} for rank, row in zip(self.ranks, self.rows, strict=True)]
        return {"ranked_by": self.quantity, "files": files, "orders": self.orders}

    @property
    def ranks(self) -> list[int | None]:
        """The rank of each file; equal ones share it, and a file that did not end well has none."""
        resolved = [_resolved(row, self.quantity) for row in self.rows]
        return [
            resolved.index(error) + 1 if row["outcome"] == "ok" else None
            for row, error in zip(self.rows, resolved, strict=True)
        ]


def judge_files(
    paths: Sequence[Path],
    scenario: Scenario,
    scenario_spec: str,
    cache: Cache | None,
    column_map: ColumnMap,
    steps_s: Sequence[float] | None,
    start: Start = "scenario",
) -> Ranking:
    """Judge several files of one scenario and rank them by the first error that all of them have.

    steps_s: the step of each file, from which orders are fitted. start: where the truth starts.
    Raises InputError where a file is invalid, has nothing to compare, or has times outside the scenario's
    duration, where two steps are the same, and where the files end at different times.
    """
    if steps_s is not None and (twice := [one for one, times in Counter(steps_s).items() if times > 1]):
        raise InputError(f"--dt: the step {twice[0]!r} is given twice")
    intervals = [None] * len(paths) if steps_s is None else steps_s
    recordings = {
        str(path): recorded_motion(path, column_map, dt_s)
        for path, dt_s in zip(paths, intervals, strict=True)
    }
    problem = Problem.of(scenario, scenario_spec, cache)
    rows = [
        {"file": str(path), **_judged(path, recordings[str(path)], problem, cache, start)} for path in paths
    ]
    if steps_s is not None:
        rows = [{"file": row["file"], "dt_s": dt_s, **row} for row, dt_s in zip(rows, steps_s, strict=True)]
    ended = [row for row in rows if row["outcome"] == "ok"]
    _check_spans({row["file"]: float(recordings[row["file"]].arrays["t_s"][-1]) for row in ended})
    common = [name for name in (*_PREFERRED, *MEASURES) if ended and all(name in row for row in ended)]
    quantity = next(iter(common), "")
    ranked = sorted(rows, key=lambda row: (row["outcome"] != "ok", _resolved(row, quantity)))
    orders = {} if steps_s is None else _orders(rows, common, problem)
    return Ranking(tuple(ranked), quantity, orders)


def _resolved(row: Mapping[str, Any], quantity: str) -> float:
    """Return the error of a file, but at least what the truth resolves: smaller ones are not ranked."""
    floor = FLOOR_BOUNDS * row["truth_bound_rad"] if quantity == ORIENTATION else 0.0
    return max(float(row.get(quantity, 0.0)), floor)


def _check_spans(ends_s: Mapping[str, float]) -> None:
    """Raise InputError where files end at different times: the errors of a shorter motion are smaller."""
    ends = list(ends_s.items())
    for file, end_s in ends[1:]:
        first, first_s = ends[0]
        if not math.isclose(first_s, end_s, rel_tol=_SAME):
            raise InputError(
                f"{file}: ends at t = {end_s!r} s, but {first} at t = {first_s!r} s; "
                "only files of the same time span can be ranked"
            )


def _orders(
    rows: Sequence[Mapping[str, Any]], common: Iterable[str], problem: Problem
) -> dict[str, Convergence]:
    """Return the convergence of each judged measure that all files that ended well have."""
    found = {}
    for quantity in QUANTITIES:
        if quantity in common and MEASURES[quantity].judged == "limit":
            points = [Point(row["dt_s"], row.get(quantity)) for row in rows]
            found[quantity] = convergence_of(points, Criteria(floor=limit(problem, quantity)))
    return found


def _judged(
    path: Path, recorded: RecordedMotion, problem: Problem, cache: Cache | None, start: Start
) -> dict[str, Any]:
    arrays = recorded.arrays
    scenario = _started(problem.scenario, arrays, start, cache)
    scene, t_s, available = scenario.scene, arrays["t_s"], _quantities(arrays)
    if not available:
        raise InputError(
            f"{path}: omega in world axes needs an attitude to be compared: qw, qx, qy, qz, or r00 to r22"
        )
    if t_s[0] < 0.0 or t_s[-1] > scenario.duration_s * (1.0 + 1e-12):
        fits = t_s[-1] - t_s[0] <= scenario.duration_s
        raise InputError(
            f"{path}: t_s must lie between 0 and the duration, {scenario.duration_s!r} s, but goes from "
            f"{float(t_s[0])!r} to {float(t_s[-1])!r}"
            + "; --map time_origin=first-sample subtracts the first time"
            * bool(fits)
        )
    scales = problem.scales
    truth = known_truth(scene, t_s, cache)
    trusted = t_s < truth.trusted_until_s
    if not trusted[0]:
        raise InputError(f"{path}: the truth ends before the first time in t_s: {truth.end_reason}")
    bound_rad = truth.bound_rad
    if start == "first-sample":
        bound_rad = bound_rad + start_bound_rad(scene, t_s, Resolution.of(recorded.resolution), cache)
    columns: dict[str, Any] = {
        "scenario": scenario.name,
        "outcome": "ok",
        "message": "",
        "truth": truth.kind,
        "truth_bound_rad": float(bound_rad[trusted].max()),
    }
    if stamp_spacing_s := float(recorded.resolution["t_s"]):
        columns["stamp_spacing_s"] = stamp_spacing_s
        columns["truth_bound_rad"] += stamp_spacing_s * largest_norm(truth.trajectory.omega_body[trusted])
    trajectory = _completed(arrays, truth.trajectory)
    true = Motion.of(scene, truth.trajectory)
    motion = stable_motion(scene, trajectory, true)
    if isinstance(motion, str):
        return {**columns, "outcome": "unstable", "message": motion}
    _check_redundant(path, trajectory)
    if not trusted.all():
        until = f"t = {truth.trusted_until_s:.6g} s"
        columns["message"] = f"compared until {until}, where the truth ends: {truth.end_reason}"
    columns["compared_until_s"] = float(t_s[trusted][-1])
    invariants = [one for one in invariants_of(scene) if one.needs <= available]
    compared = Compared(
        scene, truth.trajectory, true, trajectory, motion, invariants, until=int(np.count_nonzero(trusted))
    )
    departures = departures_of(compared)
    if "quaternion" in recorded.computed:
        departures.pop("quaternion_norm_error", None)
    series = series_of(compared, departures)
    measurable = {
        name: values[: compared.until]
        for name, values in series.items()
        if MEASURES[name].needs(scene) <= available
    }
    worst = worst_drift(compared.invariant_drifts)
    own = _drifts_from_start(measurable, departures, compared.until, scales)
    return columns | reduced(measurable, departures, scales) | own | (worst.columns if worst else {})


def _started(scenario: Scenario, arrays: dict[str, Array], start: Start, cache: Cache | None) -> Scenario:
    """Return the scenario, started at the first sample where that is asked for."""
    if start == "scenario":
        return scenario
    truth = known_truth(scenario.scene, arrays["t_s"], cache).trajectory
    return started_at_first_sample(scenario, _completed(arrays, truth), frozenset(_quantities(arrays)))


def _check_redundant(path: Path, trajectory: Trajectory) -> None:
    """Raise InputError where a file states a quantity twice, differently: only one of them is measured."""
    differences = {}
    if trajectory.quaternion is not None and trajectory.rotation is not None:
        of_matrix = matrix_to_quaternion(project_to_so3(trajectory.rotation))
        differences["quaternion and rotation"] = geodesic_angle(trajectory.quaternion, of_matrix)
    if trajectory.omega_body_rad_s is not None and trajectory.omega_world_rad_s is not None:
        rotated = rotate(trajectory.attitude, trajectory.omega_body_rad_s)
        scale = max(largest_norm(rotated), largest_norm(trajectory.omega_world_rad_s)) or 1.0
        off = np.linalg.norm(rotated - trajectory.omega_world_rad_s, axis=-1)
        differences["omega in body and in world axes"] = off / scale
    for what, difference in differences.items():
        contradictory = trajectory.t_s[difference > _REDUNDANT]
        if len(contradictory):
            at = f"t = {number(float(contradictory[0]))} s"
            raise InputError(f"{path}: {what} contradict each other at {at}; leave one of them out")


def _drifts_from_start(
    measurable: Iterable[str], departures: Mapping[str, Array], until: int, scales: Scales
) -> dict[str, float]:
    """Return max |(E - E*) - (E - E*)(0)| over the scale: max |E - E(0)| where the energy is conserved.

    In other scenes, it is the energy gained since the first sample, compared with the gain of the truth.
    """
    found = {}
    for name in ("energy_drift", "rotational_energy_drift"):
        scale = getattr(scales, SCALES[name])
        if name in measurable and scale > 0.0:
            departure = departures[name][:until, 0]
            found[f"{name}{FROM_START}"] = float(np.max(np.abs(departure - departure[0]))) / scale
    return found


def explained_file(
    path: Path,
    scenario: Scenario,
    scenario_spec: str,
    cache: Cache | None,
    column_map: ColumnMap,
    dt_s: float | None,
    resolution_text: str | None = None,
) -> ExplainedCase:
    """Return the diagnosis of the trajectory in a file, which starts from its own rows.

    dt_s: the step of the program that wrote it, None if unknown. resolution_text: what is known of its
    resolution (Resolution.with_given). Raises InputError as `judge_files` does, and where the step does not
    fit the times.
    """
    recorded = recorded_motion(path, column_map, dt_s)
    arrays, resolution = recorded.arrays, Resolution.of(recorded.resolution)
    if resolution_text is not None:
        resolution = resolution.with_given(resolution_text)
    problem, t_s = Problem.of(scenario, scenario_spec, cache), arrays["t_s"]
    truth = known_truth(scenario.scene, t_s, cache)
    trajectory, known = _completed(arrays, truth.trajectory), frozenset(_quantities(arrays))
    scene = _sampled_at(scenario.scene, t_s, resolution.stamp)
    if dt_s is not None:
        _check_step(scene, t_s, dt_s)
    found = diagnosed_recording(
        scene,
        trajectory,
        truth.trajectory,
        problem.scales,
        dt_s,
        known=known,
        resolution=resolution,
    )
    columns = {"scenario": scenario.name, "control": "none" if dt_s is None else "dt", "dt_s": dt_s}
    columns |= {"outcome": "ok", "message": ""}
    case = CaseResult({**columns, "engine": path.name, "method": ""}, MeasuredMotion(trajectory))
    reason = "" if found is not None else obstacle(scene, trajectory, known) or _TOO_MANY_STEPS
    return ExplainedCase(problem, (path.name,), case, (), found, reason)


def _sampled_at(scene: Scene, t_s: Array, resolution_s: float) -> Scene:
    """Return the scene with the samples of a file, where these are evenly spaced from 0."""
    end = float(t_s[-1])
    evenly = np.arange(len(t_s)) * end / max(len(t_s) - 1, 1)
    if len(t_s) < 2 or not np.allclose(t_s, evenly, rtol=0.0, atol=max(1e-9 * end, resolution_s)):
        return scene
    return replace(scene, duration_s=end, samples=len(t_s))


def _check_step(scene: Scene, t_s: Array, dt_s: float) -> None:
    """Raise InputError where the samples of a file do not fit the step."""
    if scene.samples != len(t_s) or scene.duration_s != t_s[-1]:
        raise InputError(f"--dt {dt_s}: needs evenly spaced times that begin at 0")
    try:
        plan_steps(scene, dt_s)
    except ValueError as error:
        raise InputError(f"--dt {dt_s}: {error}") from None


def _quantities(arrays: dict[str, Array]) -> set[str]:
    """Return which of position, velocity, attitude and omega (in body axes) a trajectory has."""
    available = {name for name in ("position", "velocity") if any(key.startswith(name) for key in arrays)}
    if "quaternion" in arrays or "rotation" in arrays:
        available.add("attitude")
    if "omega_body_rad_s" in arrays or ("omega_world_rad_s" in arrays and "attitude" in available):
        available.add("omega")
    return available


def _completed(arrays: dict[str, Array], truth: Trajectory) -> Trajectory:
    """Fill missing quantities with the truth; the measures that depend on them are dropped later."""
    filled = dict(arrays)
    filled.setdefault("position_m", truth.position_m)
    filled.setdefault("velocity_m_s", truth.velocity_m_s)
    if "quaternion" not in filled and "rotation" not in filled:
        filled["quaternion"] = truth.attitude
    if "omega_body_rad_s" not in filled and "omega_world_rad_s" not in filled:
        filled["omega_body_rad_s"] = truth.omega_body
    return Trajectory(**filled)


def judgement_document(ranking: Ranking) -> Document:
    """Return the measures of a single file, or the files by rank with their main measures and orders."""
    if len(ranking.rows) == 1 and not ranking.orders:
        lines = tuple((name, str(value)) for name, value in ranking.data.items())
        return Document("bodycheck judge", (Table((Column("", "fixed"), Column("")), lines),))
    energies = ("energy_drift", "rotational_energy_drift")
    energy = next((name for name in energies if any(name in row for row in ranking.rows)), energies[0])
    measures = dict.fromkeys(filter(None, (ranking.quantity, energy, f"{energy}{FROM_START}")))
    steps = ["dt_s"] if "dt_s" in ranking.rows[0] else []
    columns = (
        Column("#", "number"),
        Column("file", "name"),
        *(Column(name.replace("_", " "), "number") for name in (*steps, *measures)),
        Column("outcome"),
    )
    rows = tuple(
        (
            "" if rank is None else str(rank),
            row["file"],
            *(step(row[name]) for name in steps),
            *(scientific(row[name]) if name in row else "" for name in measures),
            row["outcome"] + f": {row['message']}" * bool(row["message"]),
        )
        for rank, row in zip(ranking.ranks, ranking.rows, strict=True)
    )
    by = f"ranked by {ranking.quantity}" if ranking.quantity else "not ranked: no measure in common"
    head = Sentence(f"{ranking.rows[0]['scenario']}: {len(rows)} files, {by}")
    orders = Table(
        (Column("measure", "fixed"), Column("verdict"), Column("order", "number"), Column("95 %", "fixed")),
        tuple(
            (name, found.verdict, number(found.order, 3), _interval(found))
            for name, found in ranking.orders.items()
        ),
        title="Order over the steps",
    )
    return Document("bodycheck judge", (head, Table(columns, rows), orders))


def _interval(found: Convergence) -> str:
    if found.order is None:
        return ""
    return f"{number(found.order_low, 3)} to {number(found.order_high, 3)}"
