"""Findings that compare the inertia of a link with the shapes of the link: bounds, slips and ratios.

A shape may be part of a link only, hollow, or a stand-in. So a warning needs a bound that no mass within the
shapes can exceed, or a slip that explains the numbers of the file to many digits; all else is a note.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.audit.audit import Body, LintFinding
from bodycheck.audit.shape_room import (
    IN_MM,
    centre_beyond,
    centre_left_out,
    impossible_density,
    outside,
    without_numbers,
    wrong_density,
)
from bodycheck.audit.shaped_link import (
    EXPLAINED,
    Shaped,
    agrees,
    box_around,
    is_placeholder,
    near,
)
from bodycheck.audit.slips import NO_MASS, explained
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.scenarios.mass_properties.solid import MassProperties, primitive
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink
from bodycheck.scenarios.shapes import DENSITIES

_FITS = 0.05  # the same for a tensor with few decimals
_PARTIAL = 0.9  # of the edge of the box around all shapes, below which some of them are a part only
_RATIO = 2.0  # of a moment to that of the shape, or its inverse, from which it is a note
_SIMPLIFIED = 1.1  # how far simplified shapes may stay behind the moment of the real ones
_ROUND_OFF = 1e-6
_ISOTROPIC = 0.1  # relative difference of moments below which axes do not matter
_SAME_MOMENTS = 1e-4  # relative
_CLOSER = 0.3  # relative difference from the shapes up to which a tensor about the origin is noted
_CERTAIN = 10.0  # digits that a slip explains
_NEARLY = 1.3  # of a ratio to a power of 1000: shapes of uniform density are no closer than that
_POWERS = (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)


def against_shapes(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
    """Yield the findings about a link whose inertia is written and possible."""
    if link.stated is None or link.stated.derived or link.static:
        return
    body = Body.of(link.stated.in_link)
    if not body.possible or not (link.shapes or link.visuals):
        return
    shaped = Shaped(model, link, body)
    rules: tuple[Callable[[Shaped], LintFinding | None], ...] = (_beyond, outside)
    if shaped.solids and not is_placeholder(link):
        exact = agrees(shaped, EXPLAINED) or _of_outer_box(shaped)
        others = (
            _slip,
            centre_left_out,
            _symmetry,
            _turned,
            centre_beyond,
            _unit,
            impossible_density,
            _about,
            _ratio,
        )
        rules += (centre_left_out, wrong_density, centre_beyond) if exact else others
    for rule in rules:
        if (finding := rule(shaped)) is not None:
            yield finding
            return


def fits_shapes(link: ModelLink, model: ModelFile) -> bool:
    """Return whether a tensor is that of the link's shapes, to a few per cent."""
    if link.stated is None or not (link.shapes or link.visuals):
        return False
    return agrees(Shaped(model, link, Body.of(link.stated.in_link)), _FITS)


def closer_to_shapes(link: ModelLink, model: ModelFile, tensor: Array) -> bool:
    """Return whether a tensor (3, 3) in link axes is closer to that of the link's shapes than the stated."""
    if link.stated is None:
        return False
    shaped = Shaped(model, link, Body.of(link.stated.in_link))
    return any(
        np.linalg.norm(tensor - solid.inertia) < np.linalg.norm(shaped.body.inertia_kg_m2 - solid.inertia)
        for _, solid in shaped.solids[:1]
    )


def slip_of(link: ModelLink, model: ModelFile) -> LintFinding | None:
    """Return the slip that explains a tensor, also one that no body has."""
    if link.stated is None or link.stated.derived or link.static:
        return None
    shaped = Shaped(model, link, Body.of(link.stated.in_link))
    return _slip(shaped) if shaped.solids else None


def with_shapes(finding: LintFinding, link: ModelLink, model: ModelFile) -> LintFinding:
    """Return a finding with the tensor of the link's shapes at uniform density, if they are known."""
    if link.stated is None or not link.stated.inertia.mass > 0:
        return finding
    shaped = Shaped(model, link, Body.of(link.stated.in_link))
    if not shaped.solids:
        return finding
    found = shaped.finding(finding.rule, finding.severity, finding.message)
    expected = f"{finding.expected}; its shapes have {found.expected} at uniform density"
    return replace(finding, expected=expected, shapes_kg_m2=found.shapes_kg_m2)


def _of_outer_box(shaped: Shaped) -> bool:
    """Return whether the tensor is about that of the box around all shapes, of which some are a part only.

    A table whose top alone collides may have the tensor of the box around its top and its legs.
    """
    low, high = shaped.span
    edges = high - low
    spans = (np.array([part.span for part in parts]) for parts, _ in shaped.solids)
    inner = [np.max(span[:, 1], axis=0) - np.min(span[:, 0], axis=0) for span in spans]
    if not np.all(edges > 0.0) or all(np.all(one > _PARTIAL * edges) for one in inner):
        return False
    box = primitive("box", edges.tolist())
    return near(shaped.body.inertia_kg_m2, box.inertia * (shaped.body.mass_kg / box.mass), _FITS)


def _beyond(shaped: Shaped) -> LintFinding | None:
    """I <= m r^2 about any axis, with r the distance of the farthest point of the shapes."""
    body, reach = shaped.body, shaped.reach_m
    if reach is None:
        return None
    most, largest = body.mass_kg * reach**2, float(body.principal[0][2])
    if largest <= most * (1.0 + _ROUND_OFF):
        return None
    message = (
        f"a moment of {number(largest)} kg m^2 is impossible within its shapes: m r^2 is {number(most, 3)}, "
        f"with the farthest point {number(reach, 3)} m from the centre of mass"
    )
    complete = shaped.collisions and shaped.holds_centre and not shaped.has_company
    certain = complete and largest > most * _SIMPLIFIED
    found = shaped.finding("beyond-shape", "error" if certain else "warning", message)
    slip = _slip(shaped) or _unit(shaped)
    if slip is None:  # the density may vary: the numbers of a uniform one are not the right ones
        return without_numbers(found, found.expected)
    return replace(slip, severity=found.severity, message=f"{slip.message}; {message}")


def _slip(shaped: Shaped) -> LintFinding | None:
    """Find the slip that explains the most digits."""
    link, body = shaped.link, shaped.body
    assert link.stated is not None
    written = doubles(link.stated.inertia.tensor)
    sets = [parts for parts, _ in shaped.solids]
    sets += [[box] for parts in sets if (box := box_around(parts)) is not None]
    found = [
        one
        for parts in sets
        if (one := explained(written, shaped.axes, body.centre_m, body.mass_kg, parts)) is not None
    ]
    if not found:
        return None
    best = max(found, key=lambda one: one.digits)
    message = (
        f"the tensor is {'' if best.slip.startswith(('that', 'the')) else 'that of its shapes '}{best.slip}"
    )
    if not best.common:
        rule = "about-another-point" if best.slip.startswith("about") else "shape-slip"
        return _with_digits(shaped.finding(rule, "warning", message, best.right), best.digits)
    ratio = float(np.trace(body.inertia_kg_m2) / np.trace(best.right.inertia))
    own, mass = shaped.density_kg_m3, number(ratio * body.mass_kg, 6)
    needed = f"{number(body.mass_kg)} kg need {number(own, 2)} kg/m^3 in its shapes"
    if _plausible(ratio * own):
        if not _plausible(own):  # then the tensor is right, and the mass is not
            message = f"{needed}, and the tensor is that of {mass} kg"
            return without_numbers(shaped.finding("unit-slip", "warning", message), f"a mass of {mass} kg")
        finding = shaped.finding("shape-slip", "warning", message, best.right)
        return _with_digits(finding, best.digits) if best.slip.startswith(NO_MASS) else finding
    if not _plausible(own):
        return without_numbers(shaped.finding("unit-slip", "warning", f"{needed}; {message}"), IN_MM)
    message += f", which needs {number(ratio * own, 2)} kg/m^3 in its shapes"
    return _with_digits(shaped.finding("unit-slip", "warning", message, best.right), best.digits)


def _plausible(density: float) -> bool:
    return DENSITIES[0] <= density <= DENSITIES[1]


def _with_digits(finding: LintFinding, digits: float) -> LintFinding:
    """Return a finding that is certain if the slip explains so many digits."""
    return replace(finding, confidence="certain") if digits >= _CERTAIN else finding


def _symmetry(shaped: Shaped) -> LintFinding | None:
    """Find a tensor with the symmetry of its only cylinder or capsule, but about another axis."""
    body = shaped.body
    moments, axes = body.principal
    for parts, solid in shaped.solids:
        if len(parts) != 1 or parts[0].kind not in ("cylinder", "capsule"):
            continue
        axis = parts[0].rotation[:, 2]
        along, across = float(axis @ solid.inertia @ axis), float(solid.principal()[0][1])
        equal, other = ((0, 1), 2) if along > across else ((1, 2), 0)
        if moments[equal[1]] - moments[equal[0]] > _ROUND_OFF * moments[2]:
            continue
        if abs(along - across) < _ISOTROPIC * max(along, across):
            continue
        own = axes[:, other]
        a, b = float(moments[other]), float(moments[equal[0]])
        close = all(1.0 / _RATIO < x < _RATIO for x in (a / along, b / across))
        if not close or abs(a - b) < _ISOTROPIC * max(a, b) or abs(float(own @ axis)) > _ROUND_OFF:
            continue
        right = b * np.eye(3) + (a - b) * np.outer(axis, axis)
        uniform = ", ".join(number(x, 4) for x in np.diagonal(shaped.written(solid.inertia)))
        message = (
            f"the {'large' if a > b else 'small'} moment, {number(a)} kg m^2, is about an axis across that "
            f"of its {parts[0].kind}; of uniform density it has the diagonal ({uniform})"
        )
        turned = MassProperties(body.mass_kg, body.centre_m, right)
        return shaped.finding("shape-slip", "warning", message, turned)
    return None


def _turned(shaped: Shaped) -> LintFinding | None:
    """Find the principal moments of the shapes, to four digits, about other axes."""
    own, own_axes = shaped.body.principal
    for _, solid in shaped.solids:
        moments, axes = solid.principal()
        gaps = np.abs(np.subtract.outer(moments, moments)) + moments[2] * np.eye(3)
        alone = np.min(gaps, axis=1) > _ISOTROPIC * moments[2]  # whose axis is determined
        if not alone.any() or np.any(np.abs(own - moments) > _SAME_MOMENTS * moments):
            continue
        cosines = np.abs(np.sum(own_axes * axes, axis=0))[alone]
        angle = number(float(np.arccos(np.min(np.minimum(cosines, 1.0)))), 2)
        message = (
            f"the principal moments are those of its shapes, but their axes are turned by {angle} rad: "
            "is the rotation of the inertial frame left out, or in degrees?"
        )
        return shaped.finding("shape-slip", "warning", message, solid)
    return None


def _about(shaped: Shaped) -> LintFinding | None:
    """Note a tensor that is closer to that of the shapes if it was about the link's origin."""
    body = shaped.body
    moved = body.inertia_kg_m2 - body.mass_kg * parallel_axis_tensor(body.centre_m)
    if np.array_equal(moved, body.inertia_kg_m2) or not Body(body.mass_kg, body.centre_m, moved).possible:
        return None
    for _, solid in shaped.solids:
        scale = float(np.max(solid.inertia))
        before, after = (
            float(np.max(np.abs(one - solid.inertia))) / scale for one in (body.inertia_kg_m2, moved)
        )
        if after < _CLOSER and before > 2.0 * after + _CLOSER:
            message = "the tensor is closer to that of its shapes if it is about the origin of the link"
            about_centre = MassProperties(body.mass_kg, body.centre_m, moved)
            return shaped.finding("about-another-point", "note", message, about_centre)
    return None


def _unit(shaped: Shaped) -> LintFinding | None:
    """Find moments that are each about a power of 1000 times those of the shapes."""
    for _, solid in shaped.solids:
        ratios = shaped.body.principal[0] / solid.principal()[0]
        for power in _POWERS:
            density = power * shaped.density_kg_m3
            if is_placeholder(shaped.link) or _plausible(density):
                continue
            if np.all((ratios > power / _NEARLY) & (ratios < power * _NEARLY)):
                size = "large" if power > 1.0 else "small"
                message = (
                    f"the moments are about {max(power, 1.0 / power):.0e} times too {size} for its shapes: "
                    f"they need {number(density, 2)} kg/m^3"
                ).replace("e+0", "e")
                found = shaped.finding("unit-slip", "warning", message, solid)
                if power < 1.0 and shaped.density_kg_m3 < DENSITIES[0]:
                    return without_numbers(found, IN_MM)
                return found
    return None


def _ratio(shaped: Shaped) -> LintFinding | None:
    """Note moments that are far from those of the shapes, or those of another mass."""
    body = shaped.body
    for _, solid in shaped.solids:
        factor = float(np.trace(body.inertia_kg_m2) / np.trace(solid.inertia))
        distinct = len({f"{x:.3g}" for x in solid.principal()[0]})
        if distinct > 1 and near(body.inertia_kg_m2, factor * solid.inertia, EXPLAINED):
            message = (
                f"the tensor is that of its shapes for {number(factor * body.mass_kg)} kg, not for "
                f"{number(body.mass_kg)} kg"
            )
            return shaped.finding("shape-ratio", "note", message, solid)
    ratios = [body.principal[0] / solid.principal()[0] for _, solid in shaped.solids]
    closest = min(ratios, key=lambda one: float(np.max(np.abs(np.log(one)))))
    if np.all((closest >= 1.0 / _RATIO) & (closest <= _RATIO)):
        return None
    solid = shaped.solids[[one is closest for one in ratios].index(True)][1]
    few = ", ".join(number(x, 3) for x in closest)
    message = f"the principal moments are ({few}) times those of its shapes at uniform density"
    return shaped.finding("shape-ratio", "note", message, solid)
