"""Search for the start at which a method does worst, two methods differ most, or a method breaks down."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.errors import InputError, StoppedError, UnavailableError
from bodycheck._util.formatting import count
from bodycheck._util.pinned_libraries import cma
from bodycheck._util.untrusted import shell_join
from bodycheck.adapters.batches import BatchAnswer
from bodycheck.adapters.engine_names import with_method
from bodycheck.adapters.registry import requested_name
from bodycheck.ensembles.ensemble_cases import ROTATION_MEASURES, BatchTruth, EnginePools, measured, truth_of
from bodycheck.ensembles.ensemble_files import SCHEMA_VERSION
from bodycheck.ensembles.ensemble_result import EnsembleRequest, Key
from bodycheck.ensembles.ensemble_run import is_free_rotation
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.random_bodies import COORDINATES, Bodies, bodies_at
from bodycheck.reports.measurement.case import ALLOW_CODE
from bodycheck.reports.run_files.tables import as_csv
from bodycheck.reports.run_files.writer import atomic_folder
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import Progress, ProgressFactory
from bodycheck.runs.selection import refuse_unused_settings
from bodycheck.scenarios.ensemble import Ensemble, default_distribution, scenario_text

EVALUATIONS = 2000
_UNIFORM_SHARE = 0.25  # of the evaluations: uniform starts, which give the typical error
_POPULATION, _STARTS = 12, 2
_SPREAD = 0.15  # of the first population, in widths of the cube
_INSIDE = 1e-12  # from the faces of the cube, where moments vanish
_UNSTABLE_SCORE = 1e3
"""Score of a breakdown, above that of any error."""

_UNKNOWN_SCORE = -1e3  # of a body that the method does not support, or whose truth is chaotic
_UNSTABLE = ("unstable", "failed", "timeout", "invalid")
_MIN_VALUE = 1e-300


@dataclass(frozen=True, kw_only=True)
class HuntRequest:
    """What to search. The ensemble names the method, and if `against` is given, that is the other one.

    The spin is that of the scenario unless the ensemble has a range. measure: one of ROTATION_MEASURES.
    """

    ensemble: EnsembleRequest
    against: str | None = None
    measure: str = ROTATION_MEASURES[0]
    evaluations: int = EVALUATIONS

    def checked(self) -> tuple[Ensemble, list[Key]]:
        """Return the space of starts and the method, then the other one if there is one."""
        faults = []
        if self.measure not in ROTATION_MEASURES:
            faults.append(f"--measure {self.measure}: unknown (available: {', '.join(ROTATION_MEASURES)})")
        if not 20 * _POPULATION <= self.evaluations <= 10**7:
            faults.append(f"--evaluations {self.evaluations}: must be from {20 * _POPULATION} to {10**7}")
        if faults:
            raise InputError("\n".join(faults))
        ensemble_request = self.ensemble
        ensemble = ensemble_request.ensemble()
        ranges = default_distribution(
            ensemble.scenario,
            ensemble_request.trace_kg_m2,
            ensemble_request.spin_rad_s,
            ensemble_request.torque_n_m,
            spread=1.0,
        )
        ensemble = replace(ensemble, distribution=ranges)
        names = [*ensemble_request.engines, *([] if self.against is None else [self.against])]
        keys = [key for name in names for key in replace(ensemble_request, engines=[name]).keys(ensemble)]
        refuse_unused_settings([key[:2] for key in keys], ensemble_request.dt_s, ensemble_request.tolerances)
        if len(keys) != len(names):
            raise InputError(
                f"--engine {','.join(names)}: is {count(len(keys), 'method')} with their settings; "
                "name one method like mujoco:rk4, and one step or tolerance"
            )
        return ensemble, keys


@dataclass(frozen=True, eq=False)
class Evaluations:
    """All evaluated starts: points (k, 12), the measure (k,), outcomes (k,) and scores (k,)."""

    points: Array
    values: Array
    outcomes: NDArray[np.object_]
    scores: Array


@dataclass(frozen=True, eq=False)
class HuntResult:
    """The worst start, and how it was found.

    typical: the median of the measure over those uniform starts that have one, `typical_of` in number; NaN
    for none. path: every evaluation in order.
    """

    request: HuntRequest
    ensemble: Ensemble
    keys: list[Key]
    typical: float
    typical_of: int
    uniform: int
    path: Evaluations

    @property
    def worst(self) -> int:
        """The number of the worst evaluation, from 0."""
        return int(np.argmax(self.path.scores))

    @property
    def bodies(self) -> Bodies:
        """The body of the worst start, alone."""
        index = self.worst
        return bodies_at(self.ensemble.distribution, self.path.points[index : index + 1])

    @property
    def value(self) -> float:
        """The measure at the worst start; infinite or NaN where the method broke down."""
        return float(self.path.values[self.worst])

    @property
    def ratio(self) -> float | None:
        """The measure at the worst start over the typical one; None where either is missing or 0."""
        if not (self.typical > 0.0 and math.isfinite(self.value)):
            return None
        return self.value / self.typical

    @property
    def improvements(self) -> list[int]:
        """The evaluations that were worse than all before them."""
        best = np.maximum.accumulate(self.path.scores)
        return [0, *(np.flatnonzero(best[1:] > best[:-1]) + 1).tolist()]


class _Search:
    """Evaluates starts in batches, and keeps all of them; the threads of `pool` keep their workers."""

    def __init__(
        self,
        request: HuntRequest,
        ensemble: Ensemble,
        keys: list[Key],
        engine_pools: EnginePools,
        pool: ThreadPoolExecutor,
    ) -> None:
        self._pool = pool
        self._request, self._ensemble, self._keys, self._engine_pools = request, ensemble, keys, engine_pools
        self._free = is_free_rotation(ensemble)
        self._workers = Request(jobs=request.ensemble.jobs).workers
        self._parts: list[tuple[Array, Array, NDArray[np.object_], Array]] = []
        self._known: dict[bytes, float] = {}

    @property
    def path(self) -> Evaluations:
        """All evaluations so far."""
        return Evaluations(*(np.concatenate(column) for column in zip(*self._parts, strict=True)))

    @property
    def left(self) -> int:
        """The number of evaluations that the budget still has."""
        return self._request.evaluations - sum(len(part[0]) for part in self._parts)

    def scores(self, points: Array) -> Array:
        """Return the scores (k,) of points (k, 12); a point known before costs no evaluation."""
        new = [point for point in points if point.tobytes() not in self._known][: self.left]
        if new:
            values, outcomes = self._evaluated(np.array(new))
            with np.errstate(divide="ignore"):
                found = np.log10(np.maximum(values, _MIN_VALUE))
            found = np.where(np.isin(outcomes, _UNSTABLE), _UNSTABLE_SCORE, found)
            found = np.where(np.isnan(found), _UNKNOWN_SCORE, found)
            self._parts.append((np.array(new), values, outcomes, found))
            self._known |= {point.tobytes(): float(score) for point, score in zip(new, found, strict=True)}
        return np.array([self._known.get(point.tobytes(), _UNKNOWN_SCORE) for point in points])

    def _evaluated(self, points: Array) -> tuple[Array, NDArray[np.object_]]:
        parts = np.array_split(points, min(self._workers, len(points)))
        done = list(self._pool.map(self._measured, parts))
        return tuple(np.concatenate(column) for column in zip(*done, strict=True))  # type: ignore[return-value]

    def _measured(self, points: Array) -> tuple[Array, NDArray[np.object_]]:
        template, bodies = self._ensemble.template, bodies_at(self._ensemble.distribution, points)
        answer = self._engine_pools.motions(template, bodies, *self._keys[0])
        if len(self._keys) == 1:
            found = measured(template, bodies, truth_of(template, bodies, free=self._free), answer)
            return np.asarray(found.measures[self._request.measure]), found.endings
        other = self._engine_pools.motions(template, bodies, *self._keys[1])
        # each against the other, as either may break down
        found = measured(template, bodies, _as_truth(other), answer)
        reverse = measured(template, bodies, _as_truth(answer), other)
        own = ~np.isin(found.endings, ("ok", "chaotic"))
        outcomes = np.where(own, found.endings, np.where(reverse.endings == "chaotic", "ok", reverse.endings))
        values = np.where(outcomes == "ok", found.measures[self._request.measure], np.nan)
        return np.where(outcomes == "unstable", np.inf, values), outcomes


def _as_truth(answer: BatchAnswer) -> BatchTruth:
    """Return the motions of a method in the place of the truth, where they ended well."""
    nothing = np.zeros(len(answer.endings))
    return BatchTruth(
        answer.quaternion, answer.omega_body, nothing, nothing, np.array(answer.endings) == "ok"
    )


def hunt(request: HuntRequest, make_progress: ProgressFactory) -> HuntResult:
    """Search by CMA-ES from the worst of many uniform starts; Hansen (2016), The CMA evolution strategy.

    Raises InputError for wrong input, UnavailableError without cma.
    """
    try:
        cma()  # an extra, checked before anything is run
    except ImportError:
        raise UnavailableError("hunt needs cma: pip install 'bodycheck[hunt]'") from None
    ensemble, keys = request.checked()
    engine_pools = EnginePools(request.ensemble.timeout_s)
    pool = ThreadPoolExecutor(Request(jobs=request.ensemble.jobs).workers)
    try:
        search = _Search(request, ensemble, keys, engine_pools, pool)
        uniform = int(_UNIFORM_SHARE * request.evaluations)
        with make_progress((request.evaluations - uniform) // _POPULATION) as progress:
            progress.phase("trying uniform starts")
            points = ensemble.points(0, uniform)
            ranked = points[np.argsort(-search.scores(points), kind="stable")]
            progress.motions_started()
            for start in range(_STARTS):
                budget = search.left // (_STARTS - start)
                _evolve(search, ensemble, ranked[start], budget, request.ensemble.seed + start, progress)
        path = search.path
        if np.all(path.scores == _UNKNOWN_SCORE):
            raise InputError(f"no start could be measured; the first one: {path.outcomes[0]}")
        finite = path.values[:uniform][np.isfinite(path.values[:uniform])]
        typical = float(np.median(finite)) if len(finite) else math.nan
        return HuntResult(request, ensemble, keys, typical, len(finite), uniform, path)
    except KeyboardInterrupt:
        engine_pools.stop()
        raise StoppedError("stopped; nothing was written") from None
    finally:
        pool.shutdown()
        engine_pools.close()


def _evolve(
    search: _Search, ensemble: Ensemble, start_point: Array, budget: int, seed: int, progress: Progress
) -> None:
    """Search around a start, along the axes of the cube that change it, with so many evaluations at most."""
    active = _active(ensemble)
    strategy = cma().CMAEvolutionStrategy(
        start_point[active],
        _SPREAD,
        {"bounds": [0.0, 1.0], "popsize": _POPULATION, "seed": seed + 1, "verbose": -9},  # seed 0: the clock
    )
    end = search.left - budget
    while search.left - _POPULATION >= end and not strategy.stop():
        candidates = strategy.ask()
        points = np.tile(start_point, (len(candidates), 1))
        points[:, active] = np.clip(candidates, _INSIDE, 1.0 - _INSIDE)
        strategy.tell(candidates, (-search.scores(points)).tolist())
        progress.case_done()


def _active(ensemble: Ensemble) -> list[int]:
    """Return the axes of the cube that have an effect."""
    ranges = ensemble.distribution
    fixed = {
        "trace": ranges.trace_kg_m2[0] == ranges.trace_kg_m2[1],
        "spin": ranges.spin_rad_s[0] == ranges.spin_rad_s[1],
        **dict.fromkeys(("torque", "torque_1", "torque_2"), ranges.torque_n_m[1] == 0.0),
    }
    return [axis for axis, name in enumerate(COORDINATES) if not fixed.get(name, False)]


# --------------------------------------------------------------------------------------------------- files


def command_of(result: HuntResult, scenario: Path) -> str:
    """Return the command that runs the worst start by the method, and by the other one if there is one."""
    names = ",".join(
        with_method(requested_name(engine.name), method.name) for engine, method, _ in result.keys
    )
    arguments = ["bodycheck", "run", str(scenario), "--engine", names]
    settings = [setting for _, _, setting in result.keys]
    steps = dict.fromkeys(repr(one.dt_s) for one in settings if one.dt_s is not None)
    tolerances = dict.fromkeys(repr(one.tolerance) for one in settings if one.tolerance is not None)
    arguments += ["--dt", ",".join(steps)] if steps else []
    arguments += ["--tolerance", ",".join(tolerances)] if tolerances else []
    handed_over = any(engine.build.kind == "handed over" for engine, _, _ in result.keys)
    arguments += [ALLOW_CODE] if handed_over or result.request.ensemble.allow_code else []
    return shell_join(arguments)


def write_hunt(result: HuntResult, out: Path) -> None:
    """Write worst.toml, path.csv and manifest.json to a new or empty folder."""
    import pandas as pd

    name = f"{result.ensemble.scenario.name}-worst-of-{'-'.join(key[1].name for key in result.keys)}"
    summary = (
        f"evaluation {result.worst + 1} of {len(result.path.scores)} by bodycheck hunt: "
        f"{result.request.measure} {result.value:.6g}"
        + ("" if result.ratio is None else f", {result.ratio:.3g} times the median")
    )
    scenario = result.ensemble.scenario_of(result.bodies, name, summary, "bodycheck hunt")
    path, bodies = result.path, bodies_at(result.ensemble.distribution, result.path.points)
    columns: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "evaluation": np.arange(1, len(path.scores) + 1),
        "phase": np.where(np.arange(len(path.scores)) < result.uniform, "uniform", "search"),
        "outcome": path.outcomes,
        result.request.measure: path.values,
        "worst_so_far": np.isin(np.arange(len(path.scores)), result.improvements),
        "separatrix_distance": bodies.separatrix_distance,
        **{f"i{k + 1}_kg_m2": bodies.moments[:, k] for k in range(3)},
        **{f"q{letter}": bodies.quaternion[:, k] for k, letter in enumerate("wxyz")},
        **{f"w{letter}_body_rad_s": bodies.omega_body[:, k] for k, letter in enumerate("xyz")},
        **{f"t{letter}_body_n_m": bodies.torque_body[:, k] for k, letter in enumerate("xyz")},
    }
    manifest = {
        "schema_version": SCHEMA_VERSION,
        "bodycheck": version("bodycheck"),
        "request": asdict(result.request),
        "distribution": asdict(result.ensemble.distribution),
        "typical": result.typical if result.typical_of else None,
        "reproduce": command_of(result, out / "worst.toml"),
    }
    with atomic_folder(out) as folder:
        (folder / "worst.toml").write_text(scenario_text(scenario), encoding="utf-8")
        (folder / "path.csv").write_bytes(as_csv(pd.DataFrame(columns)))
        text = json.dumps(manifest, indent=2, allow_nan=False) + "\n"
        (folder / "manifest.json").write_text(text, encoding="utf-8")
