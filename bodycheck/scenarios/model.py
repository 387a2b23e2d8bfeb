"""The scenario as its file says it, checked: every key, unit and bound of the format stands here.

Checks that look at more than one key are field validators reading what was already accepted, so that
one pass reports all the errors of a file at once.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    StrictInt,
    StrictStr,
    ValidationInfo,
    field_validator,
)

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import normalised, quaternion_to_matrix
from bodycheck.reference_impl.scene import PointForce, RigidBody, Scene, State, Timed, Torque
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.scenarios.body import Body
from bodycheck.scenarios.fields import NotYet, Number, Positive, Quaternion, Table, Vector

_ZERO: Vector = (0.0, 0.0, 0.0)
_UNIT_TOLERANCE = 1e-6  # how far a quaternion's norm may be from 1
_MOST_SAMPLES = 1_000_000
DEFAULT_STEPS_PER_SAMPLE = (5, 10, 20, 50, 100)


class Initial(Table):
    """[initial]: where the body starts; at rest at the origin, axes aligned, unless said."""

    position_m: Vector = _ZERO
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    velocity_m_s: Vector = _ZERO
    omega_body_rad_s: Vector | None = None
    omega_world_rad_s: Vector | None = None

    @field_validator("quaternion")
    @classmethod
    def _unit(cls, value: Quaternion) -> Quaternion:
        norm = math.hypot(*value)
        if abs(norm - 1.0) > _UNIT_TOLERANCE:
            raise ValueError(f"must be a unit quaternion (w, x, y, z); its norm is {norm:.9g}")
        if norm == 1.0:
            return value
        w, x, y, z = normalised(np.array(value)).tolist()
        return (w, x, y, z)

    @field_validator("omega_world_rad_s")
    @classmethod
    def _one_omega(cls, value: Vector | None, info: ValidationInfo) -> Vector | None:
        if value is not None and info.data.get("omega_body_rad_s") is not None:
            raise ValueError("give omega_body_rad_s or omega_world_rad_s, not both")
        return value

    def state(self) -> State:
        """Return the same as arrays."""
        quaternion = np.array(self.quaternion)
        if self.omega_world_rad_s is not None:
            omega_body = quaternion_to_matrix(quaternion).T @ np.array(self.omega_world_rad_s)
        else:
            omega_body = np.array(self.omega_body_rad_s or _ZERO)
        return State(np.array(self.position_m), quaternion, np.array(self.velocity_m_s), omega_body)


class _TimedTable(Table):
    axes: Literal["body", "world"]
    from_s: Number = 0.0
    until_s: Number | None = None

    @field_validator("until_s")
    @classmethod
    def _after_from(cls, value: float | None, info: ValidationInfo) -> float | None:
        begin = info.data.get("from_s")
        if value is not None and begin is not None and not value > begin:
            raise ValueError(f"must be later than from_s = {begin!r}")
        return value

    @property
    def _until(self) -> float:
        return math.inf if self.until_s is None else self.until_s


class TorqueTable(_TimedTable):
    """A torque, constant in its axes while it acts."""

    kind: Literal["torque"]
    value_n_m: Vector

    def load(self) -> Timed:
        """Return the same as arrays."""
        return Torque(self.axes, np.array(self.value_n_m), self.from_s, self._until)


class ForceTable(_TimedTable):
    """A force, constant in its axes while it acts, at a body-fixed point."""

    kind: Literal["force"]
    value_n: Vector
    at_m: Vector = _ZERO

    def load(self) -> Timed:
        """Return the same as arrays."""
        return PointForce(self.axes, np.array(self.value_n), np.array(self.at_m), self.from_s, self._until)


class GravityTable(Table):
    """Uniform gravity, in world axes."""

    kind: Literal["gravity"]
    acceleration_m_s2: Vector


FORCING_KINDS = ("torque", "force", "gravity")
_LATER_KINDS = (
    "sine-torque",
    "drag",
    "spring",
    "torsion-spring",
    "pivot",
    "gravity-gradient",
    "callable",
)


def _known_kind(value: Any) -> Any:
    """Refuse the kinds that are to come by their own message, before the union refuses the unknown."""
    if not isinstance(value, dict) or "kind" not in value:
        raise ValueError(f"needs a kind: {', '.join(FORCING_KINDS)}")
    kind = value["kind"]
    if kind in _LATER_KINDS:
        raise ValueError(f"forcing of kind {kind!r} is not yet supported; so far: {', '.join(FORCING_KINDS)}")
    if kind not in FORCING_KINDS:
        raise ValueError(f"no forcing is of kind {kind!r}; so far: {', '.join(FORCING_KINDS)}")
    return value


Forcing: TypeAlias = Annotated[
    Annotated[TorqueTable | ForceTable | GravityTable, Discriminator("kind")], BeforeValidator(_known_kind)
]


class Scenario(Table):
    """One scenario file: a body, its initial state, what acts on it, and how long it is watched."""

    name: Annotated[StrictStr, Field(min_length=1, max_length=200)]
    summary: StrictStr = ""
    source: StrictStr = ""
    tags: tuple[StrictStr, ...] = ()
    duration_s: Positive
    samples: Annotated[StrictInt, Field(ge=2, le=_MOST_SAMPLES)]
    steps_s: tuple[Positive, ...] | None = None
    body: Body
    initial: Initial = Initial()
    forcing: tuple[Forcing, ...] = ()
    sweep: NotYet = None

    @field_validator("name")
    @classmethod
    def _one_line(cls, value: str) -> str:
        if not value.isprintable() or value != value.strip():
            raise ValueError("must be one line of printable text without blanks at its ends")
        return value

    @field_validator("steps_s")
    @classmethod
    def _steps_fit(cls, value: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        if value is None or not {"duration_s", "samples"} <= info.data.keys():
            return value
        if not value:
            raise ValueError("needs at least one step, or leave it out")
        interval = info.data["duration_s"] / (info.data["samples"] - 1)
        if len({steps_per_sample(interval, step) for step in value}) < len(value):
            raise ValueError("names a step twice")
        return value

    @property
    def family(self) -> str:
        """The name before the slash of a child of a family; else the whole name."""
        return self.name.partition("/")[0]

    @property
    def steps(self) -> tuple[float, ...]:
        """The steps that a run uses unless told otherwise, in s, coarsest first."""
        interval = self.scene.sample_interval_s
        return tuple(sorted(self.steps_s or (interval / n for n in DEFAULT_STEPS_PER_SAMPLE), reverse=True))

    @cached_property
    def scene(self) -> Scene:
        """The mathematics of it, as plain arrays."""
        gravities = [np.array(f.acceleration_m_s2) for f in self.forcing if isinstance(f, GravityTable)]
        gravity: Array = sum(gravities, start=np.zeros(3))
        return Scene(
            body=RigidBody(self.body.mass_kg, np.array(self.body.inertia_kg_m2)),
            initial=self.initial.state(),
            loads=tuple(f.load() for f in self.forcing if not isinstance(f, GravityTable)),
            gravity=gravity,
            duration_s=self.duration_s,
            samples=self.samples,
        )
