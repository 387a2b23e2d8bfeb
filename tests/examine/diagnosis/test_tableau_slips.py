"""Slips of a Runge-Kutta method that is written by hand are named, on quaternions and on matrices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from bodycheck.examine.diagnosis.diagnosis import Diagnosis, diagnosed
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.problem import Problem
from bodycheck.scenarios.library import load_scenario

A = ((), (0.5,), (0.0, 0.5), (0.0, 0.0, 1.0))
B = (1 / 6, 1 / 3, 1 / 3, 1 / 6)


def rate_of(scene: Scene, y: Array) -> Array:
    """y' of y = (x, v, omega, q) or (x, v, omega, R), without loads but gravity."""
    omega, attitude = y[6:9], y[9:]
    inertia = scene.body.inertia
    x, y_, z = omega
    if len(attitude) == 4:
        w, v = attitude[0], attitude[1:]
        turned = 0.5 * np.array([-v @ omega, *(w * omega + np.cross(v, omega))])
    else:
        hat = np.array([[0.0, -z, y_], [z, 0.0, -x], [-y_, x, 0.0]])
        turned = (attitude.reshape(3, 3) @ hat).ravel()
    spun = np.linalg.solve(inertia, -np.cross(omega, inertia @ omega))
    return np.concatenate([y[3:6], scene.gravity, spun, turned])


def diagnosis_of(
    a: Sequence[Sequence[float]],
    b: Sequence[float],
    *,
    order: int | None,
    matrix: bool = False,
    every_stage: bool = False,
    dt_s: float = 0.02,
) -> Diagnosis:
    """Return the diagnosis of a motion that is stepped by a tableau; every_stage: normalises q in each."""
    problem = Problem.of(load_scenario("intermediate-axis"), "intermediate-axis")
    scene = problem.of_body.scene
    start = scene.initial
    attitude = start.rotation.ravel() if matrix else start.quaternion
    y = np.concatenate([start.position, start.velocity, start.omega_body, attitude])
    rows = [y]
    steps = round(scene.sample_interval_s / dt_s)
    for count in range(1, steps * (scene.samples - 1) + 1):
        slopes: list[Array] = []
        for row in a:
            at = y + dt_s * sum((weight * k for weight, k in zip(row, slopes, strict=True)), 0.0 * y)
            if every_stage:
                at[9:] /= np.linalg.norm(at[9:])
            slopes.append(rate_of(scene, at))
        y = y + dt_s * sum((weight * k for weight, k in zip(b, slopes, strict=True)), 0.0 * y)
        if not matrix:
            y[9:] /= np.linalg.norm(y[9:])
        if count % steps == 0:
            rows.append(y)
    found = np.array(rows)
    path = Trajectory(
        scene.sample_times,
        found[:, :3],
        found[:, 3:6],
        quaternion=None if matrix else found[:, 9:],
        omega_body_rad_s=found[:, 6:9],
        rotation=found[:, 9:].reshape(-1, 3, 3) if matrix else None,
    )
    diagnosis = diagnosed(scene, path, problem.scales, dt_s, order=order)
    assert diagnosis is not None
    return diagnosis


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("row", "stage", "name"),
    [
        ((0.0, 0.0, 0.5), 3, "stage-4-misplaced"),
        pytest.param((0.0, 1.0), 2, "stage-3-misplaced", marks=pytest.mark.slow),
        pytest.param((0.9,), 1, "stage-2-misplaced", marks=pytest.mark.nightly),
        pytest.param((0.5, 0.0), 2, "stage-3-from-1", marks=pytest.mark.nightly),
    ],
)
def test_a_wrong_stage_is_named_with_its_place(row: tuple[float, ...], stage: int, name: str) -> None:
    """The fitted place is the planted one."""
    found = diagnosis_of((*A[:stage], row, *A[stage + 1 :]), B, order=4)
    assert (found.verdict, found.base, [fault.name for fault in found.faults]) == ("explained", "rk4", [name])
    assert [p.value for p in found.faults[0].parameters] == pytest.approx(
        [row[-1]] * name.endswith("misplaced"), abs=1e-6
    )
    assert not found.alike


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("weights", "name"),
    [
        ((1 / 6, 1 / 6, 1 / 3, 1 / 6), "weight-2"),
        pytest.param((1 / 4, 1 / 4, 1 / 4, 1 / 4), "weights-equal", marks=pytest.mark.nightly),
        pytest.param((1 / 3, 1 / 6, 1 / 6, 1 / 3), "weights-exchanged", marks=pytest.mark.nightly),
        ((1 / 6, 1 / 6, 1 / 6, 1 / 6), "weights-1-6-each"),
        ((1 / 6, 1 / 2, 1 / 6, 1 / 6), "weights"),
        pytest.param((1 / 7, 2 / 7, 3 / 7, 1 / 7), "weights", marks=pytest.mark.nightly),
    ],
)
def test_wrong_weights_are_named(weights: tuple[float, ...], name: str) -> None:
    """Alone: nothing else makes the same motion."""
    found = diagnosis_of(A, weights, order=4)
    assert (found.verdict, [fault.name for fault in found.faults]) == ("explained", [name])
    assert not found.alike
    if name == "weights":
        assert [p.value for p in found.faults[0].parameters] == pytest.approx(weights, abs=1e-6)


def test_a_value_close_to_the_right_one_is_stated_as_the_difference_from_it() -> None:
    """The rounded value would be the right one."""
    (fault,) = (one for one in FAULTS if one.name == "stage-2-misplaced")
    assert " 0.5 + 5e-08 of the step" in fault.text([0.5 * (1.0 + 1e-7)])
    assert " 0.49 of the step" in fault.text([0.49])


@pytest.mark.nightly
def test_wrong_weights_are_named_at_small_steps() -> None:
    """Where the slopes of the stages are nearly equal; the intervals of the weights contain them."""
    weights = (1 / 8, 3 / 8, 3 / 8, 1 / 8)
    found = diagnosis_of(A, weights, order=None, dt_s=1.25e-3)
    assert [fault.name for fault in found.faults] == ["weights"]
    for parameter, weight in zip(found.faults[0].parameters, weights, strict=True):
        assert parameter.low <= weight <= parameter.high
        assert parameter.value == pytest.approx(weight, abs=1e-7)


@pytest.mark.parametrize("matrix", [False, pytest.param(True, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("order", [None, 4])
def test_a_right_tableau_is_healthy(order: int | None, matrix: bool) -> None:
    """On quaternions and on matrices, whether or not the order is stated."""
    found = diagnosis_of(A, B, order=order, matrix=matrix)
    assert (found.verdict, found.faults) == ("healthy", ())


@pytest.mark.nightly
@pytest.mark.parametrize("matrix", [False, pytest.param(True, marks=pytest.mark.nightly)])
def test_a_last_stage_at_half_of_the_step_is_named_without_an_order(matrix: bool) -> None:
    """As a step function is examined, whose order nobody states."""
    found = diagnosis_of((*A[:3], (0.0, 0.0, 0.5)), B, order=None, matrix=matrix)
    assert [fault.name for fault in found.faults] == ["stage-4-misplaced"]
    assert found.base == ("RK4, additive matrix" if matrix else "rk4")


EVERY_STAGE = "RK4, additive quaternion renormalised in every stage"


@pytest.mark.nightly
@pytest.mark.parametrize("order", [None, 4])
def test_a_right_tableau_that_normalises_in_every_stage_is_healthy(order: int | None) -> None:
    """Without an order, the map is named."""
    found = diagnosis_of(A, B, order=order, every_stage=True)
    assert (found.verdict, found.faults) == ("healthy", ())
    if order is None:
        assert found.base == EVERY_STAGE


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("a", "b", "order", "name"),
    [
        (A, (1 / 6, 1 / 6, 1 / 6, 1 / 6), 4, "weights-1-6-each"),
        pytest.param(A, (1 / 3, 1 / 6, 1 / 6, 1 / 3), None, "weights-exchanged", marks=pytest.mark.slow),
        pytest.param(A, (1 / 8, 3 / 8, 3 / 8, 1 / 8), None, "weights", marks=pytest.mark.slow),
        pytest.param(A, (1 / 6, 1 / 3, 1 / 6, 1 / 3), None, "weights", marks=pytest.mark.slow),
        pytest.param((*A[:3], (0.0, 0.0, 0.5)), B, None, "stage-4-misplaced", marks=pytest.mark.slow),
        pytest.param((*A[:2], (0.0, 1.0), A[3]), B, 4, "stage-3-misplaced", marks=pytest.mark.slow),
    ],
)
def test_a_slip_in_a_method_that_normalises_in_every_stage_is_named(
    a: Sequence[Sequence[float]], b: Sequence[float], order: int | None, name: str
) -> None:
    """A wrong weight is not taken for a wrong stage."""
    found = diagnosis_of(a, b, order=order, every_stage=True)
    assert (found.verdict, found.base) == ("explained", EVERY_STAGE)
    assert [fault.name for fault in found.faults] == [name]


@pytest.mark.nightly
def test_a_method_that_no_catalogue_has_is_not_accused_of_a_slip() -> None:
    """Of order 2, from the family of Ralston (1962), with its second stage at 0.4 of the step."""
    found = diagnosis_of(((), (0.4,)), (1.0 - 1.0 / 0.8, 1.0 / 0.8), order=None)
    assert (found.verdict, found.faults) == ("unexplained", ())
