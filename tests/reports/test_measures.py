"""The measures: each by hand on motions of a few samples, and planted faults against a healthy method."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from bodycheck.adapters.stable_step import energy_blowup, invalid_state, kinetic_limit
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum
from bodycheck.reference_impl.imu import ImuReadings, has_imu, imu_mistake, imu_point
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import exp_matrix, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import (
    ConstantLoad,
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
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.measurement import compared_motion, measures
from bodycheck.reports.measurement.case import measured_by
from bodycheck.reports.measurement.case_columns import COLUMNS, ComparedCase
from bodycheck.reports.measurement.compared_motion import Compared, EnergyAndMomentum
from bodycheck.reports.measurement.invariants import (
    Invariant,
    InvariantDrift,
    invariant_drifts,
    invariants_of,
    symmetry_axis,
    worst_drift,
)
from bodycheck.reports.measurement.measure_bounds import TRUTH_BOUNDS, bound_of
from bodycheck.reports.measurement.measures import (
    ORIENTATION,
    SCALES,
    departures_of,
    reduced,
    series_of,
)
from bodycheck.reports.measurement.scales import Scales, scene_scales
from bodycheck.reports.measurement.work import power, work_done, working_loads
from bodycheck.reports.run_files.tables import TABLES
from bodycheck.scenarios.library import load_any, load_one, scenario_names, tree_names

PLACE = np.array([1.0, -2.0, 0.5])
BRICK = RigidBody(2.0, np.diag([1.0, 2.0, 3.0]))
RADIUS = math.sqrt(1.5)  # sqrt(trace I / (2 m))
QUARTER = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])  # about z


def scene(*loads: Load, gravity: float = 0.0, samples: int = 4, **parts: Any) -> Scene:
    """Return a brick for 3 s, with the given parts replaced."""
    start = State(PLACE, np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    made = Scene(BRICK, start, loads, np.array([0.0, 0.0, -gravity]), 3.0, samples)
    return replace(made, **parts)


def still(samples: int = 4, **arrays: Any) -> Trajectory:
    """Return a body at rest at the start of its scene, for 3 s, with the given arrays replaced."""
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
def test_scales_are_the_largest_of_the_true_motion(
    moved: tuple[float, ...],
    velocity: tuple[float, ...],
    omega: tuple[float, ...],
    length: float,
    speed: float,
) -> None:
    """If the body hardly moves, length and speed are those of its rotating parts."""
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


def series_of_motion(found: Trajectory, truth: Trajectory, made: Scene | None = None) -> dict[str, Array]:
    """Return every measure over time."""
    made = made or scene()
    compared = Compared(
        made,
        truth,
        EnergyAndMomentum.of(made, truth),
        found,
        EnergyAndMomentum.of(made, found),
        (),
        len(truth.t_s),
    )
    return measures.series_of(compared, departures_of(compared))


SPINNING = {"omega_body_rad_s": np.tile([0.0, 0.0, 2.0], (4, 1))}


ERRORS: list[tuple[dict[str, Array], dict[str, float]]] = [
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
]


@pytest.mark.parametrize(("arrays", "reported"), ERRORS)
def test_each_error_is_in_its_own_measures(arrays: dict[str, Array], reported: dict[str, float]) -> None:
    """For a brick that rotates about its third axis, the others of these and the final error are 0."""
    found = reduced(series_of_motion(still(**{**SPINNING, **arrays}), still(**SPINNING)), {}, ONES)
    names = {name for _, values in ERRORS for name in values}
    assert {name: found[name] for name in names} == pytest.approx(
        {**dict.fromkeys(names, 0.0), **reported}, abs=1e-15
    )
    assert found["orientation_error_final_rad"] == 0.0


ONES = Scales(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def test_matrix_is_measured_as_returned() -> None:
    """Of 2 R: ||R^T R - 1|| = 3 sqrt(3), det - 1 = 7; a missing quaternion or matrix has no measure."""
    twice = np.tile(np.eye(3), (4, 1, 1))
    twice[1] *= 2.0
    found = series_of_motion(still(quaternion=None, rotation=twice), still())
    assert found["orthogonality_error"] == pytest.approx([0.0, 3.0 * math.sqrt(3.0), 0.0, 0.0])
    assert found["determinant_error"] == pytest.approx([0.0, 7.0, 0.0, 0.0])
    assert "quaternion_norm_error" not in found
    assert {"orthogonality_error", "determinant_error"}.isdisjoint(series_of_motion(still(), still()))


def test_each_measure_is_divided_by_its_own_scale() -> None:
    """Seven different scales; with a scale of 0 there is only the measure `_abs`."""
    scales = Scales(2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 0.0)
    series = {name: np.array([0.0, 1.0, 0.5]) for name in SCALES}
    found = reduced({**series, "orientation_error_rad": np.array([3.0, 1.0, 0.25])}, {}, scales)
    assert found.items() >= {f"{name}_abs": 1.0 for name in SCALES}.items()
    assert "linear_momentum_drift" not in found
    expected = {
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
    assert found.items() >= expected.items()


@pytest.mark.parametrize(("measure", "bound"), [("energy_drift", 1e-12), ("rotational_energy_drift", 4e-12)])
def test_bound_of_an_energy_is_relative_to_the_scale_of_its_measure(measure: str, bound: float) -> None:
    """1e-12 of the whole 8 J is 8e-12 J: 4e-12 of a rotational energy of 2 J."""
    columns = {"truth_bound_energy": 1e-12, "energy_scale_j": 8.0, "rotational_energy_scale_j": 2.0}
    assert bound_of(columns, measure) == pytest.approx(bound, rel=1e-15)


def test_balance_starts_with_the_first_sample_of_the_motion() -> None:
    """A body that starts with another energy than the truth, and conserves it, is balanced."""
    fast = still(velocity_m_s=np.tile([1.0, 0.0, 0.0], (4, 1)))
    found = series_of_motion(fast, still())
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
def test_balance_needs_the_work_to_a_third(
    load: Load, error: float, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """|E - E(0) - W| of 3 J is measured if the error of W is at most 1 J."""
    monkeypatch.setattr(compared_motion, "work_done", lambda *_: (np.array([0.0, 3.0, 1.0, 0.0]), error))
    found = series_of_motion(still(), still(), scene(load))
    assert ("energy_balance" in found) == there
    if there and not isinstance(load, TorsionSpring):
        assert found["energy_balance"].tolist() == [0.0, 3.0, 1.0, 0.0]
    monkeypatch.setattr(compared_motion, "work_done", lambda *_: None)
    assert ("energy_balance" in series_of_motion(still(), still(), scene(load))) == isinstance(
        load, TorsionSpring
    )


# ---------------------------------------------------------------------------------------------- one subject


def problem(compared: int, chaotic: bool, invariants: list[Invariant]) -> Any:
    """Return the parts of a problem that measured_by needs, for a body at rest."""
    truth = still()
    return SimpleNamespace(
        scenario=SimpleNamespace(scene=scene()),
        truth=SimpleNamespace(trajectory=truth),
        motion=EnergyAndMomentum.of(scene(), truth),
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


def test_samples_beyond_the_comparison_do_not_count() -> None:
    """Errors and invariants are those of the first three samples."""
    found = still(quaternion=turned(0.0, 0.1, 0.05, 3.0), position_m=PLACE + at(3, 9.0, 0.0, 0.0))
    x = Invariant("x", frozenset(), lambda motion: 2.0 * motion.position_m[:, 0], lambda _: 2.0)
    columns, moved = measured_by(problem(3, False, [x]), found, EnergyAndMomentum.of(scene(), found))
    series = moved.series
    assert {len(values) for values in moved.departures.values()} == {3}
    assert columns["orientation_error_rad"] == pytest.approx(0.1)
    assert columns["orientation_error_final_rad"] == pytest.approx(0.05)
    assert (columns["position_error"], columns["invariant"], columns["invariant_drift"]) == (0.0, "x", 0.0)
    assert {len(values) for values in series.values()} == {3}
    assert "horizon_s" not in columns
    columns, moved = measured_by(problem(4, False, [x]), found, EnergyAndMomentum.of(scene(), found))
    series = moved.series
    assert (columns["invariant_drift_abs"], columns["invariant_drift"]) == (18.0, 9.0)
    assert series["invariant_drift"].tolist() == [0.0, 0.0, 0.0, 9.0]


@pytest.mark.parametrize(
    ("angles", "horizon"),
    [
        ((0.0, 0.29, 0.31, 0.1), 1.0),
        ((0.0, 0.31, 0.1, 0.1), 0.0),
        ((0.31, 0.31, 0.31, 0.31), 0.0),
        ((0.0, 0.1, 0.29, 0.29), 3.0),
    ],
)
def test_horizon_is_the_last_time_before_an_error_of_0_3_rad(
    angles: tuple[float, ...], horizon: float
) -> None:
    """It is the end without such an error; only a chaotic motion has one."""
    found = still(quaternion=turned(*angles))
    columns, moved = measured_by(problem(4, True, []), found, EnergyAndMomentum.of(scene(), found))
    series = moved.series
    assert columns["horizon_s"] == horizon
    assert "invariant" not in columns
    assert "invariant_drift" not in series


def test_an_error_of_0_3_rad_is_within_the_horizon() -> None:
    """Only a larger one ends it; if the first sample is wrong, there is none."""

    def horizon_s(*errors_rad: float) -> float:
        facts: Any = SimpleNamespace(is_chaotic=True, times=np.arange(3.0))
        case = ComparedCase(facts, cast(Any, None), {ORIENTATION: np.array(errors_rad)})
        (of_motion,) = (one.of_motion for one in COLUMNS if one.name == "horizon_s")
        assert of_motion is not None
        return float(of_motion(case))

    assert horizon_s(0.4, 0.4, 0.4) == horizon_s(0.0, 0.4, 0.0) == 0.0
    assert horizon_s(0.0, 0.3, 0.4) == 1.0
    assert horizon_s(0.0, 0.3, 0.3) == 2.0


# ---------------------------------------------------------------------------------------------- invariants


def test_worst_invariant_has_the_largest_relative_drift() -> None:
    """One without a size comes last and has no relative drift; without invariants there is no worst."""

    def made(name: str, size: float, factor: float) -> Invariant:
        return Invariant(name, frozenset(), lambda motion: factor * motion.position_m[:, 0], lambda _: size)

    found = still(position_m=PLACE + at(2, -1.0, 0.0, 0.0))
    small, large, none = made("small", 2.0, 10.0), made("large", 1.0, 6.0), made("none", 0.0, 100.0)
    for order in ((small, large, none), (none, large, small)):
        worst = worst_drift(invariant_drifts(order, still(), found))
        assert worst is not None
        assert worst.columns == {"invariant": "large", "invariant_drift_abs": 6.0, "invariant_drift": 6.0}
    tiny = made("tiny", 1.0, 0.0)
    assert worst_drift(invariant_drifts([none, tiny], still(), found)).name == "tiny"  # type: ignore[union-attr]
    unsized = worst_drift(invariant_drifts([none], still(), found))
    assert unsized is not None
    assert unsized.columns == {"invariant": "none", "invariant_drift_abs": 100.0}
    assert unsized.relative is None
    assert worst_drift([]) is None
    for size in (2.0, 0.5):
        relative = InvariantDrift("x", np.array([1.0, 3.0]), size).relative
        assert relative is not None
        assert relative.tolist() == [1.0 / size, 3.0 / size]


@pytest.mark.parametrize("split", [0.0, 1e-12, 1e-11])
def test_moments_within_1e_12_are_equal(split: float) -> None:
    """Beyond it a body has three axes; a sphere has none."""
    assert symmetry_axis(np.eye(3)) is None
    assert symmetry_axis(np.diag([1.0, 1.0 + 3e-12, 2.0])) is None  # relative to the largest
    for moments, axis in (([2.0 * (1.0 - split), 2.0, 3.0], 2), ([2.0, 3.0 * (1.0 - split), 3.0], 0)):
        found = symmetry_axis(np.diag(moments))
        if split > 2e-12:
            assert found is None
        else:
            assert found is not None
            assert np.argmax(np.abs(found)) == axis


TOP = RigidBody(2.0, np.diag([1.0, 1.0, 1.75]))
# symmetric about its pivot, (0.5, 0, 0) m, about the axis z, on which its centre is not
ROUND_ABOUT_PIVOT = RigidBody(2.0, np.diag([2.0, 1.5, 1.75]))
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
        (scene(gravity=9.81, body=TOP, pivot=np.array([9e-7, 0.0, 0.0])), [VERTICAL]),
        (scene(gravity=9.81, body=ROUND_ABOUT_PIVOT, pivot=np.array([0.5, 0.0, 0.0])), [VERTICAL]),
        (scene(PUSH, gravity=9.81, body=TOP, pivot=ON_AXIS), []),
        (scene(body=TOP, pivot=ON_AXIS), [SPIN]),
        (scene(GravityGradient(0.1)), ["Jacobi integral"]),
        (scene(GravityGradient(0.1), PUSH), []),
        (scene(GravityGradient(0.1), GravityGradient(0.2)), []),
        (scene(TorsionSpring(1.0)), []),
    ],
)
def test_invariants_depend_on_the_loads(made: Scene, names: list[str]) -> None:
    """The spin of a top, the vertical momentum of a heavy body, the Jacobi integral."""
    assert [one.name for one in invariants_of(made)] == names


WHIRL = still(quaternion=np.tile(QUARTER, (4, 1)), omega_body_rad_s=np.tile([0.5, -0.25, 2.0], (4, 1)))


def test_spin_and_vertical_momentum_are_those_of_the_top_about_its_pivot() -> None:
    """omega . axis = 2, relative to |omega|; L . g / |g| = -I3 omega_3, relative to |L|."""
    spin, vertical = invariants_of(scene(gravity=9.81, body=TOP, pivot=ON_AXIS))
    assert np.abs(spin.of(WHIRL)) == pytest.approx(np.full(4, 2.0))
    assert spin.size(WHIRL) == pytest.approx(math.hypot(0.5, 0.25, 2.0))
    assert vertical.of(WHIRL) == pytest.approx(np.full(4, -3.5))
    about = 1.0 + 2.0 * 0.25  # Huygens and Steiner
    assert vertical.size(WHIRL) == pytest.approx(math.hypot(about * 0.5, about * 0.25, 3.5))
    assert spin.needs == {"omega"}
    assert vertical.needs == {"attitude", "omega"}


def test_jacobi_integral_equals_its_formula() -> None:
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


def test_jacobi_integral_depends_on_the_side_of_the_planet() -> None:
    """For a brick tipped about the orbit's normal, u and its mirror image have different fields."""
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


@pytest.mark.parametrize("least", [1.0, 4.0])
@pytest.mark.parametrize(("off", "there"), [(0.0, True), (1e-11, False), (-1e-11, False)])
def test_kovalevskaya_invariant_equals_its_formula(off: float, there: bool, least: float) -> None:
    """I1 = I2 = 2 I3 about the pivot, the arm across the axis; |(p + iq)^2 - c (a + ib)|^2, by hand."""
    mass, arm = 2.0 * least, 0.5
    # about the pivot (2, 2, 1) I3, so about the centre the arm along x takes m l^2 from I2 and I3
    body = RigidBody(mass, least * np.diag([2.0, 1.5, 0.5 + off]))
    made = scene(gravity=10.0, body=body, pivot=np.array([-arm, 0.0, 0.0]))
    found = [one for one in invariants_of(made) if one.name == "Kovalevskaya's invariant"]
    assert bool(found) == there
    if not there:
        return
    tipped = still(
        quaternion=quaternion_product(
            np.tile([math.cos(0.2), math.sin(0.2), 0.0, 0.0], (4, 1)),
            np.tile([math.cos(0.3), 0.0, math.sin(0.3), 0.0], (4, 1)),
        ),
        omega_body_rad_s=WHIRL.omega_body,
    )
    c = mass * 10.0 * arm / least
    # up in body axes: tipped by 0.6 about y, and then by 0.4 about x
    spin = complex(0.5, -0.25) ** 2
    pull = c * complex(-math.sin(0.6) * math.cos(0.4), math.sin(0.4))
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
def test_work_grows_while_a_load_acts(begin: float, end: float) -> None:
    """A constant power between two times; before and after it the work is constant."""
    made = scene(replace(FORCE, from_s=begin, until_s=end), samples=31)
    done = work_done(made, THROWN)
    assert done is not None
    work, error = done
    assert work == pytest.approx(RATE * np.clip(THROWN.t_s - begin, 0.0, min(end, 3.0) - begin), abs=1e-12)
    assert error <= 1e-12


def test_errors_of_the_pieces_add_up() -> None:
    """For a rough power with one switch, the error is the sum of those of the two pieces."""
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
def test_unresolved_work_is_none(made: Scene) -> None:
    """A continuous load, a pivot, a switch between samples, too few samples between two switches."""
    assert work_done(made, THROWN) is None
    assert work_done(scene(replace(FORCE, until_s=0.7), samples=31), THROWN) is not None
    assert work_done(scene(replace(FORCE, until_s=0.7 + 5e-10), samples=31), THROWN) is None


def test_loads_with_a_potential_do_no_work() -> None:
    """Springs are left out, and a load outside its time; drag and torque are included."""
    drag, push = Drag(1.0, np.eye(3)), replace(PUSH, from_s=1.0, until_s=2.0)
    made = scene(drag, push, TorsionSpring(1.0), Spring(np.zeros(3), np.zeros(3), 1.0, 0.0))
    assert working_loads(made, 1.0, 2.0) == [push, drag]
    assert working_loads(made, 0.0, 1.0) == [drag]


# -------------------------------------------------------------------------------------------- planted faults


TENSOR = np.array([[0.9, 0.04, -0.03], [0.04, 1.1, 0.02], [-0.03, 0.02, 1.3]])


def tumbling_scene(loads: tuple[ConstantLoad, ...] = (), inertia: Array = TENSOR) -> Scene:
    """Return a body thrown and tumbling under gravity for 4 s, sampled often enough for its work."""
    start = State(
        np.array([1.0, -2.0, 0.5]),
        np.array([0.5, 0.5, -0.5, 0.5]),
        np.array([1.0, 2.0, -0.5]),
        np.array([0.7, -1.1, 0.9]),
    )
    body = RigidBody(2.0, inertia)
    return Scene(body, start, loads, np.array([0.3, 0.0, -1.0]), duration_s=4.0, samples=201)


SCENES = {
    "free": tumbling_scene(),
    "symmetric": tumbling_scene(inertia=np.diag([1.0, 1.0, 1.5])),
    "forced": tumbling_scene(
        loads=(
            Torque("body", np.array([0.3, -0.2, 0.1])),
            PointForce("world", np.array([0.2, 0.1, 0.4]), np.array([0.1, 0.3, -0.2])),
        )
    ),
}
DT = 0.01


@cache
def truth_of(name: str) -> Truth:
    """Return the truth of one of the scenes."""
    return solve_truth(SCENES[name], SCENES[name].sample_times)


def motion_of(name: str) -> EnergyAndMomentum:
    """Return energy and momentum along the truth of one of the scenes."""
    return EnergyAndMomentum.of(SCENES[name], truth_of(name).trajectory)


Tamper = Callable[[Array], None]


def stepped(made: Scene, dt_factor: float = 1.0, tamper: Tamper | None = None) -> Trajectory:
    """Return the scene by RK4, its state (x, v, omega_body, q) tampered with after every step."""
    plan = plan_steps(made, DT)
    start = made.initial
    state = np.concatenate([start.position, start.velocity, start.omega_body, start.quaternion])
    body, rows = packed_body(made.body), [state.copy()]
    for leg in plan.legs():
        load = leg.wrench.packed(made.body, made.gravity)
        for _ in range(leg.steps):
            INTEGRATORS["rk4"].advance(state, body, load, plan.dt_s * dt_factor, 1)
            if tamper is not None:
                tamper(state)
        if leg.ends_at_sample:
            rows.append(state.copy())
    table = np.array(rows)
    return Trajectory(
        t_s=made.sample_times,
        position_m=table[:, 0:3],
        velocity_m_s=table[:, 3:6],
        quaternion=table[:, 9:13],
        rotation=quaternion_to_matrix(table[:, 9:13]),
        omega_body_rad_s=table[:, 6:9],
    )


def damped(name: str) -> Trajectory:
    """Damp v and omega by 1e-4 per second, as an engine's default may."""

    def tamper(state: Array) -> None:
        state[3:9] *= 1.0 - 1e-4 * DT

    return stepped(SCENES[name], tamper=tamper)


def clamped(name: str) -> Trajectory:
    """Clamp each component of v and omega at 90 % of the largest there is."""
    motion = truth_of(name).trajectory
    fastest, fastest_spin = (0.9 * np.max(np.abs(v)) for v in (motion.velocity_m_s, motion.omega_body))

    def tamper(state: Array) -> None:
        state[3:6] = np.clip(state[3:6], -fastest, fastest)
        state[6:9] = np.clip(state[6:9], -fastest_spin, fastest_spin)

    return stepped(SCENES[name], tamper=tamper)


def off_diagonal_wrong(name: str) -> Trajectory:
    """Step a body of which one product of inertia is 1 % wrong."""
    inertia = SCENES[name].body.inertia.copy()
    inertia[0, 1] = inertia[1, 0] = 1.01 * inertia[0, 1]
    return stepped(replace(SCENES[name], body=replace(SCENES[name].body, inertia=inertia)))


def wrong_step(name: str) -> Trajectory:
    """Make each step longer by one part in 10^4."""
    return stepped(SCENES[name], dt_factor=1.0 + 1e-4)


def wrong_axes(name: str) -> Trajectory:
    """Report omega in world axes as if it were in body axes."""
    healthy = stepped(SCENES[name])
    return replace(healthy, omega_body_rad_s=healthy.omega_world)


def test_the_sign_of_an_energy_drift_is_that_of_its_largest_departure() -> None:
    """A body that spins 1e-6 too fast gains what one that spins too slowly loses."""
    healthy = stepped(SCENES["free"])
    for factor in (1.0 + 1e-6, 1.0 - 1e-6):
        columns = measured("free", replace(healthy, omega_body_rad_s=healthy.omega_body * factor))
        for name in ("energy_drift", "rotational_energy_drift"):
            signed = columns[f"{name}_signed"]
            assert abs(signed) == columns[name] > 0.0
            assert (signed > 0.0) == (factor > 1.0)


def stretched(name: str) -> Trajectory:
    """Report an attitude that is too long by one part in 10^6."""
    healthy = stepped(SCENES[name])
    assert healthy.quaternion is not None
    assert healthy.rotation is not None
    return replace(
        healthy, quaternion=healthy.quaternion * (1 + 1e-6), rotation=healthy.rotation * (1 + 1e-6)
    )


def with_imu(name: str, motion: Trajectory, mistake: str = "") -> Trajectory:
    """Add the readings of sensors along a motion, with a mistake."""
    readings = ImuReadings.of(SCENES[name], motion)
    found = dict(readings.mistakes())[mistake] if mistake else readings
    return replace(motion, specific_force_m_s2=found.specific_force, gyro_rad_s=found.rate)


def turning_of_the_velocity_dropped(name: str) -> Trajectory:
    """Let an accelerometer read the derivative of its velocity in body axes, without omega x v."""
    return with_imu(name, stepped(SCENES[name]), "accelerometer: omega x v is missing")


@pytest.mark.parametrize("mistake", [name for name, _ in ImuReadings.of(scene(), still()).mistakes()])
def test_mistake_of_a_sensor_is_named(mistake: str) -> None:
    """A planted mistake is named from the readings and the motion alone; correct readings have none."""
    motion = truth_of("free").trajectory
    assert imu_mistake(SCENES["free"], with_imu("free", motion)) == ""
    assert imu_mistake(SCENES["free"], with_imu("free", motion, mistake)) == mistake


def test_readings_of_sensors_are_derivatives_of_the_motion_of_their_point() -> None:
    """The specific force is R^T (p'' - g), p the point of the sensors along the exact motion."""
    step, free = 1e-3, SCENES["free"]
    short = replace(free, duration_s=4.0 * step, samples=5)
    exact = solve_truth(short, short.sample_times).trajectory
    point = exact.position_m + exact.rotation_matrices @ imu_point(free)
    weights = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / (12.0 * step**2)
    expected = exact.rotation_matrices[2].T @ (weights @ point - free.gravity)
    readings = ImuReadings.of(free, exact)
    assert readings.specific_force[2] == pytest.approx(expected, rel=1e-7)
    assert np.array_equal(readings.rate, exact.omega_body)


def measured(name: str, trajectory: Trajectory) -> dict[str, float]:
    """Return the columns of a trajectory through one of the scenes."""
    truth = truth_of(name)
    made, true = SCENES[name], truth.trajectory
    compared = Compared(
        *(made, true, motion_of(name), trajectory, EnergyAndMomentum.of(made, trajectory)),
        *(invariants_of(made), len(true.t_s)),
    )
    departures = departures_of(compared)
    columns = reduced(series_of(compared, departures), departures, scene_scales(made, true))
    worst = worst_drift(compared.invariant_drifts)
    drift = {} if worst is None else worst.columns
    return columns | {key: value for key, value in drift.items() if key != "invariant"}


@cache
def healthy(name: str) -> dict[str, float]:
    """Return the columns of the untampered method."""
    motion = stepped(SCENES[name])
    return measured(name, with_imu(name, motion) if has_imu(SCENES[name]) else motion)


FAULTS = [
    ("energy_drift", damped, "free"),
    ("energy_drift", clamped, "free"),
    ("energy_drift", wrong_axes, "free"),
    ("energy_drift", damped, "forced"),
    ("rotational_energy_drift", damped, "free"),
    ("rotational_energy_drift", off_diagonal_wrong, "free"),
    ("energy_balance", damped, "free"),
    ("angular_momentum_drift", damped, "free"),
    ("angular_momentum_drift", off_diagonal_wrong, "free"),
    ("angular_momentum_drift", wrong_axes, "free"),
    ("angular_momentum_direction_error_rad", off_diagonal_wrong, "free"),
    ("linear_momentum_drift", damped, "free"),
    ("linear_momentum_drift", clamped, "free"),
    ("linear_momentum_drift", wrong_step, "free"),
    ("invariant_drift", damped, "symmetric"),
    ("invariant_drift", wrong_axes, "symmetric"),
    ("orthogonality_error", stretched, "free"),
    ("determinant_error", stretched, "free"),
    ("quaternion_norm_error", stretched, "free"),
    ("orientation_error_rad", wrong_step, "free"),
    ("orientation_error_rad", off_diagonal_wrong, "free"),
    ("orientation_error_rad", damped, "free"),
    ("orientation_error_rad", clamped, "forced"),
    ("orientation_error_final_rad", wrong_step, "forced"),
    ("omega_error", wrong_axes, "free"),
    ("omega_error", clamped, "forced"),
    ("imu_error", turning_of_the_velocity_dropped, "free"),
    ("position_error", wrong_step, "free"),
    ("position_error", damped, "forced"),
    ("velocity_error", clamped, "free"),
    ("velocity_error", damped, "free"),
]


OF_TREES = {"joint_error_rad", "joint_error_m", "constraint_drift_m", "constraint_drift_rad"}


def test_each_measure_can_fail() -> None:
    """A measure that no fault changes could do nothing; test_tree_runs.py has those of trees."""
    assert measures.MEASURES.keys() - {measure for measure, _, _ in FAULTS} == OF_TREES


@pytest.mark.parametrize(("measure", "fault", "name"), FAULTS)
def test_planted_fault_exceeds_three_times_the_healthy_value(
    measure: str, fault: Callable[[str], Trajectory], name: str
) -> None:
    """The relative column and the absolute one both exceed it."""
    faulty, sound = measured(name, fault(name)), healthy(name)
    for column in (measure, f"{measure}_abs"):
        if column in sound:
            assert faulty[column] > 3.0 * sound[column]
    assert measure in sound


def test_energy_balance_of_a_forced_scene_detects_damping() -> None:
    """The work equals the change of energy, unless energy is lost."""
    faulty = measured("forced", damped("forced"))
    work, error = work_done(SCENES["forced"], stepped(SCENES["forced"])) or (None, None)
    assert work is not None
    assert error is not None
    energy_scale = scene_scales(SCENES["forced"], truth_of("forced").trajectory).energy_scale_j
    assert faulty["energy_balance"] > 3.0 * error / energy_scale
    # damping at rate c removes 2 c K per second: here for 4 s, with K up to its largest value
    assert faulty["energy_balance"] < 2e-4 * 4.0


def test_balance_with_unresolved_work_is_empty() -> None:
    """A balance that would be mostly quadrature error is missing, never 0."""
    assert "energy_balance" not in measured("forced", truth_of("forced").trajectory)


def test_work_is_the_integral_of_power_to_high_order() -> None:
    """W of the true motion is the change of its energy, within the stated error."""
    made, truth = SCENES["forced"], truth_of("forced").trajectory
    done = work_done(made, truth)
    assert done is not None
    work, error = done
    energy = made.body.mass * (
        0.5 * np.sum(truth.velocity_m_s**2, axis=1) - (truth.position_m - truth.position_m[0]) @ made.gravity
    ) + 0.5 * np.einsum("ni,ij,nj->n", truth.omega_body, made.body.inertia, truth.omega_body)
    assert np.max(np.abs(energy - energy[0] - work)) <= error + 1e-13 * np.max(energy)
    assert error < 1e-6 * np.max(np.abs(work))


def test_healthy_method_is_near_the_truth() -> None:
    """RK4 at 1e-2 s has at most 1e-6 in every measure."""
    for name in SCENES:
        for measure, value in healthy(name).items():
            assert value < 1e-6, (name, measure)


def unstable_versions() -> dict[str, Trajectory]:
    """Return trajectories that ended badly, each in its own way."""
    sound = stepped(SCENES["free"])
    assert sound.quaternion is not None
    assert sound.rotation is not None
    broken_omega = sound.omega_body.copy()
    broken_omega[100:] = np.nan
    mirrored = sound.rotation.copy()
    mirrored[150] *= -1.0
    zero = sound.quaternion.copy()
    zero[3] = 0.0
    return {
        "omega_body_rad_s is not finite from t = 2 s on": replace(sound, omega_body_rad_s=broken_omega),
        "det R <= 0": replace(sound, rotation=mirrored),
        "the quaternion is zero": replace(sound, quaternion=zero),
        "det R is not finite": replace(sound, rotation=1e120 * sound.rotation),
        "the norm of the quaternion is not finite": replace(sound, quaternion=1e200 * sound.quaternion),
        "kinetic energy above 100 times": replace(sound, omega_body_rad_s=200.0 * sound.omega_body),
    }


def why_unstable(name: str, trajectory: Trajectory) -> str | None:
    """Return the reason for which a trajectory through one of the scenes is invalid or unstable, if any."""
    motion = EnergyAndMomentum.of(SCENES[name], trajectory) if invalid_state(trajectory) is None else None
    if motion is None:
        return invalid_state(trajectory)
    return energy_blowup(motion.kinetic, kinetic_limit(motion_of(name).kinetic), trajectory.t_s)


@pytest.mark.parametrize("reason", unstable_versions())
def test_unstable_motion_has_a_reason(reason: str) -> None:
    """NaN, a reflected or huge matrix, a zero or huge quaternion and a hundredfold energy are each named."""
    found = why_unstable("free", unstable_versions()[reason])
    assert found is not None
    assert found.startswith(reason)


def test_healthy_motion_is_stable() -> None:
    """The healthy method is stable in every scene."""
    for name, made in SCENES.items():
        assert why_unstable(name, stepped(made)) is None


def test_drift_is_measured_as_a_vector_in_world_axes() -> None:
    """Rotating L without changing its length is a drift of the momentum."""
    sound = stepped(SCENES["free"])
    turned = replace(sound, omega_body_rad_s=-sound.omega_body)
    momentum = angular_momentum(sound.rotation_matrices, TENSOR, sound.omega_body)
    columns = measured("free", turned)
    assert columns["angular_momentum_drift_abs"] == pytest.approx(2 * np.linalg.norm(momentum[0]), rel=1e-6)
    assert columns["rotational_energy_drift"] < 1e-6


def test_measures_that_repeat_a_judged_one_have_no_verdict() -> None:
    """A verdict on what another measure already judges would count the same fault twice."""
    for name in ("angular_momentum_direction_error_rad", "determinant_error", "orientation_error_final_rad"):
        assert measures.MEASURES[name].judged is None


def test_a_small_momentum_has_no_direction() -> None:
    """The angle counts where |L*| is at least a tenth of its largest value, and is 0 elsewhere."""
    true = np.array([[10.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.9, 0.0, 0.0], [0.0, 0.0, 0.0]])
    momentum = true + np.array([0.0, 1.0, 0.0])
    angles = measures._angle_between_momenta(
        SimpleNamespace(  # type: ignore[arg-type]
            motion=SimpleNamespace(angular_momentum=momentum), true=SimpleNamespace(angular_momentum=true)
        )
    )
    assert angles is not None
    assert angles == pytest.approx([math.atan(0.1), math.atan(1.0), 0.0, 0.0])


def test_error_of_the_momentum_direction_is_an_angle() -> None:
    """A momentum rotated by 0.3 rad, and twice as long, has an error of 0.3 rad."""
    sound = stepped(SCENES["free"])
    momentum = angular_momentum(sound.rotation_matrices, TENSOR, sound.omega_body)
    axis = np.cross(momentum[0], [1.0, 2.0, -0.5])
    turn = exp_matrix(0.3 * axis / np.linalg.norm(axis))
    turned = replace(
        sound,
        quaternion=None,
        rotation=turn @ sound.rotation_matrices,
        omega_body_rad_s=2.0 * sound.omega_body,
    )
    assert measured("free", sound)["angular_momentum_direction_error_rad"] < 1e-6
    found = measured("free", turned)["angular_momentum_direction_error_rad"]
    assert found == pytest.approx(0.3, rel=1e-6)


def test_last_value_of_a_measure_has_the_bound_of_the_measure() -> None:
    """Both are departures from the same truth."""
    last = [one for one in measures.MEASURES.values() if one.last_of is not None]
    assert last
    for one in last:
        assert one.last_of is not None
        assert one.bound == measures.MEASURES[one.last_of].bound is not None


UNITS = {"m": "m", "m_s": "m/s", "rad_s": "rad/s", "j": "J", "kg_m2_s": "kg m^2/s", "kg_m_s": "kg m/s"}


@pytest.mark.parametrize("measure", SCALES)
def test_a_measure_over_a_scale_has_a_column_in_the_unit_of_the_scale(measure: str) -> None:
    """The undivided value tells what the ratio alone does not."""
    suffix = SCALES[measure].partition("_scale_")[2]
    assert measures.MEASURES[measure].unit == UNITS[suffix]


def test_measures_need_quantities_that_a_state_has() -> None:
    """A measure that needed another would never be computed."""
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.ones(3))
    scene = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), start, (), np.zeros(3), duration_s=1.0, samples=3)
    needed = set().union(*(one.needs(scene) for one in measures.MEASURES.values()))
    assert needed == {"position", "attitude", "velocity", "omega"}


@pytest.mark.parametrize("scenario", [*scenario_names(), *tree_names()])
def test_invariants_need_quantities_that_a_state_has(scenario: str) -> None:
    """One that needed another would never be measured on a recording."""
    for one in invariants_of(load_any([scenario])[0][1].scene):
        assert one.needs <= {"position", "attitude", "velocity", "omega"}


@pytest.mark.parametrize("unit", ["m", "rad"])
def test_the_drift_of_a_constraint_is_how_far_its_joints_come_apart(unit: str) -> None:
    """Engines that store poses have it; others have no joints that could come apart."""
    measure, apart = measures.MEASURES[f"constraint_drift_{unit}"], np.array([0.0, 2e-3, 1e-3])
    compared: Any = SimpleNamespace(joints=SimpleNamespace(**{f"gap_{unit}": apart}))
    assert measure.series is not None
    assert measure.series(compared) is apart
    without: Any = SimpleNamespace(joints=None)
    assert measure.series(without) is None


@pytest.mark.parametrize(
    "measure", [name for name in measures.MEASURES if name not in (*TRUTH_BOUNDS, *OF_TREES)]
)
def test_a_measure_without_a_bound_does_not_depend_on_the_truth(measure: str) -> None:
    """Else the error of the truth would count as an error of the engine."""
    truth = still(**SPINNING)
    other = still(
        position_m=PLACE + at(1, 0.3, 0.0, 0.4),
        velocity_m_s=at(1, 0.3, 0.0, 0.4),
        quaternion=np.array([[1.0, 0, 0, 0], QUARTER, [1.0, 0, 0, 0], [1.0, 0, 0, 0]]),
        omega_body_rad_s=at(1, 0.0, 1.0, 0.0),
    )
    found = still(rotation=np.tile(1.1 * np.eye(3), (4, 1, 1)), **SPINNING)
    series = [series_of_motion(found, one)[measure] for one in (truth, other)]
    assert np.array_equal(*series)


@pytest.mark.parametrize("measure", [one for one in measures.MEASURES.values() if one.unit])
def test_the_formula_of_an_absolute_value_does_not_divide(measure: measures.Measure) -> None:
    """It is that of the measure without its scale, with the unit."""
    begin, over, _ = measure.formula.partition(" over ")
    assert over
    assert " over " not in measure.absolute_formula
    assert measure.absolute_formula.startswith(begin.rstrip(","))
    assert measure.absolute_formula.endswith(f", in {measure.unit}")


@pytest.mark.parametrize(
    ("scenario", "expected"),
    [
        ("intermediate-axis", set()),
        ("double-pendulum", {"joint_error_rad"}),
        ("cart-pole", {"joint_error_rad", "joint_error_m"}),
    ],
)
def test_a_scene_has_the_errors_of_its_kinds_of_joints(scenario: str, expected: set[str]) -> None:
    """A gate on an error of joints leaves out a scene that has none."""
    scene = load_one(scenario).scene
    joints = {name: measures.MEASURES[name].of for name in ("joint_error_rad", "joint_error_m")}
    assert {name for name, is_of in joints.items() if is_of is None or is_of(scene)} == expected


@pytest.mark.parametrize("measure", TRUTH_BOUNDS)
def test_bound_of_each_measure_is_a_column_of_the_results(measure: str) -> None:
    """A truth has a bound of this name."""
    assert TRUTH_BOUNDS[measure] in TABLES["results"].columns
