"""The contract for trees: what an engine reports of the equations of a tree, and how it moves one.

An adapter that builds trees has the attribute `tree_model`: a subclass of `TreeModel`, or its MODULE:CLASS,
which is imported when it is needed. The model takes and returns everything in the conventions of
`reference_impl.trees`: bodies in the order of the scene, u with the velocity of a free body in world axes and
its omega in body axes, rates of a ball in the child's axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Adapter, Precision, Stepping, TreeReadBack
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rotations import matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    JointSineTorque,
    JointTorque,
    TreeLoad,
    TreeScene,
)
from bodycheck.reference_impl.wrench import Wrench


class UnreportedError(Exception):
    """The engine or its adapter does not report a quantity, or cannot build a tree; the text says why."""


class TreeModel:
    """One tree in one engine: override what the engine reports; the rest is `unsupported`.

    Each reading is that of the engine's present state. After `set_state` it holds for this state: the adapter
    calls what the engine needs for that. After `step` it is what the engine returns without further calls.
    A quantity that the engine only reports after a step takes one of at most 1e-7 s, which is then undone.
    """

    precision: Precision = "float64"
    native: ClassVar[Mapping[str, str]] = {}
    """Reading -> the engine's own call, axes and order, for people to read."""
    resolution: ClassVar[Mapping[str, float]] = {}
    """Reading -> its relative accuracy, where the engine gives it only approximately."""
    known_faults: ClassVar[Mapping[str, str]] = {}
    """Reading -> a fault of the engine itself, for which `check-adapter` does not blame the adapter."""

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:  # noqa: ARG002
        """Build the tree; raise UnreportedError if the engine cannot represent it.

        masses_were: build all masses and inertias this many times as large, and change them to those of the
        scene afterwards, as a program does that changes a load while it runs.
        """
        raise UnreportedError("the adapter builds no trees")

    def set_state(self, q: Array, u: Array) -> None:
        """Set coordinates (nq,) and rates (nu,)."""
        raise NotImplementedError

    def mass_matrix(self) -> Array:
        """Return M (nu, nu)."""
        raise UnreportedError(_NOT_READ)

    def bias(self) -> Array:
        """Return c (nu,) of M u' + c = tau, gravity included."""
        raise UnreportedError(_NOT_READ)

    def gravity_bias(self) -> Array:
        """Return the part of the bias (nu,) that gravity causes."""
        raise UnreportedError(_NOT_READ)

    def accelerations(self) -> Array:
        """Return u' (nu,) without joint forces."""
        raise UnreportedError(_NOT_READ)

    def wrenches(self) -> Array:
        """Return force and moment (n, 6) of each joint on its child, without joint forces.

        The moment is about the joint's point, both in the child's axes; zero for a free body.
        """
        raise UnreportedError(_NOT_READ)

    def energy(self) -> Array:
        """Return kinetic and potential energy (2,) in J, the potential zero at the world's origin."""
        raise UnreportedError(_NOT_READ)

    def momenta(self) -> Array:
        """Return momentum and angular momentum about the world's origin (6,), in world axes."""
        raise UnreportedError(_NOT_READ)

    def poses(self) -> Array:
        """Return position of the centre of mass and quaternion, body to world, of each body (n, 7)."""
        raise UnreportedError(_NOT_READ)

    def step(self, dt_s: float) -> tuple[Array, Array]:  # noqa: ARG002
        """Make one step by the engine's default method; return q (nq,) and u (nu,) after it."""
        raise UnreportedError("the engine has no step of its own")

    # ------------------------------------------------------------------------------------------- motion

    stepping: Stepping = "python"

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Return why a method cannot move a tree under its loads; None if it can."""
        return "the adapter reports of trees, but moves none"

    def start(self, method: str, dt_s: float) -> None:
        """Choose a method and its step, give the joints their springs and dampers, and set the start."""
        raise NotImplementedError

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Replace the acting loads, each with its share, until the next call; sines follow the time."""
        if loads:
            raise NotImplementedError

    def advance(self, steps: int) -> None:
        """Make this many steps."""
        raise NotImplementedError

    def state(self) -> tuple[Array, Array]:
        """Return q (nq,) and u (nu,) as the engine stores them."""
        raise NotImplementedError

    def held(self) -> TreeReadBack:
        """Return the model and the state as read from the engine, not from the scene."""
        raise NotImplementedError


class TreeSimulation:
    """The motion of a tree: the interface of `Simulation`, with states that are (q, u)."""

    def __init__(self, model: type[TreeModel], scene: TreeScene, method: str, dt_s: float) -> None:
        self._scene, self._method, self._dt_s = scene, method, dt_s
        self._model = model(scene)
        self.reset()

    @property
    def stepping(self) -> Stepping:
        """As for `Simulation`."""
        return self._model.stepping

    def read_back(self) -> TreeReadBack:
        """Return the model as read from the engine."""
        return self._model.held()

    def reset(self) -> None:
        """Restore the start."""
        self._model.start(self._method, self._dt_s)
        self._model.push(())

    def apply(self, wrench: Wrench) -> None:
        """Replace the acting loads."""
        self._model.push(wrench.of_tree)

    def advance(self, steps: int) -> None:
        """Make this many steps."""
        self._model.advance(steps)

    def read(self) -> tuple[Array, Array]:
        """Return copies of q and u."""
        return self._model.state()

    def close(self) -> None:
        """Do nothing: models are freed with this object."""


def moved_tree(scene: TreeScene, t_s: Array, states: Sequence[tuple[Array, Array]]) -> Trajectory:
    """Return the trajectory of the states (q, u) at the times t_s (n,)."""
    q, u = (np.array([state[part] for state in states], dtype=np.float64) for part in (0, 1))
    return tree_trajectory(scene, t_s, q, u)


_SLACK: Mapping[Precision, float] = {"float64": 1e-11, "float32": 8e-6, "mixed": 8e-6}
"""Relative to the largest number: attitudes may go through rotation vectors, inertias through axes."""
_PASSIVE = ("damping", "armature", "stiffness", "rest")


def tree_mismatch(
    scene: TreeScene, method: str, dt_s: float | None, found: TreeReadBack, precision: Precision
) -> str | None:
    """Return how a tree that was read back differs from the scene; None if it does not.

    Quaternions may have either sign. With an engine's defaults, joints may have damping.
    """
    links, joints = jointed_links(scene), [body.joint for body in scene.bodies]
    expected: dict[str, Array] = {
        name: np.array([getattr(link, name) for link in links])
        for name in ("mass", "inertia", "centre", "place", "zero", "axis")
    }
    expected |= {name: np.array([getattr(joint, name) for joint in joints]) for name in _PASSIVE}
    expected |= {"gravity": scene.gravity, "q": scene.q0, "u": scene.u0}
    springs, axes = expected["stiffness"] > 0.0, np.array([joint.of_kind.has_axis for joint in joints])
    faults = []
    if dt_s is not None and not (
        found.dt_s is not None and abs(found.dt_s - dt_s) <= _SLACK[precision] * dt_s
    ):
        faults.append(f"step is {found.dt_s} in the engine, not {dt_s!r}")
    for name, stored in found.numbers.items():
        right, held = expected[name], np.asarray(stored, dtype=np.float64)
        if name in _PASSIVE and method.endswith(DEFAULTS):
            continue
        if held.shape != right.shape:
            faults.append(f"{name} has the shape {held.shape} in the engine, not {right.shape}")
            continue
        difference = np.abs(held - right)
        if name == "zero":
            difference = np.minimum(difference, np.abs(held + right).max(axis=1, keepdims=True))
        if name == "q":
            _forget_signs(scene, held, right, difference)
        if name in ("axis", "rest"):
            difference = difference[axes if name == "axis" else springs]
        if np.any(
            ~(
                difference
                <= _SLACK[precision] * max(1.0 if name in ("zero", "q") else 0.0, np.max(np.abs(right)))
            )
        ):
            worst = np.unravel_index(int(np.argmax(np.abs(held - right))), right.shape)
            body = scene.bodies[worst[0]].name if len(right) == len(links) and name not in "qu" else ""
            faults.append(
                f"{name}{f' of {body}' * bool(body)} is {held[worst]} in the engine, not {right[worst]}"
            )
    return "; ".join(faults) or None


def _forget_signs(scene: TreeScene, held: Array, right: Array, difference: Array) -> None:
    for body, part in zip(scene.bodies, scene.coordinate_slices, strict=True):
        if body.joint.of_kind.rotation is Rotation.BALL:
            own = slice(part.stop - 4, part.stop)
            if held[own] @ right[own] < 0.0:
                difference[own] = np.abs(held[own] + right[own])


_NOT_READ = "the adapter does not read it"


def tree_model_of(adapter: Adapter) -> type[TreeModel] | None:
    """Return what builds trees with an engine; None if its adapter does not."""
    stated: type[TreeModel] | str | None = getattr(adapter, "tree_model", None)
    if not isinstance(stated, str):
        return stated
    module, _, name = stated.partition(":")
    found: type[TreeModel] = getattr(import_module(module), name)
    return found


# ------------------------------------------------------------------------------------- what adapters share


@dataclass(frozen=True, eq=False)
class JointedLink:
    """A body as engines build it: its link frame lies at its joint's point, along the body axes.

    A free body's link frame is at its centre of mass. centre (3,): of mass, in the link frame. place (3,),
    zero (4,): the link frame in that of the parent at coordinate 0. axis (3,): unit, in link axes.
    """

    name: str
    kind: str
    parent: int
    mass: float
    inertia: Array
    centre: Array
    place: Array
    zero: Array
    axis: Array


def jointed_links(scene: TreeScene, factor: float = 1.0) -> tuple[JointedLink, ...]:
    """Return the bodies of a tree in its order, with all masses and inertias multiplied by a factor."""
    found: list[JointedLink] = []
    for body in scene.bodies:
        joint = body.joint
        free = joint.kind == "free"
        before = -1 if free else joint.parent
        found.append(
            JointedLink(
                body.name,
                joint.kind,
                before,
                factor * body.mass,
                factor * body.inertia,
                np.zeros(3) if free else -joint.at_body,
                np.zeros(3) if free else joint.at_parent + (found[before].centre if before >= 0 else 0.0),
                np.array([1.0, 0.0, 0.0, 0.0]) if free else joint.zero / np.linalg.norm(joint.zero),
                joint.axis / (np.linalg.norm(joint.axis) or 1.0),
            )
        )
    return tuple(found)


def depth_first(links: Sequence[JointedLink]) -> list[int]:
    """Return the order in which most engines number the bodies of a tree."""

    def below(parent: int) -> list[int]:
        children = (k for k, link in enumerate(links) if link.parent == parent)
        return [k for child in children for k in (child, *below(child))]

    return below(-1)


def link_poses(links: Sequence[JointedLink], places: Sequence[Array], rotations: Sequence[Array]) -> Array:
    """Return the poses (n, 7) of bodies whose link frames have these places (3,) and rotations (3, 3)."""
    rows = zip(links, places, rotations, strict=True)
    return np.array([np.concatenate([x + R @ one.centre, matrix_to_quaternion(R)]) for one, x, R in rows])


def link_momenta(
    links: Sequence[JointedLink], rotations: Sequence[Array], places: Array, velocities: Array, omegas: Array
) -> Array:
    """Return P and L (6,) about the origin of bodies (n, 3) by their centres of mass, all in world axes."""
    momenta = np.array([link.mass for link in links])[:, None] * velocities
    spins = [R @ link.inertia @ R.T @ w for link, R, w in zip(links, rotations, omegas, strict=True)]
    return np.concatenate([momenta.sum(axis=0), (np.cross(places, momenta) + spins).sum(axis=0)])


def frame_about(axis: Array) -> Array:
    """Return a rotation (3, 3) whose first column is a unit axis (3,), for joints that turn about their x."""
    second = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    second /= np.linalg.norm(second)
    return np.column_stack([axis, second, np.cross(axis, second)])


@dataclass(frozen=True, eq=False)
class HeldLoads:
    """The loads on a tree at one instant, for engines that accept them between steps only.

    joint: of each body, at the rates of its joint. force, torque (b, 3): on each body at its centre of mass,
    in world axes.
    """

    joint: list[Array]
    force: Array
    torque: Array


def held_loads(scene: TreeScene, loads: Sequence[tuple[TreeLoad, float]], t_s: float, q: Array) -> HeldLoads:
    """Return the sum of loads, each with its share, at a time and at coordinates q (nq,)."""
    joint = [np.zeros(part.stop - part.start) for part in scene.rate_slices]
    force, torque = np.zeros((2, len(scene.bodies), 3))
    on_bodies = any(isinstance(load, BodyLoad) for load, _ in loads)
    turned = tree_trajectory(scene, np.zeros(1), q[None], scene.u0[None]).quaternion if on_bodies else None
    for load, share in loads:
        if isinstance(load, JointSineTorque):
            joint[load.body] += load.amplitude * math.sin(load.rate * t_s + load.phase)
        elif isinstance(load, JointTorque):
            joint[load.body] += share * load.value
        else:
            assert turned is not None
            rotation, one = quaternion_to_matrix(turned[0, load.body]), load.load
            value = share * (rotation @ one.value if one.axes == "body" else one.value)
            if isinstance(one, Torque):
                torque[load.body] += value
            else:
                force[load.body] += value
                torque[load.body] += np.cross(rotation @ one.at, value)
    return HeldLoads(joint, force, torque)


def joint_forces(
    scene: TreeScene, loads: Sequence[tuple[TreeLoad, float]], t_s: float, q: Array, u: Array
) -> Array:
    """Return J^T F of the loads, and the forces of springs and dampers, at the rates (nu,)."""
    held, n = held_loads(scene, loads, t_s, q), len(u)
    forces = np.concatenate(held.joint)
    if np.any(held.force) or np.any(held.torque):
        each = tree_trajectory(scene, np.zeros(n), np.tile(q, (n, 1)), np.eye(n))
        forces = forces + np.einsum("nbi,bi->n", each.velocity_m_s, held.force)
        forces = forces + np.einsum("nbi,bi->n", each.omega_world, held.torque)
    for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        joint = body.joint
        if joint.damping:
            forces[rates] -= joint.damping * u[rates]
        if joint.stiffness:
            forces[rates] -= joint.stiffness * (q[places] - joint.rest)
    return np.asarray(forces)


class RateMap:
    """Rates of an engine in its own order and axes: u_e = T u with an invertible T.

    starts: the index of each body's first rate in the engine's vector.
    """

    def __init__(self, scene: TreeScene, starts: Sequence[int]) -> None:
        self._slices, self._starts = scene.rate_slices, starts
        self._kinds = [body.joint.kind for body in scene.bodies]
        self.matrix, self.inverse = np.zeros((2, *(self._slices[-1].stop,) * 2))
        self.drift = np.zeros(self._slices[-1].stop)
        for k, part in enumerate(self._slices):
            self.turn(k, np.eye(part.stop - part.start))

    def turn(self, body: int, block: Array, drift: Array | float = 0.0, inverse: Array | None = None) -> None:
        """Set the block of T of a body, and (dT/dt) u of its rates in the engine's order.

        inverse: of a block that is not orthogonal.
        """
        part, start = self._slices[body], self._starts[body]
        rows = slice(start, start + len(block))
        self.matrix[rows, part], self.drift[rows] = block, drift
        self.inverse[part, rows] = block.T if inverse is None else inverse

    def rates(self, u: Array) -> Array:
        """T u."""
        return np.asarray(self.matrix @ u)

    def own_rates(self, rates: Array) -> Array:
        """T^-1 u_e."""
        return np.asarray(self.inverse @ rates)

    def mass_matrix(self, mass_matrix: Array) -> Array:
        """T^T M_e T."""
        return np.asarray(self.matrix.T @ mass_matrix @ self.matrix)

    def bias(self, bias: Array, mass_matrix: Array | None = None) -> Array:
        """T^T (c_e + M_e (dT/dt) u); the matrix is only needed where T changes."""
        return np.asarray((bias if mass_matrix is None else bias + mass_matrix @ self.drift) @ self.matrix)

    def accelerations(self, accelerations: Array) -> Array:
        """T^-1 (u_e' - (dT/dt) u)."""
        return self.own_rates(accelerations - self.drift)


def swapped_in_world(quaternion: Array) -> Array:
    """T (6, 6) of a free body whose engine has omega, then the velocity, both in world axes."""
    block = np.zeros((6, 6))
    block[:3, 3:], block[3:, :3] = quaternion_to_matrix(quaternion), np.eye(3)
    return block
