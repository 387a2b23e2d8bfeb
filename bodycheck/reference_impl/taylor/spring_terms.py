"""The Taylor coefficients of springs: forces along a line, and torques along a rotation vector."""

from __future__ import annotations

import math
from typing import Any

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    Three,
    add_product,
    by_double,
    entry,
    exactly,
    high_part,
    like,
    minus,
    nothing,
    over,
    over_double,
    plus,
    put,
    renorm,
    root,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import inlined_kernel, kernel
from bodycheck.reference_impl.taylor.forcing import ANCHOR, AT, LOW, MASS_INVERSE, REST_LENGTH, STIFFNESS
from bodycheck.reference_impl.taylor.taylor_terms import (
    Q,
    R,
    X,
    added,
    cauchy,
    put_vector,
    quotient,
    rotated_to_body,
    vector_terms,
)

_D, _SQUARE, _INVERSE, _FORCE, SPRING_ROWS = 0, 3, 4, 5, 8
"""Rows of one spring: d = x + R at - anchor, |d|^2, 1 / |d|, the force."""

_PLACES, _NEWTONS = 8, 4  # samples of a spring within a step, then Newton iterations
_NEAR = 1e-6

_HALVINGS = 4  # of the half angle a: from below pi / 2 to below pi / 32
_NESTED = 13  # factors of the series in sin^2(a/32) < 0.0025: the truncation error is below 2^-112
_P, _COSINE, _SMALL, _NEST = 0, 4, 8, 9
_PRODUCT = _NEST + _NESTED
_FACTOR = _PRODUCT + _HALVINGS - 1
TORSION_ROWS = _FACTOR + 1
"""Rows of the torsion springs: p = q(0)^-1 q = (cos a, sin a e), the cosines of a/2 .. a/16, sin^2(a/32), the
nested series, the products of the cosines, a / sin a."""


# -------------------------------------------------------------------------------------------- line springs


@kernel
def _reciprocal_root(series: Numbers, square: int, row: int, k: int) -> None:
    """p = s^(-1/2), s p' = -p s' / 2: p_k = sum over j >= 1 of (j / 2 - k) s_j p_(k-j) / (k s_0)."""
    s = term(series, square, 0)
    if k == 0:
        put(series, row, 0, over(exactly(series, 1.0), root(s)))
        return
    total = nothing(series)
    for j in range(1, k + 1):
        total = add_product(total, by_double(term(series, square, j), 0.5 * j - k), term(series, row, k - j))
    put(series, row, k, over(over_double(renorm(total), float(k)), s))


@inlined_kernel
def _place(series: Numbers, spring: Array, i: int) -> Any:
    """Return one component of anchor or at, in the precision of the series."""
    return like(nothing(series), (spring[i], spring[LOW + i]))


@kernel
def _stretch(series: Numbers, spring: Array, row: int, k: int) -> None:
    """d_k = (x + R at - anchor)_k and |d|^2_k."""
    for a in range(3):
        total = add_product(term(series, X + a, k), term(series, R + 3 * a, k), _place(series, spring, AT))
        total = add_product(total, term(series, R + 3 * a + 1, k), _place(series, spring, AT + 1))
        total = renorm(add_product(total, term(series, R + 3 * a + 2, k), _place(series, spring, AT + 2)))
        if k == 0:
            total = minus(total, _place(series, spring, ANCHOR + a))
        put(series, row + _D + a, k, total)
    square = plus(cauchy(series, row, row, k), cauchy(series, row + 1, row + 1, k))
    put(series, row + _SQUARE, k, plus(square, cauchy(series, row + 2, row + 2, k)))


@kernel
def _spring_force(series: Numbers, spring: Array, row: int, k: int) -> Three:
    """(-stiffness (d - rest_length d / |d|))_k in world axes; 0 while d = 0, NaN when d leaves 0."""
    _stretch(series, spring, row, k)
    d = vector_terms(series, row + _D, k)
    high = high_part(series)
    if spring[REST_LENGTH] != 0.0 and high[row + _SQUARE, 0] > 0.0:
        _reciprocal_root(series, row + _SQUARE, row + _INVERSE, k)
        for a in range(3):
            along = cauchy(series, row + _D + a, row + _INVERSE, k)
            scaled_arm = minus(d[a], by_double(along, spring[REST_LENGTH]))
            put(series, row + _FORCE + a, k, by_double(scaled_arm, -spring[STIFFNESS]))
        return vector_terms(series, row + _FORCE, k)
    for a in range(3):
        force = by_double(d[a], -spring[STIFFNESS])
        if spring[REST_LENGTH] != 0.0 and high[row + _D + a, k] != 0.0:
            force = by_double(force, math.nan)
        put(series, row + _FORCE + a, k, force)
    return vector_terms(series, row + _FORCE, k)


@kernel
def _spring_torque(series: Numbers, spring: Array, row: int, k: int) -> Three:
    """(at x R^T force)_k in body axes."""
    x, y, z = rotated_to_body(series, row + _FORCE, k)
    a, b, c = _place(series, spring, AT), _place(series, spring, AT + 1), _place(series, spring, AT + 2)
    return (
        minus(times(z, b), times(y, c)),
        minus(times(x, c), times(z, a)),
        minus(times(y, a), times(x, b)),
    )


@kernel
def _min_along(high: Array, first: int, rows: int, h: float) -> float:
    """The minimum of d(0) . d(s) over s in [0, h], for d in the rows starting at first.

    Newton's method on the derivative, started from the least of a few samples, finds an interior minimum.
    """
    order = high.shape[1] - 2  # the motion does not need the last coefficient of d, which is not computed
    place, smallest = h, math.inf
    for i in range(1, _PLACES + 1):
        value = _along(high, first, rows, order, h * i / _PLACES)[0]
        if value < smallest:
            place, smallest = h * i / _PLACES, value
    for _ in range(_NEWTONS):
        _, slope, bend = _along(high, first, rows, order, place)
        if not bend > 0.0:
            break
        place = min(max(place - slope / bend, 0.0), h)
        smallest = min(smallest, _along(high, first, rows, order, place)[0])
    return smallest


@kernel
def _along(high: Array, first: int, rows: int, order: int, s: float) -> tuple[float, float, float]:
    """d(0) . d(s) and its first two derivatives, by Horner's rule."""
    value = slope = bend = 0.0
    for k in range(order, -1, -1):
        term = 0.0
        for a in range(rows):
            term += high[first + a, 0] * high[first + a, k]
        bend = bend * s + 2.0 * slope
        slope = slope * s + value
        value = value * s + term
    return value, slope, bend


@kernel
def passes_anchor(high: Array, springs: Array, row: int, h: float) -> bool:
    """Whether a spring that has a rest length rotates by a right angle within the step h.

    On a path that passes the anchor at a distance, steps are short relative to that distance. Only a path
    through the anchor, where the force jumps, reverses the direction within a step. high: the series; doubles
    suffice.
    """
    for i in range(len(springs)):
        first = row + SPRING_ROWS * i + _D
        jumps = springs[i, REST_LENGTH] != 0.0 and high[row + SPRING_ROWS * i + _SQUARE, 0] > 0.0
        if jumps and not _min_along(high, first, 3, h) > 0.0:
            return True
    return False


@kernel
def passes_half_turn(high: Array, row: int, h: float) -> bool:
    """Whether the cosine of half the torsion angle, positive at first, vanishes within the step h."""
    return not _min_along(high, row + _P, 1, h) > 0.0


@kernel
def is_at_anchor(high: Array, springs: Array, row: int) -> bool:
    """Whether the length of a spring is negligible relative to its rest length."""
    for i in range(len(springs)):
        if math.sqrt(high[row + SPRING_ROWS * i + _SQUARE, 0]) < _NEAR * springs[i, REST_LENGTH]:
            return True
    return False


@kernel
def springs_share(
    series: Numbers, springs: Array, translational: Numbers, row: int, k: int
) -> tuple[Three, Three]:
    """(sum of the torques)_k in body axes and (sum of the forces / m)_k in world axes."""
    none = nothing(series)
    torque, force = (none, none, none), (none, none, none)
    for i in range(len(springs)):
        first = row + SPRING_ROWS * i
        force = added(force, _spring_force(series, springs[i], first, k))
        torque = added(torque, _spring_torque(series, springs[i], first, k))
    lightness = entry(translational, MASS_INVERSE)
    return torque, (times(force[0], lightness), times(force[1], lightness), times(force[2], lightness))


# ----------------------------------------------------------------------------------------- torsion springs


@kernel
def _relative_quaternion(series: Numbers, torsion: Numbers, row: int, k: int) -> None:
    """p_k = (q(0)^-1 q)_k, whose vector part lies along the rotation vector, in body axes."""
    w, x, y, z = entry(torsion, 1), entry(torsion, 2), entry(torsion, 3), entry(torsion, 4)
    a, b = term(series, Q, k), term(series, Q + 1, k)
    c, d = term(series, Q + 2, k), term(series, Q + 3, k)
    total = nothing(series)
    p0 = add_product(add_product(add_product(add_product(total, w, a), x, b), y, c), z, d)
    p1 = subtract_product(add_product(total, w, b), x, a)
    p1 = subtract_product(add_product(p1, z, c), y, d)
    p2 = subtract_product(add_product(total, w, c), y, a)
    p2 = subtract_product(add_product(p2, x, d), z, b)
    p3 = subtract_product(add_product(total, w, d), z, a)
    p3 = subtract_product(add_product(p3, y, b), x, c)
    put(series, row, k, renorm(p0))
    put_vector(series, row + 1, k, (renorm(p1), renorm(p2), renorm(p3)))


@kernel
def _half_angle_cosine(series: Numbers, full: int, half: int, k: int) -> None:
    """c^2 = (1 + C) / 2, C and c in two rows: 2 c_0 c_k = C_k / 2 - the other products."""
    total = by_double(term(series, full, k), 0.5)
    if k == 0:
        put(series, half, 0, root(plus(total, exactly(series, 0.5))))
        return
    for n in range(1, k):
        total = subtract_product(total, term(series, half, n), term(series, half, k - n))
    put(series, half, k, over(renorm(total), by_double(term(series, half, 0), 2.0)))


@kernel
def _nested_series(series: Numbers, row: int, k: int) -> None:
    """(b / sin b)_k = 1 + 2/3 x (1 + 4/5 x (1 + 6/7 x ..)), x = sin^2(b/2) = (1 - cos b) / 2, b = a/16.

    The inner brackets are computed first. Source: Abramowitz & Stegun (1964), 15.1.6.
    """
    one = exactly(series, 1.0 if k == 0 else 0.0)
    put(series, row + _SMALL, k, by_double(minus(one, term(series, row + _COSINE + _HALVINGS - 1, k)), 0.5))
    put(series, row + _NEST + _NESTED - 1, k, one)
    for j in range(_NESTED - 2, -1, -1):
        inner = by_double(cauchy(series, row + _SMALL, row + _NEST + j + 1, k), 2.0 * j + 2.0)
        put(series, row + _NEST + j, k, plus(one, over_double(inner, 2.0 * j + 3.0)))


@kernel
def _angle_over_sine(series: Numbers, row: int, k: int) -> None:
    """(a / sin a)_k = (b / sin b) / (cos a/2 cos a/4 cos a/8 cos a/16), b = a/16: smooth at a = 0."""
    _half_angle_cosine(series, row + _P, row + _COSINE, k)
    for i in range(1, _HALVINGS):
        _half_angle_cosine(series, row + _COSINE + i - 1, row + _COSINE + i, k)
    _nested_series(series, row, k)
    product = row + _COSINE
    for i in range(1, _HALVINGS):
        put(series, row + _PRODUCT + i - 1, k, cauchy(series, product, row + _COSINE + i, k))
        product = row + _PRODUCT + i - 1
    put(series, row + _FACTOR, k, quotient(series, row + _NEST, product, row + _FACTOR, k))


@kernel
def torsion_torque(series: Numbers, torsion: Numbers, row: int, k: int) -> Three:
    """(-stiffness 2 a / sin a p)_k in body axes, p the vector part of q(0)^-1 q; NaN from an angle of pi."""
    _relative_quaternion(series, torsion, row + _P, k)
    high = high_part(series)
    if high[row, 0] <= 0.0:
        broken = exactly(series, math.nan)
        return broken, broken, broken
    _angle_over_sine(series, row, k)
    factor = by_double(entry(torsion, 0), -2.0)
    return (
        times(factor, cauchy(series, row + _FACTOR, row + _P + 1, k)),
        times(factor, cauchy(series, row + _FACTOR, row + _P + 2, k)),
        times(factor, cauchy(series, row + _FACTOR, row + _P + 3, k)),
    )
