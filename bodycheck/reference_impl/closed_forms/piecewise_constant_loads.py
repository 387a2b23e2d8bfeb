"""Sum the loads on a scene's body in rational arithmetic, from switch to switch.

These sums decide whether a motion has a closed form, exactly for the given doubles.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from math import inf

from bodycheck.reference_impl.rational import Vector, added, cross, fractions
from bodycheck.reference_impl.scene import ConstantLoad, Drag, PointForce, Scene, SineTorque, Torque
from bodycheck.reference_impl.wrench import constant_loads_between


@dataclass(frozen=True)
class Piece:
    """Torques (3,) and forces (3,) that are constant in their axes from begin_s to the next piece.

    force_world includes the weight. arms (9,): the sum of at F^T over the forces constant in world axes,
    whose torque depends on the attitude.
    """

    begin_s: float
    torque_body: Vector
    torque_world: Vector
    force_body: Vector
    force_world: Vector
    arms: Vector


@dataclass(frozen=True)
class PiecewiseLoads:
    """All loads: the pieces, linear drag in N s/m, angular drag (9,) in N m s, and sine torques."""

    pieces: list[Piece]
    linear_drag: Fraction
    angular_drag: Vector
    sines: list[SineTorque]

    @property
    def is_torque_free(self) -> bool:
        """Whether no torque but drag acts."""
        return not self.sines and not any(
            any(piece.torque_body) or any(piece.torque_world) or any(piece.arms) for piece in self.pieces
        )


def loads_of(scene: Scene) -> PiecewiseLoads | None:
    """Sum the loads, or return None where one has no closed form: a pivot, springs, the gravity gradient."""
    if scene.pivot is not None or not all(
        isinstance(load, SineTorque | Drag) for load in scene.continuous_loads
    ):
        return None
    drags = [load for load in scene.continuous_loads if isinstance(load, Drag)]
    angular = [Fraction(0)] * 9
    for drag in drags:
        angular = added(angular, fractions(drag.angular))
    edges = [0.0, *scene.switches_before(inf), inf]
    return PiecewiseLoads(
        [_piece(scene, begin, end) for begin, end in pairwise(dict.fromkeys(edges))],
        sum((Fraction(drag.linear) for drag in drags), Fraction(0)),
        angular,
        [load for load in scene.continuous_loads if isinstance(load, SineTorque) and load.amplitude.any()],
    )


def _piece(scene: Scene, begin: float, end: float) -> Piece:
    acting = constant_loads_between(scene, begin, end)
    weight = [Fraction(scene.body.mass) * g for g in fractions(scene.gravity)]
    forces = [load for load in acting if isinstance(load, PointForce)]
    world = [load for load in forces if load.axes == "world"]
    body = [load for load in forces if load.axes == "body"]
    couples = [cross(fractions(load.at), fractions(load.value)) for load in body]
    arms = [[a * f for a in fractions(load.at) for f in fractions(load.value)] for load in world]
    return Piece(
        begin,
        _sum([*_torques(acting, "body"), *couples], 3),
        _sum(_torques(acting, "world"), 3),
        _sum([fractions(load.value) for load in body], 3),
        _sum([weight, *(fractions(load.value) for load in world)], 3),
        _sum(arms, 9),
    )


def _torques(acting: Iterable[ConstantLoad], axes: str) -> list[Vector]:
    return [fractions(load.value) for load in acting if isinstance(load, Torque) and load.axes == axes]


def _sum(vectors: Iterable[Vector], width: int) -> Vector:
    total = [Fraction(0)] * width
    for vector in vectors:
        total = added(total, vector)
    return total
