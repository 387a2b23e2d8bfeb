"""The files that commands write beside what they print: refused before the run, not after it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner
from unprivileged import heed_modes

from bodycheck._util.errors import InputError
from bodycheck.cli import commands

GATES = '[[gate]]\nmeasure = "outcome"\nequals = "ok"\nreason = "any"\n'
WRITING = {
    "--junit": ("gate", "smoke", "--tolerances", "gates.toml"),
    "--json": ("gate", "smoke", "--tolerances", "gates.toml"),
    "--markdown": ("nightly", "smoke", "--history", "kept"),
}
PLACES = {
    "absent/told": "cannot be written: there is no folder",
    "gates.toml/told": "cannot be written: there is no folder",
    "/proc/told": "cannot be written: ",  # where nobody can, root neither
    ".": "is a folder; name a file",
}


@pytest.mark.parametrize("option", WRITING)
@pytest.mark.parametrize("place", PLACES)
def test_an_output_that_cannot_be_written_is_told_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, place: str
) -> None:
    """One line names the option, the file and what is wrong; nothing is run, and nothing is written."""

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


def test_bounds_that_cannot_be_replaced_are_told_before_the_run(tmp_path: Path) -> None:
    """The folder of the tolerance file is read-only: one line, status 2, the file as it was."""
    (tmp_path / "gates.toml").write_text(GATES)
    tmp_path.chmod(0o555)
    words = ["gate", "smoke", "--tolerances", "gates.toml", "--update"]
    done = subprocess.run(
        [sys.executable, "-m", "bodycheck", *words],
        cwd=tmp_path,
        preexec_fn=heed_modes,
        capture_output=True,
        text=True,
        check=False,
    )
    tmp_path.chmod(0o755)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "--update gates.toml: cannot be written: Permission denied\n"
    assert (tmp_path / "gates.toml").read_text() == GATES
