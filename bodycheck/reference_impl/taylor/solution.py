"""Integrate a scene by Taylor series from switch to switch, for a free body or about a pivot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.generic_precision import Numbers
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.rational import pair, paired_omega, unit_quaternion
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.taylor.forcing import Forcing, forcing_between, pivot_position
from bodycheck.reference_impl.taylor.spring_terms import SPRING_ROWS, TORSION_ROWS
from bodycheck.reference_impl.taylor.taylor_steps import (
    LOST_AT_ANCHOR,
    LOST_AT_HALF_TURN,
    LOST_AT_ZERO,
    follow_parabola,
    integrate,
)
from bodycheck.reference_impl.taylor.taylor_terms import OMEGA, SINES, STATE, V, X
from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True)
class SeriesAccuracy:
    """The order, tolerance and precision of an integration.

    order: of the series. tolerance: the size of the last terms. paired_orders: the number of orders in
    double-doubles. 0 is the fastest; a few reduce the round-off of many steps; with about three fifths of the
    orders, doubles are precise enough for the remaining terms, for tolerances down to 1e-33.
    """

    order: int
    tolerance: float
    paired_orders: int = 0


def resolution_for(tolerance: float) -> SeriesAccuracy:
    """Return the fastest resolution with an error per step of about the tolerance, which is 1e-17 or more."""
    if not 1e-17 <= tolerance < 1.0:
        raise ValueError(f"a tolerance of doubles lies between 1e-17 and 1, not at {tolerance!r}")
    digits = -math.log10(tolerance)
    return SeriesAccuracy(
        14 if digits < 7.0 else 16 if digits < 10.0 else 18 if digits < 14.0 else 20, tolerance
    )


@dataclass(frozen=True, eq=False)
class Solution:
    """States (n, 13): q, omega_body, v, x, as sums of a high and a low part; and the number of steps.

    lost: the reason for NaN states from some time on, if it is known.
    """

    high: Array
    low: Array
    steps: int
    lost: str = ""


_LOST = {
    LOST_AT_ANCHOR: "a spring with a rest length is at its anchor, where its force is discontinuous",
    LOST_AT_HALF_TURN: "a torsion spring is rotated by pi, where its torque is discontinuous",
    LOST_AT_ZERO: "the argument of a square root, or a divisor, in the formula of a load reaches 0",
}

_STEPS_PER_CALL = 10_000
"""Steps after which compiled code returns, because a process handles Ctrl-C and SIGTERM only in between."""

_MOST_STEPS = 1e7
"""Of one solution, if the last ones go on; a hundred microseconds each in double-doubles."""


class TooManyStepsError(ValueError):
    """A motion that would take hours to follow."""


Forcings: TypeAlias = tuple[tuple[float, float, Forcing], ...]
"""Consecutive intervals (begin in s, end in s, forcing) without gaps."""


def forcings_of(scene: Scene, until_s: float) -> Forcings:
    """Return the forcing of the scene from switch to switch."""
    edges = [0.0, *scene.switches_before(until_s), until_s]
    return tuple((begin, end, forcing_between(scene, begin, end)) for begin, end in pairwise(edges))


def solve(forcings: Forcings, start: State, t_s: Array, resolution: SeriesAccuracy) -> Solution:
    """Integrate consecutive forcings from a state; return the states at ascending times (n,) within it."""
    return solve_packed(forcings, packed_state(start), t_s, resolution)


def solve_packed(
    forcings: Forcings, state: tuple[Array, Array], t_s: Array, resolution: SeriesAccuracy
) -> Solution:
    """Integrate as `solve` does, from a state ((13,), (13,)), high and low parts, updated to the end."""
    steps, lost = 0, ""
    high, low = np.empty((len(t_s), STATE)), np.empty((len(t_s), STATE))
    for begin, end, forcing in forcings:
        first, after = np.searchsorted(t_s, [begin, end])
        part = slice(first, after if end != forcings[-1][1] else len(t_s))
        out = high[part], low[part]
        made = _advance(state, forcing, resolution, t_s[part], (begin, end), out)
        lost = lost or _LOST.get(made, "")
        steps += max(made, 0)
    return Solution(high, low, steps, lost)


def packed_state(start: State) -> tuple[Array, Array]:
    """((13,), (13,)): the high and low parts of q / |q|, omega_body, v, x."""
    state = np.concatenate([start.quaternion, start.omega_body, start.velocity, start.position])
    rest = np.zeros(STATE)
    state[:4], rest[:4] = np.array(unit_quaternion(start.quaternion)).T
    state[4:7], rest[4:7] = paired_omega(start)
    return state, rest


def trajectory_of(t_s: Array, states: Array) -> Trajectory:
    """Return the states (n, 13), q, omega_body, v, x, at t_s (n,) as a trajectory."""
    return Trajectory(
        t_s=t_s,
        position_m=states[:, X:],
        velocity_m_s=states[:, V:X],
        quaternion=states[:, :OMEGA],
        omega_body_rad_s=states[:, OMEGA:V],
    )


def _advance(
    state: tuple[Array, Array],
    forcing: Forcing,
    resolution: SeriesAccuracy,
    times: Array,
    span: tuple[float, float],
    out: tuple[Array, Array],
) -> int:
    """Run the kernels that the forcing needs over the span (begin, end) in s; return the number of steps.

    As for `integrate`, state ((13,), (13,)) is updated in place, and out ((n, 13), (n, 13)) is filled at
    times (n,).
    """
    numbers = forcing if resolution.paired_orders else forcing.rounded()
    rows, series = _working_space(forcing, resolution)
    (t, end), due, steps = span, 0, 0
    while True:
        before = t
        made, t = integrate(
            state,
            series,
            numbers.rotational,
            numbers.damping,
            numbers.body_sines,
            numbers.world,
            numbers.world_sines,
            numbers.orbit,
            None if forcing.on_parabola else numbers.translational,
            numbers.springs,
            numbers.torsion,
            numbers.recorded,
            rows,
            times[due:],
            t,
            end,
            resolution.tolerance,
            resolution.paired_orders,
            _STEPS_PER_CALL,
            (out[0][due:], out[1][due:]),
        )
        steps = made if made < 0 else steps + made
        if not t < end:
            break
        needed = steps + made * (end - t) / (t - before)
        if needed > _MOST_STEPS:
            raise TooManyStepsError(
                f"the motion takes about {needed:.0e} steps, and no more than {_MOST_STEPS:.0e} are made"
            )
        due = int(np.searchsorted(times, t, side="right"))
    if forcing.on_parabola:
        follow_parabola(state, numbers.translational, times, *span, out)
    return steps


def _working_space(forcing: Forcing, resolution: SeriesAccuracy) -> tuple[tuple[int, int, int, int], Numbers]:
    """Return the first rows, and zeroed series.

    The rows are those of the sines in world axes, the springs, the torsion spring and the recorded loads.
    """
    counts = [
        0 if part is None else len(part)
        for part in (forcing.body_sines, forcing.world_sines, forcing.springs, forcing.recorded)
    ]
    world_sines = SINES + 2 * counts[0]
    springs = world_sines + 2 * counts[1]
    torsion = springs + SPRING_ROWS * counts[2]
    recorded = torsion + (0 if forcing.torsion is None else TORSION_ROWS)
    shape = (recorded + counts[3], resolution.order + 1)
    series = (np.zeros(shape), np.zeros(shape)) if resolution.paired_orders else np.zeros(shape)
    return (world_sines, springs, torsion, recorded), series


def follow_scene(
    scene: Scene, forcings: Forcings, state: tuple[Array, Array], t_s: Array, resolution: SeriesAccuracy
) -> Solution:
    """Integrate the forcings of a scene from a packed state; return the states at ascending times (n,).

    x and v are those of the centre of mass. The state ((13,), (13,)) is updated to the end of the forcings.
    About a pivot its position and velocity are ignored, because they follow from attitude and omega.
    """
    if scene.pivot is None:
        return solve_packed(forcings, state, t_s, resolution)
    for part in state:
        part[V:] = 0.0
    about_pivot = solve_packed(forcings, state, t_s, resolution)
    origin = np.array([pair(x) for x in pivot_position(scene)], dtype=np.float64)
    _put_centre(about_pivot.high, about_pivot.low, scene.pivot, origin)
    return about_pivot


@kernel
def _put_centre(high: Array, low: Array, pivot: Array, origin: Array) -> None:
    """Write x = origin - R r and v = -R (omega x r), r the pivot in body axes, into the states (n, 13)."""
    for k in range(len(high)):
        q = high[k, :OMEGA], low[k, :OMEGA]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            spin_b, spin_c = (high[k, OMEGA + b], low[k, OMEGA + b]), (high[k, OMEGA + c], low[k, OMEGA + c])
            swept = dd.subtract(dd.multiply(spin_c, (pivot[b], 0.0)), dd.multiply(spin_b, (pivot[c], 0.0)))
            high[k, V + a], low[k, V + a] = swept
        back = _rotated(q, (-pivot[0], 0.0), (-pivot[1], 0.0), (-pivot[2], 0.0))
        speed = _rotated(
            q,
            (high[k, V], low[k, V]),
            (high[k, V + 1], low[k, V + 1]),
            (high[k, V + 2], low[k, V + 2]),
        )
        for a in range(3):
            high[k, V + a], low[k, V + a] = speed[a]
            high[k, X + a], low[k, X + a] = dd.add((origin[a, 0], origin[a, 1]), back[a])


@kernel
def _rotated(
    q: tuple[Array, Array], x: DoubleDouble, y: DoubleDouble, z: DoubleDouble
) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble]:
    """R(q) v = v + w t + u x t, t = 2 u x v, for q = (w, u)."""
    u = (q[0][1], q[1][1]), (q[0][2], q[1][2]), (q[0][3], q[1][3])
    v = (x, y, z)
    t = (
        dd.scale(dd.subtract(dd.multiply(u[1], v[2]), dd.multiply(u[2], v[1])), 2.0),
        dd.scale(dd.subtract(dd.multiply(u[2], v[0]), dd.multiply(u[0], v[2])), 2.0),
        dd.scale(dd.subtract(dd.multiply(u[0], v[1]), dd.multiply(u[1], v[0])), 2.0),
    )
    w = q[0][0], q[1][0]
    return (
        dd.add(
            dd.add(x, dd.multiply(w, t[0])), dd.subtract(dd.multiply(u[1], t[2]), dd.multiply(u[2], t[1]))
        ),
        dd.add(
            dd.add(y, dd.multiply(w, t[1])), dd.subtract(dd.multiply(u[2], t[0]), dd.multiply(u[0], t[2]))
        ),
        dd.add(
            dd.add(z, dd.multiply(w, t[2])), dd.subtract(dd.multiply(u[0], t[1]), dd.multiply(u[1], t[0]))
        ),
    )
