"""Read URDF: links, their inertials, and the tree of joints.

Source: http://wiki.ros.org/urdf/XML/link and /joint: the origin of <inertial> is the pose of the inertial
frame in the link frame, in m and fixed-axis roll, pitch, yaw; the tensor is in its axes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.scenarios.model_files.exact_arithmetic import ExactInertia, Frame, exact, mp, rotation_of_rpy
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint, limit_of
from bodycheck.scenarios.model_files.model_file import (
    ModelFile,
    ModelLink,
    Shape,
    StatedInertia,
)
from bodycheck.scenarios.model_files.urdf_mistakes import MOMENTS, SIZES, mistakes_of
from bodycheck.scenarios.model_files.xml_file import Node

_MOVABLE = ("revolute", "continuous", "prismatic", "floating", "planar", "spherical")


def read_urdf(root: Any, path: Path) -> ModelFile:
    """Return the model of a <robot> element; raises InputError with one line if it is not a tree of links."""
    robot = Node(root, path)
    nodes = list(robot.children("link"))
    if not nodes:
        raise InputError(f"{robot.where}: has no <link>")
    names = [node.text("name") for node in nodes]
    known = Counter(names)
    for node, name in zip(nodes, names, strict=True):
        if known[name] > 1:
            raise InputError(f"{node.where}: another link has the name {name!r}")
    parents = _parents(robot, set(names))
    for child in in_a_loop({child: parent for child, (parent, *_) in parents.items()}):
        raise InputError(f"{robot.where}: link {child!r} is its own ancestor")
    links = [_link(node, name, path, parents) for node, name in zip(nodes, names, strict=True)]
    meshes = {mesh.text("filename") for mesh in _meshes(robot)}
    reads = tuple(sorted(resolved(name, path) for name in meshes))
    return ModelFile(path, "urdf", tuple(links), reads)


def _link(
    node: Node, name: str, path: Path, parents: Mapping[str, tuple[str, Frame, StatedJoint, Node]]
) -> ModelLink:
    """Return a link; one whose numbers cannot be read states why."""
    parent, pose, joint, hung_from = parents.get(name, (None, Frame.of(), None, None))
    stated, unread, scaling = None, "", 1.0
    try:
        stated, scaling = _stated(node), _inertia_scaling(node)
    except InputError as error:
        unread = str(error)
    return ModelLink(
        name,
        node.line,
        path,
        parent,
        pose,
        joint,
        stated,
        tuple(_shapes(node, "collision")),
        unread,
        scaling,
        tuple(_shapes(node, "visual")),
        malformed=bool(unread),
        mistakes=tuple(mistakes_of(node, hung_from)),
    )


def resolved(name: str, model: Path) -> Path:
    """Return the file that a mesh name means: relative to the model, or package://PACKAGE/FILE.

    A package is the nearest folder of that name at or above the model; without one, the model's own folder.
    Names from the root of a disk that does not have them are relative to the model, as for Bullet.
    """
    for scheme in ("file://", "model://"):
        name = name.removeprefix(scheme)
    if not name.startswith("package://"):
        return Path(name) if _exists(name) else model.parent / name.lstrip("/")
    package, _, rest = name.removeprefix("package://").lstrip("/").partition("/")
    for folder in model.absolute().parents:
        if folder.name == package:
            return folder / rest
        if (folder / package).is_dir():
            return folder / package / rest
    return model.parent / rest


def _exists(name: str) -> bool:
    try:
        return name.startswith("/") and Path(name).exists()
    except (OSError, ValueError):  # too long, or not a name at all
        return False


def _meshes(robot: Node) -> list[Node]:
    found = []
    for link in robot.children("link"):
        for shape in link.children("visual", "collision"):
            geometry = shape.child("geometry")
            mesh = geometry.child("mesh") if geometry else None
            if mesh is not None and "filename" in mesh:
                found.append(mesh)
    return found


def _parents(robot: Node, names: set[str]) -> dict[str, tuple[str, Frame, StatedJoint, Node]]:
    """Return child -> (parent, its pose in the parent, the joint, its element)."""
    found: dict[str, tuple[str, Frame, StatedJoint, Node]] = {}
    for node in robot.children("joint"):
        ends = []
        for tag in ("parent", "child"):
            end = node.child(tag)
            if end is None:
                raise InputError(f"{node.where}: has no <{tag}>")
            if end.text("link") not in names:
                raise InputError(f"{end.where}: there is no link {end.text('link')!r}")
            ends.append(end.text("link"))
        parent, child = ends
        if child in found:
            raise InputError(f"{node.where}: link {child!r} has two parents")
        found[child] = (parent, _origin(node), _joint(node), node)
    return found


def in_a_loop(parents: Mapping[str, str]) -> list[str]:
    """Return one link of each loop in child -> parent; without their parents the others are trees."""
    found: list[str] = []
    done: set[str] = set()
    for start in parents:
        name, path = start, set[str]()
        while name in parents and name not in done:
            done.add(name)
            path.add(name)
            name = parents[name]
            if name in path:
                found.append(name)
    return found


def _joint(node: Node) -> StatedJoint:
    kind = node.text("type")
    if kind != "fixed" and kind not in _MOVABLE:
        known = ", ".join(("fixed", *_MOVABLE))
        raise InputError(f"{node.where}: unknown joint type {kind!r:.60} (available: {known})")
    axis, dynamics, limit, mimic = map(node.child, ("axis", "dynamics", "limit", "mimic"))
    name = node.text("name", "")
    if kind == "fixed":
        return StatedJoint(name, kind, node.line)

    def number(of: Node | None, key: str) -> float:
        return 0.0 if of is None else of.number(key, 0.0)

    limits = UNLIMITED
    if limit is not None and kind in ("revolute", "prismatic"):
        limits = (number(limit, "lower"), number(limit, "upper"))
    return StatedJoint(
        name,
        kind,
        node.line,
        tuple(axis.leading("xyz", 3, "1 0 0")) if axis is not None else (1.0, 0.0, 0.0),
        number(dynamics, "damping"),
        limits,
        friction=number(dynamics, "friction"),
        effort=limit_of(number(limit, "effort")),
        velocity=limit_of(number(limit, "velocity")),
        mimic=None
        if mimic is None
        else (mimic.text("joint", ""), mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)),
    )


def _origin(node: Node) -> Frame:
    origin = node.child("origin")
    if origin is None:
        return Frame.of()
    if "quat_xyzw" in origin and "rpy" not in origin:
        raise InputError(f"{origin.where}: quat_xyzw is not read here; write rpy")
    return Frame.of(origin.leading("xyz", 3, "0 0 0"), rotation_of_rpy(origin.leading("rpy", 3, "0 0 0")))


def _stated(link: Node) -> StatedInertia | None:
    inertial = link.child("inertial")
    if inertial is None:
        return None
    mass, inertia = inertial.child("mass"), inertial.child("inertia")
    m = mp.mpf(mass.number("value")) if mass is not None else mp.mpf(0)
    tensor = np.zeros((3, 3))
    if inertia is not None:
        for i, j, name in MOMENTS:
            tensor[i, j] = tensor[j, i] = inertia.number(name, 0.0)
    body = ExactInertia(m, exact(np.zeros(3)), exact(tensor))
    return StatedInertia(inertial.line, body, _origin(inertial))


def _inertia_scaling(link: Node) -> float:
    contact = link.child("contact")
    scaling = contact.child("inertia_scaling") if contact is not None else None
    return 1.0 if scaling is None else scaling.number("value", 1.0)


def geometries(link: Node, tag: str) -> Iterator[tuple[Node, Node]]:
    """Yield each <collision> or <visual> of a link, as `tag` says, and the element below its <geometry>."""
    for node in link.children(tag):
        geometry = node.child("geometry")
        for shape in geometry.children() if geometry is not None else ():
            yield node, shape


def _shapes(link: Node, tag: str) -> Iterator[Shape]:
    """Yield the shapes of a link; one that cannot be read has no size."""
    for node, shape in geometries(link, tag):
        try:
            frame = _origin(node)
            if shape.tag == "mesh":
                scale = tuple(shape.numbers("scale", None, "1 1 1"))
                yield Shape("mesh", (), frame, shape.text("filename", ""), scale)
            else:
                names = SIZES.get(shape.tag, ())
                yield Shape(shape.tag, tuple(value for name in names for value in shape.numbers(name)), frame)
        except InputError:
            yield Shape(shape.tag, (), Frame.of())
