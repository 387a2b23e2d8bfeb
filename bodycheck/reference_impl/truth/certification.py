"""The truth of a scene with its bounds: the closed form if there is one, otherwise a certified motion.

Callback loads have no Taylor series: scenes with such loads are solved with repeatedly halved steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.closed_forms.exact_motion import ExactMotion, closed_form_of
from bodycheck.reference_impl.closed_forms.fixed_axis import FixedAxisRotation
from bodycheck.reference_impl.closed_forms.fixed_axis_sensitivity import departures
from bodycheck.reference_impl.dynamics import gyration_radius
from bodycheck.reference_impl.rotations import exp_quaternion, normalised, quaternion_product
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.taylor.solution import (
    Forcings,
    SeriesAccuracy,
    Solution,
    TooManyStepsError,
    follow_scene,
    forcings_of,
    packed_state,
    trajectory_of,
)
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth.motion_distance import distances, rounding, scales, small_distances
from bodycheck.reference_impl.truth.step_halving import Halved, solve_by_halving, solve_with_steps
from bodycheck.reference_impl.truth.truth import Kind, Truth

EXACT_BOUNDS = (4e-15, 8e-15, 8e-15)
"""Bounds that the tests enforce: angle in rad; relative energy and momentum, from the 4e-15 of omega."""

_FINE, _CHECK = SeriesAccuracy(30, 1e-32, 19), SeriesAccuracy(34, 1e-33, 21)
_NUDGED, _NUDGED_STEPS = SeriesAccuracy(18, 1e-17), 512
NUDGE = 1e-7  # rad, or relative to max |omega|: the size of the perturbations that measure sensitivity
_PROPORTIONAL = 1e-2  # rad, or relative: the distance up to which nudges grow in proportion to their size
_FINE_NUDGE = 1e-15  # of those nudges: double-doubles still resolve this to nine digits
_MARGIN = 10.0
_PLAIN_EXPONENT = 20  # of two: a truth up to a time within 2^-20 s to 2^20 s is solved in seconds
_FARTHEST = 400  # so that the squares of the units are doubles
_NORM_ROUNDING = 1e-15  # of a quaternion of four doubles
_EPS = float(np.finfo(np.float64).eps)
_EPS_PAIR = 2.0**-104  # of double-double arithmetic
_TRUSTED = 1e-10  # rad, or relative: the largest bound with which the motion may serve as the reference


def solve_truth(scene: Scene, t_s: Array) -> Truth:
    """Return the truth of the scene at any times t >= 0 (n,) in s, in any order.

    Raises ValueError, naming the first such time, for times that are negative or not finite and where the
    motion leaves the range of double precision; also for loads that cannot act together, and where a
    callback returns no force and torque.
    """
    for t in t_s[~(np.isfinite(t_s) & (t_s >= 0.0))]:
        raise ValueError(f"a truth needs times that are finite and not negative, not {float(t)!r}")
    order = np.argsort(t_s, kind="stable")
    return _reordered(_ascending(scene, t_s[order]), np.argsort(order, kind="stable"))


def _ascending(scene: Scene, t_s: Array) -> Truth:
    if scene.has_callback_load:
        return _halved(scene, t_s)
    closed = closed_form_of(scene)
    return certified_truth(scene, t_s) if closed is None else _exact(scene, closed, t_s)


def _check_finite(motion: Trajectory, lost: str = "") -> None:
    """Raise ValueError for an invalid truth; lost: the reason, if known."""
    parts = (motion.position_m, motion.velocity_m_s, motion.attitude, motion.omega_body)
    finite = np.all([np.isfinite(part).all(axis=-1) for part in parts], axis=0)
    if not finite.all():
        lost_at = int(np.argmin(finite))
        first = float(motion.t_s[lost_at])
        before = float(motion.t_s[lost_at - 1]) if lost_at else 0.0
        reason = f"{lost} (after t = {before!r} s)" if lost else "it leaves the range of double precision"
        raise ValueError(f"there is no truth at t = {first!r} s: {reason}")


def _exact(scene: Scene, closed: ExactMotion, t_s: Array) -> Truth:
    """bound = bound of the closed form, constant in time, + half an ulp of each number; t_s ascending."""
    motion = closed.at(t_s)
    _check_finite(motion)
    relative = np.broadcast_to(np.array(EXACT_BOUNDS)[:, None], (3, len(t_s)))
    errors = np.concatenate([relative, closed.errors(motion)])
    bounds = np.maximum.accumulate(errors + rounding(scene, motion), axis=1)
    if isinstance(closed.rotation, FixedAxisRotation):
        gaps = _linear_gaps(scene, motion, departures(scene, closed.rotation, t_s))
    else:
        starts = _nudges(scene, motion)
        gaps = _largest_gaps(scene, motion, [_neighbour(scene, start).at(t_s) for start in starts])
    return Truth(motion, "exact", *bounds, *_EPS * _growths(scene, motion, gaps / NUDGE))


def _neighbour(scene: Scene, start: State) -> ExactMotion:
    """Return the closed-form motion from a nudged start; it exists, as no torque but drag acts."""
    closed = closed_form_of(replace(scene, initial=start))
    assert closed is not None
    return closed


def _linear_gaps(scene: Scene, motion: Trajectory, matrices: Array) -> Array:
    """Return the largest distances (6, n) of neighbours that depart according to the matrices (n, 6, 6).

    The nudges are those of `_nudges`. Distances are limited to half a turn and twice the largest |omega|.
    """
    spin = largest_norm(motion.omega_body)
    found = np.zeros((6, len(motion.t_s)))
    for nudge in np.diag([NUDGE * spin] * 3 + [NUDGE] * 3):
        deviation = matrices @ nudge
        spin_change, rotated = (np.linalg.norm(part, axis=-1) for part in np.split(deviation, 2, axis=1))
        excess = np.maximum(
            np.maximum(rotated / np.pi, spin_change / (2.0 * spin) if spin > 0.0 else 0.0), 1.0
        )
        deviation = deviation / excess[:, None]
        change = np.zeros((len(deviation), 13))
        half = np.concatenate([np.zeros((len(deviation), 1)), 0.5 * deviation[:, 3:]], axis=1)
        change[:, 0:4] = quaternion_product(motion.attitude, half)
        change[:, 4:7] = deviation[:, :3]
        found = np.maximum(found, small_distances(scene, motion, change))
    return found


def certified_truth(scene: Scene, t_s: Array) -> Truth:
    """bound = 10 (|difference of two resolutions| + 2^-104 sensitivity steps) + half an ulp, t_s ascending.

    t_s (n,) in s, ascending. For any scene without callback loads, including scenes with a closed form. The
    half ulp is that of every returned number: some 3e-16 rad. Raises ValueError as `solve_truth` does.

    Where the last time is far from 1 s, the scene is solved in a unit of time near it: in seconds, terms of a
    series would overflow, or underflow, which looks like convergence. If that overflows, the motion makes so
    many turns that the unit is that of a turn.
    """
    refused: ValueError | None = None
    for exponent in _units(scene, t_s):
        other = scene.in_time_unit(exponent) if exponent else scene
        if other is not None:
            try:
                return _in_seconds(_solved_twice(other, np.ldexp(t_s, -exponent), t_s), t_s, exponent)
            except TooManyStepsError as error:
                raise ValueError(f"there is no truth at t = {float(t_s[-1])!r} s: {error}") from None
            except ValueError as error:
                refused = refused or error
    assert refused is not None  # seconds are always tried
    raise refused


def _units(scene: Scene, t_s: Array) -> Iterator[int]:
    """Yield the units of time in which a scene is solved, as exponents of two, the best first."""
    last = math.frexp(float(t_s[-1]))[1] if len(t_s) else 0
    if abs(last) > _PLAIN_EXPONENT:
        yield max(-_FARTHEST, min(last, _FARTHEST))
        turn = -math.frexp(largest_norm(scene.initial.omega_body[None]))[1]
        if abs(turn) > _PLAIN_EXPONENT:
            yield max(-_FARTHEST, min(turn, _FARTHEST))
    yield 0


def _in_seconds(truth: Truth, t_s: Array, exponent: int) -> Truth:
    """Return a truth that was solved in a unit of time of 2^exponent s."""
    motion = truth.trajectory
    rates = {"velocity_m_s": motion.velocity_m_s, "omega_body_rad_s": motion.omega_body}
    slower = {name: np.ldexp(values, -exponent) for name, values in rates.items()}
    bounds = {
        name: np.ldexp(getattr(truth, name), -exponent)
        for quantity in ("omega_rad_s", "m_s")
        for name in (f"bound_{quantity}", f"round_off_{quantity}")
    }
    until_s = math.ldexp(truth.trusted_until_s, exponent)
    return replace(truth, trajectory=replace(motion, t_s=t_s, **slower), trusted_until_s=until_s, **bounds)


def _solved_twice(scene: Scene, t_s: Array, shown_s: Array) -> Truth:
    """Return the certified truth of a scene; shown_s (n,): its times in seconds, for messages."""
    forcings = forcings_of(scene, float(t_s[-1]) if len(t_s) else 0.0)
    fine, check = (
        follow_scene(scene, forcings, packed_state(scene.initial), t_s, resolution)
        for resolution in (_FINE, _CHECK)
    )
    motion = trajectory_of(t_s, fine.high)  # the nearest double to high + low is high
    _check_finite(replace(motion, t_s=shown_s), fine.lost)
    growths = _certified_growths(scene, forcings, motion, fine)
    gaps = small_distances(scene, motion, (check.high - fine.high) + (check.low - fine.low))
    noise = _EPS_PAIR * growths * (1 + max(fine.steps, check.steps))
    truth = _bounded(scene, motion, "certified", gaps + noise, growths)
    _check_norm(truth, shown_s)
    return truth


def _check_norm(truth: Truth, shown_s: Array) -> None:
    """Raise ValueError where |q| leaves 1 by more than the bound: two resolutions may agree on nonsense."""
    norm = np.linalg.norm(truth.trajectory.attitude, axis=1)
    wrong = np.abs(norm - 1.0) > truth.bound_rad + _NORM_ROUNDING
    if wrong.any():
        k = int(np.argmax(wrong))
        raise ValueError(
            f"there is no truth at t = {float(shown_s[k])!r} s: the norm of q is {norm[k]:.17g}, which "
            f"differs from 1 by more than the bound of {truth.bound_rad[k]:.2g} rad"
        )


def _halved(scene: Scene, t_s: Array) -> Truth:
    """bound = 10 (|difference of two step lengths| + eps sensitivity sqrt(steps)) + half an ulp.

    Round-off errors of either sign are equally likely. Two motions of order 8 differ by 255 times the error
    of the finer one.
    """
    halved = solve_by_halving(scene, t_s)
    _check_finite(halved.motion)
    growths = _halved_growths(scene, halved)
    noise = _EPS * growths * math.sqrt(halved.steps)
    kind: Kind = "certified" if halved.converged else "estimated"
    return _bounded(scene, halved.motion, kind, halved.gaps + noise, growths)


def _halved_growths(scene: Scene, halved: Halved) -> Array:
    """Return the growths of nudges (6, n), at limited resolution: neighbours have nearly the same error."""
    t_s, steps = halved.motion.t_s, min(halved.steps, _NUDGED_STEPS)
    dt_s = (float(t_s[-1]) if len(t_s) and t_s[-1] > 0.0 else 1.0) / steps
    starts = [_rounded(scene.initial), *_nudges(scene, halved.motion)]
    motion, *neighbours = (solve_with_steps(scene, start, t_s, dt_s) for start in starts)
    return _growths(scene, motion, _largest_gaps(scene, motion, neighbours) / NUDGE)


def _bounded(scene: Scene, motion: Trajectory, kind: Kind, errors: Array, growths: Array) -> Truth:
    """Return the truth of a motion whose errors (6, n) are known up to a margin."""
    errors = _MARGIN * _known(errors)
    bounds = np.maximum.accumulate(errors + rounding(scene, motion), axis=1)
    truth = Truth(motion, kind, *bounds, *_EPS * growths)
    # rounding is left out: far from the origin it is large relative to a length, but known
    lost = (truth.bound_rad > _TRUSTED) | np.any(errors[3:] > _TRUSTED * scales(scene, motion)[3:], axis=0)
    return replace(truth, trusted_until_s=float(motion.t_s[np.argmax(lost)])) if lost.any() else truth


def _known(errors: Array) -> Array:
    """Return the errors, infinite where they are unknown."""
    return np.where(np.isnan(errors), np.inf, errors)


def _certified_growths(scene: Scene, forcings: Forcings, motion: Trajectory, fine: Solution) -> Array:
    """Return growths (6, n) as `_growths`, from finer nudges in double-double where coarse ones saturate."""
    t_s = motion.t_s
    neighbours = [
        trajectory_of(t_s, follow_scene(scene, forcings, packed_state(start), t_s, _NUDGED).high)
        for start in _nudges(scene, motion)
    ]
    gaps = _largest_gaps(scene, motion, neighbours)
    growths = _growths(scene, motion, gaps / NUDGE)
    if np.max((gaps / scales(scene, motion))[[0, 3, 4, 5]], initial=0.0) < _PROPORTIONAL:
        return growths
    apart = np.zeros_like(growths)
    high, low = packed_state(scene.initial)
    rounded_high, rounded_low = packed_state(_rounded(scene.initial))
    for start in _nudges(scene, motion):
        nudged_high, nudged_low = packed_state(start)
        nudge = _FINE_NUDGE * ((nudged_high - rounded_high) + (nudged_low - rounded_low))
        found = follow_scene(scene, forcings, (high.copy(), low + nudge), t_s, _FINE)
        difference = (found.high - fine.high) + (found.low - fine.low)
        apart = np.maximum(apart, _known(small_distances(scene, motion, difference)))
    return np.maximum.accumulate(np.maximum(growths, apart / (NUDGE * _FINE_NUDGE)), axis=1)


def _largest_gaps(scene: Scene, motion: Trajectory, neighbours: list[Trajectory]) -> Array:
    """Return the largest distances (6, n) of any neighbour, infinite where one cannot be followed."""
    return np.max([_known(distances(scene, motion, neighbour)) for neighbour in neighbours], axis=0)


def _growths(scene: Scene, motion: Trajectory, growths: Array) -> Array:
    """Return the largest growth (6, n) of a small nudge up to each time, at least that of a steady motion.

    No motion is less sensitive than a steady spin to an error of eps in omega, or than a position far from
    the origin and a steady flight to an error of eps in position and velocity.
    """
    least = (1.0 + largest_norm(motion.omega_body) * motion.t_s) * scales(scene, motion)
    least[4] += 3.0 * largest_norm(motion.position_m) + largest_norm(motion.velocity_m_s) * motion.t_s
    return np.maximum.accumulate(np.maximum(growths, least), axis=1)


def _nudges(scene: Scene, motion: Trajectory) -> Iterator[State]:
    """Yield neighbours of the start: rotated about each body axis, and with omega changed along each.

    Where a load may couple rotation and translation, also neighbours with position and velocity changed.
    """
    start, omega = _rounded(scene.initial), NUDGE * largest_norm(motion.omega_body)
    for axis in np.eye(3):
        rotated = quaternion_product(start.quaternion, exp_quaternion(NUDGE * axis))
        yield replace(start, quaternion=normalised(rotated))
        yield replace(start, omega_body=start.omega_body + omega * axis)
    tied = any(load.couples_translation for load in scene.continuous_loads)
    if tied and scene.pivot is None:
        radius = gyration_radius(scene.body.mass, scene.body.inertia)
        speed = NUDGE * largest_norm(motion.velocity_m_s)
        for axis in np.eye(3):
            yield replace(start, position=start.position + NUDGE * radius * axis)
            yield replace(start, velocity=start.velocity + speed * axis)


def _rounded(start: State) -> State:
    """Return the start in doubles; this rounding is small compared with the nudges."""
    return replace(start, exact_omega_world=None)


def _reordered(truth: Truth, order: NDArray[np.intp]) -> Truth:
    motion = truth.trajectory
    trajectory = replace(motion, **_rows(motion, order))
    return replace(truth, trajectory=trajectory, **_rows(truth, order))


def _rows(samples: Truth | Trajectory, order: NDArray[np.intp]) -> dict[str, Any]:
    """Return the arrays of samples in another order, by the names of their fields."""
    values = {field.name: getattr(samples, field.name) for field in fields(samples)}
    return {name: value[order] for name, value in values.items() if isinstance(value, np.ndarray)}
