"""Vertices with the same coordinates made one, as a mesh needs them that names its corners per triangle."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.jit import kernel

_EMPTY = -1
_SLOTS = 1 << 10
"""The hash table's first size, a power of two."""


def merged(vertices: NDArray[np.floating[Any]]) -> tuple[Array, NDArray[np.int32]]:
    """Return the different vertices (k, 3), in order of appearance, and the number (n,) of each given one.

    Shape: (n, 3), finite, of 32 or 64 bits. Equal means equal coordinates, bit for bit but for the sign of
    zero: whatever a tolerance would join might be a thin wall.
    """
    kinds, number = _kinds(np.ascontiguousarray(vertices), _SLOTS)
    return kinds, number


@kernel
def _slot(x: float, y: float, z: float, mask: int) -> np.int64:
    """Return a slot from 0 to mask, a power of two less one: multiply, xor and shift (Steele 2014)."""
    mixed = np.uint64(0)
    for coordinate in (x, y, z):
        mixed ^= np.float64(coordinate).view(np.uint64)
        mixed *= np.uint64(0x9E3779B97F4A7C15)  # wraps, as it should
        mixed ^= mixed >> np.uint64(29)
    mixed ^= mixed >> np.uint64(32)  # else a sign never reaches the last bits
    return np.int64(mixed & np.uint64(mask))


@kernel
def _find(kinds: Array, slots: NDArray[np.int32], x: float, y: float, z: float) -> int:
    """Return the slot that holds (x, y, z), or the empty one where it belongs: open addressing."""
    mask = len(slots) - 1
    slot = _slot(x, y, z, mask)
    while slots[slot] != _EMPTY:
        kind = slots[slot]
        if kinds[kind, 0] == x and kinds[kind, 1] == y and kinds[kind, 2] == z:
            break
        slot = (slot + 1) & mask
    return slot


@kernel
def _grown(kinds: Array, slots: NDArray[np.int32], count: int) -> tuple[Array, NDArray[np.int32]]:
    """Return a table of twice the size with the same kinds in it, and room for as many more."""
    larger = np.full(2 * len(slots), _EMPTY, dtype=np.int32)
    room = np.empty((len(slots), 3))
    room[:count] = kinds[:count]
    for kind in range(count):
        larger[_find(room, larger, room[kind, 0], room[kind, 1], room[kind, 2])] = kind
    return room, larger


@kernel
def _kinds(vertices: NDArray[np.floating[Any]], size: int) -> tuple[Array, NDArray[np.int32]]:
    """Return the kinds (k, 3) and the kind (n,) of every row, by a hash table that is at most half full."""
    slots = np.full(size, _EMPTY, dtype=np.int32)
    kinds = np.empty((size // 2, 3))
    number = np.empty(len(vertices), dtype=np.int32)
    count = 0
    for row in range(len(vertices)):
        x, y, z = vertices[row, 0] + 0.0, vertices[row, 1] + 0.0, vertices[row, 2] + 0.0  # no -0.0
        slot = _find(kinds, slots, x, y, z)
        if slots[slot] == _EMPTY:
            if count == len(kinds):
                kinds, slots = _grown(kinds, slots, count)
                slot = _find(kinds, slots, x, y, z)
            kinds[count, 0], kinds[count, 1], kinds[count, 2] = x, y, z
            slots[slot] = count
            count += 1
        number[row] = slots[slot]
    return kinds[:count].copy(), number
