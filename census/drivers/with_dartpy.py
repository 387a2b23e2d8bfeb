"""DART by itself."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import dartpy as dart
import numpy as np
from exact import SPIN, Array, order, rotation

_TENSOR = np.array([[1.0, 0.1, 0.05], [0.1, 1.5, -0.2], [0.05, -0.2, 2.0]])
_INERTIAL = """<inertial><pose>0 0 0 0 0 0.5</pose><mass>2</mass><inertia><ixx>1</ixx><ixy>0.1</ixy>
<ixz>0.05</ixz><iyy>1.5</iyy><iyz>-0.2</iyz><izz>2</izz></inertia></inertial>"""
_SDF = """<sdf version="1.6"><model name="m"><link name="a">{}</link></model></sdf>"""
_URDF = """<robot name="m"><link name="a"><inertial><origin xyz="0 0 0" rpy="0 0 0.5"/><mass value="2"/>
<inertia ixx="1" ixy="0.1" ixz="0.05" iyy="1.5" iyz="-0.2" izz="2"/></inertial></link></robot>"""


def _read(text: str, suffix: str) -> dart.dynamics.Skeleton:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"model{suffix}"
        path.write_text(text)
        if suffix == ".urdf":
            return dart.utils.DartLoader().parseSkeleton(str(path))
        return dart.utils.SdfParser.readSkeleton(str(path))


def _held(skeleton: dart.dynamics.Skeleton) -> Array:
    return np.array(skeleton.getBodyNode(0).getInertia().getMoment())


def sdf_frame() -> list[float]:
    """Largest deviation in kg m^2 of the tensor held from R I R^T of the file, by SDFormat and by URDF."""
    turn = rotation(np.array([0.0, 0.0, 0.5]))
    stated = turn @ _TENSOR @ turn.T
    return [
        float(np.max(np.abs(_held(_read(text, suffix)) - stated)))
        for text, suffix in ((_SDF.format(_INERTIAL), ".sdf"), (_URDF, ".urdf"))
    ]


def link_drift() -> list[float]:
    """How far the centre of mass of a spinning body moves in m, and the order of that; true: 0."""
    found = []
    centre = np.array([0.2, 0.1, 0.0])
    for dt in (1e-2, 5e-3):
        world = dart.simulation.World()
        world.setGravity([0.0, 0.0, 0.0])
        world.setTimeStep(dt)
        skeleton = dart.dynamics.Skeleton()
        joint, body = skeleton.createFreeJointAndBodyNodePair()
        body.setInertia(dart.dynamics.Inertia(1.0, centre, np.diag([2.0, 2.0, 1.0])))
        joint.setAngularVelocity(SPIN)
        joint.setLinearVelocity(-np.cross(SPIN, centre))
        world.addSkeleton(skeleton)
        start = np.array(body.getCOM())
        for _ in range(round(2.0 / dt)):
            world.step()
        found.append(float(np.linalg.norm(np.array(body.getCOM()) - start)))
    return [found[0], order(*found)]


def stale_acceleration() -> list[float]:
    """Acceleration that a pendulum reports after a step, and that of its angle after the step, rad/s^2."""
    dt = 0.01
    world = dart.simulation.World()
    world.setTimeStep(dt)
    world.setGravity([0.0, 0.0, -9.81])
    skeleton = dart.dynamics.Skeleton()
    joint, body = skeleton.createRevoluteJointAndBodyNodePair()
    joint.setAxis([0.0, 1.0, 0.0])
    body.setInertia(dart.dynamics.Inertia(1.0, np.array([0.0, 0.0, -1.0]), np.diag([1e-9] * 3)))
    world.addSkeleton(skeleton)
    skeleton.setPositions([1.0])
    for _ in range(20):
        world.step()
    (position,) = skeleton.getPositions()
    return [float(skeleton.getAccelerations()[0]), float(-9.81 * np.sin(position))]


def triangle() -> list[float]:
    """Whether verify calls 1, 2, 5 kg m^2 valid, which no body has (1: yes), and the moments then held."""
    skeleton = dart.dynamics.Skeleton()
    _, body = skeleton.createFreeJointAndBodyNodePair()
    inertia = dart.dynamics.Inertia(1.0, np.zeros(3), np.diag([1.0, 2.0, 5.0]))
    body.setInertia(inertia)
    return [float(inertia.verify()), *map(float, np.diag(np.array(body.getInertia().getMoment())))]


_HINGE = """<mujoco><compiler angle="degree"/><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"
range="-90 90" armature="0.1" stiffness="2"/>
<inertial pos="0 0 0" mass="2" diaginertia="2 3 4"/></body></worldbody></mujoco>"""


def _mjcf() -> dart.dynamics.Skeleton:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(_HINGE)
        world = dart.utils.MjcfParser.readWorld(str(path))
    return world.getSkeleton(0)


def mjcf_tensor() -> list[float]:
    """Moments that MjcfParser holds of 2, 3, 4 kg m^2."""
    moment = np.array(_mjcf().getBodyNode(0).getInertia().getMoment())
    return [float(value) for value in np.diag(moment)]


def mjcf_limit() -> list[float]:
    """Upper limit that MjcfParser holds of a hinge with 90 degrees: 1.5708 rad."""
    return [float(_mjcf().getJoint(0).getPositionUpperLimit(0))]


def mjcf_spring() -> list[float]:
    """Stiffness that MjcfParser holds of a hinge with 2 N m/rad."""
    return [float(_mjcf().getJoint(0).getSpringStiffness(0))]


def sdf_limits() -> list[float]:
    """Limits that SdfParser holds of an effort of 5 N m and of 2 rad/s: 1e9 for infinite."""
    moments = "".join(
        f"<i{axes}>{axes[0] == axes[1]:d}</i{axes}>" for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    )
    link = f"<link name='{{}}'><inertial><mass>1</mass><inertia>{moments}</inertia></inertial></link>"
    text = f"""<sdf version="1.6"><model name="m">{link.format("base")}{link.format("arm")}
    <joint name="hinge" type="revolute"><parent>base</parent><child>arm</child><axis><xyz>0 1 0</xyz>
    <limit><lower>-1</lower><upper>1</upper><effort>5</effort><velocity>2</velocity></limit></axis></joint>
    </model></sdf>"""
    joint = _read(text, ".sdf").getJoint("hinge")
    return [min(1e9, float(limit)) for limit in (joint.getForceUpperLimit(0), joint.getVelocityUpperLimit(0))]


def joint_velocities() -> list[float]:
    """How far (1, 2, 3) rad/s, set as the velocities of a turned joint, is from omega in body and world axes.

    Of a free joint, then of a ball joint.
    """
    found = []
    for kind, count in (("createFreeJointAndBodyNodePair", 6), ("createBallJointAndBodyNodePair", 3)):
        skeleton = dart.dynamics.Skeleton()
        _, body = getattr(skeleton, kind)()
        set_to = np.array([1.0, 2.0, 3.0])
        skeleton.setPositions(np.array([1.0, 0.5, -0.3, 0, 0, 0])[:count])
        skeleton.setVelocities(np.array([*set_to, 0, 0, 0])[:count])
        omega = np.array(body.getAngularVelocity())
        turn = np.array(body.getTransform().rotation())
        found += [round(float(np.linalg.norm(one - set_to)), 12) for one in (turn.T @ omega, omega)]
    return found


def mjcf_site() -> list[float]:
    """Signal that ends a process which reads MJCF with a site in the world, and in a body; 0: none."""
    code = "import dartpy, sys; assert dartpy.utils.MjcfParser.readWorld(sys.argv[1])"
    body = '<body name="b"><geom size="0.1"/>{}</body>'
    found = []
    for text in ("<site/>" + body.format(""), body.format("<site/>")):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "model.xml"
            # without a default, releases up to 6.19.5 end at any model
            sphere = '<default><geom type="sphere"/></default>'
            path.write_text(f"<mujoco>{sphere}<worldbody>{text}</worldbody></mujoco>")
            done = subprocess.run([sys.executable, "-c", code, str(path)], check=False)
        found.append(-done.returncode)
    return found


def no_inertial() -> list[float]:
    """Mass and largest moment that DartLoader gives a URDF link that states no inertia."""
    body = _read('<robot name="m"><link name="a"/></robot>', ".urdf").getBodyNode(0)
    return [float(body.getMass()), float(np.max(np.array(body.getInertia().getMoment())))]
