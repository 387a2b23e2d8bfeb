"""Films: which motions they show, at which samples, and that the bodies move."""

from __future__ import annotations

import io
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.render.movie import (
    FRAMES,
    _momentum_and_axis,
    _panels,
    check_movie,
    film_frames,
    filmed_cases,
    movie,
)
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage

pytest.importorskip("matplotlib")

TITLE_SHARE = 0.2
"""The upper part of a frame, which shows the time."""


@pytest.fixture(scope="module")
def run(stored_run: Path) -> Run:
    """Return a run with its motions."""
    return read_run(stored_run, allow_code=False, cache=Cache.default())


def case(engine: str, method: str, dt_s: float, error: float) -> CaseResult:
    """Return a case that ended well, with the columns that the choice of cases reads."""
    columns = {
        "engine": engine,
        "method": method,
        "dt_s": dt_s,
        "outcome": "ok",
        "orientation_error_rad": error,
    }
    return CaseResult(columns)


CASES = [
    case("a", "near", 0.1, 1e-6),
    case("a", "far", 0.1, 1e-2),
    case("a", "far", 0.01, 1e-4),
    case("b", "one", 0.1, 1e-3),
]


@pytest.mark.parametrize(
    ("engines", "dt_s", "shown"),
    [
        ((), None, [1, 3]),
        (("a",), None, [1]),
        (("a",), 0.01, [2]),
        (("a:near",), None, [0]),
        (("b", "a:near", "a:far"), None, [3, 0, 1]),
    ],
)
def test_an_engine_shows_its_farthest_method_and_a_named_method_itself(
    engines: tuple[str, ...], dt_s: float | None, shown: list[int]
) -> None:
    """All bodies have the same step: the given one, or the coarsest that most share."""
    assert filmed_cases(CASES, engines, dt_s) == [CASES[k] for k in shown]


@pytest.mark.parametrize(("engines", "dt_s"), [((), 0.2), (("a", "b"), 0.01)])
def test_a_missing_motion_is_refused(
    engines: tuple[str, ...], dt_s: float, expected_message: ExpectedMessage
) -> None:
    """The message names a step that no motion has, or that a named engine lacks."""
    with pytest.raises(InputError) as refused:
        filmed_cases(CASES, engines, dt_s)
    expected_message(str(refused.value))


@pytest.mark.parametrize("samples", [2, FRAMES, FRAMES + 1, 10_007])
def test_frames_are_evenly_spaced(samples: int) -> None:
    """There are at most FRAMES, from the first sample to within one interval of the last."""
    frames = film_frames(samples)
    assert frames[0] == 0
    assert len(frames) <= FRAMES
    assert 0 <= samples - 1 - frames[-1] < frames.step


def test_the_program_of_a_format_is_checked_first(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """For MP4 without ffmpeg, the message names what is needed; other formats need no program."""
    monkeypatch.setenv("PATH", "")
    check_movie(None)
    with expected_message.raises(UnavailableError):
        check_movie(Path("a.mp4"))


def test_a_flip_turns_the_axis_of_a_film_against_the_angular_momentum() -> None:
    """At the start it is along it to a tenth of a radian, and the true motion turns it over."""
    scenario = load_scenario("intermediate-axis")
    problem = Problem.of(scenario, scenario.name)
    directions = _momentum_and_axis(problem)
    assert directions is not None
    momentum, axis = (one / np.linalg.norm(one) for one in directions)
    cosines = problem.truth.trajectory.rotation_matrices @ axis @ momentum
    assert cosines[0] > np.cos(0.1)
    assert cosines.min() < -np.cos(0.2)


@pytest.mark.nightly
def test_the_bodies_of_a_film_move(run: Run) -> None:
    """There is one frame per sample, equal films are equal bytes, and frames differ below the title."""
    from PIL import Image

    film = movie(run, "free", ".gif", ("reference:rk4",))
    assert film == movie(run, "free", ".gif", ("reference:rk4",))
    with Image.open(io.BytesIO(film)) as shown:
        assert shown.n_frames == run.problems[0].compared
        height = shown.size[1]
        frames = []
        for k in range(shown.n_frames):
            shown.seek(k)
            frames.append(
                np.asarray(shown.convert("L"), dtype=float)[int(TITLE_SHARE * height) : -height // 5]
            )
    assert shown.info["duration"] > 1500  # the last frame is held
    changed = [np.mean(np.abs(after - before) > 30.0) for before, after in pairwise(frames)]
    assert min(changed) > 1e-3


@pytest.mark.nightly
def test_equal_motions_are_one_body_with_all_their_names(run: Run) -> None:
    """Eight methods of which seven move equally are two bodies; no text of the frame covers another."""
    from matplotlib.figure import Figure

    cases = [case for case in run.cases if case.columns["scenario"] == "free"]
    apart, *alike = filmed_cases(cases, ("reference:m1", "reference:rk4"))
    alike += [replace(alike[0], columns={**alike[0].columns, "engine": f"engine-{k}"}) for k in range(6)]
    page = Figure()
    _panels(page, run.problems[0], [apart, *alike])(1)
    texts = [text for axes in page.axes for text in axes.texts]
    names = " ".join(text.get_text() for text in texts).replace("\N{NO-BREAK SPACE}", " ")
    assert len(page.axes) == 2
    assert "reference:rk4 = engine-0:rk4 = engine-1:rk4 = engine-2:rk4 = engine-3:rk4" in names.replace(
        "\n", " "
    )
    boxes = [text.get_window_extent() for text in texts]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert max(box.width for box in boxes) < page.bbox.width / 2


@pytest.mark.nightly
def test_a_strip_names_its_bodies(run: Run) -> None:
    """The SVG has the name of each body and the times of its frames."""
    strip = movie(run, "free", ".svg", ("reference:rk4", "reference:m1")).decode()
    assert "<!-- reference:rk4 -->" in strip
    assert "<!-- reference:m1 -->" in strip
    assert "<!-- 1 s -->" in strip
