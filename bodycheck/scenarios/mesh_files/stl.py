"""STL, binary or ASCII: a sequence of triangles, each with its own three corners.

Source: 3D Systems (1989), StereoLithography interface specification.
"""

from __future__ import annotations

import os
from array import array
from io import BufferedIOBase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import count
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mesh_files.polygons import Polygons
from bodycheck.scenarios.mesh_files.text_formats import (
    encoding_notes,
    encoding_of,
    floats,
    points,
    quoted,
    split_lines,
)

_HEADER = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_PROBED = 512
"""Bytes at the start of a file that are all printable if it is text."""


def parse_stl(file: BufferedIOBase) -> Polygons:
    """Return the triangles of a file, with its distinct vertices.

    Raises ValueError with the position and what is wrong. A file is binary if its size matches its count of
    triangles; "solid", with which an ASCII file begins, also occurs at the start of binary files. The order
    of the corners gives the orientation; normals are ignored. An ASCII file, which takes 250 bytes per
    triangle, is read line by line.
    """
    encoding = encoding_of(file)
    start = file.read(_PROBED)
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    n = int.from_bytes(start[80:_HEADER], "little")
    expected = _HEADER + n * _FACET.itemsize
    if size < _HEADER or size != expected:
        text = start.decode(encoding, errors="replace").lstrip()
        if text[:5].lower() == "solid" and all(char.isprintable() or char.isspace() for char in text):
            corners, notes = _ascii(file)
            return _numbered(corners, *encoding_notes(encoding), *notes)
    if size < _HEADER:
        raise ValueError(f"not an STL file: {size} bytes are less than the {_HEADER} of a binary header")
    if size < expected:
        raise ValueError(
            f"not an STL file: its header states {n} triangles, which take {expected} bytes; it has {size}"
        )
    more = [f"ignored: {count(size - expected, 'byte')} after the last triangle"] if size > expected else []
    facets = np.frombuffer(file.read(expected), dtype=_FACET, offset=_HEADER)
    return _numbered(facets["corners"].reshape(-1, 3), *more)


def _numbered(corners: NDArray[np.floating[Any]], *notes: str) -> Polygons:
    """Return the triangles of the corners (3 m, 3) of consecutive facets."""
    # imports numba, which takes a second
    from bodycheck.scenarios.mass_properties.vertex_merge import merged

    vertices, number = merged(corners)
    return Polygons.of_triangles(vertices, number.astype(np.int64).reshape(-1, 3), *notes)


def _ascii(file: BufferedIOBase) -> tuple[Array, tuple[str, ...]]:
    """Return the corners (3 m, 3) of an ASCII file, and a note on lines after its end."""
    corners = array("d")
    facets, ended, extra = 0, False, 0
    for line, words in split_lines(file):
        keyword = words[0].lower()
        match keyword, len(words):
            case "vertex", 4:
                corners.extend(floats(words[1:], line))
            case "endfacet", _:
                facets += 1
                if len(corners) != 9 * facets:
                    raise ValueError(f"line {line}: a facet does not have three corners")
            case ("facet", 5) | ("outer", 2) | ("endloop", 1):
                pass
            case ("solid" | "endsolid", _):
                pass
            case _ if ended:
                extra += 1
                continue
            case _:
                raise ValueError(f"line {line}: {quoted(words)} is not a line of an ASCII STL file")
        ended = keyword == "endsolid"
    if not ended:
        raise ValueError("ends without endsolid")
    return points(corners), (f"ignored: {count(extra, 'line')} after endsolid",) if extra else ()
