"""The measures of one case: formula, departure from the truth, scale, bound, and how each is judged.

The columns of results.csv, the quantities of methods.csv, the plots, the gates and `bodycheck list measures`
all derive from `MEASURES`. To add a measure, add an entry there.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.imu import has_imu
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trees.joint_kind import JointKind, Translation
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.measurement.compared_motion import Compared
from bodycheck.reports.measurement.invariants import invariants_of, worst_drift
from bodycheck.reports.measurement.scales import Scales

IDENTITY = ("scenario", "family", "engine", "engine_version", "method")
"""The columns that identify a row's method, in each table but probes.csv."""

SIGNED = "_signed"
"""Suffix of the column of a measure with its sign."""

_NORM_FLOOR = 1e-12  # round-off of |q| and R^T R after millions of products, each renormalised
_DIRECTED = 0.1  # of its largest value: a smaller vector has no reliable direction

BoundKind: TypeAlias = Literal["rad", "energy", "momentum", "omega_rad_s", "m", "m_s"]
"""The truth's error bounds, `truth_bound_KIND` in results.csv.

The floor of a measure is its bound, divided by a scale of the true motion:
rad, of the attitude: by none;
energy, momentum: relative already, to the largest kinetic energy and |L|;
omega_rad_s, m, m_s: by the scale of omega, of length or of speed, unless the measure has no scale.
"""
Judgement: TypeAlias = Literal["limit", "property"]


@dataclass(frozen=True, eq=False)
class Measure:
    """One measure: the maximum of `series` over the samples, divided by a scale of the scene if it has one.

    departure: signed difference from the truth, (n,), (n, k) or, per body of a tree, (n, b, k), in SI
    units; None where the case does not define it. It is smooth in the step, so the limit under step
    refinement is computed from it. series: its size over time (n,) [default: the norm of the departure,
    the largest of any body]. scale: field of `Scales`; None if the measure needs none. unit: unit of the
    column `_abs`; "" if there is no such column. bound: which of the truth's error bounds applies. floor:
    error of the measure itself in one case, in the unit of the departure. needs: which of position,
    velocity, attitude and omega a trajectory must provide. judged: "limit": by its limit under step
    refinement; "property": as a property of the engine's state, not necessarily a fault; None: not
    judged. last_of: the measure of which this one is the last value. of: whether a scene has it [default:
    every scene]; a gate does not expect it of others. signed: whether the column `_signed`
    has the departure of the largest size with its sign, over the scale.
    """

    name: str
    formula: str
    departure: Callable[[Compared], Array | None] = lambda _: None
    needs: Callable[[Scene], frozenset[str]] = lambda _: frozenset()
    series: Callable[[Compared], Array | None] | None = None
    scale: str | None = None
    unit: str = ""
    bound: BoundKind | None = None
    floor: Callable[[Compared], float] = lambda _: 0.0
    judged: Judgement | None = "limit"
    last_of: str | None = None
    of: Callable[[Scene | TreeScene], bool] | None = None
    signed: bool = False

    def over_time(self, compared: Compared, departure: Array | None) -> Array | None:
        """Return the measure over time (n,), in SI units; None where the case does not define it."""
        if self.series is not None:
            return self.series(compared)
        return None if departure is None else _over_bodies(np.linalg.norm(departure, axis=-1))

    @property
    def absolute_formula(self) -> str:
        """The formula of the column `_abs`, which is not divided by the scale, with its unit."""
        return f"{re.sub(',? over [^;]*', '', self.formula)}, in {self.unit}"

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of results.csv."""
        absolute, signed = [f"{self.name}_abs"] * bool(self.unit), [f"{self.name}{SIGNED}"] * self.signed
        return (self.name, *absolute, *signed)


def _needing(*quantities: str) -> Callable[[Scene], frozenset[str]]:
    return lambda _: frozenset(quantities)


def _is_body(scene: Scene | TreeScene) -> bool:
    return not isinstance(scene, TreeScene)


def _joints(scene: Scene | TreeScene) -> list[JointKind]:
    """Return the kinds of the joints of a tree; none for one body."""
    return [one.joint.of_kind for one in scene.bodies] if isinstance(scene, TreeScene) else []


def _turns(scene: Scene | TreeScene) -> bool:
    return any(kind.rotation and kind.translation is not Translation.SPACE for kind in _joints(scene))


def _slides(scene: Scene | TreeScene) -> bool:
    return any(kind.translation is Translation.AXIS for kind in _joints(scene))


def _needed_by_energy(scene: Scene) -> frozenset[str]:
    """Return the quantities that E depends on: the potential adds the position, the attitude or both."""
    needed = {"position"} if scene.gravity.any() else set()
    return frozenset({"velocity", "omega"} | needed).union(
        *(load.potential_needs for load in scene.continuous_loads)
    )


def _over_bodies(values: Array) -> Array:
    """Return values (n,) as they are, and of several bodies (n, b) the largest."""
    return np.asarray(values if values.ndim == 1 else np.max(values, axis=1))


def _attitude_departure(compared: Compared) -> Array:
    """(R - R*) / sqrt 2 as (n, 9), of norm 2 sin(angle / 2); unlike an angle, it has no jump at pi."""
    difference = compared.trajectory.rotation_matrices - compared.truth.rotation_matrices
    return difference.reshape(*difference.shape[:-2], 9) / math.sqrt(2.0)


def _gram_departure(compared: Compared) -> Array | None:
    rotation = compared.trajectory.rotation
    if rotation is None:
        return None
    return (np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).reshape(*rotation.shape[:-2], 9)


def _determinant_departure(compared: Compared) -> Array | None:
    rotation = compared.trajectory.rotation
    return None if rotation is None else np.asarray(np.linalg.det(rotation) - 1.0)[..., None]


def _norm_apart(compared: Compared) -> Array | None:
    q = compared.trajectory.quaternion
    return None if q is None else np.asarray(np.linalg.norm(q, axis=-1) - 1.0)[..., None]


def _invariants_apart(compared: Compared) -> Array | None:
    """Return the relative departures of all invariants (n, m)."""
    departures = [one.relative for one in compared.invariant_drifts if one.relative is not None]
    return np.stack(departures, axis=-1) if departures else None


def _worst_invariant(compared: Compared) -> Array | None:
    """Return the drift of the invariant that departs farthest while the truth can be trusted."""
    worst = worst_drift(compared.invariant_drifts)
    relative = None if worst is None else worst.relative
    return None if relative is None else np.abs(relative)


def _angle_between_momenta(compared: Compared) -> Array | None:
    """Return the angle between L and L* (n,), 0 where |L*| is below a tenth of its largest value."""
    momentum, true = compared.motion.angular_momentum, compared.true.angular_momentum
    sizes = np.linalg.norm(true, axis=-1)
    if not sizes.any():
        return None
    across = np.linalg.norm(np.cross(momentum, true), axis=-1)
    angles = np.arctan2(across, np.sum(momentum * true, axis=-1))
    return np.where(sizes >= _DIRECTED * sizes.max(), angles, 0.0)


_ALL = (
    Measure(
        "energy_drift",
        "max |E - E*| over the largest true kinetic energy; E = K + U",
        lambda c: c.motion.energy - c.true.energy,
        _needed_by_energy,
        scale="energy_scale_j",
        unit="J",
        bound="energy",
        signed=True,
    ),
    Measure(
        "rotational_energy_drift",
        "max |Kr - Kr*| over max Kr*; Kr = omega . I omega / 2",
        lambda c: c.motion.rotational - c.true.rotational,
        _needing("omega"),
        scale="rotational_energy_scale_j",
        unit="J",
        bound="energy",
        signed=True,
    ),
    Measure(
        "energy_balance",
        "max |E - E(0) - W| over the largest true kinetic energy; W = work of the loads",
        lambda c: None if c.balance is None else c.balance[0],
        _needing("position", "velocity", "omega", "attitude"),
        scale="energy_scale_j",
        unit="J",
        bound="energy",
        floor=lambda c: 0.0 if c.balance is None else c.balance[1],
    ),
    Measure(
        "angular_momentum_drift",
        "max |L - L*| over max |L*|; the vector in world axes",
        lambda c: c.motion.angular_momentum - c.true.angular_momentum,
        _needing("attitude", "omega"),
        scale="angular_momentum_scale_kg_m2_s",
        unit="kg m^2/s",
        bound="momentum",
    ),
    Measure(
        "angular_momentum_direction_error_rad",
        "max angle between L and L*, where |L*| is at least a tenth of its largest",
        needs=_needing("attitude", "omega"),
        series=_angle_between_momenta,
        bound="momentum",
        judged=None,
    ),
    Measure(
        "linear_momentum_drift",
        "max |P - P*| over mass x speed scale",
        lambda c: c.motion.linear_momentum - c.true.linear_momentum,
        _needing("velocity"),
        scale="linear_momentum_scale_kg_m_s",
        unit="kg m/s",
        bound="m_s",
    ),
    Measure(
        "invariant_drift",
        "max |C - C*| of the scene's worst invariant, named in `invariant`, over its size",
        _invariants_apart,
        series=_worst_invariant,
        unit="SI unit of the invariant",
        bound="momentum",
        of=lambda scene: bool(invariants_of(scene)),
    ),
    Measure(
        "orthogonality_error",
        "max ||R^T R - I||_F of the matrix that the engine itself gives",
        _gram_departure,
        _needing("attitude"),
        floor=lambda _: _NORM_FLOOR,
        judged="property",
        of=_is_body,
    ),
    Measure(
        "determinant_error",
        "max |det R - 1| of the same matrix",
        _determinant_departure,
        _needing("attitude"),
        floor=lambda _: _NORM_FLOOR,
        judged=None,
        of=_is_body,
    ),
    Measure(
        "quaternion_norm_error",
        "max ||q| - 1| of the quaternion that the engine itself holds",
        _norm_apart,
        _needing("attitude"),
        floor=lambda _: _NORM_FLOOR,
        judged="property",
    ),
    Measure(
        "orientation_error_rad",
        "max geodesic angle to the truth",
        _attitude_departure,
        _needing("attitude"),
        series=lambda c: _over_bodies(geodesic_angle(c.truth.attitude, c.trajectory.attitude)),
        bound="rad",
    ),
    Measure(
        "orientation_error_final_rad",
        "geodesic angle to the truth at the end",
        needs=_needing("attitude"),
        bound="rad",
        judged=None,
        last_of="orientation_error_rad",
    ),
    Measure(
        "omega_error",
        "max |omega - omega*| in body axes over max |omega*|",
        lambda c: c.trajectory.omega_body - c.truth.omega_body,
        _needing("omega"),
        scale="omega_scale_rad_s",
        unit="rad/s",
        bound="omega_rad_s",
    ),
    Measure(
        "imu_error",
        "max |a - a*| of the engine's accelerometer over max |a*|, or of its gyro over max |omega*|",
        lambda c: None if c.imu is None else c.imu.departure(c.trajectory),
        _needing("attitude", "omega"),
        bound="omega_rad_s",
        floor=lambda _: _NORM_FLOOR,
        of=lambda scene: not isinstance(scene, TreeScene) and has_imu(scene),
    ),
    Measure(
        "position_error",
        "max |x - x*| over the length scale",
        lambda c: c.trajectory.position_m - c.truth.position_m,
        _needing("position"),
        scale="length_scale_m",
        unit="m",
        bound="m",
    ),
    Measure(
        "velocity_error",
        "max |v - v*| over the speed scale",
        lambda c: c.trajectory.velocity_m_s - c.truth.velocity_m_s,
        _needing("velocity"),
        scale="speed_scale_m_s",
        unit="m/s",
        bound="m_s",
    ),
    Measure(
        "joint_error_rad",
        "max |q - q*| of any hinge, and the angle to the truth of any ball joint; of trees",
        lambda c: None if c.joints is None else c.joints.angles,
        series=lambda c: None if c.joints is None else c.joints.largest("rad"),
        bound="rad",
        of=_turns,
    ),
    Measure(
        "joint_error_m",
        "max |q - q*| of any slide; of trees",
        lambda c: None if c.joints is None else c.joints.lengths,
        series=lambda c: None if c.joints is None else c.joints.largest("m"),
        bound="m",
        of=_slides,
    ),
    Measure(
        "constraint_drift_m",
        "max distance between the points that a joint holds together, of engines that store poses",
        series=lambda c: None if c.joints is None else c.joints.gap_m,
        judged=None,
        of=lambda scene: bool(_joints(scene)),
    ),
    Measure(
        "constraint_drift_rad",
        "max angle by which a joint turns otherwise than it permits, of engines that store poses",
        series=lambda c: None if c.joints is None else c.joints.gap_rad,
        judged=None,
        of=lambda scene: bool(_joints(scene)),
    ),
)

MEASURES = {measure.name: measure for measure in _ALL}
"""All measures by name, in column order."""

ORIENTATION = "orientation_error_rad"
"""The measure that represents a method where only one is shown."""

QUANTITIES = (ORIENTATION, *(m.name for m in _ALL if m.judged is not None and m.name != ORIENTATION))
"""The judged measures. Each has one row of methods.csv per method and scenario."""

MEASURE_OF = {column: measure for measure in _ALL for column in measure.columns}
"""Column of results.csv -> the measure that it is of."""

SCALES = {measure.name: measure.scale for measure in _ALL if measure.scale is not None}
"""Measure -> the scale that it is divided by. The column `_abs` has the undivided value in SI units."""


def scale_of(columns: Mapping[str, Any], measure: str) -> float:
    """Return the divisor of a measure over time: 1 where it needs no scale, 0 where nothing moves.

    columns: of results.csv, either of one case or those shared by all cases of a scenario.
    """
    return float(columns[SCALES[measure]]) if measure in SCALES else 1.0


def departures_of(compared: Compared) -> dict[str, Array]:
    """Return the signed departure from the truth (n, k), in SI units, of each measure the case defines."""
    found = ((measure.name, measure.departure(compared)) for measure in _ALL)
    return {
        name: values[:, None] if values.ndim == 1 else values for name, values in found if values is not None
    }


def series_of(compared: Compared, departures: Mapping[str, Array]) -> dict[str, Array]:
    """Return each measure that the trajectory defines over time (n,), in SI units; its max is reported."""
    found = ((measure.name, measure.over_time(compared, departures.get(measure.name))) for measure in _ALL)
    return {name: values for name, values in found if values is not None}


def reduced(series: Mapping[str, Array], departures: Mapping[str, Array], scales: Scales) -> dict[str, float]:
    """Return the maxima over time: divided by the scale where that is not 0, and as `_abs` in SI units.

    departures: from the truth (n, k), of which the largest one also gets its sign in `_signed`.
    """
    columns: dict[str, float] = {}
    for name, values in series.items():
        largest = float(np.max(values))
        if name not in SCALES:
            columns[name] = largest
            continue
        columns[f"{name}_abs"] = largest
        scale = getattr(scales, SCALES[name])
        if scale > 0.0:
            columns[name] = largest / scale
            if MEASURES[name].signed and name in departures:
                columns[f"{name}{SIGNED}"] = float(departures[name][np.argmax(values)].flat[0]) / scale
    for measure in _ALL:
        if measure.last_of is not None and measure.last_of in series:
            columns[measure.name] = float(series[measure.last_of][-1])
    return columns


def gain_word(signed: float) -> str:
    """Return whether a signed drift gains or loses."""
    return "gains" if signed > 0.0 else "loses"
