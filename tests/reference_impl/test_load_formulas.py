"""Continuous loads at a state compared with 40 digits, and the fixed-step methods under them."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest

from bodycheck.adapters.contract import Reading
from bodycheck.adapters.reference import FixedStep, Reference
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import (
    continuous_wrench_at,
    packed_continuous_loads,
    rotation_vector,
)
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.loads.kinds.magnetic_dipole import MagneticDipole
from bodycheck.reference_impl.rotations import (
    exp_matrix,
    geodesic_angle,
    normalised,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import (
    ContinuousLoad,
    Drag,
    GravityGradient,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    TorsionSpring,
)
from bodycheck.reference_impl.trajectory import Trajectory
from tests.helpers.textbook_motion import solved_end

EPS = float(np.finfo(np.float64).eps)
INERTIA = np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]])
START = State(
    position=np.array([0.3, -0.2, 0.1]),
    quaternion=normalised(np.array([0.5, -0.1, 0.7, 0.3])),
    velocity=np.array([0.3, 0.1, -0.2]),
    omega_body=np.array([0.9, 1.3, -0.8]),
)
CONTINUOUS: dict[str, ContinuousLoad] = {
    "sine torque in body axes": SineTorque("body", np.array([0.9, -1.2, 0.7]), 2.3, 0.4),
    "sine torque in world axes": SineTorque("world", np.array([0.9, -1.2, 0.7]), 2.3, 0.4),
    "drag": Drag(0.8, np.array([[0.5, 0.1, 0.0], [-0.2, 0.4, 0.1], [0.0, 0.3, 0.6]])),
    "spring": Spring(np.array([1.0, 0.5, -0.3]), np.array([0.4, -0.1, 0.2]), 3.0, 0.5),
    "torsion spring": TorsionSpring(2.5),
    "gravity gradient": GravityGradient(0.9),
    "magnetic dipole": MagneticDipole(np.array([0.8, -0.5, 0.6]), np.array([0.9, 0.7, -1.1])),
}
every_kind = pytest.mark.parametrize("load", CONTINUOUS.values(), ids=CONTINUOUS.keys())
every_integrator = pytest.mark.parametrize("method", INTEGRATORS.values(), ids=INTEGRATORS.keys())


def scene_of(*loads: ContinuousLoad) -> Scene:
    """Return a scene of one second."""
    return Scene(RigidBody(1.3, INERTIA), START, loads, np.zeros(3), duration_s=1.0, samples=2)


def vector(values: Array) -> mp.matrix:
    """Return the doubles as a column."""
    return mp.matrix([mp.mpf(float(x)) for x in values])


def cross(a: mp.matrix, b: mp.matrix) -> mp.matrix:
    """a x b."""
    return mp.matrix([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def exact_rotation(q: Array) -> mp.matrix:
    """R of the quaternion, whatever its norm."""
    w, x, y, z = (mp.mpf(float(c)) for c in q)
    s = 2 / (w * w + x * x + y * y + z * z)
    return mp.matrix(
        [
            [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
        ]
    )


def exact_rotation_vector(r: mp.matrix) -> mp.matrix:
    """angle / (2 sin angle) vee(R - R^T), angle from the trace."""
    axis = mp.matrix([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    angle = mp.atan2(mp.norm(axis) / 2, (r[0, 0] + r[1, 1] + r[2, 2] - 1) / 2)
    return axis * (angle / mp.norm(axis))


def exact_wrench(
    load: ContinuousLoad, t: float, x: Array, q: Array, v: Array, w: Array
) -> tuple[Array, Array]:
    """Return force and torque in world axes with 40 digits, by the formula in the load's docstring."""
    with mp.workdps(40):
        r, force, torque = exact_rotation(q), mp.zeros(3, 1), mp.zeros(3, 1)
        match load:
            case SineTorque():
                torque = vector(load.amplitude) * mp.sin(mp.mpf(load.rate) * t + load.phase)
                torque = r * torque if load.axes == "body" else torque
            case Drag():
                force = -mp.mpf(load.linear) * vector(v)
                torque = -(r * mp.matrix(load.angular.tolist()) * r.T * vector(w))
            case Spring():
                arm = r * vector(load.at)
                d = vector(x) + arm - vector(load.anchor)
                force = -mp.mpf(load.stiffness) * (mp.norm(d) - load.rest_length) / mp.norm(d) * d
                torque = cross(arm, force)
            case TorsionSpring():
                turn = r * exact_rotation(START.quaternion).T
                torque = -mp.mpf(load.stiffness) * exact_rotation_vector(turn)
            case GravityGradient():
                n = mp.mpf(load.rate)
                u = mp.matrix([-mp.sin(n * t), 0, -mp.cos(n * t)])
                torque = 3 * n**2 * cross(u, r * mp.matrix(INERTIA.tolist()) * r.T * u)
            case MagneticDipole():
                torque = cross(r * vector(load.moment), vector(load.field))
            case _:
                raise NotImplementedError(f"exact_wrench has no formula of {load.kind}")
        return np.array(force.T.tolist()[0], dtype=float), np.array(torque.T.tolist()[0], dtype=float)


@every_kind
@pytest.mark.parametrize("seed", range(10))
def test_load_is_its_formula(load: ContinuousLoad, seed: int) -> None:
    """Force and torque at any time and state agree with 40 digits to a few roundings."""
    rng = np.random.default_rng(seed)
    t, q = float(rng.uniform(0.0, 10.0)), normalised(rng.normal(size=4))
    x, v, w = rng.normal(size=(3, 3))
    found = continuous_wrench_at(t, x, quaternion_to_matrix(q), v, w, packed_continuous_loads(scene_of(load)))
    expected = np.concatenate(exact_wrench(load, t, x, q, v, w))
    np.testing.assert_allclose(found, expected, rtol=0, atol=200 * EPS * max(1.0, np.max(np.abs(expected))))
    assert np.any(np.abs(expected) > 1e-2)


def test_loads_are_summed() -> None:
    """All loads together, two of them of one kind, give the sum of each alone."""
    loads = (*CONTINUOUS.values(), SineTorque("body", np.array([0.1, 0.2, 0.3]), 5.0, 1.0))
    at = (0.7, START.position, START.rotation, START.velocity, START.omega_world)
    sums = sum(continuous_wrench_at(*at, packed_continuous_loads(scene_of(load))) for load in loads)
    together = continuous_wrench_at(*at, packed_continuous_loads(scene_of(*loads)))
    np.testing.assert_allclose(together, sums, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(continuous_wrench_at(*at, packed_continuous_loads(scene_of())), np.zeros(6))


def test_spring_of_zero_length_exerts_no_force() -> None:
    """If the body point lies on the anchor there is no force."""
    spring = Spring(START.position, np.zeros(3), 3.0, 0.5)
    at = (0.0, START.position, START.rotation, START.velocity, START.omega_world)
    np.testing.assert_array_equal(
        continuous_wrench_at(*at, packed_continuous_loads(scene_of(spring))), np.zeros(6)
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (3, 0, 4), (1, 2, -2)])
@pytest.mark.parametrize("angle", [0.0, 1e-150, 1e-12, 1e-6, 0.1, 1.5, 2.2, 3.0, 3.141, np.pi - 1e-9])
def test_rotation_vector_is_right_at_any_angle(axis: tuple[float, float, float], angle: float) -> None:
    """The logarithm of a rotation matrix has an error below 8 eps, from angle 0 to nearly pi."""
    expected = angle * np.array(axis) / np.linalg.norm(axis)
    found = rotation_vector(tuple(exp_matrix(expected).ravel()))
    np.testing.assert_allclose(found, expected, rtol=0, atol=8 * EPS)


# --------------------------------------------------------------------------------------- the methods


def built(scene: Scene, method: str, dt_s: float) -> FixedStep:
    """Return the motion of the scene as stepped by a method."""
    simulation = Reference().build(scene, method, dt_s)
    assert isinstance(simulation, FixedStep)
    return simulation


def distances(reading: Reading, truth: Trajectory) -> tuple[float, float, float, float]:
    """Return the distance of a reading from a truth of one sample: angle, omega, position, velocity."""
    motion = Trajectory(
        t_s=truth.t_s,
        position_m=reading.position[None],
        velocity_m_s=reading.velocity[None],
        quaternion=None if reading.quaternion is None else reading.quaternion[None],
        rotation=None if reading.rotation is None else reading.rotation[None],
        omega_world_rad_s=None if reading.omega_world is None else reading.omega_world[None],
        omega_body_rad_s=None if reading.omega_body is None else reading.omega_body[None],
    )
    return (
        float(geodesic_angle(motion.attitude[0], truth.attitude[0])),
        float(np.linalg.norm(motion.omega_body - truth.omega_body)),
        float(np.linalg.norm(motion.position_m - truth.position_m)),
        float(np.linalg.norm(motion.velocity_m_s - truth.velocity_m_s)),
    )


def solved(scene: Scene) -> Trajectory:
    """Return the end of a motion under the loads of the tests above, as a trajectory of one sample."""
    loads = packed_continuous_loads(scene)
    end = solved_end(
        scene.body, scene.initial, lambda *at: np.split(continuous_wrench_at(*at, loads), 2), scene.duration_s
    )
    return Trajectory(
        np.array([scene.duration_s]),
        end.position[None],
        end.velocity[None],
        end.quaternion[None],
        omega_body_rad_s=end.omega_body[None],
    )


# order -> the numbers of steps
REFINEMENTS: dict[int, tuple[int, ...]] = {
    1: (256, 512, 1024),
    2: (64, 128, 256),
    3: (32, 48, 64),
    4: (16, 24, 32, 48),
    5: (6, 8, 12, 16),
    6: (3, 4, 5, 6),
    7: (2, 3, 4, 5, 6, 8),
    8: (1, 2, 3, 4, 5, 6, 8, 10),
}


@pytest.mark.slow(after=14)
@every_kind
@every_integrator
def test_order_under_a_continuous_load(method: Integrator, load: ContinuousLoad) -> None:
    """Under a zero-order hold the motion converges with order 1, otherwise with the method's own order."""
    scene = scene_of(load)
    if Reference().unsupported(scene, method.name):
        assert type(load) in method.refused
        return
    truth = solved(scene)
    steps, errors = [], []
    for n in REFINEMENTS[method.order]:
        simulation = built(scene, method.name, scene.duration_s / n)
        simulation.advance(n)
        error = max(distances(simulation.read(), truth))
        if error > 5e-13:  # well above the error of the truth itself
            steps.append(n)
            errors.append(error)
    assert len(steps) >= 3
    slope = -np.polyfit(np.log(steps[-3:]), np.log(errors[-3:]), 1)[0]
    assert slope > method.order - 0.3
    assert method.order > 1 or slope < 1.3
