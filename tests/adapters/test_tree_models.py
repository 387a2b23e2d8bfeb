"""Trees in engines: what they report is right, and what they cannot report is refused with a reason."""

from __future__ import annotations

import numpy as np
import pytest

from bodycheck.adapters.contract import Adapter, Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.tree_contract import TreeModel, UnreportedError, depth_first, jointed_links
from bodycheck.adapters.workers.tree_readings import (
    answered_dynamics,
    dynamics_request,
    readings_of,
    without_loads,
)
from bodycheck.examine.dynamics.engine_dynamics import ReadTree
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.reference_impl.trees.random_trees import random_state, random_tree
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene

_BRANCHED = (("ball", True), ("slide", False), ("hinge", False), ("hinge", True))
"""A first joint, and whether the base is free."""


def branched(kind: str, *, floating: bool) -> TreeScene:
    """Return a tree of five bodies whose bodies do not stand depth first."""
    rng = np.random.default_rng(3)
    kinds, parents = ("free" if floating else "hinge", kind, "hinge", "slide", kind), (-1, 0, 0, 1, 2)
    made = random_tree(rng, 5, floating=floating, kinds=("hinge",), springs=False)
    bodies = []
    for body, own, parent in zip(made.bodies, kinds, parents, strict=True):
        joint = Joint("free") if own == "free" else body.joint
        if own != "free":
            fields = {name: getattr(joint, name) for name in ("at_parent", "at_body", "zero", "axis")}
            joint = Joint(own, parent, **fields)
        bodies.append(TreeBody(body.name, body.mass, body.inertia, joint))
    return TreeScene(tuple(bodies), (), np.array([1.0, -2.0, -9.0]), 1.0, 2)


def read(adapter: Adapter, scene: TreeScene, masses_were: float = 1.0) -> ReadTree:
    """Return what an engine reports of a tree at rest and in motion."""
    rng, bare = np.random.default_rng(4), without_loads(scene)
    states = [random_state(bare, rng) for _ in range(3)]
    states[0] = states[0][0], np.zeros_like(states[0][1])
    case = TreeCase("tree", tuple(TreeState(bare, q, u) for q, u in states), masses_were)
    q, u = (np.array(part) for part in zip(*states, strict=True))
    answer = answered_dynamics(adapter, dynamics_request(bare, q, u, masses_were))
    assert answer["outcome"] == "ok", answer["message"]
    return ReadTree(case, readings_of(answer))


def deviations(tree: ReadTree) -> dict[str, float]:
    """Return reading -> its deviation."""
    assert tree.readings is not None
    return {name: tree.case.deviation(name, found) for name, found in tree.readings.values.items()}


@pytest.mark.parametrize("engine", ["mujoco", "dart"])
@pytest.mark.parametrize(("kind", "floating"), _BRANCHED)
def test_all_readings_are_right(engine: str, kind: str, floating: bool) -> None:
    """MuJoCo and DART report every reading of every joint and base to round-off."""
    found = deviations(read(get_adapter(engine), branched(kind, floating=floating)))
    assert set(found) == set(READINGS)
    assert max(found.values()) < 1e-12


@pytest.mark.parametrize("engine", ["mujoco", "dart", "pybullet"])
def test_a_change_of_mass_is_followed(engine: str) -> None:
    """Masses that are changed after building are those of all readings."""
    found = deviations(read(get_adapter(engine), branched("hinge", floating=False), masses_were=2.0))
    assert max(found["mass_matrix"], found["bias"]) < 1e-12


def test_stages_of_mujoco_and_dart() -> None:
    """After a step, MuJoCo's readings are those of its start, DART's M and poses those of its end."""
    scene = branched("hinge", floating=True)
    mujoco, dart = (read(get_adapter(engine), scene) for engine in ("mujoco", "dart"))
    assert {mujoco.stage(name) for name in READINGS} == {"start", ""}
    assert [dart.stage(name) for name in ("mass_matrix", "energy", "poses")] == ["end"] * 3
    assert [dart.stage(name) for name in ("accelerations", "wrenches")] == ["start"] * 2


def test_pybullet_has_a_wrong_wrench_in_motion_only() -> None:
    """PyBullet's joint wrenches are right at rest and wrong in motion; the rest that it reports is right."""
    tree = read(get_adapter("pybullet"), branched("hinge", floating=False))
    assert tree.readings is not None
    found = deviations(tree)
    moving = np.abs(tree.case.differences("wrenches", tree.readings.values["wrenches"]))
    assert np.max(moving[0]) < 1e-9
    assert np.max(moving[1:]) > 1e-3
    assert found["accelerations"] < 1e-6
    assert max(found[name] for name in ("mass_matrix", "bias", "gravity_bias", "poses")) < 1e-12
    assert set(tree.readings.reasons) >= {"energy", "momenta"}


def test_pybullet_reports_a_late_wrench() -> None:
    """After a step from rest, PyBullet's and MuJoCo's wrenches of a pendulum are one step late.

    A motion before it, in steps of many substeps, changes nothing.
    """
    body = TreeBody("rod", 2.0, np.diag([0.1, 0.1, 0.01]), Joint("hinge", at_body=np.array([0.0, 0.0, 0.5])))
    joint = Joint("hinge", at_body=np.array([0.0, 0.0, 0.5]), axis=np.array([0.0, 1.0, 0.0]))
    scene = TreeScene((TreeBody("rod", body.mass, body.inertia, joint),), (), np.array([0, 0, -9.81]), 1.0, 2)
    moved = record(get_adapter("pybullet"), Case(scene, "multibody@substeps", Setting(dt_s=0.01)))
    assert moved.outcome == "ok"
    for engine in ("pybullet", "mujoco"):
        assert read(get_adapter(engine), scene).stage("wrenches") == "start"


def test_what_is_not_overridden_is_unreported() -> None:
    """A model that overrides nothing reports nothing, and says so."""
    model = object.__new__(TreeModel)
    for reading in READINGS:
        with pytest.raises(UnreportedError, match="does not read"):
            getattr(model, reading)()


def test_depth_first_order() -> None:
    """Bodies are numbered along their branches."""
    assert depth_first(jointed_links(branched("hinge", floating=False))) == [0, 1, 3, 2, 4]


def test_engine_without_trees_is_unsupported() -> None:
    """An adapter that reports nothing of trees answers `unsupported` with the reason."""
    scene = branched("hinge", floating=False)
    q, u = random_state(scene, np.random.default_rng(1))
    answer = answered_dynamics(get_adapter("reference"), dynamics_request(scene, q[None], u[None]))
    assert answer["outcome"] == "unsupported"
    assert "reference" in answer["message"]
