"""The motion of a tree: coordinates and rates by Taylor series, and what the bodies do."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import inf
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import gyration_radius
from bodycheck.reference_impl.kernels.generic_precision import Numbers, high_part, put
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy, TooManyStepsError
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.tree_equations import (
    ANGULAR,
    BODY_OMEGA,
    KINETIC,
    MOMENTUM,
    POSITION,
    POTENTIAL,
    QUATERNION,
    VELOCITY,
    TreeEquations,
    tree_equations,
)
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.trees.tree_series import Integers, evaluate, put_state
from bodycheck.reference_impl.trees.tree_steps import (
    DERIVED,
    PLACE,
    SPEED,
    SPIN,
    TURNED,
    TreeNumbers,
    Workspace,
    integrate_tree,
)

_STEPS_PER_CALL = 2_000  # after which compiled code returns, so that Ctrl-C is handled
_MOST_STEPS = 1e6


@dataclass(frozen=True, eq=False)
class TreeMotion:
    """n samples of a tree of b bodies: t_s (n,), coordinates q (n, nq) and rates u (n, nu) of `TreeScene`.

    position and velocity (n, b, 3) of the centres of mass, world axes; quaternion (n, b, 4), body to world;
    omega_body (n, b, 3). kinetic and potential (n,) in J, 0 at the origin of the world and for springs at
    rest; momentum and angular_momentum (n, 3) about the origin of the world, world axes.
    """

    t_s: Array
    q: Array
    u: Array
    position: Array
    quaternion: Array
    velocity: Array
    omega_body: Array
    kinetic: Array
    potential: Array
    momentum: Array
    angular_momentum: Array

    @cached_property
    def energy(self) -> Array:
        """K + U (n,) in J."""
        return self.kinetic + self.potential


def tree_motion(scene: TreeScene, t_s: Array, q: Numbers, u: Numbers) -> TreeMotion:
    """Return what the bodies do at coordinates q (n, nq) and rates u (n, nu), doubles or double-doubles.

    Quaternions may have any norm; the results are rounded to doubles once, from double-doubles.
    """
    equations = tree_equations(scene)
    pairs = [part if isinstance(part, tuple) else (part, np.zeros_like(part)) for part in (q, u)]
    (q_high, q_low), (u_high, u_low) = ([np.ascontiguousarray(half) for half in pair] for pair in pairs)
    rows, count = equations.rows, len(t_s)
    wanted = np.concatenate([equations.poses.ravel(), equations.totals])
    series = (np.zeros((len(rows.rows), 2)), np.zeros((len(rows.rows), 2)))  # accelerations read order 1
    found = np.empty((count, len(wanted)))
    _put_outputs(
        kernel_numbers(scene, equations),
        wanted,
        (q_high, q_low),
        (u_high, u_low),
        series,
        found,
    )
    poses = found[:, : equations.poses.size].reshape(count, *equations.poses.shape)
    totals = found[:, equations.poses.size :]
    return TreeMotion(
        t_s,
        q_high,
        u_high,
        poses[..., POSITION : POSITION + 3],
        poses[..., QUATERNION : QUATERNION + 4],
        poses[..., VELOCITY : VELOCITY + 3],
        poses[..., BODY_OMEGA : BODY_OMEGA + 3],
        totals[:, KINETIC],
        totals[:, POTENTIAL],
        totals[:, MOMENTUM : MOMENTUM + 3],
        totals[:, ANGULAR : ANGULAR + 3],
    )


def kernel_numbers(scene: TreeScene, equations: TreeEquations) -> TreeNumbers:
    """Return the equations as the kernels take them, in double-doubles."""
    rows, response = equations.rows, equations.response
    kinds = [body.joint.of_kind for body in scene.bodies]
    joints = [
        ((0, 1, 3)[kind.translation], int(kind.rotation), row)
        for kind, row in zip(kinds, equations.joints, strict=True)
    ]
    return TreeNumbers(
        rows.rows,
        rows.terms,
        rows.constants,
        response.rows,
        response.ends,
        response.sources,
        response.others,
        response.constants,
        response.columns,
        response.column_ends,
        response.kept,
        equations.unknowns,
        equations.ahead,
        equations.results,
        np.array([equations.main, equations.end]),
        np.array(joints, dtype=np.int64),
        equations.sines,
        equations.sine_rows,
    )


def rounded(record: TreeNumbers | Workspace) -> Any:
    """Return a record of the kernels in doubles."""
    return type(record)(*map(high_part, record))


def rate_rows(scene: TreeScene, equations: TreeEquations) -> Integers:
    """Return the rows of all rates (nu,)."""
    layout = _State(scene, equations)
    return layout.rows[layout.u]


def workspace(equations: TreeEquations, orders: int) -> Workspace:
    """Return zeros for the kernels, in double-doubles; orders: the number of terms of the series."""
    rows, rates = len(equations.rows.rows), len(equations.unknowns)
    shapes = (rates, rates), (len(equations.response.sources), 1), (rows, 1), (rates, 1), (rows, orders)
    return Workspace(*((np.zeros(shape), np.zeros(shape)) for shape in shapes))


@kernel
def _put_outputs(
    tree: TreeNumbers,
    wanted: Integers,
    q: tuple[Array, Array],
    u: tuple[Array, Array],
    series: Numbers,
    found: Array,
) -> None:
    """Set found (n, m) to the high parts of the wanted rows at each state q (n, nq), u (n, nu)."""
    none, no_rows = np.zeros((0, 2)), np.zeros(0, np.int64)
    rows, main = tree.rows, tree.segments[0]
    coordinates, count = q[0].shape[1], u[0].shape[1]
    place = np.zeros((coordinates, 1)), np.zeros((coordinates, 1))
    rates = np.zeros((count, 1)), np.zeros((count, 1))
    for sample in range(len(found)):
        for i in range(coordinates):
            put(place, i, 0, (q[0][sample, i], q[1][sample, i]))
        for i in range(count):
            put(rates, i, 0, (u[0][sample, i], u[1][sample, i]))
        put_state(tree.joints, none, no_rows, place, rates, 0.0, series)
        evaluate(rows, tree.terms, tree.constants, series, 0, main, -1, False)
        evaluate(rows, tree.terms, tree.constants, series, main, len(rows), 0, False)
        for i in range(len(wanted)):
            found[sample, i] = series[0][wanted[i], 0]


@dataclass(frozen=True, eq=False)
class TreeSolution:
    """q (n, nq) and u (n, nu) as high and low parts, the number of steps, and the largest M_ii / d_i."""

    q: tuple[Array, Array]
    u: tuple[Array, Array]
    steps: int
    ratio: float


class _State:
    """Where coordinates and rates are in the state of the steps, and what its components are."""

    def __init__(self, scene: TreeScene, equations: TreeEquations) -> None:
        rows: list[int] = []
        classes: list[int] = []
        norms: list[tuple[int, int]] = []
        self.q: list[int] = []
        self.u: list[int] = []
        for body, first in zip(scene.bodies, equations.joints.tolist(), strict=True):
            kind, start = body.joint.of_kind, len(rows)
            moved = (0, 1, 3)[kind.translation]
            turned = {Rotation.NONE: 0, Rotation.AXIS: 3, Rotation.BALL: 4}[kind.rotation]
            skipped = 2 if kind.rotation is Rotation.AXIS else 0  # cosine and sine of half the angle
            spins = (0, 1, 3)[kind.rotation]
            free = kind.translation is Translation.SPACE  # its position follows from the velocity
            classes += [DERIVED if free else PLACE] * moved
            if kind.rotation is Rotation.AXIS:
                classes += [DERIVED, TURNED, TURNED]
                norms.append((start + moved + 1, 2))
            elif kind.rotation is Rotation.BALL:
                classes += [TURNED] * 4
                norms.append((start + moved, 4))
            classes += [SPEED] * moved + [SPIN] * spins
            rows += range(first, first + moved + turned)
            rates = first + moved + turned + skipped
            rows += range(rates, rates + moved + spins)
            in_q = moved + (1 if kind.rotation is Rotation.AXIS else turned)
            self.q += range(start, start + in_q)
            self.u += range(start + moved + turned, len(rows))
        self.rows, self.classes = np.array(rows, dtype=np.int64), np.array(classes, dtype=np.int64)
        self.norms = np.array(norms, dtype=np.int64).reshape(-1, 2)


def length_of(scene: TreeScene) -> float:
    """The largest distance of a joint from a centre of mass, or radius of gyration; 1 if all are 0."""
    sizes = [0.0]
    for body in scene.bodies:
        sizes += [float(np.linalg.norm(body.joint.at_parent)), float(np.linalg.norm(body.joint.at_body))]
        if body.mass > 0.0:
            sizes.append(gyration_radius(body.mass, body.inertia))
    return max(sizes) or 1.0


def state_layout(scene: TreeScene, equations: TreeEquations) -> tuple[list[int], list[int], list[int], Array]:
    """Return the rows of the state, the places of q and u in it, and its start in doubles."""
    layout, series = _State(scene, equations), TreeSeries(scene, SeriesAccuracy(1, 1.0))
    start, _ = series.packed((scene.q0, np.zeros_like(scene.q0)), (scene.u0, np.zeros_like(scene.u0)))
    return layout.rows.tolist(), layout.q, layout.u, start[:, 0]


class TreeSeries:
    """A scene packed for the kernels once, at one accuracy: then any motion of it."""

    def __init__(self, scene: TreeScene, accuracy: SeriesAccuracy) -> None:
        self._scene, self._accuracy, self._length = scene, accuracy, length_of(scene)
        self._edges = [0.0, *scene.switches_before(inf), inf]
        self._pieces = []
        for begin in self._edges[:-1]:
            equations = tree_equations(scene, begin)
            tree, space = kernel_numbers(scene, equations), workspace(equations, accuracy.order + 1)
            doubles, high = rounded(tree), rounded(space)
            is_paired = bool(accuracy.paired_orders)
            self._pieces.append((tree if is_paired else doubles, doubles, space if is_paired else high, high))
        self._layout = _State(scene, equations)

    def solve(self, q: tuple[Array, Array], u: tuple[Array, Array], t_s: Array) -> TreeSolution:
        """Integrate from q (nq,) and u (nu,), high and low parts, to ascending times t_s (n,).

        NaN from where the motion cannot be followed. Raises TooManyStepsError for a motion that takes hours.
        """
        end_s = float(t_s[-1]) if len(t_s) else 0.0
        layout, state = self._layout, self.packed(q, u)
        high, low = np.empty((len(t_s), len(layout.rows))), np.empty((len(t_s), len(layout.rows)))
        steps, ratio = 0, 1.0
        for piece, (begin, end) in zip(self._pieces, pairwise(self._edges), strict=True):
            if begin > end_s or (begin == end_s and begin > 0.0):
                break
            first, after = np.searchsorted(t_s, [begin, end])
            part = slice(first, after if end < end_s else len(t_s))
            out = high[part], low[part]
            made, worst = self._advance(piece, state, t_s[part], (begin, min(end, end_s)), out)
            steps, ratio = steps + made, max(ratio, worst)
        return TreeSolution(
            (high[:, layout.q], low[:, layout.q]), (high[:, layout.u], low[:, layout.u]), steps, ratio
        )

    def packed(self, q: tuple[Array, Array], u: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the state (s, 1) of coordinates and rates; quaternions may have any norm."""
        tree = self._pieces[0][1]
        series = np.zeros((len(tree.rows), 1)), np.zeros((len(tree.rows), 1))
        columns = [tuple(np.ascontiguousarray(half[:, None]) for half in pair) for pair in (q, u)]
        put_state(tree.joints, np.zeros((0, 2)), np.zeros(0, np.int64), *columns, 0.0, series)
        return series[0][self._layout.rows], series[1][self._layout.rows]

    def _advance(
        self,
        piece: tuple[TreeNumbers, TreeNumbers, Workspace, Workspace],
        state: tuple[Array, Array],
        times: Array,
        span: tuple[float, float],
        out: tuple[Array, Array],
    ) -> tuple[int, float]:
        """Make the steps of one interval; return their number and the largest M_ii / d_i."""
        layout, accuracy = self._layout, self._accuracy
        (t, end), due, steps, ratio = span, 0, 0, 1.0
        while True:
            before = t
            made, t, worst = integrate_tree(
                *piece,
                layout.rows,
                layout.classes,
                layout.norms,
                self._length,
                state,
                times[due:],
                t,
                end,
                accuracy.order,
                accuracy.tolerance,
                accuracy.paired_orders,
                _STEPS_PER_CALL,
                (out[0][due:], out[1][due:]),
            )
            steps, ratio = steps + made, max(ratio, worst)
            if not t < end:
                return steps, ratio
            needed = steps + made * (end - t) / (t - before)
            if needed > _MOST_STEPS:
                raise TooManyStepsError(
                    f"the motion takes about {needed:.0e} steps, and no more than {_MOST_STEPS:.0e} are made"
                )
            due = int(np.searchsorted(times, t, side="right"))
