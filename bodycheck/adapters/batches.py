"""Batches: many scenes that differ by their bodies, attitudes, spins and constant torques, in one request."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Adapter, Precision, Setting, read_back_mismatch
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.random_bodies import Bodies
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Torque
from bodycheck.reference_impl.wrench import steps_per_sample

RowEnding: TypeAlias = Literal["ok", "unsupported", "failed", "timeout", "invalid"]


@dataclass(frozen=True, eq=False)
class Batch:
    """A template, the bodies that replace its own, and how to step them."""

    template: Scene
    bodies: Bodies
    method: str
    setting: Setting

    def __len__(self) -> int:
        return len(self.bodies)

    @property
    def dt_s(self) -> float | None:
        """The step in s, exactly a part of the duration, as a step plan has it."""
        if self.setting.dt_s is None:
            return None
        samples = self.template.samples - 1
        return self.template.duration_s / (samples * self.steps_per_sample)

    @property
    def steps_per_sample(self) -> int:
        """The number of steps from one sample to the next."""
        assert self.setting.dt_s is not None
        return steps_per_sample(self.template.sample_interval_s, self.setting.dt_s)

    @property
    def is_free(self) -> bool:
        """Whether neither loads nor gravity nor a pivot act on any body."""
        template = self.template
        at_rest = not (template.loads or template.gravity.any() or self.bodies.torque_body.any())
        return at_rest and template.pivot is None

    def scenes(self) -> Iterator[Scene]:
        """Yield the scene of each body."""
        for row in range(len(self)):
            yield scene_of(self.template, self.bodies, row)

    def __getitem__(self, rows: slice) -> Batch:
        return replace(self, bodies=self.bodies[rows])


def scene_of(template: Scene, bodies: Bodies, row: int) -> Scene:
    """Return the template with another body, attitude and spin, and with the torque of that body if any."""
    quaternion, omega = bodies.quaternion[row].copy(), bodies.omega_body[row].copy()
    torque = bodies.torque_body[row]
    loads = (*template.loads, Torque("body", torque.copy())) if torque.any() else template.loads
    initial = State(template.initial.position, quaternion, template.initial.velocity, omega)
    if template.pivot is not None:
        initial = replace(initial, velocity=initial.rotation @ np.cross(template.pivot, omega))
    body = RigidBody(template.body.mass, np.diag(bodies.moments[row]))
    return replace(template, body=body, initial=initial, loads=loads)


@dataclass(frozen=True, eq=False)
class BatchAnswer:
    """What a method returned for m bodies at n samples, NaN for a body without a trajectory.

    quaternion (m, n, 4), scalar first, and omega_body (m, n, 3) in rad/s. endings and messages: m of each.
    """

    quaternion: Array
    omega_body: Array
    endings: tuple[RowEnding, ...]
    messages: tuple[str, ...]

    @classmethod
    def all_ok(cls, quaternion: Array, omega_body: Array) -> BatchAnswer:
        """Return the answer of bodies that all have a trajectory."""
        ok: RowEnding = "ok"
        return cls(quaternion, omega_body, (ok,) * len(quaternion), ("",) * len(quaternion))

    @classmethod
    def none(cls, batch: Batch, ending: RowEnding, message: str) -> BatchAnswer:
        """Return the answer of bodies that all ended in the same way, without a trajectory."""
        m, n = len(batch), batch.template.samples
        return cls(np.full((m, n, 4), np.nan), np.full((m, n, 3), np.nan), (ending,) * m, (message,) * m)

    @classmethod
    def joined(cls, *parts: BatchAnswer) -> BatchAnswer:
        """Return the answers of consecutive parts of a batch as one."""
        return cls(
            np.concatenate([part.quaternion for part in parts]),
            np.concatenate([part.omega_body for part in parts]),
            tuple(ending for part in parts for ending in part.endings),
            tuple(message for part in parts for message in part.messages),
        )


def record_batch(adapter: Adapter, batch: Batch) -> BatchAnswer:
    """Record all motions of a batch: in one call where the engine has one, otherwise one after the other.

    The engine's call is the adapter's `record_batch(batch)`. It returns the same motions to round-off, after
    comparing the models that it reads back with the batch, or None where it cannot take the batch.
    """
    together = getattr(adapter, "record_batch", None)
    found: BatchAnswer | None = None if together is None else together(batch)
    return one_by_one(adapter, batch) if found is None else found


def one_by_one(adapter: Adapter, batch: Batch) -> BatchAnswer:
    """Record the motions of a batch one after the other."""
    rows = []
    for scene in batch.scenes():
        case = Case(scene, batch.method, batch.setting)
        try:
            answer = record(adapter, case)
        except Exception as error:  # noqa: BLE001 - an engine may raise anything; only this body fails
            answer = Answer("failed", f"{type(error).__name__}: {error}")
        rows.append((scene, answer))
    method = adapter.methods.get(batch.method)
    return stacked(batch, rows, "float64" if method is None else method.precision)


def stacked(batch: Batch, rows: list[tuple[Scene, Answer]], precision: Precision) -> BatchAnswer:
    """Return the answers of single cases as that of a batch, after comparing the models read back."""
    answer = BatchAnswer.none(batch, "failed", "")
    endings: list[RowEnding] = []
    messages: list[str] = []
    for row, (scene, one) in enumerate(rows):
        ending: RowEnding = one.outcome
        message, motion, read_back = one.message, one.trajectory, one.read_back
        if motion is not None and read_back is not None:
            if fault := read_back_mismatch(scene, batch.dt_s, read_back, precision):
                ending, message = "invalid", fault
            else:
                answer.quaternion[row], answer.omega_body[row] = motion.attitude, motion.omega_body
        endings.append(ending)
        messages.append(message)
    return replace(answer, endings=tuple(endings), messages=tuple(messages))
