"""What the tables of a scenario file are made of: numbers, vectors, and keys that are still to come."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, PlainValidator, ValidationInfo

Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive: TypeAlias = Annotated[Number, Field(gt=0.0)]
Vector: TypeAlias = tuple[Number, Number, Number]
Quaternion: TypeAlias = tuple[Number, Number, Number, Number]
Matrix: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def _refuse(_: Any, info: ValidationInfo) -> None:
    """Refuse a key of the format that is not built so far, by a message that says so."""
    raise ValueError(f"{info.field_name} is not yet supported")


NotYet: TypeAlias = Annotated[None, PlainValidator(_refuse)]


class Table(BaseModel):
    """A table of the file: no other keys than its own, and nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True)
