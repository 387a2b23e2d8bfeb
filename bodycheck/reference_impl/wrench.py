"""The sum of the loads at an instant and between two switches, and the grid of steps aligned with these."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Instants, Load, WrenchFunction, checked
from bodycheck.reference_impl.scene import ConstantLoad, PointForce, RigidBody, Scene, Torque, unknown_load

if TYPE_CHECKING:
    from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene

_MAX_STEPS = 1e9
_ON_GRID = 1e-9  # of a step: a switch this near to a step's end counts as being there


@dataclass(frozen=True, eq=False)
class Wrench:
    """The sum of the loads, as constants of the equations of motion.

    torque_body (3,): torques constant in body axes, including the moments of body-fixed forces, N m.
    torque_world (3,): torques constant in world axes, N m.
    force_body (3,), force_world (3,): forces through the centre of mass, N, without gravity.
    point_forces: pairs (at (3,) in body axes from the centre of mass, m; force (3,) in world axes, N)
    of the world forces that have a moment; force_world does not include them.
    of_tree: all loads on a tree, each with its share; the other fields are 0 then.
    """

    torque_body: Array
    torque_world: Array
    force_body: Array
    force_world: Array
    point_forces: tuple[tuple[Array, Array], ...]
    of_tree: tuple[tuple[TreeLoad, float], ...] = ()

    @property
    def is_zero(self) -> bool:
        """Whether nothing but gravity acts."""
        sums = (self.torque_body, self.torque_world, self.force_body, self.force_world)
        return not self.point_forces and not any(np.any(value) for value in sums)

    def packed(self, body: RigidBody, gravity: Array) -> Array:
        """(21,): force_body, force_world with the weight, torque_body, torque_world, moment.

        moment (3, 3) = sum of at force^T gives the body torque of the world forces:
        tau_a = eps_abc (moment R)_bc.
        """
        moment = np.zeros((3, 3))
        force_world = self.force_world + body.mass * gravity
        for at, force in self.point_forces:
            moment += np.outer(at, force)
            force_world = force_world + force
        parts = (self.force_body, force_world, self.torque_body, self.torque_world, moment.ravel())
        return np.concatenate(parts)


def wrench_of(loads: tuple[tuple[ConstantLoad, float], ...]) -> Wrench:
    """Sum the loads, each multiplied by its share in [0, 1]."""
    torque_body, torque_world = np.zeros(3), np.zeros(3)
    force_body, force_world = np.zeros(3), np.zeros(3)
    point_forces: list[tuple[Array, Array]] = []
    for load, share in loads:
        value = share * load.value
        match load:
            case Torque(axes="body"):
                torque_body += value
            case Torque():
                torque_world += value
            case PointForce(axes="body"):
                force_body += value
                torque_body += np.cross(load.at, value)
            case PointForce() if np.any(load.at):
                point_forces.append((load.at, value))
            case PointForce():
                force_world += value
            case _:
                raise unknown_load(load, "the sum of loads that come and go")
    return Wrench(torque_body, torque_world, force_body, force_world, tuple(point_forces))


NO_WRENCH = wrench_of(())


def constant_loads_between(scene: Scene, begin_s: float, end_s: float) -> list[ConstantLoad]:
    """Return the loads that act throughout [begin_s, end_s), within which nothing switches."""
    return [
        load for load in scene.piecewise_constant_loads if load.from_s <= begin_s and end_s <= load.until_s
    ]


def shares_of_loads(scene: Scene, begin_s: float, end_s: float) -> list[tuple[ConstantLoad, float]]:
    """Return the piecewise constant loads that act within [begin_s, end_s), each with its share of it."""
    shares = (
        (load, share_of(load.from_s, load.until_s, begin_s, end_s)) for load in scene.piecewise_constant_loads
    )
    return [(load, share) for load, share in shares if share > 0.0]


def share_of(from_s: float, until_s: float, begin_s: float, end_s: float) -> float:
    """Return the share of [begin_s, end_s) within [from_s, until_s): 0 or 1 where it is that to rounding."""
    overlap = min(end_s, until_s) - max(begin_s, from_s)
    share = min(max(overlap / (end_s - begin_s), 0.0), 1.0)
    if share <= _ON_GRID:
        return 0.0
    return 1.0 if share > 1.0 - _ON_GRID else share


def wrench_between(scene: Scene | TreeScene, begin_s: float, end_s: float) -> Wrench:
    """Return the mean of the piecewise constant loads within [begin_s, end_s); exact if none switches inside.

    Continuous loads are not included: they are not constant, and a simulation evaluates them itself. Of a
    tree, all loads are.
    """
    if not isinstance(scene, Scene):
        return scene.wrench_between(begin_s, end_s)
    return wrench_of(tuple(shares_of_loads(scene, begin_s, end_s)))


def wrench_at(load: Load, scene: Scene, instants: Instants) -> tuple[Array, Array]:
    """Return force and torque (..., 3) about the centre of mass, in N and N m, world axes.

    A load with a limited duration is treated as acting. The docstrings of the loads give the formulas.
    """
    return checked(load, "the sum of forces and torques").wrench(scene, instants)


def sum_of_wrenches(loads: Sequence[Load], scene: Scene) -> WrenchFunction:
    """Return one function of the motion that sums these loads and the weight."""

    def wrench(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        instants = Instants(np.array(t), position, rotation, velocity, omega)
        force, torque = scene.body.mass * scene.gravity, np.zeros(3)
        for load in loads:
            push, couple = wrench_at(load, scene, instants)
            force, torque = force + push, torque + couple
        return force, torque

    return wrench


def continuous_wrench_of(scene: Scene) -> WrenchFunction:
    """Return one function of the motion that sums the scene's continuous loads, including callback loads.

    Force and torque are NaN where the motion is not finite; no callback is called there.
    """
    wrench = sum_of_wrenches(scene.continuous_loads, replace(scene, gravity=np.zeros(3)))

    def continuous(
        t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        if not np.isfinite([*position, *rotation.flat, *velocity, *omega]).all():
            return np.full(3, np.nan), np.full(3, np.nan)
        return wrench(t, position, rotation, velocity, omega)

    return continuous


@dataclass(frozen=True, eq=False)
class Leg:
    """A number of steps under one wrench, and whether its end is a sample time."""

    steps: int
    wrench: Wrench
    ends_at_sample: bool


@dataclass(frozen=True, eq=False)
class StepPlan:
    """The steps of one case: the wrench that acts during each step, and the sample times.

    A step with a switch inside uses the mean of the loads over the step, so that its impulse is exact.
    `mid_step_switches` counts such switches.
    """

    dt_s: float
    steps: int
    segments: tuple[tuple[int, Wrench], ...]
    stride: int
    mid_step_switches: int

    def legs(self) -> Iterator[Leg]:
        """Yield the legs from sample to sample, split where the wrench changes."""
        done = 0
        for length, wrench in self.segments:
            end = done + length
            while done < end:
                to_sample = self.stride - done % self.stride
                steps = min(to_sample, end - done)
                done += steps
                yield Leg(steps, wrench, ends_at_sample=steps == to_sample)

    def uninterrupted(self) -> Iterator[Leg]:
        """Yield the legs of a run that does not stop at samples."""
        for length, wrench in self.segments:
            yield Leg(length, wrench, ends_at_sample=False)


def steps_per_sample(interval_s: float, dt_s: float) -> int:
    """Return the number of steps of dt_s in one sampling interval of interval_s.

    Raises ValueError, naming the nearest valid steps, where dt_s does not divide the interval.
    """
    if not 0.0 < dt_s < math.inf:
        raise ValueError(f"a step must be a positive number of seconds, not {dt_s!r}")
    ratio = interval_s / dt_s
    if ratio > _MAX_STEPS:
        raise ValueError(f"a step of {dt_s!r} s is too fine: more than {_MAX_STEPS:.0e} steps per sample")
    stride = round(ratio)
    if stride >= 1 and abs(ratio - stride) <= 1e-9 * ratio:
        return stride
    nearest = " or ".join(_valid_steps(interval_s, int(ratio)))
    raise ValueError(
        f"a step of {dt_s!r} s does not divide the sampling interval of "
        f"{interval_s!r} s; the nearest that do: {nearest}"
    )


_MOST_TRIED = 10_000  # steps per sample beside the nearest, until one has three digits


def _valid_steps(interval_s: float, stride: int) -> list[str]:
    """Return the next coarser and the next finer valid step, with at most three digits if one is near."""

    def is_short(n: int) -> bool:
        return math.isclose(float(f"{interval_s / n:.3g}") * n, interval_s, rel_tol=1e-9)

    coarser = range(stride, max(stride // 2, stride - _MOST_TRIED), -1)
    finer = range(stride + 1, stride + 2 + min(stride, _MOST_TRIED))
    nearest = [next(filter(is_short, strides), strides[0]) for strides in (coarser, finer) if strides]
    return [f"{interval_s / n:.3g}" if is_short(n) else repr(interval_s / n) for n in nearest]


def plan_steps(scene: Scene | TreeScene, dt_s: float) -> StepPlan:
    """Map the scene's piecewise constant loads to the grid of steps k dt_s.

    Raises ValueError where dt_s does not divide the sampling interval.
    """
    stride = steps_per_sample(scene.sample_interval_s, dt_s)
    steps = stride * (scene.samples - 1)
    step = scene.duration_s / steps
    cuts, mid_step_switches = {0, steps}, 0
    for switch in scene.switches_before(scene.duration_s):
        place = switch / step
        if abs(place - round(place)) <= _ON_GRID + 1e-15 * place:  # plus the quotient's rounding
            cuts.add(round(place))
        else:
            cuts.update((int(place), int(place) + 1))
            mid_step_switches += 1
    edges = sorted(cuts)
    segments = tuple(
        (last - first, wrench_between(scene, first * step, last * step)) for first, last in pairwise(edges)
    )
    return StepPlan(step, steps, segments, stride, mid_step_switches)
