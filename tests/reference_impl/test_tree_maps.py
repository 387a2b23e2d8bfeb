"""The steps of trees: their formulas by the exact dynamics, the maps of one body, and their order."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps import MAPS, TREE_MAPS
from bodycheck.reference_impl.one_step_maps.one_step_map import Motion, Solid
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_dynamics import tree_dynamics
from bodycheck.reference_impl.trees.tree_motion import tree_motion
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.reference_impl.trees.tree_truth import certified_tree

_H = 1e-2


def accelerations(scene: TreeScene, name: str, t_s: float) -> Array:
    """Return a of the formula of a map at the start, from M, c and tau of the exact dynamics."""
    at = tree_dynamics(scene, t_s=t_s)
    per_rate = [(body.joint, k) for body in scene.bodies for k in range(body.joint.of_kind.rates)]
    damping, stiffness = (
        np.diag([getattr(joint, what) for joint, _ in per_rate]) for what in ("damping", "stiffness")
    )
    matrix, force = at.mass_matrix.copy(), at.applied - at.bias
    if name in ("M1d", "M2s", "M2"):
        matrix += _H * damping
    if name == "M2s":
        matrix += _H**2 * stiffness
        force -= _H * stiffness @ scene.u0
    if name == "M2":
        for j, unit in enumerate(np.eye(len(scene.u0))):
            up, down = (tree_dynamics(scene, u=scene.u0 + sign * unit, t_s=t_s).bias for sign in (1, -1))
            matrix[:, j] += _H * 0.5 * (up - down)
    return np.linalg.solve(matrix, force)


def moved(scene: TreeScene, u: Array) -> Array:
    """q (+) h u."""
    q = scene.q0.copy()
    for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        own, speed, straight = q[places], _H * u[rates], (0, 1, 3)[body.joint.of_kind.translation]
        own[:straight] += speed[:straight]
        if body.joint.of_kind.rotation is Rotation.BALL:
            own[straight:] = quaternion_product(own[straight:], exp_quaternion(speed[straight:]))
        else:
            own[straight:] += speed[straight:]
    return q


@pytest.mark.slow
@pytest.mark.nightly(after=3)
@pytest.mark.parametrize("name", ["M1", "M1d", "M2s", "M2"])
@pytest.mark.parametrize("seed", range(3))
def test_formulas_of_first_order(name: str, seed: int) -> None:
    """A step of a random tree with springs, dampers and loads is that of the formula, to 1e-12."""
    scene = random_tree(np.random.default_rng(seed), 4, loads=True)
    q, u = TREE_MAPS[name].step(scene, 0.3, scene.q0, scene.u0, _H)
    expected = scene.u0 + _H * accelerations(scene, name, 0.3)
    assert np.max(np.abs(u - expected)) < 1e-12 * np.max(np.abs(expected))
    assert np.max(np.abs(q - moved(scene, expected))) < 1e-12


@pytest.mark.parametrize("name", TREE_MAPS)
def test_free_body_is_stepped_by_the_map_of_one_body(name: str) -> None:
    """A tree of one free body makes the step of the catalogue's map for one body."""
    inertia = np.array([[0.03, 0.004, 0.0], [0.004, 0.05, -0.003], [0.0, -0.003, 0.06]])
    start, rate = np.array([0.1, 0.2, -0.3, 0.5, 0.5, -0.1, 0.7]), np.array([0.3, -0.2, 0.1, 2.0, -3.0, 1.0])
    start[3:] /= np.linalg.norm(start[3:])
    body = TreeBody("one", 2.0, inertia, Joint("free", start=start, rate=rate))
    scene = TreeScene((body,), (), np.zeros(3), 1.0, 11)
    q, u = TREE_MAPS[name].step(scene, 0.0, start, rate, _H)
    before = Motion(np.zeros(1), start[None, :3], rate[None, :3], start[None, 3:], rate[None, 3:])

    def none(t: Array, *_: Array) -> tuple[Array, Array]:
        return np.zeros((len(t), 3)), np.zeros((len(t), 3))

    after = MAPS[TREE_MAPS[name].one_body].step(Solid(np.asarray(2.0), inertia), before, np.array([_H]), none)
    assert np.max(np.abs(q - np.concatenate([after.position[0], after.quaternion[0]]))) < 1e-14
    assert np.max(np.abs(u - np.concatenate([after.velocity[0], after.omega[0]]))) < 1e-14


@pytest.mark.parametrize("name", TREE_MAPS)
def test_order_of_the_maps_on_a_tree(name: str) -> None:
    """Halved steps divide the error at the end by 2^order on a random tree with loads, within 6 %."""
    scene = random_tree(np.random.default_rng(5), 4, loads=True, floating=True)
    end = 0.2
    true = certified_tree(scene, np.array([end])).motion
    errors = []
    for steps in (80, 160):
        q, u = TREE_MAPS[name].step(scene, 0.0, scene.q0, scene.u0, end / steps, steps)
        found = tree_motion(scene, np.array([end]), q[None], u[None])
        errors.append(np.linalg.norm(found.position - true.position))
    assert math.log2(errors[0] / errors[1]) == pytest.approx(TREE_MAPS[name].order, rel=0.06)
