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

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.text_formats import floats, points, quoted, split_lines

_HEADER = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def parse_stl(file: BufferedIOBase) -> tuple[Array, Triangles]:
    """Return the distinct vertices (n, 3) and triangles (m, 3).

    Raises ValueError with the position and what is wrong. A file is binary if its size matches its count of
    triangles; "solid", with which an ASCII file begins, also occurs at the start of binary files. The order
    of the corners gives the orientation; normals are ignored. An ASCII file, which takes 250 bytes per
    triangle, is read line by line.
    """
    header = file.read(_HEADER)
    size = file.seek(0, os.SEEK_END)
    file.seek(0)
    n = int.from_bytes(header[80:], "little")
    expected = _HEADER + n * _FACET.itemsize
    if size >= _HEADER and size == expected:
        return _numbered(np.frombuffer(file.read(), dtype=_FACET, offset=_HEADER)["corners"].reshape(-1, 3))
    if header.lstrip()[:5].lower() == b"solid":
        return _numbered(_ascii_corners(file))
    if size < _HEADER:
        raise ValueError(f"not an STL file: {size} bytes are less than the {_HEADER} of a binary header")
    raise ValueError(
        f"not an STL file: its header states {n} triangles, which take {expected} bytes, but it has {size}"
    )


def _numbered(corners: NDArray[np.floating[Any]]) -> tuple[Array, Triangles]:
    """Return vertices (n, 3) and triangles (m, 3) of the corners (3 m, 3) of consecutive facets."""
    # imports numba, which takes a second
    from bodycheck.reference_impl.mass_properties.vertex_merge import merged

    vertices, number = merged(corners)
    return vertices, number.astype(np.int64).reshape(-1, 3)


def _ascii_corners(file: BufferedIOBase) -> Array:
    """Return the corners (3 m, 3) of an ASCII file."""
    corners = array("d")
    facets, keyword = 0, ""
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
            case _:
                raise ValueError(f"line {line}: {quoted(words)} is not a line of an ASCII STL file")
    if keyword != "endsolid":
        raise ValueError("ends without endsolid")
    return points(corners)
