"""The transitions of a trajectory from sample to sample, and what candidates make of them.

Each transition starts from the state that the trajectory has there: errors of earlier ones do not add up, and
the difference at its end is nearly linear in a fault (multiple shooting: Bock 1981, Springer Series in
Chemical Physics 18, 102).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import EXACT, Base, Flow, States
from bodycheck.examine.diagnosis.engine_model import (
    Grid,
    Indices,
    Misreading,
    Model,
    ReportedStates,
    conjugated,
    cross,
    matrix_of,
    product,
    rotation_vector,
    times,
    transposed_times,
)
from bodycheck.examine.diagnosis.quantity_resolution import NOT_RECORDED, Resolution
from bodycheck.examine.diagnosis.whitening import Whitening
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.pivot import about_pivot
from bodycheck.reference_impl.rotations import exp_quaternion
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
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
ROUND_OFF = 4.0  # multiples of eps: of the worst operation of a step, and of a reading
_FEWEST_OF_LOG = 60  # transitions between which the differences of a whole log are interpolated
_FAR_OFF = 1e3  # a difference that is not finite
_SWEEPS = 20  # at most, of the fixed point that finds a state from quantities of two instants
_SETTLED = 1e-15  # relative change of that fixed point that is round-off
AT_ROUND_OFF = 30.0  # multiples of the round-off that count as it
_LEAST = 0.12  # of the round-off, which is that of the worst operation
WITHIN = 1.8  # root mean square of whitened differences: rounding leaves at most sqrt(3)
_NOISE_WITHIN, _NOISE_SPREAD = 1.05, 4.0  # the same of noise of known deviation, and deviations of it
_EQUAL = 1e-3  # of the spacing of numbers: a smaller difference of increments is none
_MOST_SHARED = 2_000_000  # numbers of whitened differences of shared errors, those of the longest runs first
_FEWEST_EQUAL = 2  # equal increments after the first one, from which on errors are shared
SHIFT = 1e-5
"""The shift of a state, over the scale of its quantity, for the derivatives of a map."""


@dataclass(frozen=True, eq=False)
class Transitions:
    """Some transitions (s,) of a trajectory: from sample `indices` to the next one.

    grid: of all transitions. known: the quantities that the trajectory has. is_single: whether all of its
    numbers are float32. resolution: of a recording. from_rows: whether the first transition starts from the
    first row instead of the start of the scene. whitening: of all transitions of the whole log, where the
    resolution is coarser than round-off. whole: these transitions, of which `indices` are some.
    """

    scene: Scene
    trajectory: Trajectory
    grid: Grid
    scales: Scales
    indices: Indices
    known: frozenset[str]
    is_single: bool
    resolution: Resolution = NOT_RECORDED
    from_rows: bool = False
    whitening: Whitening | None = None
    whole: Transitions | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        trajectory: Trajectory,
        grid: Grid,
        scales: Scales,
        known: frozenset[str],
        resolution: Resolution = NOT_RECORDED,
        *,
        from_rows: bool = False,
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
        single = single and not exact
        return cls(scene, trajectory, grid, scales, indices, known, single, resolution, from_rows)

    @property
    def is_coarse(self) -> bool:
        """Whether the resolution of a known quantity is coarser than round-off."""
        return bool(np.any(self.spread[self.rows] > self.rounding[self.rows]))

    def whitened_by(self, base: Base, model: Model | None = None) -> Transitions:
        """Return the transitions with their differences whitened over the whole log.

        base, model: the map whose derivatives are used, by default without faults.
        """
        whole = self if self.whole is None else self.whole
        least = whole.rounding[whole.rows] / ROUND_OFF
        spread = np.maximum(whole.spread[whole.rows], least)
        healthy = whole.grid.model(whole.scene)
        derivatives, missed = whole._derivatives(base, healthy if model is None else model, spread)
        # a program whose numbers are float32 may also compute in float32
        noise = spread if whole.is_single else np.hypot(least, missed)
        follows = np.r_[False, np.diff(whole.indices) == 1]
        whitening = Whitening.of(derivatives, spread, noise, follows)
        return replace(self, whitening=whitening, whole=None if self.whole is None else whole)

    def _derivatives(self, base: Base, model: Model, spread: Array) -> tuple[Array, Array]:
        """Return the derivatives of a map (s, n, n), and what they miss of it (n,), in root mean square.

        Of the known quantities after each transition with respect to those before it. They miss the terms of
        second order in the errors of a state, of deviation `spread` (n,): those of a coarse omega are larger
        than the round-off of a fine attitude.
        """
        count = len(self.rows)
        errors = spread[:, None] * np.random.default_rng(0).choice([-1.0, 1.0], (count, len(self.indices)))
        shifts = [*(SHIFT * np.eye(count)[:, :, None]), errors]
        models = [model.copied() for _ in range(1 + len(shifts))]
        for shift, shifted in zip(shifts, models[1:], strict=True):
            by = np.zeros((12, shift.shape[1]))
            by[self.rows] = shift * self.sizes[self.rows, None]
            shifted.misreadings = (*shifted.misreadings, Misreading(_as_read, partial(_shifted, by=by)))
        found = replace(self, from_rows=True).gaps(models, base)[:, self.rows]
        *changes, by_errors = found[:1] - found[1:]
        derivatives = np.ascontiguousarray(np.moveaxis(np.array(changes) / SHIFT, (2, 1, 0), (0, 1, 2)))
        missed = by_errors - np.einsum("sij,js->is", derivatives, errors)
        return derivatives, np.sqrt(np.mean(missed**2, axis=1))

    def subset(self, max_count: int) -> Transitions:
        """Return at most so many of the transitions, evenly spread, the first and the load switches kept.

        Of a whole log, its differences are interpolated between them.
        """
        if self.whitening is not None:
            max_count = max(max_count, _FEWEST_OF_LOG)
        if len(self.indices) <= max_count:
            return self
        rows = self.grid.timeline[self.indices]
        mixed = np.flatnonzero(
            np.any(rows != rows[:, :1], axis=1) | np.r_[True, rows[1:, 0] != rows[:-1, -1]]
        )
        mixed = np.union1d(mixed, np.maximum(mixed - 1, 0))  # a load may also act a step early
        spread = np.linspace(0, len(self.indices) - 1, max_count).round().astype(np.intp)
        chosen = np.unique(np.concatenate([spread, mixed[:max_count]]))
        whole = None if self.whitening is None else self
        if whole is not None:
            # what happens in one transition only must not be interpolated into others
            alone = np.r_[0, mixed[: max_count // 4]]
            beside = np.concatenate([alone - 1, alone, alone + 1, [2]])
            chosen = np.union1d(chosen, np.clip(beside, 0, len(self.indices) - 1))
        return replace(self, indices=self.indices[chosen], whole=whole)

    def alone(self) -> Transitions:
        """Return the transitions each by itself, without the whole log."""
        return replace(self, whitening=None, whole=None)

    def of_quantities(self, known: frozenset[str]) -> Transitions:
        """Return the transitions of some quantities alone."""
        found = replace(self, known=known, whitening=None, whole=None)
        return found.whitened_by(EXACT) if found.is_coarse else found

    def part(self, rows: slice) -> Transitions:
        """Return consecutive transitions of a log."""
        return replace(self, indices=self.indices[rows], whitening=None, whole=None)

    @cached_property
    def rows(self) -> Indices:
        """Where the known quantities stand in a difference."""
        spans = [QUANTITIES[name] for name in QUANTITIES if name in self.known]
        return np.concatenate([np.arange(12)[span] for span in spans])

    @cached_property
    def world_omega(self) -> bool:
        """Whether the trajectory holds omega in world axes."""
        return self.trajectory.omega_body_rad_s is None

    @cached_property
    def _read(self) -> tuple[ReportedStates, ReportedStates]:
        """The readings (3, s) at the start and at the end of each transition."""
        path = self.trajectory
        omega = path.omega_world_rad_s if self.world_omega else path.omega_body_rad_s
        assert omega is not None
        q = path.attitude / np.linalg.norm(path.attitude, axis=-1, keepdims=True)
        start, end = (
            ReportedStates(path.position_m[at].T, path.velocity_m_s[at].T, q[at].T, omega[at].T)
            for at in (self.indices, self.indices + 1)
        )
        return start, end

    @cached_property
    def sizes(self) -> Array:
        """(12,) scales of the quantities; 1 where nothing moves."""
        scales = self.scales
        of = {"position": scales.length_scale_m, "velocity": scales.speed_scale_m_s, "attitude": 1.0}
        of["omega"] = scales.omega_scale_rad_s
        return np.repeat([of[name] or 1.0 for name in QUANTITIES], 3)

    @cached_property
    def spread(self) -> Array:
        """(12,) standard deviations of recorded states that the resolution leaves, over the scales."""
        path, stated = self.trajectory, self.resolution
        rates = {"position": path.velocity_m_s, "attitude": path.omega_body}
        found = []
        for name in QUANTITIES:
            moved = largest_norm(rates[name]) * stated.stamp if name in rates else 0.0
            found.append(math.hypot(getattr(stated, name), moved) / math.sqrt(12.0))
        return np.repeat(found, 3) / self.sizes

    @cached_property
    def noise(self) -> Array:
        """(12,) round-off of a difference, and what the resolution leaves of it, over the scale."""
        return np.maximum(self.rounding, 2.0 * self.spread)

    @cached_property
    def rounding(self) -> Array:
        """(12,) round-off of a difference, over the scale of its quantity; infinite for a missing one."""
        path, scales = self.trajectory, self.scales
        eps = _EPS_SINGLE if self.is_single and not self.resolution.is_stated else _EPS
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
                noise[span] = ROUND_OFF * eps * max(sizes[name], 1.0) * np.sqrt(self.grid.stride)
        return noise

    @cached_property
    def weights(self) -> Array:
        """(12,) what differences are multiplied by: less where round-off is larger."""
        return np.min(self.noise) / self.noise

    @cached_property
    def shared_errors(self) -> Array:
        """(r, 12, s) the whitened differences that rounding errors leave which consecutive rows share.

        Numbers that increase by equal amounts, such as a constant velocity, are all rounded by the same.
        """
        if self.whitening is None:
            return np.zeros((0, 12, len(self.indices)))
        indices = (self if self.whole is None else self.whole).indices
        path = self.trajectory
        omega = path.omega_world_rad_s if self.world_omega else path.omega_body_rad_s
        held = path.rotation if path.quaternion is None else path.quaternion
        assert omega is not None
        assert held is not None
        columns = {"position": path.position_m, "velocity": path.velocity_m_s, "omega": omega}
        errors = [
            (QUANTITIES[name].start + axis, rows)
            for name, values in columns.items()
            if name in self.known
            for axis, numbers in enumerate(values.T)
            for rows in _equally_spaced(numbers[:, None], getattr(self.resolution, name))
        ]
        if "attitude" in self.known:
            runs = list(_equally_spaced(held.reshape(len(held), -1), self.resolution.attitude))
            errors += [(row, rows) for rows in runs for row in range(12)[QUANTITIES["attitude"]]]
        errors = sorted(errors, key=lambda one: one[1].start - one[1].stop)
        errors = errors[: _MOST_SHARED // (12 * len(indices))]
        defects = np.zeros((len(errors), len(self.rows), len(indices)))
        for defect, (row, rows) in zip(defects, errors, strict=True):
            place = int(np.searchsorted(self.rows, row))
            off = np.zeros(len(path.t_s))
            off[rows] = self.spread[row]
            off[0] *= self.from_rows  # else the first transition starts from the exact state
            defect[place] = off[indices + 1]
            defect -= self.whitening.derivatives[:, :, place].T * off[indices]
        found = np.zeros((len(errors), 12, len(indices)))
        found[:, self.rows] = self.whitening.whitened(defects)
        return found

    @property
    def round_off(self) -> float:
        """The root mean square of differences that are round-off, or as large as the resolution leaves."""
        return float(np.min(self.noise)) if self.whitening is None else 1.0

    @property
    def least(self) -> float:
        """The smallest standard deviation that weighted differences can have."""
        return 1.0 if self.whitening is not None else _LEAST * self.round_off

    @property
    def limit(self) -> float:
        """The largest root mean square of differences of a candidate that could have made the trajectory."""
        if self.whitening is None:
            return AT_ROUND_OFF * self.round_off
        if not self.resolution.noise:
            return WITHIN
        whole = self if self.whole is None else self.whole
        return _NOISE_WITHIN + _NOISE_SPREAD / math.sqrt(2.0 * len(self.rows) * len(whole.indices))

    def flow(self, models: Sequence[Model], base: Base) -> Flow:
        """Return candidates about to advance these transitions."""
        scene = about_pivot(self.scene) if self.scene.pivot is not None else self.scene
        pivoted = replace(scene, pivot=self.scene.pivot)
        first_step = self.indices * self.grid.stride
        return Flow(
            models, base, pivoted, self.grid.dt_s[self.indices], first_step, self.trajectory.t_s[self.indices]
        )

    def predicted(self, models: Sequence[Model], base: Base) -> ReportedStates:
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
            one = ReportedStates(*(value[:, row] for value in (now.x, now.v, now.q, now.w)))
            for misreading in models[row].misreadings:
                one = misreading.apply(one)
            for name in "xvqw":
                getattr(now, name)[:, row] = getattr(one, name)
        return now

    def differences(self, models: Sequence[Model], base: Base) -> Array:
        """(c, 12, s) weighted differences of the trajectory from the predictions, over their scales."""
        gaps = self.gaps(models, base)
        if self.whitening is not None and self.whole is not None:
            healthy = self.whole.healthy_gaps(base)
            gaps = healthy + (gaps - healthy[:, :, self._places]) @ self._interpolation
        return self.weighted(gaps)

    def weighted(self, gaps: Array) -> Array:
        """Return differences (c, 12, s) over their scales, weighted, or whitened over the whole log."""
        if self.whitening is None:
            return gaps * self.weights[:, None]
        found = np.zeros_like(gaps)
        found[:, self.rows] = self.whitening.whitened(gaps[:, self.rows])
        return found

    def after(self, maps: Sequence[Base]) -> list[States]:
        """Return the states (.., 1, s) at the end of each transition that maps of the library make."""
        healthy = [self.grid.model(self.scene)]
        start, flow = self._starts(healthy, maps[0]), self.flow(healthy, maps[0])
        with np.errstate(all="ignore"):
            return [flow.of_map(base).advance(start, self.grid.stride) for base in maps]

    def gaps_after(self, states: Sequence[States]) -> Array:
        """(c, 12, s) differences of the trajectory from states (.., 1, s), over their scales."""
        parts = [self._reading_of(y) for y in states]
        x, v, q, w = (np.concatenate([getattr(one, name) for one in parts], axis=1) for name in "xvqw")
        return self.gaps_of(ReportedStates(x, v, q, w))

    def gaps(self, models: Sequence[Model], base: Base) -> Array:
        """(c, 12, s) differences of the trajectory from the predictions, over their scales."""
        with np.errstate(all="ignore"):
            return self.gaps_of(self.predicted(models, base))

    def gaps_of(self, predicted: ReportedStates) -> Array:
        """(c, 12, s) differences of the trajectory from readings (.., c, s), over their scales."""
        with np.errstate(all="ignore"):
            found = self._difference(predicted)
        return np.clip(np.where(np.isfinite(found), found, _FAR_OFF), -_FAR_OFF, _FAR_OFF)

    def cost_of(self, differences: Array) -> float:
        """Return the root mean square of weighted differences (.., 12, n) of known quantities."""
        known = np.count_nonzero(self.weights)
        return math.sqrt(float(np.sum(differences**2)) / (known * differences.shape[-1]))

    def healthy_gaps(self, base: Base) -> Array:
        """(1, 12, s) differences from a map without faults."""
        if base.name not in self._healthy_gaps:
            self._healthy_gaps[base.name] = self.gaps([self.grid.model(self.scene)], base)
        return self._healthy_gaps[base.name]

    @cached_property
    def _healthy_gaps(self) -> dict[str, Array]:
        return {}

    @cached_property
    def _places(self) -> Indices:
        """Where these transitions stand in the whole log."""
        assert self.whole is not None
        return np.searchsorted(self.whole.indices, self.indices)

    @cached_property
    def _interpolation(self) -> Array:
        """(s, n): the linear interpolation from these transitions to those of the whole log."""
        assert self.whole is not None
        places, unit = self._places, np.eye(len(self.indices))
        every = np.arange(len(self.whole.indices))
        return np.stack([np.interp(every, places, row) for row in unit])

    def _difference(self, reading: ReportedStates) -> Array:
        end, sizes = self._read[1], self.sizes[::3]
        turned = product(conjugated(reading.q / np.sqrt((reading.q**2).sum(axis=0))), end.q[:, None])
        parts = [
            (end.x[:, None] - reading.x) / sizes[0],
            (end.v[:, None] - reading.v) / sizes[1],
            rotation_vector(turned),
            (end.w[:, None] - reading.w) / sizes[3],
        ]
        return np.ascontiguousarray(np.moveaxis(np.concatenate(parts), 1, 0))

    def _reading_of(self, y: States) -> ReportedStates:
        """Return the right reading of states (3, s)."""
        w = times(matrix_of(y.q), y.w) if self.world_omega else y.w
        pivot = self.scene.pivot
        if pivot is None:
            return ReportedStates(y.x, y.v, y.q, w)
        rotation = matrix_of(y.q)
        arm = times(rotation, np.broadcast_to(-pivot[:, None, None], y.w.shape))
        spin = times(rotation, y.w)
        velocity = cross(spin, arm)
        return ReportedStates(self._pivot_position[:, None, None] + arm, velocity, y.q, w)

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
        if self.indices[0] == 0 and self.trajectory.t_s[0] == 0.0 and not self.from_rows:
            self._start_values(models, y)
        if self.trajectory.quaternion is None and base.one is not None:
            # the matrix that was read, turned as far as a candidate reads another attitude
            assert self.trajectory.rotation is not None
            held = np.moveaxis(self.trajectory.rotation[self.indices], 0, -1)[:, :, None]
            turned = np.einsum("ji...,jk...->ik...", matrix_of(self._read[0].q)[:, :, None], matrix_of(y.q))
            y.held = np.einsum("ij...,jk...->ik...", held, turned)
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

    def _state_of(self, reading: ReportedStates, misreadings: Sequence[Misreading]) -> States:
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
        dt = np.broadcast_to(self.grid.dt_s[self.indices], (len(models), len(self.indices)))
        part = 1.0 - np.array([model.lateness for model in models])[:, None]
        before = States(read.x.copy(), read.v.copy(), read.q.copy(), read.w.copy())
        stale = {name: np.array([name in model.stale for model in models])[:, None] for name in "xvqw"}
        now = read
        for _ in range(_SWEEPS):
            now, late = flow.step(before, -1, dt), flow.step(before, -1, part * dt)
            made = {name: np.where(stale[name], getattr(late, name), getattr(now, name)) for name in "xvqw"}
            largest = 0.0
            for name in "xvw":
                value, change = getattr(before, name), getattr(read, name) - made[name]
                value += change
                largest = max(largest, _relative(change, value))
            gap = product(conjugated(made["q"]), read.q)
            turned = product(before.q, gap)
            before.q[:] = turned / np.sqrt((turned**2).sum(axis=0))
            if max(largest, _relative(gap[1:], gap)) <= _SETTLED:
                break
        return now


def _as_read(reading: ReportedStates) -> ReportedStates:
    return reading


def _shifted(reading: ReportedStates, by: Array) -> ReportedStates:
    """Return the reading with its twelve components shifted; by: (12, s) or (12, 1)."""
    x, v, turn, w = by.reshape(4, 3, -1)
    q = product(reading.q, exp_quaternion(turn.T).T)
    return ReportedStates(reading.x + x, reading.v + v, q, reading.w + w)


def _relative(change: Array, value: Array) -> float:
    """Return the largest change over the largest value; 0 without a change, infinite if all values are 0."""
    largest, size = (float(np.max(np.abs(part), initial=0.0)) for part in (change, value))
    return 0.0 if largest == 0.0 else largest / size if size else math.inf


def _equally_spaced(numbers: Array, spacing: float) -> Iterator[slice]:
    """Yield the rows of numbers (n, k) that increase by equal amounts, at least four together."""
    change = np.diff(numbers, n=2, axis=0)
    equal = np.r_[False, np.all(np.abs(change) <= _EQUAL * spacing, axis=1), False]
    ends = np.flatnonzero(equal[1:] != equal[:-1])
    for first, last in zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True):
        if last - first >= _FEWEST_EQUAL:
            yield slice(first, last + 2)


def _rows(models: Sequence[Model], which: Callable[[Model], bool]) -> Indices:
    """Return the places of the candidates that fulfil a condition."""
    return np.array([row for row, model in enumerate(models) if which(model)], dtype=np.intp)
