"""The mistake of an adapter that explains wrong readings of a free motion.

Each mistake has the correction that undoes it. A mistake explains the readings if they are consistent once
it is undone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bodycheck.adapters.contract import ReadBack
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import conjugate
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.probes.finding import Finding, Sampled, limit
from bodycheck.reports.probes.readings import reading_findings, turning


@dataclass(frozen=True)
class Mistake:
    """A wrong reading in words, the correction that undoes it, and the checks that it fails."""

    text: str
    undone: Callable[[Trajectory, Scene], Trajectory]
    checks: tuple[str, ...]


_OMEGA = ("omega_body_reading", "omega_world_reading")
_VELOCITY = ("velocity_reading",)
_SAME_SHARE = 1e-2  # relative; float32 leaves 2e-3 of the positions of a probe


def reading_mistake(
    motions: Sequence[Sampled], resolution: float, findings: Sequence[Finding]
) -> Mistake | None:
    """Return the mistake that explains the inconsistent findings of `reading_findings`, if one does."""
    wrong = {finding.check for finding in findings if finding.verdict == "inconsistent"}
    for mistake in _mistakes(motions[-1].trajectory):
        concerned = wrong.intersection(mistake.checks)
        if concerned and _explains(mistake, motions, resolution, concerned):
            return mistake
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
        corrected.append(replace(motion, trajectory=mistake.undone(later, motion.scene)))
    found = {finding.check: finding for finding in reading_findings(corrected, resolution)}
    return all(found[check].verdict == "consistent" for check in checks)


def part_of(path: Trajectory, samples: slice) -> Trajectory:
    """Return these samples of a trajectory."""
    arrays = {name: getattr(path, name) for name in path.__dataclass_fields__}
    cut: dict[str, Any] = {name: value[samples] for name, value in arrays.items() if value is not None}
    return Trajectory(**cut)


def _mistakes(path: Trajectory) -> Iterator[Mistake]:
    """Yield the mistakes that readings with these quantities may have, the simplest first."""
    if path.quaternion is not None:
        yield Mistake(
            "the quaternion is world to body: the conjugate of the body's attitude",
            lambda p, _: replace(p, quaternion=conjugate(_required(p.quaternion))),
            (*_OMEGA, "rotation_reading"),
        )
        yield Mistake(
            "the quaternion is scalar last, (x, y, z, w) instead of (w, x, y, z)",
            lambda p, _: replace(p, quaternion=np.roll(_required(p.quaternion), 1, axis=-1)),
            (*_OMEGA, "rotation_reading"),
        )
    if path.rotation is not None:
        yield Mistake(
            "the rotation matrix is world to body: the transpose of the body's attitude",
            lambda p, _: replace(p, rotation=np.swapaxes(_required(p.rotation), -1, -2)),
            (*_OMEGA, "rotation_reading"),
        )
    if path.omega_body_rad_s is not None:
        yield Mistake(
            "omega_body is in world axes: it equals R omega of the derivative of the attitude",
            lambda p, _: replace(p, omega_body_rad_s=_in_body_axes(p, _required(p.omega_body_rad_s))),
            _OMEGA[:1],
        )
    if path.omega_world_rad_s is not None:
        yield Mistake(
            "omega_world is in body axes: it equals R^T omega of the derivative of the attitude",
            lambda p, _: replace(p, omega_world_rad_s=_in_world_axes(p, _required(p.omega_world_rad_s))),
            _OMEGA[1:],
        )
    for axes, check in zip(("body", "world"), _OMEGA, strict=True):
        name = f"omega_{axes}_rad_s"
        if getattr(path, name) is not None:
            yield _scaled(name, f"omega_{axes} has the opposite sign", -1.0, check)
            yield _scaled(name, f"omega_{axes} is in degrees per second, not rad/s", np.pi / 180.0, check)
            yield _scaled(name, f"omega_{axes} is in turns per second, not rad/s", 2.0 * np.pi, check)
    yield Mistake(
        "the velocity is in body axes: it equals R^T of the derivative of the position",
        lambda p, _: replace(p, velocity_m_s=_in_world_axes(p, p.velocity_m_s)),
        _VELOCITY,
    )
    yield _scaled("velocity_m_s", "the velocity has the opposite sign", -1.0, *_VELOCITY)
    yield _scaled("velocity_m_s", "the velocity is in mm/s or the position in km", 1e-3, *_VELOCITY)
    yield _scaled("velocity_m_s", "the position is in mm or the velocity in km/s", 1e3, *_VELOCITY)
    yield Mistake(
        "the position is that of the link's origin, not of the centre of mass",
        lambda p, scene: replace(p, position_m=p.position_m - _link_arm(p, scene)),
        _VELOCITY,
    )
    yield Mistake(
        "the velocity is that of the link's origin, not of the centre of mass",
        lambda p, scene: replace(
            p, velocity_m_s=p.velocity_m_s - np.cross(p.omega_world, _link_arm(p, scene))
        ),
        _VELOCITY,
    )


def _step_mistake(motions: Sequence[Sampled], wrong: set[str]) -> Mistake | None:
    """Return a step of another length than requested: omega and velocity are too large by the same factor."""
    shares = [_shares(motion.trajectory, motion.dt_s) for motion in motions]
    found = limit([motion.dt_s for motion in motions], [share[np.newaxis] for share in shares], 0.0).value[0]
    share = float(np.mean(found))
    if not {*_VELOCITY} < wrong or np.ptp(found) > _SAME_SHARE * abs(share):
        return None
    text = f"the engine's step is {share:.3g} times the requested one"
    return Mistake(text, lambda path, _: path, (*_OMEGA, *_VELOCITY))


def _shares(path: Trajectory, dt_s: float) -> Array:
    """Return the derivatives of position and attitude over their readings, (k,)."""
    pairs = [(np.diff(path.position_m, axis=0) / dt_s, path.velocity_m_s)]
    for axes, reading in (("body", path.omega_body_rad_s), ("world", path.omega_world_rad_s)):
        if reading is not None:
            pairs.append((turning(path, axes, dt_s), reading))
    means = [(rate, 0.5 * (reading[:-1] + reading[1:])) for rate, reading in pairs]
    return np.array([np.sum(rate * mean) / np.sum(mean * mean) for rate, mean in means])


def _scaled(name: str, text: str, factor: float, *checks: str) -> Mistake:
    def undone(path: Trajectory, scene: Scene) -> Trajectory:  # noqa: ARG001 - the signature of a correction
        changed: dict[str, Any] = {name: factor * getattr(path, name)}
        return replace(path, **changed)

    return Mistake(text, undone, checks)


def _required(values: Array | None) -> Array:
    assert values is not None
    return values


def _in_body_axes(path: Trajectory, vectors: Array) -> Array:
    return np.einsum("nji,nj->ni", path.rotation_matrices, vectors)


def _in_world_axes(path: Trajectory, vectors: Array) -> Array:
    return np.einsum("nij,nj->ni", path.rotation_matrices, vectors)


def _link_arm(path: Trajectory, scene: Scene) -> Array:
    """R offset (n, 3): the link's origin from the centre of mass, world axes, m; 0 without a link."""
    return (
        np.zeros_like(path.position_m) if scene.link is None else path.rotation_matrices @ scene.link.offset
    )


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
    """Return which other quantity of the scene stands in place of the right one."""
    initial, state, inertia = scene.initial, found.state, scene.body.inertia
    turn = initial.rotation
    mistakes: list[tuple[str, Array, Array | None]] = [
        ("the quaternion is world to body", conjugate(initial.quaternion), state.quaternion),
        ("the quaternion is scalar last, (x, y, z, w)", np.roll(initial.quaternion, -1), state.quaternion),
        ("the rotation matrix is world to body", turn.T, state.rotation),
        ("omega_body is in world axes", initial.omega_world, state.omega_body),
        ("omega_world is in body axes", initial.omega_body, state.omega_world),
        ("the velocity is in body axes", turn.T @ initial.velocity, state.velocity),
        ("the inertia is in world axes", turn @ inertia @ turn.T, found.inertia),
        ("the off-diagonals of the inertia are products of inertia: their sign is reversed",
         2.0 * np.diag(np.diag(inertia)) - inertia, found.inertia),
        ("the off-diagonals of the inertia are lost", np.diag(np.diag(inertia)), found.inertia),
        ("the inertia is its inverse", np.asarray(np.linalg.inv(inertia), dtype=np.float64), found.inertia),
    ]  # fmt: skip
    if scene.link is not None:
        origin = initial.position + turn @ scene.link.offset
        mistakes.append(("the position is that of the link's origin", origin, state.position))
    for text, wrong, value in mistakes:
        if value is not None and _same(wrong, value):
            return text
    return ""


def _same(wrong: Array, value: Array | float) -> bool:
    value = np.asarray(value)
    slack = _FACTOR_TOLERANCE * float(np.max(np.abs(wrong)))
    return bool(slack > 0.0 and value.shape == wrong.shape and np.all(np.abs(value - wrong) <= slack))
