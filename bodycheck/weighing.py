"""The thresholds that a command is given: --threshold, and single measures from a tolerance file."""

from __future__ import annotations

import math
from pathlib import Path

from bodycheck.errors import InputError
from bodycheck.reports.comparison.thresholds import Thresholds


def thresholds_of(threshold: float, tolerances: Path | None) -> Thresholds:
    """Return the thresholds of all measures; InputError where the option or the file is wrong."""
    if not 0.0 <= threshold < math.inf:
        raise InputError(f"--threshold {threshold}: must be 0 or more, like 0.02 for 2 %")
    if tolerances is None:
        return Thresholds(threshold)
    from bodycheck.reports.gates.gate import read_thresholds  # late: pydantic

    return read_thresholds(tolerances, threshold)
