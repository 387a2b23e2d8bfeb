"""Compile kernels ahead of use, so that neither a measurement nor a user waits for a compiler midway.

Modules with kernels are imported late: importing numba takes a second, which is saved if nothing is missing.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from bodycheck._util.child_python import child_python
from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.pinned_libraries import numba
from bodycheck.reference_impl.loads.load import Load
from bodycheck.reference_impl.scene import RigidBody, Scene, State

_WITH_CONTINUOUS_LOADS = "+continuous"
_FRAMES, _TUMBLING, _SERIES = "frames", "tumbling", "taylor"
_CLOSED_FORMS = (_FRAMES, _TUMBLING)
TREE_TRUTHS, TREE_STEPS = "tree-truths", "tree-steps"
"""The kernels of all trees: of their truths, and of the steps of the reference's methods."""
_INTERPRETED_S, _INTERPRETED_SAMPLE_S = 0.05, 2e-3  # of a truth of a free body, and of each of its samples
_POLL_S = 0.05
_COMPILING_S = 5.0  # half of what the closed forms take to compile
_interpreted_s = 0.0


@contextmanager
def without_garbage_collection() -> Iterator[None]:
    """Suspend the collector of cycles, which takes a tenth of the time of a compilation and frees little."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


@without_garbage_collection()
def compile_kernels(
    scenes: Iterable[Scene],
    methods: Sequence[str] = (),
    unsolved: Sequence[Scene] | None = None,
    *,
    never_cached: Mapping[str, Scene] = MappingProxyType({}),
    compiled: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005 - called with both
) -> None:
    """Call the kernels of these scenes' truths and of the named methods of the reference once.

    methods: also TREE_TRUTHS and TREE_STEPS. unsolved: the scenes whose truths are still to be solved
    [default: all]. never_cached: further scenes by name. compiled: called with the number of kernels done and
    of those expected, only while something is compiled.

    Another process compiles in parallel: the truths under loads are compiled here, and both processes take
    the rest off one queue. Kernels compiled before cost next to nothing, and nothing at all if none is
    missing and all truths were solved before.
    """
    scenes = list(scenes)
    names = [*(_CLOSED_FORMS if any(scene.is_free_rotation for scene in scenes) else ()), *methods]
    if any(scene.continuous_loads for scene in scenes):
        names += [name + _WITH_CONTINUOUS_LOADS for name in methods if name not in _KERNELS]
    probes = {name: scene for name, scene in never_cached.items() if not _mark(name).exists()}
    names.sort(key=lambda name: -_KERNELS.get(name, 0))  # the longest first, so that both end together
    waiting = deque(name for name in names if not _mark(name).exists())
    before, expected = _stored_kernels(), _expected_kernels(waiting, scenes)

    def report() -> None:
        done = _stored_kernels() - before
        compiled(done, max(expected, done))

    if not waiting:
        _solve(scenes if unsolved is None else unsolved, probes, report)
        return
    report()
    with _second_process(waiting) as other:
        _solve([scene for scene in scenes if not scene.is_free_rotation], {}, report)
        with _reporting(report):
            while name := _next(waiting):
                _compile_here(name)
        free = [scene for scene in scenes if scene.is_free_rotation]
        while free and other.poll() is None and not closed_forms_compiled():
            report()
            time.sleep(_POLL_S)
        _solve(free, probes, report)
        while other.poll() is None:
            report()
            time.sleep(_POLL_S)


def _solve(scenes: Iterable[Scene], probes: Mapping[str, Scene], report: Callable[[], None]) -> None:
    for scene in scenes:
        _solve_shortly(scene, report)
    for name, scene in probes.items():
        _solve_shortly(scene, report)
        _set_mark(name)


@contextmanager
def _second_process(waiting: deque[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process that takes names off the queue until it is empty; kill it at the end."""
    command, variables = child_python(__name__)
    # in a session of its own: a keyboard interrupt reaches this process only, which then ends the other
    other = subprocess.Popen(
        command,
        bufsize=0,
        env={**os.environ, **variables},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    with other:
        handing_out = threading.Thread(target=_hand_out, args=(waiting, other), daemon=True)
        handing_out.start()
        try:
            yield other
        finally:
            other.kill()
            handing_out.join()


def _hand_out(waiting: deque[str], other: Any) -> None:
    """Answer each line of the other process with the next name, or with an empty line if none is left."""
    for _ in other.stdout:
        with suppress(BrokenPipeError):
            other.stdin.write(f"{_next(waiting)}\n".encode())


def _next(waiting: deque[str]) -> str:
    """Take the first name off the queue, which two threads share; "" if it is empty."""
    with suppress(IndexError):
        return waiting.popleft()
    return ""


_KERNELS = {_FRAMES: 63, _TUMBLING: 23, _SERIES: 32, TREE_TRUTHS: 12, TREE_STEPS: 10}
_INTEGRATOR_KERNELS, _TAYLOR_KERNELS = 4, 45
"""About as many files as an empty cache gets from each; progress alone depends on them."""


def _expected_kernels(missing: Iterable[str], scenes: Sequence[Scene]) -> int:
    found = sum(_KERNELS.get(name, _INTEGRATOR_KERNELS) for name in missing)
    return found + _TAYLOR_KERNELS * any(not scene.is_free_rotation for scene in scenes)


def _stored_kernels() -> int:
    return sum(1 for _ in cache_directory().glob("*/*.nbi"))


@contextmanager
def _reporting(report: Callable[[], None]) -> Iterator[None]:
    """Call report whenever this process begins to compile a kernel."""
    event: Any = numba().core.event

    class Compilation(event.Listener):  # type: ignore[misc]
        def on_start(self, _: Any) -> None:
            report()

        def on_end(self, _: Any) -> None:
            pass

    with event.install_listener("numba:compile", Compilation()):
        yield


def _solve_shortly(scene: Scene, report: Callable[[], None]) -> None:
    from bodycheck.reference_impl.truth.certification import solve_truth

    # a scene without a truth is reported where it is solved at its samples
    with _reporting(report), suppress(ValueError):
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
    return all(_mark(name).exists() for name in _CLOSED_FORMS)


def _mark(name: str) -> Path:
    return cache_directory() / f"{name}.compiled"


@without_garbage_collection()
def _compile_on_request() -> None:
    """Compile the name on each line of the input, after asking for it by a line of output."""
    print(flush=True)
    while name := sys.stdin.readline().strip():
        _compile_here(name)
        print(flush=True)


def _compile_here(name: str) -> None:
    """Compile what has this name, and write its marker file."""
    if name == _FRAMES:
        from bodycheck.reference_impl.free_rotation.free_rotations import compile_frame_and_evaluation

        compile_frame_and_evaluation()
        _compile_flight()
    elif name == _TUMBLING:
        from bodycheck.reference_impl.free_rotation.free_rotations import compile_tumbling

        compile_tumbling()
    elif name == _SERIES:
        _compile_series()
    elif name in (TREE_TRUTHS, TREE_STEPS):
        _compile_trees(name)
    else:
        _compile_integrator(name)
    _set_mark(name)


def _set_mark(name: str) -> None:
    mark = _mark(name)
    with suppress(OSError):  # the cache folder may be read-only
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()


def _scene(*loads: Load) -> Scene:
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    return Scene(RigidBody(1.0, np.eye(3)), start, loads, np.zeros(3), 1.0, 2)


def _compile_series() -> None:
    """Solve a motion with no torque, whose kernels differ from those of any other, and one with a torque."""
    from bodycheck.reference_impl.loads.kinds.sine_torque import SineTorque
    from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion

    for scene in (_scene(), _scene(SineTorque("body", np.ones(3), 1.0, 0.0))):
        TaylorMotion.of(scene, 1e-15).solve(scene.sample_times)


def _compile_flight() -> None:
    from bodycheck.reference_impl.closed_forms.flight import Flight
    from bodycheck.reference_impl.closed_forms.piecewise_constant_loads import loads_of

    scene = _scene()
    loads = loads_of(scene)
    flight = None if loads is None else Flight.of(scene, loads)
    assert flight is not None
    flight.at(scene.sample_times)


def _compile_trees(name: str) -> None:
    """Solve a motion of a tree, or make one step of it."""
    from bodycheck.reference_impl.trees.random_trees import random_tree
    from bodycheck.reference_impl.trees.tree_stepper import TreeStepper
    from bodycheck.reference_impl.trees.tree_truth import certified_tree

    scene = random_tree(np.random.default_rng(0), 2, loads=True)
    if name == TREE_TRUTHS:
        certified_tree(scene, np.array([0.0, 1e-3]))
    else:
        TreeStepper(scene, "RK4").advance(0.0, 1e-3, 1)


def _compile_integrator(name: str) -> None:
    """Make one step, under continuous loads if the name says so."""
    from bodycheck.reference_impl.integrators import STEPPED
    from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
    from bodycheck.reference_impl.loads.load import ContinuousLoad

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
    _compile_on_request()
