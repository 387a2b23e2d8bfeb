"""Work and precision: every contender tuned for every error, and timed next to the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.contenders import (
    CLOSED_FORM,
    CLOSED_FORM_SET_UP_BEFORE,
    HEYOKA,
    MUJOCO,
    SCIPY,
    STEPPED_TAYLOR,
    all_contenders,
)
from benchmarks.figures import RATIOS, Measured, ratio_name
from benchmarks.problems import FREE, FREE_LONG, WORLD_TORQUE, Problem
from benchmarks.solver import Contender, Tried, cheapest, most_accurate, tried
from benchmarks.timing import Effort, Spread, interleaved, ratio
from bodycheck.reference_impl.arrays import Array


@dataclass(frozen=True, eq=False)
class Point:
    """A contender tuned for an error on a problem; seconds (rounds,) None where it reached no such error."""

    problem: str
    contender: Contender
    target: float
    tuned: Tried
    seconds: Array | None


Points = list[Point]


def curves(problem: Problem, contenders: Sequence[Contender], effort: Effort) -> Points:
    """Tune all for every target and time those who reach it in turn, target by target."""
    found = [tried(one, problem, min(effort.targets)) for one in contenders]
    points: Points = []
    for target in effort.targets:
        tuned = [cheapest(trials, target) for trials in found]
        seconds = iter(interleaved([one.solver for one in tuned if one is not None], effort))
        for contender, trials, one in zip(contenders, found, tuned, strict=True):
            if one is None:
                points.append(Point(problem.name, contender, target, most_accurate(trials), None))
            else:
                points.append(Point(problem.name, contender, target, one, next(seconds)))
    return points


def against(effort: Effort) -> tuple[list[Measured], Points]:
    """Measure the three problems, and the ratios that have targets."""
    contenders, missing = all_contenders()
    torque_free_only = CLOSED_FORM, CLOSED_FORM_SET_UP_BEFORE
    long = [one for one in contenders if one in (*torque_free_only, STEPPED_TAYLOR) or one.name == HEYOKA]
    points = [
        *curves(FREE, contenders, effort),
        *curves(WORLD_TORQUE, [one for one in contenders if one not in torque_free_only], effort),
        *curves(FREE_LONG, long, effort),
    ]
    return ratios(points, missing), points


def ratios(points: Points, missing: dict[str, str]) -> list[Measured]:
    """Return how many times as fast ours is at each problem and target, relative to each rival.

    Against an engine or a general solver ours is the faster of the closed form, its set-up included, and
    the stepped method; against heyoka, which steps by the same method, it is the stepped one.
    """
    ours = {
        MUJOCO: (STEPPED_TAYLOR.name, CLOSED_FORM.name),
        SCIPY: (STEPPED_TAYLOR.name, CLOSED_FORM.name),
        HEYOKA: (STEPPED_TAYLOR.name,),
    }
    measured = []
    for rival, problem, target, _ in RATIOS:
        name = ratio_name(rival, problem, target)
        here = [point for point in points if (point.problem, point.target) == (problem, target)]
        if rival in missing:
            measured.append(Measured(name, None, note=missing[rival]))
        else:
            measured.append(_ratio(name, here, rival, ours[rival]))
    return measured


def _ratio(name: str, points: Points, rival: str, ours: tuple[str, ...]) -> Measured:
    (theirs,) = (point for point in points if point.contender.name == rival)
    if theirs.seconds is None:
        return Measured(name, None, note=f"{rival} reaches {theirs.tuned.error:.1e} at best")
    reached = [point for point in points if point.contender.name in ours and point.seconds is not None]
    if not reached:
        return Measured(name, None, note="ours does not reach this error")
    best = min(reached, key=lambda point: Spread.of(_times(point)).median)
    note = f"ours: {best.contender.name}; {_settings(best)} beside {_settings(theirs)}; set-up apart"
    return Measured.of(name, ratio(theirs.seconds, _times(best)), note)


def _times(point: Point) -> Array:
    assert point.seconds is not None
    return point.seconds


def _settings(point: Point) -> str:
    if point.contender.knob == "none":
        return f"error {point.tuned.error:.1e}"
    return f"{point.contender.knob} {point.tuned.setting:.3g}, error {point.tuned.error:.1e}"
