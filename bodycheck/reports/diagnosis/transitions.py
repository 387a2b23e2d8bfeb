"""The transitions of a trajectory from sample to sample, and what candidates make of them.

Each transition starts from the state that the trajectory has there: errors of earlier ones do not add up, and
the difference at its end is nearly linear in a fault (multiple shooting: Bock 1981, Springer Series in
Chemical Physics 18, 102).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.pivot import about_pivot
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.diagnosis.engine_model import (
    Grid,
    Indices,
    Misreading,
    Model,
    Reading,
    conjugated,
    cross,
    matrix_of,
    product,
    rotation_vector,
    times,
    transposed_times,
)
from bodycheck.reports.diagnosis.flow import Base, Flow, States
from bodycheck.reports.measurement.scales import Scales

QUANTITIES = {
    "position": slice(0, 3),
    "velocity": slice(3, 6),
    "attitude": slice(6, 9),
    "omega": slice(9, 12),
}
"""Where each quantity stands in a difference (12,)."""

_EPS = float(np.finfo(np.float64).eps)
_EPS_SINGLE = float(np.finfo(np.float32).eps)
_ROUND_OFF = 4.0  # multiples of eps: of the worst operation of a step, and of a reading
_FAR_OFF = 1e3  # a difference that is not finite
_SWEEPS = 20  # at most, of the fixed point that finds a state from quantities of two instants
_SETTLED = 1e-15  # relative change of that fixed point that is round-off


@dataclass(frozen=True, eq=False)
class Transitions:
    """Some transitions (s,) of a trajectory: from sample `indices` to the next one.

    grid: of all transitions. known: the quantities that the trajectory has. is_single: whether all of its
    numbers are float32.
    """

    scene: Scene
    trajectory: Trajectory
    grid: Grid
    scales: Scales
    indices: Indices
    known: frozenset[str]
    is_single: bool

    @classmethod
    def of(
        cls, scene: Scene, trajectory: Trajectory, grid: Grid, scales: Scales, known: frozenset[str]
    ) -> Transitions:
        """Return all transitions of a trajectory."""
        arrays = (trajectory.position_m, trajectory.velocity_m_s, trajectory.omega_body_rad_s,
                trajectory.omega_world_rad_s, trajectory.quaternion, trajectory.rotation)  # fmt: skip
        with np.errstate(over="ignore"):
            single = all(
                np.array_equal(v, v.astype(np.float32)) for v in (h[1:] for h in arrays if h is not None)
            )
        exact = all(np.array_equal(h, np.round(h, 3)) for h in (h[1:] for h in arrays if h is not None))
        indices = np.arange(len(trajectory.t_s) - 1)
        return cls(scene, trajectory, grid, scales, indices, known, single and not exact)

    def subset(self, max_count: int) -> Transitions:
        """Return at most so many of the transitions, evenly spread, the first and the load switches kept."""
        if len(self.indices) <= max_count:
            return self
        rows = self.grid.timeline[self.indices]
        mixed = np.flatnonzero(
            np.any(rows != rows[:, :1], axis=1) | np.r_[True, rows[1:, 0] != rows[:-1, -1]]
        )
        spread = np.linspace(0, len(self.indices) - 1, max_count).round().astype(np.intp)
        chosen = np.unique(np.concatenate([spread, mixed[: max_count // 2]]))
        return replace(self, indices=self.indices[chosen])

    @cached_property
    def world_omega(self) -> bool:
        """Whether the trajectory holds omega in world axes."""
        return self.trajectory.omega_body_rad_s is None

    @cached_property
    def _read(self) -> tuple[Reading, Reading]:
        """The readings (3, s) at the start and at the end of each transition."""
        path = self.trajectory
        omega = path.omega_world_rad_s if self.world_omega else path.omega_body_rad_s
        assert omega is not None
        q = path.attitude / np.linalg.norm(path.attitude, axis=-1, keepdims=True)
        start, end = (
            Reading(path.position_m[at].T, path.velocity_m_s[at].T, q[at].T, omega[at].T)
            for at in (self.indices, self.indices + 1)
        )
        return start, end

    @cached_property
    def noise(self) -> Array:
        """(12,) round-off of a difference, over the scale of its quantity; infinite for a missing one."""
        path, scales = self.trajectory, self.scales
        eps = _EPS_SINGLE if self.is_single else _EPS
        moved = max(float(np.max(np.abs(path.velocity_m_s))), 1e-300) * float(np.max(np.diff(path.t_s)))
        sizes = {
            "position": (np.max(np.abs(path.position_m)) + moved) / (scales.length_scale_m or 1.0),
            "velocity": np.max(np.abs(path.velocity_m_s)) / (scales.speed_scale_m_s or 1.0),
            "attitude": 1.0 + scales.omega_scale_rad_s * float(np.max(np.diff(path.t_s))),
            "omega": np.max(np.abs(path.omega_body)) / (scales.omega_scale_rad_s or 1.0),
        }
        noise = np.full(12, np.inf)
        for name, span in QUANTITIES.items():
            if name in self.known:
                noise[span] = _ROUND_OFF * eps * max(sizes[name], 1.0) * np.sqrt(self.grid.stride)
        return noise

    @cached_property
    def weights(self) -> Array:
        """(12,) what differences are multiplied by: less where round-off is larger."""
        return np.min(self.noise) / self.noise

    @property
    def round_off(self) -> float:
        """The root mean square of weighted differences that are round-off."""
        return float(np.min(self.noise))

    def flow(self, models: Sequence[Model], base: Base) -> Flow:
        """Return candidates about to advance these transitions."""
        scene = about_pivot(self.scene) if self.scene.pivot is not None else self.scene
        pivoted = replace(scene, pivot=self.scene.pivot)
        first_step = self.indices * self.grid.stride
        return Flow(
            models, base, pivoted, self.grid.dt_s[self.indices], first_step, self.trajectory.t_s[self.indices]
        )

    def predicted(self, models: Sequence[Model], base: Base) -> Reading:
        """Return the readings (.., c, s) at the end of each transition."""
        flow = self.flow(models, base)
        stride = self.grid.stride
        y = flow.advance(self._starts(models, base), stride - 1)
        now = self._reading_of(flow.advance(y, 1, stride - 1))
        stale = _rows(models, lambda model: bool(model.stale))
        if len(stale):
            subset = [models[row] for row in stale]
            part = 1.0 - np.array([model.lateness for model in subset])[:, None]
            dt = part * self.grid.dt_s[self.indices]
            before = self._reading_of(self.flow(subset, base).step(y.of(stale), stride - 1, dt))
            for name in "xvqw":
                rows = np.array([name in model.stale for model in subset])
                getattr(now, name)[:, stale[rows]] = getattr(before, name)[:, rows]
        for row in _rows(models, lambda model: bool(model.misreadings)):
            one = Reading(*(value[:, row] for value in (now.x, now.v, now.q, now.w)))
            for misreading in models[row].misreadings:
                one = misreading.apply(one)
            for name in "xvqw":
                getattr(now, name)[:, row] = getattr(one, name)
        return now

    def differences(self, models: Sequence[Model], base: Base) -> Array:
        """(c, 12, s) weighted differences of the trajectory from the predictions, over their scales."""
        with np.errstate(all="ignore"):
            found = self._difference(self.predicted(models, base))
        found = np.where(np.isfinite(found), found, _FAR_OFF)
        return np.clip(found, -_FAR_OFF, _FAR_OFF) * self.weights[:, None]

    def _difference(self, reading: Reading) -> Array:
        end, scales = self._read[1], self.scales
        parts = [
            (end.x[:, None] - reading.x) / (scales.length_scale_m or 1.0),
            (end.v[:, None] - reading.v) / (scales.speed_scale_m_s or 1.0),
            rotation_vector(
                product(conjugated(reading.q / np.sqrt((reading.q**2).sum(axis=0))), end.q[:, None])
            ),
            (end.w[:, None] - reading.w) / (scales.omega_scale_rad_s or 1.0),
        ]
        return np.ascontiguousarray(np.moveaxis(np.concatenate(parts), 1, 0))

    def _reading_of(self, y: States) -> Reading:
        """Return the right reading of states (3, s)."""
        w = times(matrix_of(y.q), y.w) if self.world_omega else y.w
        pivot = self.scene.pivot
        if pivot is None:
            return Reading(y.x, y.v, y.q, w)
        rotation = matrix_of(y.q)
        arm = times(rotation, np.broadcast_to(-pivot[:, None, None], y.w.shape))
        spin = times(rotation, y.w)
        velocity = cross(spin, arm)
        return Reading(self._pivot_position[:, None, None] + arm, velocity, y.q, w)

    @cached_property
    def _pivot_position(self) -> Array:
        """Where the pivot is (3,)."""
        initial = self.scene.initial
        assert self.scene.pivot is not None
        return np.asarray(initial.position + initial.rotation @ self.scene.pivot)

    def _starts(self, models: Sequence[Model], base: Base) -> States:
        """Return the states (.., c, s) at the start of each transition, as each candidate reads them."""
        plain = self._state_of(self._read[0], ())
        parts = (plain.x, plain.v, plain.q, plain.w)
        y = States(*(np.repeat(value[:, None], len(models), axis=1) for value in parts))
        for row in _rows(models, lambda model: bool(model.misreadings)):
            state = self._state_of(self._read[0], models[row].misreadings)
            y.x[:, row], y.v[:, row], y.q[:, row], y.w[:, row] = state.x, state.v, state.q, state.w
        stale = _rows(models, lambda model: bool(model.stale))
        if len(stale):
            now = self._now([models[row] for row in stale], base, y.of(stale))
            y.x[:, stale], y.v[:, stale], y.q[:, stale], y.w[:, stale] = now.x, now.v, now.q, now.w
        if self.indices[0] == 0 and self.trajectory.t_s[0] == 0.0:
            self._start_values(models, y)
        return y

    def _start_values(self, models: Sequence[Model], y: States) -> None:
        """Start the first transition from the state of the scene, which no candidate has read."""
        initial = self.scene.initial
        for row, model in enumerate(models):
            attitude = initial.quaternion / np.linalg.norm(initial.quaternion)
            attitude = attitude if model.start is None else model.start(attitude)
            y.q[:, row, 0], y.w[:, row, 0] = attitude, initial.omega_body
            if self.scene.pivot is None:
                y.x[:, row, 0], y.v[:, row, 0] = initial.position, initial.velocity

    def _state_of(self, reading: Reading, misreadings: Sequence[Misreading]) -> States:
        for misreading in reversed(misreadings):
            reading = misreading.undo(reading)
        w = transposed_times(matrix_of(reading.q), reading.w) if self.world_omega else reading.w
        if self.scene.pivot is not None:
            place = np.broadcast_to(self._pivot_position[:, None], reading.x.shape)
            return States(place, 0.0 * reading.v, reading.q, w)
        return States(reading.x, reading.v, reading.q, w)

    def _now(self, models: Sequence[Model], base: Base, read: States) -> States:
        """Return the present states of candidates some of whose quantities are read late."""
        flow = self.flow(models, base)
        dt = np.array([model.lateness for model in models])[:, None] * self.grid.dt_s[self.indices]
        before = States(read.x.copy(), read.v.copy(), read.q.copy(), read.w.copy())
        present = {name: _rows(models, partial(_reads_now, name)) for name in "xvqw"}
        now = read
        for _ in range(_SWEEPS):
            now = flow.step(before, -1, dt)
            largest = 0.0
            for name in "xvw":
                rows, value = present[name], getattr(before, name)
                change = (getattr(read, name) - getattr(now, name))[:, rows]
                value[:, rows] += change
                largest = max(largest, _relative(change, value[:, rows]))
            rows = present["q"]
            gap = product(conjugated(now.q[:, rows]), read.q[:, rows])
            turned = product(before.q[:, rows], gap)
            before.q[:, rows] = turned / np.sqrt((turned**2).sum(axis=0))
            if max(largest, _relative(gap[1:], gap)) <= _SETTLED:
                break
        return now


def _relative(change: Array, value: Array) -> float:
    """Return the largest change over the largest value; 0 without a change, infinite if all values are 0."""
    largest, size = (float(np.max(np.abs(part), initial=0.0)) for part in (change, value))
    return 0.0 if largest == 0.0 else largest / size if size else math.inf


def _reads_now(name: str, model: Model) -> bool:
    return name not in model.stale


def _rows(models: Sequence[Model], which: Callable[[Model], bool]) -> Indices:
    """Return the places of the candidates that fulfil a condition."""
    return np.array([row for row, model in enumerate(models) if which(model)], dtype=np.intp)
