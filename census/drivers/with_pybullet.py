"""PyBullet by itself."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
import pybullet as p
from exact import SPIN, TOP, Array, angle, of_quaternion, top

_LINK = """<robot name="r"><link name="a"><inertial><origin xyz="0 0 0"/><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1.5" iyz="0" izz="2"/></inertial>{scaling}
<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision></link></robot>"""
_MIMIC = """<robot name="g"><link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"
ixy="0" ixz="0" iyz="0"/></inertial></link>{links}</robot>"""


def _client() -> int:
    client: int = p.connect(p.DIRECT)
    return client


def _free(moments: Array, omega: Array, dt: float, *, maximal: bool = False, fair: bool = True) -> int:
    """Return a free body with these moments and this omega, in a world with this step."""
    p.resetSimulation()
    p.setTimeStep(dt)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.05] * 3)
    body: int = p.createMultiBody(1.0, shape, useMaximalCoordinates=int(maximal))
    p.changeDynamics(body, -1, mass=1.0, localInertiaDiagonal=list(moments))
    if fair:
        p.changeDynamics(body, -1, linearDamping=0, angularDamping=0, maxJointVelocity=1e30)
    if maximal:
        p.stepSimulation()  # refreshes the world inertia
        p.resetBasePositionAndOrientation(body, [0, 0, 0], [0, 0, 0, 1])
    p.resetBaseVelocity(body, [0, 0, 0], list(omega))
    return body


def _attitude(body: int) -> Array:
    x, y, z, w = p.getBasePositionAndOrientation(body)[1]
    return of_quaternion(w, x, y, z)


def _top_error(dt: float, scale: float, *, maximal: bool) -> float:
    body = _free(TOP * scale, SPIN, dt, maximal=maximal)
    for _ in range(round(1.0 / dt)):
        p.stepSimulation()
    return angle(top(1.0), _attitude(body))


def damping() -> list[float]:
    """Omega after 1 s of a spin of 1 rad/s about a principal axis, without loads: 1 if nothing damps it."""
    _client()
    body = _free(np.ones(3), np.array([0.0, 0.0, 1.0]), 1e-3, fair=False)
    for _ in range(1000):
        p.stepSimulation()
    return [p.getBaseVelocity(body)[1][2]]


def clamp() -> list[float]:
    """Omega after one step of a spin of 150 rad/s about a principal axis."""
    _client()
    body = _free(np.ones(3), np.array([0.0, 0.0, 150.0]), 1e-6, fair=False)
    p.stepSimulation()
    return [p.getBaseVelocity(body)[1][2]]


def step_angle() -> list[float]:
    """Angle by which one step turns a body whose omega times dt is 1 rad, about a principal axis."""
    _client()
    body = _free(np.ones(3), np.array([0.0, 0.0, 10.0]), 0.1)
    p.stepSimulation()
    return [angle(np.eye(3), _attitude(body))]


def small_body() -> list[float]:
    """Error of a symmetric top with moments of 1e-6 kg m^2 after 1 s at 1e-2 and 1e-3 s."""
    _client()
    return [_top_error(dt, 1e-6, maximal=True) for dt in (1e-2, 1e-3)]


def _loaded(text: str, load: str = "loadURDF", suffix: str = ".urdf", **options: int) -> int:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"model{suffix}"
        path.write_text(text)
        found = getattr(p, load)(str(path), **options)
    body: int = found if isinstance(found, int) else found[0]
    return body


def urdf_tensor() -> list[float]:
    """The largest moment that loadURDF holds of a file that states 2 kg m^2; the box would have 0.0217."""
    _client()
    return [max(p.getDynamicsInfo(_loaded(_LINK.format(scaling="")), -1)[2])]


def inertia_scaling() -> list[float]:
    """The largest moment held with URDF_USE_INERTIA_FROM_FILE of 2 kg m^2 and an inertia_scaling of 3."""
    _client()
    text = _LINK.format(scaling='<contact><inertia_scaling value="3"/></contact>')
    return [max(p.getDynamicsInfo(_loaded(text, flags=p.URDF_USE_INERTIA_FROM_FILE), -1)[2])]


def mimic() -> list[float]:
    """Constraints of a URDF with a mimic, and both angles after the driver moved by 0.5 rad."""
    _client()
    part = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link><joint name="j{0}" type="revolute"><parent link="b"/><child link="{0}"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="100" velocity="10"/>{1}</joint>"""
    links = part.format("c", "") + part.format("d", '<mimic joint="jc" multiplier="1"/>')
    body = _loaded(_MIMIC.format(links=links), useFixedBase=1)
    p.setJointMotorControl2(body, 0, p.POSITION_CONTROL, targetPosition=0.5, force=100)
    p.setJointMotorControl2(body, 1, p.VELOCITY_CONTROL, force=0)
    for _ in range(1000):
        p.stepSimulation()
    return [p.getNumConstraints(), p.getJointState(body, 0)[0], p.getJointState(body, 1)[0]]


def _hinged(omega: float, tilt: float, dt: float) -> int:
    """Return a fixed base with one link on a free hinge along z, its centre of mass on the axis."""
    p.resetSimulation()
    p.setTimeStep(dt)
    half = tilt / 2
    body: int = p.createMultiBody(
        0, -1, -1, [0, 0, 0], [0, 0, 0, 1], linkMasses=[1.0], linkCollisionShapeIndices=[-1],
        linkVisualShapeIndices=[-1], linkPositions=[[0, 0, 0]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, 0]],
        linkInertialFrameOrientations=[[math.sin(half), 0, 0, math.cos(half)]],
        linkParentIndices=[0], linkJointTypes=[p.JOINT_REVOLUTE], linkJointAxis=[[0, 0, 1]],
    )  # fmt: skip
    p.changeDynamics(body, 0, linearDamping=0, angularDamping=0, jointDamping=0)
    p.changeDynamics(body, 0, mass=1.0, localInertiaDiagonal=[1.0, 2.0, 2.5])
    p.setJointMotorControl2(body, 0, p.VELOCITY_CONTROL, force=0)
    p.enableJointForceTorqueSensor(body, 0)
    p.resetJointState(body, 0, 0.0, omega)
    return body


def joint_wrench() -> list[float]:
    """Moment read of a link that turns steadily and omega x I omega; force read in a chain and m a."""
    _client()
    tilt, omega = 0.5, 3.0
    body = _hinged(omega, tilt, 1e-5)
    p.stepSimulation()
    read = np.array(p.getJointState(body, 0)[2][3:])
    along = np.array([0.0, math.sin(tilt), math.cos(tilt)]) * omega  # omega in the principal axes of the link
    exact = np.cross(along, np.array([1.0, 2.0, 2.5]) * along)
    return [float(np.linalg.norm(read)), float(np.linalg.norm(exact)), *_chain_force(0.7, 2.0, 3.0)]


def _chain_force(angle: float, first: float, second: float) -> list[float]:
    """Force that the second joint of a planar double pendulum without gravity reads, and m a of its link.

    Links of 1 m and 1 kg with equal moments of 0.1 kg m^2, their centres of mass in the middle.
    """
    p.resetSimulation()
    p.setTimeStep(1e-6)
    link = """<link name="{0}"><inertial><origin xyz="0.5 0 0"/><mass value="1"/><inertia ixx="0.1" iyy="0.1"
    izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j{0}" type="continuous">
    <parent link="{1}"/><child link="{0}"/><origin xyz="{2} 0 0"/><axis xyz="0 0 1"/></joint>"""
    text = f'<robot name="r"><link name="o"/>{link.format("a", "o", 0)}{link.format("b", "a", 1)}</robot>'
    body = _loaded(text, useFixedBase=1, flags=p.URDF_USE_INERTIA_FROM_FILE)
    for joint, position, rate in ((0, 0.0, first), (1, angle, second)):
        p.changeDynamics(body, joint, linearDamping=0, angularDamping=0, jointDamping=0)
        p.setJointMotorControl2(body, joint, p.VELOCITY_CONTROL, force=0)
        p.resetJointState(body, joint, position, rate)
    p.enableJointForceTorqueSensor(body, 1)
    p.stepSimulation()
    read = float(np.linalg.norm(p.getJointState(body, 1)[2][:3]))
    c, s, both = math.cos(angle), math.sin(angle), first + second
    mass = np.array([[0.2 + 1.5 + c, 0.1 + 0.25 + 0.5 * c], [0.1 + 0.25 + 0.5 * c, 0.1 + 0.25]])
    bias = 0.5 * s * np.array([first**2 - both**2, first**2])
    alpha, beta = np.linalg.solve(mass, -bias)
    force = np.array(
        [
            -(first**2) - 0.5 * (c * both**2 + s * (alpha + beta)),
            alpha + 0.5 * (c * (alpha + beta) - s * both**2),
        ]
    )
    return [read, float(np.linalg.norm(force))]


def pendulum_force() -> list[float]:
    """Force in a hinge that its sensor reads at the bottom of a swing, and the exact m (g + omega^2 L)."""
    _client()
    p.setTimeStep(1e-5)
    p.setGravity(0, 0, -9.8)
    body = p.createMultiBody(
        0, -1, -1, [0, 0, 0], [0, 0, 0, 1], linkMasses=[6.0], linkCollisionShapeIndices=[-1],
        linkVisualShapeIndices=[-1], linkPositions=[[0, 0, 0]], linkOrientations=[[0, 0, 0, 1]],
        linkInertialFramePositions=[[0, 0, -1.0]], linkInertialFrameOrientations=[[0, 0, 0, 1]],
        linkParentIndices=[0], linkJointTypes=[p.JOINT_REVOLUTE], linkJointAxis=[[1, 0, 0]],
    )  # fmt: skip
    p.changeDynamics(body, 0, linearDamping=0, angularDamping=0, jointDamping=0)
    p.changeDynamics(body, 0, mass=6.0, localInertiaDiagonal=[0.1, 0.1, 0.1])
    p.setJointMotorControl2(body, 0, p.VELOCITY_CONTROL, force=0)
    p.enableJointForceTorqueSensor(body, 0)
    p.resetJointState(body, 0, 0.0, 4.0)
    p.stepSimulation()
    return [p.getJointState(body, 0)[2][2], 6.0 * (9.8 + 4.0**2)]


def hinge_motor() -> list[float]:
    """Rate of a hinge that starts with 1 rad/s, after 1 s without loads, friction or damping."""
    _client()
    p.setTimeStep(1e-3)
    body = _loaded(
        """<robot name="h"><link name="b"/><link name="c"><inertial><mass value="1"/><inertia ixx="1" iyy="1"
        izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous">
        <parent link="b"/>        <child link="c"/><axis xyz="0 0 1"/></joint></robot>""",
        useFixedBase=1, flags=p.URDF_USE_INERTIA_FROM_FILE,
    )  # fmt: skip
    p.resetJointState(body, 0, 0.0, 1.0)
    for _ in range(1000):
        p.stepSimulation()
    return [p.getJointState(body, 0)[1]]


def mjcf_density() -> list[float]:
    """Mass that loadMJCF holds of a box of 1e-3 m^3 with density 2000 kg/m^3: 2 kg in the file."""
    _client()
    text = """<mujoco><worldbody><body name="b"><freejoint/>
    <geom type="box" size="0.05 0.05 0.05" density="2000"/></body></worldbody></mujoco>"""
    return [p.getDynamicsInfo(_loaded(text, "loadMJCF", ".xml"), -1)[0]]


def mjcf_from_geom() -> list[float]:
    """Mass that loadMJCF holds with inertiafromgeom, 1 kg by the geom, 7 kg by <inertial>, and its moments.

    The largest moment by default flags, and with URDF_USE_INERTIA_FROM_FILE.
    """
    _client()
    text = """<mujoco><compiler inertiafromgeom="true"/><worldbody><body name="b"><freejoint/>
    <inertial pos="0 0 0" mass="7" diaginertia="1 1 1"/><geom type="box" size="0.05 0.05 0.05"/>
    </body></worldbody></mujoco>"""
    usual, from_file = (
        p.getDynamicsInfo(_loaded(text, "loadMJCF", ".xml", flags=flags), -1)
        for flags in (0, p.URDF_USE_INERTIA_FROM_FILE)
    )
    return [usual[0], max(usual[2]), max(from_file[2])]


def mjcf_capsule() -> list[float]:
    """Moment about the length of a capsule that loadMJCF holds, over that of the solid."""
    _client()
    r, h = 0.05, 0.4
    text = f"""<mujoco><worldbody><body name="b"><freejoint/>
    <geom type="capsule" fromto="0 0 {-h / 2} 0 0 {h / 2}" size="{r}"/></body></worldbody></mujoco>"""
    mass, moments = (p.getDynamicsInfo(_loaded(text, "loadMJCF", ".xml"), -1)[k] for k in (0, 2))
    cylinder, ends = h * r**2, 4 / 3 * r**3  # volumes, divided by pi
    exact = mass * (cylinder * r**2 / 2 + ends * 2 / 5 * r**2) / (cylinder + ends)
    return [min(moments) / exact]


def stale_inertia() -> list[float]:
    """Acceleration of the first and the second step under 1 N m, with moments of 1 kg m^2.

    In maximal coordinates, directly after changeDynamics has set the inertia of a box of 1 cm.
    """
    _client()
    p.setTimeStep(1e-3)
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=[0.005] * 3)
    body = p.createMultiBody(1.0, shape, useMaximalCoordinates=1)
    p.changeDynamics(body, -1, mass=1.0, localInertiaDiagonal=[1, 1, 1])
    found = []
    for _ in range(2):
        p.applyExternalTorque(body, -1, [0, 0, 1], p.WORLD_FRAME)
        p.stepSimulation()
        found.append(p.getBaseVelocity(body)[1][2] / 1e-3)
    return [found[0], found[1] - found[0]]


def mjcf_joint() -> list[float]:
    """Limit, damping and angle of the body that loadMJCF holds of 90 degrees, 0.5 and 30 degrees."""
    _client()
    text = """<mujoco><compiler angle="degree"/><worldbody><body name="arm" euler="0 0 30">
    <joint name="hinge" type="hinge" axis="0 1 0" range="-90 90" damping="0.5"/>
    <inertial pos="0 0 0" mass="2" diaginertia="2 3 4"/></body></worldbody></mujoco>"""
    body = _loaded(text, "loadMJCF", ".xml")
    joint = next(k for k in range(p.getNumJoints(body)) if p.getJointInfo(body, k)[2] == p.JOINT_REVOLUTE)
    info = p.getJointInfo(body, joint)
    x, y, z, w = p.getLinkState(body, joint)[5]
    return [info[9], info[6], angle(np.eye(3), of_quaternion(w, x, y, z))]


_ARM = """<sdf version="1.6"><model name="m"><link name="base"><inertial><mass>1</mass><inertia><ixx>2</ixx>
<ixy>0</ixy><ixz>0</ixz><iyy>3</iyy><iyz>0</iyz><izz>4</izz></inertia></inertial></link><link name="arm">
<pose>0 0 1 0 0 0</pose><inertial><mass>2</mass><inertia><ixx>2</ixx><ixy>0</ixy><ixz>0</ixz><iyy>3</iyy>
<iyz>0</iyz><izz>4</izz></inertia></inertial></link><joint name="hinge" type="revolute"><parent>base</parent>
<child>arm</child><pose>0 0 0.1 0 0 0</pose><axis><xyz>0 1 0</xyz><limit><lower>-1</lower><upper>1</upper>
<effort>5</effort><velocity>2</velocity></limit></axis></joint></model></sdf>"""


def sdf_tensor() -> list[float]:
    """The largest moment that loadSDF holds of a link whose file states 4 kg m^2."""
    _client()
    return [max(p.getDynamicsInfo(_loaded(_ARM, "loadSDF", ".sdf"), 0)[2])]


def sdf_joint_point() -> list[float]:
    """Height of the arm's origin in m after its hinge, 0.1 m above it, has turned by pi: 1.2 in the file."""
    _client()
    body = _loaded(_ARM, "loadSDF", ".sdf")
    p.resetJointState(body, 0, math.pi)
    base = p.getBasePositionAndOrientation(body)[0]
    return [p.getLinkState(body, 0, computeForwardKinematics=1)[4][2] - base[2]]


def mjcf_untyped() -> list[float]:
    """Revolute joints that loadMJCF makes of a joint with a type and of one without."""
    _client()
    found = []
    for kind in ('type="hinge"', ""):
        text = f"""<mujoco><worldbody><body name="arm"><joint name="hinge" {kind} axis="0 1 0"/>
        <inertial pos="0 0 0" mass="2" diaginertia="2 3 4"/></body></worldbody></mujoco>"""
        body = _loaded(text, "loadMJCF", ".xml")
        kinds = [p.getJointInfo(body, k)[2] for k in range(p.getNumJoints(body))]
        found.append(float(kinds.count(p.JOINT_REVOLUTE)))
    return found


def no_inertial() -> list[float]:
    """Mass and largest moment that loadURDF gives a link that states no inertia."""
    _client()
    body = _loaded('<robot name="r"><link name="a"/></robot>', flags=p.URDF_USE_INERTIA_FROM_FILE)
    mass, _, moments = p.getDynamicsInfo(body, -1)[:3]
    return [mass, max(moments)]
