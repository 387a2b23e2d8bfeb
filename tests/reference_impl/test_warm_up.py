"""Compiling ahead: what is missing is compiled, and nothing else is gone through."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bodycheck.reference_impl import precompile
from bodycheck.reference_impl.scene import RigidBody, Scene, State

START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 1.0, 0.2]))
SCENES = [Scene(RigidBody(mass, np.eye(3)), START, (), np.zeros(3), 1.0, 3) for mass in (1.0, 2.0)]


@pytest.mark.parametrize("missing", [False, True])
def test_a_scene_whose_truth_is_solved_needs_no_kernels_unless_some_are_missing(
    missing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all compiled only the unsolved scene's truth is called; with anything missing, every scene's."""
    called: list[Scene] = []

    class Finished:
        """Another process that has compiled its half."""

        def wait(self) -> None:
            """Have nothing to wait for."""

        def kill(self) -> None:
            """Have nothing to end."""

        def poll(self) -> int:
            """Have ended."""
            return 0

    monkeypatch.setattr(precompile, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr(precompile, "_solve_shortly", called.append)
    monkeypatch.setattr(precompile.subprocess, "Popen", lambda *_, **__: Finished())
    for name in ("closed-forms", "m1"):
        (tmp_path / f"{name}.compiled").touch()
    integrators = ["m1", "m2"] if missing else ["m1"]
    precompile.compile_kernels(SCENES, integrators, lambda scene: scene is SCENES[0])
    assert called == (SCENES if missing else SCENES[1:])


def test_a_folder_that_cannot_be_written_keeps_no_marks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels are compiled all the same, and the process that does so ends well."""
    compiled: list[str] = []
    (tmp_path / "file").touch()
    monkeypatch.setattr(precompile, "cache_directory", lambda: tmp_path / "file" / "kernels")
    monkeypatch.setattr(precompile, "_compile_integrator", compiled.append)
    precompile._compile_here(["m1", "m2"])
    assert compiled == ["m1", "m2"]
