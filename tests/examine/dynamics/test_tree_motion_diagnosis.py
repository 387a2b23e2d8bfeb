"""The motion of a tree names its map, and the fault that an engine has, with its parameters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.dart import Dart
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.examine.dynamics.tree_flow import TreeFlow, TreeHypothesis
from bodycheck.examine.dynamics.tree_motion_diagnosis import diagnosed_tree
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reports.measurement.scales import Scales, scene_scales
from bodycheck.reports.measurement.tree_map_made import state_differences
from bodycheck.scenarios.library import load_trees
from tests.helpers.faulty_tree_motions import (
    FAULTS,
    TREES,
    MotionFault,
    diagnosed_fault,
    diagnosed_motion,
    is_named,
    loaded_tree,
)
from tests.helpers.in_process_cli import run_bodycheck

_QUICK = ("damping-of-all", "point-in-child", "no-coriolis", "base-point", "load-late")


@pytest.mark.slow
@pytest.mark.parametrize("name", TREE_MAPS)
def test_hypotheses_move_as_the_maps_of_the_catalogue(name: str) -> None:
    """Four steps of random trees with loads, springs and dampers are those of the kernel."""
    for seed in range(3):
        scene = random_tree(np.random.default_rng([seed, 3]), 4, loads=True)
        right = TREE_MAPS[name].step(scene, 0.0, scene.q0, scene.u0, 2e-3, 4)
        flow = TreeFlow([TreeHypothesis(scene)], name, np.zeros(1), 2e-3)
        made = flow.advance(scene.q0[None].copy(), scene.u0[None].copy(), 4)
        left = state_differences(scene, (right[0][None], right[1][None]), made, Scales(*[1.0] * 7))
        assert max(np.max(np.abs(part), initial=0.0) for part, _ in left) < 1e-12


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("fault", [one for one in FAULTS if one.name in _QUICK], ids=lambda one: one.name)
def test_fault_of_a_moving_tree_is_named(fault: MotionFault) -> None:
    """A fault planted in MuJoCo stands first, with its parameters within 5 %."""
    assert is_named(fault, diagnosed_fault(fault, "free-chain"))


_KINDS = {tree: loaded_tree(tree).bodies[-1].joint.kind for tree in TREES}
_EACH = [(fault, tree) for tree in TREES for fault in FAULTS if _KINDS[tree] in fault.kinds]


@pytest.mark.nightly
@pytest.mark.parametrize(("fault", "tree"), _EACH, ids=lambda one: getattr(one, "name", one))
def test_each_fault_of_a_moving_tree_is_named(fault: MotionFault, tree: str) -> None:
    """The same of all, each on those of three trees on which it acts."""
    assert is_named(fault, diagnosed_fault(fault, tree))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("method", "base", "order"), [("euler", "M1d", 1), ("implicit", "M2", 1), ("rk4", "RK4", 4)]
)
def test_healthy_method_has_no_fault(method: str, base: str, order: int) -> None:
    """The motion of each map is named as that map, on a tree with dampers and loads."""
    found = diagnosed_motion(MuJoCo(), loaded_tree("quadruped"), method, 5e-3, order)
    assert found is not None
    assert (found.verdict, found.base) == ("healthy", base)


def test_a_map_of_lower_order_than_the_method_states_is_named() -> None:
    """A method that states order 4 and makes M1 is of lower order, not faulty."""
    ((_, tree),) = load_trees("free-chain")
    found = diagnosed_motion(Dart(), tree.scene, "semi-implicit", 5e-3, 4)
    assert found is not None
    assert (found.verdict, found.base) == ("lower-order", "M1")


@pytest.mark.slow
def test_what_follows_a_breakdown_is_not_examined() -> None:
    """An engine that goes on from what is no longer finite has no fault up to then."""
    ((_, tree),) = load_trees("double-pendulum")
    motion = record(Dart(), Case(tree.scene, "semi-implicit", Setting(dt_s=2e-3))).trajectory
    assert motion is not None
    assert motion.q is not None
    assert motion.u is not None
    scales = scene_scales(tree.scene, motion)
    rates = np.where(motion.t_s[:, None] < 3.0, motion.u, 1e253)
    broken = tree_trajectory(tree.scene, motion.t_s, motion.q, rates)
    found = diagnosed_tree(tree.scene, broken, scales, 2e-3, order=1)
    assert found is not None
    assert (found.verdict, found.base) == ("healthy", "M1")
    at_once = tree_trajectory(tree.scene, motion.t_s, motion.q, np.full_like(rates, 1e253))
    assert diagnosed_tree(tree.scene, at_once, scales, 2e-3, order=1) is None


def test_dart_is_silent_on_a_motion_that_diverges(capfd: pytest.CaptureFixture[str]) -> None:
    """Its warnings, some per step and joint, do not fill the terminal."""
    ((_, tree),) = load_trees("arm")
    motion = record(Dart(), Case(tree.scene, "semi-implicit", Setting(dt_s=5e-3))).trajectory
    assert motion is not None
    assert motion.u is not None
    assert np.max(np.abs(motion.u)) > 1e20
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_explain_names_the_map_of_a_tree(tmp_path: Path) -> None:
    """`explain --case` of a tree examines its motion."""
    run_bodycheck(
        tmp_path, "run", "free-chain", "--engine", "dart", "--dt", "0.01", "--no-speed", "--out", "r"
    )
    shown = run_bodycheck(tmp_path, "explain", "r", "--case", "free-chain")
    assert shown.returncode == 0
    assert "semi-implicit Euler (M1) of trees" in shown.stdout
