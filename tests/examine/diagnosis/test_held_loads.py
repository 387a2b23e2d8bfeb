"""Loads that a step evaluates once, instead of in every stage, are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bodycheck import StepState
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.step_function import StepFunction
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, diagnosed
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_acceleration
from bodycheck.reference_impl.rotations import quaternion_product
from bodycheck.reports.measurement.problem import Problem
from bodycheck.scenarios.library import load_scenario

DT_S = 0.01


def classical(*, held: bool, unit: bool) -> Callable[[StepState, float], StepState]:
    """Return classical Runge-Kutta 4; held: loads of the start of the step; unit: normalised after it."""

    def rate(at: StepState, loads: tuple[Array, Array] | None) -> tuple[Array, ...]:
        force, torque = at.loads() if loads is None else loads
        turn = 0.5 * quaternion_product(at.quaternion, np.array([0.0, *at.omega_body]))
        spun = angular_acceleration(at.body.inertia, at.omega_body, torque)
        return at.velocity, force / at.body.mass, turn, spun

    def moved(state: StepState, rates: tuple[Array, ...], dt: float) -> StepState:
        x, v, q, w = rates
        return replace(
            state,
            t_s=state.t_s + dt,
            position=state.position + dt * x,
            velocity=state.velocity + dt * v,
            quaternion=state.quaternion + dt * q,
            omega_body=state.omega_body + dt * w,
        )

    def step(state: StepState, dt: float) -> StepState:
        loads = state.loads() if held else None
        k1 = rate(state, loads)
        k2 = rate(moved(state, k1, dt / 2), loads)
        k3 = rate(moved(state, k2, dt / 2), loads)
        k4 = rate(moved(state, k3, dt), loads)
        mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        end = moved(state, mean, dt)
        return replace(end, quaternion=end.quaternion / np.linalg.norm(end.quaternion)) if unit else end

    return step


def diagnosis_of(scenario: str, *, held: bool, unit: bool = False) -> Diagnosis:
    """Return the diagnosis of the integrator in a scenario."""
    problem = Problem.of(load_scenario(scenario), scenario)
    scene = problem.of_body.scene
    engine = StepFunction(classical(held=held, unit=unit))
    (name,) = engine.methods
    path = record(engine, Case(scene, name, Setting(dt_s=DT_S))).trajectory
    assert path is not None
    found = diagnosed(scene, path, problem.scales, DT_S)
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("scenario", "unit"),
    [
        ("powered-flight", False),
        pytest.param("powered-flight", True, marks=pytest.mark.slow),
        *(
            pytest.param(name, False, marks=pytest.mark.nightly)
            for name in ("damped-fall", "sine-torque", "satellite-libration")
        ),
    ],
)
def test_loads_of_the_start_of_a_step_are_named(scenario: str, unit: bool) -> None:
    """Whether they are constant in some axes or change continuously."""
    found = diagnosis_of(scenario, held=True, unit=unit)
    assert (found.verdict, [fault.name for fault in found.faults]) == ("explained", ["loads-held"])
    assert not found.alike


@pytest.mark.parametrize(
    "scenario", ["powered-flight", pytest.param("damped-fall", marks=pytest.mark.nightly)]
)
def test_loads_that_every_stage_evaluates_are_healthy(scenario: str) -> None:
    """The same integrator, which asks in each stage."""
    found = diagnosis_of(scenario, held=False)
    assert (found.verdict, found.faults) == ("healthy", ())
