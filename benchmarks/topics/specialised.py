"""What is gained by kernels that leave out what a scene has not: the same motion with every load in it.

The loads of the general scene are there, but so weak that they change no digit of the motion.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.contenders.stepped_taylor import STEPPED_TAYLOR
from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.problems import FREE, WORLD_TORQUE, Problem
from benchmarks.timing import interleaved, ratio
from bodycheck.reference_impl.scene import Drag, GravityGradient, Load, SineTorque, Torque

_TOLERANCE = 1e-12
# Far below the last digit of a torque of 1 N m over 10 s, and far above what underflows in a series.
_WEAK = 1e-20
_VECTOR = np.full(3, _WEAK)
_ROTATION: tuple[Load, ...] = (
    Torque("world", _VECTOR),
    SineTorque("body", _VECTOR, rate=1.0, phase=0.0),
    SineTorque("world", _VECTOR, rate=1.0, phase=0.0),
    GravityGradient(rate=_WEAK**0.5),
    Drag(0.0, _WEAK * np.eye(3)),
)
_TRANSLATION: tuple[Load, ...] = (Drag(_WEAK, np.zeros((3, 3))),)


def specialised(effort: Effort) -> list[Measured]:
    """Time a free motion next to every load, and a forced one next to the centre of mass's motion."""
    return [
        _gain("specialised.free", FREE, (*_ROTATION, *_TRANSLATION), effort),
        _gain("specialised.rotation", WORLD_TORQUE, _TRANSLATION, effort),
    ]


def _gain(figure: str, problem: Problem, more: tuple[Load, ...], effort: Effort) -> Measured:
    general = Problem(problem.name, replace(problem.scene, loads=(*problem.scene.loads, *more)))
    solvers = [STEPPED_TAYLOR.prepare(one, _TOLERANCE) for one in (general, problem)]
    slow, fast = interleaved(solvers, effort)
    errors = [problem.error(solver.end()) for solver in solvers]
    note = f"tolerance {_TOLERANCE:g}; errors {errors[0]:.1e} and {errors[1]:.1e}"
    return Measured.of(figure, ratio(slow, fast), note)
