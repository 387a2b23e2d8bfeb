"""Under a torque -k L a body turns as it would freely, in the stretched time s = (1 - e^-kt) / k.

For L' = L x omega - k L in body axes, L(t) = e^-kt M(s) with M' = M x (I^-1 M), and ds/dt = e^-kt.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.exponential import decay_means
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.jit import exact_kernel
from bodycheck.reference_impl.paired import pair, paired_omega
from bodycheck.reference_impl.rational import Vector, fractions
from bodycheck.reference_impl.scene import Scene


@exact_kernel
def _stretch(decay: DoubleDouble, t_s: Array, high: Array, low: Array, decayed: Array) -> None:
    """Fill s (n,), high and low parts, and e^-kt (n,)."""
    for i in range(len(t_s)):
        t = (t_s[i], 0.0)
        rest, mean, _ = decay_means(dd.multiply(decay, t))
        high[i], low[i] = dd.multiply(t, mean)
        decayed[i] = rest[0]


def decay_rate(inertia: Array, drag: Vector) -> Fraction | None:
    """k with drag = k inertia (9,), exactly in the doubles given; None where there is none."""
    tensor = fractions(inertia)
    k = drag[0] / tensor[0]
    return k if drag == [k * element for element in tensor] else None


@dataclass(frozen=True, eq=False)
class StretchedRotation:
    """q(t) = q_free(s), omega(t) = e^-kt omega_free(s)."""

    _free: FreeRotation
    _decay: DoubleDouble

    @classmethod
    def of(cls, scene: Scene, decay: Fraction) -> StretchedRotation:
        """Set up for a drag torque -k L, k in 1/s."""
        omega = paired_omega(scene.initial)
        free = FreeRotation.from_pairs(scene.body.inertia, scene.initial.quaternion, *omega)
        return cls(free, pair(decay))

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return (quaternion (n, 4), omega_body (n, 3)) at times t_s (n,)."""
        high, low, decayed = np.empty((3, len(t_s)))
        _stretch(self._decay, t_s, high, low, decayed)
        quaternion, omega = self._free.at_pairs(high, low)
        return quaternion, decayed[:, None] * omega
