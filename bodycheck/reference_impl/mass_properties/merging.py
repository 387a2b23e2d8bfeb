"""Vertices with the same coordinates made one, as a mesh needs them that names its corners per triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel

_EMPTY = -1


def merged(vertices: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the different vertices (k, 3), in order of appearance, and the number (n,) of each given one.

    Shape: (n, 3), finite. Equal means equal coordinates, bit for bit but for the sign of zero: whatever a
    tolerance would join might be a thin wall.
    """
    vertices = np.ascontiguousarray(vertices + 0.0)  # -0.0 becomes 0.0
    slots = np.full(1 << max(4, 2 * len(vertices)).bit_length(), _EMPTY, dtype=np.int64)
    first, number = _first_of_its_kind(vertices, _hashes(vertices, len(slots)), slots)
    return vertices[first], number


def _hashes(vertices: Array, size: int) -> NDArray[np.int64]:
    """Return a slot (n,) below size, a power of two, for each row: multiply, xor and shift (Steele 2014)."""
    bits = vertices.view(np.uint64)
    mixed = np.zeros(len(vertices), dtype=np.uint64)
    for column in bits.T:
        mixed ^= column
        mixed *= np.uint64(0x9E3779B97F4A7C15)  # wraps, as it should
        mixed ^= mixed >> np.uint64(29)
    return (mixed & np.uint64(size - 1)).astype(np.int64)


@kernel
def _first_of_its_kind(
    vertices: Array, hashes: NDArray[np.int64], slots: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows (k,) that are the first of their kind and the kind (n,) of every row.

    A hash table with open addressing: slots (a power of two of them, more than the rows, all empty) hold
    kinds; a row tries the slots from its hash on until it meets its own kind or an empty one.
    """
    first = np.empty(len(vertices), dtype=np.int64)
    number = np.empty(len(vertices), dtype=np.int64)
    kinds = 0
    for row in range(len(vertices)):
        x, y, z = vertices[row]
        slot = hashes[row]
        while slots[slot] != _EMPTY:
            known = first[slots[slot]]
            if vertices[known, 0] == x and vertices[known, 1] == y and vertices[known, 2] == z:
                break
            slot = (slot + 1) & (len(slots) - 1)
        if slots[slot] == _EMPTY:
            slots[slot] = kinds
            first[kinds] = row
            kinds += 1
        number[row] = slots[slot]
    return first[:kinds].copy(), number
