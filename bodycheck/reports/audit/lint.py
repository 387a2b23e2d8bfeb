"""Findings about the inertias of a model file that need no engine.

Each rule is one function of a link or of the model, listed in `RULES` at the end.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from typing import Literal, TypeAlias

import numpy as np

from bodycheck._util.formatting import number, vector
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reports.audit.audit import Body, Finding
from bodycheck.scenarios.model_files.exact import doubles
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, triangle_excess
from bodycheck.scenarios.model_files.shape_sizes import corners, half_extents, uniform

Severity: TypeAlias = Literal["error", "warning", "note"]
Confidence: TypeAlias = Literal["certain", "likely", "possible"]

_DECIMALS = 1e-6  # a violation below this follows from decimals that were rounded in the file
_TOO_LARGE, _TOO_SMALL = (
    30.0,
    3e-3,
)  # of max moment / (m r^2), r the reach of the shapes; a solid has 0.1 to 1
_RANGE = (1e-45, 1e45)  # of numbers whose products, up to the square of m r^2, are doubles
_UNITS = {1e3: "g, or mm in one factor", 1e6: "mm^2", 1e9: "g mm^2"}
_SIDES = re.compile(r"(?<![a-z])(left|right|l|r)(?![a-z])", re.IGNORECASE)
_OTHER_SIDE = {"left": "right", "right": "left", "l": "r", "r": "l"}


def lint(model: ModelFile) -> Iterator[Finding]:
    """Yield the findings of a model, link by link."""
    for link in model.links:
        extreme = list(_range(link, model))
        yield from extreme
        if not extreme:
            for rule in RULES:
                yield from rule(link, model)


def _range(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    """Report numbers whose products leave the range of doubles, so that nothing else can be checked."""
    if link.stated is None:
        return
    body = Body.of(link.stated.in_link)
    boxes = [box for shape in link.collisions if (box := half_extents(shape, model)) is not None]
    sizes = [size for _, half in boxes for size in half]
    positions = [*body.centre_m, *(coordinate for middle, _ in boxes for coordinate in middle)]
    min_value, max_value = _RANGE
    for quantity, unit, numbers, low in (
        ("mass", "kg", [body.mass_kg], min_value),
        ("moment", "kg m^2", np.diagonal(body.inertia_kg_m2), min_value),
        ("product of inertia", "kg m^2", body.inertia_kg_m2.ravel(), 0.0),
        ("size", "m", sizes, min_value),
        ("position", "m", positions, 0.0),
    ):
        if wrong := [x for x in map(float, numbers) if x != 0.0 and not low <= abs(x) <= max_value]:
            message = f"a {quantity} of {number(wrong[0], 6)} {unit}"
            yield _finding(
                "number-range", "error", "certain", link, message, f"0, or from {low:g} to {max_value:g}"
            )
            return


def _finding(
    rule: str, severity: Severity, confidence: Confidence, link: ModelLink, message: str, expected: str = ""
) -> Finding:
    line = link.line if link.stated is None else link.stated.line
    return Finding(rule, severity, confidence, str(link.file), line, link.name, message, expected)


def _written(link: ModelLink) -> Body | None:
    """Return the body of a link whose inertia is written in the file, not derived from geoms."""
    if link.stated is None or link.stated.derived:
        return None
    return Body.of(link.stated.in_link)


def _mass(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    body = None if link.stated is None else Body.of(link.stated.in_link)
    if body is None:
        return
    if body.mass_kg < 0.0:
        yield _finding(
            "negative-mass", "error", "certain", link, f"mass is {number(body.mass_kg)} kg", "a positive mass"
        )
    elif body.mass_kg == 0.0 and body.inertia_kg_m2.any():
        yield _finding(
            "zero-mass", "error", "certain", link, "mass is 0, but the tensor is not", "a positive mass"
        )
    elif body.mass_kg == 0.0 and _moves(link, model):
        yield _finding(
            "zero-mass",
            "warning",
            "certain",
            link,
            "mass is 0 and the link moves: engines fix it, clamp its mass or fail",
            "a positive mass",
        )


def _possible(link: ModelLink, model: ModelFile) -> Iterator[Finding]:  # noqa: ARG001 - rules are alike
    if link.stated is None or not link.stated.inertia.mass > 0:
        return
    moments = link.stated.inertia.moments
    if not moments.any():
        yield _finding(
            "not-positive",
            "error",
            "certain",
            link,
            "all moments are 0 with a mass",
            "three positive moments",
        )
    elif not moments[0] > 0.0:
        yield _finding(
            "not-positive",
            "error",
            "certain",
            link,
            f"the smallest principal moment is {number(float(moments[0]), 6)} kg m^2",
            "a positive definite tensor",
        )
    elif (excess := triangle_excess(moments)) > 1e-12:
        small = excess <= _DECIMALS
        yield _finding(
            "triangle-inequality",
            "note" if small else "error",
            "certain",
            link,
            f"no body has these moments: {vector(moments)} kg m^2"
            + ("; by so little that rounded decimals explain it" if small else ""),
            f"a largest moment of at most {number(float(moments[0] + moments[1]), 9)} kg m^2",
        )


def _units(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    body = _written(link)
    if body is None or not body.possible or _is_placeholder(link):
        return
    points = corners(link, model)
    confidence: Confidence = "likely" if len(points) else "possible"
    if not len(points):
        points = _joint_positions(link, model)
    radius = float(np.max(np.linalg.norm(points - body.centre_m, axis=1), initial=0.0))
    if not radius > 0.0:
        return
    ratio = float(body.principal[0][2]) / (body.mass_kg * radius**2)
    if ratio > _TOO_LARGE or (ratio < _TOO_SMALL and confidence == "likely"):
        power = round(math.log10(ratio / 0.3) / 3.0) * 3
        factor = 10.0 ** abs(power)
        unit = f" ({_UNITS[factor]})" if factor in _UNITS else ""
        size = "large" if ratio > 1.0 else "small"
        yield _finding(
            "unit-slip",
            "warning",
            confidence,
            link,
            f"the tensor is about {factor:.0e} times too {size} for {number(body.mass_kg)} kg within "
            f"{number(radius, 3)} m of the centre of mass{unit}".replace("e+0", "e"),
            f"a largest moment near {number(0.3 * body.mass_kg * radius**2, 2)} kg m^2",
        )


def _joint_positions(link: ModelLink, model: ModelFile) -> np.ndarray:
    positions = [doubles(child.pose.position) for child in model.links if child.parent == link.name]
    return np.array([np.zeros(3), *positions]) if positions else np.empty((0, 3))


def _about(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    """Report a tensor that fits the link's shape only about the link's origin."""
    body = _written(link)
    if body is None or not body.possible:
        return
    c = body.centre_m
    steiner = body.mass_kg * parallel_axis_tensor(c)
    about_centre = body.inertia_kg_m2 - steiner
    moved = Body(body.mass_kg, c, about_centre)
    if not moved.possible or np.max(steiner) < 0.5 * float(body.principal[0][2]):
        return
    solid = uniform(link, model)
    here = f"{vector(about_centre[np.triu_indices(3)])} kg m^2 (xx, xy, xz, yy, yz, zz) in link axes"
    if solid is not None:
        scale = float(np.max(solid.inertia))
        centre_error = float(np.max(np.abs(about_centre - solid.inertia))) / scale
        origin_error = float(np.max(np.abs(body.inertia_kg_m2 - solid.inertia))) / scale
        if centre_error < 0.3 and origin_error > 2.0 * centre_error + 0.3:
            yield _finding(
                "about-another-point",
                "warning",
                "likely",
                link,
                "the tensor fits the collision shape about the link's origin, not about the centre of mass",
                here,
            )
    elif float(np.trace(about_centre)) < 0.1 * float(np.trace(body.inertia_kg_m2)):
        yield _finding(
            "about-another-point",
            "note",
            "possible",
            link,
            "most of the tensor is m d^2 of the distance to the link's origin",
            f"if it is about the origin: {here}",
        )


def _is_placeholder(link: ModelLink) -> bool:
    """Return whether the tensor as written is a power of ten times the identity."""
    if link.stated is None:
        return False
    tensor = doubles(link.stated.inertia.tensor)
    first = float(tensor[0, 0])
    power = f"{first:.0e}"
    same = bool(np.array_equal(tensor, first * np.eye(3)))
    return same and first > 0.0 and power.startswith("1e") and float(power) == first


def _placeholder(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    body = _written(link)
    if body is None or not body.mass_kg > 0.0:
        return
    solid = uniform(link, model)
    expected = "the tensor of the part"
    if solid is not None:
        expected = (
            f"about {vector(np.linalg.eigvalsh(solid.inertia))} kg m^2 for its shape at uniform density"
        )
    if _is_placeholder(link):
        first = number(float(body.inertia_kg_m2[0, 0]))
        message = f"three equal moments of {first} kg m^2 look like a placeholder"
        yield _finding("placeholder-inertia", "warning", "likely", link, message, expected)
        return
    if not body.inertia_kg_m2.any():  # not-positive reports it
        return
    twins = [
        other.name
        for other in model.links
        if other is not link
        and (one := _written(other)) is not None
        and one.mass_kg == body.mass_kg
        and np.array_equal(one.inertia_kg_m2, body.inertia_kg_m2)
        and _shape_key(other) != _shape_key(link)
    ]
    if len(twins) >= 2:
        message = f"the same numbers as in {len(twins)} links of other shapes"
        yield _finding("placeholder-inertia", "note", "possible", link, message, expected)


def _shape_key(link: ModelLink) -> tuple[tuple[str, tuple[float, ...], str], ...]:
    return tuple((shape.kind, shape.size, shape.mesh) for shape in link.collisions)


def _missing(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    if link.stated is not None or link.unread or not _moves(link, model):
        return
    carried = [one.name for one, _ in model.fixed_below(link.name) if one.stated is not None]
    if carried:
        return
    root = link.parent is None
    yield _finding(
        "missing-inertial",
        "note" if root else "warning",
        "certain",
        link,
        "has no inertia; engines invent one, fix the link or fail",
        "<inertial> with mass, origin and tensor",
    )


def _moves(link: ModelLink, model: ModelFile) -> bool:
    """Return whether a joint moves this link itself; the root of a URDF counts."""
    if link.parent is None and model.format == "urdf":
        return link.name != "world"
    return link.joint is None or link.joint.kind not in ("fixed", "mocap")


def _mirrored(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    """Report tensors of a left and a right link that are not mirror images although their centres are."""
    for shape in link.collisions:
        if math.prod(shape.scale) < 0.0:
            message = f"the scale {vector(shape.scale)} of a mesh mirrors it: inside out in some engines"
            yield _finding("mirrored-axes", "note", "certain", link, message, "a mirrored mesh file")
    other = model.by_name.get(_SIDES.sub(lambda side: _with_case(side[0]), link.name))
    body = _written(link)
    if other is None or other is link or body is None or link.name > other.name:
        return
    twin = _written(other)
    if twin is None or twin.mass_kg != body.mass_kg:
        return
    for axis in range(3):
        M = np.diag([-1.0 if k == axis else 1.0 for k in range(3)])
        size = float(np.max(np.abs(body.inertia_kg_m2)))
        centres = np.allclose(M @ body.centre_m, twin.centre_m, rtol=1e-6, atol=1e-9)
        if centres and abs(body.centre_m[axis]) > 1e-6:
            expected = M @ body.inertia_kg_m2 @ M
            wrong = float(np.max(np.abs(expected - twin.inertia_kg_m2)))
            same_moments = np.allclose(body.principal[0], twin.principal[0], rtol=1e-3)
            if wrong > 1e-3 * size and same_moments:
                yield _finding(
                    "mirrored-axes",
                    "warning",
                    "likely",
                    other,
                    f"its centre of mass mirrors that of {link.name} in {'xyz'[axis]}, its tensor does not",
                    f"{vector(expected[np.triu_indices(3)])} kg m^2 (xx, xy, xz, yy, yz, zz) in link axes",
                )
            return


def _with_case(side: str) -> str:
    other = _OTHER_SIDE[side.lower()]
    return other.upper() if side.isupper() else other.capitalize() if side[0].isupper() else other


RULES: tuple[Callable[[ModelLink, ModelFile], Iterator[Finding]], ...] = (
    _mass,
    _possible,
    _units,
    _about,
    _placeholder,
    _missing,
    _mirrored,
)
