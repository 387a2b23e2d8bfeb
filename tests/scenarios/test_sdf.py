"""SDFormat as published models spell it: frames, nested models, includes, loops, comments and prefixes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink

_TENSOR = "<inertia><ixx>0.1</ixx><iyy>0.2</iyy><izz>0.25</izz></inertia>"
_INERTIAL = f"<inertial><mass>2</mass>{_TENSOR}</inertial>"


def _read(content: str, folder: Path, version: str = "1.7") -> ModelFile:
    path = folder / "model.sdf"
    path.write_text(f'<?xml version="1.0"?>\n<sdf version="{version}">{content}</sdf>\n')
    return read_model(path)


def _model(content: str, folder: Path) -> ModelFile:
    return _read(f"<model name='m'>{content}</model>", folder)


def _link(name: str, more: str = "", inertial: str = _INERTIAL) -> str:
    return f"<link name='{name}'>{more}{inertial}</link>"


def _joint(name: str, parent: str, child: str, kind: str = "fixed", more: str = "") -> str:
    ends = f"<parent>{parent}</parent><child>{child}</child>"
    return f"<joint name='{name}' type='{kind}'>{ends}{more}</joint>"


def _holds_its_body(link: ModelLink) -> bool:
    stated = link.stated
    return (
        stated is not None
        and float(stated.inertia.mass) == 2.0
        and doubles(stated.in_link.tensor).tolist() == np.diag([0.1, 0.2, 0.25]).tolist()
    )


@pytest.mark.parametrize(
    "content",
    [
        _link("a", "<pose relative_to='__model__'>0 0 0.1 0 0 0</pose>"),
        _link("a", "<pose frame=''>0 0 0.1 0 0 0</pose>"),
        _link("a", "<pose relative_to='f'/>") + "<frame name='f'><pose relative_to='g'/></frame>",
        _link("a", inertial=_INERTIAL.replace("<mass>", "<pose relative_to='a'/><mass>")),
        _link("a", "<sensor name='imu' type='custom' gz:type='my_imu'/><drake:proximity_properties/>"),
        "<xacro:arg name='color' default='grey'/>" + _link("a"),
        f"<!-- gz sim --verbose 4 --><![CDATA[<!-- --]]>{_link('a')}",
        _link("a") + _joint("j", "world", "a", "revolute", "<axis><limit><lower>-inf</lower></limit></axis>"),
        _link("a") + _joint("j", "world", "a", "of-the-future"),
        _link("a") + _joint("j", "a", "a"),
        _link("a") + "<joint name='j' type='fixed'/>",
        _link("a", "<collision name='c'><geometry><box><size>x</size></box></geometry></collision>"),
    ],
)
def test_what_enters_neither_mass_nor_tensor_does_not_refuse_a_link(content: str, tmp_path: Path) -> None:
    """Frames, loops, endless limits, unknown joints and shapes, prefixes and comments change no body."""
    (link,) = _model(content, tmp_path).links
    assert not link.unread
    assert _holds_its_body(link)


def test_comment_before_the_declaration_is_read(tmp_path: Path) -> None:
    """The lines keep their numbers."""
    path = tmp_path / "model.sdf"
    path.write_text(
        f"<!-- one\n-- two -->\n<?xml version='1.0'?>\n<sdf><model name='m'>\n{_link('a')}</model></sdf>"
    )
    (link,) = read_model(path).links
    assert (link.line, _holds_its_body(link)) == (5, True)


def test_poses_follow_the_frames_they_are_relative_to(tmp_path: Path) -> None:
    """The pose of a child in its parent is that of the frames, joints and nested models between them."""
    turned = Rotation.from_euler("xyz", [0.3, -0.8, 2.1])
    model = _model(
        _link("a", "<pose>1 2 3 0.3 -0.8 2.1</pose>")
        + "<frame name='f' attached_to='a'><pose degrees='true'>0 0 1 0 0 90</pose></frame>"
        + _link("b", "<pose relative_to='j'>0 1 0 0 0 0</pose>")
        + _link("c", "<pose relative_to='f'>1 0 0 0 0 0</pose>")
        + _joint("j", "a", "c", more="<pose relative_to='f'>2 0 0 0 0 0</pose>")
        + _joint("k", "f", "b")
        + "<model name='n' placement_frame='d'><pose relative_to='c'>0 0 5 0 0 0</pose>"
        + _link("d", "<pose>7 8 9 0 0 0</pose>")
        + "</model>"
        + _joint("l", "c", "n::d"),
        tmp_path,
    )
    assert {link.name: link.parent for link in model.links} == {"a": None, "b": "a", "c": "a", "n::d": "c"}
    positions = {name: doubles(link.pose.position) for name, link in model.by_name.items()}
    np.testing.assert_allclose(positions["a"], [1, 2, 3], atol=1e-15)
    np.testing.assert_allclose(positions["c"], [0, 1, 1], atol=1e-14)
    np.testing.assert_allclose(positions["b"], [-1, 2, 1], atol=1e-14)
    np.testing.assert_allclose(positions["n::d"], [0, 0, 5], atol=1e-14)
    np.testing.assert_allclose(doubles(model.links[0].pose.rotation), turned.as_matrix(), atol=1e-15)
    assert not model.notes


def test_quaternion_of_a_pose_has_its_scalar_last(tmp_path: Path) -> None:
    """rotation_format quat_xyzw: 1 kg m^2 about x becomes a moment about y by a quarter turn about z."""
    half = 0.5**0.5
    pose = f"<pose rotation_format='quat_xyzw'>0 0 0.1 0 0 {half} {half}</pose>"
    (link,) = _model(_link("a", inertial=_INERTIAL.replace("<mass>", pose + "<mass>")), tmp_path).links
    assert link.stated is not None
    np.testing.assert_allclose(np.diagonal(doubles(link.stated.in_link.tensor)), [0.2, 0.1, 0.25], atol=1e-15)
    assert doubles(link.stated.in_link.centre).tolist() == [0.0, 0.0, 0.1]


def test_includes_are_named_and_the_links_of_the_file_are_read(tmp_path: Path) -> None:
    """A joint to an included link is a note; a file or world of includes alone has no link of its own."""
    include = "<include merge='true'><uri>model://base</uri></include>"
    model = _model(include + _link("camera") + _joint("j", "base_link", "camera"), tmp_path)
    assert [link.name for link in model.links] == ["camera"]
    assert [word in " ".join(model.notes) for word in ("model://base", "base_link")] == [True, True]
    for content in (f"<model name='m'>{include}</model>", f"<world name='w'>{include}</world>"):
        alone = _read(content, tmp_path)
        assert alone.links == ()
        assert "model://base" in alone.notes[0]


def test_loop_of_joints_is_opened_and_named(tmp_path: Path) -> None:
    """The joint that closes the loop is left out of the tree, whether two parents or a circle make it."""
    links = "".join(map(_link, "abc"))
    for last in (_joint("bc", "b", "c"), _joint("ca", "c", "a")):
        model = _model(links + _joint("ab", "a", "b") + _joint("ac", "a", "c") + last, tmp_path)
        assert sum(link.parent is not None for link in model.links) <= 2
        assert "closes a loop" in model.notes[0]
        assert all(map(_holds_its_body, model.links))


def test_link_whose_numbers_cannot_be_read_is_a_row_with_its_reason(tmp_path: Path) -> None:
    """The other links are read; an inertial frame relative to another frame is not computed."""
    model = _model(
        _link("a", "<pose>1 2 x 0 0 0</pose>")
        + _link("b", inertial=_INERTIAL.replace("0.2", "nan"))
        + _link("c", inertial=_INERTIAL.replace("<mass>", "<pose relative_to='f'/><mass>"))
        + _link("d", "<pose degrees='yes'>0 0 0 0 0 0</pose>")
        + _link("e", "<pose rotation_format='xyz'>0 0 0 0 0 0</pose>")
        + _link("good"),
        tmp_path,
    )
    *bad, good = model.links
    assert all(link.unread and link.stated is None for link in bad)
    assert [link.malformed for link in bad] == [True, True, False, True, True]
    assert not good.unread
    assert _holds_its_body(good)


def test_automatic_inertia_is_that_of_the_collisions(tmp_path: Path) -> None:
    """Each collision has its density, else that of <inertial>, else 1000 kg/m^3; a mass scales the sum."""
    size = "<geometry><box><size>1 2 3</size></box></geometry>"
    box = f"<collision name='c'>{{}}<pose>0 0 1 0 0 0</pose>{size}</collision>"
    cases = [
        ("", "", 6000.0),
        ("", "<density>2</density>", 12.0),
        ("<density>3</density>", "<density>2</density>", 18.0),
        ("", "<mass>5</mass>", 5.0),
    ]
    for own, more, mass in cases:
        text = _link("a", box.format(own), f"<inertial auto='true'>{more}</inertial>")
        (link,) = _model(text, tmp_path).links
        assert link.stated is not None
        assert link.stated.derived
        body = link.stated.in_link
        assert float(body.mass) == pytest.approx(mass, rel=1e-15)
        np.testing.assert_allclose(doubles(body.centre), [0, 0, 1], atol=1e-15)
        np.testing.assert_allclose(
            np.diagonal(doubles(body.tensor)), mass / 12.0 * np.array([13.0, 10.0, 5.0]), rtol=1e-14
        )
    plane = "<collision name='c'><geometry><plane/></geometry></collision>"
    (link,) = _model(_link("a", plane, "<inertial auto='true'/>"), tmp_path).links
    assert link.unread
    assert not link.malformed
