"""A study: its cases are sorted from coarse to fine, in whatever order they were run."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest

from bodycheck.adapters.contract import Engine, Setting
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.study import study
from bodycheck.scenarios.library import load_scenario

STEPS = (0.05, 0.02, 0.01, 0.005)
FAILED = 0.01


@pytest.fixture(scope="module")
def problem() -> Problem:
    """A body that tumbles, with its truth."""
    return Problem.of(load_scenario("intermediate-axis"), "intermediate-axis")


@pytest.fixture(scope="module")
def answers(problem: Problem) -> dict[float | None, Answer]:
    """Return the reference's answer at each step; at one of them a failure."""
    cases = [Case(problem.scenario.scene, "rk4", Setting(dt_s=step)) for step in STEPS]
    said = {case.setting.dt_s: record(Reference(), case) for case in cases}
    return said | {FAILED: Answer("failed", "it crashed")}


@pytest.mark.parametrize("order", [STEPS, STEPS[::-1], *list(permutations(STEPS))[5::6]])
def test_successive_difference_is_the_angle_to_the_next_coarser_case(
    order: tuple[float, ...], problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """The largest angle between the two motions over the samples; absent if one of them failed."""
    adapter = Reference()
    engine = Engine(adapter.name, adapter.version, adapter.methods)
    found = study(
        problem,
        engine,
        adapter.methods["rk4"],
        [Setting(dt_s=step) for step in order],
        adaptive=False,
        ask=lambda _, case: answers[case.setting.dt_s],
        search=lambda _, search: pytest.fail(f"nobody asked for {search}"),
        case_done=lambda: None,
    ).cases
    assert [case.dt_s for case in found] == sorted(STEPS, reverse=True)
    assert "successive_difference_rad" not in found[0].columns
    for coarser, case in pairwise(found):
        one, other = (answers[c.dt_s].trajectory for c in (coarser, case))
        if one is None or other is None:
            assert "successive_difference_rad" not in case.columns
        else:
            change = np.max(geodesic_angle(one.attitude, other.attitude))
            assert case.columns["successive_difference_rad"] == pytest.approx(change, rel=1e-12, abs=0.0)
    assert FAILED in [case.dt_s for case in found if not case.ok]
