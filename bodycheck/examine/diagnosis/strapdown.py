"""Attitudes that are integrated from the recorded omega, as strapdown navigation does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bodycheck.examine.diagnosis.transitions import AT_ROUND_OFF, ROUND_OFF, WITHIN, Transitions
from bodycheck.examine.diagnosis.whitening import Whitening
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import (
    conjugate,
    cross,
    exp_quaternion,
    log_quaternion,
    normalised,
    quaternion_product,
    quaternion_to_matrix,
)


@dataclass(frozen=True)
class StrapdownRule:
    """q+ from q, the angles h w0 and h w1 (n, 3) of omega before and after the step, in body axes."""

    name: str
    formula: str
    order: int
    step: Callable[[Array, Array, Array], Array]


def _added(q: Array, angle: Array) -> Array:
    pure = np.concatenate([np.zeros_like(angle[:, :1]), 0.5 * angle], axis=-1)
    return normalised(q + quaternion_product(q, pure))


def _turned(q: Array, angle: Array) -> Array:
    return quaternion_product(q, exp_quaternion(angle))


RULES = (
    StrapdownRule("left-rate exponential", "q+ = q exp(h w0 / 2)", 1, lambda q, a, _: _turned(q, a)),
    StrapdownRule("right-rate exponential", "q+ = q exp(h w1 / 2)", 1, lambda q, _, b: _turned(q, b)),
    StrapdownRule(
        "mean-rate exponential", "q+ = q exp(h (w0 + w1) / 4)", 2, lambda q, a, b: _turned(q, 0.5 * (a + b))
    ),
    StrapdownRule(
        "mean-rate exponential with coning",
        "q+ = q exp(h (w0 + w1) / 4 + h^2 (w0 x w1) / 24)",
        3,
        lambda q, a, b: _turned(q, 0.5 * (a + b) + cross(a, b) / 12.0),
    ),
    StrapdownRule("left-rate additive", "q+ = q + h/2 q w0, normalised", 1, lambda q, a, _: _added(q, a)),
    StrapdownRule("right-rate additive", "q+ = q + h/2 q w1, normalised", 1, lambda q, _, b: _added(q, b)),
    StrapdownRule(
        "mean-rate additive",
        "q+ = q + h/2 q (w0 + w1) / 2, normalised",
        2,
        lambda q, a, b: _added(q, 0.5 * (a + b)),
    ),
)
"""The rules that are recognised; w0 and w1: omega before and after the step."""


def strapdown_rules(transitions: Transitions) -> list[StrapdownRule]:
    """Return the rules by which the attitude follows from the recorded omega, all transitions considered."""
    path, indices = transitions.trajectory, transitions.indices
    dt = (path.t_s[indices + 1] - path.t_s[indices])[:, None]
    q, omega = normalised(path.attitude), path.omega_body
    before, after = dt * omega[indices], dt * omega[indices + 1]
    spread, least = transitions.spread, transitions.rounding[6:9] / ROUND_OFF
    limit = WITHIN if transitions.is_coarse else AT_ROUND_OFF
    whitening = Whitening.of(
        np.swapaxes(quaternion_to_matrix(exp_quaternion(0.5 * (before + after))), -1, -2),
        np.maximum(spread[6:9], least),
        np.hypot(least, float(np.max(dt)) * spread[9:12] * transitions.sizes[9:12]),
        np.r_[False, np.diff(indices) == 1],
    )
    found = []
    for rule in RULES:
        made = rule.step(q[indices], before, after)
        gaps = log_quaternion(quaternion_product(conjugate(made), q[indices + 1]))
        whitened = whitening.whitened(gaps.T[None])
        if np.sqrt(np.mean(whitened**2)) <= limit:
            found.append(rule)
    return found
