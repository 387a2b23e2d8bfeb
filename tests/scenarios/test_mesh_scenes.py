"""GLB, 3MF and DAE: instances, transforms and units, with numbers that are known; and damaged files."""

from __future__ import annotations

import json
import struct
import zipfile
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.scenarios.mass_properties.solid import MassProperties
from bodycheck.scenarios.mesh_files import scenes
from bodycheck.scenarios.shapes import load_mesh
from tests.helpers.expected_messages import ExpectedMessage
from tests.scenarios.test_mesh_files import CUBE, QUADS

pytestmark = pytest.mark.skipif(
    not all(map(find_spec, ("trimesh", "networkx", "collada"))), reason="needs the extra meshes"
)

CORNERS = CUBE * [1, 2, 3]
TRIANGLES = [[q[0], q[k], q[k + 1]] for q in QUADS for k in (1, 2)]
"""A box of 1 x 2 x 3."""


def glb(scale: float = 1.0) -> bytes:
    """Return a scene of the box, and of its mirror image 5 m along x."""
    points = (CORNERS * scale).astype("<f4").tobytes()
    indices = np.array(TRIANGLES, dtype="<u2").tobytes()
    mirrored = [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5 * scale, 0, 0, 1]  # by columns
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"mesh": 0, "matrix": mirrored}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(points) + len(indices)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(points)},
            {"buffer": 0, "byteOffset": len(points), "byteLength": len(indices)},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 8,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": (CORNERS.max(axis=0) * scale).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    content = points + indices
    body = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def packed(model: str) -> bytes:
    """Return a 3MF package with this model."""
    stream = BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", model)
    return stream.getvalue()


def model_3mf(unit: str = ' unit="meter"', scale: float = 1.0) -> str:
    """Return the model of a box, and of a component that is its mirror image 5 m along x."""
    vertices = "".join('<vertex x="{!r}" y="{!r}" z="{!r}"/>'.format(*v) for v in (CORNERS * scale).tolist())
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*t) for t in TRIANGLES)
    return (
        f'<model{unit} xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f'<object id="1" type="model"><mesh><vertices>{vertices}</vertices><triangles>{triangles}</triangles>'
        '</mesh></object><object id="2" type="model"><components>'
        f'<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 {5 * scale!r} 0 0"/></components></object>'
        '</resources><build><item objectid="1"/><item objectid="2"/></build></model>'
    )


def dae(metre: float = 1.0, polygons: bool = True) -> str:
    """Return a scene of the box, and of its mirror image 5 m along x."""
    faces = QUADS if polygons else TRIANGLES
    corners = " ".join(repr(float(x) / metre) for x in CORNERS.ravel())
    numbers = " ".join(str(i) for face in faces for i in face)
    counts = " ".join(str(len(face)) for face in faces)
    return (
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f'<asset><unit name="u" meter="{metre!r}"/><up_axis>Z_UP</up_axis></asset>'
        '<library_geometries><geometry id="box"><mesh><source id="p"><float_array id="a" count="24">'
        f'{corners}</float_array><technique_common><accessor source="#a" count="8" stride="3">'
        '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>'
        "</accessor></technique_common></source>"
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        f'<polylist count="{len(faces)}"><input semantic="VERTEX" source="#v" offset="0"/>'
        f"<vcount>{counts}</vcount><p>{numbers}</p></polylist></mesh></geometry></library_geometries>"
        '<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#box"/></node>'
        f"<node><translate>{5.0 / metre!r} 0 0</translate><scale>-1 1 1</scale>"
        '<instance_geometry url="#box"/></node></visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


GOOD: dict[str, tuple[str, bytes]] = {
    "GLB": ("a.glb", glb()),
    "3MF in metres": ("a.3mf", packed(model_3mf())),
    "3MF in millimetres": ("a.3mf", packed(model_3mf("", 1e3))),
    "3MF in inches": ("a.3mf", packed(model_3mf(' unit="inch"', 1 / 0.0254))),
    "DAE in metres": ("a.dae", dae().encode()),
    "DAE in inches": ("a.dae", dae(0.0254).encode()),
    "DAE of triangles": ("a.DAE", dae(polygons=False).encode()),
}


def two_boxes() -> MassProperties:
    """Return two boxes of 1 x 2 x 3 m and 6 kg, 4 m apart along x."""
    across = 2 * (6 * (1 + 9) / 12 + 6 * 2.0**2), 2 * (6 * (1 + 4) / 12 + 6 * 2.0**2)
    return MassProperties(12.0, np.array([2.5, 1.0, 1.5]), np.diag([2 * 6 * (4 + 9) / 12, *across]))


@pytest.mark.parametrize("case", GOOD)
def test_scene_is_the_sum_of_its_instances_in_metres(case: str, tmp_path: Path) -> None:
    """A box and its mirror image at 1 kg/m^3; DAE, which its reader rounds to 7 digits, has a note."""
    name, content = GOOD[case]
    path = tmp_path / name
    path.write_bytes(content)
    found, expected = load_mesh(path, 1.0), two_boxes()
    tolerance = 1e-6 if "inches" in case and "DAE" in case else 1e-13
    assert found.mass == pytest.approx(expected.mass, rel=tolerance)
    assert found.centre == pytest.approx(expected.centre, rel=tolerance)
    assert found.inertia == pytest.approx(expected.inertia, rel=tolerance, abs=tolerance * 100.0)
    assert found.notes[:-1] == ((scenes._SINGLE,) if "DAE" in case else ())


MANY_CORNERS = dae().replace("<vcount>", "<vcount><!-- 4 -->1000000000 ")
OF_BOX, ABSENT = '<component objectid="1"', '<item objectid="7"'
ITSELF = '<component objectid="2"/><component objectid="1"'
BAD: dict[str, tuple[str, bytes]] = {
    "GLB cut off": ("a.glb", glb()[:200]),
    "text as GLB": ("a.glb", b"solid cube\n"),
    "3MF that is no archive": ("a.3mf", b"PK\3\4 and so on"),
    "3MF without a model": ("a.3mf", packed("")),
    "3MF of an unknown unit": ("a.3mf", packed(model_3mf(' unit="league"'))),
    "3MF without items": ("a.3mf", packed(model_3mf().replace("<item", "<other"))),
    "3MF of a component that is itself": ("a.3mf", packed(model_3mf().replace(OF_BOX, ITSELF))),
    "3MF of an item that is absent": ("a.3mf", packed(model_3mf().replace('<item objectid="2"', ABSENT))),
    "DAE cut off": ("a.dae", dae().encode()[:300]),
    "DAE of a broken reference": ("a.dae", dae().replace('url="#box"', 'url="#sphere"').encode()),
    "DAE of a billion corners": ("a.dae", MANY_CORNERS.encode("utf-16")),
    "DAE of entities": (
        "a.dae",
        dae().replace("<COLLADA", '<!DOCTYPE x [<!ENTITY a SYSTEM "/etc/passwd">]><COLLADA').encode(),
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_damaged_scene_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    """The message names the file and is one line; what it says after that is the reader's."""
    name, content = BAD[case]
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError) as refused:
        load_mesh(path, 1.0)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_unit_of_a_file_that_states_it_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """--unit does not apply to a file in metres."""
    path = tmp_path / "a.glb"
    path.write_bytes(glb())
    with expected_message.raises(InputError):
        load_mesh(path, 1.0, "mm")


def test_missing_library_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """The message has the command that installs it."""
    monkeypatch.setattr(scenes, "_found", lambda name: name != "networkx")
    path = tmp_path / "a.3mf"
    path.write_bytes(packed(model_3mf().replace("1.0", "1.5")))
    with expected_message.raises(InputError):
        load_mesh(path, 1.0)
