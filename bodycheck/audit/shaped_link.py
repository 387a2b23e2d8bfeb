"""A link with its shapes: the parts that they are, their reach, and whether they explain the tensor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from bodycheck._util.formatting import vector
from bodycheck.audit.audit import Body, Confidence, LintFinding, Severity
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import MassProperties, primitive
from bodycheck.scenarios.model_files.exact_arithmetic import doubles, mp
from bodycheck.scenarios.model_files.link_solids import Part, masses_explain, parts_of, united
from bodycheck.scenarios.model_files.mjcf_shapes import geom_inertia
from bodycheck.scenarios.model_files.model_file import Format, ModelFile, ModelLink

EXPLAINED = 1e-3
"""Relative difference up to which a tensor is that of the shapes, in its principal axes."""
CENTRE_OFF = 0.1
"""Distance of centres, in radii of gyration, from which one of them is wrong."""


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
        found: list[tuple[list[Part], MassProperties]] = []
        for parts in (self.collisions, self.visuals):
            solid = united(parts or (), self.body.mass_kg)
            known = [one.inertia.tobytes() + one.centre.tobytes() for _, one in found]
            if parts and solid and solid.inertia.tobytes() + solid.centre.tobytes() not in known:
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
    def span(self) -> tuple[Array, Array]:
        """The least and the greatest coordinates (3,) of the box around the shapes, along the link's axes."""
        parts = [part for parts in (self.collisions, self.visuals) for part in parts or ()]
        low = np.min([part.span[0] for part in parts], axis=0)
        return low, np.max([part.span[1] for part in parts], axis=0)

    @cached_property
    def holds_centre(self) -> bool:
        """Whether the centre of mass is within the box around the shapes of the link."""
        low, high = self.span
        margin = EXPLAINED * (high - low)
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
    ) -> LintFinding:
        """Return a finding, with the right body in the words of the file."""
        link = self.link
        assert link.stated is not None
        uniform = None
        if self.solids:
            uniform = self.numbers(self.solids[0][1].inertia)
            right = right or self.solids[0][1]
        confidence: Confidence = "certain" if severity == "error" else "likely"
        if severity == "note":
            confidence = "possible"
        place = (str(link.file), link.stated.line, link.name)
        found = LintFinding(rule, severity, confidence, *place, message, shapes_kg_m2=uniform)
        if right is None:
            return found
        numbers = self.numbers(right.inertia)
        centre = None
        expected = _as_in_file(numbers, self.model.format)
        if np.linalg.norm(right.centre - self.body.centre_m) > EXPLAINED * self.body.gyration_m:
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
    values = (f"{x:.9g}" for x in numbers)
    texts = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), values, strict=True))
    if form == "urdf":
        return " ".join(f'{name}="{text}"' for name, text in texts.items())
    if form == "sdf":
        return "".join(f"<{name}>{text}</{name}>" for name, text in texts.items())
    full = " ".join(texts[name] for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"))
    return f'fullinertia="{full}"'


def is_placeholder(link: ModelLink) -> bool:
    """Return whether the tensor as written is a power of ten times the identity."""
    if link.stated is None:
        return False
    tensor = doubles(link.stated.inertia.tensor)
    first = float(tensor[0, 0])
    power = f"{first:.0e}"
    same = bool(np.array_equal(tensor, first * np.eye(3)))
    return same and first > 0.0 and power.startswith("1e") and float(power) == first


def agrees(shaped: Shaped, tolerance: float) -> bool:
    """Return whether the tensor is that of the shapes: solid, hollow, one alone, or of several densities."""
    body = MassProperties(shaped.body.mass_kg, shaped.body.centre_m, shaped.body.inertia_kg_m2)
    for parts, solid in shaped.solids:
        alone = (
            one
            for part in parts
            if (one := united([part], body.mass)) is not None
            and np.linalg.norm(one.centre - body.centre) <= CENTRE_OFF * shaped.body.gyration_m
        )
        others = chain([solid], alone, _shells(parts, body.mass), _around(parts, body.mass))
        if any(near(body.inertia, one.inertia, tolerance) for one in others):
            return True
        if len(parts) > 1 and masses_explain(parts, body, EXPLAINED):
            return True
    return False


def near(inertia: Array, other: Array, tolerance: float) -> bool:
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
    if (box := box_around(parts)) is not None and (solid := united([box], mass)) is not None:
        yield solid


def box_around(parts: Sequence[Part]) -> Part | None:
    """Return the box around a single mesh, along its axes; None for other shapes."""
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
