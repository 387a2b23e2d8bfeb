"""Precompilation: missing kernels are compiled, and nothing else is computed."""

from __future__ import annotations

import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from bodycheck.reference_impl import precompile
from bodycheck.reference_impl.scene import RigidBody, Scene, State

START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 1.0, 0.2]))
SCENES = [Scene(RigidBody(mass, np.eye(3)), START, (), np.zeros(3), 1.0, 3) for mass in (1.0, 2.0)]


class Finished:
    """Another process that has ended without compiling a kernel."""

    def poll(self) -> int:
        """Return the status of a process that has ended."""
        return 0


@pytest.mark.parametrize("missing", [False, True])
def test_solved_scene_needs_no_kernels(
    missing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all kernels compiled only unsolved truths are computed; with any missing, every truth is.

    Kernels are reported only if some are compiled: those of m2, which the other process did not compile.
    """
    called: list[Scene] = []

    @contextmanager
    def second_process(waiting: deque[str]) -> Iterator[Finished]:
        assert list(waiting) == ["m2"]
        yield Finished()

    monkeypatch.setattr(precompile, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr(precompile, "_solve_shortly", lambda scene, _: called.append(scene))
    monkeypatch.setattr(precompile, "_second_process", second_process)
    monkeypatch.setattr(precompile, "_compile_integrator", lambda _: None)
    for name in ("frames", "tumbling", "m1"):
        (tmp_path / f"{name}.compiled").touch()
    integrators = ["m1", "m2"] if missing else ["m1"]
    reported: list[tuple[int, int]] = []
    precompile.compile_kernels(
        SCENES,
        integrators,
        SCENES[1:],
        compiled=lambda done, total: reported.append((done, total)),
    )
    assert called == (SCENES if missing else SCENES[1:])
    assert reported == ([(0, 4)] if missing else [])
    assert (tmp_path / "m2.compiled").exists() == missing


@pytest.mark.slow
def test_two_processes_share_the_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each name is compiled by one of the two processes, and the other process ends when no name is left."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path))
    waiting = deque(["m1", "m3", "quaternion-euler", "lie-euler"])
    with precompile._second_process(waiting) as other:
        here = precompile._next(waiting)
        assert other.wait(timeout=120.0) == 0
    names = {path.stem for path in tmp_path.rglob("*.compiled")}
    assert names == {"m1", "m3", "quaternion-euler", "lie-euler"} - {here}
    assert not waiting


SOLVES = """
from bodycheck.adapters.reference import Reference
from bodycheck.scenarios.library import load_scenario

for name in ("intermediate-axis", "world-torque", "satellite-libration", "sine-torque"):
    scene = load_scenario(name).scene
    Reference().solver(scene, "taylor", 1e-15).solve()
"""


@pytest.mark.nightly
def test_taylor_solver_compiles_nothing_in_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All kernels of the solver were compiled ahead, with and without torques."""
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(tmp_path))
    with precompile._second_process(deque(["taylor"])) as other:
        assert other.wait(timeout=120.0) == 0
    compiled = set(tmp_path.rglob("*.nbc"))
    subprocess.run([sys.executable, "-c", SOLVES], check=True)
    assert compiled
    assert set(tmp_path.rglob("*.nbc")) == compiled


def test_unwritable_cache_does_not_stop_precompilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels are compiled, and no marker file is written."""
    compiled: list[str] = []
    (tmp_path / "file").touch()
    monkeypatch.setattr(precompile, "cache_directory", lambda: tmp_path / "file" / "kernels")
    monkeypatch.setattr(precompile, "_compile_integrator", compiled.append)
    for name in ("m1", "m2"):
        precompile._compile_here(name)
    assert compiled == ["m1", "m2"]
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
