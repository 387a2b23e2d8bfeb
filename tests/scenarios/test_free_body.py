"""A free body given by a few numbers, as a scenario."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.scenarios.free_body import FreeBody, scenario_text
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members
from tests.helpers.expected_messages import ExpectedMessage

MOMENTS = [0.002, 0.003, 0.004]


def scenario(body: FreeBody, horizon_s: float | None = None) -> Scenario:
    """Return the scenario that the text of a body defines."""
    (found,) = parse_members(scenario_text(body, horizon_s, "body"), "here", Path()).values()
    return found


def test_the_numbers_of_the_body_are_those_of_the_scene() -> None:
    """Mass, moments and omega are those given, without loads; a single omega is the size of the vector."""
    scene = scenario(FreeBody(0.5, MOMENTS, [1.0, -2.0, 3.0])).scene
    assert scene.body.mass == 0.5
    assert np.array_equal(scene.body.inertia, np.diag(MOMENTS))
    assert np.array_equal(scene.initial.omega_body, [1.0, -2.0, 3.0])
    assert not scene.loads
    equal = scenario(FreeBody(0.5, MOMENTS, [20.0])).scene.initial.omega_body
    assert np.all(equal == equal[0])
    assert np.linalg.norm(equal) == pytest.approx(20.0, rel=1e-15)


@pytest.mark.parametrize("omega", [1e-3, 0.7, 3.0, 20.0, 628.0, 1e5])
def test_duration_and_sampling_follow_the_spin(omega: float) -> None:
    """There are 10 to 50 rotations, samples 0.5 to 1.3 rad apart, and steps down to a thousandth of that."""
    found = scenario(FreeBody(1.0, MOMENTS, [omega]))
    rotations = omega * found.duration_s / (2.0 * math.pi)
    assert 10.0 <= rotations <= 50.0
    angle = omega * found.scene.sample_interval_s
    assert 0.5 * (1.0 - 1e-9) <= angle <= 1.3
    assert found.steps[-1] * omega <= 5e-3
    assert round(found.duration_s / found.steps[-1]) <= 200_000


def test_a_horizon_is_the_duration() -> None:
    """The duration is the horizon, even if it is very short or contains millions of rotations."""
    for horizon_s in (1e-6, 0.3, 1e9):
        found = scenario(FreeBody(1.0, MOMENTS, [20.0]), horizon_s)
        assert found.duration_s == horizon_s
        assert found.samples <= 10_001


@pytest.mark.parametrize(
    "body",
    [
        FreeBody(-1.0, MOMENTS, [1.0]),
        FreeBody(1.0, [1.0, 2.0, 9.0], [1.0]),
        FreeBody(1.0, [1.0, 2.0], [1.0]),
        FreeBody(1.0, MOMENTS, [1.0, 2.0]),
        FreeBody(1.0, MOMENTS, [0.0, 0.0, 0.0]),
        FreeBody(1.0, MOMENTS, [math.nan]),
    ],
)
def test_impossible_bodies_are_refused(body: FreeBody, expected_message: ExpectedMessage) -> None:
    """The error names the option or the key."""
    with expected_message.raises(InputError):
        scenario_text(body, None, "body")
