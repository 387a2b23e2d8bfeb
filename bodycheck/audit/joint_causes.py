"""Name what an importer changes of a joint, by trying each known fault on what the file states."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from bodycheck._util.formatting import number
from bodycheck.audit.audit import SINGLE
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_matrix, log_matrix
from bodycheck.scenarios.model_files.joint import UNLIMITED, StatedJoint

_DEGREES = 180.0 / math.pi
_MOST_NAMES = 2  # of faults that make the same numbers


@dataclass(frozen=True, eq=False)
class Placement:
    """Rotation (3, 3) and position (3,) of a link in the link above, in the pose of the file."""

    rotation: Array
    position_m: Array


@dataclass(frozen=True, eq=False)
class JointFacts:
    """A joint with what faults need: its placement, the inertial frame of its link and the pose in the model.

    placement: None where the link above is not known. inertial, model: rotations (3, 3) to link axes, and of
    link axes in the model. size_m: the scale of positions.
    """

    joint: StatedJoint
    placement: Placement | None
    inertial: Array
    model: Array
    size_m: float


@dataclass(frozen=True)
class Quantity:
    """A number of a joint: its attribute, what it is called, and its value where none is stated."""

    attribute: str
    name: str
    neutral: float


QUANTITIES = (
    Quantity("damping", "damping", 0.0),
    Quantity("friction", "friction", 0.0),
    Quantity("armature", "armature", 0.0),
    Quantity("stiffness", "stiffness", 0.0),
    Quantity("rest", "rest of the spring", 0.0),
    Quantity("reference", "reference", 0.0),
    Quantity("effort", "effort limit", math.inf),
    Quantity("velocity", "velocity limit", math.inf),
)

FACTORS = {
    _DEGREES: "times 57.2958, as degrees for radians",
    1.0 / _DEGREES: "divided by 57.2958, as radians for degrees",
    -1.0: "of the wrong sign",
}
"""Factor of a held number -> what it means."""

AXES: dict[str, Callable[[JointFacts], Array]] = {
    "opposite": lambda _: -np.eye(3),
    "in the frame of the parent": lambda facts: _placed(facts).T,
    "turned by the joint frame twice": lambda facts: _placed(facts),
    "in the inertial frame": lambda facts: facts.inertial,
    "turned by the inverse of the inertial frame": lambda facts: facts.inertial.T,
    "in the frame of the model": lambda facts: facts.model.T,
    "turned by the pose in the model twice": lambda facts: facts.model,
    "with y and z exchanged": lambda _: np.eye(3)[[0, 2, 1]],
}
"""What an importer does with the axis of a file -> the matrix that makes its axis of the right one."""

PLACEMENTS: dict[str, Callable[[Placement], Placement]] = {
    "rotation of the joint frame ignored": lambda at: Placement(np.eye(3), at.position_m),
    "position of the joint frame ignored": lambda at: Placement(at.rotation, np.zeros(3)),
    "joint frame ignored": lambda _: Placement(np.eye(3), np.zeros(3)),
    "joint frame inverted": lambda at: Placement(at.rotation.T, -at.rotation.T @ at.position_m),
    "rotation of the joint frame inverted": lambda at: Placement(at.rotation.T, at.position_m),
    "rotation of the joint frame times 57.2958, as degrees for radians": lambda at: _scaled(at, _DEGREES),
    "rotation of the joint frame divided by 57.2958, as radians for degrees": lambda at: _scaled(
        at, 1.0 / _DEGREES
    ),
}
"""What an importer does with the frame of a joint -> where the link then is."""


def joint_causes(stated: JointFacts, held: StatedJoint, placement: Placement | None) -> tuple[str, ...]:
    """Return the named differences of a held joint, with axis and point in the axes of the file's link."""
    given = stated.joint
    if given.motion != held.motion:
        return (f"held as {_article(held.motion)}, not as {_article(given.motion)}",)
    if given.fixed:
        return tuple(_placement_causes(stated, placement))
    return (
        *_placement_causes(stated, placement),
        *_axis_causes(stated, held),
        *_limit_causes(given, held),
        *(cause for one in QUANTITIES for cause in _number_causes(one, given, held)),
        *_mimic_causes(given, held),
        *_gain_causes(given, held),
    )


def not_held(stated: StatedJoint, held: StatedJoint) -> tuple[str, ...]:
    """Return what the file states and the importer has no number for."""
    missing = []
    for one in QUANTITIES:
        value = getattr(stated, one.attribute)
        if getattr(held, one.attribute) is None and value is not None and value != one.neutral:
            missing.append(f"{one.name} not held: {number(value, 6)} in the file")
    return tuple(missing)


def _number_causes(one: Quantity, stated: StatedJoint, held: StatedJoint) -> Iterator[str]:
    given, found = getattr(stated, one.attribute), getattr(held, one.attribute)
    given = one.neutral if given is None else given
    if found is None or math.isnan(given) or (one.attribute == "rest" and not stated.stiffness):
        return
    yield from _changed(one.name, given, found, one.neutral)


def _changed(name: str, given: float, found: float, neutral: float) -> Iterator[str]:
    if close(given, found):
        return
    if given == neutral:
        yield f"{name} added: {number(found, 6)} held"
    elif found == neutral:
        yield f"{name} dropped: {number(given, 6)} in the file"
    else:
        how = next((text for factor, text in FACTORS.items() if close(found, factor * given)), "changed")
        yield f"{name} {how}: {number(given, 6)} in the file, {number(found, 6)} held"


def _limit_causes(stated: StatedJoint, held: StatedJoint) -> Iterator[str]:
    if stated.limits is None or held.limits is None or stated.motion not in ("hinge", "slide", "ball"):
        return
    given, found = (_bounded(joint.limits or UNLIMITED) for joint in (stated, held))
    if all(close(a, b) for a, b in zip(given, found, strict=True)):
        return
    if given == UNLIMITED:
        yield f"limits added: {_interval(found)} held"
    elif found == UNLIMITED:
        yield f"limits dropped: {_interval(given)} in the file"
    else:
        matches = (
            text
            for factor, text in FACTORS.items()
            if all(close(b, factor * a) for a, b in zip(given, found, strict=True))
        )
        how = next(matches, "changed")
        yield f"limits {how}: {_interval(given)} in the file, {_interval(found)} held"


def _bounded(limits: tuple[float, float]) -> tuple[float, float]:
    """Return limits; those that leave no interval, or one beyond 1e10, limit nothing."""
    return limits if 0.0 < limits[1] - limits[0] <= 1e10 else UNLIMITED


def _mimic_causes(stated: StatedJoint, held: StatedJoint) -> Iterator[str]:
    if stated.mimic is None and held.mimic is None:
        return
    if held.mimic is None:
        yield f"mimic dropped: {_followed(stated)} in the file"
    elif stated.mimic is None:
        yield f"mimic added: {_followed(held)} held"
    elif not any(map(math.isnan, held.mimic[1:])):
        same = all(close(a, b) for a, b in zip(stated.mimic[1:], held.mimic[1:], strict=True))
        if not same or stated.mimic[0] != held.mimic[0]:
            yield f"mimic changed: {_followed(stated)} in the file, {_followed(held)} held"


def _followed(joint: StatedJoint) -> str:
    other, multiplier, offset = joint.mimic or ("", 1.0, 0.0)
    if math.isnan(multiplier):
        return "another joint"
    return f"{number(multiplier, 6)} {other}" + (f" + {number(offset, 6)}" if offset else "")


def _gain_causes(stated: StatedJoint, held: StatedJoint) -> Iterator[str]:
    given, found = stated.gains or (0.0, 0.0), held.gains
    for k, name in enumerate(("position gain", "velocity gain")):
        if found is not None and not math.isnan(given[k]):
            yield from _changed(name, given[k], found[k], 0.0)


def _axis_causes(facts: JointFacts, held: StatedJoint) -> Iterator[str]:
    given, found = facts.joint.axis, held.axis
    if held.motion not in ("hinge", "slide") or given is None or found is None or not any(given):
        return
    axis, other = _unit(np.array(given)), _unit(np.array(found))
    if np.linalg.norm(axis - other) > SINGLE:
        made = {name: turn(facts) @ axis for name, turn in AXES.items()}
        made |= {f"ignored: {name} in its place": np.eye(3)[k] for k, name in enumerate("xyz")}
        names = [name for name, one in made.items() if np.linalg.norm(one - other) <= SINGLE]
        if names:
            yield f"axis {' or '.join(names[:_MOST_NAMES])}"
            return
        degrees = math.degrees(math.atan2(float(np.linalg.norm(np.cross(axis, other))), float(axis @ other)))
        yield f"axis {number(degrees, 4)} degrees off"
        return
    arm = np.array(held.at_m) - np.array(facts.joint.at_m)
    if held.motion == "hinge":
        arm = arm - (arm @ axis) * axis  # a hinge may be anywhere on its axis
        if (off := float(np.linalg.norm(arm))) > SINGLE * facts.size_m:
            yield f"joint point {number(off, 4)} m off"


def _placement_causes(facts: JointFacts, held: Placement | None) -> Iterator[str]:
    given = facts.placement
    if given is None or held is None or _same(given, held, facts.size_m):
        return
    names = [name for name, change in PLACEMENTS.items() if _same(change(given), held, facts.size_m)]
    if names:
        yield " or ".join(names[:_MOST_NAMES])
        return
    if not np.isfinite([*held.rotation.ravel(), *held.position_m]).all():
        yield "joint frame not finite"
        return
    turned = float(np.linalg.norm(log_matrix(given.rotation.T @ held.rotation)))
    moved = float(np.linalg.norm(held.position_m - given.position_m))
    parts = [f"turned by {number(math.degrees(turned), 4)} degrees"] if turned > SINGLE else []
    parts += [f"moved by {number(moved, 4)} m"] if moved > SINGLE * facts.size_m else []
    yield f"joint frame {' and '.join(parts)}"


def _same(one: Placement, other: Placement, size_m: float) -> bool:
    turned = float(np.max(np.abs(one.rotation - other.rotation)))
    return turned <= SINGLE and float(np.max(np.abs(one.position_m - other.position_m))) <= SINGLE * size_m


def _scaled(at: Placement, factor: float) -> Placement:
    return Placement(exp_matrix(factor * log_matrix(at.rotation)), at.position_m)


def _placed(facts: JointFacts) -> Array:
    return np.eye(3) if facts.placement is None else facts.placement.rotation


def _unit(vector: Array) -> Array:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 0.0 else vector


def _article(motion: str) -> str:
    return motion if motion in ("free", "fixed", "planar") else f"a {motion}"


def close(a: float, b: float) -> bool:
    """Whether two numbers agree to single precision."""
    return math.isclose(a, b, rel_tol=SINGLE)


def _interval(limits: tuple[float, float]) -> str:
    return f"[{number(limits[0], 6)}, {number(limits[1], 6)}]"
