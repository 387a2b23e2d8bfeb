"""Work equals gained energy along the truth of every forced scenario; invariants are constant."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Drag, GravityGradient, Scene
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.invariants import invariant_drifts, invariants_of, worst_drift
from bodycheck.reports.measurement.work import power, running_integral, working_loads
from bodycheck.scenarios.library import load_scenario, load_scenarios

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_PANELS = 60

FORCED = [
    how
    for how, scenario in load_scenarios(["full"])
    if not scenario.scene.is_free_rotation or scenario.scene.gravity.any()
]


def imbalance(scene: Scene, working: Scene) -> float:
    """max |E - E(0) - W| over max |E| + integral of |P|: one scene's motion, the work of another's loads."""
    switches = scene.switches_before(scene.duration_s)
    edges = np.unique([*np.linspace(0.0, scene.duration_s, _PANELS + 1), *switches, *_early(scene)])
    middles, halves = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    nodes = (middles[:, None] + halves[:, None] * _NODES).ravel()
    truth = solve_truth(scene, np.concatenate([edges, nodes])).trajectory
    energy = EnergyAndMomentum.of(scene, truth).energy[: len(edges)]
    work, total = [0.0], 0.0
    for i, (begin, end) in enumerate(pairwise(edges)):
        rates = power(scene, working_loads(working, begin, end), truth)[len(edges) :].reshape(-1, 12)[i]
        work.append(work[-1] + halves[i] * float(_WEIGHTS @ rates))
        total += halves[i] * float(_WEIGHTS @ np.abs(rates))
    return float(np.max(np.abs(energy - energy[0] - work)) / (np.max(np.abs(energy)) + total))


def _early(scene: Scene) -> Array:
    """Return times ever closer to the start if a drag acts, which may be over within milliseconds."""
    drags = any(isinstance(load, Drag) for load in scene.loads)
    return np.geomspace(1e-4, 1.0, _PANELS if drags else 1) * scene.duration_s


@pytest.mark.slow
@pytest.mark.nightly(after=6)
@pytest.mark.parametrize("name", FORCED)
def test_work_equals_gained_energy(name: str) -> None:
    """The energy of the truth, springs and weight included, changes by the work of all else, to 1e-13."""
    scene = load_scenario(name).scene
    assert imbalance(scene, scene) <= 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("name", ["detumbling", "satellite-libration", "damped-fall"])
def test_missing_load_unbalances_the_energy(name: str) -> None:
    """Without the work of one load the balance is off by a thousandth or more."""
    scene = load_scenario(name).scene
    lighter = tuple(load for load in scene.loads if not isinstance(load, Drag | GravityGradient))
    assert imbalance(scene, replace(scene, loads=lighter)) > 1e-3


KEPT = {
    "lagrange-top": {"spin about the symmetry axis", "vertical angular momentum about the pivot"},
    "sleeping-top/9.0": {"spin about the symmetry axis", "vertical angular momentum about the pivot"},
    "heavy-top": {"vertical angular momentum about the pivot"},
    "kovalevskaya-top": {"Kovalevskaya's invariant", "vertical angular momentum about the pivot"},
    "satellite-libration": {"Jacobi integral"},
    "symmetric-top": {"spin about the symmetry axis"},
    "torsion-spring": set(),
    "compass": set(),
    "detumbling": set(),
    "self-excited": set(),
}


@pytest.mark.slow
@pytest.mark.nightly(after=7)
@pytest.mark.parametrize("name", KEPT)
def test_truth_conserves_the_invariants_of_its_scene(name: str) -> None:
    """Each invariant is constant along the truth to 1e-14 of its size."""
    scene = load_scenario(name).scene
    truth = solve_truth(scene, scene.sample_times).trajectory
    found = invariants_of(scene)
    assert {one.name for one in found} == KEPT[name]
    for one in found:
        values = one.of(truth)
        assert np.max(np.abs(values - values[0])) <= 1e-14 * one.size(truth)


@pytest.mark.parametrize("name", [name for name, kept in KEPT.items() if kept])
def test_invariant_detects_damping(name: str) -> None:
    """A damped copy of the truth drifts in each invariant; the worst is named, relative to its size."""
    scene = load_scenario(name).scene
    truth = solve_truth(scene, scene.sample_times).trajectory
    damped = replace(
        truth, omega_body_rad_s=truth.omega_body * np.linspace(1.0, 0.99, scene.samples)[:, None]
    )
    drifts = {
        one.name: np.max(np.abs(one.of(damped) - one.of(truth))) / one.size(truth)
        for one in invariants_of(scene)
    }
    assert min(drifts.values()) > 1e-4
    worst = worst_drift(invariant_drifts(invariants_of(scene), truth, damped))
    assert worst is not None
    assert worst.columns["invariant"] == max(drifts, key=lambda one: drifts[one])
    assert worst.columns["invariant_drift"] == pytest.approx(max(drifts.values()))


@pytest.mark.parametrize("degree", [5, 7])
@pytest.mark.parametrize("n", [8, 9, 41])
def test_integral_of_a_spline_is_exact_for_its_polynomials(n: int, degree: int) -> None:
    """From t_0 on it is exact up to the spline's degree, for any samples, and not beyond."""
    t = 0.3 + 0.9 * np.linspace(0.0, 1.0, n) ** 1.5
    integral = running_integral(t.tobytes(), degree)
    for power_of_t in range(degree + 1):
        exact = (t ** (power_of_t + 1) - t[0] ** (power_of_t + 1)) / (power_of_t + 1)
        assert np.max(np.abs(integral(t**power_of_t) - exact)) < 2e-14
    beyond = degree + 1
    exact = (t ** (beyond + 1) - t[0] ** (beyond + 1)) / (beyond + 1)
    assert np.max(np.abs(integral(t**beyond) - exact)) > 1e-13
