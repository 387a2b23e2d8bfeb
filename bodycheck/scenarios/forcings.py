"""[[forcing]]: what acts on the body, one table per kind; those of loads follow from their keys."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, TypeAlias, Union

import numpy as np
from pydantic import (
    BeforeValidator,
    Discriminator,
    GetCoreSchemaHandler,
    PlainSerializer,
    PlainValidator,
    ValidationInfo,
    create_model,
    field_validator,
)

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import REQUIRED, Key, KeyForm
from bodycheck.reference_impl.scene import CallbackLoad, GravityGradient, Load
from bodycheck.scenarios.fields import (
    Matrix,
    NotNegative,
    Number,
    Positive,
    TomlTable,
    Vector,
    finite_numbers,
    rows,
)
from bodycheck.scenarios.user_functions import UserWrench, user_function

_Axes: TypeAlias = Literal["body", "world"]


class ForcingTable(TomlTable):
    """One table of [[forcing]]."""

    kind: str


class LoadTable(ForcingTable):
    """The constants of a load, by the names and units of the scenario format."""

    load_type: ClassVar[type[Load]]

    def load(self) -> Load:
        """Return the same as arrays."""
        return self.load_type(
            **{name: _constant(getattr(self, key.name), key) for name, key in self.load_type.keys().items()}
        )


def _constant(value: Any, key: Key) -> Any:
    """Return a value of a table as the load has it; what the table leaves out as None is infinite."""
    if value is None:
        return key.omitted
    return np.array(value) if isinstance(value, tuple) else value


class TimedTable(ForcingTable):
    """A table of what acts within an interval of time."""

    from_s: Number = 0.0
    until_s: Number | None = None

    @field_validator("until_s")
    @classmethod
    def _after_from(cls, value: float | None, info: ValidationInfo) -> float | None:
        start = info.data.get("from_s")
        if value is not None and start is not None and not value > start:
            raise ValueError(f"must be later than from_s = {start!r}")
        return value


class _SwitchedTable(LoadTable, TimedTable):
    axes: _Axes


class GravityTable(ForcingTable):
    """Uniform gravity, in world axes: no load, but the scene's own."""

    kind: Literal["gravity"]
    acceleration_m_s2: Vector


def _damping(value: Any) -> Matrix:
    """Accept a number or a 3x3 matrix that takes energy away."""
    matrix = finite_numbers(value, "a number or a 3x3 matrix of numbers", (), (3, 3))
    matrix = matrix * np.eye(3) if matrix.shape == () else matrix
    smallest = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
    if smallest < -1e-12 * float(np.max(np.abs(matrix))):
        raise ValueError(f"must be dissipative: omega . C omega would reach {smallest:.6g} |omega|^2")
    return rows(matrix)


_FORMS: dict[KeyForm, Any] = {
    "number": Number,
    "positive": Positive,
    "not negative": NotNegative,
    "vector": Vector,
    "damping matrix": Annotated[Matrix, BeforeValidator(_damping, json_schema_input_type=Number | Matrix)],
    "axes": _Axes,
}


def _table(kind: str, load_type: type[Load]) -> type[LoadTable]:
    """Return the table of a load, made of its keys."""
    keys = load_type.keys().values()
    base = _SwitchedTable if "until_s" in {key.name for key in keys} else LoadTable
    own: dict[str, Any] = {
        key.name: (_FORMS[key.form], ... if key.omitted is REQUIRED else key.omitted)
        for key in keys
        if key.name not in base.model_fields
    }
    own["kind"] = (Literal[kind], ...)
    made: type[LoadTable] = create_model(
        f"{load_type.__name__}Table", __base__=base, __doc__=load_type.__doc__, **own
    )
    made.load_type = load_type
    globals()[made.__name__] = made  # pickle looks a class up in its module
    return made


def _user_wrench(value: Any, info: ValidationInfo) -> UserWrench:
    """Import the function, where the reading's context allows code."""
    if not isinstance(value, str):
        raise ValueError("needs the name of a function, like package.module:function")
    context = info.context or {}
    allow_code = bool(context.get("allow_code"))
    return UserWrench(value, user_function(value, allow_code=allow_code, file=context.get("file")))


class CallableTable(LoadTable):
    """A force and a torque given only as a function."""

    kind: Literal["callable"]
    function: Annotated[
        UserWrench,
        PlainValidator(_user_wrench, json_schema_input_type=str),
        PlainSerializer(lambda f: f.name),
    ]

    def load(self) -> Load:
        """Return the same as a load."""
        return CallbackLoad(self.function.name, self.function)


class PivotTable(ForcingTable):
    """A point of the body that stays where it is at the start: no load, but the scene's own."""

    kind: Literal["pivot"]
    at_m: Vector


FORCING_TABLES: dict[str, type[ForcingTable]] = {
    **{kind: _table(kind, load_type) for kind, load_type in load_kinds().items()},
    CallbackLoad.kind: CallableTable,
    "gravity": GravityTable,
    "pivot": PivotTable,
}

FORCING_KINDS = tuple(FORCING_TABLES)
JOINT_FORCINGS = {"joint-torque": "value", "joint-sine-torque": "amplitude"}
"""Kinds that act on the joints of trees, with their key, to which a unit is added."""


def _known_kind(value: Any) -> Any:
    """Refuse what is of no kind by a message of its own, before the union does."""
    if not isinstance(value, dict) or "kind" not in value:
        raise ValueError(f"needs a kind: {', '.join(FORCING_KINDS)}")
    if value["kind"] not in FORCING_KINDS:
        raise ValueError(f"unknown kind {value['kind']!r} (available: {', '.join(FORCING_KINDS)})")
    return value


class _OneOfTheTables:
    """What tells pydantic to read a table by its kind."""

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> Any:
        tables: Any = Union[tuple(FORCING_TABLES.values())]  # noqa: UP007 - as many as there are
        return handler.generate_schema(Annotated[tables, Discriminator("kind")])


Forcing: TypeAlias = Annotated[ForcingTable, _OneOfTheTables(), BeforeValidator(_known_kind)]


def loads_of(forcings: tuple[Forcing, ...]) -> tuple[Load, ...]:
    """Return the loads among the forcings, in their order."""
    return tuple(f.load() for f in forcings if isinstance(f, LoadTable))


def gravity_of(forcings: tuple[Forcing, ...]) -> Array:
    """Return the sum of the accelerations of gravity (3,), m/s^2, world axes."""
    gravities = [np.array(f.acceleration_m_s2) for f in forcings if isinstance(f, GravityTable)]
    return sum(gravities, start=np.zeros(3))


def pivot_of(forcings: tuple[Forcing, ...]) -> Array | None:
    """Return the pivot (3,) from the centre of mass in body axes, m; None where there is none."""
    return next((np.array(f.at_m) for f in forcings if isinstance(f, PivotTable)), None)


def check_together(forcings: tuple[Forcing, ...]) -> None:
    """Refuse, by ValueError, forcings that cannot act together."""
    kinds = [f.kind for f in forcings]
    for kind in ("pivot", GravityGradient.kind):
        places = [i for i, one in enumerate(kinds) if one == kind]
        if len(places) > 1:
            raise ValueError(f"has {len(places)} of kind {kind!r}, at {places}; there can be one at most")
    if {"pivot", GravityGradient.kind} <= set(kinds):
        raise ValueError("a body with a pivot is not in orbit: omit 'pivot' or 'gravity-gradient'")
