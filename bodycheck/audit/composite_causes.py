"""Name what an importer did to one of several links that it merged: invented, lost or misplaced it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations
from typing import TypeAlias

import numpy as np

from bodycheck._util.formatting import names, number
from bodycheck.audit.audit import SINGLE, Body, Difference
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.scenarios.model_files.exact_arithmetic import Frame, doubles, identity
from bodycheck.scenarios.model_files.link_solids import parts_of, united
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink

Member: TypeAlias = tuple[ModelLink, Frame]
"""A link, and its pose in the link that it is part of."""

WATER_KG_M3 = 1000.0
"""The density that some importers give to shapes which state none."""

_MAX_SUBSETS = 6  # links: 63 sums


def composite_cause(model: ModelFile, members: Sequence[Member], expected: Body, imported: Body) -> str:
    """Return what explains mass, centre and tensor of merged links at once, or ""."""
    for cause, body in _variants(model, members):
        changes = Difference.between(expected, body).largest > SINGLE
        if changes and Difference.between(body, imported).largest <= SINGLE:
            return cause
    return ""


def invented(link: ModelLink, model: ModelFile) -> Body | None:
    """Return the body of a link's collision shapes at the density of water; None without a known volume."""
    parts = parts_of(link.collisions, model) or []
    volumes = [part.solid.mass for part in parts if part.solid is not None]
    solid = united(parts, WATER_KG_M3 * sum(volumes))
    return None if solid is None else Body(solid.mass, solid.centre, solid.inertia)


def combined(bodies: Sequence[Body]) -> Body:
    """m = sum m_k, c = sum m_k c_k / m, I = sum I_k + m_k (|d_k|^2 1 - d_k d_k^T), all in the same axes."""
    mass = sum(body.mass_kg for body in bodies)
    centre = (
        sum((body.mass_kg * body.centre_m for body in bodies), np.zeros(3)) / mass if mass else np.zeros(3)
    )
    tensor = np.zeros((3, 3))
    for body in bodies:
        tensor = tensor + body.inertia_kg_m2 + body.mass_kg * parallel_axis_tensor(body.centre_m - centre)
    return Body(mass, centre, tensor)


def placed(body: Body, frame: Frame) -> Body:
    """c' = R c + p, I' = R I R^T."""
    R, p = doubles(frame.rotation), doubles(frame.position)
    return Body(body.mass_kg, R @ body.centre_m + p, R @ body.inertia_kg_m2 @ R.T)


def _variants(model: ModelFile, members: Sequence[Member]) -> Iterator[tuple[str, Body]]:
    """Yield each cause, and the composite in the axes of the first member that it makes."""
    stated = [
        (link, frame, Body.of(link.stated.in_link)) for link, frame in members if link.stated is not None
    ]
    right = [placed(body, frame) for _, frame, body in stated]
    bare = [
        (link.name, placed(body, frame))
        for link, frame in members
        if link.stated is None and (body := invented(link, model)) is not None
    ]
    for some in _subsets(range(len(bare))):
        added = [bare[k][1] for k in some]
        mass = number(sum(body.mass_kg for body in added), 6)
        links = names([bare[k][0] for k in some])
        its = "its" if len(some) == 1 else "their"
        yield (
            (
                f"{mass} kg invented for {links}, without inertia in the file, from {its} collision shapes "
                f"at {WATER_KG_M3:g} kg/m^3"
            ),
            combined([*right, *added]),
        )
    for some in _subsets(range(1, len(stated))):
        links = names([stated[k][0].name for k in some])
        yield f"merged links lost: {links}", combined([body for k, body in enumerate(right) if k not in some])
        for what, change in _MISPLACED.items():
            moved = [
                placed(body, change(frame)) if k in some else right[k]
                for k, (_, frame, body) in enumerate(stated)
            ]
            yield f"{what}: {links}", combined(moved)


_MISPLACED: dict[str, Callable[[Frame], Frame]] = {
    "rotation of the merged links ignored": lambda frame: Frame(identity(), frame.position),
    "position of the merged links ignored": lambda frame: Frame(frame.rotation, 0 * frame.position),
    "pose of the merged links ignored": lambda frame: Frame(identity(), 0 * frame.position),
    "pose of the merged links inverted": Frame.inverse,
}


def _subsets(items: range) -> Iterator[tuple[int, ...]]:
    """Yield all items, then every smaller choice of them, or single ones if there are many."""
    if len(items) > 1:
        yield tuple(items)
    sizes = range(len(items) - 1, 0, -1) if 1 < len(items) <= _MAX_SUBSETS else (1,)
    for size in sizes:
        yield from combinations(items, size)
