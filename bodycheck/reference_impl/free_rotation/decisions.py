"""What kind of motion a state begins, decided in floating point where its error bounds leave no doubt.

Positive definite or not, steady or not, on which side of the separatrix and how far from it: where these
bounds do leave a doubt, exact integers decide (`exact_integers`), as predicates of computational geometry
do. Source: Shewchuk 1997, Adaptive precision floating-point arithmetic, Discrete Comput. Geom. 18, 305.
"""

from __future__ import annotations

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.free_rotation.numbered_axes import NumberedAxes, Separation
from bodycheck.reference_impl.jit import exact_kernel

# Moments, gaps and omega, all of ordinary size, err by less than 2^-125.
_CERTAINLY_NOT_ZERO = 2.0**-100
_LEAST_SHARE = 0.25  # what is left of a difference, at the least, for its error to stay some 2^-100 of it
_LEAST_PRODUCT = 2.0**-900  # above which the low parts of products keep their bits


@exact_kernel
def is_certainly_tumbling(ascending: NumberedAxes) -> bool:
    """Whether the inertia is surely positive definite, and L x omega surely not zero."""
    (i1, _, i3), (l1, l2, l3) = ascending.moments, ascending.momentum
    if not (i1[0] > _CERTAINLY_NOT_ZERO and i3[0] > 0.0):
        return False
    gap21, gap31, gap32 = ascending.gaps
    off = max(abs(gap21[0] * l1[0] * l2[0]), abs(gap31[0] * l1[0] * l3[0]), abs(gap32[0] * l2[0] * l3[0]))
    # |L| may be as small as I1, and twice it enters
    return off > _CERTAINLY_NOT_ZERO * i1[0] * i1[0]


@exact_kernel
def _weighted_square(momentum: DoubleDouble, gap: DoubleDouble, moment: DoubleDouble) -> DoubleDouble:
    """L^2 gap / moment."""
    return dd.divide(dd.multiply(dd.multiply(momentum, momentum), gap), moment)


@exact_kernel
def separation_of(ascending: NumberedAxes) -> tuple[bool, Separation]:
    """Whether d1 D2 d3 is surely as accurate as it has to be, and what it is.

    D2 = L3^2 (I3-I2)/I3 - L1^2 (I2-I1)/I1, which cancels beside the separatrix only.
    """
    (i1, i2, i3), (l1, l2, l3) = ascending.moments, ascending.momentum
    gap21, gap31, gap32 = ascending.gaps
    plus, minus = _weighted_square(l3, gap32, i3), _weighted_square(l1, gap21, i1)
    d1 = dd.add(_weighted_square(l2, gap21, i2), _weighted_square(l3, gap31, i3))
    d3 = dd.add(_weighted_square(l1, gap31, i1), _weighted_square(l2, gap32, i2))
    between = dd.subtract(plus, minus)
    descending = between[0] < 0.0
    size = dd.multiply(dd.multiply(d1, d3), (-between[0], -between[1]) if descending else between)
    sure = (
        abs(between[0]) >= _LEAST_SHARE * (plus[0] + minus[0])
        and min(d1[0], d3[0], plus[0] + minus[0]) > _LEAST_PRODUCT
        and size[0] > _LEAST_PRODUCT
    )
    return sure, Separation(descending, size, 0)
