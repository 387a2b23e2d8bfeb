"""heyoka's Taylor method on a tree, compiled for it: its equations are the recorded rows, as expressions."""

from __future__ import annotations

from functools import cache
from typing import Any

import heyoka
import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.quadratic_forms import Row
from bodycheck.reference_impl.trees.tree_equations import TreeEquations, tree_equations
from bodycheck.reference_impl.trees.tree_motion import state_layout
from bodycheck.reference_impl.trees.tree_scene import TreeScene


class _Expressions:
    """The rows of a tree as functions of its state, if the unknowns are 0, and the system for these."""

    def __init__(self, equations: TreeEquations, state: list[int]) -> None:
        self.equations = equations
        self.variables = {row: heyoka.make_vars(f"y{row}") for row in state}
        self.value, self.rate = cache(self._value), cache(self._rate)

    def _terms(self, row: int) -> list[tuple[float, int, int]]:
        rows = self.equations.rows
        _, first, end = rows.rows[row]
        constants = rows.constants[0][first:end].tolist()
        return [(c, int(a), int(b)) for c, (a, b) in zip(constants, rows.terms[first:end], strict=True)]

    def _kind(self, row: int) -> Row:
        return Row(int(self.equations.rows.rows[row, 0]))

    def form(self, row: int) -> Any:
        """The form of a row at order 0."""
        return sum(c * self.value(a) * (self.value(b) if b >= 0 else 1.0) for c, a, b in self._terms(row))

    def _value(self, row: int) -> Any:
        if row == 0:
            return 1.0
        if row in self.variables:
            return self.variables[row]
        if self._kind(row) is Row.INPUT:
            return 0.0
        if self._kind(row) is Row.DERIVATIVE:
            return sum(c * self.rate(a) for c, a, _ in self._terms(row))
        return self.form(row)

    def _rate(self, row: int) -> Any:
        """The derivative of a row whose unknowns are 0."""
        if self._kind(row) is Row.INPUT:
            return 0.0
        if self._kind(row) is Row.INTEGRAL:
            return self.form(row)
        total: Any = 0.0
        for c, a, b in self._terms(row):
            other = self.value(b) if b >= 0 else 1.0
            total = total + c * self.rate(a) * other
            if b >= 0:
                total = total + c * self.value(a) * self.rate(b)
        return total

    def derivatives(self) -> dict[int, Any]:
        """The derivative of each row of the state."""
        equations, response = self.equations, self.equations.response
        changes = []
        for unknown in equations.unknowns.tolist():
            change: dict[int, Any] = {unknown: 1.0}
            for place, row in enumerate(response.rows.tolist()):
                total: Any = 0.0
                for t in range(response.ends[place], response.ends[place + 1]):
                    source, other = int(response.sources[t]), int(response.others[t])
                    if source in change:
                        gain = float(response.constants[0][t]) * (self.value(other) if other >= 0 else 1.0)
                        total = total + gain * change[source]
                change[row] = total
            changes.append(change)
        results = equations.results.tolist()
        matrix = [[change.get(row, 0.0) for change in changes] for row in results]
        solution = _solved(matrix, [-1.0 * self.value(row) for row in results])
        unknowns = dict(zip(equations.unknowns.tolist(), solution, strict=True))
        found = {}
        for row in self.variables:
            if self._kind(row) is Row.LATE:
                found[row] = sum(
                    c * unknowns.get(a, self.value(a)) * (unknowns.get(b, self.value(b)) if b >= 0 else 1.0)
                    for c, a, b in self._terms(row)
                )
            else:
                found[row] = unknowns[row] if row in unknowns else self.form(row)
        return found


def _solved(matrix: list[list[Any]], right: list[Any]) -> list[Any]:
    """Eliminate without exchanges: the matrix is symmetric and positive definite."""
    n = len(right)
    for j in range(n):
        for i in range(j + 1, n):
            share = matrix[i][j] / matrix[j][j]
            right[i] = right[i] - share * right[j]
            matrix[i] = [a - share * b for a, b in zip(matrix[i], matrix[j], strict=True)]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            right[i] = right[i] - matrix[i][k] * right[k]
        right[i] = right[i] / matrix[i][i]
    return right


class HeyokaTree:
    """A tree without loads that vary in time, compiled for one tolerance."""

    def __init__(self, scene: TreeScene, tolerance: float) -> None:
        equations = tree_equations(scene)
        rows, self._q, self._u, self._start = state_layout(scene, equations)
        rates = _Expressions(equations, rows).derivatives()
        variables = [(heyoka.make_vars(f"y{row}"), rates[row] + heyoka.expression(0.0)) for row in rows]
        self._until = scene.duration_s
        self._integrator = heyoka.taylor_adaptive(
            variables, self._start, tol=tolerance, compact_mode=len(rows) > 8
        )

    def __call__(self) -> tuple[Array, Array]:
        """Go from the start to the end; return q and u."""
        self._integrator.state[:] = self._start
        self._integrator.time = 0.0
        self._integrator.propagate_until(self._until)
        state = np.array(self._integrator.state)
        return state[self._q], state[self._u]
