"""A force and a torque given by a user function."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, WrenchFunction

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class CallbackLoad(ContinuousLoad):
    """A force and a torque given by a user function; name: its package.module:function.

    It has no keys: reading its table runs code, and its message contains only the name.
    """

    kind: ClassVar[str] = "callable"

    name: str
    function: WrenchFunction

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return the values of the function, called once per instant."""
        parts = (at.position, at.rotation, at.velocity, at.omega)
        if at.omega.ndim == 1:
            force, torque = self.function(float(at.t), *parts)
            return np.asarray(force, dtype=np.float64), np.asarray(torque, dtype=np.float64)
        answers = [self.function(float(t), *part) for t, *part in zip(at.t, *parts, strict=True)]
        force, torque = (np.array([answer[i] for answer in answers], dtype=np.float64) for i in (0, 1))
        return force, torque

    def about_pivot(self, scene: Scene, pivot: Array) -> CallbackLoad:
        """Return the load unchanged: the caller of the function accounts for the pivot."""
        return self
