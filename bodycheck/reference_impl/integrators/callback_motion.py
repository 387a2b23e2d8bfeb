"""Integrate one body under a force and torque callback, with a Runge-Kutta method evaluated in Python."""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.dop853 import TABLEAU
from bodycheck.reference_impl.integrators.facts import Tableau
from bodycheck.reference_impl.integrators.right_hand_sides import (
    acceleration,
    body_torque,
    gyroscopic,
    packed_body,
)
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
from bodycheck.reference_impl.scene import RigidBody, State, WrenchFunction
from bodycheck.reference_impl.trajectory import Trajectory

_NO_LOAD = np.zeros(21)


def solve_with_callback(
    body: RigidBody, initial: State, wrench: WrenchFunction, t_s: Array, dt_s: float
) -> Trajectory:
    """x' = v, v' = F / m, q' = q omega / 2, omega' = I^-1 (R^T tau - omega x I omega), at the times t_s.

    Uses the method of order 8 of Dormand and Prince.

    t_s (n,): ascending, starting at the time of the initial state. Each sample is the end of a step: between
    two samples, all steps have the same length, the longest that divides the interval and does not exceed
    dt_s. The order is 8 if the wrench is smooth; place a sample at each discontinuity. The quaternion is not
    normalised.

    Raises ValueError, which names the value, for times that do not ascend, dt_s <= 0, a force or torque that
    is not finite or not (3,), and an initial state that is not 13 finite numbers.
    """
    if not 0.0 < dt_s < math.inf:
        raise ValueError(f"dt_s must be a positive number of seconds, got {dt_s!r}")
    t_s = np.asarray(t_s, dtype=np.float64)
    if t_s.ndim != 1 or not np.isfinite(t_s).all() or np.any(np.diff(t_s) <= 0.0):
        raise ValueError(f"t_s must be finite times in ascending order, got {t_s.tolist()}")
    y = np.concatenate([initial.position, initial.velocity, initial.omega_body, initial.quaternion])
    if y.shape != (13,) or not np.isfinite(y).all():
        raise ValueError(f"the initial state must be 13 finite numbers, got {y.tolist()}")
    packed, finite = packed_body(body), _finite(wrench)
    states = np.empty((len(t_s), 13))
    for k, end in enumerate(t_s):
        if k > 0:
            begin = t_s[k - 1]
            steps = math.ceil((end - begin) / dt_s * (1.0 - 1e-12))  # rounding must not add a step
            h = (end - begin) / steps
            for i in range(steps):
                t = float(begin + i * h)
                y = runge_kutta_step(TABLEAU, packed, _NO_LOAD, finite, t, y, float(h))
        states[k] = y
    return Trajectory(
        t_s=t_s,
        position_m=states[:, 0:3],
        velocity_m_s=states[:, 3:6],
        quaternion=states[:, 9:13],
        omega_body_rad_s=states[:, 6:9],
    )


def runge_kutta_step(
    tableau: Tableau, packed: Array, load: Array, wrench: WrenchFunction, t: float, y: Array, h: float
) -> Array:
    """y + h sum b_i k_i (13,), calling the function at each stage.

    packed (19,) and load (21,), which acts in addition to the function, as in right_hand_sides.py.
    y: position, velocity, omega in body axes, quaternion.
    """
    a, b, c = tableau
    k = np.zeros((len(c), 13))
    for i in range(len(c)):
        point = y + h * (a[i] @ k)
        rotation, omega_world = _rotation_and_omega(point)
        force, torque = wrench(t + float(c[i]) * h, point[0:3], rotation, point[3:6], omega_world)
        k[i] = _rates(point, packed, load, force, torque)
    return np.asarray(y + h * (b @ k))


def _finite(wrench: WrenchFunction) -> WrenchFunction:
    """Return the function wrapped: it raises ValueError unless force and torque are finite and (3,)."""

    def checked(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        force, torque = wrench(t, position, rotation, velocity, omega)
        return _checked("force", force, t), _checked("torque", torque, t)

    return checked


def _checked(name: str, value: Array, t: float) -> Array:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (3,) or not all(map(math.isfinite, array)):
        raise ValueError(f"the {name} at t = {t!r} s must be 3 finite numbers, got {value!r}")
    return array


@kernel
def _rotation_and_omega(y: Array) -> tuple[Array, Array]:
    """R (3, 3), and omega (3,) in world axes."""
    rotation = matrix_of((y[9], y[10], y[11], y[12]))
    omega = times(rotation, vector_at(y, 6))
    return np.array(rotation).reshape(3, 3), np.array(omega)


@kernel
def _rates(y: Array, body: Array, load: Array, force: Array, torque: Array) -> Array:
    """The rates of x, v, omega and q under a load, and a force and a torque in world axes."""
    q, omega = (y[9], y[10], y[11], y[12]), vector_at(y, 6)
    rotation = matrix_of(q)
    torque_body = add(body_torque(rotation, load), transposed_times(rotation, vector_at(torque, 0)))
    net_torque = scaled_add(torque_body, -1.0, gyroscopic(matrix_at(body, 1), omega))
    rates = np.empty(13)
    store(rates, 0, vector_at(y, 3))
    store(rates, 3, scaled_add(acceleration(rotation, load, body[0]), 1.0 / body[0], vector_at(force, 0)))
    store(rates, 6, times(matrix_at(body, 10), net_torque))
    attitude = quaternion_times(q, (0.0, 0.5 * omega[0], 0.5 * omega[1], 0.5 * omega[2]))
    rates[9], rates[10], rates[11], rates[12] = attitude
    return rates
