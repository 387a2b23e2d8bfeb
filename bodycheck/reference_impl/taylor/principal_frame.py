"""I = A diag(J) A^T to about 2^-110, and the body and its torques along these axes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rational import (
    Vector,
    added,
    cross,
    fractions,
    pair,
    start_omega,
    times,
    transposed,
    unit,
)
from bodycheck.reference_impl.scene import (
    ConstantLoad,
    Drag,
    GravityGradient,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    State,
    Torque,
    unknown_load,
)
from bodycheck.reference_impl.taylor.principal_terms import (
    ANGULAR,
    BODY,
    COSINE,
    DAMPED,
    DAMPING,
    EULER,
    FACTS,
    FRAME,
    GRADIENT,
    HAS_TORQUE_WORLD,
    INVERSE,
    LOAD,
    ORBIT_RATE,
    PHASES,
    SINE,
    TORQUE,
    TORQUE_WORLD,
)
from bodycheck.reference_impl.wrench import constant_loads_between

IntegerQuaternion: TypeAlias = tuple[int, int, int, int]

_SWEEPS = 12  # convergence is quadratic from the third sweep at the latest
_NEGLIGIBLE = Fraction(1, 2**220)  # squared, relative to the product of the two diagonal elements
_MAX_BITS = 256


def principal_quaternion(inertia: Vector) -> tuple[IntegerQuaternion, Vector]:
    """Return a quaternion of any length from principal to body axes, and the moments J.

    inertia: nine numbers, symmetric and positive definite. Uses Jacobi's method. The angles are rounded, but
    every integer quaternion is an exact rotation, and J is the tensor along its axes. A diagonal tensor keeps
    its axes. Source: Golub and Van Loan (2013), Matrix computations, section 8.5.
    """
    p: IntegerQuaternion = (1, 0, 0, 0)
    rotated = inertia
    for _ in range(_SWEEPS):
        converged = True
        for i, j, axis in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            off, first, second = rotated[3 * i + j], rotated[4 * i], rotated[4 * j]
            if off * off <= _NEGLIGIBLE * first * second:
                continue
            converged = False
            angle = 0.5 * math.atan(2 * off / (first - second)) if first != second else 0.25 * math.pi
            p = _rotated_about(p, axis, math.tan(0.5 * angle))
            rotated = in_axes_of(p, inertia)
        if converged:
            break
    return p, [rotated[0], rotated[4], rotated[8]]


def _rotated_about(p: IntegerQuaternion, axis: int, tangent: float) -> IntegerQuaternion:
    """p (1, tangent e) up to length, shifted to at most _MAX_BITS bits."""
    above, below = tangent.as_integer_ratio()
    w, v = p[0], p[1:]
    e = [above if i == axis else 0 for i in range(3)]
    product = [
        w * below - sum(a * b for a, b in zip(v, e, strict=True)),
        *(w * e[i] + below * v[i] + v[i - 2] * e[i - 1] - v[i - 1] * e[i - 2] for i in range(3)),
    ]
    shift = max(0, max(abs(x) for x in product).bit_length() - _MAX_BITS)
    a, b, c, d = (x >> shift for x in product)
    return a, b, c, d


def axes_of(p: IntegerQuaternion) -> Vector:
    """R(p), exact and in row-major order; its columns are the principal axes in body axes."""
    w, x, y, z = p
    square = w * w + x * x + y * y + z * z
    rows = [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)]
    rows += [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]
    return [Fraction(n, square) for n in rows]


def in_axes_of(p: IntegerQuaternion, m: Vector) -> Vector:
    """R(p)^T m R(p), for a matrix m of nine numbers."""
    r = axes_of(p)
    right = [
        sum((m[3 * i + k] * r[3 * k + j] for k in range(3)), Fraction(0)) for i in range(3) for j in range(3)
    ]
    return [
        sum((r[3 * k + i] * right[3 * k + j] for k in range(3)), Fraction(0))
        for i in range(3)
        for j in range(3)
    ]


_IN_WORLD, _IN_BODY, _OSCILLATES = 1.0, 0.0, 1.0


@dataclass(frozen=True, eq=False)
class PrincipalFrame:
    """The quaternion from principal to body axes, of any length, its row-major R, and the moments."""

    quaternion: IntegerQuaternion
    axes: Vector
    moments: Vector

    @classmethod
    def of(cls, body: RigidBody) -> PrincipalFrame:
        """Find the principal axes."""
        quaternion, moments = principal_quaternion(fractions(body.inertia))
        return cls(quaternion, axes_of(quaternion), moments)

    def components(self, v: Vector) -> Vector:
        """A^T v, for v in body axes."""
        return times(transposed(self.axes), v)

    def accelerations(self, torque: Vector) -> Vector:
        """diag(J)^-1 torque."""
        return [a / b for a, b in zip(torque, self.moments, strict=True)]

    def start(self, state: State) -> Array:
        """(2, 2, 4): the high parts of q and omega along the principal axes, and the low parts."""
        a, b, c, d = fractions(state.quaternion)
        w, x, y, z = self.quaternion
        q = [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
        omega = [*(pair(x) for x in self.components(start_omega(state))), (0.0, 0.0)]
        return np.ascontiguousarray(np.array([unit(q), omega]).transpose(2, 0, 1))


def packed_rotation(
    scene: Scene, frame: PrincipalFrame, begin_s: float, end_s: float
) -> tuple[Array, Array | None]:
    """Return the constants of the body (k,) and of its loads (m,) within [begin_s, end_s).

    The interval must contain no switch. The loads are None if no torque acts on the body. Raises ValueError
    for springs and any other unsupported kind.
    """
    for load in scene.continuous_loads:
        if not isinstance(load, Drag | GravityGradient | SineTorque):
            raise unknown_load(load, "the Taylor series along principal axes")
    constant_loads, continuous = constant_loads_between(scene, begin_s, end_s), scene.continuous_loads
    body = _packed_body(frame, constant_loads)
    for drag in (load for load in continuous if isinstance(load, Drag)):
        damping = in_axes_of(frame.quaternion, fractions(drag.angular))
        columns = [frame.accelerations([-x for x in damping[column::3]]) for column in range(3)]
        body[DAMPING : DAMPING + 3, :3] += np.array(columns, dtype=np.float64)
        body[FACTS, DAMPED] = 1.0
    for gradient in (load for load in continuous if isinstance(load, GravityGradient)):
        body[FACTS, ORBIT_RATE] = gradient.rate
        body[GRADIENT] -= 3.0 * gradient.rate**2 * body[EULER]
    rows = [
        *_constant_in_world(frame, constant_loads),
        *(_oscillating(frame, load) for load in continuous if isinstance(load, SineTorque)),
    ]
    free = (
        not rows
        and not constant_loads
        and not any(isinstance(load, Drag | GravityGradient) for load in continuous)
    )
    return body[None], None if free else np.array(rows, dtype=np.float64).reshape(len(rows), LOAD, 4)


def _packed_body(frame: PrincipalFrame, constant_loads: Iterable[ConstantLoad]) -> Array:
    a, b, c = frame.moments
    torque, world_torque = [Fraction(0)] * 3, [Fraction(0)] * 3
    for load in constant_loads:
        value = fractions(load.value)
        if load.axes == "body":
            torque = added(torque, value if isinstance(load, Torque) else cross(fractions(load.at), value))
        elif isinstance(load, Torque):
            world_torque = added(world_torque, value)
    body = np.zeros((BODY, 4))
    body[EULER, :3] = [float((b - c) / a), float((c - a) / b), float((a - b) / c)]
    body[TORQUE, :3] = _floats(frame.accelerations(frame.components(torque)))
    w, x, y, z = (high for high, _ in unit([Fraction(n) for n in frame.quaternion]))
    body[FRAME] = w, -x, -y, -z
    body[TORQUE_WORLD, :3] = _floats(world_torque)
    body[FACTS, HAS_TORQUE_WORLD] = any(world_torque)
    body[INVERSE, :3] = [float(1 / moment) for moment in frame.moments]
    return body


def _constant_in_world(frame: PrincipalFrame, constant_loads: Iterable[ConstantLoad]) -> list[Array]:
    """Pack I^-1 (at x y), y a force in body axes; torques are among the constants of the body."""
    units = [[Fraction(int(i == j)) for j in range(3)] for i in range(3)]
    rows = []
    for load in constant_loads:
        if load.axes == "world" and isinstance(load, PointForce):
            row = np.zeros((LOAD, 4))
            row[COSINE, :3] = load.value
            row[PHASES] = 0.0, 0.0, _IN_WORLD, 0.0
            columns = [cross(frame.components(fractions(load.at)), e) for e in units]
            row[ANGULAR : ANGULAR + 3, :3] = [_floats(frame.accelerations(column)) for column in columns]
            rows.append(row)
    return rows


def _oscillating(frame: PrincipalFrame, load: SineTorque) -> Array:
    in_world = load.axes == "world"
    row = np.zeros((LOAD, 4))
    row[SINE, :3] = load.amplitude if in_world else _floats(frame.components(fractions(load.amplitude)))
    row[PHASES] = load.rate, load.phase, _IN_WORLD if in_world else _IN_BODY, _OSCILLATES
    row[ANGULAR : ANGULAR + 3, :3] = np.diag([float(1 / moment) for moment in frame.moments])
    return row


def _floats(values: Vector) -> list[float]:
    return [float(x) for x in values]
