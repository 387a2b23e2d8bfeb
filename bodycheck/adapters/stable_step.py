"""Detect the breakdown of a method, and find the largest step at which it is stable.

A method breaks down with an invalid state, or with far more energy than the true motion has. The search scans
upward, then bisects the bracket.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.execution import Case, Ending, built, motion_of, readings_along, refusal
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.pivot import kinetic_energies
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import Leg, StepPlan, plan_steps

MAX_ENERGY = 100.0
"""Times the largest true kinetic energy: above it a motion is unstable."""


def invalid_state(trajectory: Trajectory) -> str | None:
    """Return why a trajectory is invalid: not finite, det R <= 0, or a zero quaternion; None if valid.

    The determinant and the norm of the quaternion must be finite too.
    """
    if found := _first_not_finite(trajectory):
        sample, name = found
        return f"{name} is not finite from t = {trajectory.t_s[sample]:.6g} s on"
    checks: list[tuple[Array, str]] = []
    if trajectory.rotation is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            determinants = np.linalg.det(trajectory.rotation)
        checks += [(determinants <= 0.0, "det R <= 0"), (~np.isfinite(determinants), "det R is not finite")]
    if trajectory.quaternion is not None:
        with np.errstate(over="ignore"):
            norms = np.linalg.norm(trajectory.quaternion, axis=-1)
        checks += [
            (norms == 0.0, "the quaternion is zero"),
            (~np.isfinite(norms), "the norm of the quaternion is not finite"),
        ]
    for invalid, what in checks:
        if np.any(invalid):
            return f"{what} at t = {trajectory.t_s[_first_sample(invalid)]:.6g} s"
    return None


def kinetic_limit(true_kinetic: Array) -> float:
    """100 max K*, in J: the kinetic energy above which a case is unstable; infinite if nothing moves.

    true_kinetic (n,): kinetic energy of the truth, in J.
    """
    largest = float(true_kinetic.max())
    return MAX_ENERGY * largest if largest > 0.0 else np.inf


def energy_blowup(kinetic: Array, limit: float, t_s: Array) -> str | None:
    """Return from which time on K exceeds its limit; None if it never does.

    kinetic (n,) and limit in J, at the times t_s (n,).
    """
    above = ~(kinetic <= limit)  # also true for NaN, into which an energy may overflow
    if not np.any(above):
        return None
    return f"kinetic energy above 100 times the true maximum from t = {t_s[np.argmax(above)]:.6g} s on"


def _first_not_finite(trajectory: Trajectory) -> tuple[int, str] | None:
    """Return the first sample with a NaN or an infinity, and the name of its array."""
    found = []
    for name in (
        "omega_body_rad_s",
        "omega_world_rad_s",
        "quaternion",
        "rotation",
        "velocity_m_s",
        "position_m",
    ):
        value = getattr(trajectory, name)
        if value is not None and not np.all(np.isfinite(value)):
            found.append((_first_sample(~np.isfinite(value)), name))
    return min(found, key=lambda lost: lost[0], default=None)


def _first_sample(invalid: Array) -> int:
    """Return the first sample in which a component (n, ...) is invalid."""
    return int(np.argmax(invalid.reshape(len(invalid), -1).any(axis=1)))


_RATIO = 1.1  # of successive steps of the scan
_WIDTH = 1.01  # ratio of the bracket's ends at which bisection stops
_MAX_READINGS = 20  # readings of the state per trial, which cost more than the engine's steps

Breakdown = Callable[[float], str | None]
"""step in s -> why the method breaks down at this step; None if it does not."""


@dataclass(frozen=True, eq=False)
class StableStepSearch:
    """A case whose step starts the scan, the bounds of the scan in s, and the limit of K in J."""

    case: Case
    lowest_s: float
    highest_s: float
    kinetic_limit_j: float


@dataclass(frozen=True)
class StableStep:
    """The result of a search: the largest stable step and the smallest unstable one above it, in s.

    reason: why the latter is unstable. stable_s is None if the method breaks down even at the lowest step,
    unstable_s if it is stable up to the highest. outcome, message, build and reused as for a case.
    """

    outcome: Ending
    message: str = ""
    stable_s: float | None = None
    unstable_s: float | None = None
    reason: str = ""
    build: str = ""
    reused: bool = False


def stable_step(adapter: Adapter, search: StableStepSearch) -> StableStep:
    """Search by trials over the scene's duration, rounded up to whole steps.

    Exceptions of the engine propagate.
    """
    case = search.case
    if reason := refusal(adapter, case.scene, case.method):
        return StableStep("unsupported", reason)
    assert case.setting.dt_s is not None
    broken = partial(_breakdown, adapter, case, search.kinetic_limit_j)
    return largest_stable(broken, case.setting.dt_s, search.lowest_s, search.highest_s)


def largest_stable(broken: Breakdown, start_s: float, lowest_s: float, highest_s: float) -> StableStep:
    """Return the first bracket of stable and unstable steps above a stable one, to 1 %.

    If the starting step is unstable, halve it until it is stable or the lowest. The scan may miss an interval
    of unstable steps that is narrower than a tenth of the step.
    """
    step = start_s
    while reason := broken(step):
        if step <= lowest_s:
            return StableStep("ok", "", None, step, reason)
        step = max(step / 2.0, lowest_s)
    stable, unstable, unstable_reason = step, None, ""
    while unstable is None and stable < highest_s:
        step = min(stable * _RATIO, highest_s)
        if reason := broken(step):
            unstable, unstable_reason = step, reason
        else:
            stable = step
    while unstable is not None and unstable > stable * _WIDTH:
        step = math.sqrt(stable * unstable)
        if reason := broken(step):
            unstable, unstable_reason = step, reason
        else:
            stable = step
    return StableStep("ok", "", stable, unstable, unstable_reason)


def _breakdown(adapter: Adapter, case: Case, limit_j: float, dt_s: float) -> str | None:
    """Return how the method breaks down within ceil(T / dt) steps; None if it does not."""
    # T / dt may exceed an integer by a rounding error
    steps = max(math.ceil(case.scene.duration_s / dt_s * (1.0 - 1e-12)), 1)
    scene = replace(case.scene, duration_s=steps * dt_s, samples=2)
    plan = plan_steps(scene, dt_s)
    legs = list(_legs_to_readings(plan, max(plan.steps // min(case.scene.samples - 1, _MAX_READINGS), 1)))
    simulation = built(adapter, scene, case.method, plan.dt_s)
    try:
        readings = readings_along(simulation, legs, with_imu=False)
    finally:
        simulation.close()
    t_s = plan.dt_s * np.cumsum([0, *(leg.steps for leg in legs)])
    motion = motion_of(scene, t_s, readings)
    with np.errstate(over="ignore", invalid="ignore"):  # in diverged states
        if reason := invalid_state(motion):
            return reason
        kinetic = kinetic_energies(scene, motion)[0]
        return energy_blowup(kinetic, limit_j, t_s)


def _legs_to_readings(plan: StepPlan, stride: int) -> Iterator[Leg]:
    """Yield the plan's legs in pieces of at most this many steps, with a reading at the end of each."""
    for leg in plan.uninterrupted():
        for begin in range(0, leg.steps, stride):
            yield Leg(min(stride, leg.steps - begin), leg.wrench, ends_at_sample=True)
