"""Bodies from a mesh or a shape: mass properties, refusals and the entry in the manifest."""

from __future__ import annotations

import json
from fractions import Fraction
from hashlib import sha256
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.body import GivenBody, MeshBody
from bodycheck.scenarios.library import load_scenario, load_scenarios
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.serialization import deserialized, serialized
from bodycheck.scenarios.shapes import plausibility_warnings, primitive
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.scenario_parsing import parse_scenario

HEAD = 'name = "x"\nduration_s = 1.0\nsamples = 11\n[body]\n'

# An L-bracket of two boxes, its outline in the xy plane, 1/8 m thick: none of its axes is principal.
OUTLINE = [(0.0, 0.0), (2.0, 0.0), (2.0, 0.5), (0.5, 0.5), (0.5, 1.0), (0.0, 1.0)]
THICKNESS = 0.125


def bracket(*, inside_out: bool = False) -> str:
    """Return the bracket as OBJ, of hexagons and quadrilaterals."""
    sides = [[i + 1, (i + 1) % 6 + 1, (i + 1) % 6 + 7, i + 7] for i in range(6)]
    faces = [[6, 5, 4, 3, 2, 1], [7, 8, 9, 10, 11, 12], *sides]
    vertices = "".join(f"v {x} {y} {z}\n" for z in (0.0, THICKNESS) for x, y in OUTLINE)
    turn = -1 if inside_out else 1
    return vertices + "".join("f " + " ".join(map(str, face[::turn])) + "\n" for face in faces)


Box = tuple[tuple[Fraction, Fraction], ...]
"""The ends of a box along x, y, z."""


def of_boxes(boxes: list[Box], density: Fraction) -> tuple[float, Array, Array]:
    """Return mass, centre and inertia of boxes that touch, by integrals in rational numbers."""

    def integral(box: Box, powers: tuple[int, ...]) -> Fraction:
        ends = zip(box, powers, strict=True)
        x, y, z = ((b ** (n + 1) - a ** (n + 1)) / (n + 1) for (a, b), n in ends)
        return x * y * z

    def total(*axes: int) -> Fraction:
        powers = tuple(axes.count(axis) for axis in range(3))
        return density * sum((integral(box, powers) for box in boxes), Fraction(0))

    mass = total()
    centre = [total(i) / mass for i in range(3)]
    second = [[total(i, j) - mass * centre[i] * centre[j] for j in range(3)] for i in range(3)]
    trace = second[0][0] + second[1][1] + second[2][2]
    inertia = [[(i == j) * trace - second[i][j] for j in range(3)] for i in range(3)]
    return float(mass), np.array(centre, dtype=np.float64), np.array(inertia, dtype=np.float64)


def box(*ends: str) -> Box:
    """Return a box from 'begin end' along x, y, z."""
    return tuple((Fraction(a), Fraction(b)) for a, b in (pair.split() for pair in ends))


BRACKET = [box("0 2", "0 0.5", "0 0.125"), box("0 0.5", "0.5 1", "0 0.125")]
T_HANDLE = [box("-0.01 0.01", "0 0.05", "-0.01 0.01"), box("-0.05 0.05", "0.05 0.07", "-0.01 0.01")]


def refusals(body: str, folder: Path) -> list[str]:
    """Return the lines with which a body is refused, without the file's name."""
    with pytest.raises(InputError) as caught:
        parse_scenario(HEAD + body, "file.toml", folder)
    return [line.removeprefix("file.toml: ") for line in str(caught.value).splitlines()]


def written(folder: Path, mesh: str = "part.obj", text: str | None = None) -> Scenario:
    """Write a scenario and its mesh into a folder and read them."""
    path = folder / "mine.toml"
    path.write_text(f'{HEAD}mesh = "{mesh}"\ndensity_kg_m3 = 8.0\n')
    (folder / mesh).parent.mkdir(exist_ok=True)
    (folder / mesh).write_text(bracket() if text is None else text)
    return load_scenario(path)


def test_mesh_keeps_its_axes_and_uses_its_centre_of_mass(tmp_path: Path) -> None:
    """The bracket's mass and full tensor equal the rational integrals of its two boxes."""
    body = written(tmp_path).scene.body
    mass, _, inertia = of_boxes(BRACKET, Fraction(8))
    assert body.mass == pytest.approx(mass, rel=1e-15, abs=0.0)
    assert abs(inertia[0, 1]) > 0.05 * inertia[0, 0]
    assert np.max(np.abs(body.inertia - inertia)) < 1e-15 * np.max(inertia)


def test_t_handle_has_the_moments_of_its_two_boxes() -> None:
    """The handle has 0.162 kg and rational moments; the stem has the middle one, so it flips."""
    body = load_scenario("t-handle").scene.body
    mass, _, inertia = of_boxes(T_HANDLE, Fraction(2700))
    assert mass == 0.162
    assert np.diag(inertia).tolist() == [6.435e-05, 9.72e-05, 15.075e-05]
    assert body.mass == pytest.approx(mass, rel=4e-16, abs=0.0)
    assert np.max(np.abs(body.inertia - inertia)) < 1e-15 * np.max(inertia)


@pytest.mark.parametrize(
    ("shape", "size", "mass", "moments"),
    [
        ("box", "[1, 2, 3]", 6.0, (6.5, 5.0, 2.5)),
        ("sphere", "[2]", 32 / 3 * np.pi, (256 / 15 * np.pi,) * 3),
        ("ellipsoid", "[1, 2, 3]", 8 * np.pi, (20.8 * np.pi, 16 * np.pi, 8 * np.pi)),
        ("cylinder", "[1, 2]", 2 * np.pi, (7 / 6 * np.pi, 7 / 6 * np.pi, np.pi)),
        ("capsule", "[1, 2]", 10 / 3 * np.pi, (121 / 30 * np.pi, 121 / 30 * np.pi, 23 / 15 * np.pi)),
        ("torus", "[2, 1]", 4 * np.pi**2, (10.5 * np.pi**2, 10.5 * np.pi**2, 19 * np.pi**2)),
    ],
)
def test_sizes_have_the_documented_order(
    shape: str, size: str, mass: float, moments: tuple[float, ...]
) -> None:
    """Mass and moments at 1 kg/m^3 equal values computed by hand."""
    scene = parse_scenario(
        f'{HEAD}shape = "{shape}"\nsize_m = {size}\ndensity_kg_m3 = 1\n', "file.toml"
    ).scene
    assert scene.body.mass == pytest.approx(mass, rel=1e-15, abs=0.0)
    assert np.diag(scene.body.inertia) == pytest.approx(moments, rel=1e-15, abs=0.0)
    assert np.array_equal(scene.body.inertia, np.diag(np.diag(scene.body.inertia)))


def test_mesh_path_is_relative_to_the_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The path is relative to the scenario's file, in whatever directory the program was started."""
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert written(tmp_path, "meshes/part.obj").scene.body.mass == pytest.approx(
        5.0 / 32 * 8, rel=1e-15, abs=0.0
    )


@pytest.mark.parametrize("name", ["t-handle", "torus-spin-up"])
def test_same_scenario_given_twice_is_read_once(name: str) -> None:
    """A scenario requested twice counts once, also after its scene was built."""
    ((_, first),) = load_scenarios([name])
    assert first.scene.body.mass > 0.0
    ((_, again),) = load_scenarios([name, name])
    assert again == first


def test_manifest_entry_of_a_mesh_reproduces_the_body(tmp_path: Path) -> None:
    """The entry is JSON with the mesh's name, hash and surface, and its numbers give the same body."""
    scenario = written(tmp_path)
    dumped = json.loads(json.dumps(scenario.model_dump(mode="json", exclude_none=True)))["body"]
    data = (tmp_path / "part.obj").read_bytes()
    surface = dumped["mesh"].pop("surface")
    assert surface.count("\nf ") == 20  # two hexagons and six rectangles as triangles
    assert dumped["mesh"] == {"file": "part.obj", "sha256": sha256(data).hexdigest()}
    assert dumped["density_kg_m3"] == 8.0
    _, centre, _ = of_boxes(BRACKET, Fraction(8))
    assert dumped["centre_m"] == pytest.approx(centre.tolist(), rel=1e-15, abs=0.0)
    given = GivenBody.model_validate({key: dumped[key] for key in ("mass_kg", "inertia_kg_m2")})
    assert given.mass_kg == scenario.scene.body.mass
    assert np.array_equal(given.inertia_kg_m2, scenario.scene.body.inertia)


def test_manifest_entry_of_a_shape_has_its_numbers() -> None:
    """The entry has the shape's keys, its mass and its inertia."""
    dumped = load_scenario("torus-spin-up").model_dump(mode="json", exclude_none=True)["body"]
    assert (dumped["shape"], dumped["size_m"], dumped["density_kg_m3"]) == ("torus", [1.0, 0.2], 50.0)
    assert dumped["mass_kg"] == pytest.approx(50 * 2 * np.pi**2 * 0.04, rel=1e-15, abs=0.0)
    assert dumped["inertia_kg_m2"][2][2] == pytest.approx(dumped["mass_kg"] * 1.03, rel=1e-15, abs=0.0)


def test_corrected_mesh_has_a_note(tmp_path: Path) -> None:
    """An inside-out bracket gives the same body and a note; a correct one gives none."""
    turned, expected = written(tmp_path, text=bracket(inside_out=True)), written(tmp_path)
    assert turned.body.notes == ("the mesh was inside-out; all its triangles were reversed",)
    assert turned.model_dump(mode="json")["body"]["notes"] == list(turned.body.notes)
    assert expected.body.notes == ()
    assert np.allclose(turned.scene.body.inertia, expected.scene.body.inertia, rtol=1e-15)


DENSITY = "density_kg_m3 = 1000\n"
FAULTS = {
    "no such mesh": 'mesh = "no.obj"\n' + DENSITY,
    "no mesh by name": 'mesh = "part.step"\n' + DENSITY,
    "open mesh": 'mesh = "open.obj"\n' + DENSITY,
    "mesh that is no name": "mesh = 3\n" + DENSITY,
    "mesh and no density": 'mesh = "part.obj"\n',
    "mesh and sizes": 'mesh = "part.obj"\nsize_m = [1]\n' + DENSITY,
    "mesh and shape": 'mesh = "part.obj"\nshape = "box"\n' + DENSITY,
    "mesh and numbers": 'mesh = "part.obj"\nmass_kg = 1\ninertia_kg_m2 = [1, 1, 1]\n' + DENSITY,
    "numbers and density": "mass_kg = 1\ninertia_kg_m2 = [1, 1, 1]\n" + DENSITY,
    "density too small": 'mesh = "part.obj"\ndensity_kg_m3 = 0\n',
    "density too large": 'shape = "sphere"\nsize_m = [1e10]\ndensity_kg_m3 = 1e300\n',
    "density of nothing": 'mesh = "part.obj"\ndensity_kg_m3 = nan\n',
    "no such shape": 'shape = "cone"\nsize_m = [1]\n' + DENSITY,
    "shape that is no name": "shape = [1]\nsize_m = [1]\n" + DENSITY,
    "shape without sizes": 'shape = "box"\n' + DENSITY,
    "sizes without shape": "size_m = [1]\n" + DENSITY,
    "too few sizes": 'shape = "cylinder"\nsize_m = [1]\n' + DENSITY,
    "negative size": 'shape = "sphere"\nsize_m = [-1]\n' + DENSITY,
    "size that is no number": 'shape = "box"\nsize_m = [1, true, nan]\n' + DENSITY,
    "absurd size": 'shape = "cylinder"\nsize_m = [1e200, 1]\n' + DENSITY,
    "vanishing body": 'shape = "cylinder"\nsize_m = [1e-45, 1]\ndensity_kg_m3 = 1e-300\n',
    "tube that meets itself": 'shape = "torus"\nsize_m = [1, 2]\n' + DENSITY,
    "link frame": 'shape = "sphere"\nsize_m = [1]\nlink_quaternion = [0, 0, 0, 0]\n' + DENSITY,
    "nothing": "",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_body_is_refused_with_its_key(
    fault: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """Each error has one line with its path within the file, and there is no other line."""
    (tmp_path / "part.obj").write_text(bracket())
    (tmp_path / "open.obj").write_text(bracket().rsplit("f ", 1)[0])
    expected_message("\n".join(refusals(FAULTS[fault], tmp_path)), tmp_path)


def test_body_that_is_not_a_table_is_refused(expected_message: ExpectedMessage) -> None:
    """A number in place of [body] is refused in one line."""
    with pytest.raises(InputError) as caught:
        parse_scenario('name = "x"\nduration_s = 1.0\nsamples = 11\nbody = 3\n', "file.toml")
    expected_message(str(caught.value))


def test_errors_of_file_and_mesh_are_reported_together(tmp_path: Path) -> None:
    """Errors of the mesh, of other keys of the body and elsewhere are reported in one reading."""
    text = (HEAD + 'mesh = "no.stl"\ndensity_kg_m3 = -1\nmass_kg = 2\n').replace("1.0\nsam", "-1.0\nsam")
    with pytest.raises(InputError) as caught:
        parse_scenario(text, "file.toml", tmp_path)
    paths = [line.split(": ")[1] for line in str(caught.value).splitlines()]
    assert sorted(paths) == ["body.density_kg_m3", "body.mass_kg", "body.mesh", "duration_s"]


def test_file_of_another_format_is_refused_with_the_way_out(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """[body] names the key of an MJCF file, and where the numbers of an SDFormat file are printed."""
    (tmp_path / "robot.xml").write_text("<mujoco><worldbody/></mujoco>")
    (tmp_path / "robot.sdf").write_text('<sdf version="1.9"><model name="m"><link name="a"/></model></sdf>')
    for name in ("robot.xml", "robot.sdf"):
        with pytest.raises(InputError) as caught:
            parse_scenario(f'{HEAD}urdf = "{name}"\n', "file.toml", tmp_path)
        expected_message(str(caught.value), tmp_path)


@pytest.mark.parametrize("density", [1.0, 7.3, 2700.0])
def test_density_scales_the_body(density: float, tmp_path: Path) -> None:
    """Mass and inertia of mesh and shape are those of unit density times the density."""
    (tmp_path / "part.obj").write_text(bracket())
    for kind in ('mesh = "part.obj"', 'shape = "torus"\nsize_m = [1.0, 0.3]'):
        unit, dense = (
            parse_scenario(f"{HEAD}{kind}\ndensity_kg_m3 = {rho}\n", "file.toml", tmp_path).scene.body
            for rho in (1.0, density)
        )
        assert dense.mass == density * unit.mass
        assert np.allclose(dense.inertia, density * unit.inertia, rtol=1e-15)


def test_bracket_oracle_is_right() -> None:
    """The bracket has 5/32 m^3, and one of its boxes the moments m (b^2 + c^2) / 12."""
    assert of_boxes(BRACKET, Fraction(1))[0] == 5 / 32
    _, centre, inertia = of_boxes(BRACKET[:1], Fraction(12))
    assert centre.tolist() == [1.0, 0.25, 0.0625]
    edges = (2.0, 0.5, 0.125)
    for i, j in product(range(3), repeat=2):
        others = sum(edge**2 for axis, edge in enumerate(edges) if axis != i)
        assert inertia[i, j] == (0.125 * others if i == j else 0.0)


@pytest.mark.parametrize(("unit", "length"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("in", 0.0254)])
def test_mesh_is_scaled_by_its_unit(unit: str, length: float, tmp_path: Path) -> None:
    """Mass scales with the third, inertia with the fifth and the centre with the first power of the unit."""
    metres = written(tmp_path).body
    (tmp_path / "x.toml").write_text(f'{HEAD}mesh = "part.obj"\nmesh_unit = "{unit}"\ndensity_kg_m3 = 8.0\n')
    body = load_scenario(tmp_path / "x.toml").body
    assert body.mass_kg == pytest.approx(length**3 * metres.mass_kg, rel=1e-15, abs=0.0)
    assert np.array(body.inertia_kg_m2) == pytest.approx(
        length**5 * np.array(metres.inertia_kg_m2), rel=1e-15, abs=0.0
    )


@pytest.mark.parametrize("stated", ["", 'mesh_unit = "mm"\n', 'mesh_overlap = "count-twice"\n'])
def test_stored_mesh_body_is_read_without_its_mesh(stated: str, tmp_path: Path) -> None:
    """The manifest has unit and overlap if they were given, and the mesh file is not needed."""
    (tmp_path / "part.obj").write_text(bracket())
    (tmp_path / "x.toml").write_text(f'{HEAD}mesh = "part.obj"\n{stated}density_kg_m3 = 8.0\n')
    scenario = load_scenario(tmp_path / "x.toml")
    (tmp_path / "part.obj").unlink()
    facts = json.loads(json.dumps(serialized(scenario)))
    assert {key: facts["body"].get(key) for key in ("mesh_unit", "mesh_overlap")} == {
        "mesh_unit": "mm" if "unit" in stated else None,
        "mesh_overlap": "count-twice" if "overlap" in stated else None,
    }
    again = deserialized(facts, "manifest.json")
    assert isinstance(again.body, MeshBody)
    assert isinstance(scenario.body, MeshBody)
    assert again.body.mesh == scenario.body.mesh
    assert again.body.mass_kg == scenario.body.mass_kg


def test_implausible_mesh_has_a_warning() -> None:
    """100 mm read as m, 0.1 m read as mm, and a density in t/mm^3 each give a warning; a ship gives none."""
    large, small = (primitive("box", [size] * 3, 2700.0) for size in (100.0, 1e-4))
    assert plausibility_warnings(large, 2700.0, None) == (
        "warning: about 129 m across and 2.7e+09 kg; if the mesh is in mm, specify the unit (--unit mm, or "
        "mesh_unit in a scenario): 0.129 m and 2.7 kg",
    )
    assert plausibility_warnings(large, 2700.0, "m") == ()
    assert "is the mesh really in mm, not in m?" in plausibility_warnings(small, 2700.0, "mm")[0]
    assert plausibility_warnings(small, 2700.0, None) == ()
    assert plausibility_warnings(primitive("box", [0.1] * 3, 7.85e-9), 7.85e-9, None)[0].startswith(
        "warning: implausible den"
    )
