"""The registry of faults: for each its sentence, its parameters, and what it changes in a model.

To add a fault, add one entry to FAULTS: specific ones before general ones, because a tie goes to the first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import permutations
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_matrix, vee
from bodycheck.reference_impl.scene import PointForce, Scene
from bodycheck.reports.diagnosis.engine_model import (
    ClampAxes,
    Loads,
    Misreading,
    Model,
    Reading,
    conjugated,
    cross,
    matrix_of,
    times,
    transposed_times,
)
from bodycheck.reports.diagnosis.transitions import Transitions

Kind: TypeAlias = Literal["body", "gravity", "map", "loads", "limit", "step", "reading", "precision"]


@dataclass(frozen=True)
class FaultContext:
    """What decides which faults are possible, and where a fit starts: a scene and its trajectory.

    stepped: whether the step of the method is known.
    """

    transitions: Transitions
    stepped: bool

    @property
    def scene(self) -> Scene:
        """The scene."""
        return self.transitions.scene

    @cached_property
    def loads(self) -> frozenset[str]:
        """The parts of the constant loads that act at some time."""
        return self.transitions.grid.loads.kinds

    @property
    def has_torque(self) -> bool:
        """Whether free torques act."""
        return bool(self.loads & {"torque_body", "torque_world"})

    @property
    def has_moment(self) -> bool:
        """Whether forces act off the centre of mass."""
        return bool(self.loads & {"lever", "moment"})

    @property
    def has_force(self) -> bool:
        """Whether forces act, gravity excepted."""
        return bool(self.loads & {"force_body", "force_world"})

    @property
    def has_gravity(self) -> bool:
        """Whether gravity acts."""
        return bool(np.any(self.scene.gravity))

    @property
    def switches(self) -> bool:
        """Whether a load begins or ends during the motion."""
        timeline = self.transitions.grid.timeline
        return bool(np.any(timeline != timeline[0, 0]))

    @property
    def is_free(self) -> bool:
        """Whether the body has no pivot."""
        return self.scene.pivot is None

    @property
    def rotates(self) -> bool:
        """Whether omega is not zero throughout."""
        return bool(np.any(self.transitions.trajectory.omega_body))

    @cached_property
    def later(self) -> tuple[Array, Array, Array, Array]:
        """v and w in world axes, w and v in body axes, of all samples but the first: (n - 1, 3)."""
        path = self.transitions.trajectory
        rotation = path.rotation_matrices[1:]
        v, w = path.velocity_m_s[1:], path.omega_body[1:]
        return v, np.einsum("nij,nj->ni", rotation, w), w, np.einsum("nji,nj->ni", rotation, v)


@dataclass(frozen=True)
class Parameter:
    """A number of a fault: its unit, its value in a healthy model, its range, and the unit of its changes."""

    name: str
    unit: str = ""
    healthy: float = 1.0
    low: float = -1e6
    high: float = 1e6
    size: float = 1.0


Plant: TypeAlias = Callable[[Model, Array, FaultContext], None]
Starts: TypeAlias = Callable[[FaultContext], Sequence[Sequence[float]]]


@dataclass(frozen=True)
class Fault:
    """One way to be wrong.

    sentence: with the parameters as {0}, {1}; special: the sentences of particular values of the first.
    starts: where a fit starts. applies: whether it could change this motion. is_general: whether it contains
    other faults as special cases, so that it is named only where these do not explain the motion. confirm:
    the experiment that would confirm it.
    """

    name: str
    kind: Kind
    sentence: str
    plant: Plant
    parameters: tuple[Parameter, ...] = ()
    starts: Starts = lambda _: [()]
    applies: Callable[[FaultContext], bool] = lambda _: True
    special: tuple[tuple[float, str], ...] = ()
    is_general: bool = False
    confirm: str = ""

    def special_text(self, values: Sequence[float] | Array) -> str:
        """Return the sentence of a particular value of the first parameter; "" for any other value."""
        for value, sentence in self.special:
            if len(values) and abs(values[0] - value) <= 1e-3 * max(1.0, abs(value)):
                return sentence
        return ""

    def text(self, values: Sequence[float] | Array) -> str:
        """Return the sentence with these values of the parameters."""
        return self.special_text(values) or self.sentence.format(*(_number(value) for value in values))


def _number(value: float) -> str:
    shown = f"{value:.5g}"
    if shown != "1" or value == 1.0:
        return shown
    return f"1 {'+' if value > 1.0 else '-'} {abs(value - 1.0):.2g}"


_FACTOR = Parameter("factor")
_POSITIVE_FACTOR = Parameter("factor", low=1e-6)
_RATE = Parameter("rate", "1/s", 0.0)


def _assigned(*names: str) -> Plant:
    """Return what assigns the first parameter to attributes of the model."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        for name in names:
            setattr(model, name, float(values[0]))

    return plant


def _constant(**changes: Any) -> Plant:
    """Return what assigns values to attributes of the model."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        for name, value in changes.items():
            setattr(model, name, value)

    return plant


def _changed(name: str, change: Callable[[Any, Array], Any]) -> Plant:
    """Return what changes an attribute of the model; change: of its value and the parameters."""
    return lambda model, values, _: setattr(model, name, change(getattr(model, name), values))


def _changed_loads(change: Callable[[Loads, Array, FaultContext], dict[str, Array]]) -> Plant:
    """Return what replaces parts of the loads."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        model.loads = replace(model.loads, **change(model.loads, values, at))

    return plant


def _near(*values: float) -> Starts:
    """Return starts at these values of one parameter."""
    return lambda _: [(value,) for value in values]


_Misread: TypeAlias = Callable[[Reading, Array, FaultContext], Reading]


def _misread(apply: _Misread, undo: _Misread) -> Plant:
    """Return what adds a misreading to the model."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        misreading = Misreading(lambda r: apply(r, values, at), lambda r: undo(r, values, at))
        model.misreadings = (*model.misreadings, misreading)

    return plant


# ---------------------------------------------------------------------------------------------- the body


def _moment_scaled(which: int) -> Callable[[Array, Array], Array]:
    def change(inertia: Array, values: Array) -> Array:
        moments, axes = np.linalg.eigh(inertia)
        moments[which] *= values[0]
        return np.asarray(axes @ np.diag(moments) @ axes.T)

    return change


_OTHER_ORDERS = list(permutations(range(3)))[1:]
"""All orders of three axes but the right one."""


def _off_diagonals(inertia: Array, values: Array) -> Array:
    diagonal = np.diag(np.diag(inertia))
    return np.asarray(diagonal + values[0] * (inertia - diagonal))


def _rotated(inertia: Array, values: Array) -> Array:
    turn = exp_matrix(values)
    return np.asarray(turn @ inertia @ turn.T)


def _any_inertia(inertia: Array, values: Array) -> Array:
    a, b, c, d, e, f = values
    return np.asarray(inertia + np.trace(inertia) / 3.0 * np.array([[a, d, e], [d, b, f], [e, f, c]]))


def _has_off_diagonals(at: FaultContext) -> bool:
    inertia = at.scene.body.inertia
    off = np.max(np.abs(inertia - np.diag(np.diag(inertia))))
    return bool(off > 1e-12 * np.max(np.abs(inertia)))


def _mass_and_inertia(model: Model, values: Array, at: FaultContext) -> None:
    model.mass, model.inertia = values[0] * model.mass, values[0] * model.inertia


def _inertia_axes(permutation: list[int]) -> Fault:
    axes = ["xyz"[k] for k in permutation]

    def permuted(inertia: Array) -> Array:
        return inertia[np.ix_(permutation, permutation)]

    def applies(at: FaultContext) -> bool:
        inertia = at.scene.body.inertia
        return not np.allclose(permuted(inertia), inertia, rtol=1e-12, atol=0.0)

    return Fault(
        f"inertia-axes-{''.join(axes)}",
        "body",
        f"the axes of the inertia tensor are permuted: x, y, z as {', '.join(axes)}",
        _changed("inertia", lambda inertia, _: permuted(inertia)),
        applies=applies,
        confirm="permute the moments in the scenario: the error must change with them",
    )


def _body() -> Iterator[Fault]:
    yield Fault(
        "off-diagonals",
        "body",
        "the off-diagonals of the inertia tensor are multiplied by {0}",
        _changed("inertia", _off_diagonals),
        (_FACTOR,),
        _near(0.0, -1.0, 1.0),
        _has_off_diagonals,
        (
            (0.0, "the off-diagonals of the inertia tensor are dropped"),
            (-1.0, "the off-diagonals of the inertia tensor have the wrong sign"),
        ),
        confirm="compare with a body whose axes are principal: its motion must be correct",
    )
    yield from (_inertia_axes(list(order)) for order in _OTHER_ORDERS)
    yield Fault(
        "inertia-sphere",
        "body",
        "the inertia is that of a sphere: trace(I) / 3 about every axis",
        _changed("inertia", lambda inertia, _: np.eye(3) * np.trace(inertia) / 3.0),
        confirm="a sphere must move correctly",
    )
    yield Fault(
        "inertia-inverted",
        "body",
        "the inertia tensor is replaced by its inverse",
        _changed("inertia", lambda inertia, _: np.linalg.inv(inertia)),
        confirm="read the inertia back from the engine",
    )
    yield Fault(
        "inertia-in-world-axes",
        "body",
        "the inertia tensor is not rotated with the body",
        _constant(inertia_in_world=1.0),
        applies=lambda at: at.rotates,
        confirm="a sphere must move correctly",
    )
    yield Fault(
        "inertia-scaled",
        "body",
        "the inertia is multiplied by {0}",
        _changed("inertia", lambda inertia, s: s[0] * inertia),
        (_POSITIVE_FACTOR,),
        _near(1.0),
        lambda at: at.has_torque or at.has_moment or bool(at.scene.continuous_loads) or not at.is_free,
        confirm="apply a known torque to a body at rest and divide it by the angular acceleration",
    )
    for which, word in enumerate(("smallest", "middle", "largest")):
        yield Fault(
            f"{word}-moment",
            "body",
            f"the {word} principal moment of inertia is multiplied by {{0}}",
            _changed("inertia", _moment_scaled(which)),
            (Parameter("factor", low=1e-3, high=1e3),),
            _near(1.0),
            confirm="spin the body up about this axis by a known torque",
        )
    yield Fault(
        "mass-scaled",
        "body",
        "the mass is multiplied by {0} where a force acts",
        _changed("mass", lambda mass, s: s[0] * mass),
        (_POSITIVE_FACTOR,),
        _near(1.0),
        lambda at: at.has_force or bool(at.scene.continuous_loads) or not at.is_free,
        confirm="push the body at its centre of mass and divide the force by the acceleration",
    )
    yield Fault(
        "mass-and-inertia-scaled",
        "body",
        "mass and inertia are multiplied by {0}",
        _mass_and_inertia,
        (_POSITIVE_FACTOR,),
        _near(1.0),
        lambda at: at.has_force and (at.has_torque or at.has_moment),
        confirm="weigh the body: compare force and acceleration",
    )


# --------------------------------------------------------------------------------------------- gravity


def _gravity_in_body_axes(model: Model, values: Array, at: FaultContext) -> None:
    model.gravity_body, model.gravity = model.gravity, np.zeros(3)


def _gravity_axes(permutation: list[int]) -> Fault:
    axes = ["xyz"[k] for k in permutation]
    return Fault(
        f"gravity-axes-{''.join(axes)}",
        "gravity",
        f"the axes of gravity are permuted: x, y, z as {', '.join(axes)}",
        _changed("gravity", lambda gravity, _: gravity[permutation]),
        applies=lambda at: bool(np.any(at.scene.gravity[permutation] != at.scene.gravity)),
        confirm="drop the body from rest",
    )


def _gravity_faults() -> Iterator[Fault]:
    yield Fault(
        "gravity",
        "gravity",
        "gravity is multiplied by {0}",
        _changed("gravity", lambda g, s: s[0] * g),
        (_FACTOR,),
        _near(1.0),
        lambda at: at.has_gravity,
        ((0.0, "gravity is missing"), (2.0, "gravity is applied twice"), (-1.0, "gravity is reversed")),
        confirm="drop the body from rest: its fall must be g t^2 / 2",
    )
    yield from (_gravity_axes(list(order)) for order in _OTHER_ORDERS)
    yield Fault(
        "gravity-in-body-axes",
        "gravity",
        "gravity rotates with the body",
        _gravity_in_body_axes,
        applies=lambda at: at.has_gravity,
        confirm="drop a rotating body",
    )


# ------------------------------------------------------------------------------------------------ the map


def _map_faults() -> Iterator[Fault]:
    yield Fault(
        "gyroscopic-term",
        "map",
        "the gyroscopic term omega x I omega is multiplied by {0}",
        _assigned("gyro"),
        (_FACTOR,),
        _near(1.0, 0.0, -1.0),
        lambda at: at.rotates,
        (
            (0.0, "the gyroscopic term omega x I omega is missing"),
            (-1.0, "the gyroscopic term omega x I omega has the wrong sign"),
        ),
        confirm="spin a free body off its principal axes: omega in body axes must change",
    )
    yield Fault(
        "omega-in-wrong-axes",
        "map",
        "omega rotates the attitude in the wrong axes: q+ = exp(dt omega) q with omega in body axes",
        _constant(world_turn=1.0),
        applies=lambda at: at.rotates,
        confirm="start the same motion from another attitude: the error must change",
    )
    yield Fault(
        "velocity-in-body-axes",
        "map",
        "the velocity rotates with the body: v' has the term omega x v",
        _constant(body_velocity=1.0),
        applies=lambda at: at.rotates and at.is_free,
        confirm="boost the scene by a velocity: the error must change",
    )
    yield Fault(
        "energy-pulled",
        "map",
        "the energy is pulled towards L^2 / (2 I2) at {0} 1/s, |L| unchanged",
        _assigned("energy_pull"),
        (_RATE,),
        _near(0.0, 1.0),
        lambda at: at.rotates,
        confirm="let the free body rotate for a long time: its energy must approach L^2 / (2 I2)",
    )
    yield Fault(
        "damping-angular",
        "map",
        "omega is damped at the rate {0} 1/s",
        _assigned("damping_w"),
        (_RATE,),
        _near(0.0, 1.0),
        lambda at: at.rotates,
        confirm="spin the body about a principal axis and wait",
    )
    yield Fault(
        "damping-linear",
        "map",
        "the velocity is damped at the rate {0} 1/s",
        _assigned("damping_v"),
        (_RATE,),
        _near(0.0, 1.0),
        lambda at: at.is_free,
        confirm="let the body fly without gravity",
    )
    yield Fault(
        "damping",
        "map",
        "the velocity and omega are damped at the rate {0} 1/s",
        _assigned("damping_v", "damping_w"),
        (_RATE,),
        _near(0.0, 1.0),
        lambda at: at.rotates and at.is_free,
        confirm="let the body fly and spin about a principal axis",
    )
    yield Fault(
        "damping-bullet",
        "map",
        "the velocity and omega are damped as by Bullet's multi-body, v' = -d (1 + |v|) v with d = {0} 1/s",
        _assigned("damping_v", "damping_v_speed", "damping_w", "damping_w_speed"),
        (Parameter("damping", "1/s", 0.0, size=0.1),),
        _near(0.0),
        confirm="set linearDamping and angularDamping to 0 and run the case again",
    )
    yield Fault(
        "damping-quadratic-angular",
        "map",
        "omega is damped by {0} |omega| omega",
        _assigned("damping_w_speed"),
        (Parameter("coefficient", "", 0.0),),
        _near(0.0),
        lambda at: at.rotates,
        confirm="spin the body about a principal axis at two speeds",
    )
    yield Fault(
        "damping-quadratic-linear",
        "map",
        "the velocity is damped by {0} |v| v",
        _assigned("damping_v_speed"),
        (Parameter("coefficient", "1/m", 0.0),),
        _near(0.0),
        lambda at: at.is_free,
        confirm="let the body fly at two speeds",
    )
    yield Fault(
        "position-by-old-velocity",
        "map",
        "the position advances with the velocity at the start of the step",
        _constant(old_velocity=1.0),
        applies=lambda at: at.is_free,
        confirm="drop the body from rest: its first step must not move it",
    )


# ------------------------------------------------------------------------------------------------ limits


def _largest_of(which: Literal["v", "w"], axes: ClampAxes, at: FaultContext) -> float:
    """Return the largest component, or norm, after the first sample."""
    v, w_world, w, v_body = at.later
    if axes == "norm":
        return float(np.max(np.linalg.norm(v if which == "v" else w, axis=-1)))
    values = {("v", "world"): v, ("v", "body"): v_body, ("w", "world"): w_world, ("w", "body"): w}
    return float(np.max(np.abs(values[which, axes])))


def _clamp(which: Literal["v", "w"], axes: ClampAxes, *, first: bool) -> Fault:
    noun, unit = ("the velocity", "m/s") if which == "v" else ("omega", "rad/s")
    part = "the norm of" if axes == "norm" else "each component of"
    tail = ("" if axes == "norm" else f" in {axes} axes") + ("" if first else " after the pose is updated")

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        setattr(model, f"clamp_{which}", (axes, abs(float(values[0]))))
        model.clamped_first = first

    def applies(at: FaultContext) -> bool:
        return bool(_largest_of(which, axes, at) > 0.0) and (which == "w" or at.is_free)

    return Fault(
        f"{'speed' if which == 'v' else 'omega'}-clamped-{axes}{'' if first else '-after'}",
        "limit",
        f"{part} {noun} is clamped at {{0}} {unit}{tail}",
        plant,
        (Parameter("limit", unit, math.inf, 0.0, 1e9, 1.0),),
        lambda at: [(_largest_of(which, axes, at),)],
        applies,
        confirm="start above and below the limit: only the motion above it must be wrong",
    )


def _both_clamped(model: Model, values: Array, at: FaultContext) -> None:
    limit = abs(float(values[0]))
    model.clamp_v, model.clamp_w = ("world", limit), ("world", limit)


def _quiet_speed(at: FaultContext) -> float:
    """Return the largest speed, in m/s or rad/s, at which the body does not move; 0 if it always does."""
    path = at.transitions.trajectory
    still = np.all(path.attitude[1:] == path.attitude[:-1], axis=-1)
    still &= np.all(path.position_m[1:] == path.position_m[:-1], axis=-1)
    if not still.any():
        return 0.0
    v, w = np.linalg.norm(path.velocity_m_s, axis=-1), np.linalg.norm(path.omega_body, axis=-1)
    return float(np.max(np.maximum(v, w)[:-1][still])) * (1.0 + 1e-9)


def _limits() -> Iterator[Fault]:
    everywhere: tuple[ClampAxes, ...] = ("world", "body", "norm")
    for first in (True, False):
        yield from (_clamp("w", axes, first=first) for axes in everywhere)
        yield from (_clamp("v", axes, first=first) for axes in everywhere)
    yield Fault(
        "velocities-clamped",
        "limit",
        "each component of the velocity and of omega in world axes is clamped at {0} m/s or rad/s",
        _both_clamped,
        (Parameter("limit", "m/s or rad/s", math.inf, 0.0, 1e9, 1.0),),
        lambda at: [(max(_largest_of("w", "world", at), _largest_of("v", "world", at)),)],
        lambda at: at.is_free and _largest_of("w", "world", at) > 0.0 and _largest_of("v", "world", at) > 0.0,
        confirm="start above and below the limit: only the motion above it must be wrong",
    )
    yield Fault(
        "turn-clamped",
        "limit",
        "the rotation in one step is limited to {0} rad",
        _assigned("largest_turn"),
        (Parameter("limit", "rad", math.inf, 1e-6, math.pi),),
        _near(math.pi / 4.0),
        lambda at: (
            at.stepped
            and bool(
                np.max(at.transitions.grid.dt_s)
                * np.max(np.linalg.norm(at.transitions.trajectory.omega_body, axis=-1))
                > 0.5
            )
        ),
        confirm="halve the step: the error must vanish",
    )
    yield Fault(
        "asleep",
        "limit",
        "the body sleeps: it stands still below {0} m/s and rad/s",
        _assigned("asleep"),
        (Parameter("threshold", "m/s and rad/s", 0.0, 0.0),),
        lambda at: [(_quiet_speed(at),)],
        lambda at: _quiet_speed(at) > 0.0,
        confirm="disable sleeping and run the case again",
    )


# ------------------------------------------------------------------------------------------------- loads


def _frozen(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    turned = loads.torque_body @ at.scene.initial.rotation.T
    return {"torque_body": 0.0 * loads.torque_body, "torque_world": loads.torque_world + turned}


def _arms_shifted(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {
        "lever": loads.lever + np.cross(values, loads.force_body),
        "moment": loads.moment + values[:, None] * loads.force_world[:, None, :],
    }


def _arms_turned(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {"moment": np.einsum("ji,pjk->pik", at.scene.initial.rotation, loads.moment)}


def _forces_swapped(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {"force_body": loads.force_world, "force_world": loads.force_body}


def _body_forces_in_world_axes(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    # the moment a x F of a body force, with F in world axes, needs a F^T, which the lever lacks
    forces = [load for load in at.scene.loads if isinstance(load, PointForce) and load.axes == "body"]
    sums = sum((np.outer(load.at, load.value) for load in forces), np.zeros((3, 3)))
    total = sum((load.value for load in forces), np.zeros(3))
    share = (loads.force_body @ total) / max(float(total @ total), 1e-300)
    return {
        "moment": loads.moment + share[:, None, None] * sums,
        "lever": 0.0 * loads.lever,
        "force_world": loads.force_world + loads.force_body,
        "force_body": 0.0 * loads.force_body,
    }


def _world_forces_in_body_axes(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    return {
        "lever": loads.lever - 2.0 * vee(loads.moment),
        "moment": 0.0 * loads.moment,
        "force_body": loads.force_body + loads.force_world,
        "force_world": 0.0 * loads.force_world,
    }


def _shifted(steps: int) -> Plant:
    def plant(model: Model, values: Array, at: FaultContext) -> None:
        line, none = model.timeline, len(model.loads.torque_body) - 1
        model.timeline = np.concatenate([np.full(steps, none), line[:-steps]])

    return plant


def _first_step_free(model: Model, values: Array, at: FaultContext) -> None:
    line = model.timeline.copy()
    line[0] = len(model.loads.torque_body) - 1
    model.timeline = line


def _released_late(model: Model, values: Array, at: FaultContext) -> None:
    """Let each segment but the first begin a step late, where the one before it has loads."""
    line = model.timeline
    parts = (
        model.loads.force_body,
        model.loads.force_world,
        model.loads.torque_body,
        model.loads.torque_world,
    )
    loaded = np.array([any(np.any(part[row]) for part in parts) for row in range(len(parts[0]))])
    delayed = line.copy()
    starts = np.flatnonzero(line[1:] != line[:-1]) + 1
    for index in starts:
        if loaded[line[index - 1]]:
            delayed[index] = line[index - 1]
    model.timeline = delayed


def _never_cleared(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    """Return each segment's loads with those of all earlier segments."""
    return {
        name: np.concatenate([np.cumsum(part[:-1], axis=0), part[-1:]]) for name, part in vars(loads).items()
    }


def _prolonged(loads: Loads, values: Array, at: FaultContext) -> dict[str, Array]:
    """Return the loads with those of the segment before it in each segment without loads."""
    parts = {name: part.copy() for name, part in vars(loads).items()}
    for row in range(1, len(loads.torque_body) - 1):
        if not any(np.any(part[row]) for part in vars(loads).values()):
            for part in parts.values():
                part[row] = part[row - 1]
    return parts


_ALL_LOADS = ("force_body", "force_world", "torque_body", "torque_world", "lever", "moment")


def _factor_texts(noun: str) -> tuple[tuple[float, str], ...]:
    return (
        (0.0, f"{noun} is missing"),
        (2.0, f"{noun} is applied twice"),
        (-1.0, f"{noun} has the opposite sign"),
    )


_LOAD_ALONE = "apply the load alone to a body at rest, and compare the momentum gained with its impulse"


def _scaled(
    name: str,
    sentence: str,
    parts: Sequence[str],
    applies: Callable[[FaultContext], bool],
    special: tuple[tuple[float, str], ...] = (),
) -> Fault:
    """Return the fault that parts of the loads are multiplied by a factor."""
    plant = _changed_loads(lambda held, s, _: {part: s[0] * getattr(held, part) for part in parts})
    return Fault(
        name, "loads", sentence, plant, (_FACTOR,), _near(1.0), applies, special, confirm=_LOAD_ALONE
    )


def _load_faults() -> Iterator[Fault]:
    yield _scaled(
        "torque",
        "torques are multiplied by {0}",
        ("torque_body", "torque_world"),
        lambda at: at.has_torque,
        _factor_texts("the torque"),
    )
    yield Fault(
        "torque-body-as-world",
        "loads",
        "a torque in body axes acts in world axes",
        _changed_loads(
            lambda h, _, __: {
                "torque_body": 0.0 * h.torque_body,
                "torque_world": h.torque_world + h.torque_body,
            }
        ),
        applies=lambda at: "torque_body" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "torque-world-as-body",
        "loads",
        "a torque in world axes acts in body axes",
        _changed_loads(
            lambda h, _, __: {
                "torque_body": h.torque_body + h.torque_world,
                "torque_world": 0.0 * h.torque_world,
            }
        ),
        applies=lambda at: "torque_world" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "torque-frozen",
        "loads",
        "a torque in body axes keeps its initial direction in world axes",
        _changed_loads(_frozen),
        applies=lambda at: "torque_body" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield _scaled(
        "moment",
        "the moments of forces are multiplied by {0}",
        ("lever", "moment"),
        lambda at: at.has_moment,
        (
            (0.0, "forces act at the centre of mass, not at their points"),
            (-1.0, "the moment of a force is F x r instead of r x F"),
        ),
    )
    yield _scaled(
        "force",
        "forces are multiplied by {0}",
        ("force_body", "force_world", "lever", "moment"),
        lambda at: at.has_force,
        _factor_texts("the force"),
    )
    yield _scaled(
        "force-without-moment",
        "forces are multiplied by {0}, their moments are right",
        ("force_body", "force_world"),
        lambda at: at.has_force and at.has_moment and at.is_free,
        ((0.0, "forces have moments, but do not push the centre of mass"),),
    )
    yield _scaled(
        "torque-and-moment",
        "torques and the moments of forces are multiplied by {0}",
        ("torque_body", "torque_world", "lever", "moment"),
        lambda at: at.has_torque and at.has_moment,
        _factor_texts("every torque"),
    )
    yield _scaled(
        "all-loads",
        "all loads except gravity are multiplied by {0}",
        _ALL_LOADS,
        lambda at: at.has_torque and at.has_force,
        ((2.0, "all loads are applied twice"), (0.0, "all loads except gravity are missing")),
    )
    yield from _applied_faults()
    for axes in ("body", "world"):
        moment = "lever" if axes == "body" else "moment"
        yield _scaled(
            f"force-{axes}",
            f"forces in {axes} axes are multiplied by {{0}}",
            (f"force_{axes}", moment),
            lambda at: {"force_body", "force_world"} <= at.loads,
            _factor_texts(f"the force in {axes} axes"),
        )
        yield _scaled(
            f"moment-{axes}",
            f"the moments of forces in {axes} axes are multiplied by {{0}}",
            (moment,),
            lambda at: {"lever", "moment"} <= at.loads,
            (
                (0.0, f"the force in {axes} axes acts at the centre of mass, not at its point"),
                (-1.0, f"the moment of the force in {axes} axes is F x r instead of r x F"),
            ),
        )
        yield _scaled(
            f"force-{axes}-without-moment",
            f"forces in {axes} axes are multiplied by {{0}}, their moments are right",
            (f"force_{axes}",),
            lambda at: {"force_body", "force_world"} <= at.loads and at.is_free,
        )
        yield _scaled(
            f"torque-{axes}",
            f"torques in {axes} axes are multiplied by {{0}}",
            (f"torque_{axes}",),
            lambda at: {"torque_body", "torque_world"} <= at.loads,
            _factor_texts(f"the torque in {axes} axes"),
        )
    yield Fault(
        "force-body-as-world",
        "loads",
        "a force in body axes acts in world axes, its moment is right",
        _changed_loads(
            lambda h, _, __: {"force_body": 0.0 * h.force_body, "force_world": h.force_world + h.force_body}
        ),
        applies=lambda at: "force_body" in at.loads and at.is_free,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-world-as-body",
        "loads",
        "a force in world axes acts in body axes, its moment is right",
        _changed_loads(
            lambda h, _, __: {"force_body": h.force_body + h.force_world, "force_world": 0.0 * h.force_world}
        ),
        applies=lambda at: "force_world" in at.loads and at.is_free,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-axes-exchanged",
        "loads",
        "forces act in the other axes, their moments are right",
        _changed_loads(_forces_swapped),
        applies=lambda at: {"force_body", "force_world"} <= at.loads and at.is_free,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-body-in-wrong-axes",
        "loads",
        "a force in body axes acts in world axes, and its moment too",
        _changed_loads(_body_forces_in_world_axes),
        applies=lambda at: "force_body" in at.loads and at.has_moment,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "force-world-in-wrong-axes",
        "loads",
        "a force in world axes acts in body axes, and its moment too",
        _changed_loads(_world_forces_in_body_axes),
        applies=lambda at: "force_world" in at.loads and at.has_moment,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "arm-in-world-axes",
        "loads",
        "the point of a world force is an offset in world axes, not in body axes",
        _constant(arm_in_world=1.0),
        applies=lambda at: "moment" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "arm-frozen",
        "loads",
        "the point of a world force does not rotate with the body",
        _constant(arm_in_world=2.0),
        applies=lambda at: "moment" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "arm-rotated",
        "loads",
        "the point of a world force is taken as an offset in world axes at the start",
        _changed_loads(_arms_turned),
        applies=lambda at: "moment" in at.loads,
        confirm=_LOAD_ALONE,
    )
    for steps in (1, 2):
        word = "one step" if steps == 1 else "two steps"
        yield Fault(
            f"load-late-{steps}",
            "loads",
            f"each load begins and ends {word} late",
            _shifted(steps),
            applies=lambda at: at.stepped and bool(at.loads),
            confirm="halve the step: the delay must halve",
        )
    yield Fault(
        "load-early",
        "loads",
        "each load begins and ends one step early",
        _changed("timeline", lambda line, _: np.concatenate([line[1:], line[-1:]])),
        applies=lambda at: at.stepped and at.switches,
        confirm="halve the step: the lead must halve",
    )
    yield Fault(
        "release-late",
        "loads",
        "each load ends one step late",
        _released_late,
        applies=lambda at: at.stepped and at.switches,
        confirm="halve the step: the delay must halve",
    )
    yield Fault(
        "first-step-free",
        "loads",
        "no load acts in the first step",
        _first_step_free,
        applies=lambda at: at.stepped and bool(at.loads),
        confirm="halve the step: the error must halve",
    )
    yield Fault(
        "load-never-cleared",
        "loads",
        "loads are added to the previous ones and never cleared",
        _changed_loads(_never_cleared),
        applies=lambda at: at.switches,
        confirm="end the load and wait: momentum must be constant",
    )
    yield Fault(
        "load-held-on",
        "loads",
        "a load continues after its end",
        _changed_loads(_prolonged),
        applies=lambda at: at.switches,
        confirm="end the load and wait: momentum must be constant",
    )
    yield Fault(
        "load-accumulates",
        "loads",
        "loads are applied again in each step and never cleared",
        _constant(ramp=1.0),
        applies=lambda at: at.stepped and bool(at.loads),
        confirm="apply a constant load: momentum must grow with the time, not with its square",
    )
    yield Fault(
        "continuous-loads",
        "loads",
        "continuous loads are multiplied by {0}",
        _assigned("continuous"),
        (_FACTOR,),
        _near(1.0),
        lambda at: bool(at.scene.continuous_loads),
        _factor_texts("the continuous load"),
        confirm=_LOAD_ALONE,
    )


def _applied_faults() -> Iterator[Fault]:
    """Yield faults of the torque in body axes as an adapter applies it, with the moments of body forces."""
    yield _scaled(
        "applied-torque",
        "torques are multiplied by {0}, the moments of body forces too",
        ("torque_body", "torque_world", "lever"),
        lambda at: at.has_torque and "lever" in at.loads,
        _factor_texts("every torque in body or world axes"),
    )
    yield Fault(
        "applied-torque-body-as-world",
        "loads",
        "a torque in body axes, and the moment of a body force, acts in world axes",
        _changed_loads(
            lambda h, _, __: {
                "torque_body": 0.0 * h.torque_body,
                "lever": 0.0 * h.lever,
                "torque_world": h.torque_world + h.torque_body + h.lever,
            }
        ),
        applies=lambda at: "lever" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield Fault(
        "applied-torque-frozen",
        "loads",
        "a torque in body axes, and the moment of a body force, keeps its initial direction in world axes",
        _changed_loads(
            lambda h, values, at: {
                **_frozen(replace(h, torque_body=h.torque_body + h.lever), values, at),
                "lever": 0.0 * h.lever,
            }
        ),
        applies=lambda at: "lever" in at.loads,
        confirm=_LOAD_ALONE,
    )
    yield _scaled(
        "applied-moment",
        "the torque in body axes and the moments of forces are multiplied by {0}",
        ("torque_body", "lever", "moment"),
        lambda at: {"torque_body", "lever"} <= at.loads,
        (
            (0.0, "torques in body axes and moments are missing"),
            (-1.0, "torques in body axes and moments have the opposite sign"),
        ),
    )
    yield _scaled(
        "applied-force",
        "forces and the torque in body axes are multiplied by {0}",
        ("force_body", "force_world", "torque_body", "lever", "moment"),
        lambda at: {"torque_body", "lever"} <= at.loads,
    )
    yield _scaled(
        "applied-force-without-lever",
        "forces are multiplied by {0}, the moments of body forces are right",
        ("force_body", "force_world", "moment"),
        lambda at: {"lever", "moment"} <= at.loads and at.is_free,
        ((0.0, "forces do not push the centre of mass, and world forces have no moment"),),
    )


# --------------------------------------------------------------------------------------- steps and readings


def _quaternions(
    given: Callable[[Array], Array],
    back: Callable[[Array], Array],
    taken: Callable[[Array], Array] | None = None,
) -> Plant:
    """Return what changes quaternions that are read; back: undoes it; taken: changes those that are set."""
    misread = _misread(lambda r, _, __: replace(r, q=given(r.q)), lambda r, _, __: replace(r, q=back(r.q)))

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        if taken is not None:
            model.start = taken
        misread(model, values, at)

    return plant


def _rolled(places: int) -> Callable[[Array], Array]:
    return lambda q: np.roll(q, places, axis=0)


def _scaled_reading(name: str) -> Plant:
    return _misread(
        lambda r, s, _: replace(r, **{name: s[0] * getattr(r, name)}),
        lambda r, s, _: replace(r, **{name: getattr(r, name) / s[0]}),
    )


def _with_omega(r: Reading, *, in_world: bool) -> Reading:
    """Return the reading with omega multiplied by R, into world axes, or by R^T, into body axes."""
    rotated = times if in_world else transposed_times
    return replace(r, w=rotated(matrix_of(r.q), r.w))


def _at_point(r: Reading, point: Array, at: FaultContext, *, position: bool, velocity: bool) -> Reading:
    """Return the reading with position or velocity of a point (3,) of the body, relative to those read."""
    rotation = matrix_of(r.q)
    arm = times(rotation, np.broadcast_to(point[:, None], r.x.shape))
    spin = r.w if at.transitions.world_omega else times(rotation, r.w)
    return replace(r, x=r.x + arm if position else r.x, v=r.v + cross(spin, arm) if velocity else r.v)


def _other_point(*, position: bool, velocity: bool) -> Plant:
    return _misread(
        lambda r, point, at: _at_point(r, point, at, position=position, velocity=velocity),
        lambda r, point, at: _at_point(r, -point, at, position=position, velocity=velocity),
    )


_DEGREES = (
    (180.0 / math.pi, "omega is read in degrees per second, not rad/s"),
    (0.5 / math.pi, "omega is read in revolutions per second, not rad/s"),
    (-1.0, "omega is read with the opposite sign"),
)
_ARM = tuple(Parameter(axis, "m", 0.0) for axis in "xyz")


def _late(name: str, quantities: str, noun: str) -> Fault:
    def plant(model: Model, values: Array, at: FaultContext) -> None:
        model.stale, model.lateness = frozenset(quantities), float(values[0])

    def applies(at: FaultContext) -> bool:
        return at.stepped and (at.is_free or bool(set(quantities) & {"q", "w"}))

    return Fault(
        name,
        "reading",
        f"{noun} read {{0}} steps late",
        plant,
        (Parameter("delay", "steps", 0.0, 0.01, 1.0),),
        _near(0.5, 1.0),
        applies,
        ((1.0, f"{noun} read one step late"), (0.5, f"{noun} read half a step late")),
        confirm="read the state twice in a row, and again after a step of length 0 if the engine allows it",
    )


def _reading_faults() -> Iterator[Fault]:
    yield Fault(
        "step-scaled",
        "step",
        "the step is multiplied by {0}: time passes at another rate",
        _assigned("step_factor"),
        (Parameter("factor", low=0.0, high=100.0),),
        _near(1.0, 0.5, 2.0),
        special=((0.5, "each step lasts half of its length"), (2.0, "each step lasts twice its length")),
        confirm="let the body fly without loads: its path must be v t",
    )
    yield Fault(
        "step-made-twice",
        "step",
        "each step is made twice",
        _constant(repeats=1.0),
        applies=lambda at: at.stepped,
        confirm="let the body fly without loads: its path must be v t",
    )
    yield _late("state-late", "xvqw", "the state is")
    yield _late("attitude-late", "q", "the attitude is")
    yield _late("omega-late", "w", "omega is")
    yield _late("position-late", "x", "the position is")
    yield _late("velocity-late", "v", "the velocity is")
    yield _late("pose-late", "xq", "the pose is")
    yield _late("velocities-late", "vw", "the velocities are")
    yield Fault(
        "quaternion-conjugated",
        "reading",
        "the quaternion is world to body, conjugated in and out",
        _quaternions(conjugated, conjugated, taken=conjugated),
        confirm="start from an attitude other than identity",
    )
    yield Fault(
        "quaternion-conjugated-when-read",
        "reading",
        "the quaternion that is read is world to body",
        _quaternions(conjugated, conjugated),
        confirm="compare q with the rotation matrix of the engine",
    )
    yield Fault(
        "quaternion-order",
        "reading",
        "the quaternion is scalar last, (x, y, z, w), in and out",
        _quaternions(_rolled(-1), _rolled(1), taken=_rolled(1)),
        confirm="start from a rotation by 90 degrees about one axis",
    )
    yield Fault(
        "quaternion-order-when-read",
        "reading",
        "the quaternion that is read is scalar last, (x, y, z, w)",
        _quaternions(_rolled(-1), _rolled(1)),
        confirm="read the attitude at t = 0",
    )
    yield Fault(
        "quaternion-order-when-set",
        "reading",
        "the quaternion that is set is taken as scalar last, (x, y, z, w)",
        _constant(start=_rolled(1)),
        confirm="read the attitude at t = 0",
    )
    yield Fault(
        "quaternion-conjugated-when-set",
        "reading",
        "the quaternion that is set is taken as world to body",
        _constant(start=conjugated),
        confirm="read the attitude at t = 0",
    )
    yield Fault(
        "omega-read-in-wrong-axes",
        "reading",
        "omega is read in the other axes, world for body or body for world",
        _misread(
            lambda r, _, at: _with_omega(r, in_world=not at.transitions.world_omega),
            lambda r, _, at: _with_omega(r, in_world=at.transitions.world_omega),
        ),
        applies=lambda at: at.rotates,
        confirm="compare omega with the derivative of the attitude",
    )
    yield Fault(
        "omega-read-scaled",
        "reading",
        "omega is multiplied by {0} when it is read",
        _scaled_reading("w"),
        (_FACTOR,),
        _near(1.0, *(value for value, _ in _DEGREES)),
        lambda at: at.rotates,
        _DEGREES,
        confirm="compare omega with the derivative of the attitude",
    )
    yield Fault(
        "velocity-read-scaled",
        "reading",
        "the velocity is multiplied by {0} when it is read",
        _scaled_reading("v"),
        (_FACTOR,),
        _near(1.0, -1.0, 1e3, 1e-3),
        lambda at: at.is_free,
        (
            (-1.0, "the velocity is read with the opposite sign"),
            (1e3, "the velocity is read in mm/s"),
            (1e-3, "the velocity is read in km/s"),
        ),
        confirm="compare it with the derivative of the position",
    )
    yield Fault(
        "position-read-scaled",
        "reading",
        "the position is multiplied by {0} when it is read",
        _scaled_reading("x"),
        (_FACTOR,),
        _near(1.0, -1.0, 1e3, 1e-3),
        lambda at: at.is_free,
        (
            (-1.0, "the position is read with the opposite sign"),
            (1e3, "the position is read in mm"),
            (1e-3, "the position is read in km"),
        ),
        confirm="compare its derivative with the velocity",
    )
    yield Fault(
        "velocity-read-in-body-axes",
        "reading",
        "the velocity is read in body axes",
        _misread(
            lambda r, _, __: replace(r, v=transposed_times(matrix_of(r.q), r.v)),
            lambda r, _, __: replace(r, v=times(matrix_of(r.q), r.v)),
        ),
        applies=lambda at: at.is_free,
        confirm="compare it with the derivative of the position",
    )
    yield Fault(
        "single-precision-stage",
        "precision",
        "omega is rounded to float32 in each stage",
        _constant(single_stage=1.0),
        applies=lambda at: at.rotates and not at.transitions.is_single,
        confirm="scan the engine's build for float32, and halve the step: the error must not decrease",
    )
    yield Fault(
        "float32",
        "precision",
        "the state is held in float32",
        _constant(single_state=1.0),
        confirm="halve the step: the error must not decrease",
    )


def _general() -> Iterator[Fault]:
    """Yield the faults that contain others as special cases, or whose parameters fit much."""
    confirm = "compare the momentum gained with the impulse of the loads"
    yield Fault(
        "velocity-of-another-point",
        "reading",
        "the velocity is that of the point ({0}, {1}, {2}) m of the body",
        _other_point(position=False, velocity=True),
        _ARM,
        lambda _: [(0.0, 0.0, 0.0)],
        lambda at: at.rotates and at.is_free,
        is_general=True,
        confirm="compare it with the derivative of the position",
    )
    yield Fault(
        "position-of-another-point",
        "reading",
        "the position is that of the point ({0}, {1}, {2}) m of the body",
        _other_point(position=True, velocity=False),
        _ARM,
        lambda _: [(0.0, 0.0, 0.0)],
        lambda at: at.rotates and at.is_free,
        is_general=True,
        confirm="spin the body about its centre of mass: the position must not change",
    )
    yield Fault(
        "state-of-another-point",
        "reading",
        "position and velocity are those of the point ({0}, {1}, {2}) m of the body",
        _other_point(position=True, velocity=True),
        _ARM,
        lambda _: [(0.0, 0.0, 0.0)],
        lambda at: at.rotates and at.is_free,
        is_general=True,
        confirm="spin the body about its centre of mass: the position must not change",
    )
    yield Fault(
        "arm-shifted",
        "loads",
        "moments of forces are taken about a point that is ({0}, {1}, {2}) m off the centre of mass",
        _changed_loads(_arms_shifted),
        _ARM,
        lambda _: [(0.0, 0.0, 0.0)],
        lambda at: at.has_force,
        is_general=True,
        confirm="push the body at its centre of mass: it must not rotate",
    )
    yield Fault(
        "inertia-axes-rotated",
        "body",
        "the principal axes are rotated by ({0}, {1}, {2}) rad",
        _changed("inertia", _rotated),
        tuple(Parameter(axis, "rad", 0.0, -math.pi, math.pi) for axis in "xyz"),
        lambda _: [(0.0, 0.0, 0.0)],
        is_general=True,
        confirm="read the inertia back from the engine",
    )
    yield Fault(
        "gravity-vector",
        "gravity",
        "gravity is off by ({0}, {1}, {2}) m/s^2",
        _changed("gravity", lambda g, d: g + d),
        tuple(Parameter(a, "m/s^2", 0.0) for a in "xyz"),
        lambda _: [(0.0, 0.0, 0.0)],
        is_general=True,
        confirm="drop the body from rest",
    )
    for noun, unit in (("torque", "N m"), ("force", "N")):
        for axes in ("body", "world"):
            yield Fault(
                f"spurious-{noun}-{axes}",
                "loads",
                f"a spurious constant {noun} of ({{0}}, {{1}}, {{2}}) {unit} in {axes} axes acts",
                _changed(f"spurious_{noun}_{axes}", lambda _, values: values),
                tuple(Parameter(a, unit, 0.0) for a in "xyz"),
                lambda _: [(0.0, 0.0, 0.0)],
                (lambda _: True) if noun == "torque" else (lambda at: at.is_free),
                is_general=True,
                confirm=confirm,
            )
    yield Fault(
        "inertia-tensor",
        "body",
        "the inertia tensor is off by xx {0}, yy {1}, zz {2}, xy {3}, xz {4}, yz {5} of its mean moment",
        _changed("inertia", _any_inertia),
        tuple(Parameter(name, "", 0.0, -2.0, 2.0) for name in ("xx", "yy", "zz", "xy", "xz", "yz")),
        lambda _: [(0.0,) * 6],
        is_general=True,
        confirm="read the inertia back from the engine",
    )


FAULTS: tuple[Fault, ...] = (
    *_map_faults(),
    *_limits(),
    *_gravity_faults(),
    *_body(),
    *_load_faults(),
    *_reading_faults(),
    *_general(),
)
"""All faults, the specific ones first."""
