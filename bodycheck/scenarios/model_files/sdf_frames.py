"""Poses of SDFormat: the frames of one model, which links, joints, frames and nested models define.

Source: http://sdformat.org/tutorials?tut=pose_frame_semantics: a pose is relative to the frame that
`relative_to` names (until version 1.6 `frame`), by default the model for a link or nested model, the child
link for a joint, and `attached_to` for a frame.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from bodycheck._util.errors import InputError
from bodycheck.scenarios.model_files.exact_arithmetic import (
    Frame,
    finite,
    rotation_of_quaternion,
    rotation_of_rpy,
)
from bodycheck.scenarios.model_files.xml_file import Node

_BOOLEANS = {"true": True, "false": False, "1": True, "0": False}
_MODEL = "__model__"


def content(node: Node) -> str:
    """Return the text of an element."""
    return (node.element.text or "").strip()


def numbers(node: Node, count: int) -> list[float]:
    """Return the numbers of an element; raises InputError if they are not `count` finite numbers."""
    try:
        return finite(content(node), count)
    except ValueError as error:
        raise InputError(f"{node.where}: {error}") from None


def is_true(node: Node, name: str) -> bool:
    """Return an attribute that is false by default; raises InputError if it is not a boolean of XML."""
    word = node.text(name, "false")
    if word not in _BOOLEANS:
        raise InputError(f"{node.where}: {name} = {word!r:.60} (available: {', '.join(_BOOLEANS)})")
    return _BOOLEANS[word]


def pose(node: Node) -> Frame:
    """Return the pose of an element in the frame that its <pose> names, or by default."""
    found = node.child("pose")
    if found is None or not content(found):
        return Frame.of()
    match found.text("rotation_format", "") or "euler_rpy":
        case "euler_rpy":
            x, y, z, *angles = numbers(found, 6)
            if is_true(found, "degrees"):
                angles = [math.radians(angle) for angle in angles]
            return Frame.of((x, y, z), rotation_of_rpy(angles))
        case "quat_xyzw":
            x, y, z, *vector, scalar = numbers(found, 7)
            if not any((*vector, scalar)):
                raise InputError(f"{found.where}: a quaternion is zero")
            return Frame.of((x, y, z), rotation_of_quaternion([scalar, *vector]))
        case other:
            raise InputError(
                f"{found.where}: rotation_format = {other!r:.60} (available: euler_rpy, quat_xyzw)"
            )


def relative_to(node: Node) -> str:
    """Return the frame that the <pose> of an element names, or ""."""
    found = node.child("pose")
    return "" if found is None else found.text("relative_to", "") or found.text("frame", "")


@dataclass
class Frames:
    """The named frames of a model, with the scopes of its nested models."""

    model: Node
    nested: Mapping[str, Frames] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._nodes: dict[str, Node] = {}
        for node in self.model.children("link", "joint", "frame", "model"):
            self._nodes.setdefault(node.text("name", ""), node)
        self._poses: dict[str, Frame | None] = {_MODEL: Frame.of(), "": Frame.of()}

    def pose_of(self, name: str) -> Frame | None:
        """Return the pose of a frame in the model; None if it, or one that it depends on, is not known."""
        if name not in self._poses:
            self._poses[name] = None  # a frame that depends on itself has no pose
            self._poses[name] = self._resolved(name)
        return self._poses[name]

    def pose_in(self, link: str, node: Node) -> Frame | None:
        """Return the pose in a link of an element of that link; None if it is not known."""
        base = relative_to(node)
        if base in ("", link):
            return pose(node)
        at, frame = self.pose_of(link), self.pose_of(base)
        return None if at is None or frame is None else at.inverse() @ frame @ pose(node)

    def link_of(self, name: str) -> str | None:
        """Return the link that a frame is attached to, as NESTED::LINK in a nested model; None if unknown."""
        seen = set()
        while name not in seen:
            seen.add(name)
            scope, _, rest = name.partition("::")
            if rest and scope in self.nested:
                inner = self.nested[scope].link_of(rest)
                return None if inner is None else f"{scope}::{inner}"
            node = self._nodes.get(name)
            if name in ("", _MODEL):
                name = self.model.text("canonical_link", "") or self._first_link()
            elif node is None:
                return None
            elif node.tag == "link":
                return name
            elif node.tag == "model":
                name = f"{name}::{_MODEL}"
            elif node.tag == "frame":
                name = node.text("attached_to", "")
            else:
                name = end(node, "child")
        return None

    def _first_link(self) -> str:
        link = next(self.model.children("link"), None)
        return next(iter(self.nested), "?") + "::" + _MODEL if link is None else link.text("name", "")

    def _resolved(self, name: str) -> Frame | None:
        scope, _, rest = name.partition("::")
        if rest and scope in self.nested:
            outer, inner = self.pose_of(scope), self.nested[scope].pose_of(rest)
            return None if outer is None or inner is None else outer @ inner
        node = self._nodes.get(name)
        if node is None:
            return None
        base = relative_to(node)
        if not base and node.tag == "frame":
            base = node.text("attached_to", "")
        if not base and node.tag == "joint":
            base = end(node, "child")
        below = self.pose_of(base)
        try:
            own = pose(node)
        except InputError:  # the link's row reports it
            return None
        if node.tag == "model" and (placed := node.text("placement_frame", "")):
            frame = self.nested[name].pose_of(placed) if name in self.nested else None
            return None if below is None or frame is None else below @ own @ frame.inverse()
        return None if below is None else below @ own


def end(joint: Node, tag: str) -> str:
    """Return the frame that a joint names as its parent or child; "" if it names none."""
    found = joint.child(tag)
    if found is None:
        return ""
    return content(found) or found.text("link_name", "")
