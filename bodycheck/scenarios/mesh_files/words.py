"""What the readers of text formats share: lines as words, words as numbers, polygons as triangles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.mass_properties.solid import Triangles


def lines_of_words(text: bytes, first: int = 1) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each line that is not blank, counted from `first`, and its words."""
    for number, line in enumerate(text.decode("utf-8", errors="replace").split("\n"), first):
        words = line.split()
        if words:
            yield number, words


def floats(words: Sequence[str], line: int) -> list[float]:
    """Return words as floats. Raises ValueError naming the line."""
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError(f"line {line}: {shown(words)} are not all numbers") from None


def integer(word: str, line: int) -> int:
    """Return a word as an integer of at most 31 bits. Raises ValueError naming the line."""
    try:
        value = int(word)
    except ValueError:
        raise ValueError(f"line {line}: {shown([word])} is not a whole number") from None
    if abs(value) >= 1 << 31:
        raise ValueError(f"line {line}: {shown([word])} is out of range")
    return value


def shown(words: Iterable[str]) -> str:
    """Return words as a message shows them: quoted, printable, not too long."""
    text = " ".join(words)
    return repr(text if len(text) <= 60 else text[:57] + "...")


def points(rows: Sequence[Sequence[float]]) -> Array:
    """Return rows of three coordinates as an array (n, 3), also where there are none."""
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def fans(polygons: Iterable[Sequence[int]]) -> Triangles:
    """Cut polygons into triangles (m, 3) about their first corners."""
    triangles = [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]
    return np.array(triangles, dtype=np.int64).reshape(-1, 3)
