"""Files of strangers: regular ones only, of limited size, whose paths are no patterns."""

from __future__ import annotations

import ast
import json
import os
import shutil
import socket
from pathlib import Path

import pytest

import bodycheck
from tests.helpers.child_process import run_in_child
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

PACKAGE = Path(bodycheck.__file__).parent
LIMIT_S = 60.0

OPENERS = {
    "_util/file_digests.py": "installed packages and the user's cache",
    "_util/files.py": "what is written",
    "_util/platform_identity.py": "/proc",
    "_util/untrusted.py": "the function that opens all others",
    "adapters/optional/javascript.py": "package data",
    "adapters/registry.py": "installed packages",
    "adapters/versions/environments.py": "the user's cache",
    "adapters/versions/uv.py": "the user's settings",
    "adapters/workers/build_identity.py": "/proc and installed packages",
    "adapters/workers/launcher.py": "/proc",
    "adapters/workers/worker.py": "the user's own script",
    "cli/_app.py": "the null device",
    "reference_impl/kernels/cache_files.py": "the user's cache",
    "reports/alerts.py": "the summary of a job of GitHub Actions",
    "reports/cache/disk_cache.py": "the user's cache",
    "reports/cache/journal.py": "a file that was checked",
    "examine/explanation/explanation_document.py": "package data",
    "reports/history/archive.py": "locks and folders",
    "reports/history/baseline.py": "a run that this command has written",
    "recordings/column_map.py": "package data",
    "reports/render/movie.py": "what this command has written",
    "reports/run_files/sentinels.py": "what is written",
    "reports/run_files/tables.py": "what this command has written",
    "reports/templating.py": "package data",
    "runs/new_adapter.py": "package data",
    "scenarios/library.py": "package data",
    "scenarios/mesh_files/__init__.py": "package data",
    "scenarios/shapes.py": "the user's cache",
}
"""Files that open something beside `open_input` -> what."""


@pytest.mark.slow
def test_every_file_that_opens_something_is_listed() -> None:
    """A module that opens files fails this test until OPENERS states why no stranger names them."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.Call):
                continue
            name = ast.unparse(node.func)
            plain = name in ("open", "os.open", "io.open")
            method = name.rpartition(".")[2] in ("open", "read_bytes", "read_text") and "." in name
            if plain or (method and not name.startswith(("untrusted.", "archive.open", "self.open"))):
                found.add(path.relative_to(PACKAGE).as_posix())
    assert found == set(OPENERS)


def pipe(path: Path) -> None:
    """Put a pipe that nobody writes in the place of a file."""
    os.mkfifo(path)


def device(path: Path) -> None:
    """Put a link to a device without end in the place of a file."""
    path.symlink_to("/dev/zero")


def socket_file(path: Path) -> None:
    """Put a socket in the place of a file."""
    with socket.socket(socket.AF_UNIX) as one:
        here = Path.cwd()
        os.chdir(path.parent)  # the name of a socket is short
        try:
            one.bind(path.name)
        finally:
            os.chdir(here)


KINDS = {"pipe": pipe, "device": device, "socket": socket_file}
JUDGE = ["judge", "FILE", "--scenario", "mine.toml"]
_RECORDINGS = (".csv", ".npz", ".parquet", ".jsonl", ".mcap", ".txt", ".aem")
READERS: dict[str, list[str]] = {
    "scenario.toml": ["truth", "FILE", "--at", "0"],
    "gates.toml": ["gate", "mine.toml", "--gates", "FILE"],
    "thresholds.toml": ["compare", "run", "run", "--thresholds", "FILE"],
    "map.toml": ["judge", "motion.csv", "--scenario", "mine.toml", "--map", "FILE"],
    "engines.toml": ["run", "mine.toml", "--engines", "FILE", "--allow-code"],
    "style": ["plot", "run", "--figure", "order", "--scenario", "free", "--svg", "x.svg", "--style", "FILE"],
    **{
        f"motion{suffix}": JUDGE for suffix in (".csv", ".npz", ".parquet", ".jsonl", ".mcap", ".txt", ".aem")
    },
    **{f"part{s}": ["body", "FILE", "--density-kg-m3", "1"] for s in (".stl", ".obj", ".ply", ".off")},
    **{f"robot{suffix}": ["audit", "FILE", "--lint"] for suffix in (".urdf", ".xml", ".sdf")},
    "run/manifest.json": ["explain", "run"],
    "run/results.csv": ["table", "run"],
    "run/methods.csv": ["table", "run", "methods"],
    "run/read_back.json": ["explain", "run"],
    "run/trajectories/free/truth.npz": ["explain", "run"],
    "out.partial/request.json": ["run", "--resume", "out"],
    "out.partial/journal": ["run", "--resume", "out"],
    "nights/0/night.json": ["history", "list", "nights"],
    "nights/0/results.csv": ["history", "query", "nights", "SELECT count(*) FROM results"],
}
"""File -> the command that reads it."""


@pytest.fixture
def folder(tmp_path: Path, stored_run: Path, stored_history: Path) -> Path:
    """Return a folder with a scenario, a motion, a run, an interrupted run and a history."""
    (tmp_path / "mine.toml").write_text(tumbling())
    (tmp_path / "motion.csv").write_text("t_s,x_m\n0,0\n1,0\n2,0\n")
    shutil.copytree(stored_run, tmp_path / "run")
    shutil.copytree(stored_history, tmp_path / "nights")
    (tmp_path / "out.partial").mkdir()
    request = {"scenarios": ["mine.toml"], "engines": ["reference:rk4"], "dt_s": [0.1], "speed": False}
    description = {"run_id": "x", "created": "2026-01-01T00:00:00+00:00", "request": request}
    (tmp_path / "out.partial/request.json").write_text(json.dumps(description))
    return tmp_path


@pytest.mark.slow(after=2)
@pytest.mark.nightly(after=3)
@pytest.mark.parametrize(
    "kind", ["pipe", *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS if kind != "pipe")]
)
@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_regular_file_is_refused_in_one_line(reader: str, kind: str, folder: Path) -> None:
    """No reader waits for a pipe or reads a device; a line names the file, and a history excludes its run."""
    path = folder / reader
    if "/0/" in reader:
        first = min(one for one in (folder / "nights").iterdir() if (one / "night.json").exists())
        path = first / path.name
    path.unlink(missing_ok=True)
    KINDS[kind](path)
    words = [str(path.relative_to(folder)) if word == "FILE" else word for word in READERS[reader]]
    ended = run_in_child(lambda: run_bodycheck(folder, *words), LIMIT_S, limit_megabytes=8192)
    assert ended.error is None
    done = ended.value
    assert done.returncode in ((1, 2) if "nights" in reader else (2,)), done.stderr
    assert "not a regular file" in done.stderr
    assert path.name in done.stderr
