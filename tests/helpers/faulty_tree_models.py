"""Trees in MuJoCo with one mistake that an engine, or the author of an adapter, may make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.adapters.mujoco.tree import MuJoCoTree
from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.tree_contract import depth_first, jointed_links
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeScene


@dataclass(frozen=True)
class PlantedTreeFault:
    """A mistake: its kind, the tree model that has it, and the fault and the parameters to be named."""

    name: str
    kind: str
    model: type[MuJoCoTree]
    expected: str
    parameters: Mapping[str, float] = field(default_factory=dict)


class FaultyTrees(MuJoCo):
    """MuJoCo with another tree model."""

    tree_model = MuJoCoTree

    def __init__(self, fault: PlantedTreeFault) -> None:
        self.name, self.tree_model = f"faulty-{fault.name}", fault.model


def _built(change: Callable[[TreeScene], TreeScene]) -> type[MuJoCoTree]:
    """Return a model that builds another tree."""

    class Built(MuJoCoTree):
        def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
            super().__init__(change(scene), masses_were)

    return Built


def _joints(change: Callable[[Joint, TreeScene], Joint]) -> type[MuJoCoTree]:
    """Return a model that builds other joints."""

    def changed(scene: TreeScene) -> TreeScene:
        bodies = (replace(body, joint=change(body.joint, scene)) for body in scene.bodies)
        return replace(scene, bodies=tuple(bodies))

    return _built(changed)


def _rotation(quaternion: Array) -> Array:
    return quaternion_to_matrix(quaternion / np.linalg.norm(quaternion))


class _Scene(MuJoCoTree):
    """A model that keeps the scene and the states that were set."""

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        super().__init__(scene, masses_were)
        self.scene, self.masses_were = scene, masses_were
        self.states: list[tuple[Array, Array]] = []

    def set_state(self, q: Array, u: Array) -> None:
        if not self.states or not np.array_equal(self.states[-1][0], q):
            self.states.append((q, u))
        super().set_state(q, u)


def _base_first(turn: Callable[[Array, Array], tuple[Array, Array]], *, taken: bool) -> type[MuJoCoTree]:
    """Return a model whose base has the rates T u: turn(R, u) -> T (6, 6), (dT/dt) u (6,)."""

    class InRates(_Scene):
        def set_state(self, q: Array, u: Array) -> None:
            self.T, self.drift = np.eye(len(u)), np.zeros(len(u))
            if self.scene.bodies[0].joint.kind == "free":
                self.T[:6, :6], self.drift[:6] = turn(_rotation(q[3:7]), u[:6])
            super().set_state(q, np.linalg.solve(self.T, u) if taken else u)

        def mass_matrix(self) -> Array:
            inverse = np.linalg.inv(self.T)
            return inverse.T @ super().mass_matrix() @ inverse

        def bias(self) -> Array:
            inverse = np.linalg.inv(self.T)
            return inverse.T @ (super().bias() - super().mass_matrix() @ inverse @ self.drift)

        def accelerations(self) -> Array:
            return self.T @ super().accelerations() + self.drift

    return InRates


def _body_axes(R: Array, u: Array) -> tuple[Array, Array]:
    T, drift = np.eye(6), np.zeros(6)
    T[:3, :3], drift[:3] = R.T, -np.cross(u[3:], R.T @ u[:3])
    return T, drift


def _omega_world(R: Array, _u: Array) -> tuple[Array, Array]:
    T = np.eye(6)
    T[3:, 3:] = R
    return T, np.zeros(6)


def _omega_first(_R: Array, _u: Array) -> tuple[Array, Array]:
    return np.roll(np.eye(6), 3, axis=0), np.zeros(6)


def _omega_first_world(R: Array, _u: Array) -> tuple[Array, Array]:
    return np.roll(_omega_world(R, _u)[0], 3, axis=0), np.zeros(6)


class _WorldWrench(MuJoCoTree):
    def wrenches(self) -> Array:
        found = super().wrenches()
        for row, pose in zip(found, self.poses(), strict=True):
            row[:3], row[3:] = _rotation(pose[3:]) @ row[:3], _rotation(pose[3:]) @ row[3:]
        return found


class _CentralMomentum(MuJoCoTree):
    def momenta(self) -> Array:
        velocity, about_centre, _ = self._field("sensordata")[:9].reshape(3, 3)
        return np.concatenate([self._total_mass * velocity, about_centre])


def _gyroscopic(times: float, of: Callable[[int], range]) -> type[MuJoCoTree]:
    """Return a model with omega x I omega of some bodies so many times in the bias."""

    class Gyroscopic(_Scene):
        def bias(self) -> Array:
            more = np.zeros(self.model.nv)
            for k in of(len(self._bodies)):
                jacobian = np.zeros((3, self.model.nv))
                mujoco.mj_jacBodyCom(self.model, self.data, None, jacobian, self._bodies[k])
                R, inertia = _rotation(self.poses()[k][3:]), self.scene.bodies[k].inertia
                omega = R.T @ jacobian @ self.data.qvel
                more += (times - 1.0) * jacobian.T @ R @ np.cross(omega, inertia @ omega)
            return super().bias() + self._map.bias(more)

    return Gyroscopic


class _NoCoriolis(MuJoCoTree):
    def bias(self) -> Array:
        return self.gravity_bias()

    def accelerations(self) -> Array:
        return -np.linalg.solve(self.mass_matrix(), self.bias())


class _HalfCoriolis(MuJoCoTree):
    def bias(self) -> Array:
        return 0.5 * (super().bias() + self.gravity_bias())


class _StaleModel(MuJoCoTree):
    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        bodies = (
            replace(b, mass=masses_were * b.mass, inertia=masses_were * b.inertia) for b in scene.bodies
        )
        super().__init__(replace(scene, bodies=tuple(bodies)))


class _StaleMatrix(_Scene):
    def mass_matrix(self) -> Array:
        return self.masses_were * super().mass_matrix()


def _late(reading: str) -> type[MuJoCoTree]:
    """Return a model one of whose readings is that of the state that was set before."""

    class Late(_Scene):
        def _late(self) -> Array:
            now, before = self.states[-1], self.states[max(0, len(self.states) - 2)]
            super().set_state(*before)
            found = getattr(MuJoCoTree, reading)(self)
            MuJoCoTree.set_state(self, *now)
            return found

    setattr(Late, reading, Late._late)
    return Late


def _taken(change: Callable[[Array, Array, str], tuple[Array, Array]]) -> type[MuJoCoTree]:
    """Return a model that takes other coordinates and rates of each joint: change(q, u, kind)."""

    class Taken(_Scene):
        def set_state(self, q: Array, u: Array) -> None:
            q, u = q.copy(), u.copy()
            scene = self.scene
            for body, at, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
                q[at], u[rates] = change(q[at], u[rates], body.joint.kind)
            super().set_state(q, u)

    return Taken


def _conjugate_ball(q: Array, u: Array, kind: str) -> tuple[Array, Array]:
    return (conjugate(q), u) if kind == "ball" else (q, u)


def _ball_in_zero(q: Array, u: Array, kind: str) -> tuple[Array, Array]:
    return (q, _rotation(q).T @ u) if kind == "ball" else (q, u)


def _hinge_degrees(q: Array, u: Array, kind: str) -> tuple[Array, Array]:
    return (np.deg2rad(q), u) if kind == "hinge" else (q, u)


def _from_parents_joint(joint: Joint, scene: TreeScene) -> Joint:
    if joint.kind == "free" or joint.parent < 0 or scene.bodies[joint.parent].joint.kind == "free":
        return joint
    return replace(joint, at_parent=joint.at_parent + scene.bodies[joint.parent].joint.at_body)


def _shifted(joint: Joint, scene: TreeScene) -> Joint:
    if joint is not scene.bodies[-1].joint or joint.kind == "free":
        return joint
    return replace(joint, at_parent=joint.at_parent + np.array([0.1, -0.05, 0.02]))


def _axis_in_parent(joint: Joint, _scene: TreeScene) -> Joint:
    return replace(joint, axis=_rotation(joint.zero).T @ joint.axis)


def _axis_opposite(joint: Joint, _scene: TreeScene) -> Joint:
    return replace(joint, axis=-joint.axis)


def _unordered(order: Callable[[TreeScene], list[int]], readings: tuple[str, ...]) -> type[MuJoCoTree]:
    """Return a model that reports rates in another order of bodies."""

    class Unordered(_Scene):
        def _rows(self) -> list[int]:
            parts = self.scene.rate_slices
            return [row for k in order(self.scene) for row in range(parts[k].start, parts[k].stop)]

        def mass_matrix(self) -> Array:
            found = super().mass_matrix()
            return found[np.ix_(self._rows(), self._rows())] if "mass_matrix" in readings else found

        def bias(self) -> Array:
            return super().bias()[self._rows()] if "bias" in readings else super().bias()

        def gravity_bias(self) -> Array:
            return (
                super().gravity_bias()[self._rows()] if "gravity_bias" in readings else super().gravity_bias()
            )

        def accelerations(self) -> Array:
            found = super().accelerations()
            return found[self._rows()] if "accelerations" in readings else found

    return Unordered


def _last(bodies: int) -> range:
    return range(bodies - 1, bodies)


def _depth_first(scene: TreeScene) -> list[int]:
    return depth_first(jointed_links(scene))


def _reversed(scene: TreeScene) -> list[int]:
    return [*reversed(range(len(scene.bodies)))]


class _Armature(_Scene):
    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        super().__init__(scene, masses_were)
        for body, joint in zip(scene.bodies, self._bodies, strict=True):
            if body.joint.kind != "free":
                start, count = int(self.model.body_dofadr[joint]), int(self.model.body_dofnum[joint])
                self.model.dof_armature[start : start + count] = 0.05
        mujoco.mj_setConst(self.model, self.data)


_ROWS: tuple[tuple[str, str, type[MuJoCoTree], str, dict[str, float]], ...] = (
    ("base-in-body-axes", "frames", _base_first(_body_axes, taken=False), "base-axes", {}),
    ("omega-in-world-axes", "frames", _base_first(_omega_world, taken=True), "base-axes", {}),
    ("wrench-in-world-axes", "frames", _WorldWrench, "wrench-frame", {}),
    ("momentum-about-centre", "frames", _CentralMomentum, "momenta-frame", {}),
    ("omega-first", "base order", _base_first(_omega_first, taken=False), "base-order", {}),
    ("omega-first-world", "base order", _base_first(_omega_first_world, taken=True), "base-order", {}),
    ("gyroscopic-twice", "gyroscopic", _gyroscopic(2.0, range), "gyroscopic-term", {"factor": 2.0}),
    ("gyroscopic-missing", "gyroscopic", _gyroscopic(0.0, _last), "gyroscopic-term", {"factor": 0.0}),
    ("no-coriolis", "coriolis", _NoCoriolis, "missing-coriolis", {"factor": 0.0}),
    ("half-coriolis", "coriolis", _HalfCoriolis, "missing-coriolis", {"factor": 0.5}),
    ("stale-masses", "stale mass", _StaleModel, "stale-mass", {"factor": 2.0}),
    ("stale-matrix", "stale mass", _StaleMatrix, "stale-mass", {"factor": 2.0}),
    ("late-matrix", "late", _late("mass_matrix"), "stale-state", {}),
    ("late-wrench", "late", _late("wrenches"), "stale-state", {}),
    ("ball-conjugate", "ball", _taken(_conjugate_ball), "ball-conjugate", {}),
    ("ball-rate-in-zero-frame", "ball", _taken(_ball_in_zero), "ball-axes", {}),
    ("offset-from-joint", "parent offset", _joints(_from_parents_joint), "parent-offset", {}),
    (
        "offset-shifted",
        "parent offset",
        _joints(_shifted),
        "parent-offset",
        {"x": 0.1, "y": -0.05, "z": 0.02},
    ),
    ("axis-in-parent", "axis", _joints(_axis_in_parent), "axis-in-parent", {}),
    ("axis-opposite", "axis", _joints(_axis_opposite), "axis-opposite", {}),
    ("order-depth-first", "joint order", _unordered(_depth_first, ("mass_matrix",)), "joint-order", {}),
    ("order-reversed", "joint order", _unordered(_reversed, READINGS), "joint-order", {}),
    ("degrees", "units", _taken(_hinge_degrees), "degrees", {}),
    ("armature", "armature", _Armature, "armature", {"armature": 0.05}),
)
PLANTED = tuple(PlantedTreeFault(*row) for row in _ROWS)
"""Mistakes of all kinds."""
