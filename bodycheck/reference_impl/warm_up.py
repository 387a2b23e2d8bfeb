"""Compiling kernels ahead of use, so that no measurement and no user waits for a compiler midway."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable, Sequence

import numpy as np

from bodycheck.reference_impl.equations import packed_body
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.jit import cache_directory
from bodycheck.reference_impl.scene import RigidBody, Scene
from bodycheck.reference_impl.truth import solve_truth

_UNDER_LASTING = "+lasting"


def compile_kernels(scenes: Iterable[Scene], integrators: Sequence[str]) -> None:
    """Call the kernels of these scenes' truths, and those of the integrators named, once.

    The integrators are compiled by another process meanwhile. What was compiled before costs next to nothing.
    """
    scenes = list(scenes)
    names = list(integrators)
    if any(scene.lasting_loads for scene in scenes):
        names += [name + _UNDER_LASTING for name in integrators]
    marks = [cache_directory() / f"{name}.compiled" for name in names]
    missing = not all(mark.exists() for mark in marks)
    words = [sys.executable, "-m", __name__, *names]
    # in a session of its own: an interrupt from the keyboard is for this process, which then ends the other
    other = subprocess.Popen(words, start_new_session=True) if missing else None
    try:
        for scene in scenes:
            solve_truth(scene, np.array([0.0, 1e-3 * scene.sample_interval_s]))
        if other is not None and other.wait() == 0:
            for mark in marks:
                mark.touch()
    finally:
        if other is not None:
            other.kill()


def compile_integrators(names: Iterable[str]) -> None:
    """Make one step with each integrator; under lasting loads where the name ends so."""
    for name in names:
        integrator = INTEGRATORS[name.removesuffix(_UNDER_LASTING)]
        attitude = np.eye(3).ravel() if integrator.attitude == "matrix" else np.array([1.0, 0.0, 0.0, 0.0])
        state = np.concatenate([np.zeros(6), np.ones(3), attitude])
        body = packed_body(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])))
        if name.endswith(_UNDER_LASTING):
            integrator.advance_under(state, body, np.zeros(21), np.zeros(0), 0.0, 1e-3, 1)
        else:
            integrator.advance(state, body, np.zeros(21), 1e-3, 1)


if __name__ == "__main__":
    compile_integrators(sys.argv[1:])
