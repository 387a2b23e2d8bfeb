"""What a model file states: its links, their inertias, and the joints between them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.model_files.exact_arithmetic import ExactInertia, Frame, composite
from bodycheck.scenarios.model_files.joint import StatedJoint

Format: TypeAlias = Literal["urdf", "mjcf", "sdf", "usd"]


@dataclass(frozen=True, eq=False)
class StatedInertia:
    """An inertia as written: about the centre of mass, in the axes of an inertial frame of the link.

    derived: how it follows from the file if it is not written, such as "from 2 geoms", with its parts.
    overruled_mass: in kg, of an element <inertial> that the file itself overrules by the geoms.
    """

    line: int
    inertia: ExactInertia
    frame: Frame
    derived: str = ""
    parts: tuple[ExactInertia, ...] = ()
    overruled_mass: float | None = None

    @cached_property
    def in_link(self) -> ExactInertia:
        """The inertia in link axes, with the centre relative to the link's origin."""
        return self.inertia.placed(self.frame)


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape in link axes: its kind, sizes as in its format, pose, and mesh file if it has one.

    A shape whose size or pose cannot be read has no sizes and no mesh. by_ends: whether the file gives the
    two ends of its axis, as fromto of MJCF does. density: in kg/m^3, of a collision of SDFormat.
    """

    kind: str
    size: tuple[float, ...]
    frame: Frame
    mesh: str = ""
    scale: tuple[float, ...] = (1.0, 1.0, 1.0)
    collides: bool = True
    by_ends: bool = False
    density: float | None = None


@dataclass(frozen=True, eq=False)
class WeighedMesh:
    """A mesh geom of MJCF from which the inertia of its body follows, with vertices (n, 3) in m.

    kind: its attribute `inertia`, or that of a mesh without faces. mass in kg, or None and density in kg/m^3.
    """

    name: str
    line: int
    kind: Literal["convex", "exact", "legacy", "shell"]
    mass: float | None
    density: float
    vertices: Array
    triangles: Triangles


@dataclass(frozen=True)
class ModelMistake:
    """A mistake of the file in a link that is read nevertheless: the rule, the line, and what is expected.

    is_certain: whether it is one, whatever was meant.
    """

    rule: str
    line: int
    message: str
    expected: str
    is_certain: bool = True


@dataclass(frozen=True, eq=False)
class ModelLink:
    """A link (URDF, SDFormat) or body (MJCF).

    shapes: those that collide, and all geoms of MJCF; visuals: those of URDF and SDFormat that are only seen.
    stated None: without inertia; unread: why it cannot be computed here; malformed: because of a mistake in
    the file. mistakes: of the file in what is read. static: part of a model of SDFormat that never moves.
    inertia_scaling: the factor of <contact><inertia_scaling>, an element that only Bullet reads.
    meshes: those of MJCF that the inertia follows from. several: the joints of a body of MJCF that has more
    than one, the first next to the parent; then `joint` is None.
    """

    name: str
    line: int
    file: Path
    parent: str | None
    pose: Frame
    joint: StatedJoint | None
    stated: StatedInertia | None
    shapes: tuple[Shape, ...] = ()
    unread: str = ""
    inertia_scaling: float = 1.0
    visuals: tuple[Shape, ...] = ()
    malformed: bool = False
    mistakes: tuple[ModelMistake, ...] = ()
    static: bool = False
    meshes: tuple[WeighedMesh, ...] = ()
    several: tuple[StatedJoint, ...] = ()

    @property
    def place(self) -> int:
        """The line of the inertia that the file states, else that of the link: it stands for the link."""
        return self.line if self.stated is None else self.stated.line

    @property
    def joints(self) -> tuple[StatedJoint, ...]:
        """All joints to the parent."""
        return self.several or (() if self.joint is None else (self.joint,))

    @property
    def collisions(self) -> tuple[Shape, ...]:
        """The shapes that collide."""
        return tuple(shape for shape in self.shapes if shape.collides)


@dataclass(frozen=True, eq=False)
class ModelFile:
    """The links of a file in document order, parents first where the format nests them.

    reads: the other files that it names; notes: sentences about what was read.
    """

    path: Path
    format: Format
    links: tuple[ModelLink, ...]
    reads: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    settings: dict[str, str] = field(default_factory=dict)

    @cached_property
    def by_name(self) -> dict[str, ModelLink]:
        """Name -> link."""
        return {link.name: link for link in self.links}

    @cached_property
    def _children(self) -> dict[str, list[ModelLink]]:
        found: dict[str, list[ModelLink]] = {}
        for link in self.links:
            if link.parent is not None:
                found.setdefault(link.parent, []).append(link)
        return found

    @cached_property
    def placed(self) -> dict[str, Frame]:
        """Name -> pose of the link in the world or the model, with all joints as in the file."""
        found: dict[str, Frame] = {}
        waiting = [(link, link.pose) for link in self.links if link.parent is None]
        while waiting:
            link, pose = waiting.pop()
            found[link.name] = pose
            waiting += [(child, pose @ child.pose) for child in self._children.get(link.name, ())]
        return found

    @cached_property
    def carrying(self) -> frozenset[str]:
        """The links to which fixed joints connect, below them, a link with inertia."""
        found: set[str] = set()
        for link in self.links:
            at = link if link.stated is not None else None
            while at is not None and at.parent is not None and at.joint is not None and at.joint.fixed:
                if at.parent in found:
                    break
                found.add(at.parent)
                at = self.by_name[at.parent]
        return frozenset(found)

    def outside(self) -> tuple[Path, ...]:
        """The files that it names outside of its own folder."""
        folder = self.path.resolve().parent
        return tuple(path for path in self.reads if not path.resolve().is_relative_to(folder))

    def fixed_below(self, name: str) -> Iterator[tuple[ModelLink, Frame]]:
        """Yield the links that fixed joints connect to a link, with their poses in it."""
        waiting = [(child, child.pose) for child in self._children.get(name, ())]
        while waiting:
            link, pose = waiting.pop()
            if link.joint is not None and link.joint.fixed:
                yield link, pose
                waiting += [(child, pose @ child.pose) for child in self._children.get(link.name, ())]

    def members(self, name: str, absent: frozenset[str]) -> list[tuple[ModelLink, Frame]]:
        """Return a link and the absent links fixed to it, with their poses in it."""
        return [
            (self.by_name[name], Frame.of()),
            *((link, pose) for link, pose in self.fixed_below(name) if link.name in absent),
        ]

    def merged(self, name: str, absent: frozenset[str]) -> ExactInertia | None:
        """Return the composite, in the link's axes, of a link and the absent links fixed to it.

        None if one of them has an inertia that cannot be computed here.
        """
        members = self.members(name, absent)
        if any(link.unread for link, _ in members):
            return None
        stated = [link.stated.in_link.placed(pose) for link, pose in members if link.stated]
        return stated[0] if len(stated) == 1 else composite(stated)


def triangle_excess(moments: Array) -> float:
    """(J3 - J1 - J2) / J3 of ascending moments: positive where no body can have them.

    0 where none is positive, and where sums of large numbers in the file are infinite.
    """
    first, second, third = map(float, moments)
    return (third - first - second) / third if 0.0 < third < math.inf else 0.0
