"""The workflows: pinned actions, minimal permissions, and existing commands and options only."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from bodycheck.cli import commands

_FOLDER = Path(__file__).parents[1] / ".github" / "workflows"
WORKFLOWS = sorted(_FOLDER.glob("*.yml"))
_ROOT = _FOLDER.parents[1]
SCRIPTS = [*WORKFLOWS, _ROOT / "scripts" / "nightly.sh", _ROOT / ".ci" / "run"]


def jobs(file: Path) -> dict[str, Any]:
    """Return the jobs of a workflow."""
    found: dict[str, Any] = yaml.safe_load(file.read_text())["jobs"]
    return found


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.stem)
def test_actions_are_pinned_by_hash(file: Path) -> None:
    """Each action is pinned by its hash, because a tag can be moved; the version is next to the hash."""
    used = re.findall(r"uses: *(.*)", file.read_text())
    assert used
    assert all(re.fullmatch(r"[\w.-]+/[\w.-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line) for line in used)


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.stem)
def test_rights_are_the_least(file: Path) -> None:
    """A job declares each permission beyond reading, and has a time limit or publishes."""
    assert yaml.safe_load(file.read_text())["permissions"] == {"contents": "read"}
    for job in jobs(file).values():
        assert "timeout-minutes" in job or len(job["steps"]) == 1


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.stem)
def test_expressions_reach_a_script_through_its_environment(file: Path) -> None:
    """The value of an expression must not become part of a script."""
    scripts = [step["run"] for job in jobs(file).values() for step in job["steps"] if "run" in step]
    assert scripts
    assert not any("${{" in script for script in scripts)


@pytest.mark.parametrize("file", SCRIPTS, ids=lambda file: file.name)
def test_commands_and_options_exist(file: Path) -> None:
    """Each word after bodycheck is a command, and each option belongs to its command."""
    lines = [
        shlex.split(line.split("||")[0].split(">")[0])
        for line in re.findall(r"^[^#\n]*?(?:bodycheck|\$bodycheck\") ([a-z]+ .*)$", file.read_text(), re.M)
    ]
    known: Any = get_command(commands.app)
    assert lines or file.name in ("release.yml", "tests.yml")
    for first, *words in lines:
        command, rest = known.commands[first], words
        if hasattr(command, "commands"):
            command, rest = command.commands[words[0]], words[1:]
        options = {name for option in command.params for name in option.opts}
        assert {word for word in rest if word.startswith("--")} <= options


def test_tests_run_on_every_supported_python() -> None:
    """The versions are those that the package supports."""
    tests = (jobs(_FOLDER / "tests.yml")["tests"], jobs(_FOLDER / "nightly.yml")["release"])
    assert all(job["strategy"]["matrix"]["python"] == ["3.11", "3.12", "3.13", "3.14"] for job in tests)


def test_nightly_workflow_runs_the_nightly_tests() -> None:
    """The workflow uses the marker of the project's settings."""
    steps = jobs(_FOLDER / "nightly.yml")["tests"]["steps"]
    assert steps[-1]["run"] == "python -m pytest -m nightly"


STUB = """#!/bin/bash
echo "python3 $*" >> log
mkdir -p .venv/bin
for name in pip python ruff mypy lint-imports sphinx-build bodycheck; do
    printf '#!/bin/bash\\necho "%s $*" >> log\\n[ "$FAILING" != "%s $*" ]\\n' $name $name > .venv/bin/$name
    chmod +x .venv/bin/$name
done
"""
"""A python3 that makes an environment whose commands only note that they were called."""


@pytest.mark.parametrize("failing", ["", "mypy ", "python -m pytest", "python -m pytest -m slow"])
def test_a_push_runs_the_command_of_the_readme(
    failing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CI installs, checks, runs the fast tests as the README does, then the slow ones; a failure ends it."""
    (readme,) = [
        line for line in (_ROOT / "README.md").read_text().splitlines() if line.endswith("-m pytest")
    ]
    (tmp_path / "README.md").write_text(readme + "\n")
    for name, text in {".ci/run": (_ROOT / ".ci/run").read_text(), "stub/python3": STUB}.items():
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text(text)
    (tmp_path / "stub/python3").chmod(0o755)
    (tmp_path / "stub/chromium").symlink_to("python3")
    monkeypatch.setenv("PATH", f"{tmp_path / 'stub'}:{os.environ['PATH']}")
    monkeypatch.setenv("FAILING", failing)
    done = subprocess.run(["bash", ".ci/run"], cwd=tmp_path, capture_output=True, text=True, check=False)
    called = (tmp_path / "log").read_text().splitlines()
    expected = ["python3 -m venv .venv", "pip install -e .[test]", "ruff check .", "ruff format --check ."]
    expected += ["mypy ", "lint-imports ", "sphinx-build -q -W --keep-going docs docs/_build"]
    expected += ["python -m pytest", "python -m pytest -m slow"]
    assert done.returncode == bool(failing)
    assert called[: len(expected)] == (expected[: expected.index(failing) + 1] if failing else expected)
