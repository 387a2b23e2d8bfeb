"""The torque-free rotation of one rigid body in closed form: attitude and angular velocity at any time.

The principal axes are numbered so that L = (A1 cn, s A2 sn, A3 dn)(u), u = u0 + lambda t, with A1 >= 0,
A3 > 0 and s = +1 where the moments ascend, -1 where they descend (the two sides of the separatrix). In the
frame whose third axis is the angular momentum the attitude's Cayley-Klein parameters are, up to one common
real factor, single theta functions of the doubled nome, with x = pi u / 2K and z = x - i s pi a / 2K:

    alpha = exp(i Omega t / 2) theta4(z | q^2),    beta = s rho exp(i Omega t / 2) theta1(z | q^2).

Nothing in them is a difference of large numbers: neither beside the separatrix (where Jacobi's imaginary
transformation makes the series converge), nor for nearly symmetric bodies, nor for needles. What time
multiplies (lambda, Omega, K) is known to 106 bits, and the moments, principal axes and momentum with it;
which side of the separatrix the body is on, and how far from it, is decided in exact integers.

Sources: Jacobi 1850, Sur la rotation d'un corps; Whittaker 1937, Analytical dynamics, par. 69-71; van Zon &
Schofield 2007, Numerical implementation of the exact dynamics of free rigid bodies, J. Comput. Phys. 225.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from operator import mul
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl import elliptic, registers
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.jit import exact_kernel, kernel
from bodycheck.reference_impl.registers import Mat, Quat, Vec

_SYMMETRY_TOLERANCE = 1e-12
_NEGLIGIBLE_BITS = 960  # components of omega below 2^-960 of the largest would leave the range of doubles
_KEPT_BITS = 120  # of an integer on its way to a double-double
_AXES_BITS = 256  # of the principal axes, of which some 80 go by the rounding and the stopping below
_SETTLED_BITS = _AXES_BITS - 200  # off-diagonal elements below 2^-200 of the largest moment are none
_MOST_TURNS = 2.0**50
_TWO_PI: DoubleDouble = (2.0 * dd.PI[0], 2.0 * dd.PI[1])
_FOUR_PI: DoubleDouble = (4.0 * dd.PI[0], 4.0 * dd.PI[1])

_Coefficients: TypeAlias = tuple[float, float, float, float]
_Triple: TypeAlias = tuple[DoubleDouble, DoubleDouble, DoubleDouble]


class _Steady(NamedTuple):
    """A constant angular velocity: q(t) = q(0) exp(axis |omega| t / 2)."""

    frequency: float
    """The power of two, in 1/s, that makes the time unit: then all that is squared is of ordinary size."""
    turn_rate: DoubleDouble
    """|omega| / 4 pi: turns of the half angle per time unit."""
    axis: Vec
    quaternion: Quat
    omega: Vec


class _CayleyKlein(NamedTuple):
    """Coefficients of the theta series of (alpha, beta), real and imaginary parts, term by term."""

    alpha_real: _Coefficients
    alpha_imag: _Coefficients
    beta_real: _Coefficients
    beta_imag: _Coefficients
    twist: float
    """Turns that the common phase gains per unit of the reduced u; zero for trigonometric series."""


class _Tumble(NamedTuple):
    """The motion seen from the principal axes, numbered as the module says, to the momentum's frame."""

    functions: elliptic.Quotients
    start: DoubleDouble
    """u0."""
    rate: DoubleDouble
    """lambda, per time unit."""
    turn_rate: DoubleDouble
    """Omega / 4 pi: turns of the common phase per time unit."""
    series: _CayleyKlein
    omega: Vec
    """Amplitudes (A1/I1, s A2/I2, A3/I3), in rad per time unit."""


class _Tumbling(NamedTuple):
    """q(body to world) = left * q(principal axes to the momentum's frame) * right."""

    motion: _Tumble
    frequency: float
    """As for a steady motion."""
    left: Quat
    right: Quat
    axes: Mat
    """The principal axes in body axes, as columns."""


# ---------------------------------------------------------------------------------------------- at a time


@exact_kernel
def _turn(rate: DoubleDouble, t: float, extra: float) -> tuple[float, float]:
    """(sin, cos) of 2 pi (rate t + extra), whole turns taken off before rounding."""
    turns, rest = dd.two_product(rate[0], t)
    fraction, low = dd.two_sum(turns - np.rint(turns), rest + rate[1] * t)
    fraction, lower = dd.two_sum(fraction - np.rint(fraction), extra)
    return elliptic.circular_argument((fraction, low + lower), _TWO_PI)


@kernel
def _unit(q: Quat) -> Quat:
    """q / |q|, |q| > 0 and of ordinary size."""
    shrink = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] * shrink, q[1] * shrink, q[2] * shrink, q[3] * shrink


@kernel
def _dot(a: _Coefficients, b: _Coefficients) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@kernel
def _trigonometric_series(s: _CayleyKlein, sin_x: float, cos_x: float) -> Quat:
    """(Re alpha, Im alpha, Re beta, Im beta) without the common phase."""
    c2 = (cos_x - sin_x) * (cos_x + sin_x)
    c4 = 2.0 * c2 * c2 - 1.0
    c6 = 2.0 * c2 * c4 - c2
    odd_sines = (1.0, 2.0 * c2 + 1.0, 2.0 * (c4 + c2) + 1.0, 2.0 * (c6 + c4 + c2) + 1.0)
    odd_cosines = (1.0, 2.0 * c2 - 1.0, 2.0 * (c4 - c2) + 1.0, 2.0 * (c6 - c4 + c2) - 1.0)
    even_sines = (0.0, 1.0, 2.0 * c2, 2.0 * c4 + 1.0)
    return (
        _dot(s.alpha_real, (1.0, c2, c4, c6)),
        2.0 * sin_x * cos_x * _dot(s.alpha_imag, even_sines),
        sin_x * _dot(s.beta_real, odd_sines),
        cos_x * _dot(s.beta_imag, odd_cosines),
    )


@kernel
def _exponential_series(s: _CayleyKlein, nome: float, sign: float, decay: float, rise: float) -> Quat:
    """(Re alpha, Im alpha, Re beta, Im beta) without the common phase, times a positive factor."""
    q = math.sqrt(nome)
    q2, q3 = nome, q * nome
    q4 = q2 * q2
    q6, q9 = q3 * q3, q4 * q3 * q2
    decay2, rise2 = decay * decay, rise * rise
    a1, b1 = q * rise, q2 * decay2
    a2, b2 = q4 * rise2, q6 * decay2 * decay
    a3, b3 = q9 * rise2 * rise, q6 * q6 * decay2 * decay2
    cosh = (1.0 + decay, a1 + b1, a2 + b2, a3 + b3)
    sinh = (1.0 - decay, a1 - b1, a2 - b2, a3 - b3)
    return (
        _dot(s.alpha_real, cosh),
        sign * _dot(s.alpha_imag, sinh),
        sign * _dot(s.beta_real, sinh),
        _dot(s.beta_imag, cosh),
    )


@exact_kernel
def _state(motion: _Tumble, t: float) -> tuple[Quat, Vec]:
    """Quaternion (of any norm) to the momentum's frame, and omega, both from and along the numbered axes."""
    f = motion.functions
    u = dd.add(dd.multiply(motion.rate, (t, 0.0)), motion.start)
    u, sign = elliptic.reduce_by_half_periods(u, f.quarter_period)
    if f.trigonometric:
        sin_x, cos_x = elliptic.circular_argument(u, f.rate)
        sn, cn, dn = elliptic.circular_functions(f, sin_x, cos_x)
        alpha_re, alpha_im, beta_re, beta_im = _trigonometric_series(motion.series, sin_x, cos_x)
    else:
        u_sign = math.copysign(1.0, u[0])
        argument = elliptic.exponential_argument(u, f.rate, f.quarter_period)
        sn, cn, dn = elliptic.exponential_functions(f, u_sign, argument)
        alpha_re, alpha_im, beta_re, beta_im = _exponential_series(
            motion.series, f.nome, u_sign, argument[0], argument[2]
        )
    s, c = _turn(motion.turn_rate, t, motion.series.twist * u[0])
    return (
        (
            alpha_re * c - alpha_im * s,
            sign * (beta_re * c - beta_im * s),
            sign * (beta_re * s + beta_im * c),
            alpha_re * s + alpha_im * c,
        ),
        (motion.omega[0] * sign * cn, motion.omega[1] * sign * sn, motion.omega[2] * dn),
    )


@kernel
def _tumbling_at(tumbling: _Tumbling, t_s: Array, quaternion: Array, omega: Array) -> None:
    """Fill quaternion (n, 4) and omega (n, 3) for the times t_s (n,)."""
    for i in range(len(t_s)):
        relative, omega_axes = _state(tumbling.motion, tumbling.frequency * t_s[i])
        q = _unit(
            registers.quaternion_times(registers.quaternion_times(tumbling.left, relative), tumbling.right)
        )
        w = registers.times(tumbling.axes, omega_axes)
        for j in range(4):
            quaternion[i, j] = q[j]
        for j in range(3):
            omega[i, j] = tumbling.frequency * w[j]


@kernel
def _steady_at(motion: _Steady, t_s: Array, quaternion: Array, omega: Array) -> None:
    """Fill quaternion (n, 4) and omega (n, 3) for the times t_s (n,)."""
    axis = motion.axis
    for i in range(len(t_s)):
        s, c = _turn(motion.turn_rate, motion.frequency * t_s[i], 0.0)
        q = _unit(registers.quaternion_times(motion.quaternion, (c, s * axis[0], s * axis[1], s * axis[2])))
        for j in range(4):
            quaternion[i, j] = q[j]
        for j in range(3):
            omega[i, j] = motion.omega[j]


# ------------------------------------------------------------------------------- set-up, exact integers


class _Exact(NamedTuple):
    """The state at t = 0 in integers, in units of 2^-bits, scaled to largest magnitudes in [1, 2)."""

    inertia: list[int]
    """xx, xy, xz, yy, yz, zz."""
    inertia_bits: int
    omega: list[int]
    omega_bits: int

    @property
    def momentum(self) -> tuple[int, int, int]:
        """L = I omega along the body axes."""
        (a, b, c, d, e, f), (x, y, z) = self.inertia, self.omega
        return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z

    @property
    def is_positive_definite(self) -> bool:
        """Whether all the leading minors of the inertia are positive (Sylvester)."""
        a, b, _, d, _, _ = self.inertia
        return a > 0 and a * d > b * b and _determinant(self.inertia) > 0

    @property
    def is_steady(self) -> bool:
        """Whether omega is along a principal axis, or zero: L x omega = 0."""
        (x, y, z), (lx, ly, lz) = self.omega, self.momentum
        return ly * z == lz * y and lz * x == lx * z and lx * y == ly * x

    @property
    def separatrix_determinant(self) -> tuple[int, int]:
        """(n, e), n 2^e = det(2E I - G^2) = d1 D2 d3; D2 = G^2 - 2E I2 is 0 on the separatrix."""
        (a, b, c, d, e, f), (x, y, z), (lx, ly, lz) = self.inertia, self.omega, self.momentum
        energy, square = x * lx + y * ly + z * lz, lx * lx + ly * ly + lz * lz
        shifted = [
            energy * a - square,
            energy * b,
            energy * c,
            energy * d - square,
            energy * e,
            energy * f - square,
        ]
        return _determinant(shifted), -6 * (self.inertia_bits + self.omega_bits)

    @classmethod
    def of(cls, inertia: Array, omega: Array) -> tuple[_Exact, float]:
        """Take over inertia (3, 3) and omega (3,), and return what omega has been divided by."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
        elements, inertia_bits, _ = _integers([xx, xy, xz, yy, yz, zz])
        components, omega_bits, exponent = _integers(omega.tolist())
        least = omega_bits - _NEGLIGIBLE_BITS
        components = [n if n.bit_length() > least else 0 for n in components]
        return cls(elements, inertia_bits, components, omega_bits), math.ldexp(1.0, exponent)


def _integers(values: list[float]) -> tuple[list[int], int, int]:
    """(n, bits, exponent) with values = n 2^(exponent - bits), the largest |n| in [2^bits, 2^(bits + 1))."""
    ratios = [value.as_integer_ratio() for value in values]
    common = max(denominator for _, denominator in ratios)
    integers = [numerator * (common // denominator) for numerator, denominator in ratios]
    bits = max(map(abs, integers)).bit_length() - 1
    return integers, bits, bits + 1 - common.bit_length()


def _determinant(m: list[int]) -> int:
    """Determinant of the symmetric matrix (xx, xy, xz, yy, yz, zz)."""
    a, b, c, d, e, f = m
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


def _double_double(n: int, exponent: int) -> DoubleDouble:
    """Round n 2^exponent to 2^-106."""
    shift = n.bit_length() - _KEPT_BITS
    if shift > 0:
        n, exponent = n >> shift, exponent + shift
    high = float(n)
    return math.ldexp(high, exponent), math.ldexp(float(n - int(high)), exponent)


def _triple(values: Iterable[int], exponent: int) -> _Triple:
    x, y, z = (_double_double(n, exponent) for n in values)
    return x, y, z


def _even_exponent(n: int, exponent: int) -> tuple[DoubleDouble, int]:
    """(x, e), e even, with n 2^exponent = x 2^e to 2^-106 and x, unless zero, in [1/4, 1)."""
    bits = n.bit_length()
    bits += (bits + exponent) % 2
    return _double_double(n, -bits), exponent + bits


def _principal_axes(inertia: list[int]) -> tuple[list[int], list[list[int]], int]:
    """(moments, axes, bits): inertia = axes^T diag(moments) axes, by cyclic Jacobi rotations in integers.

    inertia is (xx, xy, xz, yy, yz, zz); the moments come in its unit times 2^-bits, the axes, as rows, in
    2^-bits. Their error is some 2^-170 of the largest moment, so that gaps of 1e-16 keep 106 bits. A
    diagonal tensor is its own answer, exactly. Source: Golub & Van Loan 2013, Matrix computations, 8.5.
    """
    xx, xy, xz, yy, yz, zz = inertia
    if xy == xz == yz == 0:
        return [xx, yy, zz], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], 0
    bits = _AXES_BITS
    one = 1 << bits
    a = [[x << bits for x in row] for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    axes = [[one, 0, 0], [0, one, 0], [0, 0, one]]
    settled = max(xx, yy, zz) << _SETTLED_BITS
    while max(abs(a[0][1]), abs(a[0][2]), abs(a[1][2])) > settled:
        for p, q, r in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
            off, gap = a[p][q], a[q][q] - a[p][p]
            if off == 0:
                continue
            # the tangent of the smaller angle: t = 2 off / (gap +- sqrt(gap^2 + 4 off^2))
            root = math.isqrt(gap * gap + 4 * off * off)
            t = (2 * off << bits) // (gap + root if gap >= 0 else gap - root)
            c = (one << bits) // math.isqrt((one << bits) + t * t)
            s = t * c >> bits
            a[p][p] -= t * off >> bits
            a[q][q] += t * off >> bits
            a[p][q] = a[q][p] = 0
            x, y = a[r][p], a[r][q]
            a[r][p] = a[p][r] = c * x - s * y >> bits
            a[r][q] = a[q][r] = s * x + c * y >> bits
            axes[p], axes[q] = (
                [c * u - s * v >> bits for u, v in zip(axes[p], axes[q], strict=True)],
                [s * u + c * v >> bits for u, v in zip(axes[p], axes[q], strict=True)],
            )
    return [a[0][0], a[1][1], a[2][2]], axes, bits


class _Axes(NamedTuple):
    """The principal axes numbered as the module says."""

    moments: _Triple
    gaps: _Triple
    """|I2 - I1|, |I3 - I1|, |I3 - I2|."""
    momentum: _Triple
    """L along them; the first not negative, the third positive."""
    columns: Mat
    """Their directions in body axes, as columns of a proper matrix."""
    side: float
    """s: +1 where the moments ascend, -1 where they descend."""


def _numbered(exact: _Exact, descending: bool) -> _Axes:
    """Number the principal axes, so that the third carries the momentum whose sign never changes."""
    moments, axes, bits = _principal_axes(exact.inertia)
    order = sorted(range(3), key=moments.__getitem__, reverse=descending)
    i1, i2, i3 = (moments[i] for i in order)
    rows = [axes[i] for i in order]
    momentum = [
        moment * sum(map(mul, row, exact.omega)) for moment, row in zip((i1, i2, i3), rows, strict=True)
    ]
    sign1, sign3 = (-1 if momentum[i] < 0 else 1 for i in (0, 2))
    parity = 1 if (order[1] - order[0]) % 3 == 1 else -1
    signs = (sign1, parity * sign1 * sign3, sign3)
    unit = -exact.inertia_bits - bits
    x, y, z = ([math.ldexp(sign * n, -bits) for n in row] for sign, row in zip(signs, rows, strict=True))
    return _Axes(
        _triple((i1, i2, i3), unit),
        _triple((abs(i2 - i1), abs(i3 - i1), abs(i3 - i2)), unit),
        _triple(map(mul, signs, momentum), unit - bits - exact.omega_bits),
        (x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]),
        -1.0 if descending else 1.0,
    )


# ---------------------------------------------------------------------------------- set-up, double-double


@exact_kernel
def _hypotenuse(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """sqrt(x^2 + y^2), also where the squares leave the range of doubles."""
    exponent = math.frexp(max(abs(x[0]), abs(y[0])))[1]
    down = math.ldexp(1.0, -exponent)
    x, y = dd.scale(x, down), dd.scale(y, down)
    root = dd.square_root(dd.add(dd.multiply(x, x), dd.multiply(y, y)))
    return dd.scale(root, math.ldexp(1.0, exponent))


@exact_kernel
def _root_of_ratio(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    return dd.square_root(dd.divide(x, y))


@exact_kernel
def _complementary_modulus(
    root1: DoubleDouble, root3: DoubleDouble, shape: DoubleDouble, determinant: DoubleDouble, exponent: int
) -> DoubleDouble:
    """k' = sqrt(determinant 2^exponent) shape / (root1^2 root3), no step of which may underflow."""
    exponent1, exponent3 = math.frexp(root1[0])[1], math.frexp(root3[0])[1]
    root1 = dd.scale(root1, math.ldexp(1.0, -exponent1))
    root3 = dd.scale(root3, math.ldexp(1.0, -exponent3))
    ratio = dd.divide(dd.square_root(determinant), dd.multiply(dd.multiply(root1, root1), root3))
    return dd.scale(dd.multiply(ratio, shape), math.ldexp(1.0, exponent // 2 - 2 * exponent1 - exponent3))


@exact_kernel
def _mean_turn_rate(
    slow: DoubleDouble,
    fast: DoubleDouble,
    weight: DoubleDouble,
    turning: DoubleDouble,
    kc: DoubleDouble,
    quarter_period: DoubleDouble,
) -> DoubleDouble:
    """Omega / 4 pi, Omega = <precession> - turning / K.

    The precession, (fast A1^2 cn^2 + slow A2^2 sn^2) / (A1^2 cn^2 + A2^2 sn^2) with fast = G/I1, slow = G/I2
    and weight = (A2/A1)^2, is averaged over a half period; on the separatrix it is slow for ever.
    """
    if kc[0] == 0.0:
        return dd.divide(slow, _FOUR_PI)
    total = elliptic.complete_integral(kc, weight, fast, dd.multiply(weight, slow))
    return dd.divide(dd.subtract(total, turning), dd.multiply(quarter_period, _FOUR_PI))


@kernel
def _trigonometric_coefficients(nome: float, a: float, tilt: float, side: float) -> _CayleyKlein:
    """Series of theta4 and theta1, nome q^2, at x - i s a, with |beta / alpha| = tilt at x = 0.

    q^2n^2 e^2na is written q^(2n^2 - n) g^n with g = q e^2a <= 1, so that nothing overflows as a grows.
    """
    decay = math.exp(-2.0 * a)
    g = nome / decay if decay > 0.0 else 0.0
    q3, q6 = nome**3, nome**6
    # e^-2na - 1, the exponent of the sines and cosines apart
    e1, e2, e3, e4 = math.expm1(-2.0 * a), math.expm1(-4.0 * a), math.expm1(-6.0 * a), math.expm1(-8.0 * a)
    e5, e6, e7 = math.expm1(-10.0 * a), math.expm1(-12.0 * a), math.expm1(-14.0 * a)
    even1, even2, even3 = -nome * g, q6 * g * g, -q6 * q6 * q3 * g**3
    odd1, odd2, odd3 = -q3 * g, q6 * q3 * nome * g * g, -q6 * q6 * q6 * q3 * g**3
    real1, real2, real3 = even1 * (2.0 + e2), even2 * (2.0 + e4), even3 * (2.0 + e6)
    imag0, imag1, imag2, imag3 = e1, odd1 * e3, odd2 * e5, odd3 * e7
    rho = -tilt * (1.0 + real1 + real2 + real3) / (imag0 + imag1 + imag2 + imag3)
    sided = side * rho
    return _CayleyKlein(
        (1.0, real1, real2, real3),
        (0.0, -side * even1 * e2, -side * even2 * e4, -side * even3 * e6),
        (sided * (2.0 + e1), sided * odd1 * (2.0 + e3), sided * odd2 * (2.0 + e5), sided * odd3 * (2.0 + e7)),
        (rho * imag0, rho * imag1, rho * imag2, rho * imag3),
        0.0,
    )


@kernel
def _exponential_coefficients(
    nome: float, gamma: float, tilt: float, side: float, twist: float
) -> _CayleyKlein:
    """Series of theta2 and theta1, nome sqrt(q'), at gamma + i s y, with |beta / alpha| = tilt at y = 0."""
    c0, c1, c2, c3 = math.cos(gamma), math.cos(3.0 * gamma), math.cos(5.0 * gamma), math.cos(7.0 * gamma)
    s0, s1, s2, s3 = math.sin(gamma), math.sin(3.0 * gamma), math.sin(5.0 * gamma), math.sin(7.0 * gamma)
    q3, q6 = nome**3, nome**6
    rho = tilt * (c0 + nome * c1 + q3 * c2 + q6 * c3) / (s0 - nome * s1 + q3 * s2 - q6 * s3)
    sided = side * rho
    return _CayleyKlein(
        (c0, c1, c2, c3),
        (-side * s0, -side * s1, -side * s2, -side * s3),
        (sided * c0, -sided * c1, sided * c2, -sided * c3),
        (-rho * s0, rho * s1, -rho * s2, rho * s3),
        twist,
    )


@kernel
def _series(functions: elliptic.Quotients, a: float, tilt: float, side: float) -> _CayleyKlein:
    """Coefficients of (alpha, beta), whose beta has its zero at u = i s a and is tilt |alpha| at u = 0.

    Jacobi's imaginary transformation makes theta4(x - i s pi a / 2K | q^2), up to a real factor, into
    exp(i s gamma u / K) theta2(gamma + i s y | sqrt(q')), with y = pi u / 4K' and gamma = pi a / 4K', and
    theta1 likewise into theta1 (DLMF 20.7.30-33). The exponential is the twist.
    """
    if functions.trigonometric:
        return _trigonometric_coefficients(functions.nome, functions.rate[0] * a, tilt, side)
    gamma = 0.5 * functions.rate[0] * a
    twist = side * gamma / (_TWO_PI[0] * functions.quarter_period[0])
    return _exponential_coefficients(functions.nome, gamma, tilt, side, twist)


@exact_kernel
def _tumble(
    moments: _Triple,
    gaps: _Triple,
    momentum: _Triple,
    side: float,
    determinant: DoubleDouble,
    exponent: int,
) -> _Tumble:
    """Set up the motion along the numbered axes. Every step multiplies, divides or adds numbers of one sign.

    With d1 = G^2 - 2E I1 = L2^2 (I2-I1)/I2 + L3^2 (I3-I1)/I3 and d3 = 2E I3 - G^2 likewise, up to sign:
    lambda^2 = d1 (I3-I2) / I1 I2 I3, m = d3 (I2-I1) / d1 (I3-I2), m1 = D2 (I3-I1) / d1 (I3-I2),
    A1^2 = d3 I1/(I3-I1), A2^2 = d3 I2/(I3-I2), A3^2 = d1 I3/(I3-I1). gaps are |I2-I1|, |I3-I1|, |I3-I2|,
    determinant 2^exponent is |d1 D2 d3|.
    """
    (i1, i2, i3), (gap21, gap31, gap32), (l1, l2, l3) = moments, gaps, momentum
    root1 = _hypotenuse(
        dd.multiply(l2, _root_of_ratio(gap21, i2)), dd.multiply(l3, _root_of_ratio(gap31, i3))
    )
    root3 = _hypotenuse(
        dd.multiply(l1, _root_of_ratio(gap31, i1)), dd.multiply(l2, _root_of_ratio(gap32, i2))
    )
    amplitude1 = dd.multiply(root3, _root_of_ratio(i1, gap31))
    amplitude2 = dd.multiply(root3, _root_of_ratio(i2, gap32))
    amplitude3 = dd.multiply(root1, _root_of_ratio(i3, gap31))
    norm = _hypotenuse(_hypotenuse(l1, l2), l3)
    rate = dd.multiply(root1, _root_of_ratio(gap32, dd.multiply(dd.multiply(i1, i2), i3)))

    k = dd.multiply(_root_of_ratio(gap21, gap32), dd.divide(root3, root1))
    kc = _complementary_modulus(root1, root3, _root_of_ratio(gap31, gap32), determinant, exponent)
    functions = elliptic.quotients(kc, k)
    sn, cn, dn = dd.divide(l2, amplitude2), dd.divide(l1, amplitude1), dd.divide(l3, amplitude3)
    start = dd.scale(dd.multiply(sn, elliptic.carlson_rf_of_squares(cn, dn, dd.ONE)), side)

    weight = dd.divide(dd.multiply(i2, gap31), dd.multiply(i1, gap32))
    turning = dd.scale(dd.multiply(dd.PI, rate), 0.5 * side)
    turn_rate = _mean_turn_rate(
        dd.divide(norm, i2), dd.divide(norm, i1), weight, turning, kc, functions.quarter_period
    )
    # a = F(atan(1 / sqrt(kappa)) | m1), since 1 + kappa sn(i a)^2 = 0
    kappa = i3[0] * gap21[0] / (i1[0] * gap32[0])
    a = elliptic.carlson_rf(kappa, kappa + k[0] * k[0], kappa + 1.0)
    tilt = amplitude1[0] / (norm[0] + amplitude3[0])
    return _Tumble(
        functions,
        start,
        rate,
        turn_rate,
        _series(functions, a, tilt, side),
        (
            amplitude1[0] / i1[0],
            side * amplitude2[0] / i2[0],
            amplitude3[0] / i3[0],
        ),
    )


# ---------------------------------------------------------------------------------------- set-up, frames


def _quaternion_of(m: Mat) -> Quat:
    """q with R(q) = m, a rotation matrix, up to a factor, through its largest component (Shepperd 1978)."""
    w, x, y, z = (
        1.0 + m[0] + m[4] + m[8],
        1.0 + m[0] - m[4] - m[8],
        1.0 - m[0] + m[4] - m[8],
        1.0 - m[0] - m[4] + m[8],
    )
    candidates: list[tuple[float, Quat]] = [
        (w, (w, m[7] - m[5], m[2] - m[6], m[3] - m[1])),
        (x, (m[7] - m[5], x, m[1] + m[3], m[2] + m[6])),
        (y, (m[2] - m[6], m[1] + m[3], y, m[5] + m[7])),
        (z, (m[3] - m[1], m[2] + m[6], m[5] + m[7], z)),
    ]
    return max(candidates)[1]


def _conjugate(q: Quat) -> Quat:
    return q[0], -q[1], -q[2], -q[3]


def _placed(motion: _Tumble, frequency: float, columns: Mat, quaternion: Quat) -> _Tumbling:
    """Let the motion start from the quaternion."""
    principal = _unit(_quaternion_of(columns))
    relative = _unit(_state(motion, 0.0)[0])
    left = registers.quaternion_times(registers.quaternion_times(quaternion, principal), _conjugate(relative))
    return _Tumbling(motion, frequency, left, _conjugate(principal), columns)


def _steady(quaternion: Quat, omega: Array, frequency: float) -> _Steady:
    """A rotation about a fixed axis, or none for omega = 0."""
    x, y, z = (omega / frequency).tolist()
    norm = _hypotenuse(_hypotenuse((x, 0.0), (y, 0.0)), (z, 0.0))
    size = norm[0] or 1.0
    axis = (x / size, y / size, z / size)
    return _Steady(frequency, dd.divide(norm, _FOUR_PI), axis, quaternion, tuple(omega.tolist()))


# ----------------------------------------------------------------------------------------------- in public


@dataclass(frozen=True, eq=False)
class FreeRotation:
    """q(t) and omega(t) of I omega' = (I omega) x omega, q' = q omega / 2, at any t without stepping."""

    _motion: _Steady | _Tumbling

    @classmethod
    def from_state(cls, inertia: ArrayLike, quaternion: ArrayLike, omega_body: ArrayLike) -> FreeRotation:
        """Set up the motion through a state at t = 0.

        inertia (3, 3): about the centre of mass, in body axes, kg m^2; any positive multiple gives the same
        motion. quaternion (4,): scalar first, body to world, of any norm but zero. omega_body (3,): body
        axes, rad/s; components below 1e-288 of the largest are taken as zero. All else is taken as exact.

        Raises ValueError for other shapes, NaN, infinities, a zero quaternion, and an inertia that is not
        symmetric (to 1e-12 of its largest element; the symmetric part is used) or not positive definite.
        """
        tensor = _symmetric("inertia", _checked("inertia", inertia, (3, 3)))
        attitude = _checked("quaternion", quaternion, (4,))
        omega = _checked("omega_body", omega_body, (3,))
        if not attitude.any():
            raise ValueError(f"quaternion must not be zero, got {attitude.tolist()}")
        exact, frequency = _Exact.of(tensor, omega)
        if not exact.is_positive_definite:
            raise ValueError(f"inertia must be positive definite, got {tensor.tolist()}")
        start = _unit(_ordinary_size(attitude))
        if exact.is_steady:
            return cls(_steady(start, omega, frequency))
        determinant, unit = exact.separatrix_determinant
        axes = _numbered(exact, descending=determinant < 0)
        motion = _tumble(
            axes.moments,
            axes.gaps,
            axes.momentum,
            axes.side,
            *_even_exponent(abs(determinant), unit),
        )
        return cls(_placed(motion, frequency, axes.columns, start))

    @property
    def quarter_period_s(self) -> float:
        """K / lambda: omega_body repeats after four of them; infinite if steady or on the separatrix."""
        if isinstance(self._motion, _Steady):
            return math.inf
        motion = self._motion.motion
        return motion.functions.quarter_period[0] / motion.rate[0] / self._motion.frequency

    @property
    def _horizon_s(self) -> float:
        """Time in which the common phase or the momentum in the body makes 2^50 turns or half periods."""
        if isinstance(self._motion, _Steady):
            turn_rate = self._motion.turn_rate[0]
        else:
            motion = self._motion.motion
            half_period_rate = 0.5 * motion.rate[0] / motion.functions.quarter_period[0]
            turn_rate = max(abs(motion.turn_rate[0]), half_period_rate)
        return _MOST_TURNS / turn_rate / self._motion.frequency if turn_rate else math.inf

    def at(self, t_s: ArrayLike) -> tuple[Array, Array]:
        """Return (quaternion (n, 4), omega_body (n, 3)) at the times t_s (n,), of either sign, in any order.

        The unit quaternions are scalar first, map body to world and are continuous in t; omega is along body
        axes, in rad/s.
        The attitude is within 4e-15 rad, and omega within 4e-15 of its size.

        Raises ValueError for another shape, NaN or infinite times, and times more than some 1e16 rad away,
        where 106 bits would no longer hold that.
        """
        t = np.asarray(t_s, dtype=np.float64, order="C")
        if t.ndim != 1:
            raise ValueError(f"t_s must have shape (n,), got {t.shape}")
        within = np.abs(t) < self._horizon_s
        if not within.all():
            first = t[~within][0]
            limit = f"within {self._horizon_s:.1e} s" if math.isfinite(first) else "finite"
            raise ValueError(f"t_s must be {limit}, got {first}")
        quaternion, omega = np.empty((len(t), 4)), np.empty((len(t), 3))
        if isinstance(self._motion, _Steady):
            _steady_at(self._motion, t, quaternion, omega)
        else:
            _tumbling_at(self._motion, t, quaternion, omega)
        return quaternion, omega


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.array(value, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array.tolist()}")
    return array


def _symmetric(name: str, tensor: Array) -> Array:
    if (tensor == tensor.T).all():
        return tensor
    if np.abs(tensor - tensor.T).max() > _SYMMETRY_TOLERANCE * np.abs(tensor).max():
        raise ValueError(f"{name} must be symmetric, got {tensor.tolist()}")
    return 0.5 * tensor + 0.5 * tensor.T


def _ordinary_size(quaternion: Array) -> Quat:
    """Scale the quaternion by a power of two."""
    exponent = math.frexp(np.abs(quaternion).max())[1]
    w, x, y, z = np.ldexp(quaternion, -exponent).tolist()
    return w, x, y, z
