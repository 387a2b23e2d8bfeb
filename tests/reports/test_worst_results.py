"""The worst results of a run: nothing wrong is left out, and the most severe comes first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from bodycheck.reports.document import markdown
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.reports.summary.cells import summary_cells
from bodycheck.reports.summary.sentences import run_document
from bodycheck.reports.summary.worst_results import worst_results
from tests.helpers.gate_tables import with_tables

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tables(stored_run: Path) -> Tables:
    """Return the tables of a run in which one case failed."""
    return read_tables(stored_run)


def with_verdict(tables: Tables, method: str, quantity: str, **cells: object) -> Tables:
    """Return the tables with some cells of methods.csv changed, for the reference on the free body."""
    methods = tables.methods.copy()
    mine = (methods["scenario"] == "free") & (methods["engine"] == "reference")
    for name, cell in cells.items():
        methods.loc[mine & (methods["method"] == method) & (methods["quantity"] == quantity), name] = cell
    return with_tables(tables, methods=methods)


def test_what_is_wrong_is_listed_most_severe_first(tables: Tables) -> None:
    """A failure comes before a quantity that does not converge, and that before a lower order."""
    spoiled = with_verdict(tables, "rk4", "orientation_error_rad", order=2.5, order_high=2.6)
    spoiled = with_verdict(spoiled, "m1", "energy_drift", verdict="does-not-converge", finest_error=0.5)
    spoiled = with_verdict(spoiled, "taylor", "orientation_error_rad", verdict="does-not-converge")
    found = [
        (one.kind, one.method)
        for one in worst_results(spoiled, summary_cells(spoiled))
        if one.kind != "property"
    ]
    assert found == [
        ("failed", "failing:m1"),
        ("does-not-converge", "reference:m1"),
        ("does-not-converge", "reference:taylor"),
        ("lower-order", "reference:rk4"),
    ]


@pytest.mark.parametrize("verdict", [word for word, state in STATES.items() if state.tint == "bad"])
def test_every_verdict_against_a_method_is_listed(verdict: str, tables: Tables) -> None:
    """Each has its place in the order."""
    spoiled = with_verdict(tables, "rk4", "orientation_error_rad", verdict=verdict)
    (result,) = (
        one for one in worst_results(spoiled, summary_cells(spoiled)) if one.method == "reference:rk4"
    )
    assert result.kind == verdict


def test_each_has_a_command_of_a_case_that_shows_it(tables: Tables) -> None:
    """The command is that of the failed case, or of the finest case of a method that does not converge."""
    spoiled = with_verdict(tables, "m1", "orientation_error_rad", verdict="does-not-converge")
    failed, plateau, *_ = worst_results(spoiled, summary_cells(spoiled))
    outcomes = {case.columns["reproduce"]: case.columns["outcome"] for case in tables.cases}
    assert outcomes[failed.reproduce] == "failed"
    own = [
        case
        for case in tables.cases
        if (case.columns["scenario"], case.columns["engine"], case.columns["method"])
        == ("free", "reference", "m1")
    ]
    assert plateau.reproduce.endswith(f"--dt {min(case.dt_s for case in own if case.dt_s)!r}")


def test_one_method_is_one_line_however_often_it_fails(tables: Tables) -> None:
    """Twenty different failures are one line with the first one and a count."""
    failed = next(case for case in tables.cases if case.columns["outcome"] == "failed")
    more = tuple(replace(failed, columns={**failed.columns, "message": f"fault {k}"}) for k in range(19))
    lines = markdown(run_document(replace(tables, cases=(*tables.cases, *more)))).splitlines()
    assert sum("failed in 20 cases" in line for line in lines) == 1
    assert len(lines) < 60


def test_cases_with_different_messages_are_counted_together(tables: Tables) -> None:
    """Two unstable steps of a method on a scenario are two cases, although their messages differ."""
    first = next(case for case in tables.cases if case.ok)
    unstable = [
        replace(
            first, columns={**first.columns, "outcome": "unstable", "dt_s": dt_s, "message": f"at {dt_s} s"}
        )
        for dt_s in (0.5, 0.25)
    ]
    changed = replace(tables, cases=(*unstable, *tables.cases))
    (found,) = [one for one in worst_results(changed, {}) if one.kind == "unstable"]
    assert (found.text, found.size) == ("unstable in 2 cases: at 0.5 s", 2)
