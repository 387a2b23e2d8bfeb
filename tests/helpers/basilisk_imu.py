"""Print how far Basilisk's ImuSensor is from the exact readings after three steps of each length, as JSON."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from Basilisk.simulation import extForceTorque, imuSensor, spacecraft, svIntegrators

MASS, INERTIA = 1.3, np.array([[0.8, 0.1, -0.15], [0.1, 1.0, 0.05], [-0.15, 0.05, 1.2]])
PLACE, FORCE, TORQUE = np.array([0.6, -0.48, 0.64]), np.array([0.3, 0.0, 0.1]), np.array([0.1, 0.2, 0.3])


def column(values: Any) -> list[list[float]]:
    """(3,) -> a column, as Basilisk takes it."""
    return [[float(value)] for value in values]


def departure(step_ns: int) -> dict[str, float]:
    """Return the largest departures of accelerometer and gyro, and what a dropped omega x v would make."""
    craft = spacecraft.Spacecraft()
    craft.hub.mHub, craft.hub.IHubPntBc_B, craft.hub.r_BcB_B = MASS, INERTIA.tolist(), column(np.zeros(3))
    craft.hub.omega_BN_BInit, craft.hub.v_CN_NInit = column(np.ones(3)), column([0.5, -0.1, 0.2])
    loads = extForceTorque.ExtForceTorque()
    loads.extForce_B, loads.extTorquePntB_B = column(FORCE), column(TORQUE)
    craft.addDynamicEffector(loads)
    integrator = svIntegrators.svIntegratorRK4(craft)
    craft.setIntegrator(integrator)
    sensor = imuSensor.ImuSensor()
    sensor.setBodyToPlatformDCM(0.0, 0.0, 0.0)
    sensor.sensorPos_B = PLACE.tolist()
    sensor.scStateInMsg.subscribeTo(craft.scStateOutMsg)
    craft.Reset(0)
    sensor.Reset(0)
    for step in range(4):
        craft.UpdateState(step * step_ns)
        sensor.UpdateState(step * step_ns)
    state, read = craft.scStateOutMsg.read(), sensor.sensorOutMsg.read()
    omega = np.array(state.omega_BN_B)
    spin_up = np.linalg.solve(INERTIA, TORQUE - np.cross(omega, INERTIA @ omega))
    exact = FORCE / MASS + np.cross(spin_up, PLACE) + np.cross(omega, np.cross(omega, PLACE))
    return {
        "accelerometer": float(np.abs(read.AccelPlatform - exact).max()),
        "gyro": float(np.abs(read.AngVelPlatform - omega).max()),
        "omega x v": float(np.abs(np.cross(omega, state.v_CN_N)).max()),
    }


if __name__ == "__main__":
    print(json.dumps({step: departure(step) for step in (1_000, 100_000, 10_000_000)}))
