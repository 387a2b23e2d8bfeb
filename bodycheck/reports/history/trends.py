"""The speed and the error of each method over the nightly runs, as small SVG lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.regression import Speeds
from bodycheck.reports.history.step_detection import Key, Series, Step

_WIDTH, _HEIGHT, _EDGE = 240, 32, 4
_LEAST_HALF_RANGE = 0.05  # decades: a change of less than about 10 % looks flat


@dataclass(frozen=True)
class Line:
    """A line in an SVG picture of width x height; zero: the median level; marks: (x, y) of detected steps."""

    width: int
    height: int
    path: str
    zero: str
    marks: tuple[tuple[str, str], ...]
    tonight: str
    label: str


@dataclass(frozen=True)
class Trend:
    """The lines of one method; None if not measured."""

    engine: str
    method: str
    speed: Line | None
    error: Line | None


def trends_of(speeds: Speeds, errors: Series) -> list[Trend]:
    """Return one row per method that was measured in any nightly run."""
    times = _lines(speeds.series, speeds.steps, "time")
    off = _lines(errors, {}, "error")
    return [Trend(*key, times.get(key), off.get(key)) for key in sorted({**times, **off})]


def _lines(series: Series, steps: Mapping[Key, Sequence[Step]], what: str) -> dict[Key, Line]:
    columns = zip(series.methods, series.decades.T, strict=True)
    return {key: _line(decades, steps.get(key, ()), what) for key, decades in columns}


def _line(decades: Array, steps: Sequence[Step], what: str) -> Line:
    """Return the line of decades (nights,); a run without a value interrupts it."""
    nights = len(decades)
    x = np.linspace(_EDGE, _WIDTH - _EDGE, nights) if nights > 1 else np.array([_WIDTH / 2.0])
    half = max(_LEAST_HALF_RANGE, float(np.nanmax(np.abs(decades))))
    middle = _HEIGHT / 2.0
    y = middle - (middle - _EDGE) * decades / half
    there = ~np.isnan(decades)
    drawn, pen_up = [], True
    for place in range(nights):
        if there[place]:
            drawn.append(f"{'M' if pen_up else 'L'}{x[place]:.1f} {y[place]:.1f}")
        pen_up = not there[place]
    factor = number(10.0 ** decades[-1], 3) if there[-1] else ""
    told = [(f"{x[step.first]:.1f}", f"{y[step.first]:.1f}") for step in steps if there[step.first]]
    return Line(
        width=_WIDTH,
        height=_HEIGHT,
        path="".join(drawn),
        zero=f"M0 {middle:g}H{_WIDTH}",
        marks=tuple(told),
        tonight=f"× {factor}" if factor else "",
        label=f"{what} relative to the median of {int(there.sum())} runs, latest {factor or 'not measured'}",
    )
