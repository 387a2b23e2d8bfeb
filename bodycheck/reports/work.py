"""The work of the loads along a case's own samples, for the energy balance."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import Wrench, wrench_between

_DEGREES = (7, 5)  # of the splines through the power; their difference tells whether they resolve it


def work_done(scene: Scene, motion: Trajectory) -> tuple[Array, float] | None:
    """W_k = integral from 0 to t_k of F . v + tau . omega, gravity apart, and the error of W.

    The power at the samples is integrated by splines between the switches. Returns (n,) in J and an
    error in J, or None where a switch lies between samples or a piece has too few of them.
    """
    t, n = motion.t_s, len(motion.t_s)
    ends = [0.0, *scene.switches_before(scene.duration_s), scene.duration_s]
    places = [int(np.argmin(np.abs(t - end))) for end in ends]
    if any(abs(t[k] - end) > 1e-9 * scene.sample_interval_s for k, end in zip(places, ends, strict=True)):
        return None
    work, error = np.zeros(n), 0.0
    for (first, last), (begin, end) in zip(pairwise(places), pairwise(ends), strict=True):
        wrench = wrench_between(scene, begin, end)
        inside = slice(first, last + 1)
        if wrench.is_zero:
            work[inside] = work[first]
            continue
        if last - first < _DEGREES[0]:
            return None
        done, gap = _integrals(t[inside], _power(wrench, motion, inside))
        work[inside] = work[first] + done
        error += gap
    return work, error


def _integrals(t: Array, power: Array) -> tuple[Array, float]:
    from scipy.interpolate import make_interp_spline  # half a second to import; only forced scenes need it

    fine, coarse = (make_interp_spline(t, power, k=degree).antiderivative()(t) for degree in _DEGREES)
    return fine - fine[0], float(np.max(np.abs((fine - fine[0]) - (coarse - coarse[0]))))


def _power(wrench: Wrench, motion: Trajectory, inside: slice) -> Array:
    """P = tau . omega + F . v, with the loads of body axes turned: (m,) in W."""
    rotation = motion.rotation_matrices[inside]
    omega_body, omega_world = motion.omega_body[inside], motion.omega_world[inside]
    velocity = motion.velocity_m_s[inside]
    power = omega_body @ wrench.torque_body + omega_world @ wrench.torque_world
    power += np.einsum("ni,nij,j->n", velocity, rotation, wrench.force_body) + velocity @ wrench.force_world
    for at, force in wrench.point_forces:
        power += (velocity + np.cross(omega_world, rotation @ at)) @ force
    return np.asarray(power)
