"""The derivatives that engines compute, compared with those of their own motions and with exact ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck.examine.gradients.sensitivity import TERMS, sensitivity
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import log_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory

BLOCKS = {
    "attitude by inertia": (slice(0, 3), slice(0, 3)),
    "attitude by omega": (slice(0, 3), slice(3, 6)),
    "omega by inertia": (slice(3, 6), slice(0, 3)),
    "omega by omega": (slice(3, 6), slice(3, 6)),
}
_RIGHT = {"float64": 1e-6, "float32": 1e-2, "mixed": 1e-2}
"""Deviations from differences of the engine's own motion that round-off can cause."""
NUDGES = {"float64": 1e-3, "float32": 2e-2, "mixed": 2e-2}
"""Changes of a parameter, relative to the largest moment or rate, whose differences are taken."""
STENCIL = (-2, -1, 1, 2)
_EXPLAINED = 0.05  # of the deviation may remain
_NEGLIGIBLE = 1e-12


@dataclass(frozen=True, eq=False)
class CaseGradients:
    """Derivatives (6, 6) of one motion: the engine's, those of its own motion, and exact ones.

    coarse and fine: at a step and at half of it. own: by differences at that step.
    """

    name: str
    scene: Scene
    coarse: Array
    fine: Array
    own: Array

    def exact(self, missing: str = "") -> Array:
        """The exact derivative, or that with a term missing."""
        return sensitivity(self.scene, missing)


@dataclass(frozen=True)
class BlockResult:
    """One block of one method, the largest over all cases, relative to the block's largest component.

    own: from differences of the engine's own motion. coarse, fine: from the exact derivative at a step and at
    half of it. case: the case with the largest `own`.
    """

    block: str
    own: float
    coarse: float
    fine: float
    case: str
    right: bool


@dataclass(frozen=True)
class MethodGradients:
    """What one method computes, or the reason why not; cause: the fault that explains wrong blocks."""

    method: str
    blocks: tuple[BlockResult, ...] = ()
    outcome: str = "ok"
    reason: str = ""
    cause: str = ""

    @property
    def wrong(self) -> list[BlockResult]:
        """The blocks that are not derivatives of the engine's own motion."""
        return [block for block in self.blocks if not block.right]


def difference_matrix(
    motion: Trajectory, ends: Sequence[Sequence[Trajectory]], steps: Sequence[float]
) -> Array:
    """(6, 6) of a motion, by differences of order 4 of ends[parameter][stencil] with these steps."""
    columns, back = [], motion.rotation_matrices[-1].T
    for of_parameter, step in zip(ends, steps, strict=True):
        states = [
            np.concatenate([log_matrix(back @ one.rotation_matrices[-1]), one.omega_body[-1]])
            for one in of_parameter
        ]
        two_less, less, more, two_more = states
        columns.append((8.0 * (more - less) - (two_more - two_less)) / (12.0 * step))
    return np.array(columns).T


def method_gradients(method: str, precision: str, cases: Sequence[CaseGradients]) -> MethodGradients:
    """Return a method's deviations and, if some are wrong, the fault that explains them in all cases."""
    exact, own, coarse, fine = (
        np.stack(part)
        for part in zip(*((one.exact(), one.own, one.coarse, one.fine) for one in cases), strict=True)
    )
    blocks = []
    for name, (rows, columns) in BLOCKS.items():
        of_motion, at_step, at_half = (
            _largest(off[:, rows, columns]) / _largest(exact[:, rows, columns])
            for off in (coarse - own, coarse - exact, fine - exact)
        )
        worst = int(np.argmax(of_motion))
        off = float(of_motion[worst])
        right = off <= _RIGHT[precision]
        blocks.append(
            BlockResult(name, off, float(max(at_step)), float(max(at_half)), cases[worst].name, right)
        )
    found = MethodGradients(method, tuple(blocks))
    return MethodGradients(method, tuple(blocks), cause=_cause(cases)) if found.wrong else found


def _largest(matrices: Array) -> Array:
    """Return the largest absolute component of each matrix (n, ...)."""
    return np.asarray(np.max(np.abs(matrices), axis=(1, 2)))


def _cause(cases: Sequence[CaseGradients]) -> str:
    """Return the fault that leaves the least of the deviations of all cases, or "" if none explains them."""
    scales = [np.ones((6, 6)) for _ in cases]
    for scale, case in zip(scales, cases, strict=True):
        for rows, columns in BLOCKS.values():
            scale[rows, columns] = np.max(np.abs(case.exact()[rows, columns]))
    off = [(case.coarse - case.own) / scale for case, scale in zip(cases, scales, strict=True)]
    size = float(np.linalg.norm(off))
    left = {
        text: float(
            np.linalg.norm(
                [one - model / scale for one, model, scale in zip(off, models, scales, strict=True)]
            )
        )
        for text, models in _faults(cases)
    }
    best = min(left, key=lambda text: left[text])
    return best if left[best] <= _EXPLAINED * size else ""


def _faults(cases: Sequence[CaseGradients]) -> Iterator[tuple[str, list[Array]]]:
    """Yield faults in words, with the deviation (6, 6) that each causes in every case."""
    for term in TERMS:
        yield f"{term} is missing", [case.exact(term) - case.exact() for case in cases]
    parts = {
        "by inertia": (slice(None), slice(0, 3)),
        "by omega": (slice(None), slice(3, 6)),
        "of the attitude": (slice(0, 3), slice(None)),
        "of omega": (slice(3, 6), slice(None)),
        "": (slice(None), slice(None)),
        **BLOCKS,
    }
    for name, part in parts.items():
        own = np.concatenate([case.own[part].ravel() for case in cases])
        given = np.concatenate([case.coarse[part].ravel() for case in cases])
        factor = float(own @ given) / max(float(own @ own), _NEGLIGIBLE)
        masked = [np.zeros((6, 6)) for _ in cases]
        for matrix, case in zip(masked, cases, strict=True):
            matrix[part] = (factor - 1.0) * case.own[part]
        what = f"the derivative {name}".strip()
        yield (f"{what} is 0" if abs(factor) < 1e-3 else f"{what} is multiplied by {factor:.3g}"), masked
