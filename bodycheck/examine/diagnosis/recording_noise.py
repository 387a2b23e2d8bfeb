"""White noise of a recording, as that of a sensor, by what it leaves of the exact motion from row to row.

Where each row is off by e(k), a transition misses d(k) = e(k + 1) - A e(k). Where the body turns little
between rows, A is nearly 1, and d(k + 1) - d(k) = e(k + 2) - 2 e(k + 1) + e(k) has the autocovariances
6, -4, 1 times the variance of e; what varies as slowly as the state, such as the effect of a fault, is
nearly gone from it. Noise of a rate moves the pose beside it: 2, -1 times the variance of dt e.

Source: Allan (1966), Proceedings of the IEEE 54, 221: second differences.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import EXACT
from bodycheck.examine.diagnosis.quantity_resolution import Resolution
from bodycheck.examine.diagnosis.transitions import QUANTITIES, Transitions

_FEWEST = 50  # transitions
_LARGEST_TURN_RAD, _MOST = 0.5, 0.95  # between most of the rows, so that A is nearly 1
_ABOVE = 3.0  # times the deviation that the resolution leaves: less is no noise of its own
_SAME = 0.1  # of the correlation of neighbours
_RATES = {"position": "velocity", "attitude": "omega"}


def with_noise(transitions: Transitions) -> Resolution | None:
    """Return the resolution of a recording with its noise in place of its digits, where that is larger.

    None where no quantity has noise, or where the differences of one are not those of white noise.
    """
    path, given = transitions.trajectory, transitions.resolution
    interval_s = np.diff(path.t_s)
    turned = np.linalg.norm(path.omega_body[:-1], axis=-1) * interval_s
    if len(transitions.indices) < _FEWEST or np.quantile(turned, _MOST) > _LARGEST_TURN_RAD:
        return None
    gaps = transitions.healthy_gaps(EXACT)[0]
    square_s = float(np.mean(interval_s**2))
    found: dict[str, float] = {}
    noise: dict[str, float] = {}
    for name in ("velocity", "omega", "position", "attitude"):
        if name not in transitions.known:
            continue
        span = QUANTITIES[name]
        size = float(transitions.sizes[span.start])
        change = size * np.diff(gaps[span])
        energy = float(np.mean(change**2))
        neighbours = float(np.mean(change[:, 1:] * change[:, :-1]))
        moved = square_s * found.get(_RATES.get(name, ""), 0.0) ** 2
        variance = max(energy - 2.0 * moved, 0.0) / 6.0
        stated = size * float(transitions.spread[span.start])
        found[name] = max(math.sqrt(variance), stated)
        if found[name] > _ABOVE * stated:
            if abs(neighbours + 4.0 * variance + moved) > _SAME * energy:
                return None
            noise[name] = math.sqrt(12.0) * found[name]
    return replace(given, **noise, noise=frozenset(noise)) if noise else None
