"""Pinocchio: the loops that users write around its algorithms, aba and integrate, for a free-flyer.

q = (x, y, z, qx, qy, qz, qw) of the body frame, v = (velocity of its origin, omega), both in body axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Stepping
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.adapters.frames import link_frame
from bodycheck.adapters.optional.between_steps import OnRequest, scalar_first, scalar_last
from bodycheck.adapters.optional.pinocchio_loops import PinocchioLoops
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_SEMI_IMPLICIT = Method(
    name="semi-implicit",
    formula="M1; v += h aba(q, v, tau), q = integrate(q, h v), both velocities in body axes",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| to first order of its error",
    source="Pinocchio, aba and integrate",
    snippet="v += {dt_s} * pinocchio.aba(model, data, q, v, tau); "
    "q = pinocchio.integrate(model, q, {dt_s} * v)",
)
_RK4 = Method(
    name="rk4",
    formula="RK4 on the rotation group, stages averaged; q = integrate(q, h sum b_i v_i)",
    order=2,  # it averages tangent vectors as if rotations commuted
    evaluations=4,
    torque="every stage",
    continuous_loads="every stage",
    conserves="|q| to first order of its error",
    source="Pinocchio, aba and integrate; Runge-Kutta without a correction for the group",
    snippet="stages q_i = pinocchio.integrate(model, q, {dt_s} * a_ij * v_j), then their weighted mean",
)


class Pinocchio(OnRequest):
    """Pinocchio (Carpentier et al. 2019)."""

    name = "pinocchio"
    distribution = "pin"
    requires = ("pin>=4.0",)
    modules = ("pinocchio",)
    methods: Mapping[str, Method] = {method.name: method for method in (_SEMI_IMPLICIT, _RK4)}
    tree_model = "bodycheck.adapters.optional.pinocchio_tree:PinocchioTree"

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a model of one free-flyer."""
        return PinocchioSimulation(scene, dt_s, by_stages=method == _RK4.name)


class PinocchioSimulation(PinocchioLoops):
    """A model of one body, and its state (q, v)."""

    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float, *, by_stages: bool) -> None:
        import pinocchio

        self._pin: Any = pinocchio
        self._scene, self._dt_s, self._link = scene, dt_s, link_frame(scene)
        self._step = self._rk4 if by_stages else self._semi_implicit
        self._loads, self._body = StageLoads(scene), scene.body
        self._model = pinocchio.Model()
        place = pinocchio.SE3.Identity()
        joint = self._model.addJoint(0, pinocchio.JointModelFreeFlyer(), place, "free")
        rotation, self._centre = self._link.rotation, self._link.point(np.zeros(3))
        solid = pinocchio.Inertia(scene.body.mass, self._centre, rotation.T @ scene.body.inertia @ rotation)
        self._model.appendBodyToJoint(joint, solid, place)
        self._model.gravity = pinocchio.Motion(scene.gravity, np.zeros(3))
        self._data = self._model.createData()
        self.reset()

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        position, quaternion, velocity = self._link.of_origin(self._scene.initial)
        rotation = quaternion_to_matrix(quaternion)
        self._q = np.concatenate([position, scalar_last(quaternion)])
        self._v = np.concatenate(
            [rotation.T @ velocity, self._link.rotation.T @ self._scene.initial.omega_body]
        )
        self._steps_made = 0
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Replace the constant loads."""
        self._loads.wrench = wrench
        self._is_loaded = not wrench.is_zero or bool(self._scene.continuous_loads)

    def _acceleration(self, t_s: float, q: Array, v: Array) -> Array:
        """Aba(q, v, tau): (6,) in body axes, under the loads at this state."""
        generalised = np.zeros(6)
        if self._is_loaded:
            position, quaternion, velocity, omega = self._state(q, v)
            rotation = quaternion_to_matrix(quaternion)
            force, torque = self._loads.at(t_s, position, rotation, velocity, omega)
            force = force - self._body.mass * self._scene.gravity  # aba has the weight
            in_link = self._link.rotation.T @ (rotation.T @ force)
            moment = self._link.rotation.T @ torque + np.cross(self._centre, in_link)
            generalised = np.concatenate([in_link, moment])
        return np.asarray(self._pin.aba(self._model, self._data, q, v, generalised)).copy()

    def _state(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Return position, quaternion, velocity and omega of the body, in world axes."""
        quaternion = scalar_first(q[3:])
        rotation = quaternion_to_matrix(quaternion)
        omega = rotation @ v[3:]
        return *self._link.of_body(q[:3], quaternion, rotation @ v[:3], omega), omega

    def read(self) -> Reading:
        """Return copies of the state."""
        position, quaternion, velocity, _ = self._state(self._q, self._v)
        return Reading(
            position, velocity, quaternion=quaternion, omega_body=self._link.rotation @ self._v[3:]
        )

    def read_back(self) -> ReadBack:
        """Return the model as read from Pinocchio; the step is this loop's."""
        solid, rotation = self._model.inertias[1], self._link.rotation
        gravity = np.array(self._model.gravity.linear)
        return ReadBack(solid.mass, rotation @ solid.inertia @ rotation.T, self._dt_s, gravity, self.read())

    def close(self) -> None:
        """Do nothing; the model is freed with this object."""
