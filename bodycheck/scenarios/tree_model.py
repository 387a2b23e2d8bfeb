"""The model of a scenario file with [[body]] tables: bodies connected by joints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails

from bodycheck._util.formatting import count, suggestion
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rotations import quaternion_product, rotate
from bodycheck.reference_impl.trees.tree_scene import WORLD, BodyLoad, Joint, TreeBody, TreeLoad, TreeScene
from bodycheck.scenarios.forcings import JOINT_FORCINGS, LoadTable, gravity_of
from bodycheck.scenarios.model import Initial, ScenarioTable
from bodycheck.scenarios.tree_tables import (
    JOINT_KINDS,
    WORLD_NAME,
    JointSineTorqueTable,
    JointTorqueTable,
    TreeBodyTable,
    TreeForcing,
    unit_of,
)

_FREE, _BALL = "free", "ball"
_SINGULAR = 1e14  # ratio of M_ii to the pivot: all digits of a double are lost


class TreeScenario(ScenarioTable):
    """One scenario file of a tree: its bodies, the start of a free first body, and the loads."""

    body: Annotated[tuple[TreeBodyTable, ...], Field(min_length=1)]
    initial: Initial | None = None
    forcing: tuple[TreeForcing, ...] = ()

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
            if not faults and (fault := _mass_fault(made.scene)) is not None:
                faults = [_fault(("body",), fault)]
        if faults:
            raise ValidationError.from_exception_data(cls.__name__, faults)
        return made

    @cached_property
    def scene(self) -> TreeScene:
        """The tree as plain arrays, with axes and quaternions rounded to unit ones, as engines get it."""
        places = {WORLD_NAME: WORLD} | {body.name: i for i, body in enumerate(self.body)}
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
    has_joint_loads = any(forcing.kind in JOINT_FORCINGS for forcing in tree.forcing)
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


def _mass_fault(scene: TreeScene) -> str | None:
    """Return why doubles cannot solve for the accelerations at the start; None where they can."""
    from bodycheck.reference_impl.trees.tree_dynamics import pivot_ratios  # imports numba

    try:
        ratios = pivot_ratios(scene)
    except (FloatingPointError, OverflowError):
        return "some number is too large: the mass matrix overflows"
    worst = int(np.argmax(ratios))
    if ratios[worst] < _SINGULAR:
        return None
    ends = (rates.stop for rates in scene.rate_slices)
    name = next(body.name for body, end in zip(scene.bodies, ends, strict=True) if worst < end)
    return f"singular at the start: the joint of {name!r} moves no mass"


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
        if name == WORLD_NAME:
            yield (
                ("body", i, "name"),
                f"must not be {WORLD_NAME!r}, which is no body",
            )
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
    return joint.get("parent", WORLD_NAME) if isinstance(joint, dict) else WORLD_NAME


def _parent_fault(i: int, bodies: list[Any], names: list[Any]) -> str | None:
    parent = _parent(bodies[i])
    if parent == WORLD_NAME or not isinstance(parent, str) or parent in names[:i]:
        return None
    if parent not in names:
        known = dict.fromkeys(
            name for name in names if isinstance(name, str) and name not in (names[i], WORLD_NAME)
        )
        return f"there is no body {parent!r}{suggestion(parent, [WORLD_NAME, *known])}"
    path = [names[i], parent]
    while path[-1] in names and path[-1] not in path[:-1]:
        path.append(_parent(bodies[names.index(path[-1])]))
    if path[-1] == names[i]:
        return f"is part of a cycle: {' <- '.join(map(str, path))}"
    return f"{parent!r} must stand before its child {names[i]!r}"


def _forcing_faults(forcing: Any, names: list[Any], bodies: list[Any]) -> Iterator[tuple[str, str]]:
    name, kind = forcing["body"], str(forcing.get("kind"))
    if name not in names:
        if isinstance(name, str):
            known = dict.fromkeys(one for one in names if isinstance(one, str))
            yield "body", f"there is no body {name!r}{suggestion(name, known)}"
        return
    if kind not in JOINT_FORCINGS:
        return
    joint = bodies[names.index(name)].get("joint")
    of_kind = JOINT_KINDS.get(str(joint.get("kind"))) if isinstance(joint, dict) else None
    if joint is None:
        yield "body", f"{name!r} is free: it has no joint"
    elif of_kind is not None and not (of_kind.is_scalar or (kind == "joint-torque" and of_kind.rates == 3)):
        yield "body", f"{name!r} has a joint of kind {of_kind.name!r}, on which a {kind} cannot act"
    elif of_kind is not None:
        unit = {"rad": "n_m", "m": "n"}[unit_of(of_kind)]
        key, other = (f"{JOINT_FORCINGS[kind]}_{one}" for one in (unit, "n" if unit == "n_m" else "n_m"))
        if other in forcing:
            yield other, f"is not a key for a joint of kind {of_kind.name!r}; write {key}"
        elif key not in forcing:
            yield key, f"is required for a joint of kind {of_kind.name!r}"
        elif np.size(forcing[key]) != of_kind.rates:
            yield key, f"needs {count(of_kind.rates, 'number')} for a joint of kind {of_kind.name!r}"
