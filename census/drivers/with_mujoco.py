"""MuJoCo by itself."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mujoco
import numpy as np
from exact import SPIN, TOP, angle, of_quaternion, order, rotation, top

_BODY = """<mujoco><option timestep="{dt}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
<body name="b">{joint}<inertial pos="{pos}" mass="1" diaginertia="{moments}"/></body></worldbody></mujoco>"""
_FREE, _BALL = "<freejoint/>", '<joint type="ball"/>'
_URDF = """<robot name="r"><link name="world"/><link name="a"><inertial><origin xyz="0 0 0" rpy="0 0 0.5"/>
<mass value="2"/><inertia ixx="1" ixy="0.1" ixz="0" iyy="1.5" iyz="0" izz="2"/></inertial></link>
<joint name="j" type="continuous"><parent link="world"/><child link="a"/>
<axis xyz="0 0 1"/></joint></robot>"""


def _run(integrator: str, dt: float, time: float, joint: str = _FREE, pos: str = "0 0 0") -> mujoco.MjData:
    text = _BODY.format(dt=dt, integrator=integrator, joint=joint, pos=pos, moments=" ".join(map(str, TOP)))
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[-3:] = SPIN
    for _ in range(round(time / dt)):
        mujoco.mj_step(model, data)
    return data


def _top_error(integrator: str, dt: float, joint: str = _FREE) -> float:
    return angle(top(1.0), of_quaternion(*_run(integrator, dt, 1.0, joint).qpos[-4:]))


def rk4_order() -> list[float]:
    """Order of RK4 on a symmetric top, from 2e-2 to 1e-2 s, and its error at 1e-2 s."""
    coarse, fine = (_top_error("RK4", dt) for dt in (2e-2, 1e-2))
    return [order(coarse, fine), fine]


def implicit_order() -> list[float]:
    """Orders of implicit and implicitfast on the same, from 1e-2 to 5e-3 s."""
    return [order(*(_top_error(name, dt) for dt in (1e-2, 5e-3))) for name in ("implicit", "implicitfast")]


def ball_implicitfast() -> list[float]:
    """Error at 1e-2 s of Euler, implicitfast and implicit on a ball joint at the centre of mass."""
    return [_top_error(name, 1e-2, _BALL) for name in ("Euler", "implicitfast", "implicit")]


def link_drift() -> list[float]:
    """How far the centre of mass of a spinning body moves in m, and the order of that; true: 0."""
    found = []
    centre = np.array([0.2, 0.1, 0.0])
    for dt in (1e-2, 5e-3):
        text = _BODY.format(dt=dt, integrator="Euler", joint=_FREE, pos="0.2 0.1 0", moments="2 2 1")
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        data.qvel[3:] = SPIN
        data.qvel[:3] = -np.cross(SPIN, centre)  # the centre of mass is at rest
        for _ in range(round(2.0 / dt)):
            mujoco.mj_step(model, data)
        found.append(float(np.linalg.norm(data.qpos[:3] + of_quaternion(*data.qpos[3:]) @ centre - centre)))
    return [found[0], order(*found)]


def _compiled(text: str, suffix: str = ".urdf") -> mujoco.MjModel:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"model{suffix}"
        path.write_text(text)
        return mujoco.MjModel.from_xml_path(str(path))


def urdf_frame() -> list[float]:
    """Largest deviation of the tensor held, in link axes, from R I R^T of the file, kg m^2."""
    model = _compiled(_URDF.replace('<link name="world"/>', '<link name="base"/>').replace("world", "base"))
    body = model.body("a").id
    axes = of_quaternion(*model.body_iquat[body])
    held = axes @ np.diag(model.body_inertia[body]) @ axes.T
    turn = rotation(np.array([0.0, 0.0, 0.5]))
    stated = turn @ np.array([[1.0, 0.1, 0.0], [0.1, 1.5, 0.0], [0.0, 0.0, 2.0]]) @ turn.T
    return [float(np.max(np.abs(held - stated)))]


def urdf_mimic() -> list[float]:
    """Equality constraints after a URDF with one mimic joint."""
    part = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
    iyz="0"/></inertial></link><joint name="j{0}" type="revolute"><parent link="b"/><child link="{0}"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="9"/>{1}</joint>"""
    links = part.format("c", "") + part.format("d", '<mimic joint="jc"/>')
    return [_compiled(f'<robot name="r"><link name="b"/>{links}</robot>').neq]


def urdf_root() -> list[float]:
    """Mass of all bodies but the world of a URDF with one link of 2 kg: 0 if it is a part of the world."""
    text = """<robot name="r"><link name="a"><inertial><mass value="2"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""
    model = _compiled(text)
    return [float(model.body_mass[1:].sum()), model.nbody - 1]


_MESH = """<mujoco><asset><mesh name="m" {inertia} vertex="{vertex}" face="{face}"/></asset><worldbody>
<body name="b"><freejoint/><geom type="mesh" mesh="m" density="1000" contype="0" conaffinity="0"/>
</body></worldbody></mujoco>"""


def concave_mesh() -> list[float]:
    """Mass of a U of 10 cubes of 0.1 m at 1000 kg/m^3, 10 kg, with inertia legacy, exact and convex.

    The U is open at the top: 3 by 4 cubes without the upper 2 of the middle column, 0.1 m deep.
    """
    outline = [(0, 0), (3, 0), (3, 4), (2, 4), (2, 2), (1, 2), (1, 4), (0, 4)]
    points = [(0.1 * x, 0.1 * z, 0.1 * y) for y in (0, 1) for x, z in outline]  # two walls
    n = len(outline)
    flat = [(0, 1, 5), (1, 4, 5), (1, 2, 4), (2, 3, 4), (0, 5, 7), (5, 6, 7)]
    faces = [(a, c, b) for a, b, c in flat] + [(a + n, b + n, c + n) for a, b, c in flat]
    for k in range(n):
        m = (k + 1) % n
        faces += [(k, m, m + n), (k, m + n, k + n)]
    vertex = " ".join(f"{x:.1f} {y:.1f} {z:.1f}" for x, y, z in points)
    face = " ".join(" ".join(map(str, one)) for one in faces)
    masses = []
    for inertia in ("", 'inertia="exact"', 'inertia="convex"'):
        model = mujoco.MjModel.from_xml_string(_MESH.format(inertia=inertia, vertex=vertex, face=face))
        masses.append(float(model.body_mass[1]))
    return masses


def stale_readings() -> list[float]:
    """Kinetic energy that a step leaves in data.energy, and that of the velocities that it leaves in qvel."""
    text = """<mujoco><option timestep="0.01" gravity="0 0 -10"><flag energy="enable"/></option><worldbody>
    <body><freejoint/><inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for _ in range(10):
        mujoco.mj_step(model, data)
    return [float(data.energy[1]), float(data.qvel[2] ** 2)]


def spec_inertial_frame() -> list[float]:
    """Distance of a body's centre of mass from its origin in m, and angle of its inertial frame in rad.

    MjSpec has a body at (1, 2, 3) with iquat of 0.5 rad: without ipos, and with ipos = 0.
    """
    found = []
    for ipos in (None, [0.0, 0.0, 0.0]):
        spec = mujoco.MjSpec()
        body = spec.worldbody.add_body(
            pos=[1.0, 2.0, 3.0], mass=1.0, inertia=[1.0, 1.5, 2.0], explicitinertial=True
        )
        body.iquat = [np.cos(0.25), 0.0, 0.0, np.sin(0.25)]
        if ipos is not None:
            body.ipos = ipos
        body.add_freejoint()
        model = spec.compile()
        found += [
            float(np.linalg.norm(model.body_ipos[1])),
            angle(np.eye(3), of_quaternion(*model.body_iquat[1])),
        ]
    return found


def chain() -> list[float]:
    """Change of a free chain's momentum in kg m/s after 2 s by Euler at 1e-2 s, and its order; true: 0."""
    text = """<mujoco><option timestep="{}" gravity="0 0 0"/><worldbody><body><freejoint/>
    <inertial pos="0 0 0" mass="2" diaginertia=".05 .08 .1"/><body pos=".3 .05 -.02"><joint axis="0 0 1"/>
    <inertial pos=".25 .02 .03" mass="1" diaginertia=".01 .02 .025"/>
    <body pos=".5 0 .04"><joint axis="0 1 0"/>
    <inertial pos=".15 -.01 .02" mass=".5" diaginertia=".002 .003 .004"/></body></body></body></worldbody>
    </mujoco>"""
    found = []
    for dt in (1e-2, 5e-3):
        model = mujoco.MjModel.from_xml_string(text.format(dt))
        data = mujoco.MjData(model)
        data.qpos[7:] = (0.3, -0.4)
        data.qvel[3:] = (0.2, 0.1, -0.3, 1.0, -0.7)
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        start = data.subtree_linvel[1].copy()
        for _ in range(round(2.0 / dt)):
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        mujoco.mj_subtreeVel(model, data)
        mass = float(model.body_subtreemass[1])
        found.append(mass * float(np.linalg.norm(data.subtree_linvel[1] - start)))
    return [found[0], order(*found)]
