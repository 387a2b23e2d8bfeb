"""Trees in Newton: eval_mass_matrix and eval_fk of a model with one articulation, in float32.

Quaternions are scalar last; the rates of a free joint are the velocity and omega, both in world axes. Its
solvers have no bias, accelerations or wrenches to read without a step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.optional.between_steps import array, scalar_first, scalar_last
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
        self._bodies, joints = [0] * len(self._links), [0] * len(self._links)
        for k in depth_first(self._links):
            link = self._links[k]
            self._bodies[k] = builder.add_link(
                mass=link.mass, com=link.centre, inertia=link.inertia.tolist(), lock_inertia=True
            )
            joints[k] = self._add_joint(builder, link, self._bodies[k])
        builder.add_articulation([joints[k] for k in depth_first(self._links)])
        self._model = builder.finalize()
        self._state = self._model.state()
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


_STARTS = ("joint_qd_start", "joint_q_start")
