"""J omega' = sum of moments about the pivot - omega x J omega: a body that rotates about a fixed point."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import rotational_energy, translational_energy
from bodycheck.reference_impl.loads.load import checked
from bodycheck.reference_impl.rational import Vector, dot, fractions
from bodycheck.reference_impl.scene import PointForce, Scene
from bodycheck.reference_impl.trajectory import Trajectory

if TYPE_CHECKING:
    from bodycheck.reference_impl.trees.tree_scene import TreeScene


def inertia_about(inertia: Vector, mass: Fraction, point: Vector) -> Vector:
    """I + m (|r|^2 1 - r r^T): shift a tensor from the centre of mass to the point r, without rounding.

    Source: Huygens and Steiner; Goldstein, Poole and Safko (2002), Classical Mechanics, equation 5.21.
    """
    square = dot(point, point)
    return [
        inertia[3 * i + j] + mass * ((square if i == j else 0) - point[i] * point[j])
        for i in range(3)
        for j in range(3)
    ]


def rotational_inertia(scene: Scene) -> Array:
    """Return the inertia tensor (3, 3) about the pivot, or the centre of mass without one, in body axes."""
    if scene.pivot is None:
        return scene.body.inertia
    body = scene.body
    about_pivot = inertia_about(fractions(body.inertia), Fraction(body.mass), fractions(scene.pivot))
    return np.array(about_pivot, dtype=np.float64).reshape(3, 3)


def kinetic_energies(scene: Scene | TreeScene, motion: Trajectory) -> tuple[Array, Array]:
    """K = 1/2 omega . I omega + 1/2 m |v|^2 and its rotational part: (n,) and (n,) in J.

    About a pivot, which is at rest, K is the rotational part alone. Of a tree, the sums over its bodies.
    """
    if not isinstance(scene, Scene):
        return scene.kinetic_energies(motion)
    rotational = rotational_energy(rotational_inertia(scene), motion.omega_body)
    if scene.pivot is not None:
        return rotational, rotational
    return rotational + translational_energy(scene.body.mass, motion.velocity_m_s), rotational


def about_pivot(scene: Scene) -> Scene:
    """J = I + m (|c|^2 E - c c^T), c from the pivot to the centre of mass; loads and weight taken about it.

    Returns a scene without pivot and link whose body rotates as the pivoted body does, provided that its
    centre of mass, placed at the pivot, is held fixed against all forces. A scene without a pivot is
    returned unchanged. Raises ValueError for a gravity gradient, which is defined about the centre of mass.
    Source: Goldstein (1980), Classical mechanics, 5-3 and 5-7.
    """
    if scene.pivot is None:
        return scene
    arm, initial = -scene.pivot, scene.initial
    place = initial.position - initial.rotation @ arm
    weight = PointForce("world", scene.body.mass * scene.gravity, arm)
    loads = [
        checked(load, "the motion about a pivot").about_pivot(scene, scene.pivot) for load in scene.loads
    ]
    return replace(
        scene,
        body=replace(scene.body, inertia=rotational_inertia(scene)),
        initial=replace(initial, position=place, velocity=np.zeros(3)),
        loads=(*loads, weight) if np.any(weight.value) else tuple(loads),
        gravity=np.zeros(3),
        pivot=None,
        link=None,
    )


def load_about(pivot: Array, load: Array) -> Array:
    """tau_b + c x F_b and moment + c F_w^T: a packed load (21,), as by `Wrench.packed`, about the pivot."""
    arm, shifted = -pivot, load.copy()
    shifted[6:9] += np.cross(arm, load[0:3])
    shifted[12:] += np.outer(arm, load[3:6]).ravel()
    return shifted
