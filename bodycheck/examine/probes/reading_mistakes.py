"""The mistake of an adapter that explains wrong readings of a free motion.

Each mistake has the correction that undoes it. A mistake explains the readings if they are consistent once
it is undone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from bodycheck.adapters.contract import ReadBack, Reading
from bodycheck.examine.diagnosis.engine_model import ReportedStates
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import Changed
from bodycheck.examine.diagnosis.faults.wrong_readings import WrongReading, wrong_readings
from bodycheck.examine.probes.finding import Finding, Sampled, limit
from bodycheck.examine.probes.readings import reading_findings, turning
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import matrix_to_quaternion, project_to_so3, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.trajectory import Trajectory


@dataclass(frozen=True)
class Mistake:
    """A wrong reading in words, the correction that undoes it, and the checks that it fails."""

    text: str
    undone: Callable[[Trajectory], Trajectory]
    checks: tuple[str, ...]


_OMEGA = ("omega_body_reading", "omega_world_reading")
_OF_ATTITUDE = (*_OMEGA, "rotation_reading")
_VELOCITY = ("velocity_reading",)
_SAME_SHARE = 1e-2  # relative; float32 leaves 2e-3 of the positions of a probe


def reading_mistake(
    motions: Sequence[Sampled], resolution: float, findings: Sequence[Finding]
) -> Mistake | None:
    """Return the mistake that explains the inconsistent findings of `reading_findings`, if one does."""
    wrong = {finding.check for finding in findings if finding.verdict == "inconsistent"}
    last = motions[-1]
    found = [
        mistake
        for mistake in _mistakes(last.trajectory, last.scene)
        if (concerned := wrong.intersection(mistake.checks))
        and _explains(mistake, motions, resolution, concerned)
    ]
    if found:
        return replace(found[0], text=", or ".join(mistake.text for mistake in found))
    return _step_mistake(motions, wrong)


def _explains(mistake: Mistake, motions: Sequence[Sampled], resolution: float, checks: set[str]) -> bool:
    """Whether these checks are consistent without the mistake, the first coarse step left out.

    It begins with the state that the adapter was given, which it may hold in another form.
    """
    cells = len(motions[0].trajectory.t_s) - 1
    corrected = []
    for motion in motions:
        per_cell = (len(motion.trajectory.t_s) - 1) // cells
        later = part_of(motion.trajectory, slice(per_cell, None))
        corrected.append(replace(motion, trajectory=mistake.undone(later)))
    found = {finding.check: finding for finding in reading_findings(corrected, resolution)}
    return all(found[check].verdict == "consistent" for check in checks)


def part_of(path: Trajectory, samples: slice) -> Trajectory:
    """Return these samples of a trajectory."""
    arrays = {name: getattr(path, name) for name in path.__dataclass_fields__}
    cut: dict[str, Any] = {name: value[samples] for name, value in arrays.items() if value is not None}
    return Trajectory(**cut)


def _mistakes(path: Trajectory, scene: Scene) -> Iterator[Mistake]:
    """Yield the wrong readings of the catalogue that a motion with these quantities may have."""
    for one in wrong_readings():
        if one.quantity == "q" and path.quaternion is not None:
            yield Mistake(one.text, partial(_with_attitude, one, "quaternion"), _OF_ATTITUDE)
        if one.quantity == "q" and path.rotation is not None:
            text = one.text.replace("quaternion", "rotation matrix")
            yield Mistake(text, partial(_with_attitude, one, "rotation"), _OF_ATTITUDE)
        for axes, check in zip(("body", "world"), _OMEGA, strict=True):
            if one.quantity == "w" and getattr(path, f"omega_{axes}_rad_s") is not None:
                text = one.text.replace("omega", f"omega_{axes}", 1)
                yield Mistake(text, partial(_with_omega, one, axes), (check,))
        if one.quantity in ("x", "v"):
            yield Mistake(one.text, partial(_with_translation, one), _VELOCITY)
    if scene.link is not None:
        for name in ("position", "velocity"):
            point = WrongReading.of(f"{name}-of-another-point", scene.link.offset)
            text = f"the {name} is that of the link's origin, not of the centre of mass"
            yield Mistake(text, partial(_with_translation, point), _VELOCITY)


def _reading(path: Trajectory, attitude: Array, *, world_omega: bool) -> ReportedStates:
    omega = path.omega_world if world_omega else path.omega_body
    return ReportedStates(path.position_m.T, path.velocity_m_s.T, attitude.T, omega.T)


def _with_attitude(one: WrongReading, form: str, path: Trajectory) -> Trajectory:
    if form == "quaternion":
        assert path.quaternion is not None
        read = one.undo(_reading(path, path.quaternion, world_omega=False), world_omega=False)
        return replace(path, quaternion=read.q.T)
    assert path.rotation is not None
    attitude = matrix_to_quaternion(project_to_so3(path.rotation))
    read = one.undo(_reading(path, attitude, world_omega=False), world_omega=False)
    return replace(path, rotation=quaternion_to_matrix(read.q.T))


def _with_omega(one: WrongReading, axes: str, path: Trajectory) -> Trajectory:
    world = axes == "world"
    name = f"omega_{axes}_rad_s"
    reading = replace(_reading(path, path.attitude, world_omega=False), w=getattr(path, name).T)
    changed: dict[str, Any] = {name: one.undo(reading, world_omega=world).w.T}
    return replace(path, **changed)


def _with_translation(one: WrongReading, path: Trajectory) -> Trajectory:
    read = one.undo(_reading(path, path.attitude, world_omega=True), world_omega=True)
    return replace(path, position_m=read.x.T, velocity_m_s=read.v.T)


def _step_mistake(motions: Sequence[Sampled], wrong: set[str]) -> Mistake | None:
    """Return a step of another length than requested: omega and velocity are too large by the same factor."""
    shares = [_shares(motion.trajectory, motion.dt_s) for motion in motions]
    found = limit([motion.dt_s for motion in motions], [share[np.newaxis] for share in shares], 0.0).value[0]
    share = float(np.mean(found))
    if not {*_VELOCITY} < wrong or np.ptp(found) > _SAME_SHARE * abs(share):
        return None
    text = f"the engine's step is {share:.3g} times the requested one"
    return Mistake(text, lambda path: path, (*_OMEGA, *_VELOCITY))


def _shares(path: Trajectory, dt_s: float) -> Array:
    """Return the derivatives of position and attitude over their readings, (k,)."""
    pairs = [(np.diff(path.position_m, axis=0) / dt_s, path.velocity_m_s)]
    for axes, reading in (("body", path.omega_body_rad_s), ("world", path.omega_world_rad_s)):
        if reading is not None:
            pairs.append((turning(path, axes, dt_s), reading))
    means = [(rate, 0.5 * (reading[:-1] + reading[1:])) for rate, reading in pairs]
    return np.array([np.sum(rate * mean) / np.sum(mean * mean) for rate, mean in means])


_FACTORS = {
    1e3: "1000 times too large, as g for kg, mm for m or ms for s",
    1e-3: "1000 times too small, as kg for g, m for mm or s for ms",
    180.0 / np.pi: "in degrees instead of radians",
    -1.0: "of the opposite sign",
}
_FACTOR_TOLERANCE = 1e-6  # relative; far from any other factor, and wide enough for float32


def read_back_mistake(scene: Scene, dt_s: float | None, found: ReadBack) -> str:
    """Return what is wrong with a model that was read back, in words; "" if it is no known mistake."""
    initial, state = scene.initial, found.state
    pairs: dict[str, tuple[Array | float | None, Array | float | None]] = {
        "mass": (scene.body.mass, found.mass),
        "inertia": (scene.body.inertia, found.inertia),
        "step": (dt_s, found.dt_s),
        "gravity": (scene.gravity, found.gravity),
        "position": (initial.position, state.position),
        "velocity": (initial.velocity, state.velocity),
        "omega_body": (initial.omega_body, state.omega_body),
        "omega_world": (initial.omega_world, state.omega_world),
    }
    for name, (given, value) in pairs.items():
        if given is None or value is None:
            continue
        for factor, text in _FACTORS.items():
            if _same(factor * np.asarray(given), value):
                return f"{name} is {text}"
    return _misread(scene, found)


def _misread(scene: Scene, found: ReadBack) -> str:
    """Return which fault of the catalogue makes what was read back of the right quantity; "" if none does."""
    initial, state, inertia = scene.initial, found.state, scene.body.inertia
    pairs = [*_read_wrongly(initial, state), *_changed(scene, found)]
    turn = initial.rotation
    pairs.append(("the inertia is in world axes", inertia, turn @ inertia @ turn.T, found.inertia))
    if scene.link is not None:
        origin = initial.position + turn @ scene.link.offset
        text = "the position is that of the link's origin"
        pairs.append((text, initial.position, origin, state.position))
    for text, right, wrong, value in pairs:
        if value is not None and _same(wrong, value) and not _same(right, wrong):
            return text
    return ""


_Change: TypeAlias = tuple[str, Array, Array, Array | None]
"""A fault in words, the right value, what the fault makes of it, and the value that was read back."""


def _read_wrongly(initial: State, state: Reading) -> Iterator[_Change]:
    """Yield what each wrong reading makes of the initial state."""
    parts = (initial.position, initial.velocity, initial.quaternion)
    x, v, q = (part[:, None] for part in parts)
    omegas = (False, initial.omega_body, state.omega_body), (True, initial.omega_world, state.omega_world)
    for one in wrong_readings():
        for world, omega, value in omegas:
            read = one.apply(ReportedStates(x, v, q, omega[:, None]), world_omega=world)
            if one.quantity == "w":
                text = one.text.replace("omega", "omega_world" if world else "omega_body", 1)
                yield text, omega, read.w[:, 0], value
        if one.quantity == "q":
            yield one.text, initial.quaternion, read.q[:, 0], state.quaternion
            text = one.text.replace("quaternion", "rotation matrix")
            yield text, initial.rotation, quaternion_to_matrix(read.q[:, 0]), state.rotation
        elif one.quantity == "v":
            yield one.text, initial.velocity, read.v[:, 0], state.velocity
        elif one.quantity == "x":
            yield one.text, initial.position, read.x[:, 0], state.position


def _changed(scene: Scene, found: ReadBack) -> Iterator[_Change]:
    """Yield what each fault of the body or of gravity makes of its tensor, or of gravity."""
    for fault in FAULTS:
        if not isinstance(fault.plant, Changed) or fault.plant.name not in ("inertia", "gravity"):
            continue
        of_body = fault.plant.name == "inertia"
        right, value = (scene.body.inertia, found.inertia) if of_body else (scene.gravity, found.gravity)
        for values, text in fault.particular:
            yield text, right, np.asarray(fault.plant.change(right, values), dtype=np.float64), value


def _same(wrong: Array, value: Array | float) -> bool:
    value = np.asarray(value)
    slack = _FACTOR_TOLERANCE * float(np.max(np.abs(wrong)))
    return bool(slack > 0.0 and value.shape == wrong.shape and np.all(np.abs(value - wrong) <= slack))
