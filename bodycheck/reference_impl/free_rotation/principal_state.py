"""The motion relative to the numbered principal axes: its constants, and its state at a given time.

The attitude follows from Cayley-Klein parameters, which are theta series.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np

from bodycheck.reference_impl import elliptic
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel
from bodycheck.reference_impl.kernels.small_vectors import Quat, Vec

Coefficients: TypeAlias = tuple[float, float, float, float]

_TWO_PI: DoubleDouble = (2.0 * dd.PI[0], 2.0 * dd.PI[1])


class CayleyKlein(NamedTuple):
    """Coefficients of the theta series of (alpha, beta), separately for real and imaginary parts."""

    alpha_real: Coefficients
    alpha_imag: Coefficients
    beta_real: Coefficients
    beta_imag: Coefficients
    twist: float
    """Turns of the common phase per unit of the reduced u; zero for trigonometric series."""


@exact_kernel
def _trigonometric_coefficients(nome: float, a: float, tilt: float, side: float) -> CayleyKlein:
    """Series of theta4 and theta1, nome q^2, at x - i s a, with |beta / alpha| = tilt at x = 0.

    q^2n^2 e^2na is written q^(2n^2 - n) g^n with g = q e^2a <= 1, so that nothing overflows as a grows.
    """
    decay = math.exp(-2.0 * a)
    g = nome / decay if decay > 0.0 else 0.0
    g3 = g * g * g
    q3 = nome * nome * nome
    q6 = q3 * q3
    # e^-2na - 1; the exponents of the sines and cosines are kept separate
    e1, e2, e3, e4 = math.expm1(-2.0 * a), math.expm1(-4.0 * a), math.expm1(-6.0 * a), math.expm1(-8.0 * a)
    e5, e6, e7 = math.expm1(-10.0 * a), math.expm1(-12.0 * a), math.expm1(-14.0 * a)
    even1, even2, even3 = -nome * g, q6 * g * g, -q6 * q6 * q3 * g3
    odd1, odd2, odd3 = -q3 * g, q6 * q3 * nome * g * g, -q6 * q6 * q6 * q3 * g3
    real1, real2, real3 = even1 * (2.0 + e2), even2 * (2.0 + e4), even3 * (2.0 + e6)
    imag0, imag1, imag2, imag3 = e1, odd1 * e3, odd2 * e5, odd3 * e7
    rho = -tilt * (1.0 + real1 + real2 + real3) / (imag0 + imag1 + imag2 + imag3)
    sided = side * rho
    return CayleyKlein(
        (1.0, real1, real2, real3),
        (0.0, -side * even1 * e2, -side * even2 * e4, -side * even3 * e6),
        (sided * (2.0 + e1), sided * odd1 * (2.0 + e3), sided * odd2 * (2.0 + e5), sided * odd3 * (2.0 + e7)),
        (rho * imag0, rho * imag1, rho * imag2, rho * imag3),
        0.0,
    )


@exact_kernel
def _exponential_coefficients(
    nome: float, gamma: float, tilt: float, side: float, twist: float
) -> CayleyKlein:
    """Series of theta2 and theta1, nome sqrt(q'), at gamma + i s y, with |beta / alpha| = tilt at y = 0."""
    c0, c1, c2, c3 = math.cos(gamma), math.cos(3.0 * gamma), math.cos(5.0 * gamma), math.cos(7.0 * gamma)
    s0, s1, s2, s3 = math.sin(gamma), math.sin(3.0 * gamma), math.sin(5.0 * gamma), math.sin(7.0 * gamma)
    q3 = nome * nome * nome
    q6 = q3 * q3
    rho = tilt * (c0 + nome * c1 + q3 * c2 + q6 * c3) / (s0 - nome * s1 + q3 * s2 - q6 * s3)
    sided = side * rho
    return CayleyKlein(
        (c0, c1, c2, c3),
        (-side * s0, -side * s1, -side * s2, -side * s3),
        (sided * c0, -sided * c1, sided * c2, -sided * c3),
        (-rho * s0, rho * s1, -rho * s2, rho * s3),
        twist,
    )


@exact_kernel
def coefficients(functions: elliptic.Quotients, a: float, tilt: float, side: float) -> CayleyKlein:
    """Return the coefficients of (alpha, beta): beta = 0 at u = i s a, |beta| = tilt |alpha| at u = 0.

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
def _dot(a: Coefficients, b: Coefficients) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]


@exact_kernel
def trigonometric_sums(s: CayleyKlein, sin_x: float, cos_x: float) -> Quat:
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


@exact_kernel
def exponential_sums(s: CayleyKlein, nome: float, sign: float, decay: float, rise: float) -> Quat:
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


class TumblingConstants(NamedTuple):
    """Constants of the motion of the numbered principal axes relative to the frame of the momentum L."""

    functions: elliptic.Quotients
    start: DoubleDouble
    """u0."""
    rate: DoubleDouble
    """lambda, per time unit."""
    turn_rate: DoubleDouble
    """Omega / 4 pi: turns of the common phase per time unit."""
    series: CayleyKlein
    omega: Vec
    """Amplitudes (A1/I1, s A2/I2, A3/I3), in rad per time unit."""


@exact_kernel
def phase_sine_cosine(rate: DoubleDouble, t: DoubleDouble, extra: float) -> tuple[float, float]:
    """(sin, cos) of 2 pi (rate t + extra), with whole turns removed before rounding."""
    turns, rest = dd.two_product(rate[0], t[0])
    fraction, low = dd.two_sum(turns - np.rint(turns), rest + (rate[1] * t[0] + rate[0] * t[1]))
    fraction, lower = dd.two_sum(fraction - np.rint(fraction), extra)
    return elliptic.circular_argument((fraction, low + lower), _TWO_PI)


@exact_kernel
def state_at(motion: TumblingConstants, t: DoubleDouble) -> tuple[Quat, Vec]:
    """Return the quaternion (4,), of any norm, from the axes to the L frame, and omega (3,) along them."""
    f = motion.functions
    u = dd.add(dd.multiply(motion.rate, t), motion.start)
    u, sign = elliptic.reduce_by_half_periods(u, f.quarter_period)
    if f.trigonometric:
        sin_x, cos_x = elliptic.circular_argument(u, f.rate)
        sn, cn, dn = elliptic.circular_functions(f, sin_x, cos_x)
        alpha_re, alpha_im, beta_re, beta_im = trigonometric_sums(motion.series, sin_x, cos_x)
    else:
        u_sign = math.copysign(1.0, u[0])
        argument = elliptic.exponential_argument(u, f.rate, f.quarter_period)
        sn, cn, dn = elliptic.exponential_functions(f, u_sign, argument)
        alpha_re, alpha_im, beta_re, beta_im = exponential_sums(
            motion.series, f.nome, u_sign, argument[0], argument[2]
        )
    s, c = phase_sine_cosine(motion.turn_rate, t, motion.series.twist * u[0])
    return (
        (
            alpha_re * c - alpha_im * s,
            sign * (beta_re * c - beta_im * s),
            sign * (beta_re * s + beta_im * c),
            alpha_re * s + alpha_im * c,
        ),
        (motion.omega[0] * sign * cn, motion.omega[1] * sign * sn, motion.omega[2] * dn),
    )
