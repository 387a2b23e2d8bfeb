"""One recording, measured against the truth of its scenario."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from pydantic import ValidationError

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number
from bodycheck.adapters.stable_step import invalid_state
from bodycheck.examine.diagnosis.quantity_resolution import Resolution
from bodycheck.recordings.conversion import RecordedMotion
from bodycheck.recordings.first_sample import start_bound_rad, started_at_first_sample
from bodycheck.recordings.row_noise import RowNoise, row_noise
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.rotations import geodesic_angle, matrix_to_quaternion, project_to_so3, rotate
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion, stable_motion
from bodycheck.reports.measurement.compared_motion import Compared, EnergyAndMomentum
from bodycheck.reports.measurement.invariants import invariants_of, worst_drift
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS
from bodycheck.reports.measurement.measures import (
    MEASURES,
    ORIENTATION,
    SCALES,
    departures_of,
    reduced,
    series_of,
)
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.scales import Scales
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import fault_lines

Start: TypeAlias = Literal["scenario", "first-sample"]
"""Where the truth of a recording starts: at the start of the scenario, or at the first row of the file."""

FROM_START = "_from_start"
"""Suffix of an energy drift relative to the first sample of the file, instead of relative to the truth."""

TURNING = (ORIENTATION, "omega_error")
"""The errors by which a turning motion is the true one."""

TRAVELLING = ("position_error", "velocity_error")
"""The errors by which the path of the centre of mass is the true one."""

QUANTITY_OF = {
    ORIENTATION: "attitude",
    "omega_error": "omega",
    "position_error": "position",
    "velocity_error": "velocity",
}
"""Error -> the quantity that it is of."""

NEGLIGIBLE = 1e-6
"""Relative: smaller changes of a conserved quantity, and errors of the path, are not stated alone."""

VAGUE = 0.1
"""In rad, or relative: what a file resolves no better says nothing about the motion."""

_LARGEST, _OF_ONE = 4.0, 3.0  # deviations of noise: of some thousand rows, and of a single one
_REDUNDANT = 1e-3  # difference in rad, or relative, of what a file states twice: more than rounding
_HALF_SPACING = 0.5 * math.sqrt(3.0)  # the error of a rounded vector, per spacing of its components


@dataclass(frozen=True)
class MomentumChange:
    """max ||L| - |L'|| over max |L'|, and the largest angle between L and L', in rad.

    L' is L of the first row where no load acts, otherwise that of the truth.
    """

    size: float
    direction_rad: float


@dataclass(frozen=True, eq=False)
class Repair:
    """What is wrong with the rows of a recording, where nothing else is, and the motion without it.

    first_rows: measure -> the row of the file at which it begins.
    """

    wrong: str
    first_rows: Mapping[str, int]
    motion: JudgedMotion


@dataclass(frozen=True, eq=False)
class JudgedMotion:
    """A recording with the truth at its samples.

    name: what sentences and figures call its file. row: its columns, like those of results.csv, without the
    file. problem: the scenario as it started, and
    the truth at the samples of the file. case: the columns and the motion, with the measures over time where
    it is stable. known: which of position, velocity, attitude and omega the file has. resolution: of these.
    momentum: its largest changes, None where the file has no attitude or omega. energy: the largest change of
    the rotational energy since the first row, with its sign, over the largest of the truth, None without
    omega. floors: measure -> what the truth and the digits of the file leave open, relative as the
    measure is. noise: of the quantities that have it. start: where the truth starts. without_omega,
    unused_position, assumed: of the recording. is_omega_misread: whether omega is read wrongly, and the
    truth starts at the one that was meant. repaired: the same without what is wrong with its rows, where
    nothing else is. part: its longest part without single wrong rows, where more is wrong.
    """

    name: str
    row: dict[str, Any]
    problem: Problem
    case: CaseResult
    known: frozenset[str]
    resolution: Resolution
    momentum: MomentumChange | None
    energy: float | None
    floors: Mapping[str, float]
    noise: Mapping[str, RowNoise]
    start: Start
    without_omega: str = ""
    unused_position: str = ""
    assumed: str = ""
    is_omega_misread: bool = False
    repaired: Repair | None = None
    part: JudgedMotion | None = None

    @property
    def is_true(self) -> bool:
        """Whether the motion is the true one, to what the file and the truth resolve."""
        compared = [name for name in TURNING if name in self.row]
        return bool(compared) and all(map(self.is_true_by, compared)) and not self.path_errors

    @property
    def is_even(self) -> bool:
        """Whether the times are evenly spaced from 0, to their resolution, so that steps may fit them."""
        t_s = self.case.trajectory.t_s if self.case.trajectory is not None else np.zeros(0)
        if len(t_s) < 2:
            return False
        even = np.arange(len(t_s)) * t_s[-1] / (len(t_s) - 1)
        return np.allclose(t_s, even, rtol=0.0, atol=max(1e-9 * float(t_s[-1]), self.resolution.stamp))

    @property
    def path_errors(self) -> tuple[str, ...]:
        """The errors by which the path is not the true one; none where what is left open is not known."""
        measured = (name for name in TRAVELLING if name in self.row and name in self.floors)
        return tuple(name for name in measured if self.row[name] > max(NEGLIGIBLE, self.floor(name)))

    def is_true_by(self, measure: str) -> bool:
        """Whether a measure is within its floor, and that is small enough to tell."""
        return self.is_at_floor(measure) and self.floors.get(measure, 0.0) <= VAGUE

    def floor(self, measure: str) -> float:
        """Return what the truth and the digits of the file leave open."""
        return FLOOR_BOUNDS * self.floors.get(measure, 0.0)

    @cached_property
    def noisy(self) -> Mapping[str, float]:
        """Floors with the noise in place of the digits, of the start to first order; none without noise."""
        if not self.noise:
            return {}
        bound, problem = self.row["truth_bound_rad"], self.problem
        if self.start == "first-sample":
            times, one = problem.times[: problem.compared], self._within_noise(_OF_ONE)
            bound += float(np.max(start_bound_rad(problem.of_body.scene, times, one, None)))
        most = self._within_noise(_LARGEST)
        floors = _floors({**self.row, "truth_bound_rad": bound}, problem, most, self.start)
        return {name: floor * (FLOOR_BOUNDS if name in TRAVELLING else 1.0) for name, floor in floors.items()}

    def _within_noise(self, deviations: float) -> Resolution:
        """Return the resolution of numbers that are rounded by so many deviations of the noise."""
        spacings: dict[str, Any] = {
            name: 2.0 * deviations * one.deviation for name, one in self.noise.items()
        }
        return replace(self.resolution, **spacings)

    def is_noise(self, measure: str) -> bool:
        """Whether a measure is within what the noise of the rows, and of the first one, makes."""
        return bool(self.row[measure] <= self.noisy.get(measure, 0.0))

    def is_at_floor(self, measure: str) -> bool:
        """Whether a measure is within its floor."""
        return bool(self.row[measure] <= self.floor(measure))


def judged_motion(
    path: Path,
    name: str,
    recorded: RecordedMotion,
    problem: Problem,
    cache: Cache | None,
    start: Start,
    meant: Trajectory | None = None,
) -> JudgedMotion:
    """Measure a recording.

    name: what sentences and figures call the file. problem: the scenario at its own samples. start: where the
    truth starts. meant: the motion whose first sample that is, if not that of the file. Raises InputError
    where nothing can be compared, times lie outside the scenario's duration, or the file contradicts itself.
    """
    arrays, known = recorded.arrays, frozenset(quantities_of(recorded.arrays))
    resolution = Resolution.of(recorded.resolution)
    t_s = arrays["t_s"]
    _check(path, t_s, known, problem.of_body)
    scenario, scales = problem.of_body, problem.scales
    if start == "first-sample":
        if meant is None:
            meant = _completed(arrays, known_truth(scenario.scene, t_s, cache).trajectory)
        try:
            scenario = started_at_first_sample(scenario, meant, known)
        except ValidationError as error:
            raise InputError(f"{path}: the first row: {fault_lines(error)[0]}") from None
        scales = Problem.of(scenario, problem.scenario_spec, cache).scales
    scene = scenario.scene
    truth = known_truth(scene, t_s, cache)
    trusted = t_s < truth.trusted_until_s
    if not trusted[0]:
        raise InputError(f"{path}: the truth ends before the first time in t_s: {truth.end_reason}")
    bound_rad = truth.bound_rad
    if start == "first-sample":
        bound_rad = bound_rad + start_bound_rad(scene, t_s, resolution, cache)
    columns: dict[str, Any] = {
        "scenario": scenario.name,
        "outcome": "ok",
        "message": "",
        "truth": truth.kind,
        "truth_bound_rad": float(bound_rad[trusted].max()),
    }
    if resolution.stamp:
        columns["stamp_spacing_s"] = resolution.stamp
        columns["truth_bound_rad"] += resolution.stamp * largest_norm(truth.trajectory.omega_body[trusted])
    trajectory = _completed(arrays, truth.trajectory)
    true = EnergyAndMomentum.of(scene, truth.trajectory)
    at_samples = Problem(scenario, truth, true, scales, problem.scenario_spec, int(np.count_nonzero(trusted)))
    motion = stable_motion(scene, trajectory, true, from_own_start=True)
    if isinstance(motion, str):
        if recorded.without_omega:  # lost a sample before the attitude that it is derived from
            still = replace(trajectory, omega_body_rad_s=np.zeros_like(trajectory.omega_body))
            motion = invalid_state(still) or motion
        columns |= {"outcome": "unstable", "message": motion}
        case = CaseResult({**columns, **_identity(name)}, MeasuredMotion(trajectory))
        return JudgedMotion(name, columns, at_samples, case, known, resolution, None, None, {}, {}, start)
    _check_redundant(path, trajectory)
    if not trusted.all():
        until = f"t = {truth.trusted_until_s:.6g} s"
        columns["message"] = f"compared until {until}, where the truth ends: {truth.end_reason}"
    columns["compared_until_s"] = float(t_s[trusted][-1])
    invariants = [one for one in invariants_of(scene) if one.needs <= known]
    compared = Compared(
        scene, truth.trajectory, true, trajectory, motion, invariants, until=at_samples.compared
    )
    departures = departures_of(compared)
    if "quaternion" in recorded.computed:
        departures.pop("quaternion_norm_error", None)
    series = {
        name: values[: compared.until]
        for name, values in series_of(compared, departures).items()
        if MEASURES[name].needs(scene) <= known
    }
    worst = worst_drift(compared.invariant_drifts)
    columns |= reduced(series, departures, scales)
    columns |= _drifts_from_start(series, departures, compared.until, scales)
    columns |= worst.columns if worst else {}
    case = CaseResult({**columns, **_identity(name)}, MeasuredMotion(trajectory, series))
    return JudgedMotion(
        name,
        columns,
        at_samples,
        case,
        known,
        resolution,
        _momentum_change(compared) if {"attitude", "omega"} <= known else None,
        _energy_change(compared) if "omega" in known else None,
        _floors(columns, at_samples, resolution, start),
        _noise(at_samples, trajectory, known, resolution),
        start,
        recorded.without_omega,
        recorded.unused_position,
        recorded.assumed,
    )


def _identity(name: str) -> dict[str, Any]:
    """Return the columns that identify a file where a case has its engine, method and step."""
    return {"engine": name, "method": "", "control": "none", "dt_s": None, "tolerance": None}


def _check(path: Path, t_s: Array, known: frozenset[str], scenario: Scenario) -> None:
    if not known:
        raise InputError(
            f"{path}: omega in world axes needs an attitude to be compared: qw, qx, qy, qz, or r00 to r22"
        )
    if t_s[0] < 0.0 or t_s[-1] > scenario.duration_s * (1.0 + 1e-12):
        hint = "; --map time_origin=first-sample subtracts the first time"
        raise InputError(
            f"{path}: t_s must lie between 0 and the duration, {scenario.duration_s!r} s, but goes from "
            f"{float(t_s[0])!r} to {float(t_s[-1])!r}{hint * bool(t_s[-1] - t_s[0] <= scenario.duration_s)}"
        )


def is_free(scene: Scene | TreeScene) -> bool:
    """Whether no torque acts, so that angular momentum and rotational energy are conserved."""
    return isinstance(scene, Scene) and not scene.loads and scene.pivot is None


def _momentum_change(compared: Compared) -> MomentumChange:
    momentum = compared.motion.angular_momentum[: compared.until]
    true = compared.true.angular_momentum[: compared.until]
    if is_free(compared.scene):
        true = np.broadcast_to(momentum[0], momentum.shape)
    sizes, true_sizes = np.linalg.norm(momentum, axis=-1), np.linalg.norm(true, axis=-1)
    largest = float(np.max(true_sizes))
    if largest == 0.0:
        return MomentumChange(0.0, 0.0)
    across, along = np.linalg.norm(np.cross(momentum, true), axis=-1), np.sum(momentum * true, axis=-1)
    return MomentumChange(
        float(np.max(np.abs(sizes - true_sizes))) / largest, float(np.max(np.arctan2(across, along)))
    )


def _energy_change(compared: Compared) -> float:
    energy = compared.motion.rotational[: compared.until]
    change, largest = energy - energy[0], float(np.max(compared.true.rotational[: compared.until]))
    return float(change[np.argmax(np.abs(change))]) / largest if largest > 0.0 else 0.0


def _floors(
    columns: Mapping[str, Any], problem: Problem, resolution: Resolution, start: Start
) -> dict[str, float]:
    """Return what the bounds of the truth and the rounding of the samples, and of the start, leave open."""
    truth, n = problem.truth, problem.compared
    times = 2.0 if start == "first-sample" else 1.0  # the start is rounded as every sample is
    angle, omega = times * _HALF_SPACING * resolution.attitude, times * _HALF_SPACING * resolution.omega
    momentum = float(np.max(np.linalg.norm(problem.motion.angular_momentum[:n], axis=-1)))
    energy = float(np.max(problem.motion.rotational[:n]))
    speed = largest_norm(truth.trajectory.omega_body[:n])
    largest_moment = float(np.linalg.norm(rotational_inertia(problem.of_body.scene), 2))
    of_momentum = float(np.max(truth.bound_momentum[:n]))
    of_energy = float(np.max(truth.bound_energy[:n]))
    found = {ORIENTATION: columns["truth_bound_rad"] + _HALF_SPACING * resolution.attitude}
    found |= dict.fromkeys(("quaternion_norm_error", "orthogonality_error"), resolution.attitude)
    if momentum > 0.0:
        found["angular_momentum_drift"] = of_momentum + largest_moment * omega / momentum + angle
    if energy > 0.0:
        found["rotational_energy_drift"] = found["energy_drift"] = of_energy + momentum * omega / energy
    if speed > 0.0:
        bound = float(np.max(truth.bound_omega_rad_s[:n])) / speed
        turned = columns["truth_bound_rad"] - float(np.max(truth.bound_rad[:n]))
        found["omega_error"] = bound + omega / speed + turned
    return found | _path_floors(columns["truth_bound_rad"], problem, resolution, start)


def _noise(
    problem: Problem, path: Trajectory, known: frozenset[str], resolution: Resolution
) -> dict[str, RowNoise]:
    """Return the noise of each quantity that a recording has, and whose rows have more than its digits."""
    truth, n = problem.truth.trajectory, problem.compared
    found = {name: row_noise(name, path, truth, n, getattr(resolution, name)) for name in sorted(known)}
    return {
        name: one
        for name, one in found.items()
        if one is not None and one.deviation > getattr(resolution, name)
    }


def _path_floors(
    turned_rad: float, problem: Problem, resolution: Resolution, start: Start
) -> dict[str, float]:
    """Return what truth and digits leave open of position and velocity, relative as the measures are.

    A rounded start moves the path in time, and by turned_rad the forces in body axes. Nothing is known where
    it changes the forces otherwise, by a pivot or by loads that depend on the path.
    """
    scene, truth, n = problem.of_body.scene, problem.truth, problem.compared
    if scene.pivot is not None or scene.continuous_loads:
        return {}
    t_s, speeds = truth.trajectory.t_s[:n], truth.trajectory.velocity_m_s[:n]
    elapsed, pushed = float(t_s[-1] - t_s[0]), 0.0
    if scene.loads and n > 1:
        pushed = largest_norm(np.gradient(speeds, t_s, axis=0) - scene.gravity) * turned_rad
    # the bounds of rounding are strict, and those of the truth an estimate, of which FLOOR_BOUNDS are allowed
    spacings = np.array([resolution.position, resolution.velocity])
    rounded_m, rounded_m_s = (_HALF_SPACING / FLOOR_BOUNDS * spacings).tolist()
    stamp_s = resolution.stamp / FLOOR_BOUNDS
    position = float(np.max(truth.bound_m[:n])) + rounded_m + stamp_s * largest_norm(speeds)
    velocity = float(np.max(truth.bound_m_s[:n])) + rounded_m_s
    velocity += stamp_s * float(np.linalg.norm(scene.gravity))
    if start == "first-sample":
        position += rounded_m + (rounded_m_s + 0.5 * pushed * elapsed) * elapsed
        velocity += rounded_m_s + pushed * elapsed
    scales = problem.scales
    left_open = ((position, scales.length_scale_m), (velocity, scales.speed_scale_m_s))
    return {
        name: error / scale for name, (error, scale) in zip(TRAVELLING, left_open, strict=True) if scale > 0.0
    }


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


def quantities_of(arrays: dict[str, Array]) -> set[str]:
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
