"""Free rotation in closed form: what one more time costs, and what the set-up costs."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.problems import FREE_LONG
from benchmarks.task import Call
from benchmarks.timing import Spread, interleaved
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.rotations import exp_matrix

_TIMES = 10_000
_TURN = exp_matrix(np.array([0.3, -0.5, 0.7]))


def closed_form(effort: Effort) -> list[Measured]:
    """Measure at 10 000 times within 1000 s, and set up with a diagonal and a full tensor."""
    scene = FREE_LONG.scene
    diagonal = scene.body.inertia
    full = _TURN @ diagonal @ _TURN.T
    quaternion, omega = scene.initial.quaternion, scene.initial.omega_body
    motion = FreeRotation.from_state(diagonal, quaternion, omega)
    tasks = (
        Call(partial(motion.at, np.linspace(0.0, scene.duration_s, _TIMES))),
        Call(partial(FreeRotation.from_state, diagonal, quaternion, omega)),
        Call(partial(FreeRotation.from_state, 0.5 * (full + full.T), quaternion, _TURN @ omega)),
    )
    evaluation, principal, tensor = interleaved(tasks, effort)
    return [
        Measured.of("free.time", Spread.of(evaluation).scaled(1e9 / _TIMES)),
        Measured.of("free.set-up.diagonal", Spread.of(principal).scaled(1e6)),
        Measured.of("free.set-up.full", Spread.of(tensor).scaled(1e6)),
    ]
