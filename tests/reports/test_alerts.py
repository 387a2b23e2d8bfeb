"""Annotations of GitHub Actions, SARIF and badges: what a code hosting service reads of a check."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from bodycheck.reports.alerts import Alert, github_commands, sarif
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.comparison.comparison_document import alerts_of as alerts_of_comparison
from bodycheck.reports.comparison.comparison_document import sentences
from bodycheck.reports.gates.gate import gate_lines, parse_gates
from bodycheck.reports.gates.gate_output import alerts_of, as_junit, badge_of, results_data, results_document
from bodycheck.reports.gates.verdict import GateResult, check_gates
from bodycheck.reports.run_files.run_tables import Tables
from tests.helpers.gate_tables import make_tables

ERROR = "orientation_error_rad"
GATES = """# bounds of two engines
[[gate]]
engine = "mujoco"
measure = "orientation_error_rad"
upper = 1e-8
reason = "50 % below the bound, measured twice"

[[gate]]
engine = "dart"
measure = "orientation_error_rad"
upper = 1e-8
reason = "the same"

[[gate]]
engine = "*"
scenario = "absent"
measure = "energy_drift"
upper = 1.0
reason = "no such scenario"
"""
RUN = make_tables([{ERROR: 1e-3}, {"dt_s": 0.02, ERROR: 1e-2}, {"engine": "dart", "method": "semi-implicit"}])


def results(*engines: str, text: str = GATES) -> tuple[GateResult, ...]:
    """Return the results of the gates, for these engines."""
    return check_gates(parse_gates(text, "gates.toml"), RUN, engines)


def parsed(line: str) -> tuple[str, dict[str, str], str]:
    """Return the command, the properties and the message of a workflow command, unescaped as GitHub does."""
    found = re.fullmatch(r"::(\w+) ([^:]*)::([^\r\n]*)", line)
    assert found is not None, line
    marks = {"%3A": ":", "%2C": ",", "%0A": "\n", "%0D": "\r", "%25": "%"}

    def unescaped(text: str) -> str:
        return re.sub("%(?:25|0D|0A|3A|2C)", lambda mark: marks[mark[0]], text)

    properties = dict(pair.split("=", 1) for pair in found[2].split(","))
    return found[1], {key: unescaped(value) for key, value in properties.items()}, unescaped(found[3])


def alerts(*engines: str) -> list[Alert]:
    """Return the alerts of the gates."""
    return alerts_of(results(*engines), RUN, Path("gates.toml"), gate_lines(GATES, 3))


def test_failing_gate_is_annotated_at_its_table() -> None:
    """It names case, value, bound, reason and command; a gate that measured nothing has its own."""
    failed, nothing = map(parsed, github_commands(alerts(), "bodycheck gate"))
    assert failed[:2] == ("error", {"file": "gates.toml", "line": "2", "title": "bodycheck gate"})
    first, reason, command = failed[2].splitlines()
    assert first == (
        "brick mujoco:rk4 dt 0.02 s: orientation_error_rad 0.01, not <= 1e-8 (6 decades beyond); 1 more case"
    )
    assert reason == "reason of the bound: 50 % below the bound, measured twice"
    assert command == "reproduce: bodycheck run brick --engine mujoco:rk4 --dt 0.01"
    assert nothing[1]["line"] == "14"
    assert "no scenario of the run matches absent" in nothing[2]


def test_annotations_are_as_many_as_are_shown() -> None:
    """GitHub shows ten of a step, so the tenth counts the rest."""
    many = [Alert("gate-failed", f"fault {k}") for k in range(12)]
    lines = [parsed(line)[2] for line in github_commands(many, "bodycheck")]
    assert lines == [*(f"fault {k}" for k in range(9)), "and 3 more faults"]
    assert len(list(github_commands(many[:10], "bodycheck"))) == 10


@pytest.mark.parametrize("message", ["a: b, c", "100 %", "%0A", "two\nlines\r", "::error::x"])
def test_any_message_stays_one_command(message: str) -> None:
    """An engine's message cannot begin another workflow command, and arrives unchanged."""
    (line,) = github_commands([Alert("r", message, file=Path("a,b:c%.toml"))], "t: u")
    assert parsed(line) == ("error", {"file": "a,b:c%.toml", "line": "1", "title": "t: u"}, message)


def test_files_are_relative_to_the_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also from a folder below it; a file elsewhere keeps its path."""
    (tmp_path / "below").mkdir()
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))
    monkeypatch.chdir(tmp_path / "below")
    found = [
        Alert("r", "m", file=Path(name)) for name in ("g.toml", f"{tmp_path}/g.toml", "/elsewhere/g.toml")
    ]
    files = [parsed(line)[1]["file"] for line in github_commands(found, "t")]
    assert files == ["below/g.toml", "g.toml", "/elsewhere/g.toml"]


def test_gates_in_another_spelling_are_annotated_at_the_first_line() -> None:
    """Tables in one array have no lines of their own."""
    text = f'gate = [{{measure = "{ERROR}", upper = 1e-8, reason = "r"}}]\n'
    assert gate_lines(text, len(parse_gates(text, "g"))) == [1]


def test_sarif_has_rule_level_and_place() -> None:
    """The keys are those of SARIF 2.1.0; each result names a rule of the tool."""
    (run,) = json.loads(sarif(alerts()))["runs"]
    rules = {rule["id"] for rule in run["tool"]["driver"]["rules"]}
    assert rules == {one["ruleId"] for one in run["results"]} == {"gate-failed", "gate-measured-nothing"}
    place = run["results"][0]["locations"][0]["physicalLocation"]
    assert (place["artifactLocation"]["uri"], place["region"]["startLine"]) == ("gates.toml", 2)
    assert json.loads(sarif([]))["runs"][0]["results"] == []


def test_gates_of_other_engines_are_skipped() -> None:
    """They neither pass nor fail; a pattern that fits the engine is checked on its cases alone."""
    found = results("dart:semi-implicit")
    assert [one.status for one in found] == ["skipped", "passed", "nothing"]
    assert [one.status for one in results("mujoco")] == ["failed", "skipped", "nothing"]
    assert not results_data(found, "gates.toml", "r")["passed"]
    everyone = GATES.replace('engine = "mujoco"', 'engine = "*"')
    (result, _, _) = results("dart", text=everyone)
    assert (result.status, len(result.checks)) == ("passed", 1)
    assert b'skipped="1"' in as_junit(found, "gates.toml")
    assert "3 gates: 1 passed, 1 measured nothing, 1 skipped" in str(results_document(found).parts[0])


@pytest.mark.parametrize(
    ("engines", "message", "color"),
    [(("mujoco",), "2 of 2 gates failed", "red"), (("dart",), "1 gate passed", "brightgreen")],
)
def test_badge_counts_the_checked_gates(engines: tuple[str, ...], message: str, color: str) -> None:
    """The keys are those that img.shields.io/endpoint reads."""
    found = [one for one in results(*engines) if one.gate.scenario != "absent" or engines == ("mujoco",)]
    assert json.loads(badge_of(found)) == {
        "schemaVersion": 1,
        "label": "bodycheck",
        "message": message,
        "color": color,
    }


def changed(*cells: dict[str, Any]) -> Tables:
    """Return a run of mujoco 3.17.0 with these cases."""
    engines = {"mujoco": {"version": "3.17.0", "methods": {}}}
    return make_tables(list(cells), engines=engines, scenarios={}, created="today", bodycheck="1")


def test_one_annotation_per_method_that_got_worse() -> None:
    """It names engine, version, method and change; without --fail-on it is a warning."""
    methods = ("rk4", "euler", "implicit")
    before = changed(*({"method": method, "dt_s": dt_s} for method in methods for dt_s in (0.01, 0.02)))
    errors = {"rk4": 1e-6, "euler": 1e-9, "implicit": 1.01e-9}
    after = changed(
        *({"method": name, "dt_s": dt_s, ERROR: errors[name]} for name in methods for dt_s in (0.01, 0.02))
    )
    comparison = compare(before, after)
    (alert,) = alerts_of_comparison(comparison, ("worse", "missing"))
    assert (alert.level, alert.file) == ("error", None)
    assert alert.message == "mujoco:rk4: error at dt 0.01 s x 1e3 in brick"
    assert [one.level for one in alerts_of_comparison(comparison, ())] == ["warning"]
    both = alerts_of_comparison(comparison, ("worse", "missing", "moved"))
    assert [one.message for one in both] == [alert.message, "mujoco:implicit moved by up to 1 %"]
    assert sentences(comparison)[1] == "mujoco:implicit moved by up to 1 %."


def test_a_comparison_of_nothing_is_an_alert() -> None:
    """The exit status is then 1, so the annotation has to say why."""
    comparison = compare(changed({"scenario": "brick"}), changed({"scenario": "plate"}))
    (alert,) = alerts_of_comparison(comparison, ("worse", "missing"))
    assert alert.message == "Nothing could be compared."
