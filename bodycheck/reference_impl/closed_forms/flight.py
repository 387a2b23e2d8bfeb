"""The flight of the centre of mass: m v' = F + m g - c v, F constant in world axes from switch to switch."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.decaying import DecayingMotion
from bodycheck.reference_impl.closed_forms.loads import Loads
from bodycheck.reference_impl.paired import pair
from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class Flight:
    """x(t) and v(t), correctly rounded but for some 2^-100 of their largest terms."""

    _motion: DecayingMotion

    @classmethod
    def of(cls, scene: Scene, loads: Loads) -> Flight | None:
        """Set up; None where a force fixed in the body turns with it."""
        if any(any(piece.force_body) for piece in loads.pieces):
            return None
        mass, initial = Fraction(scene.body.mass), scene.initial
        pieces = [(piece.begin_s, [pair(f / mass) for f in piece.force_world]) for piece in loads.pieces]
        x, v = ([(float(c), 0.0) for c in vector] for vector in (initial.position, initial.velocity))
        return cls(DecayingMotion.of(x, v, pieces, pair(loads.linear_drag / mass)))

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return position and velocity (n, 3), world axes, at times t_s >= 0 (n,)."""
        (position, _), (velocity, _) = self._motion.at(t_s)
        return position, velocity

    def errors(self, t_s: Array, velocity: Array) -> tuple[Array, Array]:
        """What position and velocity are off by before they are rounded, (n,) and (n,): the velocities'."""
        speeds = np.abs(velocity).max(axis=-1, initial=0.0)
        return self._motion.errors(t_s, speeds)
