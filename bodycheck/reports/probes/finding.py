"""One check of a probe: what was measured, what any consistent method gives, and how far that may be off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias

from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory

Verdict: TypeAlias = Literal["consistent", "inconsistent", "not-measured"]

LONGEST_DELAY = 0.75
"""Steps. A consistent method may hold its velocities half a step off; a whole step is a delay."""


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
        """The sample at this time."""
        return round(t_s / self.dt_s)


@dataclass(frozen=True)
class Finding:
    """What one check found; without a measured value, why there is none; without a tolerance, a property."""

    check: str
    measured: float | None = None
    expected: float | None = None
    deviation: float | None = None
    tolerance: float | None = None
    message: str = ""

    @property
    def verdict(self) -> Verdict:
        """Whether the deviation is within the tolerance; a property is wrong at no size."""
        if self.deviation is None:
            return "not-measured"
        within = self.tolerance is None or self.deviation <= self.tolerance
        return "consistent" if within else "inconsistent"


def delay_finding(check: str, steps: float, late: str) -> Finding:
    """Return a delay in steps as a finding; late: what is delayed, for the message."""
    if not math.isfinite(steps):
        return Finding(check, message="no motion whose delay could be measured")
    message = ""
    if abs(steps) > LONGEST_DELAY:
        amount = f"{abs(steps):.3g}"
        unit = "step" if amount == "1" else "steps"
        message = f"{late} {amount} {unit} {'late' if steps > 0.0 else 'early'}"
    return Finding(check, steps, 0.0, abs(steps), LONGEST_DELAY, message)
