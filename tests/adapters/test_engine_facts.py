"""Facts about the engines on which their adapters and pages depend."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

INERTIA = np.diag([1.0, 2.0, 2.5])
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def mujoco_body(**properties: Any) -> Any:
    """Return the model of a free body with these moments and further attributes."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="body")
    body.add_freejoint()
    body.mass, body.inertia = 1.0, np.diag(INERTIA)
    for name, value in properties.items():
        setattr(body, name, value)
    return spec.compile()


def test_mujoco_ignores_iquat_without_ipos() -> None:
    """The principal axes are used only if the centre of mass is also given."""
    turned = [0.6, 0.8, 0.0, 0.0]
    assert mujoco_body(iquat=turned).body_iquat[1].tolist() == [1.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(mujoco_body(iquat=turned, ipos=[0.0, 0.0, 0.0]).body_iquat[1], turned)


def test_mujoco_poses_are_one_step_old() -> None:
    """After mj_step qpos is new, and xpos is that of the previous step."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco_body()
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_step(model, data)
    assert (data.qpos[0], data.xpos[1, 0]) == (model.opt.timestep, 0.0)


@pytest.mark.parametrize("off", [["SPRING"], ["DAMPER"], ["SPRING", "DAMPER"]])
def test_mujoco_calls_back_only_with_springs_or_dampers(off: list[str]) -> None:
    """The passive-force callback is called if springs or dampers are enabled, but not if neither is."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco_body()
    model.opt.disableflags = sum(int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in off)
    times: list[float] = []
    mujoco.set_mjcb_passive(lambda _model, data: times.append(data.time))
    try:
        mujoco.mj_step(model, mujoco.MjData(model))
    finally:
        mujoco.set_mjcb_passive(None)
    assert bool(times) == (len(off) == 1)


def dart_body() -> tuple[Any, Any, Any]:
    """Return a skeleton of a free body, its joint and its body, rotated by a quarter turn about z."""
    dartpy = pytest.importorskip("dartpy")
    skeleton = dartpy.dynamics.Skeleton("body")
    joint, body = skeleton.createFreeJointAndBodyNodePair()
    body.setInertia(dartpy.dynamics.Inertia(1.0, np.zeros(3), INERTIA))
    turn = dartpy.dynamics.BallJoint.convertToPositions(QUARTER_TURN)
    joint.setPositions(np.concatenate([turn, np.zeros(3)]))
    skeleton.setGravity(np.zeros(3))
    skeleton.setTimeStep(1e-3)
    return skeleton, joint, body


def test_dart_returns_the_angular_momentum_in_body_axes() -> None:
    """The velocities of a free joint are in world axes; getAngularMomentum is in body axes."""
    _, joint, body = dart_body()
    omega_world = np.array([0.3, 1.0, -0.2])
    joint.setVelocities(np.concatenate([omega_world, np.zeros(3)]))
    in_body_axes = INERTIA @ QUARTER_TURN.T @ omega_world
    np.testing.assert_allclose(body.getAngularMomentum(np.zeros(3)), in_body_axes, rtol=1e-12)


@pytest.mark.parametrize("given", ["external", "of the joint"])
def test_dart_stores_external_torques_in_body_axes(given: str) -> None:
    """If the body is rotated afterwards, an external torque rotates with it; a joint's torque does not."""
    dartpy = pytest.importorskip("dartpy")
    skeleton, joint, body = dart_body()
    torque = np.array([1.0, 0.0, 0.0])
    if given == "external":
        body.addExtTorque(torque, False)
    else:
        joint.setForces(np.concatenate([torque, np.zeros(3)]))
    unturned = dartpy.dynamics.BallJoint.convertToPositions(np.eye(3))
    joint.setPositions(np.concatenate([unturned, np.zeros(3)]))
    skeleton.computeForwardDynamics()
    acts = QUARTER_TURN.T @ torque if given == "external" else torque
    expected = np.linalg.solve(INERTIA, acts)
    np.testing.assert_allclose(np.array(joint.getAccelerations())[:3], expected, atol=1e-12)


@pytest.fixture
def bullet() -> Iterator[Any]:
    """Return PyBullet with a separate, empty world."""
    pybullet = pytest.importorskip("pybullet")
    from pybullet_utils.bullet_client import BulletClient

    world = BulletClient(pybullet.DIRECT)
    yield world
    world.disconnect()


@pytest.mark.parametrize(
    ("start", "end"), [(500.0, 100.0), (50.0, 50.0 - 0.04 * (1.0 + 50.0) * 50.0 / 240.0)]
)
def test_pybullet_damps_and_clamps_by_default(bullet: Any, start: float, end: float) -> None:
    """A step of 1/240 s removes 0.04 (1 + |v|) v of the velocity per second, and clamps it at 100."""
    body = bullet.createMultiBody(baseMass=1.0)
    bullet.resetBaseVelocity(body, [start, 0.0, 0.0], [0.0, 0.0, 0.0])
    bullet.stepSimulation()
    velocity, _ = bullet.getBaseVelocity(body)
    assert bullet.getDynamicsInfo(body, -1)[2] == (0.0, 0.0, 0.0)
    assert velocity == pytest.approx((end, 0.0, 0.0), rel=1e-7, abs=0.0)


UNTURNED = (0.0, 0.0, 0.0, 1.0)
MOMENTS = {"localInertiaDiagonal": (1.0, 2.0, 2.5)}
UNCLAMPED = {**MOMENTS, "maxJointVelocity": 1e9}


def link_of(bullet: Any, *changes: dict[str, Any], turned: tuple[float, ...] = UNTURNED) -> int:
    """Put a body without external loads on a spherical joint at its centre, and change it in place.

    turned: the rotation of its inertial frame in the link.
    """
    place = (0.0, 0.0, 0.0)
    body = bullet.createMultiBody(
        baseMass=0.0,
        linkMasses=[1.0],
        linkCollisionShapeIndices=[-1],
        linkVisualShapeIndices=[-1],
        linkPositions=[place],
        linkOrientations=[UNTURNED],
        linkInertialFramePositions=[place],
        linkInertialFrameOrientations=[turned],
        linkParentIndices=[0],
        linkJointTypes=[bullet.JOINT_SPHERICAL],
        linkJointAxis=[(0.0, 0.0, 1.0)],
    )
    for change in changes:
        bullet.changeDynamics(body, 0, **change)
    bullet.setJointMotorControlMultiDof(
        body, 0, bullet.POSITION_CONTROL, targetPosition=UNTURNED, force=[0.0] * 3
    )
    return int(body)


def push_joint(bullet: Any, body: int, torque: tuple[float, ...]) -> None:
    """Apply a torque of the joint in the next step, in the link's axes."""
    bullet.setJointMotorControlMultiDof(body, 0, bullet.TORQUE_CONTROL, force=torque)


def omega_after_a_step(bullet: Any, body: int) -> np.ndarray[Any, Any]:
    """Return omega of the link in its own axes after one step."""
    bullet.stepSimulation()
    return np.array(bullet.getJointStateMultiDof(body, 0)[1])


@pytest.mark.parametrize(
    ("changes", "answer"),
    [
        ([MOMENTS], (1.0, 0.5, 0.4)),
        ([UNCLAMPED], (math.nan,) * 3),
        ([MOMENTS, UNCLAMPED], (1.0, 0.5, 0.4)),
        ([MOMENTS, {**UNCLAMPED, "mass": 1.0}], (2.0, 1.0, 0.8)),
    ],
)
def test_pybullet_inertia_depends_on_what_is_set_with_it(
    bullet: Any, changes: list[dict[str, Any]], answer: tuple[float, ...]
) -> None:
    """On a link without a shape a velocity limit changes the first inertia, and the mass a later one.

    The angular acceleration under a torque of (1, 1, 1) N m shows it.
    """
    body = link_of(bullet, *changes)
    push_joint(bullet, body, (1.0, 1.0, 1.0))
    assert 240.0 * omega_after_a_step(bullet, body) == pytest.approx(answer, rel=1e-12, abs=0.0, nan_ok=True)


@pytest.mark.parametrize("turned", [UNTURNED, (0.0, 0.0, math.sin(0.2), math.cos(0.2))])
def test_pybullet_ignores_the_rotation_of_a_links_inertial_frame(
    bullet: Any, turned: tuple[float, ...]
) -> None:
    """Under (1, 1, 1) N m, moments of 1, 2 and 2.5 kg m^2 act as if about the link's axes."""
    body = link_of(bullet, MOMENTS, turned=turned)
    push_joint(bullet, body, (1.0, 1.0, 1.0))
    assert 240.0 * omega_after_a_step(bullet, body) == pytest.approx((1.0, 0.5, 0.4), rel=1e-12, abs=0.0)


@pytest.mark.parametrize(("pushed", "late_rad"), [("joint", 0.0), ("link", 0.1)])
def test_pybullet_rotates_a_link_torque_by_the_previous_pose(
    bullet: Any, pushed: str, late_rad: float
) -> None:
    """The torque on a link of a ball that rotates by 0.1 rad per step lags by 0.1 rad."""
    undamped = {"linearDamping": 0.0, "angularDamping": 0.0, "jointDamping": 0.0}
    body = link_of(bullet, {"localInertiaDiagonal": (1.0, 1.0, 1.0)}, undamped)
    bullet.setTimeStep(1e-2)
    bullet.resetJointStateMultiDof(body, 0, UNTURNED, (0.0, 0.0, 10.0))
    omega = []
    for _ in range(3):
        if pushed == "joint":
            push_joint(bullet, body, (1.0, 0.0, 0.0))
        else:
            bullet.applyExternalTorque(body, 0, (1.0, 0.0, 0.0), bullet.LINK_FRAME)
        omega.append(omega_after_a_step(bullet, body))
    acceleration = (omega[-1] - omega[-2]) / 1e-2
    assert acceleration == pytest.approx((math.cos(late_rad), -math.sin(late_rad), 0.0), rel=0.0, abs=1e-9)
