"""Mistakes of a URDF in links that are read nevertheless: elements that are missing, repeated or misspelt."""

from __future__ import annotations

import math
from collections.abc import Iterator
from difflib import get_close_matches

from bodycheck.scenarios.model_files.model_file import ModelMistake
from bodycheck.scenarios.model_files.xml_file import Node

MOMENTS = ((0, 0, "ixx"), (1, 1, "iyy"), (2, 2, "izz"), (0, 1, "ixy"), (0, 2, "ixz"), (1, 2, "iyz"))
"""Row, column and name of each number of <inertia>."""
SIZES = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
}
"""Shape -> the attributes that state its size."""

_ELEMENTS = {
    "link": ("inertial", "visual", "collision", "contact", "material"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry", "verbose", "contact"),
    "geometry": (*SIZES, "mesh", "plane"),
    "joint": (
        "origin",
        "parent",
        "child",
        "axis",
        "calibration",
        "dynamics",
        "limit",
        "mimic",
        "safety_controller",
    ),
}
"""Element -> those that it may hold; http://wiki.ros.org/urdf/XML and what Bullet reads besides."""
_ATTRIBUTES = {
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "mass": ("value",),
    "inertia": tuple(name for _, _, name in MOMENTS),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "mimic": ("joint", "multiplier", "offset"),
    "mesh": ("filename", "scale"),
    **SIZES,
}
"""Element -> its attributes."""
_ALIKE, _LONGER = 0.7, 2  # of two names: their likeness, and letters that one has more, at most
_TURN_RAD = 1.01 * 2.0 * math.pi


def mistakes_of(link: Node, joint: Node | None) -> Iterator[ModelMistake]:
    """Yield the mistakes of a link, and of the joint that it hangs from."""
    yield from repeated_inertial(link)
    yield from _missing_moments(link)
    for element in (link, *(() if joint is None else (joint,))):
        yield from _in(element)


def repeated_inertial(link: Node) -> Iterator[ModelMistake]:
    """Yield the mistake of a link that has more than one <inertial>."""
    first, *others = [node.line for node in link.children("inertial")] or [0]
    if others:
        amount = f"{len(others) + 1} elements <inertial>"
        message = f"has {amount}, of which the first is read, in line {first}"
        yield ModelMistake("repeated-inertial", others[0], message, "one <inertial>")


def _missing_moments(link: Node) -> Iterator[ModelMistake]:
    """Yield the mistake of an <inertia> without one of its six numbers, all of which URDF requires."""
    inertial = link.child("inertial")
    inertia = None if inertial is None else inertial.child("inertia")
    missing = [] if inertia is None else [name for _, _, name in MOMENTS if name not in inertia]
    if inertia is not None and missing:
        message = f"<inertia> has no {', '.join(missing)}: read as 0"
        yield ModelMistake("missing-moment", inertia.line, message, "ixx, ixy, ixz, iyy, iyz and izz")


def _in(element: Node) -> Iterator[ModelMistake]:
    """Yield what resembles a name that is read here, but is not read, and angles beyond a turn."""
    for child in element.children():
        if child.tag in _ELEMENTS.get(element.tag, (child.tag,)):
            yield from _in(child)
        elif "}" not in child.element.tag and (meant := _resembled(child.tag, _ELEMENTS[element.tag])):
            message = f"<{child.tag}> is not read: misspelt <{meant}>?"
            yield ModelMistake("misspelt-name", child.line, message, f"<{meant}>", is_certain=False)
    for name in element.element.attrib:
        known = _ATTRIBUTES.get(element.tag, (name,))
        if name not in known and (meant := _resembled(name, known)) and meant not in element:
            message = f"{name} of <{element.tag}> is not read: misspelt {meant}?"
            yield ModelMistake("misspelt-name", element.line, message, meant, is_certain=False)
    if element.tag == "origin" and any(abs(angle) > _TURN_RAD for angle in _angles(element)):
        message = f"rpy = {element.text('rpy')!r:.60} turns by more than a turn: in degrees?"
        yield ModelMistake("angles-in-degrees", element.line, message, "angles in rad", is_certain=False)


def _resembled(name: str, known: tuple[str, ...]) -> str:
    near = get_close_matches(name.lower(), known, n=1, cutoff=_ALIKE)
    return near[0] if near and abs(len(near[0]) - len(name)) <= _LONGER else ""


def _angles(origin: Node) -> list[float]:
    """Return the angles of an <origin>; none where they cannot be read, which is reported by itself."""
    try:
        return [float(word) for word in origin.text("rpy", "").split()]
    except ValueError:
        return []
