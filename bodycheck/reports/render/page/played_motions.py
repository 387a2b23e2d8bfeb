"""The motions that the report plays: the truth and cases of each engine, in principal axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from bodycheck.adapters.engine_names import REFERENCE
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.body_surface import BOX_FACES, surface_of, tree_box
from bodycheck.reports.render.page.downsampling import packed_fractions, packed_line
from bodycheck.reports.run_files.run_tables import MethodKey, coarsest_shared_step, common_step, key_of
from bodycheck.scenarios.body import Body

FRAMES = 101
"""The largest number of evenly spread states per motion in the page; they dominate its size."""

TRACKS = 16
"""The largest number of cases per scenario whose motions are in the page."""


def motion_view(
    problem: Problem, cases: Sequence[CaseResult], numbers: Mapping[MethodKey, int], most: int = TRACKS
) -> dict[str, Any] | None:
    """Return the data of the view of one scenario: its body, the truth, and tracks of cases.

    numbers: the style number of each method. most: the largest number of tracks, but one of each engine is
    always there. Returns None if no method with a step ended well.
    """
    at_s = coarsest_shared_step(cases)
    played = played_cases(cases, at_s)
    if at_s is None or not played:
        return None
    most = min(max(most, len(shown_cases(cases, at_s))), TRACKS)
    return played_motions(problem, played, numbers, at_s, most)


def played_motions(
    problem: Problem,
    played: Sequence[CaseResult],
    numbers: Mapping[MethodKey, int],
    at_s: float | None,
    most: int = TRACKS,
) -> dict[str, Any]:
    """Return the data of a view of the truth and of cases with samples at the same times.

    at_s: the step at which those shown first were chosen, None where they have none. most: the largest number
    of cases.
    """
    shown = played[:most]
    errors = [shown_errors(problem, case) for case in shown]
    opened = {case.columns["engine"]: k for k, case in reversed([*enumerate(shown)])}.values()
    worst = max(opened, key=lambda k: float(errors[k].max()))
    farthest = int(errors[worst].argmax())
    frames = np.union1d(frame_numbers(problem.compared), [farthest])
    if isinstance(problem.scenario.scene, TreeScene):
        scene, true = problem.scenario.scene, problem.truth.trajectory.position_m[frames]
        centres = _centres(scene, true)
        bodies = _tree(problem.scenario.name, scene, true - centres)
        track = partial(_tree_track, scene, frames=frames, centres=centres)
    else:
        moments, axes = diagonalised(rotational_inertia(problem.of_body.scene))
        bodies = {"moments": moments.tolist(), "body": _body(problem.of_body.body, axes)}
        track = partial(_track, axes=axes, frames=frames)
    times = [float(f"{t:.6g}") for t in problem.times[frames]]
    return {
        "dt": at_s,
        "t": times,
        "farthest": {
            "m": numbers[key_of(shown[worst].columns)],
            "t": times[np.searchsorted(frames, farthest)],
            "error": float(errors[worst][farthest]),
        },
        **bodies,
        "truth": track(problem.truth.trajectory),
        "tracks": [
            {
                "m": numbers[key_of(case.columns)],
                "dt": case.dt_s,
                "error": packed_line(error[frames]),
                **track(case.trajectory),
            }
            for case, error in zip(shown, errors, strict=True)
            if case.trajectory is not None
        ],
        "panels": 1 + len(opened),  # the truth, and one per engine
        "left_out": max(len(played) - most, 0),
    }


def shown_cases(cases: Sequence[CaseResult], at_s: float | None) -> list[CaseResult]:
    """Return, for each engine, the case at that step that is farthest from the truth."""
    worst: dict[str, CaseResult] = {}
    for case in cases:
        if case.ok and case.dt_s == at_s:
            engine = case.columns["engine"]
            worst_error = worst.get(engine)
            if worst_error is None or _error(case) > _error(worst_error):
                worst[engine] = case
    return list(worst.values())


def played_cases(cases: Sequence[CaseResult], at_s: float | None) -> list[CaseResult]:
    """Return the cases that can be played: first the case of each engine farthest from the truth at a step.

    Then come the cases of the plots over time, which a click selects, and the others from the coarsest step
    on; of the reference only the farthest of each step.
    """
    steps = sorted({case.dt_s for case in cases if case.ok and case.dt_s is not None}, reverse=True)
    farthest = [case for dt_s in steps for case in shown_cases(cases, dt_s)]
    engines = [
        case
        for dt_s in steps
        for case in cases
        if case.dt_s == dt_s and case.ok
        if case.columns["engine"] != REFERENCE
    ]
    plotted = [case for case in engines if case.dt_s == common_step(cases)]
    ordered = (*shown_cases(cases, at_s), *plotted, *farthest, *engines)
    return list({id(case): case for case in ordered}.values())


def shown_errors(problem: Problem, case: CaseResult) -> Array:
    """Return the error in rad at each sample (n,), 0 where it is within the bound of the truth."""
    errors = case.series[ORIENTATION]
    return np.where(errors > problem.truth.bound_rad[: len(errors)], errors, 0.0)


def _error(case: CaseResult) -> float:
    return float(case.columns[ORIENTATION])


def frame_numbers(samples: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the indices of at most FRAMES evenly spread samples, including the first and the last."""
    return np.unique(np.linspace(0, samples - 1, min(samples, FRAMES)).round().astype(np.intp))


def _track(
    trajectory: Trajectory, axes: Array, frames: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> dict[str, Any]:
    """Return quaternions (n, 4) of the principal axes and omega (n, 3) along them, packed as int16."""
    q = matrix_to_quaternion(trajectory.rotation_matrices[frames] @ axes)
    omega = trajectory.omega_body[frames] @ axes
    fastest = float(np.abs(omega).max())
    return {"q": packed_fractions(q), "omega": packed_fractions(omega, fastest), "fastest": fastest}


def _body(body: Body, axes: Array) -> dict[str, Any]:
    """Return the surface of a body in principal axes: vertices (n, 3), faces, marked faces."""
    surface = surface_of(body)
    return {
        "name": surface.name,
        "vertices": [[round(x, 4) for x in vertex] for vertex in (surface.vertices @ axes).tolist()],
        "faces": surface.faces,
        "marked": sorted(surface.marked),
    }


def _centres(scene: TreeScene, true: Array) -> Array:
    """Return what is in the middle of the view (n, 1, 3): a free tree, which it follows, or else its space.

    true: where the bodies truly are (n, bodies, 3).
    """
    if any(body.joint.kind == "free" for body in scene.bodies):
        return true.mean(axis=1, keepdims=True)
    return 0.5 * (true.max(axis=(0, 1), keepdims=True) + true.min(axis=(0, 1), keepdims=True))


def _tree(name: str, scene: TreeScene, true: Array) -> dict[str, Any]:
    """Return the bodies of a tree, how far they truly are from the middle, and the names of its joints.

    true: their places from the middle of the view (n, bodies, 3).
    """
    parts = _parts(scene)
    size = max(float(np.max(np.abs(part["vertices"]))) for part in parts)
    return {
        "body": {"name": f"the tree {name}"},
        "parts": parts,
        "reach": float(np.max(np.linalg.norm(true, axis=-1))) + size,
        "joints": [f"{body}.{unit}" for body, unit, _ in _joint_places(scene)],
    }


def _parts(scene: TreeScene) -> list[dict[str, Any]]:
    """Return the box of each body in its axes, in m, and the lines from its centre of mass to its joints."""
    found = []
    for k, body in enumerate(scene.bodies):
        points = [] if body.joint.kind == "free" else [body.joint.at_body]
        points += [other.joint.at_parent for other in scene.bodies if other.joint.parent == k]
        found.append(
            {
                "vertices": np.round(tree_box(body), 5).tolist(),
                "faces": BOX_FACES,
                "marked": [1],
                "sticks": [np.round(point, 5).tolist() for point in points],
            }
        )
    return found


def _joint_places(scene: TreeScene) -> list[tuple[str, str, int]]:
    """Return body, unit and place in q of each joint with one coordinate."""
    return [
        (body.name, "m" if body.joint.kind == "slide" else "rad", place.start)
        for body, place in zip(scene.bodies, scene.coordinate_slices, strict=True)
        if body.joint.of_kind.is_scalar
    ]


def _tree_track(
    scene: TreeScene,
    trajectory: Trajectory,
    frames: np.ndarray[tuple[int], np.dtype[np.intp]],
    centres: Array,
) -> dict[str, Any]:
    """Return the motion of each body as for one, and the coordinates of joints (n,).

    Places x (n, 3) are from the middle of the view.
    """
    quaternions, places = trajectory.attitude[frames], trajectory.position_m[frames] - centres
    omega = trajectory.omega_body[frames]
    far, fastest = (max(float(np.abs(values).max()), 1e-9) for values in (places, omega))
    coordinates = (
        [] if trajectory.q is None else [trajectory.q[frames, at] for *_, at in _joint_places(scene)]
    )
    return {
        "far": far,
        "fastest": fastest,
        "bodies": [
            {
                "q": packed_fractions(quaternions[:, k]),
                "omega": packed_fractions(omega[:, k], fastest),
                "x": packed_fractions(places[:, k], far),
            }
            for k in range(len(scene.bodies))
        ],
        "joints": [[float(f"{value:.4g}") for value in one] for one in coordinates],
    }
