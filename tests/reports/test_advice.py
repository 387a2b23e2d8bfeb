"""The cheapest settings that keep an error: only measured ones, none by luck, none that failed."""

from __future__ import annotations

from typing import Any

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.render.answer_text import print_advice
from bodycheck.reports.summary.advice import Answer, advise

BOUND = 1e-14
ERROR = "orientation_error_rad"


def case(method: str, dt_s: float, error: float | None, cpu_s: float | None, **others: Any) -> CaseResult:
    """Return a case of a table; without an error, one that did not end well."""
    columns: dict[str, Any] = {
        "scenario": "free",
        "engine": "mujoco",
        "method": method,
        "control": "dt",
        "dt_s": dt_s,
        "outcome": "failed" if error is None else "ok",
        "reproduce": f"bodycheck run free --engine mujoco:{method} --dt {dt_s!r}",
        "truth_bound_rad": BOUND,
    }
    measured = {} if error is None else {ERROR: error}
    times = {} if cpu_s is None else {"cpu_s": cpu_s}
    return CaseResult(columns | measured | times | others)


def ladder(method: str, errors: list[float | None], cost: float = 1.0, **others: Any) -> list[CaseResult]:
    """Return the cases at steps 0.1, 0.05, ...: each twice as dear as the one before."""
    return [case(method, 0.1 / 2**k, error, cost * 2**k, **others) for k, error in enumerate(errors)]


def steps(answer: Answer) -> list[tuple[str, str, tuple[float | None, ...], float | None]]:
    """Return what an answer advises."""
    return [(one.engine, one.method, one.settings, one.cpu_s) for one in answer.options]


def test_the_cheapest_that_keeps_it_is_advised() -> None:
    """Of two methods the one that costs less, at its coarsest step that keeps the error."""
    cases = [*ladder("euler", [1e-1, 5e-2, 9e-4, 4e-4]), *ladder("rk4", [1e-3 - 2e-14, 1e-5], cost=3.0)]
    (answer,) = advise(cases, 1e-3, ERROR, ["free"])
    assert steps(answer) == [("mujoco", "rk4", (0.1,), 3.0)]
    assert answer.nearest is None
    assert answer.without == ()


@pytest.mark.parametrize(("error", "kept"), [(1e-3, True), (1e-3 - 0.5 * BOUND, False)])
def test_the_bound_of_the_truth_counts_as_error(error: float, kept: bool) -> None:
    """What is measured may be off by the bound: the sum must keep the error asked for."""
    (answer,) = advise([case("rk4", 0.1, 1e-3 - BOUND, 1.0)], error, ERROR, ["free"])
    assert bool(answer.options) is kept


def test_an_error_that_is_small_by_luck_is_not_advised() -> None:
    """A coarse step below the error with a finer one above it: only what is finer than that is taken."""
    (answer,) = advise(ladder("euler", [1e-4, 5e-2, 8e-4, 4e-4]), 1e-3, ERROR, ["free"])
    assert steps(answer) == [("mujoco", "euler", (0.025,), 4.0)]


def test_round_off_of_finer_steps_is_no_bad_luck() -> None:
    """Below 1e-9 finer steps may be worse by their round-off; the coarser that keeps the error is good."""
    (answer,) = advise(ladder("rk4", [1e-9, 5e-13, 2e-12]), 1e-12, ERROR, ["free"])
    assert steps(answer) == [("mujoco", "rk4", (0.05,), 2.0)]


def test_what_did_not_end_well_keeps_nothing() -> None:
    """Nor does anything coarser than a step that failed."""
    (answer,) = advise(ladder("euler", [1e-4, None, None]), 1e-3, ERROR, ["free"])
    assert answer.options == ()
    assert answer.without == ("mujoco",)
    assert answer.nearest is not None
    assert answer.nearest.settings == (0.1,)


def test_the_best_of_each_engine_is_shown_cheapest_first() -> None:
    """One line an engine; one that keeps it by no method is named, not left out."""
    cases = [
        *ladder("euler", [9e-4], cost=5.0),
        *ladder("rk4", [1e-6], cost=2.0, engine="reference"),
        *ladder("maximal", [1e-1], engine="pybullet"),
    ]
    (answer,) = advise(cases, 1e-3, ERROR, ["free"])
    assert [one.engine for one in answer.options] == ["reference", "mujoco"]
    assert answer.without == ("pybullet",)


def test_all_scenarios_together_need_a_method_that_keeps_it_in_each() -> None:
    """The finest and the coarsest of its steps are told, times add up, the largest error counts.

    The one command runs them all: with --allow-code where one of them needs it.
    """
    cases = [
        *ladder("euler", [9e-4, 4e-4]),
        *ladder("euler", [9e-2, 8e-4], scenario="forced", reproduce="bodycheck run my.toml --allow-code"),
        *ladder("rk4", [1e-9], cost=0.1),
    ]
    together, *each = advise(cases, 1e-3, ERROR, ["free", "forced"])
    assert together.scenario is None
    assert steps(together) == [("mujoco", "euler", (0.1, 0.05), 3.0)]
    assert together.options[0].error == 9e-4 + BOUND
    assert together.options[0].reproduce == "bodycheck run free my.toml --engine mujoco:euler --allow-code"
    assert [answer.scenario for answer in each] == ["free", "forced"]
    assert steps(each[0]) == [("mujoco", "rk4", (0.1,), 0.1)]


def test_nothing_keeps_it_and_the_nearest_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """With the error that it has and the command that shows it."""
    answers = advise([*ladder("euler", [1e-1, 5e-2]), *ladder("rk4", [1e-3])], 1e-6, ERROR, ["free"])
    print_advice(answers, 1e-6, ERROR, "there")
    shown = capsys.readouterr().out
    assert "no measured setting meets it; the nearest is mujoco:rk4, dt 0.1 s: 0.001" in shown
    assert "bodycheck run free --engine mujoco:rk4 --dt 0.1" in shown


def test_a_time_that_was_not_measured_is_said_so(capsys: pytest.CaptureFixture[str]) -> None:
    """Such a setting keeps the error, but stands behind those whose cost is known."""
    cases = [case("euler", 0.1, 1e-5, None), case("rk4", 0.1, 1e-5, 2.0, engine="dart")]
    answers = advise(cases, 1e-3, ERROR, ["free"])
    assert [one.engine for one in answers[0].options] == ["dart", "mujoco"]
    print_advice(answers, 1e-3, ERROR, "there")
    assert "not measured" in capsys.readouterr().out


def test_of_steps_whose_time_was_not_measured_the_coarsest_is_advised() -> None:
    """It takes the fewest steps: without times that is all that is known of its cost."""
    cases = [case("rk4", dt_s, 1e-5, None) for dt_s in (0.1, 0.05, 0.02)]
    (answer,) = advise(cases, 1e-3, ERROR, ["free"])
    assert steps(answer) == [("mujoco", "rk4", (0.1,), None)]


@pytest.mark.parametrize(
    ("error", "quantity", "message"),
    [
        (0.0, ERROR, "--error 0.0: must be a positive number"),
        (float("nan"), ERROR, "--error nan: must be a positive number"),
        (float("inf"), ERROR, "--error inf"),
        (1e-3, "cpu_s", r"--quantity cpu_s: unknown quantity \(available: orientation_error_rad"),
        (1e-3, "quaternion_norm_error", "unknown quantity"),
    ],
)
def test_a_wrong_question_is_refused(error: float, quantity: str, message: str) -> None:
    """One line says what would be right."""
    with pytest.raises(InputError, match=message):
        advise([], error, quantity, ["free"])
