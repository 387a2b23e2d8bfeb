"""Draw figures of a run for papers: vector graphics or PNG, one or two columns wide, the legend below."""

from __future__ import annotations

import io
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from markupsafe import Markup

from bodycheck._util.code_gate import check_code
from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import setting
from bodycheck._util.pinned_libraries import matplotlib
from bodycheck._util.untrusted import check_regular
from bodycheck.adapters.engine_names import is_named
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measure_bounds import TRUTH_BOUNDS, floor_of
from bodycheck.reports.measurement.measures import MEASURES, scale_of
from bodycheck.reports.render.styles import (
    COLOURS,
    CONTEXT,
    Style,
    engine_colour,
    heading,
    merged,
    stacked,
    styles,
)
from bodycheck.reports.run_files.run_tables import (
    MethodKey,
    Run,
    Tables,
    cases_by_method,
    common_step,
    key_of,
    shown_case,
)
from bodycheck.reports.summary.advice import settings_within
from bodycheck.reports.summary.error_curve import curves_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_UNDATED = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
WIDTHS_IN = {1: 3.5, 2: 7.2}
"""The widths of a figure in columns of a paper."""

_HEIGHT_IN = 2.4
_LEGEND_LINE_IN = 0.115  # of a line of a legend of 6 points
_LABEL_LETTERS = 52  # of a line of the legend, so that it fits one column
_NAME_LETTERS = 36  # of a line of names next to the axes
_MOST_ENTRIES = 12  # of a legend; the other lines are grey
_DOTS_PER_INCH = 300
_MARKERS = {
    "circle": "o",
    "square": "s",
    "diamond": "D",
    "triangle-up": "^",
    "triangle-down": "v",
    "cross": "P",
    "x": "X",
    "star": "*",
    "pentagon": "p",
}

_Lines: TypeAlias = Mapping[MethodKey, Sequence[CaseResult]]
"""The cases of one scenario by engine and method."""

_Points: TypeAlias = tuple[Array, Array]
"""Abscissas and values of a line, each (n,)."""

_RC: Any = {
    "font.size": 8,
    "svg.hashsalt": "bodycheck",
    "axes.grid": True,
    "grid.alpha": 0.3,
    "axes.titlesize": 8,
}


@dataclass(frozen=True)
class Appearance:
    """How a figure looks.

    columns: its width, 1 (3.5 in) or 2 (7.2 in) columns of a paper. style: a file of matplotlib's settings.
    engines: the lines that are drawn, as ENGINE or ENGINE:METHOD; all if empty. allow_code: whether the
    style may start programs. tolerance: an error whose line is drawn, with the cheapest setting that meets
    it. labels: ENGINE:METHOD -> its name in the figure.
    """

    columns: int = 1
    style: Path | None = None
    engines: tuple[str, ...] = ()
    allow_code: bool = False
    tolerance: float | None = None
    labels: Mapping[str, str] = field(default_factory=dict)

    def shows(self, key: MethodKey) -> bool:
        """Whether a method is drawn."""
        return is_named(self.engines, *key)


PLAIN = Appearance()
"""A figure of one column, with all methods, in our settings of matplotlib."""


def check_drawable(what: str) -> None:
    """Raise UnavailableError without matplotlib; what: is drawn, in the plural."""
    try:
        matplotlib()  # checked before anything is read
    except ImportError:
        raise UnavailableError(f"{what} need matplotlib: pip install 'bodycheck[plot]'") from None


def picture(
    run: Tables,
    figure: str,
    scenario: str,
    quantity: str,
    suffix: str,
    appearance: Appearance = PLAIN,
) -> bytes:
    """Return a figure of one scenario as the bytes of a file, identical for identical runs.

    figure: one of FIGURES, STABILITY or BODIES; the last two ignore `quantity`. "drift" and BODIES need a
    `Run` with its motions. Raises InputError if there is nothing to draw or the style cannot be used.
    """
    with rendering(appearance):
        return figure_bytes(drawn_figure(run, figure, scenario, quantity, appearance), suffix)


def figure_bytes(page: Figure, suffix: str, *, transparent: bool = False) -> bytes:
    """Return a figure as the bytes of a file without a date; transparent: without a background."""
    buffer = io.BytesIO()
    metadata = _UNDATED.get(suffix)
    page.savefig(buffer, format=suffix[1:], dpi=_DOTS_PER_INCH, metadata=metadata, transparent=transparent)
    return buffer.getvalue()


def panel(svg: bytes) -> Markup:
    """Return a figure of one column, drawn as SVG, as a panel of a page."""
    text = svg.decode()
    return Markup(text[text.index("<svg") :])


@contextmanager
def rendering(appearance: Appearance = PLAIN) -> Iterator[None]:
    """Use matplotlib's own settings, over them ours, and over them those of the style file."""
    mpl = matplotlib()
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_RC)
        if appearance.style is not None:
            mpl.rcParams.update(_style_of(appearance.style, allow_code=appearance.allow_code))
        yield


_STARTS_PROGRAMS = ("text.usetex", "text.latex", "pgf.", "ps.usedistiller", "animation.", "backend")


def _style_of(style: Path, *, allow_code: bool) -> Any:
    """Return the settings of a style file. Raises InputError where matplotlib would only warn."""
    import logging

    complaints: list[str] = []

    class Collect(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            complaints.append(" ".join(record.getMessage().split()))

    handler, logger = Collect(), logging.getLogger("matplotlib")
    logger.addHandler(handler)
    propagates, logger.propagate = logger.propagate, False
    try:
        check_regular(style)
        found = matplotlib().rc_params_from_file(style, use_default_template=False)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--style {style}: cannot be read: {error}") from None
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagates
    if complaints:
        raise InputError(f"--style {style}: {complaints[0].partition(' You probably')[0]}")
    for key in found:
        if key.startswith(_STARTS_PROGRAMS):
            check_code(key, "can start a program", allow_code=allow_code, file=style)
    return found


def drawn_figure(
    run: Tables, figure: str, scenario: str, quantity: str, appearance: Appearance = PLAIN
) -> Figure:
    """Draw a figure of one scenario; parameters and errors as in picture."""
    from matplotlib.figure import Figure

    drawn = styles(key_of(case.columns) for case in run.cases)
    lines = cases_by_method(run.cases).get(scenario, {})
    lines = {key: cases for key, cases in lines.items() if appearance.shows(key)}
    page = Figure(figsize=(WIDTHS_IN[appearance.columns], _HEIGHT_IN), layout="constrained")
    if figure in BODIES:
        from bodycheck.reports.render import body_figures

        assert isinstance(run, Run)
        body_figures.draw(page, run, figure, scenario, [c for own in lines.values() for c in own])
        return page
    axes = page.add_subplot(title=scenario)
    if figure == STABILITY:
        rows = run.stability[run.stability["scenario"] == scenario]
        is_shown = [appearance.shows(key) for key in zip(rows["engine"], rows["method"], strict=True)]
        _stability(axes, rows[np.array(is_shown, dtype=bool)], drawn)
    elif lines:
        FIGURES[figure](axes, lines, drawn, quantity)
    if not any(len(line.get_xdata()) for line in axes.lines):  # type: ignore[arg-type]
        cases = [case for own in lines.values() for case in own]
        why = _why_nothing(run, figure, cases, quantity)
        raise InputError(f"--figure {figure}: nothing to draw for {scenario}: {why}")
    if figure != STABILITY:
        orders = _orders(run, scenario, quantity)
        _legend(page, axes, appearance, orders)
        if figure != "drift":
            _slopes(axes, orders, 1.0 if figure == "order" else -1.0)
        if appearance.tolerance is not None:
            _tolerance(axes, run, figure, scenario, quantity, appearance)
        _end_labels(axes, appearance)
    return page


def _orders(run: Tables, scenario: str, quantity: str) -> dict[str, float]:
    """Return ENGINE:METHOD -> observed order."""
    return {
        ":".join(key_of(row)): row["order"]
        for row in run.rows("methods")
        if row["scenario"] == scenario and row["quantity"] == quantity and row.get("order") is not None
    }


def _tolerance(
    axes: Axes, run: Tables, figure: str, scenario: str, quantity: str, appearance: Appearance
) -> None:
    """Draw the line of a tolerance, and the cheapest setting of an engine that meets it."""
    assert appearance.tolerance is not None
    axes.axhline(appearance.tolerance, color="#666666", linewidth=0.6, linestyle="dashed")
    curves = {
        place: curve
        for place, curve in curves_of(run, quantity).items()
        if place[0] == scenario and appearance.shows(place[1])
    }
    options = settings_within(curves, appearance.tolerance, [scenario])[0].options
    x = None if not options else options[0].cpu_s if figure == "work-precision" else options[0].setting
    if figure == "drift" or not x:
        return
    best = options[0]
    is_measured = best.basis == "measured"
    axes.plot(
        [x],
        [best.error],
        marker="*",
        markersize=9,
        color=COLOURS[engine_colour(best.engine)],
        fillstyle="full" if is_measured else "none",
        linestyle="none",
        label="_point",
        zorder=5,
    )
    text = f"{appearance.labels.get(best.name, best.name)}, {setting(best.control, best.setting)}"
    text += "" if is_measured else f" ({best.basis})"
    is_right = _within(axes, np.array([[x, best.error]]))[0, 0] > 0.5
    side, right = ("right", -6) if is_right else ("left", 6)
    # the method's line falls with the time and rises with the step: the label is on its other side
    above, up = ("bottom", 2) if is_right != (figure == "work-precision") else ("top", -2)
    axes.annotate(
        text,
        (x, best.error),
        (right, up),
        textcoords="offset points",
        fontsize=6,
        ha=side,
        va=above,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},  # over lines of slopes and others
    )


def _within(axes: Axes, points: Array) -> Array:
    """Return points (n, 2) as fractions of the axes."""
    axes.get_xlim()  # settles the limits
    return np.asarray((axes.transScale + axes.transLimits).transform(points))


_SAME_SLOPE = 0.15


def _slopes(axes: Axes, orders: Mapping[str, float], sign: float) -> None:
    """Draw the slope of each whole order below the first line that has it, with its number.

    sign: 1 where the abscissa is the step, -1 where it is a time, which falls with the step.
    """
    drawn: set[int] = set()
    for line in list(axes.lines):
        order = orders.get(str(line.get_label()).split(" = ")[0].partition(" (")[0])
        xy = np.asarray(line.get_xydata())
        whole = 0 if order is None else round(order)
        if order is None or whole < 1 or abs(order - whole) > _SAME_SLOPE or whole in drawn or len(xy) < 2:
            continue
        drawn.add(whole)
        x = np.geomspace(xy[:, 0].min(), xy[:, 0].max(), 4)[1:3]  # the middle third
        middle = np.sqrt(x[0] * x[1])
        by_x = xy[np.argsort(xy[:, 0])]
        level = np.exp(np.interp(np.log(middle), *np.log(by_x).T))
        y = 0.15 * level * (x / middle) ** (sign * whole)
        axes.plot(x, y, color="#666666", linewidth=0.7, label="_slope")
        axes.annotate(
            f"slope {sign * whole:g}",
            (middle, 0.15 * level),
            (3 * sign, -3),  # away from the line
            textcoords="offset points",
            fontsize=5.5,
            color="#444444",
            ha="left" if sign > 0 else "right",
            va="top",
        )


_LABEL_GAP = 0.055  # of the height of the axes


def _end_labels(axes: Axes, appearance: Appearance) -> None:
    """Write the name of each line of the legend next to its right end, the names apart from each other."""
    ends: list[tuple[float, str, Any]] = []
    for line in axes.lines:
        label, xy = str(line.get_label()), np.asarray(line.get_xydata())
        if not label.startswith("_") and len(xy):
            first, *others = label.split(" = ")
            height = _within(axes, xy[[np.argmax(xy[:, 0])]])[0, 1]
            name = appearance.labels.get(first, first) + (f" +{len(others)}" if others else "")
            height = float(np.clip(height, 0.0, 1.0))  # an error of 0 is at minus infinity
            ends.append((height, name, line.get_color()))
    ends.sort(key=lambda end: end[0])
    gap = min(_LABEL_GAP, 1.0 / max(len(ends), 1))
    heights = [height for height, _, _ in ends]
    for k in range(1, len(ends)):
        heights[k] = max(heights[k], heights[k - 1] + gap)
    top = 1.0
    for k in reversed(range(len(ends))):  # what was pushed out at the top goes down again
        heights[k] = min(heights[k], top)
        top = heights[k] - gap
    place: Any = axes.transAxes
    for y, (_, name, colour) in zip(heights, ends, strict=True):
        axes.text(1.01, y, name, transform=place, fontsize=5.5, color=colour, va="center")


def _why_nothing(run: Tables, figure: str, cases: Iterable[CaseResult], quantity: str) -> str:
    """Return why none of the cases of a scenario has a point in a figure."""
    ended_well = [case for case in cases if case.ok]
    if figure == STABILITY:
        return "the run has no search for stable steps there"
    if not ended_well:
        return "no case has outcome ok"
    if figure == "work-precision" and not run.manifest["speed"]:
        return "the run was made with --no-speed (--figure order needs no times)"
    if not any(quantity in case.columns for case in ended_well):
        return f"no case has {quantity}"
    if figure == "drift" and any(case.series for case in ended_well):
        if any(quantity in case.series for case in ended_well):
            return f"{quantity} is 0 at all times"
        return f"{quantity} is one number per motion, not a series over time"
    missing = {"work-precision": "a time", "order": "a step", "drift": "a motion that shows it"}
    return f"no case with {quantity} has {missing[figure]}"


def _legend(page: Figure, axes: Axes, appearance: Appearance, orders: Mapping[str, float]) -> None:
    """Put the legend below the axes, with the observed orders, and make the figure higher by as much."""
    groups: list[list[Line2D]] = []
    for line in axes.lines:  # a line without a label belongs to the one before it
        if str(line.get_label()).startswith("_"):
            groups[-1].append(line)
        else:
            groups.append([line])
    named, others = groups[:_MOST_ENTRIES], groups[_MOST_ENTRIES:]
    labels = [_legend_text(str(group[0].get_label()), appearance, orders) for group in named]
    if others:
        for line in (line for group in others for line in group):
            line.set(color=CONTEXT, linewidth=0.6, marker="", zorder=1, label="_other")
        named.append(others[0][:1])
        labels.append(f"{len(others)} more: --engine selects")
    handles: Any = [tuple(group) for group in named]  # drawn on top of each other
    wrapped = ["\n  ".join(textwrap.wrap(text, _LABEL_LETTERS, break_on_hyphens=False)) for text in labels]
    columns = appearance.columns
    heights = sum(1 + label.count("\n") for label in wrapped) / columns
    page.set_figheight(page.get_figheight() + _LEGEND_LINE_IN * (heights + 1))
    page.legend(handles, wrapped, loc="outside lower center", ncols=columns, frameon=False, fontsize=6)


def _legend_text(label: str, appearance: Appearance, orders: Mapping[str, float]) -> str:
    names = label.split(" = ")
    order = orders.get(names[0].partition(" (")[0])
    text = " = ".join(appearance.labels.get(name, name) for name in names)
    return text if order is None else f"{text}: order {order:.2f}"


def _work_precision(axes: Axes, lines: _Lines, drawn: Mapping[MethodKey, Style], quantity: str) -> None:
    """Draw error against processor time: one point per case, joined from the coarsest to the finest.

    Methods of one engine with equal errors at every step are one line, that of the fastest.
    """
    axes.set(xscale="log", yscale="log", xlabel=heading("cpu_s"), ylabel=heading(quantity))
    points = {
        key: _points(
            (case.columns["cpu_s"], _drawn_error(case, quantity))
            for case in cases
            if case.ok
            and quantity in case.columns
            and case.columns.get("cpu_s")  # a coarse clock may measure 0
        )
        for key, cases in lines.items()
    }
    for engine in dict.fromkeys(engine for engine, _ in lines):
        own = {key: _error_by_step(cases, quantity) for key, cases in lines.items() if key[0] == engine}
        timed = {key: line for key, line in own.items() if len(points[key][0])}
        for group in [*merged(timed, _floor(lines, quantity)), *([key] for key in own if key not in timed)]:
            fastest = min(group, key=lambda key: float(np.sum(points[key][0])))
            _draw(axes, drawn, group, points[fastest], [case for key in group for case in lines[key]])


def _error_by_step(cases: Sequence[CaseResult], quantity: str) -> _Points:
    """Return the steps and the errors of the cases of a method that ended well, finest first."""
    return _points(
        sorted(
            (case.setting.fineness or 0.0, _drawn_error(case, quantity))
            for case in cases
            if case.ok and quantity in case.columns
        )
    )


def _floor(lines: _Lines, quantity: str) -> float:
    columns = next(iter(lines.values()))[0].columns
    return floor_of(columns, quantity) if quantity in TRUTH_BOUNDS else 0.0


def _order(axes: Axes, lines: _Lines, drawn: Mapping[MethodKey, Style], quantity: str) -> None:
    """Draw error against step, for every method with a step; equal lines are one."""
    axes.set(xscale="log", yscale="log", xlabel="step, s", ylabel=heading(quantity))
    stepped = {key: [case for case in cases if case.dt_s is not None] for key, cases in lines.items()}
    points = {key: _error_by_step(cases, quantity) for key, cases in stepped.items()}
    floor = _floor(lines, quantity)
    _draw_merged(axes, drawn, points, lines, floor)


def _drift(axes: Axes, lines: _Lines, drawn: Mapping[MethodKey, Style], quantity: str) -> None:
    """Draw a measure over time, for each method at the step shared by most methods; equal lines are one."""
    every = [case for cases in lines.values() for case in cases]
    at_s = common_step(every)
    scale = scale_of(every[0].columns, quantity)
    label = heading(quantity) if scale > 0.0 else f"{heading(quantity)}, {MEASURES[quantity].unit}"
    axes.set(yscale="log", xlabel=f"time, s ({setting('dt', at_s)})", ylabel=label)
    representatives = {key: shown_case(cases, at_s) for key, cases in lines.items()}
    cases = {key: [case] for key, case in representatives.items() if case is not None}
    points = {key: _over_time(own[0], quantity, scale) for key, own in cases.items()}
    _draw_merged(axes, drawn, points, cases, 0.0, markers=False)


def _over_time(case: CaseResult, quantity: str, scale: float) -> _Points:
    """Return the times and the values of a measure that are above 0."""
    if quantity not in case.series or case.trajectory is None:
        return np.empty(0), np.empty(0)
    values = case.series[quantity] / (scale or 1.0)
    above = values > 0.0
    return case.trajectory.t_s[: len(values)][above], values[above]


FIGURES: dict[str, Callable[[Axes, _Lines, Mapping[MethodKey, Style], str], None]] = {
    "work-precision": _work_precision,
    "order": _order,
    "drift": _drift,
}


STABILITY = "stability"
"""The largest stable step of each method."""

BODIES = ("polhode", "motion")
"""The figures of the body itself: omega on the ellipsoid of inertia, and the body at several times."""

NEED_MOTIONS = ("drift", *BODIES)
"""The figures that need the motions of a run, not only its tables."""


def _stability(axes: Axes, rows: pd.DataFrame, drawn: Mapping[MethodKey, Style]) -> None:
    """Draw the largest stable step of each method; an open marker if it is only the end of the search.

    Methods with equal steps have one row; a method without a step has the reason next to its name.
    """
    axes.set(xscale="log")
    axes.set_xlabel("largest stable step, s; open: lower bound", loc="right")
    found = {(row["engine"], row["method"]): row for row in rows.to_dict("records")}
    ends = {key: (row["dt_stable_s"], row["dt_unstable_s"]) for key, row in found.items()}
    alike = {
        key: (np.array([float(np.isnan(unstable))]), np.array([stable]))
        for key, (stable, unstable) in ends.items()
        if not np.isnan(stable)
    }
    groups = [*merged(alike), *([key] for key in found if key not in alike)]
    most_lines = 1
    for group in sorted(groups, key=lambda group: [*found].index(group[0])):
        row = found[group[0]]
        why = "" if group[0] in alike else f" ({'none' if row['outcome'] == 'ok' else row['outcome']})"
        text = " = ".join(drawn[key].name for key in group) + why
        label = "\n".join(textwrap.wrap(text, _NAME_LETTERS, break_on_hyphens=False))
        is_open = bool(np.isnan(row["dt_unstable_s"]))
        most_lines = max(most_lines, label.count("\n") + 1)
        for key, above in stacked(group):
            axes.plot(
                [row["dt_stable_s"]],
                [label],
                color=COLOURS[drawn[key].colour],
                marker=_MARKERS[drawn[key].marker],
                markersize=4 + 2 * above,
                fillstyle="none" if is_open else "full",
                linestyle="none",
            )
    axes.figure.set_figheight(0.8 + max(1.0, len(groups) * most_lines * _LEGEND_LINE_IN))  # type: ignore[union-attr]
    axes.set_ylim(max(len(groups), 1) - 0.5, -0.5)
    stable = rows["dt_stable_s"].dropna()
    if len(stable):  # to whole decades, because only these have tick labels
        low, high = np.floor(np.log10(stable.min())), np.ceil(np.log10(stable.max()))
        axes.set_xlim(10.0**low, 10.0 ** max(high, low + 1))
    axes.xaxis.set_minor_formatter("")
    axes.tick_params(axis="y", labelsize=6)


def _drawn_error(case: CaseResult, quantity: str) -> float:
    """Return max(error, 3 bound): smaller errors cannot be resolved."""
    error = float(case.columns[quantity])
    return max(error, floor_of(case.columns, quantity)) if quantity in TRUTH_BOUNDS else error


def _points(pairs: Iterable[tuple[float, float]]) -> _Points:
    x, y = np.array(list(pairs), dtype=np.float64).reshape(-1, 2).T
    return x, y


def _draw_merged(
    axes: Axes,
    drawn: Mapping[MethodKey, Style],
    points: Mapping[MethodKey, _Points],
    cases: _Lines,
    floor: float,
    *,
    markers: bool = True,
) -> None:
    """Draw each group of equal lines as one; a method without points only has its faults in the legend."""
    nonempty = {key: line for key, line in points.items() if len(line[0])}
    empty = [[key] for key in points if key not in nonempty]
    for group in (*merged(nonempty, floor), *empty):
        own = [case for key in group for case in cases[key]]
        _draw(axes, drawn, group, points[group[0]], own, markers=markers)


def _draw(
    axes: Axes,
    drawn: Mapping[MethodKey, Style],
    group: Sequence[MethodKey],
    points: _Points,
    cases: Sequence[CaseResult],
    *,
    markers: bool = True,
) -> None:
    """Draw one line, in the colour of each of its engines, the lower ones wider, and label it with all names.

    The label counts the cases of a method that did not end well.
    """
    names = [_label(drawn[key], [case for case in cases if key_of(case.columns) == key]) for key in group]
    if not len(points[0]) and names == [drawn[key].name for key in group]:
        return
    by_engine = stacked(group)
    for key, above in by_engine:
        style = drawn[key]
        axes.plot(
            *points,
            label=" = ".join(names) if key == group[0] else None,
            color=COLOURS[style.colour],
            marker=_MARKERS[style.marker] if markers else None,
            markersize=4 + 1.5 * above,
            markerfacecolor="none",
            markeredgewidth=0.7,
            linewidth=0.8 + 1.4 * above,
            linestyle="solid" if len(by_engine) > 1 else style.linestyle,
        )


def _label(style: Style, cases: Sequence[CaseResult]) -> str:
    ended = Counter(case.columns["outcome"] for case in cases if not case.ok)
    faults = ", ".join(f"{amount} {outcome}" for outcome, amount in ended.items())
    return f"{style.name} ({faults})" if faults else style.name
