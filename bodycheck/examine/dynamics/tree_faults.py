"""Faults of trees: each makes, of exact dynamics, the readings of an engine that has it, and moves a tree so.

To add a fault, add one `TreeFault`; specific ones come before general ones, to which a tie goes last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any, TypeAlias

import numpy as np

from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.tree_contract import depth_first, jointed_links
from bodycheck.examine.diagnosis.faults.fault import FACTOR, Parameter
from bodycheck.examine.dynamics.tree_case import EXACT, TreeCase, TreeState
from bodycheck.examine.dynamics.tree_flow import TreeHypothesis
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rotations import (
    conjugate,
    exp_quaternion,
    hat,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, Joint, TreeBody, TreeScene

Faulty: TypeAlias = Callable[[str], Array]
"""reading -> its values (k, ...) in an engine that has a fault."""
Plant: TypeAlias = Callable[[TreeCase, Sequence[int], Array], Faulty]
"""(exact case, bodies that have the fault, parameters) -> readings of the faulty engine."""
Bodies: TypeAlias = Callable[[TreeScene], Sequence[int]]
Moves: TypeAlias = Callable[[TreeHypothesis, Sequence[int], Array], None]
"""(model that moves, bodies that have the fault, parameters): changes the model."""


def _reads_right(case: TreeCase, _bodies: Sequence[int], _values: Array) -> Faulty:
    """Change no reading: a fault of motions alone."""
    return case.exact


@dataclass(frozen=True)
class TreeFault:
    """One way in which an engine's equations of a tree, its motion, or the readings of either are wrong.

    sentence: with {at} for the bodies that have it, and the parameters as {0}, {1}. readings: those that it
    changes. bodies: those that can have it, each alone or all; None if it concerns the tree. start: the
    parameters where a fit starts. special: the names of particular values of the parameters. applies: whether
    it is possible in a case. is_partial: whether it can concern some of its readings and not the others.
    motion: what it changes where a tree moves [default: the tree, of a fault that is another tree].
    """

    name: str
    sentence: str
    plant: Plant = _reads_right
    readings: tuple[str, ...] = READINGS
    bodies: Bodies | None = None
    parameters: tuple[Parameter, ...] = ()
    start: tuple[float, ...] = ()
    special: Callable[[TreeCase, int], Mapping[str, Sequence[float] | Array]] = lambda _case, _body: {}
    applies: Callable[[TreeCase], bool] = lambda _: True
    is_partial: bool = False
    motion: Moves | None = None

    @property
    def moves(self) -> Moves | None:
        """What it changes in a motion; None if it is one of readings."""
        return self.plant.move if isinstance(self.plant, _AnotherTree) else self.motion


_STATICS = ("bias", "accelerations", "wrenches")
_LENGTHS = tuple(Parameter(axis, "m", 0.0) for axis in ("x", "y", "z"))


def _jointed(scene: TreeScene) -> list[int]:
    return [k for k, body in enumerate(scene.bodies) if body.joint.kind != "free"]


def _of_kinds(*kinds: str) -> Bodies:
    return lambda scene: [k for k, body in enumerate(scene.bodies) if body.joint.kind in kinds]


def _all(scene: TreeScene) -> Sequence[int]:
    return range(len(scene.bodies))


# ------------------------------------------------------------------ faults that are another tree or state


def _state(change: Callable[[TreeState, Sequence[int], Array], TreeState]) -> Plant:
    """Return what evaluates the exact equations of another tree or state."""
    return lambda case, bodies, values: case.changed(lambda state: change(state, bodies, values)).exact


@dataclass(frozen=True)
class _AnotherTree:
    """Evaluates the exact equations of another tree, or moves it."""

    change: Callable[[TreeScene, Sequence[int], Array], TreeScene]

    def __call__(self, case: TreeCase, bodies: Sequence[int], values: Array) -> Faulty:
        """Return the readings of the other tree."""
        changed = self.change(case.scene, bodies, values)
        return case.changed(lambda state: TreeState(changed, state.q, state.u)).exact

    def move(self, model: TreeHypothesis, bodies: Sequence[int], values: Array) -> None:
        """Move the other tree."""
        model.scene = self.change(model.scene, bodies, values)


def _body(change: Callable[[TreeBody, TreeScene, Array], TreeBody]) -> Plant:
    """Return what changes bodies of the tree."""

    def changed(scene: TreeScene, bodies: Sequence[int], values: Array) -> TreeScene:
        parts = [change(one, scene, values) if k in bodies else one for k, one in enumerate(scene.bodies)]
        return replace(scene, bodies=tuple(parts))

    return _AnotherTree(changed)


def _joint(change: Callable[[Joint, TreeScene, Array], Mapping[str, Any]]) -> Plant:
    """Return what replaces fields of joints."""
    return _body(
        lambda body, scene, values: replace(
            body, joint=replace(body.joint, **change(body.joint, scene, values))
        )
    )


def _coordinates(change: Callable[[Array, Array, Array], tuple[Array, Array]]) -> Plant:
    """Return what changes the coordinates and rates of joints: change(q, u, parameters)."""

    def changed(state: TreeState, bodies: Sequence[int], values: Array) -> TreeState:
        q, u, scene = state.q.copy(), state.u.copy(), state.scene
        for k in bodies:
            at, rates = scene.coordinate_slices[k], scene.rate_slices[k]
            q[at], u[rates] = change(q[at], u[rates], values)
        return replace(state, q=q, u=u)

    return _state(changed)


def _with_torques(torques: Callable[[TreeState, int, Array], Array]) -> Plant:
    """Return what adds a torque (3,) in body axes to bodies."""

    def changed(state: TreeState, bodies: Sequence[int], values: Array) -> TreeState:
        loads = tuple(BodyLoad(k, Torque("body", torques(state, k, values))) for k in bodies)
        return replace(state, scene=replace(state.scene, loads=loads))

    return _state(changed)


def _assigned(name: str) -> Moves:
    """Return what assigns the first parameter to an attribute of a model."""
    return lambda model, _, values: setattr(model, name, float(values[0]))


def _of_bodies(name: str) -> Moves:
    """Return what assigns the first parameter to each body, in an attribute of a model."""
    return lambda model, bodies, values: getattr(model, name).update(dict.fromkeys(bodies, float(values[0])))


def _gyroscopic(state: TreeState, body: int, values: Array) -> Array:
    omega = state.dynamics.omega_body[body]
    return np.asarray((1.0 - values[0]) * np.cross(omega, state.scene.bodies[body].inertia @ omega))


def _turned(joint: Joint, rotation: Array) -> dict[str, Array]:
    return {"axis": rotation @ joint.axis}


def _zero(joint: Joint) -> Array:
    return quaternion_to_matrix(joint.zero / np.linalg.norm(joint.zero))


def _parents_link(case: TreeCase, body: int) -> dict[str, Array]:
    """Return the differences that known mistakes make in at_parent."""
    joint, point = case.scene.bodies[body].joint, "the joint's point of {at} in the parent"
    found = {
        f"{point} is ignored": -joint.at_parent,
        f"{point} has the opposite sign": -2.0 * joint.at_parent,
    }
    if joint.parent >= 0 and case.scene.bodies[joint.parent].joint.kind != "free":
        link = case.scene.bodies[joint.parent].joint.at_body
        found[f"{point} is measured from the parent's joint, not its centre of mass"] = link
        found[f"{point} is moved by the parent's link offset twice"] = -link
    return found


def _own_link(case: TreeCase, body: int) -> dict[str, Array]:
    joint, point = case.scene.bodies[body].joint, "the joint's point of {at} in the child"
    return {f"{point} is ignored": -joint.at_body, f"{point} has the opposite sign": -2.0 * joint.at_body}


def _scaled(body: TreeBody, _scene: TreeScene, values: Array) -> TreeBody:
    return replace(body, mass=values[0] * body.mass, inertia=values[0] * body.inertia)


def _previous(case: TreeCase, _bodies: Sequence[int], _values: Array) -> Faulty:
    return replace(case, states=(case.states[0], *case.states[:-1])).exact


def _model_faults() -> Iterator[TreeFault]:
    yield TreeFault(
        "stale-state",
        "they hold for the state that was set before",
        _previous,
        is_partial=True,
    )
    yield TreeFault(
        "stale-mass",
        "after a change of mass, those of {at} are {0} times as large",
        _body(_scaled),
        bodies=_all,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
        special=lambda case, _: {"masses of {at} are those from before a change": (case.masses_were,)},
        applies=lambda case: case.masses_were != 1.0,
        is_partial=True,
    )
    yield TreeFault(
        "missing-coriolis",
        "the velocity terms (Coriolis, centrifugal and gyroscopic) count {0} times",
        _velocity_terms,
        _STATICS,
        motion=_assigned("velocity_terms"),
        parameters=(FACTOR,),
        start=(0.0,),
        special=lambda _case, _body: {
            "the velocity terms (Coriolis, centrifugal and gyroscopic) are missing": (0.0,)
        },
    )
    yield TreeFault(
        "gyroscopic-term",
        "the gyroscopic term omega x I omega of {at} counts {0} times",
        _with_torques(_gyroscopic),
        _STATICS,
        _all,
        (FACTOR,),
        (2.0,),
        motion=_of_bodies("gyroscopic"),
        special=lambda _case, _body: {
            "the gyroscopic term omega x I omega of {at} counts twice": (2.0,),
            "the gyroscopic term omega x I omega of {at} is missing": (0.0,),
        },
    )
    yield TreeFault(
        "gravity",
        "gravity counts {0} times",
        _AnotherTree(lambda scene, _, values: replace(scene, gravity=values[0] * scene.gravity)),
        ("bias", "gravity_bias", "accelerations", "wrenches", "energy"),
        parameters=(FACTOR,),
        start=(0.0,),
        special=lambda _case, _body: {"gravity is missing": (0.0,), "gravity has the opposite sign": (-1.0,)},
    )
    yield TreeFault(
        "ball-conjugate",
        "the quaternion of {at} is conjugate",
        _coordinates(lambda q, u, _: (np.concatenate([q[:-4], conjugate(q[-4:])]), u)),
        bodies=_of_kinds("ball", "free"),
    )
    yield TreeFault(
        "ball-order",
        "the quaternion of {at} is taken in the order x y z w",
        _coordinates(lambda q, u, _: (np.concatenate([q[:-4], np.roll(q[-4:], 1)]), u)),
        bodies=_of_kinds("ball", "free"),
    )
    yield TreeFault(
        "axis-in-parent",
        "the axis of {at} is in the axes of the parent, not of the child",
        _joint(lambda joint, _, __: _turned(joint, _zero(joint).T)),
        bodies=_of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "axis-turned-twice",
        "the axis of {at} is turned by the rotation of the joint's frame",
        _joint(lambda joint, _, __: _turned(joint, _zero(joint))),
        bodies=_of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "axis-in-world",
        "the axis of {at} is in world axes at coordinates 0, not of the child",
        _joint(lambda joint, scene, _: _turned(joint, _zero_pose(joint, scene).T)),
        bodies=_of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "axis-opposite",
        "the axis of {at} has the opposite sign",
        _joint(lambda joint, _, __: {"axis": -joint.axis}),
        bodies=_of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "zero-ignored",
        "the rotation of the joint's frame of {at} is ignored",
        _joint(lambda _, __, ___: {"zero": np.array([1.0, 0.0, 0.0, 0.0])}),
        bodies=_jointed,
    )
    yield TreeFault(
        "zero-inverse",
        "the rotation of the joint's frame of {at} is inverse",
        _joint(lambda joint, _, __: {"zero": conjugate(joint.zero)}),
        bodies=_jointed,
    )
    yield TreeFault(
        "coordinate-opposite",
        "coordinate and rate of {at} have the opposite sign",
        _coordinates(lambda q, u, _: (-q, -u)),
        bodies=_of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "degrees",
        "the coordinate of {at} is taken in degrees",
        _coordinates(lambda q, u, _: (np.deg2rad(q), u)),
        bodies=_of_kinds("hinge"),
    )
    yield TreeFault(
        "degrees",
        "coordinate and rate of {at} are taken in degrees",
        _coordinates(lambda q, u, _: (np.deg2rad(q), np.deg2rad(u))),
        bodies=_of_kinds("hinge"),
    )
    yield TreeFault(
        "off-diagonals",
        "the off-diagonals of the inertia of {at} have the opposite sign",
        _body(lambda body, _, __: replace(body, inertia=2.0 * np.diag(np.diag(body.inertia)) - body.inertia)),
        bodies=_all,
    )
    yield TreeFault(
        "off-diagonals",
        "the off-diagonals of the inertia of {at} are dropped",
        _body(lambda body, _, __: replace(body, inertia=np.diag(np.diag(body.inertia)))),
        bodies=_all,
    )
    yield TreeFault(
        "inertia-about-joint",
        "the inertia of {at} is about the joint's point, not the centre of mass",
        _body(lambda body, _, __: _moved(body, 1.0)),
        bodies=_jointed,
    )
    yield TreeFault(
        "mass-and-inertia",
        "mass and inertia of {at} are {0} times as large",
        _body(_scaled),
        bodies=_all,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
    )
    yield TreeFault(
        "mass",
        "the mass of {at} is {0} times as large",
        _body(lambda body, _, s: replace(body, mass=s[0] * body.mass)),
        bodies=_all,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
    )
    yield TreeFault(
        "inertia",
        "the inertia of {at} is {0} times as large",
        _body(lambda body, _, s: replace(body, inertia=s[0] * body.inertia)),
        bodies=_all,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
    )
    yield TreeFault(
        "damping",
        "the joint of {at} has a damping of {0}",
        _joint(lambda _, __, s: {"damping": s[0]}),
        _STATICS,
        _jointed,
        (Parameter("damping", "N m s", 0.0, low=0.0),),
        (0.1,),
    )
    yield TreeFault(
        "armature",
        "the joint of {at} has an armature of {0}",
        _joint(lambda _, __, s: {"armature": s[0]}),
        ("mass_matrix", "accelerations", "wrenches"),
        _jointed,
        (Parameter("armature", "kg m^2", 0.0, low=0.0),),
        (0.1,),
    )
    yield TreeFault(
        "coordinate-shift",
        "the coordinate of {at} is shifted by {0}",
        _joint(lambda joint, _, s: _shifted(joint, s[0])),
        bodies=_of_kinds("hinge", "slide"),
        parameters=(Parameter("shift", "", 0.0),),
        start=(0.1,),
    )
    yield TreeFault(
        "parent-offset",
        "the joint's point of {at} in the parent is off by ({0}, {1}, {2}) m",
        _joint(lambda joint, _, d: {"at_parent": joint.at_parent + d}),
        bodies=_jointed,
        parameters=_LENGTHS,
        start=(0.0, 0.0, 0.0),
        special=_parents_link,
    )
    yield TreeFault(
        "body-offset",
        "the joint's point of {at} in the child is off by ({0}, {1}, {2}) m",
        _joint(lambda joint, _, d: {"at_body": joint.at_body + d}),
        bodies=_jointed,
        parameters=_LENGTHS,
        start=(0.0, 0.0, 0.0),
        special=_own_link,
    )
    yield TreeFault(
        "axis",
        "the axis of {at} is off by ({0}, {1}, {2})",
        _joint(lambda joint, _, d: {"axis": joint.axis / np.linalg.norm(joint.axis) + d}),
        bodies=_of_kinds("hinge", "slide"),
        parameters=tuple(Parameter(axis, "", 0.0) for axis in "xyz"),
        start=(0.0, 0.0, 0.0),
    )


def _shifted(joint: Joint, by: float) -> dict[str, Array]:
    """Return the joint whose coordinate counts from elsewhere."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    if joint.kind == "slide":
        return {"at_parent": joint.at_parent + by * _zero(joint) @ axis}
    return {"zero": quaternion_product(joint.zero, exp_quaternion(by * axis))}


def _is_held(joint: Joint, stiffness: float) -> dict[str, float]:
    """Return the joint with a spring that pulls it to its start besides its own."""
    total = joint.stiffness + stiffness
    pulled = joint.stiffness * joint.rest + stiffness * float(joint.coordinates[0])
    return {"stiffness": total, "rest": pulled / total if total else 0.0}


def _motion_faults() -> Iterator[TreeFault]:
    yield TreeFault(
        "motor-position",
        "the joint of {at} has a motor that holds its start, with {0} N m per rad or N per m",
        _joint(lambda joint, _, s: _is_held(joint, s[0])),
        (),
        _of_kinds("hinge", "slide"),
        (Parameter("gain", "", 0.0, low=0.0),),
        (0.1,),
    )
    yield TreeFault(
        "motor-friction",
        "the joint of {at} is braked, by a motor left on or by friction, with {0} N m or N",
        readings=(),
        bodies=_of_kinds("hinge", "slide"),
        parameters=(Parameter("force", "", 0.0, low=0.0),),
        start=(0.1,),
        motion=_of_bodies("friction"),
    )
    yield TreeFault(
        "load-late",
        "the loads are {0} steps late",
        readings=(),
        parameters=(Parameter("steps", "", 0.0),),
        start=(0.0,),
        applies=lambda case: bool(case.scene.loads),
        motion=_assigned("late_steps"),
        special=lambda _case, _body: {
            "the loads are one step late": (1.0,),
            "the loads are one step early": (-1.0,),
        },
    )
    yield TreeFault(
        "load-factor",
        "the loads count {0} times",
        readings=(),
        parameters=(FACTOR,),
        start=(0.0,),
        applies=lambda case: bool(case.scene.loads),
        motion=_assigned("loads"),
        special=lambda _case, _body: {
            "the loads are missing": (0.0,),
            "the loads have the opposite sign": (-1.0,),
        },
    )
    yield TreeFault(
        "step",
        "a step is {0} times as long",
        readings=(),
        parameters=(Parameter("factor", low=1e-3),),
        start=(1.0,),
        motion=_assigned("step"),
    )
    yield TreeFault(
        "base-point",
        "the velocity of the free body is stepped at the point ({0}, {1}, {2}) m, not at its centre of mass",
        readings=(),
        parameters=_LENGTHS,
        start=(0.01, 0.02, 0.03),
        applies=lambda case: case.scene.bodies[0].joint.kind == "free",
        motion=lambda model, _, values: setattr(model, "base_point", values),
    )


def _velocity_terms(case: TreeCase, _bodies: Sequence[int], values: Array) -> Faulty:
    """c = c(u = 0) + s (c - c(u = 0)), and the same of all that is linear in c."""
    at_rest = case.resting.exact
    return lambda reading: at_rest(reading) + values[0] * (case.exact(reading) - at_rest(reading))


def _moved(body: TreeBody, sign: float) -> TreeBody:
    return replace(body, inertia=body.inertia + sign * body.mass * parallel_axis_tensor(body.joint.at_body))


def _zero_pose(joint: Joint, scene: TreeScene) -> Array:
    """Return the rotation (3, 3) of a joint's child to world axes, with all coordinates 0."""
    above = np.eye(3) if joint.parent < 0 else _zero_pose(scene.bodies[joint.parent].joint, scene)
    return np.asarray(above @ (np.eye(3) if joint.kind == "free" else _zero(joint)))


# --------------------------------------------------------------- faults of the order and the axes of rates


def _reported_in(turns: Callable[[TreeState], tuple[Array, Array]], *, taken: bool) -> Plant:
    """Return what reports in other rates, u_e = T u; turns(state) -> T, (dT/dt) u.

    taken: whether it also takes u as such rates.
    """

    def plant(case: TreeCase, _bodies: Sequence[int], _values: Array) -> Faulty:
        def own(state: TreeState) -> TreeState:
            return (
                replace(state, u=np.asarray(np.linalg.solve(turns(state)[0], state.u), np.float64))
                if taken
                else state
            )

        inside = case.changed(own)

        def value(reading: str) -> Array:
            if reading not in ("mass_matrix", "bias", "gravity_bias", "accelerations"):
                return inside.exact(reading)
            return np.array([_in_rates(reading, state, *turns(state)) for state in inside.states])

        return value

    return plant


def _in_rates(reading: str, state: TreeState, T: Array, drift: Array) -> Array:
    exact = EXACT[reading](state.dynamics)
    if reading == "accelerations":
        return np.asarray(T @ exact + drift)
    inverse = np.linalg.inv(T)
    if reading == "mass_matrix":
        return np.asarray(inverse.T @ exact @ inverse)
    if reading == "bias":
        exact = exact - state.dynamics.mass_matrix @ inverse @ drift
    return np.asarray(inverse.T @ exact)


def _base_rates(v_in: str, omega_in: str, *, omega_first: bool) -> Callable[[TreeState], tuple[Array, Array]]:
    def turns(state: TreeState) -> tuple[Array, Array]:
        T, drift = np.eye(len(state.u)), np.zeros(len(state.u))
        for k in _of_kinds("free")(state.scene):
            at = state.scene.rate_slices[k]
            R = quaternion_to_matrix(state.dynamics.quaternion[k])
            v, omega = state.u[at][:3], state.u[at][3:]
            block, change = np.eye(6), np.zeros(6)
            if v_in == "body":
                block[:3, :3], change[:3] = R.T, -np.cross(omega, R.T @ v)
            if omega_in == "world":
                block[3:, 3:] = R
            if omega_first:
                block, change = np.roll(block, 3, axis=0), np.roll(change, 3)
            T[at, at], drift[at] = block, change
        return T, drift

    return turns


def _of_point(case: TreeCase, _bodies: Sequence[int], values: Array) -> Faulty:
    """v of the point d of a free body: v_e = v + omega x R d."""

    def turns(state: TreeState) -> tuple[Array, Array]:
        T, drift = np.eye(len(state.u)), np.zeros(len(state.u))
        for k in _of_kinds("free")(state.scene):
            at = state.scene.rate_slices[k].start
            R, omega = quaternion_to_matrix(state.dynamics.quaternion[k]), state.u[at + 3 : at + 6]
            T[at : at + 3, at + 3 : at + 6] = -R @ hat(values)
            drift[at : at + 3] = R @ np.cross(omega, np.cross(omega, values))
        return T, drift

    return _reported_in(turns, taken=False)(case, (), values)


def _ball_rates(frame: str) -> Callable[[TreeState], tuple[Array, Array]]:
    def turns(state: TreeState) -> tuple[Array, Array]:
        T, scene = np.eye(len(state.u)), state.scene
        for k in _of_kinds("ball")(scene):
            at = scene.rate_slices[k]
            E = quaternion_to_matrix(state.q[scene.coordinate_slices[k]])
            T[at, at] = E if frame == "joint's zero frame" else _zero(scene.bodies[k].joint) @ E
        return T, np.zeros(len(state.u))

    return turns


def _in_order(order: Bodies, state: TreeState) -> tuple[Array, Array]:
    """Return T that puts the rates of bodies into another order."""
    rows = [
        row for k in order(state.scene) for row in range(*state.scene.rate_slices[k].indices(len(state.u)))
    ]
    return np.eye(len(state.u))[rows], np.zeros(len(state.u))


_ORDERS: Mapping[str, Bodies] = {
    "depth first": lambda scene: depth_first(jointed_links(scene)),
    "breadth first": lambda scene: sorted(_all(scene), key=lambda k: (_depth(scene, k), k)),
    "reversed": lambda scene: [*reversed(_all(scene))],
    "alphabetical": lambda scene: sorted(_all(scene), key=lambda k: scene.bodies[k].name),
    "grouped by their kinds": lambda scene: sorted(_all(scene), key=lambda k: scene.bodies[k].joint.kind),
}


def _depth(scene: TreeScene, body: int) -> int:
    joint = scene.bodies[body].joint
    return 0 if joint.kind == "free" or joint.parent < 0 else 1 + _depth(scene, joint.parent)


_RATE_READINGS = ("mass_matrix", "bias", "gravity_bias", "accelerations")


def _rate_faults() -> Iterator[TreeFault]:
    def both(name: str, rates: str, turns: Callable[[TreeState], tuple[Array, Array]]) -> Iterator[TreeFault]:
        yield TreeFault(name, f"they are in {rates}", _reported_in(turns, taken=False), _RATE_READINGS)
        yield TreeFault(name, f"the engine takes and reports {rates}", _reported_in(turns, taken=True))

    for order, v_in, omega_in in product((False, True), ("world", "body"), ("body", "world")):
        if (order, v_in, omega_in) == (False, "world", "body"):
            continue
        v, omega = f"v in {v_in} axes", f"omega in {omega_in} axes"
        rates = f"rates of the free body ({f'{omega}, {v}' if order else f'{v}, {omega}'})"
        name = "base-order" if order else "base-axes"
        yield from both(name, rates, _base_rates(v_in, omega_in, omega_first=order))
    for frame in ("joint's zero frame", "parent's axes"):
        yield from both("ball-axes", f"rates of balls in the {frame}, not in child axes", _ball_rates(frame))
    for words, order_of in _ORDERS.items():
        yield from both(
            "joint-order",
            f"{words} order of joints",
            partial(_in_order, order_of),
        )
    yield TreeFault(
        "base-point",
        "they are in the velocity of the free body's point ({0}, {1}, {2}) m off its centre of mass",
        _of_point,
        _RATE_READINGS,
        parameters=_LENGTHS,
        start=(0.0, 0.0, 0.0),
    )


# ------------------------------------------------------------------------------ faults of single readings


def _reading(change: Callable[[TreeState, Array, Array], Array], reading: str) -> Plant:
    """Return what changes the exact value of one reading: change(state, value, parameters)."""

    def plant(case: TreeCase, _bodies: Sequence[int], values: Array) -> Faulty:
        def value(name: str) -> Array:
            exact = case.exact(name)
            if name != reading:
                return exact
            return np.array(
                [change(state, one, values) for state, one in zip(case.states, exact, strict=True)]
            )

        return value

    return plant


def _wrench_in(
    axes: str, about: str, sign: float, *, moment_first: bool
) -> Callable[[TreeState, Array, Array], Array]:
    def change(state: TreeState, wrenches: Array, _values: Array) -> Array:
        found = sign * wrenches
        quaternions = state.dynamics.quaternion
        for k in _jointed(state.scene):
            joint, R = state.scene.bodies[k].joint, quaternion_to_matrix(quaternions[k])
            point = joint.at_body  # the joint's point, from the place that the moment is about
            if about == "joint":
                point = np.zeros(3)
            elif about == "world":
                point = joint.at_body + R.T @ state.dynamics.position[k]
            turn = np.eye(3)
            if axes == "world":
                turn = R
            elif axes == "parent":
                above = np.eye(3) if joint.parent < 0 else quaternion_to_matrix(quaternions[joint.parent])
                turn = above.T @ R
            force, moment = found[k][:3], found[k][3:] + np.cross(point, found[k][:3])
            found[k] = np.concatenate([turn @ force, turn @ moment])
        return np.roll(found, 3, axis=1) if moment_first else found

    return change


def _local_gyroscopic(state: TreeState, wrenches: Array, values: Array) -> Array:
    found = wrenches.copy()
    for k in _jointed(state.scene):
        omega = state.dynamics.omega_body[k]
        found[k][3:] += (values[0] - 1.0) * np.cross(omega, state.scene.bodies[k].inertia @ omega)
    return found


def _momenta_of(axes: str, about: str) -> Callable[[TreeState, Array, Array], Array]:
    def change(state: TreeState, momenta: Array, _values: Array) -> Array:
        P, L = momenta[:3], momenta[3:]
        if about == "centre":
            masses = np.array([body.mass for body in state.scene.bodies])
            L = L - np.cross(masses @ state.dynamics.position / masses.sum(), P)
        turn = quaternion_to_matrix(state.dynamics.quaternion[0]).T if axes == "base" else np.eye(3)
        return np.concatenate([turn @ P, turn @ L])

    return change


def _link_places(state: TreeState, poses: Array, _values: Array) -> Array:
    found = poses.copy()
    for k in _jointed(state.scene):
        found[k][:3] += quaternion_to_matrix(poses[k][3:]) @ state.scene.bodies[k].joint.at_body
    return found


def _link_quaternions(state: TreeState, poses: Array, _values: Array) -> Array:
    """Return orientations relative to the joint's zero frame: the rotation of that frame left out."""
    found = poses.copy()
    for k in _jointed(state.scene):
        found[k][3:] = quaternion_product(poses[k][3:], conjugate(state.scene.bodies[k].joint.zero))
    return found


def _reading_faults() -> Iterator[TreeFault]:
    for sign, axes, about, moment_first in product(
        (1.0, -1.0), ("child", "parent", "world"), ("joint", "centre", "world"), (False, True)
    ):
        if (sign, axes, about, moment_first) == (1.0, "child", "joint", False):
            continue
        point = {
            "joint": "",
            "centre": " about the child's centre of mass",
            "world": " about the world's origin",
        }[about]
        words = [
            f"they are in {axes} axes" if axes != "child" else "",
            f"the moment is{point}" if point else "",
        ]
        words += [
            "they act on the parent, not the child" if sign < 0.0 else "",
            "the moment comes first" if moment_first else "",
        ]
        yield TreeFault(
            "wrench-frame",
            ", ".join(filter(None, words)),
            _reading(_wrench_in(axes, about, sign, moment_first=moment_first), "wrenches"),
            ("wrenches",),
        )
    yield TreeFault(
        "wrench-gyroscopic",
        "the moment has omega x I omega of the child {0} times",
        _reading(_local_gyroscopic, "wrenches"),
        ("wrenches",),
        parameters=(FACTOR,),
        start=(2.0,),
        special=lambda _case, _body: {"the moment has omega x I omega of the child twice": (2.0,)},
    )
    for axes, about in (("base", "origin"), ("world", "centre"), ("base", "centre")):
        words = [
            "they are in the axes of the first body" if axes == "base" else "",
            "they are about the centre of mass" if about == "centre" else "",
        ]
        yield TreeFault(
            "momenta-frame",
            " and ".join(filter(None, words)),
            _reading(_momenta_of(axes, about), "momenta"),
            ("momenta",),
        )
    singles: tuple[tuple[str, str, str, Callable[[TreeState, Array, Array], Array]], ...] = (
        ("momenta", "momenta-order", "the angular momentum comes first", lambda _, p, __: np.roll(p, 3)),
        ("energy", "energy-order", "the potential comes first", lambda _, e, __: e[::-1]),
        ("energy", "energy-sign", "the potential has the opposite sign", lambda _, e, __: e * (1.0, -1.0)),
        ("energy", "energy-half", "the kinetic energy counts twice", lambda _, e, __: e * (2.0, 1.0)),
        (
            "poses",
            "pose-conjugate",
            "the quaternions are conjugate",
            lambda _, p, __: p * (1, 1, 1, 1, -1, -1, -1),
        ),
        (
            "poses",
            "pose-order",
            "the quaternions are in the order x y z w",
            lambda _, p, __: p[:, [0, 1, 2, 4, 5, 6, 3]],
        ),
        (
            "poses",
            "pose-point",
            "the places are those of the joints, not of the centres of mass",
            _link_places,
        ),
        ("poses", "pose-zero", "the orientations lack the rotation of the joint's frame", _link_quaternions),
        (
            "mass_matrix",
            "upper-triangle",
            "it is filled only above its diagonal",
            lambda _, m, __: np.triu(m),
        ),
        (
            "mass_matrix",
            "upper-triangle",
            "it is filled only below its diagonal",
            lambda _, m, __: np.tril(m),
        ),
        (
            "mass_matrix",
            "mass-inverse",
            "it is the inverse",
            lambda _, m, __: np.asarray(np.linalg.inv(m), np.float64),
        ),
    )
    for reading, name, sentence, change in singles:
        yield TreeFault(name, sentence, _reading(change, reading), (reading,))
    yield TreeFault(
        "energy-zero",
        "the potential is {0} J larger",
        _reading(lambda _, e, v: e + np.array([0.0, v[0]]), "energy"),
        ("energy",),
        parameters=(Parameter("potential", "J", 0.0),),
        start=(0.0,),
    )
    for reading in READINGS[:-1]:
        yield TreeFault(
            "factor",
            "they are {0} times as large",
            _reading(lambda _, value, s: s[0] * value, reading),
            (reading,),
            parameters=(FACTOR,),
            start=(-1.0,),
            special=lambda _case, _body: {"they have the opposite sign": (-1.0,)},
        )


TREE_FAULTS: tuple[TreeFault, ...] = (
    *_rate_faults(),
    *_motion_faults(),
    *_model_faults(),
    *_reading_faults(),
)
"""All faults of trees, the specific ones first."""
