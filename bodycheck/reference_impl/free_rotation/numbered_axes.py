"""The principal axes numbered so that the third carries the momentum whose sign never changes."""

from __future__ import annotations

from typing import NamedTuple

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.free_rotation.principal_axes import Frame, Triple
from bodycheck.reference_impl.jit import exact_kernel, inlined_kernel
from bodycheck.reference_impl.registers import Mat


class Separation(NamedTuple):
    """d1 D2 d3 = +-size 2^exponent, exponent even; D2 = G^2 - 2E I2 is 0 on the separatrix.

    size is known to 2^-100 of itself, and exactly zero where that is true.
    """

    descending: bool
    """Whether D2 < 0: the axes are then numbered by descending moments."""
    size: DoubleDouble
    exponent: int


class NumberedAxes(NamedTuple):
    """The principal axes, and what is known along them."""

    moments: Triple
    gaps: Triple
    """|I2 - I1|, |I3 - I1|, |I3 - I2|."""
    momentum: Triple
    """L along them; the first not negative, the third positive."""
    columns: Mat
    """Their directions in body axes, as columns of a proper matrix."""
    side: float
    """s: +1 where the moments ascend, -1 where they descend."""


@inlined_kernel
def _gap(frame: Frame, i: int, j: int) -> DoubleDouble:
    """I_j - I_i."""
    gap = frame.gaps[i + j - 1]
    return gap if i < j else (-gap[0], -gap[1])


@exact_kernel
def _order(frame: Frame, descending: bool) -> tuple[int, int, int]:
    """The axes by their moments, equal ones as they are."""
    sign = -1.0 if descending else 1.0
    a, b, c = 0, 1, 2
    if sign * _gap(frame, a, b)[0] < 0.0:
        a, b = b, a
    if sign * _gap(frame, b, c)[0] < 0.0:
        b, c = c, b
    if sign * _gap(frame, a, b)[0] < 0.0:
        a, b = b, a
    return a, b, c


@inlined_kernel
def _signed(x: DoubleDouble, sign: float) -> DoubleDouble:
    return sign * x[0], sign * x[1]


@exact_kernel
def numbered(frame: Frame, descending: bool) -> NumberedAxes:
    """Number the axes by ascending or descending moments, and turn them by half turns."""
    a, b, c = _order(frame, descending)
    l1 = dd.multiply(frame.moments[a], frame.omega[a])
    l2 = dd.multiply(frame.moments[b], frame.omega[b])
    l3 = dd.multiply(frame.moments[c], frame.omega[c])
    sign1, sign3 = -1.0 if l1[0] < 0.0 else 1.0, -1.0 if l3[0] < 0.0 else 1.0
    parity = 1.0 if (b - a) % 3 == 1 else -1.0
    sign2 = parity * sign1 * sign3
    x, y, z = frame.axes[a], frame.axes[b], frame.axes[c]
    sign = -1.0 if descending else 1.0
    return NumberedAxes(
        (frame.moments[a], frame.moments[b], frame.moments[c]),
        (
            _signed(_gap(frame, a, b), sign),
            _signed(_gap(frame, a, c), sign),
            _signed(_gap(frame, b, c), sign),
        ),
        (_signed(l1, sign1), _signed(l2, sign2), _signed(l3, sign3)),
        (
            sign1 * x[0],
            sign2 * y[0],
            sign3 * z[0],
            sign1 * x[1],
            sign2 * y[1],
            sign3 * z[1],
            sign1 * x[2],
            sign2 * y[2],
            sign3 * z[2],
        ),
        sign,
    )
