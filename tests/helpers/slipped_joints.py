"""Slips in the joints of a URDF or MJCF text, as converters and importers make them, and what names each."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

Element = ElementTree.Element


@dataclass(frozen=True)
class JointSlip:
    """A change of one joint's element, and the beginning of the cause that names it."""

    cause: str
    change: Callable[[Element], None]


def _set(tag: str, **values: str) -> Callable[[Element], None]:
    def change(joint: Element) -> None:
        found = joint.find(tag)
        assert found is not None
        for name, value in values.items():
            found.set(name, value)

    return change


def _without(tag: str) -> Callable[[Element], None]:
    def change(joint: Element) -> None:
        found = joint.find(tag)
        assert found is not None
        joint.remove(found)

    return change


def _scaled(tag: str, names: tuple[str, ...], factor: float) -> Callable[[Element], None]:
    def change(joint: Element) -> None:
        found = joint.find(tag)
        assert found is not None
        for name in names:
            found.set(name, repr(float(str(found.get(name))) * factor))

    return change


def _numbers(joint: Element, tag: str, name: str) -> np.ndarray:
    found = joint.find(tag)
    assert found is not None
    return np.array([float(word) for word in str(found.get(name)).split()])


def _text(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _turned_axis(turn: Callable[[Rotation], Rotation]) -> Callable[[Element], None]:
    def change(joint: Element) -> None:
        R = Rotation.from_euler("xyz", _numbers(joint, "origin", "rpy"))
        _set("axis", xyz=_text(turn(R).apply(_numbers(joint, "axis", "xyz"))))(joint)

    return change


def _axis(made: Callable[[np.ndarray], np.ndarray]) -> Callable[[Element], None]:
    return lambda joint: _set("axis", xyz=_text(made(_numbers(joint, "axis", "xyz"))))(joint)


def _origin(made: Callable[[Rotation, np.ndarray], tuple[Rotation, np.ndarray]]) -> Callable[[Element], None]:
    def change(joint: Element) -> None:
        R = Rotation.from_euler("xyz", _numbers(joint, "origin", "rpy"))
        turned, moved = made(R, _numbers(joint, "origin", "xyz"))
        _set("origin", rpy=_text(turned.as_euler("xyz")), xyz=_text(moved))(joint)

    return change


_DEGREES = 180.0 / math.pi
_RANGE = ("lower", "upper")

JOINT_SLIPS: Mapping[str, JointSlip] = {
    "axis in the parent's frame": JointSlip(
        "axis in the frame of the parent", _turned_axis(lambda R: R.inv())
    ),
    "axis turned twice": JointSlip("axis turned by the joint frame twice", _turned_axis(lambda R: R)),
    "axis opposite": JointSlip("axis opposite", _axis(lambda a: -a)),
    "axis with y and z exchanged": JointSlip("axis with y and z exchanged", _axis(lambda a: a[[0, 2, 1]])),
    "axis ignored": JointSlip("axis ignored: x in its place", _without("axis")),
    "axis off": JointSlip("axis ", _axis(lambda a: a + np.array([0.3, -0.1, 0.2]))),
    "origin's rotation ignored": JointSlip(
        "rotation of the joint frame ignored", _origin(lambda _, p: (Rotation.identity(), p))
    ),
    "origin's position ignored": JointSlip(
        "position of the joint frame ignored", _origin(lambda R, p: (R, 0.0 * p))
    ),
    "origin ignored": JointSlip("joint frame ignored", _origin(lambda _, p: (Rotation.identity(), 0.0 * p))),
    "origin inverted": JointSlip("joint frame inverted", _origin(lambda R, p: (R.inv(), -R.inv().apply(p)))),
    "origin moved": JointSlip("joint frame moved by", _origin(lambda R, p: (R, p + 0.01))),
    "damping dropped": JointSlip("damping dropped", _set("dynamics", damping="0")),
    "damping in degrees": JointSlip("damping times 57.2958", _scaled("dynamics", ("damping",), _DEGREES)),
    "friction dropped": JointSlip("friction dropped", _set("dynamics", friction="0")),
    "limits dropped": JointSlip("limits dropped", _set("limit", lower="0", upper="0")),
    "limits in degrees": JointSlip("limits times 57.2958", _scaled("limit", _RANGE, _DEGREES)),
    "limits as if in degrees": JointSlip(
        "limits divided by 57.2958", _scaled("limit", _RANGE, 1.0 / _DEGREES)
    ),
    "limits changed": JointSlip("limits changed", _set("limit", lower="-2.5")),
    "effort dropped": JointSlip("effort limit dropped", _set("limit", effort="0")),
    "velocity in degrees": JointSlip(
        "velocity limit times 57.2958", _scaled("limit", ("velocity",), _DEGREES)
    ),
    "mimic dropped": JointSlip("mimic dropped", _without("mimic")),
    "mimic reversed": JointSlip("mimic changed", _scaled("mimic", ("multiplier",), -1.0)),
    "slide as a hinge": JointSlip(
        "held as a", lambda joint: joint.set("type", _other(str(joint.get("type"))))
    ),
    "joint fixed": JointSlip("held as fixed", lambda joint: joint.set("type", "fixed")),
}


MJCF_SLIPS: Mapping[str, JointSlip] = {
    "armature dropped": JointSlip("armature dropped", _set("joint", armature="0")),
    "stiffness dropped": JointSlip("stiffness dropped", _set("joint", stiffness="0")),
    "frictionloss dropped": JointSlip("friction dropped", _set("joint", frictionloss="0")),
    "springref in degrees": JointSlip(
        "rest of the spring times 57.2958", _scaled("joint", ("springref",), _DEGREES)
    ),
    "ref dropped": JointSlip("reference dropped", _set("joint", ref="0")),
    "joint point ignored": JointSlip("joint point ", _set("joint", pos="0 0 0")),
    "axis ignored": JointSlip("axis ignored: z in its place", _set("joint", axis="0 0 1")),
    "kp too soft": JointSlip(
        "position gain divided by 57.2958", _scaled("position", ("kp",), 1.0 / _DEGREES)
    ),
    "kv dropped": JointSlip("velocity gain dropped", _set("position", kv="0")),
    "gear ignored": JointSlip("position gain changed", _set("position", gear="1", kv="18")),
    "equality dropped": JointSlip("mimic dropped", _without("equality")),
    "angles in degrees": JointSlip("limits divided by 57.2958", _set("compiler", angle="degree")),
}


def mjcf_text(rng: np.random.Generator) -> Element:
    """Return an MJCF with a hinge that states every number; the slips are in the wrappers of its elements."""
    axis, at = rng.normal(size=3), rng.uniform(0.05, 0.2, 3)
    return ElementTree.fromstring(
        '<mujoco><compiler angle="radian"/><worldbody><body name="a" pos="0 0 1">'
        '<inertial pos="0.1 0 0.2" mass="1.5" diaginertia="0.1 0.2 0.25"/>'
        '<joint name="lead" axis="0 1 0"/><body name="b" pos="0.3 0 0">'
        '<inertial pos="0 0.1 0" mass="0.7" diaginertia="0.01 0.02 0.025"/>'
        f'<joint name="j" axis="{_text(axis)}" pos="{_text(at)}" range="-1.1 0.6" armature="0.03" ref="0.2" '
        'springref="0.1" stiffness="4" frictionloss="0.2" damping="0.5"/></body></body></worldbody>'
        '<actuator><position joint="j" kp="80" kv="2" gear="3"/></actuator>'
        '<equality><joint joint1="j" joint2="lead" polycoef="0.1 2 0 0 0"/></equality></mujoco>'
    )


def slipped_mjcf(rng: np.random.Generator, name: str) -> tuple[str, str]:
    """Return an MJCF, and the same with a slip in the joint "j"."""
    root = mjcf_text(rng)
    before = ElementTree.tostring(root, encoding="unicode")
    slip = MJCF_SLIPS[name]
    for element in (root, *root.iter()):  # the parent of the element that the slip changes
        if any(one.get("joint", one.get("name")) == "j" for one in element) or name in _AT_ROOT:
            try:
                slip.change(element)
            except AssertionError:
                continue
            break
    return before, ElementTree.tostring(root, encoding="unicode")


_AT_ROOT = ("equality dropped", "angles in degrees")


def _other(kind: str) -> str:
    return "revolute" if kind == "prismatic" else "prismatic"


def joint_text(rng: np.random.Generator, urdf: str) -> str:
    """Return a random URDF whose joints all move and state every number, the last with a mimic."""
    robot = ElementTree.fromstring(re.sub(r"<\?xml[^>]*\?>", "", urdf))
    joints = robot.findall("joint")
    for joint in joints:
        joint.set("type", str(rng.choice(["revolute", "prismatic"])))
        for old in [*joint.findall("limit"), *joint.findall("dynamics")]:
            joint.remove(old)
        _set("axis", xyz=_text(rng.normal(size=3)))(joint)
        low = -float(rng.uniform(0.5, 2.0))
        ElementTree.SubElement(
            joint, "limit", lower=repr(low), upper=repr(low + 1.7), effort="12.5", velocity="3.5"
        )
        ElementTree.SubElement(joint, "dynamics", damping="0.7", friction="0.15")
    for joint in joints[1:]:
        other = str(joints[0].get("name"))
        ElementTree.SubElement(joint, "mimic", joint=other, multiplier="1.5", offset="0.1")
    return ElementTree.tostring(robot, encoding="unicode")


def slipped(text: str, name: str, joint: str) -> str:
    """Return a URDF with a slip in one joint."""
    robot = ElementTree.fromstring(text)
    (element,) = [one for one in robot.findall("joint") if one.get("name") == joint]
    JOINT_SLIPS[name].change(element)
    return ElementTree.tostring(robot, encoding="unicode")
