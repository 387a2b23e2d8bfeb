"""How drifts grow: of series made up to be what they are called, and of methods of which it is known."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import bodycheck
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import rotational_energy
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reports.measurement.growth import growth_of

N = 1001
TIMES = np.linspace(0.0, 50.0, N)
SHARE = TIMES / TIMES[-1]
SEEDS = 200


def ripple(generator: np.random.Generator) -> Array:
    """Return an oscillation between 0.7 and 1.3, of 5 to 60 periods."""
    return 1.0 + 0.3 * np.sin(2 * np.pi * generator.uniform(5, 60) * SHARE + generator.uniform(0, 6))


def walk(generator: np.random.Generator) -> Array:
    """Return the distance that a random walk in space has come."""
    steps = generator.normal(size=(N - 1, 3))
    return np.concatenate([[0.0], np.linalg.norm(np.cumsum(steps, axis=0), axis=1)])


def swing(generator: np.random.Generator) -> Array:
    """Return |sin| of 5 to 60 periods, its height changing a little."""
    return np.abs(np.sin(2 * np.pi * generator.uniform(5, 60) * SHARE)) * ripple(generator)


SERIES: dict[str, Callable[[np.random.Generator], Array]] = {
    "bounded": swing,
    "sqrt": walk,
    "linear": lambda generator: SHARE * ripple(generator),
    "quadratic": lambda generator: SHARE**2 * ripple(generator),
    "exponential": lambda generator: np.exp(generator.uniform(8, 25) * SHARE) * ripple(generator),
}
LEAST_TOLD = {"bounded": 0.9, "sqrt": 0.6, "linear": 1.0, "quadratic": 1.0, "exponential": 0.9}


@pytest.mark.parametrize("kind", SERIES)
def test_a_series_is_called_what_it_was_made_to_be(kind: str) -> None:
    """Of 200 seeds nearly none is called another kind, and most are told."""
    generator = np.random.default_rng(7)
    found = Counter(growth_of(TIMES, SERIES[kind](generator), 1e-12).growth for _ in range(SEEDS))
    told = found[kind] / SEEDS
    others = 1.0 - told - found[None] / SEEDS
    assert told >= LEAST_TOLD[kind]
    assert others <= 0.02


@pytest.mark.parametrize(("kind", "exponent"), [("sqrt", 0.5), ("linear", 1.0), ("quadratic", 2.0)])
def test_the_interval_holds_the_exponent(kind: str, exponent: float) -> None:
    """In at least nine of ten seeds."""
    generator = np.random.default_rng(8)
    grown = [growth_of(TIMES, SERIES[kind](generator), 1e-12) for _ in range(SEEDS)]
    held = [
        found.growth_exponent_low <= exponent <= found.growth_exponent_high
        for found in grown
        if found.growth_exponent_low is not None and found.growth_exponent_high is not None
    ]
    assert len(held) == SEEDS
    assert np.mean(held) >= 0.9


@pytest.mark.parametrize("growing", [1.0, 3.0])
def test_what_fits_no_kind_is_called_none(growing: float) -> None:
    """A jump halfway is none of them, nor is a cube."""
    series = np.where(SHARE < 0.5, 0.01, 1.0) if growing == 1.0 else SHARE**growing
    assert growth_of(TIMES, series, 1e-12).growth is None


def test_a_series_that_stays_at_its_floor_says_nothing() -> None:
    """There is neither a kind nor an exponent below the floor, or with too few samples above it."""
    nothing = growth_of(TIMES, SHARE, 2.0)
    assert (nothing.growth, nothing.growth_exponent) == (None, None)
    assert growth_of(TIMES[:50], SHARE[:50], 1e-12).growth_exponent is None
    assert growth_of(TIMES, SHARE, 0.5).growth_exponent is None


LONG = """
name = "long tumble"
duration_s = 2000.0
samples = 2001
[body]
mass_kg = 2.0
inertia_kg_m2 = [2.0, 3.0, 4.0]
[initial]
omega_body_rad_s = [1.0, 1.5, -1.2]
"""
KNOWN = [
    # symplectic on the rigid body's Poisson manifold (McLachlan 1993, Phys. Rev. Lett. 71, 3043)
    ("splitting6", 0.25, "energy_drift", "bounded"),
    ("splitting6", 0.25, "orientation_error_rad", "linear"),
    ("rk4", 0.1, "energy_drift", "linear"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("method", "dt_s", "quantity", "kind"), KNOWN)
def test_methods_grow_as_they_are_known_to(
    method: str, dt_s: float, quantity: str, kind: str, tmp_path: Path
) -> None:
    """A symplectic method keeps its energy bounded, Runge-Kutta loses it steadily."""
    path = tmp_path / "long.toml"
    path.write_text(LONG)
    run = bodycheck.run([path], engines=[f"reference:{method}"], dt_s=[dt_s], speed=False)
    assert run.methods.set_index("quantity")["growth"][quantity] == kind


@pytest.mark.slow
def test_the_finest_case_that_is_no_round_off_tells_the_growth(tmp_path: Path) -> None:
    """A finer step, whose energy is off by round-off alone, does not hide what the method itself does."""
    path = tmp_path / "long.toml"
    path.write_text(LONG)
    run = bodycheck.run([path], engines=["reference:splitting6"], dt_s=[0.25, 0.02], speed=False)
    assert run.methods.set_index("quantity")["growth"]["energy_drift"] == "bounded"


@pytest.mark.slow
def test_round_off_walks() -> None:
    """The energy of a million symplectic steps, their own error far below eps, strays as the root of t.

    One walk may go anywhere: of five starts the exponents' median is near a half, and none is called steady.
    """
    grown = []
    for omega in ([1.0, 1.5, -1.2], [1.1, 1.4, -1.2], [0.9, 1.5, -1.1], [1.0, 1.3, -1.5], [0.8, 1.2, 1.2]):
        start = State(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.array(omega))
        scene = Scene(RigidBody(2.0, np.diag([2.0, 3.0, 4.0])), start, (), np.zeros(3), 10000.0, 2001)
        motion = record(Reference(), Case(scene, "splitting6", Setting(dt_s=0.01))).trajectory
        assert motion is not None
        energy = rotational_energy(scene.body.inertia, motion.omega_body)
        grown.append(growth_of(scene.sample_times, np.abs(energy / energy[0] - 1.0), 1e-15))
    assert {found.growth for found in grown} <= {"sqrt", None}
    assert 0.3 < np.median([found.growth_exponent or 0.0 for found in grown]) < 0.7
