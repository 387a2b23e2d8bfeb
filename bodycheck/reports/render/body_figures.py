"""Figures of the body itself for papers: the polhode, and the body at several times next to the truth's."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number, step
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measure_bounds import FLOOR_BOUNDS
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.body_surface import DrawnBodies
from bodycheck.reports.render.page.played_motions import shown_cases
from bodycheck.reports.render.styles import COLOURS, TRUTH, TRUTH_DASH, engine_colour, merged, stacked
from bodycheck.reports.run_files.run_tables import Run, coarsest_shared_step, key_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRAMES = 6
"""The number of times at which the body is drawn."""

KEY = "truth: grey, dashed"
"""How the true body is drawn."""

_ROW_IN = 0.75  # of a row of frames
_FEW_FACES = 30  # beyond that the edges of all faces would hide them


def draw(page: Figure, run: Run, figure: str, scenario: str, cases: Sequence[CaseResult]) -> None:
    """Draw "polhode" or "motion" of the truth and, for each engine, the method farthest from it.

    cases: those of the scenario that are drawn, at the coarsest step that most methods share. Raises
    InputError if none of them has a motion.
    """
    problem = next((one for one in run.problems if one.scenario.name == scenario), None)
    at_s = coarsest_shared_step(cases)
    cases_drawn = [case for case in shown_cases(cases, at_s) if case.trajectory is not None]
    if problem is None or not cases_drawn:
        raise InputError(f"--figure {figure}: nothing to draw for {scenario}: no case has a motion")
    key = "(truth: grey)" if figure == "polhode" else f"({KEY})\n"  # names stand in the second line
    page.suptitle(f"{scenario}, dt {step(at_s)} s {key}", fontsize=8)
    (_polhodes if figure == "polhode" else draw_frames)(page, problem, cases_drawn)


def polhode(trajectory: Trajectory, truth: Trajectory, inertia: Array) -> Array:
    """omega / sqrt(2 K*) in principal axes (n, 3): for the truth it lies on the ellipsoid of inertia.

    K* is the truth's rotational energy, so a motion that loses energy leaves the ellipsoid.
    """
    moments, axes = diagonalised(inertia)
    twice = np.sum(moments * (truth.omega_body @ axes) ** 2, axis=1)
    moving = twice > 1e-6 * twice.max()
    return np.asarray((trajectory.omega_body @ axes)[moving] / np.sqrt(twice[moving])[:, None])


def _polhodes(page: Figure, problem: Problem, cases_drawn: Sequence[CaseResult]) -> None:
    inertia = rotational_inertia(problem.of_body.scene)
    moments, _ = diagonalised(inertia)
    semiaxes = 1.0 / np.sqrt(moments)
    truth = problem.truth.trajectory
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 25), np.linspace(0.0, np.pi, 13))
    sphere = np.array([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)])
    groups = equal_motions(problem, cases_drawn)
    names_in = 0.1 * max(map(len, groups))
    page.set_figheight(page.get_figwidth() / max(len(groups), 2) + 0.2 + names_in)
    for index, group in enumerate(groups):
        axes: Any = page.add_subplot(1, len(groups), index + 1, projection="3d")
        x, y, z = semiaxes[:, None, None] * sphere
        axes.plot_wireframe(x, y, z, color="#d0d0d0", linewidth=0.3)
        layers = stacked(map(key_of, (case.columns for case in group)))
        axes.plot(*polhode(truth, truth, inertia).T, color=TRUTH, linewidth=2.0 + 0.8 * layers[0][1])
        motion = group[0].trajectory
        assert motion is not None
        for (engine, _), above in layers:
            colour, width = COLOURS[engine_colour(engine)], 0.8 + 0.8 * above
            axes.plot(*polhode(motion, truth, inertia).T, color=colour, linewidth=width)
        bare_axes(axes, semiaxes.max(), "\n= ".join(map(method_name, group)))


def draw_frames(page: Figure, problem: Problem, cases_drawn: Sequence[CaseResult]) -> None:
    """Draw each case at FRAMES times, one row per case, the truth as an outline."""
    truth = problem.truth.trajectory
    frames = np.linspace(0, problem.compared - 1, FRAMES).round().astype(np.intp)
    drawn = DrawnBodies.of(problem.scenario, truth)
    groups = equal_motions(problem, cases_drawn)
    page.set_figheight(_ROW_IN * len(groups) + 0.5)
    for row, group in enumerate(groups):
        for column, k in enumerate(frames):
            axes: Any = page.add_subplot(len(groups), FRAMES, row * FRAMES + column + 1, projection="3d")
            draw_bodies(axes, drawn, truth, group, k)
            time = f"{number(float(truth.t_s[k]), 3)} s"
            bare_axes(axes, 0.75, time)
            if column == 0:
                names = " = ".join(map(method_name, group))
                title = axes.text2D(0.0, 1.25, names, fontsize=6, transform=axes.transAxes)
                title.set_in_layout(False)  # or a long one would widen its column


def equal_motions(problem: Problem, cases: Sequence[CaseResult]) -> list[list[CaseResult]]:
    """Return the cases whose errors over time cannot be distinguished together, in the order of `cases`."""
    errors = {k: case.series[ORIENTATION] for k, case in enumerate(cases)}
    lines = {k: (np.arange(len(error), dtype=np.float64), error) for k, error in errors.items()}
    groups = merged(lines, FLOOR_BOUNDS * float(np.max(problem.truth.bound_rad)))
    return [[cases[k] for k in group] for group in groups]


def draw_bodies(
    axes: Any, drawn: DrawnBodies, truth: Trajectory, group: Sequence[CaseResult], k: int
) -> list[tuple[Any, Trajectory]]:
    """Draw the true bodies at sample k, over them those of equal motions, and return both with their motions.

    Each engine of the group colours its share of the faces.
    """
    from matplotlib.colors import to_rgba
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]

    axes.computed_zorder = False  # the order of distances, which changes while two bodies turn
    motion = group[0].trajectory
    assert motion is not None
    own = [COLOURS[engine_colour(engine)] for engine in dict.fromkeys(c.columns["engine"] for c in group)]
    bodies: list[tuple[Any, Trajectory]] = []
    for moved, colours, opacities, dash in (
        (truth, [TRUTH], (0.05, 0.3), (0, TRUTH_DASH)),
        (motion, own, (0.25, 0.85), "solid"),
    ):
        faces = [
            to_rgba(colours[face * len(colours) // len(one.faces)], opacities[face in one.marked])
            for one in drawn.surfaces
            for face in range(len(one.faces))
        ]
        width = 0.6 if len(faces) <= _FEW_FACES * len(drawn.surfaces) else 0.1
        style: Any = {"facecolors": faces, "edgecolors": [face[:3] for face in faces], "linewidths": width}
        bodies.append((Poly3DCollection(drawn.polygons(moved, k), linestyles=dash, **style), moved))
        axes.add_collection3d(bodies[-1][0])
    return bodies


def method_name(case: CaseResult) -> str:
    """Return engine:method."""
    return f"{case.columns['engine']}:{case.columns['method']}"


def bare_axes(axes: Any, reach: float, title: str, fontsize: float = 6.0) -> None:
    """Show a cube of [-reach, reach] at equal scales, without axes."""
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    axes.set_box_aspect((1, 1, 1), zoom=1.3)
    axes.set_axis_off()
    axes.text2D(0.5, 1.0, title, fontsize=fontsize, ha="center", transform=axes.transAxes)
