"""A fault of trees: what it makes of the readings of an engine, and of a motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bodycheck.adapters.reading_names import READINGS
from bodycheck.examine.diagnosis.faults.fault import Parameter
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.examine.dynamics.tree_flow import TreeHypothesis
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeScene

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
class AnotherTree:
    """Evaluates the exact equations of another tree, or moves it."""

    change: Callable[[TreeScene, Sequence[int], Array], TreeScene]

    def __call__(self, case: TreeCase, bodies: Sequence[int], values: Array) -> Faulty:
        """Return the readings of the other tree."""
        changed = self.change(case.scene, bodies, values)
        return case.changed(lambda state: TreeState(changed, state.q, state.u)).exact

    def move(self, model: TreeHypothesis, bodies: Sequence[int], values: Array) -> None:
        """Move the other tree."""
        model.scene = self.change(model.scene, bodies, values)


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
        return self.plant.move if isinstance(self.plant, AnotherTree) else self.motion


LENGTHS = tuple(Parameter(axis, "m", 0.0) for axis in ("x", "y", "z"))


def jointed(scene: TreeScene) -> list[int]:
    """Return the bodies that a joint connects."""
    return [k for k, body in enumerate(scene.bodies) if body.joint.kind != "free"]


def of_kinds(*kinds: str) -> Bodies:
    """Return what finds the bodies whose joints are of some kinds."""
    return lambda scene: [k for k, body in enumerate(scene.bodies) if body.joint.kind in kinds]


def all_bodies(scene: TreeScene) -> Sequence[int]:
    """Return all bodies."""
    return range(len(scene.bodies))


def zero_rotation(joint: Joint) -> Array:
    """Return the rotation (3, 3) of a joint at coordinates 0, from the axes of its child to its parent's."""
    return quaternion_to_matrix(joint.zero / np.linalg.norm(joint.zero))
