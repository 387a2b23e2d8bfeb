"""The hard suite: each scenario is as hard as its summary states, by numbers that are computed here."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

from bodycheck.reference_impl.scene import Drag, Scene, Spring
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.scenarios.library import load_scenarios, suites
from bodycheck.scenarios.model import Scenario


def members(name: str) -> list[Scenario]:
    """Return a built-in scenario, or all members of a family."""
    return [scenario for _, scenario in load_scenarios([name])]


def only(name: str) -> Scenario:
    """Return a built-in scenario that is not a family."""
    (scenario,) = members(name)
    return scenario


def omega(scene: Scene) -> float:
    """Return |omega| at the start in rad/s."""
    return float(np.linalg.norm(scene.initial.omega_body))


def test_separatrix_is_met_exactly_and_approached_to_1e_12() -> None:
    """I1 (I2 - I1) omega1^2 - I3 (I3 - I2) omega3^2 is 0 for one member, in rational arithmetic."""
    beside = []
    for scenario in members("separatrix"):
        i1, i2, i3 = (Fraction(float(x)) for x in np.diag(scenario.scene.body.inertia))
        w1, _, w3 = (Fraction(float(x)) for x in scenario.scene.initial.omega_body)
        beside.append(abs(1 - i1 * (i2 - i1) * w1**2 / (i3 * (i3 - i2) * w3**2)) / 2)
    assert min(beside) == 0
    np.testing.assert_allclose(sorted(float(b) for b in beside)[1:], [1e-12, 1e-9, 1e-6, 1e-3], rtol=2e-3)


def test_two_moments_are_nearly_equal() -> None:
    """The two moments have relative differences of 1e-3 to 1e-12."""
    gaps = [float(np.diff(np.diag(s.scene.body.inertia))[0] / 2.0) for s in members("near-symmetric")]
    np.testing.assert_allclose(gaps, [1e-3, 1e-6, 1e-9, 1e-12], rtol=1e-3)


def test_needle_and_plate_are_at_the_limits_of_a_body() -> None:
    """One moment is 1e-6 of the others; the two smaller ones sum to the largest one, to round-off."""
    needle = np.diag(only("needle").scene.body.inertia)
    assert needle[2] / needle[0] == 1e-6
    low, middle, high = np.linalg.eigvalsh(only("tilted-plate").scene.body.inertia)
    assert low + middle == pytest.approx(high, rel=1e-15, abs=0.0)
    tensor = only("tilted-plate").scene.body.inertia
    assert np.all(tensor[np.triu_indices(3, 1)] != 0.0)


def test_steps_span_from_a_hundredth_of_a_radian_to_half_a_turn() -> None:
    """|omega| dt at the start spans this range."""
    scenario = only("turn-per-step")
    turned = omega(scenario.scene) * np.array(scenario.steps)
    assert turned.max() == pytest.approx(math.pi, rel=1e-12, abs=0.0)
    assert turned.min() == pytest.approx(0.01, rel=0.02)


def test_extreme_scenarios_have_their_sizes() -> None:
    """There are 1000 rad/s, masses and moments over 18 decades, and 1e8 m from the origin."""
    assert omega(only("fast-spin").scene) == 1000.0
    bodies = [scenario.scene.body for scenario in members("light-and-heavy")]
    np.testing.assert_allclose([body.mass for body in bodies], [1e-9, 1.0, 1e9], rtol=1e-14)
    for body in bodies:
        np.testing.assert_allclose(body.inertia / body.mass, bodies[0].inertia / bodies[0].mass, rtol=1e-13)
    assert np.abs(only("far-from-origin").scene.initial.position).min() == 1e8


def test_long_runs_are_long() -> None:
    """The long runs have a million steps and a duration of a day."""
    scenario = only("long-tumble")
    assert scenario.duration_s / min(scenario.steps) >= 1e6 * (1.0 - 1e-12)
    assert only("slow-day").duration_s == 86400.0


def test_stiff_loads_are_beyond_the_explicit_limit() -> None:
    """The coarsest step is above 2 / rate, where explicit Euler is unstable, and the finest is below."""
    spring, drag = (only(name) for name in ("stiff-spring", "stiff-drag"))
    rates = []
    for load in (*spring.scene.loads, *drag.scene.loads):
        if isinstance(load, Spring):
            rates.append((spring, math.sqrt(load.stiffness / spring.scene.body.mass)))
        if isinstance(load, Drag):
            rates.append((drag, load.linear / drag.scene.body.mass))
            eigenvalues = np.linalg.eigvals(np.linalg.solve(drag.scene.body.inertia, load.angular))
            rates.append((drag, float(eigenvalues.real.max())))
    assert len(rates) == 3
    for scenario, rate in rates:
        assert min(scenario.steps) < 2.0 / rate < max(scenario.steps)


def test_torques_switch_between_steps() -> None:
    """No switching time is a multiple of a step that the scenario lists."""
    scenario = only("off-grid-torque")
    switches = np.array(scenario.scene.switches_before(scenario.duration_s))
    assert len(switches) == 4
    for step in scenario.steps:
        assert np.all(np.abs(switches / step - np.round(switches / step)) > 1e-3)


def test_chaotic_top_outlasts_its_truth() -> None:
    """Even double-double arithmetic loses the motion before the end of the run."""
    scene = only("chaotic-top").scene
    truth = solve_truth(scene, scene.sample_times)
    assert 0.5 * scene.duration_s < truth.trusted_until_s < scene.duration_s


@pytest.mark.parametrize("name", suites()["hard"])
def test_hard_suite_has_at_most_the_steps_of_ten_minutes(name: str) -> None:
    """The total number of steps of each scenario is within the limit for a suite of ten minutes."""
    for scenario in members(name):
        assert sum(scenario.duration_s / step for step in scenario.steps) < 1.01e6
