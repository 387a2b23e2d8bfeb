"""Lasting loads evaluated at the start of each step and held over it, for methods of one evaluation."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from numba import types

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.equations import matrix_at, store, vector_at
from bodycheck.reference_impl.integrators.facts import Advance, AdvanceUnder, Spin
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.lasting import lasting_wrench
from bodycheck.reference_impl.registers import Mat, Vec, add, matrix_of, times, transposed_times

_BODY, _WORLD, _MOMENTUM = range(3)
_SPINS: dict[Spin, int] = {"omega_body": _BODY, "omega_world": _WORLD, "angular_momentum": _MOMENTUM}


def held_over_steps(advance: Advance, spin: Spin) -> AdvanceUnder:
    """Return how a method steps under lasting loads that it holds over each step."""

    def advance_under(
        state: Array, body: Array, load: Array, lasting: Array, begin: float, dt: float, steps: int
    ) -> None:
        _compiled()(advance, _SPINS[spin], state, body, load, lasting, begin, dt, steps)

    return advance_under


@kernel
def _omega_world(spin: Vec, kind: int, rotation: Mat, body: Array) -> Vec:
    """omega in world axes of omega in body axes, in world axes, or of L in world axes."""
    if kind == _BODY:
        return times(rotation, spin)
    if kind == _WORLD:
        return spin
    return times(rotation, times(matrix_at(body, 10), transposed_times(rotation, spin)))


def _advance_held(
    advance: Callable[..., None],
    kind: int,
    state: Array,
    body: Array,
    load: Array,
    lasting: Array,
    begin: float,
    dt: float,
    steps: int,
) -> None:
    """Make the steps in place, each under load and what the lasting loads are at its start."""
    held = load.copy()
    for step in range(steps):
        if len(state) == 13:
            rotation = matrix_of((state[9], state[10], state[11], state[12]))
        else:
            rotation = matrix_at(state, 9)
        omega = _omega_world(vector_at(state, 6), kind, rotation, body)
        position, velocity = vector_at(state, 0), vector_at(state, 3)
        force, torque = lasting_wrench(begin + step * dt, position, rotation, velocity, omega, lasting)
        store(held, 3, add(vector_at(load, 3), force))
        store(held, 9, add(vector_at(load, 9), torque))
        advance(state, body, held, dt, 1)


@cache
def _compiled() -> Any:
    """Compile once for all methods: the method is called by its address."""
    array = types.float64[::1]
    method = types.FunctionType(types.void(array, array, array, types.float64, types.int64))
    compiled = kernel(_advance_held)
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
