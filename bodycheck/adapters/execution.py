"""Run an engine through one case: once to record its trajectory, then repeatedly to time it."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, TypeAlias, cast

import numpy as np

from bodycheck.adapters.contract import (
    Adapter,
    ReadBack,
    Reading,
    Setting,
    Simulation,
    Solver,
    SolvingAdapter,
    Stepping,
    TreeReadBack,
)
from bodycheck.adapters.tree_contract import TreeSimulation, moved_tree, tree_model_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.wrench import Leg, StepPlan, Wrench, plan_steps

_LAP_S = 2e-3  # a lap is the whole case, or its first steps for about this long
_TRIAL_STEPS = 100

Ending: TypeAlias = Literal["ok", "unsupported", "failed", "timeout"]


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, the name of a method, and its step size or tolerance."""

    scene: Scene | TreeScene
    method: str
    setting: Setting


@dataclass(frozen=True, eq=False)
class Answer:
    """The result of a case: a trajectory and the model read back, or why there is none.

    steps: number of steps of a solver. build: id of the build that the worker had loaded. reused: whether the
    answer comes from an earlier run.
    """

    outcome: Ending
    message: str = ""
    trajectory: Trajectory | None = None
    read_back: ReadBack | TreeReadBack | None = None
    stepping: Stepping | None = None
    steps: int | None = None
    build: str = ""
    reused: bool = False


def record(adapter: Adapter, case: Case, *, again: bool = False) -> Answer:
    """Build, read back and step one case through its samples; exceptions of the engine propagate.

    again: run the case before it is read back, reset, and return the motion of the second run.
    """
    scene, method, setting = case.scene, case.method, case.setting
    if method not in adapter.methods:
        return Answer("unsupported", f"no method {method!r}")
    if reason := refusal(adapter, scene, method):
        return Answer("unsupported", reason)
    if setting.dt_s is None:
        solver = cast(SolvingAdapter, adapter).solver(cast(Scene, scene), method, setting.tolerance)
        try:
            if again:
                solver.solve()
            model: ReadBack | TreeReadBack = solver.read_back()
            solved = solver.solve()
            return Answer("ok", "", solved, model, "native", solver.steps)
        finally:
            solver.close()
    plan = plan_steps(scene, setting.dt_s)
    simulation = built(adapter, scene, method, plan.dt_s)
    try:
        if again:
            readings_along(simulation, plan.legs())
        model = simulation.read_back()
        if again:
            simulation.reset()
        readings = readings_along(simulation, plan.legs())
        motion = motion_of(scene, scene.sample_times, readings)
        return Answer("ok", "", motion, model, simulation.stepping)
    finally:
        simulation.close()


def refusal(adapter: Adapter, scene: Scene | TreeScene, method: str) -> str | None:
    """Return why a method cannot represent a scene; None if it can."""
    if not isinstance(scene, TreeScene):
        return adapter.unsupported(scene, method)
    model = tree_model_of(adapter)
    return f"the adapter of {adapter.name} builds no trees" if model is None else model.unmoved(scene, method)


def built(
    adapter: Adapter, scene: Scene | TreeScene, method: str, dt_s: float
) -> Simulation | TreeSimulation:
    """Build a scene, of one body or of a tree."""
    if not isinstance(scene, TreeScene):
        return adapter.build(scene, method, dt_s)
    model = tree_model_of(adapter)
    assert model is not None
    return TreeSimulation(model, scene, method, dt_s)


def motion_of(scene: Scene | TreeScene, t_s: Array, readings: list[Any]) -> Trajectory:
    """Return the readings at the times t_s (n,) as one trajectory; of a tree, with all poses."""
    if isinstance(scene, TreeScene):
        return moved_tree(scene, t_s, readings)
    return trajectory_of(t_s, readings)


def readings_along(
    simulation: Simulation | TreeSimulation, legs: Iterable[Leg], *, with_imu: bool = True
) -> list[Any]:
    """Step a fresh simulation along the legs, and return the states at the start and at the samples.

    A simulation may have `imu()`, which returns the specific force and the rate that its sensors read.
    """
    readings: list[Any] = []
    imu = getattr(simulation, "imu", None) if with_imu else None

    def read() -> None:
        state: Any = simulation.read()
        if imu is not None:
            force, rate = imu()
            state = replace(state, specific_force=force, gyro=rate)
        readings.append(state)

    wrench: Wrench | None = None
    for leg in legs:
        if leg.wrench is not wrench:
            wrench = leg.wrench
            simulation.apply(wrench)
        if not readings:  # the first, under the loads that act then
            read()
        simulation.advance(leg.steps)
        if leg.ends_at_sample:
            read()
    return readings


def trajectory_of(t_s: Array, readings: list[Reading]) -> Trajectory:
    """Return the readings at the times t_s (n,) as one trajectory.

    Raises TypeError if a reading has no position or no velocity.
    """

    def column(name: str) -> Array | None:
        values = [getattr(reading, name) for reading in readings]
        if values[0] is None:
            return None
        array = np.array(values)
        return array.astype(np.float64) if array.dtype.kind in "fiu" else array  # others are refused later

    position, velocity = column("position"), column("velocity")
    if position is None or velocity is None:
        raise TypeError("a reading without position or velocity")
    return Trajectory(
        t_s=t_s,
        position_m=position,
        velocity_m_s=velocity,
        quaternion=column("quaternion"),
        rotation=column("rotation"),
        omega_world_rad_s=column("omega_world"),
        omega_body_rad_s=column("omega_body"),
        specific_force_m_s2=column("specific_force"),
        gyro_rad_s=column("gyro"),
    )


class Stopwatch(Protocol):
    """A case that is built, warmed up and ready to be timed."""

    def lap(self) -> float:
        """Return the CPU time in s of the whole case."""

    def close(self) -> None:
        """Free the engine's resources."""


def stopwatch(adapter: Adapter, case: Case) -> Stopwatch:
    """Build a case and run it once without timing, so that it is ready to be timed."""
    if case.setting.dt_s is None:
        solver = cast(SolvingAdapter, adapter).solver(
            cast(Scene, case.scene), case.method, case.setting.tolerance
        )
        with _closed_on_failure(solver):
            return _SolverStopwatch(solver)
    plan = plan_steps(case.scene, case.setting.dt_s)
    simulation = built(adapter, case.scene, case.method, plan.dt_s)
    with _closed_on_failure(simulation):
        return _StepStopwatch(simulation, plan)


@contextmanager
def _closed_on_failure(built: Simulation | TreeSimulation | Solver) -> Iterator[None]:
    try:
        yield
    except BaseException:
        built.close()
        raise


def _clock() -> Callable[[], float]:
    """Return the clock of the CPU time of this process in s, that of all its threads."""
    if resource.getrlimit(resource.RLIMIT_CPU)[0] == resource.RLIM_INFINITY:
        return time.process_time
    # where `ulimit -t` limits it, Linux counts only ticks of some ms in process_time()
    return lambda: sum(resource.getrusage(resource.RUSAGE_SELF)[:2])  # user and system


class _SolverStopwatch:
    def __init__(self, solver: Solver) -> None:
        self._solver, self._now = solver, _clock()
        solver.solve()

    def lap(self) -> float:
        begin = self._now()
        self._solver.solve()
        return self._now() - begin

    def close(self) -> None:
        self._solver.close()


class _StepStopwatch:
    """Times the first steps of a case without stopping at samples, and scales to all of its steps."""

    def __init__(self, simulation: Simulation | TreeSimulation, plan: StepPlan) -> None:
        self._simulation, self._now = simulation, _clock()
        trial = min(_TRIAL_STEPS, plan.steps)
        self._legs, self._scale = list(_first_steps(plan, trial)), 1.0
        self.lap()
        per_step = max(self.lap() / trial, 1e-9)
        timed = int(min(max(_LAP_S / per_step, trial), plan.steps))
        self._legs, self._scale = list(_first_steps(plan, timed)), plan.steps / timed

    def lap(self) -> float:
        self._simulation.reset()
        begin = self._now()
        for leg in self._legs:
            self._simulation.apply(leg.wrench)
            self._simulation.advance(leg.steps)
        return (self._now() - begin) * self._scale

    def close(self) -> None:
        self._simulation.close()


def _first_steps(plan: StepPlan, steps: int) -> Iterator[Leg]:
    """Yield the legs of the first steps of a run that does not stop at samples."""
    for leg in plan.uninterrupted():
        if steps <= 0:
            return
        yield Leg(min(leg.steps, steps), leg.wrench, ends_at_sample=False)
        steps -= leg.steps
