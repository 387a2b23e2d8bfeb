"""Many steps in one call of PyBullet's stepSimulation, as its substeps."""

from __future__ import annotations

from collections.abc import Iterator

import pybullet

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
