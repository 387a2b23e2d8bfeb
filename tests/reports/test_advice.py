"""Answers of `advise`: the cheapest settings that meet an error, and the error at a step."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.document import Sentence, Table, print_document
from bodycheck.reports.measurement.case import SWITCH_NOTE, CaseResult
from bodycheck.reports.summary.advice import (
    Advice,
    Curves,
    ScenarioAdvice,
    check_question,
    errors_at,
    settings_within,
    to_measure,
)
from bodycheck.reports.summary.advice_document import advice_document
from bodycheck.reports.summary.error_curve import ErrorCurve, sequences_of
from tests.helpers.expected_messages import ExpectedMessage

BOUND = 1e-14
ERROR = "orientation_error_rad"
SNIPPET = "model.opt.timestep = {dt_s}"


def case(method: str, dt_s: float, error: float | None, cpu_s: float | None, **others: Any) -> CaseResult:
    """Return a case of a table; without an error, one that did not end well."""
    columns: dict[str, Any] = {
        "scenario": "free",
        "engine": "mujoco",
        "method": method,
        "control": "dt",
        "dt_s": dt_s,
        "outcome": "failed" if error is None else "ok",
        "message": "",
        "reproduce": f"bodycheck run free --engine mujoco:{method} --dt {dt_s!r}",
        "truth_bound_rad": BOUND,
        "omega_scale_rad_s": 2.0,
    }
    measured = {} if error is None else {ERROR: error}
    times = {} if cpu_s is None else {"cpu_s": cpu_s}
    return CaseResult(columns | measured | times | others)


def sequence(
    method: str, errors: Sequence[float | None], cost: float = 1.0, **others: Any
) -> list[CaseResult]:
    """Return the cases at steps 0.1, 0.05, ...: each twice as expensive as the one before."""
    return [case(method, 0.1 / 2**k, error, cost * 2**k, **others) for k, error in enumerate(errors)]


def curves(cases: Sequence[CaseResult], **facts: Any) -> Curves:
    """Return the curves of cases of scenarios of 10 s with samples every 0.1 s."""
    return {
        key: ErrorCurve(own, ERROR, duration_s=10.0, interval_s=0.1, snippet=SNIPPET, **facts)
        for key, own in sequences_of(cases).items()
    }


def advise(
    cases: Sequence[CaseResult], error: float, scenarios: Sequence[str] = ("free",)
) -> Sequence[ScenarioAdvice]:
    """Return the answers from these cases alone."""
    return settings_within(curves(cases), error, scenarios)


def steps(answer: ScenarioAdvice) -> list[tuple[str, str, float | None, float | None]]:
    """Return the settings that an answer recommends."""
    return [(one.engine, one.method, one.setting, one.cpu_s) for one in answer.options]


def printed(
    capsys: pytest.CaptureFixture[str], answers: Sequence[ScenarioAdvice], error: float = 1e-3
) -> str:
    """Return the output of `bodycheck advise --error` with these answers."""
    print_document(advice_document(Advice(ERROR, error, None, "there", tuple(answers))))
    return capsys.readouterr().out


def test_the_cheapest_measured_setting_is_recommended() -> None:
    """Of two methods the cheaper one is recommended, at its coarsest step that meets the error."""
    cases = [*sequence("euler", [1e-1, 5e-2, 9e-4, 4e-4]), *sequence("rk4", [1e-3 - 2e-14, 1e-5], cost=3.0)]
    (answer,) = advise(cases, 1e-3)
    assert steps(answer) == [("mujoco", "rk4", 0.1, 3.0)]
    assert answer.options[0].basis == "measured"
    assert answer.nearest is None
    assert answer.without == ()


@pytest.mark.parametrize(("error", "kept"), [(1e-3, True), (1e-3 - 0.5 * BOUND, False)])
def test_the_bound_of_the_truth_counts_as_error(error: float, kept: bool) -> None:
    """A measured error may be off by the bound: the sum has to meet the tolerance."""
    (answer,) = advise([case("rk4", 0.1, 1e-3 - BOUND, 1.0)], error)
    assert bool(answer.options) is kept


def test_an_error_that_is_small_by_accident_is_not_recommended() -> None:
    """If a coarse step meets the error but a finer one misses it, only steps below that are recommended."""
    (answer,) = advise(sequence("euler", [1e-4, 5e-2, 8e-4, 4e-4]), 1e-3)
    assert steps(answer) == [("mujoco", "euler", 0.025, 4.0)]


def test_round_off_of_finer_steps_excludes_no_coarser_one() -> None:
    """Below 1e-9 finer steps may be worse by their round-off."""
    (answer,) = advise(sequence("rk4", [1e-9, 5e-13, 2e-12]), 1e-12)
    assert steps(answer) == [("mujoco", "rk4", 0.05, 2.0)]


def test_a_case_that_did_not_end_well_meets_nothing() -> None:
    """A failed case meets no error, and neither does any coarser step."""
    (answer,) = advise(sequence("euler", [1e-4, None, None]), 1e-3)
    assert answer.options == ()
    assert [engine for engine, _ in answer.without] == ["mujoco"]
    assert answer.nearest is not None
    assert answer.nearest.setting == 0.1


def test_the_best_of_each_engine_is_shown_cheapest_first() -> None:
    """Each engine has one row, the reference the last; one without a method that meets it is named."""
    cases = [
        *sequence("euler", [9e-4], cost=5.0),
        *sequence("rk4", [1e-6], cost=2.0, engine="reference"),
        *sequence("slow", [1e-6], cost=6.0, engine="dart"),
        *sequence("maximal", [1e-1], engine="pybullet"),
    ]
    (answer,) = advise(cases, 1e-3)
    assert [one.engine for one in answer.options] == ["mujoco", "dart", "reference"]
    assert [engine for engine, _ in answer.without] == ["pybullet"]


def test_all_scenarios_together_need_a_method_that_meets_it_in_each() -> None:
    """The finest of the method's steps counts, with the total time there; the limiting scenario is named.

    A single command runs all scenarios, with --allow-code if one of them needs it.
    """
    cases = [
        *sequence("euler", [9e-4, 4e-4]),
        *sequence("euler", [9e-2, 8e-4], scenario="forced", reproduce="bodycheck run my.toml --allow-code"),
        *sequence("rk4", [1e-9], cost=0.1),
    ]
    together, *each = advise(cases, 1e-3, ["free", "forced"])
    assert together.scenario is None
    assert steps(together) == [("mujoco", "euler", 0.05, 4.0)]
    (option,) = together.options
    assert option.error == 8e-4 + BOUND
    assert option.limiting == "forced"
    assert option.real_time == 20.0 / 4.0
    assert option.confirm == "bodycheck run free my.toml --engine mujoco:euler --dt 0.05 --allow-code"
    assert [answer.scenario for answer in each] == ["free", "forced"]
    assert steps(each[0]) == [("mujoco", "rk4", 0.1, 0.1)]


def test_a_setting_for_all_scenarios_meets_the_error_on_each() -> None:
    """In single precision, the finer step that one scenario requires can be worse on another."""
    single = {"precision": "float32"}
    cases = [
        *sequence("rk4", [3e-6, 8e-6, 1e-4], **single),
        *sequence("rk4", [2e-3, 8e-5, 7e-6], scenario="forced", **single),
    ]
    together, free, forced = advise(cases, 1e-5, ["free", "forced"])
    assert (steps(free), steps(forced)) == ([("mujoco", "rk4", 0.1, 1.0)], [("mujoco", "rk4", 0.025, 4.0)])
    assert together.options == ()
    assert together.without == (("mujoco", "what one scenario requires does not meet it on another"),)
    together, *_ = advise(cases, 1e-4 + BOUND, ["free", "forced"])
    assert steps(together) == [("mujoco", "rk4", 0.05, 4.0)]
    assert together.options[0].error == 8e-5 + BOUND


def test_a_finer_step_than_one_at_the_floor_is_unsure_until_it_is_measured() -> None:
    """A method that is exact on one scenario has no order there, but the other requires a finer step."""
    cases = [
        *sequence("rk2", [1e-15, 1e-15]),
        *sequence("rk2", [1e-4 / 4**k for k in range(5)], scenario="forced"),
    ]
    answers = settings_within(curves(cases), 5e-6, ["free", "forced"])
    (option,) = answers[0].options
    assert (option.setting, option.basis) == (0.02, "unsure")
    assert option.why == "finer than the measured steps that meet it (free)"
    assert to_measure(curves(cases), answers, 5e-6) == {
        ("free", ("mujoco", "rk2")): 0.02,
        ("forced", ("mujoco", "rk2")): 0.02,
    }
    failing = [*cases, case("rk2", 0.02, None, None)]
    assert settings_within(curves(failing), 5e-6, ["free", "forced"])[0].options == ()


def test_a_search_measures_what_is_predicted_for_all_scenarios() -> None:
    """On the scenario that does not limit it, the step is predicted although a coarser one was measured."""
    errors = [1e-4 / 4**k for k in range(5)]
    cases = [
        *sequence("rk2", [error / 100.0 for error in errors]),
        *sequence("rk2", errors, scenario="forced"),
        case("rk2", 0.02, 4.05e-6, 5.0, scenario="forced"),
    ]
    answers = settings_within(curves(cases), 5e-6, ["free", "forced"])
    (option,) = answers[0].options
    assert (option.setting, option.basis) == (0.02, "predicted")
    assert to_measure(curves(cases), answers, 5e-6) == {("free", ("mujoco", "rk2")): 0.02}
    cases.append(case("rk2", 0.02, 4.05e-8, 5.0))
    answers = settings_within(curves(cases), 5e-6, ["free", "forced"])
    assert answers[0].options[0].basis == "measured"
    assert to_measure(curves(cases), answers, 5e-6) == {}


def test_a_step_inside_which_a_load_switches_is_unsure_unless_one_was_measured() -> None:
    """The order of steps without a switch says nothing about one with it, not even on another scenario."""
    cases = sequence("rk2", [1e-4 / 4**k for k in range(5)])
    found = curves(cases, switches_s=(0.3,))
    (answer,) = errors_at(found, 0.04, ["free"])
    (option,) = answer.options
    assert (option.basis, option.why) == (
        "unsure",
        "a load switches inside this step, but inside no measured one",
    )
    (answer,) = errors_at(found, 0.02, ["free"])
    assert answer.options[0].basis == "predicted"
    cases.append(case("rk2", 0.2, 4e-4, 0.5, message=f"{SWITCH_NOTE}: 1"))
    (answer,) = errors_at(curves(cases, switches_s=(0.3,)), 0.04, ["free"])
    assert answer.options[0].basis == "predicted"


def test_a_method_without_an_option_on_one_scenario_has_none_on_all() -> None:
    """The scenario and the reason are named."""
    cases = [*sequence("rk4", [1e-5]), *sequence("rk4", [None], scenario="forced")]
    together = advise(cases, 1e-3, ["free", "forced"])[0]
    assert together.options == ()
    assert together.without == (("mujoco", "forced: failed at every measured setting"),)


def test_the_nearest_setting_is_shown_where_none_meets_the_error(capsys: pytest.CaptureFixture[str]) -> None:
    """The nearest setting is printed with its error and its command."""
    shown = printed(capsys, advise([*sequence("euler", [1e-1, 5e-2]), *sequence("rk4", [1e-3])], 1e-6))
    assert "no setting is known to meet 1e-3 rad; the nearest is mujoco:rk4 with dt = 0.1 s: " in shown
    assert "bodycheck run free --engine mujoco:rk4 --dt 0.1" in shown


def test_settings_without_a_time_follow_those_with_one() -> None:
    """A setting without a measured time comes last, because its cost is unknown."""
    cases = [case("euler", 0.1, 1e-5, None), case("rk4", 0.1, 1e-5, 2.0, engine="dart")]
    (answer,) = advise(cases, 1e-3)
    assert [one.engine for one in answer.options] == ["dart", "mujoco"]
    assert answer.options[1].real_time is None


def test_without_times_the_fewest_evaluations_are_recommended() -> None:
    """Without times, the number of evaluations is all that is known of the cost."""
    cases = [
        *(case("euler", dt_s, 1e-5, None, rhs_evaluations=10.0 / dt_s) for dt_s in (1e-3, 5e-4)),
        *(case("rk4", dt_s, 1e-5, None, rhs_evaluations=40.0 / dt_s) for dt_s in (0.1, 0.05)),
    ]
    (answer,) = advise(cases, 1e-3)
    assert steps(answer) == [("mujoco", "rk4", 0.1, None)]


def test_a_coarser_step_is_predicted_with_its_cost_and_command() -> None:
    """Error 1e-4 (h / 0.1)^2: a step of 0.02 s lies between the measured 0.025 s and 0.0125 s.

    Its cost follows from that of the nearest measured step.
    """
    cases = sequence("rk2", [1e-4 / 4**k for k in range(5)])
    (answer,) = advise(cases, 5e-6)
    (option,) = answer.options
    assert (option.setting, option.basis) == (0.02, "predicted")
    assert 4e-6 < option.error < 5e-6
    assert option.cpu_s == pytest.approx(4.0 * 0.025 / 0.02)
    assert option.real_time == pytest.approx(10.0 / option.cpu_s)
    assert option.rotation_rad == 0.04
    assert option.confirm == "bodycheck run free --engine mujoco:rk2 --dt 0.02"
    assert option.snippet == "model.opt.timestep = 0.02"


@pytest.mark.parametrize(("error", "proposed"), [(1e-9, True), (1e-20, False)])
def test_a_search_is_proposed_only_where_a_finer_step_can_meet_the_error(
    error: float, proposed: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """Below every floor the answer is the smallest error, and no command that measures more."""
    few = curves([case("rk4", 0.1, 1e-3, 1.0, truth_bound_rad=1e-15)], floor=1e-14)
    answers = list(settings_within(few, error, ["free"]))
    shown = printed(capsys, answers, error)
    assert ("--search" in shown) == proposed
    assert ("the smallest error is 1e-3 rad, of mujoco:rk4 with dt = 0.1 s" in shown) != proposed
    assert bool(to_measure(few, answers, error)) == proposed


@pytest.mark.parametrize("error", [5e-14, 1e-14, 1e-16, 1e-30])
def test_no_error_near_the_floor_or_below_it_is_promised(error: float) -> None:
    """Finer steps only add round-off there: the smallest measured error is the best that is known."""
    measured = [1e-3 / 16**k for k in range(8)]
    exact = {"truth_bound_rad": 1e-32}
    found = curves(sequence("rk4", measured, cost=1e-6, **exact), floor=1e-14)
    (answer,) = settings_within(found, error, ["free"])
    assert answer.options == ()
    assert answer.nearest is not None
    assert answer.nearest.error == measured[-1]
    assert answer.without == (("mujoco", "near the floor of round-off and of the truth, 1e-14 rad"),)
    for dt_s in (1e-4, 1e-5):
        (answer,) = errors_at(found, dt_s, ["free"])
        (option,) = answer.options
        assert option.error > 1e-13
        assert option.why == "near the floor of round-off and of the truth"
    few = curves([case("rk4", 0.1, 1e-3, 1.0, **exact)], floor=1e-14, order=4)
    assert settings_within(few, error, ["free"])[0].options == ()


def test_a_step_finer_than_the_measured_ones_is_found_above_the_floor() -> None:
    """Still finer steps would not meet the error, because their round-off is larger."""
    found = curves(sequence("rk4", [1e-3 / 16**k for k in range(6)], cost=1e-6), floor=1e-14)
    (option,) = settings_within(found, 1e-12, ["free"])[0].options
    assert (option.setting, option.basis) == (0.0005, "predicted")


@pytest.mark.parametrize(("error", "setting"), [(1e-3, 0.1), (1e-5, 0.05), (1e-7, 0.025)])
def test_a_wide_interval_far_below_the_error_leaves_a_coarse_step_predicted(
    error: float, setting: float
) -> None:
    """The errors are those of mujoco:rk4 in tumbling, where 0.1 s was measured to have 8.53e-6."""
    errors = {0.02: 1.35e-8, 0.01: 8.42e-10, 0.005: 5.26e-11, 0.002: 1.37e-12, 0.001: 9.36e-14}
    cases = [case("rk4", dt_s, measured, 1e-4 / dt_s) for dt_s, measured in errors.items()]
    found = curves(cases, floor=1.3e-14, stable_s=2.5)
    (option,) = settings_within(found, error, ["free"])[0].options
    assert (option.setting, option.basis) == (setting, "predicted")
    assert option.error <= error
    (answer,) = errors_at(found, 0.1, ["free"])
    assert answer.options[0].basis == "unsure"  # without a tolerance, a factor of 2 matters


def test_a_sure_option_takes_precedence_over_a_cheaper_unsure_one() -> None:
    """One point and the theoretical order give only a guess."""
    cases = [
        case("euler", 0.1, 0.2, 1e-3, order=1),
        *sequence("rk4", [1e-2 / 16**k for k in range(5)], cost=5.0),
    ]
    found = dict(curves(cases, order=1))
    (answer,) = settings_within(found, 1e-1, ["free"])
    assert [(one.method, one.basis) for one in answer.options] == [("rk4", "measured")]
    (guess,) = settings_within({k: c for k, c in found.items() if k[1][1] == "euler"}, 1e-1, ["free"])
    (option,) = guess.options
    assert (option.basis, option.setting) == ("unsure", 0.05)
    assert option.why == "predicted from dt 0.1 s and the theoretical order 1"


def test_the_error_of_a_step_is_measured_or_predicted_for_each_method() -> None:
    """The most accurate method is first; the error over several scenarios is that of the limiting one."""
    cases = [
        *sequence("rk2", [1e-2 / 4**k for k in range(5)]),
        *sequence("rk2", [1e-1 / 4**k for k in range(5)], scenario="forced"),
        *sequence("euler", [1e-1 / 2**k for k in range(5)]),
        *sequence("euler", [1e-1 / 2**k for k in range(5)], scenario="forced"),
    ]
    together, free, _ = errors_at(curves(cases), 0.025, ["free", "forced"])
    assert [(one.method, one.basis) for one in free.options] == [("rk2", "measured"), ("euler", "measured")]
    assert [one.error - BOUND for one in free.options] == pytest.approx([6.25e-4, 2.5e-2])
    assert together.options[0].limiting == "forced"
    assert together.options[0].error == pytest.approx(6.25e-3)
    (answer,) = errors_at(curves(cases), 0.03, ["free"])
    assert [one.basis for one in answer.options] == ["predicted", "predicted"]
    assert 9e-4 <= answer.options[0].error < 1.1e-3


@pytest.mark.parametrize("scenarios", [["free"], ["free", "forced"]])
def test_of_several_scenarios_each_has_a_row(scenarios: list[str]) -> None:
    """The first column of the last table names them; the answer for one scenario has no such table."""
    cases = [found for name in scenarios for found in sequence("rk4", [1e-6, 1e-8], scenario=name)]
    parts = advice_document(Advice(ERROR, 1e-3, None, "there", tuple(advise(cases, 1e-3, scenarios)))).parts
    tables = [part for part in parts if isinstance(part, Table) and part.columns[0].head == "scenario"]
    rows = [row[0] for table in tables for row in table.rows]
    assert rows == (scenarios if len(scenarios) > 1 else [])


@pytest.mark.parametrize("only", [False, True])
def test_the_reference_is_the_most_accurate_only_where_no_engine_is_shown(only: bool) -> None:
    """It is listed last, so that the first line speaks of engines if there are any."""
    cases = [case("dop853", 0.1, 1e-14, 1.0, engine="reference")]
    cases += [] if only else [case("rk4", 0.1, 1e-9, 1.0)]
    answers = errors_at(curves(cases), 0.1, ["free"])
    first, *_ = advice_document(Advice(ERROR, None, 0.1, "there", answers)).parts
    assert isinstance(first, Sentence)
    assert first.text.partition(":")[0] == f"most accurate{'' if only else ' engine'} with dt = 0.1 s"


@pytest.mark.parametrize(("dt_s", "confirmed"), [(0.025, True), (0.02, True), (0.03, False)])
def test_a_step_that_no_run_can_use_has_no_command(dt_s: float, confirmed: bool) -> None:
    """Only steps that divide the sampling interval of 0.1 s can be confirmed by a run."""
    cases = sequence("rk2", [1e-2 / 4**k for k in range(5)])
    (answer,) = errors_at(curves(cases), dt_s, ["free"])
    assert bool(answer.options[0].confirm) is confirmed


def test_a_step_longer_than_the_scenario_has_no_error() -> None:
    """The reason gives the duration."""
    cases = sequence("rk2", [1e-2 / 4**k for k in range(5)])
    (answer,) = errors_at(curves(cases), 100.0, ["free"])
    assert answer.options == ()
    assert [why for _, why in answer.without] == ["the scenario lasts 10 s"]


def test_a_step_that_failed_has_no_error(capsys: pytest.CaptureFixture[str]) -> None:
    """The outcome is the reason, and nothing else is printed about it."""
    cases = [*sequence("rk2", [1e-2 / 4**k for k in range(5)]), case("rk2", 0.2, None, None)]
    answers = errors_at(curves(cases), 0.2, ["free"])
    assert answers[0].without == (("mujoco:rk2", "failed at this step"),)
    assert printed(capsys, answers).splitlines()[-1] == "mujoco:rk2: failed at this step"


def test_a_search_measures_what_is_predicted_and_refines_what_is_not() -> None:
    """An engine without any option gets a step half as large; a measured answer needs nothing more."""
    cases = [
        *sequence("rk2", [1e-2 / 4**k for k in range(5)])[1:],
        *sequence("euler", [2.0, 1.0], engine="dart"),
        *sequence("exact", [1e-12], engine="reference"),
    ]
    answers = advise(cases, 1.1e-4)
    assert to_measure(curves(cases), answers, 1.1e-4) == {
        ("free", ("mujoco", "rk2")): 0.01,
        ("free", ("dart", "euler")): 0.025,
    }


def test_advice_is_plain_data() -> None:
    """It can be written as JSON without further conversion."""
    cases = [*sequence("rk2", [1e-2 / 4**k for k in range(5)]), *sequence("euler", [None], engine="dart")]
    advice = Advice(ERROR, 1e-3, None, "there", tuple(advise(cases, 1e-3)))
    reported = json.loads(json.dumps(asdict(advice), allow_nan=False))
    assert reported["answers"][0]["options"][0]["setting"] == advice.answers[0].options[0].setting
    assert reported["answers"][0]["without"] == [["dart", "failed at every measured setting"]]


def test_the_last_line_of_an_answer_is_the_one_to_paste(capsys: pytest.CaptureFixture[str]) -> None:
    """It is the snippet of the first option whose engine declares one."""
    cases = sequence("rk2", [1e-2 / 4**k for k in range(5)])
    lines = printed(capsys, advise(cases, 1e-3)).splitlines()
    assert lines[-2].endswith("bodycheck run free --engine mujoco:rk2 --dt 0.025")
    assert lines[-1] == "use mujoco:rk2: model.opt.timestep = 0.025"


@pytest.mark.parametrize(
    ("errors", "first"),
    [
        ([1e-2 / 4**k for k in range(5)], "confirmed: 6.25e-4 <= 1e-3 rad; use mujoco:rk2 with dt = 0.025 s"),
        (
            [2e-2 / 4**k for k in range(5)],
            "use mujoco:rk2 with dt = 0.02 s: error at most 8.03e-4 rad (predicted)",
        ),
    ],
)
def test_the_first_line_is_the_answer(
    errors: list[float], first: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It names engine, method and step, and whether the error was measured or predicted."""
    assert printed(capsys, advise(sequence("rk2", errors), 1e-3)).splitlines()[0] == first


@pytest.mark.parametrize(
    ("dt_s", "cost", "why"),
    [(5e-6, 1.0, "its step is below 1e-5 s"), (0.1, 40.0, "slower than real time, 0.25 x"), (1e-5, 10.0, "")],
)
def test_an_impractical_setting_is_left_out_unless_all_are_requested(
    dt_s: float, cost: float, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The answer names the nearest such setting and the reason; another engine takes its place."""
    cases = [case("rk2", dt_s, 1e-4, cost)]
    (answer,) = advise(cases, 1e-3)
    assert len(answer.options) == (not why)
    if why:
        first = printed(capsys, [answer]).splitlines()[0]
        assert first.startswith("nothing practical meets 1e-3 rad; the nearest is mujoco:rk2 with dt = ")
        assert first.endswith(f", but {why}")
    every = settings_within(curves(cases), 1e-3, ["free"], every=True)
    assert [one.setting for one in every[0].options] == [dt_s]
    (answer,) = advise([*cases, *sequence("slow", [1e-4], cost=9.0, engine="dart")], 1e-3)
    assert [one.engine for one in answer.options] == (["dart"] if why else ["dart", "mujoco"])
    assert [one.impractical for one in answer.left_out] == [why] * bool(why)


@pytest.mark.parametrize(
    ("error", "dt_s", "quantity"),
    [
        (0.0, None, ERROR),
        (float("nan"), None, ERROR),
        (float("inf"), None, ERROR),
        (None, -1.0, ERROR),
        (None, None, ERROR),
        (1e-3, 1e-3, ERROR),
        (1e-3, None, "cpu_s"),
        (1e-3, None, "quaternion_norm_error"),
    ],
)
def test_a_wrong_question_is_refused(
    error: float | None, dt_s: float | None, quantity: str, expected_message: ExpectedMessage
) -> None:
    """One line says what would be right."""
    with expected_message.raises(InputError):
        check_question(error, dt_s, quantity)
