"""Trees made in Python: their faults, random ones, and joints with rotors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.scene import PointForce
from bodycheck.reference_impl.trees.joint_kinds import joint_kinds
from bodycheck.reference_impl.trees.random_trees import random_state, random_tree
from bodycheck.reference_impl.trees.tree_dynamics import tree_dynamics
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    Joint,
    JointSineTorque,
    JointTorque,
    TreeBody,
    TreeLoad,
    TreeScene,
)
from tests.helpers.expected_messages import ExpectedMessage

DOWN = np.array([0.0, 0.0, -9.81])
INERTIA = np.diag([0.1, 0.2, 0.25])


def scene(*bodies: TreeBody, loads: tuple[TreeLoad, ...] = ()) -> TreeScene:
    """Return a tree under gravity for 1 s."""
    return TreeScene(bodies, loads, DOWN, 1.0, 11)


BASE, ARM = TreeBody("base", 2.0, INERTIA, Joint("free")), TreeBody("arm", 1.0, INERTIA, Joint("hinge", 0))
FAULTS: dict[str, Callable[[], TreeScene]] = {
    "bodies": lambda: scene(
        replace(BASE, name="world", mass=-1.0),
        replace(ARM, inertia=np.diag([0.1, 0.2, -0.1])),
        replace(ARM, inertia=np.ones((3, 3)) + np.triu(np.ones((3, 3)))),
    ),
    "joints": lambda: scene(
        replace(BASE, joint=Joint("free", at_body=np.ones(3), armature=0.1, damping=0.1)),
        replace(ARM, joint=Joint("hinge", 1, np.zeros(2), axis=np.zeros(3), stiffness=-1.0, rest=np.inf)),
        replace(ARM, name="ball", joint=Joint("ball", 0, start=np.zeros(4), stiffness=1.0)),
        replace(ARM, name="weld", joint=Joint("weld", 0)),
        replace(BASE, name="second", joint=Joint("free", 0, zero=np.zeros(4))),
    ),
    "loads": lambda: scene(
        BASE,
        ARM,
        replace(ARM, name="ball", joint=Joint("ball", 0)),
        loads=(
            BodyLoad(3, PointForce("world", np.ones(3), np.zeros(3))),
            JointTorque(0, np.ones(6)),
            JointTorque(1, np.ones(2)),
            JointSineTorque(2, 1.0, 1.0),
        ),
    ),
    "empty": scene,
}


@pytest.mark.parametrize("fault", FAULTS)
def test_all_faults_of_a_scene_are_reported_at_once(fault: str, expected_message: ExpectedMessage) -> None:
    """Each is one line with the place in the scene."""
    with expected_message.raises(ValueError):
        FAULTS[fault]()


@pytest.mark.slow
def test_random_trees_are_reproducible_and_of_every_kind() -> None:
    """A seed gives the same tree; all kinds of joints and both kinds of bases occur."""
    first, again = (random_tree(np.random.default_rng(7), 9, loads=True) for _ in range(2))
    assert np.array_equal(first.q0, again.q0)
    assert np.array_equal(tree_dynamics(first).accelerations, tree_dynamics(again).accelerations)
    made = [random_tree(np.random.default_rng(seed), 6) for seed in range(10)]
    assert {body.joint.kind for tree in made for body in tree.bodies} == {*joint_kinds()}
    assert {tree.is_floating for tree in made} == {True, False}


def test_a_state_is_a_start() -> None:
    """A tree started from q and u has the dynamics at q and u."""
    rng = np.random.default_rng(3)
    tree = random_tree(rng, 4)
    q, u = random_state(tree, rng)
    assert not np.array_equal(q, tree.q0)
    there = tree_dynamics(tree.with_state(q, u))
    assert np.array_equal(tree_dynamics(tree, q, u).accelerations, there.accelerations)


def test_an_armature_adds_to_the_diagonal_alone() -> None:
    """M + diag(armature) answers to the same forces."""
    tree = random_tree(np.random.default_rng(5), 4, floating=True, kinds=("hinge", "ball"))
    rotors = tuple(
        replace(body, joint=replace(body.joint, armature=0.3)) if body.joint.kind != "free" else body
        for body in tree.bodies
    )
    plain, geared = tree_dynamics(tree), tree_dynamics(replace(tree, bodies=rotors))
    mass = plain.mass_matrix + np.diag([0.0] * 6 + [0.3] * (len(tree.u0) - 6))
    assert np.allclose(geared.mass_matrix, mass, rtol=1e-14, atol=1e-15)
    assert np.array_equal(geared.bias, plain.bias)
    assert np.allclose(mass @ geared.accelerations, plain.applied - plain.bias, rtol=1e-12, atol=1e-12)


def test_loads_that_are_switched_act_only_within_their_interval() -> None:
    """The interval is half-open."""
    tree = scene(ARM_OF_WORLD, loads=(JointTorque(0, np.array([2.0]), 0.25, 0.5),))
    assert [tree_dynamics(tree, t_s=t).applied.tolist() for t in (0.2, 0.25, 0.499, 0.5)] == [
        [0.0],
        [2.0],
        [2.0],
        [0.0],
    ]


ARM_OF_WORLD = replace(ARM, joint=Joint("hinge"))
