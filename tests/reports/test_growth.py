"""The growth of drifts: synthetic series of known growth, known methods, and the limits of each kind."""

from __future__ import annotations

import math
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
from bodycheck.reports.measurement.growth import (
    Growth,
    _last_decade,
    _power_law,
    _random_walk_like,
    growth_of,
)

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
MIN_TOLD = {"bounded": 0.9, "sqrt": 0.6, "linear": 1.0, "quadratic": 1.0, "exponential": 0.9}


@pytest.mark.parametrize("kind", SERIES)
def test_synthetic_series_is_classified(kind: str) -> None:
    """Over 200 seeds at most 2 % are classified as another kind, and most as their own."""
    generator = np.random.default_rng(7)
    found = Counter(growth_of(TIMES, SERIES[kind](generator), 1e-12).growth for _ in range(SEEDS))
    reported = found[kind] / SEEDS
    others = 1.0 - reported - found[None] / SEEDS
    assert reported >= MIN_TOLD[kind]
    assert others <= 0.02


@pytest.mark.parametrize(("kind", "exponent"), [("sqrt", 0.5), ("linear", 1.0), ("quadratic", 2.0)])
def test_interval_contains_the_exponent(kind: str, exponent: float) -> None:
    """The interval contains the exponent for at least nine of ten seeds."""
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
def test_series_of_no_kind_is_not_classified(growing: float) -> None:
    """Neither a jump halfway nor a cube has a kind."""
    series = np.where(SHARE < 0.5, 0.01, 1.0) if growing == 1.0 else SHARE**growing
    assert growth_of(TIMES, series, 1e-12).growth is None


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
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(("method", "dt_s", "quantity", "kind"), KNOWN)
def test_methods_have_their_known_growth(
    method: str, dt_s: float, quantity: str, kind: str, tmp_path: Path
) -> None:
    """The energy error of a symplectic method is bounded, that of Runge-Kutta linear."""
    path = tmp_path / "long.toml"
    path.write_text(LONG)
    run = bodycheck.run([path], engines=[f"reference:{method}"], dt_s=[dt_s], speed=False, laws=False)
    assert run.methods.set_index("quantity")["growth"][quantity] == kind


@pytest.mark.slow
def test_finest_case_above_round_off_is_classified(tmp_path: Path) -> None:
    """A finer step with round-off alone does not hide the growth of the method."""
    path = tmp_path / "long.toml"
    path.write_text(LONG)
    run = bodycheck.run([path], engines=["reference:splitting6"], dt_s=[0.25, 0.02], speed=False, laws=False)
    assert run.methods.set_index("quantity")["growth"]["energy_drift"] == "bounded"


@pytest.mark.nightly
def test_round_off_grows_as_a_random_walk() -> None:
    """The energy of a million symplectic steps drifts as the root of t.

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


# ------------------------------------------------------------------------ limits of each kind, without noise


T = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 601)])
STUDENT = 3.182446305284263  # of 3 degrees of freedom: Abramowitz and Stegun (1964), table 26.10


@pytest.mark.parametrize(
    ("power", "kind"),
    [
        (0.0, "bounded"),
        (0.09, "bounded"),
        (0.11, None),
        (0.24, None),
        (0.26, "sqrt"),
        (0.74, "sqrt"),
        (0.76, None),
        (0.84, None),
        (0.86, "linear"),
        (1.19, "linear"),
        (1.21, None),
        (1.74, None),
        (1.76, "quadratic"),
        (2.29, "quadratic"),
        (2.31, None),
    ],
)
def test_power_of_t_has_the_kind_of_its_band(power: float, kind: str | None) -> None:
    """The exponent is the power, with an interval of zero width."""
    found = growth_of(T, T**power, 1e-12)
    assert found.growth == kind
    assert (found.growth_exponent, found.growth_exponent_low, found.growth_exponent_high) == pytest.approx(
        3 * (power,), abs=1e-9
    )


@pytest.mark.parametrize(("rate", "reported"), [(2.0, False), (3.0, True), (20.0, True)])
def test_exponential_needs_a_final_slope(rate: float, reported: bool) -> None:
    """Its slope against log t must exceed 1.5 at the end."""
    assert (growth_of(T, np.exp(rate * T), 1e-12).growth == "exponential") == reported


def misfit(argument: Array, values: Array) -> float:
    """Return the root of the mean squared residual of a straight line, by numpy's fit."""
    fitted = np.polyval(np.polyfit(argument, values, 1), argument)
    return float(np.sqrt(np.mean((values - fitted) ** 2)))


@pytest.mark.parametrize(("gain", "reported"), [(3.1, True), (2.9, False)])
def test_exponential_fits_t_three_times_better_than_log_t(gain: float, reported: bool) -> None:
    """Between exp(t) and a power that grows with log t, the residuals of log M decide."""
    x = np.linspace(math.log(1e-2), 0.0, 40)

    def log_drift(at: Array, share: float) -> Array:
        return 40.0 * ((1.0 - share) * np.exp(at) + share * (at - x[0]) ** 2 / 20.0)

    low, high = 0.0, 1.0
    for _ in range(50):
        share = 0.5 * (low + high)
        values = log_drift(x, share)
        better = misfit(x, values) > gain * misfit(np.exp(x), values)
        low, high = (share, high) if better else (low, share)
    drift = np.exp(log_drift(np.log(np.maximum(T, 1e-2)), low))
    assert (growth_of(T, drift, 1e-12).growth == "exponential") == reported


def test_interval_is_that_of_the_slopes_of_four_pieces() -> None:
    """Student's t with three degrees of freedom, of the slopes in each half of the two decades."""
    x = np.log(np.maximum(T, 1e-9) / 1e-2)  # from 0 over two decades
    found = growth_of(T, np.exp(np.where(x < 0.0, 0.9 * x, 0.9 * x + 0.02 * x**2)), 1e-12)
    assert found.growth_exponent is not None
    assert found.growth_exponent_low is not None
    assert found.growth_exponent_high is not None
    edges = np.linspace(0.0, math.log(100.0), 5)
    slopes = 0.9 + 0.02 * (edges[1:] + edges[:-1])
    half = STUDENT * float(np.std(slopes, ddof=1)) / 2.0
    # the series is read at forty points, and straight between them
    assert found.growth_exponent_high - found.growth_exponent == pytest.approx(half, rel=5e-3)
    assert found.growth_exponent - found.growth_exponent_low == pytest.approx(half, rel=5e-3)


@pytest.mark.parametrize(("decades", "reported"), [(1.52, True), (1.48, False)])
def test_classification_needs_one_and_a_half_decades_above_the_floor(decades: float, reported: bool) -> None:
    """Values below the floor do not count."""
    assert (growth_of(T, T, 10.0**-decades) != Growth()) == reported


def test_the_first_sample_above_the_floor_begins_the_decades() -> None:
    """From 1 to 31.7 are one and a half decades, from the next sample on fewer."""
    t = np.concatenate([[0.0, 1.0], np.linspace(2.0, 31.7, 120)])
    assert growth_of(t, t, 0.5) != Growth()
    assert growth_of(t, t, 1.5) == Growth()
    assert growth_of(t, t, 1.0) == Growth()  # a drift at the floor is not above it
    t[-1] = 10.0**1.5
    assert growth_of(t, t, 0.5) != Growth()


@pytest.mark.parametrize(("samples", "reported"), [(100, True), (99, False)])
def test_classification_needs_a_hundred_samples(samples: int, reported: bool) -> None:
    """Those of the last two decades count, the first one included."""
    t = np.concatenate([[0.0], np.geomspace(1e-5, 0.9e-2, 500), np.geomspace(1e-2, 1.0, samples)])
    assert (growth_of(t, t, 1e-12) != Growth()) == reported
    assert growth_of(np.concatenate([t, [1.0001]])[: len(t)], 2.0 * t, 3.0) == Growth()


def test_changed_slope_in_the_last_decade_has_no_kind() -> None:
    """A linear growth may be a tenth steeper or flatter at the end."""
    for late, kind in ((1.28, "linear"), (1.45, None)):
        early = 2.0 - late
        drift = np.where(T < 0.1, T**early * 0.1 ** (late - early), T**late)
        assert growth_of(T, drift, 1e-12).growth == kind


def drift_of(slopes: tuple[float, ...]) -> Array:
    """Return a drift whose log rises with these slopes against log t, by pieces of the last two decades."""
    edges = np.linspace(math.log(1e-2), 0.0, len(slopes) + 1)
    heights = np.concatenate([[0.0], np.cumsum(np.array(slopes) * np.diff(edges))])
    return np.asarray(np.exp(np.interp(np.log(np.maximum(T, 1e-9)), edges, heights)))


def test_oscillation_before_its_return_is_not_a_random_walk() -> None:
    """A first slope of 1, a jump, and a final slope of 0 each exclude a random walk."""
    for slopes, kind in (
        ((0.5, 0.5, 0.5, 0.5), "sqrt"),
        ((1.0, 0.4, 0.4, 0.3), None),
        ((0.2, 1.6, 0.1, 0.2), None),
        ((0.2, 1.2, 0.5, 0.05), None),
        ((0.8, 0.0, 0.0, 0.0), "bounded"),
    ):
        assert growth_of(T, drift_of(slopes), 1e-12).growth == kind, slopes


def test_exponential_steepens_after_its_first_half_decade() -> None:
    """The slopes of exp(10 t) are exponential; with one lower than the one before they are not."""
    for slopes, kind in (
        ((0.2, 0.6, 1.9, 5.9), "exponential"),
        ((0.7, 0.6, 1.9, 5.9), "exponential"),
        ((0.2, 0.9, 0.3, 5.9), None),
    ):
        assert growth_of(T, drift_of(slopes), 1e-12).growth == kind, slopes


@pytest.mark.parametrize(
    ("exponent", "late", "kind"),
    [
        (0.85, 0.75, "linear"),
        (1.2, 1.3, "linear"),
        (0.849, 1.0, None),
        (1.201, 1.2, None),
        (1.0, 0.749, None),
        (1.0, 1.301, None),
        (1.75, 1.65, "quadratic"),
        (2.3, 2.4, "quadratic"),
        (2.301, 2.3, None),
    ],
)
def test_power_law_is_that_of_the_series_and_of_its_last_decade(
    exponent: float, late: float, kind: str | None
) -> None:
    """The bands include their edges; the last decade may leave them by 0.1."""
    slack = math.copysign(1e-12, 1.0 - late) if exponent < 1.5 else math.copysign(1e-12, 2.0 - late)
    assert _power_law(exponent, late + slack) == kind


@pytest.mark.parametrize(
    ("exponent", "late", "slopes", "kind"),
    [
        (0.249, 0.099, (0.5, 0.1), "bounded"),
        (0.25, 0.099, (0.5, 0.3), None),
        (0.249, 0.1, (0.5, 0.3), None),
        (0.25, 0.201, (0.5, 0.3), "sqrt"),
        (0.75, 0.201, (0.5, 0.3), "sqrt"),
        (0.76, 0.201, (0.5, 0.3), None),
        (0.5, 0.2, (0.5, 0.3), None),
        (0.5, 0.3, (0.85, 0.3), None),
        (0.5, 0.3, (0.849, 0.101), "sqrt"),
        (0.5, 0.3, (0.849, 0.1), None),
        (0.5, 0.3, (0.5, 1.49, 0.3), "sqrt"),
        (0.5, 0.3, (0.5, 1.5, 0.3), None),
    ],
)
def test_random_walk_grows_on_and_irregularly(
    exponent: float, late: float, slopes: tuple[float, ...], kind: str | None
) -> None:
    """Each bound excludes its edge, except those of the exponent of a random walk."""
    assert _random_walk_like(exponent, late, np.array(slopes)) == kind


def test_last_decade_includes_its_first_point() -> None:
    """Of logarithms of time, those up to log 10 before the last one."""
    x = math.log(10.0) * np.array([0.0, 0.5, 0.9, 1.0, 1.5, 2.0])
    last, values = _last_decade(x, np.arange(6.0))
    assert last.tolist() == x[3:].tolist()
    assert values.tolist() == [3.0, 4.0, 5.0]
