"""Free bodies in one call of `mujoco.rollout`: a model each, stepped without returning to Python."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco import rollout

from bodycheck.adapters.batches import Batch, BatchAnswer, one_by_one
from bodycheck.adapters.contract import read_back_mismatch
from bodycheck.reference_impl.arrays import Array

if TYPE_CHECKING:
    from bodycheck.adapters.mujoco import MuJoCo, MuJoCoSimulation

MODELS = 128
"""Bodies per call: each has a model of some 0.5 MB."""

STATES = 1 << 21
"""Doubles per call, 16 MB: longer motions take several calls."""

_TIME = 0  # the first number of a state


def record_rollouts(engine: MuJoCo, batch: Batch) -> BatchAnswer:
    """Step all bodies of a batch of free bodies."""
    parts = [batch[first : first + MODELS] for first in range(0, len(batch), MODELS)]
    return BatchAnswer.joined(*(_recorded(engine, part) for part in parts))


def _recorded(engine: MuJoCo, batch: Batch) -> BatchAnswer:
    dt_s, answer = batch.dt_s, BatchAnswer.none(batch, "ok", "")
    assert dt_s is not None
    endings, messages = list(answer.endings), list(answer.messages)
    built: dict[int, MuJoCoSimulation] = {}
    for row, scene in enumerate(batch.scenes()):
        if reason := engine.unsupported(scene, batch.method):
            endings[row], messages[row] = "unsupported", reason
            continue
        simulation = engine.build(scene, batch.method, dt_s)
        if fault := read_back_mismatch(scene, dt_s, simulation.read_back()):
            endings[row], messages[row] = "invalid", fault
        else:
            built[row] = simulation
    states = rollout_states(list(built.values()), batch.template.samples - 1, batch.steps_per_sample)
    for (row, simulation), motion in zip(built.items(), states, strict=True):
        if abs(motion[-1, _TIME] - batch.template.duration_s) > 0.5 * dt_s:
            # it stopped at a warning, about which the simulation of the body alone says more
            alone = one_by_one(engine, batch[row : row + 1])
            answer.quaternion[row], answer.omega_body[row] = alone.quaternion[0], alone.omega_body[0]
            endings[row], messages[row] = alone.endings[0], alone.messages[0]
            continue
        for k, state in enumerate(motion):
            reading = simulation.read_at(state)
            answer.quaternion[row, k], answer.omega_body[row, k] = reading.quaternion, reading.omega_body
    return BatchAnswer(answer.quaternion, answer.omega_body, tuple(endings), tuple(messages))


def rollout_states(simulations: list[MuJoCoSimulation], intervals: int, stride: int) -> Array:
    """Return the states at both ends of each interval of `stride` steps: (m, intervals + 1, k).

    A state is the time, qpos and qvel. The simulations themselves stay at their start.
    """
    if not simulations:
        return np.empty((0, intervals + 1, 1))
    models, starts = [one.model for one in simulations], np.array([one.state() for one in simulations])
    data, found = mujoco.MjData(models[0]), np.empty((len(models), intervals + 1, starts.shape[1]))
    found[:, 0] = starts
    together = max(STATES // (starts.size * stride), 1)
    for first in range(0, intervals, together):
        count = min(together, intervals - first)
        states, _ = rollout.rollout(models, data, found[:, first], nstep=count * stride)
        found[:, first + 1 : first + 1 + count] = states[:, stride - 1 :: stride]
    return found
