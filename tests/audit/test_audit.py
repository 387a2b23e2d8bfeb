"""The import audit: named causes, findings of the linter, and its outputs."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck._util.shard import Shard
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.audit import audit_versions, spelling_run
from bodycheck.audit.audit import (
    Audit,
    Body,
    Difference,
    ImporterColumn,
    LinkAudit,
    LinkImport,
    LintFinding,
    MatrixComparison,
    Spin,
    State,
    read_audit,
)
from bodycheck.audit.audit_document import alerts_of, audit_data, audit_document, failures
from bodycheck.audit.audit_merge import merge_audits, write_shard
from bodycheck.audit.audit_page import audit_page
from bodycheck.audit.audit_run import AuditOptions, audit
from bodycheck.audit.causes import DISCARDED, body_causes, with_issue
from bodycheck.audit.lint import lint
from bodycheck.audit.spelling_run import APART_RAD, run_spellings
from bodycheck.reports.alerts import sarif
from bodycheck.reports.document import Sentence, Table, json_text
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import Frame, doubles
from bodycheck.scenarios.model_files.model_file import ModelFile
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.model_texts import sdf_of

_LINK = """<robot name="r">
<link name="{name}">
<inertial>
<origin xyz="0.1 0.2 -0.1" rpy="0.4 -0.9 0.7"/>
<mass value="{mass}"/>
<inertia {inertia}/>
</inertial>
{more}
</link>
</robot>
"""
_GOOD = 'ixx="0.03" iyy="0.04" izz="0.05" ixy="0.004" ixz="-0.002" iyz="0.006"'
_BOX = '<collision><origin xyz="0.1 0.2 -0.1"/><geometry><box size="0.4 0.3 0.3"/></geometry></collision>'


def _file(folder: Path, inertia: str = _GOOD, mass: str = "2.0", name: str = "arm", more: str = _BOX) -> Path:
    path = folder / "robot.urdf"
    path.write_text(_LINK.format(name=name, mass=mass, inertia=inertia, more=more))
    return path


def _causes(model: ModelFile, tensor: np.ndarray, discarded: str = "") -> tuple[str, ...]:
    return _causes_of(model, lambda expected: replace(expected, inertia_kg_m2=tensor), discarded)


def _causes_of(model: ModelFile, fault: Callable[[Body], Body], discarded: str = "") -> tuple[str, ...]:
    """Return the causes named where an engine holds the body of the file with this fault.

    discarded: what a second import showed the tensor to come from.
    """
    link = model.links[0]
    assert link.stated is not None
    expected = Body.of(link.stated.in_link)
    held = fault(expected)
    difference = Difference.between(expected, held)
    return body_causes(model, [(link, Frame.of())], expected, held, difference, discarded)


def test_tensor_faults_are_named(tmp_path: Path) -> None:
    """Each fault made with the numbers of the file is named, and the right tensor has no cause."""
    model = read_model(_file(tmp_path))
    link = model.links[0]
    assert link.stated is not None
    J, R = doubles(link.stated.inertia.tensor), doubles(link.stated.frame.rotation)
    diagonal = np.diag(np.diagonal(J))
    faults = {
        "off-diagonals dropped": R @ diagonal @ R.T,
        "off-diagonals of the wrong sign": R @ (2 * diagonal - J) @ R.T,
        "rotation of the inertial frame ignored": J,
        "rotated by the inverse of the inertial frame": R.T @ J @ R,
        "tensor times 1000": 1000.0 * R @ J @ R.T,
        "replaced by the identity": np.eye(3),
    }
    for what, tensor in faults.items():
        (cause,) = _causes(model, tensor)
        assert cause == what or cause.startswith(f"{what}, ")
    assert (
        Difference.between(
            Body.of(link.stated.in_link), Body(2.0, np.array([0.1, 0.2, -0.1]), R @ J @ R.T)
        ).largest
        < 1e-15
    )


def test_a_tensor_that_is_proved_to_come_from_elsewhere_is_discarded(tmp_path: Path) -> None:
    """Whatever fault of the file's own tensor makes the same numbers."""
    model = read_model(_file(tmp_path))
    link = model.links[0]
    assert link.stated is not None
    alike = doubles(link.stated.inertia.tensor)
    assert _causes(model, alike)[0].startswith("rotation of the inertial frame ignored")
    assert _causes(model, alike, "recomputed from the only shape") == (
        "tensor discarded: recomputed from the only shape",
    )


def _turned_about_z(body: Body, degrees: float) -> Body:
    """Return the body with its principal axes rotated about the first of them."""
    _, axes = body.principal
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turn = axes @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ axes.T
    return replace(body, inertia_kg_m2=turn @ body.inertia_kg_m2 @ turn.T)


def _clamped(body: Body, least: float) -> Body:
    moments, axes = body.principal
    return replace(body, inertia_kg_m2=axes @ np.diag(np.maximum(moments, least)) @ axes.T)


@pytest.mark.parametrize(
    ("fault", "causes"),
    [
        (lambda b: replace(b, centre_m=np.zeros(3)), ["centre of mass ignored"]),
        (lambda b: replace(b, centre_m=-b.centre_m), ["centre of mass of the wrong sign"]),
        (lambda b: replace(b, centre_m=np.add(b.centre_m, [0.0, 0.0, 0.25])), ["centre of mass 0.25 m off"]),
        (lambda b: replace(b, mass_kg=0.0), ["mass discarded: the link cannot move"]),
        (lambda b: replace(b, mass_kg=2.5), ["mass times 1.25"]),
        (
            lambda b: replace(b, mass_kg=2.5, inertia_kg_m2=1.25 * b.inertia_kg_m2),
            ["mass times 1.25", "tensor scaled with the mass"],
        ),
        (lambda b: replace(b, mass_kg=36.0), ["mass recomputed: the volume of the shapes at 1000 kg/m^3"]),
        (lambda b: replace(b, mass_kg=1.0, inertia_kg_m2=np.eye(3)),
         ["mass discarded: 1 kg in its place", "replaced by the identity"]),
        (lambda b: replace(b, inertia_kg_m2=np.zeros((3, 3))), ["tensor discarded: all moments are zero"]),
        (lambda b: replace(b, inertia_kg_m2=np.full((3, 3), np.nan)), ["not finite"]),
        (lambda b: _turned_about_z(b, 30.0), ["principal axes rotated by 30 degrees"]),
        (lambda b: _clamped(b, 0.045), ["moments clamped to 0.045 kg m^2"]),
        (
            lambda b: replace(b, inertia_kg_m2=b.inertia_kg_m2 + np.diag([0.01, 0.02, 0.03])),
            ["tensor changed; no known fault makes these numbers of the file"],
        ),
        (lambda b: replace(b, mass_kg=2.0 * (1.0 + 1e-8)), ["rounded: "]),
    ],
)  # fmt: skip
def test_other_faults_of_a_body_are_named(
    fault: Callable[[Body], Body], causes: list[str], tmp_path: Path
) -> None:
    """Mass, centre and tensor have causes of their own; a fault that no rule makes is not guessed."""
    found = _causes_of(read_model(_file(tmp_path)), fault)
    assert len(found) == len(causes)
    assert all(one.startswith(cause) for one, cause in zip(found, causes, strict=True)), found


def test_known_fault_names_its_issue() -> None:
    """A cause that developers of the engine discuss has their issue; other engines have not."""
    cause = "rotation of the inertial frame ignored"
    assert with_issue("mujoco==3.12.0", cause).endswith("(google-deepmind/mujoco#3559)")
    assert with_issue("dart", cause) == cause


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"inertia": 'ixx="1" iyy="1" izz="5" ixy="0" ixz="0" iyz="0"'}, "triangle-inequality"),
        ({"inertia": 'ixx="-1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"'}, "not-positive"),
        ({"inertia": 'ixx="30" iyy="40" izz="50" ixy="4" ixz="-2" iyz="6"'}, "unit-slip"),
        (
            {"inertia": 'ixx="1.5e308" iyy="1.5e308" izz="1.5e308" ixy="5e307" ixz="0" iyz="0"'},
            "number-range",
        ),
        ({"inertia": 'ixx="3e4" iyy="4e4" izz="5e4" ixy="0" ixz="0" iyz="0"'}, "unit-slip"),
        ({"inertia": 'ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"'}, "placeholder-inertia"),
        ({"mass": "1e-320"}, "number-range"),
        ({"more": _BOX.replace("0.4 0.3", "0.4 1e300")}, "number-range"),
        ({"mass": "0"}, "zero-mass"),
        ({"mass": "-1"}, "negative-mass"),
    ],
)
def test_linter_reports_a_wrong_inertia_with_its_line(
    changes: dict[str, str], rule: str, tmp_path: Path
) -> None:
    """Each wrong inertia is found in line 3 and with what is expected; the right one gives no finding."""
    assert not list(lint(read_model(_file(tmp_path))))
    path = _file(tmp_path, **changes)
    findings = list(lint(read_model(path)))
    assert [one.rule for one in findings] == [rule]
    assert [one.line for one in (*findings, *audit(path, AuditOptions([])).links)] == [3, 3]
    assert findings[0].expected


def test_a_tensor_that_rounding_may_explain_is_not_the_worst(tmp_path: Path) -> None:
    """I1 + I2 < I3 by 0.4 % in three digits comes after one that is 200 times too large, below it."""
    rounded = 'ixx="0.0121" iyy="0.0128" izz="0.025" ixy="0" ixz="0" iyz="0"'
    text = _file(tmp_path, rounded, more="").read_text()
    other = text.split("\n", 1)[1].replace('name="arm"', 'name="wrist"').replace('izz="0.025"', 'izz="0.2"')
    path = tmp_path / "robot.urdf"
    joint = '<joint name="j" type="fixed"><parent link="arm"/><child link="wrist"/></joint>\n</robot>'
    path.write_text(text.replace("</robot>\n", "") + other.replace("</robot>", joint))
    first = _sentences(audit(path, AuditOptions([])))[0].text
    assert "wrist, line " in first, first


@pytest.mark.parametrize("name", ["ixx", "iyy", "izz", "ixy", "ixz", "iyz"])
def test_linter_reports_a_moment_that_is_missing(name: str, tmp_path: Path) -> None:
    """URDF requires all six; the first line names it, not the tensor that a 0 in its place makes impossible.

    In SDFormat each has a default.
    """
    path = _file(tmp_path, inertia=_GOOD.replace(f"{name}=", "moment="))
    found = audit(path, AuditOptions([]))
    (finding,) = [one for one in found.findings if one.rule == "missing-moment"]
    assert (finding.severity, finding.link, finding.line) == ("error", "arm", 6)
    others = len(found.findings) - 1
    more = f" (and {others} more below)" if others else ""
    assert _sentences(found)[0].text.endswith(f": arm, line 6: <inertia> has no {name}: read as 0{more}")
    path.write_text(
        '<sdf version="1.9"><model name="m"><link name="arm"><inertial><mass>2</mass>'
        "<inertia><ixx>0.5</ixx></inertia></inertial></link></model></sdf>"
    )
    assert "missing-moment" not in [one.rule for one in lint(read_model(path))]


@pytest.mark.parametrize(
    ("right", "typed", "meant"),
    [
        ("<inertial>", "<intertial>", "<inertial>"),
        ("<mass ", "<Mass ", "<mass>"),
        ("<origin", "<orgin", "<origin>"),
        (" rpy=", " rpyy=", "rpy"),
        ("<axis", "<axes", "<axis>"),
        ("lower=", "lover=", "lower"),
    ],
)
def test_linter_names_what_a_misspelt_name_resembles(
    right: str, typed: str, meant: str, tmp_path: Path
) -> None:
    """An element or attribute that is not read is no finding as such: extensions have names of their own."""
    joint = (
        '\n<joint name="j" type="revolute"><parent link="base"/><child link="arm"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1"/></joint>\n<link name="base"/>'
    )
    path = _file(tmp_path)
    text = path.read_text().replace("</link>", f"<self_collision/></link>{joint}")
    path.write_text(text)
    assert "misspelt-name" not in {one.rule for one in lint(read_model(path))}
    wrong = text.replace(right, typed, 1).replace(right.replace("<", "</"), typed.replace("<", "</"), 1)
    path.write_text(wrong)
    line = 1 + wrong[: wrong.index(typed)].count("\n")
    (found,) = [one for one in lint(read_model(path)) if one.rule == "misspelt-name"]
    assert (found.severity, found.link, found.line, found.expected) == ("warning", "arm", line, meant)


@pytest.mark.parametrize("form", ["urdf", "sdf"])
def test_linter_reports_a_second_inertial(form: str, tmp_path: Path) -> None:
    """The error is in the line of the second one, and names the one whose numbers are read."""
    path = _file(tmp_path, more=f'{_BOX}\n<inertial><mass value="3"/><inertia {_GOOD}/></inertial>')
    if form == "sdf":
        path.write_text(
            '<sdf version="1.9"><model name="m"><link name="arm">\n<inertial>'
            "<mass>2</mass></inertial>\n<inertial><mass>3</mass></inertial></link></model></sdf>"
        )
    model = read_model(path)
    (found,) = [one for one in lint(model) if one.severity == "error"]
    lines = {"urdf": (3, 9), "sdf": (2, 3)}[form]
    assert (found.rule, found.link, found.line) == ("repeated-inertial", "arm", lines[1])
    assert found.message == f"has 2 elements <inertial>, of which the first is read, in line {lines[0]}"
    assert model.links[0].stated is not None
    assert model.links[0].stated.inertia.mass == 2


def _robot(folder: Path, links: dict[str, str], joint: str = "continuous") -> Path:
    """Write links, name -> content, in lines of their own; all but the first hang on that by a joint."""
    first, *others = links
    lines = [
        '<robot name="r">',
        *(f'<link name="{name}">{content}</link>' for name, content in links.items()),
    ]
    lines += [
        f'<joint name="to_{name}" type="{joint}"><parent link="{first}"/><child link="{name}"/></joint>'
        for name in others
    ]
    path = folder / "robot.urdf"
    path.write_text("\n".join([*lines, "</robot>"]))
    return path


def _inertial(y: float, ixy: float) -> str:
    tensor = f'ixx="0.03" iyy="0.04" izz="0.05" ixy="{ixy}" ixz="0.003" iyz="0"'
    return f'<inertial><origin xyz="0.1 {y} 0"/><mass value="2"/><inertia {tensor}/></inertial>'


@pytest.mark.parametrize(("joint", "severities"), [("continuous", ["warning"]), ("fixed", [])])
def test_linter_reports_a_link_that_moves_and_has_no_inertia(
    joint: str, severities: list[str], tmp_path: Path
) -> None:
    """Its line is that of the link; a welded link needs none."""
    links = {"base": _inertial(0.0, 0.0), "arm": ""}
    found = list(lint(read_model(_robot(tmp_path, links, joint))))
    assert [(one.rule, one.link, one.line, one.severity) for one in found] == [
        ("missing-inertial", "arm", 3, severity) for severity in severities
    ]
    assert all(one.confidence == "certain" and "mass" in one.expected for one in found)


def test_linter_reports_a_root_without_inertia(tmp_path: Path) -> None:
    """It is a note: a fixed base needs none, and the file does not state whether the base is fixed."""
    (found,) = lint(read_model(_robot(tmp_path, {"base": "", "arm": _inertial(0.0, 0.0)})))
    assert (found.rule, found.link, found.line, found.severity) == ("missing-inertial", "base", 2, "note")


def test_linter_notes_a_moving_link_whose_inertia_is_that_of_fixed_ones(tmp_path: Path) -> None:
    """The file is complete, so it is a note; of a base that carries one, as ROS writes them, it is none."""
    tool = '<link name="tool">' + _inertial(0.0, 0.0) + "</link>"
    weld = '<joint name="weld" type="fixed"><parent link="arm"/><child link="tool"/></joint>'
    path = _robot(tmp_path, {"base": _inertial(0.0, 0.0), "arm": ""}, "continuous")
    path.write_text(path.read_text().replace("</robot>", f"{tool}\n{weld}\n</robot>"))
    (found,) = lint(read_model(path))
    assert (found.rule, found.link, found.line, found.severity) == ("missing-inertial", "arm", 3, "note")
    path.write_text(path.read_text().replace("continuous", "fixed"))
    assert not list(lint(read_model(path)))


@pytest.mark.parametrize("shape", ["", '<visual><geometry><sphere radius="0.1"/></geometry></visual>'])
@pytest.mark.parametrize(
    ("centre_m", "moment", "noted"), [(4.9, 0.03, 0), (5.1, 0.03, 1), (0.1, 30.0, 0), (0.1, 31.0, 1)]
)
def test_linter_notes_numbers_far_beyond_the_model(
    centre_m: float, moment: float, noted: int, shape: str, tmp_path: Path
) -> None:
    """The model spans 0.5 m; sqrt(3.3 I / 4) is 10 times that at I = 30.3; shapes have other rules."""
    tensor = f'ixx="{moment}" iyy="{1.1 * moment}" izz="{1.2 * moment}" ixy="0" ixz="0" iyz="0"'
    numbers = f'<origin xyz="{centre_m} 0 0"/><mass value="2"/><inertia {tensor}/>'
    links = {"base": _inertial(0.0, 0.0), "tool": f"{shape}<inertial>{numbers}</inertial>"}
    path = _robot(tmp_path, links)
    path.write_text(path.read_text().replace("<parent", '<origin xyz="0.5 0 0"/><parent'))
    found = [one for one in lint(read_model(path)) if one.rule == "beyond-model"]
    expected = [] if shape else [("tool", "note", "possible")] * noted
    assert [(one.link, one.severity, one.confidence) for one in found] == expected


@pytest.mark.parametrize("names", [("left_arm", "right_arm"), ("arm_l", "arm_r"), ("Left", "Right")])
def test_linter_reports_tensors_that_are_no_mirror_images(names: tuple[str, str], tmp_path: Path) -> None:
    """Mirrored in y, Ixy changes its sign; the expected tensor is that of the first link so mirrored."""
    for ixy, wrong in ((-0.004, False), (0.004, True)):
        base = {"base": _inertial(0.0, 0.0)}
        arms = dict(zip(names, (_inertial(0.2, 0.004), _inertial(-0.2, ixy)), strict=True))
        found = list(lint(read_model(_robot(tmp_path, base | arms))))
        assert [(one.rule, one.link, one.line) for one in found] == [("mirrored-axes", names[1], 4)] * wrong
    assert found[0].confidence == "likely"
    assert found[0].expected.startswith("(0.03, -0.004, 0.003, 0.04, 0, 0.05)")


def test_linter_reports_a_mirrored_mesh(tmp_path: Path) -> None:
    """A scale of negative determinant; one of two negative factors is a rotation."""
    for scale, rules in (("1 -1 1", ["mirrored-axes"]), ("-1 -1 1", [])):
        mesh = f'<collision><geometry><mesh filename="a.stl" scale="{scale}"/></geometry></collision>'
        found = list(lint(read_model(_robot(tmp_path, {"base": _inertial(0.0, 0.0) + mesh}))))
        assert [one.rule for one in found] == rules, scale


def test_linter_reports_a_tensor_about_the_origin(tmp_path: Path) -> None:
    """A tensor that fits the shape only about the link's origin is found."""
    mass, arm, edges = 2.0, np.array([0.5, 0.0, 0.0]), np.array([0.2, 0.3, 0.4])
    about_centre = np.diag(mass / 12.0 * (edges @ edges - edges**2))
    tensor = about_centre + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    xx, yy, zz = np.diagonal(tensor).tolist()
    path = tmp_path / "robot.urdf"
    path.write_text(
        '<robot name="r"><link name="a"><inertial><origin xyz="0.5 0 0"/><mass value="2"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial>'
        '<collision><origin xyz="0.5 0 0"/><geometry><box size="0.2 0.3 0.4"/></geometry></collision>'
        "</link></robot>"
    )
    assert [one.rule for one in lint(read_model(path))] == ["about-another-point"]


@pytest.fixture(scope="module")
def audited(tmp_path_factory: pytest.TempPathFactory) -> Audit:
    """The audit of one link by all built-in importers."""
    return audit(_file(tmp_path_factory.mktemp("audit")), AuditOptions())


@pytest.mark.slow
def test_importers_hold_the_link_and_default_pybullet_does_not(audited: Audit) -> None:
    """MuJoCo, DART and PyBullet with its flag agree with the file; PyBullet's default is named."""
    (link,) = audited.links
    for name in ("mujoco:recommended", "pybullet:recommended", "dart:default"):
        assert link.held[name].state in ("agrees", "rounded")
    wrong = link.held["pybullet:default"]
    assert wrong.state == "differs"
    assert wrong.causes[0].startswith("tensor discarded: recomputed from the collision shape")


@pytest.mark.slow
def test_spins_settle_what_the_numbers_claim(audited: Audit) -> None:
    """Right imports follow the truth as the engine does with the file's numbers; the wrong one leaves it."""
    (link,) = audited.links
    for name, spin in link.spins.items():
        assert spin.control_rad is not None
        assert spin.excerpt_rad is not None
        if name == "pybullet:default":
            assert spin.excerpt_rad > 30.0 * spin.control_rad
        else:
            assert spin.excerpt_rad <= 1.5 * spin.control_rad + 1e-9


@pytest.mark.slow
def test_outputs_have_all_digits_and_places(audited: Audit) -> None:
    """JSON has every digit of the body, SARIF the lines, and the page two ellipsoids per comparison."""
    data = json.loads(json_text(audit_data(audited)))
    stated = audited.links[0].stated
    assert stated is not None
    assert data["links"][0]["stated"]["inertia_kg_m2"] == stated.inertia_kg_m2.tolist()
    results = json.loads(sarif(alerts_of(audited, differences=True)))["runs"][0]["results"]
    assert {one["ruleId"] for one in results} == {"import-difference"}
    assert results[0]["locations"][0]["physicalLocation"]["region"]["startLine"] == 3
    page = audit_page(audited)
    assert page.count('<path class="held"') == page.count('<path class="true"') >= 4
    assert failures(audited, ["difference"])
    assert not failures(audited, ["error"])


_IMPOSSIBLE = 'ixx="1" iyy="1" izz="5" ixy="0" ixz="0" iyz="0"'
_BEYOND = 'ixx="30" iyy="40" izz="65" ixy="4" ixz="-2" iyz="6"'


@pytest.mark.parametrize(
    ("inertia", "fail_on", "status"),
    [
        (_IMPOSSIBLE, (), 1),
        (_IMPOSSIBLE, ("--fail-on", "difference"), 1),
        (_IMPOSSIBLE, ("--fail-on", "never"), 0),
        (_IMPOSSIBLE.replace("5", "five"), (), 1),
        (_BEYOND, (), 1),
        (_GOOD.replace('ixy="0.004"', ""), (), 1),
        (_GOOD, ("--fail-on", "note"), 0),
    ],
)
def test_lint_command_exits_by_fail_on(
    inertia: str, fail_on: tuple[str, ...], status: int, tmp_path: Path
) -> None:
    """Status 1 by default on errors, the rest by --fail-on."""
    path = _file(tmp_path, inertia=inertia)
    assert run_bodycheck(tmp_path, "audit", path.name, "--lint", "--quiet", *fail_on).returncode == status


def test_answer_begins_with_the_file(tmp_path: Path) -> None:
    """The first line has the worst finding with its link and line, whatever stands before it in the file."""
    links = {"base": _inertial(0.0, 0.0), "arm": "", "forearm": _inertial(0.1, 0.0).replace("0.05", "0.9")}
    path = _robot(tmp_path, links)
    head = _sentences(audit(path, AuditOptions([])))[0]
    assert head.strong
    assert head.text.startswith(
        "robot.urdf: 1 error, 1 warning: forearm, line 4: impossible tensor, I1 + I2 < I3: (0.0299897, "
    )


def test_a_mass_below_zero_stands_before_a_tensor_that_is_impossible(tmp_path: Path) -> None:
    """The first line names the link whose numbers are farther from those of a body."""
    negative = _inertial(0.1, 0.0).replace('mass value="', 'mass value="-')
    links = {"arm": _inertial(0.1, 0.0).replace("0.05", "0.9"), "hand": negative}
    head = _sentences(audit(_robot(tmp_path, links), AuditOptions([])))[0]
    assert head.text.startswith("robot.urdf: 2 errors: hand, line ")


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (
            _LINK.replace("{inertia}", _GOOD.replace("0.03", "0,03")),
            6,
            "<inertia>: ixx = '0,03' is not a finite number",
        ),
        (_LINK.replace(' value="{mass}"', ""), 5, "<mass>: has no attribute 'value'"),
        (_LINK.replace("0.1 0.2 -0.1", "0.1 0.2"), 4, "<origin>: xyz = '0.1 0.2' is not 3 finite numbers"),
        (
            '<sdf version="1.9"><model name="m"><link name="arm">\n<inertial>\n<mass>2 kg</mass>'
            "</inertial></link></model></sdf>",
            3,
            "<mass>: '2 kg' is not a finite number",
        ),
        (
            '<mujoco><worldbody><body name="arm">\n<inertial pos="0 0" mass="1" diaginertia="1 1 1"/>'
            "</body></worldbody></mujoco>",
            2,
            "<inertial>: pos = '0 0' is not 3 finite numbers",
        ),
    ],
)
def test_first_line_says_which_number_cannot_be_read(text: str, line: int, said: str, tmp_path: Path) -> None:
    """It has one line number, that of the element, and what is wrong with it."""
    path = tmp_path / "robot.urdf"
    path.write_text(text.format(name="arm", mass="2", inertia=_GOOD, more=""))
    found = audit(path, AuditOptions([]))
    assert _sentences(found)[0].text == f"robot.urdf: 1 error: arm, line {line}: {said}"
    assert [(one.file, one.line) for one in found.findings] == [(str(path), line)]


def test_a_number_of_an_included_file_that_cannot_be_read_is_found_there(tmp_path: Path) -> None:
    """The finding is in that file, in the line of the element."""
    (tmp_path / "part.xml").write_text('<mujoco>\n<geom size="x"/></mujoco>')
    path = tmp_path / "robot.xml"
    path.write_text(
        '<mujoco><worldbody><body name="arm"><include file="part.xml"/></body></worldbody></mujoco>'
    )
    (found,) = lint(read_model(path))
    assert (found.rule, found.file, found.line) == ("unreadable", str(tmp_path / "part.xml"), 2)


def test_an_importer_is_not_said_to_hold_numbers_that_cannot_be_read() -> None:
    """A mass like 3,4 is not compared, so nothing is stated of how an importer holds it."""
    column = ImporterColumn("dart", "6", "default", "", "ok")
    read, unread = (LinkImport(state, _HELD, _HELD) for state in ("agrees", "not computed"))
    links = [
        LinkAudit("arm", 2, _HELD, "", "", {column.name: read}),
        LinkAudit("hand", 9, None, "mass", "", {column.name: unread}),
    ]
    finding = LintFinding("unreadable", "error", "certain", "robot.urdf", 9, "hand", "mass")
    found = Audit("robot.urdf", "urdf", "", [column], links, [finding])
    assert _sentences(found)[1].text == "DART holds the other links as written."


def test_what_an_importer_always_does_is_said_once() -> None:
    """A tensor that is discarded for every link is a sentence and one row; another cause has rows."""
    discarded = LinkImport(
        "differs", _HELD, _HELD, Difference(0.0, 0.0, 1.0), (f"{DISCARDED}: a placeholder in its place",)
    )
    other = replace(discarded, causes=("off-diagonals dropped",))
    column = ImporterColumn("pybullet", "3", "default", "", "ok")
    agrees = LinkImport("agrees", _HELD, _HELD, Difference(0.0, 0.0, 0.0))
    for some, said, rows in (
        ([discarded] * 3, "discards every tensor", 1),
        ([discarded, discarded, agrees], "discards tensors, which changes 2 of 3 links", 1),
        ([discarded, agrees, agrees], "changes 1 of 3 links (tensor discarded)", 1),
        ([other] * 3, "changes 3 of 3 links (off-diagonals dropped)", 3),
        (
            [other, other, discarded],
            "changes 3 of 3 links (off-diagonals dropped: 2; tensor discarded: 1)",
            3,
        ),
    ):
        links = [LinkAudit(str(k), 2, _HELD, "", "", {column.name: one}) for k, one in enumerate(some)]
        found = Audit("robot.urdf", "urdf", "", [column], links, [])
        document = audit_document(found)
        head, sentence = _sentences(found)
        assert head.text.endswith("file (3 links); 1 of 1 import changes it: pybullet:default.")
        assert head.tint == "open"
        assert sentence.text == f"PyBullet {said}."
        tables = [part for part in document.parts if isinstance(part, Table) and "Diff" in part.title]
        assert [len(table.rows) for table in tables] == [rows]
        assert failures(found, ["difference"])


@pytest.mark.parametrize(
    ("first", "said", "tint"),
    [
        ("agrees", "holds it as written, but merges the base into the world", "good"),
        ("rounded", "holds it to single precision, but fixes the base to the world", "good"),
        ("merged", "merges every link into the world", "open"),
    ],
)
def test_a_fixed_base_changes_nothing_that_moves(first: State, said: str, tint: str) -> None:
    """An import with a fixed base, merged or not, holds the file, unless no link is left that moves."""
    column = ImporterColumn("mujoco", "4", "default", "", "ok")
    agrees = LinkImport("agrees", _HELD, _HELD, Difference(0.0, 0.0, 0.0))
    merged = LinkImport("merged", into="the world", fixed=True)
    base = replace(agrees, state=first, fixed=True) if first == "rounded" else merged
    arm = merged if first == "merged" else agrees
    links = [
        LinkAudit(name, 2, _HELD, "", "", {"mujoco:default": one}) for name, one in (("b", base), ("a", arm))
    ]
    head, sentence = _sentences(Audit("robot.urdf", "urdf", "", [column], links, []))
    assert (head.tint, sentence.text) == (tint, f"MuJoCo {said}.")
    assert head.text.endswith(
        "every import holds it." if tint == "good" else "1 of 1 import changes it: mujoco:default."
    )


def test_a_discarded_tensor_says_how_far_the_link_turns_off() -> None:
    """The largest error of a free spin with the held numbers, if one deviates."""
    column = ImporterColumn("pybullet", "3", "default", "", "ok")
    one = LinkImport("differs", _HELD, _HELD, Difference(0.0, 0.0, 0.5), ("tensor discarded",))
    for errors, said in (((0.5, 1.2), "so that a free spin is up to 1.2 rad off after 1 s"), ((1e-6,), "")):
        links = [
            LinkAudit(
                str(error), 2, _HELD, "", "", {column.name: one}, {column.name: Spin(1e-6, error, None)}
            )
            for error in errors
        ]
        (_, text) = _sentences(Audit("robot.urdf", "urdf", "", [column], links, []))
        assert text.text == f"PyBullet discards every tensor{', ' if said else ''}{said}."
    wrong = LintFinding("triangle-inequality", "error", "certain", "robot.urdf", 3, "2", "I1 + I2 < I3")
    links = [LinkAudit("2", 2, _HELD, "", "", {column.name: one}), *links]  # which is not spun
    links[1].spins[column.name] = Spin(1e-6, 0.5, None)
    (_, text) = _sentences(Audit("robot.urdf", "urdf", "", [column], links, [wrong]))
    assert "so that a free spin of a possible link is up to 0.5 rad off after 1 s" in text.text


def test_the_accuracy_of_principal_axes_is_no_change() -> None:
    """Of a nearly symmetric tensor, MuJoCo finds them to 3e-9, where its own error is 1e-13."""
    assert not Spin(1.2e-13, 1.2e-13, 3.5e-9).deviates
    assert Spin(1.2e-13, 1.2e-13, 2e-7).deviates


def test_a_body_that_only_turns_otherwise_is_not_called_changed() -> None:
    """Its numbers are those of the file; the damping of the importer is beside them."""
    column = ImporterColumn("pybullet", "3", "default", "", "ok")
    discarded = LinkImport("differs", _HELD, _HELD, Difference(0.0, 0.0, 0.5), ("tensor discarded",))
    agrees = LinkImport("agrees", _HELD, _HELD, Difference(0.0, 0.0, 0.0))
    links = [
        LinkAudit(str(k), 2, _HELD, "", "", {column.name: one}, {column.name: Spin(1e-6, 1e-6, alone_rad)})
        for k, (one, alone_rad) in enumerate([(discarded, None), (discarded, None), (agrees, 0.5)])
    ]
    (_, text) = _sentences(Audit("robot.urdf", "urdf", "", [column], links, []))
    assert text.text == (
        "PyBullet discards tensors, which changes 2 of 3 links, and turns 1 link otherwise, as by damping."
    )
    for some, said in (
        ([0, 2, 2], "changes 1 of 3 links (tensor discarded), and turns 2 links otherwise"),
        ([2, 2], "turns 2 of 2 links otherwise"),
    ):
        (_, text) = _sentences(Audit("robot.urdf", "urdf", "", [column], [links[k] for k in some], []))
        assert text.text == f"PyBullet {said}, as by damping."


@pytest.mark.parametrize(
    ("state", "held_rad", "alone_rad", "said"),
    [
        ("agrees", 1e-6, 1e-6, ""),
        ("agrees", 0.5, 0.5, "the numbers agree, but the motion deviates"),
        ("agrees", 1e-6, 0.5, "turns otherwise where it is imported alone, as by damping"),
        ("rounded", 1e-6, 0.5, "turns otherwise where it is imported alone, as by damping"),
        ("rounded", 1e-6, None, ""),
    ],
)
def test_a_motion_that_deviates_says_with_what(
    state: Any, held_rad: float, alone_rad: float | None, said: str
) -> None:
    """With the numbers that the importer holds, or only in a file of its own, as by damping."""
    held = LinkImport(state, _HELD, _HELD, Difference(0.0, 0.0, 0.0))
    spins = {"pybullet:default": Spin(1e-6, held_rad, alone_rad)}
    link = LinkAudit("arm", 2, _HELD, "", "", {"pybullet:default": held}, spins)
    found = Audit("robot.urdf", "urdf", "", [], [link], []).differing()
    assert [why for _, _, why in found] == [said] * bool(said)


def test_importers_that_are_not_compared_share_a_row() -> None:
    """The reason is said once, beside the names of all."""
    matrices = {name: MatrixComparison(None, cause="no tree") for name in ("a", "b")}
    document = audit_document(Audit("robot.urdf", "urdf", "", [], [], [], matrices=matrices))
    ((row,),) = [part.rows for part in document.parts if isinstance(part, Table) and "Mass" in part.title]
    assert row == ("a and b", "", "", "not compared: no tree")


_HELD = Body(2.0, np.zeros(3), np.diag([1.0, 2.0, 2.5]))


def test_page_marks_bad_links_and_links_issues() -> None:
    """An impossible tensor that is held as written is not green, and its row header is marked."""
    held = LinkImport("agrees", _HELD, _HELD, Difference(0.0, 0.0, 0.0), ("as in a/b#12 & c",))
    column = ImporterColumn("dart", "6", "default", "", "ok")
    links = [LinkAudit("arm", 2, _HELD, "", "", {column.name: held})]
    finding = LintFinding(
        "triangle-inequality", "error", "certain", "robot.urdf", 2, "arm", "impossible tensor"
    )
    found = Audit("robot.urdf", "urdf", "", [column], links, [finding])
    assert _sentences(found)[1].text == "DART holds the impossible numbers as written."
    page = audit_page(found)
    assert '<th scope="row" class="tint-bad">arm<br><small>line 2<br>error: triangle-inequality' in page
    assert (
        '<td class="tint-open" data-heading="dart:default"><strong>agrees, but no body has these numbers'
        in page
    )
    assert 'as in <a href="https://github.com/a/b/issues/12">a/b#12</a> &amp; c' in page


def test_sarif_names_files_relative_to_the_folder_of_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readers of SARIF join them to the root of a repository, in which they are percent-encoded."""
    folder = tmp_path / "my robots"
    folder.mkdir()
    path = _file(folder, inertia=_IMPOSSIBLE)
    monkeypatch.chdir(tmp_path)
    log = json.loads(sarif(alerts_of(audit(path, AuditOptions([])), differences=False)))
    (result,) = log["runs"][0]["results"]
    place = result["locations"][0]["physicalLocation"]["artifactLocation"]
    assert place == {"uri": "my%20robots/robot.urdf"}


_SLIPPED = (
    "<?xml version='1.0'?>\n<!-- <link name='a'> -->\n<robot name='r'>\n\t<link name = 'a'  ><inertial>"
    "<mass value='10'/><inertia ixx='{}' iyy='{}' izz='{}' ixy='0'\tixz='0' iyz=\"0\"/></inertial>{}</link>"
    "\n<link name='b'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1e3' ixy='0' ixz='0' iyz='0'/>"
    "</inertial></link><joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint></robot>\n"
)
_PLATE = '<collision><geometry><box size="0.6 0.4 0.2"/></geometry></collision>'


def test_fix_writes_certain_numbers_and_nothing_else(tmp_path: Path) -> None:
    """Every other byte stays: comments, quotes, blanks, and the error that has no certain correction."""
    path, out = tmp_path / "robot.urdf", tmp_path / "fixed.urdf"
    path.write_text(_SLIPPED.format(0.166666667, 0.333333333, 0.333333333, _PLATE))
    done = run_bodycheck(tmp_path, "audit", path.name, "--lint", "--fix", out.name, "--quiet")
    assert done.returncode == 1
    assert "fixed.urdf: the corrected numbers of a." in done.stdout
    expected = _SLIPPED.format(0.166666667, 0.333333333, 0.433333333, _PLATE)
    for name in ("ixx", "iyy", "izz"):
        value = expected.partition(f"{name}='")[2].partition("'")[0]
        expected = expected.replace(f"{name}='{value}'", f'{name}="{value}"', 1)
    for name in ("ixy='0'", "ixz='0'", 'iyz="0"'):
        expected = expected.replace(name, f'{name[:3]}="0.0"', 1)
    assert out.read_text() == expected


def test_fix_without_certain_numbers_writes_no_file(tmp_path: Path) -> None:
    """A sentence says so; other formats are refused."""
    path, out = tmp_path / "robot.urdf", tmp_path / "fixed.urdf"
    path.write_text(_SLIPPED.format(0.1, 0.2, 0.25, ""))
    done = run_bodycheck(tmp_path, "audit", path.name, "--lint", "--fix", out.name, "--quiet")
    assert "Nothing written to fixed.urdf" in done.stdout
    path.write_text("<mujoco><worldbody/></mujoco>")
    assert run_bodycheck(tmp_path, "audit", path.name, "--lint", "--fix", out.name).returncode == 2
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("form", ["urdf", "sdf"])
def test_missing_meshes_do_not_stop_the_comparison(form: str, tmp_path: Path) -> None:
    """The recommended imports leave their shapes out, and hold what the file states."""
    mesh = '<collision><geometry><mesh filename="package://none/a.stl"/></geometry></collision>'
    path = _file(tmp_path, more=mesh)
    if form == "sdf":
        text = sdf_of(path.read_text()).replace(
            "</link>",
            "<collision name='c'><geometry><mesh><uri>"
            "model://none/a.stl</uri></mesh></geometry></collision></link>",
        )
        path = tmp_path / "model.sdf"
        path.write_text(text)
    found = audit(path, AuditOptions(["pybullet", "dart"], spins=False))
    outcomes = {column.name: column.outcome for column in found.columns}
    assert outcomes["pybullet:recommended"] == outcomes["dart:recommended"] == "ok"
    assert outcomes["pybullet:default"] == "failed"
    if form == "urdf":
        assert {found.links[0].held[f"{one}:recommended"].state for one in ("pybullet", "dart")} <= {
            "agrees",
            "rounded",
        }


@pytest.mark.slow
@pytest.mark.parametrize("quiet", ["", "<default><geom contype='0' conaffinity='0'/></default>"])
def test_box_around_a_turned_capsule_is_named(quiet: str, tmp_path: Path) -> None:
    """PyBullet takes the box around the capsule's own box, and ignores default classes."""
    path = tmp_path / "capsule.xml"
    path.write_text(
        f"<mujoco>{quiet}<worldbody><body name='leg'><freejoint/>"
        "<geom type='capsule' size='0.05 0.2' quat='0.939 0 0.344 0' pos='0.1 0 -0.1'/>"
        "</body></worldbody></mujoco>"
    )
    held = audit(path, AuditOptions(["pybullet"], spins=False)).links[0].held["pybullet:default"]
    assert "tensor discarded: recomputed from a box around the collision shapes" in " ".join(held.causes)


def _mjcf(folder: Path, body: str, compiler: str = "") -> Path:
    path = folder / "model.xml"
    path.write_text(
        f"<mujoco><compiler {compiler}/><worldbody><body name='leg'><freejoint/>{body}</body></worldbody>"
        "</mujoco>"
    )
    return path


@pytest.mark.slow
@pytest.mark.nightly(after=2)
@pytest.mark.parametrize(
    ("body", "cause"),
    [
        (
            "<geom type='capsule' size='0.08' fromto='0 0 0 0.2 0.2 0' density='5'/>",
            "mass recomputed: the volume of the shapes at 1000 kg/m^3",
        ),
        (
            "<geom type='capsule' size='0.08' fromto='0 0 0 0.2 0.2 0'/>",
            "recomputed from a box around the collision shapes with margins of 0.04 m",
        ),
        (
            "<geom type='cylinder' size='0.2 0.1' density='5'/>",
            "tensor scaled with the mass",
        ),
        (
            "<inertial pos='0 0 0' mass='10' diaginertia='1 1 1'/><geom type='sphere' size='0.05'/>",
            "mass of <inertial>, which the file overrules by its geoms",
        ),
    ],
)
def test_masses_and_boxes_of_bullet_are_named(body: str, cause: str, tmp_path: Path) -> None:
    """PyBullet ignores density and inertiafromgeom, and widens capsules that are given by their ends."""
    path = _mjcf(tmp_path, body, "inertiafromgeom='true'")
    held = audit(path, AuditOptions(["pybullet"], spins=False)).links[0].held["pybullet:default"]
    assert cause in "; ".join(held.causes)


@pytest.mark.slow
def test_tensor_of_the_shape_in_place_of_the_file_is_named(tmp_path: Path) -> None:
    """PyBullet's importer of MJCF discards the tensor of <inertial>."""
    inertial = "<inertial pos='0 0 0' mass='2' diaginertia='1 1 1'/><geom type='sphere' size='0.1'/>"
    held = audit(_mjcf(tmp_path, inertial), AuditOptions(["pybullet"], spins=False)).links[0].held
    assert held["pybullet:default"].causes == ("tensor discarded: recomputed from the only shape",)


@pytest.mark.slow
def test_sdformat_is_audited_where_an_engine_reads_it(tmp_path: Path) -> None:
    """DART ignores the rotation of the inertial frame, PyBullet discards the tensor, MuJoCo reads none."""
    path = tmp_path / "model.sdf"
    path.write_text(sdf_of(_file(tmp_path, more="").read_text()))
    found = audit(path, AuditOptions(["mujoco", "pybullet", "dart"]))
    assert [column.outcome for column in found.columns] == ["unsupported", "ok", "ok", "ok", "ok"]
    (link,) = found.links
    (cause,) = link.held["dart:default"].causes
    assert cause == "rotation of the inertial frame ignored, 73.86 degrees off"
    assert link.held["pybullet:default"].causes[0].startswith("tensor discarded: a placeholder in its place")
    spin = link.spins["dart:default"]
    assert spin.held_rad == pytest.approx(spin.excerpt_rad, rel=1e-6)
    assert spin.control_rad is not None
    assert spin.held_rad is not None
    assert spin.held_rad > 100.0 * spin.control_rad


@pytest.mark.slow
def test_mass_of_a_link_without_its_merged_links_is_named(tmp_path: Path) -> None:
    """DART drops nameless bodies that are fixed to another, and their masses."""
    fixed = "<body pos='0 0 0.3'><geom type='box' size='0.1 0.1 0.1'/></body>"
    path = _mjcf(tmp_path, f"<geom type='box' size='0.2 0.1 0.1'/>{fixed}")
    held = audit(path, AuditOptions(["dart"], spins=False)).links[0].held["dart:default"]
    assert "mass of this link alone: that of the links merged into it is lost" in held.causes
    assert "replaced by the identity" in held.causes


@pytest.mark.slow
@pytest.mark.parametrize("inertia", [_GOOD, 'ixx="1" iyy="1" izz="0" ixy="0" ixz="0" iyz="0"'])
def test_inertia_scaling_is_named(inertia: str, tmp_path: Path) -> None:
    """Bullet multiplies the tensor by an element of its own, which no other importer reads."""
    more = f'<contact><inertia_scaling value="3.0"/></contact>{_BOX}'
    found = audit(_file(tmp_path, inertia, more=more), AuditOptions(["pybullet"], spins=False)).links[0]
    assert found.held["pybullet:recommended"].causes == ("tensor times 3: <inertia_scaling> of the file",)


@pytest.mark.slow
@pytest.mark.parametrize("size", ["1e-320", "1e155", "1.7e308"])
def test_extreme_numbers_are_audited_without_a_fault(size: str, tmp_path: Path) -> None:
    """What an importer makes of them is compared; a body whose motion leaves the range is not spun."""
    inertia = f'ixx="{size}" iyy="{size}" izz="{size}" ixy="0" ixz="0" iyz="0"'
    found = audit(_file(tmp_path, inertia, mass=size, more=""), AuditOptions(["pybullet"]))
    assert [one.rule for one in found.findings] == ["number-range"]
    assert {column.outcome for column in found.columns} == {"ok"}


def _sentences(found: Audit) -> list[Sentence]:
    return [part for part in audit_document(found).parts if isinstance(part, Sentence)]


@pytest.mark.slow
def test_file_that_no_importer_reads_counts_against_it(tmp_path: Path) -> None:
    """No difference was found because nothing was compared, which the first sentence states."""
    more = '<collision><geometry><box size="1 2"/></geometry></collision>'
    found = audit(_file(tmp_path, more=more), AuditOptions(["mujoco"]))
    head, mujoco, *_ = _sentences(found)
    assert (head.tint, mujoco.tint) == ("open", "bad")
    assert head.text.endswith("; 2 of 2 imports refuse it: mujoco:default and mujoco:recommended.")
    assert mujoco.text.startswith("MuJoCo refuses it (")
    assert failures(found, ["difference"])
    assert not failures(found, ["error"])


def _audit_of(state: State, outcome: str = "ok", spin: Spin | None = None) -> Audit:
    """Return the audit of one link in an importer that has it in this state, next to one that agrees."""
    columns = [
        ImporterColumn(engine, "1", "default", "", ended) for engine, ended in (("a", "ok"), ("b", outcome))
    ]
    held = {"a:default": LinkImport("agrees"), "b:default": LinkImport(state, causes=("a cause",))}
    link = LinkAudit("arm", 2, None, "", "", held, {} if spin is None else {"b:default": spin})
    return Audit("robot.urdf", "urdf", "", columns, [link], [])


@pytest.mark.parametrize(
    ("found", "counts"),
    [
        (_audit_of("agrees"), False),
        (_audit_of("rounded"), False),
        (_audit_of("merged"), False),
        (_audit_of("differs"), True),
        (_audit_of("absent"), True),
        (_audit_of("agrees", outcome="timeout"), True),
        (_audit_of("agrees", outcome="unsupported"), False),
        (_audit_of("agrees", spin=Spin(1e-6, 1e-6, 1e-6)), False),
        (_audit_of("agrees", spin=Spin(1e-6, 1e-6, 0.5)), True),
        (_audit_of("agrees", spin=Spin(1e-6, math.nan, None)), True),
    ],
)
def test_headline_and_exit_status_count_the_same_differences(found: Audit, counts: bool) -> None:
    """Bodies that differ, are absent, or move differently with equal numbers, and imports that failed."""
    _, *importers = _sentences(found)
    assert ("bad" in [sentence.tint for sentence in importers]) == counts
    assert bool(failures(found, ["difference"])) == counts
    assert len(alerts_of(found, differences=True)) == len(found.differing())
    assert alerts_of(found, differences=False) == []


def test_links_that_could_not_be_spun_are_named() -> None:
    """Their motion was not compared."""
    found = _audit_of("agrees", spin=Spin(1e-6, 1e-6, None, "the excerpt: no"))
    texts = [part.text for part in audit_document(found).parts if isinstance(part, Sentence)]
    assert "Not spun: arm in b:default (the excerpt: no)." in texts


# ------------------------------------------------------------------------------------------------ shards


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Audit]:
    """Return a folder with a file, the shards `part-1` and `part-2` of its audit, and the whole audit."""
    folder = tmp_path_factory.mktemp("audits")
    path = folder / "robot.urdf"
    links = (_LINK.format(name=f"link_{k}", mass=2.0 + k, inertia=_GOOD, more="") for k in range(4))
    inner = "".join(link.replace('<robot name="r">', "").replace("</robot>", "") for link in links)
    origin = '<origin xyz="0 0 1"/>'
    joints = "".join(
        f'<joint name="j{k}" type="revolute">{origin}<parent link="link_{k}"/><child link="link_{k + 1}"/>'
        '<axis xyz="0 0 1"/><limit effort="1" velocity="1" lower="-1" upper="1"/></joint>'
        for k in range(3)
    )
    path.write_text(f'<robot name="r">{inner}{joints}</robot>')
    options = AuditOptions(["mujoco"])
    for k in (1, 2):
        shard = Shard(k, 2)
        write_shard(audit(path, replace(options, shard=shard)), shard, folder / f"part-{k}")
    return folder, audit(path, options)


@pytest.mark.slow
def test_merged_shards_equal_one_audit(shards: tuple[Path, Audit], tmp_path: Path) -> None:
    """All data are equal; each shard spins some of the links, and each link is spun by one shard."""
    folder, whole = shards
    found, findings = merge_audits([folder / "part-2", folder / "part-1"], tmp_path / "whole")
    assert json_text(audit_data(found)) == json_text(audit_data(whole))
    assert findings == []
    spun = [[bool(link.spins) for link in read_audit(folder / f"part-{k}")[0].links] for k in (1, 2)]
    assert [one != other for one, other in zip(*spun, strict=True)] == [True] * 4
    assert all(any(shard) for shard in spun)
    assert (tmp_path / "whole/audit.html").read_text() == audit_page(found)


def _damaged(folder: Path, tmp_path: Path, change: Callable[[dict[str, Any]], None]) -> list[Path]:
    parts = [Path(shutil.copytree(folder / f"part-{k}", tmp_path / f"part-{k}")) for k in (1, 2)]
    path = parts[1] / "audit.json"
    reported = json.loads(path.read_text())
    change(reported)
    path.write_text(json.dumps(reported))
    return parts


def test_merging_reports_importers_that_disagree(shards: tuple[Path, Audit], tmp_path: Path) -> None:
    """All shards import all links: other numbers are reported with importer, link, shards and digits."""

    def change(reported: dict[str, Any]) -> None:
        reported["machine"]["cpu"] = "another"
        reported["audit"]["links"][1]["held"]["mujoco:default"]["held"]["mass_kg"] *= 1.0 + 1e-6

    parts = _damaged(shards[0], tmp_path, change)
    machine, held = merge_audits(parts, tmp_path / "whole")[1]
    assert machine.endswith("another in shard 2/2")
    agreement = "shard 2/2 agrees to 6.0 digits, the least in mass_kg of link_1"
    assert held == f"mujoco:default: compared with shard 1/2, {agreement}"


def _another_file(reported: dict[str, Any]) -> None:
    reported["audit"]["sha256"] = "0"


def _same_shard(reported: dict[str, Any]) -> None:
    reported["shard"] = "1/2"


def _no_shard(reported: dict[str, Any]) -> None:
    del reported["shard"]


def _no_body(reported: dict[str, Any]) -> None:
    reported["audit"]["links"][0]["stated"]["centre_m"] = [1.0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (_another_file, "the SHA-256 of "),
        (_same_shard, "all are shard 1/2"),
        (_no_shard, "a whole audit"),
        (_no_body, "not a shard of an audit"),
    ],
)
def test_shards_of_different_audits_are_refused(
    change: Callable[[dict[str, Any]], None], named: str, shards: tuple[Path, Audit], tmp_path: Path
) -> None:
    """The message names the folder and the fault, and nothing is written."""
    parts = _damaged(shards[0], tmp_path, change)
    with pytest.raises(InputError) as refused:
        merge_audits(parts, tmp_path / "whole")
    assert named in str(refused.value)
    assert "part-2" in str(refused.value)
    assert not (tmp_path / "whole").exists()


@pytest.mark.slow
def test_audit_command_writes_shards_that_merge_puts_together(
    shards: tuple[Path, Audit], tmp_path: Path
) -> None:
    """A shard requires a folder; the answer of merge is that of the whole audit."""
    path = shards[0] / "robot.urdf"
    for k in (1, 2):
        words = ("--engine", "mujoco", "--shard", f"{k}/2", "--quiet")
        ended = run_bodycheck(tmp_path, "audit", str(path), *words, "--out", f"part-{k}")
        assert ended.returncode == 0, ended.stderr
    assert run_bodycheck(tmp_path, "audit", str(path), *words).returncode == 2
    ended = run_bodycheck(tmp_path, "merge", "part-1", "part-2", "--out", "whole", "--json")
    assert ended.returncode == 0, ended.stderr
    reported = json.loads(ended.stdout)
    assert reported.pop("machines") == []
    assert reported == json.loads(json_text(audit_data(shards[1])))


@pytest.mark.parametrize(
    ("words", "option"),
    [
        ((), "--spellings"),
        (("robot.urdf", "--spellings"), "--spellings"),
        (("robot.urdf", "--fail-on", "sometimes"), "--fail-on"),
        (("robot.urdf", "--lint", "--engine", "dart"), "--lint"),
        (("robot.urdf", "--shard", "1/2"), "--shard"),
        (("robot.urdf", "--lint", "--html", "no such folder/page.html"), "--html"),
        (("robot.urdf", "--lint", "--sarif", "."), "--sarif"),
    ],
)
def test_wrong_options_of_an_audit_are_one_line(words: tuple[str, ...], option: str, tmp_path: Path) -> None:
    """Options that contradict one another, and outputs that cannot be written, are refused first."""
    _file(tmp_path)
    ended = run_bodycheck(tmp_path, "audit", *words)
    assert ended.returncode == 2
    assert option in ended.stderr
    assert not ended.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["robot.urdf"]


def test_spelling_with_a_wrong_answer_is_not_spun(monkeypatch: pytest.MonkeyPatch) -> None:
    """An answer without a motion is the reason of one row, not the end of the command."""
    monkeypatch.setattr(spelling_run, "SPELLINGS", spelling_run.SPELLINGS[:1])
    monkeypatch.setattr(EnginePool, "ask", lambda *_: {"outcome": "ok"})
    found = [one for one in run_spellings(["mujoco"], 60.0) if one.format == "urdf"]
    assert [(one.error_rad, one.message) for one in found] == [(None, "'rotation'")] * len(found)
    assert found


@pytest.mark.slow
def test_spellings_move_alike_where_no_tensor_is_discarded(tmp_path: Path) -> None:
    """As URDF, PyBullet's default import breaks the law, its recommended import and DART's obey it."""
    done = run_bodycheck(tmp_path, "audit", "--spellings", "--engine", "pybullet,dart", "--quiet")
    assert done.returncode == 1
    found = [one for one in run_spellings(["pybullet", "dart"], 60.0) if one.format == "urdf"]
    assert len(found) > 20
    broken = [one for one in found if one.broken]
    assert {one.importer for one in broken} == {"pybullet:default"}
    assert all(DISCARDED in " ".join(one.causes) for one in broken)
    sound = [one for one in found if one.importer != "pybullet:default"]
    assert all(one.apart_rad is not None and one.apart_rad <= APART_RAD for one in sound)


@pytest.mark.slow
def test_release_in_which_an_audit_changed_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The audits of five releases, of which the first three hold another tensor, change once."""
    path = _file(tmp_path)
    sound = audit(path, AuditOptions(["mujoco"], spins=False))
    (link,) = sound.links
    wrong = LinkImport("differs", difference=Difference(0.0, 0.0, 0.27), causes=("off-diagonals dropped",))
    fault = replace(sound, links=(replace(link, held=dict.fromkeys(link.held, wrong)),))
    versions = ["3.11.0", "3.12.0", "3.13.0", "3.14.0", "4.0.0"]
    monkeypatch.setattr(audit_versions, "releases", lambda *_: versions)
    monkeypatch.setattr(
        audit_versions, "_audit_release", lambda name, *_: fault if name < "mujoco==3.14" else sound
    )
    requested: list[str] = []
    found = audit_versions.audit_versions(
        "mujoco", "3.11.0", None, path, every=False, timeout_s=60.0, announce=requested.append
    )
    assert found.measure == "audit"
    assert len(requested) < len(versions)
    for track in found.tracks:
        assert list(track.changes) == [("3.13.0", "3.14.0")]
        assert "off-diagonals dropped" in track.findings["3.13.0"].value
