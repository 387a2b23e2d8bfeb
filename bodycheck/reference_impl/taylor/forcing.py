"""Pack the loads on a body between two switches as the numbers that the Taylor kernels take.

Sums of loads are computed in rational arithmetic and rounded once, to double-doubles, because the truth must
not start from rounded sums. Terms that a scene does not have are None, and are compiled out of the kernels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import gyration_radius
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.generic_precision import Numbers, high_part
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, checked_continuous, total_wrench
from bodycheck.reference_impl.loads.recorded_formula import Tape, recorded
from bodycheck.reference_impl.pivot import inertia_about
from bodycheck.reference_impl.rational import (
    Vector,
    added,
    cross,
    fractions,
    inverse,
    pair,
    rotation_of,
    times,
    unit_quaternion,
)
from bodycheck.reference_impl.scene import (
    ConstantLoad,
    Drag,
    GravityGradient,
    PointForce,
    Scene,
    SineTorque,
    Spring,
    Torque,
    TorsionSpring,
)
from bodycheck.reference_impl.wrench import constant_loads_between

# offsets into Forcing.rotational ...
INERTIA, INERTIA_INVERSE, TORQUE_BODY = 0, 9, 18
# ... of Forcing.world ...
TORQUE_WORLD, MOMENT = 0, 3
# ... of Forcing.orbit ...
GRADIENT, ORBIT_RATE = 0, 1
# ... of Forcing.translational ...
ACCELERATION_BODY, ACCELERATION_WORLD, DECAY, MASS_INVERSE, RADIUS = 0, 3, 6, 7, 8
# ... and each row of Forcing.springs; the low parts of anchor and at are LOW after their high parts
ANCHOR, AT, STIFFNESS, REST_LENGTH, LOW = 0, 3, 6, 7, 8


@dataclass(frozen=True, eq=False)
class Forcing:
    """The constants of the equations of motion, in one precision.

    For a body with a pivot, I, the points and the anchors are relative to the pivot, which has no
    acceleration and stays at position 0.

    rotational (21,): I, I^-1, the constant torque in body axes. damping (9,): the angular drag C. body_sines
    and world_sines (n, 5): amplitude, rate, phase of each sine torque, doubles. world (12,): the constant
    torque in world axes; moment = sum of at F^T over the world forces; 0 where there is none, because
    kernels without it would be further kernels to compile. orbit (2,): 3 n^2 and n of the gravity
    gradient. translational (9,): constant acceleration in body axes and in world axes, drag over mass,
    1 / mass, radius of gyration. springs (n, 14): anchor, at, stiffness, rest length, then the low parts of
    anchor and at. torsion (5,): stiffness and q(0). recorded (n, 5): the operations of recorded_formula.py
    that sum all other loads, with the torque in body axes. on_parabola: the centre of mass moves under a
    constant acceleration, independent of the rotation.
    """

    rotational: Numbers
    damping: Numbers | None
    body_sines: Array | None
    world: Numbers
    world_sines: Array | None
    orbit: Numbers | None
    translational: Numbers
    springs: Array | None
    torsion: Numbers | None
    recorded: Array | None
    on_parabola: bool

    def rounded(self) -> Forcing:
        """Return the same constants rounded to doubles."""
        return Forcing(**{field.name: high_part(getattr(self, field.name)) for field in fields(self)})


def forcing_between(scene: Scene, begin_s: float, end_s: float) -> Forcing:
    """Return the forcing within [begin_s, end_s), which contains no switch, in double-doubles.

    Raises ValueError for unsupported loads.
    """
    if scene.has_callback_load:
        raise ValueError("a load given only as a function has no Taylor series")
    others = [
        checked_continuous(load, "the Taylor series of a motion")
        for load in scene.continuous_loads
        if not isinstance(load, SineTorque | Drag | Spring | TorsionSpring | GravityGradient)
    ]
    constant_loads = constant_loads_between(scene, begin_s, end_s)
    sines = [load for load in scene.continuous_loads if isinstance(load, SineTorque)]
    drags = [load for load in scene.continuous_loads if isinstance(load, Drag)]
    springs = [load for load in scene.continuous_loads if isinstance(load, Spring)]
    torsion = [load for load in scene.continuous_loads if isinstance(load, TorsionSpring)]
    gradients = [load for load in scene.continuous_loads if isinstance(load, GravityGradient)]
    body_sines, world_sines = (_sine_rows(sines, axes) for axes in ("body", "world"))
    if gradients and scene.pivot is not None:
        raise ValueError("a body with a pivot is not in orbit: no gravity gradient can act on it")
    orbit, damping = _orbit(gradients), _damping(scene, drags)
    translational = _translational(scene, constant_loads, drags)
    forced_in_body = any(translational[ACCELERATION_BODY:ACCELERATION_WORLD])
    return Forcing(
        _pairs(_rotational(scene, constant_loads)),
        _pairs(damping) if any(damping) else None,
        body_sines,
        _pairs(_world(scene, constant_loads)),
        world_sines,
        _pairs(orbit) if orbit else None,
        _pairs(translational),
        _spring_rows(scene, springs) if springs else None,
        _torsion(scene, torsion) if torsion else None,
        _recorded(scene, others) if others else None,
        not (forced_in_body or springs or others or translational[DECAY]),
    )


def _rotational(scene: Scene, constant_loads: Iterable[ConstantLoad]) -> Vector:
    torque = [Fraction(0)] * 3
    for load in constant_loads:
        if load.axes == "body":
            value = fractions(load.value)
            torque = added(torque, value if isinstance(load, Torque) else cross(_arm(scene, load.at), value))
    inertia = fractions(scene.body.inertia)
    if scene.pivot is not None:
        inertia = inertia_about(inertia, Fraction(scene.body.mass), fractions(scene.pivot))
    return [*inertia, *inverse(inertia), *torque]


def _arm(scene: Scene, at: Array) -> Vector:
    """Return a body-fixed point relative to the pivot, if there is one."""
    point = fractions(at)
    if scene.pivot is None:
        return point
    return [x - p for x, p in zip(point, fractions(scene.pivot), strict=True)]


def _damping(scene: Scene, drags: Iterable[Drag]) -> Vector:
    damping = [Fraction(0)] * 9
    for drag in drags:
        damping = added(damping, fractions(drag.angular))
        if scene.pivot is not None:  # -c v at the centre of mass, v = omega x (x - pivot)
            damping = inertia_about(damping, Fraction(drag.linear), fractions(scene.pivot))
    return damping


def _world(scene: Scene, constant_loads: Iterable[ConstantLoad]) -> Vector:
    torque, moment = [Fraction(0)] * 3, [Fraction(0)] * 9
    for load in constant_loads:
        if load.axes == "world":
            value = fractions(load.value)
            if isinstance(load, Torque):
                torque = added(torque, value)
            else:
                moment = added(moment, [a * f for a in _arm(scene, load.at) for f in value])
    if scene.pivot is not None:
        weight = [Fraction(scene.body.mass) * g for g in fractions(scene.gravity)]
        moment = added(moment, [a * f for a in _arm(scene, np.zeros(3)) for f in weight])
    return [*torque, *moment]


def _orbit(gradients: Sequence[GravityGradient]) -> Vector:
    if len({load.rate for load in gradients}) > 1:
        raise ValueError("gravity gradients of different orbits cannot act on one body")
    rates = [Fraction(load.rate) for load in gradients]
    return [3 * len(rates) * rates[0] ** 2, rates[0]] if rates else []


def _translational(scene: Scene, constant_loads: Iterable[ConstantLoad], drags: Iterable[Drag]) -> Vector:
    if scene.pivot is not None:
        return [Fraction(0)] * (RADIUS + 1)
    mass = Fraction(scene.body.mass)
    sums = {"body": [Fraction(0)] * 3, "world": [mass * g for g in fractions(scene.gravity)]}
    for load in constant_loads:
        if isinstance(load, PointForce):
            sums[load.axes] = added(sums[load.axes], fractions(load.value))
    forces = [force / mass for axes in ("body", "world") for force in sums[axes]]
    decay = sum((Fraction(drag.linear) for drag in drags), Fraction(0)) / mass
    return [*forces, decay, 1 / mass, Fraction(gyration_radius(scene.body.mass, scene.body.inertia))]


def _sine_rows(sines: Iterable[SineTorque], axes: str) -> Array | None:
    rows = [[*load.amplitude, load.rate, load.phase] for load in sines if load.axes == axes]
    return np.array(rows, dtype=np.float64) if rows else None


def _spring_rows(scene: Scene, springs: Iterable[Spring]) -> Array:
    origin = [Fraction(0)] * 3 if scene.pivot is None else pivot_position(scene)
    rows = []
    for load in springs:
        anchor = [x - o for x, o in zip(fractions(load.anchor), origin, strict=True)]
        places = [pair(x) for x in (*anchor, *_arm(scene, load.at))]
        high, low = zip(*places, strict=True)
        rows.append([*high, load.stiffness, load.rest_length, *low])
    return np.array(rows, dtype=np.float64)


def pivot_position(scene: Scene) -> Vector:
    """x(0) + R(0) pivot, exactly: the fixed position of the pivot in world axes."""
    assert scene.pivot is not None
    rotated = times(rotation_of(fractions(scene.initial.quaternion)), fractions(scene.pivot))
    return added(fractions(scene.initial.position), rotated)


def _torsion(scene: Scene, springs: Iterable[TorsionSpring]) -> Numbers:
    stiffness = pair(sum((Fraction(load.stiffness) for load in springs), Fraction(0)))
    return _columns([stiffness, *unit_quaternion(scene.initial.quaternion)])


def _recorded(scene: Scene, loads: Sequence[ContinuousLoad]) -> Array:
    """Record force and, in body axes, torque; about the fixed pivot if there is one."""
    about = [load if scene.pivot is None else load.about_pivot(scene, scene.pivot) for load in loads]

    def formula(tape: Tape, at: Instants) -> tuple[Array, Array]:
        at = replace(at, omega=at.rotation @ at.omega)
        if scene.pivot is not None:
            origin = [tape.constant(*pair(x)) for x in pivot_position(scene)]
            at = replace(at, position=np.array(origin, dtype=object), velocity=np.zeros(3))
        force, torque = total_wrench(about, scene, at)
        return force, at.rotation.T @ torque

    return recorded(formula)


def _pairs(values: Iterable[Fraction]) -> Numbers:
    return _columns([pair(x) for x in values])


def _columns(values: Sequence[DoubleDouble]) -> Numbers:
    columns = np.array(values, dtype=np.float64).T
    return np.ascontiguousarray(columns[0]), np.ascontiguousarray(columns[1])
