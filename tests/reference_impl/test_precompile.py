"""Precompilation: kernels that are missing are compiled, and nothing else is computed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bodycheck.reference_impl import precompile
from bodycheck.reference_impl.scene import RigidBody, Scene, State

START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.3, 1.0, 0.2]))
SCENES = [Scene(RigidBody(mass, np.eye(3)), START, (), np.zeros(3), 1.0, 3) for mass in (1.0, 2.0)]


@pytest.mark.parametrize("missing", [False, True])
def test_solved_scene_needs_no_kernels(
    missing: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all kernels compiled only unsolved truths are computed; with any missing, every truth.

    Kernels are reported only where some are compiled: those of m2.
    """
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
    monkeypatch.setattr(precompile, "_solve_shortly", lambda scene, _: called.append(scene))
    monkeypatch.setattr(precompile.subprocess, "Popen", lambda *_, **__: Finished())
    for name in ("closed-forms", "m1"):
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


def test_unwritable_cache_does_not_stop_precompilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels are compiled, and the process ends with status 0."""
    compiled: list[str] = []
    (tmp_path / "file").touch()
    monkeypatch.setattr(precompile, "cache_directory", lambda: tmp_path / "file" / "kernels")
    monkeypatch.setattr(precompile, "_compile_integrator", compiled.append)
    precompile._compile_here(["m1", "m2"])
    assert compiled == ["m1", "m2"]
