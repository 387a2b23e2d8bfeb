"""The picture in the README: time against error, one panel per problem, as an SVG for light and dark mode."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from html import escape

import pandas as pd

PICTURE = "work-precision.svg"

_PANELS = {"free": "No torque, 10 s", "constant world torque": "Constant world torque, 10 s"}

# in the order of the legend; colour-blind safe colours after Okabe and Ito (2008), for light and dark mode
_LINES = {
    "closed form": ("bodycheck, closed form with its set-up", "#009e73"),
    "Taylor": ("bodycheck, Taylor", "#1c86d1"),
    "heyoka Taylor": ("heyoka, Taylor", "#8592a0"),
    "reference rk4": ("bodycheck, RK4", "#e69f00"),
    "scipy DOP853": ("scipy, DOP853", "#cc79a7"),
    "MuJoCo rk4": ("MuJoCo, RK4", "#d55e00"),
}

_WIDTH, _HEIGHT = 900, 485
_PANEL_WIDTH, _PANEL_HEIGHT, _TOP = 370, 290, 110
_LEFTS = (70, 500)

_STYLE = """
  .card { fill: #ffffff } .grid { stroke: #e3e6ea } .frame { stroke: #8b949e; fill: none }
  text { fill: #24292f; font: 13px system-ui, sans-serif } .title { font-weight: 600 } .axis { fill: #57606a }
  @media (prefers-color-scheme: dark) {
    .card { fill: #0d1117 } .grid { stroke: #262c36 } text { fill: #e6edf3 } .axis { fill: #9198a1 }
  }
"""


def work_precision_picture(points: pd.DataFrame) -> str:
    """Return the picture of a table of points. A contender is drawn at the errors that it reached."""
    reached = points[points["time_s"].notna() & points["problem"].isin(_PANELS)]
    seconds = reached["time_s"]
    times = _decades(float(seconds.min()), float(seconds.max()))
    errors = _decades(float(reached["target_error"].min()), float(reached["target_error"].max()))
    drawn = [name for name in _LINES if name in set(reached["contender"])]
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" role="img">',
        "<title>Time to follow a tumbling body against the error that is kept</title>",
        f"<style>{_STYLE}</style>",
        f'<rect class="card" width="{_WIDTH}" height="{_HEIGHT}" rx="8"/>',
        *_legend(drawn),
    ]
    for left, (problem, title) in zip(_LEFTS, _PANELS.items(), strict=True):
        panel = reached[reached["problem"] == problem]
        lines += [f'<g transform="translate({left} {_TOP})">', *_axes(title, errors, times)]
        for name in drawn:
            line = panel[panel["contender"] == name].sort_values("target_error", ascending=False)
            places = [
                (_across(error, errors), _up(time, times))
                for error, time in zip(line["target_error"], line["time_s"], strict=True)
            ]
            lines += _curve(places, _LINES[name][1])
        lines.append("</g>")
    caption = (
        "Each tuned by the same search, timed in turn in one process; building and compiling not counted."
    )
    lines += [f'<text class="axis" x="{_LEFTS[0]}" y="{_HEIGHT - 14}">{caption}</text>', "</svg>", ""]
    return "\n".join(lines)


def _decades(least: float, most: float) -> range:
    """Return the exponents of ten that enclose both."""
    return range(math.floor(math.log10(least) + 1e-9), math.ceil(math.log10(most) - 1e-9) + 1)


def _across(error: float, decades: range) -> float:
    """Small errors are on the right: cost increases to the right."""
    return _PANEL_WIDTH * (decades[-1] - math.log10(error)) / (decades[-1] - decades[0])


def _up(seconds: float, decades: range) -> float:
    return _PANEL_HEIGHT * (decades[-1] - math.log10(seconds)) / (decades[-1] - decades[0])


def _legend(names: Iterable[str]) -> Iterator[str]:
    for place, name in enumerate(names):
        label, colour = _LINES[name]
        x, y = 70 + 310 * (place % 3), 30 + 24 * (place // 3)
        yield f'<path d="M{x} {y}h26" stroke="{colour}" stroke-width="2.5"/>'
        yield f'<circle cx="{x + 13}" cy="{y}" r="3.5" fill="{colour}"/>'
        yield f'<text x="{x + 34}" y="{y + 4.5}">{escape(label)}</text>'


def _axes(title: str, errors: range, times: range) -> Iterator[str]:
    yield f'<text class="title" y="-12">{escape(title)}</text>'
    for exponent in times:
        y = _up(10.0**exponent, times)
        yield f'<path class="grid" d="M0 {y:.1f}h{_PANEL_WIDTH}"/>'
        yield f'<text class="axis" x="-8" y="{y + 4.5:.1f}" text-anchor="end">{_duration(exponent)}</text>'
    for exponent in errors:
        x = _across(10.0**exponent, errors)
        yield f'<path class="grid" d="M{x:.1f} 0v{_PANEL_HEIGHT}"/>'
        if (exponent - errors[0]) % 2 == 0:
            yield (
                f'<text class="axis" x="{x:.1f}" y="{_PANEL_HEIGHT + 18}" text-anchor="middle">'
                f'10<tspan dy="-5" font-size="10">{exponent}</tspan></text>'
            )
    yield f'<rect class="frame" width="{_PANEL_WIDTH}" height="{_PANEL_HEIGHT}"/>'
    middle = _PANEL_WIDTH / 2
    yield (
        f'<text class="axis" x="{middle:.0f}" y="{_PANEL_HEIGHT + 38}" text-anchor="middle">'
        "error at the end: rad, and relative in angular velocity</text>"
    )


def _duration(exponent: int) -> str:
    """Return 10^exponent seconds in words."""
    unit, factor = next(
        (unit, factor)
        for unit, factor in (("s", 0), ("ms", -3), ("µs", -6), ("ns", -9))
        if exponent >= factor
    )
    return f"{10 ** (exponent - factor)} {unit}"


def _curve(places: list[tuple[float, float]], colour: str) -> Iterator[str]:
    if places:
        path = " L".join(f"{x:.1f} {y:.1f}" for x, y in places)
        yield f'<path d="M{path}" fill="none" stroke="{colour}" stroke-width="2.5" stroke-linejoin="round"/>'
    for x, y in places:
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>'
