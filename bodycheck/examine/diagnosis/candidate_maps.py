"""The one-step maps, for all candidates and all transitions at once, in numpy.

Every map of the library can carry faults. They act through its body and its loads, and on its result; in the
maps that most engines make, they act inside the step.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from bodycheck.examine.diagnosis.engine_model import (
    ClampAxes,
    Indices,
    Model,
    conjugated,
    cross,
    exponential,
    matrix_of,
    product,
    rotation_vector,
    times,
    transposed_times,
)
from bodycheck.reference_impl.arrays import Array, inverted
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.facts import Tableau
from bodycheck.reference_impl.loads.load import Instants
from bodycheck.reference_impl.one_step_maps import EXACT as EXACT_FLOW
from bodycheck.reference_impl.one_step_maps import MAPS, OneStepMap
from bodycheck.reference_impl.one_step_maps.one_step_map import Motion, Solid, zero_order_hold
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.run_files.method_words import map_in_words


@dataclass
class States:
    """x, v in world axes, w in body axes: (3, c, s); q: (4, c, s).

    held: (3, 3, c, s) the matrix of an engine that holds one, which need not be orthogonal.
    """

    x: Array
    v: Array
    q: Array
    w: Array
    held: Array | None = None

    def of(self, candidates: Indices) -> States:
        """Return the states of some candidates."""
        held = None if self.held is None else self.held[:, :, candidates]
        x, v, q, w = (value[:, candidates] for value in (self.x, self.v, self.q, self.w))
        return States(x, v, q, w, held)


@dataclass(frozen=True)
class Base:
    """A healthy one-step map.

    kind: how omega advances. turn: how the attitude does. pose_first: whether the pose advances with the old
    velocities. tableau: instead of these three. one: a map of the library, instead of all of these.
    in_body_axes: whether its loads are held over the step in body axes, or in world axes; None: neither.
    """

    name: str
    text: str
    kind: str = "explicit"
    turn: str = "exponential"
    pose_first: bool = False
    tableau: Tableau | None = None
    order: int = 1
    one: OneStepMap | None = None
    in_body_axes: bool | None = None

    @property
    def is_rk4(self) -> bool:
        """Whether it has the tableau of the classical Runge-Kutta method, in any formulation."""
        own = self.tableau if self.one is None else getattr(self.one.step, "tableau", None)
        return own is not None and np.array_equal(own.b, RK4.b) and np.array_equal(own.a, RK4.a)


RK4 = cast(Tableau, INTEGRATORS["rk4"].tableau)


def _text(method: str, name: str) -> str:
    return f"{map_in_words(name)}, {INTEGRATORS[method].formula}"


def _runge_kutta(name: str) -> Base:
    method = INTEGRATORS[name]
    return Base(name, f"{name}, {method.formula}", tableau=method.tableau, order=method.order)


EXACT = Base("exact", "the exact flow", tableau=INTEGRATORS["dop853"].tableau, order=8)
"""Runge-Kutta of order 8 with steps so fine that their error is below round-off."""

COMMON = {
    base.name: base
    for base in (
        Base("m1", _text("m1", "M1")),
        Base("m2", _text("m2", "M2"), "implicit"),
        Base("m3", _text("m3", "M3"), "implicit gyroscopic"),
        Base("m1-additive", f"{map_in_words('M1')} with q+ = q + dt/2 q omega+", turn="additive"),
        Base(
            "quaternion-euler",
            _text("quaternion-euler", "M1, pose from the old omega"),
            turn="additive",
            pose_first=True,
        ),
        _runge_kutta("midpoint"),
        _runge_kutta("rk4"),
        EXACT,
    )
}
"""The maps that a diagnosis starts from, in which faults act inside the step."""

LIBRARY = {
    one.name: Base(one.name, f"{map_in_words(one.name)}, {one.description}", order=one.order, one=one)
    for one in MAPS.values()
    if one.order > 0 and one is not EXACT_FLOW
}
"""The maps of the library; without a gyroscopic term, they are faults."""

BASES = COMMON | LIBRARY
"""All maps in which faults are planted, by name."""


class Flow:
    """Candidates (c,) that advance transitions (s,) by steps of their own length.

    models: one per candidate. dt_s: (s,). first_step: (s,) number of steps before each transition.
    start_s: (s,).
    """

    def __init__(
        self,
        models: Sequence[Model],
        base: Base,
        scene: Scene,
        dt_s: Array,
        first_step: Indices,
        start_s: Array,
    ) -> None:
        self._models, self._base, self._scene = models, base, scene
        self._first_step, self._start_s = first_step, start_s
        self._dt_s = dt_s
        self._dt = dt_s * np.array([model.step_factor for model in models])[:, None]
        inertia = np.stack([model.turning_inertia for model in models], axis=-1)
        self._inertia = inertia[..., None]
        self._inverse: Array = np.moveaxis(inverted(np.moveaxis(inertia, -1, 0)), 0, -1)[..., None]
        packed = [np.stack(part, axis=-1) for part in zip(*(m.packed_loads() for m in models), strict=True)]
        self._packed = [np.moveaxis(part, 0, -1) for part in packed]  # (..., c, p)
        self._needs = [bool(np.any(part)) for part in self._packed]
        self._constant = all(np.all(part == part[..., :1]) for part in self._packed)
        self._timelines = np.stack([model.timeline for model in models])
        self._constant |= bool(np.all(self._timelines == self._timelines[0, 0]))
        self._cached: tuple[Indices, list[Array]] | None = None
        ramp = self._numbers("ramp")
        self._ramps = np.flatnonzero(ramp)
        gyro = self._numbers("gyro")
        self._gyro = gyro[:, None] if np.any(gyro != 1.0) else None
        turn_factor = self._numbers("turn_factor")
        self._turn_factor = turn_factor[:, None] if np.any(turn_factor != 1.0) else None
        self._is_moved = scene.pivot is None

    def _numbers(self, name: str) -> Array:
        return np.array([float(getattr(model, name)) for model in self._models])

    @cached_property
    def _solid(self) -> Solid:
        """The bodies of all candidates and transitions, in rows."""
        count = len(self._dt_s)
        inertia = np.moveaxis(self._inertia[..., 0], -1, 0)
        return Solid(np.repeat(self._numbers("mass"), count), np.repeat(inertia, count, axis=0))

    @cached_property
    def _features(self) -> dict[str, tuple[Indices, Array]]:
        """The candidates (k,) that have a number of a name, and the numbers (k, 1)."""
        found = {}
        for name in (one.name for one in fields(Model) if one.default == 0.0):
            values = self._numbers(name)
            rows = np.flatnonzero(values)
            if len(rows):
                found[name] = (rows, values[rows, None])
        return found

    @cached_property
    def _clamps(self) -> list[tuple[str, ClampAxes, Indices, Array, bool]]:
        """The limits of v and w: which, in which axes, candidates (k,), limits (k, 1), whether first."""
        groups: dict[tuple[str, ClampAxes, bool], list[tuple[int, float]]] = {}
        for row, model in enumerate(self._models):
            first = model.clamped_first and self._base.tableau is None and self._base.one is None
            for quantity, clamp in (("v", model.clamp_v), ("w", model.clamp_w)):
                if clamp is not None:
                    groups.setdefault((quantity, clamp[0], first), []).append((row, clamp[1]))
        found = []
        for (quantity, axes, first), rows in groups.items():
            candidates, limits = zip(*rows, strict=True)
            found.append((quantity, axes, np.array(candidates), np.array(limits)[:, None], first))
        return found

    def _loads(self, step: int) -> list[Array]:
        """Return the packed loads (..., c, s or 1) in a step of each transition."""
        if self._constant:
            rows = np.full((1, 1), self._timelines[0, 0])
        else:
            last = self._timelines.shape[1] - 1
            rows = self._timelines[:, np.clip(self._first_step + step, 0, last)]
        if self._cached is None or not np.array_equal(rows, self._cached[0]):
            model_rows = np.arange(len(self._models))[:, None]
            self._cached = rows, [part[..., model_rows, rows] for part in self._packed]
        parts = self._cached[1]
        if not len(self._ramps):
            return parts
        factor = np.ones((len(self._models), len(self._first_step)))
        factor[self._ramps] = 1.0 + self._first_step + step
        return [part * factor for part in parts]

    def wrench(self, y: States) -> tuple[Array, Array]:
        """Return force and torque about the centre of mass in world axes, (3, c, s), in each first step."""
        acceleration, torque, _ = self._forces(y, self._loads(0), self._start_s)
        return self._numbers("mass")[:, None] * acceleration, times(matrix_of(y.q), torque)

    def of_map(self, base: Base) -> Flow:
        """Return the same candidates, each without a fault, with another map."""
        _ = self._solid, self._features, self._again  # made once for all maps
        flow = copy.copy(self)
        flow._base = base
        return flow

    def advance(self, y: States, steps: int, first: int = 0) -> States:
        """Return the states after the steps, of which `first` were made before."""
        for step in range(first, first + steps):
            y = self.step(y, step, self._dt)
            if self._again is not None:
                rows, flow = self._again
                again = flow.step(y.of(rows), step, flow._dt)
                for value, more in ((y.x, again.x), (y.v, again.v), (y.q, again.q), (y.w, again.w)):
                    value[:, rows] = more
        return y

    @cached_property
    def _again(self) -> tuple[Indices, Flow] | None:
        """The candidates that make each step twice."""
        rows = np.flatnonzero(self._numbers("repeats"))
        if not len(rows):
            return None
        models = [replace(self._models[row], repeats=0.0) for row in rows.tolist()]
        return rows, Flow(models, self._base, self._scene, self._dt_s, self._first_step, self._start_s)

    def step(self, y: States, step: int, dt: Array) -> States:
        """Return the states after one step of length dt (c, s)."""
        loads = self._loads(step)
        t = self._start_s + step * self._dt
        if self._base.one is not None:
            new = self._of_library(self._base.one, y, loads, t, dt)
            for row, one, flow in self._apart:
                part = flow._of_library(one, y.of(row), flow._loads(step), t[row], dt[row])
                for value, own in ((new.x, part.x), (new.v, part.v), (new.q, part.q), (new.w, part.w)):
                    value[:, row] = own
                if new.held is not None:
                    new.held[:, :, row] = part.held
        else:
            advanced = self._runge_kutta if self._base.tableau else self._first_order
            new = advanced(y, loads, t, dt)
        if "old_velocity" in self._features:
            rows = self._features["old_velocity"][0]
            new.x[:, rows] = (y.x + dt * y.v)[:, rows]
        new.v, new.w = self._slowed(new, dt, late=True)
        return self._limited(y, new)

    @cached_property
    def _tableau(self) -> Tableau:
        """The tableau of all candidates, or with numbers (c, 1) where some have one of their own."""
        common = self._base.tableau
        assert common is not None
        if all(model.tableau is None for model in self._models):
            return common
        each = zip(*(model.tableau or common for model in self._models), strict=True)
        return Tableau(*(np.stack(part, axis=-1)[..., None] for part in each))

    @cached_property
    def _apart(self) -> list[tuple[Indices, OneStepMap, Flow]]:
        """The candidates with a tableau of their own, each with the map of the library that has it."""
        one, found = self._base.one, []
        for row, model in enumerate(self._models):
            if one is not None and (own := model.tableau) is not None:
                step: Any = one.step
                changed = replace(step, tableau=replace(step.tableau, a=own.a, b=own.b))
                models = [replace(model, tableau=None)]
                flow = Flow(models, self._base, self._scene, self._dt_s, self._first_step, self._start_s)
                found.append((np.array([row]), replace(one, step=changed), flow))
        return found

    def _slowed(self, y: States, dt: Array, *, late: bool) -> tuple[Array, Array]:
        """Return v and w of candidates that damp them after the kick, or late: after the step."""
        found = []
        for value, name in ((y.v, "slowed_v"), (y.w, "slowed_w")):
            if name in self._features:
                rows, rate = self._features[name]
                chosen = np.array([self._models[row].slowed_late == late for row in rows])
                value = value.copy()
                value[:, rows[chosen]] *= 1.0 - (rate * dt[rows])[chosen]
            found.append(value)
        return found[0], found[1]

    def _first_order(self, y: States, loads: list[Array], t: Array, dt: Array) -> States:
        acceleration, torque, gyroscopic = self._forces(y, loads, t)
        if self._base.kind == "explicit":
            change = times(self._inverse, torque - gyroscopic)
        else:
            inside = torque - gyroscopic if self._base.kind == "implicit" else -gyroscopic
            change = self._implicit(y.w, inside, dt)
            if self._base.kind == "implicit gyroscopic":
                change = change + times(self._inverse, torque)
        v, w = y.v + dt * acceleration, y.w + dt * (change + self._omega_extra(y))
        v, w = self._slowed(States(y.x, v, y.q, w), dt, late=False)
        self._clamp(States(y.x, v, y.q, w), first=True)
        moved, turned = (y.v, y.w) if self._base.pose_first else (v, w)
        return States(y.x + dt * moved, v, self._turned(y.q, turned, dt), w)

    def _implicit(self, w: Array, torque: Array, dt: Array) -> Array:
        """(I + dt D)^-1 torque, D = [omega]x I - [I omega]x."""
        spin = times(self._inertia, w)
        unit = np.eye(3)[..., None, None]
        columns = []
        for k in range(3):
            column = np.broadcast_to(self._inertia[:, k], w.shape)
            e = np.broadcast_to(unit[:, k], w.shape)
            turning = cross(w, column) - cross(spin, e)
            if self._gyro is not None:
                turning = self._gyro * turning
            columns.append(column + dt * turning)
        a, b, c = columns
        bc = cross(b, c)
        det = (a * bc).sum(axis=0)
        solved = [(torque * part).sum(axis=0) for part in (bc, cross(c, a), cross(a, b))]
        return np.stack(solved) / det

    def _of_library(self, one: OneStepMap, y: States, loads: list[Array], t: Array, dt: Array) -> States:
        """Return the states after a step of a map of the library."""
        shape = y.w.shape[1:]

        def in_rows(value: Array) -> Array:
            """Return (n, 3) or (n, 3, 3) of (3, c, s) or (3, 3, c, s), n = c s."""
            rows = value.reshape(*value.shape[:-2], -1)
            return rows.T if rows.ndim == 2 else rows.transpose(2, 0, 1)

        def apart(rows: Array) -> Array:
            """Undo in_rows."""
            parts = rows.T if rows.ndim == 2 else rows.transpose(1, 2, 0)
            return parts.reshape(*parts.shape[:-1], *shape)

        def acting(at: Array, x: Array, rotation: Array, v: Array, omega: Array) -> tuple[Array, Array]:
            turn = apart(rotation)
            now = States(apart(x), apart(v), y.q, transposed_times(turn, apart(omega)))
            acceleration, torque, gyroscopic = self._forces(now, loads, at.reshape(shape), turn, (y, t))
            if self._spins_wrongly:
                torque = torque - gyroscopic + cross(now.w, times(self._inertia, now.w))
                torque = torque + times(self._inertia, self._omega_extra(now))
            return self._solid.mass[:, None] * in_rows(acceleration), in_rows(torque)

        begin = Motion(
            np.broadcast_to(t, shape).reshape(-1),
            in_rows(y.x),
            in_rows(y.v),
            in_rows(y.q),
            in_rows(y.w),
            rotation=None if y.held is None else in_rows(y.held),
        )
        held = self._base.in_body_axes
        acts = acting if held is None else zero_order_hold(acting, begin, in_body_axes=held)
        end = one.step(self._solid, begin, np.broadcast_to(dt, shape).reshape(-1), acts)
        matrix = None if end.rotation is None else apart(end.rotation)
        new = States(
            apart(end.position), apart(end.velocity), apart(end.quaternion), apart(end.omega), matrix
        )
        if self._turn_factor is not None or self._features.keys() & {"largest_turn", "world_turn"}:
            unit = new.q / np.sqrt((new.q**2).sum(axis=0))
            new.q = self._rotated_by(y.q, rotation_vector(product(conjugated(y.q), unit)))
            new.held = None if matrix is None else matrix_of(new.q)
        return new

    @cached_property
    def _spins_wrongly(self) -> bool:
        """Whether omega' of a candidate has another gyroscopic term, or other terms besides."""
        return self._gyro is not None or bool(self._features.keys() & _OF_OMEGA_RATE)

    def _turned(self, q: Array, w: Array, dt: Array) -> Array:
        if self._base.turn != "additive":
            return self._rotated_by(q, dt * w)
        w = w if self._turn_factor is None else self._turn_factor * w
        return self._advanced(q, np.concatenate([np.ones_like(w[:1]), 0.5 * dt * w]))

    def _rotated_by(self, q: Array, share: Array) -> Array:
        """Return q rotated by vectors (3, c, s) in body axes, as each candidate does."""
        if self._turn_factor is not None:
            share = self._turn_factor * share
        if "largest_turn" in self._features:
            rows, limit = self._features["largest_turn"]
            angle = np.sqrt((share[:, rows] ** 2).sum(axis=0))
            share[:, rows] *= np.minimum(1.0, limit / np.maximum(angle, 1e-300))
        return self._advanced(q, exponential(share))

    def _advanced(self, q: Array, by: Array) -> Array:
        """q by, or by q of candidates that rotate the attitude in the wrong axes."""
        new = product(q, by)
        if "world_turn" in self._features:
            rows = self._features["world_turn"][0]
            new[:, rows] = product(by[:, rows], q[:, rows])
        return new

    def _runge_kutta(self, y: States, loads: list[Array], t: Array, dt: Array) -> States:
        tableau = self._tableau
        slopes: list[tuple[Array, Array, Array, Array]] = []

        def combined(weights: Array) -> States:
            parts = []
            for index, value in enumerate((y.x, y.v, y.q, y.w)):
                pairs = zip(weights, slopes, strict=False)
                terms = [weight * slope[index] for weight, slope in pairs if np.any(weight)]
                parts.append(value + dt * sum(terms[1:], terms[0]) if terms else value)
            return States(*parts)

        for stage in range(len(tableau.b)):
            at = combined(tableau.a[stage])
            acceleration, torque, gyroscopic = self._forces(
                at, loads, t + tableau.c[stage] * dt, begin=(y, t)
            )
            spun = times(self._inverse, torque - gyroscopic) + self._omega_extra(at)
            turning = self._stage_omega(at.w)
            if self._turn_factor is not None:
                turning = self._turn_factor * turning
            half = np.concatenate([np.zeros_like(at.w[:1]), 0.5 * turning])
            turned = product(at.q, half)
            if "world_turn" in self._features:
                rows = self._features["world_turn"][0]
                turned[:, rows] = product(half[:, rows], at.q[:, rows])
            slopes.append((at.v, acceleration, turned, spun))
        new = combined(tableau.b)
        if "attitude_step" in self._features:
            rows, codes = self._features["attitude_step"]
            for row, code in zip(rows.tolist(), codes[:, 0].astype(int).tolist(), strict=True):
                _, adds, old = ATTITUDE_STEPS[code - 1]
                angle = dt[row] * (old * y.w[:, row] + (1.0 - old) * new.w[:, row])
                turned = (
                    np.concatenate([np.ones_like(angle[:1]), 0.5 * angle]) if adds else exponential(angle)
                )
                new.q[:, row] = product(y.q[:, row], turned)
        if "largest_turn" in self._features:
            rows, limit = self._features["largest_turn"]
            share = (dt * y.w)[:, rows]
            angle = np.sqrt((share**2).sum(axis=0))
            turned = product(y.q[:, rows], exponential(share * (limit / np.maximum(angle, 1e-300))))
            new.q[:, rows] = np.where(angle > limit, turned, new.q[:, rows])
        return new

    def _stage_omega(self, w: Array) -> Array:
        if "single_stage" in self._features:
            rows = self._features["single_stage"][0]
            w = w.copy()
            w[:, rows] = w[:, rows].astype(np.float32)
        return w

    def _forces(
        self,
        y: States,
        loads: list[Array],
        t: Array,
        turn: Array | None = None,
        begin: tuple[States, Array] | None = None,
    ) -> tuple[Array, Array, Array]:
        """Return v' in world axes, and torque and gyroscopic term in body axes, (3, c, s).

        turn: R (3, 3, c, s), by default that of q. begin: states and times at the start of the step, at which
        some candidates evaluate their loads.
        """
        w = self._stage_omega(y.w)
        features = self._features
        force_body, force_world, torque_body, torque_world, moment, lever = loads
        gyroscopic = cross(w, times(self._inertia, w))
        if self._gyro is not None:
            gyroscopic = self._gyro * gyroscopic
        acceleration = np.broadcast_to(force_world, w.shape)
        torque = np.broadcast_to(torque_body, w.shape)
        continuous = self._scene.continuous_loads
        if turn is not None:
            rotation = turn
        elif self._needs[0] or any(self._needs[3:]) or continuous or features.keys() & _OF_ATTITUDE:
            rotation = matrix_of(y.q)
        if "held_loads" in features and begin is not None:
            y, rotation, t = self._with_held_loads(y, rotation, t, begin)
        if "force_world_by" in features:
            acceleration = self._rotated("force_world_by", rotation, acceleration, lambda _, v: v)
        if "torque_body_by" in features:
            torque = self._rotated("torque_body_by", rotation, torque, lambda _, v: v)
        if self._needs[0]:
            acceleration = acceleration + self._rotated("force_body_by", rotation, force_body, times)
        if self._needs[3]:
            turned = self._rotated("torque_world_by", rotation, torque_world, transposed_times)
            torque = torque + turned
        if self._needs[4]:
            turned = np.einsum("ab...,bc...->ac...", moment, self._moment_rotation(rotation))
            torque = torque + _moment_of(turned)
        if self._needs[5]:
            torque = torque + _moment_of(np.einsum("ba...,bc...->ac...", rotation, lever))
        if continuous:
            force, turning = self._continuous_loads(y, rotation, t)
            acceleration, torque = acceleration + force, torque + transposed_times(rotation, turning)
        if "total_force_by" in features:
            acceleration = self._turned_sum("total_force_by", rotation, acceleration)
        if "total_torque_by" in features:
            torque = self._turned_sum("total_torque_by", rotation, torque)
        if "inertia_in_world" in features:
            rows = features["inertia_in_world"][0]
            torque = np.array(torque)
            gyroscopic[:, rows], torque[:, rows] = self._world_inertia(
                rows, w[:, rows], rotation[:, :, rows], torque[:, rows]
            )
        for name, power in (("damping_v", 0), ("damping_v_speed", 1)):
            if name in features:
                rows, rate = features[name]
                part = y.v[:, rows]
                speed = np.sqrt((part * part).sum(axis=0)) if power else 1.0
                acceleration = np.array(acceleration)
                acceleration[:, rows] -= rate * speed * part
        if "body_velocity" in features:
            rows, rate = features["body_velocity"]
            spin = times(rotation[:, :, rows], w[:, rows])
            acceleration = np.array(acceleration)
            acceleration[:, rows] += rate * cross(spin, y.v[:, rows])
        return acceleration, torque, gyroscopic

    def _with_held_loads(
        self, y: States, rotation: Array, t: Array, begin: tuple[States, Array]
    ) -> tuple[States, Array, Array]:
        """Return states, R and times, of some candidates those at the start of the step."""
        rows = self._features["held_loads"][0]
        start, start_s = begin
        y, rotation, t = copy.deepcopy(y), rotation.copy(), np.broadcast_to(t, y.w.shape[1:]).copy()
        for value, first in ((y.x, start.x), (y.v, start.v), (y.w, start.w)):
            value[:, rows] = first[:, rows]
        rotation[:, :, rows] = matrix_of(start.q[:, rows])
        t[rows] = np.broadcast_to(start_s, t.shape)[rows]
        return y, rotation, t

    def _rotated(
        self, name: str, rotation: Array, vector: Array, right: Callable[[Array, Array], Array]
    ) -> Array:
        """Return a load rotated as each candidate does; right: as it should be."""
        found = right(rotation, vector)
        if name in self._features:
            rows, code = self._features[name]
            found, part = np.array(found), np.broadcast_to(vector, found.shape)[:, rows]
            turn = rotation[:, :, rows]
            once, again = _WRONGLY[name]
            found[:, rows] = np.where(code == 1.0, once(turn, part), again(turn, again(turn, part)))
        return found

    def _turned_sum(self, name: str, rotation: Array, vector: Array) -> Array:
        """Return a sum of loads, rotated by R or by R^T for some candidates."""
        rows, code = self._features[name]
        found, turn = np.array(vector), rotation[:, :, rows]
        part = found[:, rows]
        found[:, rows] = np.where(code == 1.0, times(turn, part), transposed_times(turn, part))
        return found

    def _moment_rotation(self, rotation: Array) -> Array:
        """Return R, transposed for candidates that take moments of forces in world axes with R F."""
        if "moment_by" in self._features:
            rows = self._features["moment_by"][0]
            rotation = rotation.copy()
            rotation[:, :, rows] = np.swapaxes(rotation[:, :, rows], 0, 1)
        return rotation

    def _world_inertia(self, rows: Indices, w: Array, rotation: Array, torque: Array) -> tuple[Array, Array]:
        """Return gyroscopic term and torque with I and I^-1 in place of R^T I R and its inverse."""
        inertia = np.broadcast_to(self._inertia[:, :, rows], (3, 3, *w.shape[1:]))
        inverse = self._inverse[:, :, rows]
        spin = times(rotation, w)
        turning = cross(spin, times(inertia, spin))

        def in_body(vector: Array) -> Array:
            """I R^T I^-1 vector: what gives the right omega' when it is multiplied by I^-1."""
            return times(inertia, transposed_times(rotation, times(inverse, vector)))

        return in_body(turning), in_body(times(rotation, torque))

    def _omega_extra(self, y: States) -> Array:
        """Return what is added to omega' besides I^-1 of torques: damping, and the pull of the energy."""
        features = self._features
        w = self._stage_omega(y.w)
        extra = np.zeros_like(w)
        for name, power in (("damping_w", 0), ("damping_w_speed", 1)):
            if name in features:
                rows, rate = features[name]
                part = w[:, rows]
                speed = np.sqrt((part * part).sum(axis=0)) if power else 1.0
                extra[:, rows] -= rate * speed * part
        if "damping_torque" in features:
            rows, rate = features["damping_torque"]
            extra[:, rows] -= rate * times(self._inverse[:, :, rows], w[:, rows])
        if "energy_pull" in features:
            rows, rate = features["energy_pull"]
            inertia, inverse, part = self._inertia[:, :, rows], self._inverse[:, :, rows], w[:, rows]
            middle = np.linalg.eigvalsh(np.moveaxis(inertia[..., 0], -1, 0))[:, 1][:, None]
            spin = times(inertia, part)
            size, energy = (spin * spin).sum(axis=0), 0.5 * (part * spin).sum(axis=0)
            across = times(inverse, cross(spin, cross(spin, part)))
            with np.errstate(divide="ignore", invalid="ignore"):
                share = middle * (energy - 0.5 * size / middle) / (energy * size)
            extra[:, rows] += rate * np.where(energy > 0.0, share, 0.0) * across
        return extra

    def _continuous_loads(self, y: States, rotation: Array, t: Array) -> tuple[Array, Array]:
        """Return acceleration and torque of the continuous loads, in world axes."""
        shape = y.w.shape[1:]
        at = Instants(
            np.broadcast_to(t, shape),
            np.moveaxis(y.x, 0, -1),
            np.moveaxis(rotation, (0, 1), (-2, -1)),
            np.moveaxis(y.v, 0, -1),
            np.moveaxis(times(rotation, y.w), 0, -1),
        )
        force, torque = np.zeros((*shape, 3)), np.zeros((*shape, 3))
        for load in self._scene.continuous_loads:
            push, turning = load.wrench(self._scene, at)
            force, torque = force + push, torque + turning
        factor = self._numbers("continuous")[:, None]
        mass = self._numbers("mass")[:, None]
        moving = factor / mass if self._is_moved else 0.0
        return moving * np.moveaxis(force, -1, 0), factor * np.moveaxis(torque, -1, 0)

    def _clamp(self, y: States, *, first: bool) -> None:
        """Limit velocities in place; first: those that are limited before the pose is updated."""
        for which, axes, rows, limit, early in self._clamps:
            if early == first:
                value = getattr(y, which)
                value[:, rows] = _clamped(value[:, rows], which, axes, limit, y.q[:, rows])

    def _limited(self, old: States, new: States) -> States:
        """Return the new states with clamps, sleep and precision applied."""
        features = self._features
        self._clamp(new, first=False)
        if "single_state" in features:
            rows = features["single_state"][0]
            for value in (new.x, new.v, new.q, new.w):
                value[:, rows] = value[:, rows].astype(np.float32)
        if "asleep" in features:
            rows, limit = features["asleep"]
            slow = (old.v[:, rows] ** 2).sum(axis=0) < limit**2
            slow &= (old.w[:, rows] ** 2).sum(axis=0) < limit**2
            for before, value in ((old.x, new.x), (old.v, new.v), (old.q, new.q), (old.w, new.w)):
                value[:, rows] = np.where(slow, before[:, rows], value[:, rows])
        return new


_OF_ATTITUDE = {
    "inertia_in_world",
    "force_world_by",
    "torque_body_by",
    "total_force_by",
    "total_torque_by",
    "held_loads",
    "body_velocity",
}
"""The features whose forces depend on the attitude."""

ATTITUDE_STEPS = (
    ("q+ = q + dt/2 q omega", True, 1.0),
    ("q+ = q + dt/2 q omega+", True, 0.0),
    ("q+ = q exp(dt omega / 2)", False, 1.0),
    ("q+ = q exp(dt omega+ / 2)", False, 0.0),
    ("q+ = q exp(dt (omega + omega+) / 4)", False, 0.5),
)
"""Ways to advance q by itself: formula, whether it adds to q, and the weight of omega before the step."""

_OF_OMEGA_RATE = {
    "damping_w",
    "damping_torque",
    "damping_w_speed",
    "energy_pull",
    "inertia_in_world",
    "single_stage",
}

_WRONGLY = {
    "force_body_by": (transposed_times, times),
    "force_world_by": (transposed_times, times),
    "torque_body_by": (times, transposed_times),
    "torque_world_by": (times, transposed_times),
}
"""Load -> how a candidate rotates it once, and the rotation that another one makes twice."""


def _moment_of(m: Array) -> Array:
    """Return the sum of a x F (3, ...) of the sum m of a F^T (3, 3, ...)."""
    return np.stack([m[1, 2] - m[2, 1], m[2, 0] - m[0, 2], m[0, 1] - m[1, 0]])


def _clamped(value: Array, which: str, axes: ClampAxes, limit: Array, q: Array) -> Array:
    """Return v in world axes, or w in body axes, limited by components or by its norm."""
    if axes == "norm":
        size = np.sqrt((value * value).sum(axis=0))
        return value * np.minimum(1.0, limit / np.maximum(size, 1e-300))
    if (which == "v") == (axes == "world"):
        return np.clip(value, -limit, limit)
    rotation = matrix_of(q)
    if which == "v":
        return times(rotation, np.clip(transposed_times(rotation, value), -limit, limit))
    return transposed_times(rotation, np.clip(times(rotation, value), -limit, limit))
