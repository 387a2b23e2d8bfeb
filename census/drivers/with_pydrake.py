"""Drake by itself."""

from __future__ import annotations

import numpy as np
from exact import SPIN, TOP, Array, angle, of_quaternion, order, top
from pydrake.all import DiagramBuilder, MultibodyPlant, Simulator, RotationalInertia, SpatialInertia


def _quaternion(dt: float, time: float) -> Array:
    """Return the quaternion of the symmetric top after a time in discrete steps."""
    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(dt))
    plant.AddRigidBody("b", SpatialInertia.MakeFromCentralInertia(1.0, np.zeros(3), RotationalInertia(*TOP)))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetVelocities(context, np.concatenate([SPIN, np.zeros(3)]))
    simulator.AdvanceTo(time)
    return np.array(plant.GetPositions(context)[:4])


def quaternion_norm() -> list[float]:
    """|q| - 1 after 10 s in discrete steps of 1e-2 s, and how it falls with the step."""
    found = [abs(float(np.linalg.norm(_quaternion(dt, 10.0))) - 1.0) for dt in (1e-2, 5e-3)]
    return [found[0], order(*found)]


def discrete_order() -> list[float]:
    """Error of a symmetric top after 1 s in discrete steps of 1e-3 s, and its order."""
    found = [angle(top(1.0), of_quaternion(*_quaternion(dt, 1.0))) for dt in (2e-3, 1e-3)]
    return [found[1], order(*found)]
