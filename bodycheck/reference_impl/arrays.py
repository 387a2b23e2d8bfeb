"""The array type used throughout reference_impl, and the largest of vectors."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of doubles. The docstring of each function that takes or returns one states its shape."""


def largest_norm(vectors: Array) -> float:
    """max |v| of vectors (n, components); 0 for none."""
    return float(np.max(np.linalg.norm(vectors, axis=-1), initial=0.0))
