"""Field types of the tables of a scenario file: numbers, vectors, unit quaternions."""

from __future__ import annotations

import math
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import normalised

_UNIT_TOLERANCE = 1e-6  # deviation of a quaternion's norm from 1

Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive: TypeAlias = Annotated[Number, Field(gt=0.0)]
NotNegative: TypeAlias = Annotated[Number, Field(ge=0.0)]
Vector: TypeAlias = tuple[Number, Number, Number]
Matrix: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

ZERO: Vector = (0.0, 0.0, 0.0)

_Four: TypeAlias = tuple[Number, Number, Number, Number]


def _nearly_unit(value: _Four) -> _Four:
    norm = math.hypot(*value)
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise ValueError(f"must be a unit quaternion (w, x, y, z); its norm is {norm:.9g}")
    return value


def _unit(value: _Four, info: ValidationInfo) -> _Four:
    norm = math.hypot(*_nearly_unit(value))
    if norm == 1.0 or (info.context or {}).get("stored"):  # normalising again may change an ulp
        return value
    w, x, y, z = normalised(np.array(value)).tolist()
    return (w, x, y, z)


UnitQuaternion: TypeAlias = Annotated[_Four, AfterValidator(_unit)]
"""(w, x, y, z) within 1e-6 of unit, normalised."""

NearlyUnitQuaternion: TypeAlias = Annotated[_Four, AfterValidator(_nearly_unit)]
"""(w, x, y, z) within 1e-6 of unit, unchanged."""

ALIGNED: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)


def finite_numbers(value: Any, what: str, *shapes: tuple[int, ...]) -> Array:
    """Return a number or nested lists of numbers, of one of these shapes, as an array (...) of doubles.

    Raises ValueError, which says what is needed, for anything else: a string, a boolean, a ragged list, a
    number that is not finite or of magnitude 1e300 or more.
    """
    try:
        numbers = np.array(value, dtype=object)
    except ValueError:
        numbers = np.empty(0, dtype=object)
    if numbers.shape not in shapes or not all(type(x) in (int, float) for x in numbers.flat):
        raise ValueError(f"needs {what}")
    if not all(abs(x) < 1e300 for x in numbers.flat):  # also false for NaN
        raise ValueError("needs finite numbers")
    return numbers.astype(np.float64)


def rows(matrix: Array) -> Matrix:
    """Return a matrix (3, 3) as nested tuples."""
    return tuple(tuple(row) for row in matrix.tolist())  # type: ignore[return-value]


class TomlTable(BaseModel):
    """A table of a scenario file: immutable, and without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)
