"""Input of the solvers that are specialised to one body: principal moments and a constant world torque."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene, Torque


def principal_case(scene: Scene) -> tuple[list[float], list[float]]:
    """Return the moments in kg m^2 and the sum of the world torques in N m, three numbers each.

    Raises ValueError for a body whose axes are not principal axes, and for any other load.
    """
    moments = np.diagonal(scene.body.inertia)
    if not np.array_equal(scene.body.inertia, np.diag(moments)):
        raise ValueError(f"inertia must be diagonal, got {scene.body.inertia.tolist()}")
    torque: Array = np.zeros(3)
    for load in scene.loads:
        if not isinstance(load, Torque) or load.axes != "world" or load.from_s > 0.0:
            raise ValueError(f"only a constant world torque is supported, got {load!r}")
        torque = torque + load.value
    return moments.tolist(), torque.tolist()


def start_of(scene: Scene) -> Array:
    """(7,): the quaternion and omega_body at the start."""
    return np.concatenate([scene.initial.quaternion, scene.initial.omega_body])
