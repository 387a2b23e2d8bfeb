"""The wrench on the body, and the plan of steps that accounts for switching times."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque
from bodycheck.reference_impl.scene import ConstantLoad, PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.wrench import (
    Leg,
    StepPlan,
    Wrench,
    plan_steps,
    steps_per_sample,
    wrench_between,
    wrench_of,
)
from tests.helpers.expected_messages import ExpectedMessage

EPS = float(np.finfo(np.float64).eps)

law = settings(derandomize=True, deadline=None, max_examples=200, database=None)

BODY = RigidBody(1.7, np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]]))
GRAVITY = np.array([0.3, -0.2, -9.81])
AT_REST = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))


def scene_with(
    *loads: ConstantLoad, duration_s: float = 1.0, samples: int = 11, gravity: Array | None = None
) -> Scene:
    """Return a scene at rest under these loads."""
    pull = np.zeros(3) if gravity is None else gravity
    return Scene(BODY, AT_REST, loads, pull, duration_s, samples)


def pulse(from_s: float, until_s: float) -> Torque:
    """Return a torque of 1 N m about x in body axes that acts between two times."""
    return Torque("body", np.array([1.0, 0.0, 0.0]), from_s, until_s)


# ------------------------------------------------------------------------------------- the wrench


@pytest.mark.parametrize("seed", range(20))
def test_packed_wrench_is_the_sum_of_its_loads(seed: int) -> None:
    """At any R the kernels' torque and acceleration equal the sums over the loads with np.cross."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    loads: list[ConstantLoad] = []
    force, torque = BODY.mass * GRAVITY, np.zeros(3)
    scale = float(np.linalg.norm(force))
    for axes in ("body", "world"):
        turn = rotation if axes == "body" else np.eye(3)
        for _ in range(3):
            value, at = rng.normal(size=3), rng.normal(size=3)
            loads += [Torque(axes, value), PointForce(axes, value, at), PointForce(axes, value, np.zeros(3))]
            torque = torque + turn @ value + np.cross(rotation @ at, turn @ value)
            force = force + 2.0 * (turn @ value)
            scale += float(np.linalg.norm(value)) * (3.0 + float(np.linalg.norm(at)))
    packed = wrench_between(scene_with(*loads), 0.2, 0.3).packed(BODY, GRAVITY)
    assert packed.shape == (21,)
    matrix = tuple(rotation.ravel())
    assert np.max(np.abs(np.array(body_torque(matrix, packed)) - rotation.T @ torque)) <= 16 * EPS * scale
    moved = np.array(acceleration(matrix, packed, BODY.mass))
    assert np.max(np.abs(BODY.mass * moved - force)) <= 16 * EPS * scale


@pytest.mark.parametrize(
    ("load", "parts"),
    [
        (Torque("body", np.array([1.0, 2.0, 3.0])), {"torque_body": [1.0, 2.0, 3.0]}),
        (Torque("world", np.array([1.0, 2.0, 3.0])), {"torque_world": [1.0, 2.0, 3.0]}),
        (PointForce("world", np.array([1.0, 2.0, 3.0]), np.zeros(3)), {"force_world": [1.0, 2.0, 3.0]}),
        (
            PointForce("body", np.array([0.0, 0.0, 2.0]), np.array([3.0, 0.0, 0.0])),
            {"force_body": [0.0, 0.0, 2.0], "torque_body": [0.0, -6.0, 0.0]},
        ),
    ],
)
def test_each_load_is_in_its_own_part(load: ConstantLoad, parts: dict[str, list[float]]) -> None:
    """A load contributes only to the parts of its kind and axes, multiplied by its share."""
    wrench = wrench_of(((load, 0.25),))
    for name in ("torque_body", "torque_world", "force_body", "force_world"):
        assert np.array_equal(getattr(wrench, name), 0.25 * np.array(parts.get(name, [0.0, 0.0, 0.0])))
    assert not wrench.point_forces
    assert not wrench.is_zero


def test_world_force_off_the_centre_is_kept_with_its_point() -> None:
    """A world force with a moment is stored as a point and a force, multiplied by its share."""
    wrench = wrench_of(((PointForce("world", np.array([1.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.0])), 0.5),))
    assert len(wrench.point_forces) == 1
    at, force = wrench.point_forces[0]
    assert np.array_equal(at, [0.0, 2.0, 0.0])
    assert np.array_equal(force, [0.5, 0.0, 0.0])
    assert not wrench.is_zero


def test_no_load_is_zero_and_gravity_is_not_a_load() -> None:
    """Without loads the wrench is zero; the weight is added when the wrench is packed."""
    wrench = wrench_between(scene_with(gravity=GRAVITY), 0.0, 1.0)
    assert wrench.is_zero
    packed = wrench.packed(BODY, GRAVITY)
    assert np.array_equal(packed[3:6], BODY.mass * GRAVITY)
    assert not np.any(np.delete(packed, [3, 4, 5]))


@pytest.mark.parametrize(
    ("begin", "end", "share"),
    [
        (0.0, 0.2, 0.0),  # before
        (0.1, 0.2, 0.0),  # up to the start: [from_s, until_s) excludes earlier times
        (0.2, 0.6, 1.0),
        (0.3, 0.4, 1.0),
        (0.6, 0.7, 0.0),  # from the end on
        (0.1, 0.3, 0.5),
        (0.5, 0.7, 0.5),
        (0.0, 0.8, 0.5),
    ],
)
def test_wrench_is_the_mean_over_the_interval(begin: float, end: float, share: float) -> None:
    """A load acts in proportion to the part of the interval that it covers."""
    wrench = wrench_between(scene_with(pulse(0.2, 0.6)), begin, end)
    assert np.allclose(wrench.torque_body, [share, 0.0, 0.0], rtol=0.0, atol=4 * EPS)


# --------------------------------------------------------------------------------------- the plan


def spans(plan: StepPlan, legs: Iterator[Leg]) -> list[tuple[int, int, Wrench]]:
    """Return the first and the end step of each leg, with its wrench."""
    found, done = [], 0
    for leg in legs:
        assert leg.steps >= 1
        found.append((done, done + leg.steps, leg.wrench))
        done += leg.steps
    assert done == plan.steps
    return found


def impulse(plan: StepPlan, legs: Iterator[Leg]) -> Array:
    """Return the sum of torque times time over the legs."""
    total = np.zeros(3)
    for begin, end, wrench in spans(plan, legs):
        total += (end - begin) * plan.dt_s * wrench.torque_body
    return total


fractions = st.floats(-0.5, 1.5)
pulses = st.lists(st.tuples(fractions, fractions), min_size=0, max_size=4)


@law
@given(pulses, st.integers(1, 12), st.integers(2, 9), st.sampled_from([1.0, 0.3, 10.0, 1e-3, 123.456]))
def test_plan_covers_the_time_and_keeps_the_impulse(
    ends: list[tuple[float, float]], stride: int, samples: int, duration: float
) -> None:
    """Legs sum to all steps, samples are at their times, and each load exerts its whole impulse."""
    loads = [pulse(duration * a, duration * b) for a, b in ends if a < b]
    scene = scene_with(*loads, duration_s=duration, samples=samples)
    plan = plan_steps(scene, scene.sample_interval_s / stride)
    assert plan.steps == stride * (samples - 1)
    assert plan.dt_s * plan.steps == pytest.approx(duration, rel=2 * EPS, abs=0.0)
    done, sampled = 0, []
    for leg in plan.legs():
        done += leg.steps
        if leg.ends_at_sample:
            sampled.append(done)
    assert sampled == [stride * k for k in range(1, samples)]
    durations = [min(load.until_s, duration) - max(load.from_s, 0.0) for load in loads]
    expected = sum(max(time, 0.0) for time in durations)
    # a switch within 1e-9 of a step counts as on the grid, so both ends may lose that part of a step
    slack = (2e-9 * plan.dt_s + 8 * EPS * duration) * max(len(loads), 1)
    assert impulse(plan, plan.legs())[0] == pytest.approx(expected, rel=0.0, abs=slack)
    assert impulse(plan, plan.uninterrupted())[0] == pytest.approx(expected, rel=0.0, abs=slack)


@law
@given(st.integers(0, 100), st.integers(0, 100), st.sampled_from([1.0, 0.7, 10.0, 1e-3]))
def test_switches_on_the_grid_cut_the_legs_there(first: int, last: int, duration: float) -> None:
    """If a load switches on the grid, each step has all of it or none."""
    assume(first < last)
    scene = scene_with(
        pulse(first * (duration / 100), last * (duration / 100)), duration_s=duration, samples=11
    )
    plan = plan_steps(scene, duration / 100)
    assert plan.mid_step_switches == 0
    for begin, end, wrench in spans(plan, plan.legs()):
        assert wrench.torque_body[0] == (1.0 if first <= begin and end <= last else 0.0)
        assert end <= first or begin >= first
        assert end <= last or begin >= last


def test_switch_inside_a_step_gives_the_mean_load() -> None:
    """A pulse from 0.23 to 0.5 on steps of 0.1 has one step with 0.7 of it, followed by whole steps."""
    plan = plan_steps(scene_with(pulse(0.23, 0.5)), 0.1)
    assert plan.mid_step_switches == 1
    carried = [
        wrench.torque_body[0] for begin, end, wrench in spans(plan, plan.legs()) for _ in range(begin, end)
    ]
    assert np.allclose(carried, [0, 0, 0.7, 1, 1, 0, 0, 0, 0, 0], rtol=0.0, atol=1e-15)


def test_pulse_inside_one_step_is_not_lost() -> None:
    """A pulse shorter than a step exerts its impulse in that step."""
    plan = plan_steps(scene_with(pulse(0.42, 0.45)), 0.1)
    assert impulse(plan, plan.legs())[0] == pytest.approx(0.03, rel=1e-12, abs=0.0)


def test_switches_inside_steps_are_counted() -> None:
    """Each switch off the grid is counted, even two in one step; switches on the grid or outside are not."""
    plan = plan_steps(scene_with(pulse(0.42, 0.45), pulse(0.3, 0.61), pulse(-0.05, 1.05)), 0.1)
    assert plan.mid_step_switches == 3


def test_loads_outside_the_duration_change_nothing() -> None:
    """A load that ends before 0 or begins at the end or later leaves one segment without torque."""
    plan = plan_steps(scene_with(pulse(-2.0, -1.0), pulse(1.0, 2.0), pulse(5.0, math.inf)), 0.1)
    assert len(plan.segments) == 1
    assert plan.segments[0][1].is_zero
    always = plan_steps(scene_with(pulse(-1.0, math.inf)), 0.1)
    assert len(always.segments) == 1
    assert always.segments[0][1].torque_body[0] == 1.0


def test_switches_are_those_inside_the_open_interval() -> None:
    """Only ends strictly between 0 and the given time are switches, each listed once in ascending order."""
    scene = scene_with(pulse(0.5, 0.8), pulse(0.0, 0.5), pulse(0.2, math.inf), pulse(-1.0, 3.0))
    assert scene.switches_before(1.0) == (0.2, 0.5, 0.8)
    assert scene.switches_before(0.8) == (0.2, 0.5)
    assert scene.switches_before(4.0) == (0.2, 0.5, 0.8, 3.0)


def test_uninterrupted_legs_stop_only_where_the_wrench_changes() -> None:
    """Timing advances through all samples in one leg per wrench."""
    plan = plan_steps(scene_with(pulse(0.25, 0.55)), 0.05)
    assert [leg.steps for leg in plan.uninterrupted()] == [5, 6, 9]
    assert not any(leg.ends_at_sample for leg in plan.uninterrupted())


# ------------------------------------------------------------------------------------ what is refused


@law
@given(st.floats(1e-6, 1e6), st.integers(1, 10**6))
def test_every_whole_fraction_of_the_interval_is_accepted(interval: float, n: int) -> None:
    """interval / n with its rounding is accepted and gives n steps."""
    assert steps_per_sample(interval, interval / n) == n


@pytest.mark.parametrize(
    ("interval", "dt", "named"),
    [
        (0.1, 0.04, (0.05, 0.025)),
        (0.1, 0.03, (0.05, 0.025)),
        (0.1, 0.003, (0.004, 0.0025)),
        (1.0 / 3, 0.1, (1.0 / 9, 1.0 / 12)),
        (0.1, 0.07, (0.1, 0.05)),
        (0.1, 0.3, (0.1,)),
        (1.0, 1.0 + 1e-8, (1.0,)),
        (1.0, 0.1 + 1e-9, (0.1, 0.125)),
    ],
)
def test_refused_step_names_the_nearest_that_divide(
    interval: float, dt: float, named: tuple[float, ...], expected_message: ExpectedMessage
) -> None:
    """A step that does not divide the interval is refused with near steps that do, if possible short ones."""
    with expected_message.raises(ValueError) as refusal:
        steps_per_sample(interval, dt)
    message = str(refusal.value)
    assert repr(dt) in message
    nearest = message.split("the nearest that do: ")[1].split(" or ")
    assert sorted(float(text) for text in nearest) == sorted(named)
    for text in nearest:
        assert steps_per_sample(interval, float(text)) >= 1


@pytest.mark.parametrize("dt", [0.0, -0.0, -0.1, math.nan, math.inf, -math.inf])
def test_impossible_steps_are_refused(dt: float, expected_message: ExpectedMessage) -> None:
    """Zero, negative, infinite and undefined steps are refused with their value."""
    with expected_message.raises(ValueError) as refusal:
        plan_steps(scene_with(), dt)
    assert repr(dt) in str(refusal.value)


@pytest.mark.parametrize("dt", [1e-12, 1e-310, 5e-324])
def test_tiny_steps_are_refused(dt: float, expected_message: ExpectedMessage) -> None:
    """A step so small that the number of steps overflows or takes too long is refused with its value."""
    with expected_message.raises(ValueError) as refusal:
        steps_per_sample(1.0, dt)
    assert repr(dt) in str(refusal.value)
