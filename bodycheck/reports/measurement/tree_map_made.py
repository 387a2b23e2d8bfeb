"""Which one-step map of the catalogue of trees a motion follows, from sample to sample."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.adapters.contract import Precision
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, log_quaternion, normalised, quaternion_product
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.wrench import StepPlan
from bodycheck.reports.measurement.scales import Scales

if TYPE_CHECKING:
    from bodycheck.reference_impl.one_step_maps.tree_maps import TreeMap

_TRANSITIONS = 3
_SAME = 1e-12  # relative: two maps this near are one
MADE: dict[Precision, float] = {"float64": 1e-9, "float32": 2e-6, "mixed": 2e-6}
"""The largest distance of a map that is made: attitudes of some engines go through rotation vectors."""
_FARTHER: dict[Precision, float] = {"float64": 1e3, "float32": 1e2, "mixed": 1e2}
"""How many times farther the next map must be."""
LINEAR = ", q + dt q omega / 2"
"""Added to the name of a map whose attitudes are turned linearly, in place of by exp."""

MAP, DISTANCE, NEXT = "tree_map", "tree_map_distance", "next_map_distance"
"""Columns of results.csv: the map that a case makes of a tree, its distance, and that of the next map."""


def made_map(
    scene: TreeScene, motion: Trajectory, plan: StepPlan, precision: Precision, scales: Scales
) -> dict[str, Any]:
    """Return the columns of the map that the first intervals between samples follow; none if none does.

    Each interval starts from the engine's own state. Distances are the largest of any coordinate, in rad or
    over the length, and of any rate over that of the fastest body. Maps that are the same here, as without
    damping and springs, count as the first of them.
    """
    if motion.q is None or motion.u is None or plan.mid_step_switches or plan.segments[0][0] < plan.stride:
        return {}
    from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS

    intervals = min(_TRANSITIONS, plan.segments[0][0] // plan.stride, len(motion.t_s) - 1)
    starts = [(float(motion.t_s[k]), motion.q[k], motion.u[k]) for k in range(intervals)]
    made: dict[str, list[tuple[Array, Array]]] = {
        name: [one.step(scene, *start, plan.dt_s, plan.stride) for start in starts]
        for name, one in TREE_MAPS.items()
    }
    if scene.turn_slices:
        made |= {
            f"{name}{LINEAR}": [_linearly(one, scene, *start, plan) for start in starts]
            for name, one in TREE_MAPS.items()
            if one.order == 1
        }
    found = [(motion.q[k + 1], motion.u[k + 1]) for k in range(intervals)]
    different: dict[str, list[tuple[Array, Array]]] = {}
    for name, states in made.items():
        if all(_distance(scene, states, known, scales) > _SAME for known in different.values()):
            different[name] = states
    distances = {name: _distance(scene, found, states, scales) for name, states in different.items()}
    nearest, *others = sorted(distances, key=lambda name: distances[name])
    # how attitudes are turned is no other map of the joints
    others = [name for name in others if name.partition(",")[0] != nearest.partition(",")[0]]
    is_near = distances[nearest] <= MADE[precision]
    if not (is_near and distances[nearest] * _FARTHER[precision] <= distances[others[0]]):
        return {}
    return {MAP: nearest, DISTANCE: distances[nearest], NEXT: distances[others[0]]}


def _linearly(
    one: TreeMap, scene: TreeScene, t_s: float, q: Array, u: Array, plan: StepPlan
) -> tuple[Array, Array]:
    """Make one interval's steps, each of which turns attitudes by q + dt q omega / 2, normalised."""
    for step in range(plan.stride):
        before, (q, u) = q, one.step(scene, t_s + step * plan.dt_s, q, u, plan.dt_s)
        for own, rates in scene.turn_slices:
            half = 0.5 * plan.dt_s * u[rates]
            q[own] = quaternion_product(normalised(before[own]), np.array([1.0, *half]))
    return q, u


def _distance(
    scene: TreeScene,
    one: list[tuple[Array, Array]],
    other: list[tuple[Array, Array]],
    scales: Scales,
) -> float:
    (q, u), (p, w) = ([np.stack(part) for part in zip(*states, strict=True)] for states in (one, other))
    parts = state_differences(scene, (q, u), (p, w), scales)
    sizes = (np.linalg.norm(part, axis=1) if is_turn else np.abs(part) for part, is_turn in parts)
    return max(float(np.max(size, initial=0.0)) for size in sizes)


def state_differences(
    scene: TreeScene, one: tuple[Array, Array], other: tuple[Array, Array], scales: Scales
) -> Iterator[tuple[Array, bool]]:
    """Yield one less other states (n, k), joint by joint, and whether they are rotation vectors.

    one, other: q (n, nq) and u (n, nu). Angles in rad, lengths and rates over the scales.
    """
    (q, u), (p, w) = one, other
    for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        kind = body.joint.of_kind
        own, right, moved = q[:, places], p[:, places], (0, 1, 3)[kind.translation]
        yield (own[:, :moved] - right[:, :moved]) / (scales.length_scale_m or 1.0), False
        if kind.rotation is Rotation.BALL:
            back = conjugate(normalised(right[:, moved:]))
            yield log_quaternion(quaternion_product(back, normalised(own[:, moved:]))), True
        elif kind.rotation is Rotation.AXIS:
            angle = own[:, moved:] - right[:, moved:]
            yield angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi)), False
        faster = u[:, rates] - w[:, rates]
        yield faster[:, :moved] / (scales.speed_scale_m_s or 1.0), False
        yield faster[:, moved:] / (scales.omega_scale_rad_s or 1.0), False
