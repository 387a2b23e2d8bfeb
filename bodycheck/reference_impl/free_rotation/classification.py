"""Classify the motion from a state: in floating point with error bounds, else in exact integers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation.tumbling_constants import NumberedAxes, Separation
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel

_NEGLIGIBLE_BITS = 960  # as in initial_constants.py
_MAX_BITS = 120  # of an integer before it is rounded to a double-double


class ExactState(NamedTuple):
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
        """Whether all leading principal minors of the inertia are positive (Sylvester)."""
        a, b, _, d, _, _ = self.inertia
        return a > 0 and a * d > b * b and _determinant(self.inertia) > 0

    @property
    def is_steady(self) -> bool:
        """Whether L x omega = 0: omega is along a principal axis, or zero."""
        (x, y, z), (lx, ly, lz) = self.omega, self.momentum
        return ly * z == lz * y and lz * x == lx * z and lx * y == ly * x

    @property
    def separation(self) -> Separation:
        """det(2E I - G^2) = d1 D2 d3."""
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
        determinant = _determinant(shifted)
        size, exponent = _even_exponent(abs(determinant), -6 * (self.inertia_bits + self.omega_bits))
        return Separation(determinant < 0, size, exponent)

    @classmethod
    def of(cls, inertia: Array, omega: Array, rest: Array) -> ExactState:
        """Convert a symmetric inertia (9,) and omega + rest, (3,) each."""
        xx, xy, xz, _, yy, yz, _, _, zz = inertia.tolist()
        components, bits = _integers([Fraction(x) + Fraction(y) for x, y in zip(omega, rest, strict=True)])
        significant = [n if n.bit_length() > bits - _NEGLIGIBLE_BITS else 0 for n in components]
        return cls(*_integers([xx, xy, xz, yy, yz, zz]), significant, bits)


def _integers(values: Sequence[float | Fraction]) -> tuple[list[int], int]:
    """Return (n, bits) with values proportional to n 2^-bits, the largest |n| in [2^bits, 2^(bits + 1))."""
    ratios = [value.as_integer_ratio() for value in values]
    common = max(denominator for _, denominator in ratios)
    integers = [numerator * (common // denominator) for numerator, denominator in ratios]
    return integers, max(map(abs, integers)).bit_length() - 1


def _determinant(m: list[int]) -> int:
    """Return the determinant of the symmetric matrix (xx, xy, xz, yy, yz, zz)."""
    a, b, c, d, e, f = m
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


def _double_double(n: int, exponent: int) -> DoubleDouble:
    """Round n 2^exponent to a relative 2^-106."""
    shift = n.bit_length() - _MAX_BITS
    if shift > 0:
        n, exponent = n >> shift, exponent + shift
    high = float(n)
    return math.ldexp(high, exponent), math.ldexp(float(n - int(high)), exponent)


def _even_exponent(n: int, exponent: int) -> tuple[DoubleDouble, int]:
    """Return (x, e), e even, with n 2^exponent = x 2^e to 2^-106 and x zero or in [1/4, 1)."""
    bits = n.bit_length()
    bits += (bits + exponent) % 2
    return _double_double(n, -bits), exponent + bits


# Moments, gaps and omega are scaled to about 1; their errors are below 2^-125.
_CERTAINLY_NOT_ZERO = 2.0**-100
_MIN_SHARE = 0.25  # of its terms: the least difference whose relative error stays some 2^-100
_RESOLVED_SHARE = 2.0**-60  # of its terms: the least difference whose relative error stays some 2^-40
_MIN_PRODUCT = 2.0**-900  # above it, the low parts of products keep their bits


@exact_kernel
def is_certainly_tumbling(ascending: NumberedAxes) -> bool:
    """Return whether the inertia is certainly positive definite and L x omega certainly not zero."""
    (i1, _, i3), (l1, l2, l3) = ascending.moments, ascending.momentum
    if not (i1[0] > _CERTAINLY_NOT_ZERO and i3[0] > 0.0):
        return False
    gap21, gap31, gap32 = ascending.gaps
    off = max(abs(gap21[0] * l1[0] * l2[0]), abs(gap31[0] * l1[0] * l3[0]), abs(gap32[0] * l2[0] * l3[0]))
    # |L| may be as small as I1 and enters twice
    return off > _CERTAINLY_NOT_ZERO * i1[0] * i1[0]


@exact_kernel
def _weighted_square(momentum: DoubleDouble, gap: DoubleDouble, moment: DoubleDouble) -> DoubleDouble:
    """L^2 gap / moment."""
    return dd.divide(dd.multiply(dd.multiply(momentum, momentum), gap), moment)


@exact_kernel
def separation_of(ascending: NumberedAxes) -> tuple[bool, Separation]:
    """Return whether d1 D2 d3 is certainly accurate enough, and its value.

    D2 = L3^2 (I3-I2)/I3 - L1^2 (I2-I1)/I1 cancels only near the separatrix.
    """
    (i1, i2, i3), (l1, l2, l3) = ascending.moments, ascending.momentum
    gap21, gap31, gap32 = ascending.gaps
    plus, minus = _weighted_square(l3, gap32, i3), _weighted_square(l1, gap21, i1)
    d1 = dd.add(_weighted_square(l2, gap21, i2), _weighted_square(l3, gap31, i3))
    d3 = dd.add(_weighted_square(l1, gap31, i1), _weighted_square(l2, gap32, i2))
    between = dd.subtract(plus, minus)
    descending = between[0] < 0.0
    size = dd.multiply(dd.multiply(d1, d3), (-between[0], -between[1]) if descending else between)
    certain = (
        abs(between[0]) >= _MIN_SHARE * (plus[0] + minus[0])
        and min(d1[0], d3[0], plus[0] + minus[0]) > _MIN_PRODUCT
        and size[0] > _MIN_PRODUCT
    )
    return certain, Separation(descending, size, 0)


@exact_kernel
def is_resolved(ascending: NumberedAxes) -> bool:
    """Return whether `separation_of` has a relative error of at most 2^-40."""
    (i1, _, i3), (l1, _, l3) = ascending.moments, ascending.momentum
    gap21, _, gap32 = ascending.gaps
    plus, minus = _weighted_square(l3, gap32, i3), _weighted_square(l1, gap21, i1)
    total = plus[0] + minus[0]
    return total > _MIN_PRODUCT and abs(dd.subtract(plus, minus)[0]) >= _RESOLVED_SHARE * total
