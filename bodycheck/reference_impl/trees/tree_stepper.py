"""One-step maps of trees in doubles, which one kernel steps: semi-implicit Euler and its variants, RK4.

q (+) theta adds to lengths and angles, and turns attitudes by exp(theta / 2) from the right. a = u', c the
bias with gravity, D damping, K stiffness; tau has springs, dampers and loads.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import long_kernel, unspecialised_borrowing_kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    cross,
    dot,
    quaternion_exp,
    quaternion_times,
    scaled_add,
)
from bodycheck.reference_impl.rotations import normalised
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.tree_equations import acting_loads, recorded_equations
from bodycheck.reference_impl.trees.tree_motion import kernel_numbers, rate_rows, rounded, workspace
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene
from bodycheck.reference_impl.trees.tree_series import correct, evaluate, factor, put_state, solve
from bodycheck.reference_impl.trees.tree_steps import TreeNumbers, put_mass

_BALL = int(Rotation.BALL)
_SMALL = 1e-4  # rad: below it the coefficient of the second correction is its series
_M1, _M1D, _M2S, _M2, _RK4 = range(5)
_RULES = {"M1": _M1, "M1d": _M1D, "M2s": _M2S, "M2": _M2, "RK4": _RK4}


@unspecialised_borrowing_kernel
def _put_coriolis(
    tree: TreeNumbers, space: Any, q: Array, u: Array, t: float, h: float, added: Array
) -> None:
    """Set added to h d(c - tau)/du, exactly: c is quadratic in u, and tau linear."""
    for j in range(len(u)):
        for sign in (1.0, -1.0):
            u[j, 0] += sign
            put_state(tree.joints, tree.sines, tree.sine_rows, q, u, t, space.series)
            u[j, 0] -= sign
            evaluate(tree.rows, tree.terms, tree.constants, space.series, 0, tree.segments[0], -1, False)
            for i in range(len(u)):
                space.series[tree.unknowns[i], tree.ahead[i]] = 0.0
            evaluate(tree.rows, tree.terms, tree.constants, space.series, 0, tree.segments[1], 0, False)
            for i in range(len(u)):
                own = 0.5 * h * sign * space.series[tree.results[i], 0]
                added[i, j] = own if sign > 0.0 else added[i, j] + own


@unspecialised_borrowing_kernel
def put_rates(
    tree: TreeNumbers,
    space: Any,
    passive: Array,
    rate_rows: Array,
    rule: int,
    q: Array,
    u: Array,
    t: float,
    h: float,
    added: Array,
    du: Array,
) -> None:
    """Set du (nu, 1) to u' at q (nq, 1), u (nu, 1), with what a rule adds to the mass matrix and the forces.

    passive (nu, 2): damping and stiffness of each rate.
    """
    rates = len(u)
    if rule == _M2:
        _put_coriolis(tree, space, q, u, t, h, added)
    put_state(tree.joints, tree.sines, tree.sine_rows, q, u, t, space.series)
    put_mass(tree, space)
    for i in range(rates):
        if rule in (_M1D, _M2S):
            space.mass[i, i] += h * passive[i, 0]
        if rule == _M2S:
            space.mass[i, i] += h * h * passive[i, 1]
        space.series[tree.unknowns[i], tree.ahead[i]] = 0.0
        if rule == _M2:
            for j in range(rates):
                space.mass[i, j] += added[i, j]
    evaluate(tree.rows, tree.terms, tree.constants, space.series, 0, tree.segments[1], 0, False)
    for i in range(rates):
        space.x[i, 0] = -space.series[tree.results[i], 0]
        if rule == _M2S:
            space.x[i, 0] -= h * passive[i, 1] * u[i, 0]
    if rule == _M2:
        _eliminate(space.mass, space.x)
    else:
        factor(space.mass, rates)
        solve(space.mass, space.x, rates)
    correct(
        tree.rows,
        tree.responding,
        tree.ends,
        tree.sources,
        tree.kept,
        tree.unknowns,
        tree.ahead,
        space.gains,
        space.change,
        space.x,
        space.series,
        0,
    )
    evaluate(tree.rows, tree.terms, tree.constants, space.series, 0, tree.segments[0], 0, True)
    for i in range(rates):
        du[i, 0] = space.series[rate_rows[i], 1]


@unspecialised_borrowing_kernel
def _eliminate(m: Array, x: Array) -> None:
    """Replace x (n, 1) by M^-1 x, M nearly symmetric and positive definite, which is overwritten."""
    n = len(x)
    for j in range(n):
        for i in range(j + 1, n):
            share = m[i, j] / m[j, j]
            x[i, 0] -= share * x[j, 0]
            for k in range(j, n):
                m[i, k] -= share * m[j, k]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i, 0] -= m[i, k] * x[k, 0]
        x[i, 0] /= m[i, i]


@unspecialised_borrowing_kernel
def _move(joints: Array, q: Array, k: Array, h: float, out: Array) -> None:
    """out = q (+) h k, columns (nq, 1) and (nu, 1); out may be q."""
    place = rate = 0
    for joint in range(len(joints)):
        for _ in range(joints[joint, 0] + joints[joint, 1] % _BALL):
            out[place, 0] = q[place, 0] + h * k[rate, 0]
            place, rate = place + 1, rate + 1
        if joints[joint, 1] == _BALL:
            turned = quaternion_times(
                (q[place, 0], q[place + 1, 0], q[place + 2, 0], q[place + 3, 0]),
                quaternion_exp((h * k[rate, 0], h * k[rate + 1, 0], h * k[rate + 2, 0])),
            )
            out[place, 0], out[place + 1, 0], out[place + 2, 0], out[place + 3, 0] = turned
            place, rate = place + 4, rate + 3


@unspecialised_borrowing_kernel
def _put_stage(joints: Array, u: Array, theta: Array, h: float, out: Array) -> None:
    """out = u, for attitudes the derivative of theta with exp(theta) turning at omega, at theta = h theta.

    omega + theta x omega / 2 + (1 - |theta|/2 cot(|theta|/2)) / |theta|^2 theta x (theta x omega).
    """
    rate = 0
    for joint in range(len(joints)):
        for _ in range(joints[joint, 0] + joints[joint, 1] % _BALL):
            out[rate, 0] = u[rate, 0]
            rate += 1
        if joints[joint, 1] == _BALL:
            omega = (u[rate, 0], u[rate + 1, 0], u[rate + 2, 0])
            angle = (h * theta[rate, 0], h * theta[rate + 1, 0], h * theta[rate + 2, 0])
            across = cross(angle, omega)
            square = dot(angle, angle)
            size = math.sqrt(square)
            share = 1.0 / 12.0 + square / 720.0
            if size > _SMALL:
                share = (1.0 - 0.5 * size / math.tan(0.5 * size)) / square
            found = scaled_add(scaled_add(omega, 0.5, across), share, cross(angle, across))
            out[rate, 0], out[rate + 1, 0], out[rate + 2, 0] = found
            rate += 3


@long_kernel
def advance_tree(
    tree: TreeNumbers,
    space: Any,
    passive: Array,
    rate_rows: Array,
    rule: int,
    q: Array,
    u: Array,
    begin: float,
    h: float,
    steps: int,
) -> None:
    """Make steps from q (nq, 1) and u (nu, 1) at time begin, in place."""
    rates = len(u)
    added, du, k, total_k, total = (
        np.zeros((rates, rates)),
        np.zeros((rates, 1)),
        np.zeros((rates, 1)),
        np.zeros((rates, 1)),
        np.zeros((rates, 1)),
    )
    moved, speed = q.copy(), u.copy()
    for step in range(steps):
        t = begin + step * h
        if rule != _RK4:
            put_rates(tree, space, passive, rate_rows, rule, q, u, t, h, added, du)
            for i in range(rates):
                u[i, 0] += h * du[i, 0]
            _move(tree.joints, q, u, h, q)
            continue
        total_k[:], total[:], k[:], du[:] = 0.0, 0.0, 0.0, 0.0
        for stage in range(4):
            part = h * (0.0 if stage == 0 else 1.0 if stage == 3 else 0.5)
            weight = h * (1.0 / 6.0 if stage in (0, 3) else 1.0 / 3.0)
            for i in range(rates):
                speed[i, 0] = u[i, 0] + part * du[i, 0]
            _move(tree.joints, q, k, part, moved)
            _put_stage(tree.joints, speed, k, part, k)
            put_rates(tree, space, passive, rate_rows, rule, moved, speed, t + part, h, added, du)
            for i in range(rates):
                total_k[i, 0] += weight * k[i, 0]
                total[i, 0] += weight * du[i, 0]
        _move(tree.joints, q, total_k, 1.0, q)
        for i in range(rates):
            u[i, 0] += total[i, 0]


class TreeStepper:
    """A tree stepped by one of the maps: q (nq, 1) and u (nu, 1) in doubles; quaternions have norm 1."""

    def __init__(self, scene: TreeScene, name: str) -> None:
        self._scene, self._rule = scene, _RULES[name]
        self._passive = np.array(
            [
                (body.joint.damping, body.joint.stiffness)
                for body in scene.bodies
                for _ in range(body.joint.of_kind.rates)
            ]
        )
        self.reset()

    def reset(self) -> None:
        """Go back to the start, under the loads at t = 0."""
        self.q, self.u = self._scene.q0[:, None].copy(), self._scene.u0[:, None].copy()
        for turned, _ in self._scene.turn_slices:
            self.q[turned, 0] = normalised(self.q[turned, 0])
        self.push(acting_loads(self._scene, 0.0))

    def push(self, loads: tuple[TreeLoad, ...]) -> None:
        """Let these loads act from now on, at all times."""
        equations = recorded_equations(self._scene.bodies, loads, tuple(self._scene.gravity))
        self._tree = rounded(kernel_numbers(self._scene, equations))
        self._space = rounded(workspace(equations, 2))
        self._rate_rows = rate_rows(self._scene, equations)

    @property
    def numbers(self) -> tuple[Any, ...]:
        """The first arguments of `put_rates` and `advance_tree`."""
        return self._tree, self._space, self._passive, self._rate_rows

    def advance(self, begin_s: float, dt_s: float, steps: int) -> None:
        """Make steps from a time, in one compiled call."""
        advance_tree(
            *self.numbers,
            self._rule,
            self.q,
            self.u,
            begin_s,
            dt_s,
            steps,
        )
