"""The response to loads: the momentum gained while a load acts, compared with its impulse.

dP = integral of F dt, dL = integral of tau dt, with P = m v and L = R I omega from the engine's own readings.
A difference is due to the load's size, axes or point, the effective mass or inertia, or the readings. In a
window of n steps under a constant load, any consistent method gives n h F. One that responds k steps late
gives (n - k) h F, and one that releases the load k steps late gives k h F after the window.

The mistakes that are tried have impulses in closed form, whatever the map of an engine is. The faults of the
diagnosis change the steps of a known map, which an engine behind a new adapter need not make.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bodycheck.examine.probes.finding import Finding, FindingLimit, Sampled, delay_finding, limit, noise
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, linear_momentum
from bodycheck.reference_impl.scene import Axes, ConstantLoad, PointForce, Scene, Torque

_MIN_SIZE = 1e-3  # of the impulse; a mistake that gives less is not distinguished from no response
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
    and the next load; empty for gravity, which does not end. round_off: of the gained momentum. mistaken: the
    impulses that frequent mistakes of an adapter would give, by their descriptions.
    """

    name: str
    gained: tuple[Array, ...]
    impulse: tuple[Array, ...]
    steps: tuple[int, ...]
    round_off: float
    push: Array | None = None
    carried: tuple[Array, ...] = ()
    mistaken: Mapping[str, tuple[Array, ...]] = field(default_factory=dict)

    @property
    def size(self) -> float:
        """The magnitude of the impulse."""
        return _norm(self.impulse[-1])

    @property
    def excess(self) -> list[Array]:
        """(gained - impulse) / size for each step, (1, 3)."""
        pairs = zip(self.gained, self.impulse, strict=True)
        return [(gained - impulse)[np.newaxis] / self.size for gained, impulse in pairs]

    def limit(self, steps_s: Sequence[float]) -> FindingLimit:
        """Return the excess in the limit h -> 0."""
        return limit(steps_s, self.excess, self.round_off / self.size)

    def mistake(self, steps_s: Sequence[float], *, without_effect: bool) -> str:
        """Return the description of the mistake that explains the gained momentum; "" if none does."""
        if without_effect:
            load = self.name.replace("_", " ")
            force = load.removesuffix(" moment")
            at_centre = f"the {force} acts at the centre of mass, not at its point"
            return f"the {load} has no effect" if load == force else at_centre
        for mistake, impulse in self.mistaken.items():
            found = replace(self, impulse=impulse)
            if found.size > _MIN_SIZE * self.size and found.limit(steps_s).is_zero:
                return mistake
        return self._displacement(steps_s)

    def _displacement(self, steps_s: Sequence[float]) -> str:
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
    yield from _response(weight, steps_s)
    gravity = (
        weight.limit(steps_s).value[0] * weight.size / motions[0].scene.body.mass / _alone_until(motions)
    )
    momenta = [_Momenta.of(motion, motion.scene.gravity + gravity) for motion in motions]
    for window in _loads(motions, momenta, resolution):
        yield from _response(window, steps_s)
    yield _unloaded(motions, momenta, resolution)


def gravity_finding(motions: Sequence[Sampled], resolution: float) -> Finding:
    """Return the response to gravity over a motion without other loads."""
    return next(_response(_gravity(motions, resolution), [motion.dt_s for motion in motions]))


def _alone_until(motions: Sequence[Sampled]) -> float:
    """Return the time until which gravity is the only force; a torque adds no linear momentum."""
    scene = motions[0].scene
    forces = (load.from_s for load in scene.piecewise_constant_loads if isinstance(load, PointForce))
    return min(forces, default=scene.duration_s)


def _gravity(motions: Sequence[Sampled], resolution: float) -> _Window:
    scene, until = motions[0].scene, _alone_until(motions)
    momenta = [linear_momentum(scene.body.mass, motion.trajectory.velocity_m_s) for motion in motions]
    ends = [motion.index(until) for motion in motions]
    weight = scene.body.mass * scene.gravity
    turned = [
        motion.trajectory.rotation_matrices[: end + 1] @ weight
        for motion, end in zip(motions, ends, strict=True)
    ]
    in_body_axes = tuple(integral(rate, motion.dt_s) for rate, motion in zip(turned, motions, strict=True))
    return _Window(
        "gravity",
        tuple(momentum[end] - momentum[0] for momentum, end in zip(momenta, ends, strict=True)),
        (weight * until,) * len(motions),
        tuple(ends),
        _round_off(momenta, scene.body.mass, motions, resolution),
        mistaken={
            "gravity acts in body axes": in_body_axes,
            "gravity has the opposite sign": (-weight * until,) * len(motions),
        },
    )


def _loads(motions: Sequence[Sampled], momenta: Sequence[_Momenta], resolution: float) -> Iterator[_Window]:
    for load, pause_ends in zip(*_loads_and_ends(motions[0].scene), strict=True):
        name = f"{load.axes}_{'torque' if isinstance(load, Torque) else 'force'}"
        if isinstance(load, PointForce):
            yield _window(
                name, load, pause_ends, motions, [momentum.linear for momentum in momenta], 0, resolution
            )
            name = f"{name}_moment"
        yield _window(
            name, load, pause_ends, motions, [momentum.angular for momentum in momenta], 1, resolution
        )


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
    mistaken: dict[str, list[Array]] = {}
    for motion, values in zip(motions, series, strict=True):
        first, last, end = (motion.index(t) for t in (load.from_s, load.until_s, pause_ends_s))
        rotation = motion.trajectory.rotation_matrices[first : last + 1]
        gained.append(values[last] - values[first])
        impulse.append(integral(_rates(load, rotation)[part], motion.dt_s))
        for mistake, rate in _mistaken_rates(load, rotation, part):
            mistaken.setdefault(mistake, []).append(integral(rate, motion.dt_s))
        carried.append(values[end] - values[last])
        steps.append(last - first)
        if part and isinstance(load, PointForce):
            push = integral(_rates(load, rotation)[0], motion.dt_s)
    mass = 0.0 if part else motions[0].scene.body.mass
    round_off = _round_off(series, mass, motions, resolution)
    by_mistake = {mistake: tuple(impulses) for mistake, impulses in mistaken.items()}
    return _Window(
        name, tuple(gained), tuple(impulse), tuple(steps), round_off, push, tuple(carried), by_mistake
    )


def _mistaken_rates(load: ConstantLoad, rotation: Array, part: int) -> Iterator[tuple[str, Array]]:
    """Yield force or torque (n, 3) in world axes as frequent mistakes give it, with their descriptions."""
    right = _rates(load, rotation)
    other: Axes = "world" if load.axes == "body" else "body"
    swapped = _rates(replace(load, axes=other), rotation)
    if isinstance(load, Torque) or part == 0:
        kind = "torque" if part else "force"
        yield f"the {load.axes} {kind} acts in {other} axes", swapped[part]
        yield f"the {load.axes} {kind} has the opposite sign", -right[part]
        transposed = np.einsum("nji,j->ni", rotation, load.value)
        yield f"the {load.axes} {kind} is rotated by the transpose: it acts as R^T", transposed
        yield (
            f"the {load.axes} {kind} is rotated twice",
            np.einsum("nij,njk,k->ni", rotation, rotation, load.value),
        )
        return
    arm = np.broadcast_to(load.at, right[0].shape)
    yield f"the moment of the {load.axes} force is F x r instead of r x F", -right[1]
    yield f"the moment of the {load.axes} force has its arm in world axes", np.cross(arm, right[0])
    if load.axes == "body":
        in_body_axes = np.einsum("nji,nj->ni", rotation, right[1])
        yield "the moment of the body force acts in world axes", in_body_axes
    yield f"the {load.axes} force acts in {other} axes", swapped[1]


def _rates(load: ConstantLoad, rotation: Array) -> tuple[Array, Array]:
    """Return force and torque about the centre of mass, (n, 3), world axes, at attitudes (n, 3, 3)."""
    value = np.einsum("nij,j->ni", rotation, load.value) if load.axes == "body" else load.value
    value = np.broadcast_to(value, (len(rotation), 3))
    if isinstance(load, Torque):
        return np.zeros_like(value), value
    return value, np.cross(np.einsum("nij,j->ni", rotation, load.at), value)


def integral(rate: Array, dt_s: float) -> Array:
    """Integrate rates (n, 3) by the trapezoidal rule."""
    return dt_s * (np.sum(rate, axis=0) - 0.5 * (rate[0] + rate[-1]))


def _round_off(series: Sequence[Array], mass: float, motions: Sequence[Sampled], resolution: float) -> float:
    """Return the round-off of a momentum: the larger of the scatter of all steps and the resolution."""
    weight = mass * float(np.max(np.abs(motions[0].scene.gravity))) * motions[0].scene.duration_s
    size = weight + max(float(np.max(np.abs(values))) for values in series)
    return max(len(series[-1]) * noise(series[-1]), resolution * size)


def _response(window: _Window, steps_s: Sequence[float]) -> Iterator[Finding]:
    along = window.impulse[-1] / window.size
    found = window.limit(steps_s)
    measured = _nearly(1.0 + float(found.value[0] @ along), found.tolerance)
    text = _response_text(found, along)
    if text and (
        mistake := window.mistake(steps_s, without_effect=_norm(found.value[0] + along) < _MIN_SIZE)
    ):
        text = f"{mistake}: {text}"
    yield Finding(f"{window.name}_response", measured, 1.0, found.size, found.tolerance, text)
    check = f"{window.name}_delay"
    if measured < _SMALLEST_RESPONSE:
        yield Finding(check, message="no response from which to measure a delay")
        return
    starts = window.steps[-1] * (measured - 1.0 - float(window.excess[-1][0] @ along)) / measured
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
