"""The trees of hinges, slides and balls that a model file states, for exact dynamics."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.rotations import matrix_to_quaternion
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.scenarios.model_files.exact_arithmetic import Exact, Frame, doubles, exact, mp
from bodycheck.scenarios.model_files.joint import StatedJoint
from bodycheck.scenarios.model_files.model_file import ModelFile, ModelLink

_RATES = {"hinge": 1, "slide": 1, "ball": 3}
_DURATION_S, _SAMPLES = 1.0, 2
_MOST_BODIES = 150
"""Beyond, one mass matrix takes seconds, and a chain is too deep for recursion."""


@dataclass(frozen=True, eq=False)
class ModelTree:
    """One tree of a model: fixed links are parts of the link above, armature is on the diagonal of M.

    joints: the link and the number of its joint of each body; the base, which is free, has (link, -1).
    """

    scene: TreeScene
    joints: tuple[tuple[str, int], ...]


def model_trees(model: ModelFile) -> list[ModelTree]:
    """Return the trees of a model whose joints move, each on the world or, without a joint there, free.

    Coordinates are zero in the pose of the file. A base without inertia is taken as fixed. Raises InputError
    with one line if a joint or an inertia is of a kind that trees do not have.
    """
    found = []
    for root in (link for link in model.links if link.parent is None):
        builder = _Builder(model)
        builder.add_root(root)
        if any(number >= 0 for _, number in builder.joints):
            found.append(builder.tree())
    return found


@dataclass
class _Builder:
    model: ModelFile
    bodies: list[TreeBody] = field(default_factory=list)
    centres: list[Exact] = field(default_factory=list)
    joints: list[tuple[str, int]] = field(default_factory=list)

    def tree(self) -> ModelTree:
        try:
            scene = TreeScene(tuple(self.bodies), (), np.zeros(3), _DURATION_S, _SAMPLES)
        except (ArithmeticError, ValueError) as error:
            at, _, why = str(error).splitlines()[0].partition("].inertia: ")
            if why:
                at = f"inertia of {self.joints[int(at.removeprefix('bodies['))][0]}: "
            raise InputError(f"{self.model.path}: has no exact tree: {at}{why}") from None
        return ModelTree(scene, tuple(self.joints))

    def add_root(self, root: ModelLink) -> None:
        moving = [joint for joint in root.joints if joint.motion != "fixed"]
        is_free = self.model.format != "mjcf" and not root.joints and not root.static
        if [joint.motion for joint in moving] == ["free"] or (is_free and self._body(root)[0] > 0):
            self._add(root, StatedJoint("", "free", root.line), root, -1, Frame.of(), -1)
            self._add_below(root, len(self.bodies) - 1, Frame.of())
        elif moving:
            self._add_joints(root, -1, root.pose)
        else:
            self._add_below(root, -1, root.pose)

    def _add_below(self, link: ModelLink, body: int, pose: Frame) -> None:
        """Add the moving links below a link and the links fixed to it; `pose`: of the link in the body."""
        for child in (one for one in self.model.links if one.parent == link.name):
            placed = pose @ child.pose
            if all(joint.motion == "fixed" for joint in child.joints):
                self._add_below(child, body, placed)
            else:
                self._add_joints(child, body, placed)

    def _add_joints(self, link: ModelLink, parent: int, pose: Frame) -> None:
        """Add a link by its joints: all but the last move a link without mass."""
        moving = [(k, joint) for k, joint in enumerate(link.joints) if joint.motion != "fixed"]
        for place, (number, joint) in enumerate(moving):
            last = place == len(moving) - 1
            self._add(link, joint, link if last else None, parent, pose, number)
            parent, pose = len(self.bodies) - 1, Frame.of()
        self._add_below(link, parent, Frame.of())

    def _add(
        self,
        link: ModelLink,
        joint: StatedJoint,
        carried: ModelLink | None,
        parent: int,
        pose: Frame,
        number: int,
    ) -> None:
        kind = joint.motion
        if len(self.bodies) >= _MOST_BODIES:
            raise InputError(f"{link.file}:{link.line}: more than {_MOST_BODIES} moving bodies")
        if kind not in _RATES and (kind != "free" or parent >= 0):
            raise InputError(f"{link.file}:{joint.line}: joint {joint.name!r:.60} is {joint.kind!r:.30}")
        if kind in ("hinge", "slide") and (joint.axis is None or not any(joint.axis)):
            what = "not known" if joint.axis is None else "(0, 0, 0)"
            raise InputError(f"{link.file}:{joint.line}: the axis of joint {joint.name!r:.60} is {what}")
        at = exact(joint.at_m)
        mass, centre, tensor = (mp.mpf(0), at, exact(np.zeros((3, 3))))
        if carried is not None:
            mass, centre, tensor = self._body(carried)
            tensor = (tensor + tensor.T) / 2  # rotations leave an asymmetry of the last digit
        above = exact(np.zeros(3)) if parent < 0 else self.centres[parent]
        if kind == "free":
            connection = Joint(kind, start=np.array([*doubles(centre), 1.0, 0.0, 0.0, 0.0]))
        else:
            connection = Joint(
                kind,
                parent,
                at_parent=doubles(pose.rotation @ at + pose.position - above),
                at_body=doubles(at - centre),
                zero=matrix_to_quaternion(doubles(pose.rotation)),
                axis=np.array(joint.axis or (0.0, 0.0, 1.0)),
                armature=joint.armature or 0.0,
            )
        name = f"{link.name}/{number}"
        self.bodies.append(TreeBody(name, float(mass), doubles(tensor), connection))
        self.centres.append(centre)
        self.joints.append((link.name, number))

    def _body(self, link: ModelLink) -> tuple[float, Exact, Exact]:
        """Return mass, centre and tensor of a link and the links fixed to it, in its axes."""
        below = frozenset(one.name for one, _ in self.model.fixed_below(link.name))
        body = self.model.merged(link.name, below)
        if body is None:
            unread = next(one for one, _ in self.model.members(link.name, below) if one.unread)
            raise InputError(f"{unread.file}:{unread.line}: the inertia of {unread.name!r:.60} is not known")
        return body.mass, body.centre, body.tensor
