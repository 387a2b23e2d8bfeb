"""Every fault of the diagnosis changes some motion: one that changes none could never be named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.examine.diagnosis.candidate_maps import BASES
from bodycheck.examine.diagnosis.diagnosis import ALL_QUANTITIES
from bodycheck.examine.diagnosis.engine_model import Grid
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import FACTOR, Fault, FaultContext, assigned, near
from bodycheck.examine.diagnosis.fit import planted
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.reports.measurement.problem import Problem
from bodycheck.scenarios.library import load_scenario

STEPS = {
    "full-tensor": 1e-2,
    "powered-flight": 2e-2,
    "off-grid-torque": 0.025,
    "heavy-top": 1e-2,
    "spring-pendulum": 1e-2,
}
"""Steps of scenes without loads, with all constant loads, switches, a pivot, and a continuous load."""

SPECIAL = ("tilted gravity", "half a radian per step", "a body that stands still")
"""Variants of powered-flight without which a few faults have no effect."""


@cache
def context_of(name: str) -> tuple[FaultContext, Grid]:
    """Return the circumstances of the motion of M1 on a scene, and its steps."""
    scenario, dt_s = (name, STEPS[name]) if name in STEPS else ("powered-flight", STEPS["powered-flight"])
    problem = Problem.of(load_scenario(scenario), scenario)
    scene = problem.scenario.scene
    if name == "tilted gravity":
        scene = replace(scene, gravity=np.array([1.0, -3.0, -9.0]))
    if name == "half a radian per step":
        scene = replace(scene, initial=replace(scene.initial, omega_body=np.array([12.0, -18.0, 22.0])))
    motion = record(Reference(), Case(scene, "m1", Setting(dt_s=dt_s))).trajectory
    assert motion is not None
    if name == "a body that stands still":
        still = {
            field: np.repeat(getattr(motion, field)[:1], scene.samples, axis=0)
            for field in ("position_m", "velocity_m_s", "quaternion", "omega_body_rad_s")
        }
        motion = replace(motion, **still)
    grid = Grid.of(scene, dt_s)
    found = Transitions.of(scene, motion, grid, problem.scales, ALL_QUANTITIES)
    return FaultContext(found, BASES["m1"]), grid


def inert_faults(faults: Sequence[Fault]) -> list[str]:
    """Return the names of the faults that change the steps of no scene, nor what is read of them.

    Each is planted at every start of its fits, at half of it, and a little off it.
    """
    silent = list(faults)
    for name in (*STEPS, *SPECIAL):
        circumstances, grid = context_of(name)
        healthy = grid.model(circumstances.scene)
        for base in ("m1", "rk4"):
            at = replace(circumstances, base=BASES[base])
            rows: list[int] = []
            models = [healthy.copied()]
            for row, fault in enumerate(silent):
                if not fault.applies(at):
                    continue
                nudge = np.array([1e-3 * parameter.size for parameter in fault.parameters])
                for start in fault.starts(at):
                    values_of_start = np.array(start, dtype=np.float64)
                    for values in (values_of_start, 0.5 * values_of_start, values_of_start + nudge):
                        rows.append(row)
                        models.append(planted(at, healthy, [fault], values))
            sound, *others = at.transitions.differences(models, BASES[base])
            seen = {
                row
                for row, other in zip(rows, others, strict=True)
                if not np.array_equal(other, sound, equal_nan=True)
            }
            silent = [fault for row, fault in enumerate(silent) if row not in seen]
    return [fault.name for fault in silent]


@pytest.mark.slow
def test_every_fault_changes_a_motion() -> None:
    """In at least one of eight scenes, on M1 or the classical Runge-Kutta method."""
    assert inert_faults(FAULTS) == []


def test_a_fault_that_changes_nothing_is_named() -> None:
    """It assigns an attribute of the model that no map takes into account."""
    forgotten = Fault("forgotten", "body", "damped at {0} 1/s", assigned("forgotten"), (FACTOR,), near(0.5))
    assert inert_faults([forgotten]) == ["forgotten"]
