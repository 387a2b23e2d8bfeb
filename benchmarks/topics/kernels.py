"""Our own kernels: the closed form, the Taylor integrator under one load at a time, and batches of bodies."""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.contenders import STEPPED_TAYLOR
from benchmarks.figures import Measured, key
from benchmarks.problems import FORCED, FREE, FREE_LONG, WORLD_TORQUE, Problem
from benchmarks.solver import Task, cheapest, tried
from benchmarks.timing import Effort, Spread, interleaved, ratio
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.batch import BatchMethod, advance_batch
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.rotations import exp_matrix, geodesic_angle
from bodycheck.reference_impl.scene import Drag, GravityGradient, Load, SineTorque, Torque
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion

_TIMES = 10_000
_TURN = exp_matrix(np.array([0.3, -0.5, 0.7]))
_TARGET = 1e-12
_TIGHTEST = 1e-17
# The loads of the general scene change no digit of the motion: far below the last digit of a torque of 1 N m
# over 10 s, and far above what underflows in a series.
_WEAK = 1e-20
_VECTOR = np.full(3, _WEAK)
_ROTATION: tuple[Load, ...] = (
    Torque("world", _VECTOR),
    SineTorque("body", _VECTOR, rate=1.0, phase=0.0),
    SineTorque("world", _VECTOR, rate=1.0, phase=0.0),
    GravityGradient(rate=_WEAK**0.5),
    Drag(0.0, _WEAK * np.eye(3)),
)
_TRANSLATION: tuple[Load, ...] = (Drag(_WEAK, np.zeros((3, 3))),)
_STEPS = 100
_DT_S = 1e-3
_THREADS = 2
_SEED = 2


def closed_form(effort: Effort) -> list[Measured]:
    """Measure at 10 000 times within 1000 s, and set up with a diagonal and a full tensor."""
    scene = FREE_LONG.scene
    diagonal = scene.body.inertia
    full = _TURN @ diagonal @ _TURN.T
    quaternion, omega = scene.initial.quaternion, scene.initial.omega_body
    motion = FreeRotation.from_state(diagonal, quaternion, omega)
    tasks = (
        Task(partial(motion.at, np.linspace(0.0, scene.duration_s, _TIMES))),
        Task(partial(FreeRotation.from_state, diagonal, quaternion, omega)),
        Task(partial(FreeRotation.from_state, 0.5 * (full + full.T), quaternion, _TURN @ omega)),
    )
    evaluation, principal, tensor = interleaved(tasks, effort)
    return [
        Measured.of("free.time", Spread.of(evaluation).scaled(1e9 / _TIMES)),
        Measured.of("free.set-up.diagonal", Spread.of(principal).scaled(1e6)),
        Measured.of("free.set-up.full", Spread.of(tensor).scaled(1e6)),
    ]


def forced(effort: Effort) -> list[Measured]:
    """Tune the tolerance for each load, time all of them in turn, and measure the floors."""
    tuned = [cheapest(tried(STEPPED_TAYLOR, problem, _TARGET), _TARGET) for problem in FORCED]
    reached = [(problem, one) for problem, one in zip(FORCED, tuned, strict=True) if one is not None]
    seconds = interleaved([one.solver for _, one in reached], effort)
    times = [
        Measured.of(
            f"forced.{key(problem.name)}.time",
            Spread.of(spent).scaled(1e6),
            f"tolerance {one.setting:.1e}, error {one.error:.1e}, set-up {1e6 * one.prepare_s:.0f} us apart",
        )
        for (problem, one), spent in zip(reached, seconds, strict=True)
    ]
    return times + [Measured(f"forced.{key(problem.name)}.floor", floor(problem)) for problem in FORCED]


def floor(problem: Problem) -> float:
    """max over the samples of angle / (eps x sensitivity), at the tightest tolerance."""
    truth = problem.truth
    followed = TaylorMotion.of(problem.scene, _TIGHTEST).solve(truth.trajectory.t_s)
    angles = geodesic_angle(truth.trajectory.attitude, followed.states[:, :4])
    return float(np.max(angles / truth.round_off_rad))


def specialised(effort: Effort) -> list[Measured]:
    """Measure the gain of kernels that leave out what a scene has not.

    Time a free motion next to every load, and a forced one next to the centre of mass's motion.
    """
    return [
        _gain("specialised.free", FREE, (*_ROTATION, *_TRANSLATION), effort),
        _gain("specialised.rotation", WORLD_TORQUE, _TRANSLATION, effort),
    ]


def _gain(figure: str, problem: Problem, more: tuple[Load, ...], effort: Effort) -> Measured:
    general = Problem(problem.name, replace(problem.scene, loads=(*problem.scene.loads, *more)))
    solvers = [STEPPED_TAYLOR.prepare(one, _TARGET) for one in (general, problem)]
    slow, fast = interleaved(solvers, effort)
    errors = [problem.error(solver.end()) for solver in solvers]
    note = f"tolerance {_TARGET:g}; errors {errors[0]:.1e} and {errors[1]:.1e}"
    return Measured.of(figure, ratio(slow, fast), note)


def batch(effort: Effort) -> list[Measured]:
    """Measure many free bodies by both methods, a hundred steps to a call, on two threads.

    Each thread steps an equal part of the bodies.
    """
    state, moments = bodies(effort.bodies)
    threads = min(_THREADS, os.cpu_count() or 1)
    arrays = (state, moments, np.zeros_like(moments))
    parts = [
        [np.ascontiguousarray(array[:, rows]) for array in arrays]
        for rows in np.array_split(np.arange(effort.bodies), threads)
    ]
    methods: tuple[BatchMethod, ...] = ("rk4", "dop853")
    with ThreadPoolExecutor(threads) as pool:
        seconds = interleaved([Task(partial(_advance, pool, parts, method)) for method in methods], effort)
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
