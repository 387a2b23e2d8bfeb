"""The interface of a load: its table in a scenario file, force and torque, potential energy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Self, TypeAlias, get_type_hints

import numpy as np

from bodycheck.reference_impl.arrays import Array

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene
    from bodycheck.reference_impl.trajectory import Trajectory

Axes: TypeAlias = Literal["body", "world"]

WrenchFunction: TypeAlias = Callable[[float, Array, Array, Array, Array], tuple[Array, Array]]
"""f(t, position, R, velocity, omega) -> force in N, torque about the centre of mass in N m.

position, velocity, omega, force and torque are (3,), all in world axes; R (3, 3) maps body axes to world
axes. The function may be plain Python or compiled by numba.
"""

KeyForm: TypeAlias = Literal["number", "positive", "not negative", "vector", "damping matrix", "axes"]
REQUIRED = object()


class Key(NamedTuple):
    """One key of a load's table, as an annotation of the field that it sets.

    name: ends with the unit. form: the allowed values, one of KeyForm; a damping matrix is 3x3, or a number
    times the identity, and dissipates energy. omitted: the default value. seconds: the power of the second in
    the unit, such as -2 for N and -1 for rad/s; None where it is unknown, so that no truth of a scene with
    the load can be solved in another unit of time.
    """

    name: str
    form: KeyForm
    omitted: Any = REQUIRED
    seconds: int | None = None


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants of a motion: t (...), rotation (..., 3, 3) body to world; the rest (..., 3) in world axes."""

    t: Array
    position: Array
    rotation: Array
    velocity: Array
    omega: Array

    def rotated(self, vector: Array) -> Array:
        """R v (..., 3)."""
        return self.rotation @ vector

    def in_world(self, axes: Axes, value: Array) -> Array:
        """Return a vector (3,), given in these axes, in world axes: (..., 3)."""
        return self.rotated(value) if axes == "body" else np.broadcast_to(value, self.omega.shape)


class Load(ABC):
    """One kind of load; an instance is a frozen dataclass that holds its constants in SI units.

    kind: its name in scenario files and messages.
    """

    kind: ClassVar[str]

    @abstractmethod
    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return force and torque (..., 3) about the centre of mass, in N and N m, world axes."""

    @abstractmethod
    def about_pivot(self, scene: Scene, pivot: Array) -> Load:
        """Return the equivalent load on a body that rotates about a pivot (3,) in body axes.

        The wrench of the result takes the position (3,) of the pivot. Its forces have no effect.
        """

    @classmethod
    def keys(cls) -> dict[str, Key]:
        """Return the keys of the table, by the names of the fields that they set."""
        hints = get_type_hints(cls, include_extras=True)
        return {
            name: note
            for name, hint in hints.items()
            for note in getattr(hint, "__metadata__", ())
            if isinstance(note, Key)
        }

    def in_time_unit(self, exponent: int) -> Self | None:
        """Return the load in a unit of time of 2^exponent s, rounding nothing; None where that is unknown."""
        keys = {name: key for name, key in self.keys().items() if key.form != "axes"}
        if not keys or any(key.seconds is None for key in keys.values()):
            return None
        changed = {
            name: getattr(self, name) * 2.0 ** (-exponent * key.seconds)
            for name, key in keys.items()
            if key.seconds
        }
        return replace(self, **changed)  # type: ignore[type-var]  # every load is a dataclass


@dataclass(frozen=True, eq=False)
class ContinuousLoad(Load):
    """A load that acts throughout, and varies with time or with the motion.

    potential_needs: the arguments of its potential energy, of position and attitude; empty for a load
    without potential energy, whose work depends on the path. depends_on_velocity: whether its force or
    torque depends on the velocity or on omega. couples_translation: whether the position or velocity of
    the centre of mass affects the rotation. The defaults of the last two are always safe, but may impose
    unnecessary restrictions.
    """

    potential_needs: ClassVar[frozenset[str]] = frozenset()
    depends_on_velocity: ClassVar[bool] = True
    couples_translation: ClassVar[bool] = True

    def potential(self, scene: Scene, motion: Trajectory) -> Array:
        """Return the potential energy (n,) in J. Raise NotImplementedError for a load without one."""
        raise NotImplementedError(f"{self.kind} has no potential energy")

    def about_pivot(self, scene: Scene, pivot: Array) -> Load:
        """Return the same load, evaluated at the centre of mass of a body that rotates about a pivot (3,)."""
        return _AboutPivot(self, scene, pivot)


@dataclass(frozen=True, eq=False)
class _AboutPivot(ContinuousLoad):
    """tau + c x F at x = p + c, v = omega x c, c = -R pivot: a load of a scene about a pivot at p."""

    load: Load
    scene: Scene
    pivot: Array

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return zero force, because the pivot reacts it, and the torque about the pivot."""
        arm = -at.rotated(self.pivot)
        centre = replace(at, position=at.position + arm, velocity=np.cross(at.omega, arm))
        force, torque = self.load.wrench(self.scene, centre)
        return np.zeros_like(at.omega), torque + np.cross(arm, force)


def total_wrench(loads: Iterable[Load], scene: Scene, at: Instants) -> tuple[Array, Array]:
    """Return the sum of forces and torques (3,) at one instant."""
    force, torque = np.zeros(3), np.zeros(3)
    for load in loads:
        push, couple = load.wrench(scene, at)
        force, torque = force + push, torque + couple
    return force, torque


def checked(load: object, what: str) -> Load:
    """Return the load. Raise ValueError if its kind is unknown. what: as for `unknown_load`."""
    if not isinstance(load, Load):
        raise unknown_load(load, what)
    return load


def checked_continuous(load: object, what: str) -> ContinuousLoad:
    """Return the continuous load. Raise ValueError as `checked` does."""
    if not isinstance(load, ContinuousLoad):
        raise unknown_load(load, what)
    return load


def unknown_load(load: object, what: str) -> ValueError:
    """Return the error for a load of an unknown kind. what: the component that does not support it."""
    return ValueError(f"{what} does not know loads of the kind {type(load).__name__}")
