"""A joint, as model files state it and importers hold it."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class StatedJoint:
    """The connection of a link to its parent, as a file states it or an importer holds it, in SI units.

    axis: of a hinge or slide, of any length; at_m: the joint point; both in link axes, from its origin.
    limits, effort, velocity: infinite where there are none. rest: the coordinate at which the spring has no
    load; reference: that of the pose in the file. mimic: another joint, multiplier and offset.
    gains: of position and of velocity, of the actuators. None where the format or the importer has no such
    number, NaN where it cannot be computed here.
    """

    name: str
    kind: str
    line: int
    axis: tuple[float, ...] | None = None
    damping: float | None = None
    limits: tuple[float, float] | None = None
    at_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    friction: float | None = None
    armature: float | None = None
    stiffness: float | None = None
    rest: float | None = None
    reference: float | None = None
    effort: float | None = None
    velocity: float | None = None
    mimic: tuple[str, float, float] | None = None
    gains: tuple[float, float] | None = None

    @property
    def fixed(self) -> bool:
        """Whether the joint allows no motion."""
        return self.kind == "fixed"

    @property
    def motion(self) -> str:
        """Its kind in the words of trees: hinge, slide, ball, free, fixed; another kind by its own name."""
        return _MOTIONS.get(self.kind, self.kind)


_MOTIONS = {
    "revolute": "hinge",
    "continuous": "hinge",
    "prismatic": "slide",
    "spherical": "ball",
    "floating": "free",
    "mocap": "fixed",
}
UNLIMITED = (-math.inf, math.inf)


def limit_of(value: float) -> float:
    """Return a limit of effort or velocity; importers take one that is not positive as none."""
    return value if value > 0.0 else math.inf
