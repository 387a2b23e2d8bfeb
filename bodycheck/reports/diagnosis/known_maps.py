"""The maps of the library, as fingerprints know them, on the transitions of a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Instants
from bodycheck.reference_impl.one_step_maps import EXACT, MAPS, OneStepMap
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Loads,
    Motion,
    Solid,
    back,
    times,
    zero_order_hold,
)
from bodycheck.reference_impl.rotations import exp_matrix, exp_quaternion, quaternion_product, vee
from bodycheck.reference_impl.wrench import wrench_at
from bodycheck.reports.diagnosis.engine_model import Reading
from bodycheck.reports.diagnosis.transitions import SHIFT, Transitions, derivatives_of

_SCREENED = 6  # transitions
_NEAR = 1.4  # multiples of the limit, within which a map is whitened by its own derivatives
_NEAR_BY_LOADS = 100.0  # multiples of the nearest map, within which other treatments of loads are tried
_SAME_NORM = 3.0  # multiples of the resolution
_ROUND_OFF = 1e-14


@dataclass(frozen=True)
class KnownMap:
    """A map of the library that could have made a trajectory, with the largest difference per sample.

    rule: how it treats loads, "" where it evaluates them as the map states.
    """

    one: OneStepMap
    cost: float
    rule: str = ""

    @property
    def text(self) -> str:
        """The name of the map, and how it treats loads."""
        return f"{self.one.name}, {self.rule}" if self.rule else self.one.name


def maps_of(transitions: Transitions) -> list[KnownMap]:
    """Return every map of the library that could have made a trajectory, in the order of the library.

    transitions: all of them. Maps without the gyroscopic term are faults, and so left out.
    """
    few, steps = _LibrarySteps(transitions.alone().subset(_SCREENED)), _LibrarySteps(transitions)
    possible = [one for one in MAPS.values() if one.order > 0 and one is not EXACT]
    first = {one.name: few.cost(one, "") for one in possible}
    near = _NEAR_BY_LOADS * min(first.values())
    screened = [
        (one, rule)
        for one in possible
        for rule in (few.rules(one) if first[one.name] <= near else ("",))
        if (few.cost(one, rule) if rule else first[one.name]) <= few.transitions.limit
        and few.has_norm_of(one, rule)
    ]
    found = []
    for (one, rule), cost in zip(screened, steps.costs(screened), strict=True):
        is_near = transitions.limit / _NEAR < cost <= _NEAR * transitions.limit
        settled = steps.cost(one, rule) if is_near else cost
        if settled <= transitions.limit:
            found.append(KnownMap(one, settled, rule))
    return found


_RULES = {"": None, "loads held in world axes": False, "loads held in body axes": True}


@dataclass(frozen=True, eq=False)
class _LibrarySteps:
    """The transitions of a trajectory, made by maps of the library."""

    transitions: Transitions

    def rules(self, one: OneStepMap) -> Sequence[str]:
        """Return the treatments of loads to try for a map."""
        scene = self.transitions.scene
        return tuple(_RULES) if one.stages and scene.loads else ("",)

    @cached_property
    def _starts(self) -> Motion:
        path = Motion.of(self.transitions.trajectory)
        return path.part(self.transitions.indices)

    @cached_property
    def _shifted_starts(self) -> list[Motion]:
        """The starts, and again with each known quantity shifted, one after the other."""
        moved = [self._starts]
        sizes = SHIFT * self.transitions.sizes
        for row in self.transitions.rows.tolist():
            shift = np.zeros(3)
            shift[row % 3] = sizes[row]
            moved.append(_moved(self._starts, row // 3, shift, world=self.transitions.world_omega))
        return moved

    def cost(self, one: OneStepMap, rule: str) -> float:
        """Return the root mean square of the differences, whitened by derivatives of the map itself."""
        here = self.transitions
        if here.whitening is None:
            return here.cost_of(self._gaps(one, rule, self._starts) * here.weights[:, None])
        shifted = np.concatenate([self._gaps(one, rule, start) for start in self._shifted_starts])
        here = here.whitened_with(derivatives_of(shifted[:, here.rows]))
        return here.cost_of(here.whitened(shifted[:1]))

    def costs(self, some: Sequence[tuple[OneStepMap, str]]) -> list[float]:
        """Return the root mean squares of the differences, all whitened by the same derivatives."""
        if not some:
            return []
        if self.transitions.whitening is None:
            return [self.cost(one, rule) for one, rule in some]
        gaps = np.concatenate([self._gaps(one, rule, self._starts) for one, rule in some])
        return [self.transitions.cost_of(part) for part in self.transitions.whitened(gaps)]

    def has_norm_of(self, one: OneStepMap, rule: str) -> bool:
        """Whether the norms of quaternions, or the matrices, are those that a map makes."""
        if "attitude" not in self.transitions.known:
            return True
        here, path = self.transitions, self.transitions.trajectory
        after = self._after(one, rule, self._starts)
        allowed = _SAME_NORM * here.resolution.attitude + _ROUND_OFF * here.grid.stride
        if path.quaternion is not None:
            recorded = np.linalg.norm(path.quaternion[here.indices + 1], axis=-1)
            gap = np.abs(np.linalg.norm(after.quaternion, axis=-1) - recorded)
        else:
            assert path.rotation is not None
            recorded = path.rotation[here.indices + 1]
            gram = (np.swapaxes(matrix, -1, -2) @ matrix for matrix in (after.matrix, recorded))
            gap = np.abs(next(gram) - next(gram))
        return bool(np.max(gap) <= allowed)

    def _gaps(self, one: OneStepMap, rule: str, starts: Motion) -> Array:
        after = self._after(one, rule, starts)
        omega = times(after.orthogonal, after.omega) if self.transitions.world_omega else after.omega
        parts = (after.position, after.velocity, after.quaternion, omega)
        return self.transitions.gaps_of(Reading(*(part.T[:, None] for part in parts)))

    def _after(self, one: OneStepMap, rule: str, motion: Motion) -> Motion:
        """Return states after one sample interval."""
        here, hold = self.transitions, _RULES[rule]
        dt, solid = here.grid.dt_s[here.indices], Solid.of(here.scene.body)
        with np.errstate(all="ignore"):
            for step in range(here.grid.stride):
                loads = self._loads(step)
                if hold is not None:
                    loads = zero_order_hold(loads, motion, in_body_axes=hold)
                motion = one.step(solid, motion, dt, loads)
        return motion

    def _loads(self, step: int) -> Loads:
        """Return the loads that act in a step of each transition."""
        here = self.transitions
        scene, held = here.scene, here.grid.loads
        rows = here.grid.timeline[here.indices, step]
        push_world = held.force_world[rows] + scene.body.mass * scene.gravity
        turning_body = held.torque_body[rows] + held.lever[rows]
        push_body, turning_world, moment = held.force_body[rows], held.torque_world[rows], held.moment[rows]

        def loads(
            t: Array, position: Array, rotation: Array, velocity: Array, omega: Array
        ) -> tuple[Array, Array]:
            force = push_world + times(rotation, push_body)
            torque = turning_body + back(rotation, turning_world) - 2.0 * vee(moment @ rotation)
            for load in scene.continuous_loads:
                push, couple = wrench_at(load, scene, Instants(t, position, rotation, velocity, omega))
                force, torque = force + push, torque + back(rotation, couple)
            return force, torque

        return loads


def _moved(motion: Motion, which: int, shift: Array, *, world: bool) -> Motion:
    """Return the states with position, velocity, attitude or omega shifted by (3,) in the recorded axes."""
    if which == 0:
        return replace(motion, position=motion.position + shift)
    if which == 1:
        return replace(motion, velocity=motion.velocity + shift)
    if which == 3:
        turned = back(motion.orthogonal, np.broadcast_to(shift, motion.omega.shape)) if world else shift
        return replace(motion, omega=motion.omega + turned)
    matrix = None if motion.rotation is None else motion.rotation @ exp_matrix(shift)
    turned = quaternion_product(motion.quaternion, exp_quaternion(np.broadcast_to(shift, motion.omega.shape)))
    # omega in world axes is what is recorded, and stays
    omega = motion.omega @ exp_matrix(shift) if world else motion.omega
    return replace(motion, quaternion=turned, rotation=matrix, omega=omega)
