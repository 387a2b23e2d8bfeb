"""Check what `judge --explain` says about recordings: healthy ones of maps and solvers, and those of faults.

    python tools/recording_trials.py healthy --trials 300 --seed 1
    python tools/recording_trials.py faults --digits 17 9 6 --seed 1

healthy: maps of the reference and solvers of SciPy on five scenes, written with 17, 9, 6 or 4 digits or as
float32, with the scenario's start or one that is off by 1e-6 to 1 rad/s. Counts accusations, and the maps
that are named, alone where the second nearest map is 30 resolutions away. faults: every fault of the
catalogue on a scene where it applies, with the written digits; counts those that are named, or listed among
equals, where the fault moves the log by 30 resolutions, the intervals that contain the planted parameters,
and their widths over those of Cramer and Rao.

Exit status 1 below 95 % of names, below 90 % of intervals, or with an accusation.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from itertools import count, pairwise, product
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from trials import command

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.examine.diagnosis.candidate_maps import BASES, Base, Flow, States
from bodycheck.examine.diagnosis.diagnosis import Diagnosis
from bodycheck.examine.diagnosis.engine_model import Grid, ReportedStates, matrix_of
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import Fault, FaultContext
from bodycheck.examine.diagnosis.fit import planted
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import normalised, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import wrench_between
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.problem import Problem
from bodycheck.runs import runner
from bodycheck.scenarios.library import load_scenario
from bodycheck.scenarios.model import Scenario

_BODY = """
mass_kg = 2.0
inertia_kg_m2 = [[0.05, 0.004, -0.003], [0.004, 0.07, 0.006], [-0.003, 0.006, 0.09]]
[initial]
quaternion = [0.6, 0.0, 0.8, 0.0]
velocity_m_s = [0.2, 0.0, 0.1]
"""
_NEARLY_ROUND = """
mass_kg = 2.0
inertia_kg_m2 = [[0.05, 0.0003, -0.0002], [0.0003, 0.051, 0.0004], [-0.0002, 0.0004, 0.052]]
[initial]
"""
_GRAVITY = 'kind = "gravity", acceleration_m_s2 = '
_TORQUE = 'kind = "torque", axes = "body", value_n_m = [0.05, -0.04, 0.06]'
_WORLD_TORQUE = 'kind = "torque", axes = "world", value_n_m = '
_FORCE = 'kind = "force", axes = "body", value_n = [0.3, 0.2, 1.0], at_m = [0.05, -0.02, 0.1]'
_WORLD_FORCE = 'kind = "force", axes = "world", value_n = [0.5, -0.4, 0.8], at_m = [0.03, 0.06, -0.05]'
_DRAG = (
    'kind = "drag", linear_n_s_m = 0.5, '
    "angular_n_m_s = [[0.02, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, 0.04]]"
)
SCENES: dict[str, tuple[str, ...]] = {
    "free": ("[1.0, -2.0, 3.0]",),
    "unstable-axis": ("[0.2, 4.0, 0.1]",),
    "body-torque": ("[1.0, -2.0, 3.0]", _TORQUE),
    "thrown": ("[1.5, 1.0, -2.0]", f"{_GRAVITY}[0.0, 0.0, -9.81]", _FORCE),
    "world-loads": (
        "[-1.0, 2.0, 1.0]",
        f"{_WORLD_TORQUE}[0.03, 0.05, -0.04], from_s = 0.3, until_s = 1.2",
        _WORLD_FORCE,
    ),
}
"""The scenes, each of 2 s with 201 samples: omega in body axes at the start, and the loads."""
FURTHER: dict[str, tuple[str, ...]] = {
    "all-loads": (
        "[0.8, -1.2, 0.5]",
        f"{_GRAVITY}[1.0, -2.0, -9.0]",
        f"{_TORQUE}, until_s = 0.7",
        f"{_WORLD_TORQUE}[-0.03, 0.05, 0.04], from_s = 0.4, until_s = 1.1",
        f"{_FORCE}, from_s = 0.8, until_s = 1.6",
        f"{_WORLD_FORCE}, from_s = 1.2",
    ),
    "fast": ("[60.0, -40.0, 30.0]",),
    "drag": ("[1.0, -2.0, 3.0]", _DRAG),
}
"""Further scenes of that length, for the faults that act on none of the others; `fast` is nearly round."""
MAPS = {
    "m1": "M1",
    "m2": "M2",
    "quaternion-euler": "M1, pose from the old omega, additive quaternion",
    "lie-euler": "Buss 2000, order 1",
    "euler": "Buss 2000, order 1, additive matrix",
    "rk4": "RK4",
}
"""Method of the reference -> how the name of its map begins."""
SOLVERS = {"RK45": 1e-5, "DOP853": 1e-8, "LSODA": 1e-7}
RESOLUTIONS = ("17", "9", "6", "4", "float32")
OFF_BY = (0.0, 0.0, 1e-6, 1e-4, 1e-2, 1.0)
DURATION_S, SAMPLES = 2.0, 201


def scenario_of(name: str, folder: Path) -> Scenario:
    """Return one of the scenes."""
    path = folder / f"{name}.toml"
    omega, *loads = (SCENES | FURTHER)[name]
    head = f'name = "{name}"\nduration_s = {DURATION_S}\nsamples = {SAMPLES}\n'
    forcing = f"forcing = [{', '.join(f'{{ {load} }}' for load in loads)}]\n"
    body = f"[body]{_NEARLY_ROUND if name == 'fast' else _BODY}omega_body_rad_s = {omega}\n"
    path.write_text(head + forcing + body, encoding="utf-8")
    return load_scenario(path)


def solved(scene: Scene, solver: str, tolerance: float) -> Trajectory:
    """Return the motion that a solver of SciPy gives, its dense output at the samples."""
    inertia, mass = scene.body.inertia, scene.body.mass

    def rates(t: float, y: Array) -> Array:
        velocity, q, omega = y[3:6], y[6:10], y[10:13]
        rotation = quaternion_to_matrix(q)
        wrench = wrench_between(scene, t, t + 1e-9)
        force = wrench.force_world + mass * scene.gravity + rotation @ wrench.force_body
        torque = wrench.torque_body + rotation.T @ wrench.torque_world
        for at, push in wrench.point_forces:
            force, torque = force + push, torque + np.cross(at, rotation.T @ push)
        turned = 0.5 * quaternion_product(q, np.r_[0.0, omega])
        spun = np.linalg.solve(inertia, torque - np.cross(omega, inertia @ omega))
        return np.concatenate([velocity, force / mass, turned, spun])

    start = scene.initial
    y = np.concatenate([start.position, start.velocity, normalised(start.quaternion), start.omega_body])
    switches = [0.0, *scene.switches_before(scene.duration_s), scene.duration_s]
    t_s, states = scene.sample_times, []
    for index, (begin, end) in enumerate(pairwise(switches)):
        last = index == len(switches) - 2
        at = t_s[(t_s >= begin) & ((t_s < end) | last)]
        found = solve_ivp(rates, (begin, end), y, solver, [*at, *([] if last else [end])],
                          rtol=tolerance, atol=1e-2 * tolerance)  # fmt: skip
        states.append(found.y.T[: len(at)])
        y = found.y[:, -1]
    made = np.concatenate(states)
    return Trajectory(t_s, made[:, :3], made[:, 3:6], quaternion=made[:, 6:10], omega_body_rad_s=made[:, 10:])


def written(path: Path, motion: Trajectory, resolution: str, *, translation: bool) -> float:
    """Write a motion with so many digits; return the largest spacing of its numbers.

    resolution: decimals, 17 for all digits, or float32.
    """
    columns: dict[str, Array] = {"t_s": motion.t_s}
    if translation:
        columns |= dict(zip(("x_m", "y_m", "z_m"), motion.position_m.T, strict=True))
        columns |= dict(zip(("vx_m_s", "vy_m_s", "vz_m_s"), motion.velocity_m_s.T, strict=True))
    if motion.quaternion is not None:
        columns |= dict(zip(("qw", "qx", "qy", "qz"), motion.quaternion.T, strict=True))
    else:
        assert motion.rotation is not None
        names = [f"r{i}{j}" for i in range(3) for j in range(3)]
        columns |= dict(zip(names, motion.rotation.reshape(-1, 9).T, strict=True))
    omega, axes = motion.omega_body_rad_s, "body"
    if omega is None:
        omega, axes = motion.omega_world_rad_s, "world"
    assert omega is not None
    columns |= {f"w{name}_{axes}_rad_s": part for name, part in zip("xyz", omega.T, strict=True)}
    largest = max(float(np.max(np.abs(part))) for name, part in columns.items() if name != "t_s")
    if resolution == "float32":
        columns = {n: v if n == "t_s" else v.astype(np.float32).astype(float) for n, v in columns.items()}
        spacing = float(np.spacing(np.float32(largest)))
    else:
        spacing = max(10.0 ** -int(resolution), float(np.spacing(largest)))
    form = f".{resolution}f" if resolution in ("9", "6", "4") else ".17g"
    lines = [",".join(columns)]
    stacked = np.stack(list(columns.values()), axis=-1)
    lines += [",".join([f"{row[0]:.10g}", *(format(v, form) for v in row[1:])]) for row in stacked.tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return spacing


def explained(path: Path, scenario: Scenario, dt_s: float | None) -> Diagnosis | None:
    """Return the diagnosis of a file; that of the scenario is next to it."""
    return runner.explain(path, path.parent / f"{scenario.name}.toml", dt_s=dt_s).diagnosis


def apart(one: Trajectory, other: Trajectory) -> float:
    """Return the largest difference of two motions in any number that a file has."""
    pairs = ((one.position_m, other.position_m), (one.velocity_m_s, other.velocity_m_s))
    turned = (one.rotation_matrices, other.rotation_matrices)
    return max(float(np.max(np.abs(a - b))) for a, b in (*pairs, turned, (one.omega_body, other.omega_body)))


@dataclass(frozen=True)
class HealthyTrial:
    """A healthy recording and what was said about it."""

    words: str
    is_accused: bool
    is_map: bool
    is_named: bool
    is_alone_as_it_should: bool


def healthy_trial(
    draw: np.random.Generator, scenarios: Sequence[Scenario], path: Path, made_by: str, resolution: str
) -> HealthyTrial:
    """Write a healthy recording and explain it."""
    scenario = scenarios[int(draw.integers(len(scenarios)))]
    off_by = OFF_BY[int(draw.integers(len(OFF_BY)))]
    direction = draw.normal(size=3)
    scene = scenario.scene
    omega = scene.initial.omega_body + off_by * direction / np.linalg.norm(direction)
    moved = replace(scene, initial=replace(scene.initial, omega_body=omega, exact_omega_world=None))
    dt_s = float(draw.choice([0.01, 0.005])) if made_by in MAPS else None
    motion = solved(moved, made_by, SOLVERS[made_by]) if dt_s is None else map_of(moved, made_by, dt_s)
    spacing = written(path, motion, resolution, translation=bool(draw.integers(2)))
    found = explained(path, scenario, dt_s)
    assert found is not None
    words = f"{scenario.name} {made_by} dt {dt_s} digits {resolution} off {off_by:g}: {found.sentence[:400]}"
    if dt_s is None:
        return HealthyTrial(words, found.verdict != "healthy", False, True, True)
    names = [found.base, *found.equal_maps]
    named = any(name.startswith(MAPS[made_by]) for name in names) or found.base == "exact"
    others = [
        name for name in MAPS if name != made_by and apart(motion, map_of(moved, name, dt_s)) > 30.0 * spacing
    ]
    wrongly = [name for name in others if MAPS[name] in names]
    return HealthyTrial(words, found.verdict not in ("healthy", "lower-order"), True, named, not wrongly)


def map_of(scene: Scene, method: str, dt_s: float) -> Trajectory:
    """Return the motion of a method of the reference."""
    found = record(Reference(), Case(scene, method, Setting(dt_s=dt_s))).trajectory
    assert found is not None
    return found


def healthy(trials: int = 300, seed: int = 1, minutes: float = 600.0, show: bool = False) -> bool:
    """Print the figures of healthy recordings, and return whether they miss their targets.

    minutes: no trial begins later; show: prints each recording, not only the wrong ones.
    """
    draw = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        scenarios = [scenario_of(name, Path(folder)) for name in SCENES]
        found: list[HealthyTrial] = []
        begin = time.monotonic()
        kinds: list[tuple[str, str]] = []
        while len(found) < trials and time.monotonic() - begin < 60.0 * minutes:
            if not kinds:
                every = [*product([*MAPS, *SOLVERS], RESOLUTIONS)]
                kinds = [every[k] for k in draw.permutation(len(every)).tolist()]
            one = healthy_trial(draw, scenarios, Path(folder) / "motion.csv", *kinds.pop())
            found.append(one)
            if show or one.is_accused or not one.is_named or not one.is_alone_as_it_should:
                print("ACCUSED" if one.is_accused else "named" if one.is_named else "NOT NAMED", one.words,
                      flush=True)  # fmt: skip
    maps = [one for one in found if one.is_map]
    accused, named = sum(one.is_accused for one in found), sum(one.is_named for one in maps)
    alone = sum(one.is_alone_as_it_should for one in maps)
    print(
        f"{len(found)} healthy recordings: {accused} accused; {named} of {len(maps)} maps named or listed; "
        f"{alone} without another map that differs by 30 resolutions"
    )
    return accused > 0 or min(named, alone) < 0.95 * len(maps)


def faulty_motion(
    scene: Scene, base: Base, fault: Fault, values: Array, grid: Grid, at: FaultContext, *, reads: bool
) -> Trajectory:
    """Return the motion of a map with a fault; reads: whether readings are wrong at row 0, too."""
    model = planted(at, grid.model(scene), [fault], values)
    initial = scene.initial
    attitude = normalised(initial.quaternion)
    attitude = attitude if model.start is None else model.start(attitude)
    now = States(
        *(part[:, None, None] for part in (initial.position, initial.velocity, attitude, initial.omega_body))
    )
    rows, matrices = [], []
    for sample in range(scene.samples):
        before = now
        late = None
        if sample:
            for step in range(grid.stride):
                first = (sample - 1) * grid.stride + step
                flow = Flow(
                    [model], base, scene, grid.dt_s[:1], np.array([first]), np.array([first * grid.dt_s[0]])
                )
                before, now = now, flow.advance(now, 1)
            if model.stale:
                late = flow.step(before, 0, np.full((1, 1), (1.0 - model.lateness) * grid.dt_s[0]))
        parts = {
            name: getattr(late if late is not None and name in model.stale else now, name)[:, 0]
            for name in "xvqw"
        }
        reading = ReportedStates(parts["x"], parts["v"], parts["q"], parts["w"])
        if sample or reads:
            for misreading in model.misreadings:
                reading = misreading.apply(reading)
        rows.append([part[:, 0] for part in (reading.x, reading.v, reading.q, reading.w)])
        shown = late if late is not None and "q" in model.stale else now
        matrices.append(matrix_of(shown.q) if shown.held is None else shown.held)
    x, v, q, w = (np.array([row[k] for row in rows]) for k in range(4))
    if base.one is None or not base.one.attitude.endswith("matrix"):
        return Trajectory(scene.sample_times, x, v, quaternion=q, omega_body_rad_s=w)
    rotation = np.array([matrix[:, :, 0, 0] for matrix in matrices])
    return Trajectory(scene.sample_times, x, v, rotation=rotation, omega_body_rad_s=w)


@dataclass
class Tally:
    """Counts of the trial of faults at one resolution."""

    counted: int = 0
    named: int = 0
    intervals: int = 0
    inside: int = 0
    widths: list[float] = field(default_factory=list)


_SMALL_CHANGES = (0.3, 0.03, 0.003)


def planted_values(fault: Fault, draw: np.random.Generator, at: FaultContext) -> Array:
    """Return random values of the parameters of a fault, some of them its particular values."""
    if fault.special and draw.random() < 0.25:
        return np.array([fault.special[draw.integers(len(fault.special))][0]])
    values = []
    for parameter in fault.parameters:
        if np.isinf(parameter.healthy):
            (start,) = fault.starts(at)[0]
            values.append(float(np.clip(start * draw.uniform(0.75, 0.95), parameter.low, parameter.high)))
        elif parameter.unit == "steps":
            values.append(1.0)
        else:
            size = (
                float(draw.choice(_SMALL_CHANGES)) * float(draw.choice([-1.0, 1.0])) * draw.uniform(0.7, 1.0)
            )
            values.append(parameter.healthy + size * (1.0 if len(fault.parameters) == 1 else 0.3))
    return np.array(values)


class FaultTrials:
    """The catalogue of faults, planted in maps on the scenes."""

    def __init__(self, folder: Path, draw: np.random.Generator) -> None:
        self._path, self._draw = folder / "motion.csv", draw
        self._scenarios = [scenario_of(name, folder) for name in SCENES | FURTHER]
        self._problems = {one.name: Problem.of(one, one.name, Cache.default()) for one in self._scenarios}
        self._right: dict[tuple[str, str], tuple[Trajectory, FaultContext]] = {}

    def _right_of(self, scenario: Scenario, base: Base) -> tuple[Trajectory, FaultContext]:
        """Return the motion of a map without faults, and what faults need to know of it."""
        if (key := (scenario.name, base.name)) not in self._right:
            scene, grid = scenario.scene, Grid.of(scenario.scene, 0.01)
            truth = self._context(scenario, base, self._problems[scenario.name].truth.trajectory)
            motion = faulty_motion(scene, base, _NONE, np.zeros(0), grid, truth, reads=True)
            self._right[key] = motion, self._context(scenario, base, motion)
        return self._right[key]

    def _context(self, scenario: Scenario, base: Base, motion: Trajectory) -> FaultContext:
        grid, scales = Grid.of(scenario.scene, 0.01), self._problems[scenario.name].scales
        known = frozenset({"position", "velocity", "attitude", "omega"})
        return FaultContext(Transitions.of(scenario.scene, motion, grid, scales, known), base)

    def run(self, fault: Fault, tallies: Mapping[str, Tally], *, show: bool) -> None:
        """Plant a fault on one of the scenes where it applies, and count what is said at each resolution."""
        draw = self._draw
        base = BASES[str(draw.choice(["m1", "rk4"]))]
        order = [self._scenarios[index] for index in draw.permutation(len(SCENES))]
        order += self._scenarios[len(SCENES) :]

        def acting(base: Base) -> Scenario | None:
            return next((one for one in order if fault.could_change(self._right_of(one, base)[1])), None)

        if (scenario := acting(base)) is None:  # a slip of a tableau
            scenario = acting(base := BASES["rk4"])
        if scenario is None:
            print(f"{fault.name}: applies to no scene")
            return
        right, at = self._right_of(scenario, base)
        values, grid = planted_values(fault, draw, at), Grid.of(scenario.scene, 0.01)
        # row 0 may be the state as it was set, but what is also set wrongly is always read wrongly
        reads = bool(draw.integers(2)) or getattr(fault.plant, "as_set", None) is not None
        motion = faulty_motion(scenario.scene, base, fault, values, grid, at, reads=reads)
        if not np.all(np.isfinite(motion.attitude)):
            print(f"{fault.name}: diverges")
            return
        for resolution, tally in tallies.items():
            spacing = written(self._path, motion, resolution, translation=True)
            if apart(right, motion) < 30.0 * spacing:
                continue
            begin = time.process_time()
            found = explained(self._path, scenario, 0.01)
            assert found is not None
            tally.counted += 1
            is_named = _is_named(fault, found)
            tally.named += is_named
            if show or not is_named:
                word, start = "named" if is_named else "MISSED", found.start.meaning if found.start else ""
                print(
                    f"{word} {resolution} {scenario.name} {base.name} {fault.name} {values}: {found.verdict} "
                    f"{found.base} {start} {found.sentence[:300]} ({time.process_time() - begin:.1f} s)",
                    flush=True,
                )
            if is_named and found.faults and found.faults[0].name == fault.name and len(values):
                _count_intervals(tally, found, fault, values)


def _is_named(fault: Fault, found: Diagnosis) -> bool:
    """Whether a fault is named, or listed among equals; one that is in the start only, as its meaning."""
    if fault.name.endswith("-when-set") and found.start is not None and found.start.meaning:
        return True
    listed = [{one.name for one in found.faults}, *(set(one) for one in found.alike_names)]
    return {fault.name} in listed


def _count_intervals(tally: Tally, found: Diagnosis, fault: Fault, values: Array) -> None:
    """Count the intervals that contain the planted values, and compare their widths."""
    if fault.special_text([one.value for one in found.faults[0].parameters]):
        return
    least = found.fits[0].smallest_half_widths if found.fits else None
    for index, (parameter, value) in enumerate(zip(found.faults[0].parameters, values, strict=True)):
        tally.intervals += 1
        tally.inside += parameter.low <= value <= parameter.high
        if least is not None and np.isfinite(parameter.high) and least[index] > 0.0:
            tally.widths.append((parameter.high - parameter.low) / (2.0 * float(least[index])))


def faults(
    digits: tuple[str, ...] = ("17", "9", "6"),
    seed: int = 1,
    names: tuple[str, ...] = ("*",),
    minutes: float = 600.0,
    show: bool = False,
) -> bool:
    """Print the figures of faulty recordings, and return whether they miss their targets.

    names: patterns of the names of faults; minutes: no trial begins later; show: prints each recording.
    """
    draw = np.random.default_rng(seed)
    tallies = {resolution: Tally() for resolution in digits}
    begin, tried = time.monotonic(), 0
    with tempfile.TemporaryDirectory() as folder:
        trials = FaultTrials(Path(folder), draw)
        shuffled = [FAULTS[index] for index in draw.permutation(len(FAULTS))]
        places = defaultdict[str, Iterator[int]](count)
        for fault in sorted(shuffled, key=lambda one: next(places[one.kind])):  # the kinds take turns
            if not any(fnmatchcase(fault.name, name) for name in names):
                continue
            if time.monotonic() - begin < 60.0 * minutes:
                trials.run(fault, tallies, show=show)
                tried += 1
    print(f"{tried} faults of the catalogue of {len(FAULTS)}")
    good = True
    for resolution, tally in tallies.items():
        width = float(np.median(tally.widths)) if tally.widths else math.nan
        print(
            f"{resolution} digits: {tally.named} of {tally.counted} named or listed; {tally.inside} of "
            f"{tally.intervals} intervals contain the parameter; median width {width:.2f} of Cramer and Rao"
        )
        good &= tally.named >= 0.95 * tally.counted and tally.inside >= 0.9 * tally.intervals
        good &= not width > 3.0
    return not good


_NONE = Fault("none", "map", "", lambda *_: None)


if __name__ == "__main__":
    command(healthy, faults)
