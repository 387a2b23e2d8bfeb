"""One case: a scenario through one engine's method at one step or tolerance, measured against the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from bodycheck._util.untrusted import shell_join, shell_split
from bodycheck.adapters.contract import (
    Build,
    Engine,
    Method,
    ReadBack,
    Setting,
    TreeReadBack,
    read_back_mismatch,
)
from bodycheck.adapters.engine_names import with_method
from bodycheck.adapters.execution import Answer, Case
from bodycheck.adapters.registry import program_file, requested_name
from bodycheck.adapters.stable_step import energy_blowup, invalid_state, kinetic_limit
from bodycheck.adapters.tree_contract import tree_mismatch
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.imu import imu_mistake
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.wrench import StepPlan, plan_steps
from bodycheck.reports.measurement.case_columns import (
    AnsweredCase,
    ComparedCase,
    answer_columns,
    motion_columns,
)
from bodycheck.reports.measurement.compared_motion import Compared, EnergyAndMomentum
from bodycheck.reports.measurement.invariants import worst_drift
from bodycheck.reports.measurement.joint_errors import joint_rows
from bodycheck.reports.measurement.measure_bounds import bound_of
from bodycheck.reports.measurement.measures import (
    IDENTITY,
    MEASURES,
    QUANTITIES,
    departures_of,
    reduced,
    scale_of,
    series_of,
)
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.tree_map_made import made_map

RunCase: TypeAlias = Callable[[Engine, Case], Answer]
"""A function that answers a case, from the engine or from a stored answer."""

SWITCH_NOTE = "load switches inside a step"
"""Part of the message of a case whose order is lowered by such switches."""

ENGINES_FILE = "--engines"
"""The option of a command that names the file of its programs."""

ALLOW_CODE = "--allow-code"
"""Part of a command whose scenario or engine is a function of the user."""


@dataclass(frozen=True, eq=False)
class MeasuredMotion:
    """The trajectory of a case, if any, and its measures over time.

    series: every measure (compared,), in SI units; that of the invariant over its size. departures: the
    signed departure from the truth (compared, k) of each judged measure, over its scale. floors: the error of
    a measure in this case besides the truth's.
    """

    trajectory: Trajectory | None = None
    series: Mapping[str, Array] = field(default_factory=dict)
    departures: Mapping[str, Array] = field(default_factory=dict)
    floors: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class CaseResult:
    """The result of a case: its columns (all of results.csv but run_id) and its motion.

    motion: a function where it is read from a file when first needed. read_back: the parameters as the engine
    reports them.
    """

    columns: dict[str, Any]
    motion: MeasuredMotion | Callable[[], MeasuredMotion] = MeasuredMotion()
    read_back: ReadBack | TreeReadBack | None = None

    @cached_property
    def _motion(self) -> MeasuredMotion:
        return self.motion if isinstance(self.motion, MeasuredMotion) else self.motion()

    @property
    def trajectory(self) -> Trajectory | None:
        """The motion as the engine returned it; None if it returned none."""
        return self._motion.trajectory

    @property
    def series(self) -> Mapping[str, Array]:
        """The measures over time, as in `MeasuredMotion`; empty unless the case ended well."""
        return self._motion.series

    @property
    def departures(self) -> Mapping[str, Array]:
        """The departures from the truth, as in `MeasuredMotion`."""
        return self._motion.departures

    @property
    def floors(self) -> Mapping[str, float]:
        """The floors of measures, as in `MeasuredMotion`."""
        return self._motion.floors

    @cached_property
    def setting(self) -> Setting:
        """The step, the tolerance, or neither."""
        return Setting(self.columns.get("dt_s"), self.columns.get("tolerance"))

    @property
    def dt_s(self) -> float | None:
        """The step in s; None for a method without steps."""
        return self.setting.dt_s

    @property
    def ok(self) -> bool:
        """Whether the case ended well and was measured."""
        return bool(self.columns["outcome"] == "ok")

    @property
    def joint_rows(self) -> Iterator[dict[str, Any]]:
        """The rows of joints.csv without run_id; none for one body."""
        if "worst_body" not in self.columns:
            return iter(())
        shared = {name: self.columns.get(name) for name in (*IDENTITY, "dt_s", "tolerance")}
        return joint_rows(self.series, shared)

    @cached_property
    def largest_errors(self) -> dict[str, float]:
        """measured + bound: upper bounds of the true errors, by measure; empty unless it ended well."""
        measured = (name for name in MEASURES if name in self.columns) if self.ok else ()
        return {name: float(self.columns[name] + bound_of(self.columns, name)) for name in measured}


def run_case(problem: Problem, engine: Engine, method: Method, setting: Setting, ask: RunCase) -> CaseResult:
    """Run one case and measure it; any failure becomes its outcome."""
    scene = problem.scenario.scene
    columns = _identity(problem, engine, method, setting)
    if isinstance(scene, TreeScene) and not engine.moves_trees:
        answer = Answer("unsupported", f"the adapter of {engine.name} builds no trees")
    else:
        answer = ask(engine, Case(scene, method.name, setting))
    columns |= origin_of(answer)
    if answer.outcome == "unsupported":
        return CaseResult({**columns, "outcome": "unsupported", "message": answer.message})
    plan = None if setting.dt_s is None else plan_steps(scene, setting.dt_s)
    columns |= answer_columns(AnsweredCase(problem, method, plan, answer))

    def ended(outcome: str, message: str) -> CaseResult:
        ending = {**columns, "outcome": outcome, "message": message}
        return CaseResult(ending, MeasuredMotion(answer.trajectory), answer.read_back)

    trajectory, read_back = answer.trajectory, answer.read_back
    if trajectory is None or read_back is None:
        return ended(answer.outcome, answer.message)
    if fault := _mismatch(scene, method, None if plan is None else plan.dt_s, read_back):
        return ended("invalid", fault)
    motion = stable_motion(scene, trajectory, problem.motion)
    if isinstance(motion, str):
        return ended("unstable", motion)
    measured, moved = measured_by(problem, trajectory, motion)
    columns |= measured
    if isinstance(scene, TreeScene) and plan is not None:
        columns |= made_map(scene, trajectory, plan, method.precision, problem.scales)
    mistake = "" if isinstance(scene, TreeScene) else imu_mistake(scene, trajectory)
    messages = [text for text in (answer.message, mistake) if text]
    columns |= {"outcome": "ok", "message": _note(problem, plan, messages)}
    return CaseResult(columns, moved, read_back)


def _mismatch(
    scene: Scene | TreeScene, method: Method, dt_s: float | None, found: ReadBack | TreeReadBack
) -> str | None:
    if isinstance(scene, TreeScene):
        if not isinstance(found, TreeReadBack):
            return "the engine read back one body, not a tree"
        return tree_mismatch(scene, method.name, dt_s, found, method.precision)
    return read_back_mismatch(scene, dt_s, found, method.precision)


def origin_of(answer: Answer) -> dict[str, Any]:
    """Return the columns that say where an answer comes from: reused and build."""
    return {"reused": answer.reused, "build": Build(answer.build).short}


def stable_motion(
    scene: Scene | TreeScene, trajectory: Trajectory, true: EnergyAndMomentum, *, from_own_start: bool = False
) -> EnergyAndMomentum | str:
    """Return energy and momentum along a trajectory, or the reason why it is unstable.

    true: energy and momentum along the truth. from_own_start: whether the trajectory may start with another
    energy, such as one of omega in degrees per second, which is no instability.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a diverged trajectory may overflow
        if reason := invalid_state(trajectory):
            return reason
        motion = EnergyAndMomentum.of(scene, trajectory)
    at_start = motion.kinetic[:from_own_start]
    limit_j = kinetic_limit(np.append(true.kinetic, at_start[np.isfinite(at_start)]))
    return energy_blowup(motion.kinetic, limit_j, trajectory.t_s) or motion


def measured_by(
    problem: Problem, trajectory: Trajectory, motion: EnergyAndMomentum
) -> tuple[dict[str, Any], MeasuredMotion]:
    """Return every measure of a trajectory: as columns, and over time.

    motion: energy and momentum along the trajectory.
    """
    scene, n = problem.scenario.scene, problem.compared
    compared = Compared(
        scene, problem.truth.trajectory, problem.motion, trajectory, motion, problem.invariants, n
    )
    departures = departures_of(compared)
    series = {name: values[:n] for name, values in series_of(compared, departures).items()}
    columns: dict[str, Any] = dict(reduced(series, departures, problem.scales))
    if compared.joints is not None:
        series |= {name: values[:n] for name, values in compared.joints.series.items()}
    columns |= motion_columns(ComparedCase(problem, compared, series))
    if drift := worst_drift(compared.invariant_drifts):
        columns |= drift.columns
    judged = {name: scale_of(problem.columns, name) for name in QUANTITIES if name in columns}
    return columns, MeasuredMotion(
        trajectory,
        series,
        departures={name: departures[name][:n].reshape(n, -1) / scale for name, scale in judged.items()},
        floors={name: MEASURES[name].floor(compared) / scale for name, scale in judged.items()},
    )


def _identity(problem: Problem, engine: Engine, method: Method, setting: Setting) -> dict[str, Any]:
    return {
        **problem.columns,
        "engine": engine.name,
        "engine_version": engine.version,
        "method": method.name,
        "control": method.control,
        "precision": method.precision,
        "dt_s": setting.dt_s,
        "tolerance": setting.tolerance,
        "reproduce": reproducing_command(
            problem.scenario_spec, engine, method, setting, code=problem.scenario.scene.has_callback_load
        ),
    }


def reproducing_command(
    scenario_spec: str, engine: Engine, method: Method, setting: Setting, *, code: bool = False
) -> str:
    """Return the command line that runs this one case; code: whether the scenario names functions."""
    options = []
    if setting.dt_s is not None:
        options += ["--dt", repr(setting.dt_s)]
    if setting.tolerance is not None:
        options += ["--tolerance", repr(setting.tolerance)]
    return method_command(("run", scenario_spec, "--engine"), engine, method, options, code=code)


def method_command(
    words: Sequence[str], engine: Engine, method: Method, options: Sequence[str] = (), *, code: bool = False
) -> str:
    """Return the command line `bodycheck WORDS ENGINE:METHOD OPTIONS`; code: as for `reproducing_command`."""
    arguments = ["bodycheck", *words, with_method(requested_name(engine.name), method.name), *options]
    if (file := program_file(engine.name)) is not None:
        arguments += [ENGINES_FILE, str(file)]
        code = True
    if code or engine.build.kind == "handed over":
        arguments.append(ALLOW_CODE)
    return shell_join(arguments)


def scenario_spec(reproduce: str) -> str | None:
    """Return the scenario argument in the command of a case: the word after `bodycheck run`."""
    arguments = shell_split(reproduce)
    return arguments[2] if len(arguments) > 2 else None


def _note(problem: Problem, plan: StepPlan | None, notes: list[str]) -> str:
    if plan is not None and plan.mid_step_switches:
        notes.append(f"{SWITCH_NOTE}: {plan.mid_step_switches}; such a step applies the mean of its loads")
    if problem.compared < len(problem.truth.trajectory.t_s):
        until = f"t = {problem.times[-1]:.6g} s"
        notes.append(f"compared until {until}, where the truth ends: {problem.truth.end_reason}")
    return "; ".join(notes)
