"""Where a truth ends, the state from which it starts, and the cost of a long one."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import mpmath
import numpy as np
import pytest

import bodycheck
from bodycheck._util.errors import InputError
from bodycheck.reference_impl.closed_forms.exact_motion import closed_form_of
from bodycheck.reference_impl.closed_forms.fixed_axis import FixedAxisRotation
from bodycheck.reference_impl.closed_forms.fixed_axis_sensitivity import departures
from bodycheck.reference_impl.scene import (
    Drag,
    Load,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
    TorsionSpring,
)
from bodycheck.reference_impl.truth import certification as truth_module
from bodycheck.reference_impl.truth.certification import solve_truth
from tests.helpers.expected_messages import ExpectedMessage

ALIGNED = np.array([1.0, 0.0, 0.0, 0.0])
BODY = RigidBody(1.0, np.diag([1.0, 2.0, 2.5]))


def scene_of(
    *loads: Load, x: tuple[float, ...] = (1.0, 0.0, 0.0), omega: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> Scene:
    """Return a body at rest or spinning at x."""
    start = State(np.array(x), ALIGNED, np.zeros(3), np.array(omega))
    return Scene(BODY, start, loads, np.zeros(3), 10.0, 11)


def spring(rest_length: float) -> Spring:
    """Return a spring of 3 N/m from the origin to the centre of mass."""
    return Spring(np.zeros(3), np.zeros(3), 3.0, rest_length)


# --------------------------------------------------------------------------------------- where it ends


@pytest.mark.slow
@pytest.mark.parametrize("x", [1.5, 1.001])
def test_no_truth_beyond_the_anchor_of_a_spring(x: float, expected_message: ExpectedMessage) -> None:
    """A body that swings through the anchor or near it has a truth up to that time only."""
    scene = scene_of(spring(0.5), x=(x, 0.0, 0.0))
    rate = math.sqrt(3.0)
    reached = (math.pi - math.acos(0.5 / (x - 0.5))) / rate  # x = 1/2 + (x0 - 1/2) cos(rate t)
    before = solve_truth(scene, np.array([0.0, 0.99 * reached]))
    assert before.trusted_until_s == math.inf
    found = 0.5 + (x - 0.5) * math.cos(rate * 0.99 * reached)
    assert before.trajectory.position_m[1, 0] == pytest.approx(found, abs=1e-15)
    with expected_message.raises(ValueError):
        solve_truth(scene, np.array([0.0, 1.0, 1.0001 * reached]))


@pytest.mark.slow
def test_spring_that_reverses_before_its_anchor_has_a_truth() -> None:
    """A body that comes within 1e-3 m of the anchor and returns has a truth."""
    scene = scene_of(spring(0.5), x=(0.999, 0.0, 0.0))
    truth = solve_truth(scene, np.array([0.0, 10.0]))
    assert truth.trajectory.position_m[1, 0] == pytest.approx(
        0.5 + 0.499 * math.cos(math.sqrt(3.0) * 10.0), abs=1e-15
    )
    assert truth.bound_m[1] < 1e-15


@pytest.mark.slow
def test_truth_ends_at_a_start_next_to_the_anchor() -> None:
    """If the force jumps next to the start, neighbours diverge, so the truth ends after the start."""
    truth = solve_truth(scene_of(spring(0.5), x=(0.0, 0.0, 0.0)), np.array([0.0, 1.0, 2.0]))
    assert truth.trusted_until_s == 1.0
    assert np.isfinite(truth.bounds[:, 0]).all()
    assert np.isinf(truth.bound_m[1:]).all()


@pytest.mark.nightly
def test_no_truth_beyond_half_a_revolution_of_a_torsion_spring(expected_message: ExpectedMessage) -> None:
    """A torsion spring at angle pi ends the truth with a message that names it."""
    scene = scene_of(TorsionSpring(0.01), omega=(0.0, 0.0, 3.0))
    rate = math.sqrt(0.01 / 2.5)
    reached = math.asin(math.pi * rate / 3.0) / rate  # angle = 3 / rate sin(rate t)
    assert solve_truth(scene, np.array([0.0, 0.999 * reached])).bound_rad[1] < 1e-15
    with expected_message.raises(ValueError):
        solve_truth(scene, np.array([0.0, 0.5, 1.001 * reached]))


THROUGH = """
name = "through"
duration_s = 10.0
samples = 11
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
[initial]
position_m = [{x}, 0, 0]
[[forcing]]
kind = "spring"
anchor_m = [0, 0, 0]
stiffness_n_m = 3.0
rest_length_m = 0.5
"""


@pytest.mark.slow
@pytest.mark.parametrize("x", ["1.5", "0.0"])
def test_run_without_a_truth_is_refused(x: str, tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A run whose truth ends too early is refused with the reason, and so is a truth beyond its end."""
    path = tmp_path / "through.toml"
    path.write_text(THROUGH.format(x=x), encoding="utf-8")
    with expected_message.raises(InputError):
        bodycheck.run([path], engines=["reference:rk4"], dt_s=[0.1], speed=False)
    with expected_message.raises(InputError):
        bodycheck.truth(path, [0.0, 10.0])


# --------------------------------------------------------------------------------------- where it begins


ROTATED = np.array([0.6, 0.48, -0.64, 3e-7])  # its norm is 1 + 4.5e-14
WORLD = np.array([0.3, 1.0, -0.2])


@pytest.mark.parametrize(
    "tensor", [np.diag([2.0, 2.0, 2.0]), np.diag([2.0, 2.0, 3.0])], ids=["sphere", "top"]
)
def test_omega_is_that_of_the_world_after_1e9_s(tensor: np.ndarray) -> None:
    """A start in world axes is not rounded, so the momentum is constant and the angle is right.

    R(t) = exp(L t / A) R(0) exp((1 / C - 1 / A) l3 t e3), of a symmetric top and of a sphere.
    """
    start = State(np.zeros(3), ROTATED, np.zeros(3), np.zeros(3))
    start = replace(start, omega_body=start.rotation.T @ WORLD, exact_omega_world=WORLD)
    t_s = 1e9
    truth = solve_truth(Scene(RigidBody(1.0, tensor), start, (), np.zeros(3), 1.0, 2), np.array([t_s]))
    mp = mpmath.mp.clone()
    mp.dps = 50
    first = rotation(mp, ROTATED)
    world = mp.matrix(WORLD.tolist())
    momentum = first * mp.matrix(tensor.tolist()) * first.T * world
    low, high = mp.mpf(tensor[0, 0]), mp.mpf(tensor[2, 2])
    spin = (first.T * momentum)[2] * (1 / high - 1 / low)
    expected = turn(mp, momentum / low, t_s) * first * turn(mp, mp.matrix([0, 0, spin]), t_s)
    gap = mp.norm(rotation(mp, truth.trajectory.attitude[0]) - expected) / mp.sqrt(2)
    assert truth.kind == "exact"
    assert gap <= truth.bound_rad[0] < 5e-15


def rotation(mp: mpmath.MPContext, q: np.ndarray) -> mpmath.matrix:
    """R(q / |q|)."""
    w, x, y, z = (Fraction(float(c)) for c in q)
    s = w * w + x * x + y * y + z * z
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return mp.matrix([[mp.mpf((a / s).numerator) / (a / s).denominator for a in row] for row in rows])


def turn(mp: mpmath.MPContext, omega: mpmath.matrix, t_s: float) -> mpmath.matrix:
    """exp(omega t) (Rodrigues)."""
    size = mp.norm(omega)
    a, b, c = (x / size if size else mp.mpf(0) for x in omega)
    cross = mp.matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    angle = size * mp.mpf(t_s)
    return mp.eye(3) + mp.sin(angle) * cross + (1 - mp.cos(angle)) * cross * cross


def test_norm_of_the_quaternion_does_not_matter() -> None:
    """A quaternion and the same times 1 + 2^-21 give the same chaotic motion, to the last digit."""
    q = np.array([0.5, 0.5, -0.5, 0.5])
    torque = Torque("world", np.array([0.3, -0.2, 0.1]))
    scenes = [
        Scene(
            BODY,
            State(np.zeros(3), f * q, np.zeros(3), np.array([0.1, 2.0, 0.1])),
            (torque,),
            np.zeros(3),
            1.0,
            2,
        )
        for f in (1.0, 1.0 + 2.0**-21)
    ]
    one, other = (solve_truth(scene, np.array([40.0])) for scene in scenes)
    assert np.max(np.abs(one.trajectory.attitude - other.trajectory.attitude)) <= one.bound_rad[0] < 1e-15


# --------------------------------------------------------------------------------------------- the cost

FIXED_AXIS: dict[str, tuple[Load, ...]] = {
    "sine": (SineTorque("body", np.array([0.0, 0.0, 0.3]), 0.7, 0.4),),
    "sine of the world": (SineTorque("world", np.array([0.0, 0.0, 0.3]), 0.7, 1.5),),
    "spun up": (Torque("world", np.array([0.0, 0.0, 1e-6])),),
    "drag": (Drag(0.1, np.diag([0.1, 0.3, 1e-3])),),
}


@pytest.mark.parametrize("name", FIXED_AXIS)
def test_closed_form_takes_no_steps(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The truth of 1e9 s about a fixed axis, with its sensitivity, takes no steps."""

    def no_steps(*_: object) -> None:
        raise AssertionError("a closed form was integrated")

    monkeypatch.setattr(truth_module, "follow_scene", no_steps)
    truth = solve_truth(scene_of(*FIXED_AXIS[name], omega=(0.0, 0.0, 1.0)), np.array([1.0, 1e9]))
    assert truth.kind == "exact"
    assert np.isfinite(truth.bounds).all()
    assert np.isfinite(truth.round_offs).all()
    assert truth.round_off_rad[1] > truth.round_off_rad[0]


def test_growth_about_the_middle_axis_is_that_of_linear_theory() -> None:
    """For a spin w about the middle axis, an offset grows as cosh(w t r), r r = (C - B)(B - A) / A C."""
    scene = replace(scene_of(Torque("body", np.zeros(3)), omega=(0.0, 1.5, 0.0)))
    closed = closed_form_of(
        replace(scene, loads=(SineTorque("body", np.array([0.0, 1e-300, 0.0]), 1.0, 0.0),))
    )
    assert closed is not None
    assert isinstance(closed.rotation, FixedAxisRotation)
    t_s = np.array([0.0, 1.0, 5.0])
    rate = 1.5 * math.sqrt((2.5 - 2.0) * (2.0 - 1.0) / (1.0 * 2.5))
    found = departures(scene, closed.rotation, t_s)
    assert found[:, 0, 0] == pytest.approx(np.cosh(rate * t_s), rel=1e-12)
    assert found[:, 4, 1] == pytest.approx(t_s, rel=1e-12)
