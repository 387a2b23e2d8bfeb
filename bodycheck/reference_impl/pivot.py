"""A body that turns about a point of its own: the numbers that are taken about that point.

The words work on rational numbers, which lose nothing, as on doubles.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import rotational_energy, translational_energy
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory


def inertia_about(inertia: list[Fraction], mass: Fraction, point: list[Fraction]) -> list[Fraction]:
    """I + m (|r|^2 1 - r r^T): a tensor about the centre of mass, nine numbers, as it is about r (3,).

    Source: Huygens and Steiner; Goldstein, Poole and Safko (2002), Classical Mechanics, equation 5.21.
    """
    square = sum((r * r for r in point), Fraction(0))
    return [
        inertia[3 * i + j] + mass * ((square if i == j else 0) - point[i] * point[j])
        for i in range(3)
        for j in range(3)
    ]


def rotation_of(quaternion: list[Fraction]) -> list[list[Fraction]]:
    """R(q / |q|), row by row, without rounding: the norm enters by its square alone."""
    w, x, y, z = quaternion
    s = 2 / (w * w + x * x + y * y + z * z)
    return [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]


def turning_inertia(scene: Scene) -> Array:
    """Return the tensor (3, 3) in body axes about what the body turns about: its pivot, else its centre."""
    if scene.pivot is None:
        return scene.body.inertia
    mass = Fraction(scene.body.mass)
    about_centre = [Fraction(float(x)) for x in scene.body.inertia.flat]
    about_pivot = inertia_about(about_centre, mass, [Fraction(float(x)) for x in scene.pivot])
    return np.array(about_pivot, dtype=np.float64).reshape(3, 3)


def kinetic_energies(scene: Scene, motion: Trajectory) -> tuple[Array, Array]:
    """K = 1/2 omega . I omega + 1/2 m |v|^2 and its first, rotational, part: (n,) and (n,) in J.

    About a pivot, which is at rest, K is the rotational part alone.
    """
    rotational = rotational_energy(turning_inertia(scene), motion.omega_body)
    if scene.pivot is not None:
        return rotational, rotational
    return rotational + translational_energy(scene.body.mass, motion.velocity_m_s), rotational
