from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pytest
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import MassProperties

Faces: TypeAlias = NDArray[np.int64]


class Exact(NamedTuple):
    """Volume, centre and the inertia about it as rational numbers."""

    volume: Fraction
    centre: list[Fraction]
    inertia: list[list[Fraction]]


def _exact(vertices: Array, triangles: Faces) -> Exact:
    """Integrate in integers, since every double is an integer over a power of two."""
    ratios = [[float(x).as_integer_ratio() for x in vertex] for vertex in vertices]
    unit = max(denominator for row in ratios for _, denominator in row)
    points = [[n * (unit // d) for n, d in row] for row in ratios]
    zeroth, first, second = 0, [0] * 3, [[0] * 3 for _ in range(3)]
    for i, j, k in triangles.tolist():
        a, b, c = points[i], points[j], points[k]
        d = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        )
        s = [a[p] + b[p] + c[p] for p in range(3)]
        zeroth += d
        for p in range(3):
            first[p] += d * s[p]
            for q in range(3):
                second[p][q] += d * (a[p] * a[q] + b[p] * b[q] + c[p] * c[q] + s[p] * s[q])
    volume = Fraction(zeroth, 6 * unit**3)
    centre = [Fraction(x, 24 * unit**4) / volume for x in first]
    spread = [
        [Fraction(second[p][q], 120 * unit**5) - volume * centre[p] * centre[q] for q in range(3)]
        for p in range(3)
    ]
    trace = spread[0][0] + spread[1][1] + spread[2][2]
    inertia = [[(trace if p == q else 0) - spread[p][q] for q in range(3)] for p in range(3)]
    return Exact(volume, centre, inertia)


@pytest.fixture(scope="session")
def exact_integrals() -> Callable[[Array, Faces], Exact]:
    """Return the function that computes a closed mesh's mass properties in rational numbers."""
    return _exact


def _errors(vertices: Array, triangles: Faces, found: MassProperties) -> tuple[float, float, float]:
    """Return the errors of mass, centre and inertia, relative to mass, largest coordinate and moment."""
    exact = _exact(vertices, triangles)
    farthest = Fraction(float(np.abs(vertices).max()))
    largest = max(exact.inertia[p][p] for p in range(3))
    return (
        float(abs(Fraction(found.mass) - exact.volume) / exact.volume),
        float(max(abs(Fraction(float(found.centre[p])) - exact.centre[p]) for p in range(3)) / farthest),
        float(
            max(
                abs(Fraction(float(found.inertia[p, q])) - exact.inertia[p][q])
                for p in range(3)
                for q in range(3)
            )
            / largest
        ),
    )


@pytest.fixture(scope="session")
def exact_errors() -> Callable[[Array, Faces, MassProperties], tuple[float, float, float]]:
    """Return the function that compares mass properties with rational numbers."""
    return _errors


class Meshes:
    """Closed meshes that face outward: vertices (n, 3) and triangles (m, 3)."""

    @staticmethod
    def tetrahedron() -> tuple[Array, Faces]:
        """Return the corner of the unit cube."""
        return np.vstack([np.zeros(3), np.eye(3)]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

    @staticmethod
    def box(lower: Any = (0.0, 0.0, 0.0), upper: Any = (1.0, 1.0, 1.0)) -> tuple[Array, Faces]:
        """Return a box with two triangles per face."""
        corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64)
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
        return np.asarray(lower) + corners * (np.asarray(upper) - np.asarray(lower)), np.array(triangles)

    @staticmethod
    def sphere(subdivisions: int) -> tuple[Array, Faces]:
        """Return a sphere: an octahedron whose triangles are repeatedly split in four."""
        vertices = [np.array(v, dtype=np.float64) for v in np.vstack([np.eye(3), -np.eye(3)])]
        triangles = [
            (0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5),
        ]  # fmt: skip
        for _ in range(subdivisions):
            middles: dict[tuple[int, int], int] = {}
            finer = []
            for corners in triangles:
                mid = []
                for a, b in zip(corners, corners[1:] + corners[:1], strict=True):
                    edge = (min(a, b), max(a, b))
                    if edge not in middles:
                        middle = vertices[a] + vertices[b]
                        middles[edge] = len(vertices)
                        vertices.append(middle / np.linalg.norm(middle))
                    mid.append(middles[edge])
                (a, b, c), (ab, bc, ca) = corners, mid
                finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
            triangles = finer
        return np.array(vertices), np.array(triangles)

    @staticmethod
    def grid_surface(rows: int, columns: int, point: Callable[[float, float], Any]) -> tuple[Array, Faces]:
        """Return a surface closed in both directions, point(u, v) with u and v from 0 to 2 pi."""
        angles = [
            (2 * np.pi * i / rows, 2 * np.pi * j / columns) for i in range(rows) for j in range(columns)
        ]
        triangles = []
        for i in range(rows):
            for j in range(columns):
                a, b = i * columns + j, (i + 1) % rows * columns + j
                c, d = (i + 1) % rows * columns + (j + 1) % columns, i * columns + (j + 1) % columns
                triangles += [(a, b, c), (a, c, d)]
        return np.array([point(u, v) for u, v in angles], dtype=np.float64), np.array(triangles)

    @classmethod
    def torus(cls, major: float, minor: float, rows: int, columns: int) -> tuple[Array, Faces]:
        """Return a torus about z."""

        def point(u: float, v: float) -> Any:
            rho = major + minor * np.cos(v)
            return rho * np.cos(u), rho * np.sin(u), minor * np.sin(v)

        return cls.grid_surface(rows, columns, point)

    @staticmethod
    def prism(sides: int, radius: float, length: float) -> tuple[Array, Faces]:
        """Return a regular prism about z, with two long triangles per edge of its side and fans as ends."""
        angles = 2 * np.pi * np.arange(sides) / sides
        ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
        ends = [np.column_stack([ring, np.full(sides, z)]) for z in (-0.5 * length, 0.5 * length)]
        i, j = np.arange(sides), np.roll(np.arange(sides), -1)
        side = [np.column_stack([i, j, sides + j]), np.column_stack([i, sides + j, sides + i])]
        k = np.arange(1, sides - 1)
        caps = [np.column_stack([0 * k, k + 1, k]), sides + np.column_stack([0 * k, k, k + 1])]
        return np.vstack(ends), np.vstack(side + caps)


@pytest.fixture(scope="session")
def meshes() -> type[Meshes]:
    """Return the constructors of closed meshes that face outward."""
    return Meshes


def _joined(*parts: tuple[Array, Faces]) -> tuple[Array, Faces]:
    """Return the function that joins several meshes into one."""
    offsets = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    faces = [faces + offset for (_, faces), offset in zip(parts, offsets, strict=True)]
    return np.vstack([vertices for vertices, _ in parts]), np.vstack(faces)


@pytest.fixture(scope="session")
def joined() -> Callable[..., tuple[Array, Faces]]:
    """Join several meshes into one."""
    return _joined
