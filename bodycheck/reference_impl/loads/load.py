"""What every kind of load defines: its table in a scenario file, force and torque, potential energy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, TypeAlias, get_type_hints

import numpy as np

from bodycheck.reference_impl.arrays import Array

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene
    from bodycheck.reference_impl.trajectory import Trajectory

Axes: TypeAlias = Literal["body", "world"]

Wrenching: TypeAlias = Callable[[float, Array, Array, Array, Array], tuple[Array, Array]]
"""f(t, position, R, velocity, omega) -> force in N, torque about the centre of mass in N m.

position, velocity, omega, force and torque are (3,), all in world axes; R (3, 3) takes body axes to world
axes. A function compiled by numba serves as well as a plain one.
"""

KeyForm: TypeAlias = Literal["number", "positive", "not negative", "vector", "damping matrix", "axes"]
REQUIRED = object()


class Key(NamedTuple):
    """One key of a load's table, as an annotation of the field that it fills.

    name: with its unit at the end. form: what it may be; a damping matrix is 3x3, or a number times the
    identity, and takes energy away. omitted: its value where the table leaves it out.
    """

    name: str
    form: KeyForm
    omitted: Any = REQUIRED


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants of a motion: t (...), rotation (..., 3, 3) body to world; the rest (..., 3) in world axes."""

    t: Array
    position: Array
    rotation: Array
    velocity: Array
    omega: Array

    def turned(self, vector: Array) -> Array:
        """R v (..., 3)."""
        return self.rotation @ vector

    def in_world(self, axes: Axes, value: Array) -> Array:
        """Return a vector (3,) of these axes in world axes: (..., 3)."""
        return self.turned(value) if axes == "body" else np.broadcast_to(value, self.omega.shape)


class Load(ABC):
    """One kind of load; an instance is a frozen dataclass of its constants, in SI units.

    kind: its name in scenario files and messages.
    """

    kind: ClassVar[str]

    @abstractmethod
    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return force and torque (..., 3) about the centre of mass, in N and N m, world axes."""

    @abstractmethod
    def about_pivot(self, scene: Scene, pivot: Array) -> Load:
        """Return what it does to a body that turns about a pivot (3,) in body axes, as a load about that.

        Its wrench is given positions (3,) of the pivot; its forces no longer matter.
        """

    @classmethod
    def keys(cls) -> dict[str, Key]:
        """Return the keys of the table by the names of the fields that they fill."""
        hints = get_type_hints(cls, include_extras=True)
        return {
            name: note
            for name, hint in hints.items()
            for note in getattr(hint, "__metadata__", ())
            if isinstance(note, Key)
        }


@dataclass(frozen=True, eq=False)
class ContinuousLoad(Load):
    """A load that acts throughout, and varies with the time or the motion.

    potential_needs: which of position and attitude its potential energy is a function of; nothing for a
    load without one, whose work depends on the way. depends_on_velocity: whether its force or torque is a
    function of the velocity or of omega. couples_translation: whether it lets the position or velocity of
    the centre of mass act on the rotation. A load that leaves the last two as they are is only treated
    with more care than it may need.
    """

    potential_needs: ClassVar[frozenset[str]] = frozenset()
    depends_on_velocity: ClassVar[bool] = True
    couples_translation: ClassVar[bool] = True

    def potential(self, scene: Scene, motion: Trajectory) -> Array:
        """Return the potential energy (n,) in J of a load that has one."""
        raise NotImplementedError(f"{self.kind} has no potential energy")

    def about_pivot(self, scene: Scene, pivot: Array) -> Load:
        """Return the same load at where the centre of mass is while the body turns about a pivot (3,)."""
        return _AboutPivot(self, scene, pivot)


@dataclass(frozen=True, eq=False)
class _AboutPivot(ContinuousLoad):
    """tau + c x F at x = p + c, v = omega x c, c = -R pivot: a load of a scene about a pivot at p."""

    load: Load
    scene: Scene
    pivot: Array

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return no force, which the pivot takes up, and the torque about the pivot."""
        arm = -at.turned(self.pivot)
        centre = replace(at, position=at.position + arm, velocity=np.cross(at.omega, arm))
        force, torque = self.load.wrench(self.scene, centre)
        return np.zeros_like(at.omega), torque + np.cross(arm, force)


def total_wrench(loads: Iterable[Load], scene: Scene, at: Instants) -> tuple[Array, Array]:
    """Return the sum of forces and torques (3,) at one instant."""
    force, torque = np.zeros(3), np.zeros(3)
    for load in loads:
        push, turn = load.wrench(scene, at)
        force, torque = force + push, torque + turn
    return force, torque


def checked(load: object, what: str) -> Load:
    """Return a load; raises ValueError where it is of no kind that is known. what: as `unknown_load`."""
    if not isinstance(load, Load):
        raise unknown_load(load, what)
    return load


def checked_continuous(load: object, what: str) -> ContinuousLoad:
    """Return a continuous load; raises ValueError as `checked` does."""
    if not isinstance(load, ContinuousLoad):
        raise unknown_load(load, what)
    return load


def unknown_load(load: object, what: str) -> ValueError:
    """Return what to raise where a load is of no kind that is known; what: that which knows it not."""
    return ValueError(f"{what} does not know loads of the kind {type(load).__name__}")
