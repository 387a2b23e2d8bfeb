"""Run all measurements, one topic at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.figures import FIGURES, Measured
from benchmarks.timing import Effort
from benchmarks.topics.against import Points, against
from benchmarks.topics.drift import drift
from benchmarks.topics.kernels import batch, closed_form, forced, specialised
from benchmarks.topics.mesh import mesh
from benchmarks.topics.trees import trees
from benchmarks.topics.truth import certified, start

_TOPICS: tuple[Callable[[Effort], list[Measured]], ...] = (
    closed_form,
    forced,
    drift,
    batch,
    certified,
    trees,
    mesh,
    specialised,
    start,
)


@dataclass(frozen=True, eq=False)
class Measurements:
    """All figures, in the order of FIGURES, and the points of the work-precision curves."""

    figures: list[Measured]
    points: Points


def measure(effort: Effort, tell: Callable[[str], None]) -> Measurements:
    """Run all topics; report the start of each by `tell`. A figure that no topic reached gets a note."""
    tell("against engines and solvers")
    found, points = against(effort)
    for topic in _TOPICS:
        tell(topic.__name__.replace("_", " "))
        found += topic(effort)
    by_name = {measured.figure: measured for measured in found}
    unknown = by_name.keys() - {figure.name for figure in FIGURES}
    assert not unknown, unknown
    absent = "not reached at any setting"
    return Measurements(
        [by_name.get(figure.name, Measured(figure.name, None, note=absent)) for figure in FIGURES], points
    )
