"""A study: its cases are sorted from coarse to fine, in whatever order they were run."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise, permutations
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import Engine, Setting
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.round_off import RoundOff
from bodycheck.reports.measurement.study import limit, restored, stored_form, study
from bodycheck.scenarios.library import load_scenario

STEPS = (0.05, 0.02, 0.01, 0.005)
FAILED = 0.01


METHOD = Reference().methods["rk4"]
ENGINE = Engine("reference", "1", {METHOD.name: METHOD})


def carried_out(answers: dict[float | None, Answer]) -> dict[str, Any]:
    """Return arguments of a study that give these answers, without further steps."""
    return {
        "adaptive": False,
        "ask": lambda _, case: answers[case.setting.dt_s],
        "search": lambda _, search: pytest.fail(f"nobody asked for {search}"),
        "case_done": lambda: None,
    }


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Return the problem of a body that tumbles, with its truth."""
    return Problem.of(load_scenario("intermediate-axis"), "intermediate-axis")


@pytest.fixture(scope="module")
def answers(problem: Problem) -> dict[float | None, Answer]:
    """Return the reference's answer at each step, with a failure at one of them."""
    cases = [Case(problem.scenario.scene, "rk4", Setting(dt_s=step)) for step in STEPS]
    printed = {case.setting.dt_s: record(Reference(), case) for case in cases}
    return printed | {FAILED: Answer("failed", "it crashed")}


@pytest.mark.parametrize("order", [STEPS, STEPS[::-1], *list(permutations(STEPS))[5::6]])
def test_successive_difference_is_the_angle_to_the_next_coarser_case(
    order: tuple[float, ...], problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """It is the largest angle between the two motions over the samples, and absent if one of them failed."""
    settings = [Setting(dt_s=step) for step in order]
    found = study(problem, ENGINE, METHOD, settings, **carried_out(answers)).cases
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


def test_the_floor_of_a_measure_includes_that_of_its_cases(
    problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """The round-off of the products that a norm is made of is no bound of the truth."""
    found = study(problem, ENGINE, METHOD, [Setting(dt_s=step) for step in STEPS], **carried_out(answers))
    (row,) = (row for row in found.method_rows if row["quantity"] == "quaternion_norm_error")
    own = [case.floors["quaternion_norm_error"] for case in found.cases if case.ok]
    assert row["floor"] == max(own) == 1e-12 > limit(problem, "quaternion_norm_error")


def test_a_method_that_is_unstable_everywhere_has_a_verdict_on_its_orientation(
    problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """It has no measure at all."""
    motion = answers[STEPS[0]].trajectory
    assert motion is not None
    lost = replace(answers[STEPS[0]], trajectory=replace(motion, omega_body_rad_s=np.nan * motion.omega_body))
    settings = [Setting(dt_s=step) for step in STEPS]
    rows = study(problem, ENGINE, METHOD, settings, **carried_out(dict.fromkeys(STEPS, lost))).method_rows
    assert [(row["quantity"], row["verdict"]) for row in rows] == [(ORIENTATION, "unstable")]


def test_restored_study_is_the_study(problem: Problem, answers: dict[float | None, Answer]) -> None:
    """After a round trip through JSON every column, row and series has the same bits, but a new origin."""
    how = carried_out(answers)
    first = study(problem, ENGINE, METHOD, [Setting(dt_s=step) for step in STEPS], **how)
    stored = json.loads(json.dumps(stored_form(first)))
    reused = {step: replace(answer, reused=True) for step, answer in answers.items()}
    again = restored(stored, problem, ENGINE, METHOD, **carried_out(reused))
    assert again is not None
    assert again.method_rows == first.method_rows
    for case, before in zip(again.cases, first.cases, strict=True):
        assert case.columns == {**before.columns, "reused": True}
        assert case.trajectory is before.trajectory
        assert {name: values.tobytes() for name, values in case.series.items()} == {
            name: values.tobytes() for name, values in before.series.items()
        }


def test_study_of_another_motion_is_not_restored(
    problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """A difference of one bit in one state is enough."""
    first = study(problem, ENGINE, METHOD, [Setting(dt_s=step) for step in STEPS], **carried_out(answers))
    motion = answers[STEPS[1]].trajectory
    assert motion is not None
    velocity = motion.velocity_m_s.copy()
    velocity[3, 0] = np.nextafter(velocity[3, 0], 1.0)
    changed = replace(answers[STEPS[1]], trajectory=replace(motion, velocity_m_s=velocity))
    others = carried_out({**answers, STEPS[1]: changed})
    assert restored(stored_form(first), problem, ENGINE, METHOD, **others) is None


def test_arithmetic_of_single_precision_raises_the_floor(
    problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """Of a method that chooses its steps the floor is that of the truth in doubles, and higher in singles."""
    given = {1e-3: replace(answers[STEPS[0]], steps=10**8), 1e-6: replace(answers[STEPS[-1]], steps=10**9)}
    how = carried_out({}) | {"ask": lambda _, case: given[case.setting.tolerance]}
    floors = []
    for precision in ("float64", "float32"):
        method = replace(
            METHOD, control="tolerance", order=None, tolerances=tuple(given), precision=precision
        )
        engine = Engine("reference", "1", {method.name: method})
        rows = study(problem, engine, method, [Setting(None, one) for one in given], **how).method_rows
        floors += [row["floor"] for row in rows if row["quantity"] == ORIENTATION]
    assert floors[0] == limit(problem, ORIENTATION)
    assert floors[1] > 1e3 * floors[0]


def test_the_best_step_has_the_floor_that_its_arithmetic_predicts(
    problem: Problem, answers: dict[float | None, Answer]
) -> None:
    """Of a method in doubles too, whose points have no floor of their own."""
    settings = [Setting(dt_s=step) for step in STEPS]
    rows = study(problem, ENGINE, METHOD, settings, **carried_out(answers)).method_rows
    (row,) = (row for row in rows if row["quantity"] == ORIENTATION)
    predicted = RoundOff.of(problem, ORIENTATION, "float64", METHOD.rounding_bias)
    assert row["best_dt_s"] == min(STEPS)
    assert row["predicted_floor"] == predicted.at(min(STEPS)) > 0.0
