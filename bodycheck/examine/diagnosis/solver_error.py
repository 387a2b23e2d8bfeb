"""Whether a motion is the exact one up to the errors of a solver that chooses its own steps."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import EXACT
from bodycheck.examine.diagnosis.transitions import QUANTITIES, ROUND_OFF, Transitions
from bodycheck.reference_impl.arrays import Array

_SMALL = 5e-3  # rad, or over the scale, per sample
_OUTSTANDING, _STANDS_OUT = 1e-4, 30.0  # of a few transitions: their size, and multiples of the usual one
_WINDOW_RAD = 1.0  # of the rotation: a fault, a function of the state, changes little within it
_FEWEST, _WINDOWS = 8, 4  # samples in a window, and windows
_SMOOTH = 0.5  # share of the energy that means over windows keep
_SIGNIFICANT = 9.0  # of such energy, over that of rounding
_ROUNDED = 2.0  # energy over that of rounding, below which nothing else shows per sample
_ONE_SIDED = 0.6  # correlation with the state: at most 0.5 for solvers of SciPy, 1 for damping


@dataclass(frozen=True)
class SolverError:
    """What remains of the exact motion over one sample interval.

    size: the largest difference, over the scales. usual: that of nine transitions in ten. is_small: whether a
    solver could leave it; not what stands out in a few transitions. is_smooth:
    whether most of it varies as slowly as the state, as the effect of a fault does; the errors of a solver
    vary with its steps, and the errors of its interpolation within them. is_rounding: whether it is as small
    as the rounding of the recording. is_one_sided: whether it brings energy in, or takes it out, in nearly
    every transition, as damping does.
    """

    size: float
    usual: float
    is_smooth: bool
    is_rounding: bool
    is_one_sided: bool

    @property
    def has_structure(self) -> bool:
        """Whether it may be the effect of a fault."""
        return self.is_smooth or self.is_one_sided

    @property
    def is_small(self) -> bool:
        """Whether a solver could leave so much."""
        return self.size <= _SMALL and (self.size <= _OUTSTANDING or self.size <= _STANDS_OUT * self.usual)


def solver_error(transitions: Transitions) -> SolverError:
    """Return the differences from the exact motion, all transitions considered."""
    gaps = transitions.healthy_gaps(EXACT)[0]
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
    return SolverError(size, usual, smooth, rounding, _is_one_sided(transitions, gaps))


def _is_one_sided(transitions: Transitions, gaps: Array) -> bool:
    """Whether differences (12, s) of omega or velocity change the energy as steadily as their size allows.

    |sum omega . I d| / sqrt(sum omega . I omega sum d . I d), with v and d of the velocity for omega and I.
    """
    path = transitions.trajectory
    inertia = transitions.scene.body.inertia
    parts = (("omega", path.omega_body, inertia), ("velocity", path.velocity_m_s, np.eye(3)))
    for name, states, weight in parts:
        if name not in transitions.known:
            continue
        own, state = gaps[QUANTITIES[name]].T, states[transitions.indices]
        if name == "omega" and transitions.world_omega:
            own = np.einsum("nji,nj->ni", path.rotation_matrices[transitions.indices + 1], own)
        noise = float(np.max(transitions.noise[QUANTITIES[name]]))
        work = float(np.sum(state @ weight * own))
        size = math.sqrt(float(np.sum(state @ weight * state) * np.sum(own @ weight * own)))
        if np.mean(own**2) > noise**2 and abs(work) > _ONE_SIDED * size:
            return True
    return False
