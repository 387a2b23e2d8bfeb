"""Many steps of Bullet in one call of stepSimulation."""

from __future__ import annotations

from collections.abc import Iterator

import pybullet

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
