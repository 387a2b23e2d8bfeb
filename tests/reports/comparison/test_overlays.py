"""Overlays: the errors of both runs in one picture, where they are in the tables."""

from __future__ import annotations

import re

import pytest

from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.comparison.comparison_document import comparison_page
from bodycheck.reports.comparison.overlays import Overlay, overlays_of
from tests.reports.comparison.test_measure_track import ERROR, run

STEPS = (0.04, 0.02, 0.01)
BEFORE = (1.6e-3, 4e-4, 1e-4)
AFTER = (4e-2, 2e-2, 1e-2)


def overlay() -> Overlay:
    """Return the one overlay of a method that fell from order 2 to order 1."""
    before, after = (
        run(*({"dt_s": dt_s, ERROR: error} for dt_s, error in zip(STEPS, errors, strict=True)))
        for errors in (BEFORE, AFTER)
    )
    (found,), others = overlays_of(compare(before, after))
    assert others == []
    return found


def test_an_event_is_drawn_once_and_its_other_quantities_are_others() -> None:
    """Of a method whose errors all grew, the chart is that of the error that the first line names."""
    before, after = (
        run(
            *(
                {"dt_s": dt_s, ERROR: error, "energy_drift": scale * error, "omega_error": error}
                for dt_s, error in zip(STEPS, errors, strict=True)
            )
        )
        for errors, scale in ((BEFORE, 1.0), (AFTER, 1e3))
    )
    named, others = overlays_of(compare(before, after))
    assert [one.quantity for one in named] == [ERROR]
    assert {one.quantity for one in others} == {"energy_drift", "omega_error"}


def test_points_lie_on_lines_of_their_order() -> None:
    """On axes of equal scale, the slopes are 2 before and 1 after, and later is above earlier."""
    found = overlay()
    ends = {
        name: [(float(x), float(y)) for x, y, _ in curve.points]
        for name, curve in (("before", found.before), ("after", found.after))
    }
    slopes = {name: (y[0][1] - y[-1][1]) / (y[0][0] - y[-1][0]) for name, y in ends.items()}
    assert slopes["before"] / slopes["after"] == pytest.approx(2.0, rel=2e-2)
    assert all(a[0] == b[0] and a[1] < b[1] for a, b in zip(ends["after"], ends["before"], strict=True))


def test_ticks_are_where_their_values_are() -> None:
    """Each tick of the errors lies between the points next to it in value; no mark touches the axes.

    There is one at each power of ten.
    """
    found = overlay()
    marks = [(float(x), float(y)) for x, y, _ in (*found.before.points, *found.after.points)]
    assert all(46.0 + 3.5 < x < 312.0 - 3.5 and 10.0 + 3.5 < y < 150.0 - 3.5 for x, y in marks)
    assert len(found.x_ticks) >= 2
    assert [float(text) for _, text in found.y_ticks] == [1e-4, 1e-3, 1e-2]
    known = sorted(zip((*BEFORE, *AFTER), (*found.before.points, *found.after.points), strict=True))
    for y, text in found.y_ticks:
        below = [float(point[1]) for error, point in known if error <= float(text) * (1.0 + 1e-12)]
        above = [float(point[1]) for error, point in known if error >= float(text) * (1.0 - 1e-12)]
        assert max(above, default=0.0) - 0.11 <= float(y) <= min(below, default=200.0) + 0.11


def test_page_draws_each_case_of_both_runs() -> None:
    """Every case is a circle with its step and error; a comparison without changes has no picture."""
    before = run(*({"dt_s": dt_s, ERROR: error} for dt_s, error in zip(STEPS, BEFORE, strict=True)))
    after = run(*({"dt_s": dt_s, ERROR: error} for dt_s, error in zip(STEPS, AFTER, strict=True)))
    page = comparison_page(compare(before, after))
    reported = re.findall(r"<circle[^>]*><title>(before|after), step ([^ ]+) s: ([^<]+)</title>", page)
    expected = [
        (name, dt_s, error)
        for name, errors in (("before", BEFORE), ("after", AFTER))
        for dt_s, error in zip(STEPS, errors, strict=True)
    ]
    assert [(name, float(dt_s), float(error)) for name, dt_s, error in reported] == expected
    assert "x 100" in page
    assert "<circle" not in comparison_page(compare(before, before))
