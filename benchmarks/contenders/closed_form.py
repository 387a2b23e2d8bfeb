"""Ours for a body that nothing turns: Jacobi's closed form, at one time, no steps."""

from __future__ import annotations

import numpy as np

from benchmarks.contenders.contender import Contender
from benchmarks.problems import End, Problem
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation import FreeRotation


class _Evaluation:
    """The motion set up before; a run solves for the end."""

    def __init__(self, problem: Problem, _: float) -> None:
        scene = problem.scene
        self._start = scene.body.inertia, scene.initial.quaternion, scene.initial.omega_body
        self._t_s = np.array([scene.duration_s])
        self._motion = FreeRotation.from_state(*self._start)
        self._solved: tuple[Array, Array] = self._motion.at(self._t_s)

    def reset(self) -> None:
        """Nothing to go back from."""

    def run(self) -> None:
        """Solve for the end."""
        self._solved = self._motion.at(self._t_s)

    def end(self) -> End:
        """Return the one row solved for."""
        quaternion, omega = self._solved
        return quaternion[0], omega[0]


class _WithSetUp(_Evaluation):
    """A run sets the motion up from its initial state, then solves for the end."""

    def run(self) -> None:
        """Set up and solve."""
        self._motion = FreeRotation.from_state(*self._start)
        super().run()


CLOSED_FORM = Contender("closed form", "", "none", (0.0,), _WithSetUp)
CLOSED_FORM_SET_UP_BEFORE = Contender("closed form, set up before", "", "none", (0.0,), _Evaluation)
