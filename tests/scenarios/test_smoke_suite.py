"""The smoke suite detects wrong physics: each fault changes a motion by more than the errors of methods.

The motion with a fault comes from an integrator written here, which shares no code with bodycheck.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bodycheck
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.library import suites

LIBRARY = Path(bodycheck.__file__).parent / "scenarios" / "library"
SMOKE = suites()["smoke"]
STEPS_PER_SAMPLE = 25  # |omega| dt is below 0.06, so the classical Runge-Kutta method is accurate to 1e-6
VISIBLE = 0.02  # rad, or of the scale: the error of a map of order 1 at its finest step is below 0.01


def _same(value: Array) -> Array:
    return value


def _omega(_: Array, omega: Array) -> Array:
    return omega


@dataclass(frozen=True)
class Physics:
    """The physics that an engine might compute; the defaults are correct.

    axes: (kind, axes) of a load -> the axes in which it acts instead. clamp: the limit of each component of
    the velocity or of omega.
    """

    gravity: float = 1.0
    mass: float = 1.0
    gyroscopic: float = 1.0
    moment: float = 1.0
    clock: float = 1.0
    linear_damping: float = 0.0
    angular_damping: float = 0.0
    energy_drag: float = 0.0
    clamp_velocity: float = np.inf
    clamp_omega: float = np.inf
    axes: Mapping[tuple[str, str], str] = field(default_factory=dict)
    inertia: Callable[[Array], Array] = _same
    quaternion_in: Callable[[Array], Array] = _same
    quaternion_out: Callable[[Array], Array] = _same
    omega_in: Callable[[Array, Array], Array] = _omega
    omega_out: Callable[[Array, Array], Array] = _omega


def _matrix(q: Array) -> Array:
    w, v = q[0], q[1:]
    hat = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray((w * w - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * w * hat)


def _conjugate(q: Array) -> Array:
    return np.asarray(q * [1.0, -1.0, -1.0, -1.0])


def _to_world(q: Array, omega: Array) -> Array:
    return np.asarray(_matrix(q) @ omega)


def _to_body(q: Array, omega: Array) -> Array:
    return np.asarray(_matrix(q).T @ omega)


def _without_products(inertia: Array) -> Array:
    return np.diag(np.diag(inertia))


def _with_products_of_other_sign(inertia: Array) -> Array:
    return 2.0 * _without_products(inertia) - inertia


def _permuted(inertia: Array) -> Array:
    return inertia[np.ix_([1, 2, 0], [1, 2, 0])]


def _loads(document: dict[str, Any], physics: Physics, rotation: Array) -> tuple[Array, Array, Array]:
    """Return force in world axes, torque in body axes, acceleration of gravity: (3,) each."""
    force, torque, gravity = np.zeros(3), np.zeros(3), np.zeros(3)
    for load in document["forcing"]:
        if load["kind"] == "gravity":
            gravity += physics.gravity * np.array(load["acceleration_m_s2"])
            continue
        value = np.array(load["value_n" if load["kind"] == "force" else "value_n_m"])
        axes = physics.axes.get((load["kind"], load["axes"]), load["axes"])
        in_body = value if axes == "body" else rotation.T @ value
        if load["kind"] == "force":
            force += rotation @ in_body
            torque += physics.moment * np.cross(load["at_m"], in_body)
        else:
            torque += in_body
    return force, torque, gravity


def _rates(document: dict[str, Any], physics: Physics, state: Array) -> Array:
    """d/dt (x, v, q, omega), omega in body axes: (13,)."""
    v, q, omega = state[3:6], state[6:10], state[10:]
    force, torque, gravity = _loads(document, physics, _matrix(q))
    inertia = physics.inertia(np.array(document["body"]["inertia_kg_m2"]))
    momentum = inertia @ omega
    torque = torque - physics.gyroscopic * np.cross(omega, momentum)
    towards = np.cross(momentum, np.cross(momentum, omega)) / np.linalg.norm(momentum)
    torque = torque + physics.energy_drag * towards  # |L| is constant
    quaternion_rate = 0.5 * np.concatenate([[-q[1:] @ omega], q[0] * omega + np.cross(q[1:], omega)])
    falling = gravity + force / (physics.mass * document["body"]["mass_kg"]) - physics.linear_damping * v
    spinning = np.linalg.solve(inertia, torque) - physics.angular_damping * omega
    return np.concatenate([v, falling, quaternion_rate, spinning])


def _step(document: dict[str, Any], physics: Physics, state: Array, dt_s: float) -> Array:
    """Make one step of the classical Runge-Kutta method, then clamp."""
    rates = partial(_rates, document, physics)
    k1 = rates(state)
    k2 = rates(state + 0.5 * dt_s * k1)
    k3 = rates(state + 0.5 * dt_s * k2)
    k4 = rates(state + dt_s * k3)
    state = state + dt_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    state[3:6] = np.clip(state[3:6], -physics.clamp_velocity, physics.clamp_velocity)
    state[10:] = np.clip(state[10:], -physics.clamp_omega, physics.clamp_omega)
    return np.asarray(state)


@cache
def _document(name: str) -> dict[str, Any]:
    return tomllib.loads((LIBRARY / f"{name}.toml").read_text())


def _motion(name: str, physics: Physics) -> Array:
    """Return (x, v, q, omega) at the scenario's samples: (n, 13)."""
    document = _document(name)
    initial = document["initial"]
    q = np.array(initial["quaternion"])
    omega = physics.omega_in(q, np.array(initial["omega_body_rad_s"]))
    state = np.concatenate(
        [initial["position_m"], initial["velocity_m_s"], physics.quaternion_in(q), omega], dtype=np.float64
    )
    dt_s = physics.clock * document["duration_s"] / (document["samples"] - 1) / STEPS_PER_SAMPLE
    states = [state]
    for _ in range(document["samples"] - 1):
        for _ in range(STEPS_PER_SAMPLE):
            state = _step(document, physics, state, dt_s)
        states.append(state)
    for state in (found := np.array(states)):
        state[10:] = physics.omega_out(state[6:10], state[10:])
        state[6:10] = physics.quaternion_out(state[6:10])
    return found


@cache
def _truth(name: str) -> Array:
    """Return the certified (x, v, q, omega) at the scenario's samples: (n, 13)."""
    document = _document(name)
    times = np.linspace(0.0, document["duration_s"], document["samples"])
    found = bodycheck.truth(name, times.tolist()).trajectory
    assert found.quaternion is not None
    parts = (found.position_m, found.velocity_m_s, found.quaternion, found.omega_body)
    return np.concatenate(parts, axis=1)


def _departure(name: str, physics: Physics) -> float:
    """Return the largest distance from the truth: an angle in rad, or over the quantity's largest value."""
    truth, found = _truth(name), _motion(name, physics)
    cosines = np.abs(np.sum(truth[:, 6:10] * found[:, 6:10], axis=1))
    cosines /= np.linalg.norm(found[:, 6:10], axis=1) * np.linalg.norm(truth[:, 6:10], axis=1)
    angle = float(np.max(2.0 * np.arccos(np.minimum(cosines, 1.0))))
    vectors = (slice(0, 3), slice(3, 6), slice(10, 13))
    return max(angle, *(_relative(truth[:, part], found[:, part]) for part in vectors))


def _relative(truth: Array, found: Array) -> float:
    size = np.max(np.linalg.norm(truth, axis=1))
    return float(np.max(np.linalg.norm(found - truth, axis=1)) / size)


FAULTS = {
    "no gravity": Physics(gravity=0.0),
    "doubled gravity": Physics(gravity=2.0),
    "doubled mass": Physics(mass=2.0),
    "doubled inertia": Physics(inertia=lambda inertia: 2.0 * inertia),
    "force at the centre": Physics(moment=0.0),
    "moment of other sign": Physics(moment=-1.0),
    "no gyroscopic term": Physics(gyroscopic=0.0),
    "gyroscopic term of other sign": Physics(gyroscopic=-1.0),
    "linear damping": Physics(linear_damping=0.04),
    "angular damping": Physics(angular_damping=0.04),
    "energy dragged to that of the largest moment": Physics(energy_drag=0.1),
    "clamp of the velocity": Physics(clamp_velocity=100.0),
    "clamp of omega": Physics(clamp_omega=100.0),
    "clock 1 % fast": Physics(clock=1.01),
    "clock 1 % slow": Physics(clock=0.99),
    "body torque in world axes": Physics(axes={("torque", "body"): "world"}),
    "world torque in body axes": Physics(axes={("torque", "world"): "body"}),
    "body force in world axes": Physics(axes={("force", "body"): "world"}),
    "world force in body axes": Physics(axes={("force", "world"): "body"}),
    "products of inertia dropped": Physics(inertia=_without_products),
    "products of inertia of other sign": Physics(inertia=_with_products_of_other_sign),
    "axes of the inertia permuted": Physics(inertia=_permuted),
    "quaternion conjugated at the start": Physics(quaternion_in=_conjugate),
    "quaternion conjugated when read": Physics(quaternion_out=_conjugate),
    "quaternion conjugated both ways": Physics(quaternion_in=_conjugate, quaternion_out=_conjugate),
    "omega set in world axes": Physics(omega_in=_to_world),
    "omega set in body axes for world": Physics(omega_in=_to_body),
    "omega read in world axes": Physics(omega_out=_to_world),
}


@pytest.mark.parametrize("name", SMOKE)
def test_motion_without_a_fault_equals_the_truth(name: str) -> None:
    """Correct physics, integrated by independent code, agrees with the certified truth."""
    assert _departure(name, Physics()) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_changes_the_smoke_suite(fault: str) -> None:
    """In at least one scenario the wrong motion differs from the truth by more than the errors of methods."""
    assert any(_departure(name, FAULTS[fault]) > VISIBLE for name in SMOKE)
