"""The properties that URDF, SDFormat and MJCF files state, compared with formulas and other programs."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bodycheck._util.errors import InputError
from bodycheck.audit.lint import lint
from bodycheck.audit.spelling_run import SPELLINGS, name_of
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.exact_arithmetic import composite, doubles
from bodycheck.scenarios.model_files.model_file import ModelFile
from bodycheck.scenarios.model_files.rewriting import changed_text, excerpt
from bodycheck.scenarios.model_files.urdf import resolved
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.model_texts import composite_50_digits, mutated, random_mjcf, random_urdf, sdf_of


def _read(text: str, folder: Path) -> ModelFile:
    path = folder / "model.xml"
    path.write_text(text)
    return read_model(path)


@pytest.mark.parametrize("seed", range(5))
def test_composite_agrees_with_50_digits_by_another_formula(seed: int, tmp_path: Path) -> None:
    """Masses, centres and tensors of nested fixed links agree with sums of second moments in 50 digits."""
    model = _read(random_urdf(np.random.default_rng(seed), fixed=True), tmp_path)
    found = model.merged(model.links[0].name, frozenset(link.name for link in model.links[1:]))
    assert found is not None
    mass, centre, tensor = composite_50_digits(model.path)
    assert float(found.mass) == pytest.approx(mass, rel=1e-15)
    np.testing.assert_allclose(doubles(found.centre), centre, rtol=0, atol=1e-15 * np.max(np.abs(centre)))
    np.testing.assert_allclose(doubles(found.tensor), tensor, rtol=0, atol=1e-15 * np.max(np.abs(tensor)))


def test_inertial_frame_rotates_the_tensor(tmp_path: Path) -> None:
    """In link axes the tensor is R J R^T, with R from fixed-axis roll, pitch and yaw."""
    text = (
        '<robot name="r"><link name="a"><inertial><origin xyz="1 2 3" rpy="0.3 -0.8 2.1"/><mass value="2"/>'
        '<inertia ixx="1" iyy="2" izz="2.5" ixy="0.1" ixz="0" iyz="-0.2"/></inertial></link></robot>'
    )
    stated = _read(text, tmp_path).links[0].stated
    assert stated is not None
    R = Rotation.from_euler("xyz", [0.3, -0.8, 2.1]).as_matrix()
    J = np.array([[1.0, 0.1, 0.0], [0.1, 2.0, -0.2], [0.0, -0.2, 2.5]])
    np.testing.assert_allclose(doubles(stated.in_link.tensor), R @ J @ R.T, atol=1e-15)
    assert doubles(stated.in_link.centre).tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("seed", range(8))
def test_sdformat_states_what_a_urdf_states(seed: int, tmp_path: Path) -> None:
    """The bodies of all links have the same digits, and the poses of children in parents agree."""
    urdf = random_urdf(np.random.default_rng(seed))
    model, other = _read(urdf, tmp_path), _read(sdf_of(urdf), tmp_path)
    assert other.format == "sdf"
    assert [link.name for link in other.links] == [link.name for link in model.links]
    for link in model.links:
        twin = other.by_name[link.name]
        assert link.stated is not None
        assert twin.stated is not None
        a, b = link.stated.in_link, twin.stated.in_link
        assert (a.mass, a.centre.tolist(), a.tensor.tolist()) == (
            b.mass,
            b.centre.tolist(),
            b.tensor.tolist(),
        )
        assert twin.parent == link.parent
        if link.parent is not None:
            assert link.joint is not None
            assert twin.joint is not None
            assert (twin.joint.kind, twin.joint.damping) == (link.joint.kind, link.joint.damping)
            assert twin.joint.limits == link.joint.limits
            np.testing.assert_allclose(doubles(twin.pose.rotation), doubles(link.pose.rotation), atol=1e-14)
            np.testing.assert_allclose(doubles(twin.pose.position), doubles(link.pose.position), atol=1e-14)


def test_sdformat_has_its_defaults_and_names_models(tmp_path: Path) -> None:
    """Without <inertial> a link has 1 kg and 1 kg m^2; links of several models have their models' names."""
    link = "<link name='a'><pose degrees='true'>0 0 0 0 0 90</pose>{}</link>"
    box = "<collision name='c'><geometry><box><size>1 2 3</size></box></geometry></collision>"
    models = f"<model name='m'>{link.format('')}</model><model name='n'>{link.format(box)}</model>"
    model = _read(f"<sdf version='1.6'><world name='w'>{models}</world></sdf>", tmp_path)
    assert [link.name for link in model.links] == ["m::a", "n::a"]
    first, second = model.links
    assert first.stated is not None
    assert first.stated.derived == "by the defaults of SDFormat"
    assert (float(first.stated.inertia.mass), doubles(first.stated.inertia.tensor).tolist()) == (
        1.0,
        np.eye(3).tolist(),
    )
    np.testing.assert_allclose(doubles(first.pose.rotation)[:, 0], [0.0, 1.0, 0.0], atol=1e-15)
    assert [shape.size for shape in second.shapes] == [(1.0, 2.0, 3.0)]


@pytest.mark.parametrize(("degrees", "angle"), [("1", "90"), ("true", "90"), ("0", "1.5707963267948966")])
def test_sdformat_angles_are_in_degrees_where_stated(degrees: str, angle: str, tmp_path: Path) -> None:
    """The angles of a pose are in degrees where the attribute is true or 1, in rad where it is false or 0."""
    pose = f"<pose degrees='{degrees}'>0 0 0 0 0 {angle}</pose>"
    model = _read(f"<sdf><model name='m'><link name='a'>{pose}</link></model></sdf>", tmp_path)
    np.testing.assert_allclose(doubles(model.links[0].pose.rotation)[:, 0], [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("path", SPELLINGS, ids=name_of)
def test_spellings_state_one_body(path: Path) -> None:
    """Each spelling's links together form the same body, to the rounding of the numbers in the file."""
    model = read_model(path)
    root = model.links[0]
    parts = [root.stated.in_link] if root.stated else []
    parts += [link.stated.in_link.placed(pose) for link, pose in model.fixed_below(root.name) if link.stated]
    found = composite(parts)
    scale = 1000.0 if name_of(path) == "g and mm" else 1.0
    axes = Rotation.from_euler("xyz", (0.4, -0.7, 1.1)).as_matrix()
    tensor = scale**3 * axes @ np.diag([0.031, 0.052, 0.067]) @ axes.T
    np.testing.assert_allclose(float(found.mass), scale * 2.5, rtol=1e-15)
    np.testing.assert_allclose(doubles(found.centre), scale * np.array([0.08, -0.05, 0.12]), rtol=1e-14)
    np.testing.assert_allclose(doubles(found.tensor), tensor, rtol=0, atol=3e-15 * np.max(tensor))


def test_mjcf_classes_orientations_and_compiler_agree_with_mujoco(tmp_path: Path) -> None:
    """Bodies with inertials, geoms, defaults, frames and compiler settings equal those MuJoCo compiles."""
    for seed in range(12):
        _assert_as_compiled(_read(random_mjcf(np.random.default_rng(seed)), tmp_path))


_BOX = "<geom type='box' size='0.1 0.2 0.3' pos='0.3 0 0.1' euler='10 20 30'/>"
_CORNERS = "0 0 0  0.25 0 0  0 0.375 0  0 0 0.5"
_FACES = "0 2 1  0 1 3  0 3 2  1 2 3"
_TETRAHEDRON = f"vertex='{_CORNERS}' face='{_FACES}'"
_MESH = "<geom type='mesh' mesh='m' density='700' pos='0.1 0 0'/>"


@pytest.mark.parametrize(
    ("settings", "content"),
    [
        ("<compiler angle='radian' eulerseq='XYZ'/>", "<geom type='box' size='.1 .2 .3' euler='1 2 3'/>"),
        ("<compiler settotalmass='7'/>", f"{_BOX}<body name='c'><joint/>{_BOX}</body>"),
        ("<compiler boundmass='90'/>", _BOX),
        ("<compiler boundinertia='0.9'/>", _BOX),
        (
            "<compiler balanceinertia='true'/>",
            "<inertial pos='0 0 0' mass='1' diaginertia='5 1 1'/>",
        ),
        ("<compiler inertiafromgeom='true'/>", f"<inertial pos='0 0 0' mass='1' diaginertia='2 2 2'/>{_BOX}"),
        ("<compiler inertiagrouprange='1 2'/>", f"{_BOX}<geom group='2' size='0.2'/>"),
        ("", "<inertial pos='0 1 0' mass='2' fullinertia='2 3 4 0.1 0.2 0.3'/>"),
        ("", "<inertial pos='0 1 0' mass='2' diaginertia='2 3 4' zaxis='1 1 1'/>"),
        ("", "<geom type='capsule' size='0.1' fromto='0 0 0 0.1 0.2 0.3'/>"),
        ("", "<geom type='cylinder' size='0.1 0.3' xyaxes='1 1 0 0 0 1' shellinertia='true'/>"),
        ("", "<geom type='ellipsoid' size='0.1 0.2 0.3' axisangle='1 1 0 50'/>"),
        ("", "<geom type='box' size='0.1' fromto='0 0 0 0.1 0.2 0.3' mass='3'/>"),
        (
            "<default><geom density='5' size='1 2 3'/></default>",
            "<geom type='box' size='0.5' quat='1 1 0 0'/>",
        ),
        (
            "<default><default class='d'><geom type='box' size='1 2 3'/><default class='e'>"
            "<geom mass='4'/></default></default></default>",
            "<frame childclass='d'><geom pos='1 0 0'/><geom class='e'/></frame>",
        ),
        (
            "",
            "<replicate count='3' offset='0.3 0 0.1' euler='0 0 40' sep='-'><geom size='0.1'/>"
            f"<body name='r'><joint/>{_BOX}</body></replicate>",
        ),
        (f"<asset><mesh name='m' {_TETRAHEDRON} inertia='exact' scale='1 -2 3'/></asset>", _MESH),
        (f"<asset><mesh name='m' {_TETRAHEDRON} inertia='shell' refpos='1 2 3'/></asset>", _MESH),
        (f"<asset><mesh name='m' vertex='{_CORNERS}' refquat='1 1 0 0'/></asset>", _MESH),
    ],
)
def test_each_setting_of_mjcf_has_the_meaning_it_has_for_mujoco(
    settings: str, content: str, tmp_path: Path
) -> None:
    """A body and its one-link file have the mass, centre and tensor that MuJoCo compiles."""
    text = f"<mujoco>{settings}<worldbody><body name='b' pos='1 2 3' euler='5 6 7'><joint/>{content}</body>"
    model = _read(text + "</worldbody></mujoco>", tmp_path)
    whole = _assert_as_compiled(model)
    if "settotalmass" in settings:
        return
    for link in model.links:
        if "-" in link.name:  # only the whole file has copies
            continue
        alone = mujoco.MjModel.from_xml_string(excerpt(model, link.name))
        assert alone.nbody == 2
        assert alone.nv == 6
        np.testing.assert_allclose(
            _compiled_tensor(alone, 1),
            _compiled_tensor(whole, whole.body(link.name).id),
            rtol=1e-12,
            atol=1e-15,
        )


def test_link_alone_keeps_the_meshes_of_its_file(tmp_path: Path) -> None:
    """An excerpt finds the mesh file that it needs from any folder and needs no other file."""
    (tmp_path / "meshes").mkdir()
    lines = [f"v {' '.join(corner.split())}" for corner in _CORNERS.split("  ")]
    lines += ["f " + " ".join(str(int(k) + 1) for k in face.split()) for face in _FACES.split("  ")]
    (tmp_path / "meshes" / "m.obj").write_text("\n".join(lines))
    model = _read(
        "<mujoco><compiler meshdir='meshes'/><asset><mesh file='m.obj'/><mesh file='none.stl'/>"
        "<texture name='t' file='none.png' type='2d'/><material name='w' texture='t'/></asset><worldbody>"
        f"<body name='b'>{_MESH}<geom size='0.1' mass='0' material='w'/></body>"
        "<body><geom type='mesh' mesh='none'/></body></worldbody></mujoco>",
        tmp_path,
    )
    alone = mujoco.MjModel.from_xml_string(excerpt(model, "b"))
    stated = model.by_name["b"].stated
    assert stated is not None
    mass = 700.0 * 0.25 * 0.375 * 0.5 / 6.0
    assert alone.body_mass[1] == pytest.approx(mass, rel=1e-7)
    assert float(stated.inertia.mass) == pytest.approx(mass, rel=1e-12)


@pytest.mark.parametrize(
    ("settings", "name"), [("<compiler settotalmass='7'/>", "b"), ("", "body at line 1")]
)
def test_link_that_cannot_stand_alone_is_refused(
    settings: str, name: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A mass that depends on other bodies, or a body without a name, has no file of one link."""
    bodies = f"<body name='b'>{_BOX}</body><body>{_BOX}</body>"
    model = _read(f"<mujoco>{settings}<worldbody>{bodies}</worldbody></mujoco>", tmp_path)
    assert name in model.by_name
    with expected_message.raises(InputError):
        excerpt(model, name)


def _assert_as_compiled(model: ModelFile) -> mujoco.MjModel:
    """Compare the bodies with those that MuJoCo compiles, which stores the vertices of meshes as float32."""
    compiled = mujoco.MjModel.from_xml_path(str(model.path))
    for link in model.links:
        index = compiled.body(link.name).id
        assert link.stated is not None, link.unread
        rounding = 1e-13 if compiled.nmesh == 0 else 1e-7
        assert compiled.body_mass[index] == pytest.approx(float(link.stated.inertia.mass), rel=rounding)
        tensor = doubles(link.stated.in_link.tensor)
        np.testing.assert_allclose(
            _compiled_tensor(compiled, index), tensor, rtol=0, atol=10.0 * rounding * np.max(np.abs(tensor))
        )
        np.testing.assert_allclose(
            compiled.body_ipos[index], doubles(link.stated.in_link.centre), rtol=0, atol=rounding
        )
    return compiled


def _compiled_tensor(model: mujoco.MjModel, index: int) -> np.ndarray:
    """Return R diag(I) R^T in the axes of the body (3, 3)."""
    R = Rotation.from_quat(model.body_iquat[index], scalar_first=True).as_matrix()
    return np.asarray(R @ np.diag(model.body_inertia[index]) @ R.T)


@pytest.mark.parametrize(
    "name",
    [
        "meshes/a.stl",
        "package://arm/meshes/a.stl",
        "package:///arm/meshes/a.stl",
        "file://meshes/a.stl",
        "/meshes/a.stl",
    ],
)
def test_mesh_names_mean_files_of_the_package(name: str, tmp_path: Path) -> None:
    """A mesh is searched for next to the model, then in the nearest folder with the name of its package."""
    home = tmp_path / "arm"
    folder = home if "package" not in name else home / "urdf"
    assert resolved(name, folder / "robot.urdf") == home / "meshes" / "a.stl"


@pytest.mark.parametrize(
    ("compiler", "joint", "child", "computed"),
    [
        ("", "<freejoint/>", "", True),
        ("", "<freejoint align='true'/>", "", False),
        ("", "<freejoint align='true'/>", "<body/>", True),
        ("alignfree='true'", "<freejoint/>", "", False),
        ("alignfree='true'", "<freejoint align='false'/>", "", True),
        ("alignfree='true'", "<joint type='free'/>", "", True),
    ],
)
def test_link_whose_axes_the_compiler_chooses_is_not_compared(
    compiler: str, joint: str, child: str, computed: bool, tmp_path: Path
) -> None:
    """An aligned free joint makes the axes of a body without children principal, in an unspecified order."""
    geom = "<geom type='box' size='0.1 0.2 0.3' pos='1 0 0'/>"
    body = f"<body name='b'>{joint}{geom}{child}</body>"
    model = _read(f"<mujoco><compiler {compiler}/><worldbody>{body}</worldbody></mujoco>", tmp_path)
    assert (model.by_name["b"].unread == "") == computed


def test_nameless_bodies_are_named_by_their_places(tmp_path: Path) -> None:
    """Bodies without a name on one line, or on the same line of two files, are different bodies."""
    for name in ("a", "b"):
        (tmp_path / f"{name}.xml").write_text("<mujocoinclude><body/><body/></mujocoinclude>")
    model = _read(
        "<mujoco><worldbody><include file='a.xml'/><include file='b.xml'/><body/></worldbody></mujoco>",
        tmp_path,
    )
    assert [link.name for link in model.links] == [
        "body at a.xml:1",
        "body at a.xml:1 (2)",
        "body at b.xml:1",
        "body at b.xml:1 (2)",
        "body at line 1",
    ]


@pytest.mark.parametrize("inertia", ["convex", "exact", "legacy"])
def test_mesh_geom_is_placed_once(inertia: str, tmp_path: Path) -> None:
    """The mesh of a box rotated by 30 degrees and moved has R I R^T of the box, and is moved only once."""
    edges = np.array([0.2, 0.3, 0.5])
    corners = np.array(np.meshgrid(*([-0.5, 0.5],) * 3)).reshape(3, -1).T * edges
    hull = ConvexHull(corners)
    turned = np.where(np.einsum("ij,ij->i", _normals(corners, hull.simplices), hull.equations[:, :3]) < 0)[0]
    faces = hull.simplices.copy()
    faces[turned] = faces[turned][:, [0, 2, 1]]
    mesh = f"vertex='{_row(corners)}' face='{_row(faces)}' inertia='{inertia}'"
    link = _read(
        f"<mujoco><asset><mesh name='box' {mesh}/></asset><worldbody><body name='b'><frame pos='0 0 1'>"
        "<geom type='mesh' mesh='box' mass='2' pos='0.1 0 0' euler='0 0 30'/></frame></body></worldbody>"
        "</mujoco>",
        tmp_path,
    ).links[0]
    assert link.stated is not None
    R = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    expected = R @ np.diag(2.0 / 12.0 * (edges @ edges - edges**2)) @ R.T
    np.testing.assert_allclose(doubles(link.stated.in_link.tensor), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(doubles(link.stated.in_link.centre), [0.1, 0.0, 1.0], rtol=0, atol=1e-15)


def _normals(corners: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (corners[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _row(values: np.ndarray) -> str:
    return " ".join(str(value) for value in values.ravel().tolist())


@pytest.mark.parametrize(
    "text",
    [
        "<robot><link name='a'/><link name='a'/></robot>",
        "<robot><link/></robot>",
        "<world/>",
        '<gazebo version="1.0"><model name="a"/></gazebo>',
        "<robot",
        '<!DOCTYPE r [<!ENTITY a "aa">]><robot name="&a;"><link name="b"/></robot>',
        "<mujoco><worldbody><include file='none.xml'/></worldbody></mujoco>",
        "<sdf/>",
        "<robot><link name='a'/><xacro:wheel/></robot>",
        "<robot><link name='a'><inertial><mass value='${m}'/></inertial></link></robot>",
        "<sdf><model name='m'><link name='a'/><link name='a'/></model></sdf>",
    ],
)
def test_wrong_file_gives_one_line_that_names_the_place(
    text: str, expected_message: ExpectedMessage, tmp_path: Path
) -> None:
    """A file that cannot be read gives one line with the file, the line number and the error."""
    with expected_message.raises(InputError) as caught:
        _read(text, tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "<mujoco><worldbody><body><geom size='x'/></body><body name='b'>{}</body></worldbody></mujoco>",
        "<mujoco><worldbody><body><inertial mass='x'/></body><body name='b'>{}</body></worldbody></mujoco>",
        "<robot><link name='a'><inertial><mass value='x'/></inertial></link><link name='b'/></robot>",
    ],
)
def test_link_whose_numbers_cannot_be_read_does_not_refuse_the_file(text: str, tmp_path: Path) -> None:
    """It is a row with the place and the reason; the other links are read."""
    bad, good = _read(text.format(_BOX), tmp_path).links
    assert bad.malformed
    assert "model.xml:1" in bad.unread
    assert (good.name, good.unread) == ("b", "")


def test_prefix_that_nobody_declares_is_read(tmp_path: Path) -> None:
    """XML 1.0 has no namespaces: readers of URDF skip such an element, and its siblings are read."""
    text = "<robot><link name='a'><drake:joint/><collision><drake:p/><geometry><box size='1 2 3'/></geometry>"
    (link,) = _read(text + "</collision></link></robot>", tmp_path).links
    assert [shape.size for shape in link.shapes] == [(1.0, 2.0, 3.0)]


@pytest.mark.slow
def test_damaged_files_are_read_or_refused(tmp_path: Path) -> None:
    """Damaged files raise nothing but InputError with one line."""
    rng = random.Random(3)
    urdf = random_urdf(np.random.default_rng(1))
    texts = [urdf, sdf_of(urdf), random_mjcf(np.random.default_rng(1))]
    path = tmp_path / "model.xml"
    messages = []
    for _ in range(150):
        path.write_bytes(mutated(rng.choice(texts).encode(), rng))
        try:
            read_model(path)
        except InputError as error:
            messages.append(str(error))
    assert messages
    assert not [message for message in messages if "\n" in message]


def test_changed_tensor_keeps_what_is_no_number(tmp_path: Path) -> None:
    """An attribute of <inertia> that is not a number is kept unchanged and is not an error."""
    file = tmp_path / "model.urdf"
    file.write_text(
        "<robot name='r'><link name='a'><inertial><mass value='1'/>"
        "<inertia ixx='1' iyy='2' izz='2' ixy='0' note='of wood'><!-- none --></inertia>"
        "</inertial></link></robot>"
    )
    text = changed_text(read_model(file), "tensors changed")
    assert 'ixx="2.0" iyy="4.0" izz="4.0" ixy="0.0" note="of wood"' in text


def test_file_outside_of_the_folder_is_named(tmp_path: Path) -> None:
    """An included file outside the model's folder is reported."""
    (tmp_path / "other.xml").write_text(
        "<mujoco><worldbody><body name='b'><geom size='1'/></body></worldbody></mujoco>"
    )
    inner = tmp_path / "inner"
    inner.mkdir()
    model = _read("<mujoco><include file='../other.xml'/></mujoco>", inner)
    assert [path.name for path in model.outside()] == ["other.xml"]
    assert [link.name for link in model.links] == ["b"]


def _instructions(path: Path) -> int:
    """Return the number of instructions of Python for reading and checking a model file."""
    count = 0

    def counted(frame: FrameType, event: str, _argument: object) -> Callable[..., Any]:
        nonlocal count
        frame.f_trace_opcodes = True
        count += event == "opcode"
        return counted

    before = sys.gettrace()
    sys.settrace(counted)
    try:
        list(lint(read_model(path)))
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize("kind", ["empty", "chain"])
def test_the_work_grows_with_the_number_of_links_not_with_its_square(kind: str, tmp_path: Path) -> None:
    """Twice as many links, without joints or in one chain, take twice as many instructions."""
    joint = '<joint name="j{0}" type="fixed"><parent link="l{0}"/><child link="l{1}"/></joint>'
    found = []
    for size in (40, 40, 80, 160):  # the first reading also imports
        links = [f'<link name="l{number}"/>' for number in range(size)]
        joints = [joint.format(number, number + 1) for number in range(size - 1)] if kind == "chain" else []
        path = tmp_path / f"{size}.urdf"
        path.write_text(f'<robot name="r">{"".join([*links, *joints])}</robot>')
        found.append(_instructions(path))
    assert found[3] - found[2] < 2.5 * (found[2] - found[1])
