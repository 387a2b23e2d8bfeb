"""Compile kernels ahead of use, so that neither a measurement nor a user waits for a compiler midway.

Modules with kernels are imported late: importing numba takes a second, which is saved if nothing is missing.
"""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType

import numpy as np

from bodycheck._util.compiled_cache import cache_directory
from bodycheck.reference_impl.scene import RigidBody, Scene, State

_WITH_CONTINUOUS_LOADS = "+continuous"
_CLOSED_FORMS = "closed-forms"
_INTERPRETED_S, _INTERPRETED_SAMPLE_S = 0.05, 2e-3  # of a truth of a free body, and of each of its samples
_COMPILING_S = 5.0  # half of what the closed forms take to compile
_interpreted_s = 0.0


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Suspend the collector of cycles, which takes a tenth of the time of a compilation and frees little."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@_without_garbage_collection()
def compile_kernels(
    scenes: Iterable[Scene],
    integrators: Sequence[str] = (),
    unsolved: Sequence[Scene] | None = None,
    *,
    never_cached: Mapping[str, Scene] = MappingProxyType({}),
    compiled: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005 - called with both
) -> None:
    """Call the kernels of these scenes' truths and of the named integrators once.

    unsolved: the scenes whose truths are still to be solved [default: all]. never_cached: further scenes by
    name. compiled: called with the number of kernels done and of those expected, only while something is
    compiled.

    Another process compiles half of them in parallel. Kernels compiled before cost next to nothing, and
    nothing at all if none is missing and all truths were solved before.
    """
    scenes = list(scenes)
    names = [*[_CLOSED_FORMS] * any(scene.is_free_rotation for scene in scenes), *integrators]
    if any(scene.continuous_loads for scene in scenes):
        names += [name + _WITH_CONTINUOUS_LOADS for name in integrators]
    probes = {name: scene for name, scene in never_cached.items() if not _mark(name).exists()}
    marks = [_mark(name) for name in names]
    missing = [name for name, mark in zip(names, marks, strict=True) if not mark.exists()]
    command = [sys.executable, "-m", __name__, *missing]
    # in a session of its own: a keyboard interrupt reaches this process only, which then ends the other
    other = subprocess.Popen(command, start_new_session=True) if missing else None
    before, expected = _stored_kernels(), _expected_kernels(missing, scenes)

    def report() -> None:
        done = _stored_kernels() - before
        compiled(done, max(expected, done))

    if missing:
        report()
    try:
        solving = scenes if unsolved is None or other is not None else unsolved
        closed_last = sorted(solving, key=lambda scene: scene.is_free_rotation)
        if _CLOSED_FORMS in missing:
            from bodycheck.reference_impl.free_rotation.free_rotations import compile_tumbling

            with _reporting(report):
                compile_tumbling()
        for scene in closed_last:
            if other is not None and scene.is_free_rotation:
                _wait_for(marks[0], other, report)  # the closed forms
            _solve_shortly(scene, report)
        for name, scene in probes.items():
            _solve_shortly(scene, report)
            _set_mark(name)
        if other is not None:
            _wait_for(None, other, report)
    finally:
        if other is not None:
            other.kill()
            other.wait()


_KERNELS = {_CLOSED_FORMS: 86}
_INTEGRATOR_KERNELS, _TAYLOR_KERNELS = 4, 45
"""About as many files as an empty cache gets from each; progress alone depends on them."""


def _expected_kernels(missing: Sequence[str], scenes: Sequence[Scene]) -> int:
    found = sum(_KERNELS.get(name, _INTEGRATOR_KERNELS) for name in missing)
    return found + _TAYLOR_KERNELS * any(not scene.is_free_rotation for scene in scenes)


def _stored_kernels() -> int:
    return sum(1 for _ in cache_directory().glob("*/*.nbi"))


@contextmanager
def _reporting(report: Callable[[], None]) -> Iterator[None]:
    """Call report whenever this process begins to compile a kernel."""
    from numba.core import event

    class Compilation(event.Listener):  # type: ignore[misc]
        def on_start(self, _: event.Event) -> None:
            report()

        def on_end(self, _: event.Event) -> None:
            pass

    with event.install_listener("numba:compile", Compilation()):
        yield


def _solve_shortly(scene: Scene, report: Callable[[], None]) -> None:
    from bodycheck.reference_impl.truth.certification import solve_truth

    with _reporting(report):
        solve_truth(scene, np.array([0.0, 1e-3 * scene.sample_interval_s]))


def interprets_closed_forms(samples: Sequence[int]) -> bool:
    """Whether interpreting free bodies, with these numbers of samples, takes less time than compiling.

    Counts what this process has interpreted before. Both ways give the same bits.
    """
    estimate_s = sum(_INTERPRETED_S + _INTERPRETED_SAMPLE_S * count for count in samples)
    return not closed_forms_compiled() and _interpreted_s + estimate_s < _COMPILING_S


@contextmanager
def interpreting() -> Iterator[None]:
    """Interpret kernels, and count the time."""
    global _interpreted_s
    from bodycheck.reference_impl.kernels.jit import interpreted

    begin = time.perf_counter()
    try:
        with interpreted():
            yield
    finally:
        _interpreted_s += time.perf_counter() - begin


def closed_forms_compiled() -> bool:
    """Whether the closed forms of a free body, the most expensive kernels to compile, are compiled here."""
    return _mark(_CLOSED_FORMS).exists()


def _mark(name: str) -> Path:
    return cache_directory() / f"{name}.compiled"


def _wait_for(mark: Path | None, other: subprocess.Popen[bytes], report: Callable[[], None]) -> None:
    """Wait until the other process has ended or has written the marker file, if one is given."""
    while other.poll() is None and not (mark is not None and mark.exists()):
        report()
        time.sleep(0.05)


@_without_garbage_collection()
def _compile_here(names: Iterable[str]) -> None:
    """Compile the named kernels one after the other and write a marker file for each."""
    for name in names:
        if name == _CLOSED_FORMS:
            from bodycheck.reference_impl.free_rotation.free_rotations import compile_frame_and_evaluation

            compile_frame_and_evaluation()
            _compile_flight()
        else:
            _compile_integrator(name)
        _set_mark(name)


def _set_mark(name: str) -> None:
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
    from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
    from bodycheck.reference_impl.loads.load import ContinuousLoad
    from bodycheck.reference_impl.single_precision import STEPPED

    integrator = STEPPED[name.removesuffix(_WITH_CONTINUOUS_LOADS)]
    attitude = np.eye(3).ravel() if integrator.attitude == "matrix" else np.array([1.0, 0.0, 0.0, 0.0])
    state = np.concatenate([np.zeros(6), np.ones(3), attitude]).astype(integrator.real)
    body = packed_body(RigidBody(1.0, np.diag([1.0, 2.0, 2.5]))).astype(integrator.real)
    load = np.zeros(21, integrator.real)
    if name.endswith(_WITH_CONTINUOUS_LOADS) and ContinuousLoad not in integrator.refused:
        integrator.advance_forced(state, body, load, np.zeros(0), 0.0, 1e-3, 1)
    else:
        integrator.advance(state, body, load, 1e-3, 1)


if __name__ == "__main__":
    _compile_here(sys.argv[1:])
