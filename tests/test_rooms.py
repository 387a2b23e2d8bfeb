"""Rooms: packages that nothing but their own commands imports."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = {"audit": "audit_command.py", "ensembles": "ensemble_commands.py"}
_IMPORT_ALL = """
import importlib, pathlib, pkgutil, sys
import bodycheck
assert bodycheck.__path__ == [str(pathlib.Path.cwd() / "bodycheck")], bodycheck.__path__
outside = {"bodycheck.__main__"} | {f"bodycheck.adapters.{kind}" for kind in ("optional", "importers")}
for module in pkgutil.walk_packages(bodycheck.__path__, "bodycheck."):
    if not module.name.startswith(tuple(outside)) and ".usd" not in module.name:
        importlib.import_module(module.name)
"""


@pytest.mark.slow
def test_rooms_can_be_deleted(tmp_path: Path) -> None:
    """Without the rooms and their commands, every module can be imported, and a run and its answers work."""
    package = tmp_path / "bodycheck"
    shutil.copytree(ROOT / "bodycheck", package, ignore=shutil.ignore_patterns("__pycache__"))
    for room, commands in ROOMS.items():
        shutil.rmtree(package / room)
        (package / "cli/rooms" / commands).unlink()
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}

    def python(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True
        )

    imported = python("-c", _IMPORT_ALL)
    assert imported.returncode == 0, imported.stderr
    smoke = "run", "smoke", "--engine", "reference:m1,mujoco:euler", "--no-speed", "--out", "run"
    ended = python("-m", "bodycheck", *smoke)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "run/report.html").exists()
    commands = python("-m", "bodycheck", "--help").stdout
    assert "judge" in commands
    assert not any(f"\n  {name} " in commands for name in ("audit", "ensemble", "hunt"))
    refused = python("-m", "bodycheck", "versions", "mujoco", "--since", "3.6", "--audit", "arm.urdf")
    assert (refused.returncode, "--audit" in refused.stderr) == (2, True)
