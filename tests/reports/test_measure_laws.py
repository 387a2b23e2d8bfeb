"""Each measure by hand: scales, errors, invariants and work of motions of a few samples, made up."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    PointForce,
    RigidBody,
    Scene,
    Spring,
    State,
    Torque,
    TorsionSpring,
)
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement import measures
from bodycheck.reports.measurement.case import measured_by
from bodycheck.reports.measurement.invariants import (
    Invariant,
    InvariantDrift,
    invariant_drifts,
    invariants_of,
    symmetry_axis,
    worst_drift,
)
from bodycheck.reports.measurement.measures import SCALES, Compared, Motion, departures_of, reduced
from bodycheck.reports.measurement.scales import Scales, scene_scales
from bodycheck.reports.measurement.work import power, work_done, working_loads

PLACE = np.array([1.0, -2.0, 0.5])
BRICK = RigidBody(2.0, np.diag([1.0, 2.0, 3.0]))
RADIUS = math.sqrt(1.5)  # sqrt(trace I / (2 m))
QUARTER = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])  # about z


def scene(*loads: Load, gravity: float = 0.0, samples: int = 4, **parts: Any) -> Scene:
    """Return a brick for 3 s, unless told otherwise."""
    start = State(PLACE, np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    made = Scene(BRICK, start, loads, np.array([0.0, 0.0, -gravity]), 3.0, samples)
    return replace(made, **parts)


def still(samples: int = 4, **arrays: Any) -> Trajectory:
    """Return a body at rest where its scene begins, for 3 s, but for the arrays told."""
    held = {
        "t_s": np.linspace(0.0, 3.0, samples),
        "position_m": np.tile(PLACE, (samples, 1)),
        "velocity_m_s": np.zeros((samples, 3)),
        "quaternion": np.tile([1.0, 0.0, 0.0, 0.0], (samples, 1)),
        "omega_body_rad_s": np.zeros((samples, 3)),
    }
    return Trajectory(**{**held, **arrays})


def at(place: int, *values: float, samples: int = 4) -> Array:
    """Return vectors that are zero but at one sample."""
    rows = np.zeros((samples, len(values)))
    rows[place] = values
    return rows


# ------------------------------------------------------------------------------------------------- scales


@pytest.mark.parametrize(
    ("moved", "velocity", "omega", "length", "speed"),
    [
        ((3.0, 0.0, 4.0), (0.0, 6.0, 8.0), (0.0, 0.0, 2.0), 5.0, 10.0),
        ((0.3, 0.0, 0.4), (0.0, 0.6, 0.8), (0.0, 0.0, 2.0), RADIUS, 2.0 * RADIUS),
    ],
)
def test_the_scales_are_the_largest_of_the_true_motion(
    moved: tuple[float, ...],
    velocity: tuple[float, ...],
    omega: tuple[float, ...],
    length: float,
    speed: float,
) -> None:
    """Of a body that hardly moves or flies, length and speed are those of its turning parts."""
    truth = still(
        position_m=PLACE + at(2, *moved), velocity_m_s=at(1, *velocity), omega_body_rad_s=at(3, *omega)
    )
    v, w = math.hypot(*velocity), math.hypot(*omega)
    found = scene_scales(scene(), truth)
    assert vars(found) == pytest.approx(
        {
            "length_scale_m": length,
            "speed_scale_m_s": speed,
            "omega_scale_rad_s": w,
            "energy_scale_j": max(0.5 * 2.0 * v**2, 0.5 * 3.0 * w**2),
            "rotational_energy_scale_j": 0.5 * 3.0 * w**2,
            "angular_momentum_scale_kg_m2_s": 3.0 * w,
            "linear_momentum_scale_kg_m_s": 2.0 * speed,
        }
    )


# ------------------------------------------------------------------------------------------------- errors


def series_of(found: Trajectory, truth: Trajectory, made: Scene | None = None) -> dict[str, Array]:
    """Return every measure over time."""
    made = made or scene()
    compared = Compared(
        made, truth, Motion.of(made, truth), found, Motion.of(made, found), (), len(truth.t_s)
    )
    return measures.series_of(compared, departures_of(compared))


SPINNING = {"omega_body_rad_s": np.tile([0.0, 0.0, 2.0], (4, 1))}


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"position_m": PLACE + at(2, 0.3, 0.0, 0.4)}, {"position_error": 0.5}),
        (
            {"velocity_m_s": at(1, 0.0, -0.3, 0.4)},
            {
                "velocity_error": 0.5,
                "linear_momentum_drift": 1.0,
                "energy_drift": 0.25,
                "energy_balance": 0.25,
            },
        ),
        (
            {"omega_body_rad_s": np.array([0.0, 0.0, 2.0]) - at(2, 0.0, 0.0, 1.0)},
            {
                "omega_error": 1.0,
                "angular_momentum_drift": 3.0,
                "energy_drift": 4.5,
                "energy_balance": 4.5,
                "rotational_energy_drift": 4.5,
            },
        ),
        ({"quaternion": np.array([1.0, 0, 0, 0]) - at(1, 0.5, 0, 0, 0)}, {"quaternion_norm_error": 0.5}),
        (
            {"quaternion": np.array([[1.0, 0, 0, 0], QUARTER, [1.0, 0, 0, 0], [1.0, 0, 0, 0]])},
            {"orientation_error_rad": math.pi / 2.0},
        ),
    ],
)
def test_each_error_is_in_its_own_measures_and_no_other(
    arrays: dict[str, Array], told: dict[str, float]
) -> None:
    """By hand, of a brick that turns about its third axis; all else is 0, and at the end nothing is wrong."""
    found = reduced(series_of(still(**{**SPINNING, **arrays}), still(**SPINNING)), ONES)
    names = [*SCALES, "orientation_error_rad", "quaternion_norm_error"]
    assert {name: found[name] for name in names} == pytest.approx(
        {**dict.fromkeys(names, 0.0), **told}, abs=1e-15
    )
    assert found["orientation_error_final_rad"] == 0.0


ONES = Scales(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def test_a_matrix_is_measured_as_the_engine_gives_it() -> None:
    """Of 2 R: ||R^T R - 1|| = 3 sqrt(3), det - 1 = 7; a quaternion, or a matrix, that is not there is not."""
    twice = np.tile(np.eye(3), (4, 1, 1))
    twice[1] *= 2.0
    found = series_of(still(quaternion=None, rotation=twice), still())
    assert found["orthogonality_error"] == pytest.approx([0.0, 3.0 * math.sqrt(3.0), 0.0, 0.0])
    assert found["determinant_error"] == pytest.approx([0.0, 7.0, 0.0, 0.0])
    assert "quaternion_norm_error" not in found
    assert {"orthogonality_error", "determinant_error"}.isdisjoint(series_of(still(), still()))


def test_each_measure_is_divided_by_its_own_scale() -> None:
    """Seven scales, all different; 0 divides nothing, and the measure stands as `_abs` alone."""
    scales = Scales(2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 0.0)
    series = {name: np.array([0.0, 1.0, 0.5]) for name in SCALES}
    found = reduced({**series, "orientation_error_rad": np.array([3.0, 1.0, 0.25])}, scales)
    assert found == {
        **{f"{name}_abs": 1.0 for name in SCALES},
        "energy_drift": 1.0 / 7.0,
        "energy_balance": 1.0 / 7.0,
        "rotational_energy_drift": 1.0 / 11.0,
        "angular_momentum_drift": 1.0 / 13.0,
        "omega_error": 0.2,
        "position_error": 0.5,
        "velocity_error": 1.0 / 3.0,
        "orientation_error_rad": 3.0,
        "orientation_error_final_rad": 0.25,
    }


def test_the_balance_begins_with_the_first_sample_of_the_motion_itself() -> None:
    """A body that starts with another energy than the truth, and keeps it, is in balance."""
    fast = still(velocity_m_s=np.tile([1.0, 0.0, 0.0], (4, 1)))
    found = series_of(fast, still())
    assert found["energy_drift"].tolist() == [1.0, 1.0, 1.0, 1.0]
    assert found["energy_balance"].tolist() == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("load", "error", "there"),
    [
        (Torque("body", np.array([0.0, 0.0, 1.0])), 1.0, True),
        (Torque("body", np.array([0.0, 0.0, 1.0])), math.nextafter(1.0, 2.0), False),
        (Drag(1.0, np.eye(3)), 1.0, True),
        (Drag(1.0, np.eye(3)), 2.0, False),
        (TorsionSpring(1.0), 2.0, True),  # it has an energy, and does no other work
    ],
)
def test_a_balance_is_told_where_the_work_is_known_to_a_third_of_it(
    load: Load, error: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """|E - E(0) - W| of 3 J is told with an error of W of 1 J, and of nothing more."""
    monkeypatch.setattr(measures, "work_done", lambda *_: (np.array([0.0, 3.0, 1.0, 0.0]), error))
    found = series_of(still(), still(), scene(load))
    assert ("energy_balance" in found) == there
    if there and not isinstance(load, TorsionSpring):
        assert found["energy_balance"].tolist() == [0.0, 3.0, 1.0, 0.0]
    monkeypatch.setattr(measures, "work_done", lambda *_: None)
    assert ("energy_balance" in series_of(still(), still(), scene(load))) == isinstance(load, TorsionSpring)


# ---------------------------------------------------------------------------------------------- one subject


def problem(compared: int, chaotic: bool, invariants: list[Invariant]) -> Any:
    """Return what measured_by asks of a subject: a body that is truly at rest."""
    truth = still()
    return SimpleNamespace(
        scenario=SimpleNamespace(scene=scene()),
        truth=SimpleNamespace(trajectory=truth),
        motion=Motion.of(scene(), truth),
        scales=ONES,
        columns=vars(ONES),
        compared=compared,
        times=truth.t_s[:compared],
        is_chaotic=chaotic,
        invariants=invariants,
    )


def turned(*angles: float) -> Array:
    """Return rotations about z by these angles in rad (n, 4)."""
    half = 0.5 * np.array(angles)
    return np.stack([np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)], axis=-1)


def test_beyond_the_samples_compared_nothing_counts() -> None:
    """Neither an error nor an invariant's drift; what is measured of the first three is that of them."""
    found = still(quaternion=turned(0.0, 0.1, 0.05, 3.0), position_m=PLACE + at(3, 9.0, 0.0, 0.0))
    x = Invariant("x", frozenset(), lambda motion: 2.0 * motion.position_m[:, 0], lambda _: 2.0)
    measured = measured_by(problem(3, False, [x]), found, Motion.of(scene(), found))
    columns, series = measured.columns, measured.series
    assert {len(values) for values in measured.departures.values()} == {3}
    assert columns["orientation_error_rad"] == pytest.approx(0.1)
    assert columns["orientation_error_final_rad"] == pytest.approx(0.05)
    assert (columns["position_error"], columns["invariant"], columns["invariant_drift"]) == (0.0, "x", 0.0)
    assert {len(values) for values in series.values()} == {3}
    assert "horizon_s" not in columns
    measured = measured_by(problem(4, False, [x]), found, Motion.of(scene(), found))
    columns, series = measured.columns, measured.series
    assert (columns["invariant_drift_abs"], columns["invariant_drift"]) == (18.0, 9.0)
    assert series["invariant_drift"].tolist() == [0.0, 0.0, 0.0, 9.0]


@pytest.mark.parametrize(
    ("angles", "horizon"),
    [((0.0, 0.29, 0.31, 0.1), 1.0), ((0.0, 0.31, 0.1, 0.1), 0.0), ((0.0, 0.1, 0.29, 0.29), 3.0)],
)
def test_the_horizon_is_the_last_time_before_an_error_of_three_tenths(
    angles: tuple[float, ...], horizon: float
) -> None:
    """The end, where there is no such error; only a chaotic motion has one."""
    found = still(quaternion=turned(*angles))
    measured = measured_by(problem(4, True, []), found, Motion.of(scene(), found))
    columns, series = measured.columns, measured.series
    assert columns["horizon_s"] == horizon
    assert "invariant" not in columns
    assert "invariant_drift" not in series


# ---------------------------------------------------------------------------------------------- invariants


def test_the_worst_invariant_is_the_one_that_departs_most_beside_its_size() -> None:
    """One without a size comes last, and has no relative drift; of none there is no worst."""

    def made(name: str, size: float, factor: float) -> Invariant:
        return Invariant(name, frozenset(), lambda motion: factor * motion.position_m[:, 0], lambda _: size)

    found = still(position_m=PLACE + at(2, -1.0, 0.0, 0.0))
    small, large, none = made("small", 2.0, 10.0), made("large", 1.0, 6.0), made("none", 0.0, 100.0)
    for order in ((small, large, none), (none, large, small)):
        worst = worst_drift(invariant_drifts(order, still(), found))
        assert worst is not None
        assert worst.columns == {"invariant": "large", "invariant_drift_abs": 6.0, "invariant_drift": 6.0}
    unsized = worst_drift(invariant_drifts([none], still(), found))
    assert unsized is not None
    assert unsized.columns == {"invariant": "none", "invariant_drift_abs": 100.0}
    assert unsized.relative is None
    assert worst_drift([]) is None
    relative = InvariantDrift("x", np.array([1.0, 3.0]), 2.0).relative
    assert relative is not None
    assert relative.tolist() == [0.5, 1.5]


@pytest.mark.parametrize("split", [0.0, 1e-12, 1e-11])
def test_moments_within_a_part_in_a_trillion_are_equal(split: float) -> None:
    """Beyond it a body has three axes."""
    for moments, axis in (([2.0 * (1.0 - split), 2.0, 3.0], 2), ([2.0, 3.0 * (1.0 - split), 3.0], 0)):
        found = symmetry_axis(np.diag(moments))
        if split > 2e-12:
            assert found is None
        else:
            assert found is not None
            assert np.argmax(np.abs(found)) == axis


TOP = RigidBody(2.0, np.diag([1.0, 1.0, 1.75]))
ON_AXIS, OFF_AXIS = np.array([0.0, 0.0, -0.5]), np.array([0.1, 0.0, -0.5])
SPIN, VERTICAL = "spin about the symmetry axis", "vertical angular momentum about the pivot"
PUSH = Torque("world", np.array([0.1, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("made", "names"),
    [
        (scene(), []),
        (scene(body=TOP), [SPIN]),
        (scene(PUSH, body=TOP), []),
        (scene(gravity=9.81, body=TOP), [SPIN]),
        (scene(gravity=9.81, body=TOP, pivot=ON_AXIS), [SPIN, VERTICAL]),
        (scene(gravity=9.81, body=TOP, pivot=OFF_AXIS), [VERTICAL]),
        (scene(PUSH, gravity=9.81, body=TOP, pivot=ON_AXIS), []),
        (scene(body=TOP, pivot=ON_AXIS), [SPIN]),
        (scene(GravityGradient(0.1)), ["Jacobi integral"]),
        (scene(GravityGradient(0.1), PUSH), []),
        (scene(GravityGradient(0.1), GravityGradient(0.2)), []),
        (scene(TorsionSpring(1.0)), []),
    ],
)
def test_a_scene_keeps_what_its_loads_leave(made: Scene, names: list[str]) -> None:
    """A top's spin that nothing changes, the vertical momentum of a heavy body, the Jacobi integral."""
    assert [one.name for one in invariants_of(made)] == names


WHIRL = still(quaternion=np.tile(QUARTER, (4, 1)), omega_body_rad_s=np.tile([0.5, -0.25, 2.0], (4, 1)))


def test_spin_and_vertical_momentum_are_those_of_the_top_about_its_pivot() -> None:
    """omega . axis = 2, of a largest |omega|; L . g / |g| = -I3 omega_3, of a largest |L|."""
    spin, vertical = invariants_of(scene(gravity=9.81, body=TOP, pivot=ON_AXIS))
    assert np.abs(spin.of(WHIRL)) == pytest.approx(np.full(4, 2.0))
    assert spin.size(WHIRL) == pytest.approx(math.hypot(0.5, 0.25, 2.0))
    assert vertical.of(WHIRL) == pytest.approx(np.full(4, -3.5))
    about = 1.0 + 2.0 * 0.25  # Huygens and Steiner
    assert vertical.size(WHIRL) == pytest.approx(math.hypot(about * 0.5, about * 0.25, 3.5))
    assert spin.needs == {"omega"}
    assert vertical.needs == {"attitude", "omega"}


def test_the_jacobi_integral_is_that_of_the_formula() -> None:
    """1/2 omega . I omega - n h . L + 3/2 n^2 u . I u, by hand: a quarter turn about z takes y to -x."""
    rate, t = 0.4, WHIRL.t_s
    (jacobi,) = invariants_of(scene(GravityGradient(rate)))
    kinetic = 0.5 * (1.0 * 0.25 + 2.0 * 0.0625 + 3.0 * 4.0)
    along_y = 0.5  # x of the body lies along y of the world, so L_y = I1 omega_1
    u_x, u_z = -np.sin(rate * t), -np.cos(rate * t)  # u along x of the world is along -y of the body
    field = 1.5 * rate**2 * (2.0 * u_x**2 + 3.0 * u_z**2)
    assert jacobi.of(WHIRL) == pytest.approx(kinetic - rate * along_y + field, rel=1e-12, abs=0.0)
    assert jacobi.size(WHIRL) == pytest.approx(kinetic)
    assert jacobi.needs == {"attitude", "omega"}


def test_the_jacobi_integral_knows_on_which_side_the_planet_lies() -> None:
    """Of a brick tipped about the orbit's normal the field differs between u and its mirror image."""
    rate, tip, t = 0.4, 0.3, WHIRL.t_s
    (jacobi,) = invariants_of(scene(GravityGradient(rate)))
    half = np.tile([math.cos(0.5 * tip), 0.0, math.sin(0.5 * tip), 0.0], (4, 1))
    tipped = still(quaternion=half, omega_body_rad_s=WHIRL.omega_body)
    # u stands at the angle n t in the world, about y, and the body at its tip
    first, third = -np.sin(rate * t - tip), -np.cos(rate * t - tip)
    field = 1.5 * rate**2 * (1.0 * first**2 + 3.0 * third**2)
    kinetic = 0.5 * (1.0 * 0.25 + 2.0 * 0.0625 + 3.0 * 4.0)
    along_y = 2.0 * -0.25
    assert jacobi.of(tipped) == pytest.approx(kinetic - rate * along_y + field, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(("off", "there"), [(0.0, True), (1e-11, False), (-1e-11, False)])
def test_kovalevskayas_invariant_is_that_of_her_top(off: float, there: bool) -> None:
    """I1 = I2 = 2 I3 about the pivot, the arm across the axis; |(p + iq)^2 - c (a + ib)|^2, by hand."""
    mass, arm = 2.0, 0.5
    # about the pivot diag(2, 2, 1), so about the centre the arm along x takes m l^2 from I2 and I3
    body = RigidBody(mass, np.diag([2.0, 1.5, 0.5 + off]))
    made = scene(gravity=10.0, body=body, pivot=np.array([-arm, 0.0, 0.0]))
    found = [one for one in invariants_of(made) if one.name == "Kovalevskaya's invariant"]
    assert bool(found) == there
    if not there:
        return
    tipped = still(
        quaternion=np.tile([math.cos(0.3), 0.0, math.sin(0.3), 0.0], (4, 1)),
        omega_body_rad_s=WHIRL.omega_body,
    )
    c = mass * 10.0 * arm / 1.0
    spin, pull = complex(0.5, -0.25) ** 2, c * complex(-math.sin(0.6), 0.0)  # up in body axes, tipped about y
    assert found[0].of(tipped) == pytest.approx(np.full(4, abs(spin - pull) ** 2))
    assert found[0].size(tipped) == pytest.approx((abs(spin) + abs(pull)) ** 2)
    assert found[0].needs == {"attitude", "omega"}


# ---------------------------------------------------------------------------------------------------- work

THROWN = still(
    samples=31,
    velocity_m_s=np.tile([1.0, 2.0, 3.0], (31, 1)),
    omega_body_rad_s=np.tile([0.5, -0.25, 2.0], (31, 1)),
)
FORCE = PointForce("world", np.array([2.0, -1.0, 0.5]), np.array([0.0, 0.0, 0.1]))
RATE = 2.0 - 2.0 + 1.5 + (0.1 * 0.5 + 0.2 * -0.25)  # F . v + (r x F) . omega, r x F = (0.1, 0.2, 0)


def test_power_is_that_of_force_and_torque() -> None:
    """F . v + tau . omega of all loads together."""
    assert power(scene(), [FORCE], THROWN) == pytest.approx(np.full(31, RATE))
    both = power(scene(), [FORCE, Torque("world", np.array([0.0, 0.0, 4.0]))], THROWN)
    assert both == pytest.approx(np.full(31, RATE + 8.0))
    assert power(scene(), [], THROWN).tolist() == [0.0] * 31


@pytest.mark.parametrize(("begin", "end"), [(0.0, math.inf), (1.0, math.inf), (0.0, 2.0), (1.0, 2.0)])
def test_work_grows_while_a_load_is_at_work_and_then_stays(begin: float, end: float) -> None:
    """A constant power from one time to another; before and after it nothing is done."""
    made = scene(replace(FORCE, from_s=begin, until_s=end), samples=31)
    done = work_done(made, THROWN)
    assert done is not None
    work, error = done
    assert work == pytest.approx(RATE * np.clip(THROWN.t_s - begin, 0.0, min(end, 3.0) - begin), abs=1e-12)
    assert error <= 1e-12


def test_the_errors_of_the_pieces_add_up() -> None:
    """Of a power that no spline follows, switched once, the error is more than of either piece alone."""
    rough = replace(THROWN, velocity_m_s=np.random.default_rng(1).normal(size=(31, 3)))
    first, last = replace(FORCE, until_s=1.0), replace(FORCE, from_s=1.0)
    errors = [work_done(scene(*loads, samples=31), rough) for loads in ((first,), (last,), (first, last))]
    one, other, both = (found[1] for found in errors if found is not None)
    assert both == pytest.approx(one + other)
    assert min(one, other) > 1e-3


@pytest.mark.parametrize(
    "made",
    [
        scene(Drag(1.0, np.eye(3)), samples=31),
        scene(FORCE, samples=31, pivot=ON_AXIS),
        scene(replace(FORCE, from_s=1.0001), samples=31),
        scene(
            replace(FORCE, until_s=0.6), samples=31
        ),  # six intervals, where a spline of degree 7 needs seven
    ],
)
def test_work_that_the_samples_cannot_tell_is_none(made: Scene) -> None:
    """A load that lasts, a pivot, a switch between samples, too few samples between two switches."""
    assert work_done(made, THROWN) is None
    assert work_done(scene(replace(FORCE, until_s=0.7), samples=31), THROWN) is not None


def test_what_has_a_potential_energy_does_no_work() -> None:
    """Springs are left out, and a load outside its time; drag and torque are in."""
    drag, push = Drag(1.0, np.eye(3)), replace(PUSH, from_s=1.0, until_s=2.0)
    made = scene(drag, push, TorsionSpring(1.0), Spring(np.zeros(3), np.zeros(3), 1.0, 0.0))
    assert working_loads(made, 1.0, 2.0) == [push, drag]
    assert working_loads(made, 0.0, 1.0) == [drag]
