"""The search for the cheapest setting that meets an error tolerance, whatever the error's law."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.problems import FREE, End
from benchmarks.solver import Contender, Solver, cheapest, most_accurate, step_counts, tolerances, tried


def turned_end(angle: float) -> End:
    """Return the truth's end, rotated by the angle."""
    true = FREE.truth.trajectory
    if not math.isfinite(angle):
        return np.full(4, angle), true.omega_body[-1]
    w, x, y, z = true.attitude[-1]
    c, s = math.cos(angle / 2.0), math.sin(angle / 2.0)
    turned = np.array([w * c - x * s, x * c + w * s, y * c + z * s, z * c - y * s])
    return turned, true.omega_body[-1]


def contender(law: Callable[[float], float], settings: tuple[float, ...]) -> Contender:
    """Return a contender whose error at a setting follows the law; it must start from its initial state."""

    def prepare(_: object, setting: float) -> Solver:
        places = ["end"]

        def run() -> None:
            assert places[-1] == "start"
            places.append("end")

        return Solver(run, lambda: places.append("start"), end_of=lambda _: turned_end(law(setting)))

    return Contender("synthetic", "", "steps", settings, prepare)


@pytest.mark.parametrize("order", [1, 2, 4, 8])
@pytest.mark.parametrize("target", [1e-2, 1e-5, 1e-9])
def test_fewest_steps_of_a_method_of_known_order_are_found(order: int, target: float) -> None:
    """With error 0.9 n^-p the setting is the first of the grid from (target / 0.9)^(-1/p) on."""
    needed = (target / 0.9) ** (-1.0 / order)
    settings = tuple(needed * (0.9 + 0.03 * k) for k in range(10))
    found = cheapest(tried(contender(lambda n: 0.9 * n**-order, settings), FREE, target), target)
    assert found is not None
    assert found.setting == next(n for n in settings if n >= needed)


def test_search_stops_at_the_first_setting() -> None:
    """No setting beyond the first that meets the hardest target is tried: they cost the most."""
    found = tried(contender(lambda n: 1.0 / n, tuple(float(n) for n in range(1, 100))), FREE, 0.1)
    assert [one.setting for one in found] == [float(n) for n in range(1, 11)]


def test_error_that_is_not_monotone_gives_the_first_setting() -> None:
    """A more expensive setting with a smaller error is not chosen."""
    errors = {1.0: 1e-1, 2.0: 1e-4, 3.0: 1e-3, 4.0: 1e-6}
    found = tried(contender(errors.__getitem__, tuple(errors)), FREE, 1e-6)
    assert [one.setting for one in found] == [1.0, 2.0, 3.0, 4.0]
    assert [cheapest(found, target) for target in (1e-2, 1e-5)] == [found[1], found[3]]


@pytest.mark.parametrize("lost", [math.nan, math.inf])
def test_unreachable_target_gives_none(lost: float) -> None:
    """A floor above the target gives None and the best setting; NaN and infinity are never accepted."""
    errors = {1.0: lost, 2.0: 1e-3, 3.0: 1e-5, 4.0: 1e-5, 5.0: lost}
    found = tried(contender(errors.__getitem__, tuple(errors)), FREE, 1e-9)
    assert len(found) == len(errors)
    assert cheapest(found, 1e-9) is None
    assert most_accurate(found).setting == 3.0


def test_omega_counts_as_much_as_the_angle() -> None:
    """The error is the larger of the angle and of omega's error over its largest true size."""
    true = FREE.truth.trajectory
    end = true.attitude[-1], true.omega_body[-1] + np.array([0.0, 1e-4 * FREE.largest_omega, 0.0])
    assert FREE.error(end) == pytest.approx(1e-4)
    assert FREE.error((-2.0 * true.attitude[-1], true.omega_body[-1])) < 1e-15


def test_truth_of_a_free_body_is_not_the_closed_form() -> None:
    """The closed form is a contender, so the truth is the other method, with a bound below 1e-15."""
    assert FREE.truth.kind == "certified"
    assert FREE.truth.bound_rad[-1] < 1e-15
    assert replace(FREE, name="again").truth.kind == "certified"


def test_grids_are_evenly_spaced_and_equally_fine() -> None:
    """Steps are eight per octave, tolerances eight per decade, both from cheap to expensive."""
    steps, tols = np.array(step_counts(64, 4096)), np.array(tolerances(1e-2, 1e-6))
    assert (steps[0], steps[-1], len(steps)) == (64, 4096, 6 * 8 + 1)
    assert np.diff(np.log2(steps)) == pytest.approx(1 / 8, abs=0.02)
    assert (tols[0], len(tols)) == (1e-2, 4 * 8 + 1)
    assert tols[-1] == pytest.approx(1e-6)
    assert np.diff(np.log10(tols)) == pytest.approx(-1 / 8)
