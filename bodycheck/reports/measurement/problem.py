"""The problem that cases are measured against: a scenario with its truth, scales and invariants."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.truth.truth import QUANTITIES, Truth
from bodycheck.reports.cache.disk_cache import Cache
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.convergence import LARGEST_LIMIT
from bodycheck.reports.measurement.invariants import Invariant, invariants_of
from bodycheck.reports.measurement.scales import Scales, scene_scales
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.tree_model import TreeScenario


@dataclass(frozen=True, eq=False)
class Problem:
    """A scenario with its truth at the samples, energy and momentum along the truth, and its scales.

    scenario_spec: its name on the command line. compared: number of leading samples at which the truth can be
    trusted; a chaotic motion is not compared beyond them.
    """

    scenario: Scenario | TreeScenario
    truth: Truth
    motion: EnergyAndMomentum
    scales: Scales
    scenario_spec: str
    compared: int

    @classmethod
    def of(
        cls, scenario: Scenario | TreeScenario, scenario_spec: str | Path, cache: Cache | None = None
    ) -> Problem:
        """Solve the truth at the scenario's samples, or take it from the cache.

        Raises InputError where the motion exceeds the range of double precision, or the truth ends before the
        second sample.
        """
        scene: Scene | TreeScene = scenario.scene
        try:
            truth = known_truth(scene, scene.sample_times, cache)
        except ValueError as error:
            raise InputError(f"{scenario_spec}: {error}") from None
        scales = scene_scales(scene, truth.trajectory)
        if not all(math.isfinite(scale) for scale in vars(scales).values()):
            raise InputError(f"{scenario_spec}: energy or momentum exceeds the range of double precision")
        compared = int(np.count_nonzero(truth.trajectory.t_s < truth.trusted_until_s))
        if compared < 2:
            ends = f"the truth ends before the second sample; use more samples: {truth.end_reason}"
            raise InputError(f"{scenario_spec}: {ends}")
        return cls(
            scenario,
            truth,
            EnergyAndMomentum.of(scene, truth.trajectory),
            scales,
            str(scenario_spec),
            compared,
        )

    @property
    def of_body(self) -> Scenario:
        """The scenario of one body. Raises InputError for a tree."""
        if isinstance(self.scenario, Scenario):
            return self.scenario
        raise InputError(f"{self.scenario_spec}: is a tree of bodies, unsupported by this command")

    @property
    def times(self) -> Array:
        """The times at which trajectories are compared with the truth (compared,), in s."""
        return self.truth.trajectory.t_s[: self.compared]

    @cached_property
    def invariants(self) -> list[Invariant]:
        """The invariants of the scene besides energy and momentum."""
        return invariants_of(self.scenario.scene)

    @cached_property
    def is_chaotic(self) -> bool:
        """Whether round-off alone grows so large that a method cannot be judged by its error."""
        t_s = self.truth.trajectory.t_s
        truth_ended = self.compared < len(t_s) and t_s[self.compared] >= self.truth.trusted_until_s
        return bool(truth_ended) or self.largest(self.truth.round_off_rad) > LARGEST_LIMIT

    @cached_property
    def columns(self) -> dict[str, Any]:
        """The columns shared by all cases."""
        scenario, truth = self.scenario, self.truth
        return {
            "scenario": scenario.name,
            "family": scenario.family,
            "duration_s": scenario.duration_s,
            **vars(self.scales),
            "truth": truth.kind,
            **{f"truth_bound_{name}": self.largest(getattr(truth, f"bound_{name}")) for name in QUANTITIES},
            "compared_until_s": float(self.times[-1]),
        }

    def largest(self, bound: Array) -> float:
        """Return the maximum of one of the truth's bounds (n,) over the compared samples."""
        return float(np.max(bound[: self.compared]))
