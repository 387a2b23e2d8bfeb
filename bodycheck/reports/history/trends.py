"""The speed and the error of each method over the nightly runs, as small SVG lines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.archive import started_at
from bodycheck.reports.history.regression import Speeds
from bodycheck.reports.history.step_detection import Key, Series, Step

_WIDTH, _HEIGHT, _EDGE = 240, 32, 4
_MIN_HALF_RANGE = 0.05  # decades: a change of less than about 10 % looks flat


@dataclass(frozen=True)
class Line:
    """A line in an SVG picture of width x height; zero: the median level; marks: (x, y) of detected steps.

    releases: (x, text) where the version of the engine changed. size: of the newest value, in decades.
    """

    width: int
    height: int
    path: str
    zero: str
    marks: tuple[tuple[str, str], ...]
    releases: tuple[tuple[str, str], ...]
    size: float
    newest: str
    label: str


@dataclass(frozen=True)
class Trend:
    """The lines of one method; None if not measured."""

    engine: str
    method: str
    speed: Line | None
    error: Line | None

    @property
    def size(self) -> float:
        """How far the newest speed or error is from its median, in decades."""
        return max(line.size for line in (self.speed, self.error) if line is not None)


def trends_of(speeds: Speeds, errors: Series, versions: Sequence[Mapping[str, str]]) -> list[Trend]:
    """Return one row per method that was measured in any nightly run, those farthest from usual first.

    versions: of each engine in each nightly run, the oldest first.
    """
    times = _lines(speeds.series, speeds.steps, versions, "time")
    error_lines = _lines(errors, {}, versions, "error")
    rows = [Trend(*key, times.get(key), error_lines.get(key)) for key in sorted({**times, **error_lines})]
    return sorted(rows, key=lambda row: -row.size)


def dates_of(run_ids: Sequence[str]) -> list[tuple[str, str, str]]:
    """Return (x, SVG text-anchor, date) of the first and the last nightly run, given by their run ids."""
    first, last = (f"{started_at(run_id):%Y-%m-%d}" for run_id in (run_ids[0], run_ids[-1]))
    return (
        [("0", "start", first), (str(_WIDTH), "end", last)] if len(run_ids) > 1 else [("0", "start", first)]
    )


def release_changes(versions: Sequence[str | None]) -> list[tuple[int, str]]:
    """Return the places at which a version differs from the last known one, and "before -> after"."""
    found: list[tuple[int, str]] = []
    known: str | None = None
    for index, version in enumerate(versions):
        if version is not None and known is not None and version != known:
            found.append((index, f"{known} -> {version}"))
        known = version or known
    return found


def _lines(
    series: Series, steps: Mapping[Key, Sequence[Step]], versions: Sequence[Mapping[str, str]], quantity: str
) -> dict[Key, Line]:
    columns = zip(series.methods, series.decades.T, strict=True)
    return {
        key: _line(
            decades, steps.get(key, ()), release_changes([own.get(key[0]) for own in versions]), quantity
        )
        for key, decades in columns
    }


def _line(decades: Array, steps: Sequence[Step], releases: Sequence[tuple[int, str]], quantity: str) -> Line:
    """Return the line of decades (runs,); a run without a value interrupts it."""
    runs = len(decades)
    x = np.linspace(_EDGE, _WIDTH - _EDGE, runs) if runs > 1 else np.array([_WIDTH / 2.0])
    half = max(_MIN_HALF_RANGE, float(np.nanmax(np.abs(decades))))
    middle = _HEIGHT / 2.0
    y = middle - (middle - _EDGE) * decades / half
    measured = ~np.isnan(decades)
    drawn, pen_up = [], True
    for index in range(runs):
        if measured[index]:
            drawn.append(f"{'M' if pen_up else 'L'}{x[index]:.1f} {y[index]:.1f}")
        pen_up = not measured[index]
    factor = number(10.0 ** decades[-1], 3) if measured[-1] else ""
    marks = [(f"{x[step.first]:.1f}", f"{y[step.first]:.1f}") for step in steps if measured[step.first]]
    total = int(measured.sum())
    return Line(
        width=_WIDTH,
        height=_HEIGHT,
        path="".join(drawn),
        zero=f"M0 {middle:g}H{_WIDTH}",
        marks=tuple(marks),
        releases=tuple((f"{x[index]:.1f}", text) for index, text in releases),
        size=abs(float(decades[-1])) if measured[-1] else 0.0,
        newest=f"× {factor}" if factor else "",
        label=f"{quantity} relative to the median of {total} runs, latest {factor or 'not measured'}",
    )
