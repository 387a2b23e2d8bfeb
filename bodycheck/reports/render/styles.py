"""How methods and columns are shown everywhere: colour per engine, marker and dash per method, headings.

Lines that cannot be distinguished are drawn as one, with the names of all.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar
from zlib import crc32

import numpy as np

from bodycheck.adapters.engine_names import REFERENCE
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.run_tables import MethodKey
from bodycheck.reports.templating import asset

_COLOURS = {"mujoco": 0, "pybullet": 1, "dart": 2, REFERENCE: 3}
"""Engine -> the number of its colour, the same in every report, figure and page."""

KNOWN_COLOURS = len(_COLOURS)
"""The number of the first colour that is not an engine's own."""

_ON_WHITE = dict(re.findall(r"--([\w-]+): (#\w+)", asset("templates/report.css").partition("@media")[0]))

COLOURS = tuple(_ON_WHITE[f"engine-{number}"] for number in range(8))
"""The colours of engines on white, by number, as pages have them."""

TRUTH, CONTEXT = _ON_WHITE["truth"], _ON_WHITE["context"]
"""The colours of the truth and of lines that are not selected, on white."""

TRUTH_DASH = (4, 3)
"""The dash of the edges of the true body."""

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
"""Marker -> its SVG outline in a box of 36 x 12, for the legend."""

DASHES = ("solid", "7 3", "2 3", "7 3 2 3", "13 4")
"""All 45 pairs of marker and dash are distinct, because 9 and 5 have no common divisor."""


@dataclass(frozen=True)
class Style:
    """How a method is drawn: one colour per engine, one marker and dash per method."""

    number: int
    name: str
    engine: str
    colour: int
    marker: str
    dash: str

    @property
    def outline(self) -> str:
        """The marker as an SVG path."""
        return MARKERS[self.marker]

    @property
    def linestyle(self) -> Any:
        """The dash as Matplotlib's linestyle."""
        return self.dash if self.dash == "solid" else (0, tuple(map(float, self.dash.split())))


def engine_colour(engine: str) -> int:
    """Return the number of an engine's colour; it depends on nothing but the name."""
    known = _COLOURS.get(engine)
    return KNOWN_COLOURS + crc32(engine.encode()) % (len(COLOURS) - KNOWN_COLOURS) if known is None else known


def styles(keys: Iterable[MethodKey]) -> dict[MethodKey, Style]:
    """Return the style of each method, in the order of the run."""
    ordered = list(dict.fromkeys(keys))
    markers = list(MARKERS)
    return {
        (engine, method): Style(
            number=i,
            name=f"{engine}:{method}",
            engine=engine,
            colour=engine_colour(engine),
            marker=markers[i % len(markers)],
            dash=DASHES[i % len(DASHES)],
        )
        for i, (engine, method) in enumerate(ordered)
    }


def stacked(keys: Iterable[MethodKey]) -> list[tuple[MethodKey, int]]:
    """Return the first method of each engine, and the number of engines that are drawn on top of it.

    A line of equal methods is drawn once for each of their engines, the lower ones wider.
    """
    first = list({key[0]: key for key in [*keys][::-1]}.values())[::-1]
    return [(key, len(first) - 1 - rank) for rank, key in enumerate(first)]


ALIKE = 2e-3
"""Lines are equal if they differ by at most this much at every point, relative to their values."""

Key = TypeVar("Key")


def merged(lines: Mapping[Key, tuple[Array, Array]], floor: float = 0.0) -> list[list[Key]]:
    """Return the keys of equal lines together, in the order of `lines`.

    lines: abscissas and values >= 0, each (n,). floor: values up to it cannot be distinguished.
    """
    groups: list[list[Key]] = []
    for key, line in lines.items():
        for group in groups:
            if _are_equal(lines[group[0]], line, floor):
                group.append(key)
                break
        else:
            groups.append([key])
    return groups


def _are_equal(first: tuple[Array, Array], second: tuple[Array, Array], floor: float) -> bool:
    (x, y), (abscissas, values) = first, second
    if len(x) != len(abscissas) or len(y) != len(values) or _differ(float(y[-1]), float(values[-1]), floor):
        return False  # the last value alone settles most pairs
    if not np.array_equal(x, abscissas):
        return False
    larger = np.maximum(y, values)
    return bool(np.all((np.abs(y - values) <= ALIKE * larger) | (larger <= floor)))


def _differ(one: float, other: float, floor: float) -> bool:
    larger = max(one, other)
    return larger > floor and abs(one - other) > ALIKE * larger


_HEADINGS = {
    "cpu_s": "CPU time, s",
    "ns_per_step": "time per step, ns",
    "order_low": "order, lower end",
    "order_high": "order, upper end",
    "growth_exponent": "growth exponent",
}

_UNITS = ("rad", "s")


def heading(column: str) -> str:
    """Return a column name as words, with its unit after a comma."""
    if column in _HEADINGS:
        return _HEADINGS[column]
    name, _, last = column.rpartition("_")
    text, unit = (name, f", {last}") if name and last in _UNITS else (column, "")
    return text.replace("_", " ") + unit
