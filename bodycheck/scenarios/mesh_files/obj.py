"""Wavefront OBJ: `v` lines are vertices, `f` lines polygons; everything else is ignored.

Source: Alias|Wavefront (1993), Advanced Visualizer manual, appendix B1.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from io import BufferedIOBase

import numpy as np

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

_CURVED = ("surf", "curv", "cstype")


def parse_obj(file: BufferedIOBase) -> Polygons:
    """Return the polygons of a file. Raises ValueError with the line and what is wrong.

    All objects and groups of the file are one mesh. A corner is `v`, `v/vt`, `v//vn` or `v/vt/vn`; a
    negative v counts back from the last vertex before its line.
    """
    notes = encoding_notes(encoding_of(file))
    vertices, lengths, corners = array("d"), array("i"), array("i")
    ahead: list[tuple[int, int]] = []  # lines with a reference to a later vertex than any before
    for line, words in _statements(file):
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
            case curved if curved in _CURVED:
                raise ValueError(f"line {line}: {curved!r} is a curved surface; only polygons are read")
    for line, corner in ahead:
        if 3 * corner >= len(vertices):
            known = len(vertices) // 3
            raise ValueError(f"line {line}: corner {corner + 1} is not one of the {known} vertices")
    return Polygons(points(vertices), np.asarray(lengths), np.asarray(corners), notes)


def _statements(file: BufferedIOBase) -> Iterator[tuple[int, list[str]]]:
    """Yield the line and the words of each statement; a backslash continues it in the next line."""
    begun, words = 0, list[str]()
    for line, more in split_lines(file, comment="#"):
        begun, words = begun or line, words + more
        if words[-1].endswith("\\"):
            words[-1:] = filter(None, [words[-1][:-1]])
            continue
        yield begun, words
        begun, words = 0, []
    if words:
        yield begun, words


def _corner(word: str, line: int, before: int) -> int:
    """Return the vertex index, from 0, of a face's corner; `before`: number of vertices before its line."""
    number = integer(word.partition("/")[0], line)
    if number == 0 or number < -before:
        raise ValueError(f"line {line}: corner {number} is not one of the {before} vertices before it")
    return number - 1 if number > 0 else before + number
