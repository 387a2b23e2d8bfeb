"""Read triangle meshes from STL, OBJ and PLY files, without checking the mesh."""

from __future__ import annotations

import os
from collections.abc import Callable
from importlib.resources.abc import Traversable
from io import BufferedIOBase
from pathlib import PurePath
from typing import TypeAlias, cast

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.obj import parse_obj
from bodycheck.scenarios.mesh_files.ply import parse_ply
from bodycheck.scenarios.mesh_files.stl import parse_stl

Parser: TypeAlias = Callable[[BufferedIOBase], tuple[Array, Triangles]]

_PARSERS: dict[str, Parser] = {".stl": parse_stl, ".obj": parse_obj, ".ply": parse_ply}
MESH_SUFFIXES = tuple(_PARSERS)
_MAX_BYTES = 1 << 30


def open_mesh(path: Traversable) -> BufferedIOBase:
    """Open a mesh file for reading; the caller closes it.

    Raises InputError with one line: the file, and why it cannot be read.
    """
    _parser(path)
    try:
        file = cast(BufferedIOBase, path.open("rb"))
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if size > _MAX_BYTES:
        file.close()
        raise InputError(f"{path}: too large, {size} bytes (limit: {_MAX_BYTES})")
    return file


def parse_mesh(path: Traversable, file: BufferedIOBase) -> tuple[Array, Triangles]:
    """Return the vertices (n, 3), taken as m, and triangles (m, 3) of a file; its suffix selects the format.

    Polygons become fans about their first corner, which is exact for plane polygons, convex or not. Raises
    InputError with one line: the file, the position in it, what is wrong.
    """
    try:
        vertices, triangles = _parser(path)(file)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if not len(triangles):
        raise InputError(f"{path}: has no faces")
    return vertices, triangles


def _parser(path: Traversable) -> Parser:
    """Return the parser for a file's suffix; raises InputError for an unsupported format."""
    parse = _PARSERS.get(PurePath(path.name).suffix.lower())
    if parse is None:
        raise InputError(f"{path}: unsupported mesh format (supported: {', '.join(MESH_SUFFIXES)})")
    return parse
