"""The exact dynamics of a tree in one state: motion, mass matrix, bias, accelerations, joint forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import Numbers, high_part
from bodycheck.reference_impl.kernels.jit import interpreted
from bodycheck.reference_impl.trees.prepared_tree import PreparedTree, prepared_tree
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
    """Return the dynamics at coordinates q and rates u [default: the start] at a time, in doubles."""
    numbers = _numbers(scene, scene.q0 if q is None else q, scene.u0 if u is None else u, t_s, paired=False)
    return _dynamics({name: value for name, value in numbers.items() if not isinstance(value, tuple)})


def paired_tree_dynamics(
    scene: TreeScene, q: Paired | None = None, u: Paired | None = None, t_s: float = 0.0
) -> tuple[TreeDynamics, TreeDynamics]:
    """Return the same in double-doubles: high and low parts. q and u: doubles, or high and low parts."""
    numbers = _numbers(scene, scene.q0 if q is None else q, scene.u0 if u is None else u, t_s, paired=True)
    high, low = ({name: value[part] for name, value in numbers.items()} for part in range(2))
    return _dynamics(high), _dynamics(low)


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


def _numbers(scene: TreeScene, q: Paired, u: Paired, t_s: float, *, paired: bool) -> dict[str, Numbers]:
    """Return arrays by the names of TreeDynamics, and the poses and totals, in doubles or double-doubles."""
    tree = prepared_tree(scene, t_s, paired=paired)
    place, rates = _column(q, paired), _column(u, paired)
    at_rest = _zeros(paired, len(scene.u0), 1)
    with interpreted():
        moving, resting = _State(tree, place, rates, t_s), _State(tree, place, at_rest, t_s)
        mass = moving.mass_matrix()
        bias, gravity_bias = moving.bias(), resting.bias()
        applied = moving.joint_torques()
        add_column(applied, resting.in_world_axes(resting.residual(_zeros(paired, 3, 1), pushed=True)), -1.0)
        return {
            "mass_matrix": moving.in_world_axes(_transposed(moving.in_world_axes(_copy(mass)))),
            "bias": bias,
            "gravity_bias": gravity_bias,
            "applied": applied,
            "accelerations": moving.accelerations(mass),
            "poses": moving.poses(),
            "totals": moving.totals(),
        }


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
        """Return u' (rates, 1), in world axes for free bodies; the series then hold the forces."""
        x, fall, factors = self.joint_torques(), self.column(), _copy(mass)
        add_column(x, self.residual(self.tree.gravity, pushed=True), -1.0)
        factor(factors)
        solve(factors, x)
        self.respond(x, keep=True)
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


def _column(values: Paired, paired: bool) -> Numbers:
    """Return values (m,) as a column (m, 1) of the precision."""
    high, low = values if isinstance(values, tuple) else (values, np.zeros(len(values)))
    column = np.array(high, np.float64)[:, None], np.array(low, np.float64)[:, None]
    return column if paired else column[0]


def _copy(numbers: Numbers) -> Numbers:
    return (numbers[0].copy(), numbers[1].copy()) if isinstance(numbers, tuple) else numbers.copy()


def _transposed(numbers: Numbers) -> Numbers:
    """M^T, as a copy."""
    if isinstance(numbers, tuple):
        return numbers[0].T.copy(), numbers[1].T.copy()
    return numbers.T.copy()
