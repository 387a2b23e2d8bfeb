"""Compile kernels ahead of use, so that neither a measurement nor a user waits for a compiler midway.

Modules with kernels are imported late: importing numba takes a second, which is saved if nothing is missing.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from bodycheck._util.compiled_cache import cache_directory
from bodycheck.reference_impl.scene import RigidBody, Scene, State

_UNDER_LASTING = "+lasting"
_CLOSED_FORMS = "closed-forms"


def compile_kernels(
    scenes: Iterable[Scene],
    integrators: Sequence[str] = (),
    is_solved: Callable[[Scene], bool] = lambda scene: False,  # noqa: ARG005 - called with each scene
) -> None:
    """Call the kernels of these scenes' truths and of the named integrators once.

    Another process compiles half of them in parallel. Kernels compiled before cost next to nothing, and
    nothing at all if none is missing and is_solved reports that the scene's truth was solved before.
    """
    scenes = list(scenes)
    names = [*[_CLOSED_FORMS] * any(scene.is_free_rotation for scene in scenes), *integrators]
    if any(scene.lasting_loads for scene in scenes):
        names += [name + _UNDER_LASTING for name in integrators]
    marks = [_mark(name) for name in names]
    missing = [name for name, mark in zip(names, marks, strict=True) if not mark.exists()]
    words = [sys.executable, "-m", __name__, *missing]
    # in a session of its own: a keyboard interrupt reaches this process only, which then ends the other
    other = subprocess.Popen(words, start_new_session=True) if missing else None
    try:
        closed_last = sorted(scenes, key=lambda scene: scene.is_free_rotation)
        if _CLOSED_FORMS in missing:
            from bodycheck.reference_impl.free_rotation.precompilation import compile_tumbling

            compile_tumbling()
        for scene in closed_last:
            if other is None and is_solved(scene):
                continue
            if other is not None and scene.is_free_rotation:
                _wait_for(marks[0], other)  # the closed forms
            _solve_shortly(scene)
        if other is not None:
            other.wait()
    finally:
        if other is not None:
            other.kill()
            other.wait()


def _solve_shortly(scene: Scene) -> None:
    from bodycheck.reference_impl.truth.certification import solve_truth

    solve_truth(scene, np.array([0.0, 1e-3 * scene.sample_interval_s]))


def closed_forms_compiled() -> bool:
    """Whether the closed forms of a free body, the most expensive kernels to compile, are compiled here."""
    return _mark(_CLOSED_FORMS).exists()


def _mark(name: str) -> Path:
    return cache_directory() / f"{name}.compiled"


def _wait_for(mark: Path, other: subprocess.Popen[bytes]) -> None:
    """Wait until the other process has written the marker file or has ended without writing it."""
    while not mark.exists() and other.poll() is None:
        time.sleep(0.05)


def _compile_here(names: Iterable[str]) -> None:
    """Compile the named kernels one after the other and write a marker file for each."""
    for name in names:
        if name == _CLOSED_FORMS:
            from bodycheck.reference_impl.free_rotation.precompilation import compile_frame_and_evaluation

            compile_frame_and_evaluation()
            _compile_flight()
        else:
            _compile_integrator(name)
        mark = _mark(name)
        with suppress(OSError):  # the cache folder may be read-only
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()


def _compile_flight() -> None:
    from bodycheck.reference_impl.closed_forms.flight import Flight
    from bodycheck.reference_impl.closed_forms.piecewise_constant_loads import loads_of

    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    scene = Scene(RigidBody(1.0, np.eye(3)), start, (), np.zeros(3), 1.0, 2)
    loads = loads_of(scene)
    flight = None if loads is None else Flight.of(scene, loads)
    assert flight is not None
    flight.at(scene.sample_times)


def _compile_integrator(name: str) -> None:
    """Make one step, under continuous loads if the name says so."""
    from bodycheck.reference_impl.integrators import INTEGRATORS
    from bodycheck.reference_impl.integrators.right_hand_sides import packed_body

    integrator = INTEGRATORS[name.removesuffix(_UNDER_LASTING)]
    attitude = np.eye(3).ravel() if integrator.attitude == "matrix" else np.array([1.0, 0.0, 0.0, 0.0])
    state = np.concatenate([np.zeros(6), np.ones(3), attitude])
    body = packed_body(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])))
    if name.endswith(_UNDER_LASTING):
        integrator.advance_forced(state, body, np.zeros(21), np.zeros(0), 0.0, 1e-3, 1)
    else:
        integrator.advance(state, body, np.zeros(21), 1e-3, 1)


if __name__ == "__main__":
    _compile_here(sys.argv[1:])
