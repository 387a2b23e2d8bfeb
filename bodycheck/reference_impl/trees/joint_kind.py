"""What a kind of joint permits: how the child turns, and how it moves, relative to its parent."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Rotation(IntEnum):
    """How the child turns: not at all, about the joint's axis, or freely about the joint's point."""

    NONE = 0
    AXIS = 1
    BALL = 2


class Translation(IntEnum):
    """How the joint's point of the child moves: not at all, along the joint's axis, or freely.

    SPACE: the coordinates are the position of the centre of mass, in world axes; the parent is the world.
    """

    NONE = 0
    AXIS = 1
    SPACE = 2


@dataclass(frozen=True)
class JointKind:
    """One kind of joint: its name in scenario files, and its motions.

    The coordinates are those of the translation (0, 1 or 3), then those of the rotation (0, 1, or the 4 of a
    quaternion from child axes to the axes at coordinate 0). The rates are those of the translation (0, 1, or
    the 3 of the velocity of the centre of mass in world axes), then those of the rotation (0, 1, or the 3 of
    the angular velocity relative to the parent in child axes).
    """

    name: str
    rotation: Rotation
    translation: Translation

    @property
    def coordinates(self) -> int:
        """The number of coordinates."""
        return (0, 1, 3)[self.translation] + (0, 1, 4)[self.rotation]

    @property
    def rates(self) -> int:
        """The number of rates: the degrees of freedom."""
        return (0, 1, 3)[self.translation] + (0, 1, 3)[self.rotation]

    @property
    def has_axis(self) -> bool:
        """Whether the child turns about the joint's axis, or moves along it."""
        return self.rotation is Rotation.AXIS or self.translation is Translation.AXIS

    @property
    def is_scalar(self) -> bool:
        """Whether there is one coordinate, on which a spring can act."""
        return self.coordinates == 1

    @property
    def zero(self) -> tuple[float, ...]:
        """The coordinates at which the joint frames of parent and child coincide."""
        turned = {Rotation.NONE: (), Rotation.AXIS: (0.0,), Rotation.BALL: (1.0, 0.0, 0.0, 0.0)}
        return (0.0,) * (0, 1, 3)[self.translation] + turned[self.rotation]
