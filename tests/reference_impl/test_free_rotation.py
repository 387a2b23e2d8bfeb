"""The closed form of free rotation compared with Euler's equations in 60 digits, and with laws.

The first truth uses no elliptic function: the angular momentum and the world axes, seen from the body, obey
y' = y x omega, and their Taylor series are summed in integers. Times of 1e6 s and more are
reached by whole periods: after one, the attitude has turned by a fixed rotation about the momentum. The
second truth, for cases whose period is too long for that, is the textbook's, in 60 digits and more:
Jacobi's functions for the momentum and Legendre's third integral for the precession about it.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import cache
from operator import mul
from typing import Any

import mpmath
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation import FreeRotation, FreeRotations, free_rotations
from bodycheck.reference_impl.free_rotation.initial_constants import set_up_tumbling
from tests.helpers.expected_messages import ExpectedMessage

MP = mpmath.MPContext()
MP.dps = 60
BITS = 200
ORDER = 60
TOLERANCE = 4e-15
"""The accuracy that FreeRotation.at promises: of attitude in rad, and of omega relative."""

QUATERNION = (0.9, -0.3, 0.2, 0.5)
State = list[list[int]]
"""L and the world axes x and y, in body axes and units of 2^-BITS."""


# -------------------------------------------------------------------------------------------------- truth


def as_tensor(inertia: Any) -> Array:
    """Return the tensor (3, 3) of principal moments, or the tensor itself."""
    tensor = np.asarray(inertia, dtype=np.float64)
    return np.diag(tensor) if tensor.ndim == 1 else tensor


def rotation_of(quaternion: list[Any]) -> list[list[Any]]:
    """Return R (3, 3) in any kind of number, for a quaternion of any norm."""
    w, x, y, z = quaternion
    norm = w * w + x * x + y * y + z * z
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return [[x / norm for x in row] for row in rows]


def fixed(x: Fraction) -> int:
    """Return x in units of 2^-BITS."""
    return (x.numerator << BITS) // x.denominator


class Truth:
    """A free rotation by Taylor series in integers of 2^-200; time in units of a power of two of 1 s."""

    def __init__(self, inertia: Any, omega: Any) -> None:
        tensor = as_tensor(inertia)
        size = math.frexp(np.abs(tensor).max())[1]
        self.pace = Fraction(2) ** math.frexp(np.abs(omega).max())[1]
        matrix = [[Fraction(x) / Fraction(2) ** size for x in row] for row in tensor.tolist()]
        spin = [Fraction(x) / self.pace for x in np.asarray(omega, dtype=np.float64).tolist()]
        momentum = [sum(map(mul, row, spin)) for row in matrix]
        self.inverse = [[fixed(x) for x in row] for row in _inverse(matrix)]
        axes = rotation_of([Fraction(c) for c in QUATERNION])
        self.start: State = [[fixed(x) for x in vector] for vector in (momentum, *axes[:2])]

    def omega(self, momentum: list[int]) -> list[int]:
        """I^-1 L."""
        return [sum(map(mul, row, momentum)) >> BITS for row in self.inverse]

    def _series(self, state: State) -> list[list[list[int]]]:
        """Taylor coefficients of each component of each vector."""
        vectors = [[[x] for x in vector] for vector in state]
        spin: list[list[int]] = [[], [], []]
        for n in range(ORDER):
            for component, value in zip(spin, self.omega([x[n] for x in vectors[0]]), strict=True):
                component.insert(0, value)
            for vector in vectors:
                new = [
                    (sum(map(mul, vector[a], spin[b])) - sum(map(mul, vector[b], spin[a]))) >> BITS
                    for a, b in ((1, 2), (2, 0), (0, 1))
                ]
                for component, value in zip(vector, new, strict=True):
                    component.append(value // (n + 1))
        return vectors

    def advance(self, state: State, duration: int) -> State:
        """Advance a state by a duration in units of 2^-BITS."""
        while duration:
            series = self._series(state)
            last = max(abs(component[-1]) for vector in series for component in vector)
            longest = fixed(Fraction(0.9 * 2.0 ** (-last.bit_length() / ORDER)))
            step = max(-longest, min(duration, longest))
            state = [[_horner(component, step) for component in vector] for vector in series]
            duration -= step
        return state

    def at(self, t_s: float) -> tuple[Any, list[Any]]:
        """Return R (3, 3) and omega (3,) at a time, by steps only."""
        return self.seen(self.advance(self.start, fixed(Fraction(t_s) * self.pace)))

    def seen(self, state: State) -> tuple[Any, list[Any]]:
        """Return R (3, 3) and omega (3,) of a state, in 60 digits and seconds."""
        scale = MP.mpf(2) ** -BITS
        pace = MP.mpf(self.pace.numerator) / self.pace.denominator
        rotation = MP.matrix([[x * scale for x in axis] for axis in (*state[1:], _cross(*state[1:]))])
        return rotation, [x * scale * pace for x in self.omega(state[0])]

    def once(self, period_s: float) -> tuple[int, Any, Any]:
        """Return the exact period from a guess, and the axis and angle of its rotation in the world."""
        period = fixed(Fraction(period_s) * self.pace)
        state = self.advance(self.start, period)
        for _ in range(4):  # Newton: from 1e-15 to 1e-60
            rate = _cross(state[0], self.omega(state[0]))
            missing = [a - b for a, b in zip(self.start[0], state[0], strict=True)]
            correction = (sum(map(mul, missing, rate)) << BITS) // sum(map(mul, rate, rate))
            period, state = period + correction, self.advance(state, correction)
        first, last = self.seen(self.start)[0], self.seen(state)[0]
        turned = last * first.T
        axis = first * MP.matrix(self.start[0])
        axis /= MP.norm(axis)
        skew = [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        sine = sum(map(mul, axis, skew)) / 2
        return period, axis, MP.atan2(sine, (turned[0, 0] + turned[1, 1] + turned[2, 2] - 1) / 2)

    def far(self, t_s: float, period: int, axis: Any, angle: Any) -> tuple[Any, list[Any]]:
        """Return R (3, 3) and omega (3,) at a time, given what :meth:`once` returns."""
        periods, rest = divmod(fixed(Fraction(t_s) * self.pace), period)
        rotation, omega = self.seen(self.advance(self.start, rest))
        return _about(axis, periods * angle) * rotation, omega


def _inverse(m: list[list[Fraction]]) -> list[list[Fraction]]:
    cofactors = [_cross(m[1], m[2]), _cross(m[2], m[0]), _cross(m[0], m[1])]
    determinant = sum(map(mul, m[0], cofactors[0]))
    return [[cofactors[j][i] / determinant for j in range(3)] for i in range(3)]


def _cross(a: Any, b: Any) -> Any:
    shift = BITS if isinstance(a[0], int) else 0
    values = [a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    return [x >> shift for x in values] if shift else values


def _horner(coefficients: list[int], x: int) -> int:
    total = 0
    for coefficient in reversed(coefficients):
        total = (total * x >> BITS) + coefficient
    return total


def _about(axis: Any, angle: Any) -> Any:
    """Rodrigues' formula."""
    x, y, z = axis
    hat = MP.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return MP.eye(3) + MP.sin(angle) * hat + (1 - MP.cos(angle)) * hat * hat


def textbook_of_tensor(tensor: Array, omega: Array, t_s: float) -> tuple[Any, list[Any]]:
    """Return R (3, 3) and omega (3,) at a time, through the principal axes of a full tensor in 60 digits."""
    with MP.workdps(100):
        moments, axes = MP.eigsy(MP.matrix(tensor.tolist()))
        axes *= MP.sign(MP.det(axes))
        start = MP.matrix(rotation_of([MP.mpf(c) for c in QUATERNION]))
        rotation, spin = _textbook(list(moments), list(axes.T * MP.matrix(omega.tolist())), t_s)
        # the textbook starts its own axes from the quaternion: undo that, and start these
        return start * axes * start.T * rotation * axes.T, list(axes * MP.matrix(spin))


def textbook(moments: Any, omega: Any, t_s: float, digits: int = 60) -> tuple[Any, list[Any]]:
    """Return R (3, 3) and omega (3,) at a time, for three different moments off the separatrix.

    R = R0 B(0)^T Rz(phi) B(t), the third row of B along L, the first horizontal, and phi the precession
    G t / I1 - G (I2-I1)(I3-I1) / I1^2 (I3-I2) int sn^2 / (1 + kappa sn^2) dt, with
    kappa = I3 (I2-I1) / I1 (I3-I2).
    """
    with MP.workdps(digits):
        return _textbook(moments, omega, t_s)


def _textbook(moments: Any, omega: Any, t_s: float) -> tuple[Any, list[Any]]:
    # the axes are numbered and half-turned so that L = (a1 cn, side a2 sn, a3 dn), a1 and a3 > 0
    order = sorted(range(3), key=lambda i: moments[i])
    spin = [MP.mpf(x) for x in omega]
    inertia = [MP.mpf(x) for x in moments]
    middle = inertia[order[1]]
    if sum(i * (i - middle) * x**2 for i, x in zip(inertia, spin, strict=True)) < 0:
        order.reverse()
    i1, i2, i3 = (inertia[i] for i in order)
    parity = 1 if (order[1] - order[0]) % 3 == 1 else -1
    l1, l2, l3 = (inertia[i] * spin[i] for i in order)
    s1, s3 = (-1 if x < 0 else 1 for x in (l1, l3))
    signs = (s1, parity * s1 * s3, s3)
    l1, l2, l3 = (sign * x for sign, x in zip(signs, (l1, l2, l3), strict=True))
    side = 1 if i3 > i1 else -1
    d1 = l2**2 * (i2 - i1) / i2 + l3**2 * (i3 - i1) / i3
    d3 = l1**2 * (i3 - i1) / i1 + l2**2 * (i3 - i2) / i2
    rate = MP.sqrt(d1 * (i3 - i2) / (i1 * i2 * i3))
    m, kappa = d3 * (i2 - i1) / (d1 * (i3 - i2)), i3 * (i2 - i1) / (i1 * (i3 - i2))
    a1, a2, a3 = MP.sqrt(d3 * i1 / (i3 - i1)), MP.sqrt(d3 * i2 / (i3 - i2)), MP.sqrt(d1 * i3 / (i3 - i1))
    norm = MP.sqrt(l1**2 + l2**2 + l3**2)

    def integral(sn: Any, cn: Any, dn: Any) -> Any:
        return sn**3 / 3 * MP.elliprj(cn**2, dn**2, 1, 1 + kappa * sn**2)

    def frame(momentum: list[Any]) -> Any:
        x, y, z = (c / norm for c in momentum)
        level = MP.sqrt(x**2 + y**2)
        return MP.matrix([[y / level, -x / level, 0], [x * z / level, y * z / level, -level], [x, y, z]])

    sn, cn, dn = side * l2 / a2, l1 / a1, l3 / a3
    first = integral(sn, cn, dn)
    quarter = MP.elliprf(0, 1 - m, 1)
    u = sn * MP.elliprf(cn**2, dn**2, 1) + rate * MP.mpf(t_s)
    half_periods = MP.nint(u / (2 * quarter))
    u -= 2 * quarter * half_periods
    flip = -1 if int(half_periods) % 2 else 1
    sn, cn, dn = (MP.ellipfun(kind, u, m=m) for kind in ("sn", "cn", "dn"))
    gained = integral(sn, cn, dn) + 2 * half_periods * integral(MP.one, MP.zero, MP.sqrt(1 - m)) - first
    momentum = [flip * a1 * cn, flip * side * a2 * sn, a3 * dn]
    phi = norm * MP.mpf(t_s) / i1 - norm * (i2 - i1) * (i3 - i1) / (i1**2 * (i3 - i2) * rate) * gained
    axes = MP.zeros(3)
    for column, (i, sign) in enumerate(zip(order, signs, strict=True)):
        axes[i, column] = sign
    start = MP.matrix(rotation_of([MP.mpf(c) for c in QUATERNION]))
    turn = MP.matrix([[MP.cos(phi), -MP.sin(phi), 0], [MP.sin(phi), MP.cos(phi), 0], [0, 0, 1]])
    rotation = start * axes * frame([l1, l2, l3]).T * turn * frame(momentum) * axes.T
    return rotation, list(axes * MP.matrix([x / i for x, i in zip(momentum, (i1, i2, i3), strict=True)]))


def attitude_error(quaternion: Array, rotation: Any) -> float:
    """Return the angle of R(q)^T R in rad."""
    found = MP.matrix(rotation_of([MP.mpf(float(c)) for c in quaternion]))
    d = found.T * rotation
    sine = MP.sqrt((d[2, 1] - d[1, 2]) ** 2 + (d[0, 2] - d[2, 0]) ** 2 + (d[1, 0] - d[0, 1]) ** 2) / 2
    return float(MP.atan2(sine, (d[0, 0] + d[1, 1] + d[2, 2] - 1) / 2))


def omega_error(found: Array, true: list[Any]) -> float:
    """|found - true| / |true|."""
    size = MP.norm(MP.matrix(true))
    return float(
        MP.norm(MP.matrix([MP.mpf(float(a)) - b for a, b in zip(found, true, strict=True)])) / (size or 1)
    )


def closed_form(inertia: Any, omega: Any) -> FreeRotation:
    """Return the rotation for principal moments or a tensor, from the quaternion of these tests."""
    return FreeRotation.from_state(as_tensor(inertia), QUATERNION, omega)


def assert_close(rotation: FreeRotation, t_s: float, true: tuple[Any, list[Any]]) -> None:
    """Assert that attitude and omega at a time are within the tolerance of the truth."""
    quaternion, omega = rotation.at([t_s])
    assert abs(np.linalg.norm(quaternion[0]) - 1.0) < 4e-16
    assert attitude_error(quaternion[0], true[0]) <= TOLERANCE
    assert omega_error(omega[0], true[1]) <= TOLERANCE


# ---------------------------------------------------------------------------------------------- the cases

_Q = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]


def tensor_of(moments: Any) -> Array:
    """Return a full symmetric tensor with approximately these moments."""
    tensor = _Q @ np.diag(np.asarray(moments, dtype=np.float64)) @ _Q.T
    return 0.5 * (tensor + tensor.T)


CASES: dict[str, tuple[Any, Any]] = {
    "general": ([1, 2, 3], [0.1, 2, 0.1]),
    "general, other side": ([1, 2, 3], [0.9, 0.3, 0.1]),
    "no triangle": ([0.5, 2, 7], [0.3, -0.7, 0.2]),
    "sphere": ([2, 2, 2], [0.3, -0.4, 1.2]),
    "at rest": ([1, 2, 3], [0, 0, 0]),
    "oblate": ([1, 1, 1.7], [0.3, -0.4, 1.2]),
    "oblate, in its plane": ([1, 1.7, 1], [0.3, 1e-8, 1.2]),
    "prolate": ([2, 2, 0.3], [0.3, -0.4, 1.2]),
    "prolate, hardly tumbling": ([0.3, 2, 2], [1.2, 1e-9, 1e-9]),
    "needle": ([1e-6, 1, 1], [100, 0.3, -0.2]),
    "needle, not symmetric": ([1e-6, 1, 1 + 1e-6], [100, 0.3, -0.2]),
    "needle, tumbling": ([1e-6, 1, 1 + 1e-6], [100, 1e-5, 2e-5]),
    "plate": ([1, 2, 3], [-1.3, 0.7, 0.2]),
    "axis 1": ([1, 2, 3], [1.3, 0, 0]),
    "axis 2": ([1, 2, 3], [0, -1.3, 0]),
    "axis 3": ([1, 2, 3], [0, 0, 1.3]),
    "near axis 1": ([1, 2, 3], [1, 1e-9, -1e-12]),
    "near axis 3": ([3, 2, 1], [1, 1e-15, -1e-15]),
    "very near axis 1": ([1, 2, 3], [1, 1e-160, 1e-160]),
    "very near axis 3": ([1, 2, 3], [1e-160, -1e-160, 1]),
    "separatrix": ([4, 5, 9], [3, 2, 1]),
    "separatrix, far out": ([9, 4, 5], [-1, 3, 1e-6]),
    "1000 rad/s": ([0.7, 1, 1.2], [800, -400, 600]),
    "1e-6 rad/s": ([0.7, 1, 1.2], [8e-7, -4e-7, 6e-7]),
    "small moments": ([0.7e-9, 1e-9, 1.2e-9], [0.8, -0.4, 0.6]),
    "large moments": ([0.7e9, 1e9, 1.2e9], [0.8, -0.4, 0.6]),
    "tensor": (tensor_of([1, 2, 3]), [0.1, 2, 0.1]),
    "tensor, nearly symmetric": (tensor_of([1, 1 + 1e-9, 2]), _Q @ [1, 1e-5, 1e-5]),
    "tensor, needle": (tensor_of([1e-6, 1, 1]), _Q @ [100, 0.3, -0.2]),
    "tensor, twice the same moment": ([[3, 1, 1], [1, 3, 1], [1, 1, 3]], [0.3, -0.4, 0.2]),
    "tensor, in the plane of that": ([[3, 1, 1], [1, 3, 1], [1, 1, 3]], [1, -1, 1e-9]),
    "tensor, axis 2": ([[5, 1, 0], [1, 5, 0], [0, 0, 5]], [0, 0, 1.3]),
    "tensor, axis 3": ([[5, 1, 0], [1, 5, 0], [0, 0, 5]], [0.7, 0.7, 0]),
}
LONG_CASES: dict[str, tuple[Any, Any, float]] = {
    "separatrix + 1e-3": ([4, 5, 9], [3.003, 2, 1], 17.0),
    "separatrix - 1e-3": ([4, 5, 9], [2.997, 2, 1], -17.0),
    "separatrix + 1e-9": ([9, 5, 4], [1, 2, 3 * (1 + 1e-9)], -35.0),
    "separatrix - 1e-15": ([5, 9, 4], [2, 1, 3 * (1 - 1e-15)], 65.0),
    "separatrix": ([5, 9, 4], [2, 1, 3], -13.0),
    "near axis 2": ([1, 2, 3], [1e-6, 1, 1e-6], 70.0),
    "nearer axis 2": ([1, 3, 2], [-1e-12, 1e-12, 1], -70.0),
    "nearest axis 2": ([2, 1, 3], [1, 1e-15, 1e-15], 70.0),
    "tensor, separatrix": ([[6.5, 0, -2.5], [0, 5, 0], [-2.5, 0, 6.5]], [4, 2.8, 2], 13.0),
    "tensor, near axis 2": (tensor_of([1, 2, 3]), _Q[:, 1], 70.0),
}
"""Inertia, omega, and the time of one or two flips in s."""
GAPS = [1e-3, 1e-6, 1e-9, 1e-12, 1e-15]
ORDERS = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]


@cache
def truth(name: str) -> Truth:
    """Return the truth of a named case."""
    return Truth(*CASES[name])


def assert_right(rotation: FreeRotation, true: Truth, times: tuple[float, ...]) -> None:
    """Assert that a rotation is accurate at ascending times, or at descending ones below zero."""
    state, before = true.start, Fraction(0)
    for t_s in times:
        state = true.advance(state, fixed((Fraction(t_s) - before) * true.pace))
        before = Fraction(t_s)
        assert_close(rotation, t_s, true.seen(state))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", CASES)
def test_truth_matches_sixty_digits_for_any_body(name: str) -> None:
    """Attitude and omega are accurate to 4e-15 after some rotations in either direction."""
    inertia, omega = CASES[name]
    turn_s = 2.0 * math.pi / (float(np.linalg.norm(omega)) or 1.0)
    rotation = closed_form(inertia, omega)
    assert_right(rotation, truth(name), (0.0, 0.02 * turn_s, 1.7 * turn_s))
    assert_right(rotation, truth(name), (-0.7 * turn_s,))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", LONG_CASES)
def test_truth_matches_sixty_digits_after_flips(name: str) -> None:
    """Close to the separatrix the motion stays accurate after flips that cost a stepper every digit."""
    inertia, omega, t_s = LONG_CASES[name]
    assert_right(closed_form(inertia, omega), Truth(inertia, omega), (0.2 * t_s, t_s))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("gap", GAPS)
def test_nearly_symmetric_bodies_lose_no_digits(gap: float, order: tuple[int, int, int]) -> None:
    """Two nearly equal moments lose no digits, in a general spin and in one within their plane."""
    for moments, spin in (([1, 1 + gap, 2], [0.4, -0.7, 0.5]), ([1, 1 + gap, 2], [1, 1e-5, 3e-6])):
        inertia, omega = [moments[i] for i in order], [spin[i] for i in order]
        assert_right(closed_form(inertia, omega), Truth(inertia, omega), (2.7,))


FAR = ["general", "general, other side", "oblate", "needle, not symmetric", "1000 rad/s", "tensor"]


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", FAR)
def test_truth_at_long_times_loses_no_digits(name: str) -> None:
    """No digits are lost at 1e6 s and 1e9 s, forwards or backwards."""
    rotation = closed_form(*CASES[name])
    once = truth(name).once(4.0 * rotation.quarter_period_s)
    for t_s in (1e6, -123456789.123, 1e9):
        assert_close(rotation, t_s, truth(name).far(t_s, *once))


@pytest.mark.slow
def test_oracles_agree() -> None:
    """Steps only, whole periods and the textbook agree to 1e-45."""
    inertia, omega = CASES["general"]
    once = truth("general").once(4.0 * closed_form(inertia, omega).quarter_period_s)
    stepped = truth("general").at(-9.0)
    for other in (truth("general").far(-9.0, *once), textbook(inertia, omega, -9.0)):
        assert MP.norm(stepped[0] - other[0]) < 1e-45
        assert MP.norm(MP.matrix(stepped[1]) - MP.matrix(other[1])) < 1e-45


TEXTBOOK: list[tuple[Any, Any]] = [
    *(([1, 1 + gap, 2], [0.4, -0.7, 0.5]) for gap in GAPS),
    *(([1, 1 + gap, 2], [1, -1e-5, 3e-6]) for gap in GAPS),
    *(([1, 1 + gap, 2], [1, 1e-9, 1e-8]) for gap in GAPS),
    *(([0.5, 1, 1 + gap], [1e-5, 1, -1e-7]) for gap in GAPS),
    ([1, 1 + 1e-9, 1 + 3e-9], [0.4, -0.7, 0.5]),
    ([1e-6, 1, 1 + 1e-6], [100, 1e-3, 2e-3]),
    *(([1, 2, 3], [offset, 1, -offset]) for offset in GAPS),
    *(([1, 2, 3], [1, offset, offset]) for offset in GAPS),
    *(([1, 2, 3], [offset, offset, 1]) for offset in GAPS),
    *(([4, 5, 9], [3 * (1 + offset), 2, 1]) for offset in GAPS),
    *(([4, 5, 9], [3 * (1 - offset), 2, 1]) for offset in GAPS),
]


@pytest.mark.slow(after=14)
@pytest.mark.parametrize("case", range(len(TEXTBOOK)))
def test_textbook_formula_holds_for_any_body(case: int) -> None:
    """Bodies with long periods or many flips are accurate at any time, about any axis."""
    order = ORDERS[case % len(ORDERS)]
    inertia, omega = ([values[i] for i in order] for values in TEXTBOOK[case])
    rotation = closed_form(inertia, omega)
    for t_s in (-17.0, 1e6, -1e9):
        assert_close(rotation, t_s, textbook(inertia, omega, t_s))


FULL: list[Any] = [
    [1, 2, 3],
    [1, 1 + 1e-9, 2],
    [1, 1, 2],
    [1, 2, 2],
    [1e-6, 1, 1],
    [1e-12, 1, 1],
    [1, 1 + 1e-14, 1 + 1e-15],
]


@pytest.mark.slow
@pytest.mark.nightly(after=2)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("moments", FULL)
def test_textbook_formula_holds_for_full_tensors(moments: Any, seed: int) -> None:
    """Full tensors are accurate at any time: nearly equal moments, needles, spins close to an axis."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tensor = axes @ np.diag(moments) @ axes.T
    tensor = 0.5 * (tensor + tensor.T)
    for omega in (rng.normal(size=3), *(axes[:, i] + 1e-9 * rng.normal(size=3) for i in range(3))):
        rotation = FreeRotation.from_state(tensor, QUATERNION, omega)
        for t_s in (-17.0, 1e9):
            assert_close(rotation, t_s, textbook_of_tensor(tensor, omega, t_s))


@pytest.mark.parametrize("offset", [0.0, 1e-12, -1e-6])
@pytest.mark.parametrize("seed", range(4))
def test_full_tensors_flip_on_time(offset: float, seed: int) -> None:
    """A full tensor one round-off from the separatrix flips on time after 1e9 s."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    i1, i2, i3 = moments = np.sort(rng.uniform(1.0, 3.0, size=3))
    tensor = axes @ np.diag(moments) @ axes.T
    tensor = 0.5 * (tensor + tensor.T)
    third = math.sqrt(i1 * (i2 - i1) / (i3 * (i3 - i2)))
    omega = axes @ [1.0 + offset, 0.5, third]
    rotation = FreeRotation.from_state(tensor, QUATERNION, omega)
    times = 1e9 + np.linspace(0.0, 2.0 * rotation.quarter_period_s, 2001)
    flip_s = float(times[np.argmin(np.abs(rotation.at(times)[1] @ axes[:, 1]))])
    assert_close(rotation, flip_s, textbook_of_tensor(tensor, omega, flip_s))


@pytest.mark.slow
def test_offset_of_1e_160_flips_on_time() -> None:
    """A spin that leaves the middle axis by 1e-160 flips 640 s later, on time."""
    inertia, omega = [1, 2, 3], [1e-160, 1, -3e-160]
    for t_s in (10.0, 637.0, 1e9):
        assert_close(closed_form(inertia, omega), t_s, textbook(inertia, omega, t_s, digits=700))


@pytest.mark.parametrize("name", ["general", "plate"])
def test_one_ulp_is_detected(name: str) -> None:
    """A body with a moment off by one ulp exceeds the tolerance at 1e6 s, so the bound can fail."""
    inertia, omega = CASES[name]
    wrong = closed_form([float(np.nextafter(inertia[0], 9.0)), *inertia[1:]], omega)
    assert attitude_error(wrong.at([1e6])[0][0], textbook(inertia, omega, 1e6)[0]) > 1e2 * TOLERANCE


# ------------------------------------------------------------------------------------------------- laws

LAWS = [name for name in CASES if name != "at rest"]


@pytest.mark.parametrize("name", LAWS)
def test_starts_at_the_state(name: str) -> None:
    """At t = 0 the motion is in the state from which it was set up, with the quaternion normalised."""
    inertia, omega = CASES[name]
    quaternion, found = closed_form(inertia, omega).at([0.0])
    assert quaternion[0] == pytest.approx(np.array(QUATERNION) / np.linalg.norm(QUATERNION), abs=1e-15)
    assert found[0] == pytest.approx(np.array(omega, dtype=float), rel=0.0, abs=1e-15 * np.linalg.norm(omega))


@pytest.mark.parametrize("name", LAWS + list(LONG_CASES))
def test_quaternion_is_continuous(name: str) -> None:
    """The quaternion never jumps to its negative, through half periods and whole rotations."""
    inertia, omega, *_ = (CASES | LONG_CASES)[name]
    times = np.linspace(-60.0, 60.0, 6001) / np.linalg.norm(omega)
    quaternion, _ = closed_form(inertia, omega).at(times)
    assert (np.sum(quaternion[1:] * quaternion[:-1], axis=1) > 0.9).all()


@pytest.mark.parametrize("name", LAWS + list(LONG_CASES))
def test_momentum_and_energy_are_constant(name: str) -> None:
    """The world's angular momentum and the energy are constant to rounding over 1e9 s."""
    inertia, omega, *_ = (CASES | LONG_CASES)[name]
    tensor = as_tensor(inertia)
    quaternions, found = closed_form(inertia, omega).at(np.linspace(-1e9, 1e9, 501))
    rotations = np.array([rotation_of(list(q)) for q in quaternions])
    momentum = np.einsum("nij,jk,nk->ni", rotations, tensor, found)
    first = np.array(rotation_of(list(QUATERNION))) @ tensor @ np.array(omega, dtype=float)
    size = np.linalg.norm(np.abs(found) @ np.abs(tensor), axis=1)
    assert (np.linalg.norm(momentum - first, axis=1) < 4e-15 * size).all()
    energy = np.einsum("ni,ij,nj->n", found, tensor, found)
    size = np.einsum("ni,ij,nj->n", np.abs(found), np.abs(tensor), np.abs(found))
    assert (np.abs(energy - np.array(omega) @ tensor @ np.array(omega)) < 4e-15 * size).all()


@pytest.mark.parametrize("name", ["general", "oblate", "needle", "plate", "sphere", "axis 3", "tensor"])
def test_group_property(name: str) -> None:
    """Starting again from the state at t1 and continuing for t2 equals continuing for t1 + t2."""
    inertia, omega = CASES[name]
    turn_s = 1.0 / float(np.linalg.norm(omega))
    rotation = closed_form(inertia, omega)
    quaternion, spin = rotation.at([1.7 * turn_s])
    found, found_omega = FreeRotation.from_state(as_tensor(inertia), quaternion[0], spin[0]).at(
        [2.6 * turn_s]
    )
    expected, expected_omega = rotation.at([1.7 * turn_s + 2.6 * turn_s])
    assert abs(abs(found[0] @ expected[0]) - 1.0) < 1e-14
    assert np.linalg.norm(found[0] * np.sign(found[0] @ expected[0]) - expected[0]) < 2e-14
    assert np.linalg.norm(found_omega - expected_omega) < 1e-14 * np.linalg.norm(omega)


@pytest.mark.parametrize("name", LAWS)
def test_reversal(name: str) -> None:
    """Reversing the spin reverses time: omega -> -omega and t -> -t give the same attitudes."""
    inertia, omega = CASES[name]
    times = np.array([0.3, 7.0, 1e5]) / np.linalg.norm(omega)
    forth, forth_omega = closed_form(inertia, omega).at(times)
    back, back_omega = closed_form(inertia, [-x for x in omega]).at(-times)
    assert np.abs(np.sum(forth * back, axis=1)) == pytest.approx(1.0, abs=1e-15)
    assert np.abs(forth_omega + back_omega).max() < 4e-15 * np.linalg.norm(forth_omega, axis=1).max()


@pytest.mark.parametrize("exponent", [1, -900, 1000])
@pytest.mark.parametrize(
    "name", ["general", "general, other side", "oblate", "axis 3", "separatrix", "tensor"]
)
def test_units(name: str, exponent: int) -> None:
    """A heavier body moves the same, and a faster one the same in less time, bit by bit, in any units."""
    inertia, omega = CASES[name]
    factor = 2.0**exponent
    times = np.array([0.3, -7.0, 1e5])
    quaternion, found = closed_form(inertia, omega).at(times)
    heavier = closed_form(factor * np.asarray(inertia, dtype=float), omega).at(times)
    faster = closed_form(inertia, [factor * x for x in omega]).at(times / factor)
    np.testing.assert_array_equal(heavier[0], quaternion)
    np.testing.assert_array_equal(heavier[1], found)
    np.testing.assert_array_equal(faster[0], quaternion)
    np.testing.assert_array_equal(faster[1], factor * found)


def test_largest_numbers() -> None:
    """No intermediate result overflows, up to half the largest double."""
    largest = 0.5 * float(np.finfo(np.float64).max)
    inertia, omega = largest * np.diag([0.3, 0.5, 1.0]), [largest, 0.1 * largest, -largest]
    rotation = FreeRotation.from_state(inertia, [largest] * 4, omega)
    quaternion, found = rotation.at([0.0, 3.0 / largest])
    assert np.linalg.norm(quaternion, axis=1) == pytest.approx(1.0, abs=1e-15)
    assert found[0] == pytest.approx(omega, rel=4e-15, abs=0.0)
    with pytest.raises(ValueError, match="within"):
        rotation.at([1.0])


@pytest.mark.parametrize(
    "name", ["general", "plate", "needle, not symmetric", "separatrix", "oblate", "prolate"]
)
def test_frame_indifference(name: str) -> None:
    """Other body axes, a quarter rotation apart, describe the same motion."""
    inertia, omega = CASES[name]
    tensor, spin = np.diag(np.asarray(inertia, dtype=float)), np.array(omega, dtype=float)
    times = np.array([0.3, -7.0, 1e5]) / np.linalg.norm(spin)
    quaternion, found = closed_form(inertia, omega).at(times)
    for order, half_turn in (((1, 2, 0), 0.5), ((2, 0, 1), -0.5)):
        new = np.array([0.5, half_turn, half_turn, half_turn])  # cyclic: x -> y -> z -> x, or reversed
        turned = FreeRotation.from_state(
            tensor[np.ix_(order, order)], product(QUATERNION, new), spin[list(order)]
        )
        other, other_omega = turned.at(times)
        back = np.array([product(q, new * [1, -1, -1, -1]) for q in other])
        assert np.abs(np.sum(back * quaternion, axis=1)) == pytest.approx(1.0, abs=2e-15)
        assert np.abs(other_omega - found[:, order]).max() < 4e-15 * np.abs(found).max()


def product(p: Any, q: Any) -> Array:
    """Hamilton's product p q."""
    (a, b, c, d), (w, x, y, z) = p, q
    return np.array(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ]
    )


def test_steady_rotation_is_exact() -> None:
    """About a principal axis, on a sphere or at rest, omega is returned bit for bit at any time."""
    times = np.linspace(-1e9, 1e9, 11)
    for inertia, omega in (
        ([1, 2, 3], [0, 0.1, 0]),
        ([2, 2, 2], [0.1, 0.2, 0.3]),
        ([1, 2, 2], [0, 0.1, 0.2]),
    ):
        assert (closed_form(inertia, omega).at(times)[1] == np.array(omega)).all()
    quaternion, omega = closed_form([1, 2, 3], [0, 0, 0]).at(times)
    assert (quaternion == quaternion[0]).all()
    assert not omega.any()


def test_separatrix_never_returns() -> None:
    """On the separatrix, identified exactly, the spin ends along the middle axis."""
    rotation = closed_form([4, 5, 9], [3, 2, 1])
    assert rotation.quarter_period_s == math.inf
    for t_s in (1e3, 1e9, -1e9):
        assert abs(rotation.at([t_s])[1][0] @ [0, 1, 0]) == pytest.approx(math.sqrt(13.0), rel=1e-15, abs=0.0)
    beside = closed_form([4, 5, 9], [float(np.nextafter(3.0, 4.0)), 2, 1])
    assert 10.0 < beside.quarter_period_s < 100.0


def test_negligible_components_do_no_harm() -> None:
    """A component 1e-300 of the largest does not make the motion tumble."""
    rotation = closed_form([1, 2, 3], [1e-300, 1, 5e-324])
    quaternion, omega = rotation.at([0.0, 1e9])
    assert np.isfinite(quaternion).all()
    assert omega.tolist() == [[1e-300, 1.0, 5e-324]] * 2


def test_shapes() -> None:
    """n times give n rows, none gives none, and a strided array is read correctly."""
    rotation = closed_form([1, 2, 3], [0.1, 2, 0.1])
    assert rotation.at([])[0].shape == (0, 4)
    assert rotation.at([])[1].shape == (0, 3)
    times = np.linspace(0.0, 1.0, 7)
    np.testing.assert_array_equal(rotation.at(times[::-2])[0], rotation.at(times)[0][::-2])


# -------------------------------------------------------------------------------------------- many bodies


def all_cases() -> tuple[Array, Array, Array]:
    """Return the states of every named case, with all kinds of motion mixed."""
    cases = [(as_tensor(inertia), omega) for inertia, omega, *_ in (CASES | LONG_CASES).values()]
    omegas = np.array([omega for _, omega in cases], dtype=float)
    quaternions = np.random.default_rng(3).normal(size=(len(cases), 4))
    return np.array([tensor for tensor, _ in cases]), quaternions, omegas


def test_many_bodies_equal_each_alone() -> None:
    """Steady, undecided and tumbling bodies set up together move bit for bit as each body alone."""
    states, times = all_cases(), np.array([0.0, 0.3, -7.0, 1e5])
    together = FreeRotations.from_states(*states)
    quaternion, omega = together.at(times)
    assert quaternion.shape == (len(states[0]), 4, 4)
    for k, state in enumerate(zip(*states, strict=True)):
        alone = FreeRotation.from_state(*state)
        np.testing.assert_array_equal(quaternion[k], alone.at(times)[0])
        np.testing.assert_array_equal(omega[k], alone.at(times)[1])
        assert together.quarter_period_s[k] == alone.quarter_period_s


def test_no_bodies_have_no_motion() -> None:
    """An empty set of bodies gives empty arrays."""
    nobody = FreeRotations.from_states(np.zeros((0, 3, 3)), np.zeros((0, 4)), np.zeros((0, 3)))
    assert nobody.at([0.0, 1.0])[0].shape == (0, 2, 4)


def test_one_impossible_body_is_named(expected_message: ExpectedMessage) -> None:
    """The impossible body among many is refused with its index or its values."""
    inertia, quaternion, omega = all_cases()
    inertia[3] = np.diag([1.0, -2.0, 3.0])
    with expected_message.raises(ValueError):
        FreeRotations.from_states(inertia, quaternion, omega)
    omega[5, 1] = math.nan
    with expected_message.raises(ValueError):
        FreeRotations.from_states(inertia, quaternion, omega)
    with expected_message.raises(ValueError):
        FreeRotations.from_states(inertia, quaternion[:-1], omega)


@pytest.mark.parametrize("offset", [0.3, 0.1, 1e-2, 1e-9, 1e-15])
def test_exact_decision_does_not_change_the_motion(offset: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Classified in floating point or in exact integers, the motion is the same to rounding."""
    state = (tensor_of([4, 5, 9]), QUATERNION, _Q @ [3 * (1 + offset), 2, 1])
    decided = FreeRotation.from_state(*state).at([1e9])

    def undecided(*arguments: Any) -> None:
        set_up_tumbling(*arguments)
        arguments[-1].fill(True)

    monkeypatch.setattr(free_rotations, "set_up_tumbling", undecided)
    exact = FreeRotation.from_state(*state).at([1e9])
    assert np.abs(decided[0] - exact[0]).max() < 4e-15
    assert np.abs(decided[1] - exact[1]).max() < 1e-14


# ---------------------------------------------------------------------------------------------- refusals

_EYE = np.eye(3)


@pytest.mark.parametrize(
    ("inertia", "quaternion", "omega"),
    [
        (np.diag([1, math.nan, 1]), QUATERNION, [1, 2, 3]),
        (_EYE, [1, 0, math.inf, 0], [1, 2, 3]),
        (_EYE, QUATERNION, [1, -math.inf, 3]),
        (_EYE, [0, 0, 0, 0], [1, 2, 3]),
        (np.diag([1, 1, 0]), QUATERNION, [1, 2, 3]),
        (np.diag([1, -1e-300, 1]), QUATERNION, [1, 2, 3]),
        ([[1, 1, 0], [1, 1, 0], [0, 0, 1]], QUATERNION, [1, 2, 3]),
        (-_EYE, QUATERNION, [1, 2, 3]),
        (np.zeros((3, 3)), QUATERNION, [1, 2, 3]),
        ([[1, 1e-9, 0], [0, 1, 0], [0, 0, 1]], QUATERNION, [1, 2, 3]),
        ([1, 2, 3], QUATERNION, [1, 2, 3]),
        (_EYE, [1, 0, 0], [1, 2, 3]),
        (_EYE, QUATERNION, [[1, 2, 3]]),
    ],
)
def test_impossible_states_are_refused(
    inertia: Any, quaternion: Any, omega: Any, expected_message: ExpectedMessage
) -> None:
    """An impossible state is refused, and the message shows it."""
    with expected_message.raises(ValueError):
        FreeRotation.from_state(inertia, quaternion, omega)


@pytest.mark.parametrize("omega", [[0.1, 2, 0.1], [0, 2, 0]])
@pytest.mark.parametrize(
    "times",
    [
        [0.0, math.nan],
        [-math.inf],
        [1.0, -1e18],
        1.0,
        [[1.0]],
    ],
)
def test_impossible_times_are_refused(
    omega: list[float], times: Any, expected_message: ExpectedMessage
) -> None:
    """Times that are not finite, or too large for the phase to be known, are refused with their value."""
    with expected_message.raises(ValueError):
        closed_form([1, 2, 3], omega).at(times)


def test_rounding_asymmetry_is_accepted() -> None:
    """A tensor that is asymmetric by rounding is replaced by its symmetric part."""
    tensor = tensor_of([1, 2, 3])
    skewed = tensor.copy()
    skewed[0, 1] = np.nextafter(skewed[0, 1], 9.0)
    skewed[1, 0] = np.nextafter(skewed[1, 0], -9.0)
    found = FreeRotation.from_state(skewed, QUATERNION, [0.1, 2, 0.1]).at([7.0])
    np.testing.assert_array_equal(found[0], closed_form(tensor, [0.1, 2, 0.1]).at([7.0])[0])
