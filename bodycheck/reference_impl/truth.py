"""The truth of a scene: its closed form where it has one, else a certified motion, each with its bounds.

Loads that only a function knows have no series: those scenes are solved with shorter and shorter steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.bounded_motion import Kind, Truth
from bodycheck.reference_impl.closeness import distances, rounding, small_distances
from bodycheck.reference_impl.dynamics import gyration_radius
from bodycheck.reference_impl.exact import ExactMotion, closed_form_of
from bodycheck.reference_impl.halving import Halved, solve_by_halving, solve_with_steps
from bodycheck.reference_impl.rotations import exp_quaternion, normalised, quaternion_product
from bodycheck.reference_impl.scene import BlackBox, Scene, Spring, State
from bodycheck.reference_impl.taylor import Course, Resolution, Solution, course_of, packed_state
from bodycheck.reference_impl.taylor_scene import follow_scene
from bodycheck.reference_impl.trajectory import Trajectory

_EXACT_BOUNDS = np.array([[4e-15], [8e-15], [8e-15]])
"""What the tests hold the closed form to: angle in rad, energy and momentum relative, from omega's 4e-15."""

_FINE, _CHECK = Resolution(30, 1e-32, 19), Resolution(34, 1e-33, 21)
_NUDGED, _NUDGED_STEPS = Resolution(18, 1e-17), 512
_NUDGE = 1e-7  # rad, or relative to max |omega|: the size of the perturbations that measure sensitivity
_PROPORTIONAL_RAD = 1e-2  # an angle up to which a nudge grows in proportion to its size
_FINE_NUDGE = 1e-15  # of those nudges: what double-doubles still hold to nine digits
_MARGIN = 10.0
_EPS = float(np.finfo(np.float64).eps)
_EPS_PAIR = 2.0**-104  # of double-double arithmetic
_TRUSTED_RAD = 1e-10


def solve_truth(scene: Scene, t_s: Array) -> Truth:
    """Return the truth of the scene at any times t >= 0 (n,) in s, in any order.

    Raises ValueError that names the first time that is negative or not finite, or at which the motion
    itself leaves the range of double precision; for loads that cannot act together; and where a function
    gives no force and torque.
    """
    for t in t_s[~(np.isfinite(t_s) & (t_s >= 0.0))]:
        raise ValueError(f"a truth needs times that are finite and not negative, not {float(t)!r}")
    order = np.argsort(t_s, kind="stable")
    return _reordered(_ascending(scene, t_s[order]), np.argsort(order, kind="stable"))


def _ascending(scene: Scene, t_s: Array) -> Truth:
    if scene.has_black_box:
        return _halved(scene, t_s)
    closed = closed_form_of(scene)
    return certified_truth(scene, t_s) if closed is None else _exact(scene, closed, t_s)


def _check_finite(motion: Trajectory) -> None:
    """Refuse to hand out a truth that is none."""
    parts = (motion.position_m, motion.velocity_m_s, motion.attitude, motion.omega_body)
    finite = np.all([np.isfinite(part).all(axis=-1) for part in parts], axis=0)
    if not finite.all():
        first = float(motion.t_s[np.argmin(finite)])
        raise ValueError(f"the motion cannot be computed in double precision at t = {first!r} s")


def _exact(scene: Scene, closed: ExactMotion, t_s: Array) -> Truth:
    """bound = that of the closed form, which does not grow, + half an ulp of each number, ascending times."""
    motion = closed.at(t_s)
    _check_finite(motion)
    neighbours = [_neighbour(replace(scene, initial=start), t_s) for start in _nudges(scene, motion)]
    bounds = np.maximum.accumulate(_EXACT_BOUNDS + rounding(scene, motion), axis=1)
    return Truth(motion, "exact", *bounds, *_EPS * _growths(scene, motion, neighbours))


def _neighbour(scene: Scene, t_s: Array) -> Trajectory:
    """Return the motion from a nudged start, which may have left the closed form."""
    closed = closed_form_of(scene)
    if closed is not None:
        return closed.at(t_s)
    course = course_of(scene, float(t_s[-1]) if len(t_s) else 0.0)
    return _trajectory(t_s, follow_scene(scene, course, packed_state(scene.initial), t_s, _NUDGED))


def certified_truth(scene: Scene, t_s: Array) -> Truth:
    """bound = 10 (|difference of two resolutions| + 2^-104 sensitivity steps) + half an ulp, ascending times.

    t_s (n,) in s, ascending. For any scene of known loads, also one that has a closed form. The half ulp is
    that of every number handed out: some 3e-16 rad. Raises ValueError as `solve_truth` does.
    """
    course = course_of(scene, float(t_s[-1]) if len(t_s) else 0.0)
    fine, check = (
        follow_scene(scene, course, packed_state(scene.initial), t_s, resolution)
        for resolution in (_FINE, _CHECK)
    )
    motion = _trajectory(t_s, fine)
    _check_finite(motion)
    growths = _certified_growths(scene, course, motion, fine)
    gaps = small_distances(scene, motion, (check.high - fine.high) + (check.low - fine.low))
    noise = _EPS_PAIR * growths * (1 + max(fine.steps, check.steps))
    return _bounded(scene, motion, "certified", gaps + noise, growths)


def _halved(scene: Scene, t_s: Array) -> Truth:
    """bound = 10 (|difference of two step lengths| + eps sensitivity sqrt(steps)) + half an ulp.

    Round-off errs as often one way as the other; two motions of order 8 differ by 255 times what the finer
    one is off.
    """
    halved = solve_by_halving(scene, t_s)
    _check_finite(halved.motion)
    growths = _halved_growths(scene, halved)
    noise = _EPS * growths * math.sqrt(halved.steps)
    kind: Kind = "certified" if halved.agreed else "estimated"
    return _bounded(scene, halved.motion, kind, halved.gaps + noise, growths)


def _halved_growths(scene: Scene, halved: Halved) -> Array:
    """The growths of nudges, by steps that are fine enough for them: neighbours err alike."""
    t_s, steps = halved.motion.t_s, min(halved.steps, _NUDGED_STEPS)
    dt_s = (float(t_s[-1]) if len(t_s) and t_s[-1] > 0.0 else 1.0) / steps
    starts = [scene.initial, *_nudges(scene, halved.motion)]
    motion, *neighbours = (solve_with_steps(scene, start, t_s, dt_s) for start in starts)
    return _growths(scene, motion, neighbours)


def _bounded(scene: Scene, motion: Trajectory, kind: Kind, errors: Array, growths: Array) -> Truth:
    """Return the truth of a motion whose errors (3, n) are known but for a margin."""
    bounds = np.maximum.accumulate(_MARGIN * errors + rounding(scene, motion), axis=1)
    truth = Truth(motion, kind, *bounds, *_EPS * growths)
    lost = motion.t_s[truth.bound_rad > _TRUSTED_RAD]
    return replace(truth, trusted_until_s=float(lost[0])) if len(lost) else truth


def _certified_growths(scene: Scene, course: Course, motion: Trajectory, fine: Solution) -> Array:
    """(3, n): as _growths; in double-doubles where nudges that doubles can hold grow out of proportion."""
    t_s = motion.t_s
    neighbours = [
        _trajectory(t_s, follow_scene(scene, course, packed_state(start), t_s, _NUDGED))
        for start in _nudges(scene, motion)
    ]
    growths = _growths(scene, motion, neighbours)
    if float(np.max(growths[0], initial=0.0)) * _NUDGE < _PROPORTIONAL_RAD:
        return growths
    apart = np.zeros_like(growths)
    high, low = packed_state(scene.initial)
    for start in _nudges(scene, motion):
        nudged_high, nudged_low = packed_state(start)
        nudge = _FINE_NUDGE * ((nudged_high - high) + (nudged_low - low))
        found = follow_scene(scene, course, (high.copy(), low + nudge), t_s, _FINE)
        difference = (found.high - fine.high) + (found.low - fine.low)
        apart = np.maximum(apart, small_distances(scene, motion, difference))
    return np.maximum.accumulate(np.maximum(growths, apart / (_NUDGE * _FINE_NUDGE)), axis=1)


def _trajectory(t_s: Array, solution: Solution) -> Trajectory:
    """Round a solution to doubles."""
    state = solution.high  # the nearest double to high + low is high
    return Trajectory(
        t_s=t_s,
        position_m=state[:, 10:13],
        velocity_m_s=state[:, 7:10],
        quaternion=state[:, 0:4],
        omega_body_rad_s=state[:, 4:7],
    )


def _growths(scene: Scene, motion: Trajectory, neighbours: list[Trajectory]) -> Array:
    """(3, n): the largest growth of a small nudge up to each time, of angle, energy and momentum."""
    gaps = np.max([distances(scene, motion, neighbour) for neighbour in neighbours], axis=0)
    # no motion is less sensitive than a steady spin is to an error of eps in omega
    least = 1.0 + _largest_omega(motion) * motion.t_s
    return np.maximum.accumulate(np.maximum(gaps / _NUDGE, least), axis=1)


def _largest_omega(motion: Trajectory) -> float:
    return float(np.max(np.linalg.norm(motion.omega_body, axis=-1), initial=0.0))


def _nudges(scene: Scene, motion: Trajectory) -> Iterator[State]:
    """Yield neighbours of the start: turned about, and spun up about, each body axis.

    Where a spring or a function may tie the rotation to the centre of mass, that is shifted and pushed along
    each axis too.
    """
    start, omega = scene.initial, _NUDGE * _largest_omega(motion)
    for axis in np.eye(3):
        turned = quaternion_product(start.quaternion, exp_quaternion(_NUDGE * axis))
        yield replace(start, quaternion=normalised(turned))
        yield replace(start, omega_body=start.omega_body + omega * axis)
    tied = any(isinstance(load, Spring | BlackBox) for load in scene.loads)
    if tied and scene.pivot is None:
        radius = gyration_radius(scene.body.mass, scene.body.inertia)
        speed = float(np.max(np.linalg.norm(motion.velocity_m_s, axis=-1), initial=0.0))
        for axis in np.eye(3):
            yield replace(start, position=start.position + _NUDGE * radius * axis)
            yield replace(start, velocity=start.velocity + _NUDGE * speed * axis)


def _reordered(truth: Truth, order: NDArray[np.intp]) -> Truth:
    motion = truth.trajectory
    assert motion.quaternion is not None
    assert motion.omega_body_rad_s is not None
    return Truth(
        Trajectory(
            t_s=motion.t_s[order],
            position_m=motion.position_m[order],
            velocity_m_s=motion.velocity_m_s[order],
            quaternion=motion.quaternion[order],
            omega_body_rad_s=motion.omega_body_rad_s[order],
        ),
        truth.kind,
        truth.bound_rad[order],
        truth.bound_energy[order],
        truth.bound_momentum[order],
        truth.round_off_rad[order],
        truth.round_off_energy[order],
        truth.round_off_momentum[order],
        truth.trusted_until_s,
    )
