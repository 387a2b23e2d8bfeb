"""`bodycheck dynamics`: planted faults are named with their parameters, healthy engines are not accused."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from bodycheck.adapters.registry import registered
from bodycheck.adapters.workers.tree_readings import without_loads
from bodycheck.examine.dynamics.batch_dynamics import batch_dynamics
from bodycheck.examine.dynamics.faults import TREE_FAULTS
from bodycheck.examine.dynamics.faults.tree_fault import TreeFault
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.examine.dynamics.tree_flow import TreeFlow, TreeHypothesis
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.trees.random_trees import random_state, random_tree
from bodycheck.reference_impl.trees.tree_dynamics import TreeDynamics, tree_dynamics
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, TreeScene
from bodycheck.runs.dynamics_run import DynamicsOptions, dynamics
from tests.helpers.faulty_tree_models import PLANTED, FaultyTrees, PlantedTreeFault
from tests.helpers.in_process_cli import run_bodycheck

_FAST = "stale-matrix"


def check_named(fault: PlantedTreeFault) -> None:
    """Check that the fault is the first cause, with its parameters to 5 %."""
    with registered(FaultyTrees(fault)):
        found = dynamics(f"faulty-{fault.name}", (), DynamicsOptions(random=5))
    assert found.causes[0].fault == fault.expected
    for name, value in fault.parameters.items():
        assert found.causes[0].parameters[name] == pytest.approx(value, rel=0.05, abs=1e-3)


@pytest.mark.parametrize(
    "fault",
    [pytest.param(one, id=one.name, marks=pytest.mark.nightly) for one in PLANTED if one.name != _FAST],
)
def test_planted_fault_is_named(fault: PlantedTreeFault) -> None:
    """Each fault is named first, with its parameters."""
    check_named(fault)


@pytest.mark.slow
def test_stale_matrix_is_named() -> None:
    """A mass matrix that keeps the masses from before a change is named as such."""
    check_named(next(one for one in PLANTED if one.name == _FAST))


@pytest.mark.nightly
@pytest.mark.parametrize("engine", ["mujoco", "dart"])
def test_healthy_engine_is_not_accused(engine: str) -> None:
    """No reading of 100 random trees is called wrong."""
    found = dynamics(engine, (), DynamicsOptions(random=100, seed=7))
    assert found.wrong == ()


@pytest.mark.parametrize("bodies", [1, 2, 5])
def test_hypotheses_have_the_exact_dynamics(bodies: int) -> None:
    """The dynamics of many states at once are those of each, with dampers, armatures and torques."""
    rng = np.random.default_rng(bodies)
    scene = without_loads(random_tree(rng, bodies))
    more = {"damping": 0.3, "armature": 0.1}
    scene = replace(
        scene,
        bodies=tuple(
            body if body.joint.kind == "free" else replace(body, joint=replace(body.joint, **more))
            for body in scene.bodies
        ),
        loads=(BodyLoad(bodies - 1, Torque("body", np.array([0.1, 0.2, 0.3]))),),
    )
    states = [random_state(scene, rng) for _ in range(2)]
    q, u = (np.array(part) for part in zip(*states, strict=True))
    for at, found in zip(states, batch_dynamics([scene, scene], q, u), strict=True):
        exact = tree_dynamics(scene, *at)
        for name in (field.name for field in fields(TreeDynamics)):
            one, other = np.array(getattr(exact, name)), np.array(getattr(found, name))
            if name == "quaternion":
                other = other * np.sign(np.sum(one * other, axis=1, keepdims=True))
            assert np.max(np.abs(one - other)) <= 1e-11 * max(1.0, float(np.max(np.abs(one)))), name


@pytest.mark.slow(after=39)
@pytest.mark.parametrize("fault", TREE_FAULTS, ids=lambda fault: f"{fault.name}: {fault.sentence}"[:60])
def test_each_fault_changes_each_of_its_readings_somewhere(fault: TreeFault) -> None:
    """No fault of the catalogue is inert: one of some trees shows it, in one of its readings at least."""
    values = np.array(fault.start) + 0.3 if fault.parameters else np.empty(0)
    for number in range(8):
        rng = np.random.default_rng([number, 5])
        scene = without_loads(random_tree(rng, 4, floating=number % 2 == 0, springs=False))
        renamed = (replace(body, name=name) for body, name in zip(scene.bodies, "dbca", strict=True))
        scene = replace(scene, bodies=tuple(renamed))
        states = tuple(TreeState(scene, *random_state(scene, rng)) for _ in range(2))
        case = TreeCase("tree", states, 2.0).changed(lambda state: state)
        bodies = tuple(fault.bodies(scene)) if fault.bodies else ()
        if fault.bodies and not bodies:
            continue
        faulty = fault.plant(case, bodies, values)
        if any(case.deviation(reading, faulty(reading)) > 1e-6 for reading in fault.readings):
            return
        if not fault.readings and _moves_otherwise(fault, random_tree(rng, 4, loads=True), values):
            return
    pytest.fail("no tree shows it")


def _moves_otherwise(fault: TreeFault, scene: TreeScene, values: Array) -> bool:
    """Whether a fault that no reading shows changes the first steps."""
    bodies = tuple(fault.bodies(scene)) if fault.bodies else ()
    models = TreeHypothesis(scene), TreeHypothesis(scene)
    assert fault.moves is not None
    fault.moves(models[1], bodies, values)
    states = np.tile(scene.q0, (2, 1)), np.tile(scene.u0, (2, 1))
    q, u = TreeFlow(models, "M1", np.zeros(2), 1e-2).advance(*states, 3)
    return float(np.max(np.abs(q[1] - q[0])) + np.max(np.abs(u[1] - u[0]))) > 1e-9


def test_command_answers_first_and_as_json(tmp_path: Path) -> None:
    """The first line is the answer; --json has every reading; a model file gives its tree."""
    shown = run_bodycheck(tmp_path, "dynamics", "mujoco", "double-pendulum", "--quiet")
    assert shown.returncode == 0
    assert shown.stdout.startswith("mujoco 4")
    found = json.loads(run_bodycheck(tmp_path, "dynamics", "dart", "cart-pole", "--json").stdout)
    assert {one["verdict"] for one in found["readings"]} == {"right"}
    assert found["trees"] == ["cart-pole", "cart-pole, changed mass"]


@pytest.mark.slow
def test_page_of_several_engines_shows_each_and_its_readings(tmp_path: Path) -> None:
    """The page has the answer of each engine, the table of all, and is written beside a wrong reading."""
    asked = ("dynamics", "mujoco,dart", "cart-pole", "--html", "page.html")
    assert run_bodycheck(tmp_path, *asked).returncode == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert all(f"{engine} " in page for engine in ("mujoco", "dart"))
    assert page.count("<table") == 1
    assert page.count("<tr>") == 3


@pytest.mark.slow
def test_links_between_two_joints_of_one_link_have_no_mass(tmp_path: Path) -> None:
    """MuJoCo, which refuses moving bodies without mass, is right in a link on two joints."""
    model = tmp_path / "two.xml"
    model.write_text(
        """<mujoco><worldbody><body name="arm" pos="0 0 1">
        <joint name="pitch" type="hinge" axis="0 1 0"/><joint name="yaw" type="hinge" axis="0 0 1"/>
        <inertial pos="0.1 0 0.2" mass="2" diaginertia="0.02 0.03 0.04"/></body></worldbody></mujoco>"""
    )
    found = dynamics("mujoco", (str(model),), DynamicsOptions(random=0))
    assert {one.verdict for one in found.readings} == {"right"}


@pytest.mark.slow
def test_gates_bound_readings(tmp_path: Path) -> None:
    """A gate of dynamics.<reading> passes or fails by the worst deviation, and one without a value fails."""
    gates = tmp_path / "gates.toml"
    text = '[[gate]]\nengine = "dart"\nmeasure = "dynamics.bias"\nupper = {}\nreason = "round-off"\n'
    gates.write_text(text.format("1e-9"))
    asked = ("dynamics", "dart", "cart-pole", "--gates", str(gates))
    assert run_bodycheck(tmp_path, *asked).returncode == 0
    gates.write_text(text.format("1e-30"))
    assert run_bodycheck(tmp_path, *asked).returncode == 1


def test_new_adapter_with_trees_passes_its_checks(tmp_path: Path) -> None:
    """`new-adapter --tree` writes an adapter whose trees are right as they are."""
    made = run_bodycheck(tmp_path, "new-adapter", "my-engine", "--tree", "--json")
    assert made.returncode == 0
    package = tmp_path / "bodycheck-my-engine" / "bodycheck_my_engine"
    assert "tree_model = MyEngineTree" in (package / "__init__.py").read_text()
    compile((package / "trees.py").read_text(), "trees.py", "exec")
