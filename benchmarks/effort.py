"""The sizes of a measurement: in full, or small enough for a test."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """Sizes and repeats.

    rounds: of interleaved timing. seconds: time per task and round. targets: the errors of the work-precision
    curves. orbits, steps: of the long-term drift. bodies: per batch. subdivisions: n of the icosahedron of
    20 x 4^n triangles whose mass properties are computed. starts: the number of separate processes.
    """

    rounds: int
    seconds: float
    targets: tuple[float, ...]
    orbits: int
    steps: int
    bodies: int
    subdivisions: int
    starts: int


FULL = Effort(
    rounds=11,
    seconds=0.02,
    targets=tuple(10.0**-k for k in range(3, 14)),
    orbits=8,
    steps=1_000_000,
    bodies=100_000,
    subdivisions=6,
    starts=5,
)

QUICK = Effort(
    rounds=3,
    seconds=0.0,
    targets=(1e-3, 1e-9, 1e-11, 1e-12),
    orbits=2,
    steps=1_000,
    bodies=1_000,
    subdivisions=1,
    starts=0,
)
