"""Draw figures of a run for papers, as SVG or PNG: one column wide, the legend next to the axes."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import setting
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measure_bounds import floor_of
from bodycheck.reports.measurement.measures import MEASURES, scale_of
from bodycheck.reports.render.styles import Style, styles
from bodycheck.reports.run_files.run_tables import (
    MethodKey,
    RunTables,
    cases_by_method,
    common_step,
    key_of,
    shown_case,
)

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SUFFIXES = (".svg", ".png")
_INCHES = (3.5, 2.6)
_DOTS_PER_INCH = 300
_COLOURS = (  # one per engine, as in the report: after Okabe and Ito
    *("#0072b2", "#c44e00", "#00805c", "#1a1a1a"),
    *("#a8487f", "#8a6d00", "#2f86b5", "#7a5cc0"),
)
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


def check_picture(out: Path) -> None:
    """Raise InputError for an unsupported suffix, UnavailableError without matplotlib."""
    if out.suffix not in _SUFFIXES:
        raise InputError(f"--out {out}: must end in {' or '.join(_SUFFIXES)}")
    try:
        import matplotlib  # noqa: F401 - checked before anything is read
    except ImportError:
        raise UnavailableError("figures need matplotlib: pip install 'bodycheck[plot]'") from None


def picture(run: RunTables, figure: str, scenario: str, quantity: str, suffix: str) -> bytes:
    """Return a figure of one scenario as the bytes of an SVG or PNG file, identical for identical runs.

    figure: one of FIGURES, or STABILITY, which ignores `quantity`; "drift" needs the motions. Raises
    InputError if there is nothing to draw.
    """
    import matplotlib as mpl  # late: only figures need it

    with mpl.rc_context({"font.size": 8, "svg.hashsalt": "bodycheck", "axes.grid": True, "grid.alpha": 0.3}):
        shown = io.BytesIO()
        undated = {"Date": None} if suffix == ".svg" else None
        page = drawn_figure(run, figure, scenario, quantity)
        page.savefig(shown, format=suffix[1:], dpi=_DOTS_PER_INCH, bbox_inches="tight", metadata=undated)
    return shown.getvalue()


def drawn_figure(run: RunTables, figure: str, scenario: str, quantity: str) -> Figure:
    """Draw a figure of one scenario, one line per method; parameters and errors as in picture."""
    from matplotlib.figure import Figure

    lines = cases_by_method(run.cases).get(scenario, {})
    page = Figure(figsize=_INCHES)
    axes = page.add_subplot()
    drawn = styles(key_of(case.columns) for case in run.cases)
    if figure == STABILITY:
        _stability(axes, run.stability[run.stability["scenario"] == scenario], drawn)
    elif lines:
        FIGURES[figure](axes, lines, drawn, quantity)
    if not axes.lines:
        raise InputError(f"--figure {figure}: nothing to draw for {scenario}")
    axes.set_title(scenario, fontsize=8)
    if figure != STABILITY:
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False, fontsize=6)
    return page


def _work_precision(axes: Axes, lines: _Lines, drawn: Mapping[MethodKey, Style], quantity: str) -> None:
    """Draw error against processor time: one point per case, joined from the coarsest to the finest."""
    axes.set(xscale="log", yscale="log", xlabel="processor time, s", ylabel=_words(quantity))
    for key, cases in lines.items():
        points = [
            (case.columns["cpu_s"], _drawn_error(case, quantity))
            for case in cases
            if case.ok and quantity in case.columns and "cpu_s" in case.columns
        ]
        _draw(axes, drawn[key], cases, points)


def _order(axes: Axes, lines: _Lines, drawn: Mapping[MethodKey, Style], quantity: str) -> None:
    """Draw error against step, for every method with a step."""
    axes.set(xscale="log", yscale="log", xlabel="step, s", ylabel=_words(quantity))
    for key, cases in lines.items():
        points = [
            (case.dt_s, _drawn_error(case, quantity))
            for case in cases
            if case.ok and quantity in case.columns and case.dt_s is not None
        ]
        _draw(axes, drawn[key], cases, sorted(points))


def _drift(axes: Axes, lines: _Lines, drawn: Mapping[MethodKey, Style], quantity: str) -> None:
    """Draw a measure over time, for each method at the step shared by most methods."""
    every = [case for cases in lines.values() for case in cases]
    at_s = common_step(every)
    scale = scale_of(every[0].columns, quantity)
    what = _words(quantity) if scale > 0.0 else f"{_words(quantity)}, {MEASURES[quantity].unit}"
    axes.set(yscale="log", xlabel=f"time, s ({setting('dt', at_s)})", ylabel=what)
    for key, cases in lines.items():
        case = shown_case(cases, at_s)
        if case is None:
            continue
        points: list[tuple[float, float]] = []
        if quantity in case.series and case.trajectory is not None:
            values = case.series[quantity] / (scale or 1.0)
            times = case.trajectory.t_s[: len(values)]
            points = [(t, value) for t, value in zip(times, values, strict=True) if value > 0.0]
        _draw(axes, drawn[key], [case], points, markers=False)


FIGURES: dict[str, Callable[[Axes, _Lines, Mapping[MethodKey, Style], str], None]] = {
    "work-precision": _work_precision,
    "order": _order,
    "drift": _drift,
}


STABILITY = "stability"
"""The only figure without a quantity."""


def _stability(axes: Axes, rows: pd.DataFrame, drawn: Mapping[MethodKey, Style]) -> None:
    """Draw the largest stable step of each method; an open marker if it is only the end of the search.

    A method without one has the reason next to its name.
    """
    axes.set(xscale="log", xlabel="largest stable step, s; open: lower bound")
    axes.invert_yaxis()
    for row in rows.to_dict("records"):
        style, stable = drawn[row["engine"], row["method"]], row["dt_stable_s"]
        none = np.isnan(stable)
        why = f" ({'none' if row['outcome'] == 'ok' else row['outcome']})" if none else ""
        axes.plot(
            [stable],
            [f"{style.name}{why}"],
            color=_COLOURS[style.colour],
            marker=_MARKERS[style.marker],
            markersize=4,
            fillstyle="none" if np.isnan(row["dt_unstable_s"]) else "full",
            linestyle="none",
        )
    stable = rows["dt_stable_s"].dropna()
    if len(stable):  # to whole decades, because only these have tick labels
        axes.set_xlim(10.0 ** np.floor(np.log10(stable.min())), 10.0 ** np.ceil(np.log10(stable.max())))
    axes.xaxis.set_minor_formatter("")
    axes.tick_params(axis="y", labelsize=6)


def _drawn_error(case: CaseResult, quantity: str) -> float:
    """Return max(error, 3 bound): smaller errors cannot be resolved."""
    return max(float(case.columns[quantity]), floor_of(case.columns, quantity))


def _draw(
    axes: Axes,
    style: Style,
    cases: Sequence[CaseResult],
    points: Sequence[tuple[Any, float]],
    *,
    markers: bool = True,
) -> None:
    """Draw the line of one method; its legend entry counts the cases that did not end well."""
    ended = Counter(case.columns["outcome"] for case in cases if not case.ok)
    faults = ", ".join(f"{amount} {outcome}" for outcome, amount in ended.items())
    if not points and not faults:
        return
    x, y = np.array(points, dtype=np.float64).reshape(-1, 2).T
    axes.plot(
        x,
        y,
        label=f"{style.name} ({faults})" if faults else style.name,
        color=_COLOURS[style.colour],
        marker=_MARKERS[style.marker] if markers else None,
        markersize=4,
        markerfacecolor="none",
        markeredgewidth=0.7,
        linewidth=0.8,
        linestyle="solid" if style.dash == "solid" else (0, tuple(map(float, style.dash.split()))),
    )


def _words(quantity: str) -> str:
    name = quantity.removesuffix("_rad")
    return name.replace("_", " ") + (", rad" if quantity != name else "")
