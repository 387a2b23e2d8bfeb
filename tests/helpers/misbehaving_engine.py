"""An engine that is correct except at the finest step, where each of its methods fails in its own way.

A fault ends its worker, and the next one starts again. So the engine steps with a few lines of numpy, and not
with the reference, whose kernels every such worker would have to load.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import subprocess
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NoReturn

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Solver
from bodycheck.adapters.execution import readings_along, trajectory_of
from bodycheck.adapters.step_function import StepFunction
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import plan_steps
from tests.helpers.my_integrator import step

BAD_STEP_S = 0.01
VALID_STEPS_S = (0.05, 0.02)
FLOOD_BYTES = 100_000_000

_is_broken = threading.Event()


class UnprintableError(Exception):
    """An error that cannot be converted to text."""

    def __str__(self) -> str:
        raise RuntimeError("no words")


def _raising(error: Callable[[], BaseException]) -> Callable[[], None]:
    def act() -> NoReturn:
        raise error()

    return act


def _segfault() -> None:
    ctypes.string_at(0)


def _loop() -> None:
    while True:
        pass


def _c_loop() -> None:
    sum(itertools.repeat(0))  # never returns to the interpreter, and never releases its lock


def _swell() -> None:
    np.empty(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 32 * 3)  # 3/4 of the memory


def _swell_beyond() -> None:
    np.ones(2**40)


def _print_flood() -> None:
    line = "x" * 999_999
    for _ in range(FLOOD_BYTES // 1_000_000):
        print(line)


def _raw_flood() -> None:
    piece = b"y" * 1_000_000
    for _ in range(FLOOD_BYTES // 1_000_000):
        os.write(1, piece)


def _speak_and_abort() -> None:
    print("the solver met a singular matrix")
    os.abort()


def _recurse() -> None:
    _recurse()


def _close_output() -> None:
    os.close(1)


def _close_all() -> None:
    os.closerange(0, 1024)


def _leave_a_fork() -> None:
    if os.fork() == 0:
        time.sleep(1000.0)
    os._exit(5)


def _leave_a_child() -> None:
    subprocess.Popen(["sleep", "1000"])
    os._exit(5)


def _spoil() -> None:
    _is_broken.set()


ACTS: dict[str, Callable[[], None]] = {
    "abort": os.abort,
    "segfault": _segfault,
    "exit": lambda: os._exit(7),
    "exit-0": lambda: os._exit(0),
    "loop": _loop,
    "c-loop": _c_loop,
    "sleep": lambda: time.sleep(1000.0),
    "swell": _swell,
    "swell-beyond": _swell_beyond,
    "print-flood": _print_flood,
    "raw-flood": _raw_flood,
    "speak-and-abort": _speak_and_abort,
    "raise": _raising(lambda: RuntimeError("the solver\ngave up")),
    "system-exit": _raising(lambda: SystemExit(3)),
    "keyboard-interrupt": _raising(KeyboardInterrupt),
    "generator-exit": _raising(GeneratorExit),
    "unprintable": _raising(UnprintableError),
    "endless-words": _raising(lambda: RuntimeError("\x00\ud800" + "z" * 10_000_000)),
    "recurse": _recurse,
    "close-output": _close_output,
    "close-all": _close_all,
    "leave-a-fork": _leave_a_fork,
    "leave-a-child": _leave_a_child,
    "spoil": _spoil,
}
"""Method -> what it does when the first steps are requested."""

INFINITE = np.full(3, np.inf)

READINGS: dict[str, Callable[[Reading], Reading]] = {
    "nan": lambda held: replace(held, position=held.position * np.nan),
    "infinite": lambda held: held if held.quaternion[0] == 1.0 else replace(held, omega_body=INFINITE),
    "shape": lambda held: replace(held, position=np.zeros(4)),
    "ragged": lambda held: replace(held, position=np.zeros(np.random.default_rng().integers(4, 1000))),
    "text": lambda held: replace(held, position=np.array(["0.0", "0.0", "0.0"])),
    "object": lambda held: replace(held, position=np.array([None, 0.0, 0.0])),
    "nothing": lambda held: replace(held, position=None),  # type: ignore[arg-type]
}
"""Method -> what it reads in place of the state; omega is infinite once the body has rotated."""

LIES: dict[str, Callable[[ReadBack], ReadBack]] = {
    "other-mass": lambda held: replace(held, mass=1.5 * held.mass),
}
"""Method -> what it reads back."""

ONLY_TIMED = "abort-when-timed"

SOLUTIONS: dict[str, Callable[[Trajectory], Trajectory | None]] = {
    "few": lambda whole: Trajectory(
        t_s=whole.t_s[:2],
        position_m=whole.position_m[:2],
        velocity_m_s=whole.velocity_m_s[:2],
        quaternion=whole.attitude[:2],
        omega_world_rad_s=whole.omega_world[:2],
    ),
    "none": lambda _: None,
}
"""Method -> what its solver returns in place of the trajectory."""


_STEPPED = Method(
    name="sound",
    formula="Runge-Kutta 4",
    order=4,
    evaluations=4,
    torque="zero-order hold",
    conserves="nothing",
    source="my_integrator.py",
)
_SOLVED = replace(_STEPPED, control="none")


def _stepper(scene: Scene, dt_s: float) -> Simulation:
    return StepFunction(step).build(scene, "step", dt_s)


class _Solver:
    """The motion of a scene from one call."""

    steps: int | None = None

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def read_back(self) -> ReadBack:
        """Return the scene's own numbers."""
        return replace(_stepper(self._scene, BAD_STEP_S).read_back(), dt_s=None)

    def solve(self) -> Trajectory:
        """Step through all samples."""
        readings = readings_along(
            _stepper(self._scene, BAD_STEP_S), plan_steps(self._scene, BAD_STEP_S).legs()
        )
        return trajectory_of(self._scene.sample_times, readings)

    def close(self) -> None:
        """Nothing to free."""


class Misbehaving:
    """Runge-Kutta 4 on a free body, with one method for each way to go wrong.

    sound: whether all methods are correct, for comparison.
    """

    name, version = "misbehaving", "1"

    def __init__(self, *, sound: bool = False) -> None:
        self._sound = sound
        kinds = dict.fromkeys((*ACTS, *READINGS, *LIES, ONLY_TIMED), _STEPPED) | dict.fromkeys(
            SOLUTIONS, _SOLVED
        )
        self.methods: Mapping[str, Method] = {
            name: replace(method, name=name) for name, method in kinds.items()
        }

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse nothing."""
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a sound simulation and, at the finest step, give it its fault."""
        if _is_broken.is_set():
            raise RuntimeError("spoilt by a case before this one")
        simulation = _stepper(scene, dt_s)
        if not self._sound and abs(dt_s - BAD_STEP_S) < 1e-9:
            spoil(simulation, method)
        return simulation

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:  # noqa: ARG002 - the same
        """Make a sound solver, and replace its solution."""
        solver = _Solver(scene)
        if not self._sound:
            solve = solver.solve
            solver.solve = lambda: SOLUTIONS[method](solve())  # type: ignore[method-assign,assignment,return-value]
        return solver


def spoil(simulation: Simulation, method: str) -> None:
    """Give a simulation the fault of that name."""
    if method in ACTS:
        advance = simulation.advance

        def act_and_advance(steps: int) -> None:
            simulation.advance = advance  # type: ignore[method-assign]
            ACTS[method]()
            advance(steps)

        simulation.advance = act_and_advance  # type: ignore[method-assign]
    elif method in READINGS:
        held, read = simulation.read_back(), simulation.read
        simulation.read_back = lambda: held  # type: ignore[method-assign]
        simulation.read = lambda: READINGS[method](read())  # type: ignore[method-assign]
    elif method in LIES:
        read_back = simulation.read_back
        simulation.read_back = lambda: LIES[method](read_back())  # type: ignore[method-assign]
    else:
        simulation.reset = os.abort  # type: ignore[method-assign]
