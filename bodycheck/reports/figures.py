"""The data behind the report's plots, as plain numbers; how they are drawn is the page's business."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.bounds import floor_of
from bodycheck.reports.case import CaseResult, Subject
from bodycheck.reports.findings import MethodKey, cases_by_method, key_of, shown_case
from bodycheck.reports.measures import SERIES_SCALES
from bodycheck.reports.page.front import ERRORS, Cost
from bodycheck.reports.tables import ABSOLUTE
from bodycheck.reports.wording import number

LINE_POINTS = 200  # more could not be told apart on a screen, and would make the page heavy
_FIRST_MEASURES = ("energy_drift", "angular_momentum_drift", "orientation_error_rad")
_ENGINE_COLOURS = 8

MARKERS = {
    "circle": "M14 6a4 4 0 1 0 8 0a4 4 0 1 0-8 0z",
    "square": "M14.5 2.5h7v7h-7z",
    "diamond": "M18 1l5 5-5 5-5-5z",
    "triangle-up": "M18 1l4.6 8.5h-9.2z",
    "triangle-down": "M18 11l4.6-8.5h-9.2z",
    "cross": "M16.5 1.5h3v3h3v3h-3v3h-3v-3h-3v-3h3z",
    "x": "M15.2 1L18 3.8 20.8 1 23 3.2 20.2 6 23 8.8 20.8 11 18 8.2 15.2 11 13 8.8 15.8 6 13 3.2z",
    "star": "M18 .4l1.7 3.7 4 .5-3 2.7.8 4L18 9.300l-3.500 2 .8-4-3-2.700 4-.5z",
    "pentagon": "M18 1.200l4.800 3.500-1.800 5.600h-6L13.200 4.700z",
}
"""Marker -> its outline in a box of 36 x 12, for the legend."""

DASHES = ("solid", "7 3", "2 3", "7 3 2 3", "13 4")
"""No two of the 45 pairs of marker and dash are alike: their numbers have no common divisor."""


@dataclass(frozen=True)
class Style:
    """How a method is drawn: one colour an engine, one marker and dash a method."""

    number: int
    name: str
    colour: int
    marker: str
    dash: str

    @property
    def outline(self) -> str:
        """The marker as an SVG path."""
        return MARKERS[self.marker]


def styles(keys: Iterable[MethodKey]) -> dict[MethodKey, Style]:
    """Return the style of each method, in the order of the run."""
    ordered = list(dict.fromkeys(keys))
    engines = list(dict.fromkeys(engine for engine, _ in ordered))
    markers = list(MARKERS)
    return {
        (engine, method): Style(
            number=i,
            name=f"{engine}:{method}",
            colour=engines.index(engine) % _ENGINE_COLOURS,
            marker=markers[i % len(markers)],
            dash=DASHES[i % len(DASHES)],
        )
        for i, (engine, method) in enumerate(ordered)
    }


def plot_data(
    subject: Subject,
    cases: Sequence[CaseResult],
    method_rows: Iterable[Mapping[str, Any]],
    drawn: Mapping[MethodKey, Style],
    at_s: float | None,
) -> dict[str, Any]:
    """Return what the plots of one scenario show.

    cases, method_rows: all of the scenario; drawn: the styles, whose numbers stand under "m"; at_s: the step
    at which drifts are shown over time. Values have 4 digits or more: they are drawn, not read.
    """
    index = {key: style.number for key, style in drawn.items()}
    by_method = cases_by_method(cases).get(subject.scenario.name, {})
    standing = ((index[key], shown_case(own, at_s)) for key, own in by_method.items())
    shown = {m: case for m, case in standing if case is not None}
    return {
        "errors": [
            {
                "name": error,
                "floor": _rounded(floor_of(subject.columns, error)),
                "fits": _fits(method_rows, error, index),
            }
            for error in ERRORS
        ],
        "t": [_rounded(t) for t in thinned_times(subject.times)],
        "drifts": _drifts(subject, shown, _growths(method_rows, index)),
        "missing": [_mark(m, case) for m, case in shown.items() if not case.ok],
        "ranks": _ranks(cases, drawn),
        "points": [_point(index[key_of(case.columns)], case) for case in cases if case.ok],
        "faults": [_mark(index[key_of(case.columns)], case) for case in cases if not case.ok],
    }


def _drifts(
    subject: Subject, shown: Mapping[int, CaseResult], growths: Mapping[str, Mapping[int, str]]
) -> list[dict[str, Any]]:
    """Return every measure over time that some method has: its name, one line a method, how it grows."""
    measures = dict.fromkeys((*_FIRST_MEASURES, *(name for case in shown.values() for name in case.series)))
    drifts = []
    for measure in measures:
        scale = getattr(subject.scales, SERIES_SCALES[measure]) if measure in SERIES_SCALES else 1.0
        name = measure if scale > 0.0 else f"{measure}_abs, {ABSOLUTE[measure]}"
        lines = {
            m: packed_line(case.series[measure] / (scale or 1.0))
            for m, case in shown.items()
            if measure in case.series
        }
        if lines:
            drifts.append({"name": name, "lines": lines, "growth": growths.get(measure, {})})
    return drifts


def _growths(rows: Iterable[Mapping[str, Any]], index: Mapping[MethodKey, int]) -> dict[str, dict[int, str]]:
    """Return by measure and method how it grows with time, in words, where that shows."""
    growths: dict[str, dict[int, str]] = {}
    for row in rows:
        if words := growth_words(row):
            growths.setdefault(row["quantity"], {})[index[key_of(row)]] = words
    return growths


def growth_words(row: Mapping[str, Any]) -> str:
    """Return the kind of growth of a row of methods.csv and its exponent, "" where it says nothing."""
    kind = row["growth"]
    if not isinstance(kind, str):
        return ""
    # of these two an exponent of t is no law
    return kind if kind in ("bounded", "exponential") else f"{kind}, t^{number(row['growth_exponent'], 3)}"


def packed_line(values: Array) -> str | float:
    """Return a thinned line as the base64 of its float32 values, low byte first, or a constant one's value.

    That is half as long as decimals, and plots are most of the page.
    """
    line = np.minimum(thinned_maxima(values), np.finfo(np.float32).max).astype("<f4")
    return _rounded(line[0]) if np.all(line == line[0]) else b64encode(line.tobytes()).decode()


def thinned_times(t_s: Array) -> Array:
    """Return the last time of each bucket of samples, of which there are at most LINE_POINTS."""
    ends = np.append(_bucket_starts(len(t_s))[1:], len(t_s)) - 1
    return np.asarray(t_s[ends])


def thinned_maxima(values: Array) -> Array:
    """Return the largest value of each bucket, so that no peak is lost."""
    return np.asarray(np.maximum.reduceat(values, _bucket_starts(len(values))))


def _bucket_starts(samples: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    return np.arange(0, samples, -(-samples // LINE_POINTS), dtype=np.intp)


def _point(m: int, case: CaseResult) -> dict[str, Any]:
    columns = case.columns
    point: dict[str, Any] = {
        "m": m,
        "dt": case.dt_s,
        "tolerance": case.setting.tolerance,
        "errors": [_rounded(columns[error]) if error in columns else None for error in ERRORS],
    }
    if "cpu_s" in columns:
        point["cpu"] = [_rounded(columns[name]) for name in ("cpu_s_low", "cpu_s", "cpu_s_high")]
        point["stepping"] = columns["stepping"]
        if "ns_per_step" in columns:
            point["ns"] = _rounded(columns["ns_per_step"])
    return point


def _fits(
    rows: Iterable[Mapping[str, Any]], error: str, index: Mapping[MethodKey, int]
) -> dict[int, list[float]]:
    """Return the order and the floor of each method that has an order of this error."""
    return {
        index[key_of(row)]: [_rounded(row["order"]), _rounded(row["floor"])]
        for row in rows
        if row["quantity"] == error and row["order"] == row["order"]
    }


def _mark(m: int, case: CaseResult) -> dict[str, Any]:
    return {
        "m": m,
        "dt": case.dt_s,
        "tolerance": case.setting.tolerance,
        "outcome": case.columns["outcome"],
        "message": case.columns["message"],
    }


def overall_data(
    found: Mapping[str, Mapping[MethodKey, Sequence[Cost]]], drawn: Mapping[MethodKey, Style]
) -> list[dict[str, Any]]:
    """Return what the plot over all scenarios shows: for each error the costs of every method.

    found: error -> method -> its costs. A method that keeps no error in most of its scenarios is missing from
    the lines and told apart.
    """
    return [
        {
            "name": error,
            "points": [
                _cost_point(drawn[cost.key].number, cost) for own in of_error.values() for cost in own
            ],
            "faults": [
                {"m": style.number, "message": _why_missing(of_error.get(key, ()))}
                for key, style in drawn.items()
                if not any(math.isfinite(cost.median) for cost in of_error.get(key, ()))
            ],
        }
        for error, of_error in found.items()
    ]


def _cost_point(m: int, cost: Cost) -> dict[str, Any]:
    seconds = (cost.low, cost.median, cost.high)
    return {
        "m": m,
        "error": cost.target,
        "cost": [_rounded(s) if math.isfinite(s) else None for s in seconds],
        "kept": cost.kept,
        "scenarios": cost.scenarios,
    }


def _why_missing(own: Sequence[Cost]) -> str:
    if not own:
        return "not measured: no case ended well, or no error of this kind"
    coarsest = own[0]
    return f"keeps {coarsest.target:g} in {coarsest.kept} of {coarsest.scenarios} scenarios"


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def coinciding(cases: Sequence[CaseResult]) -> list[list[MethodKey]]:
    """Return the groups of methods whose orientation errors are equal to 3 digits at every step.

    Their lines lie on top of one another. Methods with fewer than two errors are left out.
    """
    errors: dict[MethodKey, list[tuple[float, str]]] = {}
    for case in cases:
        if case.ok and case.dt_s is not None:
            error = f"{case.columns['orientation_error_rad']:.2e}"
            errors.setdefault(key_of(case.columns), []).append((case.dt_s, error))
    groups: dict[tuple[tuple[float, str], ...], list[MethodKey]] = {}
    for key, line in errors.items():
        if len(line) > 1:
            groups.setdefault(tuple(line), []).append(key)
    return [group for group in groups.values() if len(group) > 1]


def _ranks(cases: Sequence[CaseResult], drawn: Mapping[MethodKey, Style]) -> dict[int, int]:
    """Return how many engines lie on top of a line: it is drawn so much wider, to show beneath them."""
    ranks = {}
    for group in coinciding(cases):
        engines = list(dict.fromkeys(engine for engine, _ in group))
        for key in group:
            ranks[drawn[key].number] = len(engines) - 1 - engines.index(key[0])
    return ranks
