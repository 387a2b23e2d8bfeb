"""The array type used throughout reference_impl."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of doubles. The docstring of each function that takes or returns one states its shape."""
