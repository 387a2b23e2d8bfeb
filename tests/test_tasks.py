"""Each row of the README's table runs, and the first line of its answer is the answer (tests/tasks.md)."""

from __future__ import annotations

import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from tests.helpers.doc_pages import blocks, text_of
from tests.helpers.in_process_cli import run_bodycheck

pytestmark = pytest.mark.slow

ROWS = [line for line in text_of("README.md").splitlines() if re.match(r"\| [a-z].*\| .*`.*\| .*\]\(", line)][
    :6
]
ANSWERS = {
    "advise tumbling": r"use \w+:\w+ with dt = \S+ s: error at most \S+ rad",
    "run smoke": r"Nothing was measured in 1 method on 3 scenarios",  # the program cannot turn
    "nightly smoke": r"First nightly run: nothing to compare with yet, \d+ cases stored",
    "audit arm.urdf": r"arm.urdf: ",
    "judge sim.csv": r"The attitude is \S+ rad \(\S+ degrees\) from the truth after \S+ s\.$",
    "movie flip": r"intermediate-axis, dt \S+ s: farthest from the truth is ",
}
"""How each command begins -> its first line."""
QUICK = ("check my robot model", "judge my recording")
"""The rows that each push runs; what the others run has tests of its own."""


def commands_of(row: str) -> list[str]:
    """Return the commands of a row."""
    return [found.removeprefix("bodycheck ") for found in re.findall(r"`(bodycheck [^`]+)`", row)]


def test_the_table_has_six_rows_with_a_command_and_a_page() -> None:
    """Each row has a command of bodycheck whose first line is stated here."""
    assert len(ROWS) == 6
    assert all(
        any(command.startswith(known) for known in ANSWERS)
        for row in ROWS
        for command in commands_of(row)[-1:]
    )


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "row",
    [
        pytest.param(row, id=name, marks=[] if name in QUICK else pytest.mark.nightly)
        for name, row in ((row.split("|")[1].strip(), row) for row in ROWS)
    ],
)
def test_a_row_of_the_readme_runs_and_its_first_line_is_the_answer(row: str, tmp_path: Path) -> None:
    """The statuses are 0, and 3 for a history that is too short."""
    for page, language, place, name in (
        ("docs/audit.md", "xml", 0, "arm.urdf"),
        ("docs/recordings.md", "text", 0, "sim.csv"),
        ("docs/workers.md", "python", 0, "drift.py"),
    ):
        (tmp_path / name).write_text(blocks(page, language)[place].text)
    for command in commands_of(row):
        words = shlex.split(command)
        program = f"cmd:{shlex.quote(sys.executable)} {shlex.quote(str(tmp_path / 'drift.py'))}"
        words = [program if word == "cmd:PROGRAM" else word for word in words]
        done = run_bodycheck(tmp_path, *words)
        assert done.returncode == (3 if words[0] == "nightly" else 0), done.stderr
    first = done.stdout.splitlines()[0]
    (pattern,) = [pattern for known, pattern in ANSWERS.items() if command.startswith(known)]
    assert re.match(pattern, first)


def test_advice_about_a_task_uses_its_torque_and_its_horizon_and_is_drawn(tmp_path: Path) -> None:
    """The body of the options is measured with this torque for this time, and --plot writes the figure."""
    body = "--mass-kg 0.5 --inertia-kg-m2 0.002,0.003,0.004 --spin-rad-s 20"
    task = "--torque-body-n-m 0,0,1e-3 --horizon-s 2 --error 1e-3 --engine mujoco:rk4 --plot advice.svg"
    done = run_bodycheck(tmp_path, "advise", *body.split(), *task.split())
    assert done.returncode == 0, done.stderr
    assert re.match(
        r"(confirmed: \S+ <= \S+ rad; )?use mujoco:rk4 with dt = \S+ s(: error at most|\n)", done.stdout
    )
    (manifest,) = tmp_path.glob("bodycheck-runs/*/manifest.json")
    (scenario,) = json.loads(manifest.read_text())["scenarios"].values()
    assert scenario["duration_s"] == 2.0
    (forcing,) = scenario["forcing"]
    assert (forcing["kind"], forcing["axes"], forcing["value_n_m"]) == ("torque", "body", [0.0, 0.0, 1e-3])
    assert "mujoco:rk4" in (tmp_path / "advice.svg").read_text()
