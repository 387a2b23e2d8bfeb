"""Findings that compare the inertia of a link with the shapes of the link: bounds, slips and ratios.

A shape may be part of a link only, hollow, or a stand-in. So a warning needs a bound that no mass within the
shapes can exceed, or a slip that explains the numbers of the file to many digits; all else is a note.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from bodycheck._util.formatting import number, vector
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import parallel_axis_tensor
from bodycheck.reference_impl.mass_properties.solid import MassProperties, primitive
from bodycheck.reports.audit.audit import Body, Confidence, Finding, Severity
from bodycheck.reports.audit.slips import explained
from bodycheck.scenarios.model_files.exact import doubles, mp
from bodycheck.scenarios.model_files.link_solids import Part, masses_explain, parts_of, united
from bodycheck.scenarios.model_files.mjcf_shapes import geom_inertia
from bodycheck.scenarios.model_files.model_file import Format, ModelFile, ModelLink
from bodycheck.scenarios.shapes import DENSITIES

_EXPLAINED = 1e-3  # relative difference up to which a tensor is that of the shapes, in its principal axes
_FITS = 0.05  # the same for a tensor with few decimals
_RATIO = 2.0  # of a moment to that of the shape, or its inverse, from which it is a note
_SIMPLIFIED = 1.1  # how far simplified shapes may stay behind the moment of the real ones
_ROUND_OFF = 1e-6
_CENTRE_OFF = 0.1  # distance of centres in radii of gyration that a slip changes
_ISOTROPIC = 0.1  # relative difference of moments below which axes do not matter
_CLOSER = 0.3  # relative difference from the shapes up to which a tensor about the origin is noted
_CERTAIN = 10.0  # digits that a slip explains
_NEARLY = 1.3  # of a ratio to a power of 1000: shapes of uniform density are no closer than that
_POWERS = (1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)


@dataclass(frozen=True, eq=False)
class Shaped:
    """A link with an inertia that is written in the file, and the parts that its shapes are.

    collisions, visuals: None where the size of one shape is not known.
    """

    model: ModelFile
    link: ModelLink
    body: Body

    @cached_property
    def collisions(self) -> list[Part] | None:
        """The shapes that collide."""
        return parts_of(self.link.collisions, self.model)

    @cached_property
    def visuals(self) -> list[Part] | None:
        """The shapes that are only seen."""
        unseen = [shape for shape in self.link.shapes if not shape.collides]
        return parts_of((*self.link.visuals, *unseen), self.model)

    @cached_property
    def solids(self) -> list[tuple[list[Part], MassProperties]]:
        """The parts that together may be the body, at its mass and uniform density: collisions, visuals."""
        found = []
        for parts in (self.collisions, self.visuals):
            solid = united(parts or (), self.body.mass_kg)
            if parts and solid is not None:
                found.append((parts, solid))
        return found

    @cached_property
    def reach_m(self) -> float | None:
        """max |x - c| over the shapes of the link and of links without inertia fixed to it, if known."""
        found = 0.0
        for shaped, centre in self._sharing():
            for parts in (shaped.collisions, shaped.visuals):
                if parts is None:
                    return None
                found = max([found, *(part.reach(centre) for part in parts)])
        return found or None

    @cached_property
    def holds_centre(self) -> bool:
        """Whether the centre of mass is within the box around the shapes of the link, along its axes."""
        parts = [part for parts in (self.collisions, self.visuals) for part in parts or ()]
        low = np.min([part.span[0] for part in parts], axis=0)
        high = np.max([part.span[1] for part in parts], axis=0)
        margin = _EXPLAINED * (high - low)
        return bool(np.all((self.body.centre_m >= low - margin) & (self.body.centre_m <= high + margin)))

    def _sharing(self) -> Iterator[tuple[Shaped, Array]]:
        """Yield the link and links fixed to it without inertia, and the centre of mass in their axes."""
        centre = self.body.centre_m
        yield self, centre
        for other, pose in self.model.fixed_below(self.link.name):
            if other.stated is None:
                R, p = doubles(pose.rotation), doubles(pose.position)
                yield Shaped(self.model, other, self.body), R.T @ (centre - p)
        above = None if self.link.parent is None else self.model.by_name[self.link.parent]
        if above is not None and above.stated is None and (self.link.joint is None or self.link.joint.fixed):
            R, p = doubles(self.link.pose.rotation), doubles(self.link.pose.position)
            yield Shaped(self.model, above, self.body), R @ centre + p

    @cached_property
    def has_company(self) -> bool:
        """Whether a fixed joint connects the link with another, which may have its mass or its shapes."""
        link = self.link
        above = link.parent is not None and (link.joint is None or link.joint.fixed)
        return above or any(True for _ in self.model.fixed_below(link.name))

    @cached_property
    def density_kg_m3(self) -> float:
        """The mass over the volume of the collisions, else of the visuals."""
        parts, _ = self.solids[0]
        return self.body.mass_kg / sum(part.solid.mass for part in parts if part.solid is not None)

    def finding(
        self, rule: str, severity: Severity, message: str, right: MassProperties | None = None
    ) -> Finding:
        """Return a finding, with the right body in the words of the file."""
        link = self.link
        assert link.stated is not None
        if right is None and self.solids:
            right = self.solids[0][1]
        confidence: Confidence = "certain" if severity == "error" else "likely"
        if severity == "note":
            confidence = "possible"
        found = Finding(rule, severity, confidence, str(link.file), link.stated.line, link.name, message)
        if right is None:
            return found
        numbers = self.numbers(right.inertia)
        centre = None
        expected = _as_in_file(numbers, self.model.format)
        if np.linalg.norm(right.centre - self.body.centre_m) > _EXPLAINED * self.body.gyration_m:
            centre = tuple(float(f"{x:.9g}") for x in right.centre)
            expected += f", with the centre of mass at {vector(right.centre)} m"
        return replace(found, expected=expected, inertia_kg_m2=numbers, centre_m=centre)

    def numbers(self, inertia: Array) -> tuple[float, ...]:
        """Return xx, xy, xz, yy, yz, zz of a tensor in link axes as the file would state them.

        MJCF takes a full tensor in the axes of the body only.
        """
        tensor = inertia if self.model.format == "mjcf" else self.written(inertia)
        largest = float(np.max(np.abs(tensor)))
        values = tensor[np.triu_indices(3)]
        return tuple(float(f"{x:.9g}") if abs(x) > 1e-9 * largest else 0.0 for x in values)

    def written(self, inertia: Array) -> Array:
        """Return a tensor (3, 3) in link axes in those in which the file states it."""
        return np.asarray(self.axes.T @ inertia @ self.axes)

    @cached_property
    def axes(self) -> Array:
        """The rotation (3, 3) of the inertial frame in the link."""
        assert self.link.stated is not None
        return doubles(self.link.stated.frame.rotation)


def _as_in_file(numbers: Sequence[float], form: Format) -> str:
    """Return xx, xy, xz, yy, yz, zz in kg m^2 as a format states them."""
    texts = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), map(repr, numbers), strict=True))
    if form == "urdf":
        return " ".join(f'{name}="{text}"' for name, text in texts.items())
    if form == "sdf":
        return "".join(f"<{name}>{text}</{name}>" for name, text in texts.items())
    full = " ".join(texts[name] for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return f'fullinertia="{full}"'


def against_shapes(link: ModelLink, model: ModelFile) -> Iterator[Finding]:
    """Yield the findings about a link whose inertia is written and possible."""
    if link.stated is None or link.stated.derived or link.static:
        return
    body = Body.of(link.stated.in_link)
    if not body.possible or not (link.shapes or link.visuals):
        return
    shaped = Shaped(model, link, body)
    rules: tuple[Callable[[Shaped], Finding | None], ...] = (_beyond,)
    if shaped.solids and not is_placeholder(link):
        exact = _agrees(shaped, _EXPLAINED)
        rules += (_centre,) if exact else (_slip, _centre, _symmetry, _about, _unit, _ratio)
    for rule in rules:
        if (finding := rule(shaped)) is not None:
            yield finding
            return


def fits_shapes(link: ModelLink, model: ModelFile) -> bool:
    """Return whether a tensor is that of the link's shapes, to a few per cent."""
    if link.stated is None or not (link.shapes or link.visuals):
        return False
    return _agrees(Shaped(model, link, Body.of(link.stated.in_link)), _FITS)


def slip_of(link: ModelLink, model: ModelFile) -> Finding | None:
    """Return the slip that explains a tensor, also one that no body has."""
    if link.stated is None or link.stated.derived or link.static:
        return None
    shaped = Shaped(model, link, Body.of(link.stated.in_link))
    return _slip(shaped) if shaped.solids else None


def is_placeholder(link: ModelLink) -> bool:
    """Return whether the tensor as written is a power of ten times the identity."""
    if link.stated is None:
        return False
    tensor = doubles(link.stated.inertia.tensor)
    first = float(tensor[0, 0])
    power = f"{first:.0e}"
    same = bool(np.array_equal(tensor, first * np.eye(3)))
    return same and first > 0.0 and power.startswith("1e") and float(power) == first


def _beyond(shaped: Shaped) -> Finding | None:
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
        return replace(found, inertia_kg_m2=None, centre_m=None)
    return replace(slip, severity=found.severity, message=f"{slip.message}; {message}")


def _agrees(shaped: Shaped, tolerance: float) -> bool:
    """Return whether the tensor is that of the shapes: solid, hollow, one alone, or of several densities."""
    body = MassProperties(shaped.body.mass_kg, shaped.body.centre_m, shaped.body.inertia_kg_m2)
    for parts, solid in shaped.solids:
        alone = (
            one
            for part in parts
            if (one := united([part], body.mass)) is not None
            and np.linalg.norm(one.centre - body.centre) <= _CENTRE_OFF * shaped.body.gyration_m
        )
        others = chain([solid], alone, _shells(parts, body.mass), _around(parts, body.mass))
        if any(_near(body.inertia, one.inertia, tolerance) for one in others):
            return True
        if len(parts) > 1 and masses_explain(parts, body, _EXPLAINED):
            return True
    return False


def _near(inertia: Array, other: Array, tolerance: float) -> bool:
    """|v_j^T (I - T) v_k| <= tolerance sqrt(T_j T_k) in the principal axes v of T."""
    moments, axes = np.linalg.eigh(other)
    scale = np.sqrt(np.outer(moments, moments))
    return bool(np.all(np.abs(axes.T @ (inertia - other) @ axes) <= tolerance * scale))


def _shells(parts: Sequence[Part], mass: float) -> Iterator[MassProperties]:
    """Yield the thin shell of a single primitive, and the open tube of a cylinder."""
    if len(parts) != 1 or parts[0].kind not in ("box", "sphere", "cylinder", "capsule"):
        return
    (part,) = parts
    half = [mp.mpf(size) for size in part.sizes]
    if part.kind == "box":
        half = [size / 2 for size in half]
    elif len(half) == 2:
        half[1] /= 2
    shell = geom_inertia(part.kind, half, shell=True, mass=mp.mpf(mass), density=None)
    tensors = [doubles(shell.tensor)]
    if part.kind == "cylinder":
        r, length = part.sizes
        across = mass * (r**2 / 2.0 + length**2 / 12.0)
        tensors.append(np.diag([across, across, mass * r**2]))
    for tensor in tensors:
        yield MassProperties(mass, part.position, part.rotation @ tensor @ part.rotation.T)


def _around(parts: Sequence[Part], mass: float) -> Iterator[MassProperties]:
    """Yield the box around a single mesh, which many compute with."""
    if (box := _box(parts)) is not None and (solid := united([box], mass)) is not None:
        yield solid


def _box(parts: Sequence[Part]) -> Part | None:
    if len(parts) != 1 or parts[0].kind != "mesh" or parts[0].points is None:
        return None
    (mesh,) = parts
    local = (parts[0].points - mesh.position) @ mesh.rotation
    low, high = local.min(axis=0), local.max(axis=0)
    sizes = tuple((high - low).tolist())
    if not all(size > 0.0 for size in sizes):
        return None
    middle = mesh.rotation @ (0.5 * (low + high)) + mesh.position
    solid = primitive("box", sizes).rotated(mesh.rotation).translated(middle)
    return Part("box", sizes, mesh.rotation, middle, solid)


def _slip(shaped: Shaped) -> Finding | None:
    """Find the slip that explains the most digits."""
    link, body = shaped.link, shaped.body
    assert link.stated is not None
    written = doubles(link.stated.inertia.tensor)
    sets = [parts for parts, _ in shaped.solids]
    sets += [[box] for parts in sets if (box := _box(parts)) is not None]
    found = [
        one
        for parts in sets
        if (one := explained(written, shaped.axes, body.centre_m, body.mass_kg, parts)) is not None
    ]
    if not found:
        return None
    best = max(found, key=lambda one: one.digits)
    ratio = np.trace(body.inertia_kg_m2) / np.trace(best.right.inertia)
    density = shaped.density_kg_m3 * ratio if best.common else None
    if density is not None and not DENSITIES[0] <= density <= DENSITIES[1]:
        rule, more = "unit-slip", f", which needs {number(density, 2)} kg/m^3 in its shapes"
    else:
        rule, more = "about-another-point" if best.slip.startswith("about") else "shape-slip", ""
    confidence: Confidence = "certain" if best.digits >= _CERTAIN else "likely"
    message = f"the tensor is {best.slip}{more}"
    return replace(shaped.finding(rule, "warning", message, best.right), confidence=confidence)


def _symmetry(shaped: Shaped) -> Finding | None:
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


def _centre(shaped: Shaped) -> Finding | None:
    """Find a centre of mass that is left out, where the tensor is that of the shapes to three digits."""
    body = shaped.body
    for _, solid in shaped.solids:
        off = body.centre_m - solid.centre
        if np.linalg.norm(off) <= _CENTRE_OFF * body.gyration_m:
            return None
    for _, solid in shaped.solids:
        if not _near(body.inertia_kg_m2, solid.inertia, _EXPLAINED):
            continue
        for what, centre in (("at the origin of the link", 0.0), ("mirrored at the origin", -solid.centre)):
            if np.allclose(body.centre_m, centre, rtol=0.0, atol=_EXPLAINED * body.gyration_m):
                message = (
                    f"the tensor is that of its shapes about their centre, {vector(solid.centre)} m, "
                    f"but the centre of mass is {what}"
                )
                return shaped.finding("centre-of-mass", "warning", message, solid)
    return None


def _about(shaped: Shaped) -> Finding | None:
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


def _unit(shaped: Shaped) -> Finding | None:
    """Find moments that are each about a power of 1000 times those of the shapes."""
    for _, solid in shaped.solids:
        ratios = shaped.body.principal[0] / solid.principal()[0]
        for power in _POWERS:
            density = power * shaped.density_kg_m3
            if is_placeholder(shaped.link) or DENSITIES[0] <= density <= DENSITIES[1]:
                continue
            if np.all((ratios > power / _NEARLY) & (ratios < power * _NEARLY)):
                size = "large" if power > 1.0 else "small"
                message = (
                    f"the moments are about {max(power, 1.0 / power):.0e} times too {size} for its shapes: "
                    f"they need {number(density, 2)} kg/m^3"
                ).replace("e+0", "e")
                return shaped.finding("unit-slip", "warning", message, solid)
    return None


def _ratio(shaped: Shaped) -> Finding | None:
    body = shaped.body
    ratios = [body.principal[0] / solid.principal()[0] for _, solid in shaped.solids]
    closest = min(ratios, key=lambda one: float(np.max(np.abs(np.log(one)))))
    if np.all((closest >= 1.0 / _RATIO) & (closest <= _RATIO)):
        return None
    solid = shaped.solids[[one is closest for one in ratios].index(True)][1]
    few = ", ".join(number(x, 3) for x in closest)
    message = f"the principal moments are ({few}) times those of its shapes at uniform density"
    return replace(shaped.finding("shape-ratio", "note", message, solid), confidence="possible")
