"""The exact motion of a body whose rotation and flight both have a closed form.

For L' = L x omega - k L in body axes, L(t) = e^-kt M(s) with M' = M x (I^-1 M), and ds/dt = e^-kt.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.fixed_axis import FixedAxisRotation
from bodycheck.reference_impl.closed_forms.flight import Flight, decay_means
from bodycheck.reference_impl.closed_forms.piecewise_constant_loads import PiecewiseLoads, loads_of
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.kernels import double_double as dd
from bodycheck.reference_impl.kernels.double_double import DoubleDouble
from bodycheck.reference_impl.kernels.jit import exact_kernel
from bodycheck.reference_impl.rational import Vector, fractions, pair, paired_omega
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory


@exact_kernel
def _stretch(decay: DoubleDouble, t_s: Array, high: Array, low: Array, decayed: Array) -> None:
    """Fill the high and low parts of s (n,), and e^-kt (n,)."""
    for i in range(len(t_s)):
        t = (t_s[i], 0.0)
        rest, mean, _ = decay_means(dd.multiply(decay, t))
        high[i], low[i] = dd.multiply(t, mean)
        decayed[i] = rest[0]


def decay_rate(inertia: Array, drag: Vector) -> Fraction | None:
    """k with drag = k inertia, exactly for the given doubles, or None; inertia (3, 3), drag (9,)."""
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
        """Set up the motion for a drag torque -k L; decay is k in 1/s."""
        omega = paired_omega(scene.initial)
        free = FreeRotation.from_pairs(scene.body.inertia, scene.initial.quaternion, *omega)
        return cls(free, pair(decay))

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return (quaternion (n, 4), omega_body (n, 3)) at times t_s (n,)."""
        high, low, decayed = np.empty((3, len(t_s)))
        _stretch(self._decay, t_s, high, low, decayed)
        quaternion, omega = self._free.at_pairs(high, low)
        return quaternion, decayed[:, None] * omega


EXACT_OMEGA_ERROR = 4e-15
"""Relative to the largest omega up to then."""


class ExactRotation(Protocol):
    """q(t) and omega(t)."""

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Return (quaternion (n, 4), omega_body (n, 3)) at times t_s (n,) >= 0."""


@dataclass(frozen=True, eq=False)
class ExactMotion:
    """A rotation and a flight that are independent of each other."""

    rotation: ExactRotation
    flight: Flight

    def at(self, t_s: Array) -> Trajectory:
        """Return the motion at any times (n,), at the same cost for each.

        The errors are at most 4e-15 rad for the attitude; for omega 4e-15 of its size or of its largest size
        up to then; for position and velocity half an ulp and some 1e-30 of their largest terms.

        Raises ValueError, naming the first invalid time, for times that are negative, not finite, or so late
        that 106 bits no longer resolve the angle.
        """
        for t in t_s[~(np.isfinite(t_s) & (t_s >= 0.0))]:
            raise ValueError(f"a motion is known at times that are finite and not negative, not {float(t)!r}")
        quaternion, omega_body = self.rotation.at(t_s)
        position, velocity = self.flight.at(t_s)
        return Trajectory(
            t_s=t_s,
            position_m=position,
            velocity_m_s=velocity,
            quaternion=quaternion,
            omega_body_rad_s=omega_body,
        )

    def errors(self, motion: Trajectory) -> Array:
        """Return the errors (3, n) of omega in rad/s, position in m and velocity in m/s before rounding.

        motion: the result of `at`.
        """
        sizes = np.linalg.norm(motion.omega_body, axis=-1)
        if isinstance(self.rotation, FixedAxisRotation):
            sizes = np.maximum(sizes, self.rotation.largest_rate(motion.t_s))
        return np.stack([EXACT_OMEGA_ERROR * sizes, *self.flight.errors(motion.t_s, motion.velocity_m_s)])


def closed_form_of(scene: Scene) -> ExactMotion | None:
    """Return the scene's motion in closed form, or None if there is none as accurate as a truth must be.

    The flight of a body without a pivot has a closed form under forces constant in world axes, gravity and
    linear drag. The rotation has one where no torque acts, where the only torque is a drag -k L, and where
    omega and all torques stay along one principal axis. The classification is exact for the given doubles.
    """
    loads = loads_of(scene)
    rotation = None if loads is None else _rotation_of(scene, loads)
    flight = None if loads is None or rotation is None else Flight.of(scene, loads)
    return None if flight is None or rotation is None else ExactMotion(rotation, flight)


def _rotation_of(scene: Scene, loads: PiecewiseLoads) -> ExactRotation | None:
    body, initial = scene.body, scene.initial
    if loads.is_torque_free:
        if not any(loads.angular_drag) or not initial.omega_body.any():
            return FreeRotation.from_pairs(body.inertia, initial.quaternion, *paired_omega(initial))
        decay = decay_rate(body.inertia, loads.angular_drag)
        if decay is not None:
            return StretchedRotation.of(scene, decay)
    return FixedAxisRotation.of(scene, loads)
