"""The truth of a tree in motion, with bounds: two series in double-doubles, and neighbouring motions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle, quaternion_product
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy, TooManyStepsError
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.tree_motion import (
    TreeMotion,
    TreeSeries,
    TreeSolution,
    length_of,
    tree_motion,
)
from bodycheck.reference_impl.trees.tree_scene import TreeScene

TREE_QUANTITIES = (
    *("joint_rad", "joint_m", "joint_rad_s", "joint_m_s", "rad", "m", "omega_rad_s", "m_s"),
    *("energy_j", "momentum_n_s", "angular_momentum_n_m_s"),
)
"""The quantities for which the truth of a tree has bounds, the largest of any joint or body."""

_FINE, _CHECK, _NUDGED = (
    SeriesAccuracy(30, 1e-32, 19),
    SeriesAccuracy(34, 1e-33, 21),
    SeriesAccuracy(18, 1e-17),
)
_NUDGE, _FINE_NUDGE = 1e-10, 1e-22  # rad, or relative to the largest rate or length
_PROPORTIONAL = 1e-2  # rad, or relative: the distance up to which nudges grow in proportion to their size
_MARGIN = 10.0
_HALF_ULP, _EPS, _EPS_PAIR = 2.0**-53, 2.0**-52, 2.0**-104
_SHIFT = 2.0**-24  # of a small change that doubles resolve
_TRUSTED = 1e-10  # rad, or relative: the largest bound with which the motion may serve as the reference
_PLAIN_EXPONENT, _FARTHEST = 20, 400  # of two, as for single bodies


@dataclass(frozen=True, eq=False)
class TreeTruth:
    """The motion of a tree, and bounds on its error at each sample (n,), by TREE_QUANTITIES.

    joint_*: coordinates and rates of joints with a parent's axes, the angle between attitudes of a ball;
    the others: attitude, position, omega in body axes and velocity of bodies, energy and momenta. SI units.
    bounds: of the truth. round_offs: eps x sensitivity, what any stepper in double precision errs by.
    trusted_until_s: the first sample at which a bound exceeds 1e-10 rad or 1e-10 of its scale, else infinite.
    """

    motion: TreeMotion
    bounds: Mapping[str, Array]
    round_offs: Mapping[str, Array]
    trusted_until_s: float = math.inf
    kind: str = "certified"

    @property
    def end_reason(self) -> str:
        """Why samples beyond trusted_until_s are not compared."""
        return "the motion is chaotic"


def certified_tree(scene: TreeScene, t_s: Array) -> TreeTruth:
    """bound = 10 (|difference of two series| + 2^-104 steps sensitivity max M_ii / d_i) + half an ulp.

    t_s (n,) in s, not negative, in any order. Raises ValueError, naming the time, where there is no truth.
    """
    for t in t_s[~(np.isfinite(t_s) & (t_s >= 0.0))]:
        raise ValueError(f"a truth needs times that are finite and not negative, not {float(t)!r}")
    if np.any(np.diff(t_s) < 0.0):
        order = np.argsort(t_s, kind="stable")
        return _reordered(certified_tree(scene, t_s[order]), np.argsort(order, kind="stable"))
    solution = certified_series(scene, t_s)
    motion, errors = solution.motion, solution.errors
    bounds = np.maximum.accumulate(errors + _rounding(scene, motion), axis=1)
    lost = np.any(errors > _TRUSTED * tree_scales(scene, motion), axis=0)
    until = float(t_s[np.argmax(lost)]) if lost.any() else math.inf
    named = [dict(zip(TREE_QUANTITIES, rows, strict=True)) for rows in (bounds, _EPS * solution.growths)]
    return TreeTruth(motion, named[0], named[1], until)


def _reordered(truth: TreeTruth, order: NDArray[np.intp]) -> TreeTruth:
    names = [one.name for one in fields(truth.motion)]
    motion = replace(truth.motion, **{name: getattr(truth.motion, name)[order] for name in names})
    bounds, round_offs = (
        {name: row[order] for name, row in rows.items()} for rows in (truth.bounds, truth.round_offs)
    )
    return replace(truth, motion=motion, bounds=bounds, round_offs=round_offs)


@dataclass(frozen=True, eq=False)
class CertifiedSeries:
    """A solution in double-doubles, its motion in doubles, and errors and growths (11, n) of the solution."""

    solution: TreeSolution
    motion: TreeMotion
    errors: Array
    growths: Array


def certified_series(scene: TreeScene, t_s: Array) -> CertifiedSeries:
    """Return the solution by series of order 30, and what bounds it; t_s as for `certified_tree`."""
    solver = _Solver(scene, t_s)
    fine, check = solver.solve(_FINE), solver.solve(_CHECK)
    _check_finite(fine, t_s)
    motion = tree_motion(scene, t_s, fine.q, fine.u)
    growths = _growths(solver, motion, fine)
    gaps = _small_distances(scene, motion, _difference(check.q, fine.q), _difference(check.u, fine.u))
    steps, ratio = max(fine.steps, check.steps), max(fine.ratio, check.ratio)
    errors = _MARGIN * _known(gaps + _EPS_PAIR * growths * (1 + steps) * ratio)
    return CertifiedSeries(fine, motion, errors, growths)


class _Solver:
    """A scene at some times, in a unit of time near the last one if that is far from 1 s."""

    def __init__(self, scene: TreeScene, t_s: Array) -> None:
        exponent = math.frexp(float(t_s[-1]))[1] if len(t_s) else 0
        self._exponent = max(-_FARTHEST, min(exponent, _FARTHEST)) if abs(exponent) > _PLAIN_EXPONENT else 0
        self.scene, self.t_s = scene, t_s
        self._packed: dict[SeriesAccuracy, TreeSeries] = {}

    def solve(
        self, accuracy: SeriesAccuracy, dq: Array | float = 0.0, du: Array | float = 0.0
    ) -> TreeSolution:
        """Follow the motion from the start, changed by dq and du however little, in double-doubles."""
        scene, exponent = self.scene, self._exponent
        if accuracy not in self._packed:
            other = scene.in_time_unit(exponent) if exponent else scene
            self._packed[accuracy] = TreeSeries(other, accuracy)
        q, u = (scene.q0, np.zeros_like(scene.q0) + dq), (scene.u0, np.zeros_like(scene.u0) + du)
        faster = np.ldexp(u[0], exponent), np.ldexp(u[1], exponent)
        try:
            found = self._packed[accuracy].solve(q, faster, np.ldexp(self.t_s, -exponent))
        except TooManyStepsError as error:
            raise ValueError(f"there is no truth at t = {float(self.t_s[-1])!r} s: {error}") from None
        high, low = (np.ldexp(part, -exponent) for part in found.u)
        return replace(found, u=(high, low))


def _check_finite(solution: TreeSolution, t_s: Array) -> None:
    """Raise ValueError for a motion that could not be followed."""
    finite = np.isfinite(solution.q[0]).all(axis=1) & np.isfinite(solution.u[0]).all(axis=1)
    if not finite.all():
        singular = not math.isfinite(solution.ratio)
        reason = "the mass matrix is singular" if singular else "it leaves the range of double precision"
        raise ValueError(f"there is no truth at t = {float(t_s[int(np.argmin(finite))])!r} s: {reason}")


def _difference(one: tuple[Array, Array], other: tuple[Array, Array]) -> Array:
    return (one[0] - other[0]) + (one[1] - other[1])


def _known(errors: Array) -> Array:
    """Return the errors, infinite where they are unknown."""
    return np.where(np.isnan(errors), np.inf, errors)


# ----------------------------------------------------------------------------------------- distances


def tree_distances(scene: TreeScene, one: TreeMotion, other: TreeMotion) -> Array:
    """Return the distances (11, n) between two motions at the same times, one row per TREE_QUANTITIES."""
    n = len(one.t_s)
    found = {name: np.zeros(n) for name in TREE_QUANTITIES}
    for body, in_q, in_u in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        kind = body.joint.of_kind
        if kind.translation is Translation.SPACE:
            continue
        q, u = other.q[:, in_q] - one.q[:, in_q], other.u[:, in_u] - one.u[:, in_u]
        moved = int(kind.translation)
        if kind.translation:
            found["joint_m"] = np.maximum(found["joint_m"], np.abs(q[:, 0]))
            found["joint_m_s"] = np.maximum(found["joint_m_s"], np.abs(u[:, 0]))
        if kind.rotation:
            angle = np.abs(q[:, -1])
            if kind.rotation is Rotation.BALL:
                angle = geodesic_angle(one.q[:, in_q][:, -4:], other.q[:, in_q][:, -4:])
            found["joint_rad"] = np.maximum(found["joint_rad"], angle)
            found["joint_rad_s"] = np.maximum(found["joint_rad_s"], np.linalg.norm(u[:, moved:], axis=1))
    found["rad"] = np.max(geodesic_angle(one.quaternion, other.quaternion), axis=1)
    for name, values, others in (
        ("m", one.position, other.position),
        ("omega_rad_s", one.omega_body, other.omega_body),
        ("m_s", one.velocity, other.velocity),
        ("momentum_n_s", one.momentum[:, None], other.momentum[:, None]),
        ("angular_momentum_n_m_s", one.angular_momentum[:, None], other.angular_momentum[:, None]),
        ("energy_j", one.energy[:, None, None], other.energy[:, None, None]),
    ):
        found[name] = np.max(np.linalg.norm(others - values, axis=-1), axis=1)
    return np.array([found[name] for name in TREE_QUANTITIES])


def tree_scales(scene: TreeScene, motion: TreeMotion) -> Array:
    """Return the scales (11, 1) of `tree_distances`: 1 rad, and the largest value along the motion.

    Lengths: the largest distance from the start, or of a joint from a centre of mass; speeds: the largest,
    or omega times that length. Energy: kinetic. Momentum: that of the masses, without regard to direction.
    """
    masses = np.array([body.mass for body in scene.bodies])
    largest = [np.max(np.linalg.norm(part, axis=-1)) for part in (motion.omega_body, motion.velocity)]
    length = max(
        float(np.max(np.linalg.norm(motion.position - motion.position[:1], axis=-1))), length_of(scene)
    )
    omega, speed = float(largest[0]), max(float(largest[1]), float(largest[0]) * length)
    kinetic = float(np.max(motion.kinetic))
    momentum = float(np.max(np.linalg.norm(motion.velocity, axis=-1) @ masses))
    scales = [1.0, length, omega, speed, 1.0, length, omega, speed, kinetic, momentum, momentum * length]
    found = np.array(scales)[:, None]
    return np.where(found > 0.0, found, 1.0)


def _small_distances(scene: TreeScene, motion: TreeMotion, q: Array, u: Array) -> Array:
    """Return the distances (11, n) between a motion and the same changed by q, u, however little.

    The change is magnified until doubles resolve it, and the result is divided by the same factor.
    """
    sizes = np.concatenate([np.abs(q), np.abs(u)], axis=1)
    scales = np.max(np.abs(np.concatenate([motion.q, motion.u], axis=1)), axis=0)
    turned = np.concatenate([_is_turned(scene), np.zeros(u.shape[1], bool)])
    scales = np.where(turned, 1.0, scales)
    share = np.max(np.where(scales > 0.0, sizes / np.where(scales > 0.0, scales, 1.0), 0.0), axis=1)
    factor = np.where((share > 0.0) & (share < _SHIFT), _SHIFT / np.where(share > 0.0, share, 1.0), 1.0)
    changed = (motion.q + factor[:, None] * q, motion.u + factor[:, None] * u)
    return tree_distances(scene, motion, tree_motion(scene, motion.t_s, *changed)) / factor


def _is_turned(scene: TreeScene) -> Array:
    """Which coordinates (nq,) are angles or parts of quaternions."""
    found: list[bool] = []
    for body in scene.bodies:
        kind = body.joint.of_kind
        moved = (0, 1, 3)[kind.translation]
        found += [False] * moved + [True] * (kind.coordinates - moved)
    return np.array(found)


def _rounding(scene: TreeScene, motion: TreeMotion) -> Array:
    """Return the distances (11, n) caused by rounding each number of the motion to a double."""
    none = tree_motion(scene, motion.t_s, motion.q, motion.u)
    still = replace(
        none,
        **{
            name: np.zeros_like(getattr(none, name))
            for name in ("u", "position", "velocity", "omega_body", "kinetic", "potential", "momentum")
        },
        angular_momentum=np.zeros_like(none.angular_momentum),
        q=np.where(_is_quaternion(scene), none.q, 0.0),
    )
    found = _HALF_ULP * tree_distances(scene, still, motion)
    for name in ("joint_rad", "rad"):
        found[TREE_QUANTITIES.index(name)] += _EPS  # of quaternions
    energy = TREE_QUANTITIES.index("energy_j")
    found[energy] += 2.0 * _HALF_ULP * (np.abs(motion.kinetic) + np.abs(motion.potential))
    return found


def _is_quaternion(scene: TreeScene) -> Array:
    found: list[bool] = []
    for body in scene.bodies:
        kind = body.joint.of_kind
        turned = kind.rotation is Rotation.BALL
        found += [False] * (kind.coordinates - 4 * turned) + [True] * (4 * turned)
    return np.array(found)


# ---------------------------------------------------------------------------------------- sensitivity


def _growths(solver: _Solver, motion: TreeMotion, fine: TreeSolution) -> Array:
    """Return the largest growth (11, n) of a small nudge of the start up to each time, relative to its size.

    At least that of a steady motion. Where nudges in doubles saturate, smaller ones in double-doubles.
    """
    scene, scales, nudges = solver.scene, tree_scales(solver.scene, motion), _nudges(solver.scene, motion)

    def growths_of(size: float, accuracy: SeriesAccuracy, start: TreeSolution) -> Array:
        found = np.zeros((len(TREE_QUANTITIES), len(solver.t_s)))
        for dq, du in nudges:
            other = solver.solve(accuracy, size * dq, size * du)
            change = _difference(other.q, start.q), _difference(other.u, start.u)
            found = np.maximum(found, _known(_small_distances(scene, motion, *change)) / size)
        return found

    growths = growths_of(_NUDGE, _NUDGED, solver.solve(_NUDGED))
    if np.max(growths * _NUDGE / scales, initial=0.0) > _PROPORTIONAL:
        growths = growths_of(_FINE_NUDGE, _FINE, fine)
    omega = scales[TREE_QUANTITIES.index("omega_rad_s")]
    return np.maximum.accumulate(np.maximum(growths, (1.0 + omega * solver.t_s) * scales), axis=1)


def _nudges(scene: TreeScene, motion: TreeMotion) -> list[tuple[Array, Array]]:
    """Return the unit changes of q0 and u0: of each coordinate but a free body's position, and of each rate.

    1 rad, or the scale of lengths, angular velocities or velocities.
    """
    scale = dict(zip(TREE_QUANTITIES, tree_scales(scene, motion)[:, 0], strict=True))
    found: list[tuple[Array, Array]] = []
    for body, in_q, in_u in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        kind, dq, du = body.joint.of_kind, np.zeros_like(scene.q0), np.zeros_like(scene.u0)
        moved = (0, 1, 3)[kind.translation]
        for i in range(kind.rates):
            unit = scale["m_s"] if i < moved else scale["omega_rad_s"]
            found.append((dq, _at(du, in_u.start + i, unit)))
        if kind.translation is Translation.AXIS:
            found.append((_at(dq, in_q.start, scale["m"]), du))
        if kind.rotation is Rotation.AXIS:
            found.append((_at(dq, in_q.start + moved, 1.0), du))
        elif kind.rotation is Rotation.BALL:
            place = slice(in_q.stop - 4, in_q.stop)
            for axis in np.eye(3):
                turned = dq.copy()
                turned[place] = quaternion_product(scene.q0[place], np.array([0.0, *(0.5 * axis)]))
                found.append((turned, du))
    return found


def _at(zeros: Array, i: int, value: float) -> Array:
    changed = zeros.copy()
    changed[i] = value
    return changed
