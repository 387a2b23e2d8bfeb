"""Identify the one-step map of a method by comparing its steps with every known map.

A scene that is sampled after every step gives as many one-step maps as it has steps, each from the state that
the engine itself holds. Every method starts from the same states, so that the library is evaluated there
once; only the nearest maps are compared over all steps and under each load.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck._util.platform_identity import numeric_parts
from bodycheck.adapters.contract import Engine, Method, Precision, read_back_mismatch
from bodycheck.adapters.execution import Case
from bodycheck.adapters.registry import own_code
from bodycheck.adapters.stable_step import invalid_state
from bodycheck.adapters.workers import protocol
from bodycheck.examine.probes.leading_error import LeadingError, leading_error
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.kinds.callback import CallbackLoad
from bodycheck.reference_impl.loads.load import ContinuousLoad, KeyForm
from bodycheck.reference_impl.one_step_maps import MAPS, OneStepMap, named_map, substepped
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Loads,
    Motion,
    Solid,
    held_acceleration,
    scene_loads,
    zero_order_hold,
)
from bodycheck.reference_impl.rotations import geodesic_angle, normalised
from bodycheck.reference_impl.scene import Load, PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.cache.disk_cache import Cache, key_of
from bodycheck.reports.measurement.case import RunCase, method_command
from bodycheck.reports.run_files.method_words import NO_KNOWN_MAP, NOT_MEASURED

Rows: TypeAlias = NDArray[np.intp]


FARTHER = 1000.0
"""The factor by which the second nearest map must be farther away than the nearest."""

_LIMITS: Mapping[Precision, float] = {"float64": 1e-9, "float32": 2e-5, "mixed": 2e-5}
"""The largest distance to a known map: a solver inside a step may stop at such a residual."""

_ROUND_OFFS = 1000.0
"""In eps: a larger distance to a known map is the residual of a solver."""

_ANGLES_RAD = (1.0, 0.5, 0.25, 0.125)
"""|omega| dt of the free cases; those under loads have the first and the third."""
_STEPS = 4
_FINALISTS = 8  # maps that are compared over all steps, and at least all within 1e4 times the nearest
_WIDE = 1e4
_LIMITED = ", step angle at most pi/4"
_ENGINES_MAPS = tuple(
    rule + update
    for rule in (
        *("M1", "M2", "M3", "no gyroscopic term"),
        *("rescaled momentum", "rescaled momentum, torque first"),
    )
    for update in (
        "",
        _LIMITED,
        ", additive quaternion",
        ", additive quaternion renormalised",
    )
)
"""The maps that are also tried with several steps per step."""
_MAX_SUBSTEPS = 8
_SPEED_LIMIT_RAD = math.pi / 4.0
_ONLY_SLOW = ", |omega| dt below pi/4"
_NAMED_TIES = 4
"""More maps than these that agree alike, as those of high order do in float32, are only counted."""
_STATE = ("t", "position", "velocity", "quaternion", "omega")
_TINY = float(np.finfo(np.float64).eps) / 2.0

_BODY = RigidBody(3.0, np.array([[0.8, 0.1, -0.15], [0.1, 1.0, 0.05], [-0.15, 0.05, 1.2]]))
_STARTS = (
    State(
        np.array([0.3, -0.2, 0.5]),
        normalised(np.array([0.5, -0.1, 0.7, 0.5])),
        np.array([0.4, -0.6, 0.3]),
        np.array([1.1, -1.6, 0.7]),
    ),
    State(
        np.array([-0.4, 0.1, 0.2]),
        normalised(np.array([-0.3, 0.8, 0.2, -0.4])),
        np.array([-0.5, 0.2, 0.7]),
        np.array([-0.25, 0.45, 0.95]),
    ),
)
_AT = np.array([0.2, -0.3, 0.1])

CONSTANT_LOADS: Mapping[str, tuple[Load, ...]] = {
    "body torque": (Torque("body", np.array([0.9, -0.7, 0.5])),),
    "world torque": (Torque("world", np.array([-0.6, 0.8, 0.7])),),
    "body force": (PointForce("body", np.array([2.5, 1.0, -2.0]), _AT),),
    "world force": (PointForce("world", np.array([-1.5, 2.0, 3.0]), -_AT),),
    "gravity": (),
}
"""The loads under which every run compares the maps, each alone."""


def _example(kind: type[ContinuousLoad]) -> ContinuousLoad:
    """Return a load of a kind, each constant different from the others."""
    examples: dict[KeyForm, Callable[[int], Any]] = {
        "number": lambda i: 0.4 + 0.3 * i,
        "positive": lambda i: 0.8 + 0.3 * i,
        "not negative": lambda i: 0.6 + 0.3 * i,
        "vector": lambda i: (1.0 + i) * np.roll([0.5, -0.3, 0.8], i),
        "damping matrix": lambda _: np.diag([0.3, 0.4, 0.5]),
        "axes": lambda _: "body",
    }
    return kind(**{name: examples[key.form](i) for i, (name, key) in enumerate(kind.keys().items())})


def continuous_loads() -> dict[str, tuple[Load, ...]]:
    """Return an example of each continuous load; an engine may have to compile kernels for it first."""
    return {
        name: (_example(kind),)
        for name, kind in load_kinds().items()
        if issubclass(kind, ContinuousLoad) and kind is not CallbackLoad
    }


@dataclass(frozen=True, eq=False)
class Steps:
    """The one-step maps of a method under one kind of loads: states before and after n steps of dt (n,)."""

    solid: Solid
    before: Motion
    after: Motion
    dt: Array
    loads: Loads

    @property
    def shows_matrices(self) -> bool:
        """Whether the engine gives matrices, so that the norm of a quaternion is not seen."""
        return self.after.rotation is not None

    def part(self, rows: slice | Rows) -> Steps:
        """Return some of the steps."""
        return replace(self, before=self.before.part(rows), after=self.after.part(rows), dt=self.dt[rows])


@dataclass(frozen=True)
class Match:
    """How near a map is: the largest distance over all steps, in rad and relative to |omega|.

    rule: how the map treats loads, of those that it evaluates more than once per step.
    """

    name: str
    distance: float
    rule: str = ""

    @property
    def text(self) -> str:
        """The name of the map with the treatment of loads."""
        return f"{self.name}, {self.rule}" if self.rule else self.name


@dataclass(frozen=True)
class Fingerprint:
    """The known map of a method, or the local order and the leading error term of an unknown one.

    name: of the map, of several that cannot be distinguished ("A or B"), NO_KNOWN_MAP or NOT_MEASURED.
    agreement and runner_up_distance: the largest angle in rad, or difference of omega over |omega|, over all
    steps. loads: the treatment of each load that differs from the map, and each that was not measured, in
    words.
    """

    name: str
    agreement: float | None = None
    runner_up: str = ""
    runner_up_distance: float | None = None
    description: str = ""
    position_update: str = ""
    loads: Mapping[str, str] = field(default_factory=dict)
    reversible: bool = False
    leading: LeadingError | None = None
    message: str = ""

    @property
    def residual(self) -> float:
        """The agreement with a known map where it is above round-off: a solver inside a step stops there."""
        if self.agreement is None or self.name in (NO_KNOWN_MAP, NOT_MEASURED):
            return 0.0
        return self.agreement if self.agreement > _ROUND_OFFS * float(np.finfo(np.float64).eps) else 0.0

    @property
    def digits(self) -> float | None:
        """-log10 of the agreement."""
        return None if self.agreement is None else -math.log10(max(self.agreement, _TINY))


def fingerprint_of(
    engine: Engine, method: Method, ask: RunCase, loads: Mapping[str, tuple[Load, ...]] = CONSTANT_LOADS
) -> Fingerprint:
    """Compare a method with every known map, free and under each of these loads."""
    free = _steps(engine, method, ask, _free_scenes())
    if isinstance(free, str):
        return Fingerprint(NOT_MEASURED, message=free)
    limit = _LIMITS[method.precision]
    with np.errstate(all="ignore"):  # a map far from the method may overflow
        nearest = nearest_maps(free)
        if nearest[0].distance > limit:
            nearest = _substepped(free, limit) or nearest
        if nearest[0].distance <= limit:
            return _under_loads(engine, method, ask, loads, nearest)
        rows = _slow(free)
        slow = _substepped(free.part(rows), limit) if len(rows) > len(free.dt) // 4 else []
        if slow:  # below the limit, a limited step is the same map
            slow = [one for one in slow if _LIMITED not in one.name]
            return _under_loads(engine, method, ask, loads, slow, only_slow=True)
        return _unknown(free, nearest)


def _slow(steps: Steps) -> Rows:
    """Return the rows whose |omega| dt is below the speed limit of game engines, pi/4 a step."""
    speed = np.maximum(*(np.linalg.norm(one.omega, axis=-1) for one in (steps.before, steps.after)))
    return np.flatnonzero(speed * steps.dt < 0.99 * _SPEED_LIMIT_RAD)


def _free_scenes() -> Iterator[tuple[Scene, float]]:
    for start in _STARTS:
        for angle in _ANGLES_RAD:
            yield _scene(start, (), np.zeros(3), angle)


def _loaded_scenes(name: str, loads: tuple[Load, ...]) -> Iterator[tuple[Scene, float]]:
    gravity = np.array([1.2, -2.3, -9.4]) if name == "gravity" else np.zeros(3)
    for start, angle in zip(_STARTS, (_ANGLES_RAD[0], _ANGLES_RAD[2]), strict=True):
        yield _scene(start, loads, gravity, angle)


def _scene(start: State, loads: tuple[Load, ...], gravity: Array, angle: float) -> tuple[Scene, float]:
    """Return a scene with a sample after every step, and its step in s."""
    # a power of two: the step and the times are exact
    dt_s = 2.0 ** round(math.log2(angle / float(np.linalg.norm(start.omega_body))))
    return Scene(_BODY, start, loads, gravity, _STEPS * dt_s, _STEPS + 1), dt_s


def _steps(
    engine: Engine, method: Method, ask: RunCase, scenes: Iterator[tuple[Scene, float]]
) -> Steps | str:
    """Run scenes with the same loads and return all their steps, or why one did not run."""
    parts: list[Steps] = []
    for scene, dt_s in scenes:
        setting = method.setting(dt_s)
        answer = ask(engine, Case(scene, method.name, setting))
        if answer.trajectory is None or answer.read_back is None:
            return f"{answer.outcome}: {answer.message}"
        if reason := read_back_mismatch(scene, setting.dt_s, answer.read_back, method.precision):
            return f"invalid: {reason}"
        if reason := invalid_state(answer.trajectory):
            return f"unstable: {reason}"
        parts.append(steps_along(scene, answer.trajectory))
    return _joined(parts)


def steps_along(scene: Scene, path: Trajectory) -> Steps:
    """Return the one-step maps of a trajectory with a sample after every step."""
    motion = Motion.of(path)
    dt = np.full(len(path.t_s) - 1, scene.sample_interval_s)
    return Steps(
        Solid.of(scene.body),
        motion.part(slice(None, -1)),
        motion.part(slice(1, None)),
        dt,
        scene_loads(scene),
    )


def _levels(free: Steps) -> Rows:
    """Return for each free step the place of its |omega| dt among those of its start."""
    return np.arange(len(free.dt)) // _STEPS % len(_ANGLES_RAD)


def _joined(parts: Sequence[Steps]) -> Steps:
    return replace(
        parts[0],
        before=_joined_motions([part.before for part in parts]),
        after=_joined_motions([part.after for part in parts]),
        dt=np.concatenate([part.dt for part in parts]),
    )


def _joined_motions(parts: Sequence[Motion], join: Callable[[list[Array]], Array] = np.concatenate) -> Motion:
    def column(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        return None if values[0] is None else join(values)

    return Motion(
        column("t"),
        column("position"),
        column("velocity"),
        column("quaternion"),
        column("omega"),
        column("rotation"),
    )


def distances(steps: Steps, predicted: Motion) -> Array:
    """Return the distance (n,) of the states after each step from predicted ones, inf if not finite.

    The largest of the angle, the difference of the norms of quaternions, and that of omega over |omega|. For
    an engine that gives matrices, the Frobenius norm of the difference over sqrt(2) is the angle.
    """
    found = steps.after
    size = np.maximum(np.linalg.norm(predicted.omega, axis=-1), np.linalg.norm(found.omega, axis=-1))
    spin = np.linalg.norm(found.omega - predicted.omega, axis=-1) / np.where(size > 0.0, size, 1.0)
    if found.rotation is not None:
        matrix = predicted.orthogonal if predicted.rotation is None else predicted.rotation
        turn = np.linalg.norm(found.rotation - matrix, axis=(-2, -1)) / math.sqrt(2.0)
    else:
        norms = (np.linalg.norm(q, axis=-1) for q in (found.quaternion, predicted.quaternion))
        turn = np.maximum(
            geodesic_angle(found.quaternion, predicted.quaternion), np.abs(next(norms) - next(norms))
        )
    difference = np.maximum(turn, spin)
    return np.where(np.isfinite(difference), difference, np.inf)


def _is_visible(one: OneStepMap, *, matrices: bool) -> bool:
    """Whether an engine that gives quaternions, or matrices, shows what sets this map apart."""
    return one.attitude != ("quaternion" if matrices else "matrix")


@dataclass(frozen=True, eq=False)
class _Images:
    """What k maps that hold the same kind of attitude make of n starts: states of shape (k, n, ...)."""

    names: tuple[str, ...]
    states: Motion

    @classmethod
    def read(cls, message: dict[str, Any]) -> _Images:
        """Return the images that a message holds."""
        arrays = {name: protocol.unpacked(value) for name, value in message.items() if name != "names"}
        if "rotation" in arrays:  # an array of a message has at most three dimensions
            arrays["rotation"] = arrays["rotation"].reshape(*arrays["t"].shape, 3, 3)
        return cls(tuple(message["names"]), Motion(**arrays))


@cache
def _images_of_starts() -> tuple[Steps, tuple[_Images, ...]]:
    """Return the first free steps from the given states, and what each map makes of them."""
    parts = []
    for scene, dt_s in _free_scenes():
        state = scene.initial
        start = Motion(
            np.zeros(1),
            state.position[np.newaxis],
            state.velocity[np.newaxis],
            state.quaternion[np.newaxis],
            state.omega_body[np.newaxis],
        )
        parts.append(Steps(Solid.of(scene.body), start, start, np.array([dt_s]), scene_loads(scene)))
    starts = _joined(parts)
    cache, key = Cache.default(), _key_of_images(starts)
    if (stored := cache.get(key)) is None:
        stored = {"kinds": _image_messages(starts)}
        cache.put(key, stored)
    return starts, tuple(_Images.read(message) for message in stored["kinds"])


def _key_of_images(starts: Steps) -> str:
    before = {name: protocol.packed(getattr(starts.before, name)) for name in _STATE}
    solid = [protocol.packed(starts.solid.mass), protocol.packed(starts.solid.inertia)]
    return key_of(
        maps=own_code(),
        names=list(MAPS),  # loaded before the hash of the files, which may have changed since
        evaluated_by=numeric_parts(),
        dt=protocol.packed(starts.dt),
        solid=solid,
        **before,
    )


def _image_messages(starts: Steps) -> list[dict[str, Any]]:
    """Return the images under all maps as messages for the cache, those without matrices first."""
    with np.errstate(all="ignore"):
        images = {
            name: one.step(starts.solid, starts.before, starts.dt, starts.loads) for name, one in MAPS.items()
        }
    messages = []
    for matrices in (False, True):
        kind = {name: one for name, one in images.items() if (one.rotation is not None) == matrices}
        joined = _joined_motions(list(kind.values()), np.stack)
        arrays = {name: getattr(joined, name) for name in (*_STATE, *["rotation"] * matrices)}
        flat = {name: a.reshape(*a.shape[:2], -1) if a.ndim > 3 else a for name, a in arrays.items()}
        messages.append({"names": list(kind)} | {name: protocol.packed(a) for name, a in flat.items()})
    return messages


def nearest_maps(steps: Steps) -> list[Match]:
    """Return the maps nearest to free steps, nearest first.

    The first step of each case decides which maps are compared over all steps.
    """
    starts, images = _images_of_starts()
    matrices = steps.shows_matrices
    first = steps.part(np.arange(0, len(steps.dt), _STEPS))
    assert len(first.dt) == len(starts.dt)
    screened = {
        name: float(distance)
        for kind in images
        for name, distance in zip(kind.names, np.max(distances(first, kind.states), axis=-1), strict=True)
        if _is_visible(MAPS[name], matrices=matrices)
    }
    order = sorted(screened, key=lambda name: screened[name])
    wide = _WIDE * max(screened[order[0]], _TINY)
    finalists = [name for index, name in enumerate(order) if index < _FINALISTS or screened[name] <= wide]
    return _compared(steps, finalists)


def _compared(steps: Steps, names: Sequence[str]) -> list[Match]:
    found = [Match(name, _largest_distance(steps, MAPS[name])) for name in names]
    return sorted(found, key=lambda match: match.distance)


def _largest_distance(steps: Steps, one: OneStepMap, parts: int = 1) -> float:
    """Return the largest distance of the steps from those of a map that is made several times per step.

    It is infinite where the map does not exist, as for the huge states of a method that diverges.
    """
    found = distances(steps, _many(one, steps, parts))
    return float(np.max(np.nan_to_num(found, nan=math.inf, posinf=math.inf)))


def _substepped(steps: Steps, limit: float) -> list[Match]:
    """Return the maps of engines by distance, each made once or more per step; none if none is near."""
    found = []
    for name in _ENGINES_MAPS:
        for parts in range(1, _MAX_SUBSTEPS + 1):
            distance = _largest_distance(steps, MAPS[name], parts)
            found.append(Match(substepped(name, parts), distance))
    found.sort(key=lambda match: match.distance)
    return found if found[0].distance <= limit else []


def _many(one: OneStepMap, steps: Steps, parts: int) -> Motion:
    motion = steps.before
    for _ in range(parts):
        motion = one.step(steps.solid, motion, steps.dt / parts, steps.loads)
    return motion


def _unknown(free: Steps, nearest: list[Match]) -> Fingerprint:
    """Return the local order and the leading error term of a map that the library lacks."""
    near = nearest[0]
    unknown = Fingerprint(NO_KNOWN_MAP, near.distance, near.text, near.distance)
    try:
        exact = MAPS["exact flow"].step(free.solid, free.before, free.dt, free.loads)
        leading = leading_error(free.solid, free.before, free.after, exact, free.dt, _levels(free))
    except np.linalg.LinAlgError:  # the states of a method that diverges may be too large
        return replace(unknown, message="the method diverges")
    message = f"{leading.text}; nearest: {near.text} at {near.distance:.2g}"
    return replace(unknown, leading=leading, message=message)


_RULES: Mapping[str, Callable[[Steps], Loads]] = {
    "": lambda steps: steps.loads,
    "zero-order hold of loads in world axes": lambda steps: zero_order_hold(
        steps.loads, steps.before, in_body_axes=False
    ),
    "zero-order hold of loads in body axes": lambda steps: zero_order_hold(
        steps.loads, steps.before, in_body_axes=True
    ),
    "zero-order hold of accelerations in world axes": lambda steps: held_acceleration(
        steps.solid, steps.loads, steps.before
    ),
}
"""The loads of a map that evaluates them at its stages, or is made several times per step."""


def _under_loads(
    engine: Engine,
    method: Method,
    ask: RunCase,
    loads: Mapping[str, tuple[Load, ...]],
    nearest: list[Match],
    *,
    only_slow: bool = False,
) -> Fingerprint:
    """Compare the maps that agree with free steps under each load, and name the one that agrees with all.

    only_slow: whether only steps below the speed limit are those of a map.
    """
    rivals = _within(nearest)
    best: dict[str, dict[str, Match]] = {one.name: {} for one in rivals}
    notes: dict[str, str] = {}
    position: Match | None = None
    for name, acting in loads.items():
        steps = _steps(engine, method, ask, _loaded_scenes(name, acting))
        if isinstance(steps, str):
            notes[name] = steps
            continue
        if only_slow:
            steps = steps.part(_slow(steps))
            if not len(steps.dt):
                notes[name] = "no slow step"
                continue
        for one in rivals:
            best[one.name][name] = min(_ruled(one.name, steps), key=lambda match: match.distance)
        if name == "gravity":
            position = _position_update(steps)
    worst = {
        one.name: max([one.distance, *(match.distance for match in best[one.name].values())])
        for one in rivals
    }
    limit = _LIMITS[method.precision]
    # one load with a treatment of its own does not make it another map
    agreeing = {
        one.name: max([one.distance, *(m.distance for m in best[one.name].values() if m.distance <= limit)])
        for one in rivals
    }
    failed = {one.name: sum(m.distance > limit for m in best[one.name].values()) for one in rivals}
    order = sorted(worst, key=lambda name: (failed[name], worst[name]))
    chosen = order[0]
    agreement = max(agreeing[chosen], _TINY)
    others = [Match(name, worst[name]) for name in order[1:]] + [one for one in nearest if one not in rivals]
    runner_up = min(others, key=lambda match: match.distance, default=Match("", math.inf))
    tied = [one.name for one in others if one.distance < FARTHER * agreement]
    rules = {name: match.rule for name, match in best[chosen].items() if match.distance <= limit}
    shared = {rule for name, rule in rules.items() if name != "gravity"}
    suffix = _ONLY_SLOW * only_slow + (f", {shared.pop()}" if len(shared) == 1 and shared != {""} else "")
    notes |= {name: rule or "as the map" for name, rule in rules.items() if len(shared) > 1}
    notes |= {
        name: f"unknown treatment, {match.distance:.2g} from the map"
        for name, match in best[chosen].items()
        if match.distance > limit
    }
    same = [chosen, *tied] if len(tied) <= _NAMED_TIES else [chosen, f"{len(tied)} others"]
    known = named_map(chosen)
    return Fingerprint(
        " or ".join(same) + suffix,
        agreement,
        runner_up.text,
        runner_up.distance,
        "" if known is None else known[0].description,
        "" if position is None else position.name,
        notes,
        known is not None and known[0].reversible,
        message="; ".join(f"{name}: {note}" for name, note in notes.items()),
    )


def _within(nearest: list[Match]) -> list[Match]:
    """Return the matches within 1000 times the distance of the nearest."""
    return [one for one in nearest if one.distance < FARTHER * max(nearest[0].distance, _TINY)]


def _ruled(name: str, steps: Steps) -> Iterator[Match]:
    """Yield how near a map is under each treatment of loads."""
    found = named_map(name)
    assert found is not None
    one, parts = found
    for rule, acting in _RULES.items():
        if not rule or one.stages or parts > 1:
            yield Match(name, _largest_distance(replace(steps, loads=acting(steps)), one, parts), rule)


_POSITIONS = {"new velocity": 1.0, "old velocity": 0.0, "mean velocity": 0.5}
"""The share of the new velocity in that which moves the position."""


def _position_update(steps: Steps) -> Match:
    """Return the velocity with which the position is updated under gravity, by which the rules differ."""
    before, after, h = steps.before, steps.after, steps.dt[:, None]
    size = np.linalg.norm(after.position - before.position, axis=-1)
    found = []
    for rule, share in _POSITIONS.items():
        moving = share * after.velocity + (1.0 - share) * before.velocity
        predicted = before.position + h * moving
        difference = np.linalg.norm(after.position - predicted, axis=-1) / np.where(size > 0.0, size, 1.0)
        found.append(Match(rule, float(np.max(difference))))
    best = min(found, key=lambda match: match.distance)
    return best if best.distance < 1e-4 else Match("another velocity", best.distance)


def fingerprint_row(engine: Engine, method: Method, found: Fingerprint) -> dict[str, Any]:
    """Return the row of fingerprints.csv of one method without run_id."""
    leading = found.leading
    return {
        "engine": engine.name,
        "engine_version": engine.version,
        "method": method.name,
        "fingerprint": found.name,
        "agreement": found.agreement,
        "digits": found.digits,
        "runner_up": found.runner_up,
        "runner_up_distance": found.runner_up_distance,
        "position_update": found.position_update,
        "local_order": None if leading is None or not math.isfinite(leading.order) else leading.order,
        "leading_error": "" if leading is None else leading.text,
        "description": found.description,
        "message": found.message,
        "reproduce": method_command(("fingerprint",), engine, method),
    }
