"""Mistakes that users make in a step function of classical Runge-Kutta 4 are named."""

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
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reports.measurement.problem import Problem
from bodycheck.scenarios.library import load_scenario

DT_S = 0.01


def turned(q: Array, omega: Array) -> Array:
    """q omega / 2."""
    return 0.5 * quaternion_product(q, np.array([0.0, *omega]))


def classical(mistake: str, *, unit: bool) -> Callable[[StepState, float], StepState]:
    """Return the step function with a mistake, by the name of its fault; unit: normalised after the step."""

    def rate(at: StepState, loads: tuple[Array, Array]) -> tuple[Array, ...]:
        force, torque = loads
        match mistake:
            case "acceleration":
                force = -force
            case "total-force-in-body-axes":
                force = at.rotation @ force
            case "total-force-by-transpose":
                force = at.rotation.T @ force
            case "total-torque-in-world-axes":
                torque = at.rotation.T @ torque
            case "total-torque-rotated":
                torque = at.rotation @ torque
            case "damping-torque":
                torque = torque - 0.05 * at.omega_body
        spun = angular_acceleration(at.body.inertia, at.omega_body, torque)
        return at.velocity, force / at.body.mass, turned(at.quaternion, at.omega_body), spun

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
        first = state.loads()

        def loads(at: StepState) -> tuple[Array, Array]:
            return first if mistake == "loads-held" else at.loads()

        k1 = rate(state, loads(state))
        middle = moved(state, k1, dt / 2)
        k2 = rate(middle, loads(middle))
        middle = moved(state, k2, dt / 2)
        k3 = rate(middle, loads(middle))
        last = moved(state, k3, dt)
        k4 = rate(last, loads(last))
        mean = tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
        end = moved(state, mean, dt)
        q, old, new = state.quaternion, state.omega_body, end.omega_body
        match mistake:
            case "attitude-step-1":
                end = replace(end, quaternion=q + dt * turned(q, old))
            case "attitude-step-2":
                end = replace(end, quaternion=q + dt * turned(q, new))
            case "attitude-step-3":
                end = replace(end, quaternion=quaternion_product(q, exp_quaternion(dt * old)))
            case "attitude-step-4":
                end = replace(end, quaternion=quaternion_product(q, exp_quaternion(dt * new)))
            case "attitude-step-5":
                end = replace(end, quaternion=quaternion_product(q, exp_quaternion(dt * (old + new) / 2)))
        return replace(end, quaternion=end.quaternion / np.linalg.norm(end.quaternion)) if unit else end

    return step


def diagnosis_of(scenario: str, mistake: str, *, unit: bool = False) -> Diagnosis:
    """Return the diagnosis of the step function in a scenario."""
    problem = Problem.of(load_scenario(scenario), scenario)
    scene = problem.of_body.scene
    engine = StepFunction(classical(mistake, unit=unit))
    (name,) = engine.methods
    path = record(engine, Case(scene, name, Setting(dt_s=DT_S))).trajectory
    assert path is not None
    found = diagnosed(scene, path, problem.scales, DT_S)
    assert found is not None
    return found


OF_LOADS = (
    "acceleration",
    "total-force-in-body-axes",
    "total-force-by-transpose",
    "total-torque-in-world-axes",
    "total-torque-rotated",
)


@pytest.mark.parametrize(
    ("scenario", "mistake", "unit"),
    [
        ("powered-flight", "loads-held", False),
        pytest.param("powered-flight", "loads-held", True, marks=pytest.mark.slow),
        *(
            pytest.param(name, "loads-held", False, marks=pytest.mark.nightly)
            for name in ("damped-fall", "sine-torque", "satellite-libration")
        ),
        *(pytest.param("powered-flight", name, True, marks=pytest.mark.slow) for name in OF_LOADS),
        pytest.param("tumbling", "damping-torque", True, marks=pytest.mark.slow),
        *(
            pytest.param("tumbling", f"attitude-step-{place}", True, marks=pytest.mark.slow)
            for place in range(1, 6)
        ),
    ],
)
def test_the_mistake_is_named(scenario: str, mistake: str, unit: bool) -> None:
    """Alone, whether loads are constant in some axes or change continuously."""
    found = diagnosis_of(scenario, mistake, unit=unit)
    assert (found.verdict, [fault.name for fault in found.faults]) == ("explained", [mistake])
    assert not found.alike
    assert found.base == "rk4"


@pytest.mark.parametrize(
    "scenario", ["powered-flight", pytest.param("damped-fall", marks=pytest.mark.nightly)]
)
def test_no_mistake_is_healthy(scenario: str) -> None:
    """Without one, the method is what it is."""
    found = diagnosis_of(scenario, "")
    assert (found.verdict, found.faults) == ("healthy", ())
