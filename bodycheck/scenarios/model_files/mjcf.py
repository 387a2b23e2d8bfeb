"""Read the bodies of MJCF: includes, default classes, frames, compiler settings and inertia from geoms.

Source: https://mujoco.readthedocs.io/en/stable/XMLreference.html (compiler, default, body, inertial, geom).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.mass_properties.solid import Triangles
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh
from bodycheck.scenarios.model_files.exact_arithmetic import (
    Exact,
    ExactInertia,
    Frame,
    composite,
    doubles,
    exact,
    finite,
    identity,
    mp,
    norm,
    rotation_about,
    rotation_of_axes,
    rotation_of_euler,
    rotation_of_quaternion,
    rotation_to,
    words_of,
)
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint, limit_of
from bodycheck.scenarios.model_files.mjcf_shapes import (
    SIZES,
    MeshInertia,
    exact_of,
    geom_inertia,
    mesh_inertia,
)
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink, Shape, StatedInertia, WeighedMesh
from bodycheck.scenarios.model_files.xml_file import Node, parse_xml

_TINY_MASS = 1e-14  # kg; lighter geoms do not count
_TINY_LENGTH = 1e-14  # m; half the length of a geom is greater
_ALTERNATIVES = ("axisangle", "euler", "xyaxes", "zaxis")
_ACTUATORS = ("general", "motor", "position", "velocity")
_GENERATORS = ("composite", "flexcomp", "attach")
_MAX_COPIES = 10_000

_Class: TypeAlias = dict[str, dict[str, str]]
"""A default class: element -> its attributes, those of the parent class included."""


def read_mjcf(root: Any, path: Path) -> ModelFile:
    """Return the model of a <mujoco> element; raises InputError with one line if it cannot be read."""
    reader = _Reader(path)
    reader.expand(Node(root, path))
    reader.read_settings()
    for world in reader.sections("worldbody"):
        reader.body_content(world, None, Frame.of(), None, "")
    reader.actuate()
    links = _total_mass(reader.links, finite(reader.compiler.get("settotalmass", "-1"), 1)[0])
    return ModelFile(
        path, "mjcf", tuple(links), tuple(sorted(reader.reads)), tuple(reader.notes), dict(reader.compiler)
    )


def expanded(root: Any, path: Path) -> Any:
    """Return a <mujoco> element with the content of every <include> in its place."""
    _Reader(path).expand(Node(root, path))
    return root


@dataclass
class _Settings:
    """The compiler settings that matter for inertias."""

    degrees: bool = True
    sequence: str = "xyz"
    from_geom: str = "auto"
    groups: tuple[int, int] = (0, 5)
    min_mass: float = 0.0
    min_inertia: float = 0.0
    balance: bool = False


@dataclass
class _Open:
    """A body whose content is being read."""

    node: Node
    name: str
    inertial: StatedInertia | None = None
    explicit: bool = False
    parts: list[ExactInertia] = field(default_factory=list)
    joints: list[StatedJoint] = field(default_factory=list)
    shapes: list[Shape] = field(default_factory=list)
    meshes: list[WeighedMesh] = field(default_factory=list)
    unread: str = ""
    malformed: str = ""
    aligned: bool = False


class _MeshSolid(NamedTuple):
    """A mesh as MuJoCo weighs it at unit density, with vertices (n, 3) in m."""

    unit: ExactInertia
    kind: MeshInertia
    vertices: Array
    triangles: Triangles


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.reads: set[Path] = set()
        self.notes: list[str] = []
        self.links: list[ModelLink] = []
        self.compiler: dict[str, str] = {}
        self.settings = _Settings()
        self._meshes: dict[str, tuple[Node, dict[str, str]]] = {}
        self._solids: dict[str, _MeshSolid] = {}
        self._names: set[str] = set()

    # ------------------------------------------------------------------------------------ files and sections

    def expand(self, root: Node) -> None:
        """Replace every <include> by the content of its file; a file is included at most once."""
        self._files: dict[Any, Path] = {}
        self._included = {self.path.resolve()}
        self._include(root.element, self.path)
        self._root = root

    def _include(self, element: Any, file: Path) -> None:
        for child in list(element):
            if not isinstance(child.tag, str):
                continue
            if child.tag != "include":
                self._files[child] = file
                self._include(child, file)
                continue
            name = Node(child, file).text("file")
            target = self.path.parent / name
            self.reads.add(target)
            try:
                repeated = target.resolve() in self._included
            except (OSError, ValueError):
                repeated = False
            if repeated:
                raise InputError(f"{file}:{child.sourceline}: <include>: {name!r:.80} is included twice")
            self._included.add(target.resolve())
            try:
                inner = parse_xml(target)
            except InputError as error:
                raise InputError(f"{file}:{child.sourceline}: <include>: {error}") from None
            self._include(inner, target)
            for one in list(inner):
                child.addprevious(one)
            element.remove(child)

    def _node(self, element: Any) -> Node:
        return Node(element, self._files.get(element, self.path))

    def _nodes(self, node: Node, *tags: str) -> Iterator[Node]:
        for child in node.children(*tags):
            yield self._node(child.element)

    def sections(self, tag: str) -> Iterator[Node]:
        """Yield the sections of this name."""
        yield from self._nodes(self._root, tag)

    def read_settings(self) -> None:
        """Read compiler settings, default classes and meshes."""
        for section in self.sections("compiler"):
            self.compiler |= {str(name): str(value) for name, value in section.element.attrib.items()}
            self._compiler_at = section
        if self.compiler:
            self.settings = self._settings(self._compiler_at)
        self._classes: dict[str, _Class] = {"main": {}}
        for section in self.sections("default"):
            self._default(section, "main")
        for assets in self.sections("asset"):
            for node in self._nodes(assets, "mesh"):
                own = self._attributes(node, None)
                name = own.get("name") or Path(own.get("file", "").replace("\\", "/")).stem
                self._meshes[name] = (node, own)
                if "file" in own:
                    self.reads.add(self._mesh_path(own["file"]))
            for node in self._nodes(assets, "model"):
                if "file" in node:
                    self.reads.add(self.path.parent / node.text("file"))

    def _settings(self, at: Node) -> _Settings:
        def numbers(name: str, count: int, default: str) -> list[float]:
            try:
                return finite(self.compiler.get(name, default), count)
            except ValueError as error:
                raise InputError(f"{at.where}: {name} = {error}") from None

        def word(name: str, *known: str) -> str:
            found = self.compiler.get(name, known[0])
            if found not in known:
                raise InputError(f"{at.where}: {name} = {found!r:.60} (available: {', '.join(known)})")
            return found

        sequence = self.compiler.get("eulerseq", "xyz")
        if not re.fullmatch("[xyzXYZ]{3}", sequence):
            raise InputError(f"{at.where}: eulerseq = {sequence!r:.60} (expected three letters, like xyz)")
        if self.compiler.get("coordinate", "local") != "local":
            raise InputError(f"{at.where}: coordinate = 'global' is not read; MuJoCo 2.3.3 converts it")
        low, high = numbers("inertiagrouprange", 2, "0 5")
        numbers("settotalmass", 1, "-1")
        return _Settings(
            word("angle", "degree", "radian") == "degree",
            sequence,
            word("inertiafromgeom", "auto", "true", "false"),
            (int(low), int(high)),
            numbers("boundmass", 1, "0")[0],
            numbers("boundinertia", 1, "0")[0],
            word("balanceinertia", "false", "true") == "true",
        )

    def _default(self, section: Node, parent: str) -> None:
        name = section.text("class", parent)
        own = self._classes[parent] if name == parent else dict(self._classes[parent])
        self._classes[name] = own
        for node in self._nodes(section):
            if node.tag in ("mesh", "geom", "joint", *_ACTUATORS):
                attributes = {str(k): str(v) for k, v in node.element.attrib.items()}
                own[node.tag] = _overridden(own.get(node.tag, {}), attributes)
        for node in self._nodes(section, "default"):
            if "class" not in node:
                raise InputError(f"{node.where}: has no attribute 'class'")
            self._default(node, name)

    def _attributes(self, node: Node, childclass: str | None) -> dict[str, str]:
        """Return the attributes of an element over those of its class."""
        name = node.element.get("class") or childclass or "main"
        if name not in self._classes:
            known = ", ".join(sorted(self._classes))
            raise InputError(f"{node.where}: unknown default class {name!r:.60} (available: {known:.200})")
        attributes = {str(k): str(v) for k, v in node.element.attrib.items()}
        return _overridden(self._classes[name].get(node.tag, {}), attributes)

    def _mesh_path(self, name: str) -> Path:
        name = name.replace("\\", "/")
        if self.compiler.get("strippath") == "true":
            name = name.rpartition("/")[2]
        folder = self.compiler.get("meshdir", self.compiler.get("assetdir", ""))
        return self.path.parent / folder / name

    # ------------------------------------------------------------------------------------------------ bodies

    def body_content(
        self, node: Node, body: _Open | None, frame: Frame, childclass: str | None, suffix: str
    ) -> None:
        """Read what a body, a frame or the world (body None) has; `frame` is its pose in the body."""
        for child in self._nodes(node):
            match child.tag:
                case "body":
                    self._body(child, body, frame, childclass, suffix)
                case "frame":
                    inner = frame @ self._pose(child, _raw(child))
                    own = child.element.get("childclass") or childclass
                    self.body_content(child, body, inner, own, suffix)
                case "replicate":
                    self._replicate(child, body, frame, childclass, suffix)
                case "inertial" | "geom" if body is not None:
                    try:
                        if child.tag == "geom":
                            self._geom(child, body, frame, childclass)
                        else:
                            body.explicit, body.inertial = True, self._inertial(child)
                    except InputError as error:
                        body.malformed = body.malformed or str(error)
                case "joint" | "freejoint" if body is not None:
                    aligned = child.element.get("align", "auto")
                    if child.tag == "freejoint" and aligned == "auto":
                        aligned = self.compiler.get("alignfree", "false")
                    body.aligned = child.tag == "freejoint" and aligned == "true"
                    body.joints.append(self._joint(child, childclass, frame))
                case tag if tag in _GENERATORS:
                    self.notes.append(f"{child.where}: what it adds to the model is not computed here")
                    if body is not None and tag == "composite":
                        body.unread = f"has a <{tag}> in line {child.line}"

    def _body(
        self, node: Node, parent: _Open | None, frame: Frame, childclass: str | None, suffix: str
    ) -> None:
        name = self._name(node, suffix)
        body = _Open(node, name)
        place = len(self.links)
        pose = frame @ self._pose(node, _raw(node))
        link = ModelLink(
            name, node.line, node.file, None if parent is None else parent.name, pose, None, None
        )
        self.links.append(link)
        self.body_content(node, body, Frame.of(), node.element.get("childclass") or childclass, suffix)
        stated, unread = (None, body.malformed) if body.malformed else self._stated(body)
        if body.aligned and not any(True for _ in node.children("body")):
            stated, unread = None, "the free joint makes its axes principal, in an order that is not stated"
        joint = body.joints[0] if len(body.joints) == 1 else None
        if not body.joints:
            joint = StatedJoint("", "mocap" if node.element.get("mocap") == "true" else "fixed", node.line)
        self.links[place] = replace(
            link,
            stated=stated,
            unread=unread,
            joint=joint,
            shapes=tuple(body.shapes),
            malformed=bool(body.malformed),
            meshes=tuple(body.meshes) if stated is not None and stated.parts else (),
            several=tuple(body.joints) if len(body.joints) > 1 else (),
        )

    def _name(self, node: Node, suffix: str) -> str:
        """Return the name of a body, or its place; raises InputError if another body has its name."""
        if own := node.element.get("name", ""):
            name = f"{own}{suffix}"
            if name in self._names:
                raise InputError(f"{node.where}: another body has the name {name!r}")
        else:
            place = f"line {node.line}" if node.file == self.path else f"{node.file.name}:{node.line}"
            name = first = f"body at {place}{suffix}"
            for number in count(2):
                if name not in self._names:
                    break
                name = f"{first} ({number})"
        self._names.add(name)
        return name

    def _replicate(
        self, node: Node, body: _Open | None, frame: Frame, childclass: str | None, suffix: str
    ) -> None:
        copies = node.numbers("count", 1)[0]
        if not 0 <= copies <= _MAX_COPIES or copies != int(copies):
            raise InputError(f"{node.where}: count = {copies:g} (expected an integer up to {_MAX_COPIES})")
        offset = exact(node.numbers("offset", 3, "0 0 0"))
        euler = node.numbers("euler", 3, "0 0 0")
        step = Frame(self._euler(euler), offset)
        position = exact(np.zeros(3))
        for k in range(int(copies)):
            rotation = self._euler([k * angle for angle in euler])
            own = f"{node.text('sep', '')}{k:0{len(str(int(copies)))}d}"
            placed = frame @ Frame(rotation, position)
            self.body_content(node, body, placed, node.element.get("childclass") or childclass, own + suffix)
            position = (Frame(rotation, position) @ step).position

    def _stated(self, body: _Open) -> tuple[StatedInertia | None, str]:
        """Return the inertia of a body by the compiler's rules, or why it is not computed here."""
        settings = self.settings
        from_geoms = settings.from_geom == "true" or (settings.from_geom == "auto" and not body.explicit)
        parts = [part for part in body.parts if part.mass > _TINY_MASS]
        stated = body.inertial
        if from_geoms and body.unread:
            return None, body.unread
        if from_geoms and parts:
            total = composite(parts)
            derived = f"from {len(parts)} geom{'s' if len(parts) > 1 else ''}"
            overruled = None if body.inertial is None else float(body.inertial.inertia.mass)
            stated = StatedInertia(body.node.line, total, Frame.of(), derived, tuple(parts), overruled)
        if stated is None and not (settings.min_mass or settings.min_inertia):
            return None, ""
        if stated is None:
            zero = exact(np.zeros((3, 3)))
            stated = StatedInertia(body.node.line, ExactInertia(mp.mpf(0), zero[0], zero), Frame.of())
        return self._corrected(stated), ""

    def _corrected(self, stated: StatedInertia) -> StatedInertia:
        """Apply boundmass, boundinertia and balanceinertia."""
        settings, body = self.settings, stated.inertia
        if not (settings.min_mass or settings.min_inertia or settings.balance):
            return stated
        mass = max(body.mass, mp.mpf(settings.min_mass))
        values, axes = mp.eigsy(mp.matrix(body.tensor.tolist()))
        moments = [max(value, mp.mpf(settings.min_inertia)) for value in values]
        changed = mass != body.mass or moments != list(values)
        if settings.balance and 2 * max(moments) > sum(moments):
            moments, changed = [sum(moments) / 3] * 3, True
        if not changed:
            return stated
        A = np.array(axes.tolist(), dtype=object)
        tensor = sum(moment * np.outer(A[:, k], A[:, k]) for k, moment in enumerate(moments))
        derived = "; ".join(filter(None, (stated.derived, "corrected by the compiler settings of the file")))
        return replace(stated, inertia=ExactInertia(mass, body.centre, np.asarray(tensor)), derived=derived)

    # ------------------------------------------------------------------------------------ inertials and geoms

    def _inertial(self, node: Node) -> StatedInertia:
        own = _raw(node)
        tensor = exact(np.zeros((3, 3)))
        full = "fullinertia" in own
        if full and "diaginertia" in own:
            raise InputError(f"{node.where}: has both diaginertia and fullinertia; give one of them")
        if full:
            values = exact(node.numbers("fullinertia", 6))
            for value, (i, j) in zip(values, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True):
                tensor[i, j] = tensor[j, i] = value
        elif "diaginertia" in own:
            for axis, value in enumerate(exact(node.numbers("diaginertia", 3))):
                tensor[axis, axis] = value
        frame = self._pose(node, own)
        if full:  # MuJoCo's reference: the orientation then follows from the matrix
            frame = Frame(identity(), frame.position)
        body = ExactInertia(mp.mpf(node.number("mass")), exact(np.zeros(3)), tensor)
        return StatedInertia(node.line, body, frame)

    def _geom(self, node: Node, body: _Open, frame: Frame, childclass: str | None) -> None:
        own = self._attributes(node, childclass)
        kind = own.get("type", "sphere")
        pose, size = self._geom_pose(node, own, kind)
        pose = frame @ pose
        sizes = tuple(float(value) for value in size)
        collides = own.get("contype", "1") != "0" or own.get("conaffinity", "1") != "0"
        mesh, scale = self._mesh_file(own.get("mesh", ""))
        body.shapes.append(Shape(kind, sizes, pose, mesh, scale, collides, by_ends="fromto" in own))
        low, high = self.settings.groups
        group = _number(node, own, "group", 0.0)
        if not low <= group <= high or kind == "plane":
            return
        mass = None if "mass" not in own else mp.mpf(_number(node, own, "mass", 0.0))
        density = mp.mpf(_number(node, own, "density", 1000.0))
        if mass == 0 or (mass is None and density == 0):
            return
        try:
            if kind == "mesh":
                part = self._mesh_part(node, own, mass, density, body)
            elif "mesh" in own:
                raise ValueError(f"a {kind} fitted to a mesh is not computed here")
            elif kind in SIZES:
                shell = own.get("shellinertia") == "true"
                part = geom_inertia(kind, size, shell=shell, mass=mass, density=density)
            else:
                raise ValueError(f"a geom of type {kind!r:.40} is not computed here")
        except (ValueError, InputError) as error:
            body.unread = f"{node.file.name}:{node.line}: {error}"
            return
        body.parts.append(part.placed(pose))

    def _geom_pose(self, node: Node, own: dict[str, str], kind: str) -> tuple[Frame, list[Any]]:
        size = [mp.mpf(value) for value in _numbers(node, own, "size", "")]
        if "fromto" not in own:
            if kind in SIZES and "mesh" not in own and len(size) < SIZES[kind]:
                raise InputError(f"{node.where}: size has {len(size)} numbers (a {kind} needs {SIZES[kind]})")
            size = size[: SIZES.get(kind, 3)]
            if kind in SIZES and "mesh" not in own and not all(value > 0 for value in size):
                raise InputError(f"{node.where}: size must be positive")
            return self._pose(node, own), size
        ends = exact(_numbers(node, own, "fromto", "", 6))
        along = ends[:3] - ends[3:]
        if kind not in ("capsule", "cylinder", "box", "ellipsoid") or not size or not size[0] > 0:
            raise InputError(f"{node.where}: fromto needs a capsule, cylinder, box or ellipsoid with a size")
        half = norm(along) / 2
        if not half > _TINY_LENGTH:
            raise InputError(f"{node.where}: the points of fromto are too close")
        shape = [size[0], size[0], half] if kind in ("box", "ellipsoid") else [size[0], half]
        return Frame(rotation_to(along), (ends[:3] + ends[3:]) / 2), shape

    def _mesh_file(self, name: str) -> tuple[str, tuple[float, ...]]:
        """Return the file and the scale of a mesh; "" where it has none."""
        node, own = self._meshes.get(name, (None, {}))
        if node is None or "file" not in own:
            return "", (1.0, 1.0, 1.0)
        path = self._mesh_path(own["file"]).absolute()
        return str(path), tuple(_numbers(node, own, "scale", "1 1 1", 3))

    def _mesh_part(
        self, node: Node, own: dict[str, str], mass: Any, density: Any, body: _Open
    ) -> ExactInertia:
        name = own.get("mesh", "")
        if name not in self._meshes:
            raise InputError(f"{node.where}: unknown mesh {name!r:.60}")
        if name not in self._solids:
            self._solids[name] = self._mesh_solid(*self._meshes[name])
        solid = self._solids[name]
        total = density * solid.unit.mass if mass is None else mass
        given = None if mass is None else float(mass)
        body.meshes.append(
            WeighedMesh(name, node.line, solid.kind, given, float(density), solid.vertices, solid.triangles)
        )
        return ExactInertia(total, solid.unit.centre, solid.unit.tensor * (total / solid.unit.mass))

    def _mesh_solid(self, node: Node, own: dict[str, str]) -> _MeshSolid:
        if own.get("inertia", "legacy") not in ("convex", "exact", "legacy", "shell"):
            raise ValueError(f"mesh inertia {own['inertia']!r:.40} is not computed here")
        if "file" in own:
            path = self._mesh_path(own["file"])
            with open_mesh(path) as file:
                vertices, triangles = parse_mesh(path, file)
        elif "vertex" in own:
            vertices = np.array(_numbers(node, own, "vertex", ""))
            faces = np.array(_numbers(node, own, "face", ""))
            if len(vertices) % 3 or len(faces) % 3 or len(vertices) < 12:
                raise InputError(f"{node.where}: vertex and face need three numbers for each item")
            vertices = vertices.reshape(-1, 3)
            triangles = faces.reshape(-1, 3).astype(np.int64)
            if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
                raise InputError(f"{node.where}: face names a vertex that does not exist")
        else:
            raise ValueError("a generated mesh is not computed here")
        R = np.asarray(rotation_of_quaternion(_numbers(node, own, "refquat", "1 0 0 0", 4)), dtype=np.float64)
        scale = np.array(_numbers(node, own, "scale", "1 1 1", 3))
        vertices = (vertices - _numbers(node, own, "refpos", "0 0 0", 3)) @ R * scale
        if np.prod(scale) < 0.0:
            triangles = triangles[:, [0, 2, 1]]
        kind: Any = "convex" if not len(triangles) else own.get("inertia", "legacy")
        return _MeshSolid(exact_of(*mesh_inertia(vertices, triangles, kind)), kind, vertices, triangles)

    # --------------------------------------------------------------------------------------- poses and joints

    def _pose(self, node: Node, own: dict[str, str]) -> Frame:
        """Return the pose by pos and one of quat, axisangle, euler, xyaxes, zaxis."""
        position = _numbers(node, own, "pos", "0 0 0", 3)
        alternative = next((name for name in _ALTERNATIVES if name in own), None)
        return Frame.of(position, self._rotation(node, own, alternative))

    def _rotation(self, node: Node, own: dict[str, str], alternative: str | None) -> Exact:
        match alternative:
            case "euler":
                return self._euler(_numbers(node, own, "euler", "", 3))
            case "axisangle":
                *axis, angle = _numbers(node, own, "axisangle", "", 4)
                return rotation_about(_direction(node, axis), self._angle(angle))
            case "xyaxes":
                values = _numbers(node, own, "xyaxes", "", 6)
                x, y = _direction(node, values[:3]), _direction(node, values[3:])
                _direction(node, np.cross(values[:3], values[3:]).tolist())
                return rotation_of_axes(x, y)
            case "zaxis":
                return rotation_to(_direction(node, _numbers(node, own, "zaxis", "", 3)))
        quaternion = _numbers(node, own, "quat", "1 0 0 0", 4)
        _direction(node, quaternion)
        return rotation_of_quaternion(quaternion)

    def _angle(self, value: Any) -> Any:
        return mp.mpf(value) * mp.pi / 180 if self.settings.degrees else mp.mpf(value)

    def _euler(self, angles: list[float]) -> Exact:
        return rotation_of_euler([self._angle(angle) for angle in angles], self.settings.sequence)

    def _joint(self, node: Node, childclass: str | None, frame: Frame) -> StatedJoint:
        if node.tag == "freejoint":
            return StatedJoint(
                node.text("name", ""), "free", node.line, damping=0.0, friction=0.0, armature=0.0
            )
        own = self._attributes(node, childclass)
        kind = own.get("type", "hinge")
        unit = math.pi / 180.0 if kind in ("hinge", "ball") and self.settings.degrees else 1.0

        def first(name: str) -> float:
            return [*_numbers(node, own, name, "0"), 0.0][0]

        limits = UNLIMITED
        automatic = self.compiler.get("autolimits", "true") == "true"
        if "range" in own and (own.get("limited", "auto") == "true" or (automatic and "limited" not in own)):
            low, high = _numbers(node, own, "range", "", 2)
            limits = (low * unit, high * unit)
        axis, at = (
            None,
            doubles(frame.rotation @ exact(_numbers(node, own, "pos", "0 0 0", 3)) + frame.position),
        )
        if kind in ("hinge", "slide"):
            along = frame.rotation @ exact(_numbers(node, own, "axis", "0 0 1", 3))
            axis = tuple(doubles(along).tolist())
        effort = _numbers(node, own, "actuatorfrcrange", "0 0", 2)  # ignored by balls
        by_times = any(_numbers(node, own, "springdamper", "0 0"))
        return StatedJoint(
            own.get("name", ""),
            kind,
            node.line,
            axis,
            math.nan if by_times else first("damping"),
            limits,
            tuple(at.tolist()),
            friction=first("frictionloss"),
            armature=first("armature"),
            stiffness=math.nan if by_times else first("stiffness"),
            rest=first("springref") * unit,
            reference=first("ref") * unit,
            effort=math.inf if axis is None else limit_of(max(map(abs, effort))),
            gains=(0.0, 0.0),
        )

    def actuate(self) -> None:
        """Add to each joint the gains of its actuators and what an <equality> makes it follow."""
        gains: dict[str, list[tuple[float, float]]] = {}
        for section in self.sections("actuator"):
            for node in self._nodes(section, *_ACTUATORS):
                own = self._actuator(node)
                gains.setdefault(own.get("joint", own.get("jointinparent", "")), []).append(_gains(node, own))
        mimics = {}
        for section in self.sections("equality"):
            for node in self._nodes(section, "joint"):
                own = _raw(node)
                terms = _numbers(node, own, "polycoef", "0 1 0 0 0", 5)
                if "joint2" in own and not any(terms[2:]) and own.get("active") != "false":
                    mimics[own.get("joint1", "")] = (own["joint2"], terms[1], terms[0])

        def actuated(joint: StatedJoint) -> StatedJoint:
            known = gains.get(joint.name, [])
            total = (sum((one[0] for one in known), 0.0), sum((one[1] for one in known), 0.0))
            return replace(joint, gains=total, mimic=mimics.get(joint.name))

        for place, link in enumerate(self.links):
            if link.joint is not None and not link.joint.fixed and link.joint.kind != "mocap":
                self.links[place] = replace(link, joint=actuated(link.joint))
            elif link.several:
                self.links[place] = replace(link, several=tuple(map(actuated, link.several)))

    def _actuator(self, node: Node) -> dict[str, str]:
        """Return the attributes of an actuator; all kinds share the defaults of <general>."""
        shared = self._classes.get(node.element.get("class") or "main", {}).get("general", {})
        return {**shared, **self._attributes(node, None)}


def _gains(node: Node, own: dict[str, str]) -> tuple[float, float]:
    """Return the stiffness and the damping of an actuator in its joint; NaN if they are not stated."""
    gear = [*_numbers(node, own, "gear", "1"), 0.0][0]
    match node.tag:
        case "position" if "dampratio" in own or "timeconst" in own:
            gains = (_number(node, own, "kp", 1.0), math.nan)
        case "position":
            gains = (_number(node, own, "kp", 1.0), _number(node, own, "kv", 0.0))
        case "velocity":
            gains = (0.0, _number(node, own, "kv", 1.0))
        case "general" if own.get("biastype") == "affine":
            _, position, velocity, *_ = [*_numbers(node, own, "biasprm", "0 0 0"), 0.0, 0.0, 0.0]
            gains = (-position, -velocity)
        case _:
            gains = (0.0, 0.0)
    return gear * gear * gains[0], gear * gear * gains[1]


def _overridden(before: dict[str, str], own: dict[str, str]) -> dict[str, str]:
    """Return own over those of a class; an orientation replaces any, a size its first numbers."""
    found = dict(before)
    if any(name in own for name in _ALTERNATIVES):
        found = {name: value for name, value in found.items() if name not in _ALTERNATIVES}
    if "size" in own and "size" in found:
        sizes = words_of(own["size"])
        own = {**own, "size": " ".join([*sizes, *words_of(found["size"])[len(sizes) :]])}
    return {**found, **own}


def _raw(node: Node) -> dict[str, str]:
    return {str(name): str(value) for name, value in node.element.attrib.items()}


def _numbers(
    node: Node, own: dict[str, str], name: str, default: str, count: int | None = None
) -> list[float]:
    try:
        return finite(own.get(name, default), count)
    except ValueError as error:
        raise InputError(f"{node.where}: {name} = {error}") from None


def _number(node: Node, own: dict[str, str], name: str, default: float) -> float:
    return default if name not in own else _numbers(node, own, name, "", 1)[0]


def _direction(node: Node, values: list[float]) -> Exact:
    """Return a vector; raises InputError if it is zero."""
    if not max(map(abs, values)) > 0.0:
        raise InputError(f"{node.where}: a direction or quaternion is zero")
    return exact(values)


def _total_mass(links: list[ModelLink], total: float) -> list[ModelLink]:
    """Scale all masses and tensors so that the masses add up to `total`, if it is positive."""
    now = sum((link.stated.inertia.mass for link in links if link.stated), mp.mpf(0))
    if not total > 0.0 or not now > 0:
        return links
    factor = mp.mpf(total) / now
    scaled = []
    for link in links:
        if link.stated is not None:
            body = link.stated.inertia
            inertia = ExactInertia(body.mass * factor, body.centre, body.tensor * factor)
            link = replace(link, stated=replace(link.stated, inertia=inertia))
        scaled.append(link)
    return scaled
