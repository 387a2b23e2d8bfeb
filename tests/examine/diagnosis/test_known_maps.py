"""Which maps of the library are tried on a recording: no map that could have made it is left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.examine.diagnosis.diagnosis import Search
from bodycheck.examine.diagnosis.known_maps import FARTHER, HELD_ALIKE, REPRESENTATIVES
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps import EXACT, MAPS
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Loads,
    Motion,
    OneStepMap,
    Solid,
    back,
    times,
    zero_order_hold,
)
from bodycheck.reference_impl.rotations import conjugate, log_quaternion, normalised, quaternion_product
from bodycheck.reports.measurement.scales import scene_scales
from bodycheck.scenarios.library import load_scenario

_STATES = 6
_ROUND_OFF = 1e-13


def _loads(draw: np.random.Generator) -> Loads:
    """Return constant loads in body and in world axes, and a drag, some of them absent."""
    constant = draw.normal(size=(4, 3)) * draw.integers(0, 2, (4, 1))
    torque_body, torque_world, force_body, force_world = constant
    drag = 0.3 * draw.integers(0, 2)

    def loads(
        t: Array, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        del t, position
        force = times(rotation, np.broadcast_to(force_body, omega.shape)) + force_world - drag * velocity
        return force, torque_body + back(rotation, torque_world - drag * omega)

    return loads


def _departures(
    one: OneStepMap, solid: Solid, start: Motion, h: float, loads: Loads, exact: Motion
) -> list[Array]:
    """Return how far a step of a map is from the exact one in position, velocity, attitude and omega."""
    if "matrix" in one.attitude:
        start = replace(start, rotation=start.orthogonal)
    end = one.step(solid, start, np.full(_STATES, h), loads)
    turned = quaternion_product(conjugate(normalised(exact.quaternion)), normalised(end.quaternion))
    moved, pushed = end.position - exact.position, end.velocity - exact.velocity
    return [moved, pushed, log_quaternion(turned), end.omega - exact.omega]


@pytest.mark.parametrize(("wrong", "maps"), [(0.0, {"M1", "M1, step angle at most pi/4"}), (1e-3, set())])
def test_a_long_log_has_the_maps_of_its_rows_and_no_row_is_left_out(wrong: float, maps: set[str]) -> None:
    """Most maps are tried in 2000 of 5000 steps, but what is left is tried in all of them."""
    scene = load_scenario("free-flight").scene
    scene = replace(scene, duration_s=20.0, samples=5001)
    made = record(Reference(), Case(scene, "m1", Setting(0.004, None))).trajectory
    assert made is not None
    rates = made.omega_world.copy()
    rates[1002] *= 1.0 + wrong
    made = replace(made, omega_world_rad_s=rates, omega_body_rad_s=None)
    known = frozenset({"position", "velocity", "attitude", "omega"})
    search = Search.of(scene, made, scene_scales(scene, made), 0.004, known)
    assert search is not None
    assert {one.name for one in search.matches} == maps


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("seed", range(4))
def test_no_map_is_farther_from_the_exact_motion_than_representatives_of_its_order_suggest(
    seed: int,
) -> None:
    """Every map is within ten times their distance, and with held loads so near to the first of them."""
    draw = np.random.default_rng(seed)
    moments, axes = np.array([0.4, 0.7, 0.9]), np.linalg.qr(draw.normal(size=(3, 3)))[0]
    solid = Solid(np.ones(_STATES), np.repeat([(axes * moments) @ axes.T], _STATES, axis=0))
    position, velocity, omega = draw.normal(size=(3, _STATES, 3)) * [[[1.0]], [[1.0]], [[3.0]]]
    start = Motion(np.zeros(_STATES), position, velocity, normalised(draw.normal(size=(_STATES, 4))), omega)
    loads, h = _loads(draw), 0.01 * draw.uniform(0.2, 1.0)
    exact = EXACT.step(solid, start, np.full(_STATES, h), loads)

    def size(parts: list[Array]) -> Array:
        return np.array([np.sqrt(np.mean(part**2)) for part in parts])

    for order, names in REPRESENTATIVES.items():
        few = [MAPS[name] for name in names]
        farthest = np.max([size(_departures(one, solid, start, h, loads, exact)) for one in few], axis=0)
        allowed = FARTHER * farthest + _ROUND_OFF
        first = next(one for one in few if one.stages)
        holds = [zero_order_hold(loads, start, in_body_axes=axes) for axes in (False, True)]
        held = [_departures(first, solid, start, h, hold, exact) for hold in holds]
        for one in MAPS.values():
            if one is EXACT or one.order == 0 or min(one.order, max(REPRESENTATIVES)) != order:
                continue
            assert np.all(size(_departures(one, solid, start, h, loads, exact)) <= allowed), one.name
            for hold, other in zip(holds if one.stages else [], held, strict=False):
                own = _departures(one, solid, start, h, hold, exact)
                gaps = [part - beside for part, beside in zip(own, other, strict=True)]
                assert np.all(size(gaps) <= allowed + HELD_ALIKE * size(other)), f"{one.name}, loads held"
