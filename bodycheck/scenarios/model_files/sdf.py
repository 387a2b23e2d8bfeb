"""Read SDFormat: links of all models, their inertials, and the tree of joints.

Source: http://sdformat.org/spec: a pose is x, y, z in m and fixed-axis roll, pitch, yaw in rad, of a link in
its model and of an inertial frame in its link; without <inertial> a link has 1 kg and moments of 1 kg m^2.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import printable
from bodycheck.scenarios.model_files.exact_arithmetic import (
    ExactInertia,
    Frame,
    composite,
    doubles,
    exact,
    mp,
)
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint, limit_of
from bodycheck.scenarios.model_files.mjcf_shapes import geom_inertia
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, Shape, StatedInertia
from bodycheck.scenarios.model_files.sdf_frames import (
    Frames,
    content,
    end,
    is_true,
    numbers,
    pose,
    relative_to,
)
from bodycheck.scenarios.model_files.urdf import geometries, in_a_loop, resolved
from bodycheck.scenarios.model_files.urdf_mistakes import MOMENTS, repeated_inertial
from bodycheck.scenarios.model_files.xml_file import Node

_SIZES = {
    "box": ("size",),
    "sphere": ("radius",),
    "ellipsoid": ("radii",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "cone": ("radius", "length"),
}
_ENDLESS = 1e16  # rad or m: a placeholder for no limit
_DEEPEST = 20  # nested models


def read_sdf(root: Any, path: Path) -> ModelFile:
    """Return the models of an <sdf> element; raises InputError with one line if it cannot be read.

    Links of several models are named MODEL::LINK, those of a nested model NESTED::LINK. Notes name what the
    file includes.
    """
    sdf = Node(root, path)
    if not any(True for _ in sdf.children()):
        raise InputError(f"{sdf.where}: has no <model>")
    reader = _Reader(path, sdf.text("version", ""))
    reader.name_includes(sdf, *sdf.children("world"))
    for before, model in named_models(sdf):
        reader.read(model, before)
    if not reader.links:
        reader.notes.append("The file has no link of its own.")
    meshes = {shape.mesh for link in reader.links for shape in (*link.shapes, *link.visuals) if shape.mesh}
    reads = tuple(sorted(resolved(name, path) for name in meshes))
    return ModelFile(path, "sdf", tuple(reader.links), reads, tuple(reader.notes))


def named_models(sdf: Node) -> list[tuple[str, Node]]:
    """Return what precedes the names of each model's links, and the model."""
    models = [model for place in (sdf, *sdf.children("world")) for model in place.children("model")]
    return [(f"{model.text('name')}::" if len(models) > 1 else "", model) for model in models]


def linked(model: Node, before: str) -> Iterator[tuple[str, Node]]:
    """Yield the name and element of each link of a model and of the models nested in it."""
    for link in model.children("link"):
        yield before + link.text("name"), link
    for nested in model.children("model"):
        yield from linked(nested, f"{before}{nested.text('name')}::")


class _Reader:
    def __init__(self, path: Path, version: str) -> None:
        self.path = path
        self.axes_in_model = version in ("1.0", "1.2", "1.3", "1.4")
        self.links: list[ModelLink] = []
        self.notes: list[str] = []

    def name_includes(self, *places: Node) -> None:
        """Note what elements include."""
        for place in places:
            for node in place.children("include"):
                uri = node.child("uri")
                what = "another file" if uri is None else printable(content(uri), 80)
                self.notes.append(f"{_at(node)}: includes {what}, which is not read.")

    def read(self, model: Node, before: str) -> None:
        """Read a model with its nested models."""
        frames = self._frames(model, 0)
        names = [name for name, _ in linked(model, "")]
        known = set(names)
        if len(known) < len(names):
            seen: set[str] = set()
            for name, node in linked(model, ""):
                if name in seen:
                    raise InputError(f"{node.where}: another link has the name {before + name!r:.80}")
                seen.add(name)
        joints = self._joints(model, frames, "", known)
        for child in in_a_loop({child: parent for child, (parent, _) in joints.items() if parent}):
            _, joint = joints.pop(child)
            self.notes.append(f"line {joint.line}: joint {joint.name!r:.60} closes a loop and is left out.")
        self._links(model, frames, frames, before, "", joints, static=False)

    def _frames(self, model: Node, depth: int) -> Frames:
        if depth > _DEEPEST:
            raise InputError(f"{model.where}: models are nested deeper than {_DEEPEST}")
        nested = {one.text("name"): self._frames(one, depth + 1) for one in model.children("model")}
        return Frames(model, nested)

    def _joints(
        self, model: Node, frames: Frames, before: str, known: set[str]
    ) -> dict[str, tuple[str | None, StatedJoint]]:
        """Return child -> (parent, joint) for the joints of a model and its nested models.

        The parent is None for the world, and for a link that the file does not have.
        """
        found: dict[str, tuple[str | None, StatedJoint]] = {}
        for nested in model.children("model"):
            name = nested.text("name")
            found |= self._joints(nested, frames.nested[name], f"{before}{name}::", known)
        for node in model.children("joint"):
            joint = self._joint(node, frames)
            ends = {tag: end(node, tag) for tag in ("parent", "child")}
            links = {tag: frames.link_of(name) for tag, name in ends.items() if name != "world"}
            named = {tag: before + link for tag, link in links.items() if link and before + link in known}
            if missing := [ends[tag] for tag in links if tag not in named]:
                which = f"link {missing[0]!r:.60}" if missing[0] else "a link"
                self.notes.append(f"{_at(node)}: joint {joint.name!r:.60} names {which}, not in this file.")
            if "child" not in named:
                continue
            child = named["child"]
            if child in found:
                self.notes.append(f"{_at(node)}: joint {joint.name!r:.60} closes a loop and is left out.")
            else:
                found[child] = (named.get("parent"), joint)
        return found

    def _links(
        self,
        model: Node,
        frames: Frames,
        outer: Frames,
        before: str,
        scope: str,
        joints: dict[str, tuple[str | None, StatedJoint]],
        *,
        static: bool,
    ) -> None:
        """Read the links of a model; `scope` precedes their names in the outermost one, `outer`."""
        static |= _flag(model, "static")
        self.name_includes(model)
        for node in model.children("link"):
            name = node.text("name")
            parent, joint = joints.get(scope + name, (None, None))
            placed = outer.pose_of(scope + name)
            at = Frame.of() if parent is None else outer.pose_of(parent)
            if placed is None or at is None:
                parent, joint, placed, at = None, None, Frame.of(), Frame.of()
                self.notes.append(f"{_at(node)}: the pose of link {name!r:.60} depends on what is not read.")
            shapes, visuals = (self._shapes(node, frames, tag) for tag in ("collision", "visual"))
            stated, unread, malformed = None, "", False
            try:
                pose(node)
                stated, unread = self._stated(node, shapes)
            except InputError as error:
                unread, malformed = str(error), True
            self.links.append(
                ModelLink(
                    f"{before}{scope}{name}",
                    node.line,
                    self.path,
                    None if parent is None else before + parent,
                    at.inverse() @ placed,
                    joint,
                    stated,
                    shapes,
                    unread,
                    visuals=visuals,
                    malformed=malformed,
                    mistakes=tuple(repeated_inertial(node)),
                    static=static,
                )
            )
        for nested in model.children("model"):
            name = nested.text("name")
            inner = f"{scope}{name}::"
            self._links(nested, frames.nested[name], outer, before, inner, joints, static=static)

    def _joint(self, node: Node, frames: Frames) -> StatedJoint:
        axis = node.child("axis")
        kind, name = node.text("type", ""), node.text("name", "")
        if kind == "fixed":
            return StatedJoint(name, kind, node.line)
        try:
            limit, dynamics = (None if axis is None else axis.child(tag) for tag in ("limit", "dynamics"))
            limits = (_bound(limit, "lower", -math.inf), _bound(limit, "upper", math.inf))
            along, at = self._axis(node, axis, frames)
            return StatedJoint(
                name,
                kind,
                node.line,
                along,
                _number(dynamics, "damping", 0.0),
                UNLIMITED if max(map(abs, limits)) >= _ENDLESS else limits,
                at,
                friction=_number(dynamics, "friction", 0.0),
                stiffness=_number(dynamics, "spring_stiffness", 0.0),
                rest=_number(dynamics, "spring_reference", 0.0),
                effort=limit_of(_bound(limit, "effort", math.inf)),
                velocity=limit_of(_bound(limit, "velocity", math.inf)),
                mimic=_mimic(axis),
            )
        except InputError as error:
            self.notes.append(f"{error}.")
            return StatedJoint(name, kind, node.line)

    def _axis(
        self, node: Node, axis: Node | None, frames: Frames
    ) -> tuple[tuple[float, ...] | None, tuple[float, ...]]:
        """Return axis and joint point in the axes of the child link; None for an axis that is not known.

        An axis is in the joint's frame, or in the one that `expressed_in` names; until version 1.4 it is in
        the model's frame, until 1.6 where use_parent_model_frame says so.
        """
        link = frames.pose_of(frames.link_of(end(node, "child")) or "?")
        own = frames.pose_of(node.text("name", ""))
        xyz = None if axis is None else axis.child("xyz")
        if link is None or own is None:
            return None, (0.0, 0.0, 0.0)
        to_link = link.inverse()
        at = tuple(doubles((to_link @ own).position).tolist())
        if xyz is None or axis is None:
            return None, at
        base = xyz.text("expressed_in", "")
        if self.axes_in_model or _flag(axis, "use_parent_model_frame"):
            base = "__model__"
        frame = frames.pose_of(base) if base else own
        if frame is None:
            return None, at
        return tuple(doubles(to_link.rotation @ frame.rotation @ exact(numbers(xyz, 3))).tolist()), at

    def _shapes(self, link: Node, frames: Frames, tag: str) -> tuple[Shape, ...]:
        found = []
        for node, shape in geometries(link, tag):
            if shape.tag == "empty":
                continue
            unknown = Shape(shape.tag, (), Frame.of(), density=None)
            try:
                placed = frames.pose_in(link.text("name"), node)
                found.append(unknown if placed is None else _shape(node, shape, placed))
            except InputError as error:
                self.notes.append(f"{error}.")
                found.append(unknown)
        return tuple(found)

    def _stated(self, link: Node, shapes: tuple[Shape, ...]) -> tuple[StatedInertia | None, str]:
        """Return the inertia of a link, or why it is not computed here."""
        inertial = link.child("inertial")
        if inertial is not None and _is_auto(link):
            return _of_shapes(inertial, shapes)
        inertia = None if inertial is None else inertial.child("inertia")
        tensor = np.zeros((3, 3))
        for i, j, name in MOMENTS:
            tensor[i, j] = tensor[j, i] = _number(inertia, name, float(i == j))
        body = ExactInertia(mp.mpf(_number(inertial, "mass", 1.0)), exact(np.zeros(3)), exact(tensor))
        if inertial is None:
            return StatedInertia(link.line, body, Frame.of(), "by the defaults of SDFormat"), ""
        base = relative_to(inertial)
        if base not in ("", link.text("name")):
            return None, f"its <inertial> is relative to {base!r:.60}, which SDFormat's own reader ignores"
        return StatedInertia(inertial.line, body, pose(inertial)), ""


def _at(node: Node) -> str:
    return f"line {node.line}"


def _flag(node: Node, tag: str) -> bool:
    child = node.child(tag)
    return child is not None and content(child) in ("true", "1")


def _is_auto(link: Node) -> bool:
    inertial = link.child("inertial")
    return inertial is not None and is_true(inertial, "auto")


def _number(node: Node | None, tag: str, default: float) -> float:
    child = None if node is None else node.child(tag)
    return default if child is None else numbers(child, 1)[0]


def _bound(limit: Node | None, tag: str, default: float) -> float:
    """Return a limit of a joint, which may be infinite."""
    child = None if limit is None else limit.child(tag)
    word = "" if child is None else content(child).lower().lstrip("+")
    if word.lstrip("-") in ("inf", "infinity"):
        return math.copysign(math.inf, -1.0 if word.startswith("-") else 1.0)
    return _number(limit, tag, default)


def _mimic(axis: Node | None) -> tuple[str, float, float] | None:
    found = None if axis is None else axis.child("mimic")
    if found is None:
        return None
    factor = _number(found, "multiplier", 1.0)
    offset = _number(found, "offset", 0.0) - factor * _number(found, "reference", 0.0)
    return found.text("joint", ""), factor, offset


def _shape(node: Node, shape: Node, placed: Frame) -> Shape:
    density = node.child("density")
    made_of = None if density is None else numbers(density, 1)[0]
    if shape.tag == "mesh":
        uri, scale = shape.child("uri"), shape.child("scale")
        factors = (1.0, 1.0, 1.0) if scale is None else tuple(numbers(scale, 3))
        whole = shape.child("submesh") is None
        name = content(uri) if uri is not None and whole else ""
        return Shape("mesh", (), placed, name, factors, density=made_of)
    size: list[float] = []
    for name in _SIZES.get(shape.tag, ()):
        part = shape.child(name)
        if part is None:
            return Shape(shape.tag, (), placed, density=made_of)
        size += numbers(part, 3 if name in ("size", "radii") else 1)
    return Shape(shape.tag, tuple(size), placed, density=made_of)


def _of_shapes(inertial: Node, shapes: tuple[Shape, ...]) -> tuple[StatedInertia | None, str]:
    """Return the inertia that <inertial auto="true"> means, or why it is not computed here.

    Each collision has its own density, or that of <inertial>, or 1000 kg/m^3; a <mass> scales the sum.
    """
    density = _number(inertial, "density", 1000.0)
    parts = []
    for shape in shapes:
        half = {"box": [size / 2.0 for size in shape.size]}.get(shape.kind, [*shape.size])
        if shape.kind in ("cylinder", "capsule") and len(half) == 2:
            half[1] /= 2.0
        made_of = density if shape.density is None else shape.density
        try:
            size = [mp.mpf(value) for value in half]
            part = geom_inertia(shape.kind, size, shell=False, mass=None, density=mp.mpf(made_of))
        except (TypeError, ValueError, ZeroDivisionError):
            return None, f"its automatic inertia needs a {shape.kind}, which is not computed here"
        parts.append(part.placed(shape.frame))
    if not parts:
        return None, "its automatic inertia has no <collision>"
    total = composite(parts)
    if inertial.child("mass") is not None and total.mass:
        mass = mp.mpf(_number(inertial, "mass", 1.0))
        total = ExactInertia(mass, total.centre, total.tensor * (mass / total.mass))
    plural = "s" if len(parts) > 1 else ""
    return StatedInertia(inertial.line, total, Frame.of(), f"from {len(parts)} collision shape{plural}"), ""
