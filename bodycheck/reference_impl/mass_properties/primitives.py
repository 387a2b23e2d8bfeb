"""Closed forms: solids of unit density, centred at the origin, their axis of symmetry along z.

Source: volume integrals done by hand; the tests hold them to 1e-15 against numerical ones of 30 digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.mass_properties.solid import LENGTHS, MassProperties


@dataclass(frozen=True)
class Primitive:
    """The names of a shape's sizes, in m, in the order in which they are given, and its closed form."""

    sizes: tuple[str, ...]
    closed_form: Callable[..., MassProperties]


def _centred(mass: float, *moments: float) -> MassProperties:
    """Return a body with its centre at the origin and its principal axes along x, y, z."""
    return MassProperties(mass, np.zeros(3), np.diag(moments))


def box(x: float, y: float, z: float) -> MassProperties:
    """V = x y z, I_x = V (y^2 + z^2) / 12; full edges."""
    volume = x * y * z
    moments = (volume / 12.0 * (p * p + q * q) for p, q in ((y, z), (z, x), (x, y)))
    return _centred(volume, *moments)


def ellipsoid(a: float, b: float, c: float) -> MassProperties:
    """V = 4/3 pi a b c, I_x = V (b^2 + c^2) / 5; semi-axes."""
    volume = 4.0 / 3.0 * math.pi * a * b * c
    moments = (volume / 5.0 * (p * p + q * q) for p, q in ((b, c), (c, a), (a, b)))
    return _centred(volume, *moments)


def sphere(radius: float) -> MassProperties:
    """V = 4/3 pi r^3, I = 2/5 V r^2."""
    return ellipsoid(radius, radius, radius)


def cylinder(radius: float, length: float) -> MassProperties:
    """V = pi r^2 l, I_z = V r^2 / 2, I_x = V (r^2 / 4 + l^2 / 12)."""
    volume = math.pi * radius**2 * length
    across = volume * (radius**2 / 4.0 + length**2 / 12.0)
    return _centred(volume, across, across, volume * radius**2 / 2.0)


def capsule(radius: float, length: float) -> MassProperties:
    """Cylinder C and sphere S, I_z = C_z + S_z, I_x = C_x + S_x + S (l^2 / 4 + 3 l r / 8).

    The length is that of the cylindrical part; the last term moves either hemisphere, its own centre 3 r / 8
    from its base, to that part's end.
    """
    core, ends = cylinder(radius, length), sphere(radius)
    moved = ends.mass * (length**2 / 4.0 + 3.0 * length * radius / 8.0)
    moments = np.diagonal(core.inertia + ends.inertia) + np.array([moved, moved, 0.0])
    return _centred(core.mass + ends.mass, *moments)


def torus(major: float, minor: float) -> MassProperties:
    """V = 2 pi^2 R r^2, I_z = V (R^2 + 3/4 r^2), I_x = V (R^2 / 2 + 5/8 r^2), R >= r.

    R runs to the middle of the tube, r is the tube's. Raises ValueError where the tube would meet itself.
    """
    if major < minor:
        raise ValueError(f"the major radius {major!r} m must not be less than the minor one, {minor!r} m")
    volume = 2.0 * math.pi**2 * major * minor**2
    across = volume * (major**2 / 2.0 + 5.0 / 8.0 * minor**2)
    return _centred(volume, across, across, volume * (major**2 + 3.0 / 4.0 * minor**2))


PRIMITIVES: dict[str, Primitive] = {
    "box": Primitive(("edge along x", "edge along y", "edge along z"), box),
    "sphere": Primitive(("radius",), sphere),
    "ellipsoid": Primitive(("semi-axis along x", "semi-axis along y", "semi-axis along z"), ellipsoid),
    "cylinder": Primitive(("radius", "length"), cylinder),
    "capsule": Primitive(("radius", "length of the cylindrical part"), capsule),
    "torus": Primitive(("major radius", "minor radius"), torus),
}


def known_shape(shape: str) -> str:
    """Return the name of a primitive as it stands. Raises ValueError, with the names, where there is none."""
    if shape not in PRIMITIVES:
        raise ValueError(f"no shape is named {shape!r}; there are {', '.join(PRIMITIVES)}")
    return shape


def primitive(shape: str, size: Sequence[float]) -> MassProperties:
    """Return the mass properties, at unit density, of a primitive by its name and sizes in m.

    Raises ValueError for a name or a number of sizes that there is not, sizes that are not positive and
    finite, the largest of them beyond LENGTHS, and a torus whose tube meets itself.
    """
    known = PRIMITIVES[known_shape(shape)]
    if len(size) != len(known.sizes):
        raise ValueError(
            f"a {shape} has {len(known.sizes)} sizes ({', '.join(known.sizes)}), not {len(size)}"
        )
    for name, value in zip(known.sizes, size, strict=True):
        if not 0.0 < value < math.inf:
            raise ValueError(f"the {name} of a {shape} must be positive and finite, not {value!r}")
    largest = max(size)
    if not LENGTHS[0] < largest < LENGTHS[1]:
        raise ValueError(
            f"the largest size of a {shape} must be within {LENGTHS[0]} to {LENGTHS[1]} m, not {largest!r}"
        )
    return known.closed_form(*map(float, size))
