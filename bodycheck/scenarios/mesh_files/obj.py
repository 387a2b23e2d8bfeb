"""Wavefront OBJ: `v` lines are vertices, `f` lines polygons; everything else is ignored.

Source: Alias|Wavefront (1993), Advanced Visualizer manual, appendix B1.
"""

from __future__ import annotations

import re
from array import array
from io import BufferedIOBase, BytesIO

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.text_formats import (
    fans,
    floats,
    integer,
    points,
    quoted,
    split_lines,
)

_CONTINUED = re.compile(rb"(?m)^(?:[^\n]*\\\r?\n)+[^\n]*")
_CONTINUATION = re.compile(rb"\\\r?\n")


def parse_obj(file: BufferedIOBase) -> tuple[Array, Triangles]:
    """Return vertices (n, 3) and triangles (m, 3). Raises ValueError with the line and what is wrong.

    All objects and groups of the file are one mesh. A corner is `v`, `v/vt`, `v//vn` or `v/vt/vn`; a
    negative v counts back from the last vertex before its line.
    """
    vertices, lengths, corners = array("d"), array("i"), array("i")
    ahead: list[tuple[int, int]] = []  # lines with a reference to a later vertex than any before
    data = file.read()
    for line, words in split_lines(BytesIO(_CONTINUED.sub(_joined, data) if b"\\" in data else data)):
        match words[0]:
            case "v":
                if len(words) < 4:
                    raise ValueError(f"line {line}: {quoted(words)} has fewer than three coordinates")
                vertices.extend(floats(words[1:4], line))
            case "f":
                if len(words) < 4:
                    raise ValueError(f"line {line}: {quoted(words)} has fewer than three corners")
                before = len(vertices) // 3
                face = [_corner(word, line, before) for word in words[1:]]
                if max(face) >= max(before, ahead[-1][1] + 1 if ahead else 0):
                    ahead.append((line, max(face)))
                lengths.append(len(face))
                corners.extend(face)
    for line, corner in ahead:
        if 3 * corner >= len(vertices):
            known = len(vertices) // 3
            raise ValueError(f"line {line}: corner {corner + 1} is not one of the {known} vertices")
    return points(vertices), fans(np.asarray(lengths), np.asarray(corners))


def _joined(lines: re.Match[bytes]) -> bytes:
    """Join continued lines, and append empty ones, so that the lines that follow keep their numbers."""
    one, continuations = _CONTINUATION.subn(b" ", lines[0])
    return one + b"\n" * continuations


def _corner(word: str, line: int, before: int) -> int:
    """Return the vertex index, from 0, of a face's corner; `before`: number of vertices before its line."""
    number = integer(word.partition("/")[0], line)
    if number == 0 or number < -before:
        raise ValueError(f"line {line}: corner {number} is not one of the {before} vertices before it")
    return number - 1 if number > 0 else before + number
