"""The truth of many free rotations at once, with the bounds and floors that `certification` gives each."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.exact_motion import EXACT_OMEGA_ERROR
from bodycheck.reference_impl.free_rotation.free_rotations import FreeRotations
from bodycheck.reference_impl.kernels.jit import long_kernel
from bodycheck.reference_impl.kernels.small_vectors import (
    Quat,
    Vec,
    cross,
    dot,
    matrix_at,
    matrix_of,
    times,
    vector_at,
)
from bodycheck.reference_impl.truth.certification import EXACT_BOUNDS, NUDGE

FREE_QUANTITIES = ("rad", "energy", "momentum", "omega_rad_s")
"""The quantities of a rotation, in the order of the last axis of `FreeTruths.bounds`."""

_HALF_ULP = 2.0**-53
_EPS = 2.0**-52


@dataclass(frozen=True, eq=False)
class FreeTruths:
    """m free rotations at n times, body axes and units as in `Truth`.

    quaternion (m, n, 4), omega_body (m, n, 3) in rad/s. bounds and round_offs (m, 4): the largest over the
    times of `Truth.bound_*` and `Truth.round_off_*` for each of FREE_QUANTITIES.
    """

    quaternion: Array
    omega_body: Array
    bounds: Array
    round_offs: Array


def free_truths(inertia: Array, quaternion: Array, omega_body: Array, t_s: Array) -> FreeTruths:
    """Return the torque-free motions through states at t = 0, with bounds and floors.

    inertia (m, 3, 3) in kg m^2, quaternion (m, 4), omega_body (m, 3) in rad/s, t_s (n,) in s, ascending.
    Attitudes and omega are those of `solve_truth`, bit for bit; bounds and floors agree to 1e-6. Neighbours
    rotated at the start stay as far away as they were, so only omega is perturbed. Raises ValueError as
    `FreeRotations` does.
    """
    rest = np.zeros_like(omega_body)
    q, omega = FreeRotations.from_checked(inertia, quaternion, omega_body, rest).at(t_s)
    spin = np.sqrt(np.max(np.sum(omega * omega, axis=-1), axis=1))
    tensors = np.ascontiguousarray(inertia).reshape(-1, 9)
    bounds, gaps = np.empty((len(q), 4)), np.zeros((len(q), 4))
    for axis in np.eye(3):
        nudged = omega_body + (NUDGE * spin)[:, None] * axis
        near = FreeRotations.from_checked(inertia, quaternion, nudged, rest, approximate=True)
        _add_distances(tensors, q, omega, *near.at(t_s), gaps)
    _fill_bounds(tensors, q, omega, bounds)
    smallest = (1.0 + spin * t_s[-1])[:, None] * np.stack([np.ones_like(spin)] * 3 + [spin], axis=1)
    smallest[spin == 0.0, 3] = 1.0
    return FreeTruths(q, omega, bounds, _EPS * np.maximum(gaps / NUDGE, smallest))


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
def _scales(tensor: Array, omega: Array) -> tuple[float, float]:
    """max K and max |L| over the samples, 1 where nothing moves."""
    inertia, kinetic, momentum = matrix_at(tensor, 0), 0.0, 0.0
    for i in range(len(omega)):
        spin = vector_at(omega[i], 0)
        about = times(inertia, spin)
        kinetic, momentum = max(kinetic, 0.5 * dot(spin, about)), max(momentum, _norm(about))
    return (kinetic if kinetic > 0.0 else 1.0), (momentum if momentum > 0.0 else 1.0)


@long_kernel
def _add_distances(
    tensors: Array, q: Array, omega: Array, other_q: Array, other_omega: Array, gaps: Array
) -> None:
    """Raise gaps (m, 4) to the largest `motion_distance.distances` over the samples."""
    for k in range(len(q)):
        inertia = matrix_at(tensors[k], 0)
        kinetic, momentum = _scales(tensors[k], omega[k])
        for i in range(q.shape[1]):
            one, other = _attitude(q[k, i]), _attitude(other_q[k, i])
            a, b = vector_at(omega[k, i], 0), vector_at(other_omega[k, i], 0)
            first, second = times(inertia, a), times(inertia, b)
            x, y, z = times(matrix_of(one), first)
            u, v, w = times(matrix_of(other), second)
            gaps[k, 0] = max(gaps[k, 0], _angle(one, other))
            gaps[k, 1] = max(gaps[k, 1], 0.5 * abs(dot(b, second) - dot(a, first)) / kinetic)
            gaps[k, 2] = max(gaps[k, 2], _norm((u - x, v - y, w - z)) / momentum)
            gaps[k, 3] = max(gaps[k, 3], _norm((b[0] - a[0], b[1] - a[1], b[2] - a[2])))


@long_kernel
def _fill_bounds(tensors: Array, q: Array, omega: Array, bounds: Array) -> None:
    """Fill bounds (m, 4): those of the closed form + half an ulp of each number, largest over the samples.

    A change d of q rotates the body by 2 v, v the vector part of q^-1 d, in body axes.
    """
    for k in range(len(q)):
        inertia = matrix_at(tensors[k], 0)
        kinetic, momentum = _scales(tensors[k], omega[k])
        for j in range(4):
            bounds[k, j] = 0.0
        for i in range(q.shape[1]):
            spin, (w, x, y, z) = vector_at(omega[k, i], 0), _attitude(q[k, i])
            about = times(inertia, spin)
            angle = speed = energy = change = 0.0
            for size, v in ((w, (-x, -y, -z)), (x, (w, -z, y)), (y, (z, w, -x)), (z, (-y, x, w))):
                angle += 2.0 * abs(size) * _norm(v)
                change += 2.0 * abs(size) * _norm(cross(v, about))
            for j in range(3):
                speed += abs(spin[j])
                energy += abs(spin[j] * about[j])
                column = (inertia[j], inertia[3 + j], inertia[6 + j])
                change += abs(spin[j]) * _norm(column)
            bounds[k, 0] = max(bounds[k, 0], EXACT_BOUNDS[0] + _HALF_ULP * angle)
            bounds[k, 1] = max(bounds[k, 1], EXACT_BOUNDS[1] + _HALF_ULP * energy / kinetic)
            bounds[k, 2] = max(bounds[k, 2], EXACT_BOUNDS[2] + _HALF_ULP * change / momentum)
            bounds[k, 3] = max(bounds[k, 3], EXACT_OMEGA_ERROR * _norm(spin) + _HALF_ULP * speed)
