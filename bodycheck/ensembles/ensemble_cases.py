"""Many bodies of an ensemble by one method: their truth, their motions and their measures, batch by batch."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import number
from bodycheck.adapters.batches import Batch, BatchAnswer, record_batch, scene_of, stacked
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.engine_names import is_program
from bodycheck.adapters.execution import Answer, Case
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.stable_step import MAX_ENERGY
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.case_messages import batch_message, case_message
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.random_bodies import Bodies
from bodycheck.reference_impl.rotations import geodesic_angle, rotate
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.free_batch import free_truths
from bodycheck.reports.run_files.method_words import OTHER_BITS, SAME_BITS

ROTATION_MEASURES = (
    "orientation_error_rad",
    "omega_error",
    "rotational_energy_drift",
    "angular_momentum_drift",
)
"""The measures of ensembles: those of a rotation that need no load."""


def rotation_measures(
    inertia: Array, true: tuple[Array, Array], found: tuple[Array, Array]
) -> tuple[dict[str, Array], NDArray[np.bool_]]:
    """Return the maxima over n samples, relative to the maxima of the truth, and which bodies are unstable.

    The maxima (m,) by name are infinite where a body is unstable (m,).
    inertia (m, 3, 3) about the centre of mass or the pivot, in body axes; true and found: quaternion
    (m, n, 4) and omega_body (m, n, 3). A motion that is not finite, or whose energy exceeds a hundred times
    that of the truth, is unstable.
    """
    (q_true, omega_true), (q, omega) = true, found
    with np.errstate(over="ignore", invalid="ignore"):
        about_true, about = _momentum(inertia, omega_true), _momentum(inertia, omega)
        energy_true, energy = (
            0.5 * np.sum(rate * momentum, axis=-1)
            for rate, momentum in ((omega_true, about_true), (omega, about))
        )
        energy_scale = np.max(energy_true, axis=1)
        finite = np.isfinite(q).all(axis=(1, 2)) & np.isfinite(omega).all(axis=(1, 2))
        finite &= np.all(np.max(np.abs(q), axis=-1) > 0.0, axis=1)
        limit = np.where(energy_scale > 0.0, MAX_ENERGY * energy_scale, np.inf)
        unstable = ~(finite & (np.max(energy, axis=1) <= limit))
        q = np.where(unstable[:, None, None], q_true, q)
        departures = {
            "orientation_error_rad": np.max(geodesic_angle(q_true, q), axis=1),
            "omega_error": _largest(omega - omega_true) / _scale(_largest(omega_true)),
            "rotational_energy_drift": np.max(np.abs(energy - energy_true), axis=1) / _scale(energy_scale),
            "angular_momentum_drift": _largest(rotate(q, about) - rotate(q_true, about_true))
            / _scale(_largest(about_true)),
        }
    values = {name: np.where(unstable, np.inf, measured) for name, measured in departures.items()}
    return values, unstable


def _momentum(inertia: Array, omega: Array) -> Array:
    """I omega of each body at each sample (m, n, 3), in body axes."""
    return np.asarray(omega @ inertia.transpose(0, 2, 1))


def _largest(vectors: Array) -> Array:
    return np.asarray(np.max(np.linalg.norm(vectors, axis=-1), axis=1))


def _scale(sizes: Array) -> Array:
    """Return what to divide by: 1 where nothing moves."""
    return np.where(sizes > 0.0, sizes, 1.0)


_STEPS_TOGETHER, _STEPS_ALONE = 2_000_000, 200_000  # per request: some 10 s of most engines
_BATCHING = (
    "mujoco",
    "mjx",
    "mujoco-warp",
)  # engines whose request may hold more, as they step it in one call


@dataclass(frozen=True, eq=False)
class BatchTruth:
    """The truth of m bodies at n samples, and what an error is compared with.

    quaternion (m, n, 4), omega_body (m, n, 3). bound_rad, round_off_rad (m,): the truth's own error, and the
    error to expect of any stepper in doubles. trusted (m,): whether the truth holds at all samples.
    """

    quaternion: Array
    omega_body: Array
    bound_rad: Array
    round_off_rad: Array
    trusted: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class BatchResult:
    """Measures of m bodies (m,) by name, infinite where unstable, NaN where not measured; endings (m,)."""

    measures: dict[str, Array]
    endings: NDArray[np.object_]
    messages: tuple[str, ...]


def truth_of(template: Scene, bodies: Bodies, *, free: bool) -> BatchTruth:
    """Return the truth of each body; free: whether the rotation is torque-free.

    Raises InputError where a body spins too fast for it.
    """
    if free and template.pivot is None:
        try:
            found = free_truths(bodies.inertia, bodies.quaternion, bodies.omega_body, template.sample_times)
        except ValueError as error:
            fastest = number(float(np.max(np.linalg.norm(bodies.omega_body, axis=-1))))
            raise InputError(f"no truth where |omega| is up to {fastest} rad/s: {error}") from None
        trusted = np.ones(len(bodies), dtype=np.bool_)
        return BatchTruth(found.quaternion, found.omega_body, found.bound_rad, found.round_off_rad, trusted)
    truths = [
        solve_truth(scene_of(template, bodies, row), template.sample_times) for row in range(len(bodies))
    ]
    return BatchTruth(
        np.array([truth.trajectory.attitude for truth in truths]),
        np.array([truth.trajectory.omega_body for truth in truths]),
        np.array([truth.bound_rad[-1] for truth in truths]),
        np.array([truth.round_off_rad[-1] for truth in truths]),
        np.array([truth.trusted_until_s == np.inf for truth in truths]),
    )


def measured(template: Scene, bodies: Bodies, truth: BatchTruth, answer: BatchAnswer) -> BatchResult:
    """Measure the motions of an answer against the truth."""
    endings = np.array(answer.endings, dtype=object)
    values = {name: np.full(len(bodies), np.nan) for name in ROTATION_MEASURES}
    ended_well = endings == "ok"
    endings[ended_well & ~truth.trusted] = "chaotic"
    ended_well &= truth.trusted
    if ended_well.any():
        tensors = bodies.inertia if template.pivot is None else _about_pivot(template, bodies)
        measures, unstable = rotation_measures(
            tensors[ended_well],
            (truth.quaternion[ended_well], truth.omega_body[ended_well]),
            (answer.quaternion[ended_well], answer.omega_body[ended_well]),
        )
        for name, measure in measures.items():
            values[name][ended_well] = measure
        rows = np.flatnonzero(ended_well)
        endings[rows[unstable]] = "unstable"
    return BatchResult(values, endings, answer.messages)


def _about_pivot(template: Scene, bodies: Bodies) -> Array:
    return np.array([rotational_inertia(scene_of(template, bodies, row)) for row in range(len(bodies))])


def replay_of(motions: Callable[[Bodies], BatchAnswer], bodies: Bodies) -> tuple[str, BatchAnswer]:
    """Return whether bodies have the same bits alone, together and in reverse order, and their motions.

    The first is "" where a body failed.
    """
    m = len(bodies)
    forward, reverse = motions(bodies), motions(bodies[np.arange(m)[::-1]])
    alone = BatchAnswer.joined(*(motions(bodies[row : row + 1]) for row in range(m)))
    if {*forward.endings, *alone.endings, *reverse.endings} != {"ok"}:
        return "", forward
    same = all(
        found.tobytes() == getattr(forward, name).tobytes()
        for name in ("quaternion", "omega_body")
        for found in (getattr(alone, name), getattr(reverse, name)[::-1])
    )
    return (SAME_BITS if same else OTHER_BITS), forward


class EnginePools:
    """The engines of an ensemble: the reference in this process, any other in a worker for each thread."""

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._local, self._lock = threading.local(), threading.Lock()
        self._pools: list[EnginePool] = []

    def motions(
        self, template: Scene, bodies: Bodies, engine: Engine, method: Method, setting: Setting
    ) -> BatchAnswer:
        """Return the motions of the bodies; a body that ends its worker costs no other body its result."""
        batch = Batch(template, bodies, method.name, setting)
        if engine.name == Reference.name:
            return record_batch(Reference(), batch)
        rows = _rows_together(batch, engine)
        parts = [batch[first : first + rows] for first in range(0, len(batch), rows)]
        ask = self._one_by_one if is_program(engine.name) else self._batched
        return BatchAnswer.joined(*(ask(engine, method, part) for part in parts))

    def _batched(self, engine: Engine, method: Method, batch: Batch) -> BatchAnswer:
        message = self._pool.ask(engine.name, batch_message(batch), self._timeout_s)
        try:
            if message.get("outcome") == "ok":
                return received_messages.batch_answer_of(message, len(batch), batch.template.samples)
            why = protocol.text_of(message, "message")
        except ValueError as error:
            why = str(error)
        if len(batch) > 1:
            middle = len(batch) // 2
            halves = batch[:middle], batch[middle:]
            return BatchAnswer.joined(*(self._batched(engine, method, half) for half in halves))
        timed_out = message.get("outcome") == "timeout"
        return BatchAnswer.none(batch, "timeout" if timed_out else "failed", why)

    def _one_by_one(self, engine: Engine, method: Method, batch: Batch) -> BatchAnswer:
        rows = []
        for scene in batch.scenes():
            case = Case(scene, method.name, batch.setting)
            request = {"do": "record", "case": case_message(case)}
            message = self._pool.ask(engine.name, request, self._timeout_s)
            try:
                answer = received_messages.answer_of(message, scene.sample_times)
            except ValueError as error:
                answer = Answer("failed", protocol.one_line(str(error)))
            rows.append((scene, answer))
        return stacked(batch, rows, method.precision)

    @property
    def _pool(self) -> EnginePool:
        """The workers of this thread."""
        if not hasattr(self._local, "pool"):
            self._local.pool = pool = EnginePool()
            with self._lock:
                self._pools.append(pool)
        found: EnginePool = self._local.pool
        return found

    def stop(self) -> None:
        """Kill the workers, from any thread."""
        with self._lock:
            for pool in self._pools:
                pool.stop()

    def close(self) -> None:
        """End the workers, once no thread uses them."""
        for pool in self._pools:
            pool.close()


def _rows_together(batch: Batch, engine: Engine) -> int:
    steps = 1000 if batch.setting.dt_s is None else batch.steps_per_sample * (batch.template.samples - 1)
    max_steps = _STEPS_TOGETHER if engine.name.partition("==")[0] in _BATCHING else _STEPS_ALONE
    return max(max_steps // steps, 1)


def settings_of(method: Method, dt_s: Sequence[float], tolerances: Sequence[float]) -> list[Setting]:
    """Return the settings of a method."""
    match method.control:
        case "dt":
            return [Setting(dt_s=step) for step in dt_s]
        case "tolerance":
            return [Setting(tolerance=tolerance) for tolerance in tolerances or method.tolerances]
        case _:
            return [Setting()]
