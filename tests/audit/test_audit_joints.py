"""What a model file states of joints, what importers make of it, and its mass matrix."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck._util.errors import InputError
from bodycheck.adapters.importers import ImportedLink, joint_of, matrices_of
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit.audit import (
    FOLLOWS,
    SINGLE,
    Audit,
    ImporterColumn,
    LinkAudit,
    LinkImport,
    read_audit,
    write_audit,
)
from bodycheck.audit.audit_against import audit_against
from bodycheck.audit.audit_document import alerts_of, audit_data, audit_document, failures
from bodycheck.audit.audit_joints import HeldJoints, audited_joints
from bodycheck.audit.audit_page import audit_page
from bodycheck.audit.audit_run import AuditOptions, imported_audit
from bodycheck.audit.audit_summary import answer
from bodycheck.audit.joint_causes import (
    AXES,
    FACTORS,
    PLACEMENTS,
    QUANTITIES,
    JointFacts,
    Placement,
    Quantity,
    joint_causes,
)
from bodycheck.audit.lint import lint
from bodycheck.reference_impl.trees.tree_dynamics import tree_dynamics
from bodycheck.reports.document import Sentence
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint
from bodycheck.scenarios.model_files.model_file import ModelFile
from bodycheck.scenarios.model_files.model_tree import model_trees
from tests.helpers.model_texts import random_mjcf, random_urdf, sdf_of

Array = np.ndarray

_MJCF = """<mujoco>
<compiler angle="degree"/>
<default>
  <joint damping="0.7" armature="0.02"/><position kp="50"/>
  <default class="soft"><joint stiffness="5" springref="10" range="-30 60" frictionloss="0.3"/></default>
</default>
<worldbody><body name="arm" pos="0 0 1">
  <inertial pos="0.1 0 0.2" mass="1.5" diaginertia="0.1 0.2 0.25"/>
  <joint name="turn" class="soft" axis="0 1 1" pos="0.1 0 0" ref="20"/>
  <frame pos="0 0 0.3" euler="0 90 0"><joint name="push" type="slide" axis="0 0 2" range="-1 1"/></frame>
  <body name="plate" pos="0 0.2 0" euler="30 0 0">
    <inertial pos="0 0 0.1" mass="0.4" diaginertia="0.1 0.1 0.1"/></body>
  <body name="hand" pos="1 0 0" euler="0 0 40"><inertial pos="0.1 0 0" mass="2" diaginertia="0.3 0.2 0.4"/>
    <joint name="wrist" axis="1 0 0" actuatorfrcrange="-4 6"/></body>
</body></worldbody>
<actuator><position joint="turn" kv="3"/><velocity joint="turn" kv="4" gear="2"/>
  <motor joint="push" gear="9"/></actuator>
<equality><joint joint1="wrist" joint2="turn" polycoef="0.1 -2 0 0 0"/></equality>
</mujoco>"""

_LEG = """<mujoco><compiler angle="radian"/><worldbody><body name="thigh" pos="0 0 1">
<joint name="hip" type="hinge" axis="1 0 0" damping="0.5" frictionloss="0.1" range="-1 1"/>
<joint name="roll" type="hinge" axis="0 1 0" damping="0.5" armature="0.02"/>
<inertial pos="0 0 -0.2" mass="2" diaginertia="0.1 0.1 0.02"/><geom type="sphere" size="0.05" pos="0 0 -0.2"/>
</body></worldbody></mujoco>"""

_URDF = """<robot name="r">
<link name="base"><inertial><mass value="3"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
<link name="a"><inertial><origin xyz="0.1 0 0" rpy="0.4 0 0"/><mass value="2"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/></inertial></link>
<link name="b"><inertial><origin xyz="0 0.1 0"/><mass value="1"/>
  <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.2" iyz="0" izz="0.25"/></inertial></link>
<joint name="first" type="revolute"><parent link="base"/><child link="a"/>
  <origin xyz="0.3 0 0.1" rpy="0.5 0.2 -0.3"/><axis xyz="0 0.6 0.8"/>
  <limit lower="-1" upper="2" effort="40" velocity="3"/><dynamics damping="0.5" friction="0.2"/></joint>
<joint name="second" type="continuous"><parent link="a"/><child link="b"/><origin xyz="0.4 0 0"/>
  <axis xyz="0 1 0"/><limit effort="0" velocity="0"/>
  <mimic joint="first" multiplier="-2" offset="0.1"/></joint>
</robot>"""


def _chain(count: int) -> str:
    links = "".join(f"<link name='l{k}'/>" for k in range(count + 1))
    joints = "".join(
        f"<joint name='j{k}' type='continuous'><parent link='l{k}'/><child link='l{k + 1}'/></joint>"
        for k in range(count)
    )
    return f"<robot name='chain'>{links}{joints}</robot>"


def _read(text: str, folder: Path, name: str = "model.xml") -> ModelFile:
    (folder / name).write_text(text)
    return read_model(folder / name)


def _joint(model: ModelFile, name: str) -> StatedJoint:
    (found,) = [joint for link in model.links for joint in link.joints if joint.name == name]
    return found


def test_mjcf_states_joints_in_si_units_and_link_axes(tmp_path: Path) -> None:
    """Angles are converted, classes and frames applied; gains are those in the joint."""
    model = _read(_MJCF, tmp_path)
    turn, push, wrist = (_joint(model, name) for name in ("turn", "push", "wrist"))
    assert (turn.motion, turn.axis, turn.at_m) == ("hinge", (0.0, 1.0, 1.0), (0.1, 0.0, 0.0))
    assert turn.limits == pytest.approx((-math.pi / 6.0, math.pi / 3.0), rel=1e-15)
    assert (turn.damping, turn.friction, turn.armature, turn.stiffness) == (0.7, 0.3, 0.02, 5.0)
    assert (turn.rest, turn.reference) == pytest.approx((math.pi / 18.0, math.pi / 9.0), rel=1e-15)
    assert turn.gains == (50.0, 3.0 + 4.0 * 2.0**2)
    assert push.axis == pytest.approx((2.0, 0.0, 0.0), abs=1e-15)
    assert (push.at_m, push.limits, push.gains) == ((0.0, 0.0, 0.3), (-1.0, 1.0), (0.0, 0.0))
    assert (wrist.effort, wrist.mimic, wrist.limits) == (6.0, ("turn", -2.0, 0.1), UNLIMITED)


def test_urdf_states_joints(tmp_path: Path) -> None:
    """A limit of 0 for effort or velocity is none; what URDF has no number for is not stated."""
    model = _read(_URDF, tmp_path)
    first, second = _joint(model, "first"), _joint(model, "second")
    assert (first.damping, first.friction, first.effort, first.velocity) == (0.5, 0.2, 40.0, 3.0)
    assert (first.limits, first.armature, first.mimic) == ((-1.0, 2.0), None, None)
    assert (second.effort, second.velocity, second.limits) == (math.inf, math.inf, UNLIMITED)
    assert second.mimic == ("first", -2.0, 0.1)


@pytest.mark.parametrize(
    ("version", "attributes", "inside", "axis"),
    [
        ("1.11", "", "", (0.0, 1.0, 0.0)),
        ("1.11", 'expressed_in="__model__"', "", (0.0, 0.0, -1.0)),
        ("1.6", "", "<use_parent_model_frame>1</use_parent_model_frame>", (0.0, 0.0, -1.0)),
        ("1.4", "", "", (0.0, 0.0, -1.0)),
    ],
)
def test_sdformat_axes_are_turned_into_the_link(
    version: str, attributes: str, inside: str, axis: tuple[float, ...], tmp_path: Path
) -> None:
    """An axis is in the joint's frame, in a named one, or as in early versions in the model's."""
    text = (
        f"<sdf version='{version}'><model name='m'><link name='a'/><link name='b'>"
        "<pose>1 0 0 1.5707963267948966 0 0</pose></link><joint name='j' type='revolute'>"
        "<parent>a</parent><child>b</child><pose>0.1 0 0 0 0 0</pose>"
        f"<axis><xyz {attributes}>0 1 0</xyz>{inside}<limit><effort>-1</effort><velocity>7</velocity></limit>"
        "<dynamics><friction>0.2</friction><spring_stiffness>3</spring_stiffness></dynamics>"
        "</axis></joint></model></sdf>"
    )
    joint = _joint(_read(text, tmp_path), "j")
    assert joint.axis == pytest.approx(axis, abs=1e-15)
    assert (joint.at_m, joint.effort, joint.velocity) == ((0.1, 0.0, 0.0), math.inf, 7.0)
    assert (joint.friction, joint.stiffness, joint.limits) == (0.2, 3.0, UNLIMITED)


def test_mass_matrix_of_a_file_is_that_of_its_jacobians(tmp_path: Path) -> None:
    """M = sum of m Jv^T Jv + Jw^T I Jw, with armature; a joint of two moves a link without mass."""
    (tree,) = model_trees(_read(_MJCF, tmp_path))
    assert tree.joints == (("arm", 0), ("arm", 1), ("hand", 0))
    for q in ([0.0, 0.0, 0.0], [0.7, -0.2, 1.3]):
        found = tree_dynamics(tree.scene, np.array(q), np.zeros(3)).mass_matrix
        np.testing.assert_allclose(found, _from_jacobians(*q), rtol=0, atol=4e-15)


def _from_jacobians(turn: float, push: float, wrist: float) -> Array:
    """Return M (3, 3) of the MJCF above, written out in world axes."""
    axis = np.array([0.0, 1.0, 1.0]) / math.sqrt(2.0)
    pivot = np.array([0.1, 0.0, 1.0])
    arm = Rotation.from_rotvec(turn * axis)
    slide = arm.apply([1.0, 0.0, 0.0])
    origin = pivot + arm.apply([-0.1, 0.0, 0.0]) + push * slide
    plate = arm * Rotation.from_euler("x", 30.0, degrees=True)
    hand = arm * Rotation.from_euler("z", 40.0, degrees=True) * Rotation.from_euler("x", wrist)
    elbow = origin + arm.apply([1.0, 0.0, 0.0])
    spin = hand.apply([1.0, 0.0, 0.0])
    M = 0.02 * np.eye(3)
    for mass, moments, R, centre, below in (
        (1.5, (0.1, 0.2, 0.25), arm, origin + arm.apply([0.1, 0.0, 0.2]), False),
        (0.4, (0.1, 0.1, 0.1), plate, origin + arm.apply([0, 0.2, 0]) + plate.apply([0, 0, 0.1]), False),
        (2.0, (0.3, 0.2, 0.4), hand, elbow + hand.apply([0.1, 0.0, 0.0]), True),
    ):
        at_wrist = np.cross(spin, centre - elbow) if below else np.zeros(3)
        Jv = np.column_stack([np.cross(arm.apply(axis), centre - pivot), slide, at_wrist])
        Jw = np.column_stack([arm.apply(axis), np.zeros(3), spin if below else np.zeros(3)])
        inertia = R.as_matrix() @ np.diag(moments) @ R.as_matrix().T
        M += mass * Jv.T @ Jv + Jw.T @ inertia @ Jw
    return M


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (_URDF.replace('type="continuous"', 'type="planar"'), "'planar'"),
        (_URDF.replace('type="continuous"', 'type="floating"'), "'floating'"),
        (_URDF.replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"'), "is (0, 0, 0)"),
        (_chain(160), "more than 150 moving bodies"),
    ],
)  # fmt: skip
def test_trees_without_exact_dynamics_are_refused(text: str, why: str, tmp_path: Path) -> None:
    """The message has the file and the line of the joint."""
    with pytest.raises(InputError) as error:
        model_trees(_read(text, tmp_path))
    assert str(error.value).startswith(f"{tmp_path / 'model.xml'}:")
    assert why in str(error.value)


def _facts() -> JointFacts:
    turned = Rotation.from_euler("xyz", [0.5, 0.2, -0.3]).as_matrix()
    inertial = Rotation.from_euler("xyz", [0.4, 0.1, 0.9]).as_matrix()
    model = Rotation.from_euler("xyz", [-0.7, 0.3, 0.2]).as_matrix()
    joint = StatedJoint(
        "j", "revolute", 1, (0.48, 0.6, 0.64), 0.5, (-1.0, 2.0), friction=0.2, armature=0.01, stiffness=4.0,
        rest=0.3, reference=0.1, effort=40.0, velocity=3.0, mimic=("k", 2.0, 0.1), gains=(100.0, 5.0),
    )  # fmt: skip
    return JointFacts(joint, Placement(turned, np.array([0.3, -0.1, 0.2])), inertial, model, 1.0)


def _causes(
    change: Callable[[StatedJoint], StatedJoint], placement: Placement | None = None
) -> tuple[str, ...]:
    facts = _facts()
    held = change(replace(facts.joint, kind="hinge", name="", line=0))
    return joint_causes(facts, held, placement or facts.placement)


def test_a_joint_that_is_held_as_stated_has_no_cause() -> None:
    """Round-off of single precision, the length of the axis and a point along it are no differences."""
    axis = np.array(_facts().joint.axis)
    assert not _causes(lambda joint: joint)
    assert not _causes(
        lambda joint: replace(
            joint, axis=tuple(3.0 * axis), at_m=tuple(0.4 * axis), damping=0.5 * (1.0 + SINGLE / 2)
        )
    )
    assert not _causes(lambda joint: replace(joint, mimic=("", math.nan, math.nan), velocity=None))


@pytest.mark.parametrize("one", QUANTITIES, ids=lambda one: one.attribute)
def test_each_number_has_its_causes(one: Quantity) -> None:
    """Dropped where it has the neutral value, else with its factor, if a unit explains it."""
    given = getattr(_facts().joint, one.attribute)
    (dropped,) = _causes(lambda joint: replace(joint, **{one.attribute: one.neutral}))
    assert dropped.startswith(f"{one.name} dropped")
    for factor, text in FACTORS.items():
        (cause,) = _causes(lambda joint, factor=factor: replace(joint, **{one.attribute: factor * given}))
        assert cause.startswith(f"{one.name} {text}")
    (changed,) = _causes(lambda joint: replace(joint, **{one.attribute: 1.5 * given}))
    assert changed.startswith(f"{one.name} changed")


@pytest.mark.parametrize("name", AXES)
def test_each_fault_of_an_axis_is_named(name: str) -> None:
    """The axis that the fault makes is explained by its name."""
    facts = _facts()
    axis = AXES[name](facts) @ np.array(facts.joint.axis)
    assert _causes(lambda joint: replace(joint, axis=tuple(axis))) == (f"axis {name}",)


@pytest.mark.parametrize("name", PLACEMENTS)
def test_each_fault_of_a_joint_frame_is_named(name: str) -> None:
    """The placement that the fault makes is explained by its name."""
    placement = _facts().placement
    assert placement is not None
    assert _causes(lambda joint: joint, PLACEMENTS[name](placement)) == (name,)


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        ({"axis": (1.0, 0.0, 0.0)}, "axis ignored: x in its place"),
        ({"axis": (0.6, 0.64, 0.48)}, "axis 11"),
        ({"at_m": (0.0, 0.4, 0.0)}, "joint point 0.32 m off"),
        ({"limits": UNLIMITED}, "limits dropped"),
        ({"limits": (-180.0 / math.pi, 360.0 / math.pi)}, "limits times 57.2958"),
        ({"limits": (-2.0, 1.0)}, "limits changed"),
        ({"mimic": None}, "mimic dropped: 2 k + 0.1"),
        ({"mimic": ("k", 2.0, -0.1)}, "mimic changed"),
        ({"gains": (100.0 * math.pi / 180.0, 5.0)}, "position gain divided by 57.2958"),
        ({"gains": (100.0, 0.0)}, "velocity gain dropped"),
        ({"kind": "slide"}, "held as a slide, not as a hinge"),
    ],
)
def test_other_faults_of_a_joint_are_named(change: dict[str, object], cause: str) -> None:
    """Each has one cause, with the numbers."""
    (found,) = _causes(lambda joint: replace(joint, **change))  # type: ignore[arg-type]
    assert found.startswith(cause)


def test_what_a_file_does_not_state_is_added() -> None:
    """Damping, limits and a mimic that an importer adds are named."""
    facts = replace(_facts(), joint=StatedJoint("j", "continuous", 1, (0.0, 0.0, 1.0), 0.0, UNLIMITED))
    held = StatedJoint(
        "", "hinge", 0, (0.0, 0.0, 1.0), 0.04, (-1.0, 1.0), armature=0.1, mimic=("k", 1.0, 0.0)
    )
    found = joint_causes(facts, held, facts.placement)
    assert [cause.partition(" added")[0] for cause in found] == ["limits", "damping", "armature", "mimic"]


@pytest.mark.parametrize(
    ("text", "link", "line"),
    [
        (_URDF.replace('axis xyz="0 1 0"', 'axis xyz="0 0 0"'), "b", 11),
        (_MJCF.replace('type="slide" axis="0 0 2"', 'type="slide" axis="0 0 0"'), "arm", 10),
        (
            '<sdf version="1.7"><model name="m"><link name="a"/><link name="b"/>\n'
            '<joint name="j" type="prismatic"><parent>a</parent><child>b</child>'
            "<axis><xyz>0 0 0</xyz></axis></joint></model></sdf>",
            "b",
            2,
        ),
    ],
)
def test_an_axis_of_no_direction_is_an_error_and_not_compared(
    text: str, link: str, line: int, tmp_path: Path
) -> None:
    """The joint is found in its line; an importer that holds it is said to hold the links."""
    (finding,) = [one for one in lint(_read(text, tmp_path)) if one.severity == "error"]
    assert (finding.rule, finding.link, finding.line) == ("zero-axis", link, line)
    column = ImporterColumn("dart", "6", "default", "", "ok")
    body = LinkAudit(link, 1, None, "", "", {column.name: LinkImport("agrees")})
    found = Audit("model.xml", "urdf", "", [column], [body], [finding])
    assert [part.text for part in answer(found)][1] == "DART holds the links as written."


def test_a_frame_that_is_not_finite_is_a_difference_with_a_name() -> None:
    """An importer that normalises an axis of zero holds NaN for all that hangs on it."""
    held = Placement(np.full((3, 3), np.nan), np.full(3, np.nan))
    assert _causes(lambda joint: joint, held) == ("joint frame not finite",)


def test_two_joints_of_one_name_are_an_error_and_have_no_order(tmp_path: Path) -> None:
    """The second one is found in its line; an importer that gives it another name has no other order."""
    model = _read(_URDF.replace('name="second"', 'name="first"'), tmp_path)
    (finding,) = [one for one in lint(model) if one.severity == "error"]
    assert (finding.rule, finding.link, finding.line) == ("repeated-joint", "b", 11)
    assert "'first', in line 8" in finding.message
    moving = [StatedJoint(name, "hinge", 0, (0.0, 1.0, 0.0)) for name in ("first", "first_2")]
    zero, one = [0.0] * 3, np.eye(3).tolist()
    links = [
        ImportedLink(link.name, 1.0, zero, one, zero, one, at - 1, (joint,))
        for at, (link, joint) in enumerate(
            zip(model.links, [StatedJoint("", "free", 0), *moving], strict=True)
        )
    ]
    held = HeldJoints.of(links, {link.name: link for link in links}, model)
    joints, orders = audited_joints(model, {"e:default": ("e", held)})
    column = ImporterColumn("e", "1", "default", "", "ok")
    found = Audit("model.xml", "urdf", "", [column], [], [finding], joints=joints, orders=orders)
    text = " ".join(part.text for part in audit_document(found).parts if isinstance(part, Sentence))
    assert "another order" not in text


@pytest.fixture(scope="module")
def audits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Audit]:
    """The audits of the MJCF and the URDF above by all installed engines."""
    folder = tmp_path_factory.mktemp("joints")
    with closing(EnginePool()) as pool:
        return {
            name: imported_audit(
                pool,
                _read(text, folder, name),
                ["mujoco", "pybullet", "dart"],
                AuditOptions(spins=False),
            )
            for name, text in (("arm.xml", _MJCF), ("leg.xml", _LEG), ("arm.urdf", _URDF))
        }


def _found(audit: Audit, importer: str) -> set[tuple[str, str]]:
    return {
        (joint.name, cause.partition(":")[0])
        for joint, name, cause in audit.differing_joints()
        if name == importer
    }


@pytest.mark.slow
def test_importers_are_compared_with_a_urdf(audits: dict[str, Audit]) -> None:
    """PyBullet drops the mimic, which DART and MuJoCo 4 hold; MuJoCo has no limit of velocity."""
    audit = audits["arm.urdf"]
    for importer in ("mujoco:default", "mujoco:recommended", "dart:default"):
        assert not _found(audit, importer)
    assert _found(audit, "pybullet:recommended") == {("second", "mimic dropped")}
    first = next(joint for joint in audit.joints if joint.name == "first")
    assert [text.partition(":")[0] for text in first.held["mujoco:default"].not_held] == [
        "velocity limit not held"
    ]
    for importer, limit in (
        ("mujoco:default", 1e-13),
        ("pybullet:recommended", 1e-7),
        ("dart:default", 1e-13),
    ):
        deviation = audit.matrices[importer].deviation
        assert deviation is not None
        assert deviation <= limit
    assert audit.matrices["pybullet:default"].cause == FOLLOWS


@pytest.mark.slow
def test_importers_are_compared_with_an_mjcf(audits: dict[str, Audit]) -> None:
    """DART takes degrees for radians and drops friction, PyBullet drops damping; MuJoCo holds everything."""
    audit = audits["arm.xml"]
    assert not _found(audit, "mujoco:default")
    assert audit.matrices["mujoco:default"].deviation == pytest.approx(0.0, abs=1e-13)
    dart, bullet = _found(audit, "dart:default"), _found(audits["leg.xml"], "pybullet:default")
    assert {
        ("turn", "limits times 57.2958, as degrees for radians"),
        ("turn", "friction dropped"),
        ("turn", "stiffness dropped"),
        ("turn", "position gain dropped"),
        ("wrist", "mimic dropped"),
    } <= dart
    assert {("hip", "damping dropped"), ("hip", "friction dropped"), ("roll", "armature dropped")} <= bullet
    assert not {cause for _, cause in dart if cause.startswith("damping")}


@pytest.mark.slow
def test_an_audit_of_joints_is_shown_and_stored(audits: dict[str, Audit], tmp_path: Path) -> None:
    """Sentences, JSON, the page, SARIF and exit status have the differences, and so has a stored audit."""
    audit = audits["arm.urdf"]
    text = " ".join(part.text for part in audit_document(audit).parts if isinstance(part, Sentence))
    assert "but changes 1 of 2 joints (mimic dropped)" in text
    data = audit_data(audit)
    held = {one["stated"]["name"]: one["held"]["pybullet:recommended"]["causes"] for one in data["joints"]}
    assert held["second"] == ("mimic dropped: -2 first + 0.1 in the file",)
    assert data["mass_matrices"]["dart:default"]["deviation"] < 1e-13
    assert audit_page(audit).count("mimic dropped") >= 2
    assert any(alert.rule == "joint-difference" for alert in alerts_of(audit, differences=True))
    assert failures(audit, ["difference"])
    write_audit(audit, tmp_path)
    again, _ = read_audit(tmp_path)
    assert json.dumps(audit_data(again)["joints"]) == json.dumps(data["joints"])
    assert again.matrices == audit.matrices


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("seed", range(3))
def test_a_file_agrees_with_itself_in_another_format(seed: int, tmp_path: Path) -> None:
    """The joints of a random URDF and of its SDFormat, and their mass matrices, are the same."""
    urdf = random_urdf(np.random.default_rng(seed))
    _read(urdf, tmp_path, "robot.urdf")
    _read(sdf_of(urdf), tmp_path, "robot.sdf")
    found = audit_against(tmp_path / "robot.sdf", tmp_path / "robot.urdf")
    assert found.joints
    assert not found.differing_joints()
    (matrix,) = found.matrices.values()
    assert matrix.deviation is not None
    assert matrix.deviation <= 1e-12


def test_a_converter_that_loses_joints_is_named(tmp_path: Path) -> None:
    """Friction, a mimic and an axis that a converted file lacks are named, and its mass matrix differs."""
    _read(_URDF, tmp_path, "robot.urdf")
    lost = _URDF.replace('friction="0.2"', "").replace("0 0.6 0.8", "0 0.8 0.6")
    _read(lost.replace('<mimic joint="first" multiplier="-2" offset="0.1"/>', ""), tmp_path, "lost.urdf")
    found = audit_against(tmp_path / "lost.urdf", tmp_path / "robot.urdf")
    assert _found(found, "lost.urdf") == {
        ("first", "axis with y and z exchanged"),
        ("first", "friction dropped"),
        ("second", "mimic dropped"),
    }
    (matrix,) = found.matrices.values()
    assert matrix.differs
    assert matrix.cause == FOLLOWS


def test_exchanged_rates_of_a_mass_matrix_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An importer whose joints agree, but whose rates are in another order than it says, has this cause."""
    from bodycheck.audit import audit_against as module

    _read(_URDF, tmp_path, "robot.urdf")
    right = module.matrices_of_file(_read(_URDF, tmp_path, "other.urdf"))

    def exchanged(_: ModelFile) -> object:
        (one,), why = right
        order = [*range(6), 7, 6]
        return [replace(one, values=one.values[:, order][:, :, order])], why

    monkeypatch.setattr(module, "matrices_of_file", exchanged)
    (matrix,) = audit_against(tmp_path / "other.urdf", tmp_path / "robot.urdf").matrices.values()
    assert matrix.cause == "joint order: the rates of first and second exchanged"


@pytest.mark.slow
@pytest.mark.nightly(after=2)
@pytest.mark.filterwarnings("ignore:compiler attribute 'settotalmass' is deprecated")
@pytest.mark.parametrize("seed", range(6))
def test_mujoco_is_not_accused_of_random_files(seed: int, tmp_path: Path) -> None:
    """Several joints of a body, references, springs, classes and armature: no difference, M to round-off."""
    from bodycheck.adapters.importers import ImportRequest, mujoco_import
    from bodycheck.audit.audit_joints import HeldJoints, audited_joints
    from bodycheck.audit.audit_matrix import compared_matrices

    model = _read(random_mjcf(np.random.default_rng(seed)), tmp_path)
    request = ImportRequest(str(model.path), "mjcf", "default")
    links = mujoco_import.imported_links(request)
    held = HeldJoints.of(links, {link.name: link for link in links}, model)
    joints, orders = audited_joints(model, {"mujoco": ("mujoco", held)})
    assert not orders
    assert [cause for joint in joints for cause in joint.held["mujoco"].causes] == []
    matrix = compared_matrices(model, held, mujoco_import.mass_matrices(request, 2), "")
    assert matrix.deviation is None or matrix.deviation <= 1e-11


def test_answers_of_workers_are_checked() -> None:
    """A joint or matrix of a wrong shape is refused."""
    with pytest.raises(ValueError, match="axis"):
        joint_of({"name": "j", "kind": "hinge", "axis": ["1", "0"]})
    with pytest.raises(ValueError, match="matrices"):
        matrices_of({"columns": [[0, 0]], "displacements": [["0"]], "values": [[["1", "0"]]]})
