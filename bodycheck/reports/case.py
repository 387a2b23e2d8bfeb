"""One case: a scenario through one engine's method at one step, measured against the truth."""

from __future__ import annotations

import math
import shlex
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bodycheck.adapters.contract import Adapter, Method, read_back_mismatch
from bodycheck.adapters.drive import CpuTime, measure_cpu, record
from bodycheck.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth import Truth, solve_truth
from bodycheck.reference_impl.wrench import StepPlan, plan_steps
from bodycheck.reports.measures import INVARIANT, error_series, instability, reduced
from bodycheck.reports.scales import Scales, scene_scales
from bodycheck.scenarios.model import Scenario


@dataclass(frozen=True, eq=False)
class Subject:
    """A scenario with its truth at the samples and its scales; asked_as names it on the command line."""

    scenario: Scenario
    truth: Truth
    scales: Scales
    asked_as: str

    @classmethod
    def of(cls, scenario: Scenario, asked_as: str | Path) -> Subject:
        """Solve the truth at the scenario's samples; InputError where the motion is beyond all doubles."""
        try:
            truth = solve_truth(scenario.scene, scenario.scene.sample_times)
        except ValueError as error:
            raise InputError(f"{asked_as}: {error}") from None
        scales = scene_scales(scenario.scene, truth.trajectory)
        if not all(math.isfinite(scale) for scale in vars(scales).values()):
            raise InputError(f"{asked_as}: its energy or momentum is beyond the range of double precision")
        return cls(scenario, truth, scales, str(asked_as))


@dataclass(frozen=True, eq=False)
class CaseResult:
    """How a case ended: columns (all of results.csv but run_id), and what it returned, if it did.

    series: every measure over time (n,), in SI units.
    """

    columns: dict[str, Any]
    trajectory: Trajectory | None = None
    series: dict[str, Array] = field(default_factory=dict)

    @property
    def dt_s(self) -> float | None:
        """The step, None for a method that has none."""
        dt_s: float | None = self.columns.get("dt_s")
        return dt_s

    @property
    def ok(self) -> bool:
        """Whether the case ended well and was measured."""
        return bool(self.columns["outcome"] == "ok")


def run_case(
    subject: Subject, adapter: Adapter, method: Method, dt_s: float | None, *, speed: bool
) -> CaseResult:
    """Build, read back, record, measure and time one case; whatever goes wrong becomes its outcome."""
    scene = subject.scenario.scene
    columns = _who(subject, adapter, method, dt_s)

    def ended(outcome: str, message: str, trajectory: Trajectory | None = None) -> CaseResult:
        return CaseResult({**columns, "outcome": outcome, "message": message}, trajectory)

    if reason := adapter.unsupported(scene, method.name):
        return ended("unsupported", reason)
    plan = plan_steps(scene, scene.sample_interval_s if dt_s is None else dt_s)
    if dt_s is not None:
        columns["steps"] = plan.steps
    if method.evaluations is not None:
        columns["rhs_evaluations"] = method.evaluations * plan.steps
    try:
        simulation = adapter.build(scene, method.name, plan.dt_s)
        try:
            if fault := read_back_mismatch(scene, plan.dt_s, simulation.read_back()):
                return ended("invalid", fault)
            columns["stepping"] = simulation.stepping
            trajectory = record(simulation, plan, scene)
            if reason := instability(scene, subject.truth, trajectory):
                return ended("unstable", reason, trajectory)
            if speed:
                columns |= _speed(measure_cpu(simulation, plan), plan, dt_s)
        finally:
            simulation.close()
    except (Exception, SystemExit) as error:  # noqa: BLE001 - an engine may raise anything; it costs this case alone
        return ended("failed", " ".join(f"{type(error).__name__}: {error}".split()))
    series = error_series(scene, subject.truth, trajectory)
    columns |= reduced(series, subject.scales)
    if "invariant_drift" in series:
        columns["invariant"] = INVARIANT
    return CaseResult({**columns, "outcome": "ok", "message": _note(plan)}, trajectory, series)


def _who(subject: Subject, adapter: Adapter, method: Method, dt_s: float | None) -> dict[str, Any]:
    scenario, truth = subject.scenario, subject.truth
    return {
        "scenario": scenario.name,
        "family": scenario.family,
        "engine": adapter.name,
        "engine_version": adapter.version,
        "method": method.name,
        "control": method.control,
        "dt_s": dt_s,
        "duration_s": scenario.duration_s,
        "reproduce": reproducing_command(subject.asked_as, adapter.name, method.name, dt_s),
        **vars(subject.scales),
        "truth": truth.kind,
        "truth_bound_rad": float(truth.bound_rad.max()),
        "truth_bound_energy": float(truth.bound_energy.max()),
        "truth_bound_momentum": float(truth.bound_momentum.max()),
    }


def reproducing_command(asked_as: str, engine: str, method: str, dt_s: float | None) -> str:
    """Return the command line that runs this one case again."""
    words = ["bodycheck", "run", asked_as, "--engine", f"{engine}:{method}"]
    if dt_s is not None:
        words += ["--dt", repr(dt_s)]
    return shlex.join(words)


def _speed(cpu: CpuTime, plan: StepPlan, dt_s: float | None) -> dict[str, Any]:
    columns: dict[str, Any] = {"cpu_s": cpu.median_s, "cpu_s_low": cpu.low_s, "cpu_s_high": cpu.high_s}
    if dt_s is not None:
        columns["ns_per_step"] = 1e9 * cpu.median_s / plan.steps
    return columns


def _note(plan: StepPlan) -> str:
    if plan.straddled == 0:
        return ""
    return f"load switches inside a step: {plan.straddled}; such a step carries the mean of what acts in it"
