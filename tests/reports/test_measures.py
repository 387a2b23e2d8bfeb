"""Every measure sees its fault: a planted one exceeds 3 times the healthy value."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bodycheck.adapters.stability_check import energy_blowup, invalid_state, kinetic_limit
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import exp_matrix, quaternion_to_matrix
from bodycheck.reference_impl.scene import PointForce, RigidBody, Scene, State, Timed, Torque
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.measurement.invariants import invariants_of, symmetry_axis, worst_drift
from bodycheck.reports.measurement.measures import Compared, Motion, departures_of, reduced, series_of
from bodycheck.reports.measurement.scales import scene_scales
from bodycheck.reports.measurement.work import work_done

TENSOR = np.array([[0.9, 0.04, -0.03], [0.04, 1.1, 0.02], [-0.03, 0.02, 1.3]])


def scene(loads: tuple[Timed, ...] = (), inertia: Array = TENSOR) -> Scene:
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
    "free": scene(),
    "symmetric": scene(inertia=np.diag([1.0, 1.0, 1.5])),
    "forced": scene(
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


def motion_of(name: str) -> Motion:
    """Return energy and momentum along the truth of one of the scenes."""
    return Motion.of(SCENES[name], truth_of(name).trajectory)


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
    """Damp v and omega by 1e-4 a second, as an engine's default may."""

    def tamper(state: Array) -> None:
        state[3:9] *= 1.0 - 1e-4 * DT

    return stepped(SCENES[name], tamper=tamper)


def clamped(name: str) -> Trajectory:
    """Clamp each component of v and omega at 90 % of the largest there is."""
    motion = truth_of(name).trajectory
    fastest = 0.9 * np.max(np.abs(motion.velocity_m_s))
    quickest = 0.9 * np.max(np.abs(motion.omega_body))

    def tamper(state: Array) -> None:
        state[3:6] = np.clip(state[3:6], -fastest, fastest)
        state[6:9] = np.clip(state[6:9], -quickest, quickest)

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
    """Give out omega in world axes as if it were in body axes."""
    healthy = stepped(SCENES[name])
    return replace(healthy, omega_body_rad_s=healthy.omega_world)


def stretched(name: str) -> Trajectory:
    """Give out an attitude that is too long by one part in 10^6."""
    healthy = stepped(SCENES[name])
    assert healthy.quaternion is not None
    assert healthy.rotation is not None
    return replace(
        healthy, quaternion=healthy.quaternion * (1 + 1e-6), rotation=healthy.rotation * (1 + 1e-6)
    )


def measured(name: str, trajectory: Trajectory) -> dict[str, float]:
    """Return the columns of a trajectory through one of the scenes."""
    truth = truth_of(name)
    made, true = SCENES[name], truth.trajectory
    compared = Compared(
        *(made, true, motion_of(name), trajectory, Motion.of(made, trajectory)),
        *(invariants_of(made), len(true.t_s)),
    )
    series = series_of(compared, departures_of(compared))
    columns = reduced(series, scene_scales(made, true))
    worst = worst_drift(compared.invariant_drifts)
    drift = {} if worst is None else worst.columns
    return columns | {key: value for key, value in drift.items() if key != "invariant"}


@cache
def healthy(name: str) -> dict[str, float]:
    """Return the columns of the untampered method."""
    return measured(name, stepped(SCENES[name]))


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
    ("position_error", wrong_step, "free"),
    ("position_error", damped, "forced"),
    ("velocity_error", clamped, "free"),
    ("velocity_error", damped, "free"),
]


@pytest.mark.parametrize(("measure", "fault", "name"), FAULTS)
def test_a_planted_fault_exceeds_three_times_the_healthy_value(
    measure: str, fault: Callable[[str], Trajectory], name: str
) -> None:
    """A gate at 3 times the healthy value turns red, in the relative column and in the absolute one."""
    faulty, sound = measured(name, fault(name)), healthy(name)
    for column in (measure, f"{measure}_abs"):
        if column in sound:
            assert faulty[column] > 3.0 * sound[column]
    assert measure in sound


def test_the_energy_balance_of_a_forced_scene_sees_damping() -> None:
    """Work done equals the change of energy, unless something takes energy away."""
    faulty = measured("forced", damped("forced"))
    work, error = work_done(SCENES["forced"], stepped(SCENES["forced"])) or (None, None)
    assert work is not None
    assert error is not None
    energy_scale = scene_scales(SCENES["forced"], truth_of("forced").trajectory).energy_scale_j
    assert faulty["energy_balance"] > 3.0 * error / energy_scale
    # damping at rate c takes 2 c K a second: here 4 s of it, K up to its largest
    assert faulty["energy_balance"] < 2e-4 * 4.0


def test_work_that_the_samples_do_not_resolve_is_left_empty() -> None:
    """A balance that would be mostly error of quadrature is not measured, never called 0."""
    assert "energy_balance" not in measured("forced", truth_of("forced").trajectory)


def test_work_is_the_integral_of_power_to_high_order() -> None:
    """W of the true motion is the change of its energy, within the error that is stated."""
    made, truth = SCENES["forced"], truth_of("forced").trajectory
    done = work_done(made, truth)
    assert done is not None
    work, error = done
    energy = made.body.mass * (
        0.5 * np.sum(truth.velocity_m_s**2, axis=1) - (truth.position_m - truth.position_m[0]) @ made.gravity
    ) + 0.5 * np.einsum("ni,ij,nj->n", truth.omega_body, made.body.inertia, truth.omega_body)
    assert np.max(np.abs(energy - energy[0] - work)) <= error + 1e-13 * np.max(energy)
    assert error < 1e-6 * np.max(np.abs(work))


def test_the_healthy_method_is_near_the_truth() -> None:
    """Untampered RK4 at 1e-2 s errs by 1e-6 at the most in every measure."""
    for name in SCENES:
        for measure, value in healthy(name).items():
            assert value < 1e-6, (name, measure)


def test_only_a_free_symmetric_top_keeps_its_spin() -> None:
    """The axis is found for an oblate and a prolate top, for no sphere or triaxial body; forces end it."""
    oblate, prolate = (symmetry_axis(np.diag(moments)) for moments in ([1.0, 1.0, 1.5], [1.0, 2.0, 2.0]))
    assert oblate is not None
    assert prolate is not None
    assert np.abs(oblate).tolist() == [0, 0, 1]
    assert np.abs(prolate).tolist() == [1, 0, 0]
    assert symmetry_axis(TENSOR) is None
    assert symmetry_axis(np.eye(3)) is None
    assert [one.name for one in invariants_of(SCENES["symmetric"])] == ["spin about the symmetry axis"]
    forced = replace(SCENES["symmetric"], loads=SCENES["forced"].loads)
    for other in (SCENES["free"], SCENES["forced"], forced):
        assert not invariants_of(other)


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
        "kinetic energy above 100 times": replace(sound, omega_body_rad_s=200.0 * sound.omega_body),
    }


def why_unstable(name: str, trajectory: Trajectory) -> str | None:
    """Return the reason by which a trajectory through one of the scenes is no case, if there is one."""
    motion = Motion.of(SCENES[name], trajectory) if invalid_state(trajectory) is None else None
    if motion is None:
        return invalid_state(trajectory)
    return energy_blowup(motion.kinetic, kinetic_limit(motion_of(name).kinetic), trajectory.t_s)


@pytest.mark.parametrize("reason", unstable_versions())
def test_an_unstable_motion_is_called_so_with_its_reason(reason: str) -> None:
    """NaN, a mirrored matrix, a zero quaternion and a hundredfold energy each are named."""
    found = why_unstable("free", unstable_versions()[reason])
    assert found is not None
    assert found.startswith(reason)


def test_a_sound_motion_is_not_called_unstable() -> None:
    """The healthy method is stable in every scene."""
    for name, made in SCENES.items():
        assert why_unstable(name, stepped(made)) is None


def test_drift_is_measured_as_a_vector_in_world_axes() -> None:
    """Turning L without changing its length is drift of momentum all the same."""
    sound = stepped(SCENES["free"])
    turned = replace(sound, omega_body_rad_s=-sound.omega_body)
    momentum = angular_momentum(sound.rotation_matrices, TENSOR, sound.omega_body)
    columns = measured("free", turned)
    assert columns["angular_momentum_drift_abs"] == pytest.approx(2 * np.linalg.norm(momentum[0]), rel=1e-6)
    assert columns["rotational_energy_drift"] < 1e-6


def test_the_direction_of_the_momentum_is_an_angle() -> None:
    """A momentum turned by 0.3 rad about an axis across it, and twice as long, is 0.3 rad off."""
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


def test_a_scene_at_rest_has_no_relative_drift() -> None:
    """Where a scale is 0 the relative column is missing, and the absolute one stands."""
    resting = replace(
        scene(),
        gravity=np.zeros(3),
        initial=State(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3)),
    )
    truth = solve_truth(resting, resting.sample_times)
    true = Motion.of(resting, truth.trajectory)
    found = stepped(resting)
    motion = Motion.of(resting, found)
    compared = Compared(resting, truth.trajectory, true, found, motion, (), len(found.t_s))
    columns = reduced(series_of(compared, departures_of(compared)), scene_scales(resting, truth.trajectory))
    assert "energy_drift" not in columns
    assert columns["energy_drift_abs"] == 0.0
    assert columns["orientation_error_rad"] == 0.0
