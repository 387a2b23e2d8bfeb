"""Triangle meshes from STL, OBJ and PLY files, as the file has them: nothing is judged here."""

from __future__ import annotations

from pathlib import Path

from bodycheck.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.polyhedron import Triangles
from bodycheck.scenarios.mesh_files.obj import parse_obj
from bodycheck.scenarios.mesh_files.ply import parse_ply
from bodycheck.scenarios.mesh_files.stl import parse_stl

_PARSERS = {".stl": parse_stl, ".obj": parse_obj, ".ply": parse_ply}
_MOST_BYTES = 1 << 30


def read_mesh(path: Path) -> tuple[Array, Triangles]:
    """Read a mesh file, its format told by its suffix: vertices (n, 3), taken as m, and triangles (m, 3).

    Polygons become fans about their first corner, which is exact for plane ones, convex or not. Raises
    InputError with one line: the file, where in it, what is wrong.
    """
    parse = _PARSERS.get(path.suffix.lower())
    if parse is None:
        raise InputError(f"{path}: is no mesh file by its name; known are {', '.join(_PARSERS)}")
    try:
        size = path.stat().st_size
        if size > _MOST_BYTES:
            raise InputError(f"{path}: has {size} bytes; at most {_MOST_BYTES} are read")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        vertices, triangles = parse(data)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if not len(triangles):
        raise InputError(f"{path}: has no faces")
    return vertices, triangles
