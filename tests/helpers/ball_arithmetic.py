"""Enclosures of motions: Taylor steps in ball arithmetic, with rigorous remainders, by FLINT.

Each step first finds a box that the solution cannot leave (Picard and Lindelof), and then encloses the
remainder of the Taylor polynomial by the last coefficient over that box: Moore (1966), Interval Analysis,
chapter 11. The equations of motion are written here from the textbook, and share nothing with bodycheck but
the numbers of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import flint
import numpy as np
from flint import arb, arb_mat, arb_series

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    PointForce,
    Scene,
    SineTorque,
    Spring,
    Torque,
)
from bodycheck.reference_impl.truth.truth import Truth

BITS = 240
_ORDER = 22
_STEP = 0.25  # of the shortest time scale
_DIGITS = (21, 33, 48)
_NARROW = 1e-18
_RETRIES = 12

State = list[Any]
"""x (3), v (3), q (4), omega in body axes (3): balls, or series of them."""


def enclosures(scene: Scene, times: Sequence[float]) -> list[State]:
    """Return balls that contain the state at ascending times from 0 on.

    Remainders are made smaller until every radius is below 1e-18; raises ArithmeticError if that is no help.
    """
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        for digits in _DIGITS:
            found = _enclosures(scene, times, arb(10) ** -digits)
            if all(part.rad() < _NARROW for state in found for part in state):
                return found
    finally:
        flint.ctx.prec = before
    raise ArithmeticError("the enclosures are too wide")


def _enclosures(scene: Scene, times: Sequence[float], smallest: Any) -> list[State]:
    switches = {0.0, *(t for load in scene.loads for t in _ends(load) if 0.0 < t < times[-1])}
    state, now, found = _start(scene), 0.0, {0.0: _start(scene)}
    for end in sorted({*switches, *times} - {0.0}):
        active = [load for load in scene.loads if _ends(load)[0] <= now < _ends(load)[1]]
        motion = _Motion(scene, active, smallest)
        count = max(math.ceil((end - now) * motion.rate(state) / _STEP), 1)
        length = (arb(end) - arb(now)) / count
        for index in range(count):
            state = motion.step(arb(now) + length * index, state, length)
        found[end], now = state, end
    return [found[t] for t in times]


def _ends(load: Any) -> tuple[float, float]:
    return getattr(load, "from_s", 0.0), getattr(load, "until_s", math.inf)


def _start(scene: Scene) -> State:
    start = scene.initial
    q = list(map(arb, start.quaternion.tolist()))
    norm = sum(part * part for part in q).sqrt()
    q = [part / norm for part in q]
    if start.exact_omega_world is None:
        omega = list(map(arb, start.omega_body.tolist()))
    else:
        omega = _to_body(q, list(map(arb, start.exact_omega_world.tolist())))
    return [*map(arb, start.position.tolist()), *map(arb, start.velocity.tolist()), *q, *omega]


class _Motion:
    """The equations of motion under some loads, y' = f(t, y), and steps along them."""

    def __init__(self, scene: Scene, loads: Sequence[Any], remainder: Any) -> None:
        self._loads, self._remainder = loads, remainder
        self._mass = arb(scene.body.mass)
        self._gravity = list(map(arb, scene.gravity.tolist()))
        self._inertia = [list(map(arb, row)) for row in scene.body.inertia.tolist()]
        inverse = arb_mat(self._inertia).inv()
        self._inverse = [[inverse[i, j] for j in range(3)] for i in range(3)]

    def rate(self, state: State) -> float:
        """Return the inverse of a short time scale of the motion, 1/s; it decides only how long steps are."""
        smallest = float(
            np.linalg.eigvalsh(np.array([[float(x.mid()) for x in row] for row in self._inertia]))[0]
        )
        rates = [sum(abs(float(x.mid())) for x in state[10:]), 1e-3]
        for load in self._loads:
            match load:
                case Torque():
                    rates.append(math.sqrt(float(np.linalg.norm(load.value)) / smallest))
                case PointForce():
                    moment = float(np.linalg.norm(load.value)) * float(np.linalg.norm(load.at))
                    rates.append(math.sqrt(moment / smallest))
                case SineTorque():
                    rates += [math.sqrt(float(np.linalg.norm(load.amplitude)) / smallest), abs(load.rate)]
                case Drag():
                    rates += [
                        float(np.linalg.norm(load.angular)) / smallest,
                        load.linear / float(self._mass.mid()),
                    ]
                case Spring():
                    rates.append(2.0 * math.sqrt(load.stiffness / min(smallest, float(self._mass.mid()))))
                case GravityGradient():
                    rates.append(2.0 * load.rate)
        return sum(rates)

    def step(self, t: Any, state: State, length: Any, retries: int = _RETRIES) -> State:
        """Return the state at t + length, by one step or by two halves of it."""
        box = self._box(t, state, length)
        if box is not None:
            remainders = [
                c * length**_ORDER for c in self._coefficients(t + length.union(arb(0)), box, _ORDER)
            ]
            if all(remainder.rad() + abs(remainder) < self._remainder for remainder in remainders):
                series = self._series(t, state, _ORDER)
                return [_value(one, length) + rest for one, rest in zip(series, remainders, strict=True)]
        if retries == 0:
            raise ArithmeticError("no enclosure was found")
        half = length / 2
        return self.step(t + half, self.step(t, state, half, retries - 1), half, retries - 1)

    def _box(self, t: Any, state: State, length: Any) -> State | None:
        """Return a box with state + [0, length] f(box) inside, which the solution cannot leave, or None."""
        span, interval = length.union(arb(0)), t + length.union(arb(0))
        box = state
        for _ in range(8):
            image = [y + span * rate for y, rate in zip(state, self._rates(interval, box), strict=True)]
            if not all(one.is_finite() for one in image):
                return None
            if all(one.contains(part) for one, part in zip(box, image, strict=True)):
                return box
            margins = [part.rad() / 8 + arb(2) ** -(BITS // 2) for part in image]
            box = [
                part.union(one) + arb(0, margin.upper())
                for part, one, margin in zip(image, box, margins, strict=True)
            ]
        return None

    def _coefficients(self, t: Any, state: State, order: int) -> list[Any]:
        """Return the Taylor coefficient of this order of the solution through each state of a box."""
        return [_coefficient(one, order) for one in self._series(t, state, order + 1)]

    def _series(self, t: Any, state: State, length: int) -> State:
        """Return the series of the solution, of this length; each pass of y0 + integral f adds one term."""
        before = flint.ctx.cap
        found: State = [arb_series([y], prec=1) for y in state]
        try:
            for terms in range(2, length + 1):
                flint.ctx.cap = terms
                time = arb_series([t, 1], prec=terms)
                rates = self._rates(time, [arb_series(list(one), prec=terms) for one in found])
                found = [
                    arb_series([y, *(_coefficient(rate, k) / (k + 1) for k in range(terms - 1))], prec=terms)
                    for y, rate in zip(state, rates, strict=True)
                ]
        finally:
            flint.ctx.cap = before
        return found

    def _rates(self, t: Any, state: State) -> State:
        """x' = v, v' = F / m + g, q' = q (0, omega) / 2, omega' = I^-1 (tau - omega x I omega)."""
        x, v, q, omega = state[:3], state[3:6], state[6:10], state[10:]
        force, torque = [arb(0)] * 3, [-part for part in _cross(omega, _times(self._inertia, omega))]
        for load in self._loads:
            pushed, turned = self._wrench(load, t, x, v, q, omega)
            force = [a + b for a, b in zip(force, pushed, strict=True)]
            torque = [a + b for a, b in zip(torque, turned, strict=True)]
        w, i, j, k = q
        a, b, c = omega
        turning = [
            (-i * a - j * b - k * c) / 2,
            (w * a + j * c - k * b) / 2,
            (w * b + k * a - i * c) / 2,
            (w * c + i * b - j * a) / 2,
        ]
        pushing = [push / self._mass + g for push, g in zip(force, self._gravity, strict=True)]
        return [*v, *pushing, *turning, *_times(self._inverse, torque)]

    def _wrench(self, load: Any, t: Any, x: State, v: State, q: State, omega: State) -> tuple[State, State]:
        """Return the force in world axes and the torque in body axes of a load."""
        none = [arb(0)] * 3
        match load:
            case Torque():
                return none, _in_body(q, load.axes, _vector(load.value))
            case SineTorque():
                swing = (t * arb(load.rate) + arb(load.phase)).sin()
                return none, [swing * part for part in _in_body(q, load.axes, _vector(load.amplitude))]
            case PointForce():
                value = _vector(load.value)
                force = value if load.axes == "world" else _to_world(q, value)
                return force, _cross(_vector(load.at), _in_body(q, load.axes, value))
            case Drag():
                rows = [list(map(arb, row)) for row in load.angular.tolist()]
                damped = [-part for part in _times(rows, omega)]
                return [-part * arb(load.linear) for part in v], damped
            case Spring():
                arm = _to_world(q, _vector(load.at))
                stretch = [a + b - c for a, b, c in zip(x, arm, _vector(load.anchor), strict=True)]
                distance = sum((part * part for part in stretch[1:]), stretch[0] * stretch[0]).sqrt()
                factor = arb(load.stiffness) * (arb(load.rest_length) / distance - 1)
                force = [factor * part for part in stretch]
                return force, _cross(_vector(load.at), _to_body(q, force))
            case GravityGradient():
                angle = t * arb(load.rate)
                u = _to_body(q, [-angle.sin(), arb(0), -angle.cos()])
                factor = 3 * arb(load.rate) ** 2
                return none, [factor * part for part in _cross(u, _times(self._inertia, u))]
        raise NotImplementedError(type(load).__name__)


def _vector(values: Array) -> State:
    return list(map(arb, values.tolist()))


def _value(series: Any, at: Any) -> Any:
    total = arb(0)
    for k in range(_ORDER - 1, -1, -1):
        total = total * at + _coefficient(series, k)
    return total


def _coefficient(series: Any, k: int) -> Any:
    return series[k] if isinstance(series, arb_series) else (series if k == 0 else arb(0))


def _cross(a: State, b: State) -> State:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _times(matrix: Sequence[State], vector: State) -> State:
    return [row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2] for row in matrix]


def _matrix(q: State) -> list[State]:
    """R of a unit quaternion, body to world."""
    w, i, j, k = q
    return [
        [1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j)],
        [2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i)],
        [2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j)],
    ]


def _to_world(q: State, vector: State) -> State:
    return _times(_matrix(q), vector)


def _to_body(q: State, vector: State) -> State:
    return _times([list(column) for column in zip(*_matrix(q), strict=True)], vector)


def _in_body(q: State, axes: str, vector: State) -> State:
    return vector if axes == "body" else _to_body(q, vector)


ENCLOSED = (
    *("torques and forces", "body torque", "fixed axis", "drag"),
    *("sines", "spring", "gravity gradient"),
)
"""The kinds of forced motions of tests/helpers/random_motions.py that can be enclosed."""


def short_times(scene: Scene, times: Sequence[float]) -> list[float]:
    """Return times as they are, or scaled so that the body rotates by 3 rad at most: boxes of states grow."""
    spin = float(np.linalg.norm(scene.initial.omega_body))
    scale = min(1.0, 3.0 / (spin * times[-1]))
    return [scale * t for t in times]


# -------------------------------------------------------------------------------------------- comparison

_BOUNDS = ("bound_rad", "bound_omega_rad_s", "bound_m", "bound_m_s")


def largest_ratios(truth: Truth, enclosed: Sequence[State]) -> Array:
    """Return the largest possible distance of a truth from each enclosed state over its bound, (4, n).

    Numbers up to 1 prove that the bounds hold.
    """
    before, flint.ctx.prec = flint.ctx.prec, BITS
    try:
        motion, found = truth.trajectory, np.zeros((4, len(enclosed)))
        for n, state in enumerate(enclosed):
            q = _vector(motion.attitude[n])
            values = ((motion.omega_body, 10), (motion.position_m, 0), (motion.velocity_m_s, 3))
            gaps = [_angle(q, state[6:10])]
            gaps += [_distance(_vector(value[n]), state[first : first + 3]) for value, first in values]
            bounds = [arb(float(getattr(truth, name)[n])) for name in _BOUNDS]
            found[:, n] = [_over(gap, bound) for gap, bound in zip(gaps, bounds, strict=True)]
        return found
    finally:
        flint.ctx.prec = before


def _over(gap: Any, bound: Any) -> float:
    if gap.is_zero() and bound.is_zero():
        return 0.0
    return float((gap / bound).upper().mid()) if not bound.is_zero() else math.inf


def _distance(a: State, b: State) -> Any:
    return _norm([x - y for x, y in zip(a, b, strict=True)])


def _norm(vector: State) -> Any:
    """Return an upper limit of a norm; a power of a ball that contains 0 would not be a number."""
    return sum((part * part for part in vector), arb(0)).abs_upper().sqrt()


def _angle(p: State, q: State) -> Any:
    """2 asin |vec(conj(p) q)| / |p|: an upper limit of the angle between two attitudes."""
    w, x, y, z = p
    a, b, c, d = q
    parts = [w * b - x * a - y * d + z * c, w * c + x * d - y * a - z * b, w * d - x * c + y * b - z * a]
    length = sum((part * part for part in p), arb(0)).sqrt()
    return 2 * _norm([part / length for part in parts]).asin()
