"""The Taylor coefficients of loads that are recorded as operations.

Source: Griewank and Walther (2008), Evaluating derivatives, table 13.2.
"""

from __future__ import annotations

from typing import Any

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    Three,
    add_product,
    by_double,
    entry,
    exactly,
    like,
    minus,
    nothing,
    over,
    over_double,
    plus,
    put,
    renorm,
    root,
    sine_and_cosine,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import inlined_kernel, kernel
from bodycheck.reference_impl.loads.recorded_formula import (
    CONSTANT,
    COSINE,
    DIFFERENCE,
    OMEGA,
    OPERATIONS,
    PRODUCT,
    QUOTIENT,
    RESULTS,
    ROOT,
    ROTATION,
    SCALED,
    SHIFTED,
    SINE,
    SUM,
    TIME,
    VELOCITY,
)
from bodycheck.reference_impl.taylor.forcing import MASS_INVERSE
from bodycheck.reference_impl.taylor.taylor_terms import OMEGA as BODY_OMEGA
from bodycheck.reference_impl.taylor.taylor_terms import R, V, X, cauchy, quotient, vector_terms


@inlined_kernel
def start_time(series: Numbers, row: int, t: float) -> None:
    """Set the zeroth coefficient of the first operation to t."""
    put(series, row, 0, exactly(series, t))


@kernel
def recorded_share(
    series: Numbers, recorded: Array, translational: Numbers, row: int, k: int
) -> tuple[Three, Three]:
    """(sum of the torques)_k in body axes and (sum of the forces / m)_k in world axes."""
    count = len(recorded)
    for i in range(count):
        _operate(series, recorded[i], row, row + i, k)
    last = row + count - RESULTS
    force, lightness = vector_terms(series, last, k), entry(translational, MASS_INVERSE)
    push = (times(force[0], lightness), times(force[1], lightness), times(force[2], lightness))
    return vector_terms(series, last + 3, k), push


@kernel
def _series_row(operand: float, first: int) -> int:
    """Return the row of the series of an operand; those of the operations start at row first."""
    i = int(operand)
    if i >= OPERATIONS:
        return first + i - OPERATIONS
    if i >= OMEGA:
        return BODY_OMEGA + i - OMEGA
    if i >= VELOCITY:
        return V + i - VELOCITY
    return R + i - ROTATION if i >= ROTATION else X + i


@kernel
def _operate(series: Numbers, operation: Array, first: int, row: int, k: int) -> None:
    """Write the k-th coefficient of the result of one operation into its row."""
    code = int(operation[0])
    a, b = _series_row(operation[1], first), _series_row(operation[2], first)
    constant = like(nothing(series), (operation[3], operation[4]))
    if code == TIME:
        if k > 0:
            put(series, row, k, exactly(series, 1.0 if k == 1 else 0.0))
    elif code == CONSTANT:
        put(series, row, k, constant if k == 0 else nothing(series))
    elif code == SUM:
        put(series, row, k, plus(term(series, a, k), term(series, b, k)))
    elif code == DIFFERENCE:
        put(series, row, k, minus(term(series, a, k), term(series, b, k)))
    elif code == PRODUCT:
        put(series, row, k, cauchy(series, a, b, k))
    elif code == QUOTIENT:
        put(series, row, k, quotient(series, a, b, row, k))
    elif code == SCALED:
        put(series, row, k, times(term(series, a, k), constant))
    elif code == SHIFTED:
        put(series, row, k, plus(term(series, a, k), constant) if k == 0 else term(series, a, k))
    elif code == ROOT:
        put(series, row, k, _root(series, a, row, k))
    elif code == SINE:
        put(series, row, k, sine_and_cosine(term(series, a, 0))[0] if k == 0 else _swing(series, a, b, k))
    elif code == COSINE:
        if k == 0:
            put(series, row, k, sine_and_cosine(term(series, a, 0))[1])
        else:
            put(series, row, k, by_double(_swing(series, a, b, k), -1.0))


@kernel
def may_vanish(high: Array, recorded: Array, row: int, h: float, order: int) -> bool:
    """Whether the argument a of a square root, or a divisor, may reach 0 within the step h.

    It cannot if the sum of |a_k| h^k over k >= 1, up to the order, is below |a_0|. Beyond a zero the series
    may converge to another branch: along a line, sqrt(v . v) goes on as v. high: the series; doubles suffice.
    """
    for i in range(len(recorded)):
        code = int(recorded[i, 0])
        if code in (ROOT, QUOTIENT):
            a = _series_row(recorded[i, 1 if code == ROOT else 2], row)
            change = 0.0
            for k in range(order, 0, -1):
                change = (change + abs(high[a, k])) * h
            if high[a, 0] == 0.0 or change >= abs(high[a, 0]):
                return True
    return False


@kernel
def _root(series: Numbers, a: int, row: int, k: int) -> Any:
    """f^2 = a: f_k = (a_k - sum over 0 < n < k of f_n f_(k-n)) / (2 f_0)."""
    total = term(series, a, k)
    if k == 0:
        return root(total)
    for n in range(1, k):
        total = subtract_product(total, term(series, row, n), term(series, row, k - n))
    return over(renorm(total), by_double(term(series, row, 0), 2.0))


@kernel
def _swing(series: Numbers, a: int, partner: int, k: int) -> Any:
    """f' = a' g: f_k = (sum over n >= 1 of n a_n g_(k-n)) / k, of sine and, except for the sign, cosine."""
    total = nothing(series)
    for n in range(1, k + 1):
        total = add_product(total, by_double(term(series, a, n), float(n)), term(series, partner, k - n))
    return over_double(renorm(total), float(k))
