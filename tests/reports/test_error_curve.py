"""Errors predicted between and beyond the measured steps, and where they are unsure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bodycheck.reports.measurement.case import SWITCH_NOTE, CaseResult
from bodycheck.reports.measurement.order import predicted_error
from bodycheck.reports.summary.error_curve import ErrorCurve, curves_of
from tests.helpers.gate_tables import make_tables

ERROR = "orientation_error_rad"
METHODS = {"mujoco": {"version": "1", "methods": {"rk4": {"order": 4}}}}
STEPS = (0.05, 0.025, 0.01, 0.005, 0.002)


def case(dt_s: float, error: float | None, message: str = "") -> CaseResult:
    """Return a case with this error; unstable without one."""
    columns: dict[str, Any] = {"control": "dt", "dt_s": dt_s, "message": message, "truth_bound_rad": 0.0}
    return CaseResult(
        columns | ({"outcome": "unstable"} if error is None else {"outcome": "ok", ERROR: error})
    )


def error_of(dt_s: float, order: float = 2.0) -> float:
    """0.1 (10 h)^p (1 + 5 h): a power law with the next order."""
    return 0.1 * (10.0 * dt_s) ** order * (1.0 + 5.0 * dt_s)


def curve(order: float = 2.0, steps: tuple[float, ...] = STEPS, **facts: Any) -> ErrorCurve:
    """Return the curve of a stable method of this order, with samples every 0.1 s."""
    cases = [case(dt_s, error_of(dt_s, order)) for dt_s in sorted(steps)]
    facts = {"verdict": "converges", "stable_s": 1.0, **facts}
    return ErrorCurve(cases, ERROR, duration_s=10.0, interval_s=0.1, **facts)


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("dt_s", [0.1, 0.04, 0.02, 4e-3, 1e-3, 2e-4])
def test_a_prediction_bounds_the_error_without_wasting_steps(order: float, dt_s: float) -> None:
    """The upper end is above the true error and within a factor of 2 of it."""
    found = curve(order).at(dt_s)
    assert found is not None
    assert found.basis == "predicted"
    assert error_of(dt_s, order) <= found.error < 2.0 * error_of(dt_s, order)


def test_the_intervals_of_predictions_hold_as_often_as_they_say() -> None:
    """Of 600 curves drawn from the model of orders, 95 % of the intervals contain the error, to 3 sigma."""
    random = np.random.default_rng(5)
    steps, powers = np.array([1e-2, 5e-3, 2e-3, 1e-3]), np.arange(1, 40)
    inside = 0
    for _ in range(600):
        h = np.append(steps, 10.0 ** random.uniform(-3.7, -1.7))
        tau, sigma = (
            np.geomspace(0.1, 0.8, 6)[random.integers(6)],
            np.geomspace(2e-4, 0.1, 16)[random.integers(16)],
        )
        bends = random.normal(size=39) * tau / np.sqrt(2.0) ** (powers - 1)
        shape = (h[:, None] / h.max()) ** powers @ bends
        errors = 1e-2 * (h / 1e-2) ** random.uniform(1.0, 4.0) * np.exp(shape + random.normal(0.0, sigma, 5))
        found = predicted_error(steps.tolist(), errors[:-1].tolist(), 1e-30, h[-1])
        inside += found.low <= errors[-1] <= found.high
    assert abs(inside / 600 - 0.95) < 3.0 * np.sqrt(0.95 * 0.05 / 600)


@pytest.mark.parametrize("order", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("error", [1e-2, 1e-4, 1e-6])
def test_the_predicted_setting_meets_the_error(order: float, error: float) -> None:
    """The setting is the coarsest admissible step that meets the error, except for one too close to it."""
    found = curve(order).coarsest_within(error)
    kept = [dt_s for dt_s in STEPS if error_of(dt_s, order) <= error]
    if found is None:
        assert kept
        return
    assert found.setting is not None
    assert error_of(found.setting, order) <= error
    coarser = [dt_s for dt_s in curve(order).steps if dt_s > 1.01 * found.setting]
    assert all(error_of(dt_s, order) > 0.5 * error for dt_s in coarser)


def test_a_measured_step_is_not_predicted() -> None:
    """A measured step has its measured error."""
    found = curve().at(0.01)
    assert found is not None
    assert (found.error, found.basis) == (error_of(0.01), "measured")


def of_errors(*errors: float) -> ErrorCurve:
    """Return a curve with these errors at STEPS."""
    return replace(curve(), cases=[case(h, e) for h, e in zip(STEPS, errors, strict=True)][::-1])


UNSURE = {
    "above the largest stable step": (curve(stable_s=0.06), 0.1, "above the largest stable step, 0.06 s"),
    "at the floor": (curve(4.0, floor=1e-11), 4e-4, "near the floor"),
    "far away": (curve(2.0, STEPS[:4]), 1e-8, "far from the measured steps"),
    "a saturated error": (
        replace(curve(1.0), cases=[case(h, 4.0 * error_of(h, 1.0)) for h in sorted(STEPS)]),
        0.1,
        "errors above 0.3 do not follow the order",
    ),
    "an unsettled order": (
        of_errors(0.2, 0.19, 0.15, 0.16, 0.14),
        1e-3,
        "do not determine the order",
    ),
    "scattered errors": (of_errors(3e-2, 1e-3, 8e-4, 2e-5, 1e-5), 1e-3, "do not determine the order"),
    "coarse steps off the order": (
        replace(curve(), cases=[*curve().cases, case(0.1, 1e-5)]),
        0.08,
        "above 0.05 s, up to which errors follow the order",
    ),
    "a single usable point": (
        ErrorCurve([case(0.01, 0.1)], ERROR, 10.0, 0.1, order=1),
        0.005,
        "predicted from dt 0.01 s and the theoretical order 1",
    ),
}


@pytest.mark.parametrize("name", UNSURE)
def test_a_prediction_without_ground_is_unsure(name: str) -> None:
    """The estimate gives the reason."""
    found, dt_s, why = UNSURE[name]
    estimate = found.at(dt_s)
    assert estimate is not None
    assert estimate.basis == "unsure"
    assert why in estimate.why


def test_what_does_not_converge_is_not_predicted() -> None:
    """Finer steps of such a method approach a motion other than the truth."""
    assert replace(curve(), verdict="does-not-converge").at(1e-4) is None
    assert replace(curve(), verdict="does-not-converge").finer_step(1e-9) is None


def test_no_step_above_the_stability_limit_is_recommended() -> None:
    """Neither is a step above the finest measured step that was unstable."""
    assert curve(4.0, stable_s=0.03).coarsest_within(1.0 / 16.0) is None
    cases = [*curve().cases, case(0.1, None)]
    assert replace(curve(), cases=cases).coarsest_within(0.2) is None


def test_steps_inside_which_a_load_switches_are_left_out() -> None:
    """They are used only if such steps were measured, because these errors include the effect."""
    assert {0.05, 0.02, 0.01} <= set(curve(switches_s=(0.3,)).steps)
    assert 0.04 not in curve(switches_s=(0.3,)).steps
    switched = [case(dt_s, error_of(dt_s), f"{SWITCH_NOTE}: 2") for dt_s in STEPS]
    assert curve().steps == replace(curve(switches_s=(0.3,)), cases=switched).steps
    assert 0.1 / 2 in curve().steps


def test_loads_that_switch_are_those_of_the_scenario() -> None:
    """Both ends of each load within the motion, as the manifest of a run has them; 0 is no switch."""
    loads = [{"kind": "torque", "from_s": 0.0, "until_s": 0.3}, {"kind": "drag"}, {"from_s": 0.7}]
    about = {"duration_s": 1.0, "samples": 11, "forcing": loads}
    run = make_tables([{ERROR: 1e-3}], scenarios={"brick": about}, engines=METHODS)
    (found,) = curves_of(run, ERROR).values()
    assert found.switches_s == (0.3, 0.7)


def test_admissible_steps_divide_the_sampling_interval() -> None:
    """Each is the interval over a product of twos and fives; all of at most 1e9 steps of a case are there."""
    most = 10**9 // 100
    products = {2**a * 5**b for a in range(24) for b in range(11)}
    strides = 0.1 / np.array(curve().steps)
    assert np.allclose(strides, np.round(strides), rtol=1e-11, atol=0.0)
    assert {*np.round(strides).astype(int).tolist()} == {one for one in products if one <= most}
    assert curve().steps[:5] == (0.1, 0.05, 0.025, 0.02, 0.0125)
