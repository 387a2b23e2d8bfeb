"""Record the formula of a load as a list of elementary operations.

The formula is evaluated on numpy arrays of symbols, each of which records the operations applied to it.
Kernels execute the list: in doubles for engines, in Taylor coefficients of either precision for the truth.
Source: Griewank and Walther (2008), Evaluating derivatives, sections 2.2 and 13.2.

A formula may use +, -, *, /, **2, @, np.cross, np.sum, np.sin, np.cos and np.sqrt. One that branches on the
motion cannot be recorded. The truth ends where the argument of a square root or a divisor reaches 0, since
the formula is not smooth there: the speed sqrt(v . v) at a turning point, for example.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Instants

TIME, CONSTANT, SUM, DIFFERENCE, PRODUCT, QUOTIENT, SCALED, SHIFTED, ROOT, SINE, COSINE = range(11)
"""t, c, a + b, a - b, a b, a / b, c a, a + c, sqrt a, sin a, cos a; b of a sine is its cosine, and v.v."""
OPERATION = 5
"""Numbers per operation: its code, the operands a and b, and the high and low part of the constant c."""
POSITION, ROTATION, VELOCITY, OMEGA, OPERATIONS = 0, 3, 12, 15, 18
"""Indices of the operands: x, R in row-major order, v, omega, then the operations, starting with the time."""
RESULTS = 6
"""The number of final operations: three components of force, then three of torque."""

_REAL = (int, float, np.floating, np.integer)
_Scalar: TypeAlias = "Symbol | float"


class _Step(NamedTuple):
    """One operation."""

    code: int
    a: int = 0
    b: int = 0
    high: float = 0.0
    low: float = 0.0


class Symbol:
    """A component of the motion, or a number computed from such components."""

    __slots__ = ("operand", "tape")

    def __init__(self, tape: Tape, operand: int) -> None:
        self.tape, self.operand = tape, operand

    def __add__(self, other: object) -> Any:
        if isinstance(other, Symbol):
            return self._with(SUM, other)
        if not isinstance(other, _REAL):
            return NotImplemented  # numpy applies the operation to each element
        return self if other == 0.0 else self._by(SHIFTED, float(other))

    __radd__ = __add__

    def __sub__(self, other: object) -> Any:
        if isinstance(other, Symbol):
            return self._with(DIFFERENCE, other)
        return self + -other if isinstance(other, _REAL) else NotImplemented

    def __rsub__(self, other: object) -> Any:
        return -self + other

    def __mul__(self, other: object) -> Any:
        if isinstance(other, Symbol):
            return self._with(PRODUCT, other)
        if not isinstance(other, _REAL):
            return NotImplemented
        if other == 0.0:
            return 0.0
        return self if other == 1.0 else self._by(SCALED, float(other))

    __rmul__ = __mul__

    def __truediv__(self, other: object) -> Any:
        if isinstance(other, _REAL):
            other = self.tape.constant(float(other))
        return self._with(QUOTIENT, other) if isinstance(other, Symbol) else NotImplemented

    def __rtruediv__(self, other: object) -> Any:
        return self.tape.constant(float(other)) / self if isinstance(other, _REAL) else NotImplemented

    def __neg__(self) -> Symbol:
        return self._by(SCALED, -1.0)

    def __pow__(self, exponent: object) -> Any:
        return self._with(PRODUCT, self) if exponent == 2 else NotImplemented

    def __bool__(self) -> NoReturn:
        raise TypeError("a load whose formula branches on the motion cannot be recorded")

    def _ordered(self, other: object) -> bool:
        return bool(self)

    __lt__ = __le__ = __gt__ = __ge__ = _ordered

    def __getitem__(self, index: Any) -> Any:
        """Return what a numpy scalar returns for this index: x[..., None] has the shape (1,)."""
        return np.array(self, dtype=object)[index]

    def sqrt(self) -> Symbol:
        """Return the square root; np.sqrt calls this."""
        return self.tape.record(_Step(ROOT, self.operand))

    def sin(self) -> Symbol:
        """Return the sine; np.sin calls this."""
        return self.tape.sine_and_cosine(self)[0]

    def cos(self) -> Symbol:
        """Return the cosine; np.cos calls this."""
        return self.tape.sine_and_cosine(self)[1]

    def _with(self, code: int, other: Symbol) -> Symbol:
        return self.tape.record(_Step(code, self.operand, other.operand))

    def _by(self, code: int, constant: float) -> Symbol:
        return self.tape.record(_Step(code, self.operand, high=constant))


class Tape:
    """The operations recorded so far, without duplicates."""

    def __init__(self) -> None:
        self._steps: list[_Step] = []
        self._operands: dict[_Step, int] = {}
        self.record(_Step(TIME))

    def motion(self) -> Instants:
        """Return a motion at one instant, as symbols."""
        x, r, v, omega = (
            np.array([Symbol(self, i) for i in range(*span)], dtype=object)
            for span in ((POSITION, ROTATION), (ROTATION, VELOCITY), (VELOCITY, OMEGA), (OMEGA, OPERATIONS))
        )
        return Instants(np.array(Symbol(self, OPERATIONS), dtype=object), x, r.reshape(3, 3), v, omega)

    def constant(self, high: float, low: float = 0.0) -> Symbol:
        """Return the constant high + low."""
        return self.record(_Step(CONSTANT, high=high, low=low))

    def record(self, step: _Step) -> Symbol:
        """Return the result of an operation, and record it unless it is already on the tape."""
        if step not in self._operands:
            self._operands[step] = OPERATIONS + len(self._steps)
            self._steps.append(step)
        return Symbol(self, self._operands[step])

    def sine_and_cosine(self, x: Symbol) -> tuple[Symbol, Symbol]:
        """Return sin x and cos x, whose Taylor recurrences need each other."""
        after = OPERATIONS + len(self._steps)
        known = next((s for s in self._steps if s.code == SINE and s.a == x.operand), None)
        sine = self.record(known or _Step(SINE, x.operand, after + 1))
        return sine, self.record(_Step(COSINE, x.operand, sine.operand))

    def ending_in(self, results: Sequence[_Scalar]) -> Array:
        """Return the operations (n, 5) that the results depend on; the last ones are the results."""
        last = [
            _Step(SCALED, x.operand, high=1.0) if isinstance(x, Symbol) else _Step(CONSTANT, high=float(x))
            for x in results
        ]
        used = sorted(self._needed_by(last) | {0})
        renamed = {OPERATIONS + old: OPERATIONS + new for new, old in enumerate(used)}
        steps = [*(self._steps[i] for i in used), *last]
        return np.array([step._replace(a=renamed.get(step.a, step.a), b=renamed.get(step.b, step.b))
                         for step in steps], dtype=np.float64)  # fmt: skip

    def _needed_by(self, steps: Sequence[_Step]) -> set[int]:
        """Return the indices of all operations that these depend on."""
        needed: set[int] = set()
        open_steps = list(steps)
        while open_steps:
            step = open_steps.pop()
            for operand in (step.a, step.b):
                place = operand - OPERATIONS
                if place >= 0 and place not in needed:
                    needed.add(place)
                    open_steps.append(self._steps[place])
        return needed


def recorded(formula: Callable[[Tape, Instants], tuple[Array, Array]]) -> Array:
    """Return the operations (n, 5) that compute force and torque from the motion."""
    tape = Tape()
    force, torque = formula(tape, tape.motion())
    return tape.ending_in([*force, *torque])
