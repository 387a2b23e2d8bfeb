"""The trajectory in a recording: its columns by a map, as arrays in the units and axes of the scenario."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names
from bodycheck.examine.diagnosis.attitude_readings import derived_rates, turns_between
from bodycheck.examine.diagnosis.quantity_resolution import Resolution
from bodycheck.recordings.column_map import (
    ATTITUDES,
    EULER,
    KINDS,
    VECTORS,
    ColumnMap,
    changed_map,
)
from bodycheck.recordings.formats import read_recording
from bodycheck.recordings.proposed_map import proposal
from bodycheck.recordings.recording import EXACT, Recording
from bodycheck.recordings.resolution import OF_DOUBLES, Digits, digits_of, largest_finite, since_first
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import (
    conjugate,
    exp_quaternion,
    matrix_to_quaternion,
    normalised,
    project_to_so3,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.run_files.trajectory_files import COLUMNS, SENSORS, checked_arrays

ACCEPTED = "t_s, x_m, y_m, z_m, qw, qx, qy, qz, r00 to r22, vx_m_s ..., wx_body_rad_s ..., wx_world_rad_s ..."
"""The columns that need no map."""

_ATTITUDE_NAMES = {
    "quaternion": "a quaternion",
    "rotation": "a rotation matrix",
    "euler": "Euler angles",
    "rodrigues": "Rodrigues parameters",
    "modified_rodrigues": "modified Rodrigues parameters",
}
_LARGEST_SLOPES = {"euler": 0.5, "rodrigues": 1.0, "modified_rodrigues": 2.0, "velocity_body_m_s": 1.0}
"""Quantity -> the largest change of what is computed from it per change of one of its components."""

_MAX_NAMED = 4
_IGNORED = ("bound_rad", *SENSORS)  # the last column of `bodycheck truth`, and sensors in stored motions
_TURNED = 0.1  # rad: a body turns by so much, whatever the noise of attitudes is
_MOVED, _PART = 10.0, 0.1  # times the change between two rows, and of all axes: noise reaches neither
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """What a recording has of a motion, in the units and axes of the scenario.

    arrays: t_s (n,) and quantities, as an npz of bodycheck has them. resolution: name of each array -> the
    spacing of the numbers that the file can state, in the unit of the array: () for t_s, (3,) for a vector,
    (4,) for a quaternion, (3, 3) for a matrix. computed: the arrays that the file has in another form.
    without_omega: what the file has in place of an omega, which is then the derivative of its attitudes.
    unused_position: what the file has in place of a velocity with which a position starts that is left out.
    assumed: the option with the map that was not given, and why it is assumed; "" if there is none.
    """

    arrays: dict[str, Array]
    resolution: dict[str, Array]
    computed: frozenset[str] = frozenset()
    without_omega: str = ""
    unused_position: str = ""
    assumed: str = ""

    def unfilled(self, rate: Literal["velocity", "omega"]) -> str:
        """Return what of a rate is 0 in every row, but not its integral, as of a column that nothing fills.

        In words; "" if nothing is. A rate that is rounded to 0 has an integral, which is not counted.
        """
        name = next((name for name in self.arrays if name.startswith(rate)), "")
        if not name or (steps := self._steps(name)) is None:
            return ""
        rounded = self.resolution[name] * np.ptp(self.arrays["t_s"])
        noise = np.maximum(_MOVED * np.median(np.abs(steps), axis=0), _TURNED if rate == "omega" else 0.0)
        has_moved = np.max(np.abs(np.cumsum(steps, axis=0)), axis=0) > np.maximum(noise, rounded)
        sizes = np.linalg.norm(steps, axis=0)
        has_moved &= sizes > _PART * np.linalg.norm(sizes)
        is_zero = ~np.any(self.arrays[name], axis=0)
        lost = [axis for axis, is_lost in zip("xyz", is_zero & has_moved, strict=True) if is_lost]
        axes = "" if is_zero.all() else f" {'about' if rate == 'omega' else 'along'} {names(lost)}"
        return f"only zeros as {rate}{axes}" if lost else ""

    def _steps(self, rate: str) -> Array | None:
        """Return the change (n - 1, 3) of the integral of a rate, in its axes, to a sign; None without it."""
        if rate == "velocity_m_s":
            position = self.arrays.get("position_m")
            return None if position is None or len(position) < 2 else np.diff(position, axis=0)
        if (attitude := self._attitude) is None or len(attitude) < 2:
            return None
        # of the inverse attitudes: the turns in world axes, reversed
        in_world = rate == "omega_world_rad_s"
        return turns_between(conjugate(normalised(attitude)) if in_world else normalised(attitude))

    @property
    def _omegas(self) -> list[str]:
        return [name for name in ("omega_body_rad_s", "omega_world_rad_s") if name in self.arrays]

    @property
    def _attitude(self) -> Array | None:
        """The attitudes (n, 4); None without any."""
        if "rotation" in self.arrays and "quaternion" not in self.arrays:
            return matrix_to_quaternion(project_to_so3(self.arrays["rotation"]))
        return self.arrays.get("quaternion")

    def with_omega(self) -> RecordedMotion | None:
        """Return the recording with omega derived from its attitudes; None where it has too few."""
        arrays, spacings = (
            {name: values for name, values in given.items() if name not in self._omegas}
            for given in (self.arrays, self.resolution)
        )
        attitude = self._attitude
        if attitude is None:
            return None
        derived = derived_rates(arrays["t_s"], attitude, Resolution.of(spacings).attitude)
        if derived is None:
            return None
        arrays["omega_body_rad_s"], spacings["omega_body_rad_s"] = derived[0], np.full(3, derived[1])
        without = self.without_omega or self.unfilled("omega") or "no omega"
        return replace(self, arrays=arrays, resolution=spacings, without_omega=without)

    def with_omega_of(self, meant: Trajectory) -> RecordedMotion:
        """Return the recording with the omega that was meant, which has as many digits."""
        arrays, spacings = dict(self.arrays), dict(self.resolution)
        for name in self._omegas:
            read, right = arrays.pop(name), getattr(meant, name)
            if right is not None:
                arrays[name] = right
                spacings[name] = spacings[name] * (np.linalg.norm(right) / np.linalg.norm(read))
        return replace(self, arrays=arrays, resolution=spacings)

    def rows(self, start: int, stop: int) -> RecordedMotion | None:
        """Return a part of the recording, of a later start at times from 0; None if no omega is left."""
        arrays = {name: values[start:stop] for name, values in self.arrays.items()}
        if start:
            arrays["t_s"] = arrays["t_s"] - arrays["t_s"][0]
        part = replace(self, arrays=arrays)
        return part.with_omega() if self.without_omega else part

    def moved(self, quantity: str, rows: int) -> RecordedMotion:
        """Return the recording with attitude or omega moved by one row, 1 to the row before, -1 to the next.

        The row that has no other quantity any more is left out.
        """
        own, other = (slice(1, None), slice(None, -1))[::rows]
        names = ("quaternion", "rotation") if quantity == "attitude" else quantity
        arrays = {
            name: values[own if name.startswith(names) else other] for name, values in self.arrays.items()
        }
        return replace(self, arrays=arrays)


def recorded_motion(path: Path, column_map: ColumnMap, dt_s: float | None = None) -> RecordedMotion:
    """Return the quantities of a recording, and their resolution.

    dt_s: the interval between two rows of a file without times. A map that is missing is assumed if the file
    confirms it, or names axes and unit of omega. Raises InputError with one line that names the file and the
    fault, and the map that would do, if one is found.
    """
    recording = read_recording(path, column_map.topic)
    try:
        return _converted(recording, column_map, dt_s)
    except _UnmappedError as error:

        def arrays(proposed: ColumnMap, interval_s: float | None) -> dict[str, Array]:
            return _converted(recording, proposed, interval_s or dt_s).arrays

        option, confirmed, why = proposal(recording, column_map, arrays)
        if confirmed is not None:
            return replace(_converted(recording, confirmed, dt_s), assumed=f"{option} ({why})")
        remedy = f"try {option}" if option else "" if why else "--map 'NAME=COLUMN, ...' tells which is which"
        raise InputError("; ".join(filter(None, (str(error), why, remedy)))) from None


def _converted(recording: Recording, column_map: ColumnMap, dt_s: float | None) -> RecordedMotion:
    path = recording.path
    if recording.described:
        column_map = changed_map(column_map, [recording.described])
    if column_map.columns and not recording.is_named:
        recording = recording.renamed(column_map.columns)
    targets = _targets(recording, column_map, dt_s)
    found = _vectors(path, {name: target.values for name, target in targets.items()})
    if "t_s" not in found:
        raise _UnmappedError(f"{path}: has no t_s")
    stated = _vectors(path, _resolutions(targets))
    with np.errstate(invalid="ignore", over="ignore"):  # a diverged motion is an outcome, not an error
        try:
            arrays = checked_arrays(path, _in_scenario_axes(found, column_map))
        except _ConventionError as error:
            raise InputError(f"{path}: {error}") from None
        resolution = _resolution_in_scenario_axes(stated, arrays, column_map)
    return RecordedMotion(arrays, resolution, frozenset(arrays) - frozenset(found))


class _UnmappedError(InputError):
    """A map is missing, which may be proposed."""


class _ConventionError(ValueError):
    """Quantities that cannot be combined; the message says which."""


@dataclass(frozen=True, eq=False)
class _Target:
    """A quantity in SI units: scale x product of the columns (n,).

    spacing: of the columns of stamps. written: how each column is written, where its text shows it.
    """

    scale: float
    columns: tuple[Array, ...]
    rows: int
    spacing: float | None = None
    written: tuple[Callable[[], Digits | None], ...] = ()

    @classmethod
    def of(cls, recording: Recording, names: Sequence[str], scale: float = 1.0) -> _Target:
        """Return the product of some columns of a recording."""
        written = tuple(partial(recording.written_digits, name) for name in names)
        return cls(scale, tuple(map(recording.values, names)), recording.rows, None, written)

    @cached_property
    def values(self) -> Array:
        """The quantity (n,)."""
        product = np.ones(self.rows)
        for column in self.columns:
            product = product * column
        return product if self.columns and self.scale == 1.0 else product * self.scale

    @cached_property
    def shown(self) -> tuple[Digits | None, ...]:
        """How each of its columns is rounded, where its numbers show that."""
        return tuple(map(digits_of, self.columns))

    @cached_property
    def digits(self) -> tuple[Digits | None, ...]:
        """How each of its columns is rounded, where its numbers or their text show that."""
        if not self.written:
            return self.shown
        return tuple(digits or text() for digits, text in zip(self.shown, self.written, strict=True))

    def resolution(self, default: Digits) -> float:
        """Return the spacing of the quantity; default: of columns that do not show their digits."""
        if self.spacing is not None:
            return abs(self.scale) * self.spacing
        largest = [largest_finite(column) for column in self.columns]
        spacings = [
            (digits or default).spacing(one) for digits, one in zip(self.digits, largest, strict=True)
        ]
        return abs(self.scale) * sum(
            spacing * math.prod(largest[:index] + largest[index + 1 :])
            for index, spacing in enumerate(spacings)
        )


def _resolutions(targets: Mapping[str, _Target]) -> dict[str, Array]:
    """Return target -> resolution (1,): of its digits, else of those of its vector, else of the file's."""

    def finest(several: Iterable[Digits | None], default: Digits) -> Digits:
        known = [digits for digits in several if digits is not None]
        return max(known, key=lambda digits: digits.rank, default=default)

    others = [target.shown for name, target in targets.items() if name != "t_s"]
    of_file = finest(chain.from_iterable(others), OF_DOUBLES)
    found: dict[str, Array] = {}
    for vector in (("t_s",), *VECTORS.values()):
        present = [name for name in vector if name in targets]
        digits = finest(chain.from_iterable(targets[name].digits for name in present), of_file)
        found |= {name: np.array([targets[name].resolution(digits)]) for name in present}
    return found


def _stamped(recording: Recording, column: str, column_map: ColumnMap, scale: float) -> _Target:
    """Return the times of a column: less the first, where the map says so, before they are scaled."""
    subtracts = column_map.time_origin == "first-sample"
    stamps, spacing = recording.stamps(column, relative=subtracts)
    if not subtracts and any(isinstance(stamp, int) and abs(stamp) > EXACT for stamp in stamps):
        raise InputError(
            f"{recording.path}: {column} has integers above 2^53, which do not fit in doubles; "
            "--map time_origin=first-sample subtracts the first one exactly"
        )
    values = since_first(stamps) if subtracts else recording.values(column)
    return _Target(scale, (values,), recording.rows, spacing)


def _times(recording: Recording, column_map: ColumnMap, dt_s: float | None) -> _Target | None:
    """Return the times of a file that has none: of another file, or even ones."""
    if column_map.times:
        other = read_recording(Path(column_map.times), "")
        if other.rows != recording.rows:
            raise InputError(
                f"{other.path}: has {other.rows} times, but {recording.path} {recording.rows} rows"
            )
        return _stamped(other, other.names[0], column_map, 1.0)
    if dt_s is not None:
        return _Target(dt_s, (np.arange(recording.rows, dtype=np.float64),), recording.rows, 0.0)
    return None


def _targets(recording: Recording, column_map: ColumnMap, dt_s: float | None) -> dict[str, _Target]:
    """Return the quantities of a recording by name.

    Raises InputError where a column is neither used nor ignored.
    """
    path = recording.path
    found: dict[str, _Target] = {}
    used: set[str] = set()
    products = dict(column_map.products)
    for target, several in column_map.optional.items():
        fitting = (product for product in several if {*product.columns} <= {*recording.names})
        if target not in products and (product := next(fitting, None)):
            products[target] = product
    try:
        for target, product in products.items():
            scale, columns = product.settled(target, recording.names)
            used.update(columns)
            if target == "t_s" and len(columns) == 1:
                found[target] = _stamped(recording, columns[0], column_map, scale)
            else:
                found[target] = _Target.of(recording, columns, scale)
    except InputError as error:
        where = "" if str(error).startswith(str(path)) else f"{path}: "
        raise InputError(f"{where}{error}") from None
    standard = [name for name in recording.names if name in KINDS and not column_map.ignores(name)]
    for name in standard:
        if name == "t_s" and name not in found:
            found[name] = _stamped(recording, name, column_map, 1.0)
        elif name not in found:
            found[name] = _Target.of(recording, [name])
    if "t_s" not in found and (times := _times(recording, column_map, dt_s)) is not None:
        found["t_s"] = times
    unknown = [
        name
        for name in recording.names
        if name not in used
        and name not in KINDS
        and name.partition("[")[0] not in _IGNORED
        and name not in recording.metadata
        and name.partition("[")[0] not in COLUMNS
        and not column_map.ignores(name)
    ]
    if unknown:
        raise _UnmappedError(f"{path}: unknown trajectory column {_some(unknown)} (accepted: {ACCEPTED})")
    return found


def _some(columns: Sequence[str]) -> str:
    """Return a few columns, which leave room for the map that is proposed."""
    rest = len(columns) - _MAX_NAMED
    return names(columns) if rest <= 0 else f"{', '.join(columns[:_MAX_NAMED])} and {rest} more"


def _vectors(path: Path, targets: Mapping[str, Array]) -> dict[str, Array]:
    """Return t_s and the whole vectors and matrices; raises InputError where a component is missing."""
    found = {"t_s": targets["t_s"]} if "t_s" in targets else {}
    for array, columns in VECTORS.items():
        present = [column for column in columns if column in targets]
        if present and len(present) < len(columns):
            missing = ", ".join(column for column in columns if column not in targets)
            raise InputError(f"{path}: has {present[0]} but not {missing}")
        if present:
            stacked = np.stack([targets[column] for column in columns], axis=-1)
            found[array] = stacked.reshape(-1, 3, 3) if array == "rotation" else stacked
    return found


def _in_scenario_axes(found: dict[str, Array], column_map: ColumnMap) -> dict[str, Array]:
    """Return the quantities with rotations from the scenario's body axes to its world axes."""
    attitudes = [name for name in ATTITUDES if name in found]
    if len(attitudes) > 1 and set(attitudes) != {"quaternion", "rotation"}:
        named = [_ATTITUDE_NAMES[name] for name in attitudes]
        raise _ConventionError(f"has both {named[0]} and {named[1]}; ignore one of them")
    _check_combinations(found, column_map, has_attitude=bool(attitudes))
    arrays = {name: value for name, value in found.items() if name in ("t_s", *COLUMNS)}
    if "euler" in found:
        arrays["quaternion"] = _euler_quaternions(found["euler"], column_map.euler)
    for name, power in (("rodrigues", 1), ("modified_rodrigues", 2)):
        if name in found:
            arrays["quaternion"] = _rodrigues_quaternions(found[name], power)
    if column_map.attitude == "world-to-body":
        arrays |= _reversed(arrays)
    if "place" in found:
        local = _from_local_axes(found["t_s"], found["place"], column_map.earth_rate_rad_s)
        arrays = _rotated(arrays, local, quaternion_to_matrix(local), np.eye(3))
    if "velocity_body_m_s" in found:
        arrays["velocity_m_s"] = np.einsum("nij,nj->ni", _matrices(arrays), found["velocity_body_m_s"])
    if column_map.world is not None or column_map.body is not None:
        world = np.eye(3) if column_map.world is None else column_map.world
        body = np.eye(3) if column_map.body is None else column_map.body
        arrays = _rotated(arrays, matrix_to_quaternion(world), world, body)
    return arrays


def _check_combinations(found: Mapping[str, Array], column_map: ColumnMap, *, has_attitude: bool) -> None:
    """Raise _ConventionError for quantities that need another one, or that no frame gives a meaning."""
    if column_map.euler and "euler" not in found:
        raise _ConventionError(f"has no Euler angles: {', '.join(EULER)}")
    if "euler" in found and not column_map.euler:
        raise _ConventionError("Euler angles need the order of their axes, like euler=ZYX")
    if "velocity_body_m_s" in found and (not has_attitude or "velocity_m_s" in found):
        wrong = "need an attitude" if not has_attitude else "cannot be combined with velocities in world axes"
        raise _ConventionError(f"velocities in body axes {wrong}")
    if "place" not in found:
        return
    if other := set(found) & {"position_m", "velocity_m_s", "velocity_body_m_s", "omega_world_rad_s"}:
        raise _ConventionError(
            f"{names(sorted(other))} cannot be combined with longitude_rad and latitude_rad, which "
            "define only the attitude"
        )
    if found["t_s"][0] != 0.0:
        raise _ConventionError(
            "longitude_rad and latitude_rad need a sample at t_s = 0, where the axes of the world are north, "
            "east and down; time_origin=first-sample subtracts the first time"
        )


def _euler_quaternions(angles: Array, sequence: str) -> Array:
    """q = q1(a1) q2(a2) q3(a3) about body axes (ZYX), in reverse about world axes (zyx).

    Shapes: (n, 3) in rad -> (n, 4).
    """
    turns = [
        exp_quaternion(angles[:, index, None] * np.array(_AXES[axis]))
        for index, axis in enumerate(sequence.lower())
    ]
    first, second, third = turns if sequence.isupper() else turns[::-1]
    return quaternion_product(quaternion_product(first, second), third)


def _rodrigues_quaternions(parameters: Array, power: int) -> Array:
    """q = ((1, p) / |(1, p)|)^power of p = e tan(angle / (2 power)): classical (1) or modified (2).

    Shapes: (n, 3) -> (n, 4).
    """
    q = np.concatenate([np.ones((len(parameters), 1)), parameters], axis=-1)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return quaternion_product(q, q) if power == 2 else q


def _reversed(arrays: Mapping[str, Array]) -> dict[str, Array]:
    """Return the attitude as its inverse, without normalising it."""
    found = {}
    if "quaternion" in arrays:
        found["quaternion"] = conjugate(arrays["quaternion"])
    if "rotation" in arrays:
        found["rotation"] = np.swapaxes(arrays["rotation"], -1, -2)
    return found


def _from_local_axes(t_s: Array, position: Array, earth_rate_rad_s: float) -> Array:
    """Return the rotation from local north, east, down to those axes at the first sample, kept inertial.

    position: longitude and geodetic latitude (n, 2) in rad. Shapes: (n,), (n, 2) -> quaternions (n, 4).
    """
    longitude, latitude = position[:, 0] + earth_rate_rad_s * t_s, position[:, 1]
    inertial = quaternion_product(
        exp_quaternion(longitude[:, None] * np.array(_AXES["z"])),
        exp_quaternion(-(latitude[:, None] + 0.5 * np.pi) * np.array(_AXES["y"])),
    )
    return quaternion_product(conjugate(inertial[:1]), inertial)


def _rotated(arrays: Mapping[str, Array], turn: Array, world: Array, body: Array) -> dict[str, Array]:
    """Return vectors and attitudes in other axes of the world and of the body.

    turn: quaternions (4,) or (n, 4) of world, the matrices (3, 3) or (n, 3, 3) from the old axes to the new
    ones. body: (3, 3), likewise.
    """
    found = dict(arrays)
    for name in ("position_m", "velocity_m_s", "omega_world_rad_s"):
        if name in arrays:
            found[name] = np.einsum("...ij,...j->...i", world, arrays[name])
    if "omega_body_rad_s" in arrays:
        found["omega_body_rad_s"] = arrays["omega_body_rad_s"] @ body.T
    if "rotation" in arrays:
        found["rotation"] = world @ arrays["rotation"] @ body.T
    if "quaternion" in arrays:
        old = conjugate(matrix_to_quaternion(body))
        found["quaternion"] = quaternion_product(quaternion_product(turn, arrays["quaternion"]), old)
    return found


def _resolution_in_scenario_axes(
    stated: Mapping[str, Array], arrays: Mapping[str, Array], column_map: ColumnMap
) -> dict[str, Array]:
    """Return array -> resolution, as in RecordedMotion, for quantities as stated and as converted.

    A quantity that is computed from several columns gets the sum of what each of them leaves open.
    """
    axes_are_same = column_map.world is None and column_map.body is None and "place" not in stated
    found = {}
    for name, array in arrays.items():
        if name not in stated:
            source = next(
                one for one in _LARGEST_SLOPES if one in stated and (one in ATTITUDES) == (name in ATTITUDES)
            )
            found[name] = np.full(array.shape[1:], _LARGEST_SLOPES[source] * stated[source].sum())
            continue
        own = np.asarray(stated[name][0])
        if axes_are_same or name == "t_s":
            found[name] = own
        elif name in ("quaternion", "rotation"):
            found[name] = np.full(own.shape, np.max(own))
        else:
            axes = column_map.body if name == "omega_body_rad_s" else column_map.world
            found[name] = own if axes is None else np.abs(axes) @ own
    return found


def _matrices(arrays: Mapping[str, Array]) -> Array:
    return quaternion_to_matrix(arrays["quaternion"]) if "quaternion" in arrays else arrays["rotation"]
