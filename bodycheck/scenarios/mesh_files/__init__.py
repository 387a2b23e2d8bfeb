"""Read the polygons of mesh files, without checking whether they bound a solid.

STL, OBJ, PLY and OFF have readers of their own: messages name the line of a fault, and the note on polygons
that are not plane needs the polygons, neither of which trimesh provides.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources.abc import Traversable
from io import BufferedIOBase
from pathlib import Path, PurePath
from typing import TypeAlias, cast

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import unread
from bodycheck._util.untrusted import open_input
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.obj import parse_obj
from bodycheck.scenarios.mesh_files.off import parse_off
from bodycheck.scenarios.mesh_files.ply import parse_ply
from bodycheck.scenarios.mesh_files.polygons import Polygons
from bodycheck.scenarios.mesh_files.scenes import SCENE_PARSERS
from bodycheck.scenarios.mesh_files.stl import parse_stl

Parser: TypeAlias = Callable[[BufferedIOBase], Polygons]

_PARSERS: dict[str, Parser] = {
    ".stl": parse_stl,
    ".obj": parse_obj,
    ".ply": parse_ply,
    ".off": parse_off,
    **SCENE_PARSERS,
}
MESH_SUFFIXES = tuple(_PARSERS)
_COMPRESSED = (".gz", ".bz2", ".xz", ".zip", ".zst", ".7z")


def open_mesh(path: Traversable) -> BufferedIOBase:
    """Open a mesh file for reading; the caller closes it.

    Raises InputError with one line: the file, and why it cannot be read.
    """
    _parser(path)
    try:
        return cast(BufferedIOBase, open_input(path) if isinstance(path, Path) else path.open("rb"))
    except OSError as error:
        raise InputError(unread(Path(str(path)), error)) from None


def read_polygons(path: Traversable, file: BufferedIOBase) -> Polygons:
    """Return the polygons of a file; its suffix selects the format. A format that states its unit is in m.

    Raises InputError with one line: the file, the position in it, what is wrong.
    """
    try:
        found = _parser(path)(file)
    except OSError as error:
        raise InputError(unread(Path(str(path)), error)) from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if not len(found.lengths):
        raise InputError(f"{path}: has no faces")
    return found


def parse_mesh(path: Traversable, file: BufferedIOBase) -> tuple[Array, Triangles]:
    """Return the vertices (n, 3), taken as m, and triangles (m, 3) of a file.

    Polygons become fans about their first corner, which is exact for plane polygons, convex or not. Raises
    InputError as read_polygons does.
    """
    found = read_polygons(path, file)
    return found.vertices, found.triangles()


def _parser(path: Traversable) -> Parser:
    """Return the parser for a file's suffix; raises InputError for an unsupported format."""
    suffix = PurePath(path.name).suffix.lower()
    parse = _PARSERS.get(suffix)
    if parse is None:
        known = f"supported: {', '.join(MESH_SUFFIXES)}"
        if suffix in _COMPRESSED:
            raise InputError(f"{path}: is compressed; unpack it first ({known})")
        raise InputError(f"{path}: unsupported mesh format ({known})")
    return parse
