"""Runge-Kutta steps of the whole state: the attitude as a quaternion or a matrix that the stages add to.

omega is carried in body axes, in world axes, or as the angular momentum in world axes; the three differ.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from bodycheck.reference_impl.arrays import Array, inverted
from bodycheck.reference_impl.integrators.dop853 import TABLEAU as _DOP853
from bodycheck.reference_impl.one_step_maps.first_order import CARRIED, Carried, gyroscopic, momentum_of
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Attitude,
    Loads,
    Motion,
    OneStepMap,
    Solid,
    back,
    stepped,
    times,
    weighted_sum,
)
from bodycheck.reference_impl.one_step_maps.tableaus import EXPLICIT, IMPLICIT, NamedTableau
from bodycheck.reference_impl.rotations import (
    hat,
    matrix_to_quaternion,
    normalised,
    project_to_so3,
    quaternion_product,
    quaternion_to_matrix,
)

_POSITION, _VELOCITY, _SPIN, _ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, None)
_ITERATIONS = 60
_SLOW = 0.2  # the least reduction of an iteration for which the derivative is kept
_CONVERGED = 1e-16
_DIFFERENCE = 1e-6
_PARTS = 8  # of a step of the exact flow

DOP853 = NamedTableau(
    "RK8 (dop853)", 8, _DOP853.a, _DOP853.b, "Dormand and Prince (1989); Hairer, Norsett and Wanner (1993)"
)


@dataclass(frozen=True)
class _Formulation:
    """y = (x, v, spin, attitude), (n, 13) or (n, 18), and its derivative."""

    carried: Carried
    matrix: bool = False

    def state(self, solid: Solid, motion: Motion) -> Array:
        """Return y of the states."""
        rotation = motion.orthogonal
        attitude = self._stored_attitude(motion)
        spin = motion.omega
        if self.carried == "world":
            spin = times(rotation, motion.omega)
        elif self.carried == "momentum":
            spin = momentum_of(solid, self._frame(attitude), times(rotation, motion.omega))
        return np.concatenate([motion.position, motion.velocity, spin, attitude], axis=-1)

    def _stored_attitude(self, motion: Motion) -> Array:
        if not self.matrix:
            return motion.quaternion
        return motion.matrix.reshape(*motion.matrix.shape[:-2], 9)

    def _frame(self, attitude: Array) -> Array:
        if self.matrix:
            return attitude.reshape(*attitude.shape[:-1], 3, 3)
        return quaternion_to_matrix(attitude)

    def motion(self, solid: Solid, before: Motion, dt: Array, y: Array) -> Motion:
        """Return the states of y."""
        attitude, spin = y[..., _ATTITUDE], y[..., _SPIN]
        frame = self._frame(attitude)
        after = replace(stepped(before, dt), position=y[..., _POSITION], velocity=y[..., _VELOCITY])
        if self.matrix:
            quaternion = matrix_to_quaternion(project_to_so3(frame))
            after = replace(after, quaternion=quaternion, rotation=frame)
        else:
            after = replace(after, quaternion=attitude, rotation=None)
        if self.carried == "body":
            return replace(after, omega=spin)
        if self.carried == "momentum":
            spin = times(frame, times(solid.inverse, back(frame, spin)))
        return replace(after, omega=back(after.orthogonal, spin))

    def rates(self, solid: Solid, t: Array, y: Array, loads: Loads) -> Array:
        """y'."""
        velocity, spin, attitude = y[..., _VELOCITY], y[..., _SPIN], y[..., _ATTITUDE]
        frame = self._frame(attitude)
        if self.carried == "body":
            omega, omega_world = spin, times(frame, spin)
        elif self.carried == "world":
            omega, omega_world = back(frame, spin), spin
        else:
            omega = times(solid.inverse, back(frame, spin))
            omega_world = times(frame, omega)
        force, torque = loads(t, y[..., _POSITION], frame, velocity, omega_world)
        if self.carried == "momentum":
            spin_rate = times(frame, torque)
        else:
            spin_rate = times(solid.inverse, torque - gyroscopic(solid, omega))
            spin_rate = times(frame, spin_rate) if self.carried == "world" else spin_rate
        if self.matrix:
            matrix_rate = frame @ hat(omega) if self.carried == "body" else hat(omega_world) @ frame
            attitude_rate = matrix_rate.reshape(attitude.shape)
        else:
            pure = np.concatenate([np.zeros_like(omega[..., :1]), 0.5 * omega], axis=-1)
            attitude_rate = quaternion_product(attitude, pure)
        return np.concatenate([velocity, force / solid.mass[..., None], spin_rate, attitude_rate], axis=-1)


@dataclass(frozen=True)
class _Explicit:
    """y+ = y + dt sum b_i k_i, the attitude then kept or projected, in every stage too if every_stage."""

    tableau: NamedTableau
    formulation: _Formulation
    projected: bool = False
    every_stage: bool = False

    def __call__(self, solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        h = np.asarray(dt)
        y = self.formulation.state(solid, motion)
        stages: list[Array] = []
        for row, c in zip(self.tableau.a, self.tableau.c, strict=True):
            at = y + h[..., None] * weighted_sum(row, stages, y)
            if self.every_stage:
                at = _projected(self.formulation, at)
            stages.append(self.formulation.rates(solid, motion.t + c * h, at, loads))
        end = y + h[..., None] * weighted_sum(self.tableau.b, stages, y)
        return _finished(self.formulation, self.projected, solid, motion, h, end)


def _finished(
    formulation: _Formulation, projected: bool, solid: Solid, motion: Motion, h: Array, end: Array
) -> Motion:
    return formulation.motion(solid, motion, h, _projected(formulation, end) if projected else end)


def _projected(formulation: _Formulation, y: Array) -> Array:
    """Return y with a unit quaternion, or with the nearest rotation matrix."""
    attitude = y[..., _ATTITUDE]
    if formulation.matrix:
        normal = project_to_so3(attitude.reshape(*attitude.shape[:-1], 3, 3)).reshape(attitude.shape)
    else:
        normal = normalised(attitude)
    return np.concatenate([y[..., :9], normal], axis=-1)


@dataclass(frozen=True)
class _Implicit:
    """An implicit Runge-Kutta step, by Newton's iterations."""

    tableau: NamedTableau
    formulation: _Formulation
    projected: bool = False

    def __call__(self, solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        h = np.broadcast_to(np.asarray(dt, dtype=np.float64), motion.t.shape)
        y = self.formulation.state(solid, motion)
        a, b, c = self.tableau.a, self.tableau.b, self.tableau.c
        size, stages = y.shape[-1], len(b)
        k = np.repeat(self.formulation.rates(solid, motion.t, y, loads)[:, None], stages, axis=1)
        inverse = self._newton_inverse(solid, motion.t, y, h, loads)
        smallest = np.inf
        for iteration in range(_ITERATIONS):
            at = y[:, None] + h[:, None, None] * np.einsum("ij,njk->nik", a, k)
            found = [
                self.formulation.rates(solid, motion.t + c[i] * h, at[:, i], loads) for i in range(stages)
            ]
            residual = (np.stack(found, axis=1) - k).reshape(len(y), stages * size)
            change = np.einsum("nij,nj->ni", inverse, residual).reshape(k.shape)
            k = k + change
            largest_change = float(np.max(np.abs(h[:, None, None] * change)))
            if (
                largest_change <= _CONVERGED
                or largest_change >= 0.5 * smallest < 1e-13
                or not largest_change < np.inf
            ):
                break
            if iteration and largest_change > _SLOW * smallest:
                inverse = self._newton_inverse(solid, motion.t, np.mean(at, axis=1), h, loads)
            smallest = min(smallest, largest_change)
        else:
            k = np.full_like(k, np.nan)  # no solution was found
        end = y + h[:, None] * np.einsum("i,nik->nk", b, k)
        return _finished(self.formulation, self.projected, solid, motion, h, end)

    def _newton_inverse(self, solid: Solid, t: Array, y: Array, h: Array, loads: Loads) -> Array:
        """(1 - dt A x dy'/dy)^-1 (n, stages x size, stages x size), the derivative taken at y."""
        n, size, stages = len(y), y.shape[-1], len(self.tableau.b)
        derivative = self._derivative(solid, t, y, loads)
        product = np.einsum("ij,nkl->nikjl", self.tableau.a, derivative)
        matrix = np.eye(stages * size) - h[:, None, None] * product.reshape(n, stages * size, stages * size)
        return inverted(matrix)

    def _derivative(self, solid: Solid, t: Array, y: Array, loads: Loads) -> Array:
        """dy'/dy (n, size, size), by central differences."""
        columns = []
        for i in range(y.shape[-1]):
            shift = _DIFFERENCE * np.maximum(np.abs(y[:, i]), 1.0)
            ahead, behind = y.copy(), y.copy()
            ahead[:, i] += shift
            behind[:, i] -= shift
            rates = (self.formulation.rates(solid, t, at, loads) for at in (ahead, behind))
            columns.append((next(rates) - next(rates)) / (2.0 * shift[:, None]))
        return np.stack(columns, axis=-1)


_QUATERNION = {False: ", additive quaternion", True: ", additive quaternion renormalised"}
_MATRIX = {False: ", additive matrix", True: ", additive matrix projected"}
_EVERY_STAGE = ", additive quaternion renormalised in every stage"


def runge_kutta_maps() -> Iterator[OneStepMap]:
    """Yield every tableau on every formulation."""
    for tableau in (*EXPLICIT, DOP853):
        for carried, axes in CARRIED.items():
            for projected, suffix in _QUATERNION.items():
                yield _map(tableau, axes + suffix, _Explicit(tableau, _Formulation(carried), projected))
            step = _Explicit(tableau, _Formulation(carried), projected=True, every_stage=True)
            yield _map(tableau, axes + _EVERY_STAGE, step)
            for projected, suffix in _MATRIX.items():
                step = _Explicit(tableau, _Formulation(carried, matrix=True), projected)
                yield _map(tableau, axes + suffix, step)
    for tableau in IMPLICIT:
        for carried, axes in CARRIED.items():
            for projected, suffix in _QUATERNION.items():
                if projected and tableau.name.startswith("Gauss"):
                    continue  # |q| is conserved without it
                yield _map(tableau, axes + suffix, _Implicit(tableau, _Formulation(carried), projected))


def _map(tableau: NamedTableau, what: str, step: _Explicit | _Implicit) -> OneStepMap:
    spins = {"body": "omega in body axes", "world": "omega in world axes", "momentum": "L in world axes"}
    part, projected_part = (
        ("matrix", "projected matrix") if step.formulation.matrix else ("quaternion", "unit quaternion")
    )
    attitude = cast(Attitude, projected_part if step.projected else part)
    symbol = "R" if step.formulation.matrix else "q"
    projected = (
        "" if not step.projected else ", R projected onto SO(3)" if step.formulation.matrix else ", q / |q|"
    )
    if isinstance(step, _Explicit) and step.every_stage:
        projected += " in every stage and at the end"
    return OneStepMap(
        tableau.name + what,
        f"y+ = y + dt sum b_i k_i, y = (x, v, {spins[step.formulation.carried]}, {symbol}){projected}",
        tableau.source,
        tableau.order,
        step,
        attitude,
        reversible=tableau.symmetric,
        stages=True,
    )


def exact_flow(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
    """Return the exact flow to round-off for |omega| dt of up to 2, by steps of dop853."""
    step = _Explicit(DOP853, _Formulation("body"), projected=True)
    for _ in range(_PARTS):
        motion = step(solid, motion, np.asarray(dt) / _PARTS, loads)
    return motion
