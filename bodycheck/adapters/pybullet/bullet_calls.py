"""Calls shared by free and pivoted bodies: read parameters back, make many steps in one call."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pybullet

from bodycheck.adapters.contract import ReadBack, Reading
from bodycheck.reference_impl.arrays import Array


def read_back(client: int, body: int, link: int, axes: Array, state: Reading) -> ReadBack:
    """I = A diag(moments) A^T: read the model from getDynamicsInfo and getPhysicsEngineParameters.

    link: index of the link, -1 for the base. axes A (3, 3): the engine's axes as columns, in body axes.
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


_MAX_SUBSTEPS = 2**16  # 50 ms, so that an interrupt is handled soon


def set_substeps(client: int, dt_s: float, count: int) -> None:
    """Make one call perform `count` steps, a power of two.

    Then count dt_s and count dt_s / count are exact. Bullet makes int(fixedTimeStep / substep) steps, and
    round-off would cost one of them.
    """
    pybullet.setPhysicsEngineParameter(fixedTimeStep=count * dt_s, numSubSteps=count, physicsClientId=client)


def powers_of_two(steps: int) -> Iterator[int]:
    """Yield powers of two, at most _MAX_SUBSTEPS, whose sum is `steps`."""
    full_calls, rest = divmod(steps, _MAX_SUBSTEPS)
    for _ in range(full_calls):
        yield _MAX_SUBSTEPS
    for place in reversed(range(rest.bit_length())):
        if rest >> place & 1:
            yield 1 << place
