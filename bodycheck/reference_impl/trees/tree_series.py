"""The Taylor coefficients of the motion of a tree, from its recorded equations.

series[r, k] is the k-th coefficient of row r. At each order the rows are evaluated as if the derivatives of
the rates, the unknowns, were 0; the forces that are then missing at the joints give the unknowns, by one
mass matrix a step; and the rows that higher orders need are corrected. Both precisions run the same source.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    add_product,
    by_double,
    entry,
    exactly,
    high_part,
    nothing,
    over,
    over_double,
    phase,
    plus,
    put,
    renorm,
    root,
    sine_and_cosine,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import borrowing_inline, unspecialised_borrowing_kernel
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.quadratic_forms import Row

Integers: TypeAlias = NDArray[np.int64]

_INPUT, _AHEAD, _INTEGRAL, _LATE, _DERIVATIVE = (
    int(row) for row in (Row.INPUT, Row.AHEAD, Row.INTEGRAL, Row.LATE, Row.DERIVATIVE)
)
_AXIS, _BALL = int(Rotation.AXIS), int(Rotation.BALL)


@borrowing_inline
def product(series: Numbers, i: int, j: int, k: int) -> Any:
    """(a b)_k = sum of a_n b_(k-n), a and b in the rows i and j."""
    total = nothing(series)
    for n in range(k + 1):
        total = add_product(total, term(series, i, n), term(series, j, k - n))
    return renorm(total)


@unspecialised_borrowing_kernel
def evaluate(
    rows: Integers,
    terms: Integers,
    constants: Numbers,
    series: Numbers,
    first: int,
    last: int,
    k: int,
    late: bool,
) -> None:
    """Set the rows from first to last - 1 at order k, or k + 1; late: only these, otherwise all others.

    k = -1 sets order 0 of the rows ahead.
    """
    for i in range(first, last):
        kind = rows[i, 0]
        if kind == _INPUT or (kind == _LATE) != late or (k < 0 and kind != _AHEAD):
            continue
        read = k + 1 if kind in (_AHEAD, _DERIVATIVE) else k
        total = nothing(series)
        for t in range(rows[i, 1], rows[i, 2]):
            a, b = terms[t, 0], terms[t, 1]
            value = term(series, a, read) if b < 0 else product(series, a, b, read)
            total = add_product(total, entry(constants, t), value)
        total = renorm(total)
        if kind == _DERIVATIVE:
            put(series, i, k, by_double(total, k + 1.0))
        elif kind in (_INTEGRAL, _LATE):
            put(series, i, k + 1, over_double(total, k + 1.0))
        else:
            put(series, i, read, total)


# ------------------------------------------------------------------------------ the unknowns of an order


@unspecialised_borrowing_kernel
def put_gains(others: Integers, constants: Numbers, series: Numbers, gains: Numbers) -> None:
    """Set the factors of the response at the constant terms, gains (terms, 1)."""
    for t in range(len(others)):
        gain = entry(constants, t)
        put(gains, t, 0, gain if others[t] < 0 else times(gain, term(series, others[t], 0)))


@unspecialised_borrowing_kernel
def _changed(ends: Integers, sources: Integers, gains: Numbers, change: Numbers, place: int) -> Any:
    """The change of one responding row, from those of its sources."""
    total = nothing(change)
    for t in range(ends[place], ends[place + 1]):
        total = add_product(total, term(gains, t, 0), term(change, sources[t], 0))
    return renorm(total)


@unspecialised_borrowing_kernel
def put_mass_matrix(
    responding: Integers,
    ends: Integers,
    sources: Integers,
    columns: Integers,
    column_ends: Integers,
    unknowns: Integers,
    results: Integers,
    gains: Numbers,
    change: Numbers,
    mass: Numbers,
) -> None:
    """Set mass (unknowns, unknowns) to what unit unknowns change in the results; change (rows, 1) is 0."""
    for j in range(len(unknowns)):
        put(change, unknowns[j], 0, exactly(change, 1.0))
        for c in range(column_ends[j], column_ends[j + 1]):
            place = columns[c]
            put(change, responding[place], 0, _changed(ends, sources, gains, change, place))
        for i in range(len(results)):
            put(mass, i, j, term(change, results[i], 0))
        put(change, unknowns[j], 0, nothing(change))
        for c in range(column_ends[j], column_ends[j + 1]):
            put(change, responding[columns[c]], 0, nothing(change))


@unspecialised_borrowing_kernel
def factor(mass: Numbers, rates: int) -> float:
    """Replace M by L below and D on its diagonal, M = L D L^T; return max M_ii / d_i, inf if not positive."""
    ratio = 1.0
    for j in range(rates):
        own = high_part(term(mass, j, j))
        for i in range(j, rates):
            total = term(mass, i, j)
            for n in range(j):
                scaled = times(term(mass, i, n), term(mass, n, n))
                total = subtract_product(total, scaled, term(mass, j, n))
            total = renorm(total)
            put(mass, i, j, total if i == j else over(total, term(mass, j, j)))
        pivot = high_part(term(mass, j, j))
        ratio = max(ratio, own / pivot) if pivot > 0.0 else math.inf
    return ratio


@unspecialised_borrowing_kernel
def solve(factors: Numbers, x: Numbers, rates: int) -> None:
    """Replace x (rates, 1) by M^-1 x, given the factors of M."""
    for i in range(rates):
        total = term(x, i, 0)
        for n in range(i):
            total = subtract_product(total, term(factors, i, n), term(x, n, 0))
        put(x, i, 0, renorm(total))
    for i in range(rates):
        put(x, i, 0, over(term(x, i, 0), term(factors, i, i)))
    for i in range(rates - 1, -1, -1):
        total = term(x, i, 0)
        for n in range(i + 1, rates):
            total = subtract_product(total, term(factors, n, i), term(x, n, 0))
        put(x, i, 0, renorm(total))


@unspecialised_borrowing_kernel
def correct(
    rows: Integers,
    responding: Integers,
    ends: Integers,
    sources: Integers,
    kept: Integers,
    unknowns: Integers,
    ahead: Integers,
    gains: Numbers,
    change: Numbers,
    x: Numbers,
    series: Numbers,
    k: int,
) -> None:
    """Set the unknowns of order k to x (rates, 1), and correct the rows of higher orders."""
    share = over_double(exactly(series, 1.0), k + 1.0)
    for j in range(len(unknowns)):
        put(change, unknowns[j], 0, term(x, j, 0))
        if ahead[j]:
            put(series, unknowns[j], k + 1, times(share, term(x, j, 0)))
        else:
            put(series, unknowns[j], k, term(x, j, 0))
    for place in kept:
        row = responding[place]
        own = _changed(ends, sources, gains, change, place)
        put(change, row, 0, own)
        if rows[row, 0] == _AHEAD:
            put(series, row, k + 1, plus(term(series, row, k + 1), times(share, own)))
        else:
            put(series, row, k, plus(term(series, row, k), own))


# --------------------------------------------------------------------------------------- states and steps


@unspecialised_borrowing_kernel
def put_state(
    joints: Integers, sines: Array, sine_rows: Integers, q: Numbers, u: Numbers, t: float, series: Numbers
) -> None:
    """Set the constant terms of the inputs from q (coordinates, 1), with quaternions of any norm, u and t.

    joints (n, 3): translation's coordinates, rotation, and the first row of each joint.
    """
    put(series, 0, 0, exactly(series, 1.0))
    place = rate = 0
    for i in range(len(joints)):
        moved, rotation, row = joints[i, 0], joints[i, 1], joints[i, 2]
        for _ in range(moved):
            put(series, row, 0, term(q, place, 0))
            row, place = row + 1, place + 1
        spins = 0
        if rotation == _AXIS:
            angle = term(q, place, 0)
            sine, cosine = sine_and_cosine(angle)
            put(series, row, 0, angle)
            put(series, row + 1, 0, cosine)
            put(series, row + 2, 0, sine)
            sine, cosine = sine_and_cosine(by_double(angle, 0.5))
            put(series, row + 3, 0, cosine)
            put(series, row + 4, 0, sine)
            row, place, spins = row + 5, place + 1, 1
        elif rotation == _BALL:
            for j in range(4):
                put(series, row + j, 0, term(q, place + j, 0))
            normalise(series, row, 4)
            row, place, spins = row + 4, place + 4, 3
        for _ in range(moved + spins):
            put(series, row, 0, term(u, rate, 0))
            row, rate = row + 1, rate + 1
    for j in range(len(sines)):
        sine, cosine = sine_and_cosine(phase(exactly(series, sines[j, 0]), t, sines[j, 1]))
        put(series, sine_rows[j], 0, sine)
        put(series, sine_rows[j] + 1, 0, cosine)


@unspecialised_borrowing_kernel
def normalise(series: Numbers, row: int, count: int) -> None:
    """Divide the constant terms of some rows by their norm."""
    square = nothing(series)
    for j in range(count):
        square = add_product(square, term(series, row + j, 0), term(series, row + j, 0))
    norm = root(renorm(square))
    for j in range(count):
        put(series, row + j, 0, over(term(series, row + j, 0), norm))
