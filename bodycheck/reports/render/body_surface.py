"""The surface of a body as polygons, for the report and animations: its mesh, its primitive, or a box."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.scene import RigidBody
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeBody, TreeScene
from bodycheck.scenarios.body import Body, MeshBody, ShapeBody
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files.decimation import read_obj_text
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import AnyScenario
from bodycheck.scenarios.shapes import UNITS

REACH = 0.9
"""The distance of the farthest vertex from the centre of mass."""

AROUND = 24
"""Polygons around the axis of a primitive: a multiple of 4, so that quadrants have borders."""

_THINNEST = 0.06  # of the longest edge: a plate without thickness would be invisible from its side
_COPLANAR = 1e-6  # largest 1 - |n . n'| of two faces that are one polygon
_FACING = 0.9  # least component of the normal of a marked face along the axis of the largest moment
BOX_FACES = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))


@dataclass(frozen=True, eq=False)
class BodySurface:
    """A closed surface about the centre of mass, in body axes, scaled to REACH.

    vertices: (n, 3). faces: the vertices of each polygon, counter-clockwise seen from outside. marked: the
    faces in a stronger colour, which make the orientation visible. name: the shape in words.
    """

    vertices: Array
    faces: tuple[tuple[int, ...], ...]
    marked: frozenset[int]
    name: str

    def polygons(self, rotation: Array) -> list[Array]:
        """Return the corners (k, 3) of each face after a rotation (3, 3) from body to world axes."""
        rotated = self.vertices @ rotation.T
        return [rotated[list(face)] for face in self.faces]


def surface_of(body: Body) -> BodySurface:
    """Return the surface of a scenario's body; of a body given by numbers, a box of the same inertia."""
    rigid = RigidBody(body.mass_kg, np.array(body.inertia_kg_m2))
    match body:
        case MeshBody() if body.mesh.surface:
            vertices, triangles = read_obj_text(body.mesh.surface)
            vertices = vertices * float(UNITS[body.mesh_unit or "m"]) - body.solid.centre
            faces = polygons_of(vertices, triangles)
            _, axes = diagonalised(rigid.inertia)
            facing = [
                number
                for number, face in enumerate(faces)
                if normal(vertices[list(face)]) @ axes[:, 2] > _FACING
            ]
            return _scaled(vertices, faces, facing, f"the mesh {body.mesh.name}")
        case ShapeBody(shape="box"):
            vertices = 0.5 * _SIGNS * np.array(body.size_m)
            return _scaled(vertices, BOX_FACES, (1,), "a box")
        case ShapeBody():
            return _of_revolution(body.shape, body.size_m)
    return BodySurface(box_corners(rigid), BOX_FACES, frozenset((1,)), "a box of the same inertia")


def _scaled(
    vertices: Array, faces: Sequence[tuple[int, ...]], marked: Sequence[int], name: str
) -> BodySurface:
    farthest = float(np.max(np.linalg.norm(vertices, axis=1)))
    return BodySurface(vertices * (REACH / farthest), tuple(faces), frozenset(marked), name)


_SIGNS = np.array([[2.0 * (k >> i & 1) - 1.0 for i in range(3)] for k in range(8)])


@dataclass(frozen=True, eq=False)
class DrawnBodies:
    """What a motion is drawn with: the surface of each body, and where a picture that reaches 1 is centred.

    scale: of places in m; 0 for one body, whose rotation alone is drawn.
    """

    surfaces: tuple[BodySurface, ...]
    middle: Array
    scale: float

    @classmethod
    def of(cls, scenario: AnyScenario, truth: Trajectory) -> DrawnBodies:
        """Return the surface of a body, or the boxes of the bodies of a tree, to scale."""
        scene = scenario.scene
        if not isinstance(scene, TreeScene):
            assert isinstance(scenario, Scenario)
            return cls((surface_of(scenario.body),), np.zeros(3), 0.0)
        places = truth.position_m
        middle = 0.5 * (places.max(axis=(0, 1)) + places.min(axis=(0, 1)))
        boxes = [tree_box(body) for body in scene.bodies]
        sizes = [float(np.max(np.linalg.norm(box, axis=1))) for box in boxes]
        reach = float(np.max(np.linalg.norm(places - middle, axis=-1).max(axis=0) + sizes))
        surfaces = (BodySurface(box / reach, BOX_FACES, frozenset((1,)), "a box") for box in boxes)
        return cls(tuple(surfaces), middle, 1.0 / reach)

    def polygons(self, motion: Trajectory, k: int) -> list[Array]:
        """Return the corners (m, 3) of all faces at sample k."""
        if not self.scale:
            return self.surfaces[0].polygons(motion.rotation_matrices[k])
        places = self.scale * (motion.position_m[k] - self.middle)
        parts = zip(self.surfaces, motion.rotation_matrices[k], places, strict=True)
        return [corners + x for one, R, x in parts for corners in one.polygons(R)]


def tree_box(body: TreeBody) -> Array:
    """Return the corners (8, 3) of the box of uniform density with this inertia, in m, body axes.

    Sum of the squares of its edges = 6 tr I / m. A body without mass has none: its corners are 0.
    """
    if not body.mass:
        return np.zeros((8, 3))
    corners = box_corners(RigidBody(body.mass, body.inertia))
    return np.asarray(corners * math.sqrt(1.5 * float(np.trace(body.inertia)) / body.mass) / REACH)


def box_corners(body: RigidBody) -> Array:
    """a_i^2 ~ I_j + I_k - I_i: the corners (8, 3) of the box with this tensor, body axes, at distance REACH.

    The edges of the box have the same proportions as the axes of the solid ellipsoid with this tensor.
    """
    moments, axes = diagonalised(body.inertia)
    edges = np.sqrt(np.maximum(moments.sum() - 2.0 * moments, 0.0))
    edges = np.maximum(edges, _THINNEST * edges.max())
    return np.asarray(REACH * (_SIGNS * edges / np.linalg.norm(edges)) @ axes.T)


def _of_revolution(shape: str, sizes: Sequence[float]) -> BodySurface:
    """Return a primitive with its axis along z; every second octant is marked."""
    axis_scales = np.ones(3)
    angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, AROUND // 2 + 1)
    arc = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    match shape:
        case "sphere":
            profile = arc
        case "ellipsoid":
            profile, axis_scales = arc, np.array(sizes)
        case "cylinder":
            radius, half = sizes[0], 0.5 * sizes[1]
            profile = np.array([[0.0, -half], [radius, -half], [radius, 0.0], [radius, half], [0.0, half]])
        case "capsule":
            lower, upper = np.split(sizes[0] * arc, [AROUND // 4 + 1])
            shift, equator = np.array([0.0, 0.5 * sizes[1]]), lower[-1:]
            profile = np.concatenate([lower - shift, equator, equator + shift, upper + shift])
        case "torus":
            circle = np.linspace(-np.pi, np.pi, AROUND // 2 + 1)
            profile = np.stack([sizes[0] + sizes[1] * np.cos(circle), sizes[1] * np.sin(circle)], axis=1)
        case _:
            raise ValueError(f"unknown shape {shape!r}")
    vertices, faces = _revolved(profile)
    vertices = vertices * axis_scales
    centres = np.array([vertices[list(face)].mean(axis=0) for face in faces])
    marked = np.flatnonzero(np.prod(np.sign(centres), axis=1) > 0.0).tolist()
    return _scaled(vertices, faces, marked, f"{'an' if shape == 'ellipsoid' else 'a'} {shape}")


def _revolved(profile: Array) -> tuple[Array, list[tuple[int, ...]]]:
    """Rotate a profile (k, 2) of radius and height, upwards on the outside, about the z axis."""
    around = 2.0 * np.pi * np.arange(AROUND) / AROUND
    radii, heights = profile.T
    points = np.stack(
        [
            np.outer(radii, np.cos(around)),
            np.outer(radii, np.sin(around)),
            np.repeat(heights[:, None], AROUND, axis=1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    decimals = 9 - int(np.floor(np.log10(np.max(np.abs(points)))))
    _, first, numbers = np.unique(
        np.round(points, decimals) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    grid = numbers.reshape(len(profile), AROUND)
    quads = (
        (grid[i, j], grid[i, j - AROUND + 1], grid[i + 1, j - AROUND + 1], grid[i + 1, j])
        for i in range(len(profile) - 1)
        for j in range(AROUND)
    )
    distinct = (tuple(dict.fromkeys(int(corner) for corner in quad)) for quad in quads)
    return points[first], [face for face in distinct if len(face) > 2]


def normal(corners: Array) -> Array:
    """n ~ sum x_i x x_(i+1): the unit normal (3,) of a polygon (k, 3), concave or not; 0 if its area is."""
    twice = np.sum(np.cross(corners - corners[0], np.roll(corners, -1, axis=0) - corners[0]), axis=0)
    area = float(np.linalg.norm(twice))
    return np.asarray(twice / area if area > 0.0 else twice)


def polygons_of(vertices: Array, triangles: Triangles) -> list[tuple[int, ...]]:
    """Join the triangles (m, 3) of each plane region to its outline; a region with holes keeps its triangles.

    Fans of concave polygons have triangles outside their outline, with the opposite sense; joined, these
    cancel.
    """
    normals = np.array([normal(vertices[corners]) for corners in triangles])
    faces: list[tuple[int, ...]] = []
    for region in _plane_regions(triangles, normals):
        corners = [tuple(triangles[k].tolist()) for k in region]
        outline = _outline(corners)
        faces += (
            [face for face, k in zip(corners, region, strict=True) if np.any(normals[k])]
            if outline is None
            else [outline]
        )
    return faces


def _plane_regions(triangles: Triangles, normals: Array) -> list[list[int]]:
    """Return the triangles of each connected plane region.

    A degenerate triangle, whose normal is 0, has the plane of most of its neighbours.
    """
    by_edge: dict[tuple[int, int], list[int]] = {}
    for k, (a, b, c) in enumerate(triangles.tolist()):
        for edge in ((a, b), (b, c), (c, a)):
            by_edge.setdefault((min(edge), max(edge)), []).append(k)
    neighbours: list[list[int]] = [[] for _ in triangles]
    for one, other in (pair for sharing in by_edge.values() for pair in pairwise(sharing)):
        neighbours[one].append(other)
        neighbours[other].append(one)
    planes = normals.copy()
    for k in np.flatnonzero(~np.any(normals, axis=1)).tolist():
        if not neighbours[k]:
            continue
        around = normals[neighbours[k]]
        planes[k] = around[np.argmax(np.count_nonzero(_parallel(around @ around.T), axis=0))]
    regions: list[list[int]] = []
    visited: set[int] = set()
    for start in range(len(triangles)):
        region: list[int] = []
        open_planes = [start]
        while open_planes:
            if (k := open_planes.pop()) in visited:
                continue
            visited.add(k)
            region.append(k)
            open_planes += [n for n in neighbours[k] if n not in visited and _parallel(planes[k] @ planes[n])]
        regions += [region] if region else []
    return regions


def _parallel(cosines: Array) -> Any:
    return np.abs(cosines) > 1.0 - _COPLANAR


def _outline(triangles: Sequence[tuple[int, ...]]) -> tuple[int, ...] | None:
    """Return the edges that no two triangles share in opposite directions, if they are one closed path."""
    edges = Counter((t[i], t[i - 2]) for t in triangles for i in range(3))
    edges.subtract([(end, start) for start, end in edges.elements()])
    after = list((+edges).elements())
    following = dict(after)
    if not after or len(following) < len(after):
        return None
    path = [after[0][0]]
    while (corner := following[path[-1]]) != path[0]:
        path.append(corner)
    return tuple(path) if len(path) == len(after) else None
