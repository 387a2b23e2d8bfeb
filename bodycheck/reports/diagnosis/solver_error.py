"""Whether a motion is the exact one up to the errors of a solver that chooses its own steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bodycheck.reports.diagnosis.flow import EXACT
from bodycheck.reports.diagnosis.transitions import QUANTITIES, ROUND_OFF, Transitions

_SMALL = 5e-3  # rad, or over the scale, per sample
_OUTSTANDING, _STANDS_OUT = 1e-4, 30.0  # of a few transitions: their size, and multiples of the usual one
_WINDOW_RAD = 1.0  # of the rotation: a fault, a function of the state, changes little within it
_FEWEST, _WINDOWS = 8, 4  # samples in a window, and windows
_SMOOTH = 0.5  # share of the energy that means over windows keep
_SIGNIFICANT = 9.0  # of such energy, over that of rounding
_ROUNDED = 2.0  # energy over that of rounding, below which nothing else shows per sample


@dataclass(frozen=True)
class SolverError:
    """What remains of the exact motion over one sample interval.

    size: the largest difference, over the scales. usual: that of nine transitions in ten. is_small: whether a
    solver could leave it; not what stands out in a few transitions. is_smooth:
    whether most of it varies as slowly as the state, as the effect of a fault does; the errors of a solver
    vary with its steps, and the errors of its interpolation within them. is_rounding: whether it is as small
    as the rounding of the recording.
    """

    size: float
    usual: float
    is_smooth: bool
    is_rounding: bool

    @property
    def is_small(self) -> bool:
        """Whether a solver could leave so much."""
        return self.size <= _SMALL and (self.size <= _OUTSTANDING or self.size <= _STANDS_OUT * self.usual)


def solver_error(transitions: Transitions) -> SolverError:
    """Return the differences from the exact motion, all transitions considered."""
    gaps = transitions.gaps([transitions.grid.model(transitions.scene)], EXACT)[0]
    angle = np.linalg.norm(transitions.trajectory.omega_body, axis=-1)[transitions.indices]
    turned = float(np.mean(angle * np.diff(transitions.trajectory.t_s)[transitions.indices]))
    count = gaps.shape[-1]
    length = min(max(_FEWEST, round(_WINDOW_RAD / max(turned, 1e-6))), max(count // _WINDOWS, 1))
    smooth, rounding, size, usual = False, True, 0.0, 0.0
    for name, span in QUANTITIES.items():
        if name not in transitions.known:
            continue
        own = gaps[span]
        spread = float(transitions.spread[span.start])
        step = float(transitions.rounding[span.start]) / ROUND_OFF
        noise = 2.0 * spread**2 + step**2
        windows = own[:, : count // length * length].reshape(3, -1, length).mean(axis=-1)
        energy, slow = float(np.mean(own**2)), float(np.mean(windows**2))
        shows = slow > _SIGNIFICANT * (2.0 * (spread / length) ** 2 + step**2 / length)
        smooth |= shows and slow > _SMOOTH * max(energy - noise, 0.0)
        rounding &= energy <= _ROUNDED * noise
        lengths = np.linalg.norm(own, axis=0)
        size, usual = max(size, float(np.max(lengths))), max(usual, float(np.quantile(lengths, 0.9)))
    return SolverError(size, usual, smooth, rounding)
