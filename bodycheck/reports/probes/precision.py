"""Whether a method computes in the precision that it states, from the numbers it holds after each step.

An exact motion has smooth samples: their eighth differences, of order (omega h)^8, are far below round-off.
What is left is the round-off of single steps, also where only one stage of a step is rounded to float32.
"""

from __future__ import annotations

import numpy as np

from bodycheck.adapters.contract import Precision
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.probes.finding import Finding

_DIFFERENCES = 8
_DIFFERENCE_NORM = float(np.sqrt(12870.0))  # of an eighth difference of independent errors: C(16, 8)
_EPS, _SINGLE_EPS = float(np.finfo(np.float64).eps), float(np.finfo(np.float32).eps)
_MOST_DOUBLE = 16.0 * _EPS  # healthy methods stay below one, a float32 stage is above 70
_LEAST_SINGLE = 1e-3 * _SINGLE_EPS


def precision_finding(path: Trajectory, stated: Precision) -> Finding:
    """Return the largest round-off of one step, relative, against the stated precision.

    path: of a free motion, one sample after each step; the steps are not dyadic, so that double precision
    leaves no number that fits into float32.
    """
    found = max(_round_off(values) for values in _states(path))
    single = is_single(path)
    message = ""
    if stated == "float64":
        if single:
            message = "every number fits into float32: the state is not held in float64"
        elif found > _MOST_DOUBLE:
            message = f"steps are rounded at {found:.1e} of the state: not all of the arithmetic is float64"
        deviation = 1.0 if single else found
        return Finding("precision", found, 0.0, deviation, _MOST_DOUBLE, message)
    wrong = not single and found < _LEAST_SINGLE
    if wrong:
        message = f"steps are rounded at {found:.1e} of the state: it is held in float64"
    return Finding("precision", found, _SINGLE_EPS, float(wrong), 0.0, message)


def is_single(path: Trajectory) -> bool:
    """Whether all velocities and omegas after a step fit into float32."""
    omega = path.omega_world_rad_s if path.omega_body_rad_s is None else path.omega_body_rad_s
    held = (values[1:] for values in (path.velocity_m_s, omega) if values is not None)
    return all(bool(np.all(values == values.astype(np.float32))) for values in held)


def _states(path: Trajectory) -> list[Array]:
    held = (path.quaternion, path.rotation, path.omega_body_rad_s, path.omega_world_rad_s)
    there = [values.reshape(len(values), -1) for values in held if values is not None]
    return [path.position_m, path.velocity_m_s, *there]


def _round_off(values: Array) -> float:
    """Return the median |eighth difference| of values (n, k), over its norm and the largest value."""
    size = float(np.max(np.abs(values)))
    if size == 0.0 or len(values) <= _DIFFERENCES:
        return 0.0
    differences = np.median(np.abs(np.diff(values, _DIFFERENCES, axis=0)), axis=0)
    return float(np.max(differences)) / (_DIFFERENCE_NORM * size)
