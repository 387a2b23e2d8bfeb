"""Basilisk: the hub of a spacecraft by each integrator with fixed steps.

The state is position and velocity of the centre of mass in the inertial frame N, modified Rodrigues
parameters (the attitude of the body frame B in N) and omega in B. The adapter calls the integrator itself,
because times of the simulation are whole nanoseconds, and then the hub's change to the shadow set.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import BetweenSteps, FreeBodiesOnly, array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene, State

_INTEGRATORS = {
    "euler": ("svIntegratorEuler", 1),
    "rk2": ("svIntegratorRK2", 2),
    "rk4": ("svIntegratorRK4", 4),
}
_FORMULAS = {
    "euler": "y += h f(y), y = (x, v, modified Rodrigues parameters, omega)",
    "rk2": "Runge-Kutta of order 2 for y = (x, v, modified Rodrigues parameters, omega)",
    "rk4": "classical Runge-Kutta 4 for y = (x, v, modified Rodrigues parameters, omega)",
}


def _method_of(name: str) -> Method:
    called, order = _INTEGRATORS[name]
    return Method(
        name=name,
        formula=_FORMULAS[name],
        order=order,
        evaluations=order,
        torque="zero-order hold",
        conserves="|q| = 1; linear momentum",
        source=f"Basilisk, {called}; Kenneally, Piggott and Schaub (2020), J. Aerosp. Inf. Syst. 17, 496",
        changed_defaults=("steps that need not be whole nanoseconds",),
        snippet=f"spacecraft.setIntegrator(svIntegrators.{called}(spacecraft)); "
        "process.addTask(simulation.CreateNewTask('dynamics', macros.sec2nano({dt_s})))",
    )


class Basilisk(FreeBodiesOnly):
    """Basilisk (Autonomous Vehicle Systems Laboratory, University of Colorado)."""

    name = "basilisk"
    distribution = "bsk"
    requires = ("bsk>=2.10",)
    modules = ("Basilisk.simulation.spacecraft",)
    methods: Mapping[str, Method] = {name: _method_of(name) for name in _INTEGRATORS}

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a spacecraft of a hub alone."""
        return BetweenSteps(scene, dt_s, _Hub(scene, method, dt_s))


class _Hub:
    stepping: Stepping = "python"

    def __init__(self, scene: Scene, method: str, dt_s: float) -> None:
        from Basilisk.simulation import extForceTorque, spacecraft, svIntegrators

        self._dt_s, self._weight = dt_s, scene.body.mass * scene.gravity
        self._spacecraft: Any = spacecraft.Spacecraft()
        hub = self._spacecraft.hub
        hub.mHub, hub.IHubPntBc_B = scene.body.mass, scene.body.inertia.tolist()
        hub.r_BcB_B = _column(np.zeros(3))
        self._loads: Any = extForceTorque.ExtForceTorque()
        self._loads.extForce_N = _column(self._weight)
        self._spacecraft.addDynamicEffector(self._loads)
        self._integrator: Any = getattr(svIntegrators, _INTEGRATORS[method][0])(self._spacecraft)
        self._spacecraft.setIntegrator(self._integrator)
        self._spacecraft.Reset(0)
        names = (hub.nameOfHubPosition, hub.nameOfHubVelocity, hub.nameOfHubSigma, hub.nameOfHubOmega)
        self._states = [self._spacecraft.dynManager.getStateObject(name) for name in names]

    def model(self) -> tuple[float, Array, float, Array]:
        mass = float(self._spacecraft.hub.mHub)
        return (
            mass,
            array(self._spacecraft.hub.IHubPntBc_B),
            self._dt_s,
            array(self._loads.extForce_N).ravel() / mass,
        )

    def set_state(self, state: State) -> None:
        values = (state.position, state.velocity, _rodrigues(state.quaternion), state.omega_body)
        for held, value in zip(self._states, values, strict=True):
            held.setState(_column(value))
        self._steps = 0

    def step(self, steps: int, force: Array, torque: Array) -> None:
        in_body = quaternion_to_matrix(self.read().quaternion).T @ torque  # type: ignore[arg-type]
        self._loads.extForce_N = _column(self._weight + force)
        self._loads.extTorquePntB_B = _column(in_body)
        for _ in range(steps):
            self._integrator.integrate(self._steps * self._dt_s, self._dt_s)
            self._spacecraft.hub.modifyStates(self._dt_s)
            self._steps += 1
        self._loads.extForce_N = _column(self._weight)

    def read(self) -> Reading:
        position, velocity, sigma, omega = (array(held.getState()).ravel() for held in self._states)
        return Reading(position, velocity, quaternion=_quaternion(sigma), omega_body=omega)


def _column(vector: Array) -> list[list[float]]:
    return [[float(value)] for value in vector]


def _rodrigues(q: Array) -> Array:
    """sigma = q_vec / (1 + q_w) of the shorter rotation, (4,) scalar first -> (3,)."""
    shorter = -q if q[0] < 0.0 else q
    return np.asarray(shorter[1:] / (float(np.linalg.norm(q)) + shorter[0]))


def _quaternion(sigma: Array) -> Array:
    """q = (1 - sigma^2, 2 sigma) / (1 + sigma^2), (3,) -> (4,) scalar first."""
    square = float(sigma @ sigma)
    return np.concatenate([[1.0 - square], 2.0 * sigma]) / (1.0 + square)
