"""The measures that a gate can bound: columns of results.csv, values of the tables of methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from bodycheck.reports.measurement.measures import MEASURES, QUANTITIES
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.probes.laws import LAW_NAMES

Source: TypeAlias = Literal["results", "methods", "stability", "laws"]

_SPEEDS = ("cpu_s", "ns_per_step", "relative_cpu")
_COUNTS = ("steps", "rhs_evaluations")
UNCOMPARED = ("successive_difference_rad", "cpu_s", "ns_per_step", *_COUNTS)
"""Columns of results.csv that a gate can bound, but by which runs are not compared."""
_COLUMNS = (
    *(column for measure in MEASURES.values() for column in measure.columns),
    *("successive_difference_rad", *_SPEEDS, *_COUNTS),
)
_NOT_VERDICTS = ("failed", "timeout", "invalid", "unsupported", "inconsistent")
_VERDICTS = tuple(state for state in STATES if state not in _NOT_VERDICTS)
_OUTCOMES = ("ok", "unstable", "failed", "timeout", "unsupported", "invalid")
_GROWTHS = ("bounded", "sqrt", "linear", "quadratic", "exponential")


@dataclass(frozen=True)
class Measure:
    """The table, the column and the quantity that a gate reads, and the words that may stand there.

    choices: empty if the values are numbers. in_decades: whether two values are compared by their ratio, as
    errors and times are, or by their difference, as orders are. is_speed: whether the value exists only where
    processor time was measured.
    """

    source: Source
    column: str
    quantity: str | None = None
    choices: tuple[str, ...] = ()
    in_decades: bool = True
    is_speed: bool = False


def measure_of(name: str) -> Measure:
    """Return the measure of that name; raise ValueError with the available names if there is none."""
    if name in _COLUMNS:
        return Measure("results", name, in_decades=name not in _COUNTS, is_speed=name in _SPEEDS)
    head, _, quantity = name.partition(".")
    match head, quantity:
        case "outcome", "":
            return Measure("results", "outcome", choices=_OUTCOMES)
        case "stability", "dt_stable_s":
            return Measure("stability", "dt_stable_s")
        case "law", _ if quantity in LAW_NAMES:
            return Measure("laws", "size", quantity)
        case "verdict", "":
            return Measure("methods", "verdict", choices=_VERDICTS)
        case "verdict", _ if quantity in QUANTITIES:
            return Measure("methods", "verdict", quantity, choices=_VERDICTS)
        case "growth", _ if quantity in QUANTITIES:
            return Measure("methods", "growth", quantity, choices=_GROWTHS)
        case "order", _ if quantity in QUANTITIES:
            return Measure("methods", "order", quantity, in_decades=False)
    raise ValueError(
        f"unknown measure {name!r} (available: the columns that bodycheck list measures shows, "
        f"{', '.join(_SPEEDS)}, outcome, verdict, stability.dt_stable_s, order., verdict. or growth. "
        f"followed by one of {', '.join(QUANTITIES)}, and law. followed by one of {', '.join(LAW_NAMES)})"
    )
