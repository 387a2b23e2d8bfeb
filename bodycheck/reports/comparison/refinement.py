"""Which cases a run chose itself: steps beyond those it was asked for, so that an order can be seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bodycheck.scenarios.model import DEFAULT_STEPS_PER_SAMPLE

_SAME = 1e-9  # relative: how well two steps agree that are one


def is_refinement(row: Mapping[str, Any], manifest: Mapping[str, Any]) -> bool:
    """Whether a run chose the step of a case itself; such a case is neither new nor missing elsewhere.

    row: of results.csv. manifest: of its run. A run of which the requested steps are unknown chose none.
    """
    if row["control"] != "dt" or row.get("dt_s") is None:
        return False
    requested = manifest.get("dt_s") or _listed(manifest["scenarios"].get(row["scenario"], {}))
    return bool(requested) and not any(math.isclose(row["dt_s"], step, rel_tol=_SAME) for step in requested)


def _listed(scenario: Mapping[str, Any]) -> list[float]:
    """Return the steps that a scenario, as a manifest has it, uses by default."""
    if scenario.get("steps_s"):
        return list(scenario["steps_s"])
    if not {"duration_s", "samples"} <= scenario.keys():
        return []
    interval = scenario["duration_s"] / (scenario["samples"] - 1)
    return [interval / n for n in DEFAULT_STEPS_PER_SAMPLE]
