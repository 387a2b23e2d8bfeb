"""The request of an ensemble, and the results of each method on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import setting as setting_words
from bodycheck._util.shard import Shard
from bodycheck.adapters.contract import Engine, Method, Setting
from bodycheck.adapters.engine_names import with_method
from bodycheck.ensembles.ensemble_cases import ROTATION_MEASURES, settings_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.sentinels import Sentinel
from bodycheck.reports.summary.quantiles import Quantile, QuantileSketch
from bodycheck.runs.request import TIMEOUT_S
from bodycheck.runs.selection import select, step_faults, tolerance_faults
from bodycheck.scenarios.ensemble import Ensemble, default_distribution
from bodycheck.scenarios.library import load_scenario

SAMPLES = 5
STEPS = 1000
"""Default number of steps of a motion."""

SENTINELS = 16
"""Number of bodies that are stepped alone, together and in reverse order."""

_SMALLEST, _LARGEST = 1e-50, 1e50
"""Of a trace in kg m^2, a spin in rad/s or a torque in N m: products of squares stay finite."""

FLOORS = {"bound_rad": "truth_bound_rad", "round_off_rad": "round_off_rad"}
"""The counted quantities of the truth itself, and their columns in the table of the bodies."""

_FLOOR = 3.0  # multiples of the truth's error and of round-off: a smaller error is at the floor
_RANKED = ROTATION_MEASURES[0]

Key: TypeAlias = tuple[Engine, Method, Setting]


@dataclass(frozen=True, kw_only=True)
class EnsembleRequest:
    """What to measure; None stands for the default that depends on the scenario.

    shard: "K/N" for the K-th of N consecutive parts of the rows.
    """

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
    shard: str | None = None

    @property
    def rows(self) -> range:
        """The rows of the whole ensemble, or of its shard; raises InputError for a wrong shard."""
        full_range = range(self.first_row, self.first_row + self.n)
        if self.shard is None:
            return full_range
        part = Shard.parse(self.shard)
        if part.count > self.n:
            raise InputError(f"--shard {self.shard}: there are {self.n} bodies; use {self.n} shards at most")
        return full_range[self.n * (part.index - 1) // part.count : self.n * part.index // part.count]

    @property
    def sentinel_rows(self) -> range:
        """The first rows of the whole ensemble, which every shard moves and compares in three orders."""
        return range(self.first_row, self.first_row + SENTINELS)

    def ensemble(self) -> Ensemble:
        """Return the ensemble; raises InputError with one line per error."""
        faults = [
            f"{option} {value}: must be {requirement}"
            for option, value, good, requirement in (
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
            if ends is not None and not _SMALLEST <= ends[0] <= ends[1] <= _LARGEST:
                faults.append(
                    f"{option} {ends[0]:g},{ends[1]:g}: must be two numbers LOW,HIGH "
                    f"from {_SMALLEST:g} to {_LARGEST:g}"
                )
        if faults:
            raise InputError("\n".join(faults))
        self.rows  # noqa: B018 - refuses a wrong shard
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
        faults = [
            *(
                f"--dt with --samples {self.samples}: {fault}"
                for fault in step_faults(template.sample_interval_s, steps)
            ),
            *(f"--tolerance: {fault}" for fault in tolerance_faults(self.tolerances or ())),
        ]
        if faults:
            raise InputError("\n".join(faults))
        return [
            (engine, method, setting)
            for engine, method in selection.methods
            for setting in settings_of(method, steps, self.tolerances or ())
        ]


@dataclass(frozen=True)
class WorstBody:
    """One of the bodies with the largest orientation errors: its row, measures and outcome."""

    row: int
    measures: dict[str, float]
    outcome: str

    @property
    def error_rad(self) -> float:
        """The orientation error, infinite where unstable."""
        return self.measures[_RANKED]


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
    worst: list[WorstBody] = field(default_factory=list)
    """The worst first."""

    def add(self, cases: Mapping[str, NDArray[Any]], floor_rad: Array, max_kept: int) -> None:
        """Add n cases by their columns (n,), as stored; floor_rad (n,): the truth's error plus round-off."""
        self.endings.update(map(str, cases["outcome"]))
        error = cases[_RANKED]
        measured = ~np.isnan(error)
        for name, sketch in self.sketches.items():
            sketch.add(cases[name][measured])
        self.at_floor += int(np.sum(error[measured] <= _FLOOR * floor_rad[measured]))
        rows = np.flatnonzero(measured)
        ranked = rows[np.argsort(-error[rows], kind="stable")[:max_kept]]
        found = (
            WorstBody(
                int(cases["row"][k]),
                {name: float(cases[name][k]) for name in self.sketches},
                str(cases["outcome"][k]),
            )
            for k in ranked
        )
        self.worst = sorted([*self.worst, *found], key=lambda body: (-body.error_rad, body.row))[:max_kept]

    @property
    def bodies(self) -> int:
        """The number of measured bodies."""
        return self.sketches[_RANKED].total

    def quantile(self, measure: str, share: float) -> Quantile:
        """Return a quantile of a measure with its error bar."""
        return self.sketches[measure].quantile(share)


@dataclass(frozen=True, eq=False)
class EnsembleResult:
    """The statistics of each method of an ensemble, and of the truth's own error.

    sentinels: in a shard, the motions of the sentinel rows by each method. shards: those that were merged;
    findings: how their machines differ.
    """

    request: EnsembleRequest
    ensemble: Ensemble
    statistics: tuple[tuple[Key, MethodStatistics], ...]
    floors: dict[str, QuantileSketch]
    sentinels: list[Sentinel] = field(default_factory=list)
    shards: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()

    @classmethod
    def empty(cls, request: EnsembleRequest, ensemble: Ensemble, keys: Sequence[Key]) -> EnsembleResult:
        """Return the result before anything is measured."""
        floors = {name: QuantileSketch() for name in FLOORS}
        return cls(request, ensemble, tuple((key, MethodStatistics()) for key in keys), floors)


def key_text(key: Key) -> str:
    """Return "mujoco:rk4, dt 0.01 s"."""
    engine, method, setting = key
    return f"{with_method(engine.name, method.name)}, {setting_words(method.control, setting.fineness)}"
