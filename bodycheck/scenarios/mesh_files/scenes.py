"""GLB, 3MF and DAE through trimesh: the triangles of all instances in a scene, in m.

Sources: Khronos (2021), glTF 2.0; 3MF Consortium (2018), 3MF core specification 1.2.3; Khronos (2008),
COLLADA 1.5.
"""

from __future__ import annotations

import importlib.util
import re
import warnings
from fractions import Fraction
from functools import partial
from graphlib import CycleError, TopologicalSorter
from io import BufferedIOBase, BytesIO
from typing import Any
from zipfile import ZipFile

import numpy as np

from bodycheck._util.untrusted import printable
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.polygons import Polygons

LIBRARIES = {
    ".glb": ("trimesh",),
    ".3mf": ("trimesh", "networkx"),
    ".dae": ("trimesh", "pycollada"),
}
"""Suffix -> the distributions that reading takes; their versions are part of what is cached."""

_MODULES = {"pycollada": "collada"}
_UNITS = {
    "meter": Fraction(1),
    "micron": Fraction(1, 10**6),
    "millimeter": Fraction(1, 1000),
    "centimeter": Fraction(1, 100),
    "inch": Fraction(254, 10000),
    "foot": Fraction(3048, 10000),
}
_SINGLE = "coordinates were read in single precision, so that mass and inertia are right to about 1e-6"


def parse_scene(suffix: str, file: BufferedIOBase) -> Polygons:
    """Return the triangles of a scene in m, in the axes of the file. Raises ValueError with what is wrong."""
    if missing := [name for name in LIBRARIES[suffix] if not _found(name)]:
        raise ValueError(f"requires {' and '.join(missing)}: pip install 'bodycheck[meshes]'")
    import trimesh

    content = file.read()
    options: dict[str, Any] = {}
    if suffix == ".dae":
        options = {"ignore_broken": False}  # parts would be left out silently
        _check_collada(content.replace(b"\0", b""))  # UTF-16, too
    try:
        # numbers that are not finite are refused later, and named
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            vertices, triangles, unit = _instances(
                trimesh.load_scene(BytesIO(content), file_type=suffix[1:], process=False, **options)
            )
    except (MemoryError, KeyboardInterrupt):
        raise
    except Exception as error:  # noqa: BLE001 - a damaged file raises whatever its reader comes across
        reason = printable(str(error).strip(), 200) or type(error).__name__
        raise ValueError(f"cannot be read by trimesh: {reason}") from None
    if suffix == ".3mf":
        _check_objects(content)
    metre = 1.0 if suffix == ".glb" or not len(triangles) else float(_metre(unit))
    return Polygons.of_triangles(vertices * metre, triangles, *((_SINGLE,) if suffix == ".dae" else ()))


def _check_collada(content: bytes) -> None:
    """Refuse what takes more memory than the file: entities, and more corners of polygons than it has."""
    if b"<!ENTITY" in content:
        raise ValueError("declares entities, which are not expanded; write their text instead")
    for counts in re.findall(rb"<[^<>/\s]*vcount\b.*?>(.*?)</[^<>\s]*vcount", content, re.DOTALL):
        corners = sum(int(count) for count in re.findall(rb"\d{1,18}", counts))
        if corners > len(content):
            raise ValueError(f"<vcount> has {corners} corners of polygons, more than the file has bytes")


def _check_objects(content: bytes) -> None:
    """Refuse a 3MF of which trimesh leaves out objects, or repeats those that contain themselves."""
    from lxml import etree

    parts: dict[str, set[str]] = {"build": set()}
    with ZipFile(BytesIO(content)) as archive:
        name = next(one for one in archive.namelist() if "3d/3dmodel.model" in one.lower())
        with archive.open(name) as file:
            for _, node in etree.iterparse(file, tag=("{*}object", "{*}build"), resolve_entities=False):
                references = [one for one in node.iter("{*}component", "{*}item") if not _elsewhere(one)]
                parts[node.get("id", "build")] = {one.get("objectid", "") for one in references}
    if absent := sorted(set().union(*parts.values()) - parts.keys()):
        raise ValueError(f"refers to object {printable(absent[0], 40)}, which it does not have")
    try:
        TopologicalSorter(parts).prepare()
    except CycleError as error:
        raise ValueError(f"object {printable(error.args[1][0], 40)} contains itself") from None


def _elsewhere(component: Any) -> bool:
    """Whether a component is of another file in the archive, as the production extension allows."""
    return any(name.endswith("path") for name in component.attrib)


def _instances(scene: Any) -> tuple[Array, Triangles, str]:
    """Return the vertices (n, 3) and the triangles (m, 3) of all instances, and their unit of length."""
    vertices, triangles, count, unit = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0, ""
    for node in sorted(scene.graph.nodes_geometry):
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        corners = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64).reshape(-1, 3)  # none of points
        if not len(corners):
            continue
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            corners = corners[:, ::-1]
        vertices.append(mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3])
        triangles.append(corners + count)
        count += len(mesh.vertices)
        unit = str(mesh.metadata.get("units", ""))
    return np.concatenate(vertices), np.concatenate(triangles), unit


def _found(name: str) -> bool:
    return importlib.util.find_spec(_MODULES.get(name, name)) is not None


def _metre(unit: str) -> Fraction:
    """Return the length in m of a unit as trimesh names it: 'millimeter', 'inches', '0.01 * meters'."""
    factor, _, name = unit.rpartition(" * ")
    name = re.sub("^feet$", "foot", name.removesuffix("es") if name == "inches" else name.removesuffix("s"))
    if name not in _UNITS:
        raise ValueError(f"has the unit {unit!r} (known: {', '.join(_UNITS)})")
    return _UNITS[name] * Fraction(factor or "1")


SCENE_PARSERS = {suffix: partial(parse_scene, suffix) for suffix in LIBRARIES}
"""Suffix -> parser. These formats state their unit."""
