"""Laws that a method must obey whatever its error: another description of a scene gives the same motion.

Each law gives a variant of a scene and the inverse transformation of its motion. A method
that obeys it gives the same motion to round-off; no truth is needed. A violation that falls with the step or
the tolerance like the error of the method is a property: a splitting depends on the order of the body's axes,
an absolute tolerance on the unit of time.

To add a law, add its name to LawName and the law to LAWS; laws.csv, the report, `bodycheck laws` and the
gates `law.<name>` are derived from them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Engine, Method
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import invalid_state
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.rotations import (
    conjugate,
    exp_quaternion,
    geodesic_angle,
    matrix_to_quaternion,
    normalised,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import Link, Load, PointForce, RigidBody, Scene, State, Torque
from bodycheck.reports.measurement.case import RunCase, method_command
from bodycheck.reports.run_files.method_words import REPLAY, LawName, LawVerdict

if TYPE_CHECKING:
    from bodycheck.reference_impl.one_step_maps.one_step_map import Motion

_EPS, _SINGLE_EPS = float(np.finfo(np.float64).eps), float(np.finfo(np.float32).eps)
_SAFETY = 50.0
_STEPS = 16
_STEP_RATIO, _TOLERANCE_RATIO = 4, 100.0
"""From one of the three steps, or two tolerances, whose violations are compared to the next."""
_MISSING_ORDER, _MORE_ORDERS = 0.5, 3.0
"""How much more slowly, and faster, than the error of the method a violation may fall."""
_TOLERANCE_ORDERS = (0.4, 2.0)
"""The least and the largest power of the tolerance with which a violation may fall."""
_FAR_BELOW = 0.1
"""Of a tolerance: round-off stays below it."""

Undo: TypeAlias = "Callable[[Motion], Motion]"


@dataclass(frozen=True, eq=False)
class Variant:
    """Another description of a scene, with its step in s, and the inverse transformation of its motion."""

    scene: Scene
    dt_s: float
    undo: Undo = lambda path: path


Variants: TypeAlias = Callable[[Scene, float], Sequence[Variant]]
"""A function that returns the variants of a scene and its step in s."""


def _must(method: Method, reversible: bool, scene: Scene) -> str:  # noqa: ARG001 - the signature of a property
    """Return "": every method must obey."""
    return ""


def _may_step_the_origin(method: Method, reversible: bool, scene: Scene) -> str:  # noqa: ARG001 - as above
    return "engines may step the link's origin, with an error of order 1"


@dataclass(frozen=True)
class Law:
    """One law. variants: of a scene and its step; () for the laws about how a case is run.

    compared: the quantities that the law is about. property_of: why it is only a
    property of a method in a scene, given whether its known map is reversible; "" where it must obey.
    """

    name: LawName
    variants: Variants | None = None
    compared: tuple[str, ...] = ("attitude", "omega", "position", "velocity")
    property_of: Callable[[Method, bool, Scene], str] = _must


# --------------------------------------------------------------------------------------------- the variants


def _mapped(
    scene: Scene,
    *,
    to_world: Callable[[Array], Array] = lambda v: v,
    to_body: Callable[[Array], Array] = lambda v: v,
    load: float = 1.0,
) -> tuple[Load, ...]:
    """Return the loads with vectors in world and in body axes mapped, and all values times a factor."""
    found: list[Load] = []
    for one in scene.piecewise_constant_loads:
        value = load * (to_body(one.value) if one.axes == "body" else to_world(one.value))
        moved = replace(one, value=value)
        found.append(replace(moved, at=to_body(moved.at)) if isinstance(moved, PointForce) else moved)
    return tuple(found)


_TURN = normalised(np.array([0.3, -0.7, 0.5, 0.4]))


def _rotated(scene: Scene, dt_s: float) -> Sequence[Variant]:
    turn, start = quaternion_to_matrix(_TURN), scene.initial
    initial = State(
        turn @ start.position,
        quaternion_product(_TURN, start.quaternion),
        turn @ start.velocity,
        start.omega_body,
    )
    loads = _mapped(scene, to_world=lambda v: turn @ v)

    def undo(path: Motion) -> Motion:
        return replace(
            path,
            position=path.position @ turn,
            velocity=path.velocity @ turn,
            quaternion=quaternion_product(conjugate(_TURN), path.quaternion),
        )

    return (Variant(replace(scene, initial=initial, loads=loads, gravity=turn @ scene.gravity), dt_s, undo),)


_CYCLE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def _permuted(scene: Scene, dt_s: float) -> Sequence[Variant]:
    return [_in_body_axes(scene, dt_s, axes) for axes in (_CYCLE, _SWAP)]


def _in_body_axes(scene: Scene, dt_s: float, axes: Array) -> Variant:
    """Return the scene in other body axes: b' = axes b."""
    start, q = scene.initial, matrix_to_quaternion(axes)
    initial = State(
        start.position,
        quaternion_product(start.quaternion, conjugate(q)),
        start.velocity,
        axes @ start.omega_body,
    )
    body = RigidBody(scene.body.mass, axes @ scene.body.inertia @ axes.T)
    loads = _mapped(scene, to_body=lambda v: axes @ v)

    def undo(path: Motion) -> Motion:
        return replace(path, quaternion=quaternion_product(path.quaternion, q), omega=path.omega @ axes)

    return Variant(replace(scene, body=body, initial=initial, loads=loads), dt_s, undo)


_OFFSET = np.array([0.2, -0.15, 0.1])


def _linked(scene: Scene, dt_s: float) -> Sequence[Variant]:
    axes = normalised(np.array([0.8, 0.2, -0.4, 0.4]))
    return (Variant(replace(scene, link=Link(_OFFSET, axes)), dt_s),)


def _boosted(scene: Scene, dt_s: float) -> Sequence[Variant]:
    boost = np.array([2.0, -1.0, 1.5])
    initial = replace(scene.initial, velocity=scene.initial.velocity + boost)

    def undo(path: Motion) -> Motion:
        moved = path.t[:, None] * boost
        return replace(path, position=path.position - moved, velocity=path.velocity - boost)

    return (Variant(replace(scene, initial=initial), dt_s, undo),)


def _shifted(scene: Scene, dt_s: float) -> Sequence[Variant]:
    shift = np.array([8.0, -16.0, 4.0])
    initial = replace(scene.initial, position=scene.initial.position + shift)
    undo: Undo = lambda path: replace(path, position=path.position - shift)  # noqa: E731 - as the others
    return (Variant(replace(scene, initial=initial), dt_s, undo),)


def _scaled_mass(scene: Scene, dt_s: float) -> Sequence[Variant]:
    return [
        Variant(
            replace(
                scene,
                body=RigidBody(scale * scene.body.mass, scale * scene.body.inertia),
                loads=_mapped(scene, load=scale),
            ),
            dt_s,
        )
        for scale in (128.0, 1.0 / 32.0)
    ]


def _scaled_time(scene: Scene, dt_s: float) -> Sequence[Variant]:
    return [_faster(scene, dt_s, factor) for factor in (8.0, 1.0 / 32.0)]


def _faster(scene: Scene, dt_s: float, factor: float) -> Variant:
    start = scene.initial
    initial = State(start.position, start.quaternion, factor * start.velocity, factor * start.omega_body)
    faster = replace(
        scene,
        initial=initial,
        loads=_mapped(scene, load=factor * factor),
        gravity=factor * factor * scene.gravity,
        duration_s=scene.duration_s / factor,
    )

    def undo(path: Motion) -> Motion:
        return replace(path, t=path.t * factor, velocity=path.velocity / factor, omega=path.omega / factor)

    return Variant(faster, dt_s / factor, undo)


def _unreversible(method: Method, reversible: bool, scene: Scene) -> str:
    if method.control != "dt":
        return ""
    if reversible and scene.loads and method.torque == "zero-order hold":
        return "loads that are held from the beginning of a step are not time-reversible"
    return "" if reversible else "the map is not time-reversible"


_ROTATION = ("attitude", "omega")

REVERSE: LawName = "reverse"
SPLIT: LawName = "split"
REPEAT: LawName = "repeat"
LAWS = (
    Law("rotate", _rotated),  # a scene that is rotated in the world gives the rotated motion
    Law("permute", _permuted),  # the body's axes in another order give the same motion
    Law("link", _linked, _ROTATION),  # the engine's link frame does not change the rotation
    # nor the motion of the centre of mass
    Law("link-origin", _linked, ("position", "velocity"), _may_step_the_origin),
    Law("boost", _boosted),  # a constant velocity is added to the motion
    Law("shift", _shifted),  # another origin of the world shifts the motion
    Law("scale-mass", _scaled_mass),  # mass, inertia and loads times one factor give the same motion
    Law(
        "scale-time", _scaled_time
    ),  # omega and v times s, loads and gravity times s^2: the motion in time / s
    Law(REVERSE, property_of=_unreversible),  # from the reversed end the motion returns to the start
    Law(SPLIT),  # samples do not change the motion: one advance or many
    Law(REPEAT),  # after reset, the same motion again
    Law(REPLAY),  # the same bits again, after reset and in another process
)
"""Every law. The last four are about how a case is run, and have no variant."""


# --------------------------------------------------------------------------------------------- the states

_BODY = RigidBody(3.0, np.array([[0.8, 0.1, -0.15], [0.1, 1.0, 0.05], [-0.15, 0.05, 1.2]]))
_FREE = State(
    np.array([0.3, -0.2, 0.5]),
    normalised(np.array([0.5, -0.1, 0.7, 0.5])),
    np.array([0.4, -0.6, 0.3]),
    np.array([1.1, -1.6, 0.7]),
)
_LOADS: tuple[Load, ...] = (
    Torque("body", np.array([0.9, -0.7, 0.5])),
    Torque("world", np.array([-0.6, 0.8, 0.7])),
    PointForce("body", np.array([2.5, 1.0, -2.0]), np.array([0.2, -0.3, 0.1])),
    PointForce("world", np.array([-1.5, 2.0, 3.0]), np.array([-0.1, 0.25, 0.2])),
)
_GRAVITY = np.array([1.2, -2.3, -9.4])


def _state(start: State, loads: tuple[Load, ...], gravity: Array, dt_s: float) -> tuple[Scene, float]:
    return Scene(_BODY, start, loads, gravity, _STEPS * dt_s, _STEPS + 1), dt_s


STATES: Mapping[str, tuple[Scene, float]] = {
    "free, |omega| dt = 0.06": _state(_FREE, (), np.zeros(3), 2.0**-5),
    "free, |omega| dt = 0.3": _state(
        replace(_FREE, omega_body=np.array([0.4, 4.5, -0.3])), (), np.zeros(3), 2.0**-4
    ),
    "forces and torques, |omega| dt = 0.13": _state(_FREE, _LOADS, _GRAVITY, 2.0**-4),
}
"""The scenes in which the laws are checked, with their steps in s."""


@cache
def _sensitivity(name: str) -> float:
    """Return the growth of a relative error over a scene, at least 1, by RK4 from perturbed states."""
    # imported here: gates need the names of the laws only
    from bodycheck.reference_impl.one_step_maps import MAPS
    from bodycheck.reference_impl.one_step_maps.one_step_map import Motion, Solid, scene_loads

    scene, dt_s = STATES[name]
    start, tiny = scene.initial, 1e-6
    speed = float(np.linalg.norm(start.omega_body))
    count = 7
    omega = np.repeat(start.omega_body[None], count, axis=0)
    omega[1:4] += tiny * speed * np.eye(3)
    turn = np.zeros((count, 3))
    turn[4:] = tiny * np.eye(3)
    motion = Motion(
        np.zeros(count),
        np.repeat(start.position[None], count, axis=0),
        np.repeat(start.velocity[None], count, axis=0),
        quaternion_product(np.repeat(start.quaternion[None], count, axis=0), exp_quaternion(turn)),
        omega,
    )
    solid, loads, step, largest = Solid.of(scene.body), scene_loads(scene), MAPS["RK4 Munthe-Kaas"].step, 1.0
    for _ in range(_STEPS):
        motion = step(solid, motion, np.full(count, dt_s), loads)
        angle = geodesic_angle(motion.quaternion[1:], motion.quaternion[:1])
        spin = np.linalg.norm(motion.omega[1:] - motion.omega[0], axis=-1) / speed
        largest = max(largest, float(np.max(np.maximum(angle, spin))) / tiny)
    return largest


# --------------------------------------------------------------------------------------------- checking


@dataclass(frozen=True)
class Break:
    """The largest difference of a quantity over its scale, its tolerance, and where it is."""

    size: float
    tolerance: float
    quantity: str
    state: str
    dt_s: float | None
    t_s: float

    @property
    def ratio(self) -> float:
        """The size over the tolerance."""
        return self.size / self.tolerance


@dataclass(frozen=True)
class Checked:
    """A law, whether a method obeys it, and the state that shows the largest break."""

    law: Law
    verdict: LawVerdict
    worst: Break | None = None
    message: str = ""


class _NotRunError(Exception):
    """A case gave no valid motion; the text says why."""


@dataclass(frozen=True, eq=False)
class _Bench:
    """One method under test at one fineness: steps per scene, or a tolerance of its own.

    residual: at which a solver inside a step stops, which makes its map reversible up to that. bases: the
    motions of the states, with which every law compares.
    """

    engine: Engine
    method: Method
    ask: RunCase
    replay: RunCase
    steps: int = _STEPS
    tolerance: float | None = None
    residual: float = 0.0
    bases: dict[str, Motion] = field(default_factory=dict)
    moved: dict[tuple[Variants, str], list[tuple[Variant, Motion]]] = field(default_factory=dict)

    @property
    def eps(self) -> float:
        """The relative error of one step: of the arithmetic, or the tolerance."""
        single = self.method.precision != "float64"
        return max(_SINGLE_EPS if single else _EPS, self.tolerance or 0.0)

    def state(self, name: str) -> tuple[Scene, float]:
        """Return the scene of a state, and its step in s at this fineness."""
        scene, dt_s = STATES[name]
        return scene, dt_s * _STEPS / self.steps

    def base(self, name: str) -> Motion:
        """Return the motion of a state."""
        if name not in self.bases:
            self.bases[name] = self.run(*self.state(name))
        return self.bases[name]

    def varied(self, variants: Variants, name: str) -> list[tuple[Variant, Motion]]:
        """Return the variants of a state with their motions, which several laws may compare."""
        if (variants, name) not in self.moved:
            self.moved[variants, name] = [
                (variant, self.run(variant.scene, variant.dt_s)) for variant in variants(*self.state(name))
            ]
        return self.moved[variants, name]

    def run(self, scene: Scene, dt_s: float, run_case: RunCase | None = None) -> Motion:
        from bodycheck.reference_impl.one_step_maps.one_step_map import Motion  # as in _sensitivity

        setting = replace(self.method.setting(dt_s), tolerance=self.tolerance)
        answer = (run_case or self.ask)(self.engine, Case(scene, self.method.name, setting))
        if answer.trajectory is None:
            raise _NotRunError(f"{answer.outcome}: {answer.message}")
        if reason := invalid_state(answer.trajectory):
            raise _NotRunError(f"unstable: {reason}")
        return replace(Motion.of(answer.trajectory), rotation=None)  # undo maps the quaternion alone


def check_laws(
    engine: Engine,
    method: Method,
    ask: RunCase,
    replay: RunCase,
    *,
    reversible: bool = False,
    residual: float = 0.0,
) -> list[Checked]:
    """Check every law but `replay` on one method.

    replay: runs a case, resets and runs it again. reversible: whether the known map of the method is;
    residual: by how much its steps differ from that map.
    """
    bench = _Bench(engine, method, ask, replay, tolerance=method.finest_tolerance, residual=residual)
    laws = [law for law in LAWS if law.name != REPLAY]
    try:
        for name in STATES:
            bench.base(name)
    except _NotRunError as error:
        return [Checked(law, "not-measured", message=str(error)) for law in laws]
    found = []
    for law in laws:
        try:
            found.append(_checked(bench, law, reversible=reversible))
        except _NotRunError as error:
            found.append(Checked(law, "not-measured", message=str(error)))
    return found


def _checked(bench: _Bench, law: Law, *, reversible: bool) -> Checked:
    """Return the verdict on a law, with the largest violation that counts for it."""
    breaks = [one for name in STATES for one in _breaks(bench, law, name)]
    violated = [one for one in breaks if not one.ratio <= 1.0]
    if not violated:
        return Checked(law, "holds", max(breaks, key=attrgetter("ratio")))
    reasons = {name: law.property_of(bench.method, reversible, STATES[name][0]) for name in STATES}
    faults = [one for one in violated if not reasons[one.state]]
    reason = _vanishing(bench, law) if faults else reasons[max(violated, key=attrgetter("ratio")).state]
    worst = max(faults or violated, key=attrgetter("ratio"))
    text = f"{worst.quantity} differs by {worst.size:.3g} at t = {worst.t_s:.4g} s; {worst.state}"
    return Checked(law, "property" if reason else "broken", worst, f"{text}; {reason}" if reason else text)


def _vanishing(bench: _Bench, law: Law) -> str:
    """Return that every violation falls with the step or the tolerance like the method's error, else ""."""
    method = bench.method
    if method.control == "tolerance" and bench.tolerance is not None and law.name != REPEAT:
        ratio, word = _TOLERANCE_RATIO, "tolerance"
        levels = [replace(bench, tolerance=ratio * bench.tolerance, bases={}, moved={}), bench]
    elif method.control == "dt" and law.name not in (REVERSE, SPLIT, REPEAT):
        ratio, word = float(_STEP_RATIO), "step"
        numbers = (_STEP_RATIO * bench.steps, _STEP_RATIO**2 * bench.steps)
        levels = [bench, *(replace(bench, steps=n, bases={}, moved={}) for n in numbers)]
    else:
        return ""
    try:
        vanishes = all(
            _falls(before, after, ratio, _orders(method, STATES[name][0]))
            for name in STATES
            for series in zip(*(_breaks(level, law, name) for level in levels), strict=True)
            if not series[levels.index(bench)].ratio <= 1.0
            for before, after in pairwise(series)
        )
    except _NotRunError:
        return ""
    return f"it falls with the {word} like the error of the method" if vanishes else ""


def _orders(method: Method, scene: Scene) -> tuple[float, float]:
    """Return the least and the largest power of the step or tolerance with which a violation may fall.

    A method without a stated order is of order 1 at least, and so is any if loads are held over its steps.
    """
    if method.control != "dt":
        return _TOLERANCE_ORDERS
    order = max(method.order or 1, 1)
    least = 1 if scene.loads and method.torque == "zero-order hold" else order
    return least - _MISSING_ORDER, order + _MORE_ORDERS


def _falls(before: Break, after: Break, ratio: float, orders: tuple[float, float]) -> bool:
    """Whether a violation falls as a power between these orders, to round-off at most: one that ends is not.

    A limit on a speed or an angle, for example, ends to act below some step.
    """
    least, largest = orders
    if before.ratio <= 1.0:
        return after.ratio <= 1.0
    if after.ratio <= _FAR_BELOW:
        return before.size <= after.tolerance * ratio**largest
    return ratio**least <= before.size / after.size <= ratio**largest


def _breaks(bench: _Bench, law: Law, name: str) -> Iterator[Break]:
    """Yield the violation of each quantity in each variant of a state."""
    scene, dt_s = bench.state(name)
    base = bench.base(name)
    if law.variants is not None:
        for variant, path in bench.varied(law.variants, name):
            yield from _compared(bench, law, name, base, variant.undo(path), raw=path)
    elif law.name == REPEAT:
        yield from _compared(bench, law, name, base, bench.run(scene, dt_s, bench.replay))
    elif law.name == SPLIT:
        ends = bench.run(replace(scene, samples=2), dt_s)
        yield from _compared(bench, law, name, base.part(np.array([0, -1])), ends)
    else:
        yield from _compared(bench, law, name, base, _returned(bench, scene, dt_s, base))


def _returned(bench: _Bench, scene: Scene, dt_s: float, base: Motion) -> Motion:
    """Return the motion from the reversed end, reversed, with its samples in the order of the base."""
    end = State(base.position[-1], normalised(base.quaternion[-1]), -base.velocity[-1], -base.omega[-1])
    back = bench.run(replace(scene, initial=end), dt_s)
    turned = back.part(slice(None, None, -1))
    return replace(turned, t=base.t, velocity=-turned.velocity, omega=-turned.omega)


def _compared(
    bench: _Bench, law: Law, name: str, base: Motion, other: Motion, raw: Motion | None = None
) -> Iterator[Break]:
    """Yield the largest difference of each quantity. raw: the motion before it is mapped back."""
    scene, dt_s = bench.state(name)
    gyration = float(np.sqrt(np.trace(scene.body.inertia) / (2.0 * scene.body.mass)))
    speed = max(largest_norm(base.velocity), largest_norm(base.omega) * gyration)
    length = max(largest_norm(base.position - base.position[0]), gyration)
    eps = max(bench.eps, bench.residual if law.name == REVERSE else 0.0)
    noise = _SAFETY * eps * bench.steps * _sensitivity(name)
    reading = base if raw is None else raw
    # a link's origin moves with omega x offset, and a far origin rounds positions
    offset = float(np.linalg.norm(_OFFSET)) if law.variants is _linked else 0.0
    differences = {
        "attitude": (geodesic_angle(base.quaternion, other.quaternion), 1.0),
        "omega": (_norms(base.omega - other.omega) / largest_norm(base.omega), 1.0),
        "position": (
            _norms(base.position - other.position) / length,
            1.0 + (largest_norm(reading.position) + largest_norm(base.position) + offset) / length,
        ),
        "velocity": (
            _norms(base.velocity - other.velocity) / speed,
            1.0 + (largest_norm(other.velocity) + offset * largest_norm(base.omega)) / speed,
        ),
    }
    for quantity in law.compared:
        series, amplified = differences[quantity]
        at = int(np.argmax(series))
        step = dt_s if bench.method.control == "dt" else None
        yield Break(float(series[at]), noise * amplified, quantity, name, step, float(base.t[at]))


def _norms(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def law_rows(engine: Engine, method: Method, checked: Sequence[Checked]) -> list[dict[str, Any]]:
    """Return the rows of laws.csv of one method without run_id."""
    shared = {"engine": engine.name, "engine_version": engine.version, "method": method.name}
    command = method_command(("laws",), engine, method)
    return [
        {
            **shared,
            "law": one.law.name,
            "verdict": one.verdict,
            "message": one.message,
            "reproduce": command,
            **({} if one.worst is None else vars(one.worst)),
        }
        for one in checked
    ]
