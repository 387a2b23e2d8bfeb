"""The action, the workflow that `init` writes, the hooks and the container: each step does what it says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from bodycheck.cli.commands import app
from bodycheck.reports.gates.gate import read_gates
from tests.helpers.doc_pages import ROOT
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import SCENARIO

ACTION: dict[str, Any] = yaml.safe_load((ROOT / "action.yml").read_text())
STEPS: list[dict[str, Any]] = ACTION["runs"]["steps"]
SCRIPTS = [step["name"] for step in STEPS if "run" in step]
GATES = """
[[gate]]
engine = "reference"
measure = "orientation_error_rad"
upper = {upper}
reason = "a bound"
"""
LINK = """<robot name="arm"><link name="upper">
<inertial><mass value="1.0"/>
<inertia ixx="{moment}" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
</link></robot>
"""
PROJECTS = {
    "passing": {"gates.toml": GATES.format(upper=0.1), "arm.urdf": LINK.format(moment=0.02)},
    "failing": {"gates.toml": GATES.format(upper=1e-9), "arm.urdf": LINK.format(moment=0.2)},
    "broken": {"gates.toml": "[[gate]]\nupper = 1\n", "arm.urdf": "<robot"},
}
STATUS = {"passing": 0, "failing": 1, "broken": 2}


def project(folder: Path, kind: str) -> Path:
    """Write a project with a scenario, gates and a model, and programs bodycheck and python."""
    for name, text in {**PROJECTS[kind], "mine.toml": SCENARIO}.items():
        (folder / name).write_text(text)
    programs = folder / "bin"
    programs.mkdir()
    (programs / "bodycheck").write_text(f'#!/bin/sh\nexec {sys.executable} -P -m bodycheck "$@"\n')
    (programs / "python").write_text('#!/bin/sh\necho "$@" >> python.txt\n')
    for program in programs.iterdir():
        program.chmod(0o755)
    return folder


def run_step(folder: Path, name: str, **inputs: str) -> subprocess.CompletedProcess[str]:
    """Run the script of a step in a project as the runner does, with the inputs in its environment."""
    (step,) = (step for step in STEPS if step.get("name") == name)
    values = {key: str(one["default"]) for key, one in ACTION["inputs"].items()} | inputs
    expressions = {
        key: re.fullmatch(r"\$\{\{ inputs\.([\w-]+) \}\}", text) for key, text in step.get("env", {}).items()
    }
    environment = {
        **os.environ,
        **{key: values[found[1]] for key, found in expressions.items() if found is not None},
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "GITHUB_ACTION_PATH": str(ROOT),
        "GITHUB_STEP_SUMMARY": str(folder / "summary.md"),
    }
    assert len(expressions) == sum(found is not None for found in expressions.values())
    return subprocess.run(
        ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


MEASURED = {"engine": "reference:rk4", "scenarios": "mine.toml"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=() if kind == "failing" else pytest.mark.nightly) for kind in PROJECTS]
)
def test_steps_of_the_action_judge_a_project(kind: str, tmp_path: Path) -> None:
    """Audit and gate end with 0, 1 or 2; annotations, summary and SARIF tell why."""
    folder, seen = project(tmp_path, kind), []
    installed = run_step(folder, "Install bodycheck")
    assert (folder / "python.txt").read_text().split() == [
        "-m",
        "pip",
        "install",
        "--quiet",
        f"{ROOT}[engines,history]",
    ]
    audited = run_step(folder, "Audit the models", audit="**/*.urdf")
    measured = run_step(folder, "Measure", **MEASURED)
    checked = run_step(folder, "Check the bounds", gates="gates.toml")
    seen += ["Install bodycheck", "Audit the models", "Measure", "Check the bounds"]
    assert [installed.returncode, measured.returncode] == [0, 0], measured.stderr
    assert [audited.returncode, checked.returncode] == [STATUS[kind]] * 2, audited.stdout + checked.stderr
    summary = (folder / "summary.md").read_text()
    assert "### arm.urdf" in summary
    if kind == "broken":
        assert "gates.toml: gate[0]" in checked.stderr
        return
    assert {path.name for path in (folder / "bodycheck-sarif").iterdir()} == {"audit-1.sarif", "gates.sarif"}
    assert ("::error" in checked.stdout) == (kind == "failing")
    first = run_step(folder, "Compare with the baseline")
    assert "no baseline yet" in first.stdout
    assert run_step(folder, "Prepare the next baseline").returncode == 0
    if kind == "failing":  # the method of the baseline is missing
        shutil.rmtree(folder / "bodycheck-run")
        assert run_step(folder, "Measure", **{**MEASURED, "engine": "reference:m1"}).returncode == 0
    compared = run_step(folder, "Compare with the baseline")
    assert compared.returncode == STATUS[kind], compared.stdout
    seen += ["Compare with the baseline", "Prepare the next baseline"]
    assert set(seen) == set(SCRIPTS)


@pytest.mark.slow
def test_action_without_a_matching_model_fails(tmp_path: Path) -> None:
    """A pattern that matches nothing is an error, because nothing was checked."""
    done = run_step(project(tmp_path, "passing"), "Audit the models", audit="models/*.urdf")
    assert done.returncode == 2
    assert "no file matches" in done.stdout


def test_every_input_of_the_action_is_used() -> None:
    """Each input is described and occurs in a step, and expressions reach scripts by the environment only."""
    text = (ROOT / "action.yml").read_text()
    for name, one in ACTION["inputs"].items():
        assert one["description"].endswith(".")
        assert f"inputs.{name}" in text
    assert not any("${{" in step["run"] for step in STEPS if "run" in step)
    used = re.findall(r"uses: *(.*)", text)
    assert all(re.fullmatch(r"[\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line) for line in used)


@pytest.mark.parametrize("engine", ["reference:rk4", "cmd:build/engine"])
def test_init_writes_gates_and_a_workflow(engine: str, tmp_path: Path) -> None:
    """The gates are valid and of the engine; the workflow gives the action inputs that it has."""
    (tmp_path / "arm.urdf").write_text(LINK)
    done = run_bodycheck(tmp_path, "init", "--engine", engine)
    assert done.returncode == 0, done.stderr
    gates = read_gates(tmp_path / "gates.toml")
    assert {gate.concerns([engine]) for gate in gates} == {True}
    workflow = yaml.safe_load((tmp_path / ".github/workflows/bodycheck.yml").read_text())
    steps = workflow["jobs"]["bodycheck"]["steps"]
    given = steps[-1]["with"]
    assert set(given) <= set(ACTION["inputs"])
    assert given["engine"] == engine
    assert given["audit"] == "**/*.urdf"
    assert any(step.get("run") == "make" for step in steps) == engine.startswith("cmd:")
    again = run_bodycheck(tmp_path, "init", "--engine", "mujoco")
    assert again.stdout.count("left as it is") == 2
    assert read_gates(tmp_path / "gates.toml") == gates


@pytest.mark.slow
def test_gates_of_init_pass_and_are_tightened(tmp_path: Path) -> None:
    """The bounds hold for a correct method, and --update tightens them."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    run_bodycheck(tmp_path, "init", "--engine", "reference:rk4")
    words = ("gate", "mine.toml", "--gates", "gates.toml", "--update", "--quiet")
    done = run_bodycheck(tmp_path, *words)
    assert done.returncode == 0, done.stdout + done.stderr
    bounds = [gate.upper for gate in read_gates(tmp_path / "gates.toml") if gate.upper is not None]
    assert all(bound < 0.1 for bound in bounds)


@pytest.mark.parametrize("words", ["init nowhere", "init --engine mujoc"])
def test_wrong_init_is_refused(words: str, tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A folder that is not there and an unknown engine are refused; nothing is written."""
    done = run_bodycheck(tmp_path, *words.split())
    assert done.returncode == 2
    expected_message(done.stderr.strip())
    assert not list(tmp_path.iterdir())


def test_hooks_and_container_use_existing_commands() -> None:
    """The entry of each hook, and each bodycheck command of the container, exist with their options."""
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    container = (ROOT / "Containerfile").read_text()
    lines = [
        *re.findall(r"bodycheck [\w -]+[a-z]", hook["entry"]),
        *re.findall(r"^RUN (bodycheck [^&\n]*)", container, re.MULTILINE),
    ]
    known: Any = get_command(app)
    assert len(lines) == 2
    for line in lines:
        _, name, *words = line.split()
        options = {option for parameter in known.commands[name].params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options
    copied = re.findall(r"^COPY (.*) \S+$", container, re.MULTILINE)
    assert all((ROOT / name).exists() for line in copied for name in line.split())
    assert re.fullmatch(hook["files"].replace("$", ".*"), ".urdf")


@pytest.mark.nightly
def test_hook_checks_every_file_that_it_is_given(tmp_path: Path) -> None:
    """pre-commit appends the files: each is checked, and one that is wrong fails the hook."""
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
    project(tmp_path, "passing")
    (tmp_path / "good.urdf").write_text(LINK.format(moment=0.02))
    (tmp_path / "bad.urdf").write_text(LINK.format(moment=0.2))
    environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    for files, status in ((["good.urdf"], 0), (["bad.urdf", "good.urdf"], 1)):
        words = [*shlex.split(hook["entry"]), *files]
        done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, check=False)
        assert done.returncode == status
