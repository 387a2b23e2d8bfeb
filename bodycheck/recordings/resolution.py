"""The resolution of a column: the spacing of the numbers that it can state, from its digits or its type."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from decimal import Decimal, localcontext
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array

SAMPLES = 1024  # rows that show how a column is rounded
_FEWEST_VALUES = 3  # a constant, or a switch between two values, does not show how it was rounded
_EQUAL = 8.0  # roundings of doubles, by which equal steps may differ: they do not show it either
_MOST = 0.9  # of the steps
_CHANCE = 1000  # one in so many sequences of steps has a common factor by chance
_FLOAT32_SPACING = 2.0**29  # of numbers in float32, relative to that of doubles
_DECIMAL_DIGITS = 60  # of differences of stamps: 19 of nanoseconds since 1970, and any fraction

Stamp: TypeAlias = int | Decimal
"""A time as it is written, in the unit of its column."""


@dataclass(frozen=True)
class Digits:
    """How the numbers of a column are rounded.

    decimals: the most after the point, negative for multiples of ten. significant: the most digits of a
    number. is_float32: whether they are rounded to float32, whatever their digits. magnitude: the power of 10
    of the largest number with the most digits: a larger one, such as 1 among 0.999999, may be round.
    """

    decimals: int
    significant: int
    is_float32: bool
    magnitude: int = 400

    @property
    def rank(self) -> tuple[int, int]:
        """The finer digits have the higher rank."""
        return (self.significant, self.decimals)

    def spacing(self, largest: float) -> float:
        """Return the spacing of numbers with these digits near the largest of a column.

        Numbers have either a fixed number of decimals or of significant digits. The coarser of the two
        spacings is the right one in both cases: with fixed decimals, the largest number has the most digits;
        with fixed digits, the smallest one has the most decimals.
        """
        as_stored = float(np.spacing(largest)) * (_FLOAT32_SPACING if self.is_float32 else 1.0)
        return max(as_stored, self._decimal_spacing(largest))

    def _decimal_spacing(self, value: float) -> float:
        fixed = 10.0**-self.decimals
        if value == 0.0:
            return fixed
        magnitude = min(math.floor(math.log10(abs(value))), self.magnitude)
        return max(fixed, 10.0 ** (magnitude - self.significant + 1))


OF_DOUBLES = Digits(decimals=400, significant=17, is_float32=False)
"""The digits of numbers that are not rounded."""


def largest_finite(values: Array) -> float:
    """max |v| of the finite ones of values (n,)."""
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))


def digits_of(values: Array) -> Digits | None:
    """Return how values (n,) are rounded; None where a few different ones, or equal steps, do not show it."""
    finite = values[np.isfinite(values)]
    sample = np.unique(finite[:: max(1, len(finite) // SAMPLES)])
    if len(sample) < _FEWEST_VALUES:
        return None
    numbers = [Decimal(repr(value)).normalize() for value in sample.tolist() if value]
    significant = max(len(number.as_tuple().digits) for number in numbers)
    full = (number for number in numbers if len(number.as_tuple().digits) == significant)
    found = Digits(
        max(_decimals(number) for number in numbers),
        significant,
        is_float32=False,
        magnitude=max(number.adjusted() for number in full),
    )
    if _are_even(finite, 10.0**-found.decimals):
        return None
    with np.errstate(over="ignore"):
        off = np.abs(sample - sample.astype(np.float32))
        is_float32 = all(
            rounding <= 0.5 * found._decimal_spacing(value)
            or repr(value) == repr(float(str(np.float32(value))))
            for value, rounding in zip(sample.tolist(), off.tolist(), strict=True)
        )
    return replace(found, is_float32=is_float32)


def written_digits(cells: Sequence[str]) -> Digits | None:
    """Return how numbers with as many decimals each are rounded; None where no final zero shows the format.

    Programs that write each number with as few digits as it needs end none with a zero, but for "2.0".
    """
    decimals = {len(found[1]) if (found := _FIXED.fullmatch(cell)) else 0 for cell in cells}
    if len(decimals) != 1 or 0 in decimals or not any(cell.endswith("0") for cell in cells):
        return None
    return replace(OF_DOUBLES, decimals=decimals.pop())


def _are_even(values: Array, unit: float) -> bool:
    """Whether values (n,) have equal steps, except by a slow quantity that is rounded to a unit.

    Most values of that equal the one before, and the others differ from it by one unit.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        steps, rounding = np.diff(values), _EQUAL * np.spacing(largest_finite(values))
        off = np.abs(steps - np.median(steps))
        if np.mean(off <= rounding) < _MOST:
            return False
        moved = off[off > rounding]
        is_slow = np.median(steps) == 0.0 and np.mean(np.abs(moved - unit) <= rounding) >= _MOST
    return not (len(moved) and is_slow)


def _decimals(number: Decimal) -> int:
    exponent = number.as_tuple().exponent
    assert isinstance(exponent, int)  # the numbers are finite
    return -exponent


def are_doubles(stamps: Sequence[Stamp]) -> bool:
    """Whether decimal stamps are doubles that were printed in full, with 17 significant digits."""
    most = 0
    for stamp in map(Decimal, stamps[:SAMPLES]):
        digits = len(stamp.as_tuple().digits)
        value = float(stamp)
        if digits > OF_DOUBLES.significant or stamp not in (Decimal(repr(value)), Decimal(f"{value:.17g}")):
            return False
        most = max(most, digits)
    return most == OF_DOUBLES.significant


def since_first(stamps: Sequence[Stamp]) -> Array:
    """Return stamps (n,), minus the first, rounded once."""
    with localcontext(prec=_DECIMAL_DIGITS):
        return np.array([float(stamp - stamps[0]) for stamp in stamps])


def stamp_spacing(stamps: Sequence[Stamp]) -> float:
    """Return the resolution of decimal stamps; 0 where they are even, or coarser than their digits allow.

    Stamps such as 0, 0.1, 0.2 or 0, 0.25, 1 are the times that they stand for; others, such as 0, 0.033,
    0.067, are rounded to their last digit.
    """
    first = stamps[:SAMPLES]
    with localcontext(prec=_DECIMAL_DIGITS):
        decimals = max((_decimals(Decimal(stamp).normalize()) for stamp in first), default=0)
        steps = [
            int((Decimal(after) - Decimal(before)).scaleb(decimals)) for before, after in pairwise(first)
        ]
    is_even = len(set(steps)) <= 1
    is_coarse = math.gcd(*steps) ** len(steps) > _CHANCE
    return 0.0 if is_even or is_coarse else 10.0**-decimals


_FIXED = re.compile(r"[+-]?\d+\.(\d{2,})")
_DATE = re.compile(
    r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))[T ](\d\d):(\d\d):(\d\d(?:\.\d+)?)(?:Z|([+-])(\d\d):?(\d\d))?"
)


def iso_seconds(text: str) -> Decimal | None:
    """Return a date and time of ISO 8601, or of the day of the year, in s since 1970; None for other text."""
    found = _DATE.fullmatch(text.strip())
    if found is None:
        return None
    year, month, day, of_year, hour, minute, second, sign, hours, minutes = found.groups()
    try:
        first = (
            date(int(year), 1, 1).toordinal()
            if of_year
            else date(int(year), int(month), int(day)).toordinal()
        )
    except ValueError:
        return None
    days = first + (int(of_year) - 1 if of_year else 0) - date(1970, 1, 1).toordinal()
    offset = int(f"{sign}1") * (60 * int(hours) + int(minutes)) if sign else 0
    return 60 * Decimal(24 * 60 * days + 60 * int(hour) + int(minute) - offset) + Decimal(second)
