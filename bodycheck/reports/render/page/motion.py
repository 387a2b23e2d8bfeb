"""The motions that the report plays: the truth and one method of each engine, in principal axes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.pivot import turning_inertia
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.scene import RigidBody
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.page.downsampling import packed, rounded
from bodycheck.reports.run_files.run_tables import MethodKey, key_of

FRAMES = 201
"""The largest number of states per motion in the page; they dominate its size."""

_THINNEST = 0.06  # of the longest edge: a plate without thickness would be invisible from its side


def motion_view(
    problem: Problem, cases: Sequence[CaseResult], numbers: Mapping[MethodKey, int]
) -> dict[str, Any] | None:
    """Return the data of the view of one scenario: its body, the truth, and one track per shown method.

    numbers: the style number of each method. Returns None if no method with a step ended well.
    """
    at_s = coarsest_shared_step(cases)
    shown = shown_cases(cases, at_s)
    if at_s is None or not shown:
        return None
    inertia = turning_inertia(problem.scenario.scene)
    moments, axes = principal_frame(inertia)
    frames = frame_numbers(problem.compared)
    return {
        "dt": at_s,
        "t": [float(f"{t:.6g}") for t in problem.times[frames]],
        "moments": moments.tolist(),
        "corners": _rounded(box_corners(problem.scenario.scene.body) @ axes),
        "truth": _track(problem.truth.trajectory, axes, frames),
        "methods": [
            {"m": numbers[key_of(case.columns)], **_track(case.trajectory, axes, frames)}
            for case in shown
            if case.trajectory is not None
        ],
    }


def coarsest_shared_step(cases: Sequence[CaseResult]) -> float | None:
    """Return the coarsest of the steps at which most methods ended well, where errors are most visible."""
    shared = Counter(case.dt_s for case in cases if case.dt_s is not None and case.ok)
    return max(shared, key=lambda dt_s: (shared[dt_s], dt_s), default=None)


def shown_cases(cases: Sequence[CaseResult], at_s: float | None) -> list[CaseResult]:
    """Return, for each engine, the case at that step that is farthest from the truth."""
    worst: dict[str, CaseResult] = {}
    for case in cases:
        if case.ok and case.dt_s == at_s and case.trajectory is not None:
            engine = case.columns["engine"]
            least = worst.get(engine)
            if least is None or _error(case) > _error(least):
                worst[engine] = case
    return list(worst.values())


def _error(case: CaseResult) -> float:
    return float(case.columns["orientation_error_rad"])


def frame_numbers(samples: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Return the indices of at most FRAMES evenly spread samples, including the first and the last."""
    return np.unique(np.linspace(0, samples - 1, min(samples, FRAMES)).round().astype(np.intp))


def principal_frame(inertia: Array) -> tuple[Array, Array]:
    """I = A diag(moments) A^T: the moments (3,) and the rotation A (3, 3); A = 1 if I is diagonal."""
    if np.array_equal(np.diag(np.diag(inertia)), inertia):
        return np.diag(inertia).copy(), np.eye(3)
    moments, axes = np.linalg.eigh(inertia)
    return moments, axes * np.array([1.0, 1.0, np.sign(np.linalg.det(axes))])


def box_corners(body: RigidBody) -> Array:
    """a_i^2 ~ I_j + I_k - I_i: the corners (8, 3) of the box with this tensor, body axes, at distance 0.9.

    The edges of the box have the same proportions as the axes of the solid ellipsoid with this tensor.
    """
    moments, axes = principal_frame(body.inertia)
    edges = np.sqrt(np.maximum(moments.sum() - 2.0 * moments, 0.0))
    edges = np.maximum(edges, _THINNEST * edges.max())
    signs = np.array([[2.0 * (k >> i & 1) - 1.0 for i in range(3)] for k in range(8)])
    return np.asarray(0.9 * (signs * edges / np.linalg.norm(edges)) @ axes.T)


def _track(
    trajectory: Trajectory, axes: Array, frames: np.ndarray[tuple[int], np.dtype[np.intp]]
) -> dict[str, str]:
    """Return quaternions (n, 4) of the principal axes and omega (n, 3) along them, as packed float32."""
    q = matrix_to_quaternion(trajectory.rotation_matrices[frames] @ axes)
    omega = trajectory.omega_body[frames] @ axes
    return {"q": packed(q), "omega": packed(omega)}


def _rounded(values: Array) -> list[list[float]]:
    return [[rounded(x) for x in row] for row in values]
