"""The dynamics of a tree in 50 digits and maximal coordinates: bodies with forces that hold the joints.

Each body has six accelerations, each joint a force and a moment, and each direction in which a joint permits
no motion an equation for the accelerations. One linear system gives all of them. The mass matrix follows from
the velocities of the bodies for unit rates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpmath import mp, mpf

from bodycheck.reference_impl.scene import Torque
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    JointSineTorque,
    JointTorque,
    TreeScene,
    interval,
)

DIGITS = 50
Vector = Any  # object arrays of mpf


@dataclass(frozen=True)
class Witness:
    """The fields of TreeDynamics with the same names, as object arrays of mpf."""

    mass_matrix: Vector
    bias: Vector
    accelerations: Vector
    applied: Vector
    joint_force: Vector
    joint_moment: Vector


def _exact(values: Any) -> Vector:
    return np.array([mpf(float(x)) for x in np.ravel(values)], dtype=object).reshape(np.shape(values))


def _unit(v: Vector) -> Vector:
    return v / mp.sqrt(sum(v * v))


def _rotation(q: Vector) -> Vector:
    w, x, y, z = _unit(q)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=object)
    return np.eye(3, dtype=int).astype(object) + 2 * w * k + 2 * (k @ k)


def _about(axis: Vector, angle: Any) -> Vector:
    half = angle / 2
    return _rotation(np.array([mp.cos(half), *(mp.sin(half) * axis)], dtype=object))


class _Bodies:
    """Places of the bodies at q, and functions of u: their velocities."""

    def __init__(self, scene: TreeScene, q: Vector) -> None:
        self.scene, self.q = scene, q
        self.axis: list[Vector] = []
        self.rotation: list[Vector] = []
        self.position: list[Vector] = []
        for body, where in zip(scene.bodies, scene.coordinate_slices, strict=True):
            joint, own = body.joint, q[where]
            zero, axis = _rotation(_exact(joint.zero)), _unit(_exact(joint.axis))
            above = self.rotation[joint.parent] if joint.parent >= 0 else np.eye(3, dtype=int).astype(object)
            centre = self.position[joint.parent] if joint.parent >= 0 else _exact(np.zeros(3))
            turned = {"hinge": _about, "slide": lambda *_: _rotation(_exact([1.0, 0, 0, 0]))}
            relative = turned[joint.kind](axis, own[0]) if joint.kind in turned else _rotation(own[-4:])
            rotation = above @ zero @ relative
            point = centre + above @ _exact(joint.at_parent)
            if joint.kind == "slide":
                point = point + above @ zero @ axis * own[0]
            position = own[:3] if joint.kind == "free" else point - rotation @ _exact(joint.at_body)
            self.axis.append(above @ zero @ axis)
            self.rotation.append(rotation)
            self.position.append(position)

    def arms(self, i: int) -> tuple[Vector, Vector]:
        """From the centres of parent (or origin) and body to the joint's points, world axes."""
        joint = self.scene.bodies[i].joint
        above = self.rotation[joint.parent] if joint.parent >= 0 else np.eye(3, dtype=int).astype(object)
        return above @ _exact(joint.at_parent), self.rotation[i] @ _exact(joint.at_body)

    def velocities(self, u: Vector) -> tuple[list[Vector], list[Vector]]:
        """Return velocities of the centres and angular velocities, world axes."""
        velocity: list[Vector] = []
        omega: list[Vector] = []
        for i, body in enumerate(self.scene.bodies):
            joint, own = body.joint, u[self.scene.rate_slices[i]]
            v = velocity[joint.parent] if joint.parent >= 0 else _exact(np.zeros(3))
            w = omega[joint.parent] if joint.parent >= 0 else _exact(np.zeros(3))
            arm, back = self.arms(i)
            if joint.kind == "free":
                velocity.append(own[:3])
                omega.append(self.rotation[i] @ own[3:])
                continue
            if joint.kind == "slide":
                s = self.q[self.scene.coordinate_slices[i]][0]
                v = v + self.axis[i] * own[0] + np.cross(w, self.axis[i] * s)
            total = w
            if joint.kind == "hinge":
                total = w + self.axis[i] * own[0]
            elif joint.kind == "ball":
                total = w + self.rotation[i] @ own
            velocity.append(v + np.cross(w, arm) - np.cross(total, back))
            omega.append(total)
        return velocity, omega


def witness(scene: TreeScene, q: Any, u: Any, t_s: float = 0.0) -> Witness:
    """Return the dynamics at doubles q and u."""
    with mp.workdps(DIGITS):
        return _witness(scene, _exact(q), _exact(u), mpf(t_s))


def _witness(scene: TreeScene, q: Vector, u: Vector, t: Any) -> Witness:
    bodies, n = _Bodies(scene, q), len(scene.bodies)
    columns = []
    for k in range(len(u)):
        unit = _exact(np.eye(len(u))[k])
        v, w = bodies.velocities(unit)
        columns.append((v, w))
    inertia = [r @ _exact(b.inertia) @ r.T for r, b in zip(bodies.rotation, scene.bodies, strict=True)]
    mass = np.array(
        [
            [
                sum(
                    mpf(b.mass) * (va[i] @ vb[i]) + wa[i] @ inertia[i] @ wb[i]
                    for i, b in enumerate(scene.bodies)
                )
                for vb, wb in columns
            ]
            for va, wa in columns
        ],
        dtype=object,
    )
    for body, rows in zip(scene.bodies, scene.rate_slices, strict=True):
        for k in range(rows.start, rows.stop):
            mass[k, k] += mpf(body.joint.armature)
    applied = _joint_torques(scene, q, u, t)
    forces, torques = _body_loads(scene, bodies, float(t))
    generalised = applied.copy()
    for k, (v, w) in enumerate(columns):
        generalised[k] += sum(forces[i] @ v[i] + torques[i] @ w[i] for i in range(n))
    accelerations, joint_force, joint_moment = _constrained(scene, bodies, u, applied, forces, torques)
    free_fall, _, _ = _constrained(scene, bodies, u, 0 * applied, 0 * forces, 0 * torques)
    return Witness(mass, -(mass @ free_fall), accelerations, generalised, joint_force, joint_moment)


def _joint_torques(scene: TreeScene, q: Vector, u: Vector, t: Any) -> Vector:
    applied = 0 * u
    for body, place, rows in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        applied[rows] = applied[rows] - mpf(body.joint.damping) * u[rows]
        if body.joint.stiffness:
            applied[rows] = applied[rows] - mpf(body.joint.stiffness) * (q[place] - mpf(body.joint.rest))
    for load in scene.loads:
        start, end = interval(load)
        if isinstance(load, BodyLoad) or not start <= t < end:
            continue
        rows = scene.rate_slices[load.body]
        if isinstance(load, JointTorque):
            applied[rows] = applied[rows] + _exact(load.value)
        elif isinstance(load, JointSineTorque):
            swing = mp.sin(mpf(load.rate) * t + mpf(load.phase))
            applied[rows] = applied[rows] + mpf(load.amplitude) * swing
    return applied


def _body_loads(scene: TreeScene, bodies: _Bodies, t: float) -> tuple[Vector, Vector]:
    forces = _exact(np.zeros((len(scene.bodies), 3)))
    torques = forces.copy()
    for load in scene.loads:
        if not isinstance(load, BodyLoad) or not interval(load)[0] <= t < interval(load)[1]:
            continue
        rotation, value = bodies.rotation[load.body], _exact(load.load.value)
        value = rotation @ value if load.load.axes == "body" else value
        if isinstance(load.load, Torque):
            torques[load.body] = torques[load.body] + value
        else:
            forces[load.body] = forces[load.body] + value
            arm = rotation @ _exact(load.load.at)
            torques[load.body] = torques[load.body] + np.cross(arm, value)
    return forces, torques


def _constrained(
    scene: TreeScene, bodies: _Bodies, u: Vector, applied: Vector, forces: Vector, torques: Vector
) -> tuple[Vector, Vector, Vector]:
    """Solve for the accelerations a, alpha and for the force and moment of each joint at its point.

    Armatures are not supported.
    """
    n = len(scene.bodies)
    unknowns = 12 * n  # a, alpha, F, T of each body
    rows: list[dict[int, Any]] = []

    def vector_equations(terms: list[tuple[int, Vector]], value: Vector, directions: Vector) -> None:
        """Direction . (sum of M x) = direction . value."""
        for direction in directions:
            row: dict[int, Any] = {unknowns: direction @ value}
            for place, m in terms:
                for column, coefficient in enumerate(direction @ m, place):
                    row[column] = row.get(column, mpf(0)) + coefficient
            rows.append({column: entry for column, entry in row.items() if entry or column == unknowns})

    eye = np.eye(3, dtype=int).astype(object)
    _, omega = bodies.velocities(u)
    still = _exact(np.zeros(3))
    gravity = _exact(scene.gravity)
    for i, body in enumerate(scene.bodies):
        a, alpha, force, moment = (12 * i + 3 * part for part in range(4))
        inertia = bodies.rotation[i] @ _exact(body.inertia) @ bodies.rotation[i].T
        newton = [(a, mpf(body.mass) * eye), (force, -eye)]
        euler = [(alpha, inertia), (moment, -eye), (force, -_hat(bodies.arms(i)[1]))]
        for child, other in enumerate(scene.bodies):
            if other.joint.parent == i:
                newton.append((12 * child + 6, eye))
                # from the centre to where the child's point is
                reach = bodies.position[child] + bodies.arms(child)[1] - bodies.position[i]
                euler += [(12 * child + 9, eye), (12 * child + 6, _hat(reach))]
        vector_equations(newton, mpf(body.mass) * gravity + forces[i], eye)
        gyroscopic = np.cross(omega[i], inertia @ omega[i])
        vector_equations(euler, torques[i] - gyroscopic, eye)
        _joint_equations(scene, bodies, i, u, omega, applied, vector_equations)
    x = np.array(_solved(rows, unknowns), dtype=object).reshape(n, 4, 3)
    rates = 0 * u
    for i, body in enumerate(scene.bodies):
        rows_, parent, axis = scene.rate_slices[i], body.joint.parent, bodies.axis[i]
        over = x[parent] if parent >= 0 else _exact(np.zeros((4, 3)))
        spin = omega[parent] if parent >= 0 else still
        if body.joint.kind == "free":
            rates[rows_] = np.concatenate([x[i, 0], bodies.rotation[i].T @ x[i, 1]])
        elif body.joint.kind == "hinge":
            rates[rows_] = axis @ (x[i, 1] - over[1])
        elif body.joint.kind == "ball":
            relative = omega[i] - spin
            rates[rows_] = bodies.rotation[i].T @ (x[i, 1] - over[1] - np.cross(omega[i], relative))
        else:
            s, speed = bodies.q[scene.coordinate_slices[i]][0], u[rows_][0]
            arm, back = bodies.arms(i)
            apart = _at(x[i], omega[i], back) - _at(over, spin, arm + axis * s)
            rates[rows_] = axis @ (apart - 2 * np.cross(spin, axis) * speed)
    turned = [
        (r.T @ x[i, 2], r.T @ x[i, 3]) if scene.bodies[i].joint.kind != "free" else (still, still)
        for i, r in enumerate(bodies.rotation)
    ]
    return rates, np.array([f for f, _ in turned]), np.array([m for _, m in turned])


def _solved(rows: list[dict[int, Any]], unknowns: int) -> list[Any]:
    """Solve sparse equations, with their right sides at `unknowns`, by elimination from the last column."""
    pivots = []
    for column in reversed(range(unknowns)):
        pivot = max((row for row in rows if column in row), key=lambda row: abs(row[column]))
        rows = [row for row in rows if row is not pivot]
        for row in rows:
            if factor := row.pop(column, 0) / pivot[column]:
                for place, entry in pivot.items():
                    if place != column:
                        row[place] = row.get(place, mpf(0)) - factor * entry
        pivots.append(pivot)
    x: list[Any] = []
    for column, pivot in enumerate(reversed(pivots)):
        known = sum(entry * x[place] for place, entry in pivot.items() if place < column)
        x.append((pivot[unknowns] - known) / pivot[column])
    return x


def _hat(v: Vector) -> Vector:
    x, y, z = v
    zero = mpf(0)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]], dtype=object)


def _at(accelerations: Vector, omega: Vector, arm: Vector) -> Vector:
    """Return the acceleration of a point of a body with accelerations a, alpha."""
    return accelerations[0] + np.cross(accelerations[1], arm) + np.cross(omega, np.cross(omega, arm))


def _joint_equations(
    scene: TreeScene, bodies: _Bodies, i: int, u: Vector, omega: list[Vector], applied: Vector, equations: Any
) -> None:
    """State which relative accelerations a joint forbids, and its given forces in the others."""
    body, rows = scene.bodies[i], scene.rate_slices[i]
    a, alpha, force, moment = (12 * i + 3 * part for part in range(4))
    parent, axis = body.joint.parent, bodies.axis[i]
    eye = np.eye(3, dtype=int).astype(object)
    zero = _exact(np.zeros(3))
    spin = omega[parent] if parent >= 0 else zero
    across = _two_across(axis)
    if body.joint.kind == "free":
        equations([(force, eye)], zero, eye)
        equations([(moment, eye)], zero, eye)
        return
    arm, back = bodies.arms(i)
    s = bodies.q[scene.coordinate_slices[i]][0] if body.joint.kind == "slide" else mpf(0)
    speed = u[rows][0] if body.joint.kind == "slide" else mpf(0)
    reach = arm + axis * s
    points = [(a, eye), (alpha, -_hat(back))]
    turns = [(alpha, eye)]
    if parent >= 0:
        points += [(12 * parent, -eye), (12 * parent + 3, _hat(reach))]
        turns.append((12 * parent + 3, -eye))
    moving = 2 * np.cross(spin, axis) * speed
    apart = np.cross(spin, np.cross(spin, reach)) - np.cross(omega[i], np.cross(omega[i], back)) + moving
    # angular acceleration relative to the parent, by the turning of the relative velocity with it
    relative = np.cross(spin, omega[i] - spin)
    if body.joint.kind == "slide":
        equations(points, apart, across)
        equations([(force, eye)], axis * applied[rows][0], [axis])
        equations(turns, zero, eye)
        return
    equations(points, apart, eye)
    if body.joint.kind == "hinge":
        equations(turns, relative, across)
        equations([(moment, eye)], axis * applied[rows][0], [axis])
    else:
        equations([(moment, bodies.rotation[i].T)], applied[rows], eye)


def _two_across(axis: Vector) -> list[Vector]:
    """Two vectors that are perpendicular to an axis."""
    other = _exact(np.eye(3)[int(np.argmin([abs(x) for x in axis]))])
    first = _unit(np.cross(axis, other))
    return [first, np.cross(axis, first)]
