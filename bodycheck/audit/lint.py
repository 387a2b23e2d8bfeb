"""Findings about the inertias of a model file that need no engine.

Each rule is one function of a link or of the model, listed in `RULES` at the end.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from bodycheck._util.formatting import number, vector
from bodycheck.audit.audit import Body, Confidence, LintFinding, Severity
from bodycheck.audit.mesh_lint import weighed_meshes
from bodycheck.audit.shape_lint import against_shapes, closer_to_shapes, fits_shapes, slip_of, with_shapes
from bodycheck.audit.shaped_link import is_placeholder
from bodycheck.audit.slips import half_unit
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.scenarios.model_files.exact_arithmetic import doubles
from bodycheck.scenarios.model_files.joint import StatedJoint
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, triangle_excess
from bodycheck.scenarios.model_files.shape_sizes import half_extents, span_along, uniform

_DECIMALS = (1e-6, 1e-5)  # of the largest moment: what rounded decimals may break is between these
_NEAR = 1e-9  # of the limits, relative to the largest moment: 40 digits decide
_RANGE = (1e-45, 1e45)  # of numbers whose products, up to the square of m r^2, are doubles
_FAR = 10.0  # times the size of the model
_OF_THE_PART = "the tensor of the part"
_PLACE = re.compile(r":(\d+): (?=<)")
_SIDES = re.compile(r"(?<![a-z])(left|right|[fbhmr]?[lr]|[lr][fbhm])(?![a-z])", re.IGNORECASE)
_OTHER_SIDE = {"left": "right", "right": "left", "l": "r", "r": "l"}


def lint(model: ModelFile) -> Iterator[LintFinding]:
    """Yield the findings of a model, link by link."""
    for link in model.links:
        extreme = list(_range(link, model))
        yield from extreme
        if not extreme:
            found = [finding for rule in RULES for finding in rule(link, model)]
            beyond = any(finding.rule == "beyond-shape" for finding in found)
            yield from (one for one in found if not (beyond and one.rule == "placeholder-inertia"))
    yield from _repeated_joints(model)
    yield from _twins(model)
    yield from _beyond_model(model)


def _range(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
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
    rule: str,
    severity: Severity,
    confidence: Confidence,
    link: ModelLink,
    message: str,
    expected: str = "",
    line: int = 0,
) -> LintFinding:
    place = line or link.place
    return LintFinding(rule, severity, confidence, str(link.file), place, link.name, message, expected)


def _written(link: ModelLink) -> Body | None:
    """Return the body of a link whose inertia is written in the file, not derived from geoms."""
    if link.stated is None or link.stated.derived:
        return None
    return Body.of(link.stated.in_link)


def _mass(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
    body = None if link.stated is None else Body.of(link.stated.in_link)
    if body is None:
        return
    if body.mass_kg < 0.0:
        yield _finding(
            "negative-mass", "error", "certain", link, f"mass is {number(body.mass_kg)} kg", "a positive mass"
        )
    elif body.mass_kg == 0.0 and body.inertia_kg_m2.any():
        yield _finding("zero-mass", "error", "certain", link, "has no mass, but a tensor", "a positive mass")
    elif body.mass_kg == 0.0 and _moves(link, model):
        yield _finding(
            "zero-mass",
            "warning",
            "certain",
            link,
            "has no mass, but moves: engines fix it, clamp its mass or fail",
            "a positive mass",
        )


def _possible(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
    if link.stated is None or not link.stated.inertia.mass > 0:
        return
    rough = np.asarray(np.linalg.eigvalsh(doubles(link.stated.inertia.tensor)), dtype=np.float64)
    if rough[0] > _NEAR * rough[2] and triangle_excess(rough) < -_NEAR:
        return
    moments = link.stated.inertia.moments
    found = None
    if not moments.any():
        message = "impossible tensor, all moments are 0 with a mass"
        found = _finding("not-positive", "error", "certain", link, message, "three positive moments")
    elif not moments[0] > 0.0:
        message = f"impossible tensor, I1 <= 0: I1 is {number(float(moments[0]), 6)} kg m^2"
        found = _finding("not-positive", "error", "certain", link, message, "a positive definite tensor")
    elif (excess := triangle_excess(moments)) > np.clip(left_open := _left_open(link), *_DECIMALS):
        message = f"impossible tensor, I1 + I2 < I3: {vector(moments)} kg m^2"
        confidence: Confidence = "certain"
        if excess <= left_open:
            message += ", as its last digits may make it: more of them are needed"
            confidence = "likely"
        most = f"a largest moment of at most {number(float(moments[0] + moments[1]), 9)} kg m^2"
        found = _finding("triangle-inequality", "error", confidence, link, message, most)
    elif excess > 1e-12:
        message = f"I1 + I2 < I3 by {number(excess, 2)} of I3, as rounded decimals do"
        yield _finding("triangle-inequality", "note", "certain", link, message, "more decimals")
    if found is None:
        return
    slip = slip_of(link, model)
    if slip is None:
        yield with_shapes(found, link, model)
    else:
        yield replace(slip, rule=found.rule, severity="error", message=f"{found.message}; {slip.message}")


def _left_open(link: ModelLink) -> float:
    """Return what half a unit of the last digits leaves open of I1 + I2 - I3, over the largest number."""
    assert link.stated is not None
    values = doubles(link.stated.inertia.tensor)
    return float(sum(abs(x) * half_unit(x) for x in map(float, values.ravel())) / np.max(np.abs(values)))


def _about(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:  # noqa: ARG001 - rules are alike
    """Note a tensor that is mostly m d^2 of the distance to the link's origin, if the link has no shape."""
    body = _written(link)
    if body is None or not body.possible or link.shapes or link.visuals:
        return
    steiner = body.mass_kg * parallel_axis_tensor(body.centre_m)
    about_centre = body.inertia_kg_m2 - steiner
    moved = Body(body.mass_kg, body.centre_m, about_centre)
    if not moved.possible or np.max(steiner) < 0.5 * float(body.principal[0][2]):
        return
    if float(np.trace(about_centre)) < 0.1 * float(np.trace(body.inertia_kg_m2)):
        here = f"{vector(about_centre[np.triu_indices(3)])} kg m^2 (xx, xy, xz, yy, yz, zz) in link axes"
        yield _finding(
            "about-another-point",
            "note",
            "possible",
            link,
            "most of the tensor is m d^2 of the distance to the link's origin",
            f"if it is about the origin: {here}",
        )


def _placeholder(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
    body = _written(link)
    if body is None or not body.mass_kg > 0.0 or not is_placeholder(link) or fits_shapes(link, model):
        return
    first = number(float(body.inertia_kg_m2[0, 0]))
    message = f"three equal moments of {first} kg m^2 look like a placeholder"
    found = _finding("placeholder-inertia", "warning", "likely", link, message, _OF_THE_PART)
    exact, solid = with_shapes(found, link, model), uniform(link, model)
    if exact is found and solid is not None:  # a mesh that is no solid counts as the box around it
        moments = vector(np.linalg.eigvalsh(solid.inertia))
        exact = replace(found, expected=f"about {moments} kg m^2 for its shape at uniform density")
    yield exact


def _twins(model: ModelFile) -> Iterator[LintFinding]:
    """Note links that have the numbers of at least two links of other shapes."""
    same: dict[tuple[float, bytes], list[ModelLink]] = {}
    for link in model.links:
        body = _written(link)
        weighs = body is not None and body.mass_kg > 0.0 and body.inertia_kg_m2.any()
        if body is not None and weighs and link.collisions and not is_placeholder(link):
            same.setdefault((body.mass_kg, body.inertia_kg_m2.tobytes()), []).append(link)
    for links in same.values():
        shapes = Counter(map(_shape_key, links))
        for link in links:
            others = len(links) - shapes[_shape_key(link)]
            if others >= 2:
                message = f"the same numbers as in {others} links of other shapes"
                found = _finding("placeholder-inertia", "note", "possible", link, message, _OF_THE_PART)
                yield with_shapes(found, link, model)


def _shape_key(link: ModelLink) -> tuple[tuple[str, tuple[float, ...], str], ...]:
    return tuple((shape.kind, shape.size, shape.mesh) for shape in link.collisions)


def _beyond_model(model: ModelFile) -> Iterator[LintFinding]:
    """Note links without shapes whose centre or radius of gyration is far beyond the size of the model."""
    points = []
    for name, pose in model.placed.items():
        R, origin = doubles(pose.rotation), doubles(pose.position)
        points.append(origin)
        for shape in (*model.by_name[name].shapes, *model.by_name[name].visuals):
            points += [origin + end for end in span_along(shape, model, R.T) or ()]
    size = math.hypot(*np.ptp(np.array(points), axis=0)) if points else 0.0
    for link in model.links:
        body = _written(link)
        if body is None or not body.possible or link.static or link.shapes or link.visuals or size == 0.0:
            continue
        away = math.hypot(*body.centre_m)
        spans = f"the frames and shapes of the model span {number(size, 2)} m"
        if away > _FAR * size:
            message = f"its centre of mass is {number(away, 3)} m from its origin; {spans}"
            yield _finding("beyond-model", "note", "possible", link, message, "a centre of mass in m")
        elif body.gyration_m > _FAR * size and not is_placeholder(link):
            message = (
                f"its moments are those of its mass {number(body.gyration_m, 3)} m from its centre; {spans}"
            )
            most = f"moments of at most {number(body.mass_kg * size**2, 2)} kg m^2 within that size"
            yield _finding("beyond-model", "note", "possible", link, message, most)


def _repeated_joints(model: ModelFile) -> Iterator[LintFinding]:
    """Report joints of a URDF that have the name of one above; joints of nested models may share names."""
    firsts: dict[str, StatedJoint] = {}
    joints = [(link, link.joint) for link in model.links if link.joint is not None and link.joint.name]
    for link, joint in sorted(joints, key=lambda one: one[1].line) if model.format == "urdf" else ():
        first = firsts.setdefault(joint.name, joint)
        if first is not joint:
            message = f"another joint has the name {joint.name!r:.60}, in line {first.line}"
            expected = "a name for each joint"
            yield _finding("repeated-joint", "error", "certain", link, message, expected, joint.line)


def _missing(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
    if link.stated is not None or link.unread or not _moves(link, model):
        return
    root = link.parent is None
    if link.name in model.carrying:
        if model.format == "urdf" and not root:
            message = "has no inertia of its own; engines that do not merge the links fixed to it invent one"
            yield _finding(
                "missing-inertial", "note", "certain", link, message, "<inertial> of the moving link"
            )
        return
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


def _mirrored(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:
    """Report tensors of a left and a right link that are not mirror images although their centres are."""
    for shape in link.collisions:
        if math.prod(shape.scale) < 0.0:
            message = f"the scale {vector(shape.scale)} of a mesh mirrors it: inside out in some engines"
            yield _finding("mirrored-axes", "note", "certain", link, message, "a mirrored mesh file")
    other = model.by_name.get(_SIDES.sub(_other_side, link.name))
    body = _written(link)
    if other is None or other is link or body is None or link.name > other.name:
        return
    twin = _written(other)
    if twin is None or twin.mass_kg != body.mass_kg:
        return
    mirrors = [np.diag(1.0 - 2.0 * one) for one in np.eye(3)]
    if any(_is_only_tensor_mirrored(body, twin, M) for M in mirrors):
        message = f"its tensor is the mirror image of that of {link.name}, but its centre of mass is the same"
        yield _finding("mirrored-axes", "warning", "likely", other, message, "a mirrored centre of mass")
    for axis, M in enumerate(mirrors):
        size = float(np.max(np.abs(body.inertia_kg_m2)))
        centres = np.allclose(M @ body.centre_m, twin.centre_m, rtol=1e-6, atol=1e-9)
        if centres and abs(body.centre_m[axis]) > 1e-6:
            expected = M @ body.inertia_kg_m2 @ M
            wrong = float(np.max(np.abs(expected - twin.inertia_kg_m2)))
            same_moments = np.allclose(body.principal[0], twin.principal[0], rtol=1e-3)
            if wrong > 1e-3 * size and same_moments:
                sides = [(other, link, expected), (link, other, M @ twin.inertia_kg_m2 @ M)]
                closer = [closer_to_shapes(one, model, mirrored) for one, _, mirrored in sides]
                one, right, mirrored = sides[closer == [False, True]]
                yield _finding(
                    "mirrored-axes",
                    "warning",
                    "likely",
                    one,
                    f"its centre of mass mirrors that of {right.name} in {'xyz'[axis]}, its tensor does not",
                    f"{vector(mirrored[np.triu_indices(3)])} kg m^2 (xx, xy, xz, yy, yz, zz) in link axes",
                )
            return


def _is_only_tensor_mirrored(body: Body, twin: Body, M: Array) -> bool:
    """Whether a tensor that is not its own mirror image is mirrored, and a centre off the plane is not."""
    size = float(np.max(np.abs(body.inertia_kg_m2)))
    mirrored, centre = M @ body.inertia_kg_m2 @ M, body.centre_m
    is_odd = np.max(np.abs(mirrored - body.inertia_kg_m2)) > 1e-3 * size
    is_mirrored = np.max(np.abs(mirrored - twin.inertia_kg_m2)) <= 1e-5 * size
    is_off = np.linalg.norm(M @ centre - centre) > 1e-3 * body.gyration_m
    is_copied = np.allclose(centre, twin.centre_m, rtol=1e-6, atol=1e-9)
    return bool(is_odd and is_mirrored and is_off and is_copied)


def _other_side(found: re.Match[str]) -> str:
    """Return left for right, l for r, and FL for FR or LF for RF, as of the legs of a robot, in its case."""
    side = found[0]
    if len(side) == 2:
        first, last = side[0], side[1]
        return first + _in_case(last) if last.lower() in _OTHER_SIDE else _in_case(first) + last
    return _in_case(side)


def _in_case(side: str) -> str:
    other = _OTHER_SIDE[side.lower()]
    return other.upper() if side.isupper() else other.capitalize() if side[0].isupper() else other


def _unreadable(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:  # noqa: ARG001 - rules are alike
    if link.malformed:
        file, line, what = _PLACE.split(link.unread, maxsplit=1)  # the file may be an included one
        wrong, _, expected = what.partition(" (expected ")
        expected = expected.removesuffix(")")
        message = f"{wrong} is not {expected}" if expected else wrong
        found = _finding("unreadable", "error", "certain", link, message, expected, int(line))
        yield replace(found, file=file)


def _mistaken(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:  # noqa: ARG001 - rules are alike
    for one in link.mistakes:
        severity: Severity = "error" if one.is_certain else "warning"
        confidence: Confidence = "certain" if one.is_certain else "likely"
        yield _finding(one.rule, severity, confidence, link, one.message, one.expected, one.line)


def _zero_axis(link: ModelLink, model: ModelFile) -> Iterator[LintFinding]:  # noqa: ARG001 - rules are alike
    for joint in link.joints:
        if joint.motion in ("hinge", "slide", "planar") and joint.axis is not None and not any(joint.axis):
            which = f"joint {joint.name!r:.60}" if joint.name else "its joint"
            message, expected = f"the axis of {which} is (0, 0, 0)", "a direction, such as (0, 0, 1)"
            yield _finding("zero-axis", "error", "certain", link, message, expected, joint.line)


RULES: tuple[Callable[[ModelLink, ModelFile], Iterator[LintFinding]], ...] = (
    _unreadable,
    _mistaken,
    _zero_axis,
    _mass,
    _possible,
    against_shapes,
    _about,
    _placeholder,
    _missing,
    _mirrored,
    weighed_meshes,
)
