"""Many free bodies at once, on two threads."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.task import Call
from benchmarks.timing import Spread, interleaved
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.batch import BatchMethod, advance_batch

_STEPS = 100
_DT_S = 1e-3
_THREADS = 2
_SEED = 2


def batch(effort: Effort) -> list[Measured]:
    """Measure both methods, a hundred steps to a call; each thread steps an equal part of the bodies."""
    state, moments = bodies(effort.bodies)
    threads = min(_THREADS, os.cpu_count() or 1)
    arrays = (state, moments, np.zeros_like(moments))
    parts = [
        [np.ascontiguousarray(array[:, rows]) for array in arrays]
        for rows in np.array_split(np.arange(effort.bodies), threads)
    ]
    methods: tuple[BatchMethod, ...] = ("rk4", "dop853")
    with ThreadPoolExecutor(threads) as pool:
        seconds = interleaved([Call(partial(_advance, pool, parts, method)) for method in methods], effort)
    note = f"{effort.bodies} bodies, {_STEPS} steps a call, {threads} threads"
    body_steps = float(effort.bodies * _STEPS)
    return [
        Measured.of(f"batch.{method}", Spread.of(body_steps / spent), note)
        for method, spent in zip(methods, seconds, strict=True)
    ]


def _advance(pool: ThreadPoolExecutor, parts: Sequence[Sequence[Array]], method: BatchMethod) -> None:
    """Step every part, whose arrays are those of `advance_batch`, in a thread of its own."""
    made = [
        pool.submit(advance_batch, state, moments, torque, _DT_S, _STEPS, method)
        for state, moments, torque in parts
    ]
    for one in made:
        one.result()


def bodies(count: int) -> tuple[Array, Array]:
    """(13, n), (3, n): at rest at the origin, spinning at some 1 rad/s, each with moments of its own."""
    random = np.random.default_rng(_SEED)
    state = np.zeros((13, count))
    state[6:9] = random.normal(size=(3, count))
    state[9] = 1.0
    squares = random.uniform(0.5, 2.0, (3, count))  # second moments: whatever they are, a body has them
    return state, np.ascontiguousarray(squares.sum(axis=0) - squares)
