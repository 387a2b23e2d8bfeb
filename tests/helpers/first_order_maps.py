"""One step of omega by the maps that the engines' first-order methods are.

Each takes the inertia tensor (3, 3), omega and the torque (3,), all in body axes, and the step h in s, and
returns the increment of omega (3,).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bodycheck.reference_impl.arrays import Array

SpinStep = Callable[[Array, Array, Array, float], Array]


def skew(v: Array) -> Array:
    """[v]x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def explicit_step(inertia: Array, omega: Array, torque: Array, h: float) -> Array:
    """h I^-1 (tau - omega x I omega)."""
    return h * np.linalg.solve(inertia, torque - np.cross(omega, inertia @ omega))


def implicit_step(inertia: Array, omega: Array, torque: Array, h: float) -> Array:
    """h (I + h D)^-1 (tau - omega x I omega), D = [omega]x I - [I omega]x."""
    derivative = skew(omega) @ inertia - skew(inertia @ omega)
    return h * np.linalg.solve(inertia + h * derivative, torque - np.cross(omega, inertia @ omega))


def implicit_gyroscopic_step(inertia: Array, omega: Array, torque: Array, h: float) -> Array:
    """h I^-1 tau - h (I + h D)^-1 (omega x I omega)."""
    gyroscopic = implicit_step(inertia, omega, np.zeros(3), h)
    return gyroscopic + h * np.linalg.solve(inertia, torque)
