"""The work of the loads along a case's own samples, for the energy balance."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.forcing import held_between
from bodycheck.reference_impl.loads_at import Moment, wrench_at
from bodycheck.reference_impl.scene import Load, Scene, Spring, TorsionSpring
from bodycheck.reference_impl.trajectory import Trajectory

_DEGREES = (7, 5)  # of the splines through the power; their difference tells whether they resolve it


def working_loads(scene: Scene, begin_s: float, end_s: float) -> list[Load]:
    """Return what acts within [begin_s, end_s) and has no potential energy."""
    lasting = [load for load in scene.lasting_loads if not isinstance(load, Spring | TorsionSpring)]
    return [*held_between(scene, begin_s, end_s), *lasting]


def work_done(scene: Scene, motion: Trajectory) -> tuple[Array, float] | None:
    """W_k = integral from 0 to t_k of F . v + tau . omega, loads with a potential apart, and the error of W.

    The power at the samples is integrated by splines between the switches. Returns (n,) in J and an
    error in J, or None where a switch lies between samples, a piece has too few of them, or a load lasts.
    """
    if scene.lasting_loads or scene.pivot is not None:
        return None
    t, n = motion.t_s, len(motion.t_s)
    ends = [0.0, *scene.switches_before(scene.duration_s), scene.duration_s]
    places = [int(np.argmin(np.abs(t - end))) for end in ends]
    if any(abs(t[k] - end) > 1e-9 * scene.sample_interval_s for k, end in zip(places, ends, strict=True)):
        return None
    work, error = np.zeros(n), 0.0
    for (first, last), (begin, end) in zip(pairwise(places), pairwise(ends), strict=True):
        loads = working_loads(scene, begin, end)
        inside = slice(first, last + 1)
        if not loads:
            work[inside] = work[first]
            continue
        if last - first < _DEGREES[0]:
            return None
        done, gap = _integrals(t[inside], power(scene, loads, motion)[inside])
        work[inside] = work[first] + done
        error += gap
    return work, error


def _integrals(t: Array, power: Array) -> tuple[Array, float]:
    from scipy.interpolate import make_interp_spline  # half a second to import; only forced scenes need it

    fine, coarse = (make_interp_spline(t, power, k=degree).antiderivative()(t) for degree in _DEGREES)
    return fine - fine[0], float(np.max(np.abs((fine - fine[0]) - (coarse - coarse[0]))))


def power(scene: Scene, loads: Sequence[Load], motion: Trajectory) -> Array:
    """P = F . v + tau . omega of these loads at every sample: (n,) in W."""
    moment = Moment(
        t=motion.t_s,
        position=motion.position_m,
        rotation=motion.rotation_matrices,
        velocity=motion.velocity_m_s,
        omega=motion.omega_world,
    )
    total = np.zeros(len(motion.t_s))
    for load in loads:
        force, torque = wrench_at(load, scene, moment)
        total += np.sum(force * moment.velocity + torque * moment.omega, axis=-1)
    return total
