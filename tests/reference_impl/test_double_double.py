"""Double-double arithmetic against exact fractions."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest

from bodycheck.reference_impl.kernels import double_double as dd

Pair = tuple[float, float]
_ULP = Fraction(1, 2**106)
_RNG = np.random.default_rng(20240611)

DOUBLES: list[Pair] = [
    (float(a), float(b))
    for a, b in _RNG.normal(size=(300, 2)) * 10.0 ** _RNG.uniform(-12.0, 12.0, size=(300, 2))
] + [
    (1.0, 2.0**-53),
    (1.0, -(2.0**-54)),
    (3.0, -3.0),
    (0.0, 5.0),
    (0.1, 0.3),
    (1.0 + 2.0**-52, 1.0 - 2.0**-53),
]
PAIRS: list[tuple[Pair, Pair]] = [
    ((a, a * 2.0**-54 * math.cos(i)), (b, b * 2.0**-54 * math.sin(i)))
    for i, (a, b) in enumerate(DOUBLES)
    if a != 0.0
]


def exact(x: Pair) -> Fraction:
    """Return the exact sum of the two parts."""
    return Fraction(x[0]) + Fraction(x[1])


def relative_error(found: Pair, true: Fraction) -> Fraction:
    """|found - true| / |true|."""
    return abs(exact(found) - true) / abs(true)


@pytest.mark.parametrize("transformation", [dd.two_sum, dd.two_product])
def test_error_free(transformation: Callable[[float, float], Pair]) -> None:
    """High part and error sum to the exact result, and the high part is the rounded result."""
    for a, b in DOUBLES:
        true = Fraction(a) + Fraction(b) if transformation is dd.two_sum else Fraction(a) * Fraction(b)
        result = transformation(a, b)
        assert exact(result) == true
        assert result[0] == float(true)


def test_quick_two_sum() -> None:
    """If the larger number comes first, three operations are exact too."""
    for a, b in DOUBLES:
        large, small = (a, b) if abs(a) >= abs(b) else (b, a)
        assert exact(dd.quick_two_sum(large, small)) == Fraction(a) + Fraction(b)


def test_split() -> None:
    """Head and tail sum to the number, and products of two of them are exact."""
    for a, _ in DOUBLES:
        head, tail = dd.split(a)
        assert exact((head, tail)) == Fraction(a)
        assert Fraction(head) * Fraction(tail) == Fraction(head * tail)
        assert Fraction(head) ** 2 == Fraction(head * head)


@pytest.mark.parametrize(
    ("operation", "true", "bound"),
    [
        (dd.add, lambda x, y: x + y, 3),
        (dd.subtract, lambda x, y: x - y, 3),
        (dd.multiply, lambda x, y: x * y, 5),
        (dd.divide, lambda x, y: x / y, 10),
    ],
    ids=["add", "subtract", "multiply", "divide"],
)
def test_operations(
    operation: Callable[[Pair, Pair], Pair], true: Callable[[Fraction, Fraction], Fraction], bound: int
) -> None:
    """Each operation is within its error bound, which an operation without the low parts would exceed."""
    careless = Fraction(0)
    for x, y in PAIRS:
        expected = true(exact(x), exact(y))
        assert relative_error(operation(x, y), expected) <= bound * _ULP
        careless = max(careless, relative_error(operation((x[0], 0.0), (y[0], 0.0)), expected))
    assert careless > 1e10 * _ULP


def test_cancellation() -> None:
    """A difference of close numbers has the same relative accuracy."""
    for x, _ in PAIRS:
        neighbour = dd.add(x, (x[0] * 2.0**-60, 0.0))
        true = exact(neighbour) - exact(x)
        assert relative_error(dd.subtract(neighbour, x), true) <= 3 * _ULP


def test_square_root() -> None:
    """The squared root equals the number to 8 * 2^-106, and the root of zero is zero."""
    for x, _ in PAIRS:
        size = x if x[0] > 0.0 else (-x[0], -x[1])
        root = dd.square_root(size)
        assert abs(exact(root) ** 2 / exact(size) - 1) <= 8 * _ULP
    assert dd.square_root(dd.ZERO) == dd.ZERO


def test_scale() -> None:
    """Scaling by a power of two is exact."""
    for x, _ in PAIRS:
        assert exact(dd.scale(x, 2.0**-40)) == exact(x) / 2**40


def test_pi() -> None:
    """The constant is pi to 106 bits: its two parts are the rounded pi and the rounded remainder."""
    pi = Fraction("3.14159265358979323846264338327950288419716939937510582097494459")
    assert dd.PI[0] == math.pi
    assert dd.PI[1] == float(pi - Fraction(math.pi))


@pytest.mark.parametrize("name", ["two_sum", "two_product", "add", "multiply", "divide"])
def test_compiled_as_written(name: str) -> None:
    """The compiled kernel and the Python function give the same bits: no product is fused into a sum."""
    compiled = getattr(dd, name)
    written = getattr(compiled, "py_func", compiled)
    for (a, b), (x, y) in zip(DOUBLES, PAIRS, strict=False):
        arguments = (a, b) if name.startswith("two") else (x, y)
        assert compiled(*arguments) == written(*arguments)
