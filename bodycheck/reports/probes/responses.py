"""The response to loads: what each one adds to the momentum while it acts, against its impulse.

dP = integral of F dt, dL = integral of tau dt, with P = m v and L = R I omega of the engine's own readings:
what differs is a load's size, axes or point, the mass or inertia as they act, or the readings. In a window of
n steps, under a constant load, any consistent method gives n h F; one that responds k steps late gives
(n - k) h F, and one that lets go k steps late gives k h F after the window.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, linear_momentum
from bodycheck.reference_impl.scene import PointForce, Scene, Timed, Torque
from bodycheck.reports.probes.finding import Finding, Limit, Sampled, delay_finding, limit, noise

_SMALLEST_RESPONSE = 0.1  # below it there is too little of a response for a delay to be seen in it


@dataclass(frozen=True, eq=False)
class _Momenta:
    """P without what gravity adds (n, 3), and L (n, 3) about the centre of mass, world axes."""

    linear: Array
    angular: Array

    @classmethod
    def of(cls, motion: Sampled, gravity: Array) -> _Momenta:
        """gravity (3,): as it acts, so that what is wrong with it is not blamed on other loads."""
        body, path = motion.scene.body, motion.trajectory
        weight = body.mass * np.outer(path.t_s, gravity)
        return cls(
            linear_momentum(body.mass, path.velocity_m_s) - weight,
            angular_momentum(path.rotation_matrices, body.inertia, path.omega_body),
        )


@dataclass(frozen=True, eq=False)
class _Window:
    """One load's part of the motion: what it adds to a momentum, and what it should, at each step.

    gained, impulse: (3,) each, at each of the steps. kept: (3,) each, gained from the load's end to the next
    load; nothing for gravity, which has no end. round_off: of what is gained.
    """

    name: str
    gained: tuple[Array, ...]
    impulse: tuple[Array, ...]
    steps: tuple[int, ...]
    round_off: float
    kept: tuple[Array, ...] = ()

    @property
    def size(self) -> float:
        """The impulse."""
        return _norm(self.impulse[-1])

    @property
    def excess(self) -> list[Array]:
        """(gained - impulse) / size at each step, (1, 3)."""
        pairs = zip(self.gained, self.impulse, strict=True)
        return [(gained - impulse)[np.newaxis] / self.size for gained, impulse in pairs]

    def limit(self, steps_s: Sequence[float]) -> Limit:
        """Return the excess in the limit."""
        return limit(steps_s, self.excess, self.round_off / self.size)

    def kept_at_first_order(self, steps_s: Sequence[float], along: Array) -> float:
        """Return what of the impulse is gained after the load has ended, but not in the limit."""
        if not self.kept:
            return 0.0
        kept = [gained[np.newaxis] / self.size for gained in self.kept]
        found = limit(steps_s, kept, self.round_off / self.size)
        return float((kept[-1] - found.value)[0] @ along)


def response_findings(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    """Yield the response to gravity and to each timed load, its delay, and the response to none.

    motions: one scene from rest, coarsest step first. resolution: relative, of the states after all steps.
    """
    steps_s = [motion.dt_s for motion in motions]
    weight = _gravity(motions, resolution)
    yield from _response(weight, steps_s)
    gravity = (
        weight.limit(steps_s).value[0] * weight.size / motions[0].scene.body.mass / _alone_until(motions)
    )
    momenta = [_Momenta.of(motion, motion.scene.gravity + gravity) for motion in motions]
    for window in _loads(motions, momenta, resolution):
        yield from _response(window, steps_s)
    yield _unloaded(motions, momenta, resolution)


def gravity_finding(motions: Sequence[Sampled], resolution: float) -> Finding:
    """Return the response to gravity over a whole motion that nothing else acts in."""
    return next(_response(_gravity(motions, resolution), [motion.dt_s for motion in motions]))


def _alone_until(motions: Sequence[Sampled]) -> float:
    """Until when gravity is the only force: a torque adds nothing to the linear momentum."""
    scene = motions[0].scene
    forces = (load.from_s for load in scene.piecewise_constant_loads if isinstance(load, PointForce))
    return min(forces, default=scene.duration_s)


def _gravity(motions: Sequence[Sampled], resolution: float) -> _Window:
    scene, until = motions[0].scene, _alone_until(motions)
    momenta = [linear_momentum(scene.body.mass, motion.trajectory.velocity_m_s) for motion in motions]
    ends = [motion.index(until) for motion in motions]
    return _Window(
        "gravity",
        tuple(momentum[end] - momentum[0] for momentum, end in zip(momenta, ends, strict=True)),
        (scene.body.mass * scene.gravity * until,) * len(motions),
        tuple(ends),
        _round_off(momenta, scene.body.mass, motions, resolution),
    )


def _loads(motions: Sequence[Sampled], momenta: Sequence[_Momenta], resolution: float) -> Iterator[_Window]:
    for load, pause_ends in zip(*_loads_and_ends(motions[0].scene), strict=True):
        name = f"{load.axes}_{'torque' if isinstance(load, Torque) else 'force'}"
        if isinstance(load, PointForce):
            yield _window(name, load, pause_ends, motions, [held.linear for held in momenta], 0, resolution)
            name = f"{name}_moment"
        yield _window(name, load, pause_ends, motions, [held.angular for held in momenta], 1, resolution)


def _loads_and_ends(scene: Scene) -> tuple[list[Timed], list[float]]:
    """Return the timed loads by their start, and until when nothing else acts after each."""
    loads = sorted(scene.piecewise_constant_loads, key=lambda load: load.from_s)
    return loads, [*(load.from_s for load in loads[1:]), scene.duration_s]


def _window(
    name: str,
    load: Timed,
    pause_ends_s: float,
    motions: Sequence[Sampled],
    series: Sequence[Array],
    part: int,
    resolution: float,
) -> _Window:
    """Return what a load does to one of the momenta, series; part: of its rates, 0 force, 1 torque."""
    gained, impulse, kept, steps = [], [], [], []
    for motion, values in zip(motions, series, strict=True):
        first, last, end = (motion.index(t) for t in (load.from_s, load.until_s, pause_ends_s))
        rate = _rates(load, motion.trajectory.rotation_matrices[first : last + 1])[part]
        gained.append(values[last] - values[first])
        impulse.append(_integral(rate, motion.dt_s))
        kept.append(values[end] - values[last])
        steps.append(last - first)
    mass = 0.0 if part else motions[0].scene.body.mass
    round_off = _round_off(series, mass, motions, resolution)
    return _Window(name, tuple(gained), tuple(impulse), tuple(steps), round_off, tuple(kept))


def _rates(load: Timed, rotation: Array) -> tuple[Array, Array]:
    """Return force and torque about the centre of mass (n, 3) in world axes, at attitudes (n, 3, 3)."""
    value = np.einsum("nij,j->ni", rotation, load.value) if load.axes == "body" else load.value
    value = np.broadcast_to(value, (len(rotation), 3))
    if isinstance(load, Torque):
        return np.zeros_like(value), value
    return value, np.cross(np.einsum("nij,j->ni", rotation, load.at), value)


def _integral(rate: Array, dt_s: float) -> Array:
    """The trapezoidal rule over (n, 3)."""
    return dt_s * (np.sum(rate, axis=0) - 0.5 * (rate[0] + rate[-1]))


def _round_off(series: Sequence[Array], mass: float, motions: Sequence[Sampled], resolution: float) -> float:
    """Return what of a momentum is round-off: each step's scatter, or resolution, of all that is in it."""
    weight = mass * float(np.max(np.abs(motions[0].scene.gravity))) * motions[0].scene.duration_s
    size = weight + max(float(np.max(np.abs(values))) for values in series)
    return max(len(series[-1]) * noise(series[-1]), resolution * size)


def _response(window: _Window, steps_s: Sequence[float]) -> Iterator[Finding]:
    along = window.impulse[-1] / window.size
    found = window.limit(steps_s)
    measured = _nearly(1.0 + float(found.value[0] @ along), found.tolerance)
    yield Finding(
        f"{window.name}_response", measured, 1.0, found.size, found.tolerance, _response_text(found, along)
    )
    check = f"{window.name}_delay"
    if measured < _SMALLEST_RESPONSE:
        yield Finding(check, message="no response whose delay could be measured")
        return
    starts = window.steps[-1] * (measured - 1.0 - float(window.excess[-1][0] @ along)) / measured
    ends = window.steps[-1] * window.kept_at_first_order(steps_s, along) / measured
    late = "the response ends" if abs(ends) > abs(starts) else "the response begins"
    yield delay_finding(check, max(starts, ends, key=abs), late)


def _response_text(found: Limit, along: Array) -> str:
    if found.size <= found.tolerance:
        return ""
    lengthwise = float(found.value[0] @ along)
    across = float(np.linalg.norm(found.value[0] - lengthwise * along))
    gained = _nearly(1.0 + lengthwise, found.tolerance)
    text = f"the momentum gained is {gained:.6g} of the impulse"
    return f"{text}, and {across:.3g} of it across its direction" if across > found.tolerance else text


def _nearly(value: float, tolerance: float) -> float:
    """Return the value, or 0 where it cannot be told from that."""
    return value if abs(value) > tolerance else 0.0


def _unloaded(motions: Sequence[Sampled], momenta: Sequence[_Momenta], resolution: float) -> Finding:
    """What is gained after each load has ended, over its weight's impulse and over the largest moment's."""
    scene = motions[0].scene
    loads, ends = _loads_and_ends(scene)
    pauses = [(load.until_s, end) for load, end in zip(loads, ends, strict=True)]
    weight = scene.body.mass * _norm(scene.gravity) * min(end - begin for begin, end in pauses)
    moment = max(_moment(load) for load in loads)
    gains = []
    for motion, held in zip(motions, momenta, strict=True):
        spans = [(motion.index(begin), motion.index(end)) for begin, end in pauses]
        moving = [(held.linear[last] - held.linear[first]) / weight for first, last in spans]
        spinning = [(held.angular[last] - held.angular[first]) / moment for first, last in spans]
        gains.append(np.array([*moving, *spinning]))
    round_off = max(
        _round_off([held.linear for held in momenta], scene.body.mass, motions, resolution) / weight,
        _round_off([held.angular for held in momenta], 0.0, motions, resolution) / moment,
    )
    found = limit([motion.dt_s for motion in motions], gains, round_off)
    message = "" if found.size <= found.tolerance else "momentum changes while nothing but gravity acts"
    return Finding("unloaded_response", found.size, 0.0, found.size, found.tolerance, message)


def _moment(load: Timed) -> float:
    """Return the size of the angular impulse of a load, N m s."""
    torque = load.value if isinstance(load, Torque) else np.cross(load.at, load.value)
    return _norm(torque) * (load.until_s - load.from_s)


def _norm(vector: Array) -> float:
    return float(np.linalg.norm(vector))
