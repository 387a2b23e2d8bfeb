"""The page of a judgement: conclusion, motion, drifts and errors over time, diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from markupsafe import Markup

from bodycheck.examine.explanation.explain import ExplainedCase
from bodycheck.examine.explanation.explanation_document import drawn_explanations
from bodycheck.recordings.judge import Ranking
from bodycheck.recordings.judge_document import judgement_document
from bodycheck.recordings.judged_motion import JudgedMotion
from bodycheck.reports.document import page
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.page.played_motions import played_motions
from bodycheck.reports.render.page.plots import plot_data
from bodycheck.reports.render.styles import COLOURS, KNOWN_COLOURS, Style, styles
from bodycheck.reports.run_files.run_tables import MethodKey, key_of
from bodycheck.reports.templating import asset

_SCRIPTS = (
    *("page", "state", "plot_style", "lines", "plots"),
    *("legend", "sections", "quaternions", "drawing", "motion"),
    "links",
)

_FIRST = (ORIENTATION, "rotational_energy_drift", "energy_drift")
"""The quantities whose plots open a section, where they are clear of their floors."""


@dataclass(frozen=True, eq=False)
class _Section:
    """The files with samples at the same times.

    plots: without the quantities whose drifts and errors are all at their floors; those are `at_floor`.
    first: the quantities that its plots show at first. motion: None where no file has attitude and omega.
    """

    name: str
    anchor: str
    plots: dict[str, Any]
    first: tuple[str, ...]
    at_floor: tuple[str, ...]
    motion: dict[str, Any] | None


def judgement_page(ranking: Ranking, cases: Sequence[ExplainedCase]) -> str:
    """Return a judgement with its diagnoses as one self-contained HTML page."""
    drawn = {
        key: replace(
            style, name=style.engine, colour=KNOWN_COLOURS + style.number % (len(COLOURS) - KNOWN_COLOURS)
        )
        for key, style in styles(key_of(motion.case.columns) for motion in ranking.motions).items()
    }
    colours = {style.engine: style.colour for style in drawn.values()}
    groups: list[list[JudgedMotion]] = []
    for motion in ranking.motions:
        if motion.case.ok:
            same = next((group for group in groups if _same_times(group[0].problem, motion.problem)), None)
            groups.append([motion]) if same is None else same.append(motion)
    document = judgement_document(ranking, cases, evidence=True)
    return page(
        replace(document, parts=(*document.parts, drawn_explanations(cases, "in the file"))),
        "judged.html",
        allowed=Markup("script-src 'unsafe-inline'; img-src data: blob:; "),
        motions=[_section(group, drawn, number) for number, group in enumerate(groups, 1)],
        styles=drawn,
        own=(),
        styles_data=[asdict(style) for style in drawn.values()],
        first_order=[],
        errors=(),
        engine_colour=colours.__getitem__,
        js=Markup("\n").join(asset(f"templates/{name}.js") for name in _SCRIPTS),
        plotly=asset("vendor/plotly-basic.min.js"),
    )


def _same_times(one: Problem, other: Problem) -> bool:
    """Whether two files have the same samples, and the same start."""
    first, second = one.truth.trajectory, other.truth.trajectory
    return np.array_equal(first.t_s, second.t_s) and np.array_equal(first.attitude, second.attitude)


def _section(group: Sequence[JudgedMotion], drawn: dict[MethodKey, Style], number: int) -> _Section:
    problem, cases = group[0].problem, [motion.case for motion in group]
    numbers = {key: style.number for key, style in drawn.items()}
    played = [motion.case for motion in group if {"attitude", "omega"} <= motion.known]
    plots = plot_data(problem, cases, (), drawn, None)
    drifts = {drift["name"]: drift for drift in plots["drifts"]}
    at_floor = [
        name
        for name in drifts
        if (known := [motion.is_at_floor(name) for motion in group if name in motion.row]) and all(known)
    ]
    clear = [name for name in drifts if name not in at_floor]
    first = sorted(clear, key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))
    return _Section(
        name=", ".join(motion.name for motion in group),
        anchor=f"motion-{number}",
        plots=plots | {"drifts": [drifts[name] for name in clear]},
        first=tuple(first[:2]),
        at_floor=tuple(drifts[name]["title"] for name in at_floor),
        motion=played_motions(problem, played, numbers, None) if played else None,
    )
