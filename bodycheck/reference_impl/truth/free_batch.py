"""The truth of many free rotations at once, with the bounds and floors that `certification` gives each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation.free_rotations import FreeRotations
from bodycheck.reference_impl.kernels.jit import long_kernel
from bodycheck.reference_impl.kernels.small_vectors import Quat, Vec, cross, dot
from bodycheck.reference_impl.truth.certification import EXACT_BOUNDS, NUDGE

_HALF_ULP = 2.0**-53
_EPS = 2.0**-52


@dataclass(frozen=True, eq=False)
class FreeTruths:
    """m free rotations at n times, body axes and units as in `Truth`.

    quaternion (m, n, 4), omega_body (m, n, 3) in rad/s. bound_rad and round_off_rad (m,): the largest of
    those of `Truth` over the times.
    """

    quaternion: Array
    omega_body: Array
    bound_rad: Array
    round_off_rad: Array


def free_truths(inertia: Array, quaternion: Array, omega_body: Array, t_s: Array) -> FreeTruths:
    """Return the torque-free motions through states at t = 0, with bounds and floors.

    inertia (m, 3, 3) in kg m^2, quaternion (m, 4), omega_body (m, 3) in rad/s, t_s (n,) in s, ascending.
    Attitudes and omega are those of `solve_truth`, bit for bit; bounds and floors agree to 1e-6. Neighbours
    rotated at the start stay as far away as they were, so only omega is perturbed. Raises ValueError for no
    times, and as `FreeRotations` does.
    """
    if not len(t_s):
        raise ValueError(f"t_s must have at least one time, got {t_s.tolist()}")
    rest = np.zeros_like(omega_body)
    q, omega = FreeRotations.from_checked(inertia, quaternion, omega_body, rest).at(t_s)
    spin = np.sqrt(np.max(np.sum(omega * omega, axis=-1), axis=1))
    gaps = np.zeros(len(q))
    for axis in np.eye(3):
        nudged = omega_body + (NUDGE * spin)[:, None] * axis
        near, _ = FreeRotations.from_checked(inertia, quaternion, nudged, rest, approximate=True).at(t_s)
        _raise_gaps(q, near, gaps)
    smallest = 1.0 + spin * t_s[-1]
    return FreeTruths(q, omega, _bounds(q), _EPS * np.maximum(gaps / NUDGE, smallest))


@long_kernel
def _angle(p: Quat, q: Quat) -> float:
    """2 atan2(|v|, |p . q|), as `rotations.geodesic_angle` has it, for unit quaternions."""
    cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3]
    s = -1.0 if cosine < 0.0 else 1.0
    w, d = s * q[0] - p[0], (s * q[1] - p[1], s * q[2] - p[2], s * q[3] - p[3])
    x, y, z = cross((p[1], p[2], p[3]), d)
    a, b, c = p[0] * d[0] - w * p[1] - x, p[0] * d[1] - w * p[2] - y, p[0] * d[2] - w * p[3] - z
    return 2.0 * math.atan2(math.sqrt(a * a + b * b + c * c), abs(cosine))


@long_kernel
def _norm(v: Vec) -> float:
    return math.sqrt(dot(v, v))


@long_kernel
def _attitude(q: Array) -> Quat:
    return q[0], q[1], q[2], q[3]


@long_kernel
def _raise_gaps(q: Array, other_q: Array, gaps: Array) -> None:
    """Raise gaps (m,) to the largest angle between two attitudes (m, n, 4) over the samples."""
    for k in range(len(q)):
        for i in range(q.shape[1]):
            gaps[k] = max(gaps[k], _angle(_attitude(q[k, i]), _attitude(other_q[k, i])))


@long_kernel
def _bounds(q: Array) -> Array:
    """Return (m,): that of the closed form + half an ulp of each number, largest over the samples.

    A change d of q rotates the body by 2 v, v the vector part of q^-1 d, in body axes.
    """
    bounds = np.zeros(len(q))
    for k in range(len(q)):
        for i in range(q.shape[1]):
            w, x, y, z = _attitude(q[k, i])
            angle = 0.0
            for size, v in ((w, (-x, -y, -z)), (x, (w, -z, y)), (y, (z, w, -x)), (z, (-y, x, w))):
                angle += 2.0 * abs(size) * _norm(v)
            bounds[k] = max(bounds[k], EXACT_BOUNDS[0] + _HALF_ULP * angle)
    return bounds
