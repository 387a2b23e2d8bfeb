"""Random trees of bodies, and random states of a tree, reproducible from a generator with a seed."""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.loads.load import Axes
from bodycheck.reference_impl.rotations import normalised, quaternion_to_matrix
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.joint_kinds import joint_kinds
from bodycheck.reference_impl.trees.tree_scene import (
    WORLD,
    BodyLoad,
    Joint,
    JointSineTorque,
    JointTorque,
    TreeBody,
    TreeLoad,
    TreeScene,
)

JOINTS = ("hinge", "slide", "ball")
_FREE = "free"
_MASS_KG, _SIZE_M, _OFFSET_M, _SLIDE_M, _RATE = (0.1, 10.0), (0.05, 0.3), 0.4, 0.5, 2.0
_GRAVITY = np.array([0.0, 0.0, -9.81])


def random_tree(
    rng: np.random.Generator,
    bodies: int,
    *,
    floating: bool | None = None,
    kinds: tuple[str, ...] = JOINTS,
    springs: bool = True,
    loads: bool = False,
) -> TreeScene:
    """Return a tree of some bodies under gravity, for 1 s, in a random state.

    floating: whether the first body is free [default: either]. springs: some joints have springs, dampers or
    both. loads: forces and torques act on some bodies and joints. Half of the bodies continue a chain, the
    others start at any earlier body; masses are log-uniform from 0.1 to 10 kg, radii of gyration of the order
    of 0.1 m, and axes, angles and attitudes uniform.
    """
    is_free = bool(rng.random() < 0.5) if floating is None else floating
    made: list[TreeBody] = []
    for i in range(bodies):
        parent = i - 1 if i < 2 or rng.random() < 0.5 else int(rng.integers(0 if is_free else WORLD, i))
        kind = _FREE if i == 0 and is_free else str(rng.choice(kinds))
        joint = Joint(_FREE) if kind == _FREE else _random_joint(rng, kind, parent, springs=springs)
        made.append(TreeBody(f"body-{i + 1}", *_random_body(rng), joint))
    still = TreeScene(tuple(made), (), _GRAVITY, 1.0, 11)
    scene = TreeScene(still.bodies, _random_loads(rng, still) if loads else (), _GRAVITY, 1.0, 11)
    return scene.with_state(*random_state(scene, rng))


def random_state(scene: TreeScene, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return coordinates q and rates u: angles and attitudes uniform, rates of the order of 1."""
    q: list[float] = []
    for body in scene.bodies:
        kind = body.joint.of_kind
        q += rng.uniform(-_SLIDE_M, _SLIDE_M, (0, 1, 3)[kind.translation]).tolist()
        if kind.rotation is Rotation.AXIS:
            q.append(float(rng.uniform(-math.pi, math.pi)))
        elif kind.rotation is Rotation.BALL:
            q += _random_quaternion(rng).tolist()
    return np.array(q), rng.uniform(-_RATE, _RATE, len(scene.u0))


def _random_quaternion(rng: np.random.Generator) -> Array:
    return normalised(rng.standard_normal(4))


def _random_body(rng: np.random.Generator) -> tuple[float, Array]:
    """Return mass and inertia; the principal second moments are positive, so that a body can have them."""
    mass = float(np.exp(rng.uniform(*np.log(_MASS_KG))))
    second = rng.uniform(*_SIZE_M, 3) ** 2
    axes = quaternion_to_matrix(_random_quaternion(rng))
    inertia = axes @ np.diag(mass * (np.sum(second) - second)) @ axes.T
    return mass, 0.5 * (inertia + inertia.T)


def _random_joint(rng: np.random.Generator, kind: str, parent: int, *, springs: bool) -> Joint:
    has_spring, has_damper = springs and rng.random() < 0.3, springs and rng.random() < 0.3
    is_scalar = joint_kinds()[kind].is_scalar
    return Joint(
        kind,
        parent,
        rng.uniform(-_OFFSET_M, _OFFSET_M, 3),
        rng.uniform(-_OFFSET_M, _OFFSET_M, 3),
        _random_quaternion(rng),
        normalised(rng.standard_normal(3)),
        stiffness=float(rng.uniform(0.5, 20.0)) if has_spring and is_scalar else 0.0,
        rest=float(rng.uniform(-0.5, 0.5)) if has_spring and is_scalar else 0.0,
        damping=float(rng.uniform(0.05, 1.0)) if has_damper else 0.0,
    )


def _random_loads(rng: np.random.Generator, scene: TreeScene) -> tuple[TreeLoad, ...]:
    """Return a force, a torque, and what acts on one joint."""

    def body() -> int:
        return int(rng.integers(len(scene.bodies)))

    axes: tuple[Axes, Axes] = ("body", "world")
    loads: list[TreeLoad] = [
        BodyLoad(
            body(), PointForce(axes[rng.integers(2)], rng.uniform(-5.0, 5.0, 3), rng.uniform(-0.2, 0.2, 3))
        ),
        BodyLoad(body(), Torque(axes[rng.integers(2)], rng.uniform(-1.0, 1.0, 3))),
    ]
    joint = body()
    kind = scene.bodies[joint].joint.of_kind
    if kind.translation is not Translation.SPACE:
        loads.append(JointTorque(joint, rng.uniform(-2.0, 2.0, kind.rates)))
    if kind.is_scalar:
        amplitude, rate, phase = rng.uniform(0.5, 5.0, 3).tolist()
        loads.append(JointSineTorque(joint, amplitude, rate, phase))
    return tuple(loads)
