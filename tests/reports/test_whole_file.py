"""Files and folders of results are written completely, and the umask determines who may read them."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from bodycheck._util.files import atomic_write
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import SCENARIO


@pytest.fixture(params=[0o077, 0o022, 0o027])
def umask(request: pytest.FixtureRequest) -> Iterator[int]:
    """Set a umask for a test."""
    before = os.umask(request.param)
    yield request.param
    os.umask(before)


def mode(path: Path) -> int:
    """Return the permissions of a file or a folder."""
    return stat.S_IMODE(path.stat().st_mode)


def test_file_has_the_mode_of_any_new_file(umask: int, tmp_path: Path) -> None:
    """The permissions are exactly those that the umask leaves, and no other file stays next to the result."""
    for content in (b"first", b"second"):
        atomic_write(tmp_path / "table.csv", content)
        assert (tmp_path / "table.csv").read_bytes() == content
    assert mode(tmp_path / "table.csv") == 0o666 & ~umask
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]


@pytest.mark.slow
def test_run_of_a_path_that_is_not_utf8_is_stored_and_named(tmp_path: Path) -> None:
    """The command of each case can be run again as printed; folders and files have the modes of the umask."""
    name = os.fsdecode(b"caf\xe9.toml")
    (tmp_path / name).write_text(SCENARIO)
    before = os.umask(0o077)
    try:
        words = ["--engine", "reference:m1", "--dt", "0.05", "--no-speed", "--out", os.fsdecode(b"out\xff")]
        done = run_bodycheck(tmp_path, "run", name, *words)
    finally:
        os.umask(before)
    assert done.returncode == 0, done.stderr
    out = tmp_path / os.fsdecode(b"out\xff")
    assert mode(out) == 0o700
    assert {mode(path) for path in out.rglob("*") if path.is_file()} == {0o600}
    (line,) = (out / "results.csv").read_text().splitlines()[1:]
    assert r"bodycheck run $'caf\xe9.toml' --engine reference:m1 --dt 0.05" in line
    again = run_bodycheck(tmp_path, "report", os.fsdecode(b"out\xff"))
    assert again.returncode == 0, again.stderr
