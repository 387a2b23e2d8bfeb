"""The choice of motions that the page plays, and their agreement with the trajectories."""

from __future__ import annotations

import json
from base64 import b64decode
from typing import Any

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import RigidBody
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.body_surface import box_corners, surface_of
from bodycheck.reports.render.page.played_motions import (
    FRAMES,
    frame_numbers,
    played_cases,
    played_motions,
    shown_cases,
)
from bodycheck.reports.run_files.run_tables import Run, coarsest_shared_step, key_of
from bodycheck.scenarios.library import load_scenario
from tests.helpers.html_page import Page


def rotation(seed: int) -> Array:
    """Return a random rotation matrix."""
    q = np.random.default_rng(seed).normal(size=4)
    return quaternion_to_matrix(q / np.linalg.norm(q))


@pytest.mark.parametrize("seed", range(3))
def test_the_box_has_the_edges_of_the_body(seed: int) -> None:
    """The corners derived from a rotated box's tensor are those of the box, up to a factor and axis names."""
    edges, turned = np.array([1.0, 0.5, 0.2]), rotation(seed)
    squares = edges**2
    inertia = turned @ np.diag(squares.sum() - squares) @ turned.T / 12.0
    corners = box_corners(RigidBody(1.0, 0.5 * (inertia + inertia.T))) @ turned
    assert np.allclose(np.abs(corners), 0.9 * edges / np.linalg.norm(edges), atol=1e-12)
    assert len(np.unique(np.sign(corners), axis=0)) == 8


def test_a_plate_is_drawn_with_some_thickness() -> None:
    """A body without thickness gets a rim that is visible from the side."""
    corners = box_corners(RigidBody(1.0, np.diag([1.0, 2.0, 3.0])))
    assert np.abs(corners).min() > 0.02


@pytest.mark.parametrize("samples", [2, 11, FRAMES, FRAMES + 1, 10_007])
def test_frames_reach_from_the_first_sample_to_the_last(samples: int) -> None:
    """Many samples are thinned evenly and in order; few are all taken."""
    frames = frame_numbers(samples)
    assert frames[0] == 0
    assert frames[-1] == samples - 1
    assert len(frames) == min(samples, FRAMES)
    assert np.ptp(np.diff(frames)) <= 1


def test_the_view_opens_at_the_sample_that_is_farthest_from_the_truth() -> None:
    """Also where it is not one of the evenly spread ones, as a single wrong row of a recording."""
    scenario = load_scenario("intermediate-axis").model_copy(update={"samples": 201})
    problem = Problem.of(scenario, scenario.name, None)
    errors = np.zeros(problem.compared)
    (wrong, *_) = {*range(problem.compared)} - {*frame_numbers(problem.compared).tolist()}
    errors[wrong] = 1.4
    columns = {"engine": "a", "method": "b", "scenario": "intermediate-axis", "dt_s": 0.1, "outcome": "ok"}
    off = CaseResult(columns, MeasuredMotion(problem.truth.trajectory, {ORIENTATION: errors}))
    view = played_motions(problem, [off], {key_of(columns): 0}, 0.1)
    assert view["farthest"] == {"m": 0, "t": pytest.approx(problem.times[wrong]), "error": 1.4}
    assert view["farthest"]["t"] in view["t"]
    assert view["t"] == sorted(view["t"])


def case(engine: str, dt_s: float, error: float, outcome: str = "ok") -> CaseResult:
    """Return a case with the columns that the choice of cases reads."""
    columns = {"engine": engine, "dt_s": dt_s, "outcome": outcome, "orientation_error_rad": error}
    return CaseResult(columns)


def test_each_engine_is_shown_where_it_is_worst() -> None:
    """Of each engine the ok method with the largest error is shown, at the coarsest step that most share."""
    cases = [
        *(case("a", dt_s, error) for dt_s in (0.1, 0.01) for error in (1e-3, 2e-3)),
        case("a", 0.1, 9.0, outcome="unstable"),
        case("b", 0.01, 1e-9),
        case("b", 0.1, 1e-8),
        case("b", 1.0, 0.5),
    ]
    assert coarsest_shared_step(cases) == 0.1
    assert shown_cases(cases, 0.1) == [cases[1], cases[6]]
    assert coarsest_shared_step([]) is None


def test_the_cases_to_play_begin_with_those_shown() -> None:
    """The worst case of each engine comes first, then the finest shared step; each case appears once."""
    cases = [
        *(case("a", dt_s, error) for dt_s in (0.1, 0.01) for error in (1e-3, 2e-3)),
        case("a", 0.01, 9.0, outcome="unstable"),
        *(case("reference", dt_s, error) for dt_s in (0.1, 0.01) for error in (1e-9, 1e-8)),
    ]
    played = played_cases(cases, 0.1)
    assert played == [cases[k] for k in (1, 6, 2, 3, 8, 0)]


def unpacked(track: dict[str, Any]) -> tuple[Array, Array]:
    """Return rotation matrices and omega of a track, both in principal axes."""
    q, omega = (np.frombuffer(b64decode(track[name]), dtype="<i2") / 32767.0 for name in ("q", "omega"))
    return quaternion_to_matrix(q.reshape(-1, 4)), track["fastest"] * omega.reshape(-1, 3)


@pytest.mark.nightly
def test_the_page_plays_the_trajectories(page: Page, run: Run) -> None:
    """Truth and tracks have the attitude and omega of the trajectories, to 16 bits."""
    views = [data for data in map(json.loads, page.data) if "moments" in data]
    assert len(views) == len(run.problems)
    names = next(
        data for data in map(json.loads, page.data) if isinstance(data, list) and "marker" in data[0]
    )
    for view, problem in zip(views, run.problems, strict=True):
        assert np.allclose(view["t"], problem.times)
        tracks = [(view["truth"], problem.truth.trajectory)]
        for track in view["tracks"]:
            (shown,) = (
                c
                for c in run.cases
                if c.dt_s == track["dt"]
                and c.columns["scenario"] == problem.scenario.name
                and f"{c.columns['engine']}:{c.columns['method']}" == names[track["m"]]["name"]
            )
            assert shown.trajectory is not None
            tracks.append((track, shown.trajectory))
        assert len(tracks) > 3
        moments, axes = diagonalised(problem.scenario.scene.body.inertia)
        assert np.allclose(view["moments"], moments)
        drawn = surface_of(problem.scenario.body)
        assert np.allclose(np.array(view["body"]["vertices"]) @ axes.T, drawn.vertices, atol=1e-4)
        assert tuple(map(tuple, view["body"]["faces"])) == drawn.faces
        for track, trajectory in tracks:
            rotations, omega = unpacked(track)
            assert np.allclose(rotations @ axes.T, trajectory.rotation_matrices, atol=1e-4)
            assert np.allclose(np.einsum("nij,nj->ni", rotations, omega), trajectory.omega_world, atol=1e-3)
