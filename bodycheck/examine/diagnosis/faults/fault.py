"""A fault: its sentence, its parameters, and what it changes in a model; what such changes have in common."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import EXACT, Base
from bodycheck.examine.diagnosis.engine_model import Loads, Misreading, Model, ReportedStates
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene

Kind: TypeAlias = Literal["body", "gravity", "map", "loads", "limit", "step", "reading", "precision"]


@dataclass(frozen=True)
class FaultContext:
    """What decides which faults are possible, and where a fit starts: a scene and its trajectory.

    base: the map in which faults are planted.
    """

    transitions: Transitions
    base: Base

    @property
    def stepped(self) -> bool:
        """Whether the step of the method is known."""
        return self.base is not EXACT

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
    def shows_translation(self) -> bool:
        """Whether the body has no pivot, and the trajectory has positions or velocities."""
        return self.is_free and bool(self.transitions.known & {"position", "velocity"})

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
    other faults as special cases, so that it is named only where these do not explain the motion.
    is_flexible: whether it makes nearly any method, and any with another fault, so that it is named only
    alone and where it leaves nothing. confirm: the experiment that would confirm it.
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
    is_flexible: bool = False
    confirm: str = ""

    def could_change(self, at: FaultContext) -> bool:
        """Whether this fault could change a motion, and names only quantities that the trajectory has."""
        missing = _NAMED.keys() - at.transitions.known
        return self.applies(at) and not any(_NAMED[name].search(self.sentence) for name in missing)

    @property
    def particular(self) -> list[tuple[Array, str]]:
        """The values that leave no parameter open, with their sentences."""
        if not self.parameters:
            return [(np.zeros(0), self.sentence)]
        return [(np.array([value]), text) for value, text in self.special]

    def special_text(self, values: Sequence[float] | Array) -> str:
        """Return the sentence of a particular value of the first parameter; "" for any other value."""
        for value, sentence in self.special:
            if len(values) and abs(values[0] - value) <= 1e-3 * max(1.0, abs(value)):
                return sentence
        return ""

    def text(self, values: Sequence[float] | Array) -> str:
        """Return the sentence with these values of the parameters."""
        shown = [number_text(v, p.healthy) for v, p in zip(values, self.parameters, strict=False)]
        return self.special_text(values) or self.sentence.format(*shown)


_NAMED = {
    "position": re.compile(r"\bposition|\bpose\b"),
    "velocity": re.compile(r"\bvelocit"),
    "attitude": re.compile(r"\bquaternion|\battitude"),
    "omega": re.compile(r"\bomega\b"),
}
"""Quantity -> how a sentence names it."""


def number_text(value: float, healthy: float = 1.0) -> str:
    """Return a parameter in five digits; one close to its healthy value as the difference from it."""
    shown = f"{value:.5g}"
    if healthy == 0.0 or shown != f"{healthy:.5g}" or value == healthy:
        return shown
    return f"{shown} {'+' if value > healthy else '-'} {abs(value - healthy):.2g}"


FACTOR = Parameter("factor")


def assigned(*names: str) -> Plant:
    """Return what assigns the first parameter to attributes of the model."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        for name in names:
            setattr(model, name, float(values[0]))

    return plant


def constant(**changes: Any) -> Plant:
    """Return what assigns values to attributes of the model."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        for name, value in changes.items():
            setattr(model, name, value)

    return plant


def constant_and_first(changes: Mapping[str, Any], name: str) -> Plant:
    """Return what assigns values to attributes of the model, and the first parameter to another one."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        for attribute, value in changes.items():
            setattr(model, attribute, value)
        setattr(model, name, float(values[0]))

    return plant


@dataclass(frozen=True)
class Changed:
    """Changes an attribute of the model; change: of its value and the parameters."""

    name: str
    change: Callable[[Any, Array], Any]

    def __call__(self, model: Model, values: Array, _: FaultContext) -> None:
        """Change the model."""
        setattr(model, self.name, self.change(getattr(model, self.name), values))


def changed_loads(change: Callable[[Loads, Array, FaultContext], dict[str, Array]]) -> Plant:
    """Return what replaces parts of the loads."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        model.loads = replace(model.loads, **change(model.loads, values, at))

    return plant


def near(*values: float) -> Starts:
    """Return starts at these values of one parameter."""
    return lambda _: [(value,) for value in values]


_Read: TypeAlias = Callable[[ReportedStates, Array, bool], ReportedStates]
"""Of a reading, the parameters, and whether omega is read in world axes."""


@dataclass(frozen=True)
class Misread:
    """A wrong reading of right states, and how it is undone.

    as_set: what becomes of a quaternion that is set.
    """

    apply: _Read
    undo: _Read
    as_set: Callable[[Array], Array] | None = None

    def __call__(self, model: Model, values: Array, at: FaultContext) -> None:
        """Add the misreading to the model."""
        world = at.transitions.world_omega
        misreading = Misreading(lambda r: self.apply(r, values, world), lambda r: self.undo(r, values, world))
        model.misreadings = (*model.misreadings, misreading)
        model.start = model.start if self.as_set is None else self.as_set
