"""The mjModel of a scene: one body without geometry, on a free joint or on a ball joint at its pivot.

Built through MjSpec: XML would round every number to six digits. A free joint lies at the centre of mass
whatever the link frame is, for MuJoCo integrates the velocity of the joint's place: where a link frame is
asked for, the compiler's own alignment moves the frame of the body there, to its principal axes.
"""

from __future__ import annotations

import mujoco
import numpy as np

from bodycheck.adapters.link_frame import LinkFrame, link_frame, pivot_place
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.scene import PointForce, Scene

BODY = 1  # body 0 is the world

PASSIVE_OFF = (mujoco.mjtDisableBit.mjDSBL_SPRING, mujoco.mjtDisableBit.mjDSBL_DAMPER)
"""With both of them off MuJoCo has no passive forces at all, and asks no callback for any."""

OFF = (
    mujoco.mjtDisableBit.mjDSBL_AUTORESET,  # it would put a body that grew unstable back to rest, in silence
    mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    mujoco.mjtDisableBit.mjDSBL_CONTACT,
    mujoco.mjtDisableBit.mjDSBL_EULERDAMP,
    mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL,
    mujoco.mjtDisableBit.mjDSBL_SENSOR,
)

# A body-fixed point where a world force acts; None for the body-fixed forces, summed at the centre of mass.
Point = tuple[float, ...] | None


def loaded_points(scene: Scene) -> tuple[Point, ...]:
    """Return where site actuators are needed, each once."""
    forces = [load for load in scene.loads if isinstance(load, PointForce)]
    points: dict[Point, None] = {}
    for force in forces:
        if force.axes == "body":
            points[None] = None
        elif np.any(force.at):
            points[tuple(force.at)] = None
    return tuple(points)


def joint_axes(scene: Scene) -> Array:
    """Return the axes of the joint's frame as columns, in body axes: (3, 3)."""
    if scene.link is not None and scene.pivot is None:  # aligned
        return diagonalised(scene.body.inertia)[1]
    return link_frame(scene).rotation


def compiled(
    scene: Scene,
    integrator: mujoco.mjtIntegrator,
    dt_s: float,
    points: tuple[Point, ...],
    off: tuple[mujoco.mjtDisableBit, ...],
) -> mujoco.MjModel:
    """Compile the model with these features off."""
    spec = mujoco.MjSpec()
    spec.option.integrator = integrator
    spec.option.timestep = dt_s
    spec.option.gravity = scene.gravity
    spec.option.disableflags = sum(int(bit) for bit in off)

    moments, axes = diagonalised(scene.body.inertia)
    link = link_frame(scene)
    body = spec.worldbody.add_body(name="body")
    _add_joint(body, scene, link)
    body.mass = scene.body.mass
    body.ipos = link.point(np.zeros(3))  # left unset, the compiler drops iquat without a word
    body.iquat = link.turned(matrix_to_quaternion(axes))
    # A flat plate's moments may break the triangle inequality by a round-off, which the compiler refuses.
    body.inertia = np.minimum(moments, np.roll(moments, 1) + np.roll(moments, 2))

    if points:
        spec.worldbody.add_site(name="world")
    for number, point in enumerate(points):
        _add_force(spec, body, f"point-{number}", point, link)
    model = spec.compile()
    if not np.array_equal(model.body_inertia[BODY], moments):
        model.body_inertia[BODY] = moments
        # The mass matrix of a simple body is not computed in a step but copied from dof_M0.
        mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def _add_joint(body: mujoco.MjsBody, scene: Scene, link: LinkFrame) -> None:
    if scene.pivot is None:
        joint = body.add_freejoint()
        if scene.link is not None:
            joint.align = mujoco.mjtAlignFree.mjALIGNFREE_TRUE
        return
    place = link.point(scene.pivot)
    body.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, pos=place)
    body.pos = pivot_place(scene) - place


def _add_force(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, point: Point, link: LinkFrame) -> None:
    """Add an actuator whose gear will be the force: one actuator a point costs less than one a component."""
    place = link.point(np.zeros(3) if point is None else np.array(point))
    body.add_site(name=name, pos=place, quat=link.turned(np.array([1.0, 0.0, 0.0, 0.0])))
    axes_of_the_world = "" if point is None else "world"
    spec.add_actuator(
        name=name, trntype=mujoco.mjtTrn.mjTRN_SITE, target=name, refsite=axes_of_the_world, gear=np.zeros(6)
    )
