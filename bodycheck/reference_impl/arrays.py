"""The array type used throughout reference_impl, the largest of vectors, and systems of equations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of doubles. The docstring of each function that takes or returns one states its shape."""


def largest_norm(vectors: Array) -> float:
    """max |v| of vectors (n, components); 0 for none."""
    return float(np.max(np.linalg.norm(vectors, axis=-1), initial=0.0))


def solved(matrix: Array, vector: Array) -> Array:
    """x (..., n) of A x = b; NaN where A (..., n, n) is singular, as in a step that has no solution."""
    return _of_regular(matrix, lambda regular: np.linalg.solve(regular, vector[..., None])[..., 0])


def inverted(matrix: Array) -> Array:
    """A^-1 (..., n, n); NaN where A is singular."""
    return _of_regular(matrix, np.linalg.inv)


def _of_regular(matrix: Array, found: Callable[[Array], Any]) -> Array:
    try:
        return np.asarray(found(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        singular = ~(np.abs(np.linalg.det(matrix)) > 0.0)[..., None, None]
        return np.asarray(found(np.where(singular, np.nan, matrix)), dtype=np.float64)
