"""What made a recording: its start, a known map, the exact motion, strapdown integration, or a fault."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from bodycheck.examine.diagnosis.attitude_readings import (
    LARGEST_TURN_RAD,
    attitude_diagnosis,
    turns_between,
)
from bodycheck.examine.diagnosis.candidate_maps import COMMON, EXACT, Base
from bodycheck.examine.diagnosis.diagnosis import (
    ALL,
    LIBRARY_STEPS,
    Diagnosis,
    FittedFault,
    Search,
    bases_for,
    obstacle,
)
from bodycheck.examine.diagnosis.engine_model import ReportedStates
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.tableau_faults import tableau_faults
from bodycheck.examine.diagnosis.faults.wrong_readings import WrongReading, wrong_readings
from bodycheck.examine.diagnosis.quantity_resolution import Resolution
from bodycheck.examine.diagnosis.recording_noise import with_noise
from bodycheck.examine.diagnosis.solver_error import solver_error
from bodycheck.examine.diagnosis.start import StartState, start_difference
from bodycheck.examine.diagnosis.strapdown import strapdown_rules
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps import EXACT as EXACT_MAP
from bodycheck.reference_impl.one_step_maps.one_step_map import Motion, Solid, scene_loads, times
from bodycheck.reference_impl.rotations import normalised
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.scales import Scales

_SLIPS = {fault.name for fault in tableau_faults()}
_STEPLESS = tuple(fault for fault in FAULTS if fault.name not in _SLIPS)
"""The faults that are tried where the step is unknown.

One long step with a misplaced stage or weight is as several short ones of a method of lower order.
"""
_ALIKE = 0.9  # correlation of errors that one map makes, in one step and in several
_FAR, _NEAR = 0.5, 0.2  # relative distance of omega from the turns between the attitudes: misread, meant
_TURN_RAD, _FEWEST = 0.3, 8  # between rows that are compared, and of these intervals
_AS_NEAR = 1.5  # times the least such distance: noise hides which of these readings it is


def diagnosed_recording(
    scene: Scene,
    trajectory: Trajectory,
    truth: Trajectory,
    scales: Scales,
    dt_s: float | None,
    *,
    known: frozenset[str],
    resolution: Resolution,
    is_even: bool,
    from_first_row: bool,
) -> Diagnosis | None:
    """Return what made a recording; None where it cannot be examined.

    scene: with the samples of the recording. truth: at its times. dt_s: the step of the program; None if it
    is unknown or there is none: then the exact motion is tried, and maps with one step per sample. known: the
    quantities that the recording has. is_even: whether the times are those of the scene. from_first_row:
    whether the scene starts where the recording does, so that a wrong reading has moved its start, too. Not
    examined are recordings with an `obstacle`, and those with too many steps between two samples.
    """
    if known & {"attitude", "omega"} == {"attitude"}:
        return attitude_diagnosis(trajectory.attitude, truth.attitude, resolution.attitude)
    if obstacle(scene, trajectory, known):
        return None
    at_start = trajectory.t_s[0] == 0.0
    is_given = at_start and not from_first_row
    start = start_difference(scene, trajectory, known, resolution, {}) if is_given else None

    def with_omega_of(right: Trajectory) -> Diagnosis | None:
        initial = replace(scene.initial, omega_body=right.omega_body[0])
        finer = float(np.linalg.norm(right.omega_body) / np.linalg.norm(trajectory.omega_body))
        return diagnosed_recording(
            replace(scene, initial=initial) if from_first_row else scene,
            right,
            truth,
            scales,
            dt_s,
            known=known,
            resolution=replace(resolution, omega=resolution.omega * finer),
            is_even=is_even,
            from_first_row=from_first_row,
        )

    misread = _of_misread_omega(trajectory, with_omega_of) if known >= {"attitude", "omega"} else None
    if misread is not None:
        return replace(misread, start=start)
    step = dt_s
    if is_even:  # the samples are then where the scene has them, whatever the stamps are rounded to
        resolution, trajectory = replace(resolution, stamp=0.0), replace(trajectory, t_s=scene.sample_times)
        step = scene.sample_interval_s if dt_s is None else dt_s
    from_rows = from_first_row or start is not None or not at_start
    with np.errstate(all="ignore"):
        searched = partial(Search.of, scene, trajectory, scales, step, known)
        faults = _STEPLESS if dt_s is None else FAULTS
        search = searched(resolution, from_rows=from_rows, faults=faults)
        if search is None or (search.fine is None and dt_s is None):
            return None
        found, made_by = _without_fault(search, known, resolution)
        noisy = None if found is not None or search.fine is None else with_noise(search.fine)
        if noisy is not None:
            resolution, noiseless = noisy, search
            start = start_difference(scene, trajectory, known, noisy, {}) if is_given else None
            search = searched(noisy, from_rows=True, faults=faults) or search
            found, made_by = _without_fault(search, known, noisy, noiseless=noiseless)
        if found is None and dt_s is None:
            found, made_by = _of_several_steps(search, known, resolution)
        if found is None:
            found = _with_fault(search, stepped=dt_s is not None)
    if start is not None and made_by is not None and scene.pivot is None:
        later = _later(scene, made_by, step or scene.sample_interval_s, trajectory)
        start = start_difference(scene, trajectory, known, resolution, later)
    return replace(found, start=start, is_within_noise=bool(resolution.noise))


def _of_misread_omega(
    trajectory: Trajectory, of_right: Callable[[Trajectory], Diagnosis | None]
) -> Diagnosis | None:
    """Return the diagnosis of a recording with a wrong reading of omega and at most one other fault, or None.

    An omega in degrees per second turns the body by many radians between two samples, which the steps of the
    search would have to follow. of_right: the diagnosis of the recording with another omega.
    """
    found = []
    for readings, right in omegas_meant(trajectory, _FAR):
        diagnosis = of_right(right)
        if diagnosis is not None and (diagnosis.verdict == "healthy" or _is_one_fault(diagnosis)):
            found.append((readings, diagnosis))
    if not found:
        return None
    fewest = min(len(diagnosis.faults) for _, diagnosis in found)
    (_, rest), *_ = found = [pair for pair in found if len(pair[1].faults) == fewest]
    kinds = {fault.name: fault for fault in FAULTS}
    first, *others = (
        tuple(
            FittedFault(one.name, kinds[one.name].kind, one.text, (), kinds[one.name].confirm)
            for one in readings
        )
        for readings, _ in found
    )
    whole = [(*misread, *rest.faults) for misread in others]  # each alternative is whole
    texts, names = "; and ".join(one.sentence for one in first), tuple(one.name for one in first)
    return replace(
        rest,
        verdict="explained",
        faults=(*first, *rest.faults),
        share=rest.share or 1.0,
        alike=(
            *("; and ".join(one.sentence for one in faults) for faults in whole),
            *(f"{texts}; and {sentence}" for sentence in rest.alike),
        ),
        alike_names=(
            *(tuple(one.name for one in faults) for faults in whole),
            *((*names, *more) for more in rest.alike_names),
        ),
    )


def _is_one_fault(diagnosis: Diagnosis) -> bool:
    """Whether a single fault explains all of a motion."""
    return diagnosis.verdict == "explained" and len(diagnosis.faults) == 1 and diagnosis.share >= ALL


def omegas_meant(
    trajectory: Trajectory, farther: float = 0.0
) -> list[tuple[tuple[WrongReading, ...], Trajectory]]:
    """Return the wrong readings of omega that bring it near the turns between the attitudes, and the motions.

    If none does, two of them: other axes, and another unit.

    farther: a relative distance from these turns; of an omega that is nearer, none is returned.
    """
    attitude = normalised(trajectory.attitude)
    apart = _rows_apart(attitude)
    turns = turns_between(attitude[::apart])
    some = np.linalg.norm(turns, axis=-1) < LARGEST_TURN_RAD
    size, intervals_s = np.linalg.norm(turns[some]), np.diff(trajectory.t_s)[:, None]

    def distance(one: Trajectory) -> float:
        omega = one.omega_body
        sums = np.cumsum(0.5 * (omega[:-1] + omega[1:]) * intervals_s, axis=0)
        gaps = np.diff(np.vstack([np.zeros(3), sums])[::apart], axis=0) - turns
        return float(np.linalg.norm(gaps[some]) / size)

    if size == 0.0 or (before := distance(trajectory)) < farther:
        return []
    near = _NEAR * min(before / _FAR, 1.0)
    for readings in ([(one,) for one in wrong_readings("w")], _axes_and_units()):
        meant = [(some, _undone(some, trajectory)) for some in readings]
        gaps = [distance(right) for _, right in meant]
        if (least := min(gaps)) < near:
            within = min(near, _AS_NEAR * least)
            return [one for one, gap in zip(meant, gaps, strict=True) if gap <= within]
    return []


def _rows_apart(attitude: Array) -> int:
    """Return after how many rows a body turns by more than attitudes are noisy, but not far."""
    turn = float(np.median(np.linalg.norm(turns_between(attitude), axis=-1))) if len(attitude) > 1 else 0.0
    most = max((len(attitude) - 1) // _FEWEST, 1)
    return max(int(min(_TURN_RAD / turn, most)), 1) if turn > 0.0 else 1


def _axes_and_units() -> list[tuple[WrongReading, ...]]:
    """Return the pairs of a wrong reading of the axes of omega and one of its unit."""
    readings = wrong_readings("w")
    units = [one for one in readings if one.name == "omega-read-scaled"]
    return [(axes, unit) for axes in readings if axes not in units for unit in units]


def _undone(readings: Sequence[WrongReading], trajectory: Trajectory) -> Trajectory:
    """Return the recording with the omega that was meant."""
    world = trajectory.omega_body_rad_s is None
    omega = trajectory.omega_world if world else trajectory.omega_body
    none = np.zeros((3, 1))
    read = ReportedStates(none, none, normalised(trajectory.attitude).T, omega.T)
    for one in readings:
        read = one.undo(read, world_omega=world)
    right = read.w.T
    if world:
        return replace(trajectory, omega_world_rad_s=right)
    return replace(trajectory, omega_body_rad_s=right, omega_world_rad_s=None)


def _without_fault(
    search: Search, known: frozenset[str], resolution: Resolution, noiseless: Search | None = None
) -> tuple[Diagnosis | None, Base | None]:
    """Return the diagnosis of a motion without a fault, and the map that made it.

    noiseless: the search with the digits of the file, where `search` has its noise: an attitude follows to
    these digits from the omega that it is integrated from, however noisy that is.
    """
    some = search.own or search.fine
    exactly = some if noiseless is None else noiseless.own or noiseless.fine
    assert some is not None
    assert exactly is not None
    within = resolution.text(known) if some.is_coarse else ""
    is_exact = search.fine is not None and search.is_healthy(EXACT)
    # the noise of a recording hides the differences between most maps
    matches = [] if is_exact and resolution.noise else list(search.matches)
    if is_exact:
        matches.insert(0, EXACT)
    if matches:
        first, *others = matches
        names = tuple(base.name for base in others)
        healthy = Diagnosis("healthy", first.name, first.text, within=within, equal_maps=names)
        return healthy, first
    if search.fine is not None and search.fine.scene.pivot is None:
        omega = search.fine.of_quantities(frozenset({"omega"}))
        rules = strapdown_rules(exactly) if "attitude" in known else []
        if rules and Search(None, omega).is_healthy(EXACT) and _translates_as_stated(search, known):
            words = f"{rules[0].name}, {rules[0].formula}, of order {rules[0].order}"
            names = tuple(rule.name for rule in rules[1:])
            return Diagnosis("strapdown", rules[0].name, words, within=within, equal_maps=names), None
    return None, None


def _translates_as_stated(search: Search, known: frozenset[str]) -> bool:
    """Whether the exact motion or a common map explains positions and velocities, if there are any."""
    moved = known & {"position", "velocity"}
    if not moved:
        return True
    own, fine = (None if one is None else one.of_quantities(moved) for one in (search.own, search.fine))
    bases = (EXACT,) if own is None else COMMON.values()
    return any(Search(own, fine).is_healthy(base) for base in bases)


def _of_several_steps(
    search: Search, known: frozenset[str], resolution: Resolution
) -> tuple[Diagnosis | None, Base | None]:
    """Return the diagnosis of a map with several steps per sample, and the map; None where none is seen.

    n steps of a map of order p leave 1 / n^p of the error that one step of the same length leaves.
    """
    own, fine = search.own, search.fine
    if own is None or fine is None:
        return None, None
    errors = fine.healthy_gaps(EXACT)[0, fine.rows].ravel()
    tried: set[int] = set()
    for base in COMMON.values():
        of_one = errors - own.healthy_gaps(base)[0, own.rows].ravel()
        size, along = float(np.linalg.norm(of_one)), float(errors @ of_one)
        if not _ALIKE * size * float(np.linalg.norm(errors)) <= along < size**2:
            continue
        steps = round((size**2 / along) ** (1.0 / base.order))
        for count in {steps - 1, steps, steps + 1}.intersection(range(2, LIBRARY_STEPS + 1)) - tried:
            tried.add(count)
            found, made_by = _without_fault(search.with_steps(count), known, resolution)
            if found is not None:
                words = f"{found.base_words}, with {count} steps per sample"
                return replace(found, base_words=words), made_by
    return None, None


def _with_fault(search: Search, *, stepped: bool) -> Diagnosis:
    """Return the diagnosis of a motion that no map and not quite the exact flow makes."""
    left = None if search.fine is None else solver_error(search.fine)
    exact, has_noise = None, search.fine is not None and bool(search.fine.resolution.noise)
    if left is not None and left.is_small and not has_noise:  # which is larger than errors of solvers
        exact = Diagnosis("healthy", EXACT.name, "the exact flow", per_sample=left.size)
        if not left.has_structure and not (left.is_rounding and stepped):
            return exact
    found = search.diagnosis(bases_for(None) if stepped else (EXACT,), (), None)
    if search.own is not None and not stepped and len(found.faults) != 1:
        # as without a fault, maps with one step per sample are tried
        one = search.diagnosis(bases_for(None), (), None)
        if one.verdict == "explained" and one.after <= search.own.limit:
            return one
    # the errors of a method of many steps are smooth, too, but then there is no step to name
    is_like_solver = left is not None and not left.is_one_sided and not (stepped and left.is_smooth)
    if found.verdict == "unexplained" and not found.nearly and exact is not None and is_like_solver:
        return exact
    return found


def _later(scene: Scene, base: Base, dt_s: float, trajectory: Trajectory) -> dict[str, StartState]:
    """Return what a log may begin with: the state after the first step, or after the first interval."""
    initial, world = scene.initial, trajectory.omega_body_rad_s is None
    one = EXACT_MAP if base.one is None else base.one
    stride = max(round(scene.sample_interval_s / dt_s), 1)
    loads = scene_loads(replace(scene, duration_s=scene.sample_interval_s, samples=2))
    motion = Motion(
        np.zeros(1),
        initial.position[None],
        initial.velocity[None],
        normalised(initial.quaternion)[None],
        initial.omega_body[None],
        rotation=None if trajectory.quaternion is not None else initial.rotation[None],
    )
    found = {}
    for step in range(1, stride + 1):
        motion = one.step(Solid.of(scene.body), motion, np.full(1, dt_s), loads)
        state = _start_of(motion, world=world)
        if step == 1:
            found["row k holds the state after step k + 1: the whole log is one step late"] = state
        if step == stride > 1:
            found["row k holds the state of row k + 1: the whole log is one row late"] = state
    return found


def _start_of(motion: Motion, *, world: bool) -> StartState:
    omega: Array = times(motion.orthogonal, motion.omega) if world else motion.omega
    return StartState(motion.position[0], motion.velocity[0], normalised(motion.quaternion)[0], omega[0])
