"""MuJoCo's integrators by version, and the mjModel of a scene: one body without geometry.

`bodycheck versions mujoco --since 3.6` found the changes between versions.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import mujoco
import numpy as np

from bodycheck.adapters.contract import DEFAULTS, VARIANT, Method
from bodycheck.adapters.frames import LinkFrame, link_frame, pivot_place
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised, parallel_axis_tensor
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.scene import PointForce, Scene

_MANUAL = "MuJoCo documentation, Computation, Numerical integration"
_CONSERVES = "|q| = 1; linear momentum"
_OFF = ("autoreset off", "constraints, contacts, springs, dampers and sensors off")
_CHANGED = (*_OFF, "the free joint of a body with a link frame aligned")
_BY_THE_ORIGIN = (
    "; v and x of the link's origin are stepped, v += h (F / m - d(omega x c)/dt), c the centre of mass"
)
_EXPLICIT, _IMPLICIT, _MIDPOINT = "M1", "M2", "implicit midpoint"


def methods_of(version: str) -> dict[str, Method]:
    """Return name -> Method of the integrators of a version like "3.8.1"."""
    numbers = tuple(int(number) for number in re.findall(r"\d+", version)[:3])
    midpoint = numbers >= (3, 7)
    implicit = _MIDPOINT if midpoint and numbers < (3, 8, 1) else _IMPLICIT
    fast = _IMPLICIT if numbers >= (3, 11) else _MIDPOINT if midpoint else _EXPLICIT
    return {
        "euler": _one_evaluation("euler", _EXPLICIT),
        "rk4": Method(
            name="rk4",
            formula="RK4 Munthe-Kaas" if numbers >= (4,) else "RK4 on the rotation group, stages averaged",
            order=4 if numbers >= (4,) else 2,
            evaluations=4,
            torque="every stage",
            continuous_loads="every stage",
            conserves=_CONSERVES,
            source=_MANUAL,
            changed_defaults=_CHANGED,
            snippet=_snippet("rk4"),
        ),
        "implicit": _one_evaluation("implicit", implicit),
        "implicitfast": _one_evaluation("implicitfast", fast),
        "discrete": _one_evaluation("discrete", _IMPLICIT),
    }


def variants_of(methods: Iterable[Method]) -> dict[str, Method]:
    """Return the variants that occur in practice: with all defaults, unaligned, and with a welded child."""
    found: dict[str, Method] = {}
    for method in methods:
        if method.name == "euler":
            found[f"euler{DEFAULTS}"] = _variant(method, DEFAULTS, ())
        for variant in (f"{VARIANT}unaligned", f"{VARIANT}welded"):
            found[f"{method.name}{variant}"] = _variant(method, variant, _OFF)
    return found


def _variant(method: Method, variant: str, changed: tuple[str, ...]) -> Method:
    return replace(
        method,
        name=f"{method.name}{variant}",
        formula=method.formula + _BY_THE_ORIGIN,
        conserves="|q| = 1; linear momentum where the link is at the centre of mass",
        changed_defaults=changed,
    )


def _one_evaluation(name: str, formula: str) -> Method:
    order = 2 if formula == _MIDPOINT else 1
    return Method(
        name,
        formula,
        order,
        1,
        "zero-order hold",
        _CONSERVES,
        _MANUAL,
        changed_defaults=_CHANGED,
        snippet=_snippet(name),
    )


def _snippet(name: str) -> str:
    integrator = f"mujoco.mjtIntegrator.mjINT_{name.upper()}"
    return f"model.opt.timestep = {{dt_s}}; model.opt.integrator = {integrator}"


BODY = 1  # body 0 is the world

PASSIVE_OFF = tuple(
    flag
    for name in ("SPRING", "DAMPER", "PASSIVE")
    if (flag := getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}", None)) is not None
)
"""Disabled, MuJoCo has no passive forces and calls no callback; one flag until 3.3.5, two since."""

OFF = (
    mujoco.mjtDisableBit.mjDSBL_AUTORESET,  # it would silently reset an unstable body to rest
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
    mujoco.mjtDisableBit.mjDSBL_EULERDAMP,
    mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL,
    mujoco.mjtDisableBit.mjDSBL_SENSOR,
)

Build: TypeAlias = Literal["aligned", "unaligned", "welded"]

# A body-fixed point where a world force acts; None for the body-fixed forces, summed at the centre of mass.
Point = tuple[float, ...] | None


def loaded_points(scene: Scene) -> tuple[Point, ...]:
    """Return the points that need a site actuator, each once."""
    forces = [load for load in scene.loads if isinstance(load, PointForce)]
    points: dict[Point, None] = {}
    for force in forces:
        if force.axes == "body":
            points[None] = None
        elif np.any(force.at):
            points[tuple(force.at)] = None
    return tuple(points)


def joint_axes(scene: Scene, build: Build) -> Array:
    """Return the axes of the joint's frame as columns, in body axes: (3, 3)."""
    if build == "aligned" and scene.link is not None and scene.pivot is None:
        return diagonalised(scene.body.inertia)[1]
    return link_frame(scene).rotation


def compiled(
    scene: Scene,
    integrator: mujoco.mjtIntegrator,
    dt_s: float,
    points: tuple[Point, ...],
    off: tuple[mujoco.mjtDisableBit, ...],
    build: Build,
    imu: Array | None = None,
) -> mujoco.MjModel:
    """Compile the model with these features off; its last body has the mass.

    imu (3,): the point of an accelerometer and a gyro, in body axes from the centre of mass.
    """
    spec = mujoco.MjSpec()
    spec.option.integrator = integrator
    spec.option.timestep = dt_s
    spec.option.gravity = scene.gravity
    spec.option.disableflags = sum(int(bit) for bit in off)

    moments, axes = diagonalised(scene.body.inertia)
    link = link_frame(scene)
    body = spec.worldbody.add_body(name="body")
    _add_joint(body, scene, link, build)
    centre, quaternion = link.point(np.zeros(3)), link.rotated(matrix_to_quaternion(axes))
    solid = body
    if build == "welded":
        solid = body.add_body(name="welded", pos=centre, quat=quaternion)
        centre, quaternion = np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])
    solid.mass = scene.body.mass
    solid.ipos = centre  # if unset, the compiler silently drops iquat
    solid.iquat = quaternion
    # A flat plate's moments may violate the triangle inequality by round-off, which the compiler rejects.
    solid.inertia = np.minimum(moments, np.roll(moments, 1) + np.roll(moments, 2))

    if points:
        spec.worldbody.add_site(name="world")
    for number, point in enumerate(points):
        _add_force(spec, body, f"point-{number}", point, link)
    if imu is not None:
        body.add_site(name="imu", pos=link.point(imu), quat=link.rotated(np.array([1.0, 0.0, 0.0, 0.0])))
        for kind in (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO):
            spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="imu")
    model = spec.compile()
    if not np.array_equal(model.body_inertia[-1], moments):
        model.body_inertia[-1] = moments
        # For a simple body, a step copies the mass matrix from dof_M0 instead of computing it.
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


@dataclass(frozen=True, eq=False)
class StatedMassProperties:
    """Mass in kg, centre of mass (3,) in m and the inertia tensor about it (3, 3) in kg m^2."""

    mass: float
    centre: Array
    inertia: Array


def mass_properties(model: mujoco.MjModel) -> StatedMassProperties:
    """Return the mass properties of the body with everything welded to it, in the body's frame."""
    masses = model.body_mass[BODY:]
    total = float(np.sum(masses))
    rotations, places = [np.eye(3)], [model.body_ipos[BODY]]
    for child in range(BODY + 1, model.nbody):
        rotations.append(matrix_of(model.body_quat[child]))
        places.append(model.body_pos[child] + rotations[-1] @ model.body_ipos[child])
    centre = np.asarray((masses / total) @ np.array(places))
    inertia = np.zeros((3, 3))
    for k, (rotation, place) in enumerate(zip(rotations, places, strict=True), start=BODY):
        axes, arm = rotation @ matrix_of(model.body_iquat[k]), place - centre
        inertia += axes @ np.diag(model.body_inertia[k]) @ axes.T
        inertia += model.body_mass[k] * parallel_axis_tensor(arm)
    return StatedMassProperties(total, centre, inertia)


def matrix_of(quaternion: Array) -> Array:
    """mju_quat2Mat(q): (4,) -> (3, 3)."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _add_joint(body: mujoco.MjsBody, scene: Scene, link: LinkFrame, build: Build) -> None:
    if scene.pivot is None:
        joint = body.add_freejoint()
        if scene.link is not None and build == "aligned":
            joint.align = mujoco.mjtAlignFree.mjALIGNFREE_TRUE
        return
    place = link.point(scene.pivot)
    body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, pos=place)
    body.pos = pivot_place(scene) - place


def _add_force(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, point: Point, link: LinkFrame) -> None:
    """Add an actuator whose gear is the force; one per point is cheaper than one per component."""
    place = link.point(np.zeros(3) if point is None else np.array(point))
    body.add_site(name=name, pos=place, quat=link.rotated(np.array([1.0, 0.0, 0.0, 0.0])))
    axes_of_the_world = "" if point is None else "world"
    spec.add_actuator(
        name=name, trntype=mujoco.mjtTrn.mjTRN_SITE, target=name, refsite=axes_of_the_world, gear=np.zeros(6)
    )
