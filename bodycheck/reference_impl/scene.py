"""The problem to simulate, as plain arrays: a body, its initial state, its loads and the duration."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias, cast

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.callback import CallbackLoad
from bodycheck.reference_impl.loads.kinds.drag import Drag
from bodycheck.reference_impl.loads.kinds.force import PointForce
from bodycheck.reference_impl.loads.kinds.gravity_gradient import GravityGradient
from bodycheck.reference_impl.loads.kinds.sine_torque import SineTorque
from bodycheck.reference_impl.loads.kinds.spring import Spring
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.loads.kinds.torsion_spring import TorsionSpring
from bodycheck.reference_impl.loads.load import Axes, ContinuousLoad, Load, WrenchFunction, unknown_load
from bodycheck.reference_impl.rotations import quaternion_to_matrix, rotate

__all__ = [
    "Axes",
    "CallbackLoad",
    "ConstantLoad",
    "ContinuousLoad",
    "Drag",
    "GravityGradient",
    "Link",
    "Load",
    "PointForce",
    "RigidBody",
    "Scene",
    "SineTorque",
    "Spring",
    "State",
    "Torque",
    "TorsionSpring",
    "WrenchFunction",
    "unknown_load",
]


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass in kg and inertia tensor (3, 3) in kg m^2 about the centre of mass, in body axes."""

    mass: float
    inertia: Array


@dataclass(frozen=True, eq=False)
class State:
    """Pose and velocity of the body.

    position (3,) and velocity (3,) of the centre of mass, world axes, m and m/s; quaternion (4,)
    (w, x, y, z), body to world, of any non-zero norm: the attitude is that of q / |q|; omega_body (3,) in
    body axes, rad/s. exact_omega_world (3,): the angular velocity of a start given in world axes, rad/s;
    omega_body is then rounded from it, and a truth starts from the exact value.
    """

    position: Array
    quaternion: Array
    velocity: Array
    omega_body: Array
    exact_omega_world: Array | None = field(default=None, kw_only=True)

    @cached_property
    def rotation(self) -> Array:
        """R (3, 3), body to world."""
        return quaternion_to_matrix(self.quaternion)

    @cached_property
    def omega_world(self) -> Array:
        """R omega_body (3,), rad/s."""
        return rotate(self.quaternion, self.omega_body)


ConstantLoad: TypeAlias = Torque | PointForce
"""A load that acts from from_s to until_s and is constant in its axes."""


@dataclass(frozen=True, eq=False)
class Link:
    """An engine's own frame of the body; it affects how the body is built, not how it moves.

    offset (3,) in m: from the centre of mass to its origin, body axes; quaternion (4,): link to body axes.
    """

    offset: Array
    quaternion: Array


@dataclass(frozen=True, eq=False)
class Scene:
    """One body from one initial state under its loads, sampled evenly from 0 to duration_s.

    gravity (3,) in m/s^2, world axes. pivot (3,) in m: the body-fixed point that stays at its initial place,
    from the centre of mass in body axes; None for a free body. link: the engine's own frame of the body;
    None for a frame at the centre of mass along the body axes.
    """

    body: RigidBody
    initial: State
    loads: tuple[Load, ...]
    gravity: Array
    duration_s: float
    samples: int
    pivot: Array | None = None
    link: Link | None = None

    @property
    def sample_interval_s(self) -> float:
        """The time between two samples, s."""
        return self.duration_s / (self.samples - 1)

    @property
    def sample_times(self) -> Array:
        """t_k = k T / (n - 1), computed directly rather than accumulated: (samples,) in s."""
        return np.arange(self.samples) * self.duration_s / (self.samples - 1)

    @property
    def piecewise_constant_loads(self) -> tuple[ConstantLoad, ...]:
        """The loads that switch on and off."""
        return tuple(load for load in self.loads if isinstance(load, Torque | PointForce))

    @property
    def continuous_loads(self) -> tuple[ContinuousLoad, ...]:
        """The loads that act throughout."""
        continuous = (load for load in self.loads if not isinstance(load, Torque | PointForce))
        return cast("tuple[ContinuousLoad, ...]", tuple(continuous))

    def switches_before(self, end_s: float) -> tuple[float, ...]:
        """Return the ascending times inside (0, end_s) at which a load switches on or off."""
        ends = {end for load in self.piecewise_constant_loads for end in (load.from_s, load.until_s)}
        return tuple(sorted(end for end in ends if 0.0 < end < end_s))

    @property
    def is_free_rotation(self) -> bool:
        """Whether no torque acts: no loads, and no gravity on a pivoted body (none about the centre)."""
        return not self.loads and (self.pivot is None or not self.gravity.any())

    @property
    def is_off_centre(self) -> bool:
        """Whether the body is free and the engine's own frame lies off its centre of mass."""
        return self.pivot is None and self.link is not None and bool(self.link.offset.any())

    def in_time_unit(self, exponent: int) -> Scene | None:
        """Return the scene in a unit of time of 2^exponent s, unrounded; None if a load has no units."""
        loads = [load.in_time_unit(exponent) for load in self.loads]
        known = tuple(load for load in loads if load is not None)
        if len(known) < len(loads):
            return None
        unit, start = 2.0**exponent, self.initial
        exact = start.exact_omega_world
        return replace(
            self,
            initial=replace(
                start,
                velocity=start.velocity * unit,
                omega_body=start.omega_body * unit,
                exact_omega_world=None if exact is None else exact * unit,
            ),
            loads=known,
            gravity=self.gravity * unit**2,
            duration_s=self.duration_s / unit,
        )

    @property
    def has_callback_load(self) -> bool:
        """Whether a load is given by a function."""
        return any(isinstance(load, CallbackLoad) for load in self.loads)
