"""Inertias against the shapes of their links: bounds, slips that explain the numbers, healthy links."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.audit.audit import LintFinding
from bodycheck.audit.lint import lint
from bodycheck.scenarios.model_files import read_model
from tests.helpers.slipped_links import SLIPS, changes_enough, is_right, random_link


def _inertial(mass: float, moments: tuple[float, ...], xyz: str = "0 0 0", off: str = "0") -> str:
    xx, yy, zz = moments
    return (
        f'<inertial><origin xyz="{xyz}"/><mass value="{mass}"/><inertia ixx="{xx}" ixy="{off}" ixz="0" '
        f'iyy="{yy}" iyz="0" izz="{zz}"/></inertial>'
    )


def _shape(geometry: str, origin: str = "", tag: str = "collision") -> str:
    return f"<{tag}><origin {origin}/><geometry><{geometry}/></geometry></{tag}>"


def _lint(content: str, folder: Path, others: str = "") -> list[LintFinding]:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="part">{content}</link>{others}</robot>')
    return list(lint(read_model(path)))


_BOX = _shape('box size="0.6 0.4 0.2"')
_ROD = _shape('cylinder radius="0.05" length="0.508"', 'xyz="0 0 0.254"')
_BALL = _shape('sphere radius="9"')
_WELD = '<joint name="j" type="fixed"><parent link="part"/><child link="fin"/></joint>'
_TORSO = _inertial(0.57307, (1.415, 0.819, 0.819))


def test_z_for_y_is_named_with_the_right_moments(tmp_path: Path) -> None:
    """10 kg of 0.6 x 0.4 x 0.2 m: izz from x and z is 1/3 in place of 13/30."""
    (found,) = _lint(_inertial(10, (0.16666660000000003, 0.3333332, 0.3333332)) + _BOX, tmp_path)
    assert (found.rule, found.severity, found.confidence) == ("shape-slip", "warning", "certain")
    assert "izz from x and z" in found.message
    assert found.inertia_kg_m2 == pytest.approx((1 / 6, 0, 0, 1 / 3, 0, 13 / 30), rel=1e-8)
    assert 'izz="0.433333333"' in found.expected


def test_large_moment_on_the_wrong_axis_is_named(tmp_path: Path) -> None:
    """A wheel about y whose tensor is symmetric about z, 18 to 23 % off that of uniform density."""
    shape = _shape('cylinder radius="0.1651" length="0.1143"', 'rpy="1.5707963267948966 0 0"')
    (found,) = _lint(_inertial(2.637, (0.02467, 0.02467, 0.04411)) + shape, tmp_path)
    assert (found.rule, found.severity, found.confidence) == ("shape-slip", "warning", "likely")
    assert found.inertia_kg_m2 == pytest.approx((0.02467, 0, 0, 0.04411, 0, 0.02467), abs=1e-12)
    assert "(0.02084, 0.03594, 0.02084)" in found.message
    assert _lint(_inertial(2.637, (0.02467, 0.04411, 0.02467)) + shape, tmp_path) == []


@pytest.mark.parametrize(
    ("moments", "severity"),
    [
        ((0.111112, 0.222224, 0.333336), ""),
        ((0.111112, 0.222223, 0.333336), "note"),
        ((0.111112, 0.222223, 0.333340), "error"),
        ((0.111112000, 0.222223001, 0.333336002), "error"),
    ],
)
def test_a_plate_may_break_the_triangle_by_its_last_digits(
    moments: tuple[float, ...], severity: str, tmp_path: Path
) -> None:
    """I1 + I2 = I3 of a thin plate, off by 1 in the sixth digit, by more, or with digits that show it."""
    found = _lint(_inertial(1.0, moments), tmp_path)
    assert [one.severity for one in found if one.rule == "triangle-inequality"] == [severity] * bool(severity)


@pytest.mark.parametrize(
    ("moments", "rule"),
    [
        ((1, 1, 2.5), "triangle-inequality"),
        ((1, 1, -1), "not-positive"),
        ((0.1, 0.1, 0.1), "placeholder-inertia"),
        ((20, 21, 22), "beyond-shape"),
    ],
)
def test_a_bound_has_the_tensor_of_the_shapes_beside_it(
    moments: tuple[float, ...], rule: str, tmp_path: Path
) -> None:
    """10 kg of 0.6 x 0.4 x 0.2 m, in words and as data, which --fix does not write; none without shapes."""
    (found,) = _lint(_inertial(10, moments) + _BOX, tmp_path)
    assert (found.rule, found.inertia_kg_m2) == (rule, None)
    assert found.shapes_kg_m2 == pytest.approx((1 / 6, 0, 0, 1 / 3, 0, 13 / 30), rel=1e-8)
    assert 'ixx="0.166666667" ixy="0" ixz="0" iyy="0.333333333" iyz="0" izz="0.433333333"' in found.expected
    assert {one.shapes_kg_m2 for one in _lint(_inertial(10, moments), tmp_path)} <= {None}


def _in_frame(angles: Sequence[float], written: str) -> str:
    """Return 10 kg of 0.6 x 0.4 x 0.2 m, turned by (0.3, -0.4, 0.5), stated in a frame at these angles."""
    turned = Rotation.from_euler("xyz", [0.3, -0.4, 0.5]).as_matrix()
    frame = Rotation.from_euler("xyz", angles).as_matrix()
    tensor = frame.T @ turned @ np.diag([1 / 6, 1 / 3, 13 / 30]) @ turned.T @ frame
    names = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    inertia = " ".join(f'{name}="{tensor[place]:.9g}"' for name, place in names.items())
    origin = f'<origin rpy="{written}"/>' if written else ""
    return f'<inertial>{origin}<mass value="10"/><inertia {inertia}/></inertial>'


@pytest.mark.parametrize(
    ("written", "rules"),
    [
        ("0.7 0.2 -1.1", []),
        ("", ["shape-slip"]),
        ("40.107045659 11.459155903 -63.025357464", ["angles-in-degrees", "shape-slip"]),
    ],
    ids=["right", "left out", "in degrees"],
)
def test_a_wrong_rotation_of_the_inertial_frame_is_found(
    written: str, rules: list[str], tmp_path: Path
) -> None:
    """The moments are those of the shape, about other axes; expected are the numbers in the stated axes."""
    box = _shape('box size="0.6 0.4 0.2"', 'rpy="0.3 -0.4 0.5"')
    found = _lint(_in_frame([0.7, 0.2, -1.1], written) + box, tmp_path)
    assert [one.rule for one in found] == rules
    if rules:
        assert {one.severity for one in found} == {"warning"}
        assert "their axes are turned by" in found[-1].message
        assert found[-1].shapes_kg_m2 is not None


_ARM = _shape('box size="0.4 0.06 0.06"', 'xyz="0.2 0.01 0"')


@pytest.mark.parametrize(
    ("xyz", "said"),
    [
        ("0.15 0.012 0", ""),
        ("0.02 0.012 0", ""),
        ("0 0 0", "its centre of mass is at the origin of the link"),
        ("-0.15 0.012 0", "as one with the opposite sign of x could"),
    ],
)
def test_a_centre_that_no_mass_within_the_shapes_has_is_found(xyz: str, said: str, tmp_path: Path) -> None:
    """Whatever the tensor, Var(x) <= (c - min x)(max x - c), within what simple shapes leave open."""
    found = _lint(_inertial(2.0, (0.0011, 0.019, 0.0192), xyz) + _ARM, tmp_path)
    assert [one.rule for one in found if one.severity != "note"] == ["centre-of-mass"] * bool(said)
    assert said in "".join(one.message for one in found)


@pytest.mark.parametrize(("mass", "size"), [(6.0e3, 1.0), (6.0, 1000.0)])
def test_a_mass_that_no_material_has_is_found_whatever_the_tensor(
    mass: float, size: float, tmp_path: Path
) -> None:
    """In g, or with shapes in mm, where the tensor is neither that of the shapes nor a power of ten of it."""
    x, y, z = 0.1 * size, 0.06 * size, 0.04 * size
    moments = tuple(1e-2 * size**2 * mass / 6.0 * moment for moment in (0.03, 0.07, 0.09))
    found = _lint(_inertial(mass, moments) + _shape(f'box size="{x} {y} {z}"'), tmp_path)
    assert [one.rule for one in found if one.severity == "warning"] == ["unit-slip"]
    assert f"{mass:g} kg need" in found[0].message


@pytest.mark.parametrize(
    ("left", "right"), [("FL_hip", "FR_hip"), ("leg_lf", "leg_rf"), ("rear_left", "rear_right"), ("RL", "RR")]
)
@pytest.mark.parametrize(
    ("centre", "product", "said"),
    [
        (-0.1, -4e-3, ""),
        (-0.1, 4e-3, "its tensor does not"),
        (0.1, -4e-3, "its centre of mass is the same"),
    ],
)
def test_a_mirrored_leg_mirrors_its_centre_and_its_tensor(
    left: str, right: str, centre: float, product: float, said: str, tmp_path: Path
) -> None:
    """Whichever of the two was copied, and in whatever way the names have sides."""
    own = _inertial(1.0, (0.02, 0.03, 0.04), "0.05 0.1 0", "0.004")
    other = _inertial(1.0, (0.02, 0.03, 0.04), f"0.05 {centre} 0", str(product))
    path = tmp_path / "robot.urdf"
    joint = f'<joint name="j" type="continuous"><parent link="{left}"/><child link="{right}"/></joint>'
    path.write_text(
        f'<robot name="r"><link name="{left}">{own}</link><link name="{right}">{other}</link>{joint}</robot>'
    )
    found = [one for one in lint(read_model(path)) if one.rule == "mirrored-axes"]
    assert [said in one.message for one in found] == [True] * bool(said)


def test_box_around_partial_shapes_is_no_slip(tmp_path: Path) -> None:
    """Only the top of a table collides, and the tensor is that of the box around its top and its legs."""
    moments = tuple(53.5 / 12 * (a**2 + b**2) for a, b in ((0.762, 0.762), (0.7112, 0.762), (0.7112, 0.762)))
    top = _shape('box size="0.7112 0.762 0.057"', 'xyz="0 0 0.736"')
    leg = _shape('box size="0.05 0.05 0.762"', 'xyz="0.33 0.35 0.381"', tag="visual")
    table = _inertial(53.5, moments, "0 0 0.4")
    assert _lint(table + top + leg, tmp_path) == []
    (found,) = _lint(table + top, tmp_path)
    assert found.rule == "shape-slip"


@pytest.mark.parametrize("wrong", ["left", "right"])
def test_mirror_image_that_differs_from_its_shapes_is_accused(wrong: str, tmp_path: Path) -> None:
    """Of two legs that are no mirror images, the one whose tensor differs from that of its shapes."""
    legs = {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        ixy = 4e-4 * sign * (-1.0 if side == wrong else 1.0)
        foot = _shape('box size="0.6 0.2 0.2"', f'xyz="0.1 {0.2 * sign} 0" rpy="0 0 {-0.3 * sign}"')
        legs[side] = _inertial(1.0, (0.0068, 0.033, 0.033), f"0.1 {0.2 * sign} 0", str(ixy * 10)) + foot
    path = tmp_path / "robot.urdf"
    links = "".join(f'<link name="{side}">{content}</link>' for side, content in legs.items())
    path.write_text(f'<robot name="r">{links}</robot>')
    found = [one for one in lint(read_model(path)) if one.rule == "mirrored-axes"]
    assert [one.link for one in found] == [wrong]


def test_links_without_shapes_are_no_twins(tmp_path: Path) -> None:
    """A link that has no shape is not one of another shape; three shapes with the same numbers are noted."""
    same = _inertial(1.0, (0.2, 0.3, 0.4))
    shapes = [_shape(f'box size="1.5 1.2 {z}"') for z in (1.0, 1.1, 1.2)]
    for last, twins in (("", 0), (shapes[2], 3)):
        others = "".join(f'<link name="b{k}">{same}{one}</link>' for k, one in enumerate((shapes[1], last)))
        found = _lint(same + shapes[0], tmp_path, others)
        assert [one.rule for one in found].count("placeholder-inertia") == twins


def test_mesh_that_is_not_finite_hides_nothing(tmp_path: Path) -> None:
    """The size of a mesh with vertices that are no numbers is not known; an impossible tensor is reported."""
    (tmp_path / "part.obj").write_text("v nan nan nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (found,) = _lint(_inertial(0.1, (1, 1, 0)) + _shape('mesh filename="part.obj"'), tmp_path)
    assert (found.rule, found.severity) == ("not-positive", "error")


def test_parts_added_without_the_parallel_axis_are_named(tmp_path: Path) -> None:
    """Two cubes 0.6 m apart: 2 (m / 6 a^2 + m d^2 across the line between them)."""
    cubes = "".join(_shape('box size="0.1 0.1 0.1"', f'xyz="{x} 0 0"') for x in (0.3, -0.3))
    (found,) = _lint(_inertial(2, (1 / 300, 1 / 300, 1 / 300)) + cubes, tmp_path)
    assert (found.rule, found.severity) == ("shape-slip", "warning")
    assert "parallel axis" in found.message
    assert found.inertia_kg_m2 == pytest.approx((1 / 300, 0, 0, 0.55 / 3, 0, 0.55 / 3), rel=1e-8)


def test_moment_beyond_the_farthest_point_is_an_error(tmp_path: Path) -> None:
    """No mass within the shape exceeds m r^2 = 0.149; the largest moment that it allows is no finding."""
    (found,) = _lint(_TORSO + _ROD, tmp_path)
    assert (found.rule, found.severity, found.confidence) == ("beyond-shape", "error", "certain")
    assert "m r^2 is 0.149" in found.message
    most = 0.57307 * (0.508**2 + 0.05**2)
    for factor, rules in ((0.999, ["shape-ratio"]), (1.2, ["beyond-shape"])):
        largest = factor * most
        content = _inertial(0.57307, (largest, largest, 0.3 * largest)) + _ROD
        assert [one.rule for one in _lint(content, tmp_path)] == rules


@pytest.mark.parametrize(
    ("content", "others", "severities"),
    [
        (_TORSO + _ROD.replace("collision", "visual"), "", ["warning"]),
        (_TORSO.replace("0 0 0", "0 0 -1") + _ROD, "", ["warning"]),
        (
            _TORSO + _ROD,
            f'<link name="fin"/>{_WELD}',
            ["warning"],
        ),
        (
            _TORSO + _ROD,
            f'<link name="fin">{_BALL}</link>{_WELD}',
            [],
        ),
        (_TORSO + _ROD + _shape('mesh filename="none.stl"', tag="visual"), "", []),
        (_TORSO + _ROD + _shape("plane"), "", []),
        (_TORSO, "", []),
    ],
    ids=[
        "seen only",
        "centre outside",
        "with company",
        "mass of a welded link",
        "unreadable",
        "unsized",
        "none",
    ],
)
def test_shapes_that_may_be_partial_or_are_unknown_do_not_convict(
    content: str, others: str, severities: list[str], tmp_path: Path
) -> None:
    """Such shapes make the same numbers a warning, and a size that is not known makes no finding."""
    found = _lint(content, tmp_path, others)
    assert [one.severity for one in found if one.rule == "beyond-shape"] == severities
    assert not severities or all(one.confidence == "likely" for one in found)
    assert severities or all(one.severity == "note" for one in found)


def test_static_models_are_not_compared_with_their_shapes(tmp_path: Path) -> None:
    """What never moves has a tensor that nobody needs."""
    for static, rules in (("false", ["beyond-shape"]), ("true", [])):
        path = tmp_path / "world.sdf"
        path.write_text(
            f"<sdf><model name='m'><static>{static}</static><link name='a'>"
            "<inertial><mass>1</mass></inertial>"
            "<collision name='c'><geometry><sphere><radius>0.1</radius></sphere></geometry></collision>"
            "</link></model></sdf>"
        )
        found = [one.rule for one in lint(read_model(path))]
        assert [rule for rule in found if rule != "placeholder-inertia"] == rules


def _box_stl(folder: Path, edges: tuple[float, float, float]) -> None:
    corners = np.array(np.meshgrid(*([-0.5, 0.5],) * 3, indexing="ij")).reshape(3, -1).T * edges
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    lines = ["solid part"]
    for a, b, c, d in faces:
        for triangle in ((a, b, c), (a, c, d)):
            rows = [f"vertex {' '.join(map(repr, corners[k].tolist()))}" for k in triangle]
            lines += ["facet normal 0 0 0", "outer loop", *rows, "endloop", "endfacet"]
    (folder / "part.stl").write_text("\n".join([*lines, "endsolid"]))


@pytest.mark.parametrize("tag", ["visual", "collision"])
@pytest.mark.parametrize("geometry", ['mesh filename="part.stl"', 'box size="0.034 0.020 0.024"', ""])
def test_tensor_of_the_part_is_no_unit_slip(tag: str, geometry: str, tmp_path: Path) -> None:
    """A small part far from the next joint: a distance to a joint is no size of the part."""
    _box_stl(tmp_path, (0.034, 0.020, 0.024))
    content = _inertial(0.086, (6.99467e-06, 1.24127e-05, 1.11513e-05), "0 2.3e-5 0")
    joint = (
        '<joint name="j" type="fixed"><parent link="part"/><child link="next"/><origin xyz="0 0 1"/></joint>'
    )
    shape = _shape(geometry, tag=tag) if geometry else ""
    assert _lint(content + shape, tmp_path, f'<link name="next"/>{joint}') == []


@pytest.mark.parametrize(("factor", "rules"), [(1e-6, ["unit-slip"]), (1e-3, ["shape-slip"]), (1.0, [])])
def test_unit_slip_states_a_density_that_no_material_has(
    factor: float, rules: list[str], tmp_path: Path
) -> None:
    """10 kg in 48 l: 1e-6 of the tensor needs 2e-4 kg/m^3; 1e-3 needs 0.21 kg/m^3, which foam almost has."""
    moments = tuple(factor * 10.0 / 12.0 * np.array([0.2, 0.4, 0.52]))
    found = _lint(_inertial(10, moments) + _BOX, tmp_path)
    assert [one.rule for one in found] == rules
    assert all(("kg/m^3" in one.message) == (one.rule == "unit-slip") for one in found)


@pytest.mark.parametrize(
    ("mass", "factor", "size", "rule", "severity", "proposed"),
    [
        (10, 1.7, 1, "shape-ratio", "note", True),
        (7.3, 1 / 7.3, 1, "shape-slip", "warning", True),
        (1e4, 1e-3, 1, "unit-slip", "warning", False),
        (10, 1e-6, 1000, "unit-slip", "warning", False),
    ],
    ids=["of another mass", "mass missing", "mass in g", "shapes in mm"],
)
def test_factor_of_all_moments_is_of_the_tensor_only_if_mass_and_shapes_are_plausible(
    mass: float, factor: float, size: float, rule: str, severity: str, proposed: bool, tmp_path: Path
) -> None:
    """Where the mass or the shapes need a density that no material has, no tensor is proposed."""
    edges = np.array([0.6, 0.4, 0.2]) * size
    moments = tuple((factor * mass / 12.0 * (edges @ edges - edges**2)).tolist())
    box = _shape(f'box size="{edges[0]} {edges[1]} {edges[2]}"')
    (found,) = _lint(_inertial(mass, moments) + box, tmp_path)
    assert (found.rule, found.severity) == (rule, severity)
    assert (found.inertia_kg_m2 is not None) == proposed
    if proposed:
        right = (mass / 60, 0, 0, mass / 30, 0, 0.52 * mass / 12)
        assert found.inertia_kg_m2 == pytest.approx(right, rel=1e-8)


@pytest.mark.parametrize(
    ("mass", "found"),
    [
        (2.3e-4, [("unit-slip", "warning")]),
        (7e-4, [("unit-slip", "note")]),
        (9e-4, []),
        (3500, []),
        (3700, [("unit-slip", "note")]),
        (12100, [("unit-slip", "warning")]),
    ],
)
def test_mass_and_tensor_that_agree_at_the_density_of_no_material_are_found(
    mass: float, found: list[tuple[str, str]], tmp_path: Path
) -> None:
    """A box of 0.048 m^3, at 3 and 10 times less or more than 0.05 to 25,000 kg/m^3."""
    moments = (mass / 60, mass / 30, 0.52 * mass / 12)
    box = _shape('box size="0.6 0.4 0.2"')
    told = _lint(_inertial(mass, moments) + box, tmp_path)
    assert [(one.rule, one.severity) for one in told] == found


def test_forgotten_centre_of_mass_is_named(tmp_path: Path) -> None:
    """The tensor is that of the box about its middle, but the centre of mass is at the link's origin."""
    box = _shape('box size="0.6 0.4 0.2"', 'xyz="0.3 0 0"')
    moments = (10 / 60, 10 / 30, 13 / 30)
    (found,) = _lint(_inertial(10, moments) + box, tmp_path)
    assert (found.rule, found.severity, found.centre_m) == ("centre-of-mass", "warning", (0.3, 0.0, 0.0))
    assert _lint(_inertial(10, moments, "0.3 0 0") + box, tmp_path) == []


def test_placeholder_is_said_once(tmp_path: Path) -> None:
    """Beyond the shape it is that; a sphere whose moments round to a power of ten is none."""
    one = _inertial(1, (1, 1, 1)) + _BOX
    assert [found.rule for found in _lint(one, tmp_path)] == ["beyond-shape"]
    sphere = _inertial(3.623, (0.1, 0.1, 0.1)) + _shape('sphere radius="0.263"')
    assert _lint(sphere, tmp_path) == []


def test_other_tensors_are_a_note_with_the_ratio(tmp_path: Path) -> None:
    """Three times the moments of the box, without a slip that explains them."""
    (found,) = _lint(_inertial(10, (0.5 * 1.03, 0.9, 1.2)) + _BOX, tmp_path)
    assert (found.rule, found.severity, found.confidence) == ("shape-ratio", "note", "possible")


@pytest.mark.parametrize("slip", SLIPS)
def test_planted_slip_gives_the_right_numbers(slip: str, tmp_path: Path) -> None:
    """Five links with primitives, compounds and meshes, with 6 to 17 digits."""
    rng = np.random.default_rng(list(SLIPS).index(slip))
    make, shapes = SLIPS[slip]
    for _ in range(5):
        link = random_link(rng, tmp_path, str(rng.choice(shapes)))
        written = make(link, rng)
        found = _lint_link(link.text("part", written, bool(rng.integers(2))), tmp_path)
        if changes_enough(link, written):
            assert any(is_right(one.inertia_kg_m2, link) for one in found), found


def test_healthy_link_is_not_accused(tmp_path: Path) -> None:
    """Solids and compounds, of one density and of several by part, have no finding."""
    rng = np.random.default_rng(5)
    for k in range(60):
        kind = str(rng.choice(["box", "cylinder", "sphere", "capsule", "mesh", "several", "several"]))
        link = random_link(rng, tmp_path, kind, even=k % 2 == 0)
        assert _lint_link(link.text("part", link.written, visual=False), tmp_path) == []


def _lint_link(link: str, folder: Path) -> list[LintFinding]:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="r">{link}</robot>')
    return list(lint(read_model(path)))


@pytest.mark.parametrize(
    ("x_m", "severity"), [(1.0, None), (1.1, "note"), (7.6, "note"), (7.9, "warning"), (150.0, "warning")]
)
def test_a_centre_far_from_the_shapes_is_found(x_m: float, severity: str | None, tmp_path: Path) -> None:
    """The box ends at 0.3 m and has a diagonal of 0.748 m, which is a limit, as ten times as much is."""
    found = _lint(_inertial(10, (0.166, 0.333, 0.433), f"{x_m} 0 0") + _BOX, tmp_path)
    severities = [one.severity for one in found if one.rule == "centre-of-mass"]
    assert severities == ([] if severity is None else [severity])


def test_a_centre_is_not_far_from_shapes_of_unknown_size(tmp_path: Path) -> None:
    """A mesh that is not there may reach as far as the centre."""
    shapes = _shape('sphere radius="0.1"', tag="visual") + _shape('mesh filename="absent.stl"')
    found = _lint(_inertial(10, (0.04, 0.04, 0.04), "150 0 0") + shapes, tmp_path)
    assert "centre-of-mass" not in {one.rule for one in found}
