"""Whether faults that explain one scene of a run agree with what the method does in the other scenes.

A fault of an engine acts in every scene, with the same numbers. One that was fitted to a single scene is
planted, unchanged, in the single steps of each other scene: where it would act and the motion is right, or
wrong in another way, the run refutes it. Another fault may act in the other scene as well; where a diagnosis
names it, less of the motion must agree.
"""

from __future__ import annotations

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import Base
from bodycheck.examine.diagnosis.diagnosis import ALL_QUANTITIES, Diagnosis, Search, could_act, obstacle
from bodycheck.examine.diagnosis.faults.fault import FaultContext
from bodycheck.examine.diagnosis.fit import Fit, planted
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.problem import Problem

_TRANSITIONS = 20
_VISIBLE = 10.0  # multiples of the smallest significant difference: a fault that would be seen
_ACTS = 0.1  # of the differences of a wrong motion: less is no effect
_EXPLAINS = 0.5  # share of the differences of a wrong motion that the same numbers must explain
_EXPLAINS_ALONE = 0.9  # the same, where no other fault is known

_OF_THE_SCENE = frozenset({"kg", "kg m^2", "m"})
"""Units of parameters that may differ between bodies, so that they cannot be carried over."""


def is_refuted(
    fit: Fit,
    base: Base,
    problem: Problem,
    motion: Trajectory,
    dt_s: float | None,
    own: Diagnosis | None = None,
) -> bool:
    """Whether faults would change a motion of the same method in a way in which it is not changed.

    fit: to another scene. dt_s: the step of the motion. own: its diagnosis, if it has one. False where the
    fault does not act, or where its parameters belong to the body.
    """
    units = {parameter.unit for fault in fit.faults for parameter in fault.parameters}
    of_body = any(fault.kind == "body" and fault.is_general for fault in fit.faults)  # such as a whole tensor
    scene = problem.of_body.scene
    if of_body or units & _OF_THE_SCENE or obstacle(scene, motion, ALL_QUANTITIES):
        return False
    with np.errstate(all="ignore"):
        search = Search.of(scene, motion, problem.scales, dt_s, ALL_QUANTITIES)
        whole = None if search is None else search.on(base)
        if whole is None:
            return False
        some = whole.subset(_TRANSITIONS)
        at = FaultContext(some, base)
        if not could_act(fit.faults, at):
            return False
        model = some.grid.model(scene)
        sound, faulty = some.differences([model, planted(at, model, fit.faults, fit.values)], base)
        before, after, effect = (some.cost_of(one) for one in (sound, faulty, faulty - sound))
    if before <= some.limit:
        return bool(after > _VISIBLE * some.limit)
    if own is not None and (own.verdict == "unexplained" or own.fault_names == fit.names):
        return bool(effect > _VISIBLE * some.limit and after > (1.0 - _EXPLAINS_ALONE) * before)
    return bool(effect > _ACTS * before and after > (1.0 - _EXPLAINS) * before)
