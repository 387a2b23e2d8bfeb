"""Compile the set-up kernels in two independent halves, so that two processes can work in parallel."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.free_rotation.classification import is_certainly_tumbling, separation_of
from bodycheck.reference_impl.free_rotation.evaluation import evaluate
from bodycheck.reference_impl.free_rotation.packing import WIDTH, put_tumbling
from bodycheck.reference_impl.free_rotation.set_up import frame_of, placed
from bodycheck.reference_impl.free_rotation.tensor_axes import Frame
from bodycheck.reference_impl.free_rotation.tumbling_constants import numbered, tumble

_INERTIA, _OMEGA, _QUATERNION = (
    np.diag([1.0, 2.0, 3.0]).ravel(),
    np.array([0.1, 2.0, 0.1]),
    np.array([1.0, 0.0, 0.0, 0.0]),
)


def compile_frame_and_evaluation() -> None:
    """Compile the kernels from a tensor to its principal frame, and from a row to the motion at times."""
    frame_of(_INERTIA, _OMEGA, np.zeros(3))
    nothing = np.zeros(0)
    evaluate(np.zeros((0, WIDTH)), nothing, nothing, np.zeros((0, 0, 4)), np.zeros((0, 0, 3)))


def compile_tumbling() -> None:
    """Compile the kernels from the principal frame to a row."""
    frame = Frame(
        moments=((1.0, 0.0), (2.0, 0.0), (3.0, 0.0)),
        gaps=((1.0, 0.0), (2.0, 0.0), (1.0, 0.0)),
        omega=((0.1, 0.0), (2.0, 0.0), (0.1, 0.0)),
        axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    )
    axes = numbered(frame, False)
    is_certainly_tumbling(axes)
    _, separation = separation_of(axes)
    axes = numbered(frame, separation.descending)
    put_tumbling(np.empty(WIDTH), placed(tumble(axes, separation), axes, _OMEGA, _QUATERNION))
