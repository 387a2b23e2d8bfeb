"""A tree of rigid bodies, its initial state, its loads and the duration, as plain arrays."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, TypeAlias

import numpy as np

from bodycheck._util.formatting import count
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import rotational_energy, translational_energy
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.scene import Link
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import JointKind, Rotation, Translation
from bodycheck.reference_impl.trees.joint_kinds import joint_kinds
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench, share_of

WORLD = -1
"""The parent of a body that no other body carries."""


@dataclass(frozen=True, eq=False)
class Joint:
    """How a body is connected to its parent; numbers are exact doubles, axes and quaternions of any norm.

    parent: its index among the bodies, or WORLD. at_parent (3,) in m: the joint's point from the parent's
    centre of mass in its body axes, or from the origin of the world; at_body (3,) in m: from the body's own
    centre of mass, body axes. zero (4,): quaternion, child axes to parent axes at coordinate 0. axis (3,) in
    child axes. start and rate: coordinates and rates at the start, as `JointKind` orders them [default: 0].
    A spring and a damper give -stiffness (q - rest) - damping u, in N m or N. armature: added to the diagonal
    of the mass matrix at the joint's rates; part of no energy and no momentum.
    """

    kind: str
    parent: int = WORLD
    at_parent: Array = field(default_factory=lambda: np.zeros(3))
    at_body: Array = field(default_factory=lambda: np.zeros(3))
    zero: Array = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    start: Array | None = None
    rate: Array | None = None
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    armature: float = 0.0

    @property
    def of_kind(self) -> JointKind:
        """What the kind of joint permits. Raises KeyError for an unknown kind."""
        return joint_kinds()[self.kind]

    @property
    def coordinates(self) -> Array:
        """The coordinates at the start."""
        return np.array(self.of_kind.zero) if self.start is None else np.asarray(self.start, np.float64)

    @property
    def rates(self) -> Array:
        """The rates at the start."""
        return np.zeros(self.of_kind.rates) if self.rate is None else np.asarray(self.rate, np.float64)


@dataclass(frozen=True, eq=False)
class TreeBody:
    """A body of a tree: mass in kg, inertia (3, 3) about its centre of mass in body axes, in kg m^2.

    link: the engine's own frame of the body, as for a `Scene`; it affects no motion.
    """

    name: str
    mass: float
    inertia: Array
    joint: Joint
    link: Link | None = None


@dataclass(frozen=True, eq=False)
class BodyLoad:
    """A torque or a force on the body with this index."""

    body: int
    load: Torque | PointForce


@dataclass(frozen=True, eq=False)
class JointTorque:
    """A constant generalised force at the rates of a body's joint, from its parent, within [from_s, until_s).

    value (rates,): N m about a hinge, N along a slide, N m in child axes at a ball.
    """

    body: int
    value: Array
    from_s: float = 0.0
    until_s: float = math.inf


@dataclass(frozen=True, eq=False)
class JointSineTorque:
    """amplitude sin(rate t + phase) at a hinge in N m, or at a slide in N."""

    body: int
    amplitude: float
    rate: float
    phase: float = 0.0


TreeLoad: TypeAlias = BodyLoad | JointTorque | JointSineTorque


@dataclass(frozen=True, eq=False)
class TreeScene:
    """Bodies connected by joints, from one state under their loads, sampled evenly from 0 to duration_s.

    Parents stand before their children. gravity (3,) in m/s^2, world axes. q (coordinates,) and u (rates,)
    hold those of all joints in the order of the bodies. Raises ValueError with one line per fault.
    """

    bodies: tuple[TreeBody, ...]
    loads: tuple[TreeLoad, ...]
    gravity: Array
    duration_s: float
    samples: int

    def __post_init__(self) -> None:
        faults = [f"{'.'.join(place)}: {fault}" for place, fault in tree_faults(self.bodies, self.loads)]
        if faults:
            raise ValueError("\n".join(faults))

    @property
    def sample_interval_s(self) -> float:
        """The time between two samples, s."""
        return self.duration_s / (self.samples - 1)

    @property
    def sample_times(self) -> Array:
        """t_k = k T / (n - 1), computed directly rather than accumulated: (samples,) in s."""
        return np.arange(self.samples) * self.duration_s / (self.samples - 1)

    def switches_before(self, end_s: float) -> tuple[float, ...]:
        """Return the ascending times inside (0, end_s) at which a load switches on or off."""
        ends = {end for load in self.loads for end in interval(load)}
        return tuple(sorted(end for end in ends if 0.0 < end < end_s))

    @cached_property
    def coordinate_slices(self) -> tuple[slice, ...]:
        """The place of each joint in q."""
        return _slices(body.joint.of_kind.coordinates for body in self.bodies)

    @cached_property
    def rate_slices(self) -> tuple[slice, ...]:
        """The place of each joint in u."""
        return _slices(body.joint.of_kind.rates for body in self.bodies)

    @cached_property
    def turn_slices(self) -> tuple[tuple[slice, slice], ...]:
        """The places of each quaternion in q, and of its omega in u."""
        places = zip(self.bodies, self.coordinate_slices, self.rate_slices, strict=True)
        return tuple(
            (slice(in_q.stop - 4, in_q.stop), slice(in_u.stop - 3, in_u.stop))
            for body, in_q, in_u in places
            if body.joint.of_kind.rotation is Rotation.BALL
        )

    @cached_property
    def q0(self) -> Array:
        """The coordinates of all joints at the start."""
        return np.concatenate([body.joint.coordinates for body in self.bodies])

    @cached_property
    def u0(self) -> Array:
        """The rates of all joints at the start."""
        return np.concatenate([body.joint.rates for body in self.bodies])

    def wrench_between(self, begin_s: float, end_s: float) -> Wrench:
        """Return the loads that act within [begin_s, end_s), each with its share of it."""
        shares = ((load, share_of(*interval(load), begin_s, end_s)) for load in self.loads)
        return replace(NO_WRENCH, of_tree=tuple((load, share) for load, share in shares if share > 0.0))

    def kinetic_energies(self, motion: Trajectory) -> tuple[Array, Array]:
        """K = sum of 1/2 omega . I omega + 1/2 m |v|^2, and its rotational part: (n,) and (n,) in J."""
        rotational, moving = np.zeros((2, len(motion.t_s)))
        for k, body in enumerate(self.bodies):
            rotational += rotational_energy(body.inertia, motion.omega_body[:, k])
            moving += translational_energy(body.mass, motion.velocity_m_s[:, k])
        return rotational + moving, rotational

    @property
    def has_callback_load(self) -> bool:
        """Whether a load is given by a function: never, in a tree."""
        return False

    @property
    def is_off_centre(self) -> bool:
        """Whether an engine's own frame of a free body lies off its centre of mass: never, in a tree."""
        return False

    @property
    def continuous_loads(self) -> tuple[JointSineTorque, ...]:
        """The loads that act throughout."""
        return tuple(load for load in self.loads if isinstance(load, JointSineTorque))

    @property
    def is_floating(self) -> bool:
        """Whether a body moves freely."""
        return any(body.joint.of_kind.translation is Translation.SPACE for body in self.bodies)

    @cached_property
    def unloaded(self) -> TreeScene:
        """The same tree without springs, dampers and loads."""
        return self._with_bodies(lambda body: _with_joint(body, stiffness=0.0, damping=0.0), ())

    @cached_property
    def massless(self) -> TreeScene:
        """The same joints, springs, dampers and loads between bodies without mass."""
        return self._with_bodies(
            lambda body: replace(_with_joint(body, armature=0.0), mass=0.0, inertia=np.zeros((3, 3))),
            self.loads,
        )

    def _with_bodies(self, change: Callable[[TreeBody], TreeBody], loads: tuple[TreeLoad, ...]) -> TreeScene:
        return replace(self, bodies=tuple(map(change, self.bodies)), loads=loads)

    def in_time_unit(self, exponent: int) -> TreeScene:
        """Return the scene in a unit of time of 2^exponent s, unrounded."""
        unit = 2.0**exponent
        faster = self._with_bodies(
            lambda body: _with_joint(
                body,
                rate=body.joint.rates * unit,
                stiffness=body.joint.stiffness * unit**2,
                damping=body.joint.damping * unit,
            ),
            tuple(_in_time_unit(load, exponent) for load in self.loads),
        )
        return replace(faster, gravity=self.gravity * unit**2, duration_s=self.duration_s / unit)

    def with_state(self, q: Array, u: Array) -> TreeScene:
        """Return the scene that starts at the coordinates q and the rates u."""
        bodies = (
            _with_joint(body, start=q[coordinates].copy(), rate=u[rates].copy())
            for body, coordinates, rates in zip(
                self.bodies, self.coordinate_slices, self.rate_slices, strict=True
            )
        )
        return replace(self, bodies=tuple(bodies))


def interval(load: TreeLoad) -> tuple[float, float]:
    """Return the times from which and until which a load acts, s."""
    if isinstance(load, JointSineTorque):
        return -math.inf, math.inf
    switched = load.load if isinstance(load, BodyLoad) else load
    return switched.from_s, switched.until_s


def _with_joint(body: TreeBody, **changes: Any) -> TreeBody:
    return replace(body, joint=replace(body.joint, **changes))


def _in_time_unit(load: TreeLoad, exponent: int) -> TreeLoad:
    unit = 2.0**exponent
    if isinstance(load, BodyLoad):
        changed = load.load.in_time_unit(exponent)
        assert changed is not None  # the units of torques and forces are known
        return replace(load, load=changed)
    if isinstance(load, JointTorque):
        return replace(
            load, value=load.value * unit**2, from_s=load.from_s / unit, until_s=load.until_s / unit
        )
    return replace(load, amplitude=load.amplitude * unit**2, rate=load.rate * unit)


def _slices(sizes: Iterator[int]) -> tuple[slice, ...]:
    return tuple(slice(start, end) for start, end in pairwise((0, *accumulate(sizes))))


def tree_faults(
    bodies: tuple[TreeBody, ...], loads: tuple[TreeLoad, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the faults of a tree: the place, as attributes from the scene, and what is wrong there."""
    if not bodies:
        yield ("bodies",), "needs at least one body"
    names = Counter(body.name for body in bodies)
    for i, body in enumerate(bodies):
        for place, fault in _body_faults(i, body, names):
            yield (f"bodies[{i}]", *place), fault
    for k, load in enumerate(loads):
        for place, fault in _load_faults(load, bodies):
            yield (f"loads[{k}]", *place), fault


def _body_faults(i: int, body: TreeBody, names: Counter[str]) -> Iterator[tuple[tuple[str, ...], str]]:
    if body.name in ("", "world"):
        yield ("name",), "must be a name other than 'world'"
    if names[body.name] > 1:
        yield ("name",), f"there are {names[body.name]} bodies named {body.name!r}; names must be unique"
    if not (np.isfinite(body.mass) and body.mass >= 0.0):
        yield ("mass",), f"must be finite and not negative, not {body.mass!r}"
    if np.shape(body.inertia) != (3, 3) or not np.isfinite(body.inertia).all():
        yield ("inertia",), "must be a tensor (3, 3) of finite numbers"
    elif np.any(body.inertia != body.inertia.T) or np.linalg.eigvalsh(body.inertia)[0] < _negative(body):
        yield ("inertia",), "must be symmetric and without negative moments"
    joint = body.joint
    if joint.kind not in joint_kinds():
        yield ("joint", "kind"), f"unknown kind {joint.kind!r} (available: {', '.join(joint_kinds())})"
        return
    if not WORLD <= joint.parent < i:
        yield (
            ("joint", "parent"),
            f"must be -1, the world, or the index of an earlier body, not {joint.parent}",
        )
    kind = joint.of_kind
    if kind.translation is Translation.SPACE and joint.parent != WORLD:
        yield ("joint", "kind"), f"a {joint.kind} body has the parent world"
    shapes = {
        "at_parent": (joint.at_parent, 3),
        "at_body": (joint.at_body, 3),
        "zero": (joint.zero, 4),
        "axis": (joint.axis, 3),
        "start": (joint.coordinates, kind.coordinates),
        "rate": (joint.rates, kind.rates),
    }
    for name, (value, size) in shapes.items():
        if np.shape(value) != (size,) or not np.isfinite(value).all():
            yield ("joint", name), f"must be {size} finite numbers, not {np.asarray(value).tolist()}"
        elif name == "zero" and not np.any(value):
            yield ("joint", name), "must not be 0"
        elif name == "axis" and kind.has_axis and not np.any(value):
            yield ("joint", name), "must not be of length 0"
    for name in ("stiffness", "rest", "damping", "armature"):
        value = getattr(joint, name)
        if not math.isfinite(value) or (name != "rest" and value < 0.0):
            yield ("joint", name), f"must be finite{' and not negative' * (name != 'rest')}, not {value!r}"
    if not np.any(joint.coordinates[-4:]) and kind.rotation is Rotation.BALL:
        yield ("joint", "start"), "must have a quaternion that is not 0"
    if joint.damping and kind.rotation and kind.translation:
        yield ("joint", "damping"), f"a joint of kind {joint.kind!r} has no damper"
    if joint.stiffness and not kind.is_scalar:
        yield ("joint", "stiffness"), f"a joint of kind {joint.kind!r} has no spring"
    if kind.translation is Translation.SPACE:
        if joint.armature:
            yield ("joint", "armature"), f"a {joint.kind} body has none"
        if np.any(joint.at_parent) or np.any(joint.at_body) or np.any(joint.zero[1:]):
            yield ("joint",), f"a {joint.kind} body has no at_parent, at_body and zero"


def _negative(body: TreeBody) -> float:
    """Return how far below 0 a moment may come out by rounding."""
    return -1e-12 * float(np.max(np.abs(body.inertia)))


def _load_faults(load: TreeLoad, bodies: tuple[TreeBody, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
    if not 0 <= load.body < len(bodies):
        yield ("body",), f"must be the index of a body, not {load.body}"
        return
    kind = joint_kinds().get(bodies[load.body].joint.kind)
    if isinstance(load, BodyLoad) or kind is None:
        return
    if kind.translation is Translation.SPACE:
        yield ("body",), f"{bodies[load.body].name!r} has no joint on which a torque acts"
    elif isinstance(load, JointSineTorque) and not kind.is_scalar:
        yield ("body",), f"{bodies[load.body].name!r} has no joint of one coordinate"
    elif isinstance(load, JointTorque) and np.shape(load.value) != (kind.rates,):
        yield ("value",), f"must be {count(kind.rates, 'number')}, not {np.asarray(load.value).tolist()}"
