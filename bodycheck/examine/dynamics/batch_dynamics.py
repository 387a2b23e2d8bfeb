"""The dynamics of many states of a tree at once, in doubles: what faulty equations would give.

Recursive Newton-Euler over arrays of states and of columns: one column for the bias, one at rest, and one for
each unit vector of M. Source: Featherstone (2008), Rigid Body Dynamics Algorithms, sections 5.3 and 6.2.
`tree_dynamics` judges engines; this one only makes hypotheses, and is a thousand times as fast.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.tree_dynamics import TreeDynamics
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, TreeScene

_NEXT = [1, 2, 0]


@dataclass(frozen=True, eq=False)
class _Stacked:
    """A number of one body in all states: q (k, nq), and its joint and mass properties (k, ...).

    places: of its coordinates. torque, force (k, 3): on it, in body and in world axes.
    """

    kind: str
    parent: int
    rates: slice
    places: slice
    q: Array
    at_parent: Array
    at_body: Array
    zero: Array
    axis: Array
    mass: Array
    inertia: Array
    torque: Array
    force: Array


class StackedTrees:
    """k trees of the same structure, for their equations in k states at once.

    passive (k, nu, 4): damping, armature, stiffness and rest of each rate.
    """

    def __init__(self, scenes: Sequence[TreeScene]) -> None:
        first = scenes[0]
        self.bodies = [_stacked(scenes, k) for k in range(len(first.bodies))]
        self.gravity = np.array([scene.gravity for scene in scenes])
        self.passive = np.array([_passive(scene) for scene in scenes])

    def at(self, q: Array) -> list[_Stacked]:
        """Return the bodies at the coordinates q (k, nq)."""
        return [replace(body, q=q[:, body.places]) for body in self.bodies]

    def equations(self, q: Array, u: Array, *, pushes: bool = True) -> tuple[Array, Array, Array, Array]:
        """Return M (k, nu, nu), the bias, the bias at rest, and what dampers and pushes apply (k, nu).

        M has the armatures. Springs are left out.
        """
        states, rates = u.shape
        bodies, columns = self.at(q), rates + 2
        speeds, pull = np.zeros((states, columns, rates)), np.zeros((states, columns, 3))
        speeds[:, 0], pull[:, :2] = u, self.gravity[:, None]
        wanted = np.zeros((states, columns, rates))
        wanted[:, 2:] = np.eye(rates)
        forces, *_ = _newton_euler(bodies, speeds, wanted, pull, pushed=False)
        damping, armature = self.passive[..., 0], self.passive[..., 1]
        applied = -damping * u
        if pushes:
            still = 0.0 * u[:, None]
            pushed, *_ = _newton_euler(bodies, still, still, 0.0 * pull[:, :1], pushed=True)
            applied = applied - pushed[:, 0]
        mass = forces[:, 2:] + armature[:, :, None] * np.eye(rates)
        return mass, forces[:, 0], forces[:, 1], applied

    def change_with_rates(self, q: Array, u: Array) -> Array:
        """dc/du (k, nu, nu) of the bias c, exactly, because c is quadratic in u."""
        rates = u.shape[1]
        speeds = u[:, None] + np.vstack([np.eye(rates), -np.eye(rates)])
        pull = np.repeat(self.gravity[:, None], 2 * rates, axis=1)
        forces, *_ = _newton_euler(self.at(q), speeds, 0.0 * speeds, pull, pushed=False)
        return np.asarray(0.5 * (forces[:, :rates] - forces[:, rates:]).transpose(0, 2, 1))

    def motion(self, q: Array, u: Array) -> tuple[Array, Array]:
        """Return the rotations R (b, k, 3, 3) and omega in body axes (b, k, 3) of the bodies."""
        speeds = u[:, None]
        _, m, _ = _newton_euler(self.at(q), speeds, 0.0 * speeds, 0.0 * self.gravity[:, None], pushed=False)
        rotations, omega = np.array(m.R), np.array(m.omega)[:, :, 0]
        return rotations, np.einsum("bkji,bkj->bki", rotations, omega)

    def with_pushes(self, force: Array, torque: Array) -> StackedTrees:
        """Return the trees under forces and torques (b, k, 3) on their bodies, in world and in body axes."""
        found = copy.copy(self)
        parts = zip(self.bodies, force, torque, strict=True)
        found.bodies = [replace(body, force=f, torque=t) for body, f, t in parts]
        return found


def _passive(scene: TreeScene) -> Array:
    joints = [body.joint for body in scene.bodies for _ in range(body.joint.of_kind.rates)]
    return np.array([(one.damping, one.armature, one.stiffness, one.rest) for one in joints])


def batch_dynamics(scenes: Sequence[TreeScene], q: Array, u: Array) -> list[TreeDynamics]:
    """Return the dynamics of k states: trees of the same structure, q (k, nq) and u (k, nu).

    Loads other than constant torques on bodies in their own axes, and springs, are left out.
    """
    states, trees = len(u), StackedTrees(scenes)
    mass, bias, at_rest, applied = trees.equations(q, u)
    bodies, gravity = trees.at(q), trees.gravity
    accelerations = np.asarray(np.linalg.solve(mass, (applied - bias)[..., None])[..., 0], np.float64)
    moving = (u[:, None], accelerations[:, None], gravity[:, None])
    _, motion, wrenches = _newton_euler(bodies, *moving, pushed=True)
    named = {"mass_matrix": mass, "bias": bias, "gravity_bias": at_rest}
    named |= {"applied": applied, "accelerations": accelerations}
    return [
        _dynamics(bodies, k, motion, wrenches, gravity[k], {name: one[k] for name, one in named.items()})
        for k in range(states)
    ]


def _stacked(scenes: Sequence[TreeScene], k: int) -> _Stacked:
    first = scenes[0]
    bodies = [scene.bodies[k] for scene in scenes]
    joints = [body.joint for body in bodies]
    torque = np.zeros((len(scenes), 3))
    for row, scene in zip(torque, scenes, strict=True):
        for load in scene.loads:
            if load.body == k and isinstance(load, BodyLoad) and load.load.axes == "body":
                row += load.load.value
    zero = np.array([joint.zero for joint in joints])
    axis = np.array([joint.axis for joint in joints])
    return _Stacked(
        joints[0].kind,
        -1 if joints[0].kind == "free" else joints[0].parent,
        first.rate_slices[k],
        first.coordinate_slices[k],
        np.empty(0),
        np.array([joint.at_parent for joint in joints]),
        np.array([joint.at_body for joint in joints]),
        zero,
        axis / np.linalg.norm(axis, axis=1, keepdims=True),
        np.array([body.mass for body in bodies]),
        np.array([body.inertia for body in bodies]),
        torque,
        np.zeros((len(scenes), 3)),
    )


def _matrices(quaternions: Array) -> Array:
    """R (k, 3, 3) of quaternions (k, 4) of any norm."""
    w, v = quaternions[:, 0, None, None], quaternions[:, 1:]
    square = np.sum(quaternions**2, axis=1)[:, None, None]
    cross = np.cross(np.eye(3)[None], v[:, None])
    return np.eye(3) + 2.0 * (w * cross + cross @ cross) / square


def _turn(body: _Stacked) -> Array:
    """Return the quaternion (k, 4) of the child relative to the parent."""
    if body.kind == "free":
        return body.q[:, 3:]
    if body.kind == "slide":
        return body.zero
    half = 0.5 * body.q
    own = body.q if body.kind == "ball" else np.hstack([np.cos(half), np.sin(half) * body.axis])
    return _product(body.zero, own)


def _product(p: Array, q: Array) -> Array:
    """P q: (k, 4), (k, 4) -> (k, 4)."""
    scalar = p[:, :1] * q[:, :1] - np.sum(p[:, 1:] * q[:, 1:], axis=1, keepdims=True)
    return np.hstack([scalar, p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + _cross(p[:, 1:], q[:, 1:])])


class _Motion:
    """The motion of bodies in world axes, one list entry a body.

    quaternion (k, 4), R (k, 3, 3), x and the joint's point (k, 3); v, omega, alpha and a (k, c, 3).
    """

    def __init__(self) -> None:
        self.quaternion, self.R, self.x, self.point = (list[Array]() for _ in range(4))
        self.v, self.omega, self.alpha, self.a = (list[Array]() for _ in range(4))

    def add(self, *motion: Array) -> None:
        """Append one body."""
        for values, value in zip(vars(self).values(), motion, strict=True):
            values.append(value)


def _rotate(R: Array, vectors: Array) -> Array:
    """R v: (k, 3, 3) and (k, c, 3) or (k, 3)."""
    return np.einsum("kij,k...j->k...i", R, vectors)


def _cross(a: Array, b: Array) -> Array:
    """A x b, several times as fast as np.cross for small arrays."""
    return np.asarray((a * b[..., _NEXT] - a[..., _NEXT] * b)[..., _NEXT])


def _newton_euler(
    bodies: Sequence[_Stacked], u: Array, wanted: Array, gravity: Array, *, pushed: bool
) -> tuple[Array, _Motion, Array]:
    """Return forces (k, c, nu) of the joints, the motion, and forces and moments (n, k, c, 6) in world axes.

    u, wanted: rates and their derivatives (k, c, nu). pushed: whether torques act on the bodies.
    """
    states, columns, _ = u.shape
    m, still, cross = _Motion(), np.zeros((states, columns, 3)), _cross
    for body in bodies:
        own, change = u[..., body.rates], wanted[..., body.rates]
        p, turn = body.parent, _turn(body)
        turn = turn if p < 0 else _product(m.quaternion[p], turn)
        R = _matrices(turn)
        if body.kind == "free":
            x, v, a = body.q[:, :3], own[..., :3], change[..., :3] - gravity
            omega, alpha, point = _rotate(R, own[..., 3:]), _rotate(R, change[..., 3:]), x
        else:
            arm, x, v, omega, alpha, a = body.at_parent, still[:, 0], still, still, still, still - gravity
            if p >= 0:
                arm, x, v, omega = _rotate(m.R[p], body.at_parent), m.x[p], m.v[p], m.omega[p]
                alpha, a = m.alpha[p], m.a[p]
            along = _rotate(R, body.axis)
            if body.kind == "slide":
                arm = arm + along * body.q
            reach, point = arm[:, None] + still, x + arm
            v, a = v + cross(omega, reach), a + cross(alpha, reach) + cross(omega, cross(omega, reach))
            if body.kind == "slide":
                sliding = along[:, None] * own
                v, a = v + sliding, a + along[:, None] * change + 2.0 * cross(omega, sliding)
            else:
                about = 1.0 if body.kind == "ball" else body.axis[:, None]
                spin = _rotate(R, own * about)
                alpha = alpha + _rotate(R, change * about) + cross(omega, spin)
                omega = omega + spin
            back = -_rotate(R, body.at_body)
            reach = back[:, None] + still
            x, v = point + back, v + cross(omega, reach)
            a = a + cross(alpha, reach) + cross(omega, cross(omega, reach))
        m.add(turn, R, x, point, v, omega, alpha, a)
    total = np.zeros((len(bodies), states, columns, 6))
    forces = np.zeros_like(u)
    for k in reversed(range(len(bodies))):
        body, R = bodies[k], m.R[k]
        inertia = R @ body.inertia @ R.transpose(0, 2, 1)
        total[k, ..., :3] += body.mass[:, None, None] * m.a[k]
        total[k, ..., 3:] += _rotate(inertia, m.alpha[k]) + cross(m.omega[k], _rotate(inertia, m.omega[k]))
        if pushed:
            total[k, ..., 3:] -= _rotate(R, body.torque)[:, None]
            total[k, ..., :3] -= body.force[:, None]
        force = total[k, ..., :3]
        if body.kind == "free":
            forces[..., body.rates] = np.concatenate(
                [force, _rotate(R.transpose(0, 2, 1), total[k, ..., 3:])], axis=-1
            )
            continue
        total[k, ..., 3:] -= cross((m.point[k] - m.x[k])[:, None] + still, force)
        moment = total[k, ..., 3:]
        if body.kind == "ball":
            forces[..., body.rates] = _rotate(R.transpose(0, 2, 1), moment)
        else:
            along = _rotate(R, body.axis)[:, None]
            forces[..., body.rates] = np.sum(
                along * (force if body.kind == "slide" else moment), axis=-1, keepdims=True
            )
        if body.parent >= 0:
            total[body.parent, ..., :3] += force
            total[body.parent, ..., 3:] += moment + cross(
                (m.point[k] - m.x[body.parent])[:, None] + still, force
            )
    return forces, m, total


def _dynamics(
    bodies: Sequence[_Stacked],
    k: int,
    motion: _Motion,
    wrenches: Array,
    gravity: Array,
    named: dict[str, Array],
) -> TreeDynamics:
    """Return the dynamics of state k; named: its fields that are known already."""
    quaternion, R = np.array([one[k] for one in motion.quaternion]), np.array([one[k] for one in motion.R])
    x, v = np.array([one[k] for one in motion.x]), np.array([one[k, 0] for one in motion.v])
    omega = np.einsum("nji,nj->ni", R, np.array([one[k, 0] for one in motion.omega]))
    masses = np.array([body.mass[k] for body in bodies])
    spin = np.array([body.inertia[k] @ w for body, w in zip(bodies, omega, strict=True)])
    momentum = masses[:, None] * v
    is_free = np.array([body.kind == "free" for body in bodies])
    wrench = np.where(is_free[:, None], 0.0, wrenches[:, k, 0])
    return TreeDynamics(
        position=x,
        quaternion=quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        velocity=v,
        omega_body=omega,
        joint_force=np.einsum("nji,nj->ni", R, wrench[:, :3]),
        joint_moment=np.einsum("nji,nj->ni", R, wrench[:, 3:]),
        kinetic=float(0.5 * (np.sum(momentum * v) + np.sum(spin * omega))),
        potential=float(-masses @ x @ gravity),
        momentum=momentum.sum(axis=0),
        angular_momentum=(np.cross(x, momentum) + np.einsum("nij,nj->ni", R, spin)).sum(axis=0),
        **named,
    )
