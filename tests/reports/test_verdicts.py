"""The rules behind cells: states, faults, the worst results of a run, and the row of a stable step."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.stable_step import StableStep, StableStepSearch
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.study import stability_row
from bodycheck.reports.measurement.verdicts import (
    STATES,
    QuantityVerdict,
    method_verdict,
    most_severe,
    severity,
)
from bodycheck.reports.run_files.run_tables import Tables, common_step, shown_case
from bodycheck.reports.summary.cells import CaseFault, Cell, faults_of, summary_cell, summary_cells
from bodycheck.reports.summary.sentences import Summary
from bodycheck.reports.summary.worst_results import (
    MethodResults,
    Result,
    headline,
    worst_results,
)
from tests.helpers.gate_tables import CASE, METHOD, make_tables

ERROR = "orientation_error_rad"
ROW = {
    **METHOD,
    "order_low": 3.9,
    "order_high": 4.1,
    "expected_order": 4,
    "points": 5,
    "floor": 1e-14,
    "finest_dt_s": 0.01,
    "finest_error": 1e-9,
}
FOUND = {ERROR: ROW}
FLAT = {"verdict": "does-not-converge", "order": math.nan, "order_low": math.nan, "order_high": math.nan}
THEORY = {"mujoco": {"methods": {"rk4": {"order": 4}, "euler": {"order": None}}}}


def case(**cells: Any) -> CaseResult:
    """Return a case that ended well, with the given cells replaced."""
    return CaseResult({**CASE, "truth_bound_rad": 1e-12, **cells})


def findings(*cases: dict[str, Any], methods: tuple[dict[str, Any], ...] = ()) -> Tables:
    """Return a run of one or two scenarios."""
    rows = [{"truth_bound_rad": 1e-12, **cells} for cells in cases]
    scenarios = {"brick": {}, "plate": {}}
    return make_tables(rows, [{**ROW, **cells} for cells in methods], scenarios=scenarios, engines=THEORY)


# ------------------------------------------------------------------------------------------------- states


def test_faults_of_one_kind_stand_together() -> None:
    """One fault has one scenario, method, outcome and message; sound or unsupported cases are not faults."""
    bad = {"outcome": "failed", "message": "no"}
    cases = [case(), case(outcome="unsupported"), case(**bad), case(**bad, dt_s=0.02)]
    cases += [case(outcome=one, message="no", dt_s=None, tolerance=1e-6) for one in ("timeout", "unstable")]
    cases += [case(outcome="invalid", message="no"), case(outcome="failed", message="yes")]
    key = ("mujoco", "rk4")
    assert faults_of(cases) == [
        CaseFault("brick", key, "failed", "no", (0.01, 0.02)),
        CaseFault("brick", key, "timeout", "no", (1e-6,)),
        CaseFault("brick", key, "unstable", "no", (1e-6,)),
        CaseFault("brick", key, "invalid", "no", (0.01,)),
        CaseFault("brick", key, "failed", "yes", (0.01,)),
    ]


def test_a_method_is_shown_at_the_common_step_or_at_its_finest_tolerance() -> None:
    """A case at another step does not represent the method."""
    steps = [case(dt_s=dt_s) for dt_s in (0.02, 0.01, 0.005)]
    assert shown_case(steps, 0.01) is steps[1]
    assert shown_case(steps, 0.001) is None
    reported = [case(dt_s=None, tolerance=tolerance) for tolerance in (1e-3, 1e-9, 1e-6)]
    assert shown_case(reported, 0.01) is reported[1]
    none = [case(dt_s=None)]
    assert shown_case(none, 0.01) is none[0]
    assert common_step([case(dt_s=0.1), case(dt_s=0.1), case(dt_s=0.2), case(dt_s=None)]) == 0.1
    assert common_step([case(dt_s=0.1), case(dt_s=0.2)]) == 0.1
    unsupported = [case(dt_s=0.2, outcome="unsupported") for _ in range(3)]
    assert common_step([case(dt_s=0.1), *unsupported]) == 0.1


def verdict(quantity: str = ERROR, **cells: Any) -> QuantityVerdict:
    """Return the verdict of a row of methods.csv."""
    return QuantityVerdict.of({**ROW, "quantity": quantity, **cells})


def test_a_cell_says_the_most_severe_of_all_quantities() -> None:
    """A wrong limit of the energy outweighs the order of the orientation; a failed case outweighs both."""
    found = {
        **FOUND,
        "energy_drift": {**ROW, **FLAT, "quantity": "energy_drift", "finest_error": 0.2},
        "omega_error": {**ROW, "quantity": "omega_error"},
        "position_error": {**ROW, **FLAT, "quantity": "position_error", "finest_error": 0.9},
    }
    cell = summary_cell([case()], found, 0.01)
    assert (cell.state, cell.order, cell.error) == ("does-not-converge", 4.0, 1e-9)
    assert [one.quantity for one in cell.wrong] == ["position_error", "energy_drift"]
    assert cell.verdict is not None
    assert cell.verdict.text == "position_error does not converge to the truth: 0.9 of its scale at dt 0.01 s"
    assert not cell.is_sound
    unstable = [case(), case(dt_s=0.02, outcome="unstable"), case(dt_s=0.03, outcome="unstable")]
    worse = summary_cell(unstable, found, 0.01)
    assert (worse.state, worse.faults, worse.cases) == ("unstable", {"unstable": 2}, 3)
    assert worse.notes[0] == "2 of 3 unstable"
    assert len(worse.notes) == 3
    assert summary_cell(unstable, FOUND, 0.02).error is None
    assert summary_cell(unstable, FOUND, 0.5).error is None


def test_a_cell_names_the_undecided_quantity_that_makes_it_undecided() -> None:
    """A sound orientation does not hide a velocity that is not shown to converge."""
    velocity = {**ROW, "quantity": "velocity_error", "verdict": "pre-asymptotic", "finest_error": 0.15}
    cell = summary_cell([case()], {**FOUND, "velocity_error": velocity}, 0.01)
    assert (cell.state, cell.is_sound) == ("pre-asymptotic", False)
    assert cell.notes == ["velocity_error cannot be judged: still 0.15 of its scale at dt 0.01 s"]
    orientation = {**ROW, "verdict": "pre-asymptotic", "finest_error": 0.15}
    assert summary_cell([case()], {ERROR: orientation}, 0.01).notes == []


def test_a_sound_cell_tells_what_its_order_rests_on() -> None:
    """A sound cell gives the interval, points and floor, and reports a load that switches inside a step."""
    cell = summary_cell([case()], FOUND, 0.01)
    assert cell.is_sound
    assert cell.detail == "order between 3.9 and 4.1, from 5 steps; floor 1e-14 rad"
    switched = summary_cell([case(message="load switches inside a step: 1")], FOUND, 0.01)
    assert switched.detail.endswith("; a load switches inside a step, which lowers the order")


def test_where_nothing_ended_well_the_worst_end_is_the_state() -> None:
    """Every reason is given once; an unsupported case is not a fault."""
    ends = (("timeout", "slow"), ("failed", "no"), ("failed", "no"))
    cell = summary_cell([case(outcome=one, message=why) for one, why in ends], FOUND, 0.01)
    assert cell == Cell("failed", faults={"failed": 2, "timeout": 1}, cases=3, detail="slow; no")
    none = summary_cell([case(outcome="unsupported", message="no pivot")], {}, 0.01)
    assert none == Cell("unsupported", cases=1, detail="no pivot")


@pytest.mark.parametrize(
    ("high", "expected", "state"),
    [(3.49, 4, "lower-order"), (3.51, 4, "converges"), (1.2, 1, "converges"), (1.2, math.nan, "converges")],
)
def test_an_order_is_lower_where_its_whole_interval_is(high: float, expected: float, state: str) -> None:
    """It must be lower by half an order or more; orders are integers. Without an expected order none is."""
    assert verdict(order_high=high, expected_order=expected).state == state


def test_a_method_is_judged_by_its_worst_quantity() -> None:
    """Wrong limits come first, then lower orders, then undecided errors, by size; then the orientation."""
    lower = verdict("omega_error", order=1.0, order_high=1.1)
    flat = verdict("velocity_error", **FLAT)
    sound = verdict()
    assert most_severe([sound, lower, flat]) == [flat, lower]
    assert method_verdict({ERROR: sound, "omega_error": lower}) == lower
    assert method_verdict({ERROR: sound}) == sound
    open_one = verdict("position_error", verdict="pre-asymptotic", finest_error=0.9)
    small = verdict("velocity_error", verdict="too-few-points", finest_error=1e-3)
    assert method_verdict({ERROR: sound, "velocity_error": small}) == small
    assert method_verdict({ERROR: sound, "velocity_error": small, "position_error": open_one}) == open_one
    assert method_verdict({}) is None


def test_an_undecided_orientation_counts_before_smaller_undecided_errors() -> None:
    """Unless the other error is as large as the motion."""
    chaotic = verdict(verdict="chaotic", finest_error=1e-6)
    for size, counts in ((1e-3, False), (0.9, True)):
        other = verdict("position_error", verdict="pre-asymptotic", finest_error=size)
        assert method_verdict({ERROR: chaotic, "position_error": other}) == (other if counts else chaotic)


@pytest.mark.parametrize(
    "harmless",
    [
        {"quantity": "position_error", "finest_error": 9e-10},
        {"quantity": "position_error", "finest_error": 9e-7, "floor": 1e-7},
        {"quantity": "quaternion_norm_error", "finest_error": 0.9},
    ],
)
def test_undecided_errors_at_round_off_and_properties_do_not_count(harmless: dict[str, Any]) -> None:
    """They leave a sound orientation as the verdict of the method."""
    sound = verdict()
    other = verdict(**{"verdict": "pre-asymptotic", **harmless})
    assert method_verdict({ERROR: sound, other.quantity: other}) == sound


@pytest.mark.parametrize("state", STATES)
def test_a_verdict_that_is_wrong_counts_against_the_method(state: str) -> None:
    """Of the verdicts, these are the ones with a bad tint, and a lower order; an outcome is not a verdict."""
    assert verdict(verdict=state).is_wrong == (STATES[state].tint == "bad" or state == "lower-order")


def test_what_the_state_holds_is_a_property_and_no_fault() -> None:
    """A quaternion that is not normalised is reported with size, step and order, but is not judged."""
    norm = verdict("quaternion_norm_error", order=1.0, finest_error=5e-3, floor=1e-12)
    assert norm.is_property
    assert norm.text == "quaternion_norm_error 0.005 at dt 0.01 s, order 1 (the state is not normalised)"
    assert most_severe([norm]) == []
    assert not verdict("quaternion_norm_error", finest_error=1e-12, floor=1e-12).is_property
    assert not verdict().is_property


def test_an_error_without_a_step_has_no_step_in_its_words() -> None:
    """A method without steps is off by an amount alone; one with a tolerance has that."""
    off = {"verdict": "off", "finest_dt_s": None, "finest_error": 0.1}
    assert verdict(**off).text == "orientation_error_rad is off: 0.1 rad"
    assert verdict(**off, finest_tolerance=1e-6).amount == "0.1 rad at tolerance 1e-6"


def test_cells_are_those_of_each_scenario_at_its_own_common_step() -> None:
    """Methods are in the order of the run, and each scenario has its own common step."""
    plate = {"scenario": "plate", ERROR: 1e-3}
    run = findings(
        {},
        {"method": "euler"},
        {**plate, "dt_s": 0.5},
        methods=(
            {},
            {"quantity": "energy_drift", **FLAT},
            {"method": "euler", "verdict": "off"},
            {"scenario": "plate", "order": 3.0},
        ),
    )
    cells = summary_cells(run)
    assert {name: list(methods) for name, methods in cells.items()} == {
        "brick": [("mujoco", "rk4"), ("mujoco", "euler")],
        "plate": [("mujoco", "rk4")],
    }
    first, second = cells["brick"]["mujoco", "rk4"], cells["plate"]["mujoco", "rk4"]
    assert (first.order, first.error, first.state) == (4.0, 1e-9, "does-not-converge")
    assert (second.order, second.error, second.state) == (3.0, 1e-3, "converges")
    assert cells["brick"]["mujoco", "euler"].state == "off"


# ----------------------------------------------------------------------------------------- worst results


def test_all_that_is_wrong_is_listed_with_its_words_and_command() -> None:
    """Failures come first, then wrong limits by size, then lower orders, then timeouts."""
    run = findings(
        {"reproduce": "a", "scenario": "plate", ERROR: 1e-3, "dt_s": 0.02},
        {"reproduce": "b", "scenario": "plate", ERROR: 2e-3, "dt_s": 0.01},
        {"reproduce": "c", "scenario": "plate", "outcome": "failed", "message": "no", "dt_s": 0.005},
        {"reproduce": "d", "scenario": "plate", "outcome": "failed", "message": "no", "dt_s": 0.004},
        {"reproduce": "f"},
        {"reproduce": "g", "scenario": "plate", "method": "euler", "outcome": "timeout", "message": "slow"},
        methods=(
            {"scenario": "plate", **FLAT, "finest_error": 2e-3},
            {"order": 3.0, "order_high": 3.1},
        ),
    )
    about = "orientation_error_rad"
    assert worst_results(run, summary_cells(run)) == [
        Result("failed", "mujoco:rk4", "", "failed in 2 cases: no", "c", ("plate",), 2),
        Result(
            *("does-not-converge", "mujoco:rk4", about),
            f"{about} does not converge to the truth: 0.002 rad at dt 0.01 s",
            *("b", ("plate",), 2e-3),
        ),
        Result(
            *("lower-order", "mujoco:rk4", about),
            f"{about} of order 3, expected 4: 1e-9 rad at dt 0.01 s",
            *("f", ("brick",), 1e-9),
        ),
        Result("timeout", "mujoco:euler", "", "timeout in 1 case: slow", "g", ("plate",), 1),
    ]
    first, second = Summary.of(run).worst
    assert first.method == "mujoco:rk4"
    assert first.sentence == "failed in 2 cases: no in plate; 2 more findings"
    assert headline([first, second]) == "2 methods with findings: mujoco:rk4, mujoco:euler."


@pytest.mark.parametrize(
    ("sizes", "engines", "is_shared"),
    [
        ((0.2, 0.2, 0.2005), ("mujoco", "dart", "reference"), True),
        ((0.2, 0.2, 0.21), ("mujoco", "dart", "reference"), False),
        ((0.2, 0.2, 0.2), ("mujoco", "mujoco", "mujoco"), False),
        ((0.2, 0.2), ("mujoco", "dart"), False),
    ],
)
def test_a_wrong_limit_that_all_engines_share_has_a_common_cause(
    sizes: tuple[float, ...], engines: tuple[str, ...], is_shared: bool
) -> None:
    """At least three methods of two engines, with the same distance; one sound method excludes it."""
    theory = {name: {"methods": {f"m{k}": {"order": 4} for k in range(4)}} for name in engines}
    keys = [{"engine": name, "method": f"m{k}"} for k, name in enumerate(engines)]

    def sentences(*states: dict[str, Any]) -> list[str]:
        rows = [{**ROW, **key, **state} for key, state in zip(keys, states, strict=True)]
        cases = [{"truth_bound_rad": 1e-12, **key} for key in keys]
        tables = make_tables(cases, rows, scenarios={"brick": {}}, engines=theory)
        return Summary.of(tables).sentences

    wrong = [{**FLAT, "finest_error": size} for size in sizes]
    assert any("share" in one for one in sentences(*wrong)) == is_shared
    assert not any("share" in one for one in sentences({"finest_error": sizes[0]}, *wrong[1:]))


def test_what_repeats_in_several_scenarios_is_one_result() -> None:
    """The result has the largest size with its command, and the number of further scenarios."""
    run = findings(
        {"reproduce": "a"},
        {"scenario": "plate", "reproduce": "b", ERROR: 1e-3},
        methods=({**FLAT}, {**FLAT, "scenario": "plate", "finest_error": 1e-3}),
    )
    (found,) = worst_results(run, summary_cells(run))
    assert (found.scenarios, found.size, found.reproduce) == (("plate", "brick"), 1e-3, "b")
    assert found.sentence.endswith("in plate and 1 more scenario")
    healthy = findings({}, methods=({},))
    assert worst_results(healthy, summary_cells(healthy)) == []


def test_a_probe_that_is_not_passed_is_a_result() -> None:
    """The result has the measured value, the expected one and the step; a consistent probe gives none."""
    probe = {
        "run_id": "r",
        "engine": "mujoco",
        "engine_version": "4",
        "method": "rk4",
        "message": "late",
        "check": "gravity_delay",
        "measured": 1.0,
        "expected": 0.0,
        "deviation": 1.0,
        "tolerance": 0.75,
        "dt_s": 1e-3,
        "reproduce": "bodycheck run probe",
    }
    rows = [{**probe, "verdict": "inconsistent"}, {**probe, "verdict": "consistent", "check": "x"}]
    run = findings({}, methods=({},)).with_rows(probes=rows)
    (found,) = worst_results(run, summary_cells(run))
    assert found.kind == "inconsistent"
    assert found.sentence == "gravity_delay 1, expected 0 at dt 0.001 s: late"


def test_a_property_alone_is_no_finding() -> None:
    """The headline names only methods with faults."""
    norm = Result("property", "mujoco:rk4", "quaternion_norm_error", "q", "a", ("brick",), 1e-3)
    assert headline([MethodResults("mujoco:rk4", (norm,))]) == ""


def test_the_headline_tells_instability_from_faults() -> None:
    """A step beyond the stability limit of a method is not reported in the same sentence as a fault."""
    grown = MethodResults("mujoco:rk4", (Result("unstable", "mujoco:rk4", "", "u", "a", ("brick",), 1),))
    wrong = MethodResults("dart:x", (Result("does-not-converge", "dart:x", "e", "w", "a", ("brick",), 1),))
    unstable = "1 method unstable in some cases: mujoco:rk4."
    assert headline([grown]) == unstable
    assert headline([wrong, grown]) == f"1 method with findings: dart:x. {unstable}"


# --------------------------------------------------------------------------------------------- stable step


def stable_row(
    *cases: tuple[float, str], duration_s: float = 10.0, omega: float = 0.0, **found: Any
) -> tuple[dict[str, Any], list[StableStepSearch]]:
    """Return the stability row of cases with these steps and outcomes, and the requested searches."""
    start = State(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    scene = Scene(RigidBody(1.0, np.eye(3)), start, (), np.zeros(3), duration_s, 11)
    problem: Any = SimpleNamespace(
        scenario=SimpleNamespace(scene=scene),
        scales=SimpleNamespace(omega_scale_rad_s=omega),
        motion=SimpleNamespace(kinetic=np.array([1.0, 3.0, 2.0])),
    )
    made = [
        case(dt_s=dt_s, outcome=outcome, message="m", family="brick", engine_version="3")
        for dt_s, outcome in cases
    ]
    requested: list[StableStepSearch] = []

    def search(_: Any, wanted: StableStepSearch) -> StableStep:
        requested.append(wanted)
        return StableStep("ok", "said", 0.5, 0.505, "why") if not found else StableStep(**found)

    method: Any = SimpleNamespace(name="rk4")
    engine: Any = SimpleNamespace(name="mujoco")
    row = stability_row(problem, engine, method, made, search)
    return row, requested


WHO = {"scenario": "brick", "family": "brick", "engine": "mujoco", "engine_version": "3", "method": "rk4"}


@pytest.mark.parametrize("outcome", ["failed", "timeout", "unsupported", "invalid"])
def test_no_search_is_made_where_a_case_did_not_end(outcome: str) -> None:
    """The row has the outcome and the message of this case, and no step."""
    row, requested = stable_row((0.02, "ok"), (0.01, outcome))
    assert row == {**WHO, "outcome": outcome, "message": "m"}
    assert requested == []


def test_a_row_says_what_the_search_found() -> None:
    """The row has both steps, the reason, the outcome and the message."""
    row, _ = stable_row((0.02, "ok"))
    reported = {
        "dt_stable_s": 0.5,
        "dt_unstable_s": 0.505,
        "reason": "why",
        "outcome": "ok",
        "message": "said",
    }
    assert row == {**WHO, **reported, "reused": False, "build": ""}


@pytest.mark.parametrize(
    ("cases", "scene", "start", "lowest", "highest"),
    [
        ([(0.02, "ok"), (0.01, "ok"), (0.04, "ok")], {}, 0.04, 0.002, 2.5),
        ([(0.02, "unstable"), (0.01, "ok"), (0.04, "ok")], {}, 0.01, 0.002, 2.5),
        ([(0.02, "unstable"), (0.01, "unstable")], {}, 0.01, 0.002, 2.5),
        ([(0.02, "ok")], {"omega": math.pi}, 0.02, 0.004, 2.0),
        ([(3.0, "ok")], {}, 3.0, 0.6, 3.0),
        ([(1e-4, "ok")], {}, 5e-4, 2e-5, 2.5),
    ],
)
def test_a_search_goes_from_the_coarsest_sound_step_to_a_turn(
    cases: list[tuple[float, str]], scene: dict[str, float], start: float, lowest: float, highest: float
) -> None:
    """The upper end is a revolution or a quarter of the duration, the start at least 1/20,000 of it.

    The lower end is a fifth of the finest step.
    """
    _, (search,) = stable_row(*cases, **scene)
    requested = (search.case.setting.dt_s, search.lowest_s, search.highest_s, search.kinetic_limit_j)
    assert requested == pytest.approx((start, lowest, highest, 300.0))
    assert search.case.method == "rk4"


SEVERITIES = {
    **dict.fromkeys(["converges", "at-floor", "at-precision-floor", "exact"], 0),
    **dict.fromkeys(["pre-asymptotic", "lower-order", "too-few-points", "chaotic", "unsupported"], 1),
    **dict.fromkeys(["does-not-converge", "error-grows", "off"], 2),
    **dict.fromkeys(["unstable", "failed", "timeout", "invalid"], 3),
}


def test_each_state_has_a_severity() -> None:
    """The severity is 0 for good, 1 for undecided, 2 for wrong and 3 for broken."""
    assert {word: severity(word) for word in STATES} == SEVERITIES
    assert severity("unheard-of") == 1


def test_property_of_the_state_has_its_order_in_two_digits() -> None:
    """An engine that never normalises loses orthogonality with its own order, printed to two digits."""
    found = QuantityVerdict("orthogonality_error", "converges", 1e-3, order=1.987, floor=1e-15)
    assert "order 2 (" in found.text
