"""Trees by the reference's own methods, and the table of their truth."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bodycheck
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.one_step_maps import TREE_MAPS
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_scene import JointTorque, TreeScene
from bodycheck.reference_impl.trees.tree_truth import certified_tree
from tests.helpers.in_process_cli import run_bodycheck


def loaded_tree() -> TreeScene:
    """Return a tree whose joint torque ends within the motion, where a step ends."""
    scene = random_tree(np.random.default_rng(3), 4, loads=True)
    loads = (replace(one, until_s=0.5) if isinstance(one, JointTorque) else one for one in scene.loads)
    return replace(scene, loads=tuple(loads))


@pytest.mark.nightly
@pytest.mark.parametrize(("method", "order"), [("m1", 1), ("rk4", 4)])
def test_steps_converge_with_their_order(method: str, order: int) -> None:
    """Halved steps divide the error of a loaded tree by 2^order, within 8 %."""
    scene, errors = loaded_tree(), []
    true = certified_tree(scene, scene.sample_times).motion
    for dt_s in (2.5e-3, 1.25e-3):
        answer = record(Reference(), Case(scene, method, Setting(dt_s=dt_s)))
        assert answer.trajectory is not None
        errors.append(np.max(np.abs(answer.trajectory.position_m - true.position)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, rel=0.08)


@pytest.mark.slow
def test_series_follows_the_truth() -> None:
    """At a tolerance of 1e-14 the series is within 1e-11 m of the truth at every sample, loads included."""
    scene = loaded_tree()
    answer = record(Reference(), Case(scene, "taylor", Setting(tolerance=1e-14)))
    assert answer.trajectory is not None
    true = certified_tree(scene, scene.sample_times).motion
    assert np.max(np.abs(answer.trajectory.position_m - true.position)) < 1e-11
    assert answer.steps is not None
    assert answer.steps > 5


@pytest.mark.nightly
def test_steps_are_those_of_the_catalogue() -> None:
    """The adapter's m1 makes the steps of the map M1, but for quaternions that it normalises at the start."""
    scene = replace(loaded_tree(), duration_s=0.1, samples=2)
    answer = record(Reference(), Case(scene, "m1", Setting(dt_s=0.01)))
    q, u = TREE_MAPS["M1"].step(scene, 0.0, scene.q0, scene.u0, 0.01, 10)
    assert answer.trajectory is not None
    assert answer.trajectory.q is not None
    assert answer.trajectory.u is not None
    assert np.max(np.abs(answer.trajectory.q[-1] - q)) < 1e-14
    assert np.max(np.abs(answer.trajectory.u[-1] - u)) < 1e-13


def test_other_methods_refuse_trees() -> None:
    """A method for one body names those that move trees."""
    answer = record(Reference(), Case(loaded_tree(), "cf4", Setting(dt_s=0.01)))
    assert answer.outcome == "unsupported"
    assert "m1, rk4, taylor" in answer.message


def test_truth_of_a_tree_as_a_table(tmp_path: Path) -> None:
    """`truth` prints every body and joint at times in any order, with bounds last."""
    table = pd.read_csv(io.StringIO(run_bodycheck(tmp_path, "truth", "cart-pole", "--at", "1,0").stdout))
    assert table["t_s"].tolist() == [1.0, 0.0]
    names = list(table.columns)
    assert {"body.cart.x_m", "body.pole.qw", "joint.cart.q_m", "joint.pole.q_rad", "joint.pole.rate"} <= {
        *names
    }
    assert names[-6:] == [
        f"bound_{name}" for name in ("rad", "energy", "momentum", "omega_rad_s", "m", "m_s")
    ]
    assert table["bound_rad"].between(1e-17, 1e-14).all()
    solved = bodycheck.truth("cart-pole", [1.0])
    assert solved.trajectory.q is not None
    assert table["joint.pole.q_rad"][0] == solved.trajectory.q[0, 1]
