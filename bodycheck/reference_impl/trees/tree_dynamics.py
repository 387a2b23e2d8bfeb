"""The exact dynamics of a tree in one state: motion, mass matrix, bias, accelerations, joint forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import Numbers, high_part
from bodycheck.reference_impl.kernels.jit import interpreted
from bodycheck.reference_impl.trees.prepared_tree import RATES, PreparedTree, prepared_tree
from bodycheck.reference_impl.trees.tree_numbers import ROWS
from bodycheck.reference_impl.trees.tree_response import factor, put_mass_matrix, response, solve
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.trees.tree_state import (
    ANGULAR,
    BODY_OMEGA,
    JOINT_FORCE,
    JOINT_MOMENT,
    KINETIC,
    MOMENTUM,
    POSE,
    POSITION,
    POTENTIAL,
    QUATERNION,
    TOTALS,
    VELOCITY,
    add_column,
    put_free_fall,
    put_in_world_axes,
    put_motion,
    put_state,
    put_totals,
    put_wrenches,
)
from bodycheck.reference_impl.trees.tree_terms import (
    advance,
    put_joint_torques,
    put_pushes,
    put_world_axes,
    residual,
)

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
    scene: TreeScene, q: Array | None = None, u: Array | None = None, t_s: float = 0.0
) -> TreeDynamics:
    """Return the dynamics at coordinates q and rates u [default: the start] at a time, in doubles.

    Only the mass matrix, which takes most of the time, is computed in doubles. The rest is rounded from
    double-doubles, because forces in doubles lose digits in proportion to the condition of the mass matrix.
    """
    numbers = _numbers(scene, q, u, t_s, paired=False)
    return _dynamics({name: high_part(value) for name, value in numbers.items()})


def paired_tree_dynamics(
    scene: TreeScene, q: Paired | None = None, u: Paired | None = None, t_s: float = 0.0
) -> tuple[TreeDynamics, TreeDynamics]:
    """Return the same in double-doubles: high and low parts. q and u: doubles, or high and low parts."""
    numbers = _numbers(scene, q, u, t_s, paired=True)
    high, low = ({name: np.asarray(value)[part] for name, value in numbers.items()} for part in range(2))
    return _dynamics(high), _dynamics(low)


def pivot_ratios(scene: TreeScene) -> Array:
    """M_ii / d_i (nu,) at the start, M = L D L^T: the loss of digits; infinite where M is singular."""
    with interpreted(), np.errstate(divide="ignore", invalid="ignore"):
        mass = _mass_in_doubles(prepared_tree(scene, 0.0), scene.q0[:, None])
        factors = mass.copy()
        factor(factors)
        pivots = np.diag(factors)
        return np.where(pivots > 0.0, np.diag(mass) / pivots, np.inf)


def _dynamics(numbers: dict[str, Array]) -> TreeDynamics:
    poses, totals = numbers.pop("poses"), numbers.pop("totals")[:, 0]
    columns = {name: array[:, 0] for name, array in numbers.items() if name != "mass_matrix"}
    return TreeDynamics(
        position=poses[:, POSITION : POSITION + 3],
        quaternion=poses[:, QUATERNION : QUATERNION + 4],
        velocity=poses[:, VELOCITY : VELOCITY + 3],
        omega_body=poses[:, BODY_OMEGA : BODY_OMEGA + 3],
        joint_force=poses[:, JOINT_FORCE : JOINT_FORCE + 3],
        joint_moment=poses[:, JOINT_MOMENT : JOINT_MOMENT + 3],
        mass_matrix=numbers["mass_matrix"],
        kinetic=float(totals[KINETIC]),
        potential=float(totals[POTENTIAL]),
        momentum=totals[MOMENTUM : MOMENTUM + 3],
        angular_momentum=totals[ANGULAR : ANGULAR + 3],
        **columns,
    )


def _numbers(
    scene: TreeScene, q: Paired | None, u: Paired | None, t_s: float, *, paired: bool
) -> dict[str, Numbers]:
    """Return double-doubles by the names of TreeDynamics, and the poses and totals; paired: also M."""
    tree = prepared_tree(scene, t_s)
    place, rates = _column(scene.q0 if q is None else q), _column(scene.u0 if u is None else u)
    at_rest = _zeros(True, len(scene.u0), 1)
    with interpreted():
        moving, resting = _State(tree, place, rates, t_s), _State(tree, place, at_rest, t_s)
        mass = moving.mass_matrix() if paired else _mass_in_doubles(tree, place[0])
        applied = moving.joint_torques()
        add_column(applied, resting.in_world_axes(resting.residual(_zeros(True, 3, 1), pushed=True)), -1.0)
        numbers: dict[str, Numbers] = {
            "bias": moving.bias(),
            "gravity_bias": resting.bias(),
            "applied": applied,
            "accelerations": moving.accelerations(mass),
            "poses": moving.poses(),
            "totals": moving.totals(),
        }
        pair = mass if isinstance(mass, tuple) else (mass, np.zeros_like(mass))
        numbers["mass_matrix"] = moving.in_world_axes(_transposed(moving.in_world_axes(pair)))
        return numbers


def _mass_in_doubles(tree: PreparedTree, place: Array) -> Array:
    """Return M (nu, nu) in doubles, at a place as a column, for u' of free bodies in body axes."""
    at_rest = np.zeros((int(np.sum(tree.structure[:, RATES])), 1))
    mass: Array = high_part(_State(tree.rounded(), place, at_rest, 0.0).mass_matrix())
    return mass


class _State:
    """One state of a tree in the series of the kernels; rates of free bodies are those of the kernels."""

    def __init__(self, tree: PreparedTree, q: Numbers, u: Numbers, t_s: float) -> None:
        self.tree, self.rates, self.paired = tree, len(high_part(u)), isinstance(q, tuple)
        self.structure, self.constants = tree.structure, tree.constants
        bodies = len(tree.structure)
        self.series = _zeros(self.paired, ROWS * bodies + 2 * len(tree.sines), 2)
        self.work, self._poses = _zeros(self.paired, bodies, 12), _zeros(self.paired, bodies, POSE)
        put_state(self.structure, self.constants, tree.sines, q, u, t_s, self.series)
        advance(self.structure, tree.sines, self.series, 0)
        put_world_axes(self.structure, self.constants, self.series, 0)

    def column(self) -> Numbers:
        return _zeros(self.paired, self.rates, 1)

    def in_world_axes(self, numbers: Numbers) -> Numbers:
        """Turn the rows (rates, any) of free bodies' translations from body axes to world axes, in place."""
        for column in range(high_part(numbers).shape[1]):
            put_in_world_axes(self.structure, self.series, numbers, column)
        return numbers

    def residual(self, gravity: Numbers, *, pushed: bool) -> Numbers:
        """Return the forces (rates, 1) that the joints must supply for u' = 0, free bodies falling."""
        tree, out = self.tree, self.column()
        loads = tree.pushed if pushed else tree.pushed[:0]
        put_pushes(tree.pushes, loads, self.series, len(self.structure), 0)
        residual(self.structure, self.constants, gravity, self.series, out, 0)
        return out

    def respond(self, x: Numbers, *, keep: bool) -> Numbers:
        """Return M x (rates, 1), without armatures."""
        out = self.column()
        response(self.structure, self.constants, self.series, self.work, x, out, 0, keep)
        return out

    def bias(self) -> Numbers:
        """Return the bias (rates, 1) of M u' + bias = 0, u' in world axes for free bodies."""
        fall, bias = self.column(), self.residual(self.tree.gravity, pushed=False)
        put_free_fall(self.structure, self.tree.gravity, self.series, fall)
        add_column(bias, self.respond(fall, keep=False), -1.0)
        return self.in_world_axes(bias)

    def mass_matrix(self) -> Numbers:
        """Return M (rates, rates) for u' of free bodies in body axes."""
        mass = _zeros(self.paired, self.rates, self.rates)
        x, out = self.column(), self.column()
        put_mass_matrix(self.structure, self.constants, self.series, self.work, x, out, mass)
        return mass

    def joint_torques(self) -> Numbers:
        """Return the forces (rates, 1) of springs, dampers and loads at the joints."""
        tree, out = self.tree, self.column()
        put_joint_torques(
            *(self.structure, self.constants, tree.torques, tree.sines, tree.sine_rates, self.series, out, 0)
        )
        return out

    def accelerations(self, mass: Numbers) -> Numbers:
        """Return u' (rates, 1), in world axes for free bodies; the series then hold the forces.

        If M is in doubles, the solution is refined twice by what remains of the forces (Wilkinson 1963,
        Rounding errors in algebraic processes).
        """
        x, forces = self.column(), self.joint_torques()
        add_column(forces, self.residual(self.tree.gravity, pushed=True), -1.0)
        factors = _copy(mass)
        factor(factors)
        for _ in range(1 if isinstance(mass, tuple) else 3):
            rest = _copy(forces)
            add_column(rest, self.respond(x, keep=False), -1.0)
            change = rest if isinstance(mass, tuple) else high_part(rest)
            solve(factors, change)
            add_column(x, change if isinstance(mass, tuple) else (change, np.zeros_like(change)), 1.0)
        self.respond(x, keep=True)
        fall = self.column()
        put_free_fall(self.structure, self.tree.gravity, self.series, fall)
        add_column(x, fall, 1.0)
        return self.in_world_axes(x)

    def poses(self) -> Numbers:
        """Return the motion of the bodies and, once accelerations are known, the forces of the joints."""
        put_motion(self.structure, self.constants, self.series, self.work, self._poses)
        put_wrenches(self.structure, self.constants, self.series, self._poses)
        return self._poses

    def totals(self) -> Numbers:
        """Return energies and momenta, once the poses are known."""
        totals = _zeros(self.paired, TOTALS, 1)
        put_totals(self.structure, self.constants, self.tree.gravity, self.series, self._poses, totals)
        return totals


def _zeros(paired: bool, *shape: int) -> Numbers:
    return (np.zeros(shape), np.zeros(shape)) if paired else np.zeros(shape)


def _column(values: Paired) -> tuple[Array, Array]:
    """Return values (m,) as a column (m, 1) of double-doubles."""
    high, low = values if isinstance(values, tuple) else (values, np.zeros(len(values)))
    return np.array(high, np.float64)[:, None], np.array(low, np.float64)[:, None]


def _copy(numbers: Numbers) -> Numbers:
    return (numbers[0].copy(), numbers[1].copy()) if isinstance(numbers, tuple) else numbers.copy()


def _transposed(numbers: Numbers) -> Numbers:
    """M^T of double-doubles, as a copy."""
    return numbers[0].T.copy(), numbers[1].T.copy()
