"""[[forcing]]: what acts on the body, one table a kind."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, TypeAlias, get_args

import numpy as np
from pydantic import (
    BeforeValidator,
    Discriminator,
    PlainSerializer,
    PlainValidator,
    ValidationInfo,
    field_validator,
)

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    Load,
    PointForce,
    SineTorque,
    Spring,
    Torque,
    TorsionSpring,
)
from bodycheck.scenarios.fields import (
    ZERO,
    Matrix,
    NotNegative,
    Number,
    Positive,
    Table,
    Vector,
    finite_numbers,
    rows,
)
from bodycheck.scenarios.user_functions import UserWrench, user_function

_Axes: TypeAlias = Literal["body", "world"]


class _TimedTable(Table):
    axes: _Axes
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

    def load(self) -> Load:
        """Return the same as arrays."""
        return Torque(self.axes, np.array(self.value_n_m), self.from_s, self._until)


class ForceTable(_TimedTable):
    """A force, constant in its axes while it acts, at a body-fixed point."""

    kind: Literal["force"]
    value_n: Vector
    at_m: Vector = ZERO

    def load(self) -> Load:
        """Return the same as arrays."""
        return PointForce(self.axes, np.array(self.value_n), np.array(self.at_m), self.from_s, self._until)


class GravityTable(Table):
    """Uniform gravity, in world axes: no load, but the scene's own."""

    kind: Literal["gravity"]
    acceleration_m_s2: Vector


class SineTorqueTable(Table):
    """A torque that swings as a sine of the time."""

    kind: Literal["sine-torque"]
    axes: _Axes
    amplitude_n_m: Vector
    rate_rad_s: Number
    phase_rad: Number = 0.0

    def load(self) -> Load:
        """Return the same as arrays."""
        return SineTorque(self.axes, np.array(self.amplitude_n_m), self.rate_rad_s, self.phase_rad)


def _damping(value: Any) -> Matrix:
    """Accept a number or a 3x3 matrix that takes energy away."""
    matrix = finite_numbers(value, "a number or a 3x3 matrix of numbers", (), (3, 3))
    matrix = matrix * np.eye(3) if matrix.shape == () else matrix
    least = float(np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0])
    if least < -1e-12 * float(np.max(np.abs(matrix))):
        raise ValueError(f"must take energy away: omega . C omega would reach {least:.6g} |omega|^2")
    return rows(matrix)


class DragTable(Table):
    """Linear drag, of the centre of mass and of the rotation."""

    kind: Literal["drag"]
    linear_n_s_m: NotNegative = 0.0
    angular_n_m_s: Annotated[Matrix, BeforeValidator(_damping)] = (ZERO, ZERO, ZERO)

    def load(self) -> Load:
        """Return the same as arrays."""
        return Drag(self.linear_n_s_m, np.array(self.angular_n_m_s))


class SpringTable(Table):
    """A spring from a point of the world to a point of the body."""

    kind: Literal["spring"]
    anchor_m: Vector
    at_m: Vector = ZERO
    stiffness_n_m: Positive
    rest_length_m: NotNegative = 0.0

    def load(self) -> Load:
        """Return the same as arrays."""
        return Spring(np.array(self.anchor_m), np.array(self.at_m), self.stiffness_n_m, self.rest_length_m)


class TorsionSpringTable(Table):
    """A spring that turns the body back to where it started, by the shortest way."""

    kind: Literal["torsion-spring"]
    stiffness_n_m: Positive

    def load(self) -> Load:
        """Return the same as a load."""
        return TorsionSpring(self.stiffness_n_m)


class GravityGradientTable(Table):
    """The torque of a central field on a satellite in a circular orbit."""

    kind: Literal["gravity-gradient"]
    orbit_rate_rad_s: Positive

    def load(self) -> Load:
        """Return the same as a load."""
        return GravityGradient(self.orbit_rate_rad_s)


def _user_wrench(value: Any, info: ValidationInfo) -> UserWrench:
    """Import the function, where the reading's context allows code."""
    if not isinstance(value, str):
        raise ValueError("needs the name of a function, like package.module:function")
    allow_code = bool((info.context or {}).get("allow_code"))
    return UserWrench(value, user_function(value, allow_code=allow_code))


class CallableTable(Table):
    """A force and a torque that only a function knows."""

    kind: Literal["callable"]
    function: Annotated[UserWrench, PlainValidator(_user_wrench), PlainSerializer(lambda f: f.name)]

    def load(self) -> Load:
        """Return the same as a load."""
        return CallbackLoad(self.function.name, self.function)


class PivotTable(Table):
    """A point of the body that stays where it is at the start: no load, but the scene's own."""

    kind: Literal["pivot"]
    at_m: Vector


_LoadTable: TypeAlias = (
    TorqueTable
    | ForceTable
    | SineTorqueTable
    | DragTable
    | SpringTable
    | TorsionSpringTable
    | GravityGradientTable
    | CallableTable
)
_Any: TypeAlias = _LoadTable | GravityTable | PivotTable

FORCING_KINDS = tuple(get_args(table.model_fields["kind"].annotation)[0] for table in get_args(_Any))


def _known_kind(value: Any) -> Any:
    """Refuse what is of no kind by a message of its own, before the union does."""
    if not isinstance(value, dict) or "kind" not in value:
        raise ValueError(f"needs a kind: {', '.join(FORCING_KINDS)}")
    if value["kind"] not in FORCING_KINDS:
        raise ValueError(f"no forcing is of kind {value['kind']!r}; there are: {', '.join(FORCING_KINDS)}")
    return value


Forcing: TypeAlias = Annotated[Annotated[_Any, Discriminator("kind")], BeforeValidator(_known_kind)]


def loads_of(forcings: tuple[Forcing, ...]) -> tuple[Load, ...]:
    """Return the loads among the forcings, in their order."""
    return tuple(f.load() for f in forcings if not isinstance(f, GravityTable | PivotTable))


def gravity_of(forcings: tuple[Forcing, ...]) -> Array:
    """Return the sum of the accelerations of gravity (3,), m/s^2, world axes."""
    gravities = [np.array(f.acceleration_m_s2) for f in forcings if isinstance(f, GravityTable)]
    return sum(gravities, start=np.zeros(3))


def pivot_of(forcings: tuple[Forcing, ...]) -> Array | None:
    """Return the pivot (3,) from the centre of mass in body axes, m; None where there is none."""
    return next((np.array(f.at_m) for f in forcings if isinstance(f, PivotTable)), None)


def check_together(forcings: tuple[Forcing, ...]) -> None:
    """Refuse, by ValueError, forcings that cannot act together."""
    for table in (PivotTable, GravityGradientTable):
        kind = get_args(table.model_fields["kind"].annotation)[0]
        places = [i for i, f in enumerate(forcings) if isinstance(f, table)]
        if len(places) > 1:
            raise ValueError(f"has {len(places)} of kind {kind!r}, at {places}; there can be one at most")
    if pivot_of(forcings) is not None and any(isinstance(f, GravityGradientTable) for f in forcings):
        raise ValueError("a body with a pivot is in no orbit: leave out 'pivot' or 'gravity-gradient'")
