"""The workflow of docs/pull-requests.md: its shell steps, run in a repository with an engine in C."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from bodycheck.runs.new_adapter import new_adapter

PAGE = Path(__file__).parents[1] / "docs/pull-requests.md"
WORKFLOW: dict[Any, Any] = yaml.safe_load(
    re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)[0]
)
MAKEFILE = "build/engine: engine.c\n\tmkdir -p build && cc -O2 -o $@ engine.c -lm\n"
GATES = """# bounds of the engine

[[gate]]
scenario = "free-flight"
dt_s = 1e-3
measure = "orientation_error_rad"
upper = 9e-3
reason = "explicit Euler is off by 8.2 mrad"
"""
COMMIT = "git -c user.name=me -c user.email=me@example.org commit --quiet --message accepted"
RIGHT, FAULT = "* torque[i % 3];", "* 0.9 * torque[i % 3];"


def test_workflow_is_pinned_and_has_the_least_permissions() -> None:
    """As the workflows of this repository; expressions reach a script through its environment only."""
    assert WORKFLOW["permissions"] == {"contents": "read"}
    steps = [step for job in WORKFLOW["jobs"].values() for step in job["steps"]]
    assert all("timeout-minutes" in job for job in WORKFLOW["jobs"].values())
    used = re.findall(r"uses: *(.*)", PAGE.read_text())
    assert len(used) == sum("uses" in step for step in steps)
    assert all(re.fullmatch(r"[\w.-]+/[\w.-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line) for line in used)
    assert not any("${{" in step.get("run", "") for step in steps)


@dataclass
class Result:
    """The steps of a job that were run, the last of which may have failed, and what they printed."""

    names: list[str] = field(default_factory=list)
    output: str = ""
    failed: bool = False

    @property
    def annotations(self) -> list[str]:
        """The annotations of all steps."""
        return [line for line in self.output.splitlines() if line.startswith("::")]


@dataclass(frozen=True)
class Repository:
    """A checkout of an engine's repository, in which jobs run as on GitHub."""

    folder: Path

    def git(self, *words: str) -> str:
        """Run git, and return what it prints."""
        identity = ("-c", "user.name=me", "-c", "user.email=me@example.org")
        done = subprocess.run(
            ["git", *identity, *words], cwd=self.folder, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    def commit(self, old: str = "", new: str = "") -> str:
        """Commit the files, with a text in the engine replaced, and return the commit."""
        source = self.folder / "engine.c"
        assert source.read_text().count(old) >= 1
        source.write_text(source.read_text().replace(old, new))
        self.git("add", "engine.c", "Makefile", "physics.toml")
        self.git("commit", "--quiet", "--allow-empty", "--message", "a change")
        return self.git("rev-parse", "HEAD")

    def run(self, job: str, values: Mapping[str, str]) -> Result:
        """Run the steps of a job until one fails; values: of the expressions in the environment of steps."""
        output = self.folder.parent / "output"
        output.write_text("")
        for name in ("base", "repository/before", "repository/after", "repository/history"):
            shutil.rmtree(self.folder.parent / name, ignore_errors=True)
        self.git("worktree", "prune")
        result = Result()
        for step in WORKFLOW["jobs"][job]["steps"]:
            if "run" not in step or step["name"] == "Install bodycheck":
                continue
            set_by_steps = re.findall(r"^(\w+)=(.*)$", output.read_text(), flags=re.MULTILINE)
            given = {**values, **{name.upper(): value for name, value in set_by_steps}}
            done = subprocess.run(
                ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
                cwd=self.folder,
                env={
                    **os.environ,
                    "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
                    "GITHUB_WORKSPACE": str(self.folder),
                    "GITHUB_SHA": self.git("rev-parse", "HEAD"),
                    "GITHUB_STEP_SUMMARY": str(self.folder.parent / "summary.md"),
                    "GITHUB_OUTPUT": str(output),
                    **{name: given[name] for name in step.get("env", {})},
                },
                capture_output=True,
                text=True,
                check=False,
            )
            result.names.append(step["name"])
            result.output += done.stdout + done.stderr
            if done.returncode:
                result.failed = True
                break
        return result


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Repository:
    """Return a repository with an engine in C, its Makefile and its bounds."""
    for program in ("git", "make", "cc"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    monkeypatch.chdir(tmp_path)
    folder, _ = new_adapter("engine", "c")
    made = tmp_path / "repository"
    folder.rename(made)
    (made / "Makefile").write_text(MAKEFILE)
    (made / "physics.toml").write_text(GATES)
    found = Repository(made)
    found.git("init", "--quiet", "--initial-branch", "main")
    return found


@pytest.mark.nightly
def test_pull_request_fails_on_a_fault_and_passes_after_acceptance(repository: Repository) -> None:
    """One annotation names method, change, cause and commits; the label and a changed bound accept it."""
    base = repository.commit()
    clean = repository.run("pull-request", {"BASE": base, "FAIL_ON": "worse"})
    assert not clean.failed, clean.output
    assert clean.annotations == []
    broken = repository.commit(RIGHT, FAULT)
    failed = repository.run("pull-request", {"BASE": base, "FAIL_ON": "worse"})
    assert (failed.failed, failed.names[-1]) == (True, "Compare"), failed.output
    (line,) = failed.annotations
    assert line.startswith("::error title=bodycheck compare::engine:euler: "), line
    assert "the gyroscopic term omega x I omega is multiplied by 0.9" in line
    assert f"in commits {base[:10]}..{broken[:10]}" in line
    labelled = repository.run("pull-request", {"BASE": base, "FAIL_ON": "never"})
    assert (labelled.failed, labelled.names[-1]) == (True, "Check the bounds"), labelled.output
    assert [line.split(" ")[0] for line in labelled.annotations] == ["::warning", "::error"]
    assert "file=physics.toml,line=3" in labelled.annotations[1]
    bodycheck = [sys.executable, "-m", "bodycheck"]
    loosened = [*bodycheck, "gate", "--gates", "physics.toml", "--run", "after", "--update"]
    subprocess.run([*loosened, "--loosen", "scaled on purpose"], cwd=repository.folder, check=True)
    repository.commit()
    accepted = repository.run("pull-request", {"BASE": base, "FAIL_ON": "never"})
    assert not accepted.failed, accepted.output
    assert "scaled on purpose" in (repository.folder / "physics.toml").read_text()


@pytest.mark.nightly
def test_history_of_the_main_branch_fails_until_the_change_is_accepted(repository: Repository) -> None:
    """The first run passes without a baseline; the annotation has the command that accepts the fault."""
    bare = repository.folder.parent / "bare.git"
    subprocess.run(["git", "init", "--quiet", "--bare", str(bare)], check=True)
    values = {"REPOSITORY": str(bare)}
    good = repository.commit()
    first = repository.run("history", values)
    assert (first.failed, first.annotations) == (False, []), first.output
    broken = repository.commit(RIGHT, FAULT)
    failed = repository.run("history", values)
    assert (failed.failed, failed.names[-1]) == (True, "Fail while a regression is open"), failed.output
    (line,) = failed.annotations
    assert line.startswith("::error title=bodycheck nightly::engine:euler: "), line
    assert "the gyroscopic term omega x I omega is multiplied by 0.9" in line
    assert f"in commits {good[:10]}..{broken[:10]}" in line
    command = line.rpartition("to accept it: ")[2].replace("TEXT", "'scaled on purpose'")
    accept = (
        f"set -e; {command}; cd history; git add --all; {COMMIT}; git push -q {bare} HEAD:physics-history"
    )
    env = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    subprocess.run(["bash", "-c", accept], cwd=repository.folder, env=env, check=True)
    accepted = repository.run("history", values)
    assert (accepted.failed, accepted.annotations) == (False, []), accepted.output
