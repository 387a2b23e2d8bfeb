"""Loads that only a function knows: asked at every stage of a tableau, else at each step's start and held."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.black_box import stage_by_stage_asking
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.registers import matrix_of
from bodycheck.reference_impl.scene import Wrenching

_FORCE_WORLD, _TORQUE_WORLD = slice(3, 6), slice(9, 12)


def can_ask(method: Integrator) -> bool:
    """Whether its loads are needed where Python can be asked: at a step's start, or at a tableau's stages."""
    return method.lasting == "held over the step" or method.tableau is not None


def advance_asking(
    method: Integrator,
    wrench: Wrenching,
    state: Array,
    body: Array,
    load: Array,
    begin: float,
    dt: float,
    steps: int,
) -> None:
    """Make the steps in place under a constant load and the function's, for a method that `can_ask`.

    state, body and load as of Integrator.advance; begin: the time in s at which the first step begins.
    """
    for step in range(steps):
        t = begin + step * dt
        if method.tableau is not None:
            state[:] = stage_by_stage_asking(method.tableau, body, load, wrench, t, state, dt)
            continue
        rotation = rotation_held(method, state)
        omega = omega_world(method, state, body, rotation)
        force, torque = wrench(t, state[0:3], rotation, state[3:6], omega)
        held = load.copy()
        held[_FORCE_WORLD] += force
        held[_TORQUE_WORLD] += torque
        method.advance(state, body, held, dt, 1)


def rotation_held(method: Integrator, state: Array) -> Array:
    """R (3, 3) of a state; of a method that carries a matrix that matrix itself, whatever became of it."""
    numbers = state[9:]
    if method.attitude == "quaternion":
        numbers = np.array(matrix_of(tuple(numbers.tolist())))
    return numbers.reshape(3, 3)


def omega_world(method: Integrator, state: Array, body: Array, rotation: Array) -> Array:
    """omega (3,) in world axes of a state: as it is, R omega, or R I^-1 R^T L, by the method's own R."""
    spin = state[6:9]
    match method.spin:
        case "omega_world":
            return spin
        case "omega_body":
            return rotation @ spin
        case "angular_momentum":
            return rotation @ (body[10:].reshape(3, 3) @ (rotation.T @ spin))
