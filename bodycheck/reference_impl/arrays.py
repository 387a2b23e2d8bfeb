"""The array type used all over reference_impl."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""An array of doubles; its shape stands in the docstring of whatever takes or returns it."""
