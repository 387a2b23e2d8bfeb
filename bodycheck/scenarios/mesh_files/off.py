"""OFF, ASCII: counts, then a line per vertex and a line per polygon.

Source: Geomview manual (1996), Object File Format.
"""

from __future__ import annotations

import re
from array import array
from io import BufferedIOBase
from itertools import islice

import numpy as np

from bodycheck._util.formatting import count
from bodycheck.scenarios.mesh_files.polygons import Polygons
from bodycheck.scenarios.mesh_files.text_formats import (
    encoding_notes,
    encoding_of,
    floats,
    integer,
    points,
    quoted,
    split_lines,
)

_KEYWORD = re.compile("(ST)?C?N?OFF", re.IGNORECASE)


def parse_off(file: BufferedIOBase) -> Polygons:
    """Return the polygons of a file. Raises ValueError with the line and what is wrong.

    Texture coordinates, colours and normals, which follow the numbers that are needed, are ignored.
    """
    notes = encoding_notes(encoding_of(file))
    lines = split_lines(file, comment="#")
    line, words = next(lines, (1, [""]))
    if _KEYWORD.fullmatch(words[0]):
        words = words[1:]
        if [word.upper() for word in words] == ["BINARY"]:
            raise ValueError("a binary OFF file; only text is read")
        if not words:
            line, words = next(lines, (line + 1, [""]))
    if len(words) not in (2, 3) or not all(word.isdecimal() for word in words):
        raise ValueError(
            f"line {line}: not an OFF file: {quoted(words)} are not its numbers of vertices and faces"
        )
    vertices, lengths, corners = array("d"), array("i"), array("i")
    n, k = (integer(word, line) for word in words[:2])
    for line, words in islice(lines, n):
        if len(words) < 3:
            raise ValueError(f"line {line}: {quoted(words)} has fewer than three coordinates")
        vertices.extend(floats(words[:3], line))
    for line, words in islice(lines, k):
        length = integer(words[0], line)
        face = [integer(word, line) for word in words[1 : length + 1]]
        if not 3 <= length == len(face):
            raise ValueError(
                f"line {line}: {quoted(words)} is not a number of corners, at least 3, and the corners"
            )
        if wrong := [corner for corner in face if not 0 <= corner < n]:
            raise ValueError(f"line {line}: corner {wrong[0]} is not one of the {n} vertices, 0 to {n - 1}")
        lengths.append(length)
        corners.extend(face)
    if len(vertices) < 3 * n or len(lengths) < k:
        raise ValueError(f"ends after {len(vertices) // 3} of {n} vertices and {len(lengths)} of {k} faces")
    if more := sum(1 for _ in lines):
        notes += (f"ignored: {count(more, 'line')} after the last face",)
    return Polygons(points(vertices), np.asarray(lengths), np.asarray(corners), notes)
