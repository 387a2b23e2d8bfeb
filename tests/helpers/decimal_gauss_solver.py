"""Forced motion in decimals of fifty digits, by independent formulas: springs, drag, orbits, pivots.

The state is R and the angular momentum in world axes, about the pivot if there is one, and position and
velocity; the method is Gauss's with twelve stages, of order 24. It shares no code with bodycheck.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Decimal
from functools import cache
from itertools import pairwise
from operator import mul

import mpmath
import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.magnetic_dipole import MagneticDipole
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    PointForce,
    Scene,
    SineTorque,
    Spring,
    Torque,
    TorsionSpring,
)

DIGITS = 50
STAGES = 12
SETTLED = Decimal("1e-36")

Vec = list[Decimal]
Mat = list[Vec]


def decimals(values: Array) -> Vec:
    """Return doubles as exactly equal decimals."""
    return [Decimal(float(x)) for x in values]


def matrix(values: Array) -> Mat:
    """Return a matrix of doubles row by row."""
    return [decimals(row) for row in values]


def dot(a: Vec, b: Vec) -> Decimal:
    """a . b."""
    return sum(map(mul, a, b), Decimal(0))


def cross(a: Vec, b: Vec) -> Vec:
    """a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def plus(a: Vec, b: Vec, factor: Decimal | int = 1) -> Vec:
    """a + factor b."""
    return [x + factor * y for x, y in zip(a, b, strict=True)]


def times(m: Mat, v: Vec) -> Vec:
    """m v."""
    return [dot(row, v) for row in m]


def transposed(m: Mat) -> Mat:
    """m^T."""
    return [list(column) for column in zip(*m, strict=True)]


def norm(v: Vec) -> Decimal:
    """|v|."""
    return dot(v, v).sqrt()


def inverse(m: Mat) -> Mat:
    """m^-1."""
    columns = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])]
    determinant = dot(m[0], columns[0])
    return [[columns[j][i] / determinant for j in range(3)] for i in range(3)]


def rotation_of(q: Array) -> Mat:
    """R(q / |q|), by its columns R e = e + 2 w (u x e) + 2 u x (u x e), over |q|^2."""
    w, *u = decimals(q)
    square = w * w + dot(u, u)
    columns = []
    for i in range(3):
        e = [Decimal(int(i == j)) for j in range(3)]
        swept = cross(u, e)
        columns.append(
            [a + 2 * (w * b + c) / square for a, b, c in zip(e, swept, cross(u, swept), strict=True)]
        )
    return transposed(columns)


def by_mpmath(function: Callable[..., mpmath.mpf], *arguments: Decimal) -> Decimal:
    """Return the value of a function that decimals lack."""
    with mpmath.workdps(DIGITS + 10):
        return Decimal(mpmath.nstr(function(*(mpmath.mpf(str(x)) for x in arguments)), DIGITS + 5))


@cache
def gauss() -> tuple[Vec, Mat, Vec]:
    """Nodes c, matrix a and weights b of Gauss's method: a_ij = the integral of l_j from 0 to c_i."""
    with mpmath.workdps(DIGITS + 30):
        guesses = np.polynomial.legendre.leggauss(STAGES)[0]
        roots = [mpmath.findroot(lambda x: mpmath.legendre(STAGES, x), mpmath.mpf(g)) for g in guesses]
        c = [(1 + root) / 2 for root in roots]
        powers = mpmath.matrix([[node**k for k in range(STAGES)] for node in c])
        integrals = mpmath.matrix(
            [[node ** (k + 1) / (k + 1) for k in range(STAGES)] for node in [*c, mpmath.mpf(1)]]
        )
        found = (integrals * powers**-1).tolist()
        rows = [[Decimal(mpmath.nstr(x, DIGITS + 10)) for x in row] for row in found]
        return [Decimal(mpmath.nstr(x, DIGITS + 10)) for x in c], rows[:-1], rows[-1]


class Oracle:
    """The equations of motion of one scene, and its energy and angular momentum."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.mass = scene, Decimal(scene.body.mass)
        self.gravity, self.centre = decimals(scene.gravity), decimals(scene.initial.position)
        self.start = rotation_of(scene.initial.quaternion)
        self.pivot = None if scene.pivot is None else decimals(scene.pivot)
        self.inertia = matrix(scene.body.inertia)
        if self.pivot is not None:
            r = self.pivot
            for i in range(3):
                for j in range(3):
                    self.inertia[i][j] += self.mass * ((dot(r, r) if i == j else 0) - r[i] * r[j])
            self.place = plus(self.centre, times(self.start, r))
        self.inverse = inverse(self.inertia)

    def first(self) -> Vec:
        """Return R, L, x, v at the start, in one list of 18."""
        initial = self.scene.initial
        omega = decimals(initial.omega_body)
        if initial.exact_omega_world is not None:
            omega = times(transposed(self.start), decimals(initial.exact_omega_world))
        spin = times(self.start, times(self.inertia, omega))
        flat = [x for row in self.start for x in row]
        return [*flat, *spin, *self.centre, *decimals(initial.velocity)]

    def parts(self, y: Vec) -> tuple[Mat, Vec, Vec, Vec, Vec]:
        """Return R, L, omega in body axes, and x, v of the centre of mass."""
        rotation = [y[0:3], y[3:6], y[6:9]]
        momentum, position, velocity = y[9:12], y[12:15], y[15:18]
        spin = times(self.inverse, times(transposed(rotation), momentum))
        if self.pivot is not None:
            position = plus(self.place, times(rotation, self.pivot), -1)
            velocity = times(rotation, cross(self.pivot, spin))
        return rotation, momentum, spin, position, velocity

    def rates(self, t: Decimal, y: Vec) -> Vec:
        """R' = R [omega]x, L' = torque, x' = v, v' = F / m."""
        rotation, _, spin, position, velocity = self.parts(y)
        matrix_rate = [cross(row, spin) for row in rotation]  # (R [omega]x) row by row is row x omega
        omega = times(rotation, spin)
        force, torque = [self.mass * g for g in self.gravity], [Decimal(0)] * 3
        for load in self.scene.loads:
            push, turn = self.wrench(load, t, rotation, position, velocity, omega)
            force, torque = plus(force, push), plus(torque, turn)
        flat = [x for row in matrix_rate for x in row]
        if self.pivot is not None:
            torque = plus(torque, cross(plus(position, self.place, -1), force))
            return [*flat, *torque, *[Decimal(0)] * 6]
        return [*flat, *torque, *velocity, *(f / self.mass for f in force)]

    def wrench(
        self, load: Load, t: Decimal, rotation: Mat, position: Vec, velocity: Vec, omega: Vec
    ) -> tuple[Vec, Vec]:
        """Return the force, and the torque about the centre of mass, in world axes."""
        none = [Decimal(0)] * 3
        match load:
            case Torque() | PointForce() if not load.from_s <= t < load.until_s:
                return none, none
            case Torque():
                value = decimals(load.value)
                return none, times(rotation, value) if load.axes == "body" else value
            case PointForce():
                value = decimals(load.value)
                force = times(rotation, value) if load.axes == "body" else value
                return force, cross(times(rotation, decimals(load.at)), force)
            case SineTorque():
                swing = by_mpmath(mpmath.sin, Decimal(load.rate) * t + Decimal(load.phase))
                value = [swing * a for a in decimals(load.amplitude)]
                return none, times(rotation, value) if load.axes == "body" else value
            case Drag():
                seen = times(transposed(rotation), omega)
                braking = times(rotation, times(matrix(load.angular), seen))
                return [-Decimal(load.linear) * v for v in velocity], [-x for x in braking]
            case Spring():
                arm = times(rotation, decimals(load.at))
                stretch = plus(plus(position, arm), decimals(load.anchor), -1)
                length = norm(stretch)
                pull = Decimal(load.stiffness) * (Decimal(load.rest_length) / length - 1)
                force = [pull * d for d in stretch]
                return force, cross(arm, force)
            case TorsionSpring():
                turned = transposed([times(rotation, row) for row in self.start])
                sine = [turned[2][1] - turned[1][2], turned[0][2] - turned[2][0], turned[1][0] - turned[0][1]]
                angle, twice = self.angle(turned), norm(sine)
                factor = Decimal(1) / 2 if twice == 0 else angle / twice
                return none, [-Decimal(load.stiffness) * factor * x for x in sine]
            case GravityGradient():
                n = Decimal(load.rate)
                u = [-by_mpmath(mpmath.sin, n * t), Decimal(0), -by_mpmath(mpmath.cos, n * t)]
                seen = times(transposed(rotation), u)
                return none, [3 * n * n * x for x in cross(u, times(rotation, times(self.inertia, seen)))]
            case MagneticDipole():
                return none, cross(times(rotation, decimals(load.moment)), decimals(load.field))
        raise AssertionError(f"these digits do not know {load}")

    @staticmethod
    def angle(turned: Mat) -> Decimal:
        """Return the angle of a rotation matrix, from 2 sin and 2 cos of it."""
        sine = [turned[2][1] - turned[1][2], turned[0][2] - turned[2][0], turned[1][0] - turned[0][1]]
        return by_mpmath(mpmath.atan2, norm(sine), turned[0][0] + turned[1][1] + turned[2][2] - 1)

    def energies(self, rotation: Mat, spin: Vec, position: Vec, velocity: Vec) -> tuple[Decimal, Decimal]:
        """Return K, about the pivot if there is one, and K + U."""
        kinetic = dot(spin, times(self.inertia, spin)) / 2
        if self.pivot is None:
            kinetic += self.mass * dot(velocity, velocity) / 2
        energy = kinetic - self.mass * dot(self.gravity, plus(position, self.centre, -1))
        for load in self.scene.loads:
            if isinstance(load, Spring):
                arm = times(rotation, decimals(load.at))
                length = norm(plus(plus(position, arm), decimals(load.anchor), -1))
                energy += Decimal(load.stiffness) * (length - Decimal(load.rest_length)) ** 2 / 2
            if isinstance(load, TorsionSpring):
                turned = transposed([times(rotation, row) for row in self.start])
                energy += Decimal(load.stiffness) * self.angle(turned) ** 2 / 2
            if isinstance(load, MagneticDipole):
                energy -= dot(times(rotation, decimals(load.moment)), decimals(load.field))
        return kinetic, energy

    def step(self, t: Decimal, y: Vec, h: Decimal) -> Vec:
        """Make one step of Gauss's method, whose stages are found by iteration."""
        c, a, b = gauss()
        slopes = [self.rates(t, y)] * STAGES
        moved = Decimal(1)
        while moved > SETTLED:
            before = slopes
            slopes = []
            for i in range(STAGES):
                # the stages before this one are already updated
                known = zip(*slopes, *before[i:], strict=True)
                point = [x + h * sum(map(mul, a[i], column)) for x, column in zip(y, known, strict=True)]
                slopes.append(self.rates(t + c[i] * h, point))
            gaps = (
                abs(p - q)
                for old, new in zip(before, slopes, strict=True)
                for p, q in zip(old, new, strict=True)
            )
            moved = h * max(gaps)
        return [x + h * dot(b, [k[j] for k in slopes]) for j, x in enumerate(y)]

    def states(self, t_s: Sequence[float], step: float) -> list[Vec]:
        """Return the states at ascending times from 0 on, with steps no longer than the given one."""
        y = self.first()
        found = [y]
        for begin, end in pairwise(t_s):
            inside = (switch for switch in self.scene.switches_before(end) if switch > begin)
            for first, last in pairwise([begin, *inside, end]):
                count = int(np.ceil((last - first) / step))
                h = (Decimal(last) - Decimal(first)) / count
                for i in range(count):
                    y = self.step(Decimal(first) + i * h, y, h)
            found.append(y)
        return found
