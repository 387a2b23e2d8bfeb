"""The exact dynamics of a tree in one state: motion, mass matrix, bias, accelerations, joint forces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import Numbers
from bodycheck.reference_impl.kernels.jit import interpreted
from bodycheck.reference_impl.rational import Vector, fractions, pair, rotation_of, times, transposed
from bodycheck.reference_impl.trees.joint_kind import Translation
from bodycheck.reference_impl.trees.tree_equations import (
    ANGULAR,
    BODY_OMEGA,
    JOINT_FORCE,
    JOINT_MOMENT,
    KINETIC,
    MOMENTUM,
    POSITION,
    POTENTIAL,
    QUATERNION,
    VELOCITY,
    tree_equations,
)
from bodycheck.reference_impl.trees.tree_motion import kernel_numbers, workspace
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.trees.tree_series import evaluate, factor, put_state, solve
from bodycheck.reference_impl.trees.tree_steps import put_mass

Paired: TypeAlias = Array | tuple[Array, Array]
"""Doubles, or the high and low parts of double-doubles."""


@dataclass(frozen=True, eq=False)
class TreeDynamics:
    """What holds in one state of a tree of n bodies and nu rates u; SI units.

    position and velocity (n, 3) of the centres of mass, world axes; quaternion (n, 4), body to world;
    omega_body (n, 3). M u' + bias = applied: mass_matrix (nu, nu), bias (nu,), with gravity; gravity_bias
    (nu,), the bias at rest; applied (nu,), of springs, dampers and loads; accelerations (nu,), u'. The rates
    of a free body are its velocity in world axes and omega in body axes; those of a ball in child axes.
    joint_force and joint_moment (n, 3): of the joint, with its spring, damper and loads, on the child; moment
    about the joint's point of the child, both in body axes of the child; 0 for a free body. kinetic and
    potential in J, 0 at the origin of the world and for springs at rest; momentum (3,) and angular_momentum
    (3,) about the origin of the world, world axes, without armatures.
    """

    position: Array
    quaternion: Array
    velocity: Array
    omega_body: Array
    mass_matrix: Array
    bias: Array
    gravity_bias: Array
    applied: Array
    accelerations: Array
    joint_force: Array
    joint_moment: Array
    kinetic: float
    potential: float
    momentum: Array
    angular_momentum: Array


def tree_dynamics(
    scene: TreeScene, q: Paired | None = None, u: Paired | None = None, t_s: float = 0.0
) -> TreeDynamics:
    """Return the dynamics at coordinates q and rates u [default: the start] at a time, rounded to doubles."""
    return paired_tree_dynamics(scene, q, u, t_s)[0]


def paired_tree_dynamics(
    scene: TreeScene, q: Paired | None = None, u: Paired | None = None, t_s: float = 0.0
) -> tuple[TreeDynamics, TreeDynamics]:
    """Return the same in double-doubles: high and low parts. q and u: doubles, or high and low parts."""
    place, rates = _column(scene.q0 if q is None else q), _column(scene.u0 if u is None else u)
    at_rest = _column(np.zeros(len(scene.u0)))
    unloaded = scene.unloaded
    with interpreted():
        moving = _State(scene, place, rates, t_s)
        mass = moving.mass_matrix()
        accelerations = moving.accelerations(mass)
        needed = _State(scene.massless, place, rates, t_s).forces([Fraction(0)] * len(scene.u0))
        exact = {
            "accelerations": accelerations,
            "bias": _State(unloaded, place, rates, t_s).bias(),
            "gravity_bias": _State(unloaded, place, at_rest, t_s).bias(),
            "applied": [-x for x in moving.in_world_axes(needed)],
            "mass_matrix": moving.matrix_in_world_axes(mass),
        }
    pairs = {name: np.array([pair(x) for x in values]) for name, values in exact.items()}
    high, low = (
        _dynamics({name: value[:, part] for name, value in pairs.items()}, moving.outputs(part))
        for part in range(2)
    )
    return high, low


def pivot_ratios(scene: TreeScene) -> Array:
    """M_ii / d_i (nu,) at the start, M = L D L^T: the loss of digits; infinite where M is singular."""
    with interpreted(), np.errstate(divide="ignore", invalid="ignore"):
        high, _ = _State(scene, _column(scene.q0), _column(np.zeros(len(scene.u0))), 0.0).mass_matrix()
        factors = high.copy()
        factor(factors, len(high))
        pivots = np.diag(factors)
        return np.where(pivots > 0.0, np.diag(high) / pivots, np.inf)


def _dynamics(numbers: dict[str, Array], outputs: tuple[Array, Array]) -> TreeDynamics:
    poses, totals = outputs
    mass = numbers.pop("mass_matrix").reshape(len(numbers["bias"]), -1)
    return TreeDynamics(
        position=poses[:, POSITION : POSITION + 3],
        quaternion=poses[:, QUATERNION : QUATERNION + 4],
        velocity=poses[:, VELOCITY : VELOCITY + 3],
        omega_body=poses[:, BODY_OMEGA : BODY_OMEGA + 3],
        joint_force=poses[:, JOINT_FORCE : JOINT_FORCE + 3],
        joint_moment=poses[:, JOINT_MOMENT : JOINT_MOMENT + 3],
        mass_matrix=mass,
        kinetic=float(totals[KINETIC]),
        potential=float(totals[POTENTIAL]),
        momentum=totals[MOMENTUM : MOMENTUM + 3],
        angular_momentum=totals[ANGULAR : ANGULAR + 3],
        **numbers,
    )


class _State:
    """One state of a tree in the rows of its equations; b = R^T (v' - g) stands for v' of free bodies."""

    def __init__(self, scene: TreeScene, q: Numbers, u: Numbers, t_s: float) -> None:
        self.scene, self.equations = scene, tree_equations(scene, t_s)
        self.tree, self.space = kernel_numbers(scene, self.equations), workspace(self.equations, 2)
        self.series = self.space.series
        put_state(self.tree.joints, self.tree.sines, self.tree.sine_rows, q, u, t_s, self.series)
        self._evaluate(0, self.equations.main, -1)
        self._turns = {
            rates.start: rotation_of([self._exact(first + i) for i in range(3, 7)])
            for body, rates, first in zip(
                scene.bodies, scene.rate_slices, self.equations.joints.tolist(), strict=True
            )
            if body.joint.of_kind.translation is Translation.SPACE
        }

    def _evaluate(self, first: int, last: int, k: int) -> None:
        rows = self.equations.rows
        evaluate(rows.rows, rows.terms, rows.constants, self.series, first, last, k, False)

    def _exact(self, row: int) -> Fraction:
        return Fraction(self.series[0][row, 0]) + Fraction(self.series[1][row, 0])

    def forces(self, unknowns: Iterable[Fraction]) -> Vector:
        """Return the forces (rates,) that are missing at the joints for given unknowns."""
        equations = self.equations
        for row, is_ahead, x in zip(equations.unknowns, equations.ahead, unknowns, strict=True):
            self.series[0][row, is_ahead], self.series[1][row, is_ahead] = pair(x)
        self._evaluate(0, equations.end, 0)
        return [self._exact(row) for row in equations.results]

    def in_world_axes(self, v: Vector) -> Vector:
        """Return the components (rates,) with those of free bodies' translations turned by R."""
        turned = list(v)
        for start, rotation in self._turns.items():
            turned[start : start + 3] = times(rotation, v[start : start + 3])
        return turned

    def bias(self) -> Vector:
        """Return the forces (rates,) that keep all rates constant, world axes: b = -R^T g of free bodies."""
        unknowns = [Fraction(0)] * len(self.equations.unknowns)
        for start, rotation in self._turns.items():
            unknowns[start : start + 3] = times(
                transposed(rotation), [-x for x in fractions(self.scene.gravity)]
            )
        return self.in_world_axes(self.forces(unknowns))

    def mass_matrix(self) -> tuple[Array, Array]:
        """Return M (rates, rates) of the unknowns."""
        put_mass(self.tree, self.space)
        high, low = self.space.mass
        return high, low

    def matrix_in_world_axes(self, mass: tuple[Array, Array]) -> Vector:
        """Return M of the rates, row by row."""
        rows = [
            [Fraction(x) + Fraction(y) for x, y in zip(*row, strict=True)] for row in zip(*mass, strict=True)
        ]
        for _ in range(2):
            rows = [list(row) for row in zip(*map(self.in_world_axes, rows), strict=True)]
        return [x for row in rows for x in row]

    def accelerations(self, mass: tuple[Array, Array]) -> Vector:
        """Return u' (rates,), world axes; the rows then hold the forces."""
        missing = self.forces([Fraction(0)] * len(self.equations.unknowns))
        high, low = np.array([pair(-force) for force in missing]).reshape(-1, 2).T
        x = _column((high, low))
        factors = mass[0].copy(), mass[1].copy()
        factor(factors, len(missing))
        solve(factors, x, len(missing))
        solution = [Fraction(a) + Fraction(b) for a, b in zip(x[0][:, 0], x[1][:, 0], strict=True)]
        self.forces(solution)
        rates = self.in_world_axes(solution)
        for start in self._turns:
            rates[start : start + 3] = [
                x + g for x, g in zip(rates[start : start + 3], fractions(self.scene.gravity), strict=True)
            ]
        return rates

    def outputs(self, part: int) -> tuple[Array, Array]:
        """Return the high or low part of poses (n, POSE) and totals (TOTALS,), after the accelerations."""
        equations = self.equations
        with interpreted():
            self._evaluate(equations.end, len(equations.rows.rows), 0)
        return self.series[part][equations.poses, 0], self.series[part][equations.totals, 0]


def _zeros(rows: int) -> Numbers:
    return np.zeros((rows, 1)), np.zeros((rows, 1))


def _column(values: Paired) -> tuple[Array, Array]:
    """Return values (m,) as a column (m, 1) of double-doubles."""
    high, low = values if isinstance(values, tuple) else (values, np.zeros(len(values)))
    return np.array(high, np.float64)[:, None], np.array(low, np.float64)[:, None]
