"""Every verdict in words, and what each judged quantity of a method comes to, the most severe first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bodycheck._util.formatting import number, setting
from bodycheck.reports.measurement.convergence import ABOVE_FLOOR, LARGEST_ERROR
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION


@dataclass(frozen=True)
class State:
    """What a cell can say: its symbol, its word, what it means, and the tint that it shares with others."""

    symbol: str
    word: str
    meaning: str
    tint: str


STATES = {
    "converges": State("✓", "converges", "ever finer steps lead to the truth, in every quantity", "good"),
    "at-floor": State("≈", "at floor", "all errors lie at round-off or at the truth's own bound", "floor"),
    "exact": State("=", "exact", "a method without steps, at the truth's own bound", "floor"),
    "pre-asymptotic": State(
        "…", "pre-asymptotic", "errors too large or too irregular for an order to show", "open"
    ),
    "lower-order": State(
        "↓", "lower order", "the error shrinks, at a lower order than the method has in theory", "open"
    ),
    "too-few-points": State("?", "too few points", "fewer than four steps with a usable error", "open"),
    "chaotic": State("≋", "chaotic", "nearby motions part too fast for an error to mean much", "open"),
    "does-not-converge": State(
        "✗", "does not converge", "ever finer steps lead to something else than the truth", "bad"
    ),
    "off": State("✗", "no steps, off", "a method without steps, above the truth's own bound", "bad"),
    "unstable": State(
        "▲", "unstable", "not finite, not a rotation, or 100 times the true kinetic energy", "fault"
    ),
    "failed": State("!", "failed", "the engine raised an error", "fault"),
    "timeout": State("!", "timeout", "the case took longer than it was given", "fault"),
    "invalid": State("≠", "invalid", "the engine held other parameters than it was given", "fault"),
    "unsupported": State("○", "unsupported", "the method cannot represent the scenario", "none"),
}
"""Every verdict of methods.csv and every outcome but ok, with words for what neither of them says."""

FAULTS = ("invalid", "failed", "timeout", "unstable")
"""The outcomes of cases that did not end well, the gravest first."""

UNDECIDED = 1
"""The severity of a verdict that neither confirms nor accuses."""

_SEVERITIES = {"good": 0, "floor": 0, "open": UNDECIDED, "none": UNDECIDED, "bad": 2, "fault": 3}
"""Tint -> how severe the states of that tint are."""


def severity(word: str) -> int:
    """Return how severe a verdict is: 0 sound, 1 undecided, 2 wrong, 3 broken; an unknown word: 1."""
    return _SEVERITIES[STATES[word].tint] if word in STATES else UNDECIDED


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
