"""Two files of one robot are compared: what converters to USD lose is named, and nothing else."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bodycheck._util.errors import InputError
from bodycheck.audit.audit import SINGLE, Audit
from bodycheck.audit.audit_against import audit_against
from bodycheck.audit.audit_document import audit_document
from bodycheck.audit.audit_page import audit_page
from bodycheck.audit.audit_run import AuditOptions, audit
from bodycheck.cli.commands import app
from bodycheck.reports.document import Sentence, Table, markdown
from bodycheck.scenarios.model_files import read_model, usd
from bodycheck.scenarios.model_files.usd_stage import stage_facts
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.usd_stages import Link, Stage, tensor, urdf

ROOT = Path(__file__).parents[2]
needs_usd = pytest.mark.skipif(find_spec("pxr") is None, reason="needs the extra usd")

REPORTED = tensor((0.268209, 0.011284, 0.0635697, 0.359486, -0.00106685, 0.225659))
"""The tensor of newton-physics/urdf-usd-converter#119."""
LINKS = [
    Link("base", 2.0, (0.01, 0.02, 0.03), np.diag([0.1, 0.2, 0.25])),
    Link("arm", 1.5, (0.1, -0.05, 0.2), REPORTED, (0.5, 0.0, 0.1), "base"),
    Link(
        "tip",
        0.3,
        (0.0, 0.0, 0.05),
        tensor((1e-3, 1e-4, 2e-5, 1.2e-3, 0, 1.1e-3)),
        (0.9, 0, 0.1),
        "arm",
        "fixed",
    ),
]


@pytest.fixture
def own_process() -> None:
    """Read stages in a process of its own, as commands do."""


@pytest.fixture(autouse=True)
def one_process(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read stages in this process, where OpenUSD is imported once, in tests that do not need its own."""
    if "own_process" not in request.fixturenames and find_spec("pxr"):
        monkeypatch.setattr(usd, "asked", lambda path: stage_facts(str(path)))


def against(folder: Path, stage: Stage, links: list[Link] = LINKS) -> Audit:
    """Return the audit of a stage against the URDF of the same links."""
    (folder / "robot.urdf").write_text(urdf(LINKS))
    (folder / "robot.usda").write_text(stage.text(links))
    return audit_against(folder / "robot.usda", folder / "robot.urdf")


def causes(audit: Audit) -> dict[str, tuple[str, ...]]:
    """Return link -> causes of those that differ."""
    return {
        link.name: one.causes
        for link in audit.links
        for one in link.held.values()
        if one.state not in ("agrees", "rounded")
    }


HEALTHY = {
    "metres": Stage(),
    "centimetres, y up": Stage(metre=0.01, up="Y"),
    "grams and millimetres": Stage(metre=1e-3, kilogram=1e-3),
    "relabelled axes": Stage(axes="relabelled"),
}


@needs_usd
@pytest.mark.parametrize("case", HEALTHY)
def test_healthy_stage_agrees(case: str, tmp_path: Path) -> None:
    """Units, up axis and the order and signs of principal axes are free: all agree to single precision."""
    audit = against(tmp_path, HEALTHY[case])
    assert causes(audit) == {}
    assert [link.name for link in audit.links] == ["base", "arm", "tip"]
    assert all(
        one.difference and one.difference.largest < 1e-6 for link in audit.links for one in link.held.values()
    )


FAULTY: dict[str, tuple[Stage, str]] = {
    "axes lost": (Stage(axes="lost"), "principal axes lost"),
    "axes inverted": (Stage(axes="inverted"), "rotated by the inverse of the principal axes"),
    "diagonal only": (Stage(diagonal_only=True), "off-diagonals dropped"),
    "moments not converted": (
        Stage(metre=0.01, moments=1e-4),
        "tensor times 0.0001: kg m^2 taken as kg cm^2",
    ),
    "moments converted twice": (
        Stage(metre=0.01, moments=1e4),
        "tensor times 10000: kg cm^2 taken as kg m^2",
    ),
    "centres not converted": (Stage(metre=0.01, centres=1e-2), "centre of mass times 0.01: m taken as cm"),
    "masses in grams": (Stage(masses=1e3), "mass times 1000: g taken as kg"),
    "turned": (
        Stage(turned=np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])),
        "axes of the body exchanged: (x, -z, y) in place of (x, y, z) (one is up in place of the other)",
    ),
}


@needs_usd
@pytest.mark.parametrize("case", FAULTY)
def test_fault_of_a_converter_is_named(case: str, tmp_path: Path) -> None:
    """Each link that the fault changes has its cause as the first one."""
    stage, expected = FAULTY[case]
    found = causes(against(tmp_path, stage))
    assert "arm" in found
    assert all(one[0].startswith(expected) for one in found.values())


@needs_usd
def test_unit_hides_no_other_fault(tmp_path: Path) -> None:
    """Moments that were not converted and principal axes that were lost are both named."""
    found = causes(against(tmp_path, Stage(metre=0.01, moments=1e-4, axes="lost")))
    assert [cause.partition(":")[0] for cause in found["arm"]] == [
        "tensor times 0.0001",
        "principal axes lost",
    ]


@needs_usd
def test_axes_turned_by_their_inverse_are_named(tmp_path: Path) -> None:
    """The conjugate of the reported link's axes, with its converter's signs, is 94.6 degrees off."""
    arm = replace(LINKS[1])
    moments, axes = np.linalg.eigh(REPORTED)
    axes *= np.sign(axes[np.argmax(np.abs(axes), axis=0), range(3)])
    arm.principal = moments, axes * np.array([1.0, 1.0, np.linalg.det(axes)])
    (cause,) = causes(against(tmp_path, Stage(axes="inverted"), [LINKS[0], arm, LINKS[2]]))["arm"]
    assert cause.startswith("rotated by the inverse of the principal axes, ")
    assert cause.endswith("degrees off (newton-physics/urdf-usd-converter#118)")


@needs_usd
def test_stage_states_units_bodies_and_joints(tmp_path: Path) -> None:
    """Mass, centre and tensor in kg and m, to single precision; parents by joints; the axis that is up."""
    path = tmp_path / "robot.usda"
    path.write_text(Stage(metre=0.01, kilogram=0.5, up="Y").text(LINKS))
    model = read_model(path)
    assert model.settings == {"meters_per_unit": "0.01", "kilograms_per_unit": "0.5", "up_axis": "Y"}
    assert [(link.name, link.parent) for link in model.links] == [
        ("base", None),
        ("arm", "base"),
        ("tip", "arm"),
    ]
    for link, given in zip(model.links, LINKS, strict=True):
        assert link.stated is not None
        body = link.stated.in_link
        assert float(body.mass) == pytest.approx(given.mass, rel=1e-7)
        assert body.centre.astype(float) == pytest.approx(given.centre, rel=1e-6)
        size = np.abs(given.tensor).max()
        assert body.tensor.astype(float) == pytest.approx(given.tensor, abs=SINGLE * size)
    placed = [float(x) for x in model.by_name["tip"].pose.position]
    assert placed == pytest.approx([0.4, 0.0, 0.0], abs=1e-12)


@needs_usd
def test_what_a_stage_leaves_to_importers_is_not_compared(tmp_path: Path) -> None:
    """A body without a stated mass but with a collider has the importer's mass: not compared."""
    text = Stage().text(LINKS)
    start = text.index('def Xform "arm"')
    line = text.index("float physics:mass", start)
    text = text[:line] + text[text.index("\n", line) :]
    place = text.index("uniform token[] xformOpOrder", start)
    collider = 'def Cube "box" (prepend apiSchemas = ["PhysicsCollisionAPI"]) {\n double size = 0.2\n}\n'
    end = text.index("\n", place) + 1
    (tmp_path / "robot.usda").write_text(text[:end] + collider + text[end:])
    (tmp_path / "robot.urdf").write_text(urdf(LINKS))
    audit = audit_against(tmp_path / "robot.usda", tmp_path / "robot.urdf")
    found = causes(audit)
    assert found == {"arm": ("states no mass: importers compute it from its colliders",)}
    model = read_model(tmp_path / "robot.usda")
    assert [(shape.kind, shape.size) for shape in model.by_name["arm"].shapes] == [("box", (0.2, 0.2, 0.2))]


@needs_usd
def test_two_spellings_of_a_tensor_that_differ_are_noted(tmp_path: Path) -> None:
    """newton:inertia is in body axes; a note states how far it is from the principal form."""
    arm = replace(LINKS[1], extra="    double[] newton:inertia = [0.268209, 0.359486, 0.225659, 0, 0, 0]\n")
    (note,) = [note for note in against(tmp_path, Stage(), [LINKS[0], arm, LINKS[2]]).notes if "arm" in note]
    assert "newton:inertia differs by 0.18" in note


@needs_usd
def test_another_link_frame_is_no_difference(tmp_path: Path) -> None:
    """A body frame that a converter turned, with the body in it, states the same body."""
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # of the other frame in the link's
    arm = replace(LINKS[1], centre=tuple(R.T @ np.array(LINKS[1].centre)), tensor=R.T @ REPORTED @ R)
    text = Stage().text([LINKS[0], arm, LINKS[2]])
    start = text.index('def Xform "arm"')
    order = text.index("uniform token[] xformOpOrder", start)
    operations = '["xformOp:translate", "xformOp:rotateZ"]'
    turned = f"float xformOp:rotateZ = 90\n    uniform token[] xformOpOrder = {operations}"
    text = text[:order] + turned + text[text.index("\n", order) :]
    (tmp_path / "robot.usda").write_text(text)
    (tmp_path / "robot.urdf").write_text(urdf(LINKS))
    audit = audit_against(tmp_path / "robot.usda", tmp_path / "robot.urdf")
    (one,) = audit.links[1].held.values()
    assert one.state == "rounded"
    assert one.causes[0].startswith("the same body: only the link frame is another, turned by 90 degrees")


@needs_usd
def test_absent_link_counts_as_a_difference(tmp_path: Path) -> None:
    """A link that the stage lacks, and a part fixed to another whose mass is lost, are differences."""
    audit = against(tmp_path, Stage(), LINKS[:2])
    states = {link.name: one.state for link in audit.links for one in link.held.values()}
    assert states == {"base": "rounded", "arm": "differs", "tip": "merged"}


def test_converted_mjcf_agrees_with_its_urdf(tmp_path: Path) -> None:
    """MuJoCo's own conversion merges the fixed link, and the composite agrees."""
    import mujoco

    (tmp_path / "robot.urdf").write_text(urdf(LINKS))
    spec = mujoco.MjSpec.from_file(str(tmp_path / "robot.urdf"))
    spec.compile()
    (tmp_path / "robot.xml").write_text(spec.to_xml())
    audit = audit_against(tmp_path / "robot.xml", tmp_path / "robot.urdf")
    states = {link.name: one.state for link in audit.links for one in link.held.values()}
    assert states["arm"] in ("agrees", "rounded")
    assert states["tip"] == "merged"


@needs_usd
@pytest.mark.usefixtures("own_process")
def test_command_compares_and_fails_on_request(tmp_path: Path) -> None:
    """The JSON has the causes; the status is 1 with --fail-on difference."""
    against(tmp_path, Stage(axes="lost"))
    words = ["audit", str(tmp_path / "robot.usda"), "--against", str(tmp_path / "robot.urdf"), "--json"]
    done = CliRunner().invoke(app, words)
    data = json.loads(done.output)
    (arm,) = [link for link in data["links"] if link["name"] == "arm"]
    assert arm["held"]["robot.usda"]["causes"][0].startswith("principal axes lost")
    assert CliRunner().invoke(app, [*words, "--fail-on", "difference"]).exit_code == 1


@needs_usd
def test_answer_comes_first(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """First what is found in the stage, then how it compares; without another file, its bodies are listed."""
    compared = audit_document(against(tmp_path, Stage(axes="lost")))
    alone = audit_document(audit(tmp_path / "robot.usda", AuditOptions()))
    for document in (compared, alone):
        sentences = [part.text for part in document.parts if isinstance(part, Sentence)]
        expected_message("\n".join(sentences), tmp_path)
    (bodies,) = [part for part in alone.parts if isinstance(part, Table) and part.rows]
    assert [row[0] for row in bodies.rows] == ["base", "arm", "tip"]


@needs_usd
def test_comparison_of_two_files_names_no_importer(tmp_path: Path) -> None:
    """Neither the page nor the text calls a file an importer or an engine."""
    compared = against(tmp_path, Stage(axes="lost"))
    for text in (audit_page(compared), markdown(audit_document(compared))):
        assert "robot.usda" in text
        assert not re.search("importer(?!-)|in the engine", text, re.IGNORECASE)


BAD = {
    "no stage": "#usda 1.0\ndef Xform {",
    "no body": '#usda 1.0\ndef Xform "robot" {}\n',
    "no units": '#usda 1.0\n(\n  metersPerUnit = 0\n)\ndef Xform "robot" {}\n',
    "empty": "",
}


@pytest.mark.slow(after=1)
@needs_usd
@pytest.mark.usefixtures("own_process")
@pytest.mark.parametrize("case", BAD)
def test_bad_stage_is_refused_in_one_line(
    case: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A file that OpenUSD cannot read, or that has no bodies, is refused by name."""
    path = tmp_path / "bad.usda"
    path.write_text(BAD[case])
    with pytest.raises(InputError) as refused:
        read_model(path)
    assert "\n" not in str(refused.value)
    expected_message(str(refused.value), tmp_path)


def test_unrelated_files_are_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Files that share no name of a link are not compared."""
    (tmp_path / "one.urdf").write_text(urdf(LINKS[:1]))
    (tmp_path / "two.urdf").write_text(urdf([Link("body", 1.0, (0, 0, 0), np.eye(3))]))
    with expected_message.raises(InputError):
        audit_against(tmp_path / "one.urdf", tmp_path / "two.urdf")
