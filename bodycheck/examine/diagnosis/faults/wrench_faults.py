"""Faults of the total force, with the weight, and of the total torque: what a step function receives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from bodycheck.examine.diagnosis.engine_model import Model
from bodycheck.examine.diagnosis.faults.fault import FACTOR, Fault, FaultContext, constant, near
from bodycheck.reference_impl.arrays import Array

_CONFIRM = "start from an attitude other than identity, under one load at a time"


def _is_sum_of_forces(at: FaultContext) -> bool:
    """Return whether the total force differs from each of its parts, and moves the body."""
    parts = len(at.loads & {"force_body", "force_world"}) + at.has_gravity + bool(at.scene.continuous_loads)
    return parts > 1 and at.shows_translation


def _is_sum_of_torques(at: FaultContext) -> bool:
    parts = at.loads & {"torque_body", "torque_world", "moment", "lever"}
    return len(parts) + bool(at.scene.continuous_loads) > 1 and at.is_free


def _accelerated(model: Model, values: Array, at: FaultContext) -> None:
    parts = ("force_body", "force_world")
    model.loads = replace(model.loads, **{part: values[0] * getattr(model.loads, part) for part in parts})
    model.gravity = values[0] * model.gravity


def wrench_faults() -> Iterator[Fault]:
    """Yield the faults of the total force, then those of the total torque."""
    yield Fault(
        "acceleration",
        "loads",
        "the acceleration of the centre of mass is multiplied by {0}",
        _accelerated,
        (FACTOR,),
        near(1.0, -1.0),
        lambda at: _is_sum_of_forces(at) and not at.scene.continuous_loads,
        (
            (0.0, "the velocity is constant: the total force is missing"),
            (-1.0, "the total force, with the weight, has the opposite sign"),
            (2.0, "the total force, with the weight, is applied twice"),
        ),
        confirm="compare v' with the total force over the mass",
    )
    total = "the total force in world axes, with the weight,"
    for name, text, code in (
        ("total-force-in-body-axes", f"{total} acts in body axes", 1.0),
        ("total-force-by-transpose", f"{total} is rotated by R^T", 2.0),
    ):
        changes = constant(total_force_by=code)
        yield Fault(name, "loads", text, changes, applies=_is_sum_of_forces, confirm=_CONFIRM)
    for name, text, code in (
        ("total-torque-in-world-axes", "the total torque in body axes acts in world axes", 2.0),
        ("total-torque-rotated", "the total torque in body axes is rotated by R", 1.0),
    ):
        changes = constant(total_torque_by=code)
        yield Fault(name, "loads", text, changes, applies=_is_sum_of_torques, confirm=_CONFIRM)
