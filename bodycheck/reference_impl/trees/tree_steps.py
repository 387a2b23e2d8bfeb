"""The steps of the Taylor integrator of trees, in doubles or double-doubles, with dense output.

As for one body (`taylor_steps.py`): the last two coefficients give the step, which ends on a coarse binary
grid, and the state is a double-double. Quaternions, cosines and sines are divided by their norms after each
step. Source: Jorba and Zou (2005), Experimental Mathematics 14, 99.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    as_pair,
    by_double,
    exactly,
    is_paired,
    like,
    nothing,
    phase,
    put,
    sine_and_cosine,
    term,
)
from bodycheck.reference_impl.kernels.jit import long_kernel, unspecialised_borrowing_kernel
from bodycheck.reference_impl.taylor.taylor_steps import EPS, SMALLER, next_time, reach, series_change
from bodycheck.reference_impl.trees.tree_series import (
    Integers,
    correct,
    evaluate,
    factor,
    normalise,
    put_gains,
    put_mass_matrix,
    solve,
)

TURNED, PLACE, SPIN, SPEED, DERIVED = 0, 1, 2, 3, 4
"""What a component of the state is: of a rotation of norm 1, a length, a rate of either, or the integral of a
rate that the step need not watch."""


class TreeNumbers(NamedTuple):
    """The equations of a tree for the kernels: the arrays of `TreeEquations`, `Rows` and `Response`.

    joints: as for `put_state`. segments: the first rows of the forms and of the outputs.
    """

    rows: Integers
    terms: Integers
    constants: Numbers
    responding: Integers
    ends: Integers
    sources: Integers
    others: Integers
    shares: Numbers
    columns: Integers
    column_ends: Integers
    kept: Integers
    unknowns: Integers
    ahead: Integers
    results: Integers
    segments: Integers
    joints: Integers
    sines: Array
    sine_rows: Integers


class Workspace(NamedTuple):
    """mass (nu, nu), gains (terms of the response, 1), change (rows, 1), x (nu, 1), series (rows, orders)."""

    mass: Numbers
    gains: Numbers
    change: Numbers
    x: Numbers
    series: Numbers


@unspecialised_borrowing_kernel
def put_mass(tree: TreeNumbers, space: Workspace) -> None:
    """Set the rows ahead, the gains and the mass matrix at the constant terms."""
    evaluate(tree.rows, tree.terms, tree.constants, space.series, 0, tree.segments[0], -1, False)
    put_gains(tree.others, tree.shares, space.series, space.gains)
    for i in range(len(tree.rows)):
        put(space.change, i, 0, nothing(space.change))
    put_mass_matrix(
        tree.responding,
        tree.ends,
        tree.sources,
        tree.columns,
        tree.column_ends,
        tree.unknowns,
        tree.results,
        space.gains,
        space.change,
        space.mass,
    )


@unspecialised_borrowing_kernel
def expand(tree: TreeNumbers, space: Workspace, first: int, last: int) -> None:
    """Fill the orders from first to last of all rows, first + 1 to last of the state; M is factored."""
    rows, terms, constants, series, x = tree.rows, tree.terms, tree.constants, space.series, space.x
    unknowns, ahead, results = tree.unknowns, tree.ahead, tree.results
    main, end = tree.segments
    for k in range(first, last):
        for j in range(len(unknowns)):
            put(series, unknowns[j], k + ahead[j], nothing(series))
        evaluate(rows, terms, constants, series, 0, end, k, False)
        for j in range(len(results)):
            put(x, j, 0, by_double(term(series, results[j], k), -1.0))
        solve(space.mass, x, len(results))
        correct(
            rows,
            tree.responding,
            tree.ends,
            tree.sources,
            tree.kept,
            unknowns,
            ahead,
            space.gains,
            space.change,
            x,
            series,
            k,
        )
        evaluate(rows, terms, constants, series, 0, main, k, True)


@unspecialised_borrowing_kernel
def _largest(high: Array, state_rows: Integers, classes: Integers, wanted: int, k: int) -> float:
    """max |c_k| over the components of one class; infinite if one is NaN."""
    largest = 0.0
    for i in range(len(classes)):
        if classes[i] == wanted:
            size = abs(high[state_rows[i], k])
            if not size <= math.inf:
                return math.inf
            largest = max(largest, size)
    return largest


@unspecialised_borrowing_kernel
def _step_size(
    high: Array, state_rows: Integers, classes: Integers, length: float, order: int, tolerance: float
) -> float:
    """The step at which the last two terms of the state reach the tolerance, lengths relative to `length`."""
    step = math.inf
    length = max(length, _largest(high, state_rows, classes, PLACE, 0))
    spin = _largest(high, state_rows, classes, SPIN, 0)
    start = max(spin, _largest(high, state_rows, classes, SPEED, 0) / length)
    for k in (order - 1, order):
        size = _largest(high, state_rows, classes, TURNED, k)
        size = max(size, _largest(high, state_rows, classes, PLACE, k) / length)
        if size != 0.0:
            step = min(step, (tolerance / size) ** (1.0 / k))
        rate = _largest(high, state_rows, classes, SPIN, k)
        rate = max(rate, _largest(high, state_rows, classes, SPEED, k) / length)
        step = min(step, reach(rate, start, k, tolerance))
    return step


@long_kernel
def integrate_tree(
    tree: TreeNumbers,
    rounded: TreeNumbers,
    space: Workspace,
    high: Workspace,
    state_rows: Integers,
    classes: Integers,
    norms: Integers,
    length: float,
    state: tuple[Array, Array],
    times: Array,
    begin: float,
    end: float,
    order: int,
    tolerance: float,
    paired_orders: int,
    max_steps: int,
    out: tuple[Array, Array],
) -> tuple[int, float, float]:
    """Advance the state (s, 1) from time begin to end, and write it at the times (n,) into out (n, s).

    Returns the number of steps, the last time and the largest M_ii / d_i. After max_steps it returns early;
    the next call, from the returned time, continues bit for bit. out is NaN from where the integration fails.
    norms (m, 2): first component and number of those of norm 1. rounded, high: tree and space in doubles.
    """
    series, sines = space.series, tree.sines
    full = min(paired_orders, order) if is_paired(series) else order
    t, due, steps, ratio = begin, 0, 0, 1.0
    while due < len(times) and times[due] <= begin:
        for i in range(len(state_rows)):
            out[0][due, i], out[1][due, i] = state[0][i, 0], state[1][i, 0]
        due += 1
    while t < end and steps < max_steps:
        put(series, 0, 0, exactly(series, 1.0))
        for i in range(len(state_rows)):
            put(series, state_rows[i], 0, like(nothing(series), (state[0][i, 0], state[1][i, 0])))
        for j in range(len(sines)):
            sine, cosine = sine_and_cosine(phase(exactly(series, sines[j, 0]), t, sines[j, 1]))
            put(series, tree.sine_rows[j], 0, sine)
            put(series, tree.sine_rows[j] + 1, 0, cosine)
        put_mass(tree, space)
        ratio = max(ratio, factor(space.mass, len(tree.results)))
        expand(tree, space, 0, full)
        expand(rounded, high, full, order)
        step = _step_size(high.series, state_rows, classes, length, order, tolerance)
        if tolerance * SMALLER < EPS:
            step = min(step, _step_size(high.series, state_rows, classes, length, full, tolerance * SMALLER))
        after = next_time(t, step, end)
        if not (after > t and ratio < math.inf):
            for i in range(len(state_rows)):
                state[0][i, 0] = math.nan
            while due < len(times):
                for i in range(len(state_rows)):
                    out[0][due, i] = math.nan
                due += 1
            return steps, end, ratio
        while due < len(times) and times[due] < after:
            for i in range(len(state_rows)):
                gained = as_pair(series_change(series, state_rows[i], order, times[due] - t))
                out[0][due, i], out[1][due, i] = dd.add((state[0][i, 0], state[1][i, 0]), gained)
            due += 1
        for i in range(len(state_rows)):
            gained = as_pair(series_change(series, state_rows[i], order, after - t))
            state[0][i, 0], state[1][i, 0] = dd.add((state[0][i, 0], state[1][i, 0]), gained)
        for i in range(len(norms)):
            normalise(state, norms[i, 0], norms[i, 1])
        while due < len(times) and times[due] <= after:
            for i in range(len(state_rows)):
                out[0][due, i], out[1][due, i] = state[0][i, 0], state[1][i, 0]
            due += 1
        t = after
        steps += 1
    return steps, t, ratio
