"""The impulses that each fault of the catalogue would give to a load, or to gravity, whatever the map is.

A wrong impulse is the integral of the wrong force or torque at the attitudes that an engine reads.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import EXACT, Flow, States
from bodycheck.examine.diagnosis.engine_model import Grid, Loads, Model
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import FaultContext
from bodycheck.examine.diagnosis.transitions import QUANTITIES, Transitions
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.scales import scene_scales

Mistaken: TypeAlias = dict[str, list[Array]]
"""The sentence of a fault -> for each motion, the impulses (2, 3) of force and torque in world axes."""


def mistaken_impulses(alone: Scene, paths: Sequence[Trajectory]) -> Mistaken:
    """Return what faults without open parameters would give; timing is left to the delays.

    alone: a scene with one constant load or gravity only. paths: motions while it acts, one for each step.
    """
    found: Mistaken = {}
    for path in paths:
        for text, impulse in _of_motion(alone, path):
            found.setdefault(text, []).append(impulse)
    return found


def _of_motion(alone: Scene, path: Trajectory) -> Iterator[tuple[str, Array]]:
    acting = Loads.of([[(load, 1.0) for load in alone.piecewise_constant_loads]])
    count = len(path.t_s)
    grid = Grid(1, np.diff(path.t_s), acting, np.zeros((count - 1, 1), dtype=np.intp))
    transitions = Transitions.of(alone, path, grid, scene_scales(alone, path), frozenset(QUANTITIES))
    texts, models = zip(*_candidates(FaultContext(transitions, EXACT)), strict=True)
    flow = Flow(models, EXACT, alone, np.ones(count), np.zeros(count, dtype=np.intp), path.t_s)
    columns = (path.position_m, path.velocity_m_s, path.attitude, path.omega_body)
    y = States(*(np.repeat(column.T[:, None], len(models), axis=1) for column in columns))
    force, torque = flow.wrench(y)
    for text, *rates in zip(texts, *(np.moveaxis(part, 1, 0) for part in (force, torque)), strict=True):
        yield text, np.stack([np.trapezoid(rate, path.t_s) for rate in rates])


def _candidates(at: FaultContext) -> Iterator[tuple[str, Model]]:
    kind = "loads" if at.scene.loads else "gravity"
    for fault in FAULTS:
        if fault.kind != kind or fault.is_general or not fault.could_change(at):
            continue
        for values, text in fault.particular:
            model = at.transitions.grid.model(at.scene)
            fault.plant(model, values, at)
            yield text, model
