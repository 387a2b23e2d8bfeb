"""Find the lines that cannot be told apart, which plots draw as one line with the names of all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from bodycheck.reference_impl.arrays import Array

ALIKE = 2e-3
"""Lines are equal if they differ by at most this much at every point, relative to their values."""

Key = TypeVar("Key")


def merged(lines: Mapping[Key, tuple[Array, Array]], floor: float = 0.0) -> list[list[Key]]:
    """Return the keys of equal lines together, in the order of `lines`.

    lines: abscissas and values >= 0, each (n,). floor: values up to it cannot be told apart.
    """
    groups: list[list[Key]] = []
    for key, line in lines.items():
        for group in groups:
            if _alike(lines[group[0]], line, floor):
                group.append(key)
                break
        else:
            groups.append([key])
    return groups


def _alike(first: tuple[Array, Array], second: tuple[Array, Array], floor: float) -> bool:
    (x, y), (abscissas, values) = first, second
    if len(x) != len(abscissas) or len(y) != len(values) or _differ(float(y[-1]), float(values[-1]), floor):
        return False  # the last value alone settles most pairs
    if not np.array_equal(x, abscissas):
        return False
    larger = np.maximum(y, values)
    return bool(np.all((np.abs(y - values) <= ALIKE * larger) | (larger <= floor)))


def _differ(one: float, other: float, floor: float) -> bool:
    larger = max(one, other)
    return larger > floor and abs(one - other) > ALIKE * larger
