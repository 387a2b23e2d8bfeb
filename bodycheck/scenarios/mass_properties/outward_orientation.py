"""Orient triangles consistently, closed surfaces outward and cavities inward, where that is unambiguous."""

from __future__ import annotations

from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.formatting import vector
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.scenarios.mass_properties.containment import Containment, containment
from bodycheck.scenarios.mass_properties.edges import described
from bodycheck.scenarios.mass_properties.polyhedron import volume_area_reach
from bodycheck.scenarios.mass_properties.solid import Overlap, Triangles

_UNVISITED = -1
_NONE = -1


class Surfaces(NamedTuple):
    """Triangles (m, 3), consistent within each surface; the surface (m,) of each; which (m,) were flipped."""

    triangles: Triangles
    surface: NDArray[np.int32]
    flipped: NDArray[np.bool_]


def consistent(vertices: Array, triangles: Triangles, partner: NDArray[np.int32]) -> Surfaces:
    """Flip the fewest triangles that make each connected surface consistent, facing outward or inward.

    Shapes: (n, 3), (m, 3), (3 m,) from edges.partners. Raises ValueError naming an edge where a surface has
    only one side (it contains a Möbius band or Klein bottle).
    """
    surface, flipped, conflict = _spread(triangles, partner)
    if conflict != _NONE:
        raise ValueError(
            "the mesh is not orientable: its surface has one side only; the two sides meet on the edge "
            + described(vertices, triangles, conflict)
        )
    minority = 2 * np.bincount(surface[flipped], minlength=surface.max() + 1) > np.bincount(surface)
    flipped = flipped != minority[surface]
    return Surfaces(with_flipped(triangles, flipped), surface, flipped)


def with_flipped(triangles: Triangles, flipped: NDArray[np.bool_]) -> Triangles:
    """Return the triangles (m, 3), with the orientation reversed of those selected by flipped (m,)."""
    return np.where(flipped[:, None], triangles[:, ::-1], triangles) if flipped.any() else triangles


@kernel
def _spread(
    triangles: Triangles, partner: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.bool_], int]:
    """Walk each surface from its first triangle over every edge, flipping triangles that disagree.

    Returns the surface (m,) of each triangle, which triangles (m,) are flipped, and a half-edge at which two
    visited triangles still disagree, or -1.
    """
    count = len(partner) // 3
    start = triangles.ravel()
    surface = np.full(count, _UNVISITED, dtype=np.int32)
    flipped = np.zeros(count, dtype=np.bool_)
    stack = np.empty(count, dtype=np.int32)
    surfaces = 0
    for seed in range(count):
        if surface[seed] != _UNVISITED:
            continue
        surface[seed] = surfaces
        stack[0] = seed
        waiting = 1
        while waiting > 0:
            waiting -= 1
            here = stack[waiting]
            for half_edge in range(3 * here, 3 * here + 3):
                there = partner[half_edge] // 3
                agreeing = start[half_edge] != start[partner[half_edge]]
                should_be = flipped[here] == agreeing
                if surface[there] == _UNVISITED:
                    surface[there] = surfaces
                    flipped[there] = should_be
                    stack[waiting] = there
                    waiting += 1
                elif flipped[there] != should_be:
                    return surface, flipped, half_edge
        surfaces += 1
    return surface, flipped, _NONE


_FLAT = 1e-14
"""A volume below this fraction of area times reach is round-off."""


class Orientation(NamedTuple):
    """Which triangles (m,), consistent within their surfaces, must be flipped, and the notes on that."""

    wrong: NDArray[np.bool_]
    notes: tuple[str, ...]


def outward_orientation(vertices: Array, surfaces: Surfaces, overlap: Overlap = "refuse") -> Orientation:
    """Return which triangles must be flipped for the surfaces to bound a solid; vertices (n, 3) in m.

    A surface within an even number of others bounds matter and faces outward. A surface within an odd number
    is a cavity and faces inward. A wholly inside-out mesh may be reoriented, and so may any surface that lies
    within no other and crosses none. Raises ValueError where a surface encloses nothing, where two cross, and
    where one within another does not face as a cavity: it may be a cavity drawn inside-out, or matter drawn
    twice. If the overlap is "count-twice", surfaces may cross, and surfaces that face outward may lie within
    matter.
    """
    members = _members(surfaces.surface)
    parts = [surfaces.triangles[rows] for rows in members] if len(members) > 1 else [surfaces.triangles]
    outward = np.array([_is_outward(vertices, part) for part in parts])
    found = containment(vertices, parts, outward, overlap)
    repaired = np.array([surfaces.flipped[rows].any() for rows in members])
    wrong = outward != (found.depth % 2 == 0)
    if not wrong.all() or repaired.any():
        if overlap == "count-twice":
            wrong = ~outward & (found.winding < 1)
        ambiguous = np.flatnonzero((wrong | repaired) & ((found.depth > 0) | found.crossing))
        if len(ambiguous):
            _refuse(vertices, parts[ambiguous[0]], crossing=bool(found.crossing[ambiguous[0]]))
    return Orientation(
        wrong[surfaces.surface], _parts_note(found, int(np.sum(outward & (found.winding > 0))))
    )


def _members(surface: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Return the triangles of each surface, ascending."""
    if not surface.any():
        return [np.arange(len(surface))]
    order = np.argsort(surface, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(surface[order])) + 1)


def _is_outward(vertices: Array, triangles: Triangles) -> bool:
    """Return whether a closed surface faces outward; raise ValueError if it encloses nothing."""
    volume, area, reach = volume_area_reach(vertices, triangles)
    if abs(volume) <= _FLAT * area * reach:
        where = vector(vertices[triangles[0, 0]])
        raise ValueError(f"the mesh is degenerate: the closed surface at {where} encloses no volume")
    return bool(volume > 0.0)


def _refuse(vertices: Array, triangles: Triangles, *, crossing: bool) -> NoReturn:
    """Raise ValueError naming a surface that may bound matter or void."""
    where = vector(vertices[triangles[0, 0]])
    if crossing:
        raise ValueError(
            f"the mesh is ambiguous: the closed surface at {where} crosses another and does not face "
            "outward; it may be one drawn inside-out, or a cut"
        )
    raise ValueError(
        f"the mesh is ambiguous: the closed surface at {where} lies within another and does not face as "
        "a cavity; it may be one drawn inside-out, or matter drawn twice (--overlap count-twice, or "
        'mesh_overlap = "count-twice" in a scenario)'
    )


def _parts_note(found: Containment, within_matter: int) -> tuple[str, ...]:
    """Return a note on the number of closed surfaces, if more than one, and on their overlaps."""
    parts = len(found.depth)
    if parts == 1:
        return ()
    shared = [
        f"{found.pairs} crossing pairs are among them" if found.pairs else "none was found to cross another",
        *([f"{within_matter} lie within matter"] if within_matter else []),
    ]
    counted = ": what they share counts as often as it is drawn" if found.pairs or within_matter else ""
    return (f"the mesh has {parts} closed surfaces; {' and '.join(shared)}{counted}",)
