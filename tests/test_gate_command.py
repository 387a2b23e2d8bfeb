"""The command `gate`: its output, files and exit status."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner, Result

from bodycheck._util.errors import InputError
from bodycheck.cli import commands
from bodycheck.reports.document import json_text, markdown
from bodycheck.reports.gates.gate import parse_gates
from bodycheck.reports.gates.gate_output import as_junit, results_data
from bodycheck.reports.gates.verdict import check_gates
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.reports.summary.sentences import run_document
from bodycheck.runs import gate_run
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import NULL_PROGRESS
from bodycheck.runs.selection import Selection
from tests.helpers.scenario_texts import tumbling

SCENARIO = tumbling(steps_s=[0.05, 0.02])
KEPT = """
[[gate]]
scenario = "free"
engine = "reference"
method = "rk4"
measure = "order.orientation_error_rad"
lower = 3.9
upper = 4.1
reason = "the classical method is of order 4"

[[gate]]
scenario = "free"
engine = "reference"
method = "rk4"
measure = "orientation_error_rad"
upper = 1e-3
floor = 1e-14
reason = "loose"
"""
BROKEN = """
[[gate]]
scenario = "free"
engine = "reference"
method = "m1"
measure = "orientation_error_rad"
upper = 1e-9
reason = "M1 is of order 1"
"""
IDLE = """
[[gate]]
engine = "failing"
measure = "orientation_error_rad"
scenario = "forced*"
dt_s = 2e-2
upper = 1.0
reason = "it gives up"

[[gate]]
scenario = "nowhere"
measure = "energy_drift"
upper = 1.0
reason = "there is no such scenario"
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Change to an empty folder and write tolerance files to it."""
    for name, text in {"kept": KEPT, "broken": KEPT + BROKEN, "idle": KEPT + IDLE}.items():
        (tmp_path / f"{name}.toml").write_text(text)
    (tmp_path / "mine.toml").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def gate(*words: str | Path) -> Result:
    """Run `bodycheck gate words` in this process and return its result."""
    return CliRunner().invoke(commands.app, ["gate", *map(str, words)])


def test_gates_that_hold_end_with_status_0(folder: Path, stored_run: Path) -> None:
    """The output has one line per gate with its worst value, and the count; nothing is written."""
    before = sorted(folder.iterdir())
    done = gate("--gates", "kept.toml", "--run", stored_run)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert [line.split()[0] for line in lines] == ["2", "passed", "passed"]
    assert (
        "[0]  free reference:rk4: order.orientation_error_rad >= 3.9 and <= 4.1: 1 case; worst " in lines[1]
    )
    assert lines[0] == "2 gates: 2 passed"
    assert sorted(folder.iterdir()) == before


@pytest.mark.usefixtures("folder")
def test_failed_gate_ends_with_status_1_and_its_commands(stored_run: Path) -> None:
    """The table has value, bound, distance and command of each case, followed by the reason of the gate."""
    done = gate("--gates", "broken.toml", "--run", stored_run)
    assert done.exit_code == 1
    assert done.stdout.splitlines()[0] == "3 gates: 2 passed, 1 failed"
    lines = done.stdout.splitlines()
    commands = [k for k, line in enumerate(lines) if "--engine reference:m1 --dt" in line]
    assert len(commands) >= 5
    for k in commands:
        line = f"{lines[k - 1]} {lines[k]}"
        for cell in ("orientation_error_rad <= 1e-9", "decades beyond", "bodycheck run ", "free.toml"):
            assert cell in line
    assert "[2] M1 is of order 1" in done.stdout


def test_a_failed_order_lists_the_error_at_each_step(folder: Path, stored_run: Path) -> None:
    """The errors and the order between adjacent steps are on the terminal, in the JUnit file and in JSON."""
    bound = 'measure = "order.orientation_error_rad"\nlower = 3.9\n'
    head, _, tail = BROKEN.partition("measure = ")
    (folder / "order.toml").write_text(head + bound + tail[tail.index("reason") :])
    done = gate("--gates", "order.toml", "--run", stored_run, "--junit", "a.xml")
    data = gate("--gates", "order.toml", "--run", stored_run, "--json")
    assert done.exit_code == data.exit_code == 1
    table = read_tables(stored_run).results
    own = table[table["reproduce"].str.contains("free.toml --engine reference:m1 ", regex=False)]
    own = own.sort_values("dt_s", ascending=False)
    (row,) = json.loads(data.stdout)["gates"][0]["rows"]
    assert [line.split(":")[0] for line in row["errors"]] == [f"dt {dt_s!r} s" for dt_s in own["dt_s"]]
    for line, error in zip(row["errors"], own["orientation_error_rad"], strict=True):
        assert float(line.split(": ")[1].split(" rad")[0]) == pytest.approx(error, rel=1e-3)
        assert f"free reference:m1: {line}" in done.stdout
        assert line in Path("a.xml").read_text()
    assert all(0.9 < float(line.split("order ")[1]) < 1.1 for line in row["errors"][1:])


@pytest.mark.usefixtures("folder")
def test_gates_that_measured_nothing_end_with_status_1(stored_run: Path) -> None:
    """An engine that always fails and a missing scenario are reported as measuring nothing."""
    done = gate("--gates", "idle.toml", "--run", stored_run)
    assert done.exit_code == 1
    nothing = [line for line in done.stdout.splitlines() if line.startswith("nothing")]
    assert len(nothing) == 2
    assert ": failed: RuntimeError: the solver gave up | it said <so>" in nothing[0]
    assert (
        "no scenario of the run matches nowhere (available: free, forced, and a mesh and shape/1"
        in nothing[1]
    )
    assert done.stdout.splitlines()[0] == "4 gates: 2 passed, 2 measured nothing"


def test_junit_and_json_equal_the_terminal(folder: Path, stored_run: Path) -> None:
    """JUnit has one test case per gate and a failure for each that did not pass; JSON has all digits."""
    done = gate("--gates", "idle.toml", "--run", stored_run, "--junit", "g.xml", "--json")
    assert done.exit_code == 1
    suite = ElementTree.parse(folder / "g.xml").getroot()[0]
    assert (suite.get("tests"), suite.get("failures")) == ("4", "2")
    assert [case.find("failure") is not None for case in suite] == [False, False, True, True]
    reported = json.loads(done.stdout)
    assert reported["passed"] is False
    assert reported["run_id"] == json.loads((stored_run / "manifest.json").read_text())["run_id"]
    assert [gate["status"] for gate in reported["gates"]] == ["passed", "passed", "nothing", "nothing"]
    row = reported["gates"][0]["rows"][0]
    assert row["obtained"] == pytest.approx(4.0, abs=0.1)
    assert row["beyond"] == pytest.approx(max(row["obtained"] - 4.1, 3.9 - row["obtained"]), abs=1e-12)


def test_any_message_of_an_engine_fits_into_xml_and_json() -> None:
    """Control characters, angle brackets and lone surrogates give well-formed files."""
    from tests.helpers.gate_tables import make_tables

    gates = parse_gates('[[gate]]\nmeasure = "energy_drift"\nupper = 1.0\nreason = "r"\n', "t")
    results = check_gates(gates, make_tables([{"outcome": "failed", "message": "\x1b[31m<&>\x00\ud800\n"}]))
    failure = ElementTree.fromstring(as_junit(results, "t")).find(".//failure")
    assert failure is not None
    assert "[31m<&>" in (failure.text or "")
    assert json.loads(json_text(results_data(results, "t", "r")))["gates"][0]["status"] == "nothing"


@pytest.mark.slow
def test_update_tightens_the_bounds_and_prints_the_margin(folder: Path, stored_run: Path) -> None:
    """The bound becomes the worst value plus the margin, and a second update changes nothing."""
    words = ("--gates", "kept.toml", "--run", stored_run, "--update", "--margin", "0.5")
    done = gate(*words)
    assert done.exit_code == 0, done.output
    assert "upper 0.001 -> " in done.stdout
    assert "margin 0.5 decades" in done.stdout
    text = (folder / "kept.toml").read_text()
    (upper,) = (gate.upper for gate in parse_gates(text, "t")[1:])
    assert upper is not None
    assert 1e-14 <= upper < 1e-4
    assert text == KEPT.replace("1e-3", f"{upper:.1e}".replace("e-0", "e-"))
    again = gate(*words)
    assert again.exit_code == 0
    assert again.stdout.splitlines()[-1] == "0 bounds replaced"
    assert (folder / "kept.toml").read_text() == text


def test_update_loosens_nothing_without_a_reason(folder: Path, stored_run: Path) -> None:
    """A failed bound is kept; with a reason it is loosened and the reason is stored."""
    words = ("--gates", "broken.toml", "--run", stored_run, "--update")
    done = gate(*words)
    assert done.exit_code == 1
    assert "upper = 1e-9\n" in (folder / "broken.toml").read_text()
    done = gate(*words, "--loosen", "as M1 is known to be")
    assert done.exit_code == 0, done.output
    last = parse_gates((folder / "broken.toml").read_text(), "t")[-1]
    assert last.upper is not None
    assert 1e-3 < last.upper < 1.0
    assert last.reason == "M1 is of order 1; loosened: as M1 is known to be"


WRONG = {
    "no file": (["--gates", "no.toml"], "no.toml: cannot be read"),
    "no gates": (["--gates", "mine.toml"], "gate: needs at least one [[gate]] table"),
    "no run": (["--gates", "kept.toml", "--run", "."], "not a run folder"),
    "unknown scenario": (["nope", "--gates", "kept.toml"], "nope: is neither"),
    "margin alone": (
        ["--gates", "kept.toml", "--margin", "1"],
        "--margin and --loosen require --update",
    ),
    "reason alone": (
        ["--gates", "kept.toml", "--loosen", "x"],
        "--margin and --loosen require --update",
    ),
    "no reason": (["--gates", "kept.toml", "--update", "--loosen", " "], "must state the reason"),
    "negative margin": (
        ["--gates", "kept.toml", "--update", "--margin", "-1"],
        "must be between 0 and 300 decades",
    ),
    "endless margin": (
        ["--gates", "kept.toml", "--update", "--margin", "400"],
        "must be between 0 and 300 decades",
    ),
    "no jobs": (["mine.toml", "--gates", "kept.toml", "--jobs", "0"], "1 or more, not 0"),
}


@pytest.mark.parametrize("what", WRONG)
def test_wrong_input_is_refused_before_the_run(what: str, folder: Path) -> None:
    """An error of one line is raised, for which main() returns status 2; nothing is printed or written."""
    words, message = WRONG[what]
    before = sorted(folder.iterdir())
    done = gate(*words)
    assert isinstance(done.exception, InputError)
    assert message in str(done.exception)
    assert done.stdout == ""
    assert sorted(folder.iterdir()) == before


@pytest.mark.nightly
def test_new_run_is_compared_with_the_gates(folder: Path) -> None:
    """In a separate process a failed gate gives status 1 and a table, and an invalid file gives status 2."""
    (folder / "t.toml").write_text(
        '[[gate]]\nengine = "reference"\nmethod = "rk4"\ndt_s = 0.05\nmeasure = "orientation_error_rad"\n'
        'upper = 1e-12\nreason = "too tight"\n'
    )
    words = [sys.executable, "-m", "bodycheck", "gate", "mine.toml", "--gates"]
    done = subprocess.run([*words, "t.toml"], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    assert done.stdout.splitlines()[0] == "1 gate: 1 failed"
    assert "bodycheck run mine.toml --engine reference:rk4 --dt 0.05" in done.stdout
    assert not (folder / "bodycheck-runs").exists()
    kept = subprocess.run([*words, "t.toml", "--out", "kept"], capture_output=True, text=True, check=False)
    assert kept.returncode == 1, kept.stderr
    assert kept.stderr.splitlines()[-1] == "kept/report.html"
    assert gate("--gates", "t.toml", "--run", "kept").exit_code == 1
    assert '<h1 class="tint-bad">Failed check: ' in (folder / "kept/report.html").read_text(encoding="utf-8")
    assert "Failed check: " in markdown(run_document(read_tables(folder / "kept")))
    wrong = subprocess.run([*words, "mine.toml"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert wrong.stdout == ""
    assert "Traceback" not in wrong.stderr


@pytest.mark.nightly
def test_only_scenarios_and_methods_of_gates_are_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other scenarios and methods are left out, and times are measured only if a gate needs them."""
    requested: list[tuple[Selection, Request]] = []

    def run_selection(selection: Selection, request: Request, *_: object, **__: object) -> Tables:
        requested.append((selection, request))
        return Tables(run_id="none", manifest={"engines": {}}, cases=())

    monkeypatch.setattr(gate_run, "run_selection", run_selection)
    text = '[[gate]]\nengine = "reference"\nmethod = "m[12]"\nscenario = "mine"\nreason = "r"\n'
    defaults = '[[gate]]\nengine = "mujoco"\nmethod = "euler@defaults"\nreason = "r"\n'
    for measure in ("energy_drift", "relative_cpu"):
        gates = parse_gates(f'{text}measure = "{measure}"\nupper = 1e9\n', "t")
        scenarios = [folder / "mine.toml", "intermediate-axis"]
        gate_run.run_for_gates(gates, scenarios, Request(), lambda _: nullcontext(NULL_PROGRESS))
    gates = parse_gates(f'{defaults}measure = "verdict"\nequals = "converges"\n', "t")
    gate_run.run_for_gates(gates, ["intermediate-axis"], Request(), lambda _: nullcontext(NULL_PROGRESS))
    names = [
        (
            [scenario.name for _, scenario in selection.scenarios],
            [method.name for _, method in selection.methods],
        )
        for selection, _ in requested
    ]
    assert names == [(["mine"], ["m1", "m2"])] * 2 + [(["intermediate-axis"], ["euler@defaults"])]
    assert [options.speed for _, options in requested] == [False, True, False]
