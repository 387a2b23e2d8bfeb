"""Small mesh files as other programs write them: the right answer, or a message that names the fault."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bodycheck._util.errors import InputError
from bodycheck.cli.commands import app
from bodycheck.scenarios.mass_properties.solid import MassProperties
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh
from bodycheck.scenarios.shapes import load_mesh
from tests.helpers.expected_messages import ExpectedMessage
from tests.scenarios.test_mesh_files import CUBE as CORNERS
from tests.scenarios.test_mesh_files import QUADS

INPUTS = Path(__file__).parent / "mesh_inputs"
NOT_READ = ("comma.stl", "cube.stl.gz", "truncated.stl")
CUBES = tuple(
    sorted(
        path.name
        for path in INPUTS.iterdir()
        if path.name not in (*NOT_READ, "cuboid.obj", "tet.off", "cube50.stl", "two_cubes_wall.stl")
        and not path.name.startswith("nonplanar")
    )
)


@pytest.mark.parametrize("name", CUBES)
def test_each_spelling_of_the_unit_cube_is_the_unit_cube(name: str) -> None:
    """1000 kg/m^3: 1000 kg, 166.67 kg m^2 about each axis, the centre at (0.5, 0.5, 0.5)."""
    found = load_mesh(INPUTS / name, 1000.0)
    assert found.mass == pytest.approx(1000.0, rel=1e-15, abs=0.0)
    assert found.inertia == pytest.approx(np.eye(3) * 1000.0 / 6.0, rel=1e-15, abs=1e-13)
    assert found.centre == pytest.approx([0.5, 0.5, 0.5], rel=1e-15, abs=0.0)


def test_two_cubes_with_a_wall_are_one_solid() -> None:
    """The wall between two cubes bounds nothing: 2000 kg, with a note."""
    found = load_mesh(INPUTS / "two_cubes_wall.stl", 1000.0)
    assert found.mass == pytest.approx(2000.0, rel=1e-15, abs=0.0)
    assert np.diagonal(found.inertia) == pytest.approx([1000.0 / 3.0, 2500.0 / 3.0, 2500.0 / 3.0], rel=1e-15)
    assert len(found.notes) == 1


@pytest.mark.parametrize("name", NOT_READ)
def test_message_names_what_is_wrong(name: str, expected_message: ExpectedMessage) -> None:
    """Decimal commas, a compressed file and a cut-off file are refused in one line."""
    with pytest.raises(InputError) as refused:
        load_mesh(INPUTS / name, 1000.0)
    expected_message(str(refused.value), INPUTS)


NOTED = (
    "utf16.obj",
    "cube_and_sheet.stl",
    "cube50.stl",
    "cuboid.obj",
    "nonplanar.obj",
    "nonplanar_rot.obj",
)


@pytest.mark.parametrize("name", NOTED)
def test_notes_state_what_was_done(name: str, expected_message: ExpectedMessage) -> None:
    """Repairs, the encoding and the effect of polygons that are not plane stand in the notes."""
    expected_message("\n".join(load_mesh(INPUTS / name, 1000.0).notes), INPUTS)


def test_note_bounds_the_difference_between_the_cuts_of_a_polygon() -> None:
    """The same faces, listed from their second corners, differ by what the note states."""
    masses = [load_mesh(INPUTS / name, 1000.0).mass for name in ("nonplanar.obj", "nonplanar_rot.obj")]
    assert masses == pytest.approx([7000.0 / 6.0, 6500.0 / 6.0], rel=1e-15)
    for name, mass in zip(("nonplanar.obj", "nonplanar_rot.obj"), masses, strict=True):
        (note,) = load_mesh(INPUTS / name, 1000.0).notes
        percent = float(note.split()[-2])
        assert percent == pytest.approx(100.0 * abs(masses[1] - masses[0]) / mass, rel=1e-2)


def test_plane_polygons_have_no_note(tmp_path: Path) -> None:
    """A rotated prism with concave ends, whose corners are rounded to doubles, counts as plane."""
    outline = np.array([(2, 1, 0), (1, 1, 0), (1, 2, 0), (0, 2, 0), (0, 0, 0), (2, 0, 0)], dtype=float)
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    K = np.cross(np.eye(3), axis)
    R = np.eye(3) + np.sin(0.7) * K + (1.0 - np.cos(0.7)) * K @ K
    points = np.concatenate([outline, outline + np.array([0.0, 0.0, 1.0])]) @ R + 10.0
    sides = [[i + 1, (i + 1) % 6 + 1, (i + 1) % 6 + 7, i + 7] for i in range(6)]
    faces = [[7, 8, 9, 10, 11, 12], [6, 5, 4, 3, 2, 1], *sides]
    path = tmp_path / "prism.obj"
    path.write_text(
        "".join("v {!r} {!r} {!r}\n".format(*point) for point in points.tolist())
        + "".join("f " + " ".join(map(str, face)) + "\n" for face in faces)
    )
    found = load_mesh(path, 1.0)
    assert found.notes == ()
    assert found.mass == pytest.approx(3.0, rel=1e-14)


# --------------------------------------------------------------------------------------- lengths of lists


def cube_faces(kind: str) -> tuple[list[list[float]], list[list[int]]]:
    """Return the unit cube of triangles, of quadrilaterals, of pentagons, or of all."""
    vertices, quads = CORNERS.tolist(), QUADS
    if kind == "4":
        return vertices, quads
    triangles = [[q[0], q[k], q[k + 1]] for q in quads for k in (1, 2)]
    if kind == "3":
        return vertices, triangles
    if kind == "mixed":
        return vertices, [*quads[:3], *triangles[6:]]
    faces: list[list[int]] = []
    numbers: dict[tuple[float, ...], int] = {tuple(v): i for i, v in enumerate(vertices)}

    def vertex(*points: int) -> int:
        place = tuple(np.mean([vertices[p] for p in points], axis=0).tolist())
        if place not in numbers:
            numbers[place] = len(vertices)
            vertices.append(list(place))
        return numbers[place]

    for a, b, c, d in quads:  # each face is cut into pentagons between the middles of two opposite edges
        ab, bc, cd, da = vertex(a, b), vertex(b, c), vertex(c, d), vertex(d, a)
        faces += [[ab, b, bc, c, cd], [cd, d, da, a, ab]]
    return vertices, faces


TYPES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I"}


@pytest.mark.slow(after=4)
@pytest.mark.nightly(after=8)
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["3", "4", "5", "mixed"])
@pytest.mark.parametrize("length", TYPES)
def test_binary_ply_of_any_length_type_and_corner_count_is_the_same_cube(
    length: str, kind: str, order: str, tmp_path: Path
) -> None:
    """1000 kg and 166.67 kg m^2, for each type of the numbers of corners, with each type of corners."""
    vertices, faces = cube_faces(kind)
    header = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    for corner, code in TYPES.items():
        text = (
            f"ply\nformat {header} 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
            f"property float z\nelement face {len(faces)}\nproperty list {length} {corner} vertex_indices\n"
            "end_header\n"
        )
        body = b"".join(struct.pack(order + "3f", *vertex) for vertex in vertices)
        for face in faces:
            body += struct.pack(f"{order}{TYPES[length]}{len(face)}{code}", len(face), *face)
        path = tmp_path / f"cube-{corner}.ply"
        path.write_bytes(text.encode() + body)
        found = load_mesh(path, 1000.0)
        assert found.notes == ()
        assert found.mass == pytest.approx(1000.0, rel=1e-15, abs=0.0)
        assert found.inertia == pytest.approx(np.eye(3) * 1000.0 / 6.0, rel=1e-15, abs=1e-13)


# --------------------------------------------------------------------------- encodings, line ends, the end

CUBE_OBJ = "".join("v {} {} {}\n".format(*corner) for corner in CORNERS) + "".join(
    "f " + " ".join(str(corner + 1) for corner in face) + "\n" for face in QUADS
)


def ascii_cube(kind: str) -> str:
    """Return the unit cube as text of a format."""
    rows = [" ".join(map(str, corner)) for corner in CORNERS]
    counted = [" ".join(map(str, [4, *face])) for face in QUADS]
    match kind:
        case "obj":
            return CUBE_OBJ
        case "off":
            return "\n".join(["OFF", "8 6 12", *rows, *counted, ""])
        case "ply":
            header = (
                "ply\nformat ascii 1.0\nelement vertex 8\nproperty double x\nproperty double y\n"
                "property double z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n"
            )
            return header + "\n".join([*rows, *counted, ""])
    text = "solid cube\n"
    for q in QUADS:
        for k in (1, 2):
            corners = "".join(f"vertex {rows[corner]}\n" for corner in (q[0], q[k], q[k + 1]))
            text += f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"
    return text + "endsolid cube\n"


ENCODINGS: dict[str, Callable[[str], bytes]] = {
    "byte order mark": lambda text: text.encode("utf-8-sig"),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "byte order mark and CR": lambda text: text.replace("\n", "\r").encode("utf-8-sig"),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16 big-endian": lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
    "UTF-16 without a mark": lambda text: text.encode("utf-16-le"),
    "UTF-16 with CRLF": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
}


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off"])
def test_text_of_any_encoding_and_line_end_is_read(kind: str, encoding: str, tmp_path: Path) -> None:
    """The unit cube; only UTF-16, which other readers refuse, is noted."""
    path = tmp_path / f"cube.{kind}"
    path.write_bytes(ENCODINGS[encoding](ascii_cube(kind)))
    found = load_mesh(path, 1000.0)
    assert found.mass == pytest.approx(1000.0, rel=1e-15, abs=0.0)
    assert len(found.notes) == ("UTF-16" in encoding)


def test_binary_ply_after_a_header_that_ends_with_cr_is_read(tmp_path: Path) -> None:
    """The first byte of the body may be that of LF, which is not part of the line end."""
    header = (
        "ply\rformat binary_little_endian 1.0\relement tag 1\rproperty uchar number\relement vertex 8\r"
        "property float x\rproperty float y\rproperty float z\relement face 6\r"
        "property list uchar uchar vertex_index\rend_header\r"
    )
    body = b"\n" + b"".join(struct.pack("<3f", *corner) for corner in CORNERS.tolist())
    body += b"".join(struct.pack("<5B", 4, *face) for face in QUADS)
    path = tmp_path / "cube.ply"
    path.write_bytes(header.encode() + body)
    found = load_mesh(path, 1000.0)
    assert (found.mass, found.notes) == (pytest.approx(1000.0, rel=1e-15), ())


TRAILING: dict[str, tuple[str, Callable[[], bytes]]] = {
    "text STL": ("stl", lambda: ascii_cube("stl").encode() + b"made by a program\n\x1a\n"),
    "OFF": ("off", lambda: ascii_cube("off").encode() + b"# a comment\n1 2 3\n"),
    "text PLY": ("ply", lambda: ascii_cube("ply").encode() + b"0\n"),
    "binary STL": ("stl", lambda: (INPUTS / "solid_header.stl").read_bytes() + b"\0" * 7),
    "binary PLY": ("ply", lambda: (INPUTS / "quad_uchar.ply").read_bytes() + b"\n"),
}


@pytest.mark.parametrize("case", TRAILING)
def test_what_follows_the_last_item_is_noted(
    case: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The cube is read, and a note states how much was ignored."""
    kind, content = TRAILING[case]
    path = tmp_path / f"cube.{kind}"
    path.write_bytes(content())
    found = load_mesh(path, 1000.0)
    assert found.mass == pytest.approx(1000.0, rel=1e-15)
    expected_message("\n".join(found.notes), tmp_path)


def test_triangle_strips_of_a_ply_are_read(tmp_path: Path) -> None:
    """Two strips, separated by -1 and joined by triangles without area, are a tetrahedron."""
    header = (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips 2\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    )
    path = tmp_path / "strips.ply"
    path.write_text(header + "7 0 2 1 3 -1 -1 0\n6 1 3 3 -1 0 2\n")
    with pytest.raises(InputError):
        load_mesh(path, 6.0)  # open: the last strip has no triangle
    path.write_text(header + "8 0 2 1 3 -1 0 1 3\n6 0 0 2 3 3 -1\n")
    found = load_mesh(path, 6.0)
    assert found.mass == pytest.approx(1.0, rel=1e-15)
    assert found.notes == ()


BAD_OFF = {
    "no counts": "OFF\n",
    "counts of words": "OFF\n4 four 6\n",
    "binary": "OFF BINARY\n4 4 6\n",
    "vertex of two": "OFF\n4 1 0\n0 0\n",
    "face of two": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2 0 1\n",
    "corner that is no vertex": "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n",
    "cut off": "OFF\n3 1 0\n0 0 0\n1 0 0\n",
    "another file": "# no mesh\nhello\n",
}


@pytest.mark.parametrize("case", BAD_OFF)
def test_malformed_off_is_refused_in_one_line(
    case: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """One line names the place and the fault."""
    path = tmp_path / "a.off"
    path.write_text(BAD_OFF[case])
    with pytest.raises(InputError) as refused:
        load_mesh(path, 1.0)
    expected_message(str(refused.value), tmp_path)


@pytest.mark.parametrize(
    "start", ["OFF\n8 6 12\n", "OFF 8 6 12\n", "8 6\n", "# made by hand\nCOFF\n\n8 6 12\n", "off\n8 6 0\n"]
)
def test_each_form_of_the_first_lines_of_off_is_read(start: str, tmp_path: Path) -> None:
    """The keyword and the number of edges are optional; colours follow the numbers."""
    path = tmp_path / "cube.off"
    path.write_text(
        ascii_cube("off").replace("OFF\n8 6 12\n", start).replace("4 0 2 3 1", "4 0 2 3 1 0.5 1 1")
    )
    assert load_mesh(path, 1000.0).mass == pytest.approx(1000.0, rel=1e-15)


def test_curved_surfaces_of_obj_are_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A message names the line and the keyword of a surface that is no polygon."""
    path = tmp_path / "a.obj"
    path.write_text(CUBE_OBJ + "cstype bspline\n")
    with expected_message.raises(InputError):
        load_mesh(path, 1.0)


# -------------------------------------------------------------------------------------------- known masses


def test_mesh_of_known_mass_has_that_mass() -> None:
    """A cuboid of 2 x 6 x 4 m and 4 kg: (17.333, 6.667, 13.333) kg m^2; the notes stand in the JSON."""
    done = CliRunner().invoke(app, ["body", str(INPUTS / "cuboid.obj"), "--mass-kg", "4", "--json"])
    assert done.exit_code == 0
    data = json.loads(done.output)
    assert data["body"]["mass_kg"] == 4.0
    assert np.diagonal(data["body"]["inertia_kg_m2"]) == pytest.approx([52 / 3, 20 / 3, 40 / 3], rel=1e-6)
    assert len(data["notes"]) == 1


def rational_moments(path: Path) -> tuple[Fraction, list[Fraction], list[list[Fraction]]]:
    """Return the integrals of 1, x and x x^T over the solid of a file in rational numbers."""
    with open_mesh(path) as file:
        vertices, triangles = parse_mesh(path, file)
    volume, first = Fraction(0), [Fraction(0)] * 3
    second = [[Fraction(0)] * 3 for _ in range(3)]
    for triangle in triangles:
        a, b, c = ([Fraction(float(x)) for x in vertices[i]] for i in triangle)
        D = sum(a[i] * (b[i - 2] * c[i - 1] - b[i - 1] * c[i - 2]) for i in range(3))
        s = [a[i] + b[i] + c[i] for i in range(3)]
        volume += D / 6
        for i in range(3):
            first[i] += D * s[i] / 24
            for j in range(3):
                second[i][j] += D * (a[i] * a[j] + b[i] * b[j] + c[i] * c[j] + s[i] * s[j]) / 120
    return volume, first, second


def rational_solid(path: Path, density: Fraction) -> tuple[float, list[float], np.ndarray]:
    """Return mass, centre and tensor about it, each rounded once."""
    volume, first, second = rational_moments(path)
    centre = [x / volume for x in first]
    central = [[second[i][j] - first[i] * first[j] / volume for j in range(3)] for i in range(3)]
    trace = central[0][0] + central[1][1] + central[2][2]
    tensor = [
        [float(density * ((trace if i == j else 0) - central[i][j])) for j in range(3)] for i in range(3)
    ]
    return float(density * volume), [float(x) for x in centre], np.array(tensor)


def assert_exact(found: MassProperties, path: Path, density: int) -> None:
    """Compare with rational arithmetic to 1e-12."""
    mass, centre, tensor = rational_solid(path, Fraction(density))
    sign = 1.0 if mass > 0.0 else -1.0  # an inside-out mesh is reversed
    assert found.mass == pytest.approx(sign * mass, rel=1e-12, abs=0.0)
    radius = float(np.sqrt(np.trace(tensor) / mass))
    assert found.centre == pytest.approx(centre, rel=1e-12, abs=1e-12 * radius)
    assert found.inertia == pytest.approx(sign * tensor, rel=1e-12, abs=1e-12 * float(np.abs(tensor).max()))


@pytest.mark.parametrize("name", ["tet.off", "cuboid.obj", "nonplanar.obj", "utf16.obj", "cube.ply"])
def test_accepted_meshes_equal_rational_arithmetic(name: str) -> None:
    """Mass, centre and tensor of files without repairs are those of exact arithmetic."""
    assert_exact(load_mesh(INPUTS / name, 7.0), INPUTS / name, 7)


# --------------------------------------------------------------------------------------- crossing surfaces


def swept_tube(lift: float, rings: int = 24) -> Iterator[str]:
    """Yield the lines of an OBJ: a square tube along a figure eight; its branches pass 2 `lift` apart."""
    t = 2.0 * np.pi * np.arange(rings) / rings
    path = np.stack([np.sin(t), np.sin(t) * np.cos(t), lift * np.cos(t)], axis=1)
    along = np.stack([np.cos(t), np.cos(2.0 * t), -lift * np.sin(t)], axis=1)
    u = np.cross(along, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u, axis=1)[:, None]
    w = np.cross(along, u)
    w /= np.linalg.norm(w, axis=1)[:, None]
    for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        for point in (path + 0.15 * (a * u + b * w)).tolist():
            yield "v {!r} {!r} {!r}\n".format(*point)
    for k, i in product(range(4), range(rings)):
        here, there = k * rings, (k + 1) % 4 * rings
        a, b, c, d = here + i, here + (i + 1) % rings, there + (i + 1) % rings, there + i
        yield f"f {a + 1} {c + 1} {b + 1}\nf {a + 1} {d + 1} {c + 1}\n"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("lift", [0.0, 0.01, 0.1])
def test_surface_that_crosses_itself_is_refused(
    lift: float, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message states the volume that counts the crossing twice, the occupied one, and both masses."""
    path = tmp_path / "eight.obj"
    path.write_text("".join(swept_tube(lift)))
    with pytest.raises(InputError) as refused:
        load_mesh(path, 1000.0)
    expected_message(str(refused.value), tmp_path)


def test_tube_that_passes_above_itself_is_a_solid(tmp_path: Path) -> None:
    """With its branches apart, the same tube is accepted and exact."""
    path = tmp_path / "eight.obj"
    path.write_text("".join(swept_tube(0.5)))
    found = load_mesh(path, 3.0)
    assert found.notes == ()
    assert_exact(found, path, 3)


def test_crossing_counts_twice_on_request(tmp_path: Path) -> None:
    """The mass is the signed one, exact, and the note's occupied mass is less by that of the crossing."""
    path = tmp_path / "eight.obj"
    path.write_text("".join(swept_tube(0.01)))
    found = load_mesh(path, 1000.0, None, "count-twice")
    assert_exact(found, path, 1000)
    (note,) = found.notes
    occupied, half = float(note.split("occupy is ")[1].split()[0]), float(note.split("+- ")[1].split()[0])
    assert abs(occupied - occupied_by_points(path)) < half + 0.004


def occupied_by_points(path: Path) -> float:
    """Return the volume around which a surface winds, from the winding numbers of random points."""
    from bodycheck.scenarios.mass_properties.containment import winding_number

    with open_mesh(path) as file:
        vertices, triangles = parse_mesh(path, file)
    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    points = np.random.default_rng(5).uniform(lower, upper, (40_000, 3))
    inside = sum(round(winding_number(tuple(point), vertices, triangles)) != 0 for point in points)
    return float(np.prod(upper - lower)) * inside / len(points)
