"""The tables of a scenario file with [[body]] tables: joints, bodies and what acts on them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, Union

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    StrictStr,
    Tag,
    create_model,
)

from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation
from bodycheck.reference_impl.trees.joint_kinds import joint_kinds
from bodycheck.reference_impl.trees.tree_scene import Joint, JointSineTorque, JointTorque
from bodycheck.scenarios.body import (
    FILE,
    GIVEN,
    MESH,
    SHAPE,
    FileBody,
    GivenBody,
    MeshBody,
    ShapeBody,
    form_of,
)
from bodycheck.scenarios.fields import (
    ALIGNED,
    ZERO,
    NearlyUnitQuaternion,
    NotNegative,
    Number,
    TomlTable,
    Vector,
    finite_numbers,
)
from bodycheck.scenarios.forcings import FORCING_TABLES, ForcingTable, GravityTable, TimedTable
from bodycheck.scenarios.model import rounded_to_unit

WORLD_NAME = "world"
"""The parent of a body that no other carries."""

JOINT_KINDS = {
    name: kind for name, kind in joint_kinds().items() if kind.translation is not Translation.SPACE
}
"""The kinds of [body.joint], by name; a body without one is free."""

# ------------------------------------------------------------------------------------------------- joints


def _up_to(limit: float) -> AfterValidator:
    def check(value: float) -> float:
        if abs(value) > limit:
            raise ValueError(f"numbers above {limit:g} are not supported")
        return value

    return AfterValidator(check)


def _not_zero(value: Vector) -> Vector:
    if not any(value):
        raise ValueError("must not be of length 0")
    return value


_Number: TypeAlias = Annotated[Number, _up_to(1e50)]  # its square and cube are doubles
_Vector: TypeAlias = tuple[_Number, _Number, _Number]
_Axis: TypeAlias = Annotated[Vector, AfterValidator(_not_zero)]
_Name: TypeAlias = Annotated[StrictStr, Field(pattern=r"^[\w-]+$")]
_Angle: TypeAlias = Annotated[Number, _up_to(1e12)]  # its sine is known to double-doubles


class JointTable(TomlTable):
    """[body.joint]: how a body is connected to its parent; its points are given from the centres."""

    of_kind: ClassVar[JointKind]

    kind: str
    parent: StrictStr = WORLD_NAME
    at_parent_m: _Vector = ZERO
    at_body_m: _Vector = ZERO
    quaternion: NearlyUnitQuaternion = ALIGNED

    def joint(self, parent: int) -> Joint:
        """Return the same with unit vectors rounded to doubles; parent: an index, or WORLD."""
        given = self.model_dump()
        start = [given[name] for name in ("start_m", "start_rad") if name in given]
        rate = [given[name] for name in ("rate_m_s", "rate_rad_s") if name in given]
        names = {"stiffness": "stiffness_n_m", "rest": "rest_", "damping": "damping_"}
        own = {
            name: value for name, key in names.items() for has, value in given.items() if has.startswith(key)
        }
        if self.of_kind.has_axis:
            own["axis"] = rounded_to_unit(given["axis"])
        return Joint(
            self.kind,
            parent,
            np.array(self.at_parent_m),
            np.array(self.at_body_m),
            rounded_to_unit(self.quaternion),
            start=rounded_to_unit(given["start"]) if "start" in given else np.array(start),
            rate=np.ravel(rate),
            **own,
        )


def unit_of(kind: JointKind) -> str:
    """Return the unit of a kind's coordinate, as in the names of keys."""
    return "rad" if kind.rotation else "m"


def _joint_table(kind: JointKind) -> type[JointTable]:
    """Return the table of a kind of joint: axis, start and rate, spring and damper as far as it has them."""
    own: dict[str, Any] = {"kind": (Literal[kind.name], ...)}
    if kind.has_axis:
        own["axis"] = (_Axis, ...)
    if kind.translation is Translation.AXIS:
        own |= {"start_m": (_Number, 0.0), "rate_m_s": (_Number, 0.0)}
    if kind.rotation is Rotation.AXIS:
        own |= {"start_rad": (_Angle, 0.0), "rate_rad_s": (_Number, 0.0)}
    elif kind.rotation is Rotation.BALL:
        own |= {"start": (NearlyUnitQuaternion, ALIGNED), "rate_rad_s": (_Vector, ZERO)}
    if kind.is_scalar:
        stiffness = {"rad": "stiffness_n_m_rad", "m": "stiffness_n_m"}[unit_of(kind)]
        own |= {stiffness: (NotNegative, 0.0), f"rest_{unit_of(kind)}": (Number, 0.0)}
    if not (kind.rotation and kind.translation):
        own[{"rad": "damping_n_m_s", "m": "damping_n_s_m"}[unit_of(kind)]] = (NotNegative, 0.0)
    made: type[JointTable] = create_model(f"{kind.name.title()}Table", __base__=JointTable, **own)
    made.of_kind = kind
    globals()[made.__name__] = made  # pickle looks a class up in its module
    return made


class _OfKinds:
    """What tells pydantic to read a table by its kind: one of some tables, which state it."""

    def __init__(self, *tables: type[TomlTable]) -> None:
        self._tables = tables

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> Any:
        tables: Any = Union[self._tables]  # noqa: UP007 - as many as there are
        return handler.generate_schema(Annotated[tables, Discriminator("kind")])


def _of_known_kind(kinds: Mapping[str, Any], hints: Mapping[str, str]) -> BeforeValidator:
    """Refuse what is of no kind by a message of its own."""

    def check(value: Any) -> Any:
        if not isinstance(value, dict) or "kind" not in value:
            raise ValueError(f"needs a kind: {', '.join(kinds)}")
        kind = value["kind"]
        if not isinstance(kind, str) or kind not in kinds:
            if hint := hints.get(str(kind)):
                raise ValueError(f"{kind!r} is unsupported in a tree: {hint}")
            raise ValueError(f"unknown kind {kind!r} (available: {', '.join(kinds)})")
        return value

    return BeforeValidator(check)


_Joint: TypeAlias = Annotated[
    JointTable, _OfKinds(*map(_joint_table, JOINT_KINDS.values())), _of_known_kind(JOINT_KINDS, {})
]

# ------------------------------------------------------------------------------------------------- bodies


def _body_table(base: type[Any]) -> Any:
    made = create_model(
        f"Tree{base.__name__}",
        __base__=base,
        name=(_Name, ...),
        joint=(_Joint | None, None),
    )
    globals()[made.__name__] = made  # pickle looks a class up in its module
    return made


_FORMS = {
    form: _body_table(base)
    for form, base in {GIVEN: GivenBody, MESH: MeshBody, SHAPE: ShapeBody, FILE: FileBody}.items()
}


class _OneOfTheForms:
    """What tells pydantic to read a body by its keys."""

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> Any:
        tables: Any = Union[tuple(Annotated[table, Tag(form)] for form, table in _FORMS.items())]  # noqa: UP007
        return handler.generate_schema(Annotated[tables, Discriminator(form_of)])


TreeBodyTable: TypeAlias = Annotated[Any, _OneOfTheForms()]

# ----------------------------------------------------------------------------------------------- forcings


def _on_a_body(table: type[ForcingTable]) -> type[ForcingTable]:
    made = create_model(f"Tree{table.__name__}", __base__=table, body=(StrictStr, ...))
    globals()[made.__name__] = made  # pickle looks a class up in its module
    return made


def _number_or_three(value: Any) -> float | Vector:
    numbers = finite_numbers(value, "a number, or three for a ball", (), (3,))
    return float(numbers) if numbers.shape == () else tuple(numbers.tolist())


class JointTorqueTable(TimedTable):
    """A constant torque about a hinge or at a ball, or a constant force along a slide, from the parent."""

    kind: Literal["joint-torque"]
    body: StrictStr
    value_n_m: Annotated[float | Vector | None, BeforeValidator(_number_or_three)] = None
    value_n: Number | None = None

    def load(self, body: int) -> JointTorque:
        """Return the same on the body with this index."""
        value = self.value_n if self.value_n_m is None else self.value_n_m
        until = np.inf if self.until_s is None else self.until_s
        return JointTorque(body, np.atleast_1d(np.array(value, dtype=np.float64)), self.from_s, until)


class JointSineTorqueTable(ForcingTable):
    """amplitude sin(rate t + phase) about a hinge or along a slide."""

    kind: Literal["joint-sine-torque"]
    body: StrictStr
    amplitude_n_m: Number | None = None
    amplitude_n: Number | None = None
    rate_rad_s: Number
    phase_rad: Number = 0.0

    def load(self, body: int) -> JointSineTorque:
        """Return the same on the body with this index."""
        amplitude = self.amplitude_n if self.amplitude_n_m is None else self.amplitude_n_m
        assert amplitude is not None
        return JointSineTorque(body, amplitude, self.rate_rad_s, self.phase_rad)


TREE_FORCINGS: dict[str, type[ForcingTable]] = {
    "torque": _on_a_body(FORCING_TABLES["torque"]),
    "force": _on_a_body(FORCING_TABLES["force"]),
    "gravity": GravityTable,
    "joint-torque": JointTorqueTable,
    "joint-sine-torque": JointSineTorqueTable,
}
"""The kinds of [[forcing]] in a tree."""

_UNSUPPORTED = {
    **{kind: f"available: {', '.join(TREE_FORCINGS)}" for kind in FORCING_TABLES},
    "pivot": "use a joint of kind 'ball'",
}
TreeForcing: TypeAlias = Annotated[
    ForcingTable,
    _OfKinds(*TREE_FORCINGS.values()),
    _of_known_kind(TREE_FORCINGS, _UNSUPPORTED),
]
