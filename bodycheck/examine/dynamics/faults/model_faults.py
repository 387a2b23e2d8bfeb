"""Faults of trees that are another tree, another state or another motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bodycheck.examine.diagnosis.faults.fault import FACTOR, Parameter
from bodycheck.examine.dynamics.faults.tree_fault import (
    LENGTHS,
    AnotherTree,
    Faulty,
    Moves,
    Plant,
    TreeFault,
    all_bodies,
    jointed,
    of_kinds,
    zero_rotation,
)
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rotations import conjugate, exp_quaternion, quaternion_product
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, Joint, TreeBody, TreeScene

_STATICS = ("bias", "accelerations", "wrenches")


def _state(change: Callable[[TreeState, Sequence[int], Array], TreeState]) -> Plant:
    """Return what evaluates the exact equations of another tree or state."""
    return lambda case, bodies, values: case.changed(lambda state: change(state, bodies, values)).exact


def _body(change: Callable[[TreeBody, TreeScene, Array], TreeBody]) -> Plant:
    """Return what changes bodies of the tree."""

    def changed(scene: TreeScene, bodies: Sequence[int], values: Array) -> TreeScene:
        parts = [change(one, scene, values) if k in bodies else one for k, one in enumerate(scene.bodies)]
        return replace(scene, bodies=tuple(parts))

    return AnotherTree(changed)


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


def model_faults() -> Iterator[TreeFault]:
    """Yield those that are another tree or another state."""
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
        bodies=all_bodies,
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
        all_bodies,
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
        AnotherTree(lambda scene, _, values: replace(scene, gravity=values[0] * scene.gravity)),
        ("bias", "gravity_bias", "accelerations", "wrenches", "energy"),
        parameters=(FACTOR,),
        start=(0.0,),
        special=lambda _case, _body: {"gravity is missing": (0.0,), "gravity has the opposite sign": (-1.0,)},
    )
    yield TreeFault(
        "ball-conjugate",
        "the quaternion of {at} is conjugate",
        _coordinates(lambda q, u, _: (np.concatenate([q[:-4], conjugate(q[-4:])]), u)),
        bodies=of_kinds("ball", "free"),
    )
    yield TreeFault(
        "ball-order",
        "the quaternion of {at} is taken in the order x y z w",
        _coordinates(lambda q, u, _: (np.concatenate([q[:-4], np.roll(q[-4:], 1)]), u)),
        bodies=of_kinds("ball", "free"),
    )
    yield TreeFault(
        "axis-in-parent",
        "the axis of {at} is in the axes of the parent, not of the child",
        _joint(lambda joint, _, __: _turned(joint, zero_rotation(joint).T)),
        bodies=of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "axis-turned-twice",
        "the axis of {at} is turned by the rotation of the joint's frame",
        _joint(lambda joint, _, __: _turned(joint, zero_rotation(joint))),
        bodies=of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "axis-in-world",
        "the axis of {at} is in world axes at coordinates 0, not of the child",
        _joint(lambda joint, scene, _: _turned(joint, _zero_pose(joint, scene).T)),
        bodies=of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "axis-opposite",
        "the axis of {at} has the opposite sign",
        _joint(lambda joint, _, __: {"axis": -joint.axis}),
        bodies=of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "zero-ignored",
        "the rotation of the joint's frame of {at} is ignored",
        _joint(lambda _, __, ___: {"zero": np.array([1.0, 0.0, 0.0, 0.0])}),
        bodies=jointed,
    )
    yield TreeFault(
        "zero-inverse",
        "the rotation of the joint's frame of {at} is inverse",
        _joint(lambda joint, _, __: {"zero": conjugate(joint.zero)}),
        bodies=jointed,
    )
    yield TreeFault(
        "coordinate-opposite",
        "coordinate and rate of {at} have the opposite sign",
        _coordinates(lambda q, u, _: (-q, -u)),
        bodies=of_kinds("hinge", "slide"),
    )
    yield TreeFault(
        "degrees",
        "the coordinate of {at} is taken in degrees",
        _coordinates(lambda q, u, _: (np.deg2rad(q), u)),
        bodies=of_kinds("hinge"),
    )
    yield TreeFault(
        "degrees",
        "coordinate and rate of {at} are taken in degrees",
        _coordinates(lambda q, u, _: (np.deg2rad(q), np.deg2rad(u))),
        bodies=of_kinds("hinge"),
    )
    yield TreeFault(
        "off-diagonals",
        "the off-diagonals of the inertia of {at} have the opposite sign",
        _body(lambda body, _, __: replace(body, inertia=2.0 * np.diag(np.diag(body.inertia)) - body.inertia)),
        bodies=all_bodies,
    )
    yield TreeFault(
        "off-diagonals",
        "the off-diagonals of the inertia of {at} are dropped",
        _body(lambda body, _, __: replace(body, inertia=np.diag(np.diag(body.inertia)))),
        bodies=all_bodies,
    )
    yield TreeFault(
        "inertia-about-joint",
        "the inertia of {at} is about the joint's point, not the centre of mass",
        _body(lambda body, _, __: _moved(body, 1.0)),
        bodies=jointed,
    )
    yield TreeFault(
        "mass-and-inertia",
        "mass and inertia of {at} are {0} times as large",
        _body(_scaled),
        bodies=all_bodies,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
    )
    yield TreeFault(
        "mass",
        "the mass of {at} is {0} times as large",
        _body(lambda body, _, s: replace(body, mass=s[0] * body.mass)),
        bodies=all_bodies,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
    )
    yield TreeFault(
        "inertia",
        "the inertia of {at} is {0} times as large",
        _body(lambda body, _, s: replace(body, inertia=s[0] * body.inertia)),
        bodies=all_bodies,
        parameters=(Parameter("factor", low=1e-6),),
        start=(1.5,),
    )
    yield TreeFault(
        "damping",
        "the joint of {at} has a damping of {0}",
        _joint(lambda _, __, s: {"damping": s[0]}),
        _STATICS,
        jointed,
        (Parameter("damping", "N m s", 0.0, low=0.0),),
        (0.1,),
    )
    yield TreeFault(
        "armature",
        "the joint of {at} has an armature of {0}",
        _joint(lambda _, __, s: {"armature": s[0]}),
        ("mass_matrix", "accelerations", "wrenches"),
        jointed,
        (Parameter("armature", "kg m^2", 0.0, low=0.0),),
        (0.1,),
    )
    yield TreeFault(
        "coordinate-shift",
        "the coordinate of {at} is shifted by {0}",
        _joint(lambda joint, _, s: _shifted(joint, s[0])),
        bodies=of_kinds("hinge", "slide"),
        parameters=(Parameter("shift", "", 0.0),),
        start=(0.1,),
    )
    yield TreeFault(
        "parent-offset",
        "the joint's point of {at} in the parent is off by ({0}, {1}, {2}) m",
        _joint(lambda joint, _, d: {"at_parent": joint.at_parent + d}),
        bodies=jointed,
        parameters=LENGTHS,
        start=(0.0, 0.0, 0.0),
        special=_parents_link,
    )
    yield TreeFault(
        "body-offset",
        "the joint's point of {at} in the child is off by ({0}, {1}, {2}) m",
        _joint(lambda joint, _, d: {"at_body": joint.at_body + d}),
        bodies=jointed,
        parameters=LENGTHS,
        start=(0.0, 0.0, 0.0),
        special=_own_link,
    )
    yield TreeFault(
        "axis",
        "the axis of {at} is off by ({0}, {1}, {2})",
        _joint(lambda joint, _, d: {"axis": joint.axis / np.linalg.norm(joint.axis) + d}),
        bodies=of_kinds("hinge", "slide"),
        parameters=tuple(Parameter(axis, "", 0.0) for axis in "xyz"),
        start=(0.0, 0.0, 0.0),
    )


def _shifted(joint: Joint, by: float) -> dict[str, Array]:
    """Return the joint whose coordinate counts from elsewhere."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    if joint.kind == "slide":
        return {"at_parent": joint.at_parent + by * zero_rotation(joint) @ axis}
    return {"zero": quaternion_product(joint.zero, exp_quaternion(by * axis))}


def _is_held(joint: Joint, stiffness: float) -> dict[str, float]:
    """Return the joint with a spring that pulls it to its start besides its own."""
    total = joint.stiffness + stiffness
    pulled = joint.stiffness * joint.rest + stiffness * float(joint.coordinates[0])
    return {"stiffness": total, "rest": pulled / total if total else 0.0}


def motion_faults() -> Iterator[TreeFault]:
    """Yield those of motions alone."""
    yield TreeFault(
        "motor-position",
        "the joint of {at} has a motor that holds its start, with {0} N m per rad or N per m",
        _joint(lambda joint, _, s: _is_held(joint, s[0])),
        (),
        of_kinds("hinge", "slide"),
        (Parameter("gain", "", 0.0, low=0.0),),
        (0.1,),
    )
    yield TreeFault(
        "motor-friction",
        "the joint of {at} is braked, by a motor left on or by friction, with {0} N m or N",
        readings=(),
        bodies=of_kinds("hinge", "slide"),
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
        parameters=LENGTHS,
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
    return np.asarray(above @ (np.eye(3) if joint.kind == "free" else zero_rotation(joint)))
