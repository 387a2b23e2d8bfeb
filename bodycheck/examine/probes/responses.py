"""The response to loads: the momentum gained while a load acts, compared with its impulse.

dP = integral of F dt, dL = integral of tau dt, with P = m v and L = R I omega from the engine's own readings.
A difference is due to the load's size, axes or point, the effective mass or inertia, or the readings. In a
window of n steps under a constant load, any consistent method gives n h F. One that responds k steps late
gives (n - k) h F, and one that releases the load k steps late gives k h F after the window.

A wrong response is explained by a fault of the catalogue that gives all the momenta that were gained.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.examine.probes.finding import Finding, FindingLimit, Sampled, delay_finding, limit, noise
from bodycheck.examine.probes.load_mistakes import mistaken_impulses
from bodycheck.examine.probes.reading_mistakes import part_of
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, linear_momentum
from bodycheck.reference_impl.scene import ConstantLoad, PointForce, Scene, Torque

_MIN_ALONG = 1e-2  # of an excess moment; a moment with such a part along the force is that of no arm
_SMALLEST_RESPONSE = 0.1  # a smaller response is too small to measure a delay


@dataclass(frozen=True, eq=False)
class _Momenta:
    """P without the contribution of gravity (n, 3), and L (n, 3) about the centre of mass, in world axes."""

    linear: Array
    angular: Array

    @classmethod
    def of(cls, motion: Sampled, gravity: Array) -> _Momenta:
        """Return the momenta; gravity (3,): as measured, so that its error does not count for other loads."""
        body, path = motion.scene.body, motion.trajectory
        weight = body.mass * np.outer(path.t_s, gravity)
        return cls(
            linear_momentum(body.mass, path.velocity_m_s) - weight,
            angular_momentum(path.rotation_matrices, body.inertia, path.omega_body),
        )


@dataclass(frozen=True, eq=False)
class _Window:
    """The part of the motion under one load: the gained momentum and the load's impulse, for each step.

    gained, impulse: (3,) for each of the steps. push: the impulse of the force (3,) at the finest step, where
    this is the angular momentum of a force. carried: (3,) for each step, gained between the end of the load
    and the next load; empty for gravity, which does not end. round_off: of the gained momentum. part: 0 of
    linear, 1 of angular momentum.
    """

    name: str
    part: int
    gained: tuple[Array, ...]
    impulse: tuple[Array, ...]
    steps: tuple[int, ...]
    round_off: float
    push: Array | None = None
    carried: tuple[Array, ...] = ()

    @property
    def size(self) -> float:
        """The magnitude of the impulse."""
        return _norm(self.impulse[-1])

    def excess(self, impulse: Sequence[Array]) -> list[Array]:
        """(gained - impulse) / size for each step, (1, 3)."""
        pairs = zip(self.gained, impulse, strict=True)
        return [(gained - other)[np.newaxis] / self.size for gained, other in pairs]

    def limit(self, steps_s: Sequence[float], impulse: Sequence[Array] = ()) -> FindingLimit:
        """Return the excess over this impulse, by default the right one, in the limit h -> 0."""
        return limit(steps_s, self.excess(impulse or self.impulse), self.round_off / self.size)

    def displacement(self, steps_s: Sequence[float]) -> str:
        """Return how far from its point a force acts that explains the excess moment d x F; "" if none does.

        An excess along the moment itself would also be that of a scaled force.
        """
        if self.push is None:
            return ""
        excess = self.limit(steps_s).value[0] * self.size
        along = abs(float(excess @ self.push)) / _norm(self.push)
        scaled = abs(float(excess @ self.impulse[-1])) / self.size
        if along > _MIN_ALONG * _norm(excess) or scaled > (1.0 - _MIN_ALONG) * _norm(excess):
            return ""
        distance = _norm(excess) / _norm(self.push)
        return (
            f"the {self.name.replace('_moment', '').replace('_', ' ')} acts {distance:.3g} m from its point"
        )

    def kept_at_first_order(self, steps_s: Sequence[float], along: Array) -> float:
        """Return the share of the impulse gained after the load has ended, less its limit for h -> 0."""
        if not self.carried:
            return 0.0
        carried = [gained[np.newaxis] / self.size for gained in self.carried]
        found = limit(steps_s, carried, self.round_off / self.size)
        return float((carried[-1] - found.value)[0] @ along)


def response_findings(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    """Yield the response to gravity and to each timed load, each delay, and the response without loads.

    motions: of one scene from rest, coarsest step first. resolution: relative, of the states after all steps.
    """
    steps_s = [motion.dt_s for motion in motions]
    weight = _gravity(motions, resolution)
    yield from _gravity_responses(weight, motions)
    gravity = (
        weight.limit(steps_s).value[0] * weight.size / motions[0].scene.body.mass / _alone_until(motions)
    )
    momenta = [_Momenta.of(motion, motion.scene.gravity + gravity) for motion in motions]
    for load, pause_ends in zip(*_loads_and_ends(motions[0].scene), strict=True):
        windows = list(_windows(load, pause_ends, motions, momenta, resolution))
        alone = replace(motions[0].scene, loads=(load,), gravity=np.zeros(3))
        yield from _responses(windows, motions, (load.from_s, load.until_s), alone)
    yield _unloaded(motions, momenta, resolution)


def gravity_finding(motions: Sequence[Sampled], resolution: float) -> Finding:
    """Return the response to gravity over a motion without other loads."""
    return next(_gravity_responses(_gravity(motions, resolution), motions))


def _gravity_responses(weight: _Window, motions: Sequence[Sampled]) -> Iterator[Finding]:
    span, alone = (0.0, _alone_until(motions)), replace(motions[0].scene, loads=())
    yield from _responses([weight], motions, span, alone)


def _alone_until(motions: Sequence[Sampled]) -> float:
    """Return the time until which gravity is the only force; a torque adds no linear momentum."""
    scene = motions[0].scene
    forces = (load.from_s for load in scene.piecewise_constant_loads if isinstance(load, PointForce))
    return min(forces, default=scene.duration_s)


def _gravity(motions: Sequence[Sampled], resolution: float) -> _Window:
    scene, until = motions[0].scene, _alone_until(motions)
    momenta = [linear_momentum(scene.body.mass, motion.trajectory.velocity_m_s) for motion in motions]
    ends = [motion.index(until) for motion in motions]
    return _Window(
        "gravity",
        0,
        tuple(momentum[end] - momentum[0] for momentum, end in zip(momenta, ends, strict=True)),
        (scene.body.mass * scene.gravity * until,) * len(motions),
        tuple(ends),
        _round_off(momenta, scene.body.mass, motions, resolution),
    )


def _windows(
    load: ConstantLoad,
    pause_ends_s: float,
    motions: Sequence[Sampled],
    momenta: Sequence[_Momenta],
    resolution: float,
) -> Iterator[_Window]:
    """Yield the effect of a load on the linear momentum, if it is a force, and on the angular momentum."""
    linear = [momentum.linear for momentum in momenta]
    angular = [momentum.angular for momentum in momenta]
    name = f"{load.axes}_{'torque' if isinstance(load, Torque) else 'force'}"
    if isinstance(load, PointForce):
        yield _window(name, load, pause_ends_s, motions, linear, 0, resolution)
        name = f"{name}_moment"
    yield _window(name, load, pause_ends_s, motions, angular, 1, resolution)


def _loads_and_ends(scene: Scene) -> tuple[list[ConstantLoad], list[float]]:
    """Return the timed loads by start, and for each the start of the next one or the end of the scene."""
    loads = sorted(scene.piecewise_constant_loads, key=lambda load: load.from_s)
    return loads, [*(load.from_s for load in loads[1:]), scene.duration_s]


def _window(
    name: str,
    load: ConstantLoad,
    pause_ends_s: float,
    motions: Sequence[Sampled],
    series: Sequence[Array],
    part: int,
    resolution: float,
) -> _Window:
    """Return the effect of a load on one of the momenta, series; part: 0 for force, 1 for torque."""
    gained, impulse, carried, steps, push = [], [], [], [], None
    for motion, values in zip(motions, series, strict=True):
        first, last, end = (motion.index(t) for t in (load.from_s, load.until_s, pause_ends_s))
        rotation = motion.trajectory.rotation_matrices[first : last + 1]
        gained.append(values[last] - values[first])
        rates = np.array(_rates(load, rotation))
        force, torque = np.asarray(np.trapezoid(rates, dx=motion.dt_s, axis=1))
        impulse.append(torque if part else force)
        carried.append(values[end] - values[last])
        steps.append(last - first)
        if part and isinstance(load, PointForce):
            push = force
    mass = 0.0 if part else motions[0].scene.body.mass
    round_off = _round_off(series, mass, motions, resolution)
    return _Window(name, part, tuple(gained), tuple(impulse), tuple(steps), round_off, push, tuple(carried))


def _rates(load: ConstantLoad, rotation: Array) -> tuple[Array, Array]:
    """Return force and torque about the centre of mass, (n, 3), world axes, at attitudes (n, 3, 3)."""
    value = np.einsum("nij,j->ni", rotation, load.value) if load.axes == "body" else load.value
    value = np.broadcast_to(value, (len(rotation), 3))
    if isinstance(load, Torque):
        return np.zeros_like(value), value
    return value, np.cross(np.einsum("nij,j->ni", rotation, load.at), value)


def _round_off(series: Sequence[Array], mass: float, motions: Sequence[Sampled], resolution: float) -> float:
    """Return the round-off of a momentum: the larger of the scatter of all steps and the resolution."""
    weight = mass * float(np.max(np.abs(motions[0].scene.gravity))) * motions[0].scene.duration_s
    size = weight + max(float(np.max(np.abs(values))) for values in series)
    return max(len(series[-1]) * noise(series[-1]), resolution * size)


def _responses(
    windows: Sequence[_Window], motions: Sequence[Sampled], span_s: tuple[float, float], alone: Scene
) -> Iterator[Finding]:
    """Yield the response and the delay in each window of one load or of gravity, which acts alone in a scene.

    span_s: the time of the windows.
    """
    steps_s = [motion.dt_s for motion in motions]
    mistakes = ""
    if not all(window.limit(steps_s).is_zero for window in windows):
        first, last = span_s
        spans = [slice(motion.index(first), motion.index(last) + 1) for motion in motions]
        paths = [part_of(motion.trajectory, span) for motion, span in zip(motions, spans, strict=True)]
        mistakes = ", or ".join(
            text
            for text, impulses in mistaken_impulses(alone, paths).items()
            if all(
                window.limit(steps_s, [both[window.part] for both in impulses]).is_zero for window in windows
            )
        )
    for window in windows:
        yield from _response(window, steps_s, mistakes)


def _response(window: _Window, steps_s: Sequence[float], mistakes: str) -> Iterator[Finding]:
    along = window.impulse[-1] / window.size
    found = window.limit(steps_s)
    measured = _nearly(1.0 + float(found.value[0] @ along), found.tolerance)
    text = _response_text(found, along)
    if text and (mistake := mistakes or window.displacement(steps_s)):
        text = f"{mistake}: {text}"
    yield Finding(f"{window.name}_response", measured, 1.0, found.size, found.tolerance, text)
    check = f"{window.name}_delay"
    if measured < _SMALLEST_RESPONSE:
        yield Finding(check, message="no response from which to measure a delay")
        return
    starts = (
        window.steps[-1] * (measured - 1.0 - float(window.excess(window.impulse)[-1][0] @ along)) / measured
    )
    ends = window.steps[-1] * window.kept_at_first_order(steps_s, along) / measured
    late = "the response ends" if abs(ends) > abs(starts) else "the response begins"
    yield delay_finding(check, max(starts, ends, key=abs), late)


def _response_text(found: FindingLimit, along: Array) -> str:
    if found.is_zero:
        return ""
    lengthwise = float(found.value[0] @ along)
    across = float(np.linalg.norm(found.value[0] - lengthwise * along))
    gained = _nearly(1.0 + lengthwise, found.tolerance)
    text = f"the momentum gained is {gained:.6g} times the impulse"
    return (
        f"{text}, plus {across:.3g} times its size perpendicular to it" if across > found.tolerance else text
    )


def _nearly(value: float, tolerance: float) -> float:
    """Return the value, or 0 where it is within the tolerance."""
    return value if abs(value) > tolerance else 0.0


def _unloaded(motions: Sequence[Sampled], momenta: Sequence[_Momenta], resolution: float) -> Finding:
    """Return the momenta gained in the pauses between loads, which should be zero.

    They are relative to the impulse of the weight in the shortest pause, and to the largest angular impulse.
    """
    scene = motions[0].scene
    loads, ends = _loads_and_ends(scene)
    pauses = [(load.until_s, end) for load, end in zip(loads, ends, strict=True)]
    weight = scene.body.mass * _norm(scene.gravity) * min(end - start for start, end in pauses)
    moment = max(_moment(load) for load in loads)
    gains = []
    for motion, momentum in zip(motions, momenta, strict=True):
        spans = [(motion.index(start), motion.index(end)) for start, end in pauses]
        moving = [(momentum.linear[last] - momentum.linear[first]) / weight for first, last in spans]
        spinning = [(momentum.angular[last] - momentum.angular[first]) / moment for first, last in spans]
        gains.append(np.array([*moving, *spinning]))
    round_off = max(
        _round_off([momentum.linear for momentum in momenta], scene.body.mass, motions, resolution) / weight,
        _round_off([momentum.angular for momentum in momenta], 0.0, motions, resolution) / moment,
    )
    found = limit([motion.dt_s for motion in motions], gains, round_off)
    return found.finding("unloaded_response", "momentum changes while only gravity acts")


def _moment(load: ConstantLoad) -> float:
    """Return the magnitude of the angular impulse of a load, in N m s."""
    torque = load.value if isinstance(load, Torque) else np.cross(load.at, load.value)
    return _norm(torque) * (load.until_s - load.from_s)


def _norm(vector: Array) -> float:
    return float(np.linalg.norm(vector))
