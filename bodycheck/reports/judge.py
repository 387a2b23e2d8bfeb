"""Judge a trajectory written by any program, with all measures that its quantities allow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.measurement.case import stable_motion
from bodycheck.reports.measurement.invariants import invariants_of, worst_drift
from bodycheck.reports.measurement.measures import (
    MEASURES,
    Compared,
    Motion,
    departures_of,
    reduced,
    series_of,
)
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.trajectory_files import read_arrays
from bodycheck.scenarios.model import Scenario


def judge_file(path: Path, scenario: Scenario, scenario_spec: str, cache: Cache | None) -> dict[str, Any]:
    """Return outcome, message and measures of the trajectory in a file, like a row of results.csv.

    Raises InputError where the file is invalid or its times are outside the scenario's duration.
    """
    arrays = read_arrays(path)
    scene, t_s = scenario.scene, arrays["t_s"]
    if t_s[0] < 0.0 or t_s[-1] > scenario.duration_s * (1.0 + 1e-12):
        raise InputError(f"{path}: t_s must lie between 0 and the duration, {scenario.duration_s!r} s")
    scales = Problem.of(scenario, scenario_spec, cache).scales
    truth = known_truth(scene, t_s, cache)
    trusted = t_s < truth.trusted_until_s
    if not trusted[0]:
        raise InputError(f"{path}: the truth ends before the first time in t_s: {truth.end_reason}")
    columns: dict[str, Any] = {
        "scenario": scenario.name,
        "outcome": "ok",
        "message": "",
        "truth": truth.kind,
        "truth_bound_rad": float(truth.bound_rad[trusted].max()),
    }
    trajectory = _completed(arrays, truth.trajectory)
    true = Motion.of(scene, truth.trajectory)
    motion = stable_motion(scene, trajectory, true)
    if isinstance(motion, str):
        return {**columns, "outcome": "unstable", "message": motion}
    if not trusted.all():
        until = f"t = {truth.trusted_until_s:.6g} s"
        columns["message"] = f"compared until {until}, where the truth ends: {truth.end_reason}"
    had = _quantities(arrays)
    kept = [one for one in invariants_of(scene) if one.needs <= had]
    compared = Compared(
        scene, truth.trajectory, true, trajectory, motion, kept, until=int(np.count_nonzero(trusted))
    )
    series = series_of(compared, departures_of(compared))
    founded = {
        name: values[: compared.until]
        for name, values in series.items()
        if MEASURES[name].needs(scene) <= had
    }
    worst = worst_drift(compared.invariant_drifts)
    return columns | reduced(founded, scales) | (worst.columns if worst else {})


def _quantities(arrays: dict[str, Array]) -> set[str]:
    """Return which of position, velocity, attitude and omega (in body axes) a trajectory has."""
    had = {name for name in ("position", "velocity") if any(key.startswith(name) for key in arrays)}
    if "quaternion" in arrays or "rotation" in arrays:
        had.add("attitude")
    if "omega_body_rad_s" in arrays or ("omega_world_rad_s" in arrays and "attitude" in had):
        had.add("omega")
    return had


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
