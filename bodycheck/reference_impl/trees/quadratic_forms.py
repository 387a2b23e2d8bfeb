"""Record equations as rows, each a sum of constants times rows and times products of two rows.

Constants are exact, so that terms that vanish for one tree (an axis along e_y, a joint frame turned by a
quarter) are left out. Kernels evaluate the rows in Taylor coefficients: see `tree_series.py`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.kernels.generic_precision import Numbers
from bodycheck.reference_impl.rational import pair

_ONE = Fraction(1)
Key: TypeAlias = tuple[int, ...]
"""The rows of one term: none for a constant, one, or two of a product."""


class Row(IntEnum):
    """How the coefficient of a row follows from its form, at order k.

    INPUT: from outside. FORM: y_k. AHEAD: y_{k+1}. INTEGRAL: y_{k+1} = form_k / (k + 1). LATE: the same, once
    the unknowns of order k are known. DERIVATIVE: y_k = (k + 1) form_{k+1}.
    """

    INPUT = 0
    FORM = 1
    AHEAD = 2
    INTEGRAL = 3
    LATE = 4
    DERIVATIVE = 5


@dataclass(frozen=True, eq=False)
class Form:
    """A sum of constants times rows, and times products of two rows."""

    equations: Equations
    terms: Mapping[Key, Fraction]

    def __add__(self, other: Form) -> Form:
        terms = dict(self.terms)
        for key, constant in other.terms.items():
            terms[key] = terms.get(key, Fraction(0)) + constant
        return Form(self.equations, {key: constant for key, constant in terms.items() if constant})

    def __sub__(self, other: Form) -> Form:
        return self + other.by(-1)

    def by(self, constant: Fraction | int) -> Form:
        """Return the form times a constant."""
        terms = {key: constant * own for key, own in self.terms.items()} if constant else {}
        return Form(self.equations, terms)

    def __mul__(self, other: Form) -> Form:
        if not self.terms or not other.terms:
            return Form(self.equations, {})
        if self.terms.keys() == {()} or other.terms.keys() == {()}:
            own, others = (self, other) if self.terms.keys() == {()} else (other, self)
            return others.by(own.terms[()])
        ((one, a),), ((two, b),) = (self.equations.row(form).terms.items() for form in (self, other))
        return Form(self.equations, {tuple(sorted((*one, *two))): a * b})


Three: TypeAlias = list[Form]


class Equations:
    """The rows recorded so far; row 0 is the constant 1."""

    def __init__(self) -> None:
        self.kinds: list[Row] = [Row.INPUT]
        self.forms: list[Mapping[Key, Fraction]] = [{}]
        self.kind = Row.FORM
        self._known: dict[tuple[Row, frozenset[tuple[Key, Fraction]]], Form] = {}

    @property
    def zero(self) -> Form:
        """0."""
        return Form(self, {})

    def constant(self, x: Fraction) -> Form:
        """x."""
        return Form(self, {(): x} if x else {})

    def constants(self, vector: Iterable[Fraction]) -> Three:
        """A constant vector."""
        return [self.constant(x) for x in vector]

    def inputs(self, count: int) -> list[Form]:
        """Return rows that are set from outside, or defined later."""
        first = len(self.kinds)
        self.kinds += [Row.INPUT] * count
        self.forms += [{}] * count
        return [Form(self, {(row,): _ONE}) for row in range(first, first + count)]

    def define(self, row: Form, kind: Row, form: Form) -> None:
        """State what an input is."""
        self.kinds[number(row)], self.forms[number(row)] = kind, form.terms

    def row(self, form: Form, kind: Row | None = None) -> Form:
        """Return a form as one row times a constant, recorded unless it is one already."""
        kind = self.kind if kind is None else kind
        if len(form.terms) == 1:
            ((key, constant),) = form.terms.items()
            if len(key) == 0 or (len(key) == 1 and kind is not Row.DERIVATIVE):
                return form
            return self._recorded(kind, {key: _ONE}).by(constant)
        return self._recorded(kind, form.terms) if form.terms else form

    def _recorded(self, kind: Row, terms: Mapping[Key, Fraction]) -> Form:
        known = kind, frozenset(terms.items())
        if known not in self._known:
            (row,) = self.inputs(1)
            self.define(row, kind, Form(self, terms))
            self._known[known] = row
        return self._known[known]

    def rows(self, vector: Three) -> Three:
        """Return each component as a row times a constant."""
        return [self.row(form) for form in vector]

    def derivative(self, form: Form) -> Form:
        """The derivative of a row times a constant that is known one order ahead."""
        if not form.terms or form.terms.keys() == {()}:
            return self.zero
        return self.row(form, Row.DERIVATIVE)

    def outputs(self, forms: Iterable[Form]) -> NDArray[np.int64]:
        """Record forms as rows of their own; return the numbers of the rows."""
        made = []
        for form in forms:
            (row,) = self.inputs(1)
            self.define(row, Row.FORM, form)
            made.append(number(row))
        return np.array(made, dtype=np.int64)


def number(row: Form) -> int:
    """Return the number of a row."""
    ((key, constant),) = row.terms.items()
    assert constant == 1
    return key[0]


@dataclass(frozen=True, eq=False)
class Rows:
    """Recorded rows for the kernels: rows (n, 3) of kind, first term and end of terms.

    terms (m, 2): one row and -1, or the two rows of a product. constants (m,).
    """

    rows: NDArray[np.int64]
    terms: NDArray[np.int64]
    constants: Numbers


def packed(equations: Equations) -> Rows:
    """Return the recorded rows as arrays, with constants rounded to double-doubles."""
    rows: list[tuple[int, int, int]] = []
    terms: list[tuple[int, ...]] = []
    constants: list[tuple[float, float]] = []
    for kind, form in zip(equations.kinds, equations.forms, strict=True):
        first = len(terms)
        for key in sorted(form, key=lambda key: (len(key), key)):
            terms.append((*key, -1, -1)[:2] if key else (0, -1))
            constants.append(pair(form[key]))
        rows.append((int(kind), first, len(terms)))
    pairs = np.array(constants).reshape(-1, 2)
    return Rows(
        np.array(rows, dtype=np.int64),
        np.array(terms, dtype=np.int64).reshape(-1, 2),
        (np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])),
    )


@dataclass(frozen=True, eq=False)
class Response:
    """What the derivatives of the rates, the unknowns of an order, change in the rows of this order.

    The change of rows[i] is the sum, over the terms t from ends[i] to ends[i + 1], of constants[t] (times the
    constant term of the row others[t], unless it is -1) times the change of the row sources[t].
    columns: places in rows, in ascending order, those of unknown j from column_ends[j] to column_ends[j + 1]:
    what is needed for the equations' response to that unknown. kept: the places of the rows that products
    of higher orders contain.
    """

    rows: NDArray[np.int64]
    ends: NDArray[np.int64]
    sources: NDArray[np.int64]
    others: NDArray[np.int64]
    constants: Numbers
    columns: NDArray[np.int64]
    column_ends: NDArray[np.int64]
    kept: NDArray[np.int64]


def response_of(equations: Equations, unknowns: list[tuple[Form, bool]], results: list[Form]) -> Response:
    """Return how rows respond to the unknowns; results: the rows that the unknowns make 0.

    An unknown is a row, and whether it is known one order ahead of the forms, as a rate is.
    """
    ahead = {number(row) for row, is_ahead in unknowns if is_ahead}
    here = {number(row) for row, is_ahead in unknowns if not is_ahead}
    changes: dict[int, list[tuple[int, int, Fraction]]] = {}
    for row, (kind, form) in enumerate(zip(equations.kinds, equations.forms, strict=True)):
        responding = {Row.FORM: here, Row.AHEAD: ahead, Row.DERIVATIVE: ahead}.get(kind, set())
        for key, constant in form.items():
            for place, one in enumerate(key):
                if one in responding:
                    other = key[1 - place] if len(key) == 2 else -1
                    changes.setdefault(row, []).append((one, other, constant))
        if row in changes:
            (ahead if kind is Row.AHEAD else here).add(row)
    factors = {row for form in equations.forms for key in form if len(key) == 2 for row in key}
    return _packed(changes, [number(row) for row, _ in unknowns], list(map(number, results)), factors)


def _packed(
    changes: dict[int, list[tuple[int, int, Fraction]]],
    unknowns: list[int],
    results: list[int],
    factors: set[int],
) -> Response:
    for_results, for_factors = _needed(changes, results), _needed(changes, factors)
    rows = sorted(for_results | for_factors)
    columns, ends = [], [0]
    for unknown in unknowns:
        reached = {unknown}
        for place, row in enumerate(rows):
            if row in for_results and any(source in reached for source, _, _ in changes[row]):
                reached.add(row)
                columns.append(place)
        ends.append(len(columns))
    terms = [change for row in rows for change in changes[row]]
    pairs = np.array([pair(constant) for _, _, constant in terms]).reshape(-1, 2)
    return Response(
        np.array(rows, dtype=np.int64),
        np.cumsum([0, *(len(changes[row]) for row in rows)]),
        np.array([source for source, _, _ in terms], dtype=np.int64),
        np.array([other for _, other, _ in terms], dtype=np.int64),
        (np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1])),
        np.array(columns, dtype=np.int64),
        np.array(ends),
        np.array([place for place, row in enumerate(rows) if row in for_factors], dtype=np.int64),
    )


def _needed(changes: Mapping[int, list[tuple[int, int, Fraction]]], rows: Iterable[int]) -> set[int]:
    """Return these rows and those that they follow from, as far as they respond."""
    needed: set[int] = set()
    open_rows = [row for row in rows if row in changes]
    while open_rows:
        row = open_rows.pop()
        if row not in needed:
            needed.add(row)
            open_rows += [source for source, _, _ in changes[row] if source in changes]
    return needed
