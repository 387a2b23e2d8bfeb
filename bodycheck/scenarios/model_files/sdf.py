"""Read SDFormat: links of all models, their inertials, and the tree of joints.

Source: http://sdformat.org/spec: a pose is x, y, z in m and fixed-axis roll, pitch, yaw in rad, of a link in
its model and of an inertial frame in its link; without <inertial> a link has 1 kg and moments of 1 kg m^2.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.scenarios.model_files.exact import ExactInertia, Frame, exact, finite, mp, rotation_of_rpy
from bodycheck.scenarios.model_files.model_file import Joint, ModelFile, ModelLink, Shape, StatedInertia
from bodycheck.scenarios.model_files.urdf import MOMENTS, SIZES, check_tree, collision_shapes, resolved
from bodycheck.scenarios.model_files.xml_file import Node

_KINDS = (
    "revolute",
    "revolute2",
    "prismatic",
    "ball",
    "universal",
    "continuous",
    "screw",
    "gearbox",
    "fixed",
)
_BOOLEANS = {"true": True, "false": False, "1": True, "0": False}


def read_sdf(root: Any, path: Path) -> ModelFile:
    """Return the models of an <sdf> element; raises InputError with one line if it cannot be read.

    Links of several models are named MODEL::LINK. Nested and included models are notes, not links.
    """
    sdf = Node(root, path)
    models = named_models(sdf)
    if not models:
        raise InputError(f"{sdf.where}: has no <model>")
    links: list[ModelLink] = []
    notes = []
    for before, model in models:
        links += _links(model, before, path)
        notes += [
            f"{nested.where}: what it adds to the model is not computed here"
            for nested in model.children("model", "include")
        ]
    seen = set()
    for link in links:
        if link.name in seen:
            raise InputError(f"{path}:{link.line}: <link>: another link has the name {link.name!r:.80}")
        seen.add(link.name)
    if not links:
        raise InputError(f"{models[0][1].where}: has no <link>")
    meshes = {shape.mesh for link in links for shape in link.shapes if shape.mesh}
    reads = tuple(sorted(resolved(name, path) for name in meshes))
    return ModelFile(path, "sdf", tuple(links), reads, tuple(notes))


def named_models(sdf: Node) -> list[tuple[str, Node]]:
    """Return what precedes the names of each model's links, and the model."""
    models = [model for place in (sdf, *sdf.children("world")) for model in place.children("model")]
    return [(f"{model.text('name')}::" if len(models) > 1 else "", model) for model in models]


def _links(model: Node, before: str, path: Path) -> list[ModelLink]:
    nodes = [(node.text("name"), node) for node in model.children("link")]
    poses = {name: _pose(node) for name, node in nodes}
    joints: dict[str, tuple[str, Joint]] = {}
    for node in model.children("joint"):
        parent, child = (_content(node, tag) for tag in ("parent", "child"))
        for end in (parent, child):
            if end not in poses and end != "world":
                raise InputError(f"{node.where}: there is no link {end!r:.60}")
        if child in joints:
            raise InputError(f"{node.where}: link {child!r:.60} has two parents")
        joints[child] = (parent, _joint(node))
    check_tree({child: parent for child, (parent, _) in joints.items()}, model)
    links = []
    for name, node in nodes:
        parent, joint = joints.get(name, ("world", None))
        pose = poses[name] if parent == "world" else poses[parent].inverse() @ poses[name]
        above = None if parent == "world" else before + parent
        links.append(
            ModelLink(before + name, node.line, path, above, pose, joint, _stated(node), tuple(_shapes(node)))
        )
    return links


def _content(node: Node, tag: str) -> str:
    child = node.child(tag)
    if child is None:
        raise InputError(f"{node.where}: has no <{tag}>")
    return (child.element.text or "").strip()


def _numbers(node: Node, count: int) -> list[float]:
    try:
        return finite(node.element.text or "", count)
    except ValueError as error:
        raise InputError(f"{node.where}: {error}") from None


def _number(node: Node | None, tag: str, default: float) -> float:
    child = None if node is None else node.child(tag)
    return default if child is None else _numbers(child, 1)[0]


def _pose(node: Node) -> Frame:
    pose = node.child("pose")
    if pose is None:
        return Frame.of()
    for name, known in (("relative_to", ("",)), ("rotation_format", ("", "euler_rpy"))):
        if pose.text(name, "") not in known:
            raise InputError(f"{pose.where}: {name} is not read here; write the pose in the model, as rpy")
    x, y, z, *angles = _numbers(pose, 6)
    if _is_true(pose, "degrees"):
        angles = [math.radians(angle) for angle in angles]
    return Frame.of((x, y, z), rotation_of_rpy(angles))


def _is_true(node: Node, name: str) -> bool:
    """Return an attribute that is false by default; raises InputError if it is not a boolean of XML."""
    word = node.text(name, "false")
    if word not in _BOOLEANS:
        raise InputError(f"{node.where}: {name} = {word!r:.60} (available: {', '.join(_BOOLEANS)})")
    return _BOOLEANS[word]


def _joint(node: Node) -> Joint:
    kind = node.text("type")
    if kind not in _KINDS:
        raise InputError(f"{node.where}: unknown joint type {kind!r:.60} (available: {', '.join(_KINDS)})")
    axis = node.child("axis")
    xyz = None if axis is None else axis.child("xyz")
    limit = None if axis is None else axis.child("limit")
    damping = _number(None if axis is None else axis.child("dynamics"), "damping", 0.0)
    limits = (_number(limit, "lower", -1e16), _number(limit, "upper", 1e16))
    return Joint(
        node.text("name", ""),
        kind,
        node.line,
        None if xyz is None else tuple(_numbers(xyz, 3)),
        None if kind == "fixed" else damping,
        None if limit is None or max(map(abs, limits)) >= 1e16 else limits,
    )


def _stated(link: Node) -> StatedInertia:
    inertial = link.child("inertial")
    inertia = None if inertial is None else inertial.child("inertia")
    tensor = np.zeros((3, 3))
    for i, j, name in MOMENTS:
        tensor[i, j] = tensor[j, i] = _number(inertia, name, float(i == j))
    body = ExactInertia(mp.mpf(_number(inertial, "mass", 1.0)), exact(np.zeros(3)), exact(tensor))
    if inertial is None:
        return StatedInertia(link.line, body, Frame.of(), "by the defaults of SDFormat")
    return StatedInertia(inertial.line, body, _pose(inertial))


def _shapes(link: Node) -> list[Shape]:
    found = []
    for node, shape in collision_shapes(link):
        if shape.tag in SIZES:
            parts = ((name, shape.child(name)) for name in SIZES[shape.tag])
            size = [
                value
                for name, part in parts
                if part is not None
                for value in _numbers(part, 3 if name == "size" else 1)
            ]
            found.append(Shape(shape.tag, tuple(size), _pose(node)))
        elif shape.tag == "mesh" and shape.child("uri") is not None:
            scale = shape.child("scale")
            factors = (1.0, 1.0, 1.0) if scale is None else tuple(_numbers(scale, 3))
            found.append(Shape("mesh", (), _pose(node), _content(shape, "uri"), factors))
    return found
