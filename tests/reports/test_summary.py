"""What a run reports in words: the verdict, the states, numbers and lists."""

from __future__ import annotations

import pytest

from bodycheck._util.formatting import brief, names, number, scientific, step
from bodycheck.reference_impl.one_step_maps import MAPS
from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS
from bodycheck.reports.document import Sentence, Table
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.method_words import _MAPS_IN_WORDS, NO_KNOWN_MAP, NOT_MEASURED, map_in_words
from bodycheck.reports.run_files.run_tables import MethodKey, Run, common_step
from bodycheck.reports.summary.cells import Cell, summary_cells
from bodycheck.reports.summary.method_identity import fingerprint_document, map_text
from bodycheck.reports.summary.sentences import (
    Summary,
    refusal_table,
    refusals,
    run_document,
    verdict_sentences,
)
from bodycheck.reports.summary.worst_results import worst_results
from bodycheck.reports.table_layout import Span, plain
from tests.helpers.gate_tables import make_tables, with_tables

UNKNOWN = {"scenarios": {}, "run_s": None, "compile_s": None} | dict.fromkeys(
    ("bodycheck", "python", "cpu", "cores", "platform", "run_id", "created"), ""
)
"""The other entries of a manifest that the document of a run needs."""


@pytest.mark.slow
def test_the_verdict_names_what_is_sound_and_what_is_open(run: Run) -> None:
    """Methods that converge are counted and named; pairs without a verdict are counted by scenario."""
    cells = summary_cells(run)
    forced = cells["forced"]
    odd = {("reference", "m2"): Cell("pre-asymptotic")}
    reported = " ".join(verdict_sentences({**cells, "forced": {**forced, **odd}}, []))
    pairs = sum(len(methods) for methods in cells.values())
    assert f"No verdict for 1 of {pairs} pairs of method and scenario, in forced" in reported
    assert "methods converge, or are at the floor, in all quantities" in reported
    one = {"forced": {("reference", "rk3"): Cell("unsupported"), ("reference", "rk4"): Cell("at-floor")}}
    first = verdict_sentences(one, [])[0]
    assert first.startswith("reference:rk4 converges, or is at the floor, in all quantities")


def test_many_methods_have_one_line_per_engine_on_a_console() -> None:
    """It counts the methods by group, and names the one with the smallest error where most are supported."""
    errors = {f"m{k}": 0.1 / 10**k for k in range(4)} | {"few": 1e-9, "broken": 1.0}
    rows = [
        {"scenario": scenario, "engine": engine, "method": method, "orientation_error_rad": error}
        for scenario in ("free", "forced")
        for engine in ("one", "other")
        for method, error in errors.items()
        if (scenario, method) != ("forced", "few")
    ]
    invalid = {"outcome": "invalid", "message": "mass is 3, not 2"}
    keys = ("scenario", "engine", "method")
    run = make_tables(
        [{**row, **(invalid if row["method"] == "broken" else {})} for row in rows],
        [{**{key: row[key] for key in keys}, "verdict": "pre-asymptotic"} for row in rows],
        outcomes={"ok": len(rows)},
        **UNKNOWN,
    )
    parts = run_document(run).on("console")
    assert parts[0] == Sentence(
        "Findings in 2 of 12 methods: one:broken and other:broken; 10 are undecided in some scenarios.",
        strong=True,
        only=("console",),
    )
    tables = {part.title.partition(",")[0]: part for part in parts if isinstance(part, Table)}
    assert [(plain(row[0]), plain(row[1]), row[2:]) for row in tables["Engines"].rows] == [
        (engine, "1 with findings, 5 undecided", ("m3", "0.0001")) for engine in ("one", "other")
    ]
    assert "Methods" not in tables
    assert "Methods" in {part.title for part in run_document(run).on("markdown") if isinstance(part, Table)}


def test_a_console_has_the_reasons_of_methods_that_ran_nowhere() -> None:
    """Why a method is refused in some scenarios only is left to the other media."""
    cases: list[dict[str, str]] = [
        {"scenario": "free", "method": "partly"},
        {"scenario": "forced", "method": "partly", "outcome": "unsupported", "message": "no forces"},
        {"scenario": "free", "method": "never", "outcome": "unsupported", "message": "no tensor"},
        {"scenario": "forced", "method": "never", "outcome": "unsupported", "message": "no tensor"},
    ]
    methods = [{"scenario": "free", "method": "partly", "verdict": "at-floor"}]
    document = run_document(make_tables(cases, methods, outcomes={"ok": 1, "unsupported": 3}, **UNKNOWN))
    for medium, expected in (("console", {"no tensor"}), ("markdown", {"no tensor", "no forces"})):
        tables = [part for part in document.on(medium) if isinstance(part, Table)]
        rows = [row for table in tables if table.title == "Not measured" for row in table.rows]
        assert {row[-1] for row in rows} == expected


def test_no_finding_of_a_method_that_is_far_off_at_every_step_states_how_far() -> None:
    """A low order on a hard scenario is no finding, but the reader must not take it for a right motion."""
    cells = {
        "slow": {("one", "euler"): Cell("converges", finest=1e-3, finest_at="dt 0.001 s", cases=4)},
        "fast": {("one", "euler"): Cell("pre-asymptotic", finest=3.1, finest_at="dt 0.0005 s", cases=4)},
    }
    assert Summary(cells, []).conclusion == (
        "No findings in 1 method on 2 scenarios, but one:euler is up to 3.1 rad from the truth in fast at "
        "its finest step, dt 0.0005 s: 1 is undecided in some scenarios."
    )
    coarse = {("one", "euler"): Cell("converges", finest=1e-3, largest=3.1, largest_at="dt 0.05 s", cases=4)}
    assert Summary({"slow": coarse}, []).conclusion == (
        "No findings in 1 method, but one:euler is up to 3.1 rad from the truth in slow at dt 0.05 s: "
        "1 converges or is at the floor."
    )
    chaotic = {("one", "rk4"): Cell("chaotic", finest=3.0, finest_at="dt 0.0005 s", cases=4)}
    assert "one:rk4 is up to 3 rad from the truth in wild, which is chaotic, at its finest step" in (
        Summary({"wild": chaotic}, []).conclusion
    )
    assert (
        "one:euler is up to 3.1 rad from the truth in fast"
        in Summary({**cells, "wild": chaotic}, []).conclusion
    )


def test_a_single_step_states_its_error_and_a_failed_check_is_no_lack_of_findings() -> None:
    """No order can show in one case, such as that which confirms advice."""
    single = Cell("too-few-points", finest=8.5e-6, finest_at="dt 0.1 s", cases=1)
    assert Summary({"fast": {("one", "rk4"): single}}, []).conclusion == (
        "one:rk4 is up to 8.5e-6 rad from the truth in fast at dt 0.1 s; a single step shows no order."
    )
    sound = {"fast": {("one", "rk4"): Cell("converges", cases=4)}}
    assert Summary(sound, [], failed=("order",)).conclusion == (
        "No other findings in 1 method: 1 converges or is at the floor."
    )


@pytest.mark.parametrize("cells", [{}, {"fast": {}}])
def test_a_run_without_cases_says_so(cells: dict[str, dict[MethodKey, Cell]]) -> None:
    """A shard has no cases, and a table whose rows were removed has scenarios without any."""
    assert Summary(cells, []).conclusion == "This run has no cases."


def test_a_scenario_without_cases_hides_no_error_of_another() -> None:
    """The error of the only case is stated wherever it stands."""
    single = Cell("too-few-points", finest=0.5, finest_at="dt 0.1 s", cases=1)
    assert Summary({"slow": {}, "fast": {("one", "rk4"): single}}, []).conclusion.startswith(
        "one:rk4 is up to 0.5"
    )


@pytest.mark.parametrize("label", _MAPS_IN_WORDS)
def test_a_map_in_words_is_a_known_map(label: str) -> None:
    """Words for a label that no map has would never be read."""
    assert label in {*(one.name for one in MAPS.values()), *TREE_MAPS}
    assert map_in_words(label) == f"{_MAPS_IN_WORDS[label]} ({label})"


def test_too_few_steps_do_not_read_as_a_failure() -> None:
    """If no verdict is possible yet, no sentence says that nothing converges."""
    cells = {"forced": {("reference", "rk4"): Cell("too-few-points")}}
    reported = verdict_sentences(cells, [])
    assert len(reported) == 1
    assert reported[0].startswith("No verdict for 1 of 1 pair")


def test_a_broken_law_is_a_finding() -> None:
    """The finding names the law, its violation and the command; laws that hold give no finding."""
    law = {"engine": "mujoco", "method": "rk4", "law": "boost", "message": "omega differs by 1", "size": 1.0}
    law["reproduce"] = "bodycheck laws mujoco:rk4"
    rows = [{**law, "verdict": "broken"}, {**law, "verdict": "holds", "law": "rotate"}]
    run = make_tables([{}]).with_rows(laws=rows)
    (found,) = worst_results(run, {})
    assert (found.kind, found.method, found.quantity) == ("inconsistent", "mujoco:rk4", "boost")
    assert found.sentence == "law boost broken: omega differs by 1"
    assert found.reproduce == "bodycheck laws mujoco:rk4"


def test_the_reason_of_refused_and_invalid_cases_is_printed_once() -> None:
    """Methods and scenarios with one reason share a row; invalid ones come first, others have none."""
    refused = {"engine": "dart", "outcome": "unsupported", "message": "no pivot"}
    run = make_tables(
        [
            {**refused, "method": method, "scenario": scenario, "dt_s": dt_s}
            for method in ("a", "b")
            for scenario in ("top", "flight")
            for dt_s in (0.1, 0.05)
        ]
        + [{**refused, "method": "a", "scenario": "spring", "message": "no spring"}]
        + [{"engine": "other", "method": "m", "outcome": "invalid", "message": "mass is 3, not 2"}]
        + [{"engine": "other", "method": "m", "outcome": "failed", "message": "it crashed"}]
    )
    found = refusals(run)
    assert [(one.outcome, one.engine, one.reason) for one in found] == [
        ("invalid", "other", "mass is 3, not 2"),
        ("unsupported", "dart", "no pivot"),
        ("unsupported", "dart", "no spring"),
    ]
    assert (found[1].methods, found[1].scenarios) == (("a", "b"), ("top", "flight"))
    (table,) = refusal_table(found)
    assert [row[-1] for row in table.rows] == [one.reason for one in found]
    assert table.rows[1][1] == "dart:a, dart:b"
    assert list(refusal_table([])) == []


def test_every_verdict_and_outcome_has_its_word() -> None:
    """Every state of a method or a case has a symbol, a word and a meaning."""
    verdicts = "converges pre-asymptotic does-not-converge at-floor chaotic unstable too-few-points"
    outcomes = "unstable failed timeout unsupported invalid"
    assert {*verdicts.split(), *outcomes.split()} <= STATES.keys()
    for name, state in STATES.items():
        assert state.word in (name, name.replace("-", " "), f"no steps, {name}")


def test_methods_are_compared_at_the_finest_step_that_most_have() -> None:
    """Steps to which only some methods were refined are not common; without steps there is no common one."""
    steps = [None, 0.02, 0.01, 0.02, 0.01, 0.005, 0.02, 0.01]
    cases = [CaseResult({"dt_s": dt_s, "outcome": "ok"}) for dt_s in steps]
    assert common_step([*cases, CaseResult({"dt_s": 0.02, "outcome": "unsupported"})]) == 0.01
    assert common_step(cases[:1]) is None


@pytest.mark.parametrize("value", [0.0, 1e-300, -2.5e-17, 1.0, 0.1, 12345.678, 1e5, 6.02e23])
def test_numbers_read_back(value: float) -> None:
    """A printed number parses to the value at the printed precision, a step to the same double."""
    assert float(number(value)) == float(f"{value:.4g}")
    assert float(scientific(value)) == float(f"{value:.3g}")
    assert float(step(value)) == value
    assert float(brief(value)) == float(f"{value:.3g}")


def test_a_brief_number_has_the_shorter_form() -> None:
    """A tolerance is printed as it is written, and an error with three digits."""
    values = (0.05, 1e-3, 4.6249e-4, 0.0425, 0.0, 2.0, 1.5e-11)
    assert [brief(one) for one in values] == ["0.05", "1e-3", "4.62e-4", "0.0425", "0", "2", "1.5e-11"]


def test_lists_read_as_sentences() -> None:
    """Names are joined as in a sentence; the rest of a long list is counted."""
    assert names(["a"]) == "a"
    assert names(["a", "b", "c"]) == "a, b and c"
    assert names([str(i) for i in range(10)]) == "0, 1, 2, 3, 4, 5, 6 and 3 more"


@pytest.mark.slow
def test_a_wrong_limit_of_any_measure_reaches_the_headline(run: Run) -> None:
    """A wrong limit of the energy in methods.csv is the state of the cell, and the method is named first."""
    methods = run.methods.copy()
    of_energy = (methods["quantity"] == "energy_drift") & (methods["method"] == "rk4")
    methods.loc[of_energy & (methods["scenario"] == "forced"), "verdict"] = "does-not-converge"
    spoiled = with_tables(run, methods=methods)
    summary = Summary.of(spoiled)
    assert summary.cells["forced"]["reference", "rk4"].state == "does-not-converge"
    assert "reference:rk4" in summary.sentences[0]
    assert summary_cells(run)["forced"]["reference", "rk4"].state == "converges"


@pytest.mark.parametrize(
    ("fingerprint", "tint"),
    [("no gyroscopic term, linear attitude", "good"), (NO_KNOWN_MAP, "open"), (NOT_MEASURED, "open")],
)
def test_only_a_method_without_a_known_map_counts_as_unknown(fingerprint: str, tint: str) -> None:
    """The names of some known maps begin with "no"."""
    row = {"engine": "e", "method": "m", "fingerprint": fingerprint, "message": "why", "description": ""}
    row |= {"digits": 9.0, "agreement": None, "runner_up": "m1", "runner_up_distance": 1.0}
    first, table, *_ = fingerprint_document([row]).parts
    assert isinstance(first, Sentence)
    assert isinstance(table, Table)
    assert first.text.endswith(f" {fingerprint}")
    assert ("steps by the known map" in first.text, first.tint) == (tint == "good", tint)
    assert table.rows[0][1] == Span(fingerprint, tint)
    assert ("9 digits" in map_text(row)) == (tint == "good")
