"""Measure methods on an ensemble of random bodies, and write quantiles, a dataset and the worst bodies."""

from __future__ import annotations

import json
import math
import shutil
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.errors import InputError, StoppedError
from bodycheck._util.files import unfinished_name
from bodycheck._util.formatting import setting as setting_words
from bodycheck._util.untrusted import joined
from bodycheck.adapters.batches import scene_of
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.programs import with_method
from bodycheck.reference_impl.closed_forms.exact_motion import closed_form_of
from bodycheck.reference_impl.free_rotation.motions import FreeRotation
from bodycheck.reference_impl.random_bodies import Bodies
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.reports.measurement.rotation_measures import ROTATION_MEASURES
from bodycheck.reports.run_files.ensemble_dataset import SCHEMA_VERSION, Dataset, Part
from bodycheck.reports.run_files.writer import check_output
from bodycheck.reports.summary.quantiles import SHARES, Quantile, QuantileSketch
from bodycheck.runs.ensemble_cases import (
    BatchResult,
    BatchTruth,
    Hosts,
    measured,
    replay_of,
    settings_of,
    truth_of,
)
from bodycheck.runs.run_options import TIMEOUT_S, ProgressFactory, RunOptions
from bodycheck.runs.selection import select
from bodycheck.scenarios.ensemble import Ensemble, default_distribution, scenario_text
from bodycheck.scenarios.library import load_scenario

SAMPLES = 5
STEPS = 1000
"""Default number of steps of a motion."""

_MOST_LOADED = 10_000
_MOST_ROWS, _LEAST_ROWS = 8192, 16  # of one task
_MOST_STATES = 40_960  # of one task: bodies x samples
_TASKS_PER_WORKER = 8  # at least, so that the workers end at about the same time
REPLAYED = 16  # bodies that are stepped alone, together and in reverse order
_FLOOR = 3.0  # multiples of the truth's error and of round-off: a smaller error is at the floor
_RANKED = ROTATION_MEASURES[0]

Key: TypeAlias = tuple[Engine, Method, Setting]


@dataclass(frozen=True, kw_only=True)
class EnsembleRequest:
    """What to measure; None stands for the default that depends on the scenario."""

    scenario: str
    engines: Sequence[str]
    n: int
    seed: int = 1
    first_row: int = 0
    dt_s: Sequence[float] | None = None
    tolerances: Sequence[float] | None = None
    samples: int = SAMPLES
    trace_kg_m2: tuple[float, float] | None = None
    spin_rad_s: tuple[float, float] | None = None
    torque_n_m: tuple[float, float] | None = None
    worst: int = 10
    jobs: int | None = None
    timeout_s: float = TIMEOUT_S
    allow_code: bool = False

    def ensemble(self) -> Ensemble:
        """Return the ensemble; raises InputError with one line per error."""
        faults = [
            f"{option} {value}: must be {wanted}"
            for option, value, good, wanted in (
                ("--n", self.n, self.n >= 1, "1 or more"),
                ("--seed", self.seed, 0 <= self.seed < 2**63, f"from 0 to {2**63 - 1}"),
                ("--first-row", self.first_row, 0 <= self.first_row < 2**60, f"from 0 to {2**60 - 1}"),
                ("--samples", self.samples, 2 <= self.samples <= 100_000, "from 2 to 100000"),
                ("--worst", self.worst, 0 <= self.worst <= 10_000, "from 0 to 10000"),
            )
            if not good
        ]
        for option, ends in (
            ("--trace-kg-m2", self.trace_kg_m2),
            ("--spin-rad-s", self.spin_rad_s),
            ("--torque-n-m", self.torque_n_m),
        ):
            if ends is not None and not 0.0 < ends[0] <= ends[1] < math.inf:
                faults.append(f"{option} {ends[0]:g},{ends[1]:g}: must be two positive numbers, LOW,HIGH")
        if faults:
            raise InputError("\n".join(faults))
        scenario = load_scenario(self.scenario, allow_code=self.allow_code)
        ranges = default_distribution(scenario, self.trace_kg_m2, self.spin_rad_s, self.torque_n_m)
        return Ensemble(scenario, ranges, self.seed, self.samples)

    def keys(self, ensemble: Ensemble) -> list[Key]:
        """Return the methods with their settings; raises InputError for unknown ones and unfit steps.

        The default step makes some 1000 steps, a whole number of them from one sample to the next.
        """
        template = ensemble.template
        selection = select([self.scenario], list(self.engines), allow_code=self.allow_code)
        stride = max(round(STEPS / (self.samples - 1)), 1)
        steps = list(self.dt_s or [template.duration_s / (stride * (self.samples - 1))])
        faults = []
        for step in steps:
            try:
                steps_per_sample(template.sample_interval_s, step)
            except ValueError as error:
                faults.append(f"--dt {step:g} with --samples {self.samples}: {error}")
        if faults:
            raise InputError("\n".join(faults))
        return [
            (engine, method, setting)
            for engine, method in selection.methods
            for setting in settings_of(method, steps, self.tolerances or ())
        ]


@dataclass
class MethodStatistics:
    """What is known of one method so far: sketches by measure, endings, and the worst bodies.

    replay: whether bodies move alike alone, together and in reverse order: same bits, other bits, or "".
    """

    sketches: dict[str, QuantileSketch] = field(
        default_factory=lambda: {name: QuantileSketch() for name in ROTATION_MEASURES}
    )
    endings: Counter[str] = field(default_factory=Counter)
    at_floor: int = 0
    replay: str = ""
    worst: list[tuple[float, int, dict[str, float], str]] = field(default_factory=list)
    """(error, row, measures, ending), the worst first."""

    def add(self, first: int, result: BatchResult, truth: BatchTruth, most: int) -> None:
        """Add the results of consecutive rows, of which the first has the number `first`."""
        self.endings.update(result.endings.tolist())
        error = result.measures[_RANKED]
        there = ~np.isnan(error)
        for name, sketch in self.sketches.items():
            sketch.add(result.measures[name][there])
        self.at_floor += int(np.sum(error[there] <= _FLOOR * (truth.bound_rad + truth.round_off_rad)[there]))
        rows = np.flatnonzero(there)
        ranked = rows[np.argsort(-error[rows], kind="stable")[:most]]
        found = [
            (
                float(error[k]),
                first + int(k),
                {name: float(values[k]) for name, values in result.measures.items()},
                str(result.endings[k]),
            )
            for k in ranked
        ]
        self.worst = sorted([*self.worst, *found], key=lambda one: (-one[0], one[1]))[:most]

    @property
    def bodies(self) -> int:
        """The number of measured bodies."""
        return self.sketches[_RANKED].total

    def quantile(self, measure: str, share: float) -> Quantile:
        """Return a quantile of a measure with its error bar."""
        return self.sketches[measure].quantile(share)


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """The statistics of each method of an ensemble, and of the truth's own error."""

    request: EnsembleRequest
    ensemble: Ensemble
    statistics: tuple[tuple[Key, MethodStatistics], ...]
    floors: dict[str, QuantileSketch]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Consecutive rows of an ensemble with all that was measured on them."""

    first: int
    bodies: Bodies
    truth: BatchTruth
    results: tuple[BatchResult, ...]


def run_ensemble(request: EnsembleRequest, out: Path, watching: ProgressFactory) -> EnsembleResult:
    """Measure the ensemble and write its files to `out`, which must be new or empty.

    Raises InputError for wrong input, before anything is run, and StoppedError if the user interrupts it;
    then nothing is written.
    """
    check_output(out)
    options = RunOptions(jobs=request.jobs, timeout_s=request.timeout_s)
    ensemble = request.ensemble()
    keys = request.keys(ensemble)
    free = _checked_loads(ensemble, request.n)
    result = EnsembleResult(
        request,
        ensemble,
        tuple((key, MethodStatistics()) for key in keys),
        {"bound_rad": QuantileSketch(), "round_off_rad": QuantileSketch()},
    )
    try:
        out.absolute().parent.mkdir(parents=True, exist_ok=True)
        unfinished = unfinished_name(out.absolute())
        try:
            unfinished.mkdir()
            with Dataset(unfinished) as dataset:
                _measure(result, free, options, dataset, watching)
            _write_summaries(result, unfinished, out)
            unfinished.replace(out)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written: {error.strerror or error}") from None
    except KeyboardInterrupt:
        raise StoppedError(f"stopped; nothing was written to {out}") from None
    return result


def _checked_loads(ensemble: Ensemble, n: int) -> bool:
    """Return whether the rotation is torque-free; refuse too many bodies without a closed form."""
    template, bodies = ensemble.template, ensemble.bodies(0, 1)
    scene = scene_of(template, bodies, 0)
    closed = None if scene.has_callback_load else closed_form_of(scene)
    if closed is None and n > _MOST_LOADED:
        raise InputError(
            f"--n {n}: the loads of {ensemble.scenario.name} have no closed form for random bodies; "
            f"with such loads n is at most {_MOST_LOADED}"
        )
    return closed is not None and isinstance(closed.rotation, FreeRotation)


def is_free_rotation(ensemble: Ensemble) -> bool:
    """Whether the rotation is torque-free; raises InputError as `run_ensemble` does."""
    return _checked_loads(ensemble, 1)


def _measure(
    result: EnsembleResult, free: bool, options: RunOptions, dataset: Dataset, watching: ProgressFactory
) -> None:
    request, ensemble, template = result.request, result.ensemble, result.ensemble.template
    hosts = Hosts(request.timeout_s)

    def task(first: int, end: int) -> _Rows:
        bodies = ensemble.bodies(first, end)
        truth = truth_of(template, bodies, free=free)
        results = tuple(
            measured(template, bodies, truth, hosts.motions(template, bodies, *key))
            for key, _ in result.statistics
        )
        return _Rows(first, bodies, truth, results)

    begin, end = request.first_row, request.first_row + request.n
    rows = _rows_per_task(request, options.workers)
    parts = [(first, min(first + rows, end)) for first in range(begin, end, rows)]
    try:
        with watching(len(parts)) as progress:
            progress.phase("compiling")
            task(begin, begin + 1)  # by one thread, so that nothing is compiled twice
            few = ensemble.bodies(begin, begin + REPLAYED)
            for key, statistics in result.statistics:
                motions = partial(hosts.motions, template, engine=key[0], method=key[1], setting=key[2])
                statistics.replay = replay_of(motions, few)
            progress.motions_begun()
            for found in _in_order(task, parts, options.workers, hosts.stop):
                _add(result, found, dataset)
                progress.case_done()
    finally:
        hosts.close()


def _rows_per_task(request: EnsembleRequest, workers: int) -> int:
    balanced = math.ceil(request.n / (workers * _TASKS_PER_WORKER))
    return max(min(_MOST_ROWS, _MOST_STATES // request.samples, balanced), _LEAST_ROWS)


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
    for name, sketch in result.floors.items():
        sketch.add(getattr(truth, name))
    dataset.add(Part(("bodies", f"seed={seed}")), _body_columns(rows, bodies, truth))
    for (key, statistics), one in zip(result.statistics, found.results, strict=True):
        statistics.add(found.first, one, truth, result.request.worst)
        columns = {"row": rows, **one.measures, "outcome": one.endings, "message": one.messages}
        dataset.add(Part.of_method("cases", *_names(key)), {**_setting_columns(key, len(rows)), **columns})


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


def _names(key: Key) -> tuple[str, str, str]:
    engine, method, setting = key
    words = "none" if setting.fineness is None else repr(setting.fineness)
    return engine.name, method.name, words


def _who(key: Key) -> dict[str, Any]:
    engine, method, setting = key
    return {
        "schema_version": SCHEMA_VERSION,
        "engine": engine.name,
        "engine_version": engine.version,
        "method": method.name,
        "dt_s": setting.dt_s,
        "tolerance": setting.tolerance,
    }


def words_of(key: Key) -> str:
    """Return "mujoco:rk4, dt 0.01 s"."""
    engine, method, setting = key
    return f"{with_method(engine.name, method.name)}, {setting_words(method.control, setting.fineness)}"


# --------------------------------------------------------------------------------------------------- files


def _write_summaries(result: EnsembleResult, folder: Path, out: Path) -> None:
    import pandas as pd

    tables = {
        "quantiles": quantile_rows(result),
        "methods": method_rows(result),
        "worst": list(_worst_rows(result, folder, out)),
        "sketches": list(_sketch_rows(result)),
    }
    for name in ("quantiles", "methods", "worst"):
        pd.DataFrame(tables[name]).to_csv(folder / f"{name}.csv", index=False)
    with Dataset(folder) as dataset:
        sketches = pd.DataFrame(tables["sketches"])
        dataset.add(Part(("sketches",)), {name: sketches[name].to_numpy() for name in sketches.columns})
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "bodycheck": version("bodycheck"),
        "numpy": np.__version__,
        "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "request": asdict(result.request),
        "distribution": asdict(result.ensemble.distribution),
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    _draw(result, folder / "distributions.svg")


def quantile_rows(result: EnsembleResult) -> list[dict[str, Any]]:
    """Return the rows of quantiles.csv; the engine `truth` stands for the truth's own bound and round-off."""
    truth = {"schema_version": SCHEMA_VERSION, "engine": "truth", "engine_version": version("bodycheck")}
    sketches = [
        (_who(key), name, sketch)
        for key, statistics in result.statistics
        for name, sketch in statistics.sketches.items()
    ]
    sketches += [(truth, name, sketch) for name, sketch in result.floors.items()]
    return [
        {**who, "measure": name, **asdict(sketch.quantile(share)), "bodies": sketch.total}
        for who, name, sketch in sketches
        if sketch.total
        for share in SHARES
    ]


def method_rows(result: EnsembleResult) -> list[dict[str, Any]]:
    """Return the rows of methods.csv: how many bodies ended how, and at the floor of double precision."""
    return [
        {
            **_who(key),
            "bodies": sum(statistics.endings.values()),
            **{ending: statistics.endings[ending] for ending in _ENDINGS},
            "at_floor": statistics.at_floor,
            "replay": statistics.replay,
        }
        for key, statistics in result.statistics
    ]


_ENDINGS = ("ok", "unstable", "failed", "timeout", "invalid", "unsupported", "chaotic")


def _worst_rows(result: EnsembleResult, folder: Path, out: Path) -> Iterator[dict[str, Any]]:
    """Write the worst bodies of each method as scenario files, each row once, and yield their rows."""
    for key, statistics in result.statistics:
        engine, method, setting = key
        for rank, (_, row, measures, ending) in enumerate(statistics.worst, 1):
            scenario = result.ensemble.row_scenario(row)
            (folder / "worst").mkdir(exist_ok=True)
            name = f"row-{row}.toml"
            (folder / "worst" / name).write_text(scenario_text(scenario), encoding="utf-8")
            words = ["bodycheck", "run", str(out / "worst" / name), "--engine"]
            words.append(with_method(engine.name, method.name))
            words += [] if setting.dt_s is None else ["--dt", repr(setting.dt_s)]
            words += [] if setting.tolerance is None else ["--tolerance", repr(setting.tolerance)]
            words += ["--allow-code"] if result.request.allow_code else []
            place = {"rank": rank, "row": row, "outcome": ending}
            yield {**_who(key), **place, **measures, "reproduce": joined(words)}


def _sketch_rows(result: EnsembleResult) -> Iterator[dict[str, Any]]:
    """Yield the counts of all bins; sketches of ensembles merge by adding counts of equal bins."""
    for key, statistics in result.statistics:
        for name, sketch in statistics.sketches.items():
            for low, high, count in zip(*sketch.edges, sketch.counts.tolist(), strict=True):
                yield {**_who(key), "measure": name, "bin_low": low, "bin_high": high, "count": count}


def _draw(result: EnsembleResult, path: Path) -> None:
    """Draw the distributions where matplotlib is installed; docs/ensembles.md says so."""
    try:
        import matplotlib  # noqa: F401 - an extra
    except ImportError:
        return
    from bodycheck.reports.render.distributions import distributions_svg

    sketches = [(words_of(key), statistics.sketches) for key, statistics in result.statistics]
    path.write_bytes(distributions_svg(sketches))


# ------------------------------------------------------------------------------------------------ one row


def row_text(request: EnsembleRequest, row: int) -> str:
    """Return the scenario file of one row, without any other row."""
    return scenario_text(request.ensemble().row_scenario(row))
