"""What Bullet says that it was given, of a body alone and of one on a pivot."""

from __future__ import annotations

import numpy as np
import pybullet

from bodycheck.adapters.contract import ReadBack, Reading
from bodycheck.reference_impl.arrays import Array


def read_back(client: int, body: int, link: int, axes: Array, state: Reading) -> ReadBack:
    """Ask getDynamicsInfo and getPhysicsEngineParameters; I = A diag(moments) A^T.

    link: which of the body's links, -1 its base. axes A (3, 3): the engine's axes as columns, in body axes.
    """
    mass, _, moments, *_ = pybullet.getDynamicsInfo(body, link, client)
    world = pybullet.getPhysicsEngineParameters(client)
    return ReadBack(
        mass=mass,
        inertia=axes @ np.diag(moments) @ axes.T,
        dt_s=world["fixedTimeStep"] / world["numSubSteps"],
        gravity=np.array([world[f"gravityAcceleration{axis}"] for axis in "XYZ"]),
        state=state,
    )
