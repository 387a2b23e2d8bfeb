"""The truth of a scene: its exact motion where it is free, else a high-order solution, each with a bound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import (
    angular_momentum,
    gravity_potential,
    rotational_energy,
    translational_energy,
)
from bodycheck.reference_impl.equations import packed_body
from bodycheck.reference_impl.exact import ExactMotion
from bodycheck.reference_impl.rotations import (
    exp_quaternion,
    geodesic_angle,
    normalised,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.taylor import integrate_taylor
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import wrench_between

EXACT_BOUND_RAD = 1e-14
EXACT_BOUND_RELATIVE = 1e-14
"""What the tests hold the closed form to, against 50-digit arithmetic, rounded up."""

_COARSE, _FINE = (22, 1e-17), (28, 1e-18)  # (order, tolerance) of the two resolutions
_NUDGE = 1e-7  # rad, or relative to max |omega|: the size of the perturbations that measure sensitivity
_MARGIN = 10.0
_EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True, eq=False)
class Truth:
    """A motion that others are measured with, and how far it may itself be off at each sample (n,).

    bound_rad: orientation. bound_energy, bound_momentum: relative to the scene's largest kinetic energy
    and angular momentum. round_off_rad, round_off_energy, round_off_momentum: eps x sensitivity, what
    any stepper in double precision has to expect. kind: exact, or estimate (the difference of two
    resolutions, and the round-off).
    """

    trajectory: Trajectory
    kind: Literal["exact", "estimate"]
    bound_rad: Array
    bound_energy: Array
    bound_momentum: Array
    round_off_rad: Array
    round_off_energy: Array
    round_off_momentum: Array


def solve_truth(scene: Scene, t_s: Array) -> Truth:
    """Return the truth of the scene at any times t >= 0 (n,), in any order.

    Raises ValueError that names the first time that is negative or not finite, or at which the motion
    itself leaves the range of double precision.
    """
    for t in t_s[~(np.isfinite(t_s) & (t_s >= 0.0))]:
        raise ValueError(f"a truth needs times that are finite and not negative, not {float(t)!r}")
    order = np.argsort(t_s, kind="stable")
    ascending = _free_truth(scene, t_s[order]) if scene.is_free_rotation else _estimate(scene, t_s[order])
    _check_finite(ascending.trajectory)
    return _reordered(ascending, np.argsort(order, kind="stable"))


def _check_finite(motion: Trajectory) -> None:
    """Refuse to hand out a truth that is none."""
    parts = (motion.position_m, motion.velocity_m_s, motion.attitude, motion.omega_body)
    finite = np.all([np.isfinite(part).all(axis=-1) for part in parts], axis=0)
    if not finite.all():
        first = float(motion.t_s[np.argmin(finite)])
        raise ValueError(f"the motion cannot be computed in double precision at t = {first!r} s")


def _free_truth(scene: Scene, t_s: Array) -> Truth:
    """Solve in closed form, whose bound does not grow, for ascending times."""
    motion = ExactMotion.of(scene).at(t_s)
    neighbours = [ExactMotion.of(replace(scene, initial=start)).at(t_s) for start in _nudges(scene, motion)]
    angle, relative = np.full(len(t_s), EXACT_BOUND_RAD), np.full(len(t_s), EXACT_BOUND_RELATIVE)
    return Truth(motion, "exact", angle, relative, relative, *_round_off(scene, motion, neighbours))


def _estimate(scene: Scene, t_s: Array) -> Truth:
    """bound = 10 (|difference of two resolutions| + eps sensitivity), for ascending times."""
    fine = _solve(scene, scene.initial, t_s, *_FINE)
    coarse = _solve(scene, scene.initial, t_s, *_COARSE)
    neighbours = [_solve(scene, start, t_s, *_COARSE) for start in _nudges(scene, fine)]
    round_off = _round_off(scene, fine, neighbours)
    bounds = (
        _MARGIN * (np.maximum.accumulate(gap) + noise)
        for gap, noise in zip(_distances(scene, fine, coarse), round_off, strict=True)
    )
    return Truth(fine, "estimate", *bounds, *round_off)


def _round_off(scene: Scene, motion: Trajectory, neighbours: list[Trajectory]) -> list[Array]:
    """eps x the largest growth of a small nudge up to each time, of angle, energy and momentum: (n,) each."""
    gaps = [_distances(scene, motion, neighbour) for neighbour in neighbours]
    # no motion is less sensitive than a steady spin is to an error of eps in omega
    least = 1.0 + _largest_omega(motion) * motion.t_s
    growths = (np.max([gap[i] for gap in gaps], axis=0) / _NUDGE for i in range(3))
    return [_EPS * np.maximum.accumulate(np.maximum(growth, least)) for growth in growths]


def _largest_omega(motion: Trajectory) -> float:
    return float(np.max(np.linalg.norm(motion.omega_body, axis=-1), initial=0.0))


def _nudges(scene: Scene, motion: Trajectory) -> Iterator[State]:
    """Yield six neighbours of the start: turned about, and spun up about, each body axis."""
    start, omega = scene.initial, _NUDGE * _largest_omega(motion)
    for axis in np.eye(3):
        turned = quaternion_product(start.quaternion, exp_quaternion(_NUDGE * axis))
        yield replace(start, quaternion=normalised(turned))
        yield replace(start, omega_body=start.omega_body + omega * axis)


def _solve(scene: Scene, start: State, t_s: Array, order: int, tolerance: float) -> Trajectory:
    """Integrate piece by piece from switch to switch, through ascending times."""
    last = float(t_s[-1]) if len(t_s) else 0.0
    edges = [0.0, *scene.switches_before(last), last]
    state = np.concatenate([start.quaternion, start.omega_body, start.velocity, start.position])
    body, rows = packed_body(scene.body), []
    for begin, end in pairwise(edges):
        load = wrench_between(scene, begin, end).packed(scene.body, scene.gravity) if end > begin else None
        inside = t_s[(t_s >= begin) & ((t_s < end) | (end == last))]
        if load is None:
            rows.append(np.tile(state, (len(inside), 1)))
            continue
        piece, _ = integrate_taylor(state, body, load, inside - begin, end - begin, order, tolerance)
        rows.append(piece)
    solved = np.concatenate(rows)
    return Trajectory(
        t_s=t_s,
        position_m=solved[:, 10:13],
        velocity_m_s=solved[:, 7:10],
        quaternion=normalised(solved[:, 0:4]),
        omega_body_rad_s=solved[:, 4:7],
    )


def _distances(scene: Scene, one: Trajectory, other: Trajectory) -> tuple[Array, Array, Array]:
    """Angle in rad, and difference of E and of L over the scene's scales, at each sample (n,)."""
    energies, momenta = zip(*(_energy_and_momentum(scene, motion) for motion in (one, other)), strict=True)
    energy_scale = np.max(np.abs(_kinetic(scene, one)), initial=0.0) or 1.0
    momentum_scale = np.max(np.linalg.norm(momenta[0], axis=-1), initial=0.0) or 1.0
    return (
        geodesic_angle(one.attitude, other.attitude),
        np.abs(energies[1] - energies[0]) / energy_scale,
        np.linalg.norm(momenta[1] - momenta[0], axis=-1) / momentum_scale,
    )


def _kinetic(scene: Scene, motion: Trajectory) -> Array:
    body = scene.body
    return rotational_energy(body.inertia, motion.omega_body) + translational_energy(
        body.mass, motion.velocity_m_s
    )


def _energy_and_momentum(scene: Scene, motion: Trajectory) -> tuple[Array, Array]:
    moved = motion.position_m - scene.initial.position
    energy = _kinetic(scene, motion) + gravity_potential(scene.body.mass, scene.gravity, moved)
    rotation = quaternion_to_matrix(motion.attitude)
    return energy, angular_momentum(rotation, scene.body.inertia, motion.omega_body)


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
    )
