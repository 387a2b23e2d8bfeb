"""Ours for any load: the adaptive Taylor integrator in doubles."""

from __future__ import annotations

import numpy as np

from benchmarks.contenders.contender import Contender, tolerances
from benchmarks.problems import End, Problem
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion


class _Solving:
    def __init__(self, problem: Problem, tolerance: float) -> None:
        self._motion = TaylorMotion.of(problem.scene, tolerance)
        self._t_s = np.array([problem.scene.duration_s])
        self._solved = self._motion.solve(self._t_s)

    def reset(self) -> None:
        """Do nothing: each run begins at the initial state."""

    def run(self) -> None:
        """Solve for the end."""
        self._solved = self._motion.solve(self._t_s)

    def end(self) -> End:
        """Return the one row solved for."""
        state = self._solved.states[0]
        return state[:4], state[4:7]


# With steps that err by 1e-2 a body gains energy without end over 1000 s, and its steps shrink without end.
STEPPED_TAYLOR = Contender("Taylor", "", "tolerance", tolerances(1e-3, 1e-17), _Solving)
