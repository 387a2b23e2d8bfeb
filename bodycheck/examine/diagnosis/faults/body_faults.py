"""Faults of the body: its inertia and its mass; faults of gravity."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import permutations

import numpy as np

from bodycheck.examine.diagnosis.engine_model import Model
from bodycheck.examine.diagnosis.faults.fault import (
    FACTOR,
    Changed,
    Fault,
    FaultContext,
    Parameter,
    constant,
    near,
)
from bodycheck.reference_impl.arrays import Array

_POSITIVE_FACTOR = Parameter("factor", low=1e-6)
_OTHER_ORDERS = list(permutations(range(3)))[1:]
"""All orders of three axes but the right one."""


def _moment_scaled(which: int) -> Callable[[Array, Array], Array]:
    def change(inertia: Array, values: Array) -> Array:
        moments, axes = np.linalg.eigh(inertia)
        moments[which] *= values[0]
        return np.asarray(axes @ np.diag(moments) @ axes.T)

    return change


def _off_diagonals(inertia: Array, values: Array) -> Array:
    diagonal = np.diag(np.diag(inertia))
    return np.asarray(diagonal + values[0] * (inertia - diagonal))


def _has_off_diagonals(at: FaultContext) -> bool:
    inertia = at.scene.body.inertia
    off = np.max(np.abs(inertia - np.diag(np.diag(inertia))))
    return bool(off > 1e-12 * np.max(np.abs(inertia)))


def _mass_and_inertia(model: Model, values: Array, at: FaultContext) -> None:
    model.mass, model.inertia = values[0] * model.mass, values[0] * model.inertia


def _inertia_axes(permutation: list[int]) -> Fault:
    axes = ["xyz"[k] for k in permutation]

    def permuted(inertia: Array) -> Array:
        return inertia[np.ix_(permutation, permutation)]

    def applies(at: FaultContext) -> bool:
        inertia = at.scene.body.inertia
        return not np.allclose(permuted(inertia), inertia, rtol=1e-12, atol=0.0)

    return Fault(
        f"inertia-axes-{''.join(axes)}",
        "body",
        f"the axes of the inertia tensor are permuted: x, y, z as {', '.join(axes)}",
        Changed("inertia", lambda inertia, _: permuted(inertia)),
        applies=applies,
        confirm="permute the moments in the scenario: the error must change with them",
    )


def body_faults() -> Iterator[Fault]:
    """Yield the faults of mass and inertia."""
    yield Fault(
        "off-diagonals",
        "body",
        "the off-diagonals of the inertia tensor are multiplied by {0}",
        Changed("inertia", _off_diagonals),
        (FACTOR,),
        near(0.0, -1.0, 1.0),
        _has_off_diagonals,
        (
            (0.0, "the off-diagonals of the inertia tensor are dropped"),
            (-1.0, "the off-diagonals of the inertia tensor have the wrong sign"),
        ),
        confirm="compare with a body whose axes are principal: its motion must be correct",
    )
    yield from (_inertia_axes(list(order)) for order in _OTHER_ORDERS)
    yield Fault(
        "inertia-sphere",
        "body",
        "the inertia is that of a sphere: trace(I) / 3 about every axis",
        Changed("inertia", lambda inertia, _: np.eye(3) * np.trace(inertia) / 3.0),
        confirm="a sphere must move correctly",
    )
    yield Fault(
        "inertia-inverted",
        "body",
        "the inertia tensor is replaced by its inverse",
        Changed("inertia", lambda inertia, _: np.linalg.inv(inertia)),
        confirm="read the inertia back from the engine",
    )
    yield Fault(
        "inertia-in-world-axes",
        "body",
        "the inertia tensor is not rotated with the body",
        constant(inertia_in_world=1.0),
        applies=lambda at: at.rotates,
        confirm="a sphere must move correctly",
    )
    yield Fault(
        "inertia-scaled",
        "body",
        "the inertia is multiplied by {0}",
        Changed("inertia", lambda inertia, s: s[0] * inertia),
        (_POSITIVE_FACTOR,),
        near(1.0),
        lambda at: at.has_torque or at.has_moment or bool(at.scene.continuous_loads) or not at.is_free,
        confirm="apply a known torque to a body at rest and divide it by the angular acceleration",
    )
    for which, word in enumerate(("smallest", "middle", "largest")):
        yield Fault(
            f"{word}-moment",
            "body",
            f"the {word} principal moment of inertia is multiplied by {{0}}",
            Changed("inertia", _moment_scaled(which)),
            (Parameter("factor", low=1e-3, high=1e3),),
            near(1.0),
            confirm="spin the body up about this axis by a known torque",
        )
    yield Fault(
        "mass-scaled",
        "body",
        "the mass is multiplied by {0} where a force acts",
        Changed("mass", lambda mass, s: s[0] * mass),
        (_POSITIVE_FACTOR,),
        near(1.0),
        lambda at: at.has_force or bool(at.scene.continuous_loads) or not at.is_free,
        confirm="push the body at its centre of mass and divide the force by the acceleration",
    )
    yield Fault(
        "mass-and-inertia-scaled",
        "body",
        "mass and inertia are multiplied by {0}",
        _mass_and_inertia,
        (_POSITIVE_FACTOR,),
        near(1.0),
        lambda at: at.has_force and (at.has_torque or at.has_moment),
        confirm="weigh the body: compare force and acceleration",
    )


def _gravity_in_body_axes(model: Model, values: Array, at: FaultContext) -> None:
    model.gravity_body, model.gravity = model.gravity, np.zeros(3)


def _gravity_axes(permutation: list[int]) -> Fault:
    axes = ["xyz"[k] for k in permutation]
    return Fault(
        f"gravity-axes-{''.join(axes)}",
        "gravity",
        f"the axes of gravity are permuted: x, y, z as {', '.join(axes)}",
        Changed("gravity", lambda gravity, _: gravity[permutation]),
        applies=lambda at: bool(np.any(at.scene.gravity[permutation] != at.scene.gravity)),
        confirm="drop the body from rest",
    )


def gravity_faults() -> Iterator[Fault]:
    """Yield the faults of gravity."""
    yield Fault(
        "gravity",
        "gravity",
        "gravity is multiplied by {0}",
        Changed("gravity", lambda g, s: s[0] * g),
        (FACTOR,),
        near(1.0),
        lambda at: at.has_gravity,
        ((0.0, "gravity is missing"), (2.0, "gravity is applied twice"), (-1.0, "gravity is reversed")),
        confirm="drop the body from rest: its fall must be g t^2 / 2",
    )
    yield from (_gravity_axes(list(order)) for order in _OTHER_ORDERS)
    yield Fault(
        "gravity-in-body-axes",
        "gravity",
        "gravity rotates with the body",
        _gravity_in_body_axes,
        applies=lambda at: at.has_gravity,
        confirm="drop a rotating body",
    )
