"""The motion of the bodies of a tree over time, in doubles: from coordinates and rates, or the reverse.

Q = R(zero): parent axes from the axes at coordinate 0; E: these from the child's. Source: Featherstone
(2008), Rigid Body Dynamics Algorithms, section 4.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import gravity_potential
from bodycheck.reference_impl.rotations import (
    conjugate,
    cross,
    exp_quaternion,
    normalised,
    quaternion_product,
    rotate,
)
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeScene


def tree_trajectory(scene: TreeScene, t_s: Array, q: Array, u: Array) -> Trajectory:
    """Return the trajectory of coordinates q (n, nq) and rates u (n, nu) at times t_s (n,)."""
    position, quaternion, velocity, omega = (
        np.stack(part, axis=1) for part in zip(*_bodies(scene, q, u), strict=True)
    )
    return Trajectory(t_s, position, velocity, quaternion, omega_body_rad_s=omega, q=q, u=u)


def _bodies(scene: TreeScene, q: Array, u: Array) -> list[tuple[Array, Array, Array, Array]]:
    """Return position (n, 3), quaternion (n, 4), velocity (n, 3) and omega in body axes (n, 3) of each."""
    found: list[tuple[Array, Array, Array, Array]] = []
    rest = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        joint, own, speed = body.joint, q[:, places], u[:, rates]
        kind = joint.of_kind
        if kind.translation is Translation.SPACE:
            found.append((own[:, :3], own[:, 3:], speed[:, :3], speed[:, 3:]))
            continue
        x, parent, v, omega = rest if joint.parent < 0 else found[joint.parent]
        axis, still = normalised(joint.axis) if kind.has_axis else np.zeros(3), np.zeros((len(q), 3))
        spin = still
        turn = np.broadcast_to(normalised(joint.zero), (len(q), 4))
        if kind.rotation is Rotation.AXIS:
            spin, turn = axis * speed[:, -1:], quaternion_product(turn, exp_quaternion(axis * own[:, -1:]))
        elif kind.rotation is Rotation.BALL:
            spin, turn = speed[:, -3:], quaternion_product(turn, normalised(own[:, -4:]))
        quaternion = quaternion_product(parent, turn)
        own_omega = rotate(conjugate(turn), omega) + spin
        arm = rotate(parent, joint.at_parent)
        x, v = x + arm + still, v + cross(rotate(parent, omega + still), arm + still)
        if kind.translation is Translation.AXIS:
            along = rotate(quaternion, axis)
            slid = along * own[:, :1]
            x, v = x + slid, v + along * speed[:, :1] + cross(rotate(parent, omega + still), slid)
        back = -rotate(quaternion, joint.at_body)
        found.append((x + back, quaternion, v + cross(rotate(quaternion, own_omega), back), own_omega))
    return found


def tree_potential_energy(scene: TreeScene, motion: Trajectory) -> Array:
    """U of gravity, zero at the start, and of the springs, zero at rest: (n,) in J."""
    total = np.zeros(len(motion.t_s))
    for k, (body, part) in enumerate(zip(scene.bodies, scene.coordinate_slices, strict=True)):
        place = motion.position_m[:, k]
        total += gravity_potential(body.mass, scene.gravity, place - place[0])
        if body.joint.stiffness and motion.q is not None:
            total += 0.5 * body.joint.stiffness * (motion.q[:, part][:, 0] - body.joint.rest) ** 2
    return total


def tree_momenta(scene: TreeScene, motion: Trajectory) -> tuple[Array, Array]:
    """P and L about the origin of the world (n, 3), in world axes."""
    masses, inertias = np.array([body.mass for body in scene.bodies]), [body.inertia for body in scene.bodies]
    linear = masses[:, None] * motion.velocity_m_s
    spin = np.stack([motion.omega_body[:, k] @ inertia.T for k, inertia in enumerate(inertias)], axis=1)
    turned = np.einsum("...ij,...j->...i", motion.rotation_matrices, spin)
    return linear.sum(axis=1), (turned + cross(motion.position_m, linear)).sum(axis=1)


@dataclass(frozen=True, eq=False)
class JointMotion:
    """What the poses of bodies say of one joint: its coordinates (n, k) and rates (n, j), and its gap.

    gap_m (n,): from the joint's point of the parent to that of the child, across what the joint permits.
    gap_rad (n,): the angle by which the child turns otherwise than the joint permits.
    """

    q: Array
    u: Array
    gap_m: Array
    gap_rad: Array


def joints_of(scene: TreeScene, motion: Trajectory) -> list[JointMotion]:
    """Return the joints of bodies whose poses are known; an angle is within pi of 0."""
    return [_joint(body.joint, k, motion) for k, body in enumerate(scene.bodies)]


def _joint(joint: Joint, k: int, motion: Trajectory) -> JointMotion:
    kind, n = joint.of_kind, len(motion.t_s)
    x, turned, v, omega = (
        part[:, k] for part in (motion.position_m, motion.attitude, motion.velocity_m_s, motion.omega_body)
    )
    none = np.zeros(n)
    if kind.translation is Translation.SPACE:
        return JointMotion(np.hstack([x, turned]), np.hstack([v, omega]), none, none)
    at, parent, speed, spin = np.zeros((n, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.zeros((n, 3)), None
    if joint.parent >= 0:
        at, parent = motion.position_m[:, joint.parent], motion.attitude[:, joint.parent]
        speed, spin = motion.velocity_m_s[:, joint.parent], motion.omega_body[:, joint.parent]
    spin_world = np.zeros((n, 3)) if spin is None else rotate(parent, spin)
    axis = normalised(joint.axis) if kind.has_axis else np.zeros(3)
    relative = normalised(
        quaternion_product(conjugate(joint.zero), quaternion_product(conjugate(parent), turned))
    )
    rate = omega - rotate(conjugate(turned), spin_world)
    arm, back = rotate(parent, joint.at_parent), rotate(turned, joint.at_body)
    apart = x + back - at - arm
    parting = v + cross(rotate(turned, omega), back) - speed - cross(spin_world, arm + apart)
    q, u = np.zeros((n, 0)), np.zeros((n, 0))
    gap, slip = apart, relative
    if kind.translation is Translation.AXIS:
        along = rotate(turned, axis)
        q, u = _along(apart, along), _along(parting, along)
        gap = apart - q * along
    if kind.rotation is Rotation.AXIS:
        angle = 2.0 * np.arctan2(relative[:, 1:] @ axis, relative[:, 0])[:, None]
        angle -= 2.0 * math.pi * np.round(angle / (2.0 * math.pi))
        q, u = np.hstack([q, angle]), np.hstack([u, (rate @ axis)[:, None]])
        slip = quaternion_product(relative, exp_quaternion(-angle * axis))
    elif kind.rotation is Rotation.BALL:
        q, u, slip = np.hstack([q, relative]), np.hstack([u, rate]), np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    turn = 2.0 * np.arctan2(np.linalg.norm(slip[:, 1:], axis=1), np.abs(slip[:, 0]))
    return JointMotion(q, u, np.linalg.norm(gap, axis=1), turn)


def _along(vectors: Array, axes: Array) -> Array:
    """V . e (n, 1)."""
    return np.sum(vectors * axes, axis=-1, keepdims=True)
