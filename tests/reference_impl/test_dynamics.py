"""Energy, momentum and inertia of a body compared with sums over its points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import (
    angular_acceleration,
    angular_momentum,
    diagonalised,
    force_and_torque,
    gravity_potential,
    gyration_radius,
    inertia_of_points,
    inertia_world,
    linear_momentum,
    point_positions,
    point_velocities,
    principal_axes,
    rotational_energy,
    translational_energy,
)

EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Cloud:
    """A rigid body of point masses, their positions from the centre of mass in body axes, and its motion."""

    masses: Array
    points: Array
    rotation: Array
    position: Array
    velocity: Array
    omega_world: Array

    @property
    def mass(self) -> float:
        """M = sum m."""
        return float(self.masses.sum())

    @property
    def inertia(self) -> Array:
        """I0 by its definition, entry by entry: I_xx = sum m (y^2 + z^2), I_xy = -sum m x y."""
        tensor = np.zeros((3, 3))
        for m, (x, y, z) in zip(self.masses, self.points, strict=True):
            tensor += m * np.array(
                [
                    [y * y + z * z, -x * y, -x * z],
                    [-x * y, x * x + z * z, -y * z],
                    [-x * z, -y * z, x * x + y * y],
                ]
            )
        return tensor

    @property
    def omega_body(self) -> Array:
        """R^T omega."""
        return self.rotation.T @ self.omega_world

    def chunk_velocities(self) -> Array:
        """v = omega x r + vc, point by point."""
        return np.array([np.cross(self.omega_world, self.rotation @ x) + self.velocity for x in self.points])


def cloud(seed: int) -> Cloud:
    """Return a random cloud of points with its centre of mass at the origin."""
    rng = np.random.default_rng(seed)
    masses = rng.uniform(0.1, 2.0, size=12)
    points = rng.normal(size=(12, 3)) * rng.uniform(0.1, 3.0, size=3)
    points = points - (masses @ points) / masses.sum()
    return Cloud(
        masses,
        points,
        Rotation.random(random_state=rng.integers(1 << 30)).as_matrix(),
        rng.normal(size=3),
        rng.normal(size=3),
        3.0 * rng.normal(size=3),
    )


clouds = pytest.mark.parametrize("body", [cloud(seed) for seed in range(10)])


@clouds
def test_points_move_with_the_body(body: Cloud) -> None:
    """x = R x0 + xc has the rate v = omega x r + vc, compared with a small rotation."""
    positions = point_positions(body.rotation, body.position, body.points)
    for x, x0 in zip(positions, body.points, strict=True):
        assert np.max(np.abs(x - (body.rotation @ x0 + body.position))) <= 16 * EPS * np.max(
            np.abs(body.points)
        )
    velocities = point_velocities(body.rotation, body.velocity, body.omega_world, body.points)
    assert np.allclose(velocities, body.chunk_velocities(), rtol=0.0, atol=1e-14)
    h = 1e-5

    def at(t: float) -> Array:
        turn = Rotation.from_rotvec(t * body.omega_world).as_matrix()
        return point_positions(turn @ body.rotation, body.position + t * body.velocity, body.points)

    slope = (at(h) - at(-h)) / (2 * h)
    # truncation h^2 |omega|^3 |r| / 6 < 1e-7, round-off eps |r| / h < 1e-9
    assert np.max(np.abs(velocities - slope)) <= 1e-7


@clouds
def test_kinetic_energy_is_the_sum_over_the_points(body: Cloud) -> None:
    """1/2 M v^2 + 1/2 omega I omega = sum 1/2 m |omega x r + vc|^2."""
    parts = [0.5 * m * float(v @ v) for m, v in zip(body.masses, body.chunk_velocities(), strict=True)]
    energy = rotational_energy(body.inertia, body.omega_body) + translational_energy(body.mass, body.velocity)
    assert abs(energy - sum(parts)) <= 64 * EPS * sum(parts)


@clouds
def test_momenta_are_the_sums_over_the_points(body: Cloud) -> None:
    """M vc = sum m v and R I0 omega_body = sum m r x v, r from the centre of mass in world axes."""
    velocities = body.chunk_velocities()
    arms = body.points @ body.rotation.T
    linear = sum(m * v for m, v in zip(body.masses, velocities, strict=True))
    orbital = sum(m * np.cross(r, v) for m, r, v in zip(body.masses, arms, velocities, strict=True))
    scale = float(np.sum(body.masses * np.linalg.norm(arms, axis=1) * np.linalg.norm(velocities, axis=1)))
    assert np.max(np.abs(linear_momentum(body.mass, body.velocity) - linear)) <= 64 * EPS * body.mass * 20
    spin = angular_momentum(body.rotation, body.inertia, body.omega_body)
    assert np.max(np.abs(spin - orbital)) <= 64 * EPS * scale
    # and so does I(t) omega, all in world axes
    assert (
        np.max(np.abs(inertia_world(body.rotation, body.inertia) @ body.omega_world - spin))
        <= 64 * EPS * scale
    )


@clouds
def test_inertia_in_world_axes_is_that_of_the_moved_points(body: Cloud) -> None:
    """I(t) = R I0 R^T is the inertia of the moved points about their centre."""
    arms = body.points @ body.rotation.T
    moved = inertia_of_points(body.masses, arms)
    scale = float(np.trace(moved))
    assert np.max(np.abs(inertia_world(body.rotation, body.inertia) - moved)) <= 16 * EPS * scale
    assert np.max(np.abs(inertia_of_points(body.masses, body.points) - body.inertia)) <= 16 * EPS * scale


def test_off_diagonals_have_their_true_sign() -> None:
    """A mass at (1, 1, 0) gives I_xy = -1, the entry of the tensor and not the product of inertia."""
    tensor = inertia_of_points(np.array([1.0]), np.array([[1.0, 1.0, 0.0]]))
    assert np.array_equal(tensor, [[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])


@clouds
def test_forces_at_points_sum_to_one_force_and_one_torque(body: Cloud) -> None:
    """F = sum f and tau = sum (R x) x f, and their power is sum f . v."""
    forces = np.random.default_rng(99).normal(size=body.points.shape)
    force, torque = force_and_torque(body.rotation, body.points, forces)
    assert np.allclose(force, sum(forces), rtol=0.0, atol=64 * EPS)
    expected = sum(np.cross(body.rotation @ x, f) for x, f in zip(body.points, forces, strict=True))
    scale = float(np.sum(np.linalg.norm(body.points, axis=1) * np.linalg.norm(forces, axis=1)))
    assert np.max(np.abs(torque - expected)) <= 16 * EPS * scale
    power = float(np.sum(forces * body.chunk_velocities()))
    speeds = float(np.sum(np.linalg.norm(forces, axis=1) * np.linalg.norm(body.chunk_velocities(), axis=1)))
    assert abs(power - (force @ body.velocity + torque @ body.omega_world)) <= 16 * EPS * speeds


def test_no_forces_are_no_force() -> None:
    """An empty list of points gives zero force and zero torque."""
    force, torque = force_and_torque(np.eye(3), np.zeros((0, 3)), np.zeros((0, 3)))
    assert np.array_equal(force, np.zeros(3))
    assert np.array_equal(torque, np.zeros(3))


def check_principal(tensor: Array) -> Array:
    """Assert that moments ascend, axes are a rotation, and both give the tensor; return the moments."""
    moments, axes = principal_axes(tensor)
    scale = float(np.max(np.abs(tensor)))
    assert np.all(np.diff(moments) >= 0.0)
    assert abs(np.linalg.det(axes) - 1.0) <= 16 * EPS
    assert np.max(np.abs(axes.T @ axes - np.eye(3))) <= 16 * EPS
    assert np.max(np.abs(axes @ np.diag(moments) @ axes.T - tensor)) <= 16 * EPS * scale
    return moments


@clouds
def test_principal_axes_reproduce_the_tensor(body: Cloud) -> None:
    """I = A diag(J) A^T with A a rotation and J ascending."""
    check_principal(body.inertia)


@pytest.mark.parametrize("gap", [0.0, 1e-16, 1e-14, 1e-10, 1e-6])
@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_principal_axes_of_near_equal_moments(gap: float, scale: float) -> None:
    """Nearly equal and equal moments are returned, although the axes between them are arbitrary."""
    for seed in range(20):
        turn = Rotation.random(random_state=seed).as_matrix()
        expected = scale * np.array([2.0, 2.0 * (1.0 + gap), 3.0])
        tensor = turn @ np.diag(expected) @ turn.T
        moments = check_principal(0.5 * (tensor + tensor.T))
        assert np.max(np.abs(moments - expected)) <= 32 * EPS * scale
    assert np.max(np.abs(check_principal(scale * np.eye(3)) - scale)) <= 8 * EPS * scale


def test_principal_axes_of_unsorted_diagonals() -> None:
    """A diagonal tensor in any order gives right-handed axes."""
    for diagonal in ([3.0, 2.0, 1.0], [2.0, 3.0, 1.0], [1.0, 3.0, 2.0], [2.0, 1.0, 3.0]):
        assert np.allclose(check_principal(np.diag(diagonal)), [1.0, 2.0, 3.0], rtol=4 * EPS)


@clouds
def test_angular_acceleration_makes_momentum_follow_torque(body: Cloud) -> None:
    """I omega' + omega x I omega = tau exactly, and L' = R tau by finite difference."""
    tensor, omega = body.inertia, body.omega_body
    torque = np.random.default_rng(98).normal(size=3)
    rate = angular_acceleration(tensor, omega, torque)
    momentum = tensor @ omega
    scale = float(np.linalg.norm(omega) * np.linalg.norm(momentum)) + 1.0
    residual = tensor @ rate + np.cross(omega, momentum) - torque
    assert np.max(np.abs(residual)) <= 32 * EPS * scale * float(np.linalg.cond(tensor))
    h = 1e-5

    def momentum_at(t: float) -> Array:
        # R and omega to second order in t, so that the central difference depends only on the first
        turn = Rotation.from_rotvec(t * (omega + 0.5 * t * rate)).as_matrix()
        return angular_momentum(body.rotation @ turn, tensor, omega + t * rate)

    slope = (momentum_at(h) - momentum_at(-h)) / (2 * h)
    growth = (float(np.linalg.norm(omega)) + float(np.linalg.norm(rate)) + 1.0) ** 3 * float(np.trace(tensor))
    assert np.max(np.abs(slope - body.rotation @ torque)) <= h * h * growth + EPS / h * float(
        np.linalg.norm(momentum)
    )


def test_free_angular_acceleration_keeps_the_energy() -> None:
    """Without torque omega . I omega' = 0, because Euler's term does no work."""
    body = cloud(3)
    rate = angular_acceleration(body.inertia, body.omega_body, np.zeros(3))
    work = float(body.omega_body @ body.inertia @ rate)
    assert abs(work) <= 64 * EPS * float(np.linalg.norm(body.omega_body) ** 3 * np.trace(body.inertia))
    assert np.array_equal(angular_acceleration(body.inertia, np.zeros(3), np.zeros(3)), np.zeros(3))


def test_batches_equal_single_calls() -> None:
    """Functions with leading batch dimensions give the results of single calls."""
    rng = np.random.default_rng(5)
    tensor = cloud(0).inertia
    rotations = Rotation.random(6, random_state=1).as_matrix().reshape(2, 3, 3, 3)
    vectors, torques = rng.normal(size=(2, 3, 3)), rng.normal(size=(2, 3, 3))
    for i in range(2):
        for j in range(3):
            r, v, tau = rotations[i, j], vectors[i, j], torques[i, j]
            for together, single in (
                (inertia_world(rotations, tensor)[i, j], inertia_world(r, tensor)),
                (rotational_energy(tensor, vectors)[i, j], rotational_energy(tensor, v)),
                (translational_energy(2.0, vectors)[i, j], translational_energy(2.0, v)),
                (
                    gravity_potential(2.0, torques[0, 0], vectors)[i, j],
                    gravity_potential(2.0, torques[0, 0], v),
                ),
                (linear_momentum(2.0, vectors)[i, j], linear_momentum(2.0, v)),
                (angular_momentum(rotations, tensor, vectors)[i, j], angular_momentum(r, tensor, v)),
                (angular_acceleration(tensor, vectors, torques)[i, j], angular_acceleration(tensor, v, tau)),
            ):
                assert np.allclose(together, single, rtol=64 * EPS, atol=64 * EPS)


def test_gravity_potential_is_the_work_against_gravity() -> None:
    """Lifting 2 kg by 3 m against 9.81 m/s^2 takes 58.86 J, and -dU/dx is the weight."""
    gravity = np.array([0.0, 0.0, -9.81])
    assert gravity_potential(2.0, gravity, np.array([7.0, -5.0, 3.0])) == pytest.approx(
        58.86, rel=2 * EPS, abs=0.0
    )
    slope = [gravity_potential(2.0, gravity, axis) for axis in np.eye(3)]
    assert np.array_equal(slope, -2.0 * gravity)


@clouds
def test_gyration_radius_is_the_root_mean_square_distance(body: Cloud) -> None:
    """sqrt(sum m r^2 / M)."""
    expected = np.sqrt(np.sum(body.masses * np.sum(body.points**2, axis=1)) / body.mass)
    assert gyration_radius(body.mass, body.inertia) == pytest.approx(expected, rel=16 * EPS, abs=0.0)
    # a thin ring of radius 2, with every point at the same distance
    assert gyration_radius(3.0, 3.0 * 4.0 * np.diag([0.5, 0.5, 1.0])) == pytest.approx(
        2.0, rel=2 * EPS, abs=0.0
    )


def test_a_diagonal_tensor_keeps_its_axes() -> None:
    """The moments of a diagonal tensor stay in their order; those of any other one ascend."""
    moments, axes = diagonalised(np.diag([3.0, 1.0, 2.0]))
    assert np.array_equal(moments, [3.0, 1.0, 2.0])
    assert np.array_equal(axes, np.eye(3))
    coupled = np.diag([3.0, 1.0, 2.0]) + 0.1
    for found, expected in zip(diagonalised(coupled), principal_axes(coupled), strict=True):
        assert np.array_equal(found, expected)
