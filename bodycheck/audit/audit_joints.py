"""Compare the joints of a file with those that importers hold, and its mass matrix with theirs."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.adapters.importers import ImportedLink
from bodycheck.audit.audit import JointAudit, JointComparison
from bodycheck.audit.causes import with_issue
from bodycheck.audit.joint_causes import JointFacts, Placement, joint_causes, not_held
from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.model_files.exact_arithmetic import Frame, doubles
from bodycheck.scenarios.model_files.joint import StatedJoint
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink


@dataclass(frozen=True, eq=False)
class HeldJoint:
    """A joint of an importer: the indices of its link and of it there, in the axes of the file's link."""

    place: tuple[int, int]
    joint: StatedJoint


@dataclass(frozen=True, eq=False)
class HeldJoints:
    """The links of an import, and which of them, by index, has each name of the file."""

    links: Sequence[ImportedLink]
    named: Mapping[str, int]

    @classmethod
    def of(
        cls, found: Sequence[ImportedLink], named: Mapping[str, ImportedLink], model: ModelFile
    ) -> HeldJoints:
        """Return an import whose links were named."""
        index = {id(link): place for place, link in enumerate(found)}
        return cls(found, {name: index[id(link)] for name, link in named.items() if name in model.by_name})

    def joints_of(self, link: ModelLink) -> list[HeldJoint]:
        """Return the joints between a link and the next link above it that the file names, fixed ones too.

        Importers that split a body with several joints add links between.
        """
        at = self.named.get(link.name, -1)
        names = set(self.named.values())
        chain: list[int] = []
        while at >= 0 and len(chain) <= len(self.links):
            chain.append(at)
            at = self.links[at].parent
            if at in names:
                break
        found = []
        for index in reversed(chain):
            for k, joint in enumerate(self.links[index].joints):
                found.append(HeldJoint((index, k), self._in_axes_of(chain[0], index, joint)))
        return found

    def _in_axes_of(self, link: int, of: int, joint: StatedJoint) -> StatedJoint:
        to, own = self.pose(link), self.pose(of)
        R = to.rotation.T @ own.rotation
        at = to.rotation.T @ (own.rotation @ np.array(joint.at_m) + own.position_m - to.position_m)
        axis = None if joint.axis is None else tuple((R @ np.array(joint.axis)).tolist())
        return replace(joint, axis=axis, at_m=tuple(at.tolist()))

    def pose(self, link: int) -> Placement:
        """Return the pose of a link in the world, all joints as in the file."""
        one = self.links[link]
        return Placement(np.array(one.rotation), np.array(one.position_m))

    def placement(self, model: ModelFile, link: ModelLink) -> tuple[Placement | None, Placement | None]:
        """Return the pose of a link in the next link above it that is held: in the file, and as held.

        Links merged into the world are part of it. None where no link above is known.
        """
        here = self.pose(self.named[link.name])
        pose, at = link.pose, link
        while at.parent is not None:
            above = model.by_name[at.parent]
            if above.name in self.named:
                there = self.pose(self.named[above.name])
                R = there.rotation.T
                held = Placement(R @ here.rotation, R @ (here.position_m - there.position_m))
                return _placement(pose), held
            if any(joint.motion != "fixed" for joint in above.joints):
                return None, None
            if above.parent is not None or model.format == "mjcf":
                pose = above.pose @ pose
            at = above
        if at is link and (model.format != "mjcf" or any(one.motion == "free" for one in link.joints)):
            return None, None  # where a base is placed is up to the importer
        return _placement(pose), here


def _placement(frame: Frame) -> Placement:
    return Placement(doubles(frame.rotation), doubles(frame.position))


def audited_joints(
    model: ModelFile, imports: Mapping[str, tuple[str, HeldJoints]]
) -> tuple[list[JointAudit], dict[str, list[str]]]:
    """Return the audit of every joint of a file, and the orders of joints that differ from the file's.

    imports: the name of each importer -> its engine and what it holds.
    """
    size_m = _size(model)
    found = []
    for link in model.links:
        stated = link.joints
        matched = {
            name: matched_joints(link, held) for name, (_, held) in imports.items() if link.name in held.named
        }
        for k, joint in enumerate(stated):
            comparisons = {}
            for name, (engine, held) in imports.items():
                if link.name not in held.named:
                    comparisons[name] = (
                        JointComparison("merged")
                        if joint.motion == "fixed"
                        else JointComparison("absent", causes=("lost: the import has no link of this name",))
                    )
                    continue
                expected, at = held.placement(model, link) if k == 0 else (None, None)
                facts = JointFacts(
                    joint, expected, _inertial(link), doubles(model.placed[link.name].rotation), size_m
                )
                comparisons[name] = _compared(facts, matched[name][k], at, engine)
            found.append(JointAudit(link.name, joint, comparisons))
    if model.format == "urdf":  # whose joints are in an order of their own
        found.sort(key=lambda one: one.stated.line)
    return found, _orders(found, imports)


def _compared(facts: JointFacts, one: HeldJoint | None, at: Placement | None, engine: str) -> JointComparison:
    stated = facts.joint
    if one is None and stated.motion == "fixed":
        one = HeldJoint((-1, 0), StatedJoint(stated.name, "fixed", 0))
    if one is None:
        return JointComparison("absent", causes=("lost: the import has no such joint",))
    causes = tuple(with_issue(engine, cause) for cause in joint_causes(facts, one.joint, at))
    return JointComparison("differs" if causes else "agrees", one.joint, causes, not_held(stated, one.joint))


def matched_joints(link: ModelLink, held: HeldJoints) -> list[HeldJoint | None]:
    """Return the held joint of each joint of a link: by the order of those that move, or by name."""
    every = held.joints_of(link)
    moving = [one for one in every if one.joint.motion != "fixed"]
    stated = [joint for joint in link.joints if joint.motion != "fixed"]
    by_name = {one.joint.name: one for one in every}
    if not stated:  # a fixed joint, which the importer may let move
        return [moving[0] if moving else None for _ in link.joints]
    names = [joint.name for joint in stated]
    if len(moving) == len(stated) and not (set(names) <= set(by_name) and all(names)):
        return list(moving)
    if len(moving) == len(stated) == 1:
        return list(moving)
    return [by_name.get(name) if name else None for name in names]


def _inertial(link: ModelLink) -> Array:
    return np.eye(3) if link.stated is None else doubles(link.stated.frame.rotation)


def _size(model: ModelFile) -> float:
    """Return the scale of positions in m: the largest in the file."""
    positions = [np.linalg.norm(doubles(link.pose.position)) for link in model.links]
    return float(max([size for size in positions if math.isfinite(size)], default=0.0)) or 1.0


def _orders(
    joints: Sequence[JointAudit], imports: Mapping[str, tuple[str, HeldJoints]]
) -> dict[str, list[str]]:
    """Return importer -> its joints that move, in its order, where that is not the order of the file.

    A name that several joints of the file have says nothing of their order.
    """
    known = Counter(joint.stated.name for joint in joints)
    moving = [joint.stated.name for joint in joints if joint.stated.motion != "fixed"]
    names = [name for name in moving if name and known[name] == 1]
    found = {}
    for importer, (_, held) in imports.items():
        order = [joint.name for link in held.links for joint in link.joints if joint.name in set(names)]
        if sorted(order) == sorted(set(order)) and order != [name for name in names if name in set(order)]:
            found[importer] = order
    return found
