"""Where compiled kernels are stored: never next to the sources, even if the cache cannot be written."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from bodycheck._util import compiled_cache
from bodycheck._util.compiled_cache import cache_directory

COMPILING = """
from bodycheck._util.compiled_cache import cache_directory
from bodycheck.reference_impl.kernels.double_double import two_sum
two_sum(1.0, 1e-20)
print(cache_directory(), len([*cache_directory().rglob("*.nbi")]))
"""


@pytest.fixture
def fresh_cache(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Search for the folder as a new process does."""
    monkeypatch.setenv(compiled_cache.KERNELS_FOR_NOW, "")
    cache_directory.cache_clear()
    yield
    cache_directory.cache_clear()


@pytest.mark.usefixtures("fresh_cache")
def test_writable_cache_is_used_silently(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The cache is created if missing, within the folder that the user names."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path / "new"))
    assert cache_directory().is_dir()
    assert cache_directory().parent == tmp_path / "new" / "kernels"
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("fresh_cache")
def test_processes_of_a_command_share_a_temporary_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first process prints one line; the processes that it starts use its folder and print nothing."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path / "file"))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    first = cache_directory()
    assert capsys.readouterr().err == (
        f"{tmp_path / 'file'}: cannot be written: Not a directory; "
        "compiled code is cached for this command only\n"
    )
    assert first.parent == tmp_path
    cache_directory.cache_clear()
    assert cache_directory() == first
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_nothing_is_written_next_to_the_sources(tmp_path: Path) -> None:
    """numba would write there by default; the temporary folder is removed when the process ends."""
    (tmp_path / "file").touch()
    (tmp_path / "room").mkdir()
    sources = Path(compiled_cache.__file__).parents[1]
    before = {path: path.stat().st_mtime_ns for path in sources.rglob("*.nb?")}
    surroundings = {
        **os.environ,
        "BODYCHECK_CACHE_DIR": str(tmp_path / "file"),
        "TMPDIR": str(tmp_path / "room"),
        compiled_cache.KERNELS_FOR_NOW: "",
    }
    done = subprocess.run(
        [sys.executable, "-c", COMPILING], env=surroundings, capture_output=True, text=True, check=True
    )
    folder, compiled = done.stdout.split()
    assert Path(folder).parent == tmp_path / "room"
    assert int(compiled) > 0
    assert {path: path.stat().st_mtime_ns for path in sources.rglob("*.nb?")} == before
    assert [*(tmp_path / "room").iterdir()] == []
