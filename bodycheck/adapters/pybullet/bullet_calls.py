"""Calls that free and pivoted bodies share: parameters read back, many steps in one call."""

from __future__ import annotations

from collections.abc import Iterator

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


_MAX_SUBSTEPS = 2**16  # 50 ms: no longer between two chances of an interrupt


def set_substeps(client: int, dt_s: float, count: int) -> None:
    """Let one call make this many steps, a power of two.

    Then count dt_s, and count dt_s / count, are exact: Bullet makes int(fixedTimeStep / substep) steps,
    and would lose one to a round-off.
    """
    pybullet.setPhysicsEngineParameter(fixedTimeStep=count * dt_s, numSubSteps=count, physicsClientId=client)


def powers_of_two(steps: int) -> Iterator[int]:
    """Yield powers of two, none above _MAX_SUBSTEPS, that sum up to steps."""
    whole, rest = divmod(steps, _MAX_SUBSTEPS)
    for _ in range(whole):
        yield _MAX_SUBSTEPS
    for place in reversed(range(rest.bit_length())):
        if rest >> place & 1:
            yield 1 << place
