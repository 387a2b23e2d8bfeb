"""Error against step of both runs, over each other, for the methods whose accuracy changed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bodycheck._util.formatting import number, step
from bodycheck.reports.comparison.change import Change
from bodycheck.reports.comparison.compare import Comparison
from bodycheck.reports.comparison.headlines import lines_of
from bodycheck.reports.measurement.measures import MEASURES, ORIENTATION
from bodycheck.reports.run_files.run_tables import StudyKey, Tables, study_key

_MAX_OVERLAYS = 12
_KINDS = ("accuracy", "order", "verdict", "outcome", "stability")
_LEFT, _RIGHT, _TOP, _BOTTOM = 46.0, 312.0, 10.0, 150.0
_MAX_TICKS = 5
_MIN_DECADES = 0.5  # of an axis: a smaller range is widened, so that it does not look like a change
_MARGIN = 0.04  # of an axis, so that no mark covers a label

Point = tuple[float, float]
_Key = tuple[StudyKey, str]
"""Scenario and method, and a quantity."""


@dataclass(frozen=True)
class Curve:
    """One run's errors in an SVG picture: a path, and (x, y, text) of each case."""

    path: str
    points: tuple[tuple[str, str, str], ...]
    version: str


@dataclass(frozen=True)
class Overlay:
    """The errors of one method in both runs, and their largest change.

    x_ticks, y_ticks: (position, text) along each axis.
    """

    change: Change
    quantity: str
    before: Curve
    after: Curve
    x_ticks: tuple[tuple[str, str], ...]
    y_ticks: tuple[tuple[str, str], ...]


def overlays_of(comparison: Comparison) -> tuple[list[Overlay], list[Overlay]]:
    """Return the overlay that each line about the comparison names, and those of the other changes.

    One per method, scenario and quantity that changed; the others as listed, at most twelve together.
    """
    largest: dict[_Key, Change] = {}
    for change in _listed(comparison.changes):
        largest.setdefault(_key(change), change)
    named = dict.fromkeys(key for line in lines_of(comparison) if (key := _key(line.main)) in largest)
    drawn = {
        key: made
        for key in (*named, *(key for key in largest if key not in named))
        if (made := _overlay(comparison, *key, largest[key])) is not None
    }
    shown = [*drawn.items()][:_MAX_OVERLAYS]
    return [one for key, one in shown if key in named], [one for key, one in shown if key not in named]


def _listed(changes: Iterable[Change]) -> list[Change]:
    """Return the changes with an error against the step, failing ones first, then the largest."""
    ranks = ("worse", "missing", "improved", "moved")
    plotted = [one for one in changes if one.kind in _KINDS and one.status in ranks and one.scenario]
    return sorted(plotted, key=lambda one: (ranks.index(one.status), -one.size))


def _key(change: Change) -> _Key:
    word = change.quantity.rpartition(" ")[2]  # "order of energy_drift"
    return (change.scenario or "", change.engine, change.method), word if word in MEASURES else ORIENTATION


def _overlay(comparison: Comparison, key: StudyKey, quantity: str, change: Change) -> Overlay | None:
    """Return None where neither run has two steps to connect."""
    points = [_points(tables, key, quantity) for tables in (comparison.before, comparison.after)]
    all_points = [*points[0], *points[1]]
    if max(map(len, points)) < 2:
        return None
    x_range, y_range = _range([x for x, _ in all_points]), _range([y for _, y in all_points])
    curves = [
        _curve(found, x_range, y_range, tables.manifest["engines"].get(change.engine, {}).get("version", ""))
        for found, tables in zip(points, (comparison.before, comparison.after), strict=True)
    ]
    return Overlay(
        *(change, quantity, curves[0], curves[1]),
        x_ticks=tuple((f"{_at(v, x_range, _LEFT, _RIGHT):.1f}", number(v, 1)) for v in _ticks(x_range)),
        y_ticks=tuple((f"{_at(v, y_range, _BOTTOM, _TOP):.1f}", number(v, 1)) for v in _ticks(y_range)),
    )


def _points(tables: Tables, key: StudyKey, quantity: str) -> list[Point]:
    """Return the step or tolerance and the error of each case that ended well, the coarsest first."""
    rows = (case.columns for case in tables.cases if case.ok)
    found = [
        (row.get("dt_s") or row.get("tolerance"), row.get(quantity)) for row in rows if study_key(row) == key
    ]
    return sorted([(x, y) for x, y in found if x and y and y > 0.0], reverse=True)


def _range(values: Sequence[float]) -> tuple[float, float]:
    """Return the ends of a logarithmic axis, in decades."""
    low, high = math.log10(min(values)), math.log10(max(values))
    wider = max(_MARGIN * (high - low), 0.5 * (_MIN_DECADES - (high - low)))
    return low - wider, high + wider


def _ticks(ends: tuple[float, float]) -> list[float]:
    """Return the powers of ten on an axis, at most five; also 2 and 5 of each decade where there are few."""
    powers = range(math.floor(ends[0]), math.floor(ends[1] + 1e-9) + 1)
    fine = [float(f"{m}e{e}") for e in powers for m in (1, 2, 5)]
    visible = [value for value in fine if ends[0] - 1e-9 <= math.log10(value) <= ends[1] + 1e-9]
    powers_of_ten = [value for value in visible if f"{value:e}".startswith("1.0")]
    return visible if len(powers_of_ten) < 2 else powers_of_ten[:: -(-len(powers_of_ten) // _MAX_TICKS)]


def _at(value: float, ends: tuple[float, float], start: float, stop: float) -> float:
    return start + (stop - start) * (math.log10(value) - ends[0]) / (ends[1] - ends[0])


def _curve(
    points: Sequence[Point], x_range: tuple[float, float], y_range: tuple[float, float], version: str
) -> Curve:
    positions = [
        (f"{_at(x, x_range, _LEFT, _RIGHT):.1f}", f"{_at(y, y_range, _BOTTOM, _TOP):.1f}") for x, y in points
    ]
    labels = [f"step {step(x)} s: {number(y, 4)}" for x, y in points]
    return Curve(
        path="".join(f"{'L' if k else 'M'}{x} {y}" for k, (x, y) in enumerate(positions)),
        points=tuple((x, y, text) for (x, y), text in zip(positions, labels, strict=True)),
        version=version,
    )
