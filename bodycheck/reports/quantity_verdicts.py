"""What each judged quantity of a method comes to on a scenario, the most severe first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bodycheck.reports.convergence import ABOVE_FLOOR, LARGEST_ERROR
from bodycheck.reports.measures import MEASURES, ORIENTATION
from bodycheck.reports.wording import number, setting

_ORDER_SLACK = 0.5  # orders are whole: one that is this much lower, by its whole interval, is another
_WRONG = ("does-not-converge", "off", "lower-order")


@dataclass(frozen=True)
class QuantityVerdict:
    """A row of methods.csv: the verdict, and the error at the finest step or tolerance that ended well.

    state: the verdict, or lower-order where the order is surely below the expected one. at: the step or
    tolerance in words.
    """

    quantity: str
    state: str
    size: float | None = None
    at: str = ""
    floor: float = 0.0
    order: float | None = None
    expected_order: float | None = None

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> QuantityVerdict:
        """Return the verdict of a row of methods.csv, whose empty cells may be missing or NaN."""
        there = {name: value for name, value in row.items() if value == value and value is not None}
        high, expected = there.get("order_high"), there.get("expected_order")
        lower = high is not None and expected is not None and high < expected - _ORDER_SLACK
        return cls(
            there["quantity"],
            "lower-order" if lower and there["verdict"] == "converges" else there["verdict"],
            there.get("finest_error"),
            setting("tolerance" if "finest_tolerance" in there else "dt", _finest(there)),
            there.get("floor", 0.0),
            there.get("order"),
            expected,
        )

    @property
    def is_wrong(self) -> bool:
        """Whether the quantity speaks against the method."""
        return self.state in _WRONG

    @property
    def is_property(self) -> bool:
        """Whether it is what the engine's state holds, well above round-off: a design, not a fault."""
        return MEASURES[self.quantity].judged == "property" and (self.size or 0.0) > ABOVE_FLOOR * self.floor

    @property
    def is_open(self) -> bool:
        """Whether nothing could be told of it, and it is as large as the motion itself."""
        return self.state == "pre-asymptotic" and (self.size or 0.0) >= LARGEST_ERROR

    @property
    def amount(self) -> str:
        """The size with its unit, and the step: "0.98 of its scale at dt 0.001 s"."""
        if self.size is None:
            return "not measured"
        unit = (
            "rad" if self.quantity == ORIENTATION else "of its scale" if MEASURES[self.quantity].scale else ""
        )
        return " ".join(filter(None, (number(self.size, 3), unit, f"at {self.at}" if self.at else "")))

    @property
    def text(self) -> str:
        """The finding in words."""
        if self.state == "lower-order":
            orders = f"of order {number(self.order, 3)}, expected {number(self.expected_order)}"
            return f"{self.quantity} {orders}: {self.amount}"
        if self.is_property:
            order = "" if self.order is None else f", order {number(self.order, 2)}"
            return f"{self.quantity} {self.amount}{order} (the state is not normalised)"
        if self.state == "off":
            return f"{self.quantity} is off: {self.amount}"
        if self.is_open:
            return f"{self.quantity} cannot be judged: still {self.amount}"
        return f"{self.quantity} does not converge to the truth: {self.amount}"


def _finest(there: Mapping[str, Any]) -> float | None:
    return there.get("finest_dt_s", there.get("finest_tolerance"))


def most_severe(verdicts: Iterable[QuantityVerdict]) -> list[QuantityVerdict]:
    """Return those that speak against a method, the most severe first, and by their size."""
    wrong = [one for one in verdicts if one.is_wrong and MEASURES[one.quantity].judged == "limit"]
    return sorted(wrong, key=lambda one: (_WRONG.index(one.state), -(one.size or 0.0)))


def method_verdict(verdicts: Mapping[str, QuantityVerdict]) -> QuantityVerdict | None:
    """Return the verdict of a method on a scenario: of its quantities the most severe; None without any.

    Where none is wrong it is that of the orientation, unless another quantity could not be judged and is as
    large as the motion itself.
    """
    if wrong := most_severe(verdicts.values()):
        return wrong[0]
    open_ones = (one for one in verdicts.values() if one.is_open)
    return next(open_ones, verdicts.get(ORIENTATION))
