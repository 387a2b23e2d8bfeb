"""Scenario files of trees: their tables, all their faults at once, and trees that are a single body."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.trees.tree_dynamics import pivot_ratios
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, JointSineTorque, JointTorque
from bodycheck.reports.summary.catalogue import catalogue
from bodycheck.runs.schemas import SCHEMAS
from bodycheck.scenarios.library import load_scenario, load_trees, scenario_names, tree_names
from bodycheck.scenarios.reader import parse_members, parse_trees
from bodycheck.scenarios.tree_model import TreeScenario
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck

HEAD = """
name = "cart-pole"
duration_s = 5.0
samples = 51
"""
BODY = "mass_kg = 1.0\ninertia_kg_m2 = [0.01, 0.01, 0.01]\n"
CART = f"""
[[body]]
name = "cart"
{BODY}
[body.joint]
kind = "slide"
axis = [2, 0, 0]
start_m = 0.1
rate_m_s = 0.5
stiffness_n_m = 3.0
rest_m = 0.2
damping_n_s_m = 0.4
"""
POLE = f"""
[[body]]
name = "pole"
link_offset_m = [0, 0, -0.4]
{BODY}
[body.joint]
kind = "hinge"
parent = "cart"
at_parent_m = [0, 0, 0.05]
at_body_m = [0, 0, -0.4]
quaternion = [0.6, 0.8, 0, 0]
axis = [0, 1, 0]
start_rad = 0.3
rate_rad_s = -0.1
stiffness_n_m_rad = 2.0
rest_rad = 0.1
damping_n_m_s = 0.5
"""
LOADS = """
[[forcing]]
kind = "joint-torque"
body = "pole"
value_n_m = 0.3
from_s = 0.5
[[forcing]]
kind = "joint-sine-torque"
body = "cart"
amplitude_n = 0.2
rate_rad_s = 5.0
phase_rad = 0.3
[[forcing]]
kind = "force"
body = "pole"
axes = "world"
value_n = [0.1, 0, 0]
[[forcing]]
kind = "gravity"
acceleration_m_s2 = [0, 0, -9.81]
"""
FAULTS = {
    "joints": f"""
{CART.replace("axis = [2, 0, 0]", "axis = [0, 0, 0]").replace("start_m", "start_rad")}
{POLE.replace("mass_kg = 1.0", "mass_kg = -1.0").replace('"cart"', '"card"')}
[[body]]
name = "arm"
{BODY}
joint = {{kind = "ball", parent = "hand", axis = [0, 0, 1], stiffness_n_m_rad = 2.0}}
[[body]]
name = "hand"
{BODY}
joint = {{kind = "ball", parent = "arm", start = [1, 1, 0, 0]}}
[[body]]
name = "hand"
{BODY}
joint = {{kind = "weld", parent = "cart"}}
[[body]]
name = "world"
{BODY}
[[body]]
name = "early"
{BODY}
joint = {{kind = "ball", parent = "late"}}
[[body]]
name = "late"
{BODY}
joint = {{kind = "ball"}}
[initial]
omega_body_rad_s = [0, 0, 1]
""",
    "loads": f"""
[[body]]
name = "base"
{BODY}
{CART}
{POLE}
[[body]]
name = "ball"
{BODY}
joint = {{kind = "ball", parent = "pole"}}
"""
    + "".join(
        f"[[forcing]]\n{keys}\n"
        for keys in (
            'kind = "joint-torque"\nbody = "cart"\nvalue_n_m = 0.3',
            'kind = "joint-torque"\nbody = "ball"\nvalue_n_m = 0.3',
            'kind = "joint-torque"\nbody = "pole"\nvalue_n_m = [1, 2, 3]',
            'kind = "joint-torque"\nbody = "base"\nvalue_n_m = [1, 2, 3]',
            'kind = "joint-torque"\nbody = "pole"',
            'kind = "joint-sine-torque"\nbody = "ball"\namplitude_n_m = 1.0\nrate_rad_s = 1.0',
            'kind = "force"\naxes = "world"\nvalue_n = [0.1, 0, 0]',
            'kind = "torque"\nbody = "pol"\naxes = "world"\nvalue_n_m = [0.1, 0, 0]',
            'kind = "gravity"\nbody = "cart"\nacceleration_m_s2 = [0, 0, -9.81]',
            'kind = "pivot"\nat_m = [0, 0, 0]',
            'kind = "spring"\nanchor_m = [0, 0, 0]\nstiffness_n_m = 1.0',
        )
    ),
    "sizes": CART.replace("0.1", "1e60")
    + POLE.replace("mass_kg = 1.0", "mass_kg = 1e250").replace("-0.4", "1e40"),
    "masses": POLE.replace("mass_kg = 1.0", "mass_kg = 1e250")
    .replace("-0.4", "1e40")
    .replace('"cart"', '"world"'),
    "names and angles": CART.replace('"cart"', '"the.cart"')
    + POLE.replace("start_rad = 0.3", "start_rad = 1e13")
    + "[[forcing]]\nkind = [1]\nbody = 1\n",
    "singular": """
[[body]]
name = "ring"
mass_kg = 1e-30
inertia_kg_m2 = [1e-30, 1e-30, 1e-30]
joint = {kind = "hinge", axis = [0, 0, 1]}
[[body]]
name = "inner"
mass_kg = 1e-30
inertia_kg_m2 = [1e-30, 1e-30, 1e-30]
joint = {kind = "hinge", parent = "ring", axis = [0, 1, 0]}
[[body]]
name = "wheel"
mass_kg = 1.0
inertia_kg_m2 = [1.0, 1.0, 1.5]
joint = {kind = "hinge", parent = "inner", axis = [0, 0, 1]}
""",
}


def parsed(text: str) -> TreeScenario:
    """Return the tree that this text defines, after HEAD."""
    return parse_trees(HEAD + text, "file.toml", Path())[None]


@pytest.mark.parametrize("fault", FAULTS)
def test_all_faults_of_a_tree_are_reported_at_once(fault: str, expected_message: ExpectedMessage) -> None:
    """Each is one line with the path of its key: of bodies, of joints and between them, of loads."""
    with expected_message.raises(InputError):
        parsed(FAULTS[fault])


def test_tables_become_a_tree() -> None:
    """Every key of a joint and of a load is in the scene; axes are unit vectors."""
    scene = parsed(CART + POLE + LOADS).scene
    cart, pole = (body.joint for body in scene.bodies)
    assert cart.axis.tolist() == [1.0, 0.0, 0.0]
    assert (cart.parent, cart.stiffness, cart.rest, cart.damping) == (-1, 3.0, 0.2, 0.4)
    assert (pole.parent, pole.stiffness, pole.rest, pole.damping) == (0, 2.0, 0.1, 0.5)
    assert pole.at_parent.tolist() == [0.0, 0.0, 0.05]
    assert pole.at_body.tolist() == [0.0, 0.0, -0.4]
    assert pole.zero.tolist() == [0.6, 0.8, 0.0, 0.0]
    assert scene.q0.tolist() == [0.1, 0.3]
    assert scene.u0.tolist() == [0.5, -0.1]
    assert scene.bodies[1].link is not None
    assert scene.gravity.tolist() == [0.0, 0.0, -9.81]
    constant, sine, force = scene.loads
    assert isinstance(constant, JointTorque)
    assert isinstance(sine, JointSineTorque)
    assert isinstance(force, BodyLoad)
    assert (constant.body, constant.value.tolist(), constant.from_s) == (1, [0.3], 0.5)
    assert (sine.body, sine.amplitude, sine.rate, sine.phase) == (0, 0.2, 5.0, 0.3)
    assert isinstance(force.load, PointForce)
    assert scene.switches_before(5.0) == (0.5,)


def test_a_free_first_body_starts_from_the_initial_state() -> None:
    """[initial] is that of the first body, without a joint."""
    base = f'[[body]]\nname = "cart"\n{BODY}'
    scene = parsed(base + POLE + "[initial]\nposition_m = [1, 2, 3]\nomega_body_rad_s = [0, 0, 2]\n").scene
    assert scene.is_floating
    assert scene.q0.tolist() == [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, 0.3]
    assert scene.u0.tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 2.0, -0.1]


def test_a_tree_is_the_same_after_pickling() -> None:
    """Workers get trees by pickle, also where the schema of scenarios was made in between."""
    tree = parsed(CART + POLE + LOADS)
    assert SCHEMAS["scenario"].document
    assert pickle.loads(pickle.dumps(tree)) == tree


def test_one_free_body_in_a_tree_is_a_scenario_of_today() -> None:
    """Its numbers and loads are those of the same file with [body]."""
    force = '[[forcing]]\nkind = "force"\naxes = "body"\nvalue_n = [0.1, 0, 0]\n'
    initial = "[initial]\nomega_body_rad_s = [0, 1, 2]\n"
    own = f'{HEAD}[[body]]\nname = "brick"\n{BODY}{initial}{force}body = "brick"\n'
    (found,) = parse_members(own, "file.toml", Path()).values()
    (today,) = parse_members(f"{HEAD}[body]\n{BODY}{initial}{force}", "file.toml", Path()).values()
    assert found == today


def test_one_body_on_a_ball_is_a_body_with_a_pivot() -> None:
    """The joint's point stays where it is in the world, and the attitude is zero, then start."""
    joint = (
        'joint = {kind = "ball", at_parent_m = [1, 2, 3], at_body_m = [0, 0, -0.5], '
        "quaternion = [0, 0, 1, 0], start = [0.6, 0.8, 0, 0], rate_rad_s = [0.1, 0.2, 0.3]}\n"
    )
    text = f'{HEAD}[[body]]\nname = "top"\n{BODY}{joint}'
    (found,) = parse_members(text, "file.toml", Path()).values()
    scene = found.scene
    assert scene.pivot is not None
    assert scene.pivot.tolist() == [0.0, 0.0, -0.5]
    assert np.allclose(scene.initial.quaternion, [0.0, 0.0, 0.6, -0.8], atol=1e-15)
    assert np.allclose(scene.initial.position + scene.initial.rotation @ scene.pivot, [1.0, 2.0, 3.0])
    assert scene.initial.omega_body.tolist() == [0.1, 0.2, 0.3]
    with pytest.raises(InputError):
        parse_members(text.replace("rate_rad_s", "damping_n_m_s = 0.1, rate_rad_s"), "file.toml", Path())


@pytest.mark.parametrize("name", tree_names())
def test_each_built_in_tree_is_read_and_has_a_regular_mass_matrix(name: str) -> None:
    """No rate loses more than five digits at the start."""
    ((spec, tree),) = load_trees(name)
    assert spec == tree.name == name
    assert "tree" in tree.tags
    assert tree.summary
    assert tree.source
    assert max(pivot_ratios(tree.scene)) < 1e5


def test_only_the_spherical_pendulum_is_a_single_body() -> None:
    """The other built-in trees are refused where one body is needed; none has the name of a scenario."""
    assert not {*tree_names()} & {*scenario_names()}
    assert {entry.name for entry in catalogue("scenarios")} == {*scenario_names(), *tree_names()}
    for name in tree_names():
        if name == "spherical-pendulum":
            assert load_scenario(name).scene.pivot is not None
        else:
            with pytest.raises(InputError, match="unsupported"):
                load_scenario(name)


@pytest.mark.parametrize(
    "command", [("ensemble", "--engine", "reference:rk4"), ("hunt", "--engine", "reference:rk4")]
)
def test_commands_without_trees_refuse_one_in_one_line(
    command: tuple[str, ...], tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A built-in tree and a file are input errors, and nothing is written."""
    (tmp_path / "mine.toml").write_text(HEAD + CART + POLE)
    for tree in ("cart-pole", "mine.toml"):
        result = run_bodycheck(tmp_path, command[0], tree, *command[1:])
        assert result.returncode == 2
        expected_message(result.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


def test_a_tree_of_an_unknown_name_or_of_one_body_is_refused(expected_message: ExpectedMessage) -> None:
    """Each gives one line, with the names that exist."""
    with expected_message.raises(InputError):
        load_trees("cart-pol")
    with expected_message.raises(InputError):
        parse_trees(f"{HEAD}[body]\n{BODY}", "file.toml", Path())


_CYLINDER = '''
"""A cylindrical joint: the child turns about an axis, and moves along it."""

from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation

JOINT = JointKind("cylinder", Rotation.AXIS, Translation.AXIS)
'''
_WITH_CYLINDER = """
import sys
import numpy as np
import bodycheck.reference_impl.trees.joint_kinds as package
package.__path__.append(sys.argv[1])
from pathlib import Path
from bodycheck.reference_impl.trees.tree_dynamics import tree_dynamics
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.scenarios.reader import read_trees

found = tree_dynamics(read_trees(Path(sys.argv[1], "tree.toml"))[None].scene)
tilt, axis, at = np.array([0.6, 0.8, 0.0, 0.0]), np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.2, -0.3])
inertia = np.diag([0.02, 0.03, 0.04])
bodies = (
    TreeBody("base", 2.0, np.diag([0.2, 0.3, 0.4]), Joint("ball", rate=np.array([0.3, -0.8, 0.5]))),
    TreeBody("link", 0.0, np.zeros((3, 3)), Joint("slide", 0, at, zero=tilt, axis=axis, start=[0.3])),
    TreeBody("arm", 1.0, inertia, Joint("hinge", 1, at_body=-at, axis=axis, start=[0.4])),
)
tree = TreeScene(bodies, (), np.array([0.0, 0.0, -9.81]), 1.0, 11)
expected = tree_dynamics(tree, u=np.array([0.3, -0.8, 0.5, 0.7, -0.9]))
for name in ("mass_matrix", "bias", "accelerations", "momentum", "angular_momentum"):
    assert np.allclose(getattr(found, name), getattr(expected, name), rtol=1e-13, atol=1e-13), name
for name in ("position", "velocity", "omega_body", "joint_force"):
    assert np.allclose(getattr(found, name)[-1], getattr(expected, name)[-1], rtol=1e-13, atol=1e-13), name
"""
_TREE_WITH_CYLINDER = f"""{HEAD}
[[body]]
name = "base"
mass_kg = 2.0
inertia_kg_m2 = [0.2, 0.3, 0.4]
joint = {{kind = "ball", rate_rad_s = [0.3, -0.8, 0.5]}}
[[body]]
name = "arm"
mass_kg = 1.0
inertia_kg_m2 = [0.02, 0.03, 0.04]
[body.joint]
kind = "cylinder"
parent = "base"
at_parent_m = [0.1, 0.2, -0.3]
at_body_m = [-0.1, -0.2, 0.3]
quaternion = [0.6, 0.8, 0, 0]
axis = [0, 3, 4]
start_m = 0.3
rate_m_s = 0.7
start_rad = 0.4
rate_rad_s = -0.9
[[forcing]]
kind = "gravity"
acceleration_m_s2 = [0, 0, -9.81]
"""


@pytest.mark.slow
def test_one_file_adds_a_kind_of_joint(tmp_path: Path) -> None:
    """The reader and the dynamics know a cylindrical joint: a slide and a hinge by a link without mass."""
    (tmp_path / "cylinder.py").write_text(_CYLINDER)
    (tmp_path / "tree.toml").write_text(_TREE_WITH_CYLINDER)
    subprocess.run([sys.executable, "-c", _WITH_CYLINDER, str(tmp_path)], check=True, timeout=120)
