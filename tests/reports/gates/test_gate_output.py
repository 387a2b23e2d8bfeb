"""Results of gates as text and as data; the column of each measure; proposals of new bounds."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from io import StringIO
from typing import Any
from xml.etree import ElementTree

import pytest
from rich.console import Console

from bodycheck._util.errors import InputError
from bodycheck.reports import document
from bodycheck.reports.document import json_text, print_document
from bodycheck.reports.gates.gate import Gate, GateMeasure, gate_of, measure_of
from bodycheck.reports.gates.gate_output import (
    as_junit,
    changes_document,
    failure_rows,
    line_of,
    note_failures,
    results_data,
    results_document,
)
from bodycheck.reports.gates.proposal import BoundChange, edited, proposals
from bodycheck.reports.gates.verdict import GateResult, check_gates
from bodycheck.reports.run_files.run_tables import FAILED_CASES
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.gate_tables import make_tables

ERROR = "orientation_error_rad"
VERDICTS = (
    *("converges", "at-floor", "at-precision-floor", "pre-asymptotic", "lower-order", "too-few-points"),
    "chaotic",
)
COMMAND = "bodycheck run brick --engine mujoco:rk4 --dt 0.01"


def gate(**table: Any) -> Gate:
    """Return a gate on the orientation error, with the given fields replaced."""
    return gate_of({"measure": ERROR, "reason": "because", **table}, "here")


def results() -> tuple[GateResult, ...]:
    """Return one gate that passed, two that failed, and one that measured nothing."""
    run = make_tables(
        [{}, {"dt_s": 0.02, ERROR: 1e-2}, {"dt_s": 0.03, "outcome": "failed", "message": "no\x00"}]
    )
    gates = [
        gate(upper=1e-8, dt_s=0.01),
        gate(upper=1e-3),
        gate(measure="outcome", equals="ok"),
        gate(upper=1.0, engine="dart"),
    ]
    return check_gates(gates, run)


TITLES = (
    f"* *:* at 0.01 s: {ERROR} <= 1e-8",
    f"* *:*: {ERROR} <= 0.001",
    "* *:*: outcome = ok",
    f"* dart:*: {ERROR} <= 1",
)
LINES = (
    f"{TITLES[0]}: 1 case; worst 1e-9, 1 decade within",
    f"{TITLES[1]}: 2 of 3 cases failed; worst 0.01, 1 decade beyond",
    f"{TITLES[2]}: 1 of 3 cases failed; worst failed",
    f"{TITLES[3]}: no engine of the run matches dart (available: mujoco)",
)


def test_each_gate_is_one_line() -> None:
    """The line has title, number of cases and failures, the worst value and its distance, or the reason."""
    assert tuple(line_of(result) for result in results()) == LINES


@pytest.mark.parametrize(
    ("table", "bound"),
    [
        ({"near": 1.4e-2, "decades": 0.1}, "within 0.1 decades of 0.014"),
        ({"lower": 1e-9, "upper": 1e-3}, ">= 1e-9 and <= 0.001"),
        ({"measure": "outcome", "equals": "ok"}, "= ok"),
    ],
)
def test_a_bound_is_described(table: dict[str, Any], bound: str) -> None:
    """A bound is printed as a distance from a value, as two sides, or as a word."""
    assert gate(**table).bound == bound


def test_a_case_is_named_by_its_step_its_tolerance_or_neither() -> None:
    """The label is the same as in the report."""
    steps = [("dt", 0.02, None), ("tolerance", None, 1e-6), ("none", None, None)]
    run = make_tables(
        [{"control": control, "dt_s": dt_s, "tolerance": reported} for control, dt_s, reported in steps]
    )
    labels = [check.row.at for check in check_gates([gate(upper=1.0)], run)[0].checks]
    assert labels == ["dt 0.02 s", "tolerance 1e-6", "no steps"]


def test_a_run_without_cases_has_none() -> None:
    """Nothing was measured, which never passes; the reason says so."""
    (result,) = check_gates([gate(upper=1.0)], make_tables([]))
    assert (result.status, result.why) == ("nothing", "no scenario of the run matches * (available: none)")


def test_each_failed_row_is_shown_with_its_command() -> None:
    """The row has gate, scenario, method, step, value or reason, bound, distance and command."""
    assert failure_rows(results()) == [
        ("[1]", "brick", "mujoco:rk4", "dt 0.02 s", "0.01", f"{ERROR} <= 0.001", "1 decade beyond", COMMAND),
        ("[1]", "brick", "mujoco:rk4", "dt 0.03 s", "failed: no\x00", f"{ERROR} <= 0.001", "", COMMAND),
        ("[2]", "brick", "mujoco:rk4", "dt 0.03 s", "failed", "outcome = ok", "", COMMAND),
    ]


def test_the_terminal_has_the_count_then_lines_then_failures_then_reasons(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The first line counts the gates by status; the reason of each that did not pass is last."""
    print_document(results_document(results()))
    first, *shown = capsys.readouterr().out.splitlines()
    assert first == "4 gates: 1 passed, 2 failed, 1 measured nothing"
    places = zip(("passed ", "failed ", "failed ", "nothing"), LINES, strict=True)
    assert shown[:4] == [f"{status}  [{place}]  {line}" for place, (status, line) in enumerate(places)]
    assert shown[4:6] == ["", "Failed"]
    assert shown[6].split() == [
        "gate",
        "scenario",
        "method",
        "at",
        "obtained",
        "bound",
        "distance",
        "command",
    ]
    assert shown[7].endswith(COMMAND)
    assert shown[-3:] == ["[1] because", "[2] because", "[3] because"]
    print_document(results_document(results()[:1]))
    assert capsys.readouterr().out.splitlines() == ["1 gate: 1 passed", f"passed  [0]  {LINES[0]}"]


def test_on_a_terminal_the_status_alone_is_coloured_and_no_character_is_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """`passed` is green, any other status red; a line longer than the terminal is wrapped between words.

    The count, which is read first, is bold.
    """
    shown = StringIO()
    narrow = Console(file=shown, width=60, force_terminal=True, color_system="standard", highlight=False)
    monkeypatch.setattr(document, "console", lambda: narrow)
    print_document(results_document(results()))
    words = " ".join(shown.getvalue().split())
    assert words.startswith("\x1b[1m4 gates: 1 passed, 2 failed, 1 measured nothing\x1b[0m")
    colours = ("\x1b[32mpassed", "\x1b[31mfailed", "\x1b[31mfailed", "\x1b[31mnothing")
    for place, colour in enumerate(colours):
        assert f"{colour}\x1b[0m [{place}] {LINES[place]}" in words
    reasoned = replace(results()[1], gate=gate(upper=1e-3, reason=20 * "because "))
    print_document(results_document([reasoned]))
    assert f"[0] {20 * 'because '}".rstrip() in " ".join(shown.getvalue().split())


def test_changes_are_shown_with_their_measurements(capsys: pytest.CaptureFixture[str]) -> None:
    """The output also counts the gates that did not pass and are left unchanged."""
    changes = [
        BoundChange(0, "upper", 1e-8, 2e-9, 1e-9, loosens=False),
        BoundChange(1, "near", 1e-3, 1e-2, 1e-2, loosens=True),
    ]
    print_document(changes_document(changes, results(), 0.3))
    about = f"* *:* {ERROR}:"
    assert capsys.readouterr().out.splitlines() == [
        f"[0] {about} upper 1e-8 -> 2e-9; measured 1e-9, margin 0.3 decades",
        f"[1] {about} near 0.001 -> 0.01; measured 0.01; loosened",
        "2 gates that did not pass left unchanged: loosen with --loosen REASON",
        "2 bounds replaced",
    ]
    both = [BoundChange(1, key, 1e-3, 1e-2, 1e-2, loosens=True) for key in ("lower", "upper")]
    print_document(changes_document(both, results(), 0.3))
    assert "2 gates that did not pass left unchanged" in capsys.readouterr().out
    print_document(changes_document(changes[:1], results()[:1], 0.3))
    assert capsys.readouterr().out.splitlines()[1:] == ["1 bound replaced"]


def test_junit_has_a_test_case_a_gate_and_a_failure_for_all_that_did_not_pass() -> None:
    """Both levels have the counts; characters that XML cannot represent are replaced."""
    written = as_junit(results(), "gates.toml")
    assert written.startswith(b"<?xml version='1.0' encoding='utf-8'?>\n<testsuites")
    assert written.endswith(b"</testsuites>\n")
    root = ElementTree.fromstring(written)
    (suite,) = root
    counts = {"tests": "4", "failures": "3", "errors": "0", "skipped": "0"}
    assert (root.tag, root.attrib) == ("testsuites", counts)
    assert (suite.tag, suite.attrib) == ("testsuite", {"name": "bodycheck gate", **counts})
    names = [f"gate[{place}] {title}" for place, title in enumerate(TITLES)]
    assert [(case.tag, case.attrib) for case in suite] == [
        ("testcase", {"classname": "gates.toml", "name": name}) for name in names
    ]
    assert [[failure.tag for failure in case] for case in suite] == [[], *3 * [["failure"]]]
    reported = [case[0].attrib for case in suite if len(case)]
    kinds = ("failed", "failed", "nothing")
    assert reported == [{"type": kind, "message": line} for kind, line in zip(kinds, LINES[1:], strict=True)]
    replaced = f"brick | mujoco:rk4 | dt 0.03 s | failed: no\ufffd | {ERROR} <= 0.001 | {COMMAND}"
    assert (suite[1][0].text or "").splitlines()[0] == "because"
    assert (suite[1][0].text or "").splitlines()[2] == replaced


def test_json_has_every_number_in_full() -> None:
    """JSON has the file, the run, whether all gates passed, and each gate with its rows; infinity is null."""
    written = json_text(results_data(results(), "gates.toml", "the-run"))
    assert written.startswith('{\n "file": "gates.toml",\n')
    found = json.loads(written)
    assert {key: found[key] for key in ("file", "run_id", "passed")} == {
        "file": "gates.toml",
        "run_id": "the-run",
        "passed": False,
    }
    first, second, third, fourth = found["gates"]
    assert first["gate"]["upper"] == 1e-8
    assert "lower" not in first["gate"]
    assert [one["status"] for one in found["gates"]] == ["passed", "failed", "failed", "nothing"]
    assert fourth["why"] == "no engine of the run matches dart (available: mujoco)"
    assert first["rows"] == [
        {
            "scenario": "brick",
            "engine": "mujoco",
            "method": "rk4",
            "at": "dt 0.01 s",
            "obtained": 1e-9,
            "why": "",
            "reproduce": COMMAND,
            "about": "",
            "errors": [],
            "is_wrong": False,
            "passed": True,
            "beyond_decades": pytest.approx(-1.0),
        }
    ]
    assert second["rows"][2]["beyond_decades"] is None
    assert third["rows"][2]["passed"] is False
    assert json.loads(json_text(results_data(results()[:1], "", "")))["passed"] is True
    order = check_gates([gate(measure=f"order.{ERROR}", lower=3.5)], make_tables([{}], [{}]))
    assert json.loads(json_text(results_data(order, "", "")))["gates"][0]["rows"][0]["beyond"] == -0.5
    zero = check_gates([gate(upper=0.0)], make_tables([{}]))
    assert json.loads(json_text(results_data(zero, "", "")))["gates"][0]["rows"][0]["beyond_decades"] is None


@pytest.mark.parametrize(
    ("name", "measure"),
    [
        ("energy_drift", GateMeasure("results", "energy_drift")),
        ("energy_drift_abs", GateMeasure("results", "energy_drift_abs")),
        ("successive_difference_rad", GateMeasure("results", "successive_difference_rad")),
        ("steps", GateMeasure("results", "steps", in_decades=False)),
        ("rhs_evaluations", GateMeasure("results", "rhs_evaluations", in_decades=False)),
        ("cpu_s", GateMeasure("results", "cpu_s", is_speed=True)),
        ("ns_per_step", GateMeasure("results", "ns_per_step", is_speed=True)),
        ("relative_cpu", GateMeasure("results", "relative_cpu", is_speed=True)),
        ("stability.dt_stable_s", GateMeasure("stability", "dt_stable_s")),
        (f"order.{ERROR}", GateMeasure("methods", "order", ERROR, in_decades=False)),
        (
            "growth.energy_drift",
            GateMeasure(
                *("methods", "growth", "energy_drift"),
                choices=("bounded", "sqrt", "linear", "quadratic", "exponential"),
            ),
        ),
        (
            "outcome",
            GateMeasure(
                *("results", "outcome"),
                choices=("ok", "unstable", "failed", "timeout", "unsupported", "invalid"),
            ),
        ),
    ],
)
def test_a_measure_stands_for_one_column(name: str, measure: GateMeasure) -> None:
    """A name gives its table, its quantity, its words, and how two of its values are compared."""
    assert measure_of(name) == measure


@pytest.mark.parametrize(("name", "quantity"), [("verdict", None), ("verdict.energy_drift", "energy_drift")])
def test_a_verdict_is_of_all_quantities_unless_one_is_named(name: str, quantity: str | None) -> None:
    """Its words are the verdicts, without the outcomes."""
    found = measure_of(name)
    assert (found.source, found.column, found.quantity, found.in_decades) == (
        "methods",
        "verdict",
        quantity,
        True,
    )
    assert set(found.choices) == {*VERDICTS, "does-not-converge", "error-grows", "unstable", "exact", "off"}


@pytest.mark.parametrize(
    "name",
    [
        "order",
        "growth",
        "stability",
        "stability.x",
        "order.x",
        "energy_scale_j",
    ],
)
def test_what_is_no_measure_is_refused_with_what_there_is(
    name: str, expected_message: ExpectedMessage
) -> None:
    """The message names the unknown measure and lists the available ones."""
    with expected_message.raises(ValueError):
        measure_of(name)


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("outcome.x", "outcome"),
        ("orthogonality_error_abs", "orthogonality_error"),
        ("order.position_error_m", "order.position_error"),
    ],
)
def test_a_measure_that_resembles_the_typed_one_is_suggested(name: str, near: str) -> None:
    """In place of the list of all measures."""
    with pytest.raises(ValueError, match=f"did you mean {re.escape(near)}\\?$"):
        measure_of(name)


def bounds(table: dict[str, Any], *errors: float) -> list[tuple[str, float, float, float, bool]]:
    """Return key, old and new bound, the worst value and whether the bound is loosened, which is allowed."""
    run = make_tables([{ERROR: error, "dt_s": k + 1.0} for k, error in enumerate(errors)])
    changes = proposals(check_gates([gate(**table)], run), 0.3, loosen=True)
    return [(one.key, one.old, one.new, one.measured, one.loosens) for one in changes]


@pytest.mark.parametrize(
    ("table", "errors", "reported"),
    [
        ({"near": 1e-3, "decades": 0.5}, (4e-3,), [("near", 1e-3, 4e-3, 4e-3, True)]),
        ({"near": 1e-3, "decades": 0.5}, (1e-3, 9e-3), [("near", 1e-3, 3e-3, 9e-3, True)]),
        ({"near": 1e-3, "decades": 0.5}, (1e-3, 11e-3), []),  # farther apart than one bound allows
        ({"near": 1e-3, "decades": 0.5}, (1e-3, 3e-3), []),
        ({"upper": 1e-3}, (1e-4, 1e-2), [("upper", 1e-3, 2e-2, 1e-2, True)]),
        ({"lower": 1e-3}, (1e-4, 1e-2), [("lower", 1e-3, 5e-5, 1e-4, True)]),
        ({"upper": 1e-3, "floor": 1e-2}, (9e-3,), []),  # values below the floor count as the floor
        ({"lower": 1e-3, "floor": 1e-2}, (1e-4,), []),
        ({"lower": 1e-3, "floor": 1e-2}, (1.0,), [("lower", 1e-3, 0.5, 1.0, False)]),
        (
            {"lower": 1e-3, "upper": 1e-2},
            (5e-3,),
            [("lower", 1e-3, 2.5e-3, 5e-3, False)],
        ),
        ({"upper": 1.0}, (0.0,), []),
    ],
)
def test_a_new_bound_is_the_margin_from_the_worst(
    table: dict[str, Any], errors: tuple[float, ...], reported: list[tuple[str, float, float, float, bool]]
) -> None:
    """The bound is above the largest or below the least error, to two digits; `near` is between the two."""
    assert bounds(table, *errors) == [
        (*one[:2], pytest.approx(one[2], rel=1e-12, abs=0.0), *one[3:]) for one in reported
    ]


def test_an_edit_after_which_a_file_could_not_be_read_is_refused(expected_message: ExpectedMessage) -> None:
    """A new upper bound below the lower one is never written."""
    toml_text = '[[gate]]\nmeasure = "energy_drift"\nlower = 1e-4\nupper = 1e-3\nreason = "r"\n'
    with expected_message.raises(InputError):
        edited(toml_text, "here", [BoundChange(0, "upper", 1e-3, 1e-5, 5e-6, loosens=False)], None)


def test_an_edit_leaves_texts_alone_and_writes_reasons_as_they_are_spoken() -> None:
    """Text in a later string that looks like a bound stays; letters of another script are not escaped."""
    toml_text = '[[gate]]\nmeasure = "energy_drift"\nupper = 1e-3\nreason = "r"\n'
    after = toml_text.replace('"r"', '"""\nupper = 3\n"""')
    change = BoundChange(0, "upper", 1e-3, 1e-2, 5e-3, loosens=True)
    assert edited(after, "here", [change], None) == after.replace("1e-3", "0.01")
    expected = toml_text.replace("1e-3", "0.01").replace('"r"', '"r; loosened: größer"')
    assert edited(toml_text, "here", [change], "größer") == expected


def test_the_case_that_failed_a_gate_is_noted() -> None:
    """With its step, and no other one: `explain` of the run examines it, whatever its verdict."""
    run = make_tables([{"dt_s": 0.01, ERROR: 1.0}, {"dt_s": 0.005, ERROR: 1e-9}])
    note_failures(run, check_gates([gate(upper=1e-3)], run))
    assert run.manifest[FAILED_CASES] == ["brick,mujoco:rk4,0.01"]
    healthy = make_tables([{"dt_s": 0.01, ERROR: 1e-9}])
    note_failures(healthy, check_gates([gate(upper=1e-3)], healthy))
    assert FAILED_CASES not in healthy.manifest
