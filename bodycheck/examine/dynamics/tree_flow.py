"""The one-step maps of trees for many hypotheses and transitions at once, in numpy.

Formulas: `reference_impl/one_step_maps/tree_maps.py`, whose kernel compiles nothing per tree but needs a
recording of each, so it is slow where every hypothesis is another tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bodycheck.examine.dynamics.batch_dynamics import StackedTrees
from bodycheck.reference_impl.arrays import Array, solved
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.one_step_maps.lie_group import inverse_dexp
from bodycheck.reference_impl.rotations import (
    exp_quaternion,
    normalised,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    JointSineTorque,
    JointTorque,
    TreeScene,
    interval,
)
from bodycheck.reference_impl.wrench import share_of


@dataclass
class TreeHypothesis:
    """A tree as an engine moves it, with the terms that a fault may change.

    velocity_terms, gyroscopic: how many times all velocity terms, and omega x I omega of each body, count.
    friction: of each body's joint, N m or N. base_point (3,): of a free body, whose velocity is stepped.
    loads: how many times they count; late_steps: by how many steps they are late; step: of how many steps.
    """

    scene: TreeScene
    velocity_terms: float = 1.0
    gyroscopic: dict[int, float] = field(default_factory=dict)
    friction: dict[int, float] = field(default_factory=dict)
    base_point: Array = field(default_factory=lambda: np.zeros(3))
    loads: float = 1.0
    late_steps: float = 0.0
    step: float = 1.0


class TreeFlow:
    """Rows (n,) of models that step by one map from states of their own.

    models: one per row; begin_s (n,): when each starts. States are q (n, nq) and u (n, nu).
    """

    def __init__(self, models: Sequence[TreeHypothesis], name: str, begin_s: Array, dt_s: float) -> None:
        self._models, self._name, self._t, self._own = models, name, np.array(begin_s), dt_s
        self._h = dt_s * np.array([model.step for model in models])
        self._trees = StackedTrees([model.scene for model in models])
        self._scene = models[0].scene
        self._velocity = np.array([model.velocity_terms for model in models])[:, None]
        self._friction = np.zeros((len(models), len(self._scene.u0)))
        self._gyroscopic = np.ones((len(self._scene.bodies), len(models)))
        for row, model in enumerate(models):
            for body, force in model.friction.items():
                self._friction[row, self._scene.rate_slices[body]] = force
            for body, share in model.gyroscopic.items():
                self._gyroscopic[body, row] = share
        self._point = np.array([model.base_point for model in models])
        self._loads = np.array([model.loads for model in models])
        self._late = dt_s * np.array([model.late_steps for model in models])

    def advance(self, q: Array, u: Array, steps: int) -> tuple[Array, Array]:
        """Return the states after so many steps."""
        for _ in range(steps):
            q, u = self._runge_kutta(q, u) if self._name == "RK4" else self._euler(q, u)
            self._t = self._t + self._own
        return q, u

    def _euler(self, q: Array, u: Array) -> tuple[Array, Array]:
        h = self._h[:, None]
        faster = self._rates(q, u, 0.0)
        if not self._point.any():
            u = u + h * faster
            return self.moved(q, h * u), u
        rates = slice(0, 6)  # of the free body, which is the first
        arm, after = self._arm(q), u + h * faster
        omega = self._in_world(q, u[:, 3:6])
        at = u[:, :3] + np.cross(omega, arm)
        spun = self._in_world(q, faster[:, 3:6])
        at = at + h * (faster[:, :3] + np.cross(spun, arm) + np.cross(omega, np.cross(omega, arm)))
        moved = self.moved(q, h * np.hstack([0.0 * at, after[:, 3:]]))
        turned = self._arm(moved)
        moved[:, :3] = q[:, :3] + arm + h * at - turned
        after[:, rates] = np.hstack(
            [at - np.cross(self._in_world(moved, after[:, 3:6]), turned), after[:, 3:6]]
        )
        return moved, after

    def _in_world(self, q: Array, vectors: Array) -> Array:
        return np.einsum("nij,nj->ni", quaternion_to_matrix(normalised(q[:, 3:7])), vectors)

    def _arm(self, q: Array) -> Array:
        return self._in_world(q, self._point)

    def _runge_kutta(self, q: Array, u: Array) -> tuple[Array, Array]:
        h = self._h[:, None]
        k, faster = np.zeros_like(u), np.zeros_like(u)
        total, gained = np.zeros_like(u), np.zeros_like(u)
        for part, weight in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
            theta, speed = part * h * k, u + part * h * faster
            at = self.moved(q, theta)
            k = self._stage_rates(speed, theta)
            faster = self._rates(at, speed, part)
            total, gained = total + weight * h * k, gained + weight * h * faster
        return self.moved(q, total), u + gained

    def _stage_rates(self, u: Array, theta: Array) -> Array:
        """Return the derivative of theta, with exp(theta) turning at omega, in place of omega in u."""
        found = u.copy()
        for _, own in self._scene.turn_slices:
            found[:, own] = inverse_dexp(theta[:, own], u[:, own], "exact")
        return found

    def moved(self, q: Array, turned: Array) -> Array:
        """Q (+) turned."""
        found, scene = q.copy(), self._scene
        for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
            lengths = rates.stop - rates.start - (3 if body.joint.of_kind.rotation is Rotation.BALL else 0)
            found[:, places.start : places.start + lengths] += turned[:, rates.start : rates.start + lengths]
        for places, rates in scene.turn_slices:
            found[:, places] = quaternion_product(normalised(q[:, places]), exp_quaternion(turned[:, rates]))
        return found

    def _rates(self, q: Array, u: Array, part: float) -> Array:
        """u' at the states, a part of the step after its beginning."""
        h, passive = self._h[:, None], self._trees.passive
        damping, stiffness, rest = passive[..., 0], passive[..., 2], passive[..., 3]
        trees, of_joints = self._pushed(q, part)
        has_pushes = trees is not self._trees or bool((self._gyroscopic != 1.0).any())
        if (self._gyroscopic != 1.0).any():
            trees = self._with_gyroscopic(trees, q, u)
        mass, bias, at_rest, applied = trees.equations(q, u, pushes=has_pushes)
        bias = at_rest + self._velocity * (bias - at_rest)
        applied = applied + of_joints - self._friction * np.sign(u)
        if stiffness.any():
            applied = applied - stiffness * (self._coordinates(q) - rest)
        matrix = mass.copy()
        diagonal = np.einsum("nii->ni", matrix)
        if self._name in ("M1d", "M2s", "M2"):
            diagonal += h * damping
        if self._name == "M2s":
            diagonal += h**2 * stiffness
            applied = applied - h * stiffness * u
        if self._name == "M2":
            matrix += (h * self._velocity)[..., None] * trees.change_with_rates(q, u)
        return solved(matrix, applied - bias)

    def _coordinates(self, q: Array) -> Array:
        """Return the coordinates at the places of the rates; 0 where there is no spring."""
        scene = self._scene
        found = np.zeros((len(q), len(scene.u0)))
        for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
            if body.joint.of_kind.is_scalar:
                found[:, rates] = q[:, places]
        return found

    def _with_gyroscopic(self, trees: StackedTrees, q: Array, u: Array) -> StackedTrees:
        _, omega = trees.motion(q, u)
        torque = np.array([body.torque for body in trees.bodies])
        force = np.array([body.force for body in trees.bodies])
        for k, body in enumerate(trees.bodies):
            w = omega[k]
            gyroscopic = np.cross(w, np.einsum("nij,nj->ni", body.inertia, w))
            torque[k] += (1.0 - self._gyroscopic[k])[:, None] * gyroscopic
        return trees.with_pushes(force, torque)

    def _pushed(self, q: Array, part: float) -> tuple[StackedTrees, Array]:
        """Return the trees under the loads on bodies, and the loads on joints (n, nu).

        Constant loads count by the share of the step within which they act, as engines hold them.
        """
        scene, rows = self._scene, len(q)
        of_joints = np.zeros((rows, len(scene.u0)))
        if not scene.loads:
            return self._trees, of_joints
        force, torque = np.zeros((2, len(scene.bodies), rows, 3))
        on_bodies = [load for load in scene.loads if isinstance(load, BodyLoad)]
        turned, _ = self._trees.motion(q, np.zeros_like(of_joints))
        begin = self._t - self._late
        for load in scene.loads:
            if isinstance(load, JointSineTorque):
                at = begin + part * self._h
                value = load.amplitude * np.sin(load.rate * at + load.phase)
                of_joints[:, scene.rate_slices[load.body]] += (self._loads * value)[:, None]
                continue
            within = np.array([_share(load, start, self._own) for start in begin]) * self._loads
            if isinstance(load, JointTorque):
                of_joints[:, scene.rate_slices[load.body]] += within[:, None] * load.value
                continue
            R, one = turned[load.body], load.load
            in_body = one.value + 0.0 * within[:, None]
            if one.axes == "world":
                in_body = np.einsum("nji,j->ni", R, one.value)
            in_body = within[:, None] * in_body
            if isinstance(one, PointForce):
                force[load.body] += np.einsum("nij,nj->ni", R, in_body)
                torque[load.body] += np.cross(one.at, in_body)
            else:
                torque[load.body] += in_body
        return (self._trees.with_pushes(force, torque) if on_bodies else self._trees), of_joints


def _share(load: BodyLoad | JointTorque, begin_s: float, dt_s: float) -> float:
    """Return the share of a step within which a load acts; none before the motion starts."""
    if begin_s < -0.5 * dt_s:
        return 0.0
    from_s, until_s = interval(load)
    return share_of(from_s, until_s, max(begin_s, 0.0), begin_s + dt_s)
