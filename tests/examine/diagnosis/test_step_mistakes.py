"""Mistakes that users make in a step function of classical Runge-Kutta 4 are named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bodycheck
from bodycheck import StepState
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.registry import registered
from bodycheck.adapters.step_function import StepFunction
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, diagnosed
from bodycheck.examine.explanation.explain import explain_run
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_acceleration
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reports.measurement.problem import Problem
from bodycheck.runs.directory import write_run
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


def with_weights(weights: Sequence[float]) -> Callable[[StepState, float], StepState]:
    """Return a free step of Runge-Kutta 4 with these weights, the quaternion normalised in every stage."""

    def normal(y: Array) -> Array:
        return np.concatenate([y[:4] / np.linalg.norm(y[:4]), y[4:]])

    def step(state: StepState, dt: float) -> StepState:
        def rate(y: Array) -> Array:
            spun = angular_acceleration(state.body.inertia, y[4:], np.zeros(3))
            return np.concatenate([turned(y[:4], y[4:]), spun])

        y = np.concatenate([state.quaternion, state.omega_body])
        slopes = [rate(y)]
        for share in (0.5, 0.5, 1.0):
            slopes.append(rate(normal(y + share * dt * slopes[-1])))
        y = normal(y + dt * sum(b * k for b, k in zip(weights, slopes, strict=True)))
        return replace(state, quaternion=y[:4], omega_body=y[4:])

    return step


OF_LOADS = (
    "acceleration",
    "total-force-in-body-axes",
    "total-force-by-transpose",
    "total-torque-in-world-axes",
    "total-torque-rotated",
)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
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


@pytest.mark.nightly
def test_a_cause_that_shows_with_few_steps_per_sample_alone_is_named(tmp_path: Path) -> None:
    """With 20 steps, not all maps are tried, and those that are leave a part of the error."""
    weights = (1 / 6, 1 / 6, 1 / 3, 1 / 3)
    engine = StepFunction(with_weights(weights))
    with registered(engine):
        run = bodycheck.run(
            ["intermediate-axis"], engines=[engine.name], dt_s=[2e-2, 1e-2, 5e-3], speed=False
        )
    write_run(run, tmp_path / "run")
    (one,) = explain_run(tmp_path / "run", "intermediate-axis")
    assert one.case.dt_s == 1e-2
    assert one.explains_all
    assert one.diagnosis is not None
    (fault,) = one.diagnosis.faults
    assert fault.name == "weights"
    assert [p.value for p in fault.parameters] == pytest.approx(weights, abs=1e-6)
