"""Runs of trees: measures, tables, verdicts and pages are those of one body, with joints besides."""

from __future__ import annotations

import math
from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bodycheck
from bodycheck._util.errors import InputError
from bodycheck.adapters.contract import Precision
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS
from bodycheck.reference_impl.rotations import quaternion_product
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reference_impl.trees.tree_scene import Joint, JointTorque, TreeBody, TreeScene
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import measured_by
from bodycheck.reports.measurement.compared_motion import Compared, EnergyAndMomentum
from bodycheck.reports.measurement.invariants import invariants_of
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.scales import scene_scales
from bodycheck.reports.measurement.tree_map_made import made_map
from bodycheck.reports.render.body_surface import tree_box
from bodycheck.reports.render.movie import movie
from bodycheck.reports.render.page.played_motions import motion_view
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run, key_of
from bodycheck.reports.summary.sentences import Summary
from bodycheck.runs.directory import write_run
from bodycheck.scenarios.library import (
    load_any,
    load_scenario,
    load_scenarios,
    load_trees,
    suites,
    tree_names,
)
from bodycheck.scenarios.serialization import deserialized, serialized
from tests.helpers.html_page import report_page
from tests.helpers.in_process_cli import run_bodycheck

_SAME = ("mujoco:euler", "mujoco:implicitfast", "mujoco:discrete", "dart:semi-implicit", "pybullet:multibody")


@pytest.fixture(scope="module")
def chain() -> Run:
    """Return the free chain through every method of three engines at 1e-2 s."""
    return bodycheck.run(
        scenarios=["free-chain"], engines=["mujoco", "dart", "pybullet"], dt_s=[1e-2], speed=False, laws=False
    )


def _by_method(run: Run) -> dict[str, dict[str, Any]]:
    rows = [row for row in run.rows("results") if row["outcome"] == "ok"]
    return {f"{row['engine']}:{row['method']}": row for row in rows}


def test_engines_agree_and_are_all_wrong(chain: Run) -> None:
    """Five methods are 4.97e-2 rad off in the joints with a false momentum, and MuJoCo's RK4 is right."""
    rows = {
        f"{row['engine']}:{row['method']}": row for row in chain.rows("results") if row["outcome"] == "ok"
    }
    joints = {name: row["joint_error_rad"] for name, row in rows.items()}
    assert [round(joints[name], 4) for name in _SAME] == [0.0497] * 5
    assert max(joints[name] for name in _SAME) - min(joints[name] for name in _SAME) < 1e-12
    assert joints["mujoco:rk4"] < 1e-6
    assert rows["mujoco:rk4"]["linear_momentum_drift_abs"] < 1e-6
    assert min(rows[name]["linear_momentum_drift_abs"] for name in _SAME) > 0.03
    assert {rows[name]["worst_body"] for name in _SAME} == {"l2"}


def test_each_joint_has_a_row(chain: Run) -> None:
    """joints.csv has the largest and the final error of every joint of every case that ended well."""
    rows = chain.rows("joints")
    ended = [row for row in chain.rows("results") if row["outcome"] == "ok"]
    assert len(rows) == 2 * len(ended)
    for case in ended:
        own = [row for row in rows if (row["engine"], row["method"]) == (case["engine"], case["method"])]
        assert max(row["joint_error"] for row in own) == case["joint_error_rad"]
        assert all(row["joint_error_final"] <= row["joint_error"] for row in own)
        assert {row["body"] for row in own} == {"l1", "l2"}


def test_a_stored_run_of_a_tree_is_read_as_it_was_written(chain: Run, tmp_path: Path) -> None:
    """Tables, motions and the page of a run that is read are those of the run."""
    write_run(chain, tmp_path / "run")
    again = read_run(tmp_path / "run", allow_code=False, cache=Cache.default())
    assert again.joints.to_csv() == chain.joints.to_csv()
    for one, other in zip(again.cases, chain.cases, strict=True):
        if other.trajectory is not None:
            assert one.trajectory is not None
            assert np.array_equal(one.trajectory.q, other.trajectory.q)
    assert report_page(again) == (tmp_path / "run" / "report.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", tree_names())
def test_a_stored_tree_is_the_same(name: str) -> None:
    """A built-in tree survives the manifest of a run."""
    ((_, tree),) = load_trees(name)
    assert deserialized(serialized(tree), name) == tree


def test_commands_without_trees_leave_out_those_of_suites_and_refuse_others() -> None:
    """Only `load_any` returns trees; a suite has them, and a tree that is named is refused."""
    assert {*tree_names()} <= {scenario.name for _, scenario in load_any(["full"])}
    assert not {*tree_names()} & {scenario.name for _, scenario in load_scenarios(["full"])}
    assert suites()["trees"] == tree_names()
    for load in (load_scenario, lambda name: load_scenarios([name])):
        with pytest.raises(InputError, match="tree of bodies"):
            load("free-chain")


@pytest.mark.parametrize(
    ("name", "invariant"),
    [
        ("cart-pole", "momentum along the root's slide"),
        ("double-pendulum", None),
    ],
)
def test_the_root_conserves_what_nothing_outside_changes(name: str, invariant: str | None) -> None:
    """The momentum along a slide, or about a vertical axis, is an invariant that the truth conserves."""
    ((spec, tree),) = load_any([name])
    problem = Problem.of(tree, spec, Cache.default())
    found = {one.name: one for one in problem.invariants}
    assert ([*found] or [None]) == [invariant]
    for one in found.values():
        values = one.of(problem.truth.trajectory)
        assert np.max(np.abs(values - values[0])) <= 1e-13 * one.size(problem.truth.trajectory)


@pytest.mark.parametrize(("body", "kept"), [(0, 0), (1, 1)])
def test_a_motor_between_bodies_keeps_the_momentum_of_the_root(body: int, kept: int) -> None:
    """A force at the root's own joint, whose reaction is outside the tree, changes it."""
    ((_, tree),) = load_any(["cart-pole"])
    assert isinstance(tree.scene, TreeScene)
    driven = replace(tree.scene, loads=(JointTorque(body, np.array([0.3])),))
    assert len(invariants_of(driven)) == kept


@pytest.mark.parametrize("name", ["free-chain", "double-pendulum", "spring-damper-pair", "cart-pole"])
def test_the_truth_of_a_tree_balances_its_energy(name: str) -> None:
    """Along the truth, the energy changes by the work of loads and dampers."""
    ((spec, tree),) = load_any([name])
    problem = Problem.of(tree, spec, Cache.default())
    truth, motion = problem.truth.trajectory, problem.motion
    compared = Compared(tree.scene, truth, motion, truth, motion, problem.invariants, problem.compared)
    balance = compared.balance
    if balance is not None:
        assert np.max(np.abs(balance[0])) <= max(10.0 * balance[1], 1e-12 * problem.scales.energy_scale_j)


@pytest.mark.nightly
def test_a_tree_that_is_far_from_the_truth_shows_no_order() -> None:
    """Where attitudes of the arm are radians off, its other errors and its drifts have no order."""
    steps = [3.125e-3, 1.5625e-3, 7.8125e-4, 3.90625e-4]
    run = bodycheck.run(["arm"], engines=["reference:m1"], dt_s=steps, speed=False, laws=False)
    assert all(row["orientation_error_rad"] > 1.0 for row in run.rows("results"))
    undecided = [row for row in run.rows("methods") if row["verdict"] != "at-floor"]
    assert undecided
    assert {(row["verdict"], row["points"]) for row in undecided} == {("pre-asymptotic", 0)}


def test_scales_of_a_tree_are_finite(chain: Run) -> None:
    """No scale of a moving tree vanishes."""
    assert all(math.isfinite(scale) and scale > 0.0 for scale in vars(chain.problems[0].scales).values())


def _measured(name: str, change: Callable[[TreeScene, Trajectory], Trajectory]) -> dict[str, Any]:
    ((spec, tree),) = load_any([name])
    problem = Problem.of(tree, spec, Cache.default())
    motion = change(tree.scene, problem.truth.trajectory)
    return measured_by(problem, motion, EnergyAndMomentum.of(tree.scene, motion))[0]


def _turned(scene: TreeScene, motion: Trajectory) -> Trajectory:
    assert motion.q is not None
    assert motion.u is not None
    return tree_trajectory(scene, motion.t_s, motion.q + 1e-3, motion.u)


def _apart(_: TreeScene, motion: Trajectory) -> Trajectory:
    places, turned = motion.position_m.copy(), motion.attitude.copy()
    places[:, -1] += np.array([1e-3, 2e-3, 3e-3])
    turned[:, -1] = quaternion_product(turned[:, -1], np.array([1.0, 1e-3, 2e-3, 3e-3]))
    return replace(motion, position_m=places, quaternion=turned, q=None, u=None)


@pytest.mark.parametrize(
    ("measure", "change", "least"),
    [
        ("joint_error_rad", _turned, 9e-4),
        ("joint_error_m", _turned, 9e-4),
        ("constraint_drift_m", _apart, 1e-3),
        ("constraint_drift_rad", _apart, 1e-3),
    ],
)
def test_each_measure_of_joints_can_fail(
    measure: str, change: Callable[[TreeScene, Trajectory], Trajectory], least: float
) -> None:
    """Coordinates that are off, and bodies that come apart, are measured; the truth itself is not off."""
    stored = replace if change is _apart else None
    sound = _measured("cart-pole", lambda _, motion: stored(motion, q=None, u=None) if stored else motion)
    assert sound[measure] < 1e-12
    assert _measured("cart-pole", change)[measure] > least


def test_the_map_that_engines_share_is_named(chain: Run) -> None:
    """M1 is the map of five methods of three engines, to round-off; the next map is far."""
    rows = _by_method(chain)
    assert {name: row.get("tree_map") for name, row in rows.items()} == {
        **dict.fromkeys(_SAME, "M1"),
        "mujoco:implicit": "M2",
        "mujoco:rk4": "RK4",
    }
    assert max(row["tree_map_distance"] for row in rows.values()) < 1e-12
    assert min(row["next_map_distance"] / row["tree_map_distance"] for row in rows.values()) > 1e3
    found = Summary.of(chain)
    (sentence,) = found.alike
    assert all(text in sentence for text in ("5 methods of 3 engines", "joint angles are 0.0497 rad"))
    assert len(sentence) < 140  # read in five seconds
    (details,) = found.details
    assert all(name in details for name in _SAME)


@pytest.mark.parametrize("precision", ["float64", "float32", "mixed"])
@pytest.mark.parametrize("linear", [False, True])
def test_how_a_map_turns_a_ball_is_named(linear: bool, precision: Precision) -> None:
    """M1 with q + dt q omega / 2, normalised, in place of a turn by exp(dt omega), is another name."""
    scene = random_tree(np.random.default_rng(4), 2, floating=False, kinds=("ball",), springs=False)
    dt_s = scene.sample_interval_s / 4
    plan, rows = plan_steps(scene, dt_s), [(scene.q0, scene.u0)]
    for _ in range(4 * (scene.samples - 1)):
        before, _ = rows[-1]
        q, u = TREE_MAPS["M1"].step(scene, 0.0, *rows[-1], dt_s)
        for ball, rates in scene.turn_slices if linear else ():
            w, v, omega = before[ball][0], before[ball][1:], u[rates]
            turned = before[ball] + 0.5 * dt_s * np.array([-v @ omega, *(w * omega + np.cross(v, omega))])
            q[ball] = turned / np.linalg.norm(turned)
        rows.append((q, u))
    q, u = (np.array(part)[::4] for part in zip(*rows, strict=True))
    motion = tree_trajectory(scene, scene.sample_times, q, u)
    found = made_map(scene, motion, plan, precision, scene_scales(scene, motion))
    assert found["tree_map"] == ("M1, q + dt q omega / 2" if linear else "M1")
    assert found["tree_map_distance"] < 1e-13


def test_the_page_states_the_shared_map_before_any_fold(chain: Run) -> None:
    """A reader who opens nothing sees it, as on the console."""
    findings = report_page(chain).partition('aria-label="Findings"')[2].partition("<details>")[0]
    assert "5 methods of 3 engines are semi-implicit Euler (M1)" in findings


@pytest.mark.slow
def test_a_false_momentum_is_stated_first() -> None:
    """Of two trees, the free one comes first, although the errors of the other are larger."""
    engines = ["mujoco:euler", "dart"]
    run = bodycheck.run(
        scenarios=["double-pendulum", "free-chain"], engines=engines, dt_s=[1e-2], speed=False, laws=False
    )
    first, second, *_ = Summary.of(run).alike
    assert first.startswith("free-chain")
    assert "false momentum" in first
    assert "double-pendulum" in second


def test_the_page_plays_a_tree(chain: Run) -> None:
    """Each body moves with its place, with the truth and the coordinate of each joint beside it."""
    (problem,) = chain.problems
    numbers = {key_of(case.columns): k for k, case in enumerate(chain.cases)}
    view = motion_view(problem, chain.cases, numbers)
    assert view is not None
    assert len(view["parts"]) == len(view["truth"]["bodies"]) == 3
    assert view["joints"] == ["l1.rad", "l2.rad"]
    truth = problem.truth.trajectory
    assert truth.q is not None
    shown = np.array(view["truth"]["joints"][1])
    assert np.max(np.abs(shown - truth.q[:, -1])) < 1e-3
    places = np.array(
        [np.frombuffer(b64decode(one["x"]), dtype="<i2").reshape(-1, 3) for one in view["truth"]["bodies"]]
    )
    assert np.max(np.abs(places.mean(axis=0))) <= 1.0  # of int16: the view follows the free chain
    spread = truth.position_m - truth.position_m.mean(axis=1, keepdims=True)
    assert np.max(np.abs(spread)) < view["reach"] < np.max(np.abs(truth.position_m))


def test_a_box_has_the_inertia_of_its_body() -> None:
    """The box of a uniform block is the block."""
    a, b, c, mass = 0.3, 0.2, 0.1, 2.0
    inertia = mass / 12.0 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    corners = tree_box(TreeBody("block", mass, inertia, Joint("free")))
    assert np.allclose(np.abs(corners), np.array([a, b, c]) / 2.0, rtol=1e-12)


def test_a_film_shows_a_tree(chain: Run) -> None:
    """Its frames are those of the free chain."""
    assert b"free-chain" in movie(chain, "free-chain", ".svg")


@pytest.mark.slow
def test_methods_that_make_another_map_of_trees_are_named() -> None:
    """MuJoCo's implicitfast and discrete make M2 of one body and M1 of a tree; its euler makes M1 of both."""
    engines = ["mujoco:implicitfast", "mujoco:discrete", "mujoco:euler"]
    run = bodycheck.run(scenarios=["free-chain"], engines=engines, dt_s=[1e-2], speed=False)
    (sentence,) = [text for text in Summary.of(run).alike if "of one body" in text]
    assert "mujoco:implicitfast and mujoco:discrete (M2 of one body and M1 of trees)" in sentence
    assert "mujoco:euler" not in sentence


@pytest.mark.slow
def test_advice_compare_and_gates_take_a_stored_run_of_a_tree(chain: Run, tmp_path: Path) -> None:
    """Each answers about the tree without code of its own."""
    write_run(chain, tmp_path / "run")
    advice = run_bodycheck(tmp_path, "advise", "free-chain", "--error", "1e-3", "--run", "run")
    assert advice.returncode == 0
    assert "mujoco:rk4" in advice.stdout.partition("\n")[0]
    assert run_bodycheck(tmp_path, "compare", "run", "run").returncode == 0
    (tmp_path / "gates.toml").write_text(
        '[[gate]]\nmethod = "rk4"\nmeasure = "joint_error_rad"\nupper = 1e-6\nreason = "order 4"\n'
    )
    gate = run_bodycheck(tmp_path, "gate", "--gates", "gates.toml", "--run", "run")
    assert (gate.returncode, gate.stdout.partition("\n")[0]) == (0, "1 gate: 1 passed")
    drawn = run_bodycheck(
        tmp_path, "plot", "run", "--scenario", "free-chain", "--figure", "motion", "--svg", "m.svg"
    )
    assert drawn.returncode == 0, drawn.stderr
