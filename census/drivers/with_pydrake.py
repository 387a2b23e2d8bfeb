"""Drake by itself."""

from __future__ import annotations

import numpy as np
from exact import SPIN, TOP, angle, of_quaternion, order, top
from pydrake.all import (
    DiagramBuilder,
    MultibodyPlant,
    ResetIntegratorFromFlags,
    Simulator,
    RotationalInertia,
    SpatialInertia,
)


def _free(dt: float, scheme: str, attitude: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Return quaternion and omega in world axes of the symmetric top after a time."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(dt if scheme == "discrete" else 0.0))
    inertia = SpatialInertia.MakeFromCentralInertia(1.0, np.zeros(3), RotationalInertia(*TOP))
    plant.AddRigidBody("b", inertia)
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    if scheme != "discrete":
        ResetIntegratorFromFlags(simulator, scheme, dt)
        simulator.get_mutable_integrator().set_fixed_step_mode(True)
    start = of_quaternion(*attitude)
    plant.SetPositions(context, np.concatenate([attitude, np.zeros(3)]))
    plant.SetVelocities(context, np.concatenate([start @ SPIN, np.zeros(3)]))
    simulator.AdvanceTo(time)
    return plant.GetPositions(context)[:4], plant.GetVelocities(context)[:3]


_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def quaternion_norm() -> list[float]:
    """|q| - 1 after 10 s in discrete steps of 1e-2 s, and how it falls with the step."""
    found = [
        abs(float(np.linalg.norm(_free(dt, "discrete", _IDENTITY, 10.0)[0])) - 1.0) for dt in (1e-2, 5e-3)
    ]
    return [found[0], order(*found)]


def turned_axes() -> list[float]:
    """Angle between two motions that differ by the world's axes alone, by radau1 and RK3."""
    half = 0.6
    turned = np.array([np.cos(half), np.sin(half) * 0.6, 0.0, np.sin(half) * 0.8])
    found = []
    for scheme in ("radau1", "runge_kutta3"):
        first, second = (of_quaternion(*_free(0.1, scheme, start, 1.0)[0]) for start in (_IDENTITY, turned))
        found.append(angle(of_quaternion(*turned) @ first, second))
    return found


def discrete_order() -> list[float]:
    """Error of a symmetric top after 1 s in discrete steps of 1e-3 s, and its order."""
    found = [angle(top(1.0), of_quaternion(*_free(dt, "discrete", _IDENTITY, 1.0)[0])) for dt in (2e-3, 1e-3)]
    return [found[1], order(*found)]
