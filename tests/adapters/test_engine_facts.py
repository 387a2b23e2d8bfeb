"""What the engines' pages say of the engines themselves: why the adapters build and read as they do."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

INERTIA = np.diag([1.0, 2.0, 2.5])
QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def mujoco_body(**said: Any) -> Any:
    """Return the model of a free body of these moments, of which more is said."""
    mujoco = pytest.importorskip("mujoco")
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="body")
    body.add_freejoint()
    body.mass, body.inertia = 1.0, np.diag(INERTIA)
    for name, value in said.items():
        setattr(body, name, value)
    return spec.compile()


def test_mujoco_drops_iquat_without_ipos() -> None:
    """The principal axes that are said count only where the centre of mass is said too."""
    turned = [0.6, 0.8, 0.0, 0.0]
    assert mujoco_body(iquat=turned).body_iquat[1].tolist() == [1.0, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(mujoco_body(iquat=turned, ipos=[0.0, 0.0, 0.0]).body_iquat[1], turned)


def test_mujoco_shows_poses_that_are_a_step_old() -> None:
    """After mj_step qpos has moved on, and xpos is where the body was before."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco_body()
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_step(model, data)
    assert (data.qpos[0], data.xpos[1, 0]) == (model.opt.timestep, 0.0)


@pytest.mark.parametrize("off", [["SPRING"], ["DAMPER"], ["SPRING", "DAMPER"]])
def test_mujoco_asks_no_callback_without_springs_and_dampers(off: list[str]) -> None:
    """With one of them on the passive forces are asked for, with both off they are not."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco_body()
    model.opt.disableflags = sum(int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in off)
    asked: list[float] = []
    mujoco.set_mjcb_passive(lambda _model, data: asked.append(data.time))
    try:
        mujoco.mj_step(model, mujoco.MjData(model))
    finally:
        mujoco.set_mjcb_passive(None)
    assert bool(asked) == (len(off) == 1)


def dart_body() -> tuple[Any, Any, Any]:
    """Return a skeleton of a free body, its joint and its body, a quarter turn about z from the start."""
    dartpy = pytest.importorskip("dartpy")
    skeleton = dartpy.dynamics.Skeleton("body")
    joint, body = skeleton.createFreeJointAndBodyNodePair()
    body.setInertia(dartpy.dynamics.Inertia(1.0, np.zeros(3), INERTIA))
    turn = dartpy.dynamics.BallJoint.convertToPositions(QUARTER_TURN)
    joint.setPositions(np.concatenate([turn, np.zeros(3)]))
    skeleton.setGravity(np.zeros(3))
    skeleton.setTimeStep(1e-3)
    return skeleton, joint, body


def test_dart_tells_the_momentum_in_body_axes() -> None:
    """The velocities of a free joint are in world axes, and getAngularMomentum is not."""
    _, joint, body = dart_body()
    omega_world = np.array([0.3, 1.0, -0.2])
    joint.setVelocities(np.concatenate([omega_world, np.zeros(3)]))
    in_body_axes = INERTIA @ QUARTER_TURN.T @ omega_world
    np.testing.assert_allclose(body.getAngularMomentum(np.zeros(3)), in_body_axes, rtol=1e-12)


@pytest.mark.parametrize("given", ["external", "of the joint"])
def test_dart_keeps_what_was_given_in_world_axes_in_axes_of_its_own(given: str) -> None:
    """When the body is turned afterwards an external torque has turned with it, and a joint's has not."""
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


def pybullet_body(client: int) -> int:
    """Return a body without a shape, of 1 kg, in PyBullet's defaults."""
    pybullet = pytest.importorskip("pybullet")
    return int(pybullet.createMultiBody(baseMass=1.0, physicsClientId=client))


@pytest.mark.parametrize(
    ("start", "end"), [(500.0, 100.0), (50.0, 50.0 - 0.04 * (1.0 + 50.0) * 50.0 / 240.0)]
)
def test_pybullets_defaults_damp_and_clamp(start: float, end: float) -> None:
    """A step of 1/240 s takes 0.04 (1 + |v|) v of the velocity a second, and what is above 100 at once."""
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet_body(client)
        pybullet.resetBaseVelocity(body, [start, 0.0, 0.0], [0.0, 0.0, 0.0], physicsClientId=client)
        pybullet.stepSimulation(physicsClientId=client)
        velocity, _ = pybullet.getBaseVelocity(body, physicsClientId=client)
        assert pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[2] == (0.0, 0.0, 0.0)
    finally:
        pybullet.disconnect(client)
    assert velocity == pytest.approx((end, 0.0, 0.0), rel=1e-7, abs=0.0)


MOMENTS = {"localInertiaDiagonal": (1.0, 2.0, 2.5)}
UNCLAMPED = {**MOMENTS, "maxJointVelocity": 1e9}


def answer_of_a_pybullet_link(client: int, *changes: dict[str, Any]) -> list[float]:
    """Return the angular acceleration of a link, so changed in turn, under a torque of (1, 1, 1) N m."""
    pybullet = pytest.importorskip("pybullet")
    unturned, place = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0)
    body = pybullet.createMultiBody(
        baseMass=0.0,
        linkMasses=[1.0],
        linkCollisionShapeIndices=[-1],
        linkVisualShapeIndices=[-1],
        linkPositions=[place],
        linkOrientations=[unturned],
        linkInertialFramePositions=[place],
        linkInertialFrameOrientations=[unturned],
        linkParentIndices=[0],
        linkJointTypes=[pybullet.JOINT_SPHERICAL],
        linkJointAxis=[(0.0, 0.0, 1.0)],
        physicsClientId=client,
    )
    for change in changes:
        pybullet.changeDynamics(body, 0, physicsClientId=client, **change)
    for control, torque in ((pybullet.POSITION_CONTROL, 0.0), (pybullet.TORQUE_CONTROL, 1.0)):
        pybullet.setJointMotorControlMultiDof(
            body, 0, control, targetPosition=unturned, force=[torque] * 3, physicsClientId=client
        )
    pybullet.stepSimulation(physicsClientId=client)
    omega = pybullet.getJointStateMultiDof(body, 0, physicsClientId=client)[1]
    return [240.0 * rate for rate in omega]


@pytest.mark.parametrize(
    ("changes", "answer"),
    [
        ([MOMENTS], [1.0, 0.5, 0.4]),
        ([UNCLAMPED], [math.nan] * 3),
        ([MOMENTS, UNCLAMPED], [1.0, 0.5, 0.4]),
        ([MOMENTS, {**UNCLAMPED, "mass": 1.0}], [2.0, 1.0, 0.8]),
    ],
)
def test_pybullet_minds_with_what_an_inertia_is_set(
    changes: list[dict[str, Any]], answer: list[float]
) -> None:
    """On a link without a shape a velocity limit spoils the first inertia, and with the mass a later one."""
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        found = answer_of_a_pybullet_link(client, *changes)
    finally:
        pybullet.disconnect(client)
    assert found == pytest.approx(answer, rel=1e-12, abs=0.0, nan_ok=True)
