"""Name places on a mesh by coordinates, which stay valid when triangles are removed or turned."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

from bodycheck.reference_impl.arrays import Array

_SHOWN = 3


def place(point: Array) -> str:
    """Return a point (3,) as '(0, 0.5, 1)'."""
    return "(" + ", ".join(f"{x:.6g}" for x in point) + ")"


def first_few(items: Iterable[str]) -> str:
    """Return 'one; two; three; ...'."""
    shown = list(islice(items, _SHOWN + 1))
    return "; ".join(shown[:_SHOWN] + ["..."] * (len(shown) > _SHOWN))
