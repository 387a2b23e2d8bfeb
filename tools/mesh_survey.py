"""Check every mesh of a folder: each refusal by another reader, each solid by rational arithmetic.

    python tools/mesh_survey.py --most-triangles 20000 --json survey.json

Reads all mesh files of a folder, by default those of pybullet_data. The accepted triangles are integrated
again in integers (every double is an integer over a power of two): mass, centre and inertia must agree to
1e-15 (relative to the mass, the largest distance, the largest moment). A refused file is read again by
trimesh, which joins corners closer than 1e-8, and explained:

  open      trimesh finds edges of one triangle too, and its own hole test reports a mesh that is not closed
  not a surface   trimesh finds edges of more than two triangles too
  overlapping  a computation in fractions finds an edge of one part that passes through the inside of a
             triangle of another
  crosses itself  the same within one part
  unreadable trimesh cannot read it either, or has coordinates that are not finite

A refusal without such an explanation is wrong. With --overlap count-twice, overlapping parts are accepted;
the mass must be trimesh's volume of the whole mesh or, if parts were reversed, the sum of the volumes of its
closed parts, to 1e-8. Needs pybullet, and trimesh from the extra "bench". Prints a row per kind. Exit status
1 if a refusal is wrong or an error too large.
"""

from __future__ import annotations

import logging
from collections import Counter
from fractions import Fraction
from json import dumps
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pybullet_data
import trimesh
from trials import command

from benchmarks.exact_solid import exact_solid
from bodycheck._util.errors import InputError
from bodycheck.scenarios.mass_properties.mesh_check import Mesh, checked_mesh
from bodycheck.scenarios.mass_properties.polyhedron import polyhedron
from bodycheck.scenarios.mesh_files import MESH_SUFFIXES, open_mesh, parse_mesh

_TOLERANCE = 1e-15

_OTHER_READER = 1e-8
"""trimesh joins corners that are closer than this, in the unit of the file."""


class Row(NamedTuple):
    """The result for a file: accepted or a kind of refusal, its explanation, and the largest error."""

    file: str
    kind: str
    why: str
    explained: bool
    error: float | None = None


def survey(path: Path, name: str, most: int) -> Row:
    """Read a file and return its result."""
    try:
        with open_mesh(path) as file:
            vertices, triangles = parse_mesh(path, file)
    except InputError as error:
        return Row(name, "unreadable", str(error).removeprefix(f"{path}: "), _unreadable(path))
    try:
        mesh = checked_mesh(vertices, triangles)
    except ValueError as error:
        return _refused(path, name, vertices, triangles, str(error))
    if mesh.crossing is not None:
        other = _loaded(path)
        return Row(name, "crosses itself", str(mesh.crossing), other is not None and _pierces(other, other))
    kind = "accepted, slits joined" if any("round-off" in note for note in mesh.notes) else "accepted"
    return Row(name, kind, "; ".join(mesh.notes), True, _error(mesh) if len(mesh.triangles) <= most else None)


def _error(mesh: Mesh) -> float:
    """Return the largest error relative to rational arithmetic."""
    found = polyhedron(mesh.vertices, mesh.triangles)
    return float(exact_solid(mesh.vertices, mesh.triangles).error(found))


def _refused(path: Path, name: str, vertices: Any, triangles: Any, why: str) -> Row:
    """Check a refused mesh with another reader."""
    other = _loaded(path)
    match why:
        case _ if "is not finite" in why:
            return Row(name, "unreadable", why, other is None or not np.isfinite(other.vertices).all())
        case _ if "is open" in why:
            once = _edge_counts(other)[1] if other else 0
            return Row(name, "open", f"{once} open edges by trimesh", once > 0 and not other.is_watertight)
        case _ if "not a surface" in why:
            more = sum(count for shared, count in _edge_counts(other).items() if shared > 2)
            return Row(name, "not a surface", f"{more} edges of three or more by trimesh", more > 0)
        case _ if "ambiguous" in why:
            return _overlapping(name, vertices, triangles, other)
    return Row(name, "other", why, False)


def _loaded(path: Path) -> Any:
    """Return the mesh as trimesh reads it, corners joined whatever their normals and textures, or None."""
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
        mesh.update_faces(mesh.nondegenerate_faces(height=None))
    except Exception as error:  # noqa: BLE001 - any error means that it cannot read the file
        print(f"  trimesh: {path.name}: {error}")
        return None
    return mesh


def _unreadable(path: Path) -> bool:
    other = _loaded(path)
    return other is None or not len(other.faces) or not other.is_watertight


def _edge_counts(mesh: Any) -> Counter[int]:
    """Return how many edges belong to one triangle, to two, and so on."""
    _, count = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    return Counter(count.tolist())


def _overlapping(name: str, vertices: Any, triangles: Any, other: Any) -> Row:
    """Check that parts really overlap, and that counting the overlap twice gives the sum of the parts."""
    proof = "an edge passes through a triangle" if _parts_cross(other) else "no crossing found"
    try:
        mesh = checked_mesh(vertices, triangles, "count-twice")
    except ValueError as error:
        return Row(name, "overlapping, also refused by count-twice", str(error), _parts_cross(other))
    mass, parts = polyhedron(mesh.vertices, mesh.triangles).mass, other.split(repair=False)
    sums = abs(other.volume), sum(abs(part.volume) for part in parts)
    agrees = min(abs(mass - volume) for volume in sums) <= _OTHER_READER * mass
    why = f"{proof}; the mass {'agrees' if agrees else 'disagrees'} with trimesh"
    return Row(name, "overlapping", why, proof.startswith("an edge") and agrees, _error(mesh))


def _parts_cross(mesh: Any) -> bool:
    """Return whether an edge of one part passes through a triangle of another, in exact arithmetic."""
    parts = mesh.split(only_watertight=False, repair=False)
    boxes = np.array([part.bounds for part in parts])
    for i, one in enumerate(parts):
        near = np.all((boxes[:, 0] <= boxes[i, 1]) & (boxes[i, 0] <= boxes[:, 1]), axis=1)
        if any(i != j and _pierces(one, parts[j]) for j in np.flatnonzero(near).tolist()):
            return True
    return False


def _pierces(one: Any, other: Any) -> bool:
    """Return whether an edge of one passes through the inside of a triangle of the other, exactly."""
    lower, upper = other.triangles.min(axis=1), other.triangles.max(axis=1)
    ends = one.vertices[one.edges_unique]
    low, high = ends.min(axis=1), ends.max(axis=1)
    for edge in np.flatnonzero(np.all((low <= upper.max(axis=0)) & (high >= lower.min(axis=0)), axis=1)):
        for face in np.flatnonzero(np.all((lower <= high[edge]) & (upper >= low[edge]), axis=1)):
            if _through(*_rational(ends[edge]), *_rational(other.triangles[face])):
                return True
    return False


def _rational(points: Any) -> list[list[Fraction]]:
    return [[Fraction(float(x)) for x in point] for point in points]


def _through(p: Any, q: Any, a: Any, b: Any, c: Any) -> bool:
    """Return whether the segment pq passes through the inside of the triangle abc."""
    if _volume(a, b, c, p) * _volume(a, b, c, q) >= 0:
        return False
    around = [_volume(p, q, a, b), _volume(p, q, b, c), _volume(p, q, c, a)]
    return all(x > 0 for x in around) or all(x < 0 for x in around)


def _volume(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Return the sign of the volume of abcd, from 6 times the volume."""
    (u1, u2, u3), (v1, v2, v3), (w1, w2, w3) = (
        [x - y for x, y in zip(point, a, strict=True)] for point in (b, c, d)
    )
    return u1 * (v2 * w3 - v3 * w2) - u2 * (v1 * w3 - v3 * w1) + u3 * (v1 * w2 - v2 * w1)


def main(
    most_triangles: int = 20000,
    every: int = 1,
    folder: Path | None = None,
    json: Path | None = None,
) -> bool:
    """Print the results; most_triangles: limit for exact integrals; every: of random_urdfs; json: of all."""
    logging.disable(logging.WARNING)
    folder = folder or Path(pybullet_data.getDataPath())
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in MESH_SUFFIXES)
    random = [path for path in files if "random_urdfs" in path.parts]
    files = [path for path in files if "random_urdfs" not in path.parts] + random[::every]
    rows = []
    for path in files:
        rows.append(survey(path, str(path.relative_to(folder)), most_triangles))
        if not rows[-1].explained or (rows[-1].error or 0.0) > _TOLERANCE:
            print(rows[-1], flush=True)
    if json is not None:
        json.write_text(dumps([row._asdict() for row in rows], indent=1))
    return _summed_up(rows)


def _summed_up(rows: list[Row]) -> bool:
    """Print a row per kind, and return whether something is wrong."""
    print(f"{'kind':40} files unexplained  checked by fractions  largest error")
    for kind, count in sorted(Counter(row.kind for row in rows).items()):
        of_kind = [row for row in rows if row.kind == kind]
        errors = [row.error for row in of_kind if row.error is not None]
        unexplained = sum(not row.explained for row in of_kind)
        print(f"{kind:40} {count:5} {unexplained:11} {len(errors):21}  {max(errors, default=0.0):.1e}")
    wrong = [row for row in rows if not row.explained or (row.error or 0.0) > _TOLERANCE]
    print(f"{len(rows)} files; refused wrongly or with too large an error: {len(wrong)}")
    return bool(wrong)


if __name__ == "__main__":
    command(main)
