"""Measure methods on an ensemble of random bodies, and write quantiles, a dataset and the worst bodies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.errors import InputError, StoppedError
from bodycheck._util.formatting import setting as setting_words
from bodycheck.adapters.batches import BatchAnswer, scene_of
from bodycheck.ensembles.ensemble_cases import (
    BatchResult,
    BatchTruth,
    EnginePools,
    measured,
    replay_of,
    truth_of,
)
from bodycheck.ensembles.ensemble_files import Dataset, add_stored_rows, cases_folder, write_summaries
from bodycheck.ensembles.ensemble_result import EnsembleRequest, EnsembleResult, Key
from bodycheck.reference_impl.closed_forms.exact_motion import closed_form_of
from bodycheck.reference_impl.free_rotation.free_rotations import FreeRotation
from bodycheck.reference_impl.random_bodies import Bodies
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.run_files.sentinels import Sentinel
from bodycheck.reports.run_files.writer import atomic_folder, check_output
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import ProgressFactory
from bodycheck.runs.selection import refuse_unused_settings
from bodycheck.scenarios.ensemble import Ensemble, scenario_text

_MAX_LOADED = 10_000
_MAX_ROWS, _MIN_ROWS = 8192, 16  # of one task
_MAX_STATES = 40_960  # of one task: bodies x samples
_TASKS_PER_WORKER = 8  # at least, so that the workers end at about the same time


@dataclass(frozen=True, eq=False)
class _Rows:
    """Consecutive rows of an ensemble with all that was measured on them."""

    first: int
    bodies: Bodies
    truth: BatchTruth
    results: tuple[BatchResult, ...]


def run_ensemble(request: EnsembleRequest, out: Path, make_progress: ProgressFactory) -> EnsembleResult:
    """Measure the ensemble and write its files to `out`, which must be new or empty.

    Raises InputError for wrong input, before anything is run, and StoppedError if the user interrupts it;
    then nothing is written.
    """
    check_output(out)
    options = Request(jobs=request.jobs, timeout_s=request.timeout_s)
    ensemble = request.ensemble()
    keys = request.keys(ensemble)
    refuse_unused_settings([key[:2] for key in keys], request.dt_s, request.tolerances)
    free = is_free_rotation(ensemble, request.n)
    result = EnsembleResult.empty(request, ensemble, keys)
    try:
        with atomic_folder(out) as folder:
            with Dataset(folder) as dataset:
                _measure(result, free, options, dataset, make_progress)
            add_stored_rows(result, folder, request.rows)
            write_summaries(result, folder, out)
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; nothing was written to {out}") from None
    return result


def is_free_rotation(ensemble: Ensemble, n: int = 1) -> bool:
    """Return whether the rotation is torque-free.

    Raises InputError where n bodies are too many because their loads have no closed form.
    """
    template, bodies = ensemble.template, ensemble.bodies(0, 1)
    scene = scene_of(template, bodies, 0)
    closed = None if scene.has_callback_load else closed_form_of(scene)
    if closed is None and n > _MAX_LOADED:
        raise InputError(
            f"--n {n}: the loads of {ensemble.scenario.name} have no closed form for random bodies; "
            f"with such loads n is at most {_MAX_LOADED}"
        )
    return closed is not None and isinstance(closed.rotation, FreeRotation)


def _measure(
    result: EnsembleResult, free: bool, options: Request, dataset: Dataset, make_progress: ProgressFactory
) -> None:
    request, ensemble, template = result.request, result.ensemble, result.ensemble.template
    engine_pools = EnginePools(request.timeout_s)

    def task(first: int, end: int) -> _Rows:
        bodies = ensemble.bodies(first, end)
        truth = truth_of(template, bodies, free=free)
        results = tuple(
            measured(template, bodies, truth, engine_pools.motions(template, bodies, *key))
            for key, _ in result.statistics
        )
        return _Rows(first, bodies, truth, results)

    start, end = request.rows.start, request.rows.stop
    rows = _rows_per_task(request, options.workers)
    parts = [(first, min(first + rows, end)) for first in range(start, end, rows)]
    try:
        with make_progress(len(parts)) as progress:
            progress.phase("compiling")
            task(start, start + 1)  # by one thread, so that nothing is compiled twice
            few = ensemble.bodies(request.sentinel_rows.start, request.sentinel_rows.stop)
            for key, statistics in result.statistics:
                motions = partial(
                    engine_pools.motions, template, engine=key[0], method=key[1], setting=key[2]
                )
                statistics.replay, forward = replay_of(motions, few)
                if request.shard is not None:
                    result.sentinels.extend(_sentinels(result, key, forward))
            progress.motions_started()
            for found in _in_order(task, parts, options.workers, engine_pools.stop):
                _add(result, found, dataset)
                progress.case_done()
    finally:
        engine_pools.close()


def _rows_per_task(request: EnsembleRequest, workers: int) -> int:
    balanced = math.ceil(len(request.rows) / (workers * _TASKS_PER_WORKER))
    return max(min(_MAX_ROWS, _MAX_STATES // request.samples, balanced), _MIN_ROWS)


def _sentinels(result: EnsembleResult, key: Key, motions: BatchAnswer) -> Iterator[Sentinel]:
    """Yield the motions of the sentinel rows by one method; batches have no position and no velocity."""
    engine, method, setting = key
    times = result.ensemble.template.sample_times
    still = np.zeros((len(times), 3))
    for index, row in enumerate(result.request.sentinel_rows):
        outcome = motions.endings[index]
        motion = None
        if outcome == "ok":
            quaternion, omega = motions.quaternion[index], motions.omega_body[index]
            motion = Trajectory(times, still, still, quaternion=quaternion, omega_body_rad_s=omega)
        yield Sentinel(
            scenario=f"row {row} of {result.ensemble.scenario.name}",
            engine=engine.name,
            engine_version=engine.version,
            method=method.name,
            setting=setting_words(method.control, setting.fineness),
            outcome=outcome,
            message=motions.messages[index],
            build=engine.build.short,
            trajectory=motion,
        )


def _in_order(
    task: Callable[[int, int], _Rows],
    parts: Sequence[tuple[int, int]],
    workers: int,
    stop: Callable[[], None],
) -> Iterator[_Rows]:
    """Yield the results of the tasks in order, with few tasks at once, so that memory is bounded."""
    with ThreadPoolExecutor(workers) as pool:
        waiting = iter(parts)
        running: list[Future[_Rows]] = [pool.submit(task, *part) for part in islice(waiting, 2 * workers)]
        try:
            while running:
                found = running.pop(0).result()
                running += [pool.submit(task, *part) for part in islice(waiting, 1)]
                yield found
        except BaseException:
            stop()
            pool.shutdown(cancel_futures=True)
            raise


def _add(result: EnsembleResult, found: _Rows, dataset: Dataset) -> None:
    seed, bodies, truth = result.request.seed, found.bodies, found.truth
    rows = np.arange(found.first, found.first + len(bodies))
    dataset.add(("bodies", f"seed={seed}"), _body_columns(rows, bodies, truth))
    for (key, _), one in zip(result.statistics, found.results, strict=True):
        columns = {"row": rows, **one.measures, "outcome": one.endings, "message": one.messages}
        dataset.add(cases_folder(key), {**_setting_columns(key, len(rows)), **columns})


def _body_columns(rows: NDArray[np.int64], bodies: Bodies, truth: BatchTruth) -> dict[str, Any]:
    columns: dict[str, Any] = {"row": rows}
    for names, values in (
        (("i1_kg_m2", "i2_kg_m2", "i3_kg_m2"), bodies.moments),
        (("qw", "qx", "qy", "qz"), bodies.quaternion),
        (("wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s"), bodies.omega_body),
        (("tx_body_n_m", "ty_body_n_m", "tz_body_n_m"), bodies.torque_body),
    ):
        columns |= dict(zip(names, values.T, strict=True))
    return {
        **columns,
        "separatrix_distance": bodies.separatrix_distance,
        "truth_bound_rad": truth.bound_rad,
        "round_off_rad": truth.round_off_rad,
    }


def _setting_columns(key: Key, rows: int) -> dict[str, Any]:
    _, _, setting = key
    return {
        name: np.full(rows, np.nan if value is None else value)
        for name, value in (("dt_s", setting.dt_s), ("tolerance", setting.tolerance))
    }


# ------------------------------------------------------------------------------------------------ one row


def row_text(request: EnsembleRequest, row: int) -> str:
    """Return the scenario file of one row, without any other row."""
    return scenario_text(request.ensemble().row_scenario(row))
