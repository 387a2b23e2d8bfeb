"""Additional output files of commands: an invalid one is refused before the run."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bodycheck._util.errors import InputError
from bodycheck.cli import commands
from tests.helpers.file_permissions import obey_file_permissions
from tests.helpers.in_process_cli import run_bodycheck

GATES = '[[gate]]\nmeasure = "outcome"\nequals = "ok"\nreason = "any"\n'
WRITING = {
    "--junit": ("gate", "smoke", "--gates", "gates.toml"),
    "--markdown": ("nightly", "smoke", "--history", "kept"),
}
PLACES = {
    "absent/told": "cannot be written: there is no folder",
    "gates.toml/told": "cannot be written: there is no folder",
    "/proc/told": "cannot be written: ",  # not writable even by root
    ".": "is a folder; name a file",
}


@pytest.mark.parametrize("option", WRITING)
@pytest.mark.parametrize("place", PLACES)
def test_unwritable_output_is_refused_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, place: str
) -> None:
    """One line names the option, the file and the error; nothing is run or written."""

    def never(*_: object, **__: object) -> None:
        raise AssertionError("something was run")

    monkeypatch.setattr("bodycheck.runs.runner.run_selection", never)
    monkeypatch.setattr("bodycheck.runs.selection.announcing", never)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "gates.toml").write_text(GATES)
    done = CliRunner().invoke(commands.app, [*WRITING[option], option, place])
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith(f"{option} {place}: {PLACES[place]}")
    assert "\n" not in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["gates.toml"]


@pytest.mark.slow
def test_unwritable_tolerance_file_is_refused_before_the_run(tmp_path: Path) -> None:
    """A file in a read-only folder gives one line and status 2 and is left unchanged."""
    (tmp_path / "gates.toml").write_text(GATES)
    tmp_path.chmod(0o555)
    words = ["gate", "smoke", "--gates", "gates.toml", "--update"]
    done = subprocess.run(
        [sys.executable, "-m", "bodycheck", *words],
        cwd=tmp_path,
        preexec_fn=obey_file_permissions,
        capture_output=True,
        text=True,
        check=False,
    )
    tmp_path.chmod(0o755)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "--update gates.toml: cannot be written: Permission denied\n"
    assert (tmp_path / "gates.toml").read_text() == GATES


ANSWERING = {
    "compare": ("compare", "run", "run", "--html", "a.html", "--markdown", "a.md"),
    "explain": ("explain", "run", "--markdown", "a.md"),
    "gate": ("gate", "--gates", "gates.toml", "--run", "run", "--junit", "a.xml", "--badge", "a.json"),
    "audit": ("audit", "arm.urdf", "--lint", "--html", "a.html", "--sarif", "a.sarif"),
}


@pytest.mark.parametrize("command", ANSWERING)
def test_files_that_were_asked_for_are_named_after_the_answer(
    command: str, stored_run: Path, tmp_path: Path
) -> None:
    """The last lines are their paths; standard output as JSON is JSON alone."""
    shutil.copytree(stored_run, tmp_path / "run")
    (tmp_path / "gates.toml").write_text(GATES)
    (tmp_path / "arm.urdf").write_text("<robot name='arm'><link name='base'/></robot>")
    words = ANSWERING[command]
    files = [word for word in words if word.startswith("a.")]
    answer = run_bodycheck(tmp_path, *words).stdout.splitlines()
    assert len(answer) > len(files)
    assert answer[-len(files) :] == files
    assert all((tmp_path / file).stat().st_size for file in files)
    json.loads(run_bodycheck(tmp_path, *words, "--json").stdout)
