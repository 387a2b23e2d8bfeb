"""Laws of trees: another description of a tree gives the same motion of its bodies.

To add a law, add its name to LawName and the law to TREE_LAWS; `bodycheck laws` checks it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import invalid_state
from bodycheck.examine.probes.laws import Break, Checked, Law
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.rotations import (
    conjugate,
    exp_quaternion,
    geodesic_angle,
    normalised,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.reports.measurement.case import RunCase

_STEP_S, _STEPS, _FINER = 2.0**-7, 16, 4
_POINT_KG = 0.1
_SAFETY = 2e3  # of the relative error of one step, over all steps and bodies
_SLOWER = 0.5  # than the order of the method, at most, a violation that is its error falls

Undo: TypeAlias = Callable[[Array, Array, Array, Array, Array], tuple[Array, Array, Array, Array]]
"""(times, positions, quaternions, velocities, omega), each (n, b, ...) but the times -> the last four."""


@dataclass(frozen=True, eq=False)
class _Variant:
    """Another description of the tree, where each of its bodies stands there, and how motions return."""

    scene: TreeScene
    places: Sequence[int]
    undo: Undo = lambda _, x, q, v, w: (x, q, v, w)


def _tree() -> TreeScene:
    """Return a free body that carries a chain of two hinges, and another hinge, under gravity."""
    bodies = (
        TreeBody("base", 2.0, np.diag([0.04, 0.06, 0.08]), Joint("free", start=_START, rate=_RATES)),
        TreeBody("upper", 1.0, np.diag([0.01, 0.03, 0.035]), _hinge(0, (0.0, 1.0, 0.0), 0.4, 1.5)),
        TreeBody("lower", 0.5, np.diag([0.004, 0.009, 0.01]), _hinge(1, (0.0, 0.6, 0.8), -0.7, -2.0)),
        TreeBody("arm", 0.4, np.diag([0.003, 0.005, 0.007]), _hinge(0, (1.0, 0.0, 0.0), 0.2, 1.0)),
    )
    gravity = np.array([0.5, -1.0, -9.0])
    return TreeScene(bodies, (), gravity, _STEPS * _STEP_S, 5)


_START = np.array([0.1, -0.2, 0.3, *normalised(np.array([0.9, 0.1, -0.3, 0.2]))])
_RATES = np.array([0.3, -0.2, 0.4, 0.5, 2.0, 0.3])


def _hinge(parent: int, axis: tuple[float, float, float], start: float, rate: float) -> Joint:
    return Joint(
        "hinge",
        parent,
        np.array([0.3, 0.02, 0.05 * (parent + 1)]),
        np.array([-0.25, 0.01, -0.05]),
        normalised(np.array([0.9, 0.2, 0.1, -0.3])),
        np.array(axis),
        np.array([start]),
        np.array([rate]),
    )


def _with_base(scene: TreeScene, q: Array, u: Array) -> tuple[TreeBody, ...]:
    base = scene.bodies[0]
    return (replace(base, joint=replace(base.joint, start=q, rate=u)), *scene.bodies[1:])


def _same(scene: TreeScene) -> range:
    return range(len(scene.bodies))


def _rotated(scene: TreeScene) -> _Variant:
    turn = normalised(np.array([0.3, -0.7, 0.5, 0.4]))
    R = quaternion_to_matrix(turn)
    q = np.concatenate([R @ scene.q0[:3], quaternion_product(turn, scene.q0[3:7])])
    u = np.concatenate([R @ scene.u0[:3], scene.u0[3:6]])
    other = replace(scene, bodies=_with_base(scene, q, u), gravity=R @ scene.gravity)
    return _Variant(
        other,
        _same(scene),
        lambda _, x, q, v, w: (x @ R, quaternion_product(conjugate(turn), q), v @ R, w),
    )


def _boosted(scene: TreeScene) -> _Variant:
    boost = np.array([2.0, -1.0, 1.5])
    u = scene.u0[:6] + np.concatenate([boost, np.zeros(3)])
    return _Variant(
        replace(scene, bodies=_with_base(scene, scene.q0[:7], u)),
        _same(scene),
        lambda t, x, q, v, w: (x - t[:, None, None] * boost, q, v - boost, w),
    )


def _shifted(scene: TreeScene) -> _Variant:
    shift = np.array([8.0, -4.0, 2.0])
    q = scene.q0[:7] + np.concatenate([shift, np.zeros(4)])
    return _Variant(
        replace(scene, bodies=_with_base(scene, q, scene.u0[:6])),
        _same(scene),
        lambda _, x, q, v, w: (x - shift, q, v, w),
    )


def _reordered(scene: TreeScene) -> _Variant:
    base, upper, lower, arm = scene.bodies
    lower = replace(lower, joint=replace(lower.joint, parent=2))
    return _Variant(replace(scene, bodies=(base, arm, upper, lower)), (0, 2, 3, 1))


def _of_hinges(scene: TreeScene, change: Callable[[Joint], Joint]) -> _Variant:
    bodies = (
        body if body.joint.kind == "free" else replace(body, joint=change(body.joint))
        for body in scene.bodies
    )
    return _Variant(replace(scene, bodies=tuple(bodies)), _same(scene))


def _flipped(scene: TreeScene) -> _Variant:
    return _of_hinges(
        scene, lambda one: replace(one, axis=-one.axis, start=-one.coordinates, rate=-one.rates)
    )


def _from_another_zero(scene: TreeScene) -> _Variant:
    by = 0.8
    return _of_hinges(
        scene,
        lambda one: replace(
            one, zero=quaternion_product(one.zero, exp_quaternion(by * one.axis)), start=one.coordinates - by
        ),
    )


def _rerooted(scene: TreeScene) -> _Variant:
    """Let the second body be the free one: its joint is that of the first, reversed."""
    start = tree_trajectory(scene, np.zeros(1), scene.q0[None], scene.u0[None])
    base, upper, lower, arm = scene.bodies
    free = Joint(
        "free",
        start=np.concatenate([start.position_m[0, 1], start.attitude[0, 1]]),
        rate=np.concatenate([start.velocity_m_s[0, 1], start.omega_body[0, 1]]),
    )
    hinge = upper.joint
    reversed_hinge = replace(
        hinge,
        parent=0,
        at_parent=hinge.at_body,
        at_body=hinge.at_parent,
        zero=conjugate(hinge.zero),
        axis=quaternion_to_matrix(hinge.zero) @ hinge.axis,
        start=-hinge.coordinates,
        rate=-hinge.rates,
    )
    bodies = (
        replace(upper, joint=free),
        replace(base, joint=reversed_hinge),
        replace(lower, joint=replace(lower.joint, parent=0)),
        replace(arm, joint=replace(arm.joint, parent=1)),
    )
    return _Variant(replace(scene, bodies=bodies), (1, 0, 2, 3))


def _divided(scene: TreeScene) -> _Variant:
    """Cut a point mass out of the second body where the third is hinged to it, and add it to the third.

    The point moves with both bodies, so that the joints move as before.
    """
    base, upper, lower, arm = scene.bodies
    joint = lower.joint
    upper, off_upper = _with_point(upper, -_POINT_KG, joint.at_parent)
    lower, off_lower = _with_point(lower, _POINT_KG, joint.at_body)
    lower = replace(lower, joint=replace(lower.joint, at_parent=joint.at_parent - off_upper))

    def undo(_: Array, x: Array, q: Array, v: Array, w: Array) -> tuple[Array, Array, Array, Array]:
        x, v = x.copy(), v.copy()
        for body, off in ((1, off_upper), (2, off_lower)):
            R = quaternion_to_matrix(q[:, body])
            x[:, body] -= R @ off
            v[:, body] -= np.einsum("nij,nj->ni", R, np.cross(w[:, body], off))
        return x, q, v, w

    return _Variant(replace(scene, bodies=(base, upper, lower, arm)), _same(scene), undo)


def _with_point(body: TreeBody, mass: float, at: Array) -> tuple[TreeBody, Array]:
    """Return a jointed body with a point mass more at a place, and by how much its centre of mass moves."""
    total = body.mass + mass
    off = mass / total * at
    inertia = body.inertia + mass * parallel_axis_tensor(at) - total * parallel_axis_tensor(off)
    joint = replace(body.joint, at_body=body.joint.at_body - off)
    return replace(body, mass=total, inertia=inertia, joint=joint), off


TREE_LAWS: tuple[tuple[Law, Callable[[TreeScene], _Variant] | None], ...] = (
    (Law("tree-rotate"), _rotated),  # a tree that is rotated in the world gives the rotated motion
    (Law("tree-boost"), _boosted),  # a constant velocity is added to the motion
    (Law("tree-shift"), _shifted),  # another origin of the world shifts the motion
    (Law("tree-order"), _reordered),  # the order of the bodies changes nothing
    (Law("tree-flip"), _flipped),  # hinges with opposite axes, coordinates and rates give the same motion
    (Law("tree-zero"), _from_another_zero),  # coordinates that count from elsewhere do
    (Law("tree-divide"), _divided),  # a body that is divided, with a part of it counted to the next, does
    (Law("tree-root"), _rerooted),  # another free body does
    (Law("tree-repeat"), None),  # after reset, the same motion again
)
"""Every law of trees."""


def check_tree_laws(engine: Engine, method: Method, ask: RunCase, replay: RunCase) -> list[Checked]:
    """Check every law on one method; none if the engine moves no trees."""
    if not engine.moves_trees:
        return []
    found = []
    for law, describe in TREE_LAWS:
        coarse = _violation(engine, method, ask, replay, describe, _STEPS)
        if isinstance(coarse, str):
            found.append(Checked(law, "not-measured", message=coarse))
        elif coarse.ratio <= 1.0:
            found.append(Checked(law, "holds", coarse))
        else:
            finer = _violation(engine, method, ask, replay, describe, _FINER * _STEPS)
            found.append(_broken(law, method, coarse, finer))
    return found


def _broken(law: Law, method: Method, coarse: Break, fine: Break | str) -> Checked:
    """Return a law that is broken; one whose violation falls like the method's error is a property."""
    text = f"{coarse.quantity} differs by {coarse.size:.3g} at t = {coarse.t_s:.4g} s"
    least = _FINER ** ((method.order or 1) - _SLOWER)
    if method.control == "dt" and not isinstance(fine, str) and coarse.size >= least * fine.size:
        return Checked(
            law, "property", coarse, f"{text}; it falls with the step like the error of the method"
        )
    return Checked(law, "broken", coarse, text)


def _violation(
    engine: Engine,
    method: Method,
    ask: RunCase,
    replay: RunCase,
    describe: Callable[[TreeScene], _Variant] | None,
    steps: int,
) -> Break | str:
    """Return the largest difference of two motions, or why there is none."""
    scene = _tree()
    variant = _Variant(scene, _same(scene)) if describe is None else describe(scene)
    dt_s = scene.duration_s / steps
    setting = method.setting(dt_s)
    motions: list[Trajectory] = []
    for run_case, one in ((ask, scene), (replay if describe is None else ask, variant.scene)):
        answer = run_case(engine, Case(one, method.name, setting))
        if answer.trajectory is None:
            return f"{answer.outcome}: {answer.message}"
        if reason := invalid_state(answer.trajectory):
            return f"unstable: {reason}"
        motions.append(answer.trajectory)
    base, other = motions
    at = [*variant.places]
    moved = variant.undo(
        base.t_s,
        other.position_m[:, at],
        other.attitude[:, at],
        other.velocity_m_s[:, at],
        other.omega_body[:, at],
    )
    eps = float(np.finfo(np.float32 if method.precision != "float64" else np.float64).eps)
    speed = float(np.max(np.linalg.norm(base.omega_body, axis=-1)))
    own = (base.position_m, base.attitude, base.velocity_m_s, base.omega_body)
    sizes = {
        "attitude": geodesic_angle(moved[1], own[1]),
        "position": np.linalg.norm(moved[0] - own[0], axis=-1),
        "velocity": np.linalg.norm(moved[2] - own[2], axis=-1) / speed,
        "omega": np.linalg.norm(moved[3] - own[3], axis=-1) / speed,
    }
    worst = max(sizes, key=lambda name: float(np.max(sizes[name])))
    largest = np.max(sizes[worst], axis=1)
    k = int(np.argmax(largest))
    return Break(float(largest[k]), _SAFETY * eps, worst, "tree", setting.dt_s, float(base.t_s[k]))
