"""A force and a torque that only a function knows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants, Wrenching

if TYPE_CHECKING:
    from bodycheck.reference_impl.scene import Scene


@dataclass(frozen=True, eq=False)
class CallbackLoad(ContinuousLoad):
    """A force and a torque that only a function knows; name: its package.module:function.

    Its table, whose reading runs code, and its message, which holds the name alone, are not among the keys.
    """

    kind: ClassVar[str] = "callable"

    name: str
    function: Wrenching

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return what the function returns, instant by instant."""
        parts = (at.position, at.rotation, at.velocity, at.omega)
        if at.omega.ndim == 1:
            force, torque = self.function(float(at.t), *parts)
            return np.asarray(force, dtype=np.float64), np.asarray(torque, dtype=np.float64)
        answers = [self.function(float(t), *part) for t, *part in zip(at.t, *parts, strict=True)]
        force, torque = (np.array([answer[i] for answer in answers], dtype=np.float64) for i in (0, 1))
        return force, torque

    def about_pivot(self, scene: Scene, pivot: Array) -> CallbackLoad:
        """Return the same: what calls the function sees to the pivot."""
        return self
