"""The model of a scenario file with [[body]] tables: bodies connected by joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, Union

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    GetCoreSchemaHandler,
    ModelWrapValidatorHandler,
    StrictStr,
    Tag,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails

from bodycheck._util.formatting import count, suggestion
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rotations import quaternion_product, rotate
from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation
from bodycheck.reference_impl.trees.joint_kinds import joint_kinds
from bodycheck.reference_impl.trees.tree_scene import (
    WORLD,
    BodyLoad,
    Joint,
    JointSineTorque,
    JointTorque,
    TreeBody,
    TreeLoad,
    TreeScene,
)
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
    Table,
    Vector,
    finite_numbers,
)
from bodycheck.scenarios.forcings import (
    FORCING_TABLES,
    ForcingTable,
    GravityTable,
    LoadTable,
    TimedTable,
    gravity_of,
)
from bodycheck.scenarios.model import Initial, ScenarioTable, rounded_to_unit

_WORLD = "world"
_FREE, _BALL = "free", "ball"
_SINGULAR = 1e14  # ratio of M_ii to the pivot: all digits of a double are lost
JOINT_KINDS = {
    name: kind for name, kind in joint_kinds().items() if kind.translation is not Translation.SPACE
}
"""The kinds of [body.joint], by name; a body without one is free."""

# ------------------------------------------------------------------------------------------------- joints


def _not_zero(value: Vector) -> Vector:
    if not any(value):
        raise ValueError("must not be of length 0")
    return value


_Axis: TypeAlias = Annotated[Vector, AfterValidator(_not_zero)]


class JointTable(Table):
    """[body.joint]: how a body is connected to its parent; its points are given from the centres."""

    of_kind: ClassVar[JointKind]

    kind: str
    parent: StrictStr = _WORLD
    at_parent_m: Vector = ZERO
    at_body_m: Vector = ZERO
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


def _unit(kind: JointKind) -> str:
    """Return the unit of a kind's coordinate, as in the names of keys."""
    return "rad" if kind.rotation else "m"


def _joint_table(kind: JointKind) -> type[JointTable]:
    """Return the table of a kind of joint: axis, start and rate, spring and damper as far as it has them."""
    own: dict[str, Any] = {"kind": (Literal[kind.name], ...)}
    if kind.has_axis:
        own["axis"] = (_Axis, ...)
    if kind.translation is Translation.AXIS:
        own |= {"start_m": (Number, 0.0), "rate_m_s": (Number, 0.0)}
    if kind.rotation is Rotation.AXIS:
        own |= {"start_rad": (Number, 0.0), "rate_rad_s": (Number, 0.0)}
    elif kind.rotation is Rotation.BALL:
        own |= {"start": (NearlyUnitQuaternion, ALIGNED), "rate_rad_s": (Vector, ZERO)}
    if kind.is_scalar:
        stiffness = {"rad": "stiffness_n_m_rad", "m": "stiffness_n_m"}[_unit(kind)]
        own |= {stiffness: (NotNegative, 0.0), f"rest_{_unit(kind)}": (Number, 0.0)}
    if not (kind.rotation and kind.translation):
        own[{"rad": "damping_n_m_s", "m": "damping_n_s_m"}[_unit(kind)]] = (NotNegative, 0.0)
    made: type[JointTable] = create_model(f"{kind.name.title()}Table", __base__=JointTable, **own)
    made.of_kind = kind
    globals()[made.__name__] = made  # pickle looks a class up in its module
    return made


class _OfKinds:
    """What tells pydantic to read a table by its kind: one of some tables, which state it."""

    def __init__(self, *tables: type[Table]) -> None:
        self._tables = tables

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> Any:
        tables: Any = Union[self._tables]  # noqa: UP007 - as many as there are
        return handler.generate_schema(Annotated[tables, Discriminator("kind")])


def _of_known_kind(kinds: Mapping[str, Any], hints: Mapping[str, str]) -> BeforeValidator:
    """Refuse what is of no kind by a message of its own."""

    def check(value: Any) -> Any:
        if not isinstance(value, dict) or "kind" not in value:
            raise ValueError(f"needs a kind: {', '.join(kinds)}")
        if value["kind"] not in kinds:
            if hint := hints.get(str(value["kind"])):
                raise ValueError(f"{value['kind']!r} is unsupported in a tree: {hint}")
            raise ValueError(f"unknown kind {value['kind']!r} (available: {', '.join(kinds)})")
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
        name=(Annotated[StrictStr, Field(min_length=1)], ...),
        joint=(_Joint | None, None),
    )
    globals()[made.__name__] = made  # pickle looks a class up in its module
    return made


_FORMS = {GIVEN: GivenBody, MESH: MeshBody, SHAPE: ShapeBody, FILE: FileBody}


class _OneOfTheForms:
    """What tells pydantic to read a body by its keys."""

    def __get_pydantic_core_schema__(self, _: Any, handler: GetCoreSchemaHandler) -> Any:
        tables: Any = Union[tuple(Annotated[_body_table(base), Tag(form)] for form, base in _FORMS.items())]  # noqa: UP007
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


_JOINT_FORCINGS = {"joint-torque": "value", "joint-sine-torque": "amplitude"}
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
_Forcing: TypeAlias = Annotated[
    ForcingTable,
    _OfKinds(*TREE_FORCINGS.values()),
    _of_known_kind(TREE_FORCINGS, _UNSUPPORTED),
]

# --------------------------------------------------------------------------------------------------- tree


class TreeScenario(ScenarioTable):
    """One scenario file of a tree: its bodies, the start of a free first body, and the loads."""

    body: Annotated[tuple[TreeBodyTable, ...], Field(min_length=1)]
    initial: Initial | None = None
    forcing: tuple[_Forcing, ...] = ()

    @model_validator(mode="wrap")
    @classmethod
    def _connected(cls, data: Any, handler: ModelWrapValidatorHandler[TreeScenario]) -> TreeScenario:
        """Report, with all other faults of the file, what is wrong between its tables."""
        faults = [_fault(loc, text) for loc, text in _connection_faults(data)]
        try:
            made = handler(data)
        except ValidationError as error:
            faults = [*(_again(one) for one in error.errors(include_url=False)), *faults]
        else:
            if not faults and (name := _without_inertia(made.scene)) is not None:
                faults = [_fault(("body",), f"singular at the start: the joint of {name!r} moves no mass")]
        if faults:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        return made

    @cached_property
    def scene(self) -> TreeScene:
        """The tree as plain arrays, with axes and quaternions rounded to unit ones, as engines get it."""
        places = {_WORLD: WORLD} | {body.name: i for i, body in enumerate(self.body)}
        loads: list[TreeLoad] = []
        for forcing in self.forcing:
            if isinstance(forcing, JointTorqueTable | JointSineTorqueTable):
                loads.append(forcing.load(places[forcing.body]))
            elif isinstance(forcing, LoadTable):
                load = forcing.load()
                assert isinstance(load, Torque | PointForce)
                loads.append(BodyLoad(places[getattr(forcing, "body")], load))  # noqa: B009 - of made tables
        return TreeScene(
            tuple(self._body(body, places) for body in self.body),
            tuple(loads),
            gravity_of(self.forcing),
            self.duration_s,
            self.samples,
        )

    def _body(self, body: Any, places: Mapping[str, int]) -> TreeBody:
        if body.joint is not None:
            joint = body.joint.joint(places[body.joint.parent])
        else:
            start = (self.initial or Initial()).state(None)
            joint = Joint(
                _FREE,
                start=np.concatenate([start.position, start.quaternion]),
                rate=np.concatenate([start.velocity, start.omega_body]),
            )
        return TreeBody(body.name, body.mass_kg, np.array(body.inertia_kg_m2), joint, body.link)


def as_single_body(data: dict[str, Any], tree: TreeScenario) -> dict[str, Any] | None:
    """Return the data of the same motion with a [body], for one free body or one on an undamped ball.

    None for any other tree.
    """
    joint = tree.scene.bodies[0].joint
    is_free, is_pivoted = joint.kind == _FREE, joint.kind == _BALL and not joint.damping
    has_joint_loads = any(forcing.kind in _JOINT_FORCINGS for forcing in tree.forcing)
    if len(tree.body) > 1 or not (is_free or is_pivoted) or has_joint_loads:
        return None
    body = {key: value for key, value in data["body"][0].items() if key not in ("name", "joint")}
    forcing = [{key: value for key, value in one.items() if key != "body"} for one in data.get("forcing", ())]
    if is_free:
        return {**data, "body": body, "forcing": forcing}
    quaternion = quaternion_product(joint.zero, joint.coordinates)
    initial = {
        "position_m": (joint.at_parent - rotate(quaternion, joint.at_body)).tolist(),
        "quaternion": quaternion.tolist(),
        "omega_body_rad_s": joint.rates.tolist(),
    }
    forcing.append({"kind": "pivot", "at_m": joint.at_body.tolist()})
    return {**data, "body": body, "initial": initial, "forcing": forcing}


def _without_inertia(scene: TreeScene) -> str | None:
    """Return the body whose joint makes the mass matrix singular at the start, in doubles."""
    from bodycheck.reference_impl.trees.tree_dynamics import pivot_ratios  # imports numba

    ratios = pivot_ratios(scene)
    worst = int(np.argmax(ratios))
    if ratios[worst] < _SINGULAR:
        return None
    return next(
        body.name for body, rates in zip(scene.bodies, scene.rate_slices, strict=True) if worst < rates.stop
    )


def _fault(loc: tuple[str | int, ...], text: str) -> InitErrorDetails:
    return {"type": "value_error", "loc": loc, "input": None, "ctx": {"error": ValueError(text)}}


def _again(fault: Any) -> InitErrorDetails:
    return {name: fault[name] for name in ("type", "loc", "input", "ctx") if name in fault}  # type: ignore[return-value]


def _tables(data: Any, key: str) -> list[Any]:
    tables = data.get(key) if isinstance(data, dict) else None
    return tables if isinstance(tables, list) else []


def _connection_faults(data: Any) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Yield the faults between the tables of a file, which may have faults of their own."""
    bodies = [body if isinstance(body, dict) else {} for body in _tables(data, "body")]
    names = [body.get("name") for body in bodies]
    counts = Counter(name for name in names if isinstance(name, str))
    for i, (name, body) in enumerate(zip(names, bodies, strict=True)):
        if name == _WORLD:
            yield ("body", i, "name"), f"must not be {_WORLD!r}, the parent of bodies that no other carries"
        if isinstance(name, str) and counts[name] > 1:
            yield ("body", i, "name"), f"there are {counts[name]} bodies named {name!r}; names must be unique"
        if "joint" not in body and i > 0:
            yield ("body", i, "joint"), "is required: only the first body can be free"
        if fault := _parent_fault(i, bodies, names):
            yield ("body", i, "joint", "parent"), fault
    if bodies and "initial" in data and "joint" in bodies[0]:
        yield ("initial",), f"only a free first body has one; give the start of {names[0]!r} in its joint"
    for k, forcing in enumerate(_tables(data, "forcing")):
        if isinstance(forcing, dict) and "body" in forcing:
            for key, fault in _forcing_faults(forcing, names, bodies):
                yield ("forcing", k, key), fault


def _parent(body: Mapping[str, Any]) -> Any:
    joint = body.get("joint")
    return joint.get("parent", _WORLD) if isinstance(joint, dict) else _WORLD


def _parent_fault(i: int, bodies: list[Any], names: list[Any]) -> str | None:
    parent = _parent(bodies[i])
    if parent == _WORLD or not isinstance(parent, str) or parent in names[:i]:
        return None
    if parent not in names:
        known = dict.fromkeys(
            name for name in names if isinstance(name, str) and name not in (names[i], _WORLD)
        )
        return f"there is no body {parent!r}{suggestion(parent, [_WORLD, *known])}"
    path = [names[i], parent]
    while path[-1] in names and path[-1] not in path[:-1]:
        path.append(_parent(bodies[names.index(path[-1])]))
    if path[-1] == names[i]:
        return f"is part of a cycle: {' <- '.join(map(str, path))}"
    return f"{parent!r} must stand before its child {names[i]!r}"


def _forcing_faults(forcing: Any, names: list[Any], bodies: list[Any]) -> Iterator[tuple[str, str]]:
    name, kind = forcing["body"], forcing.get("kind")
    if name not in names:
        if isinstance(name, str):
            known = dict.fromkeys(one for one in names if isinstance(one, str))
            yield "body", f"there is no body {name!r}{suggestion(name, known)}"
        return
    if kind not in _JOINT_FORCINGS:
        return
    joint = bodies[names.index(name)].get("joint")
    of_kind = JOINT_KINDS.get(str(joint.get("kind"))) if isinstance(joint, dict) else None
    if joint is None:
        yield "body", f"{name!r} is free: it has no joint"
    elif of_kind is not None and not (of_kind.is_scalar or (kind == "joint-torque" and of_kind.rates == 3)):
        yield "body", f"{name!r} has a joint of kind {of_kind.name!r}, on which a {kind} cannot act"
    elif of_kind is not None:
        unit = {"rad": "n_m", "m": "n"}[_unit(of_kind)]
        key, other = (f"{_JOINT_FORCINGS[kind]}_{one}" for one in (unit, "n" if unit == "n_m" else "n_m"))
        if other in forcing:
            yield other, f"is not a key for a joint of kind {of_kind.name!r}; write {key}"
        elif key not in forcing:
            yield key, f"is required for a joint of kind {of_kind.name!r}"
        elif np.size(forcing[key]) != of_kind.rates:
            yield key, f"needs {count(of_kind.rates, 'number')} for a joint of kind {of_kind.name!r}"
