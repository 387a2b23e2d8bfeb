"""The Taylor coefficients of what springs do: forces along a line, and torques along a rotation vector."""

from __future__ import annotations

import math
from typing import Any

from bodycheck.reference_impl.arithmetic import (
    Numbers,
    Three,
    add_product,
    by_double,
    entry,
    exactly,
    high_part,
    minus,
    nothing,
    over,
    over_double,
    plus,
    put,
    root,
    settled,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.forcing import ANCHOR, AT, MASS_INVERSE, REST_LENGTH, STIFFNESS
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.taylor_terms import (
    Q,
    R,
    X,
    added,
    cauchy,
    put_vector,
    turned_back,
    vector_terms,
)

_D, _SQUARE, _INVERSE, _FORCE, SPRING_ROWS = 0, 3, 4, 5, 8
"""Rows of one spring: d = x + R at - anchor, |d|^2, 1 / |d|, the force."""

_HALVINGS = 4  # of the half angle: below pi / 2 at first, below pi / 32 then
_SERIES = 14  # terms of arcsin: 0.0024^14 < 2^-120 at pi, and beyond it the angle is refused
_P, _COSINE, _SMALL, _HORNER = 0, 4, 9, 10
_SHARE = _HORNER + _SERIES
_FACTOR = _SHARE + _HALVINGS
TORSION_ROWS = _FACTOR + 1
"""Rows of the torsion springs: p = q(0)^-1 q, the cosines of a = angle / 2, a/2, .. a/16, then see below."""


# -------------------------------------------------------------------------------------------- line springs


@kernel
def reciprocal_root(series: Numbers, square: int, row: int, k: int) -> None:
    """p = s^(-1/2), s p' = -p s' / 2: p_k = sum over j >= 1 of (j / 2 - k) s_j p_(k-j) / (k s_0)."""
    s = term(series, square, 0)
    if k == 0:
        put(series, row, 0, over(exactly(series, 1.0), root(s)))
        return
    total = nothing(series)
    for j in range(1, k + 1):
        total = add_product(
            total, by_double(term(series, square, j), 0.5 * j - k), term(series, row, k - j)
        )
    put(series, row, k, over(over_double(settled(total), float(k)), s))


@kernel
def stretch(series: Numbers, spring: Array, row: int, k: int) -> None:
    """d_k = (x + R at - anchor)_k and |d|^2_k."""
    for a in range(3):
        total = add_product(term(series, X + a, k), term(series, R + 3 * a, k), exactly(series, spring[AT]))
        total = add_product(total, term(series, R + 3 * a + 1, k), exactly(series, spring[AT + 1]))
        total = settled(
            add_product(total, term(series, R + 3 * a + 2, k), exactly(series, spring[AT + 2]))
        )
        if k == 0:
            total = minus(total, exactly(series, spring[ANCHOR + a]))
        put(series, row + _D + a, k, total)
    square = plus(cauchy(series, row, row, k), cauchy(series, row + 1, row + 1, k))
    put(series, row + _SQUARE, k, plus(square, cauchy(series, row + 2, row + 2, k)))


@kernel
def spring_force(series: Numbers, spring: Array, row: int, k: int) -> Three:
    """(-stiffness (d - rest_length d / |d|))_k in world axes; 0 while d = 0, NaN where it leaves 0."""
    stretch(series, spring, row, k)
    d = vector_terms(series, row + _D, k)
    high = high_part(series)
    if spring[REST_LENGTH] != 0.0 and high[row + _SQUARE, 0] > 0.0:
        reciprocal_root(series, row + _SQUARE, row + _INVERSE, k)
        for a in range(3):
            along = cauchy(series, row + _D + a, row + _INVERSE, k)
            kept = minus(d[a], by_double(along, spring[REST_LENGTH]))
            put(series, row + _FORCE + a, k, by_double(kept, -spring[STIFFNESS]))
        return vector_terms(series, row + _FORCE, k)
    for a in range(3):
        force = by_double(d[a], -spring[STIFFNESS])
        if spring[REST_LENGTH] != 0.0 and high[row + _D + a, k] != 0.0:
            force = by_double(force, math.nan)
        put(series, row + _FORCE + a, k, force)
    return vector_terms(series, row + _FORCE, k)


@kernel
def spring_torque(series: Numbers, spring: Array, row: int, k: int) -> Three:
    """(at x R^T force)_k in body axes."""
    x, y, z = turned_back(series, row + _FORCE, k)
    a, b, c = spring[AT], spring[AT + 1], spring[AT + 2]
    return (
        minus(by_double(z, b), by_double(y, c)),
        minus(by_double(x, c), by_double(z, a)),
        minus(by_double(y, a), by_double(x, b)),
    )


@kernel
def springs_share(
    series: Numbers, springs: Array, moving: Numbers, row: int, k: int
) -> tuple[Three, Three]:
    """(sum of the torques)_k in body axes and (sum of the forces / m)_k in world axes."""
    none = nothing(series)
    torque, force = (none, none, none), (none, none, none)
    for i in range(len(springs)):
        first = row + SPRING_ROWS * i
        force = added(force, spring_force(series, springs[i], first, k))
        torque = added(torque, spring_torque(series, springs[i], first, k))
    lightness = entry(moving, MASS_INVERSE)
    return torque, (times(force[0], lightness), times(force[1], lightness), times(force[2], lightness))


# ----------------------------------------------------------------------------------------- torsion springs


@kernel
def relative_quaternion(series: Numbers, torsion: Numbers, row: int, k: int) -> None:
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
    put(series, row, k, settled(p0))
    put_vector(series, row + 1, k, (settled(p1), settled(p2), settled(p3)))


@kernel
def half_angle_cosine(series: Numbers, row: int, k: int) -> None:
    """c = sqrt((1 + C) / 2), C in the row and c in the next: 2 c_0 c_k = C_k / 2 - the other products."""
    given = by_double(term(series, row, k), 0.5)
    if k == 0:
        put(series, row + 1, 0, root(plus(given, exactly(series, 0.5))))
        return
    total = given
    for n in range(1, k):
        total = subtract_product(total, term(series, row + 1, n), term(series, row + 1, k - n))
    put(series, row + 1, k, over(settled(total), by_double(term(series, row + 1, 0), 2.0)))


@kernel
def quotient(series: Numbers, above: int, below: int, row: int, k: int) -> None:
    """f = a / b: f_k = (a_k - sum over n >= 1 of b_n f_(k-n)) / b_0."""
    total = term(series, above, k)
    for n in range(1, k + 1):
        total = subtract_product(total, term(series, below, n), term(series, row, k - n))
    put(series, row, k, over(settled(total), term(series, below, 0)))


@kernel
def angle_over_sine(series: Numbers, row: int, k: int) -> None:
    """(a / sin a)_k of the half angle a from cos a: smooth at a = 0, without a switch.

    a / sin a = F(x) / (cos(a/2) cos(a/4) .. cos(a/16)), with the series of b / sin b at b = a/16,
    F = sum of x^j 2^2j j!^2 / (2j + 1)! in x = (1 - cos b) / 2 times 2, which is arcsin(y) / (y sqrt(1 - y^2))
    at y^2 = x (Abramowitz & Stegun 1964, 15.1.6), by Horner's rule: a row for each of its terms.
    """
    for halving in range(_HALVINGS):
        half_angle_cosine(series, row + _COSINE - 4 + 4 * (halving == 0) + halving, k)
    put(series, row, k, nothing(series))
