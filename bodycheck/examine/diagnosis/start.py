"""How the first sample of a recording differs from the start of its scenario, and what that means."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bodycheck._util.formatting import names, number
from bodycheck.examine.diagnosis.engine_model import ReportedStates
from bodycheck.examine.diagnosis.faults.wrong_readings import quaternions_as_set, wrong_readings
from bodycheck.examine.diagnosis.quantity_resolution import UNITS, Resolution
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle, normalised, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory

_SAME = 3.0  # multiples of the resolution
_SAME_ROUND_OFF = 1e-12  # relative to the size of a quantity


@dataclass(frozen=True)
class StartState:
    """One state: position, velocity (3,) and attitude (4,) in world axes, omega (3,) in its own axes."""

    position: Array
    velocity: Array
    attitude: Array
    omega: Array

    @classmethod
    def of(cls, scene: Scene, *, world_omega: bool) -> StartState:
        """Return the start of a scenario, with omega in the axes that a recording has."""
        initial = scene.initial
        omega = initial.omega_body
        omega = quaternion_to_matrix(initial.quaternion) @ omega if world_omega else omega
        return cls(initial.position, initial.velocity, normalised(initial.quaternion), omega)


@dataclass(frozen=True)
class StartDifference:
    """The differences of the first sample from the start of the scenario, and what would explain them.

    sizes: quantity -> difference in its unit. meaning: "" where none is known. begins_late: whether the
    log begins with the state after the first sample interval or step.
    """

    sizes: Mapping[str, float]
    meaning: str = ""
    begins_late: bool = False

    @property
    def sentence(self) -> str:
        """The difference in one sentence."""
        parts = [f"{name} by {number(size, 3)} {UNITS[name]}" for name, size in self.sizes.items()]
        meaning = f": {self.meaning}" if self.meaning else ""
        return f"the first sample differs from the start of the scenario, {names(parts)}{meaning}"


def start_difference(
    scene: Scene,
    trajectory: Trajectory,
    known: frozenset[str],
    resolution: Resolution,
    later: Mapping[str, StartState],
) -> StartDifference | None:
    """Return how the first sample differs from the start of the scenario; None where it does not.

    later: sentence -> the state of the same motion somewhat later, with which a log may begin.
    """
    world_omega = trajectory.omega_body_rad_s is None
    start = StartState.of(scene, world_omega=world_omega)
    omega = trajectory.omega_world_rad_s if world_omega else trajectory.omega_body_rad_s
    assert omega is not None
    attitude = trajectory.attitude[0]
    first = StartState(trajectory.position_m[0], trajectory.velocity_m_s[0], attitude, omega[0])
    sizes = _differences(first, start, known, resolution)
    if not sizes:
        return None
    for meaning, state in later.items():
        if not _differences(first, state, known, resolution):
            return StartDifference(sizes, meaning, begins_late=True)
    found = []
    for name in ("attitude", "omega"):
        if name in sizes:
            for meaning, state in _readings(start, scene, name, world_omega=world_omega):
                if name not in _differences(first, state, known, resolution):
                    found.append(f"as if {meaning}")
                    break
    return StartDifference(sizes, "; ".join(found))


def _differences(
    first: StartState, start: StartState, known: frozenset[str], resolution: Resolution
) -> dict[str, float]:
    found: dict[str, float] = {}
    for name in ("attitude", "omega", "position", "velocity"):
        if name not in known:
            continue
        one, other = getattr(first, name), getattr(start, name)
        size = 1.0 if name == "attitude" else float(np.max(np.abs([one, other])))
        distance = (
            float(geodesic_angle(one / np.linalg.norm(one), other))
            if name == "attitude"
            else float(np.linalg.norm(one - other))
        )
        if distance > max(_SAME * getattr(resolution, name), _SAME_ROUND_OFF * size):
            found[name] = distance
    return found


def _readings(
    start: StartState, scene: Scene, name: str, *, world_omega: bool
) -> Iterator[tuple[str, StartState]]:
    """Yield how the first attitude or omega may have been read or set, and the state that this makes."""
    right = ReportedStates(
        start.position[:, None], start.velocity[:, None], start.attitude[:, None], start.omega[:, None]
    )
    for one in wrong_readings("q" if name == "attitude" else "w"):
        read = one.apply(right, world_omega=world_omega)
        yield one.text, replace(start, attitude=read.q[:, 0], omega=read.w[:, 0])
    if name == "attitude":
        for text, as_set in quaternions_as_set():
            yield text, replace(start, attitude=as_set(start.attitude))
        yield "the attitude is the identity", replace(start, attitude=np.array([1.0, 0.0, 0.0, 0.0]))
    else:
        rotation = quaternion_to_matrix(scene.initial.quaternion)
        inverse = rotation @ start.omega if world_omega else rotation.T @ start.omega
        yield "omega is rotated by the inverse of the attitude", replace(start, omega=inverse)
