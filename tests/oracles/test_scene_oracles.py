"""Published numbers and closed forms for whole scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import (
    angular_momentum,
    gravity_potential,
    rotational_energy,
    translational_energy,
)
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.wrench import wrench_between
from bodycheck.scenarios.library import load_scenario


def motion_at(scene: Scene, t_s: float) -> Trajectory:
    """Return the truth at one time."""
    return solve_truth(scene, np.array([t_s])).trajectory


def free_body(inertia: Array, omega: tuple[float, float, float]) -> Scene:
    """Return a free body with this spin and aligned axes."""
    tensor = inertia if inertia.ndim == 2 else np.diag(inertia)
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array(omega))
    return Scene(RigidBody(1.0, tensor), start, (), np.zeros(3), 10.0, 2)


# ----------------------------------------------- a symmetric body under an axial torque, in closed form


@pytest.mark.parametrize("t_s", [0.0, 0.1, 3.0, 10.0])
def test_the_torus_spins_up_as_euler_says(t_s: float) -> None:
    """omega_3 = s + T t / I3; omega_1 + i omega_2 rotates by (I3 - I1) / I1 times the angle of omega_3.

    The couple is T = 2.4 m x 1 N, and I3 / I1 = (R^2 + 3/4 r^2) / (R^2 / 2 + 5/8 r^2) of the torus.
    """
    mass, couple = 50.0 * 2.0 * np.pi**2 * 0.2**2, 2.4
    across, along = mass * (0.5 + 0.625 * 0.04), mass * (1.0 + 0.75 * 0.04)
    scene = load_scenario("torus-spin-up").scene
    angle = 0.5 * t_s + 0.5 * couple / along * t_s**2
    transverse = 0.2 * np.exp(1j * (along / across - 1.0) * angle)
    expected = [transverse.real, transverse.imag, 0.5 + couple / along * t_s]
    motion = motion_at(scene, t_s)
    assert np.max(np.abs(motion.omega_body[0] - expected)) <= 1e-14
    assert np.max(np.abs(motion.position_m[0])) <= 1e-14


# ------------------------------- scpeters/benchmark, "boxes", complex: box 0.1 x 0.4 x 0.9 m of 10 kg


def energy_and_momentum(scene: Scene, t_s: float) -> tuple[float, Array]:
    """Return E = K + U, U = 0 at the start, and L in world axes, of the truth at one time."""
    body, motion = scene.body, motion_at(scene, t_s)
    energy = (
        rotational_energy(body.inertia, motion.omega_body[0])
        + translational_energy(body.mass, motion.velocity_m_s[0])
        + gravity_potential(body.mass, scene.gravity, motion.position_m[0] - scene.initial.position)
    )
    rotation = quaternion_to_matrix(motion.attitude[0])
    return float(energy), angular_momentum(rotation, body.inertia, motion.omega_body[0])


@pytest.mark.parametrize("t_s", [0.0, 10.0])
def test_boxes_has_the_published_energy_and_momentum(t_s: float) -> None:
    """E0 = 368.5464125 J and |L0| = 3.41765, at the start and after ten seconds of falling.

    The published energy is that of moments rounded to six digits; with the exact m (b^2 + c^2) / 12 it
    is 368.54641666..., 4.2e-6 J more.
    """
    scene = load_scenario("boxes").scene
    rounded = replace(scene, body=replace(scene.body, inertia=np.diag([0.808333, 0.683333, 0.141667])))
    assert energy_and_momentum(rounded, t_s)[0] == pytest.approx(368.5464125, abs=5e-8)
    energy, momentum = energy_and_momentum(scene, t_s)
    # K increases to 4e4 J in the fall, so its round-off is about 1e-11 J
    assert energy == pytest.approx(360.0 + 12.5 * 8.2 / 12 + 0.005 * (9.7 + 1.7) / 12, abs=1e-10)
    assert np.linalg.norm(momentum) == pytest.approx(3.41765, abs=5e-6)


def test_boxes_has_the_published_inertia() -> None:
    """The moments are those of a box of 0.1 x 0.4 x 0.9 m and 10 kg: m (b^2 + c^2) / 12."""
    a, b, c = 0.1, 0.4, 0.9
    expected = 10.0 / 12.0 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
    assert np.allclose(np.diag(load_scenario("boxes").scene.body.inertia), expected, rtol=1e-15)


def test_boxes_turns_as_published() -> None:
    """omega(10) in body axes has the published value to 1e-12."""
    expected = [2.75584040514684, -3.7359635192162, -3.16180900346752]
    assert np.max(np.abs(motion_at(load_scenario("boxes").scene, 10.0).omega_body[0] - expected)) <= 1e-12


# ------------------------------------------------- Drake FreeBody, from Kane and Levinson's closed form


def test_free_body_turns_and_flies_as_in_drake() -> None:
    """Published values: omega(10) in body axes and the velocity to 1e-13, the position to 1e-12."""
    scene = load_scenario("free-body").scene
    motion = motion_at(scene, 10.0)
    expected = [-3.643623596596279, 2.593069047736060, 6.0]
    assert np.max(np.abs(motion.omega_body[0] - expected)) <= 1e-13
    assert np.max(np.abs(motion.position_m[0] - [-41.0, 57.0, -426.5])) <= 1e-12
    assert np.max(np.abs(motion.velocity_m_s[0] - [-4.2, 5.5, -92.0])) <= 1e-13


# -------------------------------------------------------------------------- free bodies of other projects


def test_attitude_as_in_basilisk() -> None:
    """Basilisk, test_spacecraft: the modified Rodrigues parameters after ten seconds to 1e-9."""
    motion = motion_at(free_body(np.array([500.0, 200.0, 300.0]), (0.5, -0.4, 0.7)), 10.0)
    w, *vector = motion.attitude[0] * np.sign(motion.attitude[0, 0])
    sigma = np.array(vector) / (1.0 + w)
    assert np.max(np.abs(sigma - [0.373034285, -0.00239564413, 0.208570797])) <= 1e-9


def test_omega_as_in_principia() -> None:
    """Principia, Dzhanibekov effect: I = (3, 5, 9), L0 = (0, 2, 0.01), omega(100) to 1e-12."""
    motion = motion_at(free_body(np.array([3.0, 5.0, 9.0]), (0.0, 2.0 / 5.0, 0.01 / 9.0)), 100.0)
    expected = [0.0696980876099254, 0.394497096218929, 0.0284758108573114]
    assert np.max(np.abs(motion.omega_body[0] - expected)) <= 1e-12


def test_omega_as_in_newton() -> None:
    """Newton, test_torque_free_precession: omega(0.2) to 1e-13."""
    motion = motion_at(free_body(np.array([0.2, 0.5, 0.4]), (0.7, -0.5, 0.9)), 0.2)
    expected = [0.656101451048804, -0.449861413387142, 0.948312358296295]
    assert np.max(np.abs(motion.omega_body[0] - expected)) <= 1e-13


def test_omega_as_in_dart() -> None:
    """DART, bm_free_body_energy, first body: omega(1) to 1e-13."""
    motion = motion_at(free_body(np.array([0.7, 1.0, 1.2]), (8.0, -4.0, 6.0)), 1.0)
    expected = [5.21216613578143962, 8.96985603578859326, -1.94186543009897352]
    assert np.max(np.abs(motion.omega_body[0] - expected)) <= 1e-13


# ------------------------------------------- scpeters/benchmark: error of semi-implicit Euler in free fall


@pytest.mark.parametrize("dt_s", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("method", ["m1", "m2", "m3"])
def test_semi_implicit_free_fall_is_off_by_half_a_step(method: str, dt_s: float) -> None:
    """The position error of a semi-implicit Euler step in free fall is exactly g dt T / 2, downwards."""
    scene = load_scenario("boxes").scene
    start, duration = scene.initial, 10.0
    state = np.concatenate([start.position, start.velocity, start.omega_body, start.quaternion])
    load = wrench_between(scene, 0.0, duration).packed(scene.body, scene.gravity)
    INTEGRATORS[method].advance(state, packed_body(scene.body), load, dt_s, round(duration / dt_s))
    error = state[0:3] - motion_at(scene, duration).position_m[0]
    # 0.049 m at 1e-3
    assert np.max(np.abs(error - [0.0, 0.0, -9.8 * dt_s * duration / 2.0])) <= 1e-9
