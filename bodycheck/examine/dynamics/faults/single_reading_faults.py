"""Faults of trees that change a single reading."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from bodycheck.adapters.reading_names import READINGS
from bodycheck.examine.diagnosis.faults.fault import FACTOR, Parameter
from bodycheck.examine.dynamics.faults.tree_fault import Faulty, Plant, TreeFault, jointed
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate, quaternion_product, quaternion_to_matrix


def _reading(change: Callable[[TreeState, Array, Array], Array], reading: str) -> Plant:
    """Return what changes the exact value of one reading: change(state, value, parameters)."""

    def plant(case: TreeCase, _bodies: Sequence[int], values: Array) -> Faulty:
        def value(name: str) -> Array:
            exact = case.exact(name)
            if name != reading:
                return exact
            return np.array(
                [change(state, one, values) for state, one in zip(case.states, exact, strict=True)]
            )

        return value

    return plant


def _wrench_in(
    axes: str, about: str, sign: float, *, moment_first: bool
) -> Callable[[TreeState, Array, Array], Array]:
    def change(state: TreeState, wrenches: Array, _values: Array) -> Array:
        found = sign * wrenches
        quaternions = state.dynamics.quaternion
        for k in jointed(state.scene):
            joint, R = state.scene.bodies[k].joint, quaternion_to_matrix(quaternions[k])
            point = joint.at_body  # the joint's point, from the place that the moment is about
            if about == "joint":
                point = np.zeros(3)
            elif about == "world":
                point = joint.at_body + R.T @ state.dynamics.position[k]
            turn = np.eye(3)
            if axes == "world":
                turn = R
            elif axes == "parent":
                above = np.eye(3) if joint.parent < 0 else quaternion_to_matrix(quaternions[joint.parent])
                turn = above.T @ R
            force, moment = found[k][:3], found[k][3:] + np.cross(point, found[k][:3])
            found[k] = np.concatenate([turn @ force, turn @ moment])
        return np.roll(found, 3, axis=1) if moment_first else found

    return change


def _local_gyroscopic(state: TreeState, wrenches: Array, values: Array) -> Array:
    found = wrenches.copy()
    for k in jointed(state.scene):
        omega = state.dynamics.omega_body[k]
        found[k][3:] += (values[0] - 1.0) * np.cross(omega, state.scene.bodies[k].inertia @ omega)
    return found


def _momenta_of(axes: str, about: str) -> Callable[[TreeState, Array, Array], Array]:
    def change(state: TreeState, momenta: Array, _values: Array) -> Array:
        P, L = momenta[:3], momenta[3:]
        if about == "centre":
            masses = np.array([body.mass for body in state.scene.bodies])
            L = L - np.cross(masses @ state.dynamics.position / masses.sum(), P)
        turn = quaternion_to_matrix(state.dynamics.quaternion[0]).T if axes == "base" else np.eye(3)
        return np.concatenate([turn @ P, turn @ L])

    return change


def _link_places(state: TreeState, poses: Array, _values: Array) -> Array:
    found = poses.copy()
    for k in jointed(state.scene):
        found[k][:3] += quaternion_to_matrix(poses[k][3:]) @ state.scene.bodies[k].joint.at_body
    return found


def _link_quaternions(state: TreeState, poses: Array, _values: Array) -> Array:
    """Return orientations relative to the joint's zero frame: the rotation of that frame left out."""
    found = poses.copy()
    for k in jointed(state.scene):
        found[k][3:] = quaternion_product(poses[k][3:], conjugate(state.scene.bodies[k].joint.zero))
    return found


def single_reading_faults() -> Iterator[TreeFault]:
    """Yield those that change one reading."""
    for sign, axes, about, moment_first in product(
        (1.0, -1.0), ("child", "parent", "world"), ("joint", "centre", "world"), (False, True)
    ):
        if (sign, axes, about, moment_first) == (1.0, "child", "joint", False):
            continue
        point = {
            "joint": "",
            "centre": " about the child's centre of mass",
            "world": " about the world's origin",
        }[about]
        words = [
            f"they are in {axes} axes" if axes != "child" else "",
            f"the moment is{point}" if point else "",
        ]
        words += [
            "they act on the parent, not the child" if sign < 0.0 else "",
            "the moment comes first" if moment_first else "",
        ]
        yield TreeFault(
            "wrench-frame",
            ", ".join(filter(None, words)),
            _reading(_wrench_in(axes, about, sign, moment_first=moment_first), "wrenches"),
            ("wrenches",),
        )
    yield TreeFault(
        "wrench-gyroscopic",
        "the moment has omega x I omega of the child {0} times",
        _reading(_local_gyroscopic, "wrenches"),
        ("wrenches",),
        parameters=(FACTOR,),
        start=(2.0,),
        special=lambda _case, _body: {"the moment has omega x I omega of the child twice": (2.0,)},
    )
    for axes, about in (("base", "origin"), ("world", "centre"), ("base", "centre")):
        words = [
            "they are in the axes of the first body" if axes == "base" else "",
            "they are about the centre of mass" if about == "centre" else "",
        ]
        yield TreeFault(
            "momenta-frame",
            " and ".join(filter(None, words)),
            _reading(_momenta_of(axes, about), "momenta"),
            ("momenta",),
        )
    singles: tuple[tuple[str, str, str, Callable[[TreeState, Array, Array], Array]], ...] = (
        ("momenta", "momenta-order", "the angular momentum comes first", lambda _, p, __: np.roll(p, 3)),
        ("energy", "energy-order", "the potential comes first", lambda _, e, __: e[::-1]),
        ("energy", "energy-sign", "the potential has the opposite sign", lambda _, e, __: e * (1.0, -1.0)),
        ("energy", "energy-half", "the kinetic energy counts twice", lambda _, e, __: e * (2.0, 1.0)),
        (
            "poses",
            "pose-conjugate",
            "the quaternions are conjugate",
            lambda _, p, __: p * (1, 1, 1, 1, -1, -1, -1),
        ),
        (
            "poses",
            "pose-order",
            "the quaternions are in the order x y z w",
            lambda _, p, __: p[:, [0, 1, 2, 4, 5, 6, 3]],
        ),
        (
            "poses",
            "pose-point",
            "the places are those of the joints, not of the centres of mass",
            _link_places,
        ),
        ("poses", "pose-zero", "the orientations lack the rotation of the joint's frame", _link_quaternions),
        (
            "mass_matrix",
            "upper-triangle",
            "it is filled only above its diagonal",
            lambda _, m, __: np.triu(m),
        ),
        (
            "mass_matrix",
            "upper-triangle",
            "it is filled only below its diagonal",
            lambda _, m, __: np.tril(m),
        ),
        (
            "mass_matrix",
            "mass-inverse",
            "it is the inverse",
            lambda _, m, __: np.asarray(np.linalg.inv(m), np.float64),
        ),
    )
    for reading, name, sentence, change in singles:
        yield TreeFault(name, sentence, _reading(change, reading), (reading,))
    yield TreeFault(
        "energy-zero",
        "the potential is {0} J larger",
        _reading(lambda _, e, v: e + np.array([0.0, v[0]]), "energy"),
        ("energy",),
        parameters=(Parameter("potential", "J", 0.0),),
        start=(0.0,),
    )
    for reading in READINGS[:-1]:
        yield TreeFault(
            "factor",
            "they are {0} times as large",
            _reading(lambda _, value, s: s[0] * value, reading),
            (reading,),
            parameters=(FACTOR,),
            start=(-1.0,),
            special=lambda _case, _body: {"they have the opposite sign": (-1.0,)},
        )
