"""Basilisk by itself."""

from __future__ import annotations

import numpy as np
from Basilisk.simulation import spacecraft, sphericalPendulum
from Basilisk.utilities import SimulationBaseClass, macros

_DT, _DAMPING, _LENGTH = 0.01, 10.0, 0.5


def pendulum_damping() -> list[float]:
    """Energy that a spacecraft with a damped pendulum loses in 10 s, and the work of the damper, J.

    The damper resists the velocity of a mass of 20 kg, 0.5 m from its pivot, by 10 N s/m in every direction;
    its work is the integral of D L^2 (phi'^2 cos^2 theta + theta'^2). The third is the energy that is lost
    if it resists one direction only, by 30 N s/m.
    """
    lost, work = _lost_and_work(_DAMPING * np.eye(3))
    return [round(lost, 6), work, _lost_and_work(np.diag([0.0, 30.0, 0.0]))[0]]


def _lost_and_work(damping: np.ndarray) -> tuple[float, float]:
    """Return the energy that is lost, and the work of an isotropic damper of _DAMPING."""
    simulation = SimulationBaseClass.SimBaseClass()
    simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("task", macros.sec2nano(_DT)))
    craft, pendulum = spacecraft.Spacecraft(), sphericalPendulum.SphericalPendulum()
    craft.hub.mHub, craft.hub.IHubPntBc_B = 100.0, np.diag([90.0, 80.0, 60.0]).tolist()
    craft.hub.omega_BN_BInit = [[1.0], [0.5], [0.1]]
    pendulum.massInit, pendulum.pendulumRadius = 20.0, _LENGTH
    pendulum.d, pendulum.D = [[0.1], [0.1], [0.1]], damping.tolist()
    pendulum.phiDotInit, pendulum.thetaDotInit = 0.3, 0.4
    craft.addStateEffector(pendulum)
    simulation.AddModelToTask("task", craft)
    energy = craft.logger(["totRotEnergy"])
    simulation.AddModelToTask("task", energy)
    simulation.InitializeSimulation()
    names = (pendulum.nameOfThetaState, pendulum.nameOfPhiDotState, pendulum.nameOfThetaDotState)
    powers = []
    for step in range(1001):
        simulation.ConfigureStopTime(macros.sec2nano(step * _DT))
        simulation.ExecuteSimulation()
        states = (craft.dynManager.getStateObject(name).getState() for name in names)
        theta, phi_rate, theta_rate = (float(np.ravel(state)[0]) for state in states)
        powers.append(_DAMPING * _LENGTH**2 * ((phi_rate * np.cos(theta)) ** 2 + theta_rate**2))
    lost = np.array(energy.totRotEnergy)
    work = _DT * (sum(powers) - 0.5 * (powers[0] + powers[-1]))
    return float(lost[1] - lost[-1]), work
