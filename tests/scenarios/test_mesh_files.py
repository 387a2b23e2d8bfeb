"""STL, OBJ and PLY files: what is read, what is refused, and the messages."""

from __future__ import annotations

import struct
import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import bodycheck.scenarios.shapes
from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios import shapes
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh, read_polygons
from bodycheck.scenarios.shapes import load_mesh, primitive
from tests.helpers.expected_messages import ExpectedMessage

VERTICES = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
CUBE = np.array([[x, y, z] for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)])


def binary_stl(header: bytes = b"made for a test") -> bytes:
    """Return the corner as binary STL."""
    facets = [
        struct.pack("<12fH", 0, 0, 0, *VERTICES[triangle].astype(np.float32).ravel(), 0)
        for triangle in TRIANGLES
    ]
    return header.ljust(80) + struct.pack("<I", len(facets)) + b"".join(facets)


def ascii_stl() -> str:
    """Return the corner as ASCII STL."""
    facets = [
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x!r} {y!r} {z!r}\n" for x, y, z in VERTICES[triangle].tolist())
        + " endloop\nendfacet\n"
        for triangle in TRIANGLES
    ]
    return "solid corner of a box\n" + "".join(facets) + "endsolid\n"


def obj(face: Callable[[int], str] = str) -> str:
    """Return the corner as OBJ, with references to vertices in the given form."""
    vertices = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in VERTICES.tolist())
    faces = "".join("f " + " ".join(face(i + 1) for i in triangle) + "\n" for triangle in TRIANGLES.tolist())
    return "# a corner\no corner\nvt 0 0\nvn 0 0 1\n" + vertices + "s off\n" + faces


PLY_HEADER = """ply
format {format} 1.0
comment a corner
element vertex 4
property double x
property double y
property double z
property uchar red
element face 4
property list uchar int vertex_indices
end_header
"""


def ascii_ply() -> str:
    """Return the corner as ASCII PLY."""
    vertices = "".join(f"{x!r} {y!r} {z!r} 255\n" for x, y, z in VERTICES.tolist())
    faces = "".join("3 " + " ".join(map(str, triangle)) + "\n" for triangle in TRIANGLES.tolist())
    return PLY_HEADER.format(format="ascii") + vertices + faces


def binary_ply(order: str) -> bytes:
    """Return the corner as binary PLY with the given byte order."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    vertices = b"".join(struct.pack(order + "3dB", *vertex, 255) for vertex in VERTICES)
    faces = b"".join(struct.pack(order + "B3i", 3, *triangle) for triangle in TRIANGLES)
    return PLY_HEADER.format(format=name).encode() + vertices + faces


def as_bytes(text: str | bytes) -> bytes:
    """Return text as bytes."""
    return text if isinstance(text, bytes) else text.encode()


GOOD: dict[str, tuple[str, str | bytes]] = {
    "binary STL": ("a.stl", binary_stl()),
    "binary STL that says solid": ("a.stl", binary_stl(b"solid")),
    "ASCII STL": ("a.STL", ascii_stl()),
    "ASCII STL with CRLF": ("a.stl", ascii_stl().replace("\n", "\r\n")),
    "ASCII STL in capitals": ("a.stl", ascii_stl().upper()),
    "OBJ": ("a.obj", obj()),
    "OBJ v/vt": ("a.obj", obj(lambda i: f"{i}/1")),
    "OBJ v//vn": ("a.obj", obj(lambda i: f"{i}//1")),
    "OBJ v/vt/vn": ("a.obj", obj(lambda i: f"{i}/1/1")),
    "OBJ counted backwards": ("a.obj", obj(lambda i: str(i - 5))),
    "OBJ with continued lines": ("a.obj", obj().replace("f 1 ", "f 1 \\\n")),
    "ASCII PLY": ("a.ply", ascii_ply()),
    "ASCII PLY with CRLF": ("a.ply", ascii_ply().replace("\n", "\r\n")),
    "little-endian PLY": ("a.ply", binary_ply("<")),
    "big-endian PLY": ("a.ply", binary_ply(">")),
}


def written(folder: Path, name: str, content: str | bytes) -> Path:
    """Write a file and return its path."""
    path = folder / name
    path.write_bytes(as_bytes(content))
    return path


def meshed(path: Path) -> tuple[Array, Triangles]:
    """Return the vertices and triangles of a file."""
    with open_mesh(path) as file:
        return parse_mesh(path, file)


@pytest.mark.nightly
@pytest.mark.parametrize("case", GOOD)
def test_each_format_gives_the_same_triangles(case: str, tmp_path: Path) -> None:
    """Every notation of the corner of a box gives the same triangles, bit for bit."""
    vertices, triangles = meshed(written(tmp_path, *GOOD[case]))
    assert np.array_equal(vertices[triangles], VERTICES[TRIANGLES])


@pytest.mark.parametrize("case", GOOD)
def test_each_format_gives_the_same_body(case: str, tmp_path: Path) -> None:
    """The corner of a 1 x 2 x 3 box at 1000 kg/m^3 has 1000 kg and its centre at a quarter of each edge."""
    body = load_mesh(written(tmp_path, *GOOD[case]), 1000.0)
    assert body.mass == pytest.approx(1000.0, rel=1e-15, abs=0.0)
    assert body.centre == pytest.approx([0.25, 0.5, 0.75], rel=1e-15, abs=0.0)
    assert body.notes == ()


def quads(extension: str) -> str | bytes:
    """Return a cube of quadrilaterals; one corner has the two triangles of a face instead."""
    faces = [*QUADS[:-1], [1, 3, 7], [1, 7, 5]]
    faces = [face[::-1] for face in faces]
    if extension == "obj":
        vertices = "".join("v {} {} {}\n".format(*vertex) for vertex in CUBE)
        return vertices + "".join("f " + " ".join(str(i + 1) for i in face) + "\n" for face in faces)
    header = PLY_HEADER.replace("vertex 4", "vertex 8").replace("face 4", "face 7")
    if extension == "ascii.ply":
        vertices = "".join("{} {} {} 0\n".format(*vertex) for vertex in CUBE)
        rows = "".join(" ".join(map(str, [len(face), *face])) + "\n" for face in faces)
        return header.format(format="ascii") + vertices + rows
    packed = b"".join(struct.pack("<3dB", *vertex, 0) for vertex in CUBE)
    packed += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    return header.format(format="binary_little_endian").encode() + packed


@pytest.mark.parametrize("extension", ["obj", "ascii.ply", "binary.ply"])
def test_polygons_are_cut_into_triangles(extension: str, tmp_path: Path) -> None:
    """A cube of mixed quadrilaterals and triangles is the unit cube."""
    body = load_mesh(written(tmp_path, f"cube.{extension}", quads(extension)), 6.0)
    assert body.mass == pytest.approx(6.0, rel=1e-15, abs=0.0)
    assert body.inertia == pytest.approx(np.eye(3), abs=1e-15)


def test_concave_polygons_are_exact(tmp_path: Path) -> None:
    """An L-shaped plate with concave hexagonal ends has exactly the right volume and centre."""
    outline = [(2, 1), (1, 1), (1, 2), (0, 2), (0, 0), (2, 0)]
    vertices = "".join(f"v {x} {y} {z}\n" for z in (0, 1) for x, y in outline)
    top, bottom = [7, 8, 9, 10, 11, 12], [6, 5, 4, 3, 2, 1]
    sides = [[i + 1, (i + 1) % 6 + 1, (i + 1) % 6 + 7, i + 7] for i in range(6)]
    faces = "".join("f " + " ".join(map(str, face)) + "\n" for face in (top, bottom, *sides))
    body = load_mesh(written(tmp_path, "l.obj", vertices + faces), 1.0)
    assert body.mass == 3.0
    assert body.centre == pytest.approx([5 / 6, 5 / 6, 0.5], rel=1e-15, abs=0.0)


def test_other_elements_of_a_ply_are_skipped(tmp_path: Path) -> None:
    """Elements before the vertices, with lists of varying length, are skipped."""
    header = PLY_HEADER.format(format="binary_little_endian").replace(
        "element vertex", "element strip 2\nproperty list ushort float weights\nelement vertex"
    )
    strips = struct.pack("<HfHff", 1, 0.5, 2, 0.5, 0.5)
    body = binary_ply("<").partition(b"end_header\n")[2]
    vertices, triangles = meshed(written(tmp_path, "a.ply", header.encode() + strips + body))
    assert np.array_equal(vertices[triangles], VERTICES[TRIANGLES])


def test_corrected_file_has_a_note(tmp_path: Path) -> None:
    """An inside-out file is reversed, and the body's notes state it."""
    text = obj().replace("f 1 3 2", "f 1 2 3").replace("f 1 2 4", "f 1 4 2")
    text = text.replace("f 1 4 3", "f 1 3 4").replace("f 2 3 4", "f 2 4 3")
    body = load_mesh(written(tmp_path, "a.obj", text), 1.0)
    assert body.mass == pytest.approx(1.0, rel=1e-15, abs=0.0)
    assert body.notes == ("the mesh was inside-out; all its triangles were reversed",)


def ply(**changes: str) -> str:
    """Return the ASCII PLY with pieces of its text replaced."""
    text = ascii_ply()
    for old, new in changes.items():
        assert PIECES[old] in text
        text = text.replace(PIECES[old], new, 1)
    return text


PIECES = {
    "format": "format ascii 1.0",
    "vertices": "element vertex 4",
    "faces": "element face 4",
    "x": "property double x\n",
    "list": "property list uchar int vertex_indices",
    "row": "0.0 0.0 3.0 255",
    "face": "3 1 2 3",
    "end": "end_header\n",
}

BAD: dict[str, tuple[str, str | bytes]] = {
    "no mesh by name": ("a.txt", ""),
    "empty STL": ("a.stl", b""),
    "short STL": ("a.stl", binary_stl()[:-1]),
    "huge STL": ("a.stl", b" " * 80 + b"\xff" * 4),
    "STL without triangles": ("a.stl", b" " * 80 + b"\0" * 4),
    "OBJ fault after continued lines": ("a.obj", "v 0 \\\n0 \\\r\n0\nv 0 1 x\n"),
    "STL cut off": ("a.stl", ascii_stl()[:-30]),
    "STL with a word for a number": ("a.stl", ascii_stl().replace("3.0", "three", 1)),
    "STL facet of two corners": ("a.stl", ascii_stl().replace("  vertex 0.0 2.0 0.0\n", "", 1)),
    "STL with another line": ("a.stl", ascii_stl().replace("outer loop", "loop", 1)),
    "OBJ without faces": ("a.obj", "v 0 0 0\n"),
    "OBJ vertex of two": ("a.obj", "v 0 0\n"),
    "OBJ vertex of words": ("a.obj", "v 0 0 zero\n"),
    "OBJ face of two": ("a.obj", obj() + "f 1 2\n"),
    "OBJ face of words": ("a.obj", obj() + "f 1 2 a/b\n"),
    "OBJ corner 0": ("a.obj", obj() + "f 0 1 2\n"),
    "OBJ corner 5": ("a.obj", obj() + "f 1 2 5\n"),
    "OBJ corner -5": ("a.obj", obj() + "f 1 2 -5\n"),
    "OBJ endless corner": ("a.obj", obj() + "f 1 2 99999999999\n"),
    "OBJ not a number": ("a.obj", obj().replace("3.0", "nan")),
    "OBJ open": ("a.obj", obj().replace("f 1 3 2\n", "")),
    "PLY of nothing": ("a.ply", ""),
    "PLY without end": ("a.ply", ply(end="")),
    "PLY of another format": ("a.ply", ply(format="format utf8 1.0")),
    "PLY of no format": ("a.ply", ply(format="")),
    "PLY without x": ("a.ply", ply(x="property double u\n")),
    "PLY of one type twice": ("a.ply", ply(x="property double y\n")),
    "PLY of no known type": ("a.ply", ply(x="property real x\n")),
    "PLY of broken corners": ("a.ply", ply(list="property list uchar float vertex_indices")),
    "PLY of a negative count": ("a.ply", ply(vertices="element vertex -4")),
    "PLY of no count": ("a.ply", ply(vertices="element vertex four")),
    "PLY of too many rows": ("a.ply", ply(faces="element face 5")),
    "PLY of too few rows": ("a.ply", ply(faces="element face 3")),
    "PLY row too short": ("a.ply", ply(row="0.0 0.0 3.0")),
    "PLY row too long": ("a.ply", ply(row="0.0 0.0 3.0 255 1")),
    "PLY row of words": ("a.ply", ply(row="0.0 0.0 z 255")),
    "PLY list too short": ("a.ply", ply(face="4 1 2 3")),
    "PLY list of negative length": ("a.ply", ply(face="-3 1 2 3")),
    "PLY face of two": ("a.ply", ply(face="2 1 2")),
    "PLY face of a fifth": ("a.ply", ply(face="3 1 2 4")),
    "PLY without faces": ("a.ply", ply(list="property list uchar int strips")),
    "PLY cut off": ("a.ply", binary_ply("<")[:-1]),
    "PLY cut off early": ("a.ply", binary_ply("<")[:-60]),
    "PLY of huge count": ("a.ply", binary_ply("<").replace(b"face 4", b"face 2000000000")),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", BAD)
def test_malformed_files_are_refused_in_one_line(
    case: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """One line names the file, the place and the error."""
    name, content = BAD[case]
    path = written(tmp_path, name, content)
    with pytest.raises(InputError) as caught:
        load_mesh(path, 1.0)
    expected_message(str(caught.value), tmp_path)


def ball(rings: int) -> tuple[Array, Triangles]:
    """Return the corners and triangles of a ball with 2 rings (rings - 1) triangles."""
    polar, around = np.pi * np.arange(1, rings) / rings, 2.0 * np.pi * np.arange(rings) / rings
    z, x, y = np.cos(polar), np.outer(np.sin(polar), np.cos(around)), np.outer(np.sin(polar), np.sin(around))
    vertices = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1).reshape(-1, 3)
    here = np.arange(len(vertices)).reshape(-1, rings)
    after = np.roll(here, -1, axis=1)
    a, b, c, d = (part.ravel() for part in (here[:-1], after[:-1], here[1:], after[1:]))
    north, south = np.full(rings, len(vertices)), np.full(rings, len(vertices) + 1)
    parts = [(a, c, d), (a, d, b), (north, here[0], after[0]), (south, after[-1], here[-1])]
    return np.vstack([vertices, [[0, 0, 1], [0, 0, -1]]]), np.vstack(
        [np.column_stack(part) for part in parts]
    )


def ball_files(vertices: Array, triangles: Triangles) -> dict[str, bytes]:
    """Return a mesh as files of every format at their maximum size, with all digits of every double."""
    facets = np.zeros(len(triangles), dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("a", "<u2")])
    facets["v"] = vertices[triangles]
    lines = [" ".join(map(repr, point)) for point in vertices.tolist()]
    rows = [" ".join(map(str, triangle)) for triangle in triangles.tolist()]
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    corners = (facet.format("".join(f"vertex {lines[i]}\n" for i in row)) for row in triangles.tolist())
    header = (
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n"
    )
    header = (header + "element face {}\nproperty list uchar int vertex_index\nend_header\n").format(
        len(vertices), len(triangles)
    )
    counted = [" ".join(map(str, row)) for row in (triangles + 1).tolist()]
    return {
        "binary.stl": bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes(),
        "text.stl": ("solid\n" + "".join(corners) + "endsolid\n").encode(),
        "text.obj": "".join([f"v {line}\n" for line in lines] + [f"f {row}\n" for row in counted]).encode(),
        "text.ply": (
            header + "".join([f"{line}\n" for line in lines] + [f"3 {row}\n" for row in rows])
        ).encode(),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(f"{kind}.stl", marks=pytest.mark.nightly) for kind in ("binary", "text")),
        "text.obj",
        "text.ply",
    ],
)
def test_mesh_takes_at_most_200_bytes_per_triangle(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The peak from file to mass includes the memory of numpy and numba and the bytes of the file."""
    monkeypatch.setattr(bodycheck.scenarios.shapes, "cache_directory", lambda: tmp_path / "cache")
    first = written(tmp_path, f"first-{name}", ball_files(*ball(49))[name])
    load_mesh(first, 1.0)  # loads the compiled functions
    vertices, triangles = ball(50)
    path = written(tmp_path, name, ball_files(vertices, triangles)[name])
    tracemalloc.start()
    mass = load_mesh(path, 1.0).mass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert mass == pytest.approx(4.0 / 3.0 * np.pi, rel=0.01)
    assert peak / len(triangles) < 200


def test_file_changed_during_reading_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """No solid is stored under the hash of other bytes."""
    monkeypatch.setattr(bodycheck.scenarios.shapes, "cache_directory", lambda: tmp_path / "cache")
    path = written(tmp_path, "a.obj", obj())

    def changed(*read: Any) -> Any:
        path.write_text(obj() + "# more\n")
        return read_polygons(*read)

    monkeypatch.setattr(shapes, "read_polygons", changed)
    with expected_message.raises(InputError):
        load_mesh(path, 1.0)
    assert not (tmp_path / "cache").exists()


def test_files_that_cannot_be_read_are_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A missing file and a folder are refused by name."""
    (tmp_path / "folder.stl").mkdir()
    for name in ("missing.stl", "folder.stl"):
        with expected_message.raises(InputError):
            open_mesh(tmp_path / name)


def test_file_above_one_gibibyte_is_not_read(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The file is refused by its size alone."""
    path = tmp_path / "huge.obj"
    with path.open("wb") as file:
        file.truncate((1 << 30) + 1)
    with pytest.raises(InputError) as refused:
        open_mesh(path)
    expected_message(str(refused.value), tmp_path)


def test_impossible_density_or_shape_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """An invalid density of a mesh or size of a primitive is refused in one line."""
    path = written(tmp_path, "a.obj", obj())
    with expected_message.raises(InputError):
        load_mesh(path, float("nan"))
    with expected_message.raises(InputError):
        primitive("sphere", [1.0, 2.0], 1.0)


def test_primitive_is_scaled_by_its_density() -> None:
    """A box of 1 x 2 x 3 m at 2 kg/m^3 weighs 12 kg, with I_z = m (1 + 4) / 12."""
    body = primitive("box", [1, 2, 3], 2.0)
    assert body.mass == pytest.approx(12.0, rel=1e-15, abs=0.0)
    assert body.inertia[2, 2] == pytest.approx(5.0, rel=1e-15, abs=0.0)


@pytest.mark.slow
@pytest.mark.nightly(after=4)
@pytest.mark.parametrize("case", GOOD)
@given(data=st.data())
@settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_damaged_files_never_crash(case: str, tmp_path: Path, data: st.DataObject) -> None:
    """With a few bytes changed, cut or doubled, a file is read or refused in one line."""
    name, content = GOOD[case]
    damaged = bytearray(as_bytes(content))
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        end = at + data.draw(st.integers(0, 12))
        damaged[at:end] = data.draw(st.binary(max_size=12))
        if not damaged:
            break
    path = written(tmp_path, name, bytes(damaged))
    message = ""
    try:
        load_mesh(path, 1.0)
    except InputError as error:
        message = str(error)
    assert "\n" not in message


def exact_volume(vertices: Any, triangles: Any) -> Fraction:
    """Return the volume in rational numbers."""
    volume = Fraction(0)
    for triangle in triangles:
        a, b, c = ([Fraction(float(x)) for x in vertices[i]] for i in triangle)
        volume += (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
    return volume / 6


def pybullet_file(name: str) -> Path:
    """Return the path of a file that comes with PyBullet, or skip the test."""
    data = pytest.importorskip("pybullet_data")
    return Path(data.getDataPath()) / name


@pytest.mark.slow
@pytest.mark.nightly(after=3)
@pytest.mark.parametrize(
    "name",
    ["domino/domino.obj", "bunny.obj", "torus/torus_textured.obj", "gripper/meshes/WSG50_110.stl",
     "stone.obj", "kuka_iiwa/meshes/finger_tip_left.stl", "quadruped/microtaur/fr12_h101.stl"],
)  # fmt: skip
def test_pybullet_meshes_match_rational_arithmetic(name: str) -> None:
    """Closed meshes that come with PyBullet have the volume of exact arithmetic to 1e-15."""
    path = pybullet_file(name)
    exact = exact_volume(*meshed(path))
    assert load_mesh(path, 1.0).mass == pytest.approx(abs(float(exact)), rel=1e-15, abs=0.0)


@pytest.mark.slow
def test_touching_parts_are_counted_once_each() -> None:
    """A duck of five touching convex parts has the sum of their volumes, and a note on the parts."""
    path = pybullet_file("duck_vhacd.obj")
    body = load_mesh(path, 1.0)
    assert body.mass == pytest.approx(float(exact_volume(*meshed(path))), rel=1e-15, abs=0.0)
    assert body.notes == ("the mesh has 5 closed surfaces; none was found to cross another",)


@pytest.mark.slow
@pytest.mark.nightly(after=2)
@pytest.mark.parametrize(
    "name",
    [
        "plane.obj",
        "cloth_z_up.obj",
        "teddy2_VHACD_CHs.obj",
    ],
)
def test_pybullet_meshes_without_a_solid_are_refused(name: str, expected_message: ExpectedMessage) -> None:
    """Open meshes and overlapping convex parts are refused with a message that identifies the fault."""
    path = pybullet_file(name)
    with pytest.raises(InputError) as caught:
        load_mesh(path, 1.0)
    expected_message(str(caught.value), path.parent)
