"""Figures for papers: what is drawn is what was measured, and the same run gives the same file."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.render.figures import FIGURES, STABILITY, check_picture, drawn_figure, picture
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run

pytestmark = pytest.mark.slow

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def run(stored_run: Path) -> Run:
    """Return a run with its motions."""
    return read_run(stored_run, cache=Cache.default())


@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_is_the_same_each_time_and_names_every_method(figure: str, run: Run) -> None:
    """An SVG without a date, whose text tells each method; what failed is said beside its name."""
    drawn = picture(run, figure, "forced, and a mesh", "orientation_error_rad", ".svg")
    assert drawn == picture(run, figure, "forced, and a mesh", "orientation_error_rad", ".svg")
    told = re.findall(r"<!-- (.*?) -->", drawn.decode())
    for name in ("reference:m1", "reference:rk4", "reference:exact (1 unsupported)"):
        assert name in told
    assert any(re.fullmatch(r"failing:m1( \(1 failed\))?", text) for text in told)
    assert "forced, and a mesh" in told


@pytest.mark.parametrize(("figure", "column"), [("work-precision", "cpu_s"), ("order", "dt_s")])
def test_every_case_that_ended_well_is_a_point(figure: str, column: str, run: Run) -> None:
    """At its time or step, and its error; an error below 3 bounds of the truth stands at that."""
    (axes,) = drawn_figure(run, figure, "free", "orientation_error_rad").axes
    points = sorted(tuple(point) for line in axes.lines for point in np.asarray(line.get_xydata()).tolist())
    rows = [case.columns for case in run.cases if case.ok and case.columns["scenario"] == "free"]
    assert points == sorted(
        (row[column], max(row["orientation_error_rad"], 3.0 * row["truth_bound_rad"]))
        for row in rows
        if row.get(column) is not None
    )
    assert len(points) > 10


def test_the_largest_stable_step_of_each_method_is_drawn(run: Run) -> None:
    """At its step, open where none broke down; one whose search failed is named with the reason."""
    stable, limited = run.stability["dt_stable_s"], run.stability["method"] == "m1"
    run = replace(run, stability=run.stability.assign(dt_unstable_s=1.01 * stable.where(limited)))
    (axes,) = drawn_figure(run, STABILITY, "forced, and a mesh", "").axes
    rows = run.stability[run.stability["scenario"] == "forced, and a mesh"]
    found = [float(np.asarray(line.get_xdata())[0]) for line in axes.lines]
    np.testing.assert_array_equal(found, rows["dt_stable_s"])
    is_open = [line.get_fillstyle() == "none" for line in axes.lines]
    assert is_open == rows["dt_unstable_s"].isna().tolist()
    assert {True, False} == set(is_open)
    names = [label.get_text() for label in axes.get_yticklabels()]
    assert names[0] == "reference:m1"
    assert names[-1] == "failing:m1 (failed)"


def test_a_picture_for_a_page_is_png(run: Run) -> None:
    """By the end of the file's name."""
    assert picture(run, "order", "free", "energy_drift", ".png")[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_drift_that_has_no_scale_is_drawn_in_its_unit(run: Run) -> None:
    """A label without a unit is that of a number over its scale."""
    still = {"omega_scale_rad_s": 0.0}
    at_rest = replace(run, cases=tuple(replace(c, columns={**c.columns, **still}) for c in run.cases))
    labels = [
        drawn_figure(one, "drift", "free", "omega_error").axes[0].get_ylabel() for one in (run, at_rest)
    ]
    assert labels == ["omega error", "omega error, rad/s"]


@pytest.mark.parametrize("figure", FIGURES)
def test_what_has_no_points_is_no_figure(figure: str, run: Run) -> None:
    """An empty picture would say that all is well."""
    with pytest.raises(InputError, match="nothing to draw for nowhere"):
        picture(run, figure, "nowhere", "orientation_error_rad", ".svg")


def test_a_picture_is_asked_for_rightly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another format is refused; without matplotlib the line names the extra."""
    with pytest.raises(InputError, match=r"--out a.pdf: must end in .svg or .png"):
        check_picture(Path("a.pdf"))
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UnavailableError, match=r"^figures need matplotlib: pip install 'bodycheck\[plot\]'$"):
        check_picture(Path("a.svg"))
