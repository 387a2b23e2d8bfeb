"""STL, binary and ASCII: triangles one after the other, each with its own three corners.

Source: 3D Systems (1989), StereoLithography interface specification.
"""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.words import floats, lines_of_words, points, shown

_HEADER = 84
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def parse_stl(data: bytes) -> tuple[Array, Triangles]:
    """Return vertices (3 m, 3) and triangles (m, 3). Raises ValueError saying where and what is wrong.

    A file is binary where its size is what its count of triangles says: "solid", with which an ASCII file
    begins, stands at the head of binary ones too. Normals are not used; the order of the corners is.
    """
    said = int.from_bytes(data[80:_HEADER], "little")
    if len(data) >= _HEADER and len(data) == _HEADER + said * _FACET.itemsize:
        facets = np.frombuffer(data, dtype=_FACET, offset=_HEADER)
        return _numbered(facets["corners"].reshape(-1, 3).astype(np.float64))
    if data.lstrip()[:5].lower() == b"solid":
        return _numbered(_ascii_corners(data))
    if len(data) < _HEADER:
        raise ValueError(f"is no STL: {len(data)} bytes are less than the {_HEADER} of a binary header")
    raise ValueError(
        f"is no STL: its header says {said} triangles, which take {_HEADER + said * _FACET.itemsize} bytes, "
        f"but there are {len(data)}"
    )


def _numbered(corners: Array) -> tuple[Array, Triangles]:
    return corners, np.arange(len(corners), dtype=np.int64).reshape(-1, 3)


def _ascii_corners(data: bytes) -> Array:
    """Return the corners (3 m, 3) of an ASCII file."""
    corners: list[list[float]] = []
    facets, keyword = 0, ""
    for line, words in lines_of_words(data):
        keyword = words[0].lower()
        match keyword, len(words):
            case "vertex", 4:
                corners.append(floats(words[1:], line))
            case "endfacet", _:
                facets += 1
                if len(corners) != 3 * facets:
                    raise ValueError(f"line {line}: a facet ends that has not three corners")
            case ("facet", 5) | ("outer", 2) | ("endloop", 1):
                pass
            case ("solid" | "endsolid", _):
                pass
            case _:
                raise ValueError(f"line {line}: {shown(words)} is no line of an ASCII STL")
    if keyword != "endsolid":
        raise ValueError("ends without endsolid")
    return points(corners)
