"""One measure of one method between runs of a few cells; a comparison on the terminal and as a page."""

from __future__ import annotations

import math
from dataclasses import replace
from io import StringIO
from typing import Any

import pytest
from markupsafe import escape
from rich.console import Console

from bodycheck._util.errors import InputError
from bodycheck.reports import document
from bodycheck.reports.comparison.change import FAILING, Change, Status
from bodycheck.reports.comparison.compare import compare, renamed
from bodycheck.reports.comparison.comparison_document import (
    HEADINGS,
    change_tables,
    comparison_data,
    comparison_document,
    comparison_page,
    sentences,
)
from bodycheck.reports.comparison.release_results import OneMeasure, ReleaseFinding, comparable
from bodycheck.reports.document import Document, print_document
from bodycheck.reports.run_files.run_tables import Run, Tables
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.gate_tables import make_tables

ERROR = "orientation_error_rad"


def run(*cases: dict[str, Any], **parts: Any) -> Tables:
    """Return a run of these cases, by default of one scenario."""
    return make_tables(
        list(cases), **{"scenarios": {"brick": {}}, "created": "today", "bodycheck": "1", **parts}
    )


def one(name: str = ERROR, **of: Any) -> OneMeasure:
    """Return a measure of one case, by default its error, with the given fields replaced."""
    who = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "control": "dt", "fineness": 0.01}
    return OneMeasure(name=name, **{**who, **of})


def differs(requested: OneMeasure, before: Tables, after: Tables) -> bool:
    """Return whether two runs differ in the measure; the answer must not depend on their order."""
    a, b = requested.finding(before), requested.finding(after)
    found = requested.differ(a, b)
    assert requested.differ(b, a) == found
    return found


# --------------------------------------------------------------------------------------------------- findings


@pytest.mark.parametrize(
    "name",
    [
        "energy",
        "cpu_s",
        "steps",
        "law.rotate",
    ],
)
def test_what_runs_are_not_compared_by_is_refused(name: str, expected_message: ExpectedMessage) -> None:
    """The message names the measure and gives the reason."""
    with expected_message.raises(InputError):
        comparable(name)


@pytest.mark.parametrize(
    "name", [ERROR, "energy_drift_abs", "outcome", "verdict", "stability.dt_stable_s", f"order.{ERROR}"]
)
def test_what_runs_are_compared_by_is_a_measure_of_a_gate(name: str) -> None:
    """Errors, outcomes, verdicts, orders and stable steps can be compared."""
    assert comparable(name).column == name.removesuffix(f".{ERROR}").removeprefix("stability.")


@pytest.mark.parametrize(
    ("requested", "value"),
    [
        (one(), 1e-9),
        (one(fineness=0.02), 2e-9),
        (one(control="tolerance", fineness=1e-6), 3e-9),
        (one(method="euler"), 4e-9),
        (one(scenario="plate[1]*"), 5e-9),
        (one("outcome"), "ok"),
        (one("verdict"), "converges"),
        (one(f"order.{ERROR}"), 4.0),
    ],
)
def test_a_finding_is_of_its_own_case(requested: OneMeasure, value: float | str) -> None:
    """A finding has the exact scenario, the method, and the step or tolerance; an order is of all steps."""
    tables = run(
        {"engine": "dart", ERROR: 6e-9},
        {"method": "euler", ERROR: 4e-9},
        {"scenario": "plate[1]*", ERROR: 5e-9},
        {"dt_s": 0.02, ERROR: 2e-9},
        {"control": "tolerance", "dt_s": None, "tolerance": 1e-6, ERROR: 3e-9},
        {},
        methods=[{}],
        scenarios={"brick": {}, "plate[1]*": {}},
    )
    found = requested.finding(tables)
    assert (found.value, found.why) == (value, "")
    assert found.tables is tables


def test_a_case_that_was_not_made_has_the_reason_of_its_methods_first() -> None:
    """A scene that a method cannot represent is not tried at finer steps, so the first reason is reported."""
    none = run({"method": "euler"}, {"dt_s": 0.1, "outcome": "unsupported", "message": "no pivot"})
    found = one().finding(none)
    assert (found.value, found.why) == (None, "unsupported: no pivot")
    failed = one().finding(run({"outcome": "failed", "message": "no"}))
    assert (failed.value, failed.why) == (None, "failed: no")


# -------------------------------------------------------------------------------------------- what differs


@pytest.mark.parametrize(
    ("requested", "different"),
    [
        (one(), True),
        (one(fineness=0.02), False),
        (one("omega_error"), False),
        (one("energy_drift_abs"), True),
        (one("energy_drift"), False),  # no scale in either run
        (one(method="euler"), False),
        (one(scenario="plate"), False),
        (one(f"order.{ERROR}"), True),
        (one("order.omega_error"), False),
        (one("stability.dt_stable_s"), True),
    ],
)
def test_a_measure_differs_where_the_comparison_tells_a_change_of_it(
    requested: OneMeasure, different: bool
) -> None:
    """A change of another scenario, method, step or measure does not count."""
    order = {"order_low": 3.9, "order_high": 4.1}
    stable = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "outcome": "ok"}

    def made(error: float, drift: float, *, shift: float) -> Tables:
        others = [{"dt_s": 0.02}, {"method": "euler"}, {"scenario": "plate"}]
        return run(
            {ERROR: error, "omega_error": 1e-3, "energy_drift_abs": drift},
            *others,
            methods=[
                {**order, "order": 4.0 + shift, "order_low": 3.9 + shift, "order_high": 4.1 + shift},
                {**order, "quantity": "omega_error"},
            ],
            stability=[{**stable, "dt_stable_s": 0.1 + 0.1 * shift, "dt_unstable_s": 0.101 + 0.1 * shift}],
            scenarios={"brick": {}, "plate": {}},
        )

    before, after = made(1e-3, 1e-3, shift=0.0), made(1e-2, 2e-3, shift=1.0)
    assert differs(requested, before, after) == different
    assert not differs(requested, before, before)


def test_words_and_what_is_missing_differ_where_they_are_not_the_same() -> None:
    """Different words differ, and so do a number and an absent value; two absent values do not."""
    ok, failed = run({}), run({"outcome": "failed", "message": "no"})
    assert differs(one("outcome"), ok, failed)
    assert not differs(one("outcome"), failed, failed)
    assert differs(one(), ok, failed)
    assert not differs(one(), failed, failed)
    assert one().differ(ReleaseFinding("x", ""), ReleaseFinding(1.0, ""))


def test_two_versions_of_an_engine_are_compared_under_one_name() -> None:
    """The engine is renamed in the cases and in every table; nothing else changes."""
    stable = {"scenario": "brick", "engine": "mujoco==3", "method": "rk4", "outcome": "ok"}
    tables = run({"engine": "mujoco==3"}, methods=[{"engine": "mujoco==3"}], stability=[stable])
    made = Run(**vars(tables), problems=())
    found = renamed(made, {"mujoco==3": "mujoco"})
    assert {table["engine"].item() for table in (found.results, found.methods, found.stability)} == {"mujoco"}
    assert [case.columns["engine"] for case in found.cases] == ["mujoco"]
    assert [case.columns["engine"] for case in made.cases] == ["mujoco==3"]
    assert (found.run_id, found.manifest) == (tables.run_id, tables.manifest)
    assert found.cases[0].columns[ERROR] == 1e-9


# ----------------------------------------------------------------------------------------------------- output


def test_the_terminal_says_what_changed_and_then_names_both_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """The terminal shows the sentences, one line per change under a heading, and the identities."""
    before, after = run({}), replace(run({ERROR: 1e-6}), run_id="other")
    found = compare(before, after)
    print_document(comparison_document(found))
    assert capsys.readouterr().out.splitlines() == [
        *sentences(found),
        "",
        "Worse",
        "scenario  engine:method  change",
        "brick     mujoco:rk4     orientation_error_rad 1e-9 -> 1e-6 (x 1e3) at dt 0.01 s",
        "before  made-up, today, bodycheck 1",
        "after   other, today, bodycheck 1",
    ]


def test_data_have_both_runs_the_sentences_and_every_change() -> None:
    """What a page shows in words, a script reads as data."""
    found = compare(run({}, run_id="first"), run({ERROR: 1e-6}, run_id="second"))
    data = comparison_data(found)
    runs = [(data[name]["run_id"], data[name]["bodycheck"]) for name in ("before", "after")]
    assert runs == [("first", "1"), ("second", "1")]
    assert (data["sentences"], data["changes"]) == (sentences(found), found.changes)
    assert (data["cases_compared"], data["cases_compared_by_speed"]) == (1, 0)


@pytest.mark.parametrize(("amount", "more"), [(20, []), (22, ["and 2 more lines: there"])])
def test_of_a_long_list_twenty_lines_are_shown(
    amount: int, more: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """The rest is counted, with its place; missing cases have a heading; passing changes are not listed."""
    who = ("accuracy", "brick", "mujoco")
    changes = [
        Change(*who, f"m{k}", ERROR, 1.0, 2.0, "worse", decades=math.log10(2.0)) for k in range(amount)
    ]
    changes += [Change(*who, "b", ERROR, 2.0, 1.0, "improved", decades=-0.3)]
    changes += [Change(*who, "p", ERROR, 1.0, 1.01, "moved", decades=0.004)]
    changes += [Change(*who, "n", ERROR, None, 1.0, "new")]
    changes += [Change(*who, "o", ERROR, 1.0, None, "missing")]
    print_document(Document("", change_tables(changes, "there")))
    shown = capsys.readouterr().out.splitlines()
    assert shown[:2] == ["Worse", "scenario  engine:method  change"]
    end = 2 + min(amount, 20)
    assert all("mujoco:m" in line for line in shown[2:end])
    assert shown[end:] == [
        *more,
        *["", "No longer measured", "scenario  engine:method  change"],
        "brick     mujoco:o       orientation_error_rad 1 -> not measured",
    ]


@pytest.mark.parametrize("status", FAILING)
def test_on_a_terminal_what_fails_is_red(status: Status, monkeypatch: pytest.MonkeyPatch) -> None:
    """The heading of failing changes is red and bold."""
    shown = StringIO()
    console = Console(file=shown, width=100, force_terminal=True, color_system="standard", highlight=False)
    monkeypatch.setattr(document, "console", lambda: console)
    changes = [Change("case", "brick", "mujoco", "rk4", "case", "ok", None, status)]
    print_document(Document("", change_tables(changes, "there")))
    assert f"\x1b[1;31m{HEADINGS[status]}" in shown.getvalue()


def test_the_page_has_all_of_it_under_the_tints_of_a_report() -> None:
    """The page has the identities, the sentences, and each heading once, failing changes first."""
    before = run({ERROR: 1e-3}, {"dt_s": 0.02, ERROR: 1e-3}, {"dt_s": 0.03}, {"dt_s": 0.05, ERROR: 1e-3})
    after = run({ERROR: 1e-2}, {"dt_s": 0.02, ERROR: 1e-4}, {"dt_s": 0.04}, {"dt_s": 0.05, ERROR: 1.01e-3})
    after = replace(after, run_id="other")
    found = compare(before, after)
    page = comparison_page(found)
    for words in ("made-up, today, bodycheck 1", "other, today, bodycheck 1", *sentences(found)):
        assert str(escape(words)) in page
    heads = ("Worse</h2>", "No longer measured</h2>", "Improved</h2>", "Moved</h2>", "New</h2>")
    places = [page.index(head) for head in heads]
    assert places == sorted(places)
    assert page.count("orientation_error_rad 0.001 -&gt; 0.01") == 2  # in the table, and below its figure
    assert "new case at dt 0.04 s (ok)" in page
    for column in ("kind", "size"):
        assert f">{column}</th>" in page
    assert "--good" in page  # the report's own style
    assert "by more than 2.0 % of the smaller value" in page
