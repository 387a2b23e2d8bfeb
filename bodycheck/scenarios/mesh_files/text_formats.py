"""Shared by the readers of text formats: split lines, parse numbers, triangulate polygons."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles


def split_lines(lines: Iterable[bytes], first: int = 1) -> Iterator[tuple[int, list[str]]]:
    """Yield (line number, words) of each line that is not blank, counting from `first`."""
    for number, line in enumerate(lines, first):
        words = line.decode("utf-8", errors="replace").split()
        if words:
            yield number, words


def floats(words: Sequence[str], line: int) -> list[float]:
    """Return words as floats. Raises ValueError with the line number."""
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError(f"line {line}: not all of {quoted(words)} are numbers") from None


def integer(word: str, line: int) -> int:
    """Return a word as an integer of at most 31 bits. Raises ValueError with the line number."""
    try:
        value = int(word)
    except ValueError:
        raise ValueError(f"line {line}: {quoted([word])} is not an integer") from None
    if abs(value) >= 1 << 31:
        raise ValueError(f"line {line}: {quoted([word])} is out of range")
    return value


def quoted(words: Iterable[str]) -> str:
    """Return words for a message: quoted, printable, at most 60 characters."""
    text = " ".join(words)
    return repr(text if len(text) <= 60 else text[:57] + "...")


def points(coordinates: array[float]) -> Array:
    """Return consecutive coordinates (3 n,) as an array (n, 3); n may be zero."""
    return np.asarray(coordinates, dtype=np.float64).reshape(-1, 3)


def fans(lengths: NDArray[np.integer[Any]], corners: NDArray[np.integer[Any]]) -> Triangles:
    """Split polygons, of `lengths` (k,) of the `corners` (l,), into triangles (m, 3) about the first."""
    if (lengths == 3).all():
        return np.ascontiguousarray(corners.reshape(-1, 3), dtype=np.int64)
    count = lengths.astype(np.int64) - 2
    first = np.repeat(np.cumsum(lengths) - lengths, count)
    step = np.arange(1, len(first) + 1) - np.repeat(np.cumsum(count) - count, count)
    found = np.empty((len(first), 3), dtype=np.int64)
    found[:, 0], found[:, 1], found[:, 2] = corners[first], corners[first + step], corners[first + step + 1]
    return found
