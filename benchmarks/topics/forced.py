"""The Taylor integrator under one load at a time: the cost of 1e-12 rad, and the least error it can keep."""

from __future__ import annotations

import numpy as np

from benchmarks.contenders.stepped_taylor import STEPPED_TAYLOR
from benchmarks.effort import Effort
from benchmarks.figures import Measured, key
from benchmarks.problems import BODY_SINE, BODY_TORQUE, DRAG, GRAVITY_GRADIENT, WORLD_TORQUE, Problem
from benchmarks.search import cheapest, tried
from benchmarks.timing import Spread, interleaved
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion

FORCED = (BODY_TORQUE, DRAG, BODY_SINE, GRAVITY_GRADIENT, WORLD_TORQUE)

_TARGET = 1e-12
_TIGHTEST = 1e-17


def forced(effort: Effort) -> list[Measured]:
    """Tune the tolerance for each load, time all of them in turn, and measure the floors."""
    tuned = [cheapest(tried(STEPPED_TAYLOR, problem, _TARGET), _TARGET) for problem in FORCED]
    reached = [(problem, one) for problem, one in zip(FORCED, tuned, strict=True) if one is not None]
    seconds = interleaved([one.solver for _, one in reached], effort)
    times = [
        Measured.of(
            f"forced.{key(problem.name)}.time",
            Spread.of(spent).scaled(1e6),
            f"tolerance {one.setting:.1e}, error {one.error:.1e}, set-up {1e6 * one.prepare_s:.0f} us apart",
        )
        for (problem, one), spent in zip(reached, seconds, strict=True)
    ]
    return times + [Measured(f"forced.{key(problem.name)}.floor", floor(problem)) for problem in FORCED]


def floor(problem: Problem) -> float:
    """max over the samples of angle / (eps x sensitivity), at the tightest tolerance."""
    truth = problem.truth
    followed = TaylorMotion.of(problem.scene, _TIGHTEST).solve(truth.trajectory.t_s)
    angles = geodesic_angle(truth.trajectory.attitude, followed.states[:, :4])
    return float(np.max(angles / truth.round_off_rad))
