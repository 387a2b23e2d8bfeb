"""Operations on doubles or double-doubles: kernels written with them run in either precision.

A number is a float or a DoubleDouble. Numbers are stored in an ndarray, or in two ndarrays of the same shape
for the high and low parts. The compiler selects the precision by type, plain Python by isinstance. On doubles
each operation compiles to one machine operation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

from bodycheck._util.pinned_libraries import numba
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble

types, uintp, overload = numba().types, numba().uintp, numba().extending.overload

Number: TypeAlias = float | DoubleDouble
Numbers: TypeAlias = Array | tuple[Array, Array]
Three: TypeAlias = tuple[Number, Number, Number]

_OPTIONS = {"fastmath": {"contract"}, "error_model": "numpy"}
_Form: TypeAlias = Callable[..., Any]


def _register(python: _Form, on_doubles: _Form, on_pairs: _Form) -> None:
    """Register both forms of an operation with numba, which selects by the type of the first argument."""

    def choose(*arguments: Any) -> _Form:
        return on_pairs if isinstance(arguments[0], types.BaseTuple) else on_doubles

    overload(python, jit_options=_OPTIONS, strict=False)(choose)


# --------------------------------------------------------------------------------------- access to arrays


def entry(numbers: Numbers, i: int) -> Any:
    """numbers[i]."""
    return (numbers[0][i], numbers[1][i]) if isinstance(numbers, tuple) else numbers[i]


def term(numbers: Numbers, i: int, k: int) -> Any:
    """numbers[i, k]."""
    return (numbers[0][i, k], numbers[1][i, k]) if isinstance(numbers, tuple) else numbers[i, k]


def put(numbers: Numbers, i: int, k: int, x: Any) -> None:
    """numbers[i, k] = x."""
    if isinstance(numbers, tuple):
        numbers[0][i, k], numbers[1][i, k] = x
    else:
        numbers[i, k] = x


def high_part(numbers: Any) -> Any:
    """Return the numbers rounded to doubles; anything but double-doubles unchanged."""
    return numbers[0] if isinstance(numbers, tuple) else numbers


def is_paired(numbers: Numbers) -> bool:
    """Whether the numbers are double-doubles."""
    return isinstance(numbers, tuple)


def nothing(numbers: Numbers) -> Any:
    """Return 0 in the precision of the numbers."""
    return dd.ZERO if isinstance(numbers, tuple) else 0.0


def exactly(numbers: Numbers, x: float) -> Any:
    """Return the double x in the precision of the numbers."""
    return (x, 0.0) if isinstance(numbers, tuple) else x


def _put_pair(numbers: Any, i: int, k: int, x: Any) -> None:
    numbers[0][uintp(i), uintp(k)] = x[0]
    numbers[1][uintp(i), uintp(k)] = x[1]


def _put_double(numbers: Any, i: int, k: int, x: Any) -> None:
    numbers[uintp(i), uintp(k)] = x


# an unsigned index saves the check for negative indices
_register(
    entry,
    lambda numbers, i: numbers[uintp(i)],
    lambda numbers, i: (numbers[0][uintp(i)], numbers[1][uintp(i)]),
)
_register(
    term,
    lambda numbers, i, k: numbers[uintp(i), uintp(k)],
    lambda numbers, i, k: (numbers[0][uintp(i), uintp(k)], numbers[1][uintp(i), uintp(k)]),
)
_register(put, _put_double, _put_pair)
_register(high_part, lambda numbers: numbers, lambda numbers: numbers[0])
_register(is_paired, lambda numbers: False, lambda numbers: True)  # noqa: ARG005 - called by type
_register(nothing, lambda numbers: 0.0, lambda numbers: (0.0, 0.0))  # noqa: ARG005 - called by type
_register(exactly, lambda numbers, x: x, lambda numbers, x: (x, 0.0))  # noqa: ARG005 - called by type

# --------------------------------------------------------------------------------------------- arithmetic


def plus(x: Any, y: Any) -> Any:
    """x + y."""
    return dd.add(x, y) if isinstance(x, tuple) else x + y


def minus(x: Any, y: Any) -> Any:
    """x - y."""
    return dd.subtract(x, y) if isinstance(x, tuple) else x - y


def times(x: Any, y: Any) -> Any:
    """x y."""
    return dd.multiply(x, y) if isinstance(x, tuple) else x * y


def by_double(x: Any, y: float) -> Any:
    """x y for a double y."""
    return double_double.times_double(x, y) if isinstance(x, tuple) else x * y


def over(x: Any, y: Any) -> Any:
    """x / y."""
    return dd.divide(x, y) if isinstance(x, tuple) else x / y


def over_double(x: Any, y: float) -> Any:
    """x / y for a double y."""
    return dd.divide(x, (y, 0.0)) if isinstance(x, tuple) else x / y


def root(x: Any) -> Any:
    """sqrt(x)."""
    return dd.square_root(x) if isinstance(x, tuple) else math.sqrt(x)


def add_product(total: Any, x: Any, y: Any) -> Any:
    """Return total + x y; call `renorm` on the final sum."""
    return double_double.add_product(total, x, y) if isinstance(total, tuple) else total + x * y


def subtract_product(total: Any, x: Any, y: Any) -> Any:
    """Return total - x y; call `renorm` on the final sum."""
    return double_double.subtract_product(total, x, y) if isinstance(total, tuple) else total - x * y


def renorm(total: Any) -> Any:
    """Return a sum of products, normalised."""
    return double_double.renorm(total) if isinstance(total, tuple) else total


def phase(rate: Any, t: float, offset: float) -> Any:
    """Return rate t + offset."""
    if isinstance(rate, tuple):
        return dd.add(double_double.times_double(rate, t), (offset, 0.0))
    return rate * t + offset


def sine_and_cosine(x: Any) -> Any:
    """sin x and cos x."""
    return double_double.sine_and_cosine(x) if isinstance(x, tuple) else (math.sin(x), math.cos(x))


def as_pair(x: Any) -> DoubleDouble:
    """Return the number as a double-double."""
    return x if isinstance(x, tuple) else (x, 0.0)


def like(x: Any, pair: DoubleDouble) -> Any:
    """Return a double-double in the precision of x."""
    return pair if isinstance(x, tuple) else pair[0]


_register(plus, lambda x, y: x + y, lambda x, y: dd.add(x, y))
_register(minus, lambda x, y: x - y, lambda x, y: dd.subtract(x, y))
_register(times, lambda x, y: x * y, lambda x, y: dd.multiply(x, y))
_register(by_double, lambda x, y: x * y, lambda x, y: double_double.times_double(x, y))
_register(over, lambda x, y: x / y, lambda x, y: dd.divide(x, y))
_register(over_double, lambda x, y: x / y, lambda x, y: dd.divide(x, (y, 0.0)))
_register(root, lambda x: math.sqrt(x), lambda x: dd.square_root(x))
_register(
    add_product,
    lambda total, x, y: total + x * y,
    lambda total, x, y: double_double.add_product(total, x, y),
)
_register(
    subtract_product,
    lambda total, x, y: total - x * y,
    lambda total, x, y: double_double.subtract_product(total, x, y),
)
_register(renorm, lambda total: total, lambda total: double_double.renorm(total))
_register(
    phase,
    lambda rate, t, offset: rate * t + offset,
    lambda rate, t, offset: dd.add(double_double.times_double(rate, t), (offset, 0.0)),
)
_register(
    sine_and_cosine,
    lambda x: (math.sin(x), math.cos(x)),
    lambda x: double_double.sine_and_cosine(x),
)
_register(as_pair, lambda x: (x, 0.0), lambda x: x)
_register(like, lambda x, pair: pair[0], lambda x, pair: pair)  # noqa: ARG005 - called by type
