"""A body that turns about a point of its own: the numbers that are taken about that point."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import rotational_energy, translational_energy
from bodycheck.reference_impl.rational import Vector, dot, fractions
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory


def inertia_about(inertia: Vector, mass: Fraction, point: Vector) -> Vector:
    """I + m (|r|^2 1 - r r^T): a tensor about the centre of mass as it is about r, without rounding.

    Source: Huygens and Steiner; Goldstein, Poole and Safko (2002), Classical Mechanics, equation 5.21.
    """
    square = dot(point, point)
    return [
        inertia[3 * i + j] + mass * ((square if i == j else 0) - point[i] * point[j])
        for i in range(3)
        for j in range(3)
    ]


def turning_inertia(scene: Scene) -> Array:
    """Return the tensor (3, 3) in body axes about what the body turns about: its pivot, else its centre."""
    if scene.pivot is None:
        return scene.body.inertia
    body = scene.body
    about_pivot = inertia_about(fractions(body.inertia), Fraction(body.mass), fractions(scene.pivot))
    return np.array(about_pivot, dtype=np.float64).reshape(3, 3)


def kinetic_energies(scene: Scene, motion: Trajectory) -> tuple[Array, Array]:
    """K = 1/2 omega . I omega + 1/2 m |v|^2 and its first, rotational, part: (n,) and (n,) in J.

    About a pivot, which is at rest, K is the rotational part alone.
    """
    rotational = rotational_energy(turning_inertia(scene), motion.omega_body)
    if scene.pivot is not None:
        return rotational, rotational
    return rotational + translational_energy(scene.body.mass, motion.velocity_m_s), rotational
