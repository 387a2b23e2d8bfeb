"""Explicit Runge-Kutta methods on y = (x, v, omega, q), defined by their tableaus."""

from __future__ import annotations

import cmath

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench
from bodycheck.reference_impl.integrators.facts import Advance, Integrator, Tableau
from bodycheck.reference_impl.integrators.right_hand_sides import acceleration, body_torque, gyroscopic
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    add,
    matrix_at,
    matrix_of,
    quaternion_times,
    scaled_add,
    store,
    times,
    transposed_times,
    vector_at,
)


def runge_kutta(
    name: str,
    formula: str,
    order: int,
    tableau: Tableau,
    conserves: str,
    source: str,
    advance: Advance | None = None,
) -> Integrator:
    """Return the method of a tableau for Euler's equations and the quaternion, which is not normalised.

    advance: a kernel for constant loads specialised to this tableau. [default: the generic kernel, which
    takes twice as long]
    """

    def advance_constant(state: Array, body: Array, load: Array, dt: float, steps: int) -> None:
        _advance(state, body, load, None, 0.0, dt, steps, *tableau)

    def advance_forced(
        state: Array, body: Array, load: Array, continuous: Array, begin: float, dt: float, steps: int
    ) -> None:
        _advance(state, body, load, continuous, begin, dt, steps, *tableau)

    def step_angle(x: float) -> float:
        """2 arg R(i x / 2), as q' = q omega / 2."""
        return 2.0 * cmath.phase(tableau.stability_function(0.5j * x))

    return Integrator(
        name=name,
        formula=formula,
        order=order,
        evaluations=len(tableau.b),
        torque="every stage",
        conserves=conserves,
        preserves=frozenset(),
        source=source,
        step_angle=step_angle,
        position_weight=float(tableau.b @ tableau.c),
        attitude="quaternion",
        spin="omega_body",
        advance=advance or advance_constant,
        advance_forced=advance_forced,
        continuous="every stage",
        tableau=tableau,
    )


@kernel
def _rates(t: float, y: Array, body: Array, load: Array, continuous: Array | None, k: Array) -> None:
    """x' = v, v' = F / m, omega' = I^-1 (tau - omega x I omega), q' = q omega / 2, into k (13,)."""
    omega, q = vector_at(y, 6), (y[9], y[10], y[11], y[12])
    rotation = matrix_of(q)
    torque, linear_acceleration = body_torque(rotation, load), acceleration(rotation, load, body[0])
    if continuous is not None:
        omega_world = times(rotation, omega)
        force, couple = continuous_wrench(
            t, vector_at(y, 0), rotation, vector_at(y, 3), omega_world, continuous
        )
        torque = add(torque, transposed_times(rotation, couple))
        linear_acceleration = scaled_add(linear_acceleration, 1.0 / body[0], force)
    net_torque = scaled_add(torque, -1.0, gyroscopic(matrix_at(body, 1), omega))
    store(k, 0, vector_at(y, 3))
    store(k, 3, linear_acceleration)
    store(k, 6, times(matrix_at(body, 10), net_torque))
    k[9], k[10], k[11], k[12] = quaternion_times(q, (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2]))


@kernel
def _advance(
    state: Array,
    body: Array,
    load: Array,
    continuous: Array | None,
    begin: float,
    dt: float,
    steps: int,
    a: Array,
    b: Array,
    c: Array,
) -> None:
    """Advance the state by the steps, in place. omega is in body axes."""
    stages, point = np.zeros((len(b), 13)), np.empty(13)
    for step in range(steps):
        t = begin + step * dt
        for i in range(len(b)):
            for n in range(13):
                increment = 0.0
                for j in range(i):
                    increment += a[i, j] * stages[j, n]
                point[n] = state[n] + dt * increment
            _rates(t + c[i] * dt, point, body, load, continuous, stages[i])
        for n in range(13):
            increment = 0.0
            for i in range(len(b)):
                increment += b[i] * stages[i, n]
            state[n] += dt * increment
