"""The motion relative to the numbered principal axes: its constants, and its state at a given time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bodycheck.reference_impl import elliptic
from bodycheck.reference_impl.free_rotation.theta_series import (
    CayleyKlein,
    exponential_sums,
    trigonometric_sums,
)
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel
from bodycheck.reference_impl.kernels.small_vectors import Quat, Vec

_TWO_PI: DoubleDouble = (2.0 * dd.PI[0], 2.0 * dd.PI[1])


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
