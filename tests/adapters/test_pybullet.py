"""Behaviour that is specific to PyBullet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.adapters.contract import read_back_mismatch
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import (
    ConstantLoad,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    State,
    Torque,
)
from bodycheck.reference_impl.wrench import wrench_between
from tests.helpers.first_order_maps import SpinStep, explicit_step, implicit_gyroscopic_step

pybullet = pytest.importorskip("pybullet")

from pybullet_utils.bullet_client import BulletClient  # noqa: E402 - it imports the engine

from bodycheck.adapters.pybullet import PyBullet, PyBulletSimulation  # noqa: E402 - it imports the engine

INERTIA = np.diag([1.0, 2.0, 3.0])
BODY_TORQUE = Torque("body", np.array([0.3, -0.2, 0.1]))
WORLD_TORQUE = Torque("world", np.array([0.3, -0.2, 0.1]))
BODY_FORCE = PointForce("body", np.array([0.5, 0.3, -0.8]), np.zeros(3))
CENTRAL_FORCE = PointForce("world", np.array([0.5, 0.3, -0.8]), np.zeros(3))
WORLD_FORCE = PointForce("world", np.array([0.5, 0.3, -0.8]), np.array([0.2, -0.4, 0.3]))

both_methods = pytest.mark.parametrize("method", ["multibody", "maximal"])


def scene_of(loads: tuple[ConstantLoad, ...] = (), inertia: Array = INERTIA) -> Scene:
    """Return a scene of a rotated body at rest in the air."""
    initial = State(np.zeros(3), np.array([0.5, -0.5, 0.1, 0.7]), np.zeros(3), np.zeros(3))
    return Scene(RigidBody(1.3, inertia), initial, loads, np.zeros(3), duration_s=1.0, samples=2)


def moving(scene: Scene, velocity: tuple[float, ...], omega_body: tuple[float, ...]) -> Scene:
    """Set the initial velocities of the body."""
    initial = replace(scene.initial, velocity=np.array(velocity), omega_body=np.array(omega_body))
    return replace(scene, initial=initial)


def loaded(adapter: PyBullet, scene: Scene, method: str, dt_s: float = 1e-2) -> PyBulletSimulation:
    """Build a simulation on which all loads of the scene act."""
    simulation = adapter.build(scene, method, dt_s)
    simulation.apply(wrench_between(scene, 0.0, scene.duration_s))
    return simulation


@pytest.fixture
def adapter() -> Iterator[PyBullet]:
    """Return an adapter whose clients are disconnected after the test."""
    adapter = PyBullet()
    yield adapter
    for client in adapter._idle_clients:
        pybullet.disconnect(client)


@both_methods
def test_first_step_has_the_inertia_of_the_initial_pose(adapter: PyBullet, method: str) -> None:
    """From rest, one step under a body torque gives h I^-1 tau."""
    scene = scene_of((BODY_TORQUE,))
    simulation = loaded(adapter, scene, method)
    for _ in range(2):
        simulation.advance(1)
        reading = simulation.read()
        assert reading.omega_world is not None
        expected = scene.initial.rotation @ (1e-2 * np.linalg.solve(INERTIA, BODY_TORQUE.value))
        np.testing.assert_allclose(reading.omega_world, expected, rtol=1e-14)
        simulation.advance(200)
        simulation.reset()
        simulation.apply(wrench_between(scene, 0.0, 1.0))
    simulation.close()


@both_methods
def test_velocities_are_neither_damped_nor_clamped(adapter: PyBullet, method: str) -> None:
    """A sphere keeps 1e6 m/s and 700 rad/s over 1000 steps to 1e-12."""
    scene = moving(scene_of(inertia=np.eye(3)), (1e6, -1e6, 5e5), (700.0, 0.0, 0.0))
    simulation = adapter.build(scene, method, 1e-3)
    simulation.advance(1000)
    reading = simulation.read()
    np.testing.assert_allclose(reading.velocity, scene.initial.velocity, rtol=1e-12)
    np.testing.assert_allclose(reading.omega_world, scene.initial.omega_world, rtol=1e-12, atol=1e-10)
    simulation.close()


@both_methods
def test_slow_body_is_not_put_to_sleep(adapter: PyBullet, method: str) -> None:
    """A body of 1e-7 m/s and 1e-7 rad/s still moves after 100 s."""
    scene = moving(scene_of(inertia=np.eye(3)), (1e-7, 0.0, 0.0), (1e-7, 0.0, 0.0))
    simulation = adapter.build(scene, method, 1e-2)
    simulation.advance(10_000)
    np.testing.assert_allclose(simulation.read().position, [1e-5, 0.0, 0.0], rtol=1e-9, atol=1e-18)
    simulation.close()


@both_methods
def test_unbounded_growth_ends_in_nan(adapter: PyBullet, method: str) -> None:
    """An unstable body ends non-finite or bounded by its own map, never at a clamp of the adapter."""
    simulation = adapter.build(moving(scene_of(), (0.0, 0.0, 0.0), (10.0, 200.0, 10.0)), method, 0.5)
    simulation.advance(100)
    omega = simulation.read().omega_world
    assert omega is not None
    assert np.all(np.isnan(omega)) == (method == "multibody")
    simulation.close()


@both_methods
@pytest.mark.parametrize("steps", [2001, 70_001])
@pytest.mark.parametrize("dt_s", [1e-3, 1.0 / 300.0, 0.1])
def test_one_call_makes_every_step(adapter: PyBullet, method: str, dt_s: float, steps: int) -> None:
    """A free fall of 2001 substeps in one advance ends at g h^2 n (n + 1) / 2: no substep is left out.

    If 2001 substeps of 1e-3 s are requested in one call, Bullet makes 2000 and leaves one for the next call.
    """
    scene = replace(scene_of(), gravity=np.array([0.0, 0.0, -1.0]))
    simulation = adapter.build(scene, method, dt_s)
    simulation.advance(steps)
    fallen = simulation.read().position[2]
    assert fallen == pytest.approx(-(dt_s**2) * steps * (steps + 1) / 2.0, rel=1e-10, abs=0.0)
    simulation.close()


@both_methods
@pytest.mark.parametrize(
    ("loads", "stepping"),
    [
        ((), "native"),
        ((WORLD_TORQUE, CENTRAL_FORCE), "native"),
        ((BODY_TORQUE,), "python"),
        ((BODY_FORCE,), "python"),
        ((WORLD_FORCE,), "python"),
        ((WORLD_TORQUE, WORLD_FORCE), "python"),
    ],
)
def test_stepping_is_native_where_no_load_rotates_with_the_body(
    adapter: PyBullet, method: str, loads: tuple[ConstantLoad, ...], stepping: str
) -> None:
    """Bullet's substeps are used under gravity and loads that are constant in world axes."""
    simulation = adapter.build(scene_of(loads), method, 1e-2)
    assert simulation.stepping == stepping
    simulation.close()


@both_methods
def test_substeps_under_constant_loads_equal_steps(adapter: PyBullet, method: str) -> None:
    """Under a world torque and a central world force, 1023 substeps equal 1023 steps, bit for bit."""
    scene = moving(scene_of((WORLD_TORQUE, CENTRAL_FORCE)), (0.1, 0.2, 0.3), (0.1, 2.0, 0.1))
    at_once, singly = (loaded(adapter, scene, method, 1e-3) for _ in range(2))
    at_once.advance(1023)
    for _ in range(1023):
        singly.advance(1)
    for name in ("position", "velocity", "quaternion", "omega_world"):
        np.testing.assert_array_equal(getattr(at_once.read(), name), getattr(singly.read(), name))
    at_once.close()
    singly.close()


@both_methods
def test_central_force_has_no_torque_far_away(adapter: PyBullet, method: str) -> None:
    """A million kilometres from the origin, a force through the centre of mass exerts no torque."""
    scene = scene_of((CENTRAL_FORCE, BODY_FORCE))
    scene = replace(scene, initial=replace(scene.initial, position=np.array([1e9, -1e9, 1e9])))
    simulation = loaded(adapter, scene, method)
    simulation.advance(10)
    np.testing.assert_array_equal(simulation.read().omega_world, np.zeros(3))
    simulation.close()


@both_methods
def test_arm_of_a_force_is_exact_far_away(adapter: PyBullet, method: str) -> None:
    """A million kilometres from the origin, a force at a body point has the torque that it has there."""
    near = scene_of((WORLD_FORCE,))
    far = replace(near, initial=replace(near.initial, position=np.array([1e9, -1e9, 1e9])))
    simulations = [loaded(adapter, scene, method) for scene in (near, far)]
    for simulation in simulations:
        simulation.advance(10)
    here, there = (simulation.read().omega_world for simulation in simulations)
    np.testing.assert_array_equal(here, there)
    for simulation in simulations:
        simulation.close()


def test_client_is_reused_when_it_is_free(adapter: PyBullet) -> None:
    """The client of a closed simulation serves the next one; two open simulations have one client each."""
    first = adapter.build(scene_of(), "multibody", 1e-2)
    second = adapter.build(scene_of(), "maximal", 1e-2)
    assert first._client != second._client
    first.close()
    first.close()
    third = adapter.build(scene_of(), "maximal", 1e-2)
    assert third._client == first._client
    assert adapter._idle_clients == []
    second.close()
    third.close()


def test_client_is_discarded_after_a_failed_build(adapter: PyBullet, monkeypatch: pytest.MonkeyPatch) -> None:
    """The client is disconnected with everything built in it, and the next case gets a new client."""

    def refused(*_: object, **__: object) -> None:
        raise pybullet.error("no dynamics today")

    def connected() -> list[int]:
        return [client for client in range(100) if pybullet.isConnected(client)]

    before = connected()
    monkeypatch.setattr(pybullet, "changeDynamics", refused)
    for scene in (scene_of(), replace(scene_of(), pivot=np.array([0.1, 0.0, 0.0]))):
        with pytest.raises(pybullet.error, match="today"):
            adapter.build(scene, "multibody", 1e-2)
    assert adapter._idle_clients == []
    assert connected() == before


@both_methods
def test_rotation_per_step_is_limited_by_bullet(adapter: PyBullet, method: str) -> None:
    """Above |omega| h = pi/4 Bullet itself rotates a body by a smaller angle."""
    angles = []
    for turn in (0.78, 1.0, 5.0):
        scene = moving(scene_of(inertia=np.eye(3)), (0.0, 0.0, 0.0), (turn, 0.0, 0.0))
        simulation = adapter.build(scene, method, 1.0)
        simulation.advance(1)
        reading = simulation.read()
        assert reading.quaternion is not None
        angles.append(float(geodesic_angle(reading.quaternion, scene.initial.quaternion)))
        simulation.close()
    assert angles[0] == pytest.approx(0.78, abs=1e-14)
    assert angles[1] < 0.98
    assert angles[2] < 2.5


@both_methods
@pytest.mark.parametrize("planted", ["mass", "inertia", "step", "gravity"])
def test_read_back_reads_the_engine(adapter: PyBullet, method: str, planted: str) -> None:
    """A value that is changed in the engine changes the value read back."""
    scene = scene_of(inertia=np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 2.5]]))
    simulation = adapter.build(scene, method, 1e-2)
    assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None
    body, client = simulation._body, simulation._client
    match planted:
        case "mass":
            moments = pybullet.getDynamicsInfo(body, -1, client)[2]
            pybullet.changeDynamics(body, -1, mass=1.31, localInertiaDiagonal=moments, physicsClientId=client)
        case "inertia":
            pybullet.changeDynamics(
                body, -1, mass=1.3, localInertiaDiagonal=(1.0, 2.0, 2.5), physicsClientId=client
            )
        case "step":
            pybullet.setTimeStep(1e-3, physicsClientId=client)
        case "gravity":
            pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
    assert planted in str(read_back_mismatch(scene, 1e-2, simulation.read_back()))
    simulation.close()


@pytest.mark.parametrize(("size", "turns"), [(5e-6, True), (2e-6, False)])
def test_small_body_loses_its_gyroscopic_term(adapter: PyBullet, size: float, turns: bool) -> None:
    """In maximal coordinates omega stays constant if the product of the moments is below machine epsilon."""
    small = moving(scene_of(inertia=size * np.diag([1.0, 2.0, 2.5])), (0.0, 0.0, 0.0), (0.3, 1.0, -0.2))
    for method, expected in (("maximal", turns), ("multibody", True)):
        simulation = loaded(adapter, small, method)
        simulation.advance(100)
        omega_world = simulation.read().omega_world
        simulation.close()
        assert omega_world is not None
        assert bool(np.linalg.norm(omega_world - small.initial.omega_world) > 1e-3) is expected


URDF = """
<robot name="body"><link name="link"><inertial>
<mass value="1.5"/><inertia ixx="1" iyy="2" izz="2.5" ixy="0" ixz="0" iyz="0"/>
</inertial></link></robot>
"""


@pytest.mark.parametrize("kind", ["multibody", "maximal"])
def test_body_with_defaults_equals_one_loaded_from_a_file(kind: str, tmp_path: Path) -> None:
    """With its defaults a body makes the steps of a URDF's, bit for bit, including damping and clamps."""
    inertia = np.diag([1.0, 2.0, 2.5])
    initial = State(
        np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.array([3.0, 0.0, 40.0]), np.array([0.9, 1.3, -0.8])
    )
    torque = Torque("world", np.array([0.3, -0.2, 0.1]))
    gravity = np.array([0.0, 0.0, -9.81])
    scene = Scene(RigidBody(1.5, inertia), initial, (torque,), gravity, duration_s=1.0, samples=2)
    simulation = PyBullet().build(scene, f"{kind}@defaults", 1.0 / 256.0)
    try:
        simulation.apply(wrench_between(scene, 0.0, 1.0))
        for _ in range(256):
            simulation.advance(1)
        found = simulation.read()
    finally:
        simulation.close()
    file = tmp_path / "body.urdf"
    file.write_text(URDF)
    world = BulletClient(pybullet.DIRECT)
    try:
        world.setTimeStep(1.0 / 256.0)
        world.setGravity(*gravity)
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        body = world.loadURDF(str(file), useMaximalCoordinates=kind == "maximal", flags=flags)
        world.resetBaseVelocity(body, initial.velocity, initial.omega_world)
        for _ in range(256):
            world.applyExternalTorque(body, -1, torque.value, pybullet.WORLD_FRAME)
            world.stepSimulation()
        position, quaternion = world.getBasePositionAndOrientation(body)
        velocity, omega = world.getBaseVelocity(body)
    finally:
        world.disconnect()
    np.testing.assert_array_equal(found.position, position)
    np.testing.assert_array_equal(found.velocity, velocity)
    np.testing.assert_array_equal(found.quaternion, np.roll(quaternion, 1))
    np.testing.assert_array_equal(found.omega_world, omega)


@pytest.mark.parametrize(
    ("method", "step"), [("multibody", explicit_step), ("maximal", implicit_gyroscopic_step)]
)
def test_varying_load_is_constant_over_all_substeps(method: str, step: SpinStep) -> None:
    """A sine torque in body axes keeps its value at the start of the step over the four substeps."""
    sine = SineTorque("body", np.array([0.9, -1.2, 0.7]), 2.3, 0.4)
    scene = replace(moving(scene_of(), (0.0, 0.0, 0.0), (0.9, 1.3, -0.8)), loads=(sine,))
    simulation = PyBullet().build(scene, f"{method}@substeps", 1e-2)
    try:
        simulation.advance(100)
        omega_world = simulation.read().omega_world
    finally:
        simulation.close()
    turn, omega = Rotation.from_quat(scene.initial.quaternion, scalar_first=True), scene.initial.omega_body
    for k in range(100):
        torque_world = turn.apply(sine.amplitude * np.sin(sine.rate * k * 1e-2 + sine.phase))
        for _ in range(4):
            omega = omega + step(INERTIA, omega, turn.inv().apply(torque_world), 2.5e-3)
            turn = turn * Rotation.from_rotvec(2.5e-3 * omega)
    np.testing.assert_allclose(omega_world, turn.apply(omega), rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["multibody", "maximal"])
def test_substeps_are_steps_of_their_length(method: str) -> None:
    """A free step of four substeps equals four steps bit for bit, and its own length is read back."""
    scene = moving(scene_of(), (1.0, 2.0, 3.0), (0.1, 2.0, 0.1))
    ends = []
    for name, dt_s, steps in ((method, 2.5e-3, 400), (f"{method}@substeps", 1e-2, 100)):
        simulation = PyBullet().build(scene, name, dt_s)
        try:
            assert simulation.read_back().dt_s == dt_s
            simulation.advance(steps)
            ends.append(simulation.read())
        finally:
            simulation.close()
    np.testing.assert_array_equal(ends[0].quaternion, ends[1].quaternion)
    np.testing.assert_array_equal(ends[0].position, ends[1].position)
