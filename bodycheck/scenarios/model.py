"""The model of a scenario file: its tables define every key, unit and bound of the format.

Checks of more than one key are field validators that read the fields already validated, so that one pass
reports all errors of a file.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import Field, StrictInt, StrictStr, ValidationInfo, field_validator

from bodycheck._util.untrusted import FORMULA
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import normalised, quaternion_to_matrix
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.scenarios.body import Body
from bodycheck.scenarios.fields import ALIGNED, ZERO, NearlyUnitQuaternion, Positive, TomlTable, Vector
from bodycheck.scenarios.forcings import Forcing, check_together, gravity_of, loads_of, pivot_of

_VELOCITY_TOLERANCE = 1e-9  # relative deviation of a given velocity from the one that a pivot implies
_MAX_SAMPLES = 1_000_000
_LARGEST = 1e100  # of a number of the initial state: its square and cube must be doubles
_UNIT = 4.0 * float(np.finfo(np.float64).eps)  # deviation from 1 of the norm of a quaternion of doubles
DEFAULT_STEPS_PER_SAMPLE = (5, 10, 20, 50, 100)


def rounded_to_unit(vector: tuple[float, ...]) -> Array:
    """Return a vector as an array, normalised unless its norm is 1 to rounding."""
    array = np.array(vector)
    return array if abs(float(np.linalg.norm(array)) - 1.0) <= _UNIT else normalised(array)


class Initial(TomlTable):
    """[initial]: the initial state [default: at rest at the origin, axes aligned]."""

    position_m: Vector = ZERO
    quaternion: NearlyUnitQuaternion = ALIGNED
    velocity_m_s: Vector | None = None
    omega_body_rad_s: Vector | None = None
    omega_world_rad_s: Vector | None = None

    @field_validator("position_m", "velocity_m_s", "omega_body_rad_s", "omega_world_rad_s")
    @classmethod
    def _not_too_large(cls, value: Vector | None) -> Vector | None:
        if value is not None and max(map(abs, value)) > _LARGEST:
            raise ValueError(f"numbers above {_LARGEST:g} are not supported")
        return value

    @field_validator("omega_world_rad_s")
    @classmethod
    def _one_omega(cls, value: Vector | None, info: ValidationInfo) -> Vector | None:
        if value is not None and info.data.get("omega_body_rad_s") is not None:
            raise ValueError("give omega_body_rad_s or omega_world_rad_s, not both")
        return value

    def state(self, pivot: Array | None) -> State:
        """Return the start in doubles, as passed to engines: a unit quaternion, omega in body axes.

        pivot (3,) in m from the centre of mass in body axes, or None; about a pivot, the rotation determines
        the velocity of the centre of mass.
        """
        quaternion = rounded_to_unit(self.quaternion)
        if self.omega_world_rad_s is not None:
            omega_body = quaternion_to_matrix(quaternion).T @ np.array(self.omega_world_rad_s)
        else:
            omega_body = np.array(self.omega_body_rad_s or ZERO)
        if pivot is None:
            velocity = np.array(self.velocity_m_s or ZERO)
        else:
            velocity = quaternion_to_matrix(quaternion) @ np.cross(pivot, omega_body)
        return State(np.array(self.position_m), quaternion, velocity, omega_body)

    def as_written(self, pivot: Array | None) -> State:
        """Return the start with the exact numbers of the file; pivot (3,) or None as for `state`."""
        omega = self.omega_world_rad_s
        return replace(
            self.state(pivot),
            quaternion=np.array(self.quaternion),
            exact_omega_world=None if omega is None else np.array(omega),
        )


class ScenarioTable(TomlTable):
    """What every scenario file has: its name and origin, the duration, the samples and the steps."""

    name: Annotated[StrictStr, Field(min_length=1, max_length=200)]
    summary: StrictStr = ""
    source: StrictStr = ""
    tags: tuple[StrictStr, ...] = ()
    duration_s: Positive
    samples: Annotated[StrictInt, Field(ge=2, le=_MAX_SAMPLES)] = 101
    steps_s: tuple[Positive, ...] | None = None

    @field_validator("name")
    @classmethod
    def _one_line(cls, value: str) -> str:
        if not value.isprintable() or value != value.strip():
            raise ValueError("must be one line of printable text without leading or trailing spaces")
        if value.startswith(FORMULA):
            raise ValueError("must not begin with =, +, - or @, which makes it a formula in tables")
        return value

    @field_validator("name")
    @classmethod
    def _of_no_family(cls, value: str, info: ValidationInfo) -> str:
        """Refuse a slash in the file's own name, because the part before it would count as a family."""
        context = info.context or {"stored": True}
        own = value.removesuffix(f"/{context['label']}") if "label" in context else value
        if "/" in own and not context.get("stored"):  # stored runs contain names of children
            raise ValueError("must have no slash: NAME/VALUE names the scenarios of a [[sweep]]")
        return value

    @field_validator("steps_s")
    @classmethod
    def _steps_fit(cls, value: tuple[float, ...] | None, info: ValidationInfo) -> tuple[float, ...] | None:
        if value is None or not {"duration_s", "samples"} <= info.data.keys():
            return value
        if not value:
            raise ValueError("needs at least one step, or omit it")
        interval = info.data["duration_s"] / (info.data["samples"] - 1)
        if len({steps_per_sample(interval, step) for step in value}) < len(value):
            raise ValueError("contains a step twice")
        return value

    @property
    def family(self) -> str:
        """The name before the slash for a child of a family, else the whole name."""
        return self.name.partition("/")[0]

    @property
    def steps(self) -> tuple[float, ...]:
        """The default step sizes of a run in s, coarsest first."""
        interval = self.duration_s / (self.samples - 1)
        return tuple(sorted(self.steps_s or (interval / n for n in DEFAULT_STEPS_PER_SAMPLE), reverse=True))


class Scenario(ScenarioTable):
    """One scenario file: a body, its initial state, the loads, the duration and the number of samples."""

    body: Body
    initial: Initial = Initial()
    forcing: tuple[Forcing, ...] = ()

    @field_validator("forcing")
    @classmethod
    def _fit_together(cls, value: tuple[Forcing, ...], info: ValidationInfo) -> tuple[Forcing, ...]:
        check_together(value)
        pivot, initial = pivot_of(value), info.data.get("initial")
        if pivot is not None and initial is not None and initial.velocity_m_s is not None:
            allowed = initial.state(pivot).velocity
            slack = _VELOCITY_TOLERANCE * float(np.max(np.abs(allowed)))
            if np.max(np.abs(allowed - initial.velocity_m_s)) > slack:
                raise ValueError(
                    "the pivot is fixed, so initial.velocity_m_s must be omitted, or be "
                    f"omega x (x - pivot) = {allowed.tolist()}"
                )
        return value

    @property
    def scene_as_written(self) -> Scene:
        """The scene with the exact initial numbers of the file, which engines receive rounded to doubles."""
        scene = self.scene
        return replace(scene, initial=self.initial.as_written(scene.pivot))

    @cached_property
    def scene(self) -> Scene:
        """The scene as plain arrays, with the initial state as passed to engines."""
        pivot = pivot_of(self.forcing)
        return Scene(
            body=RigidBody(self.body.mass_kg, np.array(self.body.inertia_kg_m2)),
            initial=self.initial.state(pivot),
            loads=loads_of(self.forcing),
            gravity=gravity_of(self.forcing),
            duration_s=self.duration_s,
            samples=self.samples,
            pivot=pivot,
            link=self.body.link,
        )
