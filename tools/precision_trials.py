"""Measure how well the floors of the reference's float32 methods are predicted.

    python tools/precision_trials.py
    python tools/precision_trials.py --engine rapier:semi-implicit --dt 2e-3,1e-3,5e-4

Runs rk4-f32 and m1-f32 on the suite `standard`, and prints for each scenario the best step, its orientation
error, and the predicted floor if the floor was reached. Then it fits both branches of the error to all
steps except the two finest, and predicts these. An error on the floor scatters by a factor of 1.8 between
steps that differ by a hundredth, so the fit uses single cases and the geometric means of five neighbouring
steps. Exit status 1 if a method is invalid or accused, or if a figure misses its target.

With --engine, prints only the floors of these methods and their rounding bias: the median over the scenarios
of the least mean rounding error of omega per step that explains an error at the floor, (e / u - S) / (R N).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from statistics import fmean, median
from typing import Any

from trials import command

import bodycheck
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.reports.measurement.case import measured_by, stable_motion
from bodycheck.reports.measurement.convergence import LARGEST_ERROR
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.round_off import RoundOff, fitted
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.scenarios.library import load_scenarios
from tests.helpers.reported_results import reported_results

_METHODS = {"rk4-f32": 4, "m1-f32": 1}
_LADDER = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_NEIGHBOURS = (-2, -1, 0, 1, 2)
_MIN_FIT = 2  # steps, in addition to the two that are predicted
_SHARE = 0.9
_TRUE = ("property", "unstable")


def main(engine: str | None = None, dt: str | None = None) -> bool:
    """Print the figures; engine: methods as NAME:METHOD,..., of which only floors and biases are printed.

    dt: steps in s, separated by commas; by default those of each scenario.
    """
    steps = None if dt is None else [float(step) for step in dt.split(",")]
    if engine is not None:
        return _floors(engine.split(","), steps)
    missed = [_floors([f"reference:{name}" for name in _METHODS], steps), _predictions()]
    return any(missed)


def _floors(engines: list[str], steps: list[float] | None) -> bool:
    run = bodycheck.run(["standard"], engines=engines, dt_s=steps, speed=False)
    rows = run.methods[run.methods["quantity"] == ORIENTATION]
    within: Counter[str] = Counter()
    reached: Counter[str] = Counter()
    biases: dict[str, list[float]] = {}
    for row in rows.to_dict("records"):
        name = f"{row['engine']}:{row['method']}"
        ratio = row["least_error"] / row["predicted_floor"]
        floor = "not reached"
        if row["measured_floor"] == row["measured_floor"]:
            reached[name] += 1
            within[name] += 0.1 <= ratio <= 10.0
            biases.setdefault(name, []).append(bias := _bias(run, row))
            floor = f"least over predicted {ratio:.2g}, bias {bias:.2g}"
        print(
            f"{row['scenario']:18} {name:24} {row['verdict']:19} best step {row['best_dt_s']:.3g} s, "
            f"error {row['least_error']:.1e}, predicted floor {row['predicted_floor']:.1e}: {floor}"
        )
    for name, count in reached.items():
        print(
            f"{name}: floor within a factor of 10 of the formula in {within[name]} of {count} scenarios; "
            f"median bias {median(biases[name]):.2g}"
        )
    outcomes = run.results["outcome"].value_counts().to_dict()
    print("outcomes: " + ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()))
    accused = [one for results in reported_results(run).values() for one in results if one.kind not in _TRUE]
    for one in accused:
        print(f"accused: {one.sentence}\n    {one.reproduce}")
    total, right = sum(reached.values()), sum(within.values())
    return bool(accused) or "invalid" in outcomes or right < _SHARE * total


def _bias(run: Run, row: dict[str, Any]) -> float:
    """Return the bias that explains the error of a method at the finest successful step."""
    problem = next(one for one in run.problems if one.scenario.name == row["scenario"])
    formula = RoundOff.of(problem, ORIENTATION, "float32")
    steps = problem.scenario.duration_s / row["finest_dt_s"]
    return float(row["finest_error"] / formula.unit - formula.largest) / (formula.typical * steps)


def _predictions() -> bool:
    missed = False
    for grouped in (False, True):
        right = total = 0
        for spec, scenario in load_scenarios(["standard"]):
            problem = Problem.of(scenario, spec)
            for method, order in _METHODS.items():
                ratios = _predicted(problem, method, order, _NEIGHBOURS if grouped else (0,))
                if ratios is None:
                    continue
                total += 1
                if all(1.0 / 3.0 <= ratio <= 3.0 for ratio in ratios):
                    right += 1
                else:
                    named = ", ".join(f"{ratio:.2g}" for ratio in ratios)
                    print(f"{spec} {method}: measured over predicted {named}")
        what = "means of five neighbouring steps" if grouped else "single cases"
        print(f"the two finest steps predicted within a factor of 3, {what}: {right} of {total}")
        missed = grouped and right < _SHARE * total
    return missed


def _predicted(problem: Problem, method: str, order: int, neighbours: Sequence[int]) -> list[float] | None:
    """Return measured over predicted error at the two finest steps, or None if no others can be fitted."""
    interval = problem.scenario.scene.sample_interval_s
    listed = {round(interval / step) for step in problem.scenario.steps}
    strides = sorted(listed | {n for n in _LADDER if n < max(listed)})
    round_off = RoundOff.of(problem, ORIENTATION, "float32")
    points = []
    for stride in strides:
        near = [stride + n for n in neighbours] if stride >= 2 * len(_NEIGHBOURS) else [stride]
        errors = list(_errors(problem, method, near))
        if errors and (error := math.exp(fmean(map(math.log, errors)))) < LARGEST_ERROR:
            points.append((interval / stride, error, round_off.at(interval / stride)))
    if len(points) < _MIN_FIT + 2:
        return None
    steps, errors, floors = zip(*points[:-2], strict=True)
    branches = fitted(steps, errors, floors, order)
    return [error / branches.error(step, floor) for step, error, floor in points[-2:]]


def _errors(problem: Problem, method: str, strides: Sequence[int]) -> Iterator[float]:
    scene = problem.scenario.scene
    for stride in strides:
        answer = record(Reference(), Case(scene, method, Setting(dt_s=scene.sample_interval_s / stride)))
        assert answer.trajectory is not None
        motion = stable_motion(scene, answer.trajectory, problem.motion)
        if not isinstance(motion, str):
            yield float(measured_by(problem, answer.trajectory, motion).columns[ORIENTATION])


if __name__ == "__main__":
    command(main)
