"""What the tables of a scenario file are made of: numbers, vectors, unit quaternions."""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from bodycheck.reference_impl.rotations import normalised

_UNIT_TOLERANCE = 1e-6  # how far a quaternion's norm may be from 1

Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive: TypeAlias = Annotated[Number, Field(gt=0.0)]
NotNegative: TypeAlias = Annotated[Number, Field(ge=0.0)]
Vector: TypeAlias = tuple[Number, Number, Number]
Matrix: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

ZERO: Vector = (0.0, 0.0, 0.0)

_Four: TypeAlias = tuple[Number, Number, Number, Number]


def _unit(value: _Four, info: ValidationInfo) -> _Four:
    norm = math.hypot(*value)
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise ValueError(f"must be a unit quaternion (w, x, y, z); its norm is {norm:.9g}")
    if norm == 1.0 or (info.context or {}).get("written"):  # made unit twice it may move by an ulp
        return value
    w, x, y, z = normalised(np.array(value)).tolist()
    return (w, x, y, z)


UnitQuaternion: TypeAlias = Annotated[_Four, AfterValidator(_unit)]
"""(w, x, y, z), made unit where it nearly is."""

ALIGNED: UnitQuaternion = (1.0, 0.0, 0.0, 0.0)


class Table(BaseModel):
    """A table of the file: no other keys than its own, and nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)
