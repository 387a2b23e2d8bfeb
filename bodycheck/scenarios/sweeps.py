"""[[sweep]]: one file for a family of scenarios, which differ in the value of one key."""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from typing import Annotated, Any, TypeAlias

from pydantic import Field, PlainValidator, StrictStr, field_validator

from bodycheck.scenarios.fields import Table, finite_numbers

_STEP = re.compile(r"(?:^|\.)([A-Za-z_]\w*)|\[(\d+)\]")


def _number_or_text(value: Any) -> float | str:
    return value if isinstance(value, str) else float(finite_numbers(value, "a number or a text", ()))


_Value: TypeAlias = Annotated[float | str, PlainValidator(_number_or_text)]


class Sweep(Table):
    """The key that differs, as a path within the file, and its values."""

    key: StrictStr
    values: Annotated[tuple[_Value, ...], Field(min_length=1)]

    @field_validator("key")
    @classmethod
    def _a_path(cls, value: str) -> str:
        if "".join(match.group() for match in _STEP.finditer(value)) != value or not value:
            raise ValueError("must be a path in the file, like initial.omega_body_rad_s[0]")
        if value.partition(".")[0] in ("name", "sweep"):
            raise ValueError(f"cannot be {value!r}: the children get their names from the values")
        return value

    @field_validator("values")
    @classmethod
    def _different(cls, value: tuple[float | str, ...]) -> tuple[float | str, ...]:
        if len({label(one) for one in value}) < len(value):
            raise ValueError("names a value twice")
        return value


class Family(Table):
    """The part of a file that makes it a family."""

    sweep: Annotated[tuple[Sweep, ...], Field(min_length=1, max_length=1)]


def label(value: float | str) -> str:
    """Return a value as it stands in the name of its child."""
    return value if isinstance(value, str) else repr(value)


def children(data: dict[str, Any], sweep: Sweep) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield for each value its label and the file with it in place.

    Raises ValueError where the key's path leads nowhere.
    """
    for value in sweep.values:
        child = copy.deepcopy(data)
        _put(child, sweep.key, value)
        if isinstance(data.get("name"), str):
            child["name"] = f"{data['name']}/{label(value)}"
        yield label(value), child


def _put(data: Any, key: str, value: float | str) -> None:
    """data.key = value; the key itself may be new, what leads to it must be there."""
    *path, last = [name or int(index) for name, index in _STEP.findall(key)]
    place = data
    for step in path:
        if not _has(place, step):
            raise ValueError(f"{key!r} leads nowhere in this file: there is no {step!r}")
        place = place[step]
    if not isinstance(place, dict if isinstance(last, str) else list) or (
        isinstance(last, int) and not _has(place, last)
    ):
        raise ValueError(f"{key!r} leads nowhere in this file: there is no place for {last!r}")
    place[last] = value


def _has(place: Any, step: int | str) -> bool:
    if isinstance(step, int):
        return isinstance(place, list) and step < len(place)
    return isinstance(place, dict) and step in place
