"""What a run says in words: the verdict, the states, numbers and lists."""

from __future__ import annotations

from dataclasses import replace

import pytest

from bodycheck.reports.case import CaseResult
from bodycheck.reports.findings import common_step
from bodycheck.reports.run import Run
from bodycheck.reports.states import STATES
from bodycheck.reports.summary import Cell, summary_cells, worst_state
from bodycheck.reports.summary_words import verdict_sentences
from bodycheck.reports.wording import names, number, scientific, step


@pytest.mark.slow
def test_the_verdict_names_what_is_not_as_it_should_be(run: Run) -> None:
    """A plateau, a lower order and an order that cannot be told are each said of the method they befell."""
    cells = summary_cells(run)
    forced = cells["forced"]
    odd = {
        ("reference", "rk4"): replace(forced["reference", "rk4"], order=2.0),
        ("reference", "m1"): Cell("does-not-converge"),
        ("reference", "m2"): Cell("pre-asymptotic"),
    }
    told = verdict_sentences(run, {**cells, "forced": {**forced, **odd}})
    assert "Of a lower order than in theory: reference:rk4 in forced (2, in theory 4)." in told
    assert "The orientation error does not converge: reference:m1 in forced." in told
    pairs = sum(len(methods) for methods in cells.values())
    assert f"No order can be told for 1 of {pairs} pairs of method and scenario, in forced." in told
    assert " methods but reference:rk4, reference:m1, reference:m2, " in told[0]
    one = {"forced": {("reference", "rk3"): Cell("unsupported"), ("reference", "rk4"): Cell("at-floor")}}
    first, *_ = verdict_sentences(run, one)
    assert first == "reference:rk4 converges with its order of theory, or is at the floor, in forced."


@pytest.mark.slow
def test_a_lower_order_has_its_cause_where_the_cases_tell_it(run: Run) -> None:
    """A load that switches inside a step makes any method one of order 2, and the sentence says so."""
    key, note = ("reference", "rk4"), "load switches inside a step: 1; such a step carries the mean of it"
    cases = tuple(replace(case, columns={**case.columns, "message": note}) for case in run.cases)
    cells = {"forced": {key: replace(summary_cells(run)["forced"][key], order=2.0)}}
    told = verdict_sentences(replace(run, cases=cases), cells)
    cause = "reference:rk4 in forced (2, in theory 4: a load switches inside a step)"
    assert f"Of a lower order than in theory: {cause}." in told


def test_every_verdict_and_outcome_has_its_word() -> None:
    """Whatever a method or a case can come to has a symbol, a word and a meaning."""
    verdicts = "converges pre-asymptotic does-not-converge at-floor chaotic unstable too-few-points"
    outcomes = "unstable failed timeout unsupported invalid"
    assert {*verdicts.split(), *outcomes.split()} <= STATES.keys()


def test_methods_are_compared_at_the_finest_step_that_most_have() -> None:
    """Steps that only some methods were refined to are not the common one; without steps there is none."""
    steps = [None, 0.02, 0.01, 0.02, 0.01, 0.005, 0.02, 0.01]
    cases = [CaseResult({"dt_s": dt_s, "outcome": "ok"}) for dt_s in steps]
    assert common_step([*cases, CaseResult({"dt_s": 0.02, "outcome": "unsupported"})]) == 0.01
    assert common_step(cases[:1]) is None


@pytest.mark.parametrize("value", [0.0, 1e-300, -2.5e-17, 1.0, 0.1, 12345.678, 1e5, 6.02e23])
def test_numbers_read_back(value: float) -> None:
    """What is shown parses to the value at the shown precision, a step to the very same double."""
    assert float(number(value)) == float(f"{value:.4g}")
    assert float(scientific(value)) == float(f"{value:.3g}")
    assert float(step(value)) == value


def test_lists_read_as_sentences() -> None:
    """Names are joined as in a sentence; of a long list the rest is counted."""
    assert names(["a"]) == "a"
    assert names(["a", "b", "c"]) == "a, b and c"
    assert names([str(i) for i in range(10)]) == "0, 1, 2, 3, 4, 5, 6 and 3 more"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("cell", "worst"),
    [
        (Cell("converges", 4.0), "converges"),
        (Cell("converges", 3.0), "lower-order"),
        (Cell("converges", 4.0, faults={"unstable": 1}, cases=6), "unstable"),
        (Cell("converges", 4.0, plateaus=("energy_drift",)), "does-not-converge"),
        (Cell("does-not-converge", faults={"timeout": 2}, cases=6), "timeout"),
        (Cell("at-floor", plateaus=("omega_error",), faults={"invalid": 1}, cases=1), "invalid"),
        (Cell("unsupported"), "unsupported"),
    ],
)
def test_the_gravest_of_a_cell_is_what_counts(run: Run, cell: Cell, worst: str) -> None:
    """One case that ended badly outweighs a plateau, that a lower order, and that the verdict."""
    assert worst_state(run, ("reference", "rk4"), cell) == worst


@pytest.mark.slow
def test_a_plateau_of_another_measure_is_told(run: Run) -> None:
    """A measure that does not converge is named in the notes and in the sentences."""
    cell = Cell("converges", 4.0, plateaus=("energy_drift",), faults={"failed": 2}, cases=6)
    assert cell.notes == ["2 of 6 failed", "energy_drift does not converge"]
    told = verdict_sentences(run, {"forced": {("reference", "rk4"): cell}})
    assert "Other measures that do not converge: energy_drift of reference:rk4 in forced." in told
    assert told[0] == "No methods converge with their order of theory, or are at the floor, in forced."


@pytest.mark.slow
def test_the_methods_rows_of_other_measures_reach_the_cell(run: Run) -> None:
    """A plateau of the energy in methods.csv is a plateau of the cell."""
    methods = run.methods.copy()
    of_energy = (methods["quantity"] == "energy_drift") & (methods["method"] == "rk4")
    methods.loc[of_energy & (methods["scenario"] == "forced"), "verdict"] = "does-not-converge"
    cells = summary_cells(replace(run, methods=methods))
    assert cells["forced"]["reference", "rk4"].plateaus == ("energy_drift",)
    assert summary_cells(run)["forced"]["reference", "rk4"].plateaus == ()
