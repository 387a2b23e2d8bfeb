"""Comparison of two runs: every change is reported and nothing else, whichever run comes first."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck._util.formatting import count
from bodycheck.reports.comparison.compare import Comparison, compare
from bodycheck.reports.comparison.comparison_document import (
    comparison_document,
    comparison_page,
    groups,
    sentences,
)
from bodycheck.reports.comparison.release_results import OneMeasure
from bodycheck.reports.document import print_document
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Tables
from tests.helpers.gate_tables import with_tables
from tests.helpers.swapped_runs import swapped

MEASURES = ("orientation_error_rad", "energy_drift", "omega_error", "position_error", "quaternion_norm_error")


@pytest.fixture(scope="module")
def tables(stored_run: Path) -> Tables:
    """Return the tables of a run."""
    return read_tables(stored_run)


Where = Callable[[Mapping[str, Any]], bool]


def of(scenario: str, method: str, dt_s: float | None = None) -> Where:
    """Return a condition that selects the cases of a reference method, at one step or at all steps."""
    return lambda row: (
        (row["scenario"], row["engine"], row["method"]) == (scenario, "reference", method)
        and dt_s in (None, row["dt_s"])
    )


def with_rows(tables: Tables, where: Where, change: Callable[[dict[str, Any]], dict[str, Any]]) -> Tables:
    """Return the tables with some rows of results changed."""
    cases = [
        replace(case, columns=change(dict(case.columns))) if where(case.columns) else case
        for case in tables.cases
    ]
    assert any(where(case.columns) for case in tables.cases)
    return replace(tables, cases=tuple(cases))


def planted(tables: Tables, where: Where, **amounts: float) -> Tables:
    """Return the tables with something added to some cells."""
    return with_rows(tables, where, lambda row: row | {name: row[name] + x for name, x in amounts.items()})


def timed(tables: Tables, where: Where, factor: float) -> Tables:
    """Return the tables with the times of some cases multiplied by a factor."""
    names = ("cpu_s", "cpu_s_low", "cpu_s_high", "relative_cpu")
    return with_rows(
        tables, where, lambda row: row | {name: factor * row[name] for name in names if name in row}
    )


def test_nothing_changed_between_a_run_and_itself(tables: Tables) -> None:
    """A run compared with itself pairs every case, compares every measured speed and reports no change."""
    found = compare(tables, tables)
    assert found.changes == found.environment == found.redefined == ()
    assert found.paired == len(tables.cases)
    assert found.timed == sum("cpu_s" in case.columns for case in tables.cases) > 0
    assert any("Nothing changed" in sentence for sentence in sentences(found))


@pytest.mark.parametrize("amount", [1e-9, -1e-9])
@pytest.mark.parametrize("measure", MEASURES)
def test_a_change_of_a_billionth_is_named_and_no_other(tables: Tables, measure: str, amount: float) -> None:
    """A change of 1e-9 is reported with its measure, case and direction, and nothing else is reported."""
    scenario = "forced, and a mesh" if measure == "position_error" else "free"
    where = of(scenario, "m1", 0.01)
    before = with_rows(tables, where, lambda row: row | {measure: 1e-3})
    (change,) = compare(before, planted(before, where, **{measure: amount})).changes
    assert (change.quantity, change.scenario, change.method, change.fineness) == (
        measure,
        scenario,
        "m1",
        0.01,
    )
    assert change.status == "moved"
    assert change.decades == pytest.approx(amount / 1e-3 / np.log(10.0), rel=1e-5)


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize(
    ("factor", "status"),
    [
        (1.0 + 1e-13, None),
        (1.0 + 1e-6, "moved"),
        (1.01, "moved"),
        (1.05, "worse"),
        (1e6, "worse"),
        (1.0 / 1.01, "moved"),
        (1.0 / 1.05, "improved"),
        (1e-6, "improved"),
    ],
)
def test_a_planted_change_is_weighed_by_its_size(
    tables: Tables, measure: str, factor: float, status: str | None
) -> None:
    """Round-off is ignored, 1 % has moved, 5 % is worse or improved; swapping the runs mirrors the result."""
    where = of("forced, and a mesh" if measure == "position_error" else "free", "m1", 0.01)
    before = with_rows(tables, where, lambda row: row | {measure: 1e-3})
    after = with_rows(before, where, lambda row: row | {measure: factor * row[measure]})
    found = compare(before, after).changes
    assert [(change.quantity, change.status) for change in found] == ([(measure, status)] if status else [])
    assert [swapped(change) for change in found] == list(compare(after, before).changes)


def test_what_lies_beneath_the_noise_is_neither_better_nor_worse(tables: Tables) -> None:
    """Below 3 bounds of the truth an error may vary freely; beyond three times that, and 2 %, it is worse."""
    where = of("free", "exact")
    bound = next(case.columns["truth_bound_rad"] for case in tables.cases if where(case.columns))
    before = with_rows(tables, where, lambda row: row | {"orientation_error_rad": 0.0})
    for error, reported in ((2.9 * bound, 0), (8.9 * bound, 0), (9.1 * bound, 1)):
        found = compare(before, planted(before, where, orientation_error_rad=error)).changes
        assert [change.status for change in found] == reported * ["worse"]


def test_a_floor_that_rose_hides_nothing(tables: Tables) -> None:
    """The smaller of the two floors is used, whichever run comes first, so a raised floor hides no change."""
    where = of("free", "rk4", 0.001)
    before = with_rows(tables, where, lambda row: row | {"orientation_error_rad": 1e-13})
    methods = tables.methods.copy()
    mine = (methods["scenario"] == "free") & (methods["method"] == "rk4")
    methods.loc[mine, "floor"] = 1e-10
    after = planted(before, where, orientation_error_rad=9e-11).with_rows(methods=methods.to_dict("records"))
    assert [change.status for change in compare(before, after).changes] == ["worse"]
    assert [change.status for change in compare(after, before).changes] == ["improved"]


def test_a_floor_of_both_runs_hides_what_is_below_it(tables: Tables) -> None:
    """The floor of a method covers changes up to three times itself, for its own quantity only."""
    where = of("free", "rk4", 0.001)
    methods = tables.methods.copy()
    mine = (methods["scenario"] == "free") & (methods["method"] == "rk4")
    methods.loc[mine & (methods["quantity"] == "orientation_error_rad"), "floor"] = 1e-10
    low = with_rows(
        tables.with_rows(methods=methods.to_dict("records")),
        where,
        lambda row: row | {"orientation_error_rad": 1e-13},
    )
    for error, reported in ((9e-11, []), (2.9e-10, []), (4.1e-10, ["worse"])):
        high = planted(low, where, orientation_error_rad=error)
        assert [change.status for change in compare(low, high).changes] == reported


@pytest.mark.parametrize("seed", range(3))
def test_a_comparison_is_the_same_from_either_side(tables: Tables, seed: int) -> None:
    """Swapping the runs swaps worse with improved and new with missing, and changes nothing else."""
    rng = np.random.default_rng(seed)

    def stirred(row: dict[str, Any]) -> dict[str, Any]:
        factors = {name: 10.0 ** rng.normal() for name in MEASURES if name in row and rng.random() < 0.3}
        row |= {name: row[name] * factor for name, factor in factors.items()}
        return {**row, "outcome": "failed"} if rng.random() < 0.1 else row

    after = with_rows(tables, lambda _: True, stirred)
    after = replace(after, cases=after.cases[5:])
    after = timed(after, of("shape/1", "m1"), 3.0)
    before = replace(tables, cases=tables.cases[:-3])
    there, back = compare(before, after), compare(after, before)
    assert len(there.changes) > 10
    assert {swapped(change) for change in there.changes} == set(back.changes)
    assert there.paired == back.paired


@pytest.mark.parametrize("outcome", ["failed", "invalid", "timeout", "unstable", "unsupported"])
def test_a_case_that_no_longer_ends_well_is_reported(tables: Tables, outcome: str) -> None:
    """A case that no longer succeeds is one change for the worse, and in reverse an improvement."""
    where = of("free", "m1", 0.01)
    kept = ("scenario", "engine", "method", "control", "dt_s", "tolerance", "reproduce")
    after = with_rows(tables, where, lambda row: {name: row[name] for name in kept} | {"outcome": outcome})
    (change,) = compare(tables, after).changes
    assert (change.kind, change.before, change.after, change.status) == ("outcome", "ok", outcome, "worse")
    (change,) = compare(after, tables).changes
    assert (change.kind, change.before, change.after, change.status) == ("outcome", outcome, "ok", "improved")


def test_a_missing_measure_is_reported(tables: Tables) -> None:
    """A measure that only the first run has is reported as missing, without a size and before all others."""
    gone = with_rows(
        tables,
        of("free", "m1", 0.01),
        lambda row: {name: value for name, value in row.items() if name != "energy_drift"},
    )
    change = compare(tables, gone).changes[0]
    assert (change.quantity, change.after, change.status) == ("energy_drift", None, "missing")


def test_cases_of_only_one_run_are_reported(tables: Tables) -> None:
    """Each case that only one of the two runs has is a change."""
    few = replace(tables, cases=tables.cases[4:])
    gone = compare(tables, few).changes
    assert [change.kind for change in gone] == 4 * ["case"]
    assert all(change.after is None for change in gone)
    assert sentences(compare(tables, few))[-1].endswith("0 new cases, 4 missing cases.")


def test_a_changed_verdict_and_order_are_reported(tables: Tables) -> None:
    """A lower order whose interval does not overlap the old one is worse; so is a plateau."""
    methods = tables.methods.copy()
    mine = (methods["scenario"] == "free") & (methods["quantity"] == "orientation_error_rad")
    rk4, m1 = (mine & (methods["method"] == method) for method in ("rk4", "m1"))
    methods.loc[rk4, ["order", "order_low", "order_high"]] = [3.0, 2.9, 3.1]
    methods.loc[m1, "verdict"] = "does-not-converge"
    found = compare(tables, with_tables(tables, methods=methods)).changes
    reported = {(change.kind, change.method, change.status) for change in found}
    assert reported == {("order", "rk4", "worse"), ("verdict", "m1", "worse")}


@pytest.mark.parametrize(
    ("span", "direction"),
    [
        ((0.5, 0.505), None),
        ((0.503, 0.506), None),  # the limit may be 0.504 in both
        ((0.505, 0.51), "moved"),  # by 1 %
        ((0.515, 0.52), "improved"),
        ((0.515, np.nan), "improved"),
        ((0.49, 0.5), "worse"),
        ((np.nan, 0.01), "worse"),
    ],
)
def test_a_stable_step_changed_where_the_two_searches_cannot_mean_one(
    tables: Tables, span: tuple[float, float], direction: str | None
) -> None:
    """The limit lies between the last stable and the first unstable step; overlapping spans are no change."""

    def with_span(low: float, high: float) -> Tables:
        stability = tables.stability.copy()
        mine = (stability["scenario"] == "free") & (stability["method"] == "m1")
        stability.loc[mine & (stability["engine"] == "reference"), ["dt_stable_s", "dt_unstable_s"]] = (
            low,
            high,
        )
        return with_tables(tables, stability=stability)

    before, after = with_span(0.5, 0.505), with_span(*span)
    found = compare(before, after).changes
    assert [(change.quantity, change.status) for change in found] == (
        [("dt_stable_s", direction)] if direction else []
    )
    assert [swapped(change) for change in found] == list(compare(after, before).changes)


def test_a_search_that_now_fails_is_reported(tables: Tables) -> None:
    """A search that fails where it found a stable step before is a change for the worse."""
    stability = tables.stability.copy()
    stability.loc[stability.index[0], ["outcome", "dt_stable_s"]] = "failed", np.nan
    (change,) = compare(tables, with_tables(tables, stability=stability)).changes
    assert (change.kind, change.after, change.status) == ("stability", "failed", "worse")


def test_a_slower_method_is_reported_and_scatter_of_laps_is_not(tables: Tables) -> None:
    """Twice the time exceeds the quartiles of quiet laps and is reported; times within them do not differ."""
    tables = with_rows(
        tables,
        lambda row: "cpu_s" in row,
        lambda row: row | {"cpu_s_low": 0.97 * row["cpu_s"], "cpu_s_high": 1.03 * row["cpu_s"]},
    )
    tables = replace(tables, manifest={**tables.manifest, "speed_noise": 0.05})
    m1: Where = lambda row: row["engine"] == "reference" and row["method"] == "m1"  # noqa: E731
    (slower,) = compare(tables, timed(tables, m1, 2.0)).changes
    assert (slower.kind, slower.scenario, slower.method, slower.status) == ("speed", None, "m1", "worse")
    assert slower.decades == pytest.approx(np.log10(2.0))
    assert compare(tables, timed(tables, m1, 1.12)).changes == ()  # beyond the noise, but within the laps
    (there,) = compare(tables, timed(tables, of("free", "m1"), 2.0)).changes
    assert (there.scenario, there.status) == ("free", "worse")


def test_seconds_of_two_machines_are_not_compared(tables: Tables) -> None:
    """Without a reference measurement, a time is valid on its own machine only; a sentence says so."""
    bare = with_rows(
        tables,
        lambda row: "relative_cpu" in row,
        lambda row: {name: value for name, value in row.items() if name != "relative_cpu"},
    )
    assert compare(bare, bare).timed > 0
    elsewhere = replace(bare, manifest={**bare.manifest, "cpu": "another"})
    found = compare(bare, elsewhere)
    assert found.timed == 0
    assert found.environment == (f"cpu: {bare.manifest['cpu']} -> another",)


def test_a_scenario_that_is_another_by_the_same_name_is_not_compared(tables: Tables) -> None:
    """Only its name is reported, since its cases differ without an engine's fault; the summary is ignored."""
    free = tables.manifest["scenarios"]["free"]

    def compared_with(**keys: Any) -> Comparison:
        scenarios = {**tables.manifest["scenarios"], "free": {**free, **keys}}
        after = planted(tables, of("free", "m1"), orientation_error_rad=0.1)
        return compare(tables, replace(after, manifest={**tables.manifest, "scenarios": scenarios}))

    found = compared_with(duration_s=2.0)
    assert (found.redefined, found.changes) == (("free",), ())
    assert "(scenario definition changed): free" in " ".join(sentences(found))
    assert compared_with(summary="reworded").changes


def test_versions_that_differ_stand_on_top(tables: Tables) -> None:
    """Changed versions of bodycheck and of each engine are listed before the changes of results."""
    engines = {
        **tables.manifest["engines"],
        "failing": {**tables.manifest["engines"]["failing"], "version": "2"},
    }
    after = replace(tables, manifest={**tables.manifest, "engines": engines, "bodycheck": "9"})
    found = compare(tables, after)
    assert found.environment == (f"bodycheck: {tables.manifest['bodycheck']} -> 9", "failing: 1 -> 2")
    assert sentences(found)[1].startswith("Different environment: bodycheck")


@pytest.fixture(scope="module")
def much(tables: Tables) -> Comparison:
    """Return a comparison in which nearly everything changed and one name contains markup."""

    def worse(case: CaseResult) -> CaseResult:
        columns = {name: 2.0 * value if name in MEASURES else value for name, value in case.columns.items()}
        hostile = "<b>free</b>" if columns["scenario"] == "free" else columns["scenario"]
        return replace(case, columns={**columns, "scenario": hostile})

    def named(case: CaseResult) -> CaseResult:
        free = case.columns["scenario"] == "free"
        return replace(case, columns=case.columns | ({"scenario": "<b>free</b>"} if free else {}))

    return compare(
        replace(tables, cases=tuple(map(named, tables.cases))),
        replace(tables, cases=tuple(map(worse, tables.cases))),
    )


def test_every_change_is_in_one_group_and_on_the_page(much: Comparison) -> None:
    """Grouping loses no change; the page has an entry for each and shows names as plain text."""
    made = groups(much.changes)
    assert sorted(len(group.changes) for group in made)[-1] > 1
    assert {change for group in made for change in group.changes} == set(much.changes)
    for group in made:
        cases = {change.fineness for change in group.changes}
        assert len(group.changes) == 1 or f"in {count(len(cases), 'case')}" in group.text
    page = comparison_page(much)
    assert "by more than 2.0 % of the smaller value" in page
    headline, *others = sentences(much)
    assert page.count("<li>") == len(others) + sum(
        len(group.changes) for group in made if len(group.changes) > 1
    )
    assert escape(headline) in page
    assert "<b>free</b>" not in page
    assert "&lt;b&gt;free&lt;/b&gt;" in page


def test_a_pipe_is_given_whole_lines_without_colour(
    much: Comparison, capsys: pytest.CaptureFixture[str]
) -> None:
    """A pipe gets one line per method and scenario, however long, and no control characters."""
    print_document(comparison_document(much))
    shown = capsys.readouterr().out
    assert "\x1b" not in shown
    failing = [group for group in groups(much.changes) if group.status == "worse"]
    assert (
        sum(re.search(r"\((x \d|\+)", line) is not None and " -> " in line for line in shown.splitlines())
        == len(failing)
        > 0
    )
    assert not any(line != line.rstrip() for line in shown.splitlines())


OTHERS = [
    ("forced", "m1", "energy_drift", 0.01),
    ("free", "rk4", "energy_drift", 0.01),
    ("free", "m1", "omega_error", 0.01),
    ("free", "m1", "energy_drift", 0.02),
]


@pytest.mark.parametrize(("scenario", "method", "name", "dt_s"), OTHERS)
def test_one_measure_is_different_where_it_is_and_nowhere_else(
    tables: Tables, scenario: str, method: str, name: str, dt_s: float
) -> None:
    """A change belongs to its scenario, method, measure and step, in either direction; round-off is none."""
    changed = planted(tables, of("free", "m1", 0.01), energy_drift=1e-3)
    barely = planted(tables, of("free", "m1", 0.01), energy_drift=1e-18)
    this = OneMeasure("free", "reference", "m1", "energy_drift", "dt", 0.01)
    other = OneMeasure(scenario, "reference", method, name, "dt", dt_s)
    for before, after in ((tables, changed), (changed, tables)):
        assert this.differ(this.finding(before), this.finding(after))
        assert not other.differ(other.finding(before), other.finding(after))
    assert not this.differ(this.finding(tables), this.finding(barely))


def test_one_measure_that_is_lost_is_different(tables: Tables) -> None:
    """A failed case has no value and gives the reason; two cases without a value do not differ."""
    this = OneMeasure("free", "reference", "m1", "energy_drift", "dt", 0.01)
    lost = this.finding(with_rows(tables, of("free", "m1"), lambda row: row | {"outcome": "failed"}))
    assert lost.value is None
    assert lost.why.startswith("failed")
    assert this.differ(this.finding(tables), lost)
    assert this.differ(lost, this.finding(tables))
    assert not this.differ(lost, lost)
