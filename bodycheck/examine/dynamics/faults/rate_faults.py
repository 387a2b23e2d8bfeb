"""Faults of trees of the order and the axes of rates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from bodycheck.adapters.tree_contract import depth_first, jointed_links
from bodycheck.examine.dynamics.faults.tree_fault import (
    LENGTHS,
    Bodies,
    Faulty,
    Plant,
    TreeFault,
    all_bodies,
    of_kinds,
    zero_rotation,
)
from bodycheck.examine.dynamics.tree_case import EXACT, TreeCase, TreeState
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import hat, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeScene

_RATE_READINGS = ("mass_matrix", "bias", "gravity_bias", "accelerations")


def _reported_in(turns: Callable[[TreeState], tuple[Array, Array]], *, taken: bool) -> Plant:
    """Return what reports in other rates, u_e = T u; turns(state) -> T, (dT/dt) u.

    taken: whether it also takes u as such rates.
    """

    def plant(case: TreeCase, _bodies: Sequence[int], _values: Array) -> Faulty:
        def own(state: TreeState) -> TreeState:
            return (
                replace(state, u=np.asarray(np.linalg.solve(turns(state)[0], state.u), np.float64))
                if taken
                else state
            )

        inside = case.changed(own)

        def value(reading: str) -> Array:
            if reading not in ("mass_matrix", "bias", "gravity_bias", "accelerations"):
                return inside.exact(reading)
            return np.array([_in_rates(reading, state, *turns(state)) for state in inside.states])

        return value

    return plant


def _in_rates(reading: str, state: TreeState, T: Array, drift: Array) -> Array:
    exact = EXACT[reading](state.dynamics)
    if reading == "accelerations":
        return np.asarray(T @ exact + drift)
    inverse = np.linalg.inv(T)
    if reading == "mass_matrix":
        return np.asarray(inverse.T @ exact @ inverse)
    if reading == "bias":
        exact = exact - state.dynamics.mass_matrix @ inverse @ drift
    return np.asarray(inverse.T @ exact)


def _base_rates(v_in: str, omega_in: str, *, omega_first: bool) -> Callable[[TreeState], tuple[Array, Array]]:
    def turns(state: TreeState) -> tuple[Array, Array]:
        T, drift = np.eye(len(state.u)), np.zeros(len(state.u))
        for k in of_kinds("free")(state.scene):
            at = state.scene.rate_slices[k]
            R = quaternion_to_matrix(state.dynamics.quaternion[k])
            v, omega = state.u[at][:3], state.u[at][3:]
            block, change = np.eye(6), np.zeros(6)
            if v_in == "body":
                block[:3, :3], change[:3] = R.T, -np.cross(omega, R.T @ v)
            if omega_in == "world":
                block[3:, 3:] = R
            if omega_first:
                block, change = np.roll(block, 3, axis=0), np.roll(change, 3)
            T[at, at], drift[at] = block, change
        return T, drift

    return turns


def _of_point(case: TreeCase, _bodies: Sequence[int], values: Array) -> Faulty:
    """v of the point d of a free body: v_e = v + omega x R d."""

    def turns(state: TreeState) -> tuple[Array, Array]:
        T, drift = np.eye(len(state.u)), np.zeros(len(state.u))
        for k in of_kinds("free")(state.scene):
            at = state.scene.rate_slices[k].start
            R, omega = quaternion_to_matrix(state.dynamics.quaternion[k]), state.u[at + 3 : at + 6]
            T[at : at + 3, at + 3 : at + 6] = -R @ hat(values)
            drift[at : at + 3] = R @ np.cross(omega, np.cross(omega, values))
        return T, drift

    return _reported_in(turns, taken=False)(case, (), values)


def _ball_rates(frame: str) -> Callable[[TreeState], tuple[Array, Array]]:
    def turns(state: TreeState) -> tuple[Array, Array]:
        T, scene = np.eye(len(state.u)), state.scene
        for k in of_kinds("ball")(scene):
            at = scene.rate_slices[k]
            E = quaternion_to_matrix(state.q[scene.coordinate_slices[k]])
            T[at, at] = E if frame == "joint's zero frame" else zero_rotation(scene.bodies[k].joint) @ E
        return T, np.zeros(len(state.u))

    return turns


def _in_order(order: Bodies, state: TreeState) -> tuple[Array, Array]:
    """Return T that puts the rates of bodies into another order."""
    rows = [
        row for k in order(state.scene) for row in range(*state.scene.rate_slices[k].indices(len(state.u)))
    ]
    return np.eye(len(state.u))[rows], np.zeros(len(state.u))


_ORDERS: Mapping[str, Bodies] = {
    "depth first": lambda scene: depth_first(jointed_links(scene)),
    "breadth first": lambda scene: sorted(all_bodies(scene), key=lambda k: (_depth(scene, k), k)),
    "reversed": lambda scene: [*reversed(all_bodies(scene))],
    "alphabetical": lambda scene: sorted(all_bodies(scene), key=lambda k: scene.bodies[k].name),
    "grouped by their kinds": lambda scene: sorted(
        all_bodies(scene), key=lambda k: scene.bodies[k].joint.kind
    ),
}


def _depth(scene: TreeScene, body: int) -> int:
    joint = scene.bodies[body].joint
    return 0 if joint.kind == "free" or joint.parent < 0 else 1 + _depth(scene, joint.parent)


def rate_faults() -> Iterator[TreeFault]:
    """Yield those of the axes, the order and the point of rates."""

    def both(name: str, rates: str, turns: Callable[[TreeState], tuple[Array, Array]]) -> Iterator[TreeFault]:
        yield TreeFault(name, f"they are in {rates}", _reported_in(turns, taken=False), _RATE_READINGS)
        yield TreeFault(name, f"the engine takes and reports {rates}", _reported_in(turns, taken=True))

    for order, v_in, omega_in in product((False, True), ("world", "body"), ("body", "world")):
        if (order, v_in, omega_in) == (False, "world", "body"):
            continue
        v, omega = f"v in {v_in} axes", f"omega in {omega_in} axes"
        rates = f"rates of the free body ({f'{omega}, {v}' if order else f'{v}, {omega}'})"
        name = "base-order" if order else "base-axes"
        yield from both(name, rates, _base_rates(v_in, omega_in, omega_first=order))
    for frame in ("joint's zero frame", "parent's axes"):
        yield from both("ball-axes", f"rates of balls in the {frame}, not in child axes", _ball_rates(frame))
    for words, order_of in _ORDERS.items():
        yield from both(
            "joint-order",
            f"{words} order of joints",
            partial(_in_order, order_of),
        )
    yield TreeFault(
        "base-point",
        "they are in the velocity of the free body's point ({0}, {1}, {2}) m off its centre of mass",
        _of_point,
        _RATE_READINGS,
        parameters=LENGTHS,
        start=(0.0, 0.0, 0.0),
    )
