"""Judge trajectories written by any program, with all measures that their quantities allow, and rank them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.examine.diagnosis.attitude_readings import attitude_diagnosis, conserving_reading
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, obstacle
from bodycheck.examine.diagnosis.quantity_resolution import Resolution
from bodycheck.examine.diagnosis.recorded import diagnosed_recording
from bodycheck.examine.explanation.explain import ExplainedCase
from bodycheck.recordings.column_map import ColumnMap
from bodycheck.recordings.conversion import RecordedMotion, recorded_motion
from bodycheck.recordings.judged_motion import TURNING, JudgedMotion, Start, is_free, quantities_of
from bodycheck.recordings.wrong_rows import is_right_elsewhere, with_repair
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion
from bodycheck.reports.measurement.convergence import Convergence, Criteria, Point, convergence_of
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION, QUANTITIES
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.study import limit
from bodycheck.scenarios.given_motion import GivenMotion
from bodycheck.scenarios.model import Scenario

_TOO_MANY_STEPS = "omega turns the body too far between two samples, as where times are not in s"
_WRONG_ROWS = "some rows are wrong, and without them little is left to explain"
_SAME = 1e-9  # relative difference of two times that count as equal
_PREFERRED = (ORIENTATION, "omega_error", "position_error", "velocity_error")


@dataclass(frozen=True)
class Ranking:
    """Judged files, best first.

    rows: file, dt_s where given, outcome, message and measures, like a row of results.csv, and the last time
    in s that was compared, `compared_until_s`. quantity: the measure that they are ranked by, "" where they
    have none in common. orders: measure -> its convergence over the steps. motions: what was measured, in the
    order of the rows.
    """

    rows: tuple[dict[str, Any], ...]
    quantity: str
    orders: Mapping[str, Convergence]
    motions: tuple[JudgedMotion, ...]

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
        resolved = [_place(motion, self.quantity) for motion in self.motions]
        return [
            resolved.index(place) + 1 if motion.row["outcome"] == "ok" else None
            for motion, place in zip(self.motions, resolved, strict=True)
        ]


def read_files(
    paths: Sequence[Path], column_map: ColumnMap, steps_s: Sequence[float] | None
) -> list[RecordedMotion]:
    """Return what each file has of a motion; steps_s: the intervals between rows of files without times.

    Raises InputError where a file is invalid.
    """
    intervals = [None] * len(paths) if steps_s is None else steps_s
    return [recorded_motion(path, column_map, dt_s) for path, dt_s in zip(paths, intervals, strict=True)]


def of_given_body(
    paths: Sequence[Path], recordings: Sequence[RecordedMotion], body: GivenMotion
) -> tuple[list[RecordedMotion], Scenario]:
    """Return the recordings without what has no start, and the scenario of a body that starts at their rows.

    A position is left out if there is no velocity to start with; omega is derived from the attitudes where
    there is none. A rate of zeros is none where its integral moves. Raises InputError where a file has a
    single row, or neither.
    """
    kept = []
    for path, read in zip(paths, recordings, strict=True):
        if len(read.arrays["t_s"]) < 2:
            raise InputError(f"{path}: has a single row, so nothing to judge")
        has_omega = "omega" in quantities_of(read.arrays) and not read.unfilled("omega")
        recorded = read if has_omega else read.with_omega()
        if recorded is None:
            raise InputError(
                f"{path}: has no angular velocity at which the motion of a body could start, nor three "
                "attitudes from which to derive it; --scenario gives the start"
            )
        arrays, unused = dict(recorded.arrays), recorded.unused_position
        zeros = recorded.unfilled("velocity")
        if "velocity_m_s" not in arrays or zeros:
            arrays.pop("velocity_m_s", None)
            if arrays.pop("position_m", None) is not None:
                unused = zeros or "no velocity"
        kept.append(replace(recorded, arrays=arrays, unused_position=unused))
    ends_s = [float(one.arrays["t_s"][-1]) for one in kept]
    return kept, body.scenario(max(ends_s), len(kept[0].arrays["t_s"]))


def judge_files(
    paths: Sequence[Path],
    recordings: Sequence[RecordedMotion],
    scenario: Scenario,
    scenario_spec: str,
    cache: Cache | None,
    steps_s: Sequence[float] | None,
    start: Start = "scenario",
) -> Ranking:
    """Judge several files of one scenario and rank them by the first error that all have, and that differs.

    recordings: what was read of each. steps_s: the step of each file, from which orders are fitted. start:
    where the truth starts. Raises InputError where a file has nothing to compare, or has times outside the
    scenario's duration, where two steps are the same, and where the files end at different times.
    """
    if steps_s is not None and (twice := [one for one, times in Counter(steps_s).items() if times > 1]):
        raise InputError(f"--dt: the step {twice[0]!r} is given twice")
    problem = Problem.of(scenario, scenario_spec, cache)
    motions = [
        with_repair(path, name, recorded, problem, cache, start)
        for path, name, recorded in zip(paths, _file_names(paths), recordings, strict=True)
    ]
    steps = [{}] * len(motions) if steps_s is None else [{"dt_s": dt_s} for dt_s in steps_s]
    judged = [
        ({"file": str(path), **step_s, **motion.row}, motion)
        for path, motion, step_s in zip(paths, motions, steps, strict=True)
    ]
    ended = [(row, motion) for row, motion in judged if row["outcome"] == "ok"]
    _check_spans({row["file"]: float(motion.problem.truth.trajectory.t_s[-1]) for row, motion in ended})
    common = [name for name in (*_PREFERRED, *MEASURES) if ended and all(name in row for row, _ in ended)]
    ranking = [name for name in common if name in _PREFERRED] or common
    differing = [name for name in ranking if len({_resolved(motion, name) for _, motion in ended}) > 1]
    quantity = next(iter(differing or ranking), "")
    judged.sort(key=lambda one: (one[0]["outcome"] != "ok", _place(one[1], quantity)))
    rows, ranked = zip(*judged, strict=True)
    orders = {} if steps_s is None or len(paths) < 2 else _orders(rows, common, ranked[0].problem)
    return Ranking(rows, quantity, orders, ranked)


def _file_names(paths: Sequence[Path]) -> list[str]:
    """Return the name of each file without its folder, or the paths where two files have the same name."""
    alone = [path.name for path in paths]
    return alone if len({*alone}) == len(paths) else [str(path) for path in paths]


def _place(motion: JudgedMotion, quantity: str) -> tuple[float, ...]:
    """Return the error that files are ranked by, and of equal files those of attitude and omega."""
    return tuple(_resolved(motion, name) for name in (quantity, *TURNING))


def _resolved(motion: JudgedMotion, quantity: str) -> float:
    """Return the error of a file, 0 where it is not told from the truth: the rest is rounding."""
    is_true = quantity not in motion.row or motion.is_true_by(quantity)
    return 0.0 if is_true else float(motion.row[quantity])


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


def examined(
    motion: JudgedMotion, dt_s: float | None, resolution_text: str | None
) -> tuple[Scene, Resolution]:
    """Return what a diagnosis starts from: the scene at the samples of the file, and its resolution.

    Raises InputError where the step does not fit the times, or the resolution states none.
    """
    assert motion.case.trajectory is not None
    resolution, t_s = motion.resolution, motion.case.trajectory.t_s
    if resolution_text is not None:
        resolution = resolution.with_given(resolution_text)
    scene = motion.problem.of_body.scene
    if motion.is_even:
        scene = replace(scene, duration_s=float(t_s[-1]), samples=len(t_s))
    if dt_s is not None:
        _check_step(scene, motion, dt_s)
    return scene, resolution


def explained_motion(
    motion: JudgedMotion, dt_s: float | None, resolution_text: str | None = None
) -> ExplainedCase:
    """Return the diagnosis of a judged recording, which starts from its own rows.

    dt_s: the step of the program that wrote it, None if unknown. resolution_text: what is known of its
    resolution (Resolution.with_given). Raises InputError where the step does not fit the times.
    """
    if motion.part is not None:  # single wrong rows are no part of a motion
        return explained_motion(motion.part, dt_s, resolution_text)
    problem, trajectory = motion.problem, motion.case.trajectory
    assert trajectory is not None
    scene, resolution = examined(motion, dt_s, resolution_text)
    known, found, reason = motion.known, None, "the motion is not finite"
    states = (trajectory.position_m, trajectory.velocity_m_s, trajectory.attitude, trajectory.omega_body)
    is_finite = all(np.isfinite(values).all() for values in states)
    has_only_wrong_rows = is_right_elsewhere(motion)
    if motion.without_omega:  # it follows from the attitudes, so they alone are examined
        known = known - {"omega"}
        found = _of_attitudes(motion, scene, trajectory)
    elif is_finite and not has_only_wrong_rows:
        truth = problem.truth.trajectory
        found = diagnosed_recording(
            scene,
            trajectory,
            truth,
            problem.scales,
            dt_s,
            known=known,
            resolution=resolution,
            is_even=motion.is_even,
            from_first_row=motion.start == "first-sample",
        )
    if found is not None:
        reason = ""
    elif is_finite:
        of_motion = obstacle(scene, trajectory, known) or _TOO_MANY_STEPS
        reason = _WRONG_ROWS if has_only_wrong_rows else of_motion
    setting = {"control": "none" if dt_s is None else "dt", "dt_s": dt_s}
    case = CaseResult({**motion.case.columns, **setting}, MeasuredMotion(trajectory))
    return ExplainedCase(problem, (motion.name,), case, (), found, reason)


def _of_attitudes(motion: JudgedMotion, scene: Scene, trajectory: Trajectory) -> Diagnosis | None:
    """Return what attitudes alone tell: the reading that conserves angular momentum, or that is the truth."""
    attitude, found = trajectory.attitude, None
    if is_free(scene):
        resolution_rad = motion.resolution.attitude
        found = conserving_reading(trajectory.t_s, attitude, scene.body.inertia, resolution_rad)
    truth = motion.problem.truth.trajectory
    return found or attitude_diagnosis(attitude, truth.attitude, motion.floors[ORIENTATION])


def _check_step(scene: Scene, motion: JudgedMotion, dt_s: float) -> None:
    """Raise InputError where the samples of a file do not fit the step."""
    if not motion.is_even:
        raise InputError(f"--dt {dt_s}: needs evenly spaced times that begin at 0")
    try:
        plan_steps(scene, dt_s)
    except ValueError as error:
        raise InputError(f"--dt {dt_s}: {error}") from None
