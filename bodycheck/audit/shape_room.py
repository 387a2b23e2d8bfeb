"""Findings about a link's mass and its centre in the link's shapes: density, and where mass can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bodycheck._util.formatting import number, vector
from bodycheck.audit.audit import LintFinding
from bodycheck.audit.shaped_link import CENTRE_OFF, EXPLAINED, Shaped, near
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files.link_solids import Part
from bodycheck.scenarios.shapes import DENSITIES

IN_MM = "a mass in kg, and shapes in m: are these in mm?"

_NOTED, _FAR = 3.0, 10.0  # times the densities of materials; the latter also times the size of the shapes
_OUTSIDE = 1.0  # times the size of the shapes: of 292 links of PyBullet's data, none is beyond a quarter
_SIMPLER = 0.05  # of the size, how far simplified shapes may stay behind the real ones on each side


def outside(shaped: Shaped) -> LintFinding | None:
    """Find a centre of mass that is far from the shapes, in units of the diagonal of the box around them."""
    if shaped.collisions is None or shaped.visuals is None or not shaped.collisions + shaped.visuals:
        return None  # of a size that is not known
    low, high = shaped.span
    centre = shaped.body.centre_m
    away = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - centre, centre - high))))
    size = float(np.linalg.norm(high - low))
    if away <= _OUTSIDE * size:
        return None
    box = f"in a box with a diagonal of {number(size, 3)} m"
    message = f"its centre of mass is {number(away, 3)} m from its shapes, {box}"
    found = shaped.finding("centre-of-mass", "warning" if away > _FAR * size else "note", message)
    return without_numbers(found, "a centre of mass near its shapes, in m")


def centre_beyond(shaped: Shaped) -> LintFinding | None:
    """Find a centre of mass that is left out or on the wrong side, where no mass in the shapes can have it.

    Others may be right: shapes are often simpler than what has the mass.
    """
    parts = [*(shaped.collisions or ()), *(shaped.visuals or ())]
    if shaped.collisions is None or shaped.visuals is None or not parts or shaped.has_company:
        return None
    centre = shaped.body.centre_m
    if _fills(shaped, parts, centre):
        return None
    mirrored = [axis for axis in range(3) if _fills(shaped, parts, centre * (1.0 - 2.0 * np.eye(3)[axis]))]
    if not centre.any() and any(_fills(shaped, parts, solid.centre) for _, solid in shaped.solids):
        message = (
            "its centre of mass is at the origin of the link, where no mass within its shapes can have it"
        )
    elif mirrored:
        message = (
            f"no mass within its shapes has its centre of mass at {vector(centre)} m, as one with the "
            f"opposite sign of {'xyz'[mirrored[0]]} could"
        )
    else:
        return None
    finding = shaped.finding("centre-of-mass", "warning", message)
    return without_numbers(finding, "a centre of mass within its shapes")


def _fills(shaped: Shaped, parts: Sequence[Part], centre: Array) -> bool:
    """Whether Var(x) <= (c - min x)(max x - c) along any axis, as of all masses within the shapes.

    Source: Bhatia and Davis (2000), American Mathematical Monthly 107, 353.
    """
    body = shaped.body
    spread = (0.5 * np.trace(body.inertia_kg_m2) * np.eye(3) - body.inertia_kg_m2) / body.mass_kg
    for axes in (np.eye(3), body.principal[1], *(part.rotation for part in parts)):
        ends = np.concatenate([part.corners for part in parts]) @ axes
        low, high, at = ends.min(axis=0), ends.max(axis=0), axes.T @ centre
        allowed = _SIMPLER * (high - low)
        room = np.maximum(at - low + allowed, 0.0) * np.maximum(high + allowed - at, 0.0)
        if np.any(np.diagonal(axes.T @ spread @ axes) > room):
            return False
    return True


def centre_left_out(shaped: Shaped) -> LintFinding | None:
    """Find a centre of mass that is left out, where the tensor is that of the shapes to three digits."""
    body = shaped.body
    for _, solid in shaped.solids:
        off = body.centre_m - solid.centre
        if np.linalg.norm(off) <= CENTRE_OFF * body.gyration_m:
            return None
    for _, solid in shaped.solids:
        if not near(body.inertia_kg_m2, solid.inertia, EXPLAINED):
            continue
        for what, centre in (("at the origin of the link", 0.0), ("mirrored at the origin", -solid.centre)):
            if np.allclose(body.centre_m, centre, rtol=0.0, atol=EXPLAINED * body.gyration_m):
                message = (
                    f"the tensor is that of its shapes about their centre, {vector(solid.centre)} m, "
                    f"but the centre of mass is {what}"
                )
                return shaped.finding("centre-of-mass", "warning", message, solid)
    return None


def wrong_density(shaped: Shaped) -> LintFinding | None:
    """Find a mass and a tensor that agree, at a density that is far from that of any material."""
    density = shaped.density_kg_m3
    beyond = max(DENSITIES[0] / density, density / DENSITIES[1])
    if beyond <= _NOTED:
        return None
    message = (
        f"{number(shaped.body.mass_kg)} kg need {number(density, 2)} kg/m^3 in its shapes, "
        "whose tensor for this mass is that of the file"
    )
    found = shaped.finding("unit-slip", "warning" if beyond > _FAR else "note", message)
    return without_numbers(found, "a mass in kg, and shapes in m")


def impossible_density(shaped: Shaped) -> LintFinding | None:
    """Find a mass that needs a density far beyond that of any material, whatever the tensor."""
    low, high = shaped.span
    volume, density = float(np.prod(high - low)), shaped.density_kg_m3
    is_heavy = shaped.body.mass_kg > _FAR * DENSITIES[1] * volume > 0.0  # even in the box around all shapes
    if not is_heavy and density >= DENSITIES[0] / _FAR:
        return None
    message = f"{number(shaped.body.mass_kg)} kg need {number(density, 2)} kg/m^3 in its shapes"
    return without_numbers(shaped.finding("unit-slip", "warning", message), IN_MM)


def without_numbers(finding: LintFinding, expected: str) -> LintFinding:
    """Return a finding that knows what is right in words only."""
    return replace(finding, expected=expected, inertia_kg_m2=None, centre_m=None)
