"""What cells say, each rule by itself: states, faults, the worst of a run, and the row of a stable step."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gated import CASE, METHOD, a_run

from bodycheck.adapters.stable_step import Search, StableStep
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reports.case import CaseResult
from bodycheck.reports.findings import common_step, shown_case
from bodycheck.reports.offenders import Offender, offenders
from bodycheck.reports.stability import stability_row
from bodycheck.reports.stored import Tables
from bodycheck.reports.summary import (
    Cell,
    Fault,
    faults_of,
    is_lower,
    summary_cell,
    summary_cells,
    worst_state,
)

ERROR = "orientation_error_rad"
ROW = {**METHOD, "order_low": 3.9, "order_high": 4.1, "points": 5, "floor": 1e-14}
FOUND = {ERROR: ROW}
THEORY = {"mujoco": {"methods": {"rk4": {"order": 4}, "euler": {"order": None}}}}


def case(**cells: Any) -> CaseResult:
    """Return a case that ended well, but for what is told."""
    return CaseResult({**CASE, "truth_bound_rad": 1e-12, **cells})


def findings(*cases: dict[str, Any], methods: tuple[dict[str, Any], ...] = ()) -> Tables:
    """Return a run of one or two scenarios."""
    rows = [{"truth_bound_rad": 1e-12, **cells} for cells in cases]
    scenarios = {"brick": {}, "plate": {}}
    return a_run(rows, [{**ROW, **cells} for cells in methods], scenarios=scenarios, engines=THEORY)


# ------------------------------------------------------------------------------------------------- states


def test_faults_of_one_kind_stand_together() -> None:
    """Same scenario, method, outcome and message; what ended well or is unsupported is none."""
    bad = {"outcome": "failed", "message": "no"}
    cases = [case(), case(outcome="unsupported"), case(**bad), case(**bad, dt_s=0.02)]
    cases += [case(outcome=one, message="no", dt_s=None, tolerance=1e-6) for one in ("timeout", "unstable")]
    cases += [case(outcome="invalid", message="no"), case(outcome="failed", message="yes")]
    key = ("mujoco", "rk4")
    assert faults_of(cases) == [
        Fault("brick", key, "failed", "no", (0.01, 0.02)),
        Fault("brick", key, "timeout", "no", (1e-6,)),
        Fault("brick", key, "unstable", "no", (1e-6,)),
        Fault("brick", key, "invalid", "no", (0.01,)),
        Fault("brick", key, "failed", "yes", (0.01,)),
    ]


def test_a_method_is_shown_at_the_common_step_or_at_its_finest_tolerance() -> None:
    """A case of another step does not stand for it."""
    steps = [case(dt_s=dt_s) for dt_s in (0.02, 0.01, 0.005)]
    assert shown_case(steps, 0.01) is steps[1]
    assert shown_case(steps, 0.001) is None
    told = [case(dt_s=None, tolerance=tolerance) for tolerance in (1e-3, 1e-9, 1e-6)]
    assert shown_case(told, 0.01) is told[1]
    none = [case(dt_s=None)]
    assert shown_case(none, 0.01) is none[0]
    assert common_step([case(dt_s=0.1), case(dt_s=0.1), case(dt_s=0.2), case(dt_s=None)]) == 0.1
    assert common_step([case(dt_s=0.1), case(dt_s=0.2)]) == 0.1
    unsupported = [case(dt_s=0.2, outcome="unsupported") for _ in range(3)]
    assert common_step([case(dt_s=0.1), *unsupported]) == 0.1


def test_a_cell_says_state_order_error_and_faults() -> None:
    """By the verdict of the orientation; other measures that do not converge stand beside."""
    cases = [case(), case(dt_s=0.02, outcome="unstable"), case(dt_s=0.03, outcome="unstable")]
    flat = {"verdict": "does-not-converge"}
    found = {**FOUND, "energy_drift": {**ROW, **flat}, "omega_error": ROW, "position_error": {**ROW, **flat}}
    cell = summary_cell(cases, found, 0.01)
    assert cell == Cell(
        "converges",
        4.0,
        1e-9,
        {"unstable": 2},
        3,
        ("energy_drift", "position_error"),
        "order between 3.9 and 4.1, from 5 steps; floor 1e-14 rad",
    )
    assert cell.notes == [
        "2 of 3 unstable",
        "energy_drift does not converge",
        "position_error does not converge",
    ]
    assert summary_cell(cases, FOUND, 0.02).error is None
    assert summary_cell(cases, FOUND, 0.5).error is None
    flat_row = {ERROR: {**ROW, **flat, "order": math.nan}}
    plateau = summary_cell(cases[:1], flat_row, 0.01)
    assert plateau == Cell("does-not-converge", None, 1e-9, {}, 1, (), "floor 1e-14 rad")


def test_where_nothing_ended_well_the_gravest_end_is_the_state() -> None:
    """With every reason once; what is merely unsupported is no fault."""
    ends = (("timeout", "slow"), ("failed", "no"), ("failed", "no"))
    cell = summary_cell([case(outcome=one, message=why) for one, why in ends], FOUND, 0.01)
    assert cell == Cell("failed", faults={"failed": 2, "timeout": 1}, cases=3, detail="slow; no")
    none = summary_cell([case(outcome="unsupported", message="no pivot")], {}, 0.01)
    assert none == Cell("unsupported", cases=1, detail="no pivot")


@pytest.mark.parametrize(("error", "state"), [(3e-11, "exact"), (3.01e-11, "off")])
def test_a_method_without_steps_is_exact_within_thirty_bounds_of_the_truth(error: float, state: str) -> None:
    """It has no order; one error decides."""
    cell = summary_cell([case(dt_s=None, **{ERROR: error})], {}, 0.01)
    assert cell == Cell(state, error=error, cases=1)


def test_cells_are_those_of_each_scenario_at_its_own_common_step() -> None:
    """Also of a scenario of which nothing was run; methods in the order of the run."""
    plate = {"scenario": "plate", ERROR: 1e-3}
    run = findings(
        {},
        {"method": "euler"},
        {**plate, "dt_s": 0.5},
        methods=(
            {},
            {"quantity": "energy_drift", "verdict": "does-not-converge"},
            {"scenario": "plate", "order": 3.0},
        ),
    )
    cells = summary_cells(run)
    assert {name: list(methods) for name, methods in cells.items()} == {
        "brick": [("mujoco", "rk4"), ("mujoco", "euler")],
        "plate": [("mujoco", "rk4")],
    }
    first, second = cells["brick"]["mujoco", "rk4"], cells["plate"]["mujoco", "rk4"]
    assert (first.order, first.error, first.plateaus) == (4.0, 1e-9, ("energy_drift",))
    assert (second.order, second.error, second.plateaus) == (3.0, 1e-3, ())
    assert cells["brick"]["mujoco", "euler"].state == "off"


@pytest.mark.parametrize(
    ("cell", "lower", "worst"),
    [
        (Cell("converges", 4.0), False, "converges"),
        (Cell("converges", 3.8), False, "converges"),
        (Cell("converges", 3.79), True, "lower-order"),
        (Cell("at-floor"), False, "at-floor"),
        (Cell("converges", 3.0, plateaus=("omega_error",)), True, "does-not-converge"),
        (Cell("converges", 3.0, faults={"timeout": 1}, plateaus=("omega_error",)), True, "timeout"),
    ],
)
def test_the_worst_state_is_the_gravest_of_all_that_a_cell_says(cell: Cell, lower: bool, worst: str) -> None:
    """A fault, then a plateau, then an order more than 0.2 below that of theory, then the verdict."""
    key = ("mujoco", "rk4")
    assert is_lower(findings({}), key, cell) == lower
    assert worst_state(findings({}), key, cell) == worst
    assert not is_lower(findings({}), ("mujoco", "euler"), cell)


# ----------------------------------------------------------------------------------------------- offenders


def test_all_that_is_wrong_is_listed_with_its_words_and_command() -> None:
    """Faults first, then what does not converge by its error, then other measures, then lower orders."""
    run = findings(
        {"reproduce": "a", "scenario": "plate", ERROR: 1e-3, "dt_s": 0.02},
        {"reproduce": "b", "scenario": "plate", ERROR: 2e-3, "dt_s": 0.01},
        {"reproduce": "c", "scenario": "plate", "outcome": "failed", "message": "no", "dt_s": 0.005},
        {"reproduce": "d", "scenario": "plate", "outcome": "failed", "message": "no", "dt_s": 0.004},
        {"reproduce": "e", "method": "euler", "dt_s": None, ERROR: 0.5, "control": "none"},
        {"reproduce": "f"},
        {"reproduce": "g", "scenario": "plate", "method": "euler", "outcome": "timeout", "message": "slow"},
        methods=({"scenario": "plate", "verdict": "does-not-converge"}, {"order": 3.0}),
    )
    assert offenders(run) == [
        Offender("failed", "plate", "mujoco:rk4", "failed in 2 cases: no", "c"),
        Offender("timeout", "plate", "mujoco:euler", "timeout in 1 case: slow", "g"),
        Offender(
            *("does-not-converge", "plate", "mujoco:rk4", "does not converge: 0.002 rad, dt 0.01 s", "b"),
            2e-3,
        ),
        Offender("off", "brick", "mujoco:euler", "does not converge: 0.5 rad, no steps", "e", 0.5),
        Offender("lower-order", "brick", "mujoco:rk4", "order 3, in theory 4", "f"),
    ]


def test_of_two_that_do_not_converge_the_larger_error_comes_first() -> None:
    """Whatever their order in the run; and a plateau of another measure goes before a lower order."""
    flat = {"verdict": "does-not-converge"}
    run = findings(
        {},
        {"scenario": "plate", ERROR: 1e-3},
        methods=(flat, {**flat, "scenario": "plate"}, {**flat, "quantity": "omega_error"}),
    )
    assert [(one.scenario, one.error) for one in offenders(run)] == [("plate", 1e-3), ("brick", 1e-9)]
    plateau = findings({}, methods=({"order": 3.0}, {**flat, "quantity": "omega_error"}))
    (found,) = offenders(plateau)
    assert (found.kind, found.text) == ("plateau", "omega_error do not shrink with the step")
    assert offenders(findings({}, methods=({},))) == []


# --------------------------------------------------------------------------------------------- stable step


def stable_row(
    *cases: tuple[float, str], duration_s: float = 10.0, omega: float = 0.0, **found: Any
) -> tuple[dict[str, Any], list[Search]]:
    """Return the row of cases with these steps and outcomes, and what was searched for it."""
    start = State(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    scene = Scene(RigidBody(1.0, np.eye(3)), start, (), np.zeros(3), duration_s, 11)
    subject: Any = SimpleNamespace(
        scenario=SimpleNamespace(scene=scene),
        scales=SimpleNamespace(omega_scale_rad_s=omega),
        motion=SimpleNamespace(kinetic=np.array([1.0, 3.0, 2.0])),
    )
    made = [
        case(dt_s=dt_s, outcome=outcome, message="m", family="brick", engine_version="3")
        for dt_s, outcome in cases
    ]
    asked: list[Search] = []

    def search(_: Any, wanted: Search) -> StableStep:
        asked.append(wanted)
        return StableStep("ok", "said", 0.5, 0.505, "why") if not found else StableStep(**found)

    method: Any = SimpleNamespace(name="rk4")
    engine: Any = SimpleNamespace(name="mujoco")
    row = stability_row(subject, engine, method, made, search)
    return row, asked


WHO = {"scenario": "brick", "family": "brick", "engine": "mujoco", "engine_version": "3", "method": "rk4"}


@pytest.mark.parametrize("outcome", ["failed", "timeout", "unsupported", "invalid"])
def test_no_search_is_made_where_a_case_did_not_end(outcome: str) -> None:
    """The row says how it ended, and has no step."""
    row, asked = stable_row((0.02, "ok"), (0.01, outcome))
    assert row == {**WHO, "outcome": outcome, "message": "m"}
    assert asked == []


def test_a_row_says_what_the_search_found() -> None:
    """Both steps, the reason, the outcome and the message."""
    row, _ = stable_row((0.02, "ok"))
    told = {"dt_stable_s": 0.5, "dt_unstable_s": 0.505, "reason": "why", "outcome": "ok", "message": "said"}
    assert row == {**WHO, **told}


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
    """Or to a quarter of the duration; from no less than a 20 000th of it, and to a fifth of the finest."""
    _, (search,) = stable_row(*cases, **scene)
    asked = (search.case.setting.dt_s, search.lowest_s, search.highest_s, search.kinetic_limit_j)
    assert asked == pytest.approx((start, lowest, highest, 300.0))
    assert search.case.method == "rk4"
