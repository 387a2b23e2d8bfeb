"""Free motion, and motion under constant loads, to fifty digits: its Taylor series in integers.

Its variables are R and the angular momentum in world axes, not those of bodycheck; it shares no code.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from operator import mul

import mpmath

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import PointForce, Scene, Torque

BITS = 224  # fractional bits of a fixed-point number
ORDER = 52
SMALL = 1 << (BITS - 166)  # 1e-50: the limit for the last terms of a series

Fixed = list[int]
Loads = list[tuple[Fixed, Fixed]]


def fixed(x: Fraction | float) -> int:
    """Return x as an integer over 2^BITS."""
    exact = Fraction(x)
    return (exact.numerator << BITS) // exact.denominator


def fractions(values: Array) -> list[Fraction]:
    """Return doubles as exactly equal rational numbers."""
    return [Fraction(float(x)) for x in values]


def rational_rotation(q: Array) -> list[list[Fraction]]:
    """R(q / |q|) without rounding: only the square of the norm enters."""
    w, x, y, z = fractions(q)
    s = 2 / (w * w + x * x + y * y + z * z)
    return [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]


def rational_inverse(tensor: Array) -> list[list[Fraction]]:
    """I^-1 without rounding, by cofactors."""
    m = [fractions(row) for row in tensor]

    def cofactor(i: int, j: int) -> Fraction:
        a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
        return m[a][c] * m[b][d] - m[a][d] * m[b][c]

    determinant = sum(m[0][j] * cofactor(0, j) for j in range(3))
    return [[cofactor(j, i) / determinant for j in range(3)] for i in range(3)]


def dot(row: Sequence[Fraction], v: Sequence[Fraction]) -> Fraction:
    """row . v without rounding."""
    return sum(map(mul, row, v), Fraction(0))


def convolved(a: Fixed, b: Fixed, k: int) -> int:
    """sum over n of a_n b_(k - n), over 2^(2 BITS)."""
    return sum(map(mul, a[: k + 1], b[k::-1]))


@dataclass
class Exact:
    """The state at one time, in fixed point: R row by row, then L, v and x in world axes."""

    state: list[int]

    def values(self) -> list[mpmath.mpf]:
        """Return the 18 numbers with slightly more than fifty digits."""
        return [mpmath.mpf(x) / (1 << BITS) for x in self.state]


def one_series(state: list[int], h: int, inverse: list[list[int]], loads: Loads) -> tuple[list[int], int]:
    """Sum one Taylor step of R' = R [omega]x, L' = torque(R), v' = force(R) / m; with the largest last term.

    omega = I^-1 R^T L is in body axes. loads: for each of L', v' the constant part (3) and the matrix (3, 9)
    that multiplies the entries of R.
    """
    r: list[Fixed] = [[x] for x in state[:9]]
    momentum: list[Fixed] = [[x] for x in state[9:12]]
    velocity: list[Fixed] = [[x] for x in state[12:15]]
    position: list[Fixed] = [[x] for x in state[15:18]]
    omega: list[Fixed] = [[], [], []]
    for k in range(ORDER):
        spin = [
            sum(convolved(r[3 * j + i], momentum[j], k) for j in range(3)) >> BITS for i in range(3)
        ]  # R^T L
        for i in range(3):
            omega[i].append(sum(map(mul, inverse[i], spin)) >> BITS)
        rates: list[int] = []
        for i in range(3):
            row = r[3 * i : 3 * i + 3]
            # (R [omega]x)_ij = R_ia [omega]x_aj
            rates += [
                (convolved(row[1], omega[2], k) - convolved(row[2], omega[1], k)) >> BITS,
                (convolved(row[2], omega[0], k) - convolved(row[0], omega[2], k)) >> BITS,
                (convolved(row[0], omega[1], k) - convolved(row[1], omega[0], k)) >> BITS,
            ]
        for constant, matrix in loads:
            for i in range(3):
                turned = sum(matrix[9 * i + a] * r[a][k] for a in range(9)) >> BITS
                rates.append(turned + (constant[i] if k == 0 else 0))
        rates += [velocity[i][k] for i in range(3)]
        for series, rate in zip([*r, *momentum, *velocity, *position], rates, strict=True):
            series.append((rate * h >> BITS) // (k + 1))
    last = max(abs(term) for series in [*r, *momentum] for term in series[-2:])
    return [sum(series) for series in [*r, *momentum, *velocity, *position]], last


def advanced(state: list[int], length: Fraction, inverse: list[list[int]], loads: Loads) -> list[int]:
    """Return the state after a time; each step is as long as the last terms of its series permit."""
    step = left = fixed(length)
    while left:
        tried = min(step, left)
        ahead, last = one_series(state, tried, inverse, loads)
        # the last term is proportional to the step to the power of ORDER
        fitting = int(tried * min(max(0.95 * (SMALL / max(last, 1)) ** (1.0 / ORDER), 0.1), 2.0))
        if last < SMALL:
            state, left = ahead, left - tried
            step = max(step, fitting) if tried < step else fitting
        else:
            step = fitting
    return state


def constant_loads(scene: Scene) -> list[Torque | PointForce]:
    """Return the loads of a scene, all of which must be constant torques or forces."""
    known = [load for load in scene.loads if isinstance(load, Torque | PointForce)]
    assert len(known) == len(scene.loads)
    return known


def packed_loads(scene: Scene, begin: Fraction, end: Fraction) -> Loads:
    """Return the constant and rotating parts of L' and v' within [begin, end), in which nothing switches."""
    zero = Fraction(0)
    torque, turned_torque = [zero] * 3, [[zero] * 9 for _ in range(3)]
    force, turned_force = [zero] * 3, [[zero] * 9 for _ in range(3)]
    mass = Fraction(float(scene.body.mass))
    for i, g in enumerate(fractions(scene.gravity)):
        force[i] += mass * g
    for load in constant_loads(scene):
        until = Fraction(load.until_s) if math.isfinite(load.until_s) else end
        if not (Fraction(load.from_s) <= begin and end <= until):
            continue
        value = fractions(load.value)
        for i in range(3):
            if isinstance(load, Torque):
                if load.axes == "world":
                    torque[i] += value[i]
                for j in range(3 if load.axes == "body" else 0):
                    turned_torque[i][3 * i + j] += value[j]
                continue
            at, (a, b) = fractions(load.at), ((i + 1) % 3, (i + 2) % 3)
            if load.axes == "world":
                force[i] += value[i]
                for j in range(3):  # (R at) x F
                    turned_torque[i][3 * a + j] += at[j] * value[b]
                    turned_torque[i][3 * b + j] -= at[j] * value[a]
            else:
                moment = [at[1] * value[2] - at[2] * value[1], at[2] * value[0] - at[0] * value[2]]
                moment.append(at[0] * value[1] - at[1] * value[0])
                for j in range(3):
                    turned_force[i][3 * i + j] += value[j]
                    turned_torque[i][3 * i + j] += moment[j]

    def row(
        constant: list[Fraction], turned: list[list[Fraction]], scale: Fraction
    ) -> tuple[list[int], list[int]]:
        return [fixed(x / scale) for x in constant], [fixed(x / scale) for line in turned for x in line]

    return [row(torque, turned_torque, Fraction(1)), row(force, turned_force, mass)]


def exact_states(scene: Scene, times: Sequence[float]) -> list[Exact]:
    """Solve the scene to fifty digits at ascending times."""
    rotation = rational_rotation(scene.initial.quaternion)
    omega = fractions(scene.initial.omega_body)
    if scene.initial.exact_omega_world is not None:
        given = fractions(scene.initial.exact_omega_world)
        omega = [dot(column, given) for column in zip(*rotation, strict=True)]
    spin = [dot(fractions(row), omega) for row in scene.body.inertia]
    state = [fixed(x) for line in rotation for x in line]
    state += [fixed(dot(line, spin)) for line in rotation]
    state += [fixed(x) for x in (*fractions(scene.initial.velocity), *fractions(scene.initial.position))]
    inverse = [[fixed(x) for x in row] for row in rational_inverse(scene.body.inertia)]
    switches = {end for load in constant_loads(scene) for end in (load.from_s, load.until_s)}
    edges = sorted({0.0, *times, *(t for t in switches if 0.0 < t < max(times))})
    found = {0.0: Exact(state)}
    for begin, end in pairwise(edges):
        loads = packed_loads(scene, Fraction(begin), Fraction(end))
        state = advanced(state, Fraction(end) - Fraction(begin), inverse, loads)
        found[end] = Exact(state)
    return [found[t] for t in times]
