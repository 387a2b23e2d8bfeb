"""The result of a gate: bounds, floors and patterns; a value that was not measured never passes."""

from __future__ import annotations

import math
from typing import Any

import pytest

from bodycheck.reports.gates.gate import Gate, gate_of
from bodycheck.reports.gates.gate_output import error_lines, line_of
from bodycheck.reports.gates.verdict import GateResult, check_gates, distance
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.scenarios.library import load_any
from bodycheck.scenarios.serialization import serialized
from tests.helpers.gate_tables import CASE, METHOD, make_tables

NEAR = {"near": 1e-3, "decades": 0.5}


def gate(**table: Any) -> Gate:
    """Return a gate on the orientation error, with the given fields replaced."""
    return gate_of({"measure": "orientation_error_rad", "reason": "r", **table}, "here")


def one(requested: Gate, *cases: dict[str, Any], methods: list[dict[str, Any]] | None = None) -> GateResult:
    """Return the result of the gate on a run of these cases."""
    (result,) = check_gates([requested], make_tables(list(cases), methods))
    return result


@pytest.mark.parametrize(
    ("bound", "value", "passes"),
    [
        ({"upper": 1e-3}, 1e-3, True),
        ({"upper": 1e-3}, math.nextafter(1e-3, 1), False),
        ({"upper": 1e-3}, 0.0, True),
        ({"upper": 0.0}, 5e-324, False),
        ({"upper": 0.0}, 0.0, True),
        ({"lower": 1e-3}, 1e-3, True),
        ({"lower": 1e-3}, math.nextafter(1e-3, 0), False),
        ({"lower": 1e-3}, 0.0, False),
        ({"lower": 1e-4, "upper": 1e-3}, 5e-4, True),
        ({"lower": 1e-4, "upper": 1e-3}, 5e-5, False),
        ({"lower": 1e-4, "upper": 1e-3}, 5e-3, False),
        (NEAR, 3.1e-3, True),
        (NEAR, 3.3e-4, True),
        (NEAR, 3.2e-3, False),
        (NEAR, 3.1e-4, False),
    ],
)
def test_bound_includes_itself(bound: dict[str, Any], value: float, passes: bool) -> None:
    """A value at the bound passes; one double beyond it fails."""
    result = one(gate(**bound), {"orientation_error_rad": value})
    assert result.status == ("passed" if passes else "failed")


@pytest.mark.parametrize(
    ("bound", "value", "passes"),
    [
        ({"upper": 1e-15}, 9e-15, True),
        ({"upper": 1e-15}, 1.1e-14, False),
        ({"upper": 1e-13}, 9e-14, True),
        ({"lower": 1e-15}, 1e-16, True),
        ({"lower": 1e-13}, 1e-16, False),
        ({"near": 1e-15, "decades": 0.1}, 9e-15, True),
        ({"near": 1e-15, "decades": 0.1}, 1.1e-14, False),
    ],
)
def test_values_below_the_floor_pass(bound: dict[str, Any], value: float, passes: bool) -> None:
    """Values and bounds below the floor of 1e-14 count as the floor; above it the bound counts."""
    result = one(gate(**bound, floor=1e-14), {"orientation_error_rad": value})
    assert result.status == ("passed" if passes else "failed")


UNMEASURED = {
    "not a number": {"orientation_error_rad": math.nan},
    "infinite": {"orientation_error_rad": math.inf},
    "minus infinite": {"orientation_error_rad": -math.inf},
    "empty": {"orientation_error_rad": None},
    **{
        outcome: {"outcome": outcome, "orientation_error_rad": 0.0}
        for outcome in ("unstable", "failed", "timeout", "unsupported", "invalid")
    },
}


@pytest.mark.parametrize("bound", [{"upper": 1.0}, {"lower": 0.0}, NEAR], ids=["upper", "lower", "near"])
@pytest.mark.parametrize("what", UNMEASURED)
def test_unmeasured_case_never_passes(what: str, bound: dict[str, Any]) -> None:
    """Alone it gives `nothing measured`; next to a passing case the gate fails."""
    alone = one(gate(**bound), UNMEASURED[what])
    assert alone.status == "nothing"
    assert alone.why
    beside = one(gate(**bound), {"orientation_error_rad": 1e-3}, {**UNMEASURED[what], "dt_s": 0.02})
    assert beside.status == "failed"
    assert [check.row.at for check in beside.failed] == ["dt 0.02 s"]


@pytest.mark.parametrize("outcome", ["ok", "unstable", "unsupported"])
def test_outcome_is_compared_with_the_required_one(outcome: str) -> None:
    """A gate may require an outcome, and then only that one passes."""
    cases = ({"outcome": found} for found in ("ok", "unstable", "unsupported"))
    requested = gate(measure="outcome", equals=outcome)
    assert [one(requested, case).status for case in cases] == [
        "passed" if found == outcome else "failed" for found in ("ok", "unstable", "unsupported")
    ]


def test_law_is_bounded_by_method_and_not_measured_without_a_row() -> None:
    """A gate on a law takes the size of each method's own row; a method without one does not pass."""
    laws = [
        {
            "engine": "mujoco",
            "method": "rk4",
            "law": "replay",
            "size": 0.0,
            "reproduce": "bodycheck laws mujoco",
        },
        {"engine": "mujoco", "method": "rk4", "law": "rotation", "size": 1.0},
        {"engine": "mujoco", "method": "euler", "law": "replay", "size": 1e-9},
        {"engine": "mujoco", "method": "discrete", "law": "replay", "message": "no such body"},
    ]
    cases = [{"method": method} for method in ("rk4", "euler", "implicit", "discrete")]
    tables = make_tables(cases).with_rows(laws=laws)
    for method, status, why in (
        ("rk4", "passed", ""),
        ("euler", "failed", ""),
        ("implicit", "nothing", "no law.replay: not checked"),
        ("discrete", "nothing", "no law.replay: no such body"),
    ):
        (result,) = check_gates([gate(measure="law.replay", method=method, upper=0.0)], tables)
        assert (result.status, result.checks[0].row.why) == (status, why), method


def _of_two_scenes(*cases: dict[str, Any], methods: list[dict[str, Any]] | None = None) -> Tables:
    """Return a run of cases in the free chain, a tree, and in a free body."""
    found = {name: serialized(load_any([name])[0][1]) for name in ("free-chain", "free-flight")}
    return make_tables(list(cases), methods, scenarios=found)


TREE, BODY = {"scenario": "free-chain"}, {"scenario": "free-flight"}


@pytest.mark.slow(after=1)
@pytest.mark.parametrize(
    ("measure", "lacking", "having"),
    [
        ("orthogonality_error", TREE, BODY),
        ("determinant_error", TREE, BODY),
        ("joint_error_rad", BODY, TREE),
        ("constraint_drift_m", BODY, TREE),
    ],
)
def test_measure_that_a_scene_lacks_is_not_missing(
    measure: str, lacking: dict[str, Any], having: dict[str, Any]
) -> None:
    """A scene without the measure does not count, and alone is nothing; a scene that has it must give it."""
    requested = gate(measure=measure, upper=1e-3)
    (result,) = check_gates([requested], _of_two_scenes(lacking, {**having, measure: 1e-9}))
    assert (result.status, len(result.checks)) == ("passed", 1)
    assert lacking["scenario"] in result.left_out[0]
    (result,) = check_gates([requested], _of_two_scenes(lacking, {**having, measure: 1e-2}))
    assert result.status == "failed"
    (result,) = check_gates([requested], _of_two_scenes({**having, measure: 1e-9}, having))
    assert (result.status, len(result.failed)) == ("failed", 1)
    (result,) = check_gates([requested], _of_two_scenes(lacking))
    assert (result.status, lacking["scenario"] in result.why) == ("nothing", True)


def test_order_of_a_measure_that_a_scene_lacks_is_not_missing() -> None:
    """The order of an error of joints counts in trees only."""
    rows = [{**TREE, "quantity": "joint_error_rad", "order": 4.0}]
    requested = gate(measure="order.joint_error_rad", lower=3.9)
    (result,) = check_gates([requested], _of_two_scenes(TREE, BODY, methods=rows))
    assert (result.status, len(result.checks)) == ("passed", 1)
    (result,) = check_gates([requested], _of_two_scenes(TREE, BODY))
    assert result.status == "nothing"


def test_method_that_moves_no_tree_fails_no_gate_over_all_scenarios() -> None:
    """It does not count in trees; a gate on the tree alone is nothing, and one refusal among trees fails."""
    refused = {**TREE, "outcome": "unsupported", "message": "no joints"}
    requested = gate(upper=1e-3)
    (result,) = check_gates([requested], _of_two_scenes(BODY, refused))
    assert (result.status, len(result.checks)) == ("passed", 1)
    assert "mujoco:rk4" in result.left_out[0]
    (result,) = check_gates([gate(scenario="free-chain", upper=1e-3)], _of_two_scenes(BODY, refused))
    assert result.status == "nothing"
    (result,) = check_gates([requested], _of_two_scenes(BODY, refused, {**TREE, "dt_s": 0.1}))
    assert result.status == "failed"
    (result,) = check_gates([requested], _of_two_scenes(BODY, {**refused, **BODY, "dt_s": 0.1}))
    assert result.status == "failed"


PATTERNS = {
    "scenario": ({"scenario": "lake"}, "no scenario of the run matches lake (available: brick)"),
    "engine": ({"engine": "mujoc"}, "no engine of the run matches mujoc (available: mujoco)"),
    "method": ({"method": "RK4"}, "no method of the run matches RK4 (available: rk4)"),
    "step": ({"dt_s": 0.001}, "no step of the run matches 0.001 (available: dt 0.01 s)"),
    "tolerance": ({"tolerance": 1e-6}, "no step of the run matches 1e-6 (available: dt 0.01 s)"),
}


@pytest.mark.parametrize("key", PATTERNS)
def test_gate_without_cases_names_the_key(key: str) -> None:
    """The message names the pattern that matches nothing and what the run has."""
    patterns, message = PATTERNS[key]
    result = one(gate(upper=1.0, **patterns), {})
    assert (result.status, result.why) == ("nothing", message)


def test_missing_engine_is_reported_with_its_reason() -> None:
    """The message has the reason why it could not be imported."""
    run = make_tables([{}], engines={"dart": {"unavailable": "dart cannot be imported: no module"}})
    (result,) = check_gates([gate(upper=1.0, engine="dart")], run)
    assert result.status == "nothing"
    assert result.why.endswith("(available: mujoco); dart cannot be imported: no module")


def test_empty_run_passes_no_gate() -> None:
    """Without a case every gate measured nothing."""
    for requested in (
        gate(upper=1.0),
        gate(measure="verdict", equals="converges"),
        gate(measure="outcome", equals="ok"),
    ):
        assert one(requested).status == "nothing"


@pytest.mark.parametrize("pattern", ["brick", "bri*", "*", "b?ick", "[ab]rick"])
@pytest.mark.parametrize(("name", "matches"), [("brick", True), ("brick/1e-3", True), ("a brick", False)])
def test_scenario_matches_by_name_or_family(pattern: str, name: str, matches: bool) -> None:
    """A family's name matches all its children; a pattern matches the whole name."""
    requested = gate(upper=1.0, scenario=pattern)
    assert requested.matches_scenario(name) == (matches or pattern == "*")


def test_step_matches_to_round_off() -> None:
    """1e-3 in the file matches the step 0.1 / 100 of the run; its neighbours do not."""
    requested = gate(upper=1.0, dt_s=1e-3)
    assert requested.matches_setting(0.1 / 100, None)
    assert not requested.matches_setting(1.001e-3, None)
    assert not requested.matches_setting(None, 1e-3)


@pytest.mark.parametrize(
    ("bound", "cells", "status"),
    [
        ({"lower": 3.9, "upper": 4.1}, {"order": 4.0}, "passed"),
        ({"lower": 3.9, "upper": 4.1}, {"order": 3.85, "order_low": 3.8, "order_high": 3.89}, "failed"),
        ({"lower": 3.9, "upper": 4.1}, {"order": 3.85, "order_low": 3.7, "order_high": 4.0}, "nothing"),
        ({"upper": 4.1}, {"order": 4.2, "order_low": 4.05, "order_high": 4.35}, "nothing"),
        ({"upper": 4.1}, {"order": 4.2, "order_low": 4.15, "order_high": 4.25}, "failed"),
        ({"upper": 1.0}, {"order": -2.0}, "passed"),
        ({"lower": 0.0}, {"order": None, "verdict": "at-floor"}, "nothing"),
        ({"lower": 0.0}, {"quantity": "energy_drift"}, "nothing"),
    ],
)
def test_order_is_compared_with_its_bounds(bound: dict[str, Any], cells: dict[str, Any], status: str) -> None:
    """Only a measured order of the requested quantity can pass, and only one that is known to fail fails."""
    requested = gate(measure="order.orientation_error_rad", **bound)
    assert one(requested, {}, methods=[cells]).status == status


@pytest.mark.parametrize(
    ("verdict", "reason"),
    [
        ("at-floor", "at-floor"),
        (
            "does-not-converge",
            "orientation_error_rad does not converge to the truth: 0.02 rad at dt 0.01 s",
        ),
    ],
)
def test_missing_order_has_the_verdict_as_its_reason(verdict: str, reason: str) -> None:
    """The size of the error stands where it counts against the method."""
    row = {"order": None, "verdict": verdict, "finest_error": 0.02, "finest_dt_s": 0.01}
    result = one(gate(measure="order.orientation_error_rad", lower=1.0), {}, methods=[row])
    assert [check.row.why for check in result.checks] == [f"no order: {reason}"]


@pytest.mark.parametrize(("points", "why"), [(3, "at least 4 steps"), (4, "no one power of dt")])
def test_an_order_that_is_missing_though_the_method_converges_has_a_reason(points: int, why: str) -> None:
    """It takes four usable errors, which follow one power of the step."""
    row = {"order": None, "verdict": "converges", "finest_dt_s": 0.01, "points": points}
    (check,) = one(gate(measure="order.orientation_error_rad", lower=1.0), {}, methods=[row]).checks
    assert check.row.why.startswith("no order: converges, but ")
    assert why in check.row.why


@pytest.mark.parametrize("verdict", ["does-not-converge", "error-grows"])
def test_order_that_the_verdict_excludes_fails(verdict: str) -> None:
    """A method that is wrong, and so has no order, fails with verdict and error, alone or beside others."""
    row = {"order": None, "verdict": verdict, "finest_error": 0.02, "finest_dt_s": 0.01, "method": "euler"}
    requested = gate(measure="order.orientation_error_rad", lower=1.0)
    alone = one(requested, {"method": "euler"}, methods=[row])
    beside = one(requested, {}, {"method": "euler"}, methods=[{}, row])
    for result in (alone, beside):
        assert (result.status, len(result.failed)) == ("failed", 1)
        assert "0.02 rad at dt 0.01 s" in line_of(result)
        assert [line for line in error_lines(result) if "euler: dt 0.01 s" in line]
    unmeasured = {**row, "verdict": "too-few-points"}
    assert one(requested, {"method": "euler"}, methods=[unmeasured]).status == "nothing"


def test_method_without_a_row_does_not_pass() -> None:
    """If one of two methods was unsupported, a gate on the verdict of both fails."""
    cases = [{}, {"method": "euler", "outcome": "unsupported", "message": "no pivot"}]
    result = one(gate(measure="verdict", equals="converges"), *cases, methods=[{}])
    assert result.status == "failed"
    assert [check.row.why for check in result.failed] == ["no verdict: no pivot"]


@pytest.mark.parametrize(
    ("found", "status"),
    [({"dt_stable_s": 0.2}, "passed"), ({"dt_stable_s": 0.05}, "failed"), ({"message": "lost"}, "nothing")],
)
def test_stable_step_is_compared_with_its_bound(found: dict[str, Any], status: str) -> None:
    """The largest stable step must be long enough; without a search nothing was measured."""
    row = {"scenario": "brick", "engine": "mujoco", "method": "rk4", **found}
    requested = gate(measure="stability.dt_stable_s", lower=0.1)
    (result,) = check_gates([requested], make_tables([{}], [], [row]))
    assert result.status == status
    (none,) = check_gates([requested], make_tables([{}]))
    assert none.status == "nothing"


@pytest.mark.parametrize(
    ("found", "status"), [("bounded", "passed"), ("linear", "failed"), (None, "nothing")]
)
def test_growth_is_compared_with_the_required_one(found: str | None, status: str) -> None:
    """A growth that was not classified does not pass."""
    requested = gate(measure="growth.energy_drift", equals="bounded")
    row = {"quantity": "energy_drift", "growth": found}
    assert one(requested, {}, methods=[row]).status == status


def test_a_failed_order_has_the_error_at_each_step() -> None:
    """The coarsest step comes first, with the order between neighbours; a failed case has its message."""
    errors = {0.01: 1e-3, 0.02: 4e-3, 0.005: 5e-4}
    cases = [{"dt_s": dt_s, "orientation_error_rad": error} for dt_s, error in errors.items()]
    cases.append({"dt_s": 0.04, "outcome": "failed", "message": "no convergence"})
    result = one(gate(measure="order.orientation_error_rad", lower=3.9), *cases, methods=[{"order": 1.5}])
    assert result.worst is not None
    lines = result.worst.row.errors
    assert [line.split(":")[0] for line in lines] == ["dt 0.04 s", "dt 0.02 s", "dt 0.01 s", "dt 0.005 s"]
    assert lines[0].endswith("failed: no convergence")
    assert "order 2" in lines[2]
    assert "order 1" in lines[3]


def test_distance_is_in_decades_for_errors_and_plain_for_orders() -> None:
    """1e-2 is one decade beyond 1e-3; an order of 3.5 is 0.4 beyond 3.9; two digits are shown."""
    error = one(gate(upper=1e-3), {"orientation_error_rad": 1e-2})
    near = one(gate(upper=1e-3), {"orientation_error_rad": 9.7e-3})
    order = one(gate(measure="order.orientation_error_rad", lower=3.9), {}, methods=[{"order": 3.5}])
    kept = one(gate(upper=1e-3), {"orientation_error_rad": 1e-5})
    assert kept.worst is not None
    assert distance(kept.worst, kept.gate) == "2 decades within"
    met = one(gate(measure="order.orientation_error_rad", lower=3.9), {}, methods=[{"order": 4.2}])
    assert met.worst is not None
    assert distance(met.worst, met.gate) == "0.3 within"
    assert error.worst is not None
    assert near.worst is not None
    assert order.worst is not None
    assert distance(near.worst, near.gate) == "0.99 decades beyond"  # log10 9.7 = 0.98677
    assert distance(error.worst, error.gate) == "1 decade beyond"
    assert distance(order.worst, order.gate) == "0.4 off the bound"


def test_worst_case_is_the_nearest_to_failing() -> None:
    """Among three passing cases it has the largest error; among words it is one that fails."""
    errors = [{"orientation_error_rad": error, "dt_s": error} for error in (1e-9, 1e-5, 1e-7)]
    worst = one(gate(upper=1e-3), *errors).worst
    assert worst is not None
    assert worst.row.obtained == 1e-5
    for bound in ({"upper": 0.0}, {"upper": -1.0}):  # every distance is infinite in decades
        worst = one(gate(**bound), *errors).worst
        assert worst is not None
        assert worst.row.obtained == 1e-5
    worst = one(gate(lower=0.0, floor=0.0), *errors).worst
    assert worst is not None
    assert worst.row.obtained == 1e-9
    word = one(gate(measure="outcome", equals="ok"), {}, {"outcome": "failed"}).worst
    assert word is not None
    assert word.row.obtained == "failed"


@pytest.mark.parametrize(
    ("requested", "command"),
    [
        (None, "bodycheck run brick --engine mujoco:rk4"),
        ([0.02, 0.01], "bodycheck run brick --engine mujoco:rk4 --dt 0.02,0.01"),
    ],
)
def test_order_is_reproduced_with_the_steps_of_its_run(requested: list[float] | None, command: str) -> None:
    """The command has the requested steps, and none if the run chose them."""
    run = make_tables([CASE], [METHOD], dt_s=requested)
    (result,) = check_gates([gate(measure="order.orientation_error_rad", lower=5.0)], run)
    assert [check.row.reproduce for check in result.failed] == [command]
