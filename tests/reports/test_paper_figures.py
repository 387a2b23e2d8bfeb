"""Figures for papers: they show what was measured, and the same run gives the same file."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.pinned_libraries import matplotlib
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import MeasuredMotion
from bodycheck.reports.measurement.measures import MEASURES
from bodycheck.reports.render.body_figures import polhode
from bodycheck.reports.render.figures import (
    BODIES,
    FIGURES,
    STABILITY,
    Appearance,
    check_drawable,
    drawn_figure,
    picture,
)
from bodycheck.reports.render.styles import COLOURS, engine_colour
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run, check_engines, key_of
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.gate_tables import with_tables

if TYPE_CHECKING:
    from matplotlib.axes import Axes


pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def run(stored_run: Path) -> Run:
    """Return a run with its motions."""
    return read_run(stored_run, allow_code=False, cache=Cache.default())


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("figure", FIGURES)
def test_a_figure_is_the_same_each_time_and_names_every_method(figure: str, run: Run) -> None:
    """A figure is an SVG without a date whose text names each method; failures follow the name."""
    drawn = picture(run, figure, "forced, and a mesh", "orientation_error_rad", ".svg")
    assert drawn == picture(run, figure, "forced, and a mesh", "orientation_error_rad", ".svg")
    reported = re.findall(r"<!-- (.*?) -->", drawn.decode(), re.DOTALL)
    texts = [re.sub(r": order [\d.]+$", "", " ".join(text.split())) for text in reported]
    labels = [name for text in texts for name in text.split(" = ")]
    for name in ("reference:m1", "reference:rk4", "reference:exact (1 unsupported)"):
        assert name in labels
    assert any(re.fullmatch(r"failing:m1( \(1 failed\))?", name) for name in labels)
    assert "forced, and a mesh" in labels


def figure_of(run: Run, figure: str, appearance: Appearance) -> Axes | None:
    """Return the axes of a figure of the free scenario; None if there is nothing to draw."""
    try:
        (axes,) = drawn_figure(run, figure, "free", "orientation_error_rad", appearance).axes
    except InputError:
        return None
    return axes


@pytest.mark.parametrize("figure", ["order", "drift"])
def test_equal_methods_are_one_line_with_all_names(figure: str, run: Run) -> None:
    """failing:m1 and reference:m1 are one map: one line in both engines' colours, one label with both."""
    axes = figure_of(run, figure, Appearance())
    assert axes is not None
    own = [line for line in axes.lines if "reference:m1" in str(line.get_label()).split(" = ")]
    (lower,) = own
    assert "failing:m1" in str(lower.get_label()).split(" = ")
    upper = axes.lines[list(axes.lines).index(lower) + 1]
    assert str(upper.get_label()).startswith("_")
    assert np.array_equal(np.asarray(lower.get_xydata()), np.asarray(upper.get_xydata()))
    assert lower.get_linewidth() > upper.get_linewidth()
    assert {lower.get_color(), upper.get_color()} == {
        COLOURS[engine_colour(engine)] for engine in ("reference", "failing")
    }


@pytest.mark.parametrize("figure", ["work-precision", "order"])
def test_a_tolerance_is_a_line_with_the_setting_that_meets_it(figure: str, run: Run) -> None:
    """The point of the setting is below the line, in its engine's colour, its label beside its method's line.

    Without a tolerance there is neither.
    """
    look = Appearance(engines=("reference:rk4", "reference:m1"))
    plain, bounded = (figure_of(run, figure, replace(look, tolerance=at)) for at in (None, 1e-4))
    assert plain is not None
    assert bounded is not None
    (line, point) = bounded.lines[len(plain.lines) :]
    assert {float(y) for y in np.asarray(line.get_ydata())} == {1e-4}
    assert 0.0 < float(np.asarray(point.get_ydata())[0]) <= 1e-4
    (note,) = [text for text in bounded.texts if ", dt " in text.get_text()]
    name = note.get_text().partition(",")[0]
    assert point.get_color() == COLOURS[engine_colour("reference")]
    (own,) = [line for line in bounded.lines if str(line.get_label()).split(" = ")[0] == name]
    bounded.figure.canvas.draw()
    ends = own.get_transform().transform(np.asarray(own.get_xydata()))
    box = note.get_window_extent()
    along = np.linspace(ends[:-1], ends[1:], 200).reshape(-1, 2)
    assert not any(box.contains(*at) for at in along)


def test_a_label_replaces_the_name_of_a_method(run: Run) -> None:
    """It stands in the legend, with the observed order, and at the end of the line."""
    axes = figure_of(run, "order", Appearance(engines=("reference:rk4",), labels={"reference:rk4": "ours"}))
    assert axes is not None
    assert [text.get_text() for text in axes.texts if "slope" not in text.get_text()] == ["ours"]
    (legend,) = axes.figure.legends
    (text,) = legend.get_texts()
    assert re.fullmatch(r"ours: order [34]\.\d\d", text.get_text())


def test_the_slope_of_each_whole_order_is_drawn(run: Run) -> None:
    """The line of a method of order p has slope p over the step, in logarithms, and its number beside it."""
    axes = figure_of(run, "order", Appearance(engines=("reference:m1", "reference:rk4")))
    assert axes is not None
    slopes = []
    for line in axes.lines:
        if line.get_label() == "_slope":
            (x0, y0), (x1, y1) = np.log(np.asarray(line.get_xydata()))
            slopes.append((y1 - y0) / (x1 - x0))
    np.testing.assert_allclose(sorted(slopes), [1.0, 4.0], rtol=1e-12)
    noted = [text.get_text() for text in axes.texts if "slope" in text.get_text()]
    assert sorted(noted) == ["slope 1", "slope 4"]


def test_a_legend_has_twelve_entries_at_most(run: Run) -> None:
    """The other lines are grey, and are one entry; names at line ends stay within the axes and apart."""
    rk4 = [case for case in run.cases if case.columns["method"] == "rk4" and case.ok]
    scaled = [
        replace(
            case,
            columns={
                **case.columns,
                "method": f"rk4-{k}",
                "orientation_error_rad": 2.0**k * case.columns["orientation_error_rad"],
            },
        )
        for k in range(15)
        for case in rk4
    ]
    axes = figure_of(replace(run, cases=tuple(scaled)), "order", Appearance())
    assert axes is not None
    texts = [text.get_text() for text in axes.figure.legends[0].get_texts()]
    assert len(texts) == 13
    assert texts[-1].startswith("3 more")
    heights = [text.get_position()[1] for text in axes.texts if "rk4-" in text.get_text()]
    assert len(heights) == 12
    assert max(heights) <= 1.0
    assert np.diff(heights).min() > 0.05


@pytest.mark.parametrize("measure", ["quaternion_norm_error", "orthogonality_error", "determinant_error"])
def test_measures_without_a_bound_are_drawn_as_measured(measure: str, run: Run) -> None:
    """A measure of the engine's state has no truth, and no floor."""
    kept = [case for case in run.cases if measure in case.columns and case.ok]
    if not kept:
        pytest.skip("no method of the run has it")
    scenario = kept[0].columns["scenario"]
    try:
        drawn = drawn_figure(run, "order", scenario, measure)
    except InputError as error:
        assert "has a step" in str(error)  # noqa: PT017 - only methods without steps have it
        return
    (axes,) = drawn.axes
    drawn_values = {float(y) for line in axes.lines for y in np.asarray(line.get_ydata())}
    assert drawn_values <= {float(case.columns[measure]) for case in kept}


@pytest.mark.parametrize("figure", ["order", "drift"])
def test_methods_that_only_failed_are_no_figure(figure: str, run: Run) -> None:
    """A legend without a line would come with axes of made-up ranges."""
    only_failed = Appearance(engines=("reference:exact",))
    with pytest.raises(InputError):
        drawn_figure(run, figure, "forced, and a mesh", "orientation_error_rad", only_failed)


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("figure", ["order", "polhode", "motion"])
def test_a_figure_is_as_wide_as_its_columns(figure: str, columns: int, run: Run) -> None:
    """The width is 3.5 in or 7.2 in, whatever the legend contains."""
    look = Appearance(columns=columns, engines=("reference",))
    drawn = picture(run, figure, "free", "orientation_error_rad", ".svg", look)
    found = re.search(rb'width="([\d.]+)pt"', drawn)
    assert found
    assert float(found[1]) == pytest.approx(72.0 * {1: 3.5, 2: 7.2}[columns])


def test_only_selected_engines_are_drawn(run: Run, expected_message: ExpectedMessage) -> None:
    """An engine or one of its methods can be selected; a name that the run does not have is refused."""
    axes = figure_of(run, "order", Appearance(engines=("failing", "reference:rk4")))
    assert axes is not None
    names = {name for line in axes.lines for name in str(line.get_label()).split(" = ")}
    assert {name.partition(" ")[0].partition(":")[0] for name in names} >= {"failing", "reference"}
    assert not any(name.startswith("reference:m1") for name in names)
    with expected_message.raises(InputError):
        check_engines(run, ["reference", "nobody"])


def test_a_style_file_is_followed(run: Run, tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The settings of the file change the figure; an unknown setting or a missing file is refused."""
    style = tmp_path / "thick.mplstyle"
    style.write_text("axes.grid: False\naxes.linewidth: 3\n")
    plain, thick = (
        picture(run, "order", "free", "orientation_error_rad", ".svg", Appearance(style=file))
        for file in (None, style)
    )
    assert b"stroke-width: 3;" in thick
    assert b"stroke-width: 3;" not in plain
    style.write_text("nonsense: 4\n")
    for wrong in (style, tmp_path / "absent"):
        with expected_message.raises(InputError):
            picture(run, "order", "free", "orientation_error_rad", ".svg", Appearance(style=wrong))


def test_the_polhode_of_the_truth_lies_on_the_ellipsoid_of_inertia(run: Run) -> None:
    """w . I w = 1 along the truth; a motion whose omega is 1 % too large lies outside."""
    problem = run.problems[0]
    inertia, truth = rotational_inertia(problem.scenario.scene), problem.truth.trajectory
    moments, _ = diagonalised(inertia)
    on = polhode(truth, truth, inertia)
    np.testing.assert_allclose(np.sum(moments * on**2, axis=1), 1.0, rtol=1e-12)
    faster = replace(truth, omega_body_rad_s=1.01 * truth.omega_body, omega_world_rad_s=None)
    np.testing.assert_allclose(
        np.sum(moments * polhode(faster, truth, inertia) ** 2, axis=1), 1.01**2, rtol=1e-12
    )


@pytest.mark.parametrize("figure", BODIES)
def test_a_figure_of_the_body_names_its_methods(figure: str, run: Run) -> None:
    """Equal runs give equal bytes, with the method farthest off of each engine, and the step."""
    drawn = picture(run, figure, "free", "", ".svg")
    assert drawn == picture(run, figure, "free", "", ".svg")
    reported = re.findall(r"<!-- (.*?) -->", drawn.decode())
    assert any(text.startswith("reference:") for text in reported)
    assert any(text.startswith("free, dt ") for text in reported)


@pytest.mark.parametrize(("figure", "column"), [("work-precision", "cpu_s"), ("order", "dt_s")])
def test_every_case_that_ended_well_is_a_point(figure: str, column: str, run: Run) -> None:
    """A point has the time or step and the error of its case, which is at least 3 bounds of the truth."""
    methods = dict.fromkeys(key_of(case.columns) for case in run.cases)
    points = sorted(
        tuple(point)
        for key in methods
        for axes in (figure_of(run, figure, Appearance(engines=(":".join(key),))),)
        if axes is not None
        for line in axes.lines
        if line.get_label() != "_slope"
        for point in np.asarray(line.get_xydata()).tolist()
    )
    rows = [case.columns for case in run.cases if case.ok and case.columns["scenario"] == "free"]
    assert points == sorted(
        (row[column], max(row["orientation_error_rad"], 3.0 * row["truth_bound_rad"]))
        for row in rows
        if row.get(column) is not None
    )
    assert len(points) > 10


def test_a_case_too_short_for_its_clock_has_no_point(run: Run) -> None:
    """A time of 0, which a coarse clock measures, has no place on a logarithmic axis."""
    look = Appearance(engines=("reference:rk4",), tolerance=1e3)  # which the case of no time meets first
    own = [case.columns for case in run.cases if key_of(case.columns) == ("reference", "rk4") and case.ok]
    times = sorted(row["cpu_s"] for row in own if row["scenario"] == "free")
    cases = tuple(
        replace(case, columns=case.columns | {"cpu_s": 0.0})
        if case.columns.get("cpu_s") == times[0]
        else case
        for case in run.cases
    )
    axes = figure_of(replace(run, cases=cases), "work-precision", look)
    assert axes is not None
    assert sorted(axes.lines[0].get_xdata()) == times[1:]


def test_the_largest_stable_step_of_each_method_is_drawn(run: Run) -> None:
    """Its mark is open if no step was unstable; a method whose search failed is named with the reason."""
    stable, limited = run.stability["dt_stable_s"], run.stability["method"] == "m1"
    run = with_tables(run, stability=run.stability.assign(dt_unstable_s=1.01 * stable.where(limited)))
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


def test_methods_with_one_stable_step_are_one_row(run: Run) -> None:
    """Twins have one row with all names; two steps that differ, or ends of different kinds, have two."""
    rows = run.stability[run.stability["scenario"] == "free"].head(3).copy()
    rows["dt_stable_s"], rows["dt_unstable_s"] = [0.1, 0.1, 0.1], [0.11, 0.11, np.nan]
    (axes,) = drawn_figure(with_tables(run, stability=rows), STABILITY, "free", "").axes
    names = [" ".join(label.get_text().split()) for label in axes.get_yticklabels()]
    keys = [":".join(key) for key in zip(rows["engine"], rows["method"], strict=True)]
    assert names == [f"{keys[0]} = {keys[1]}", keys[2]]


def test_a_picture_for_a_page_is_png(run: Run) -> None:
    """The suffix of the file selects the format; a PDF has no date either."""
    assert picture(run, "order", "free", "energy_drift", ".png")[:8] == b"\x89PNG\r\n\x1a\n"
    drawn = picture(run, "order", "free", "energy_drift", ".pdf")
    assert drawn.startswith(b"%PDF")
    assert drawn == picture(run, "order", "free", "energy_drift", ".pdf")


def test_a_drift_that_has_no_scale_is_drawn_in_its_unit(run: Run) -> None:
    """A label without a unit means that the drift is divided by its scale."""
    still = {"omega_scale_rad_s": 0.0}
    at_rest = replace(run, cases=tuple(replace(c, columns={**c.columns, **still}) for c in run.cases))
    labels = [
        drawn_figure(one, "drift", "free", "omega_error").axes[0].get_ylabel() for one in (run, at_rest)
    ]
    assert labels == ["omega error", "omega error, rad/s"]


@pytest.mark.parametrize("figure", FIGURES)
def test_every_measure_is_drawn_or_refused_with_its_reason(figure: str, run: Run) -> None:
    """It is drawn where a case has it, over time where motions show it; the reason names it in one line."""
    cases = [case for case in run.cases if case.columns["scenario"] == "free" and case.ok]
    drawn = 0
    for measure in MEASURES:
        in_cases = any(measure in case.columns for case in cases)
        over_time = [case.series[measure] for case in cases if measure in case.series]
        if any(one.any() for one in over_time) if figure == "drift" else in_cases:
            drawn += len(drawn_figure(run, figure, "free", measure).axes)
            continue
        with pytest.raises(InputError) as refused:
            drawn_figure(run, figure, "free", measure)
        (line,) = str(refused.value).splitlines()
        why = f"{measure} is 0 at all times" if over_time else f"{measure} is one number per motion"
        assert (why if in_cases else f"no case has {measure}") in line
    assert drawn >= 8


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("figure", ["work-precision", "order"])
def test_an_error_of_zero_at_the_end_of_a_line_is_drawn(figure: str, run: Run) -> None:
    """The name of the line stands at the lower end of the axes; the layout succeeds, or would warn."""
    cases = [
        replace(case, columns={**case.columns, "quaternion_norm_error": 0.0})
        if "m1" in key_of(case.columns)
        else case
        for case in run.cases
    ]
    changed = replace(run, cases=tuple(cases))
    (axes,) = drawn_figure(changed, figure, "free", "quaternion_norm_error").axes
    assert min(text.get_position()[1] for text in axes.texts if ":m1" in text.get_text()) == 0.0
    assert b"<svg" in picture(changed, figure, "free", "quaternion_norm_error", ".svg")


@pytest.mark.parametrize("figure", [*FIGURES, STABILITY, *BODIES])
def test_what_has_no_points_is_no_figure(figure: str, run: Run, expected_message: ExpectedMessage) -> None:
    """An empty figure would suggest that all is well, so it is refused."""
    with expected_message.raises(InputError):
        picture(run, figure, "nowhere", "orientation_error_rad", ".svg")


@pytest.mark.parametrize(
    ("figure", "quantity"),
    [("work-precision", "energy_drift"), ("order", "invariant_drift"), ("drift", "omega_error")],
)
def test_why_a_figure_has_nothing_is_stated(
    figure: str, quantity: str, run: Run, expected_message: ExpectedMessage
) -> None:
    """The run has no times, no case has the measure, or there are no motions."""
    unmeasured = {"cpu_s", "invariant_drift"}
    cases = (
        replace(
            case,
            columns={name: cell for name, cell in case.columns.items() if name not in unmeasured},
            motion=MeasuredMotion(),
        )
        for case in run.cases
    )
    empty = replace(run, cases=tuple(cases), manifest={**run.manifest, "speed": False})
    with expected_message.raises(InputError):
        picture(empty, figure, "free", quantity, ".svg")


def test_a_missing_matplotlib_is_named(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """Without matplotlib the message names the extra."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    matplotlib.cache_clear()  # another test may have imported it
    with expected_message.raises(UnavailableError):
        check_drawable("figures")
