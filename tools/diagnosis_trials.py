"""Check that the diagnosis names planted faults, with three maps and three scenarios.

    python tools/diagnosis_trials.py [--pairs 60] [--scenarios ...] [--maps ...] [--show]

Plants each fault of tests/helpers/planted_faults.py in M1, M2 and Runge-Kutta 4, and counts the cases in
which it moves the result beyond ten floors: a hit names the fault, or its class, with its parameter within
5 %. --pairs: also plants this many random pairs, and counts those for which a third fault is named. Exit
status 1 below 95 % of hits, if a third fault is named, or if a healthy map is accused.
"""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from trials import command

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, diagnosed
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.problem import Problem
from bodycheck.scenarios.library import load_scenario
from tests.helpers.planted_faults import FAULTS, Fault
from tests.helpers.planted_maps import FaultyMap

BASES = {"m1": 1, "m2": 1, "rk4": 4}
SCENARIOS = {
    "full-tensor": 1e-2,
    "powered-flight": 1e-2,
    "body-torque": 2e-2,
    "pulsed-torque": 1e-2,
    "fast-flight": 1e-4,
}
SMALL = 0.05

NAMES: dict[str, tuple[set[str], float | None]] = {
    "gravity-doubled": ({"gravity"}, 2.0),
    "gravity-missing": ({"gravity"}, 0.0),
    "gravity-reversed": ({"gravity"}, -1.0),
    "gravity-1e-3": ({"gravity"}, 1.001),
    "gravity-1-percent": ({"gravity"}, 1.01),
    "gravity-1e-5": ({"gravity"}, 1.00001),
    "gravity-axes": ({"gravity-axes-xzy"}, None),
    "gravity-in-body-axes": ({"gravity-in-body-axes"}, None),
    "mass-doubled": ({"mass-scaled"}, 2.0),
    "mass-5-percent": ({"mass-scaled"}, 1.05),
    "mass-1e-4": ({"mass-scaled"}, 1.0001),
    "moment-1e-4": ({"smallest-moment"}, 1.0001),
    "moment-10-percent": ({"smallest-moment"}, 1.1),
    "moment-1-percent": ({"largest-moment"}, 1.01),
    "middle-moment-1e-3": ({"middle-moment"}, 1.001),
    "inertia-1-percent": ({"inertia-scaled"}, 1.01),
    "inertia-axes-turned": ({"inertia-axes-rotated"}, None),
    "inertia-sphere": ({"inertia-sphere"}, None),
    "inertia-axes-permuted": ({"inertia-axes-yzx"}, None),
    "off-diagonals-dropped": ({"off-diagonals"}, 0.0),
    "off-diagonals-reversed": ({"off-diagonals"}, -1.0),
    "no-gyroscopic-term": ({"gyroscopic-term"}, 0.0),
    "gyroscopic-term-reversed": ({"gyroscopic-term"}, -1.0),
    "gyroscopic-term-1e-3": ({"gyroscopic-term"}, 1.001),
    "gyroscopic-term-1-percent": ({"gyroscopic-term"}, 0.99),
    "omega-read-in-world-axes": ({"omega-read-in-wrong-axes"}, None),
    "omega-turned-in-world-axes": ({"omega-in-wrong-axes"}, None),
    "omega-scaled": ({"omega-read-scaled"}, 1.0001),
    "omega-reversed-when-read": ({"omega-read-scaled"}, -1.0),
    "velocity-scaled": ({"velocity-read-scaled"}, 1.0001),
    "position-scaled": ({"position-read-scaled"}, 1.0001),
    "torque-body-as-world": ({"torque-body-as-world", "applied-torque-body-as-world"}, None),
    "torque-world-as-body": ({"torque-world-as-body"}, None),
    "torque-doubled": ({"torque", "applied-torque"}, 2.0),
    "torque-missing": ({"torque", "applied-torque"}, 0.0),
    "torque-reversed": ({"torque", "applied-torque"}, -1.0),
    "torque-1-percent": ({"torque", "applied-torque"}, 1.01),
    "torque-frozen": ({"torque-frozen", "applied-torque-frozen"}, None),
    "load-late": ({"load-late-1"}, None),
    "load-two-steps-late": ({"load-late-2"}, None),
    "release-late": ({"release-late"}, None),
    "first-step-free": ({"first-step-free"}, None),
    "load-kept": ({"load-never-cleared", "load-held-on"}, None),
    "force-at-centre": ({"moment", "applied-moment"}, 0.0),
    "moment-reversed": ({"moment", "applied-moment"}, -1.0),
    "force-missing": ({"force-without-moment", "applied-force-without-lever"}, 0.0),
    "force-1e-3": ({"force", "applied-force"}, 1.001),
    "arm-1-percent": ({"moment-world", "moment"}, 1.01),
    "lever-in-world-axes": ({"arm-rotated"}, None),
    "force-axes-exchanged": ({"force-axes-exchanged", "force-body-as-world", "force-world-as-body"}, None),
    "damping-linear": ({"damping-linear"}, 0.04),
    "damping-angular": ({"damping-angular"}, 0.04),
    "damping-linear-1e-3": ({"damping-linear"}, 1e-3),
    "damping-angular-1e-3": ({"damping-angular"}, 1e-3),
    "damping-angular-1e-5": ({"damping-angular"}, 1e-5),
    "damping-negative": ({"damping-angular"}, -0.01),
    "damping-quadratic": ({"damping-quadratic-linear"}, 1e-3),
    "omega-clamped": ({"omega-clamped-body", "omega-clamped-body-after"}, 100.0),
    "omega-clamped-at-175": ({"omega-clamped-body", "omega-clamped-body-after"}, 175.0),
    "speed-clamped": ({"speed-clamped-world", "speed-clamped-world-after"}, 100.0),
    "asleep": ({"asleep"}, None),
    "turn-clamped": ({"turn-clamped"}, np.pi / 4.0),
    "state-late": ({"state-late"}, 1.0),
    "attitude-late": ({"attitude-late"}, 1.0),
    "velocity-late": ({"velocity-late"}, 1.0),
    "omega-late": ({"omega-late"}, 1.0),
    "position-late": ({"position-late"}, 1.0),
    "quaternion-conjugated": ({"quaternion-conjugated"}, None),
    "quaternion-conjugated-when-read": ({"quaternion-conjugated-when-read"}, None),
    "quaternion-order": ({"quaternion-order"}, None),
    "energy-dragged": ({"energy-pulled"}, 1.0),
    "energy-dragged-slowly": ({"energy-pulled"}, 0.01),
    "step-1-percent": ({"step-scaled"}, 1.01),
    "step-1e-3": ({"step-scaled"}, 1.001),
    "step-halved": ({"step-scaled"}, 0.5),
    "step-twice": ({"step-made-twice"}, None),
    "velocity-turns-with-body": ({"velocity-in-body-axes"}, None),
    "velocity-of-another-point": ({"velocity-of-another-point"}, 0.05),
    "single-precision-stage": ({"single-precision-stage"}, None),
    "position-by-old-velocity": ({"position-by-old-velocity"}, None),
}
"""Planted fault -> the correct names, and the first parameter."""
INERTIA = {"smallest-moment", "middle-moment", "largest-moment", "inertia-scaled", "off-diagonals"} | {
    "inertia-axes-rotated", "inertia-axes-yzx", "inertia-sphere",
}  # fmt: skip
"""The faults that change only the tensor."""


def problem_of(name: str) -> Problem:
    """Return a scenario with its truth."""
    return Problem.of(load_scenario(name), name, Cache.default())


def motion_of(problem: Problem, base: str, faults: Sequence[Fault]) -> Trajectory:
    """Return the motion of a map with planted faults."""
    scene = problem.scenario.scene
    case = Case(scene, "planted", Setting(dt_s=SCENARIOS[problem.scenario.name]))
    found = record(FaultyMap(base, faults), case).trajectory
    assert found is not None
    return found


def moved(problem: Problem, one: Trajectory, other: Trajectory) -> float:
    """Return the largest scaled difference of two motions in floors of the truth."""
    scales, truth = problem.scales, problem.truth
    gaps = (
        (one.rotation_matrices, other.rotation_matrices, 1.0),
        (one.omega_body, other.omega_body, scales.omega_scale_rad_s),
        (one.velocity_m_s, other.velocity_m_s, scales.speed_scale_m_s),
        (one.position_m, other.position_m, scales.length_scale_m),
    )
    largest = max(float(np.max(np.abs(a - b))) / (scale or 1.0) for a, b, scale in gaps)
    floor = max(problem.largest(truth.bound_rad), problem.largest(truth.round_off_rad), 1e-15)
    return largest / (3.0 * floor)


@dataclass(frozen=True)
class Trial:
    """The diagnosis of planted faults, the CPU time that it took in s, and the change of the result."""

    scenario: str
    base: str
    faults: tuple[Fault, ...]
    found: Diagnosis | None
    took_s: float
    floors: float

    @property
    def names(self) -> list[set[str]]:
        """Return the names of the faults named first, and of those that the scene cannot distinguish."""
        if self.found is None:
            return []
        return [{fault.name for fault in self.found.faults}, *(set(one) for one in self.found.alike_names)]

    @property
    def line(self) -> str:
        """Return the trial in one line."""
        reported = "not examined" if self.found is None else self.found.sentence
        alike = [sorted(names) for names in self.names[1:]]
        planted = " + ".join(fault.name for fault in self.faults)
        return f"{self.scenario} {self.base} {planted}: {reported}; same: {alike}; {self.took_s:.2f} s"


def trial(problem: Problem, base: str, faults: Sequence[Fault]) -> Trial:
    """Plant faults in a map, and diagnose the motion."""
    name = problem.scenario.name
    healthy, wrong = motion_of(problem, base, ()), motion_of(problem, base, faults)
    finite = bool(np.all(np.isfinite(wrong.attitude)))
    begin = time.process_time()
    found = None
    if finite:
        scene = problem.scenario.scene
        found = diagnosed(scene, wrong, problem.scales, SCENARIOS[name], order=BASES[base])
    took = time.process_time() - begin
    return Trial(name, base, tuple(faults), found, took, moved(problem, healthy, wrong) if finite else 0.0)


def is_hit(one: Trial) -> bool:
    """Return whether the planted fault or its class is named with its parameter within 5 %."""
    right, value = NAMES[one.faults[0].name]
    if one.found is None or one.found.verdict != "explained":
        return False
    if not any(len(names) == 1 and names <= right for names in one.names):
        return False
    first = one.found.faults[0]
    if value is None or first.name not in right or not first.parameters:
        return True
    change = abs(value - 1.0) if first.parameters[0].name == "factor" else abs(value)
    return abs(first.parameters[0].value - value) <= SMALL * change


def singles(scenarios: Sequence[str], maps: Sequence[str], *, show: bool) -> tuple[int, int, int]:
    """Print the misses, and return the numbers of hits, counted cases and accused healthy maps."""
    counted: list[tuple[Trial, bool]] = []
    accused = 0
    for scenario in scenarios:
        problem = problem_of(scenario)
        for base in maps:
            healthy = trial(problem, base, ()).found
            accused += healthy is not None and healthy.verdict != "healthy"
            for fault in FAULTS:
                if fault.name in NAMES:
                    one = trial(problem, base, (fault,))
                    if one.floors >= 10.0:
                        counted.append((one, is_hit(one)))
                        if show or not counted[-1][1]:
                            print("hit: " if counted[-1][1] else "MISS:", one.line)
    hits, times = sum(hit for _, hit in counted), sorted(one.took_s for one, _ in counted)
    kinds = {one.faults[0].name for one, _ in counted}
    print(
        f"{len(kinds)} kinds of faults x {len(maps)} maps x {len(scenarios)} scenarios: {hits} of "
        f"{len(counted)} named ({100.0 * hits / max(len(counted), 1):.1f} %), CPU time at most "
        f"{times[-1]:.2f} s, median {times[len(times) // 2]:.2f} s; {accused} healthy maps accused"
    )
    return hits, len(counted), accused


def random_pairs(scenarios: Sequence[str], maps: Sequence[str], count: int, *, show: bool) -> int:
    """Print the results for random pairs, and return how often a third fault was named."""
    draw = random.Random(25)
    tally: Counter[str] = Counter()
    possible = [fault for fault in FAULTS if fault.name in NAMES]
    problems = {name: problem_of(name) for name in scenarios}
    while sum(tally.values()) < count:
        problem, base = problems[draw.choice(scenarios)], draw.choice(maps)
        two = draw.sample(possible, 2)
        healthy = motion_of(problem, base, ())
        if min(moved(problem, healthy, motion_of(problem, base, (one,))) for one in two) < 10.0:
            continue
        one = trial(problem, base, two)
        if one.found is not None:
            word = _pair_word(one)
            tally[word] += 1
            if show or word == "THIRD":
                print(f"{word}: {one.line}")
    print(f"{count} pairs: {dict(tally)}")
    return tally["THIRD"]


def _pair_word(one: Trial) -> str:
    """Return which faults are named: both, one of them, a third one, or none."""
    assert one.found is not None
    if one.found.verdict != "explained":
        return one.found.verdict
    first, second = (NAMES[fault.name][0] for fault in one.faults)
    if (first | second) <= INERTIA and {"inertia-tensor"} in one.names:
        return "both"  # as one tensor, which combines both
    if any(len(names) == 2 and names & first and names & second for names in one.names):
        return "both"
    return "one of them" if any(names <= first | second for names in one.names) else "THIRD"


def main(
    pairs: int = 60,
    scenarios: tuple[str, ...] = (*SCENARIOS,),
    maps: tuple[str, ...] = (*BASES,),
    show: bool = False,
) -> bool:
    """Print the misses, or with show each case; return whether the figures are missed."""
    hits, counted, accused = singles(scenarios, maps, show=show)
    third = random_pairs(scenarios, maps, pairs, show=show) if pairs else 0
    return hits < 0.95 * counted or third > 0 or accused > 0


if __name__ == "__main__":
    command(main)
