"""One check of a probe: the measured value, the value that any consistent method gives, and the tolerance.

The error of a one-step method has an expansion in powers of the step h (Gragg 1964; Hairer, Norsett and
Wanner, Solving ODEs I, II.8), so the limit is the value at h = 0 of the polynomial through several steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory

_SAFETY = 10.0  # multiples of the estimated uncertainty: a limit within it counts as zero
# Relative. A smaller deviation is not a wrong formula: an implicit method may stop its iterations there.
_MIN_TOLERANCE = float(np.sqrt(np.finfo(np.float64).eps))
_DIFFERENCE_NORM = float(np.sqrt(70.0))  # of a fourth difference of independent errors: 1, -4, 6, -4, 1


@dataclass(frozen=True, eq=False)
class FindingLimit:
    """A relative limit for h -> 0, (cells, components), and the largest size that still counts as zero."""

    value: Array
    tolerance: float

    @property
    def size(self) -> float:
        """The largest norm over the cells."""
        return largest_norm(self.value)

    @property
    def is_zero(self) -> bool:
        """Whether the size is within the tolerance; a size that is not finite never is."""
        return self.size <= self.tolerance

    def finding(self, check: str, wrong: str) -> Finding:
        """Return whether the limit is zero; wrong: the message if it is not."""
        return Finding(check, self.size, 0.0, self.size, self.tolerance, "" if self.is_zero else wrong)


def limit(steps_s: Sequence[float], mismatches: Sequence[Array], round_off: float) -> FindingLimit:
    """Extrapolate relative mismatches, each (cells, components), to h = 0.

    The uncertainty is the larger of two: the change of the extrapolated value without the coarsest step, and
    the round-off of a mismatch times the condition number of the extrapolation.
    """
    weights = _weights(steps_s)
    value = np.einsum("h,hij->ij", weights, np.array(mismatches))
    without_coarsest = np.einsum("h,hij->ij", _weights(steps_s[1:]), np.array(mismatches[1:]))
    uncertainty = max(largest_norm(value - without_coarsest), float(np.sum(np.abs(weights))) * round_off)
    return FindingLimit(value, max(_SAFETY * uncertainty, _MIN_TOLERANCE))


def _weights(steps_s: Sequence[float]) -> Array:
    """Lagrange basis polynomials at 0: prod over j != i of h_j / (h_j - h_i)."""
    h = np.array(steps_s)
    return np.array([np.prod([other / (other - one) for other in h if other != one]) for one in h])


def noise(series: Array) -> float:
    """Median |fourth difference| / sqrt(70): the round-off of samples (n, components) of a smooth motion.

    It is the round-off of the engine's own arithmetic, also in single precision. The median ignores the kinks
    where loads switch, and single wrong samples. Use the finest step, where these are few.
    """
    if len(series) < 5:
        return 0.0
    return float(np.max(np.median(np.abs(np.diff(series, 4, axis=0)), axis=0))) / _DIFFERENCE_NORM


Verdict: TypeAlias = Literal["consistent", "inconsistent", "not-measured"]

LONGEST_DELAY = 0.75
"""In steps. A consistent method may store its velocities half a step off; a whole step is a delay."""


@dataclass(frozen=True, eq=False)
class Sampled:
    """A probe's motion at one step, with a sample after every step."""

    scene: Scene
    trajectory: Trajectory

    @property
    def dt_s(self) -> float:
        """The time between two samples."""
        return self.scene.sample_interval_s

    def index(self, t_s: float) -> int:
        """Return the index of the sample at this time."""
        return round(t_s / self.dt_s)


@dataclass(frozen=True)
class Finding:
    """The result of one check. If nothing was measured, message says why. A property has no tolerance."""

    check: str
    measured: float | None = None
    expected: float | None = None
    deviation: float | None = None
    tolerance: float | None = None
    message: str = ""

    @property
    def verdict(self) -> Verdict:
        """Whether the deviation is within the tolerance; a property is never inconsistent."""
        if self.deviation is None:
            return "not-measured"
        within = self.tolerance is None or self.deviation <= self.tolerance
        return "consistent" if within else "inconsistent"


def delay_finding(check: str, steps: float, late: str) -> Finding:
    """Return a delay in steps as a finding; late: what is delayed, for the message."""
    if not math.isfinite(steps):
        return Finding(check, message="no motion from which to measure a delay")
    message = ""
    if abs(steps) > LONGEST_DELAY:
        amount = f"{abs(steps):.3g}"
        unit = "step" if amount == "1" else "steps"
        message = f"{late} {amount} {unit} {'late' if steps > 0.0 else 'early'}"
    return Finding(check, steps, 0.0, abs(steps), LONGEST_DELAY, message)
