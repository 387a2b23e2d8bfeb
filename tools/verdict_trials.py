"""Judge made-up series of errors: without a law, with one wrong step, and healthy; and scale scenes in time.

    python tools/verdict_trials.py --series 400 --healthy 2000 --seed 1 --scales=-40,-30,-21,30,40

Without a law: errors drawn log-uniformly over ten decades, of which at most 2 % may have an order. One wrong
step: power laws of order 1, 2, 4 and 6 with a next-order term and scatter of 1 %, in which one interior error
below 0.3 is 1e2 to 1e5 times too large; it must be found in 95 %. Healthy: the series of
tests/reports/test_order.py; none may be accused, and each must have the order that it has without the test of
its fit. Scales: the truth of ten scenes in which a second is so many powers of two longer; its attitudes must
have the same bits, and so must its angular velocities and positions in their units. Prints the figures. Exit
status 1 if one is missed.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
from trials import command

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reports.measurement import order as fits
from bodycheck.reports.measurement.convergence import Criteria, Point, convergence_of
from bodycheck.scenarios.library import load_scenarios
from tests.reports.test_order import LADDERS
from tests.reports.test_order import series as healthy_series

_STEPS = (0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005)
_FLOOR = 1e-14
_SCENES = (
    *("body-torque", "heavy-top", "sine-torque", "spring-pendulum", "satellite-libration"),
    *("powered-flight", "detumbling", "torsion-spring", "probe", "compass"),
)
_SECONDS = {
    **dict.fromkeys(("value", "amplitude", "stiffness", "field"), -2),
    **dict.fromkeys(("linear", "angular", "rate"), -1),
    **dict.fromkeys(("from_s", "until_s"), 1),
}
"""The power of the second in the units of the parameters of loads; 0 for all others."""


def main(series: int = 400, healthy: int = 2000, seed: int = 1, scales: str = "-40,-30,-21,30,40") -> bool:
    """Print the figures; return whether one is missed. scales: powers of two."""
    chance = np.random.default_rng(seed)
    failed = 0
    for points in (6, 7, 8):
        ordered = sum(
            fits.settled_order(
                _STEPS[:points], tuple(0.3 * 10.0 ** chance.uniform(-10.0, 0.0, points)), _FLOOR
            )
            is not None
            for _ in range(series)
        )
        print(f"{points} points without a law: {series}, with an order: {ordered}", flush=True)
        failed += ordered > 0.02 * series
    for order in (1, 2, 4, 6):
        found = sum(one_wrong(chance, order) for _ in range(series))
        print(f"order {order}, one wrong step: {series}, found: {found}", flush=True)
        failed += found < 0.95 * series
    accused = changed = 0
    for number in range(healthy):
        steps = np.array(LADDERS[4 + number % 4])
        _, errors, floor = healthy_series(chance, steps, 10.0 ** chance.uniform(-3.0, -2.0))
        points = [Point(h, e) for h, e in zip(steps, errors, strict=True)]
        accused += convergence_of(points, Criteria(floor)).verdict in ("does-not-converge", "error-grows")
        changed += with_fit(tuple(steps), tuple(errors), floor)
    print(f"healthy: {healthy}, accused: {accused}, with another order: {changed}")
    powers = [int(text) for text in scales.split(",")]
    equal = sum(has_equal_bits(name, power) for name in _SCENES for power in powers)
    print(f"scaled in time: {len(_SCENES) * len(powers)}, with equal bits: {equal}")
    failed += equal < len(_SCENES) * len(powers)
    return failed + accused + changed > 0


def one_wrong(chance: np.random.Generator, order: int) -> bool:
    """Whether the wrong step of a power law is a finding with its error."""
    steps = np.array(_STEPS[: int(chance.integers(5, 9))])
    z = steps / steps[0]
    while True:
        law = 10.0 ** chance.uniform(-6.0, -1.0) * z**order * (1.0 + chance.uniform(-0.5, 0.5) * z)
        errors: Array = law * np.exp(0.01 * chance.normal(size=len(steps)))
        place = int(chance.integers(1, len(steps) - 1))
        errors[place] *= 10.0 ** chance.uniform(2.0, 5.0)
        if errors[place] < 0.3:
            break
    points = [Point(h, e) for h, e in zip(steps, errors, strict=True)]
    found = convergence_of(points, Criteria(min(_FLOOR, 1e-3 * float(errors.min()))))
    return (found.verdict, found.excluded_dt_s) == ("does-not-converge", steps[place])


def with_fit(steps: tuple[float, ...], errors: tuple[float, ...], floor: float) -> bool:
    """Whether the test of the fit changes the order of a series."""
    tested = fits.settled_order(steps, errors, floor)
    least, fits._MIN_FIT = fits._MIN_FIT, 0.0
    try:
        fits.settled_order.cache_clear()
        return tested != fits.settled_order(steps, errors, floor)
    finally:
        fits._MIN_FIT = least
        fits.settled_order.cache_clear()


def scaled(scene: Scene, power: int) -> Scene:
    """Return the same motion, 2**power times as slow."""

    def units(seconds: int) -> float:
        return 2.0 ** (power * seconds)

    loads = []
    for load in scene.loads:
        found = {one.name: getattr(load, one.name) for one in fields(load) if one.name in _SECONDS}
        loads.append(replace(load, **{name: value * units(_SECONDS[name]) for name, value in found.items()}))
    start, exact = scene.initial, scene.initial.exact_omega_world
    initial = replace(
        start,
        velocity=start.velocity * units(-1),
        omega_body=start.omega_body * units(-1),
        exact_omega_world=None if exact is None else exact * units(-1),
    )
    duration_s, gravity = scene.duration_s * units(1), scene.gravity * units(-2)
    return replace(scene, initial=initial, loads=tuple(loads), gravity=gravity, duration_s=duration_s)


def has_equal_bits(name: str, power: int) -> bool:
    """Whether the truth of a scene and that of the scaled one have the same bits; prints a difference."""
    ((_, scenario),) = load_scenarios([name])
    times = scenario.scene.sample_times[:: max(1, scenario.scene.samples // 10)]
    one = solve_truth(scenario.scene, times).trajectory
    try:
        other = solve_truth(scaled(scenario.scene, power), times * 2.0**power).trajectory
    except InputError as refused:
        print(f"{name} x 2^{power}: {refused}")
        return False
    assert one.omega_body_rad_s is not None
    assert other.omega_body_rad_s is not None
    pairs = (
        (one.quaternion, other.quaternion),
        (one.omega_body_rad_s, other.omega_body_rad_s * 2.0**power),
        (one.position_m, other.position_m),
    )
    return all(np.array_equal(np.asarray(before), np.asarray(after)) for before, after in pairs)


if __name__ == "__main__":
    command(main)
