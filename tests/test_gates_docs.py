"""What docs/gates.md shows works word for word, and the project's own gates hold."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from contextlib import nullcontext
from importlib.metadata import entry_points
from pathlib import Path

import pytest

from bodycheck.gate_run import run_for_gates
from bodycheck.reports.gates.gate import read_gates
from bodycheck.reports.gates.verdict import held
from bodycheck.runner import SILENCE, Manner
from bodycheck.scenarios.library import suites

pytest_plugins = ["pytester"]

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/gates.md").read_text()
MODULE = "bodycheck.pytest_plugin"
INSTALLED = any(point.value == MODULE for point in entry_points(group="pytest11"))


def blocks(language: str) -> list[str]:
    """Return the code blocks of one language on the page."""
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, flags=re.DOTALL | re.MULTILINE)


def shell_lines(program: str) -> list[str]:
    """Return the command lines of one program on the page."""
    return [line for line in "".join(blocks("sh")).splitlines() if line.startswith(f"{program} ")]


@pytest.mark.slow
def test_the_commands_of_the_page_work(tmp_path: Path) -> None:
    """One after the other, with the page's gates: all hold, and both files are written."""
    (gates,) = blocks("toml")
    (tmp_path / "gates.toml").write_text(gates)
    lines = shell_lines("bodycheck")
    assert len(lines) == 4
    for line in lines:
        words = [sys.executable, "-m", *shlex.split(line, comments=True)]
        done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"gates.toml", "gates.xml", "gates.json", "my-run"}
    assert [gate.reason for gate in read_gates(tmp_path / "gates.toml")] == re.findall(
        'reason = "(.*)"', gates
    )


@pytest.mark.slow
def test_the_tests_of_the_page_pass(pytester: pytest.Pytester) -> None:
    """Each Python block is a file of tests, run by the page's own command."""
    pytester.makefile(".toml", gates=blocks("toml")[0])
    pytester.makepyfile(**{f"test_block_{i}": code for i, code in enumerate(blocks("python"))})
    (command,) = shell_lines("pytest")
    plugin = () if INSTALLED else ("-p", MODULE)
    done = pytester.runpytest_subprocess(*plugin, *shlex.split(command)[1:], "-p", "no:cacheprovider")
    by_gate, marked, others = 4, 2, 4
    done.assert_outcomes(passed=by_gate + marked + others)


@pytest.mark.slow
def test_the_projects_own_gates_hold_where_the_racket_flips() -> None:
    """All gates that look at the intermediate axis hold there, and were measured."""
    gates = [
        gate for gate in read_gates(ROOT / "tolerances.toml") if gate.wants_scenario("intermediate-axis")
    ]
    run = run_for_gates(gates, ["intermediate-axis"], Manner(), lambda _: nullcontext(SILENCE))
    results = held(gates, run)
    lost = run.manifest["engines"].get("pybullet", {}).get("unavailable")
    wanted = {"passed"} if lost is None else {"passed", "nothing"}  # on later Pythons there is no PyBullet
    assert {result.status for result in results} == wanted
    assert all(result.gate.engine == "pybullet" for result in results if result.status == "nothing")


def test_every_gate_of_the_project_looks_at_the_standard_suite() -> None:
    """Each has a scenario there: `bodycheck gate` without names measures something for every one."""
    for gate in read_gates(ROOT / "tolerances.toml"):
        assert any(gate.wants_scenario(name) for name in suites()["standard"]), gate.title
