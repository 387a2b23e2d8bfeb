"""The verdicts in words, and the verdicts of a method's judged quantities, the most severe first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from bodycheck._util.formatting import number, setting
from bodycheck.reports.measurement.convergence import ABOVE_FLOOR, LARGEST_ERROR, LARGEST_ROUND_OFF
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION


@dataclass(frozen=True)
class CellState:
    """A state of a cell: its symbol, word and meaning, and the tint that it shares with similar states."""

    symbol: str
    word: str
    meaning: str
    tint: str


STATES = {
    "converges": CellState("✓", "converges", "finer steps converge to the truth in every quantity", "good"),
    "at-floor": CellState(
        "≈", "at floor", "all errors are at round-off or within the truth's bound", "floor"
    ),
    "at-precision-floor": CellState(
        "≈",
        "at precision floor",
        "the errors are the round-off of the method's own arithmetic: finer steps do not reduce them",
        "floor",
    ),
    "exact": CellState("=", "exact", "a method without steps, within the truth's bound", "floor"),
    "pre-asymptotic": CellState(
        "…", "pre-asymptotic", "the errors are too large or too irregular to show an order", "open"
    ),
    "lower-order": CellState(
        "↓",
        "lower order",
        "the error decreases, but at a lower order than the method's theoretical one",
        "open",
    ),
    "too-few-points": CellState("?", "too few points", "fewer than four steps have a usable error", "open"),
    "chaotic": CellState("≋", "chaotic", "nearby motions diverge too fast for a meaningful error", "open"),
    "does-not-converge": CellState(
        "✗",
        "does not converge",
        "finer steps converge to something other than the truth, or a step is wrong that the others exclude",
        "bad",
    ),
    "error-grows": CellState(
        "✗",
        "error grows",
        "finer steps increase the error, more than the method's arithmetic explains",
        "bad",
    ),
    "off": CellState("✗", "no steps, off", "a method without steps, outside the truth's bound", "bad"),
    "unstable": CellState(
        "▲", "unstable", "not finite, not a rotation, or over 100 times the true kinetic energy", "fault"
    ),
    "failed": CellState("!", "failed", "the engine raised an error", "fault"),
    "timeout": CellState("!", "timeout", "the case exceeded its time limit", "fault"),
    "invalid": CellState("≠", "invalid", "the engine's parameters differ from those it was given", "fault"),
    "unsupported": CellState("○", "unsupported", "the method cannot represent the scenario", "none"),
}
"""The verdicts of methods.csv, the outcomes other than ok, and the states derived from them."""

FAULTS = ("invalid", "failed", "timeout", "unstable")
"""The outcomes of cases that did not end well, the most severe first."""

UNDECIDED = 1
"""The severity of a verdict that is neither good nor bad."""

_SEVERITIES = {"good": 0, "floor": 0, "open": UNDECIDED, "none": UNDECIDED, "bad": 2, "fault": 3}
"""Tint -> severity of the states of that tint."""


def severity(word: str) -> int:
    """Return the severity of a verdict: 0 good, 1 undecided, 2 wrong, 3 broken; 1 for an unknown word."""
    return _SEVERITIES[STATES[word].tint] if word in STATES else UNDECIDED


_ORDER_SLACK = 0.5  # orders are integers: an interval that ends this far below one excludes it
_WRONG = ("does-not-converge", "error-grows", "off", "lower-order")


def amount_of(quantity: str, size: float, digits: int = 4) -> str:
    """Return a size with its unit, as in "3.108 rad" or "0.98 of its scale"."""
    return number(size, digits) + unit_of(quantity)


def unit_of(quantity: str) -> str:
    """Return what stands after a size, with a space: " rad", " of its scale" or nothing."""
    return " rad" if quantity == ORIENTATION else " of its scale" if MEASURES[quantity].scale else ""


@dataclass(frozen=True)
class QuantityVerdict:
    """A row of methods.csv: the verdict, and the error of the case that shows it.

    state: the verdict, or lower-order where the order is certainly below the expected one. size: the error at
    the excluded step, or else at the finest step or tolerance that ended well. fineness, at: that step or
    tolerance, and as text; None and "" for a method without either. ratio: of the error at an excluded step
    to that which the other steps predict.
    """

    quantity: str
    state: str
    size: float | None = None
    fineness: float | None = None
    at: str = ""
    ratio: float | None = None
    floor: float = 0.0
    order: float | None = None
    expected_order: float | None = None

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> QuantityVerdict:
        """Return the verdict of a row of methods.csv; empty cells may be missing or None."""
        present = {name: value for name, value in row.items() if value is not None}
        high, expected = present.get("order_high"), present.get("expected_order")
        lower = high is not None and expected is not None and high < expected - _ORDER_SLACK
        return cls(
            present["quantity"],
            "lower-order" if lower and present["verdict"] == "converges" else present["verdict"],
            present.get("excluded_error", present.get("finest_error")),
            *_shown_setting(present),
            present.get("excluded_ratio"),
            present.get("floor", 0.0),
            present.get("order"),
            expected,
        )

    @property
    def is_wrong(self) -> bool:
        """Whether the quantity counts against the method."""
        return self.state in _WRONG

    @property
    def has_wrong_limit(self) -> bool:
        """Whether the method converges to something other than the truth, at all steps alike."""
        return self.state in ("does-not-converge", "off") and self.ratio is None

    @property
    def is_property(self) -> bool:
        """Whether it is a property of the engine's state, well above round-off: by design, not a fault."""
        return MEASURES[self.quantity].judged == "property" and (self.size or 0.0) > ABOVE_FLOOR * self.floor

    @property
    def is_open(self) -> bool:
        """Whether it is undecided and above round-off: nothing shows that finer steps reduce it."""
        undecided = self.state in ("pre-asymptotic", "too-few-points")
        above = (self.size or 0.0) > max(ABOVE_FLOOR * self.floor, LARGEST_ROUND_OFF)
        return undecided and above and MEASURES[self.quantity].judged == "limit"

    @property
    def amount(self) -> str:
        """The size with its unit, and the step, as in "0.98 of its scale at dt 0.001 s"."""
        if self.size is None:
            return "not measured"
        return amount_of(self.quantity, self.size, 3) + (f" at {self.at}" if self.at else "")

    @property
    def text(self) -> str:
        """The finding as text."""
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
        if self.state == "error-grows":
            return f"{self.quantity} grows with finer steps: {self.amount}"
        if self.ratio is not None:
            return (
                f"{self.quantity} {self.amount} is {number(self.ratio, 2)} times what the other steps predict"
            )
        return f"{self.quantity} does not converge to the truth: {self.amount}"


def _shown_setting(present: Mapping[str, Any]) -> tuple[float | None, str]:
    for control, name in (("dt", "excluded_dt_s"), ("dt", "finest_dt_s"), ("tolerance", "finest_tolerance")):
        if name in present:
            return present[name], setting(control, present[name])
    return None, ""


def most_severe(verdicts: Iterable[QuantityVerdict]) -> list[QuantityVerdict]:
    """Return the verdicts that count against a method, sorted by severity, then by size, descending."""
    wrong = [one for one in verdicts if one.is_wrong and MEASURES[one.quantity].judged == "limit"]
    return sorted(wrong, key=lambda one: (_WRONG.index(one.state), -(one.size or 0.0)))


def method_verdict(verdicts: Mapping[str, QuantityVerdict]) -> QuantityVerdict | None:
    """Return the verdict of a method on a scenario: the most severe of its quantities; None if it has none.

    Where none is wrong, return the largest undecided one, or that of the orientation if there is none. An
    undecided orientation counts before others, unless these are as large as the motion itself.
    """
    if wrong := most_severe(verdicts.values()):
        return wrong[0]
    orientation = verdicts.get(ORIENTATION)
    largest = max((one for one in verdicts.values() if one.is_open), key=_size, default=orientation)
    if largest is None or orientation is None:
        return largest
    counts = severity(orientation.state) < UNDECIDED or _size(largest) >= LARGEST_ERROR
    return largest if counts else orientation


def _size(verdict: QuantityVerdict) -> float:
    return verdict.size or 0.0
