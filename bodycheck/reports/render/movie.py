"""Draw the motions of a run as an animation: each engine's body, with the truth over it in grey."""

from __future__ import annotations

import tempfile
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.formatting import number, step
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.body_figures import (
    KEY,
    bare_axes,
    draw_bodies,
    draw_frames,
    equal_motions,
    method_name,
)
from bodycheck.reports.render.body_surface import DrawnBodies
from bodycheck.reports.render.figures import WIDTHS_IN, check_drawable, figure_bytes, rendering
from bodycheck.reports.render.page.played_motions import shown_cases, shown_errors
from bodycheck.reports.render.styles import TRUTH
from bodycheck.reports.run_files.run_tables import Run, coarsest_shared_step
from bodycheck.reports.table_layout import Column

if TYPE_CHECKING:
    from matplotlib.animation import AbstractMovieWriter
    from matplotlib.figure import Figure

FRAMES = 200
"""The largest number of frames of an animation."""

_PLAY_S = 10.0
_HOLD_S = 1.5
_SEEN_RAD = 0.1  # six degrees
_SLOWEST, _FASTEST = 2, 25  # frames per second
_SIZE_IN = (9.6, 5.4)  # 16:9
_MAX_IN_ROW = 4
_DOTS_PER_INCH = 100
_FONT = 11
_LETTERS = 104  # of a line of this font across the page
_LINE = 0.036  # its height, as a share of the page
_ARROW = 0.7  # in the units of the panels, whose half width is 0.75
_AXIS = 0.95  # of a body, in the same units: it begins along the arrow, and must be seen beside it


def check_movie(mp4: Path | None) -> None:
    """Raise UnavailableError without matplotlib, and without ffmpeg if an MP4 file is requested."""
    check_drawable("animations")
    with rendering():
        from matplotlib.animation import FFMpegWriter

        if mp4 is not None and not FFMpegWriter.isAvailable():
            raise UnavailableError(f"--mp4 {mp4}: needs ffmpeg on the path; --gif does not")


def movie(
    run: Run, scenario: str, suffix: str, engines: Sequence[str] = (), dt_s: float | None = None
) -> bytes:
    """Return an animation of one scenario as the bytes of a file; an SVG is a strip of frames.

    engines: the bodies, as ENGINE (its method farthest from the truth) or ENGINE:METHOD; all engines if
    empty. dt_s: their step; if None, the coarsest that most of them share. Raises InputError if the run has
    no such motion.
    """
    problem, filmed = _filmed(run, scenario, engines, dt_s)
    with rendering():
        from matplotlib.figure import Figure

        if suffix == ".svg":
            page = Figure(figsize=(WIDTHS_IN[2], 1.0), layout="constrained")
            page.suptitle(f"{scenario}, dt {step(filmed[0].dt_s)} s ({KEY})\n", fontsize=8)
            draw_frames(page, problem, filmed)
            return figure_bytes(page, suffix)
        with tempfile.TemporaryDirectory() as folder:  # a writer of matplotlib needs a path
            film = Path(folder) / f"film{suffix}"
            _write_film(film, Figure(), problem, filmed)
            return film.read_bytes()


def movie_document(
    run: Run, scenario: str, engines: Sequence[str] = (), dt_s: float | None = None
) -> Document:
    """Return what a film shows: its bodies, the farthest first, and from when each is seen to be wrong."""
    problem, filmed = _filmed(run, scenario, engines, dt_s)
    groups = sorted(equal_motions(problem, filmed), key=lambda group: -shown_errors(problem, group[0]).max())
    rows = []
    for group in groups:
        errors = shown_errors(problem, group[0])
        seen = problem.times[: len(errors)][errors > _SEEN_RAD]
        rows.append(
            (
                " = ".join(map(method_name, group)),
                number(float(errors.max()), 3),
                number(float(problem.times[errors.argmax()]), 4) if errors.any() else "",
                number(float(seen[0]), 4) if len(seen) else "never",
            )
        )
    farthest, error, at_s, _ = rows[0]
    where = f"{scenario}, dt {step(filmed[0].dt_s)} s"
    conclusion = f"farthest from the truth is {farthest}, by {error} rad at {at_s} s"
    return Document(
        "bodycheck: film",
        (
            Sentence(f"{where}: {conclusion if at_s else 'no body leaves the truth'}."),
            Table(
                (
                    Column("body (=: equal motions)"),
                    Column("largest error, rad", "number"),
                    Column("at t, s", "number"),
                    Column(f"above {_SEEN_RAD:g} rad from t, s", "number"),
                ),
                tuple(rows),
            ),
        ),
    )


def _filmed(
    run: Run, scenario: str, engines: Sequence[str], dt_s: float | None
) -> tuple[Problem, list[CaseResult]]:
    problem = next((one for one in run.problems if one.scenario.name == scenario), None)
    cases = [case for case in run.cases if case.columns["scenario"] == scenario]
    filmed = filmed_cases(cases, engines, dt_s)
    if problem is None or not filmed:
        raise InputError(f"--scenario {scenario}: no case with a step has outcome ok")
    return problem, filmed


def filmed_cases(
    cases: Sequence[CaseResult], engines: Sequence[str] = (), dt_s: float | None = None
) -> list[CaseResult]:
    """Return the cases of one scenario that a film shows; parameters and errors as in movie."""
    chosen = [
        case for case in cases if not engines or {case.columns["engine"], method_name(case)} & {*engines}
    ]
    moved = [case for case in chosen if case.ok and case.dt_s is not None]
    steps = sorted({case.dt_s for case in moved if case.dt_s is not None})
    if dt_s is not None and dt_s not in steps:
        known = ", ".join(map(step, steps)) or "none"
        raise InputError(f"--dt {step(dt_s)}: no motion has this step (available: {known})")
    at_s = coarsest_shared_step(moved) if dt_s is None else dt_s
    candidates = [case for case in moved if not engines or case.columns["engine"] in engines]
    named = (
        [case for case in moved if case.columns["engine"] not in engines and case.dt_s == at_s]
        if engines
        else []
    )
    filmed = [*shown_cases(candidates, at_s), *named]
    available = {name for case in filmed for name in (case.columns["engine"], method_name(case))}
    if missing := [name for name in engines if name not in available]:
        raise InputError(f"--engine {', '.join(missing)}: no case at dt {step(at_s)} s has outcome ok")
    return filmed


def _write_film(film: Path, page: Figure, problem: Problem, cases: Sequence[CaseResult]) -> None:
    """Write the frames to a file; its suffix is the format."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    frames = film_frames(problem.compared)
    per_second = min(max(round(len(frames) / _PLAY_S), _SLOWEST), _FASTEST)
    writer: AbstractMovieWriter
    writer = PillowWriter(fps=per_second) if film.suffix == ".gif" else FFMpegWriter(fps=per_second)
    show = _panels(page, problem, cases)
    with writer.saving(page, film, _DOTS_PER_INCH):
        for k in frames:
            show(k)
            writer.grab_frame()
        # hold the last frame: a film that repeats would otherwise seem to jump back
        for _ in range(round(_HOLD_S * per_second)):
            writer.grab_frame()


def film_frames(samples: int) -> range:
    """Return the indices of at most FRAMES samples at equal intervals, from the first on."""
    return range(0, samples, -(-samples // FRAMES))


def _panels(page: Figure, problem: Problem, cases: Sequence[CaseResult]) -> Callable[[int], None]:
    """Draw one panel per case, and return the function that shows sample k in all of them."""
    groups = equal_motions(problem, cases)
    cases = [group[0] for group in groups]
    rows, columns = -(-len(cases) // _MAX_IN_ROW), min(len(cases), _MAX_IN_ROW)
    names = [
        textwrap.fill(" =\u00a0".join(map(method_name, group)), _LETTERS // columns, break_on_hyphens=False)
        for group in groups
    ]
    label = (1 + max(name.count("\n") for name in names)) * _LINE  # its height, as a share of the page
    top = 1.0 - 1.7 * _LINE - label
    height = (top - _LINE - (rows - 1) * (label + _LINE)) / rows  # of a panel
    page.set_size_inches(*_SIZE_IN)
    page.subplots_adjust(
        left=0.0, right=1.0, bottom=_LINE, top=top, wspace=0.0, hspace=(label + _LINE) / height
    )
    truth = problem.truth.trajectory
    drawn = DrawnBodies.of(problem.scenario, truth)
    errors = [shown_errors(problem, case) for case in cases]
    title = page.suptitle("", fontsize=_FONT, y=1.0 - 0.4 * _LINE)
    directions = _momentum_and_axis(problem)
    key = KEY if directions is None else f"{KEY}, with its angular momentum; dot: an axis of the body"
    bodies: list[tuple[Any, Trajectory]] = []
    lines: list[tuple[Any, Trajectory]] = []
    labels: list[Any] = []
    for index, (group, name) in enumerate(zip(groups, names, strict=True)):
        axes: Any = page.add_subplot(rows, columns, index + 1, projection="3d")
        bodies += draw_bodies(axes, drawn, truth, group, 0)
        if directions is not None:
            axes.quiver(0.0, 0.0, 0.0, *directions[0], color=TRUTH, linewidth=1.2, arrow_length_ratio=0.1)
            body, motion = bodies[-1]
            style = {"color": body.get_edgecolor()[0], "marker": "o", "markevery": [1]}
            lines.append((axes.plot(*directions[1][:, None], **style)[0], motion))
        bare_axes(axes, 0.75, name, fontsize=_FONT)
        labels.append(axes.text2D(0.5, 0.0, "", fontsize=_FONT, ha="center", transform=axes.transAxes))

    def show(k: int) -> None:
        title.set_text(
            f"{problem.scenario.name}, dt {step(cases[0].dt_s)} s: t = {truth.t_s[k]:.2f} s ({key})"
        )
        for body, motion in bodies:
            body.set_verts(drawn.polygons(motion, k))
        if directions is not None:
            for line, motion in lines:
                line.set_data_3d(*np.outer(motion.rotation_matrices[k] @ directions[1], (0.0, 1.0)))
        for text, error in zip(labels, errors, strict=True):
            text.set_text(f"error {number(float(error[k]), 2)} rad")

    return show


def _momentum_and_axis(problem: Problem) -> tuple[Array, Array] | None:
    """Return two arrows (3,), None where the angular momentum is not constant.

    Along it, in world axes, and, in body axes, along the principal axis that is nearest to it at the start:
    a flip turns the second against the first.
    """
    scene = problem.scenario.scene
    if isinstance(scene, TreeScene) or not scene.is_free_rotation:
        return None
    momentum = problem.motion.angular_momentum[0]
    size = float(np.linalg.norm(momentum))
    if not size:
        return None
    _, axes = diagonalised(rotational_inertia(scene))
    along = axes.T @ (problem.truth.trajectory.rotation_matrices[0].T @ momentum)
    nearest = int(np.argmax(np.abs(along)))
    return momentum * (_ARROW / size), axes[:, nearest] * (_AXIS * np.sign(along[nearest]))
