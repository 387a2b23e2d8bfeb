"""Exudyn's solvers with a fixed step, and their settings."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class ExudynSolver:
    """A member of DynamicSolverType, its order, its evaluations per step and its formula."""

    called: str
    order: int
    evaluations: int | None
    formula: str


SOLVERS = {
    "explicit-euler": ExudynSolver("ExplicitEuler", 1, 1, "M1, pose from the old omega"),
    "explicit-midpoint": ExudynSolver("ExplicitMidpoint", 2, 2, "midpoint Munthe-Kaas"),
    "rk44": ExudynSolver("RK44", 4, 4, "RK4 Munthe-Kaas"),
    "dopri5": ExudynSolver("DOPRI5", 5, 7, "RK5 (Dormand-Prince) Munthe-Kaas"),
    "rk67": ExudynSolver("RK67", 6, 7, "explicit Runge-Kutta of order 6 with 7 stages on the rotation group"),
    "trapezoidal-index2": ExudynSolver(
        "TrapezoidalIndex2", 2, None, "implicit trapezoidal rule (Newmark, beta 1/4, gamma 1/2)"
    ),
}
_NO_CONTROL = 1e30
ROUND_OFF = 64.0 * float(np.finfo(np.float64).eps)
_ITERATIONS = 50


def fixed_steps() -> Any:
    """Return settings of a solver without step control and output, whose iterations end at round-off."""
    import exudyn

    settings = exudyn.SimulationSettings()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        settings.solutionSettings.writeSolutionToFile = False
    steps = settings.timeIntegration
    steps.verboseMode, steps.automaticStepSize, steps.adaptiveStep = 0, False, False
    steps.absoluteTolerance = _NO_CONTROL  # DOPRI5 controls its error whatever automaticStepSize is
    steps.newton.useModifiedNewton = False
    steps.newton.relativeTolerance, steps.newton.maxIterations = ROUND_OFF, _ITERATIONS
    return settings
