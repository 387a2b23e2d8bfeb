"""Many free bodies at once, on two threads."""

from __future__ import annotations

from functools import partial

import numba
import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.task import Call
from benchmarks.timing import Spread, interleaved
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.batch import advance_batch

_STEPS = 100
_DT_S = 1e-3
_THREADS = 2
_SEED = 2


def batch(effort: Effort) -> list[Measured]:
    """Measure both methods, a hundred steps to a call, all of `advance_batch` and its checks included."""
    state, moments = bodies(effort.bodies)
    threads = min(_THREADS, numba.config.NUMBA_NUM_THREADS)
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        seconds = interleaved(
            [
                Call(partial(advance_batch, state, moments, _DT_S, _STEPS, "rk4")),
                Call(partial(advance_batch, state, moments, _DT_S, _STEPS, "dop853")),
            ],
            effort,
        )
    finally:
        numba.set_num_threads(before)
    note = f"{effort.bodies} bodies, {_STEPS} steps a call, {threads} threads"
    body_steps = float(effort.bodies * _STEPS)
    return [
        Measured.of(f"batch.{method}", Spread.of(body_steps / spent), note)
        for method, spent in zip(("rk4", "dop853"), seconds, strict=True)
    ]


def bodies(count: int) -> tuple[Array, Array]:
    """(13, n), (3, n): at rest at the origin, spinning at some 1 rad/s, each with moments of its own."""
    random = np.random.default_rng(_SEED)
    state = np.zeros((13, count))
    state[6:9] = random.normal(size=(3, count))
    state[9] = 1.0
    squares = random.uniform(0.5, 2.0, (3, count))  # second moments: whatever they are, a body has them
    return state, np.ascontiguousarray(squares.sum(axis=0) - squares)
