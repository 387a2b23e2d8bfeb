"""Driving a simulation through its plan of steps: once to record it, again and again to time it."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bodycheck.adapters.contract import Reading, Simulation
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import Leg, StepPlan, Wrench

_MOST_REPEATS = 7
_MOST_SECONDS = 0.12  # of stepping per case; at least one repeat is made after the recording


@dataclass(frozen=True)
class CpuTime:
    """Median and quartiles of the processor time of stepping one whole case, in s, over the repeats."""

    median_s: float
    low_s: float
    high_s: float


def record(simulation: Simulation, plan: StepPlan, scene: Scene) -> Trajectory:
    """Step a fresh simulation through its plan and return what it held at the samples."""
    readings = [simulation.read()]
    wrench: Wrench | None = None
    for leg in plan.legs():
        if leg.wrench is not wrench:
            wrench = leg.wrench
            simulation.apply(wrench)
        simulation.advance(leg.steps)
        if leg.ends_at_sample:
            readings.append(simulation.read())
    return _trajectory(scene.sample_times, readings)


def measure_cpu(simulation: Simulation, plan: StepPlan) -> CpuTime:
    """Step through the whole plan, stopping at no sample, until the repeats or the seconds are spent.

    The simulation must have been stepped before: the first pass through an engine is never timed.
    """
    legs = list(plan.uninterrupted())
    spent: list[float] = []
    while len(spent) < _MOST_REPEATS and sum(spent) < _MOST_SECONDS:
        simulation.reset()
        begin = time.process_time()
        _step_through(simulation, legs)
        spent.append(time.process_time() - begin)
    low, median, high = np.quantile(spent, [0.25, 0.5, 0.75]).tolist()
    return CpuTime(median, low, high)


def _step_through(simulation: Simulation, legs: Iterable[Leg]) -> None:
    for leg in legs:
        simulation.apply(leg.wrench)
        simulation.advance(leg.steps)


def _trajectory(t_s: Array, readings: list[Reading]) -> Trajectory:
    def column(name: str) -> Array | None:
        values = [getattr(reading, name) for reading in readings]
        return None if values[0] is None else np.array(values, dtype=np.float64)

    position, velocity = column("position"), column("velocity")
    assert position is not None
    assert velocity is not None
    return Trajectory(
        t_s=t_s,
        position_m=position,
        velocity_m_s=velocity,
        quaternion=column("quaternion"),
        rotation=column("rotation"),
        omega_world_rad_s=column("omega_world"),
        omega_body_rad_s=column("omega_body"),
    )
