"""Evaluate continuous loads in fixed steps: at every stage, or at the start of a step (zero-order hold)."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from bodycheck._util.pinned_libraries import numba
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench
from bodycheck.reference_impl.integrators.callback_motion import runge_kutta_step
from bodycheck.reference_impl.integrators.facts import AdvanceForced, Integrator, Spin
from bodycheck.reference_impl.kernels.jit import Kernel, kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Mat,
    Vec,
    add,
    matrix_at,
    matrix_of,
    store,
    times,
    transposed_times,
    vector_at,
)
from bodycheck.reference_impl.scene import WrenchFunction

_BODY, _WORLD, _MOMENTUM = range(3)
_SPINS: dict[Spin, int] = {"omega_body": _BODY, "omega_world": _WORLD, "angular_momentum": _MOMENTUM}


def with_zero_order_hold(advance: Kernel, spin: Spin) -> AdvanceForced:
    """Return the stepper of a method that holds continuous loads constant over the step (zero-order hold)."""

    def advance_forced(
        state: Array, body: Array, load: Array, continuous: Array, begin: float, dt: float, steps: int
    ) -> None:
        _compiled()(advance.dispatcher, _SPINS[spin], state, body, load, continuous, begin, dt, steps)

    return advance_forced


@kernel
def _omega_world(spin: Vec, kind: int, rotation: Mat, body: Array) -> Vec:
    """omega in world axes, from omega in body axes, omega in world axes, or L in world axes."""
    if kind == _BODY:
        return times(rotation, spin)
    if kind == _WORLD:
        return spin
    return times(rotation, times(matrix_at(body, 10), transposed_times(rotation, spin)))


def _advance_zero_order_hold(
    advance: Callable[..., None],
    kind: int,
    state: Array,
    body: Array,
    load: Array,
    continuous: Array,
    begin: float,
    dt: float,
    steps: int,
) -> None:
    """Advance the state by the steps, in place, with continuous loads held constant over each."""
    total_load = load.copy()
    for step in range(steps):
        if len(state) == 13:
            rotation = matrix_of((state[9], state[10], state[11], state[12]))
        else:
            rotation = matrix_at(state, 9)
        omega = _omega_world(vector_at(state, 6), kind, rotation, body)
        position, velocity = vector_at(state, 0), vector_at(state, 3)
        force, torque = continuous_wrench(begin + step * dt, position, rotation, velocity, omega, continuous)
        store(total_load, 3, add(vector_at(load, 3), force))
        store(total_load, 9, add(vector_at(load, 9), torque))
        advance(state, body, total_load, dt, 1)


@cache
def _compiled() -> Any:
    """Compile once for all methods: the method is passed as a function pointer."""
    types = numba().types

    array = types.float64[::1]
    method = types.FunctionType(types.void(array, array, array, types.float64, types.int64))
    compiled = kernel(_advance_zero_order_hold).dispatcher
    compiled.compile(
        types.void(
            method,
            types.int64,
            array,
            array,
            array,
            array,
            types.float64,
            types.float64,
            types.int64,
        )
    )
    compiled.disable_compile()
    return compiled


_FORCE_WORLD, _TORQUE_WORLD = slice(3, 6), slice(9, 12)


def supports_callbacks(method: Integrator) -> bool:
    """Whether Python can call the load: the method needs it at the start of a step, or has a tableau."""
    return method.continuous == "zero-order hold" or method.tableau is not None


def advance_with_callback(
    method: Integrator,
    wrench: WrenchFunction,
    state: Array,
    body: Array,
    load: Array,
    begin: float,
    dt: float,
    steps: int,
) -> None:
    """Advance the state by the steps, in place, under a constant load and a function.

    method: one for which `supports_callbacks` is true. state, body and load: as for Integrator.advance.
    begin: the time in s at the start of the first step.
    """
    for step in range(steps):
        t = begin + step * dt
        if method.tableau is not None:
            state[:] = runge_kutta_step(method.tableau, body, load, wrench, t, state, dt)
            continue
        rotation = rotation_of_state(method, state)
        omega = omega_world(method, state, body, rotation)
        force, torque = wrench(t, state[0:3], rotation, state[3:6], omega)
        total_load = load.copy()
        total_load[_FORCE_WORLD] += force
        total_load[_TORQUE_WORLD] += torque
        method.advance(state, body, total_load, dt, 1)


def rotation_of_state(method: Integrator, state: Array) -> Array:
    """R (3, 3) of a state. If the state holds a matrix, it is returned unchanged, orthogonal or not."""
    numbers = state[9:]
    if method.attitude == "quaternion":
        numbers = np.array(matrix_of(tuple(numbers.tolist())))
    return numbers.reshape(3, 3)


def omega_world(method: Integrator, state: Array, body: Array, rotation: Array) -> Array:
    """omega (3,) in world axes of a state: omega, R omega, or R I^-1 R^T L, with the R of the method."""
    spin = state[6:9]
    match method.spin:
        case "omega_world":
            return spin
        case "omega_body":
            return rotation @ spin
        case "angular_momentum":
            return rotation @ (body[10:].reshape(3, 3) @ (rotation.T @ spin))
