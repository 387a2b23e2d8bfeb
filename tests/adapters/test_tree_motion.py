"""How engines move trees: each makes the one-step map that joints obey, also under springs and loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.tree_contract import held_loads, tree_mismatch
from bodycheck.adapters.workers import case_messages
from bodycheck.examine.dynamics.batch_dynamics import batch_dynamics
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_bodies import joints_of, tree_trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene, interval
from bodycheck.scenarios.library import load_trees, tree_names

_STEPS, _DT_S = 20, 1e-3
_METHODS = {
    "mujoco:euler": "damping",
    "mujoco:implicitfast": "damping",
    "mujoco:discrete": "damping and stiffness",
    "mujoco:implicit": "damping and bias",
    "dart:semi-implicit": "damping and stiffness",
    "pybullet:multibody": "nothing",
}
"""Method -> of which forces it takes the derivative into account; joints.md has the maps' formulas."""


def _forces(scene: TreeScene, q: Array, t_s: float) -> Array:
    """J^T F of the loads, and of the springs."""
    acting = [(load, 1.0) for load in scene.loads if interval(load)[0] <= t_s < interval(load)[1]]
    held, n = held_loads(scene, acting, t_s, q), len(scene.u0)
    forces = np.concatenate(held.joint)
    each = tree_trajectory(scene, np.zeros(n), np.tile(q, (n, 1)), np.eye(n))
    forces = forces + np.einsum("nbi,bi->n", each.velocity_m_s, held.force)
    forces = forces + np.einsum("nbi,bi->n", each.omega_world, held.torque)
    for body, place, rate in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        if body.joint.stiffness:
            forces[rate] -= body.joint.stiffness * (q[place] - body.joint.rest)
    return np.asarray(forces)


def _moved(scene: TreeScene, q: Array, change: Array) -> Array:
    moved = q.copy()
    for body, place, rate in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        kind, own, by = body.joint.of_kind, moved[place], change[rate]
        free = 3 if kind.translation is Translation.SPACE else 0
        if kind.rotation is Rotation.BALL:
            own[:free] += by[:free]
            own[-4:] = quaternion_product(own[-4:], exp_quaternion(by[-3:]))
        else:
            own += by
    return moved


def _by_map(scene: TreeScene, implicit: str) -> tuple[Array, Array]:
    """Return q and u after the steps of (M + h D + h^2 K + h dc/du) (u+ - u) / h = tau - c - h K u."""
    bare, q, u = replace(scene, loads=()), scene.q0, scene.u0
    damping, stiffness = np.zeros((2, len(u)))
    for body, rate in zip(scene.bodies, scene.rate_slices, strict=True):
        damping[rate], stiffness[rate] = body.joint.damping, body.joint.stiffness

    def bias(rates: Array) -> Array:
        (at,) = batch_dynamics([bare], q[None], rates[None])
        return at.bias

    for step in range(_STEPS):
        (at,) = batch_dynamics([bare], q[None], u[None])
        right, left = _forces(scene, q, step * _DT_S) - damping * u - at.bias, at.mass_matrix
        if "damping" in implicit:
            left = left + _DT_S * np.diag(damping)
        if "stiffness" in implicit:
            left, right = left + _DT_S**2 * np.diag(stiffness), right - _DT_S * stiffness * u
        if "bias" in implicit:
            columns = [(bias(u + unit) - bias(u - unit)) / 2.0 for unit in np.eye(len(u))]
            left = left + _DT_S * np.array(columns).T
        u = u + _DT_S * np.linalg.solve(left, right)
        q = _moved(scene, q, _DT_S * u)
    return q, u


def _random(seed: int, **options: bool) -> TreeScene:
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, int(rng.integers(2, 6)), **options)
    bodies = (replace(body, joint=replace(body.joint, armature=0.0)) for body in tree.bodies)
    return replace(tree, bodies=tuple(bodies), duration_s=_STEPS * _DT_S, samples=2)


@pytest.mark.slow(after=1)
@pytest.mark.nightly(after=5)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", _METHODS)
def test_a_method_makes_the_map_of_its_formula(name: str, seed: int) -> None:
    """20 steps of random trees with springs, dampers and loads end where the formula does."""
    engine, _, method = name.partition(":")
    scene = _random(seed, springs=True, loads=True)
    if engine == "pybullet":  # which has no springs
        bodies = (replace(body, joint=replace(body.joint, stiffness=0.0)) for body in scene.bodies)
        scene = replace(scene, bodies=tuple(bodies))
    answer = record(get_adapter(engine), Case(scene, method, Setting(dt_s=_DT_S)))
    assert answer.outcome == "ok", answer.message
    assert answer.trajectory is not None
    assert answer.read_back is not None
    assert tree_mismatch(scene, method, _DT_S, answer.read_back, "float64") is None
    q, u = _by_map(scene, _METHODS[name])
    own = tree_trajectory(scene, np.zeros(1), q[None], u[None])
    found = answer.trajectory
    tolerance = 1e-7 if engine == "dart" else 1e-12  # rotation vectors near pi lose digits
    assert np.max(np.abs(found.u[-1] - u)) < tolerance
    assert np.max(np.abs(found.rotation_matrices[-1] - own.rotation_matrices[0])) < tolerance
    assert np.max(np.abs(found.position_m[-1] - own.position_m[0])) < tolerance


@pytest.mark.parametrize("name", ["mujoco:euler", "dart:semi-implicit", "pybullet:multibody"])
@pytest.mark.parametrize(
    ("number", "change"),
    [
        ("mass", lambda held: held + 0.04),
        ("inertia", lambda held: 1.001 * held),
        ("zero", lambda held: np.roll(held, 1, axis=1)),
        ("place", lambda held: held + 1e-3),
        ("q", lambda held: held + 1e-3),
    ],
)
def test_a_tree_that_an_engine_holds_otherwise_is_a_mismatch(
    name: str, number: str, change: Callable[[Array], Array]
) -> None:
    """A wrong damping, inertia, frame or state that is read back is named."""
    engine, _, method = name.partition(":")
    scene = _random(1, springs=False, loads=False)
    answer = record(get_adapter(engine), Case(scene, method, Setting(dt_s=_DT_S)))
    assert answer.read_back is not None
    numbers = {**answer.read_back.numbers, number: change(answer.read_back.numbers[number])}
    wrong = replace(answer.read_back, numbers=numbers)
    assert str(tree_mismatch(scene, method, _DT_S, wrong, "float64")).startswith(number)


@pytest.mark.parametrize("engine", ["mujoco", "dart", "pybullet"])
@pytest.mark.parametrize("name", tree_names())
def test_a_built_in_tree_moves_or_is_refused_with_a_reason(engine: str, name: str) -> None:
    """Every method of every engine moves each built-in tree, or says why it cannot."""
    adapter, ((_, tree),) = get_adapter(engine), load_trees(name)
    scene = replace(tree.scene, duration_s=2e-3, samples=2)
    for method in adapter.methods:
        answer = record(adapter, Case(scene, method, Setting(dt_s=_DT_S)))
        assert answer.outcome == "ok" or (answer.outcome == "unsupported" and answer.message), answer


def test_a_tree_survives_the_message_to_a_worker() -> None:
    """All numbers and loads of a tree are the same after the message."""
    scene = _random(4, springs=True, loads=True)
    message = case_messages.scene_message(scene)
    again = case_messages.scene_of(message)
    assert case_messages.scene_message(again) == message
    assert isinstance(again, TreeScene)
    assert np.array_equal(again.q0, scene.q0)


def test_joints_are_read_off_the_poses_of_bodies() -> None:
    """Coordinates and rates follow from poses and velocities, and a body that is moved aside is a gap."""
    scene = _random(2, springs=False, loads=False)
    motion = tree_trajectory(scene, np.zeros(1), scene.q0[None], scene.u0[None])
    found = joints_of(scene, motion)
    q, u = np.hstack([one.q[0] for one in found]), np.hstack([one.u[0] for one in found])
    assert np.allclose(u, scene.u0, atol=1e-14)
    assert np.allclose(np.abs(q), np.abs(scene.q0), atol=1e-14)  # quaternions may have either sign
    assert max(one.gap_m[0] for one in found) < 1e-14
    apart = motion.position_m.copy()
    apart[:, -1] += 1e-3 * np.cross([0.6, 0.8, 0.0], scene.bodies[-1].joint.axis)
    gaps = [one.gap_m[0] for one in joints_of(scene, replace(motion, position_m=apart))]
    assert max(gaps) > 1e-4
