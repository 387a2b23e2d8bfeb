"""Force and torque of loads at given instants, about the centre of mass, in world axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Instants, Load, WrenchFunction, checked
from bodycheck.reference_impl.scene import Scene


def wrench_at(load: Load, scene: Scene, instants: Instants) -> tuple[Array, Array]:
    """Return force and torque (..., 3) about the centre of mass, in N and N m, world axes.

    A load with a limited duration is treated as acting. The docstrings of the loads give the formulas.
    """
    return checked(load, "the sum of forces and torques").wrench(scene, instants)


def sum_of_wrenches(loads: Sequence[Load], scene: Scene) -> WrenchFunction:
    """Return one function of the motion that sums these loads and the weight."""

    def wrench(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        instants = Instants(np.array(t), position, rotation, velocity, omega)
        force, torque = scene.body.mass * scene.gravity, np.zeros(3)
        for load in loads:
            push, couple = wrench_at(load, scene, instants)
            force, torque = force + push, torque + couple
        return force, torque

    return wrench


def continuous_wrench_of(scene: Scene) -> WrenchFunction:
    """Return one function of the motion that sums the scene's continuous loads, including callback loads.

    Force and torque are NaN where the motion is not finite; no callback is called there.
    """
    wrench = sum_of_wrenches(scene.continuous_loads, replace(scene, gravity=np.zeros(3)))

    def continuous(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        if not np.isfinite([*position, *rotation.flat, *velocity, *omega]).all():
            return np.full(3, np.nan), np.full(3, np.nan)
        return wrench(t, position, rotation, velocity, omega)

    return continuous
