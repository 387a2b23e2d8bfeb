"""Trees in Newton: a model with one articulation, in float32, and its solvers in joint coordinates.

Quaternions are scalar last; the rates of a free joint are the velocity and omega, both in world axes. The
solvers have no bias, accelerations or wrenches to read without a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.contract import TreeReadBack
from bodycheck.adapters.optional.between_steps import array, scalar_first, scalar_last
from bodycheck.adapters.optional.newton_solvers import SOLVERS, finalized
from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    UnreportedError,
    depth_first,
    jointed_links,
    link_poses,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeScene


class NewtonTree(TreeModel):
    """A model and a state."""

    precision = "float32"
    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "eval_mass_matrix; v, omega, world axes",
        "poses": "eval_fk; of the link",
    }

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        import newton
        import warp

        if masses_were != 1.0:
            raise UnreportedError("the adapter changes no masses of a finalized model")
        self._newton: Any = newton
        self._warp: Any = warp
        self._scene, self._links = scene, jointed_links(scene)
        builder = newton.ModelBuilder()
        self._joints: list[int]
        self._bodies, joints = [0] * len(self._links), [0] * len(self._links)
        for k in depth_first(self._links):
            link = self._links[k]
            self._bodies[k] = builder.add_link(
                mass=link.mass, com=link.centre, inertia=link.inertia.tolist(), lock_inertia=True
            )
            joints[k] = self._add_joint(builder, link, self._bodies[k])
        builder.add_articulation([joints[k] for k in depth_first(self._links)])
        self._joints = joints
        self._model = finalized(builder, scene.gravity)
        self._state, self._next = self._model.state(), self._model.state()
        starts, coordinates = (array(getattr(self._model, name).numpy()) for name in _STARTS)
        self._coordinates = [int(coordinates[joint]) for joint in joints]
        self._map = RateMap(scene, [int(starts[joint]) for joint in joints])

    def _add_joint(self, builder: Any, link: JointedLink, body: int) -> int:
        if link.kind == "free":
            return int(builder.add_joint_free(child=body))
        parent = -1 if link.parent < 0 else self._bodies[link.parent]
        place = self._warp.transform(link.place.tolist(), scalar_last(link.zero).tolist())
        if link.kind == "ball":
            return int(builder.add_joint_ball(parent, body, parent_xform=place))
        add = {"hinge": builder.add_joint_revolute, "slide": builder.add_joint_prismatic}[link.kind]
        return int(add(parent, body, parent_xform=place, axis=link.axis.tolist(), armature=0.0))

    def set_state(self, q: Array, u: Array) -> None:
        """Set joint_q and joint_qd, and call eval_fk."""
        own = np.zeros(self._model.joint_coord_count, dtype=np.float32)
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            values = q[part]
            if link.kind in ("ball", "free"):
                values = np.concatenate([values[:-4], scalar_last(values[-4:])])
            own[self._coordinates[k] : self._coordinates[k] + len(values)] = values
            if link.kind == "free":
                block = np.eye(6)
                block[3:, 3:] = quaternion_to_matrix(q[part][3:])
                self._map.turn(k, block)
            elif link.kind == "ball":
                self._map.turn(k, quaternion_to_matrix(q[part]))
        self._state.joint_q.assign(own)
        self._state.joint_qd.assign(self._map.rates(u).astype(np.float32))
        self._newton.eval_fk(self._model, self._state.joint_q, self._state.joint_qd, self._state)

    def mass_matrix(self) -> Array:
        """eval_mass_matrix, without armatures."""
        found = self._newton.eval_mass_matrix(self._model, self._state, include_armature=False)
        rates = self._model.joint_dof_count
        return self._map.mass_matrix(array(found.numpy())[0, :rates, :rates])

    def poses(self) -> Array:
        """state.body_q."""
        poses = array(self._state.body_q.numpy())[self._bodies]
        rotations = [quaternion_to_matrix(scalar_first(pose[3:])) for pose in poses]
        return link_poses(self._links, [pose[:3] for pose in poses], rotations)

    # --------------------------------------------------------------------------------------------- motion

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:
        """Refuse solvers in maximal coordinates, loads, springs and dampers."""
        if method != "featherstone" and not method.startswith("mujoco-"):
            return "the adapter moves trees by solvers in joint coordinates only"
        joints = [body.joint for body in scene.bodies]
        if scene.loads or any(one.damping or one.stiffness or one.armature for one in joints):
            return "the adapter moves trees without loads, springs and dampers only"
        return None

    def start(self, method: str, dt_s: float) -> None:
        """Make the solver and set the state."""
        solver = SOLVERS[method]
        self._solver = getattr(self._newton.solvers, solver.name)(self._model, **solver.options)
        self._dt_s = dt_s
        self.set_state(self._scene.q0, self._scene.u0)

    def advance(self, steps: int) -> None:
        """Make the steps, each from one state into the other."""
        for _ in range(steps):
            self._solver.step(self._state, self._next, None, None, self._dt_s)
            self._state, self._next = self._next, self._state

    def state(self) -> tuple[Array, Array]:
        """joint_q and joint_qd."""
        held, parts = array(self._state.joint_q.numpy()), []
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            own = held[self._coordinates[k] : self._coordinates[k] + part.stop - part.start]
            if link.kind in ("ball", "free"):
                own = np.concatenate([own[:-4], scalar_first(own[-4:])])
            if link.kind == "free":
                block = np.eye(6)
                block[3:, 3:] = quaternion_to_matrix(own[3:])
                self._map.turn(k, block)
            elif link.kind == "ball":
                self._map.turn(k, quaternion_to_matrix(own))
            parts.append(own)
        return np.concatenate(parts), self._map.own_rates(array(self._state.joint_qd.numpy()))

    def held(self) -> TreeReadBack:
        """Read the finalized model."""
        model, bodies = self._model, self._bodies
        frames = array(model.joint_X_p.numpy())[self._joints]
        q, u = self.state()
        numbers = {
            "mass": array(model.body_mass.numpy())[bodies],
            "inertia": array(model.body_inertia.numpy())[bodies],
            "centre": array(model.body_com.numpy())[bodies],
            "place": frames[:, :3],
            "zero": np.array([scalar_first(frame[3:]) for frame in frames]),
            "gravity": array(model.gravity.numpy()[0]),
            "q": q,
            "u": u,
        }
        return TreeReadBack(self._dt_s, numbers)


_STARTS = ("joint_qd_start", "joint_q_start")
