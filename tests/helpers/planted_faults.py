"""Engines whose methods each have one fault planted in a healthy base: rk4, or M1 (semi-implicit).

The read-back of such an engine is right: the faults are in what it does, or in what it reports later.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Stepping
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import conjugate, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

BASES = {"rk4": 4, "m1": 1}
"""The healthy bases and their orders."""
NO_FAULT = "sound"
"""The method without a fault."""

_CLAMP, _ANGLE, _ADDITIVE, _OLD_VELOCITY, _WORLD_OMEGA, _SINGLE, _DRAG_ENERGY, _BODY_VELOCITY, _NORMAL = (
    range(9)
)
_SPEED_CLAMP, _ASLEEP, _QUADRATIC = range(9, 12)


@dataclass
class Model:
    """An engine's model of a scene: right, until a fault changes it."""

    scene: Scene
    gravity: Array
    mass: float
    inertia: Array
    gyro: float = 1.0
    linear_damping: float = 0.0
    angular_damping: float = 0.0
    step_factor: float = 1.0
    steps_factor: int = 1
    load_late: int = 0
    load_kept: bool = False
    release_late: bool = False
    first_step_free: bool = False
    stale: tuple[str, ...] = ()
    switches: Array = field(default_factory=lambda: np.array([0.0] * 8 + [1.0] + [0.0] * 3))
    wrench: Callable[[Wrench, Array], Wrench] = lambda wrench, rotation: wrench  # noqa: ARG005
    start: Callable[[Array], Array] = lambda quaternion: quaternion
    reading: Callable[[Reading], Reading] = lambda reading: reading
    later_reading: Callable[[Reading], Reading] = lambda reading: reading

    @classmethod
    def of(cls, scene: Scene) -> Model:
        """Return the model of a healthy engine."""
        return cls(scene, scene.gravity.copy(), scene.body.mass, scene.body.inertia.copy())

    @property
    def constants(self) -> Array:
        """1 / m, I^-1 (9,), I (9,), the gyroscopic factor, two dampings, the middle moment."""
        middle = np.sort(diagonalised(self.inertia)[0])[1]
        parts = (
            [1.0 / self.mass],
            np.linalg.inv(self.inertia).ravel(),
            self.inertia.ravel(),
            [self.gyro, self.linear_damping, self.angular_damping, middle],
        )
        return np.concatenate(parts)


Planting = Callable[[Model], None]


@dataclass(frozen=True)
class Fault:
    """A fault: what is planted, how, and the bases in which nothing could detect it, with the reason."""

    name: str
    planted: str
    plant: Planting
    undetectable: Mapping[str, str] = field(default_factory=dict)


def _set(**values: Any) -> Planting:
    def plant(model: Model) -> None:
        for name, value in values.items():
            setattr(model, name, value)

    return plant


def _scaled(name: str, factor: float) -> Planting:
    return lambda model: setattr(model, name, factor * getattr(model, name))


def _switched(place: int, value: float = 1.0) -> Planting:
    def plant(model: Model) -> None:
        model.switches[place] = value

    return plant


def _additive(normal: float) -> Planting:
    def plant(model: Model) -> None:
        model.switches[_ADDITIVE], model.switches[_NORMAL] = 1.0, normal

    return plant


def _inertia(change: Callable[[Array], Array]) -> Planting:
    return lambda model: setattr(model, "inertia", change(model.inertia))


def _one_moment(which: int, factor: float) -> Callable[[Array], Array]:
    """Return a function that multiplies one of the principal moments, which are in ascending order."""

    def change(inertia: Array) -> Array:
        moments, axes = np.linalg.eigh(inertia)
        moments[which] *= factor
        return np.asarray(axes @ np.diag(moments) @ axes.T)

    return change


def _reading(**changes: Callable[[Reading], Array | None]) -> Planting:
    """Return a fault that replaces quantities of each reading but the first."""

    def plant(model: Model) -> None:
        model.later_reading = lambda reading: replace(
            reading, **{name: change(reading) for name, change in changes.items()}
        )

    return plant


def _torques(change: Callable[[Array, Array, Array], tuple[Array, Array]]) -> Planting:
    """Return a fault that changes the torques in body and world axes; the change also gets R at the start."""

    def wrench(wrench: Wrench, rotation: Array) -> Wrench:
        body, world = change(wrench.torque_body, wrench.torque_world, rotation)
        return replace(wrench, torque_body=body, torque_world=world)

    return _set(wrench=wrench)


def _at_centre(wrench: Wrench, rotation: Array) -> Wrench:
    """Return a wrench whose forces have no moment.

    The moment of a body force is part of torque_body, as the body torques are: both are removed.
    """
    del rotation
    force = wrench.force_world + sum((force for _, force in wrench.point_forces), np.zeros(3))
    lever = np.zeros(3) if np.any(wrench.force_body) else wrench.torque_body
    return replace(wrench, force_world=force, point_forces=(), torque_body=lever)


def _lever_in_world(wrench: Wrench, rotation: Array) -> Wrench:
    """Return a wrench whose points are offsets in world axes that do not rotate with the body."""
    points = tuple((rotation.T @ at, force) for at, force in wrench.point_forces)
    return replace(wrench, point_forces=points)


def _no_forces(wrench: Wrench, rotation: Array) -> Wrench:
    del rotation
    return replace(wrench, force_body=np.zeros(3), force_world=np.zeros(3), point_forces=())


def _forces(factor: float) -> Planting:
    """Return a fault that multiplies the forces, and torque_body if it has the moment of a body force."""

    def wrench(wrench: Wrench, rotation: Array) -> Wrench:
        del rotation
        lever = factor if np.any(wrench.force_body) else 1.0
        return replace(
            wrench,
            force_body=factor * wrench.force_body,
            force_world=factor * wrench.force_world,
            point_forces=tuple((at, factor * force) for at, force in wrench.point_forces),
            torque_body=lever * wrench.torque_body,
        )

    return _set(wrench=wrench)


def _longer_arm(wrench: Wrench, rotation: Array) -> Wrench:
    """Return a wrench whose world forces act at points 1 % farther out."""
    del rotation
    return replace(wrench, point_forces=tuple((1.01 * at, force) for at, force in wrench.point_forces))


def _force_axes_exchanged(wrench: Wrench, rotation: Array) -> Wrench:
    """Return a wrench whose forces are constant in the other axes, with the right moments."""
    del rotation
    force = wrench.force_world + sum((force for _, force in wrench.point_forces), np.zeros(3))
    couples = tuple((at, force) for at, force in wrench.point_forces)
    balancing = tuple((0.0 * at, -force) for at, force in couples)
    return replace(
        wrench, force_body=force, force_world=wrench.force_body, point_forces=(*couples, *balancing)
    )


def _gravity_in_body_axes(model: Model) -> None:
    weight, model.gravity = model.mass * model.gravity, np.zeros(3)
    model.wrench = lambda wrench, _: replace(wrench, force_body=wrench.force_body + weight)


def _rotated(angle: float) -> Callable[[Array], Array]:
    """Return a function that rotates the principal axes about z."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return lambda inertia: turn @ inertia @ turn.T


def _moment_reversed(wrench: Wrench, rotation: Array) -> Wrench:
    """Return a wrench whose moments are F x a."""
    del rotation
    points = tuple((-at, force) for at, force in wrench.point_forces)
    body = -wrench.torque_body if np.any(wrench.force_body) else wrench.torque_body
    return replace(wrench, point_forces=points, torque_body=body)


def _held(values: Array | None) -> Array:
    assert values is not None
    return values


def _omega_world(reading: Reading) -> Array:
    assert reading.quaternion is not None
    assert reading.omega_body is not None
    return np.asarray(quaternion_to_matrix(reading.quaternion) @ reading.omega_body)


def _quaternions(taken: Callable[[Array], Array], given: Callable[[Array], Array]) -> Planting:
    """Return a fault that converts the quaternion at the start, and that of each reading, to another form."""

    def plant(model: Model) -> None:
        model.start = taken
        model.reading = lambda reading: replace(reading, quaternion=given(np.asarray(reading.quaternion)))

    return plant


def _link_origin(model: Model) -> None:
    """Report the link's origin instead of the centre of mass."""
    link = model.scene.link
    if link is None:
        return

    def reading(reading: Reading) -> Reading:
        assert reading.quaternion is not None
        offset = quaternion_to_matrix(reading.quaternion) @ link.offset
        return replace(reading, position=reading.position + offset)

    model.reading = reading


def _other_point(reading: Reading) -> Array:
    assert reading.quaternion is not None
    assert reading.omega_body is not None
    arm = np.array([0.05, 0.0, 0.02])
    return np.asarray(
        reading.velocity + quaternion_to_matrix(reading.quaternion) @ np.cross(reading.omega_body, arm)
    )


_CONSISTENT_M1 = "a consistent method of order 1 too: its limit, order and readings are those of M1"
_RK4_ITSELF = "Runge-Kutta 4 on the quaternion: |q| - 1 is of order 5, below 1e-12 at the finest step"
_LONG_STEPS = "right below a turn of pi / 4 a step, beyond which errors are large in any method"
_NO_LINK = "no scenario of smoke has a link off the centre of mass; off-centre-link has"
_NO_PIVOT = "no scenario of smoke has a pivot; heavy-top has"
_BOTH = tuple(BASES)


def _nowhere(reason: str) -> dict[str, str]:
    return dict.fromkeys(_BOTH, reason)


FAULTS: Sequence[Fault] = (
    Fault("gravity-doubled", "g x 2", _scaled("gravity", 2.0)),
    Fault("gravity-missing", "g x 0", _scaled("gravity", 0.0)),
    Fault("gravity-reversed", "g x -1", _scaled("gravity", -1.0)),
    Fault("gravity-1e-3", "g x 1.001", _scaled("gravity", 1.001)),
    Fault("gravity-axes", "y and z exchanged", lambda m: setattr(m, "gravity", m.gravity[[0, 2, 1]])),
    Fault("mass-doubled", "m x 2 under forces", _scaled("mass", 2.0)),
    Fault("moment-1e-4", "smallest moment x 1.0001", _inertia(_one_moment(0, 1.0001))),
    Fault("moment-10-percent", "smallest moment x 1.1", _inertia(_one_moment(0, 1.1))),
    Fault("off-diagonals-dropped", "I = diag(I)", _inertia(lambda i: np.diag(np.diag(i)))),
    Fault("off-diagonals-reversed", "I_xy = +sum m x y", _inertia(lambda i: 2.0 * np.diag(np.diag(i)) - i)),
    Fault("inertia-axes-permuted", "x, y, z as y, z, x", _inertia(lambda i: i[np.ix_([1, 2, 0], [1, 2, 0])])),
    Fault("inertia-sphere", "I = trace(I) / 3", _inertia(lambda i: np.eye(3) * np.trace(i) / 3.0)),
    Fault("no-gyroscopic-term", "omega x I omega x 0", _set(gyro=0.0)),
    Fault("gyroscopic-term-reversed", "omega x I omega x -1", _set(gyro=-1.0)),
    Fault("gyroscopic-term-1e-3", "omega x I omega x 1.001", _set(gyro=1.001)),
    Fault("omega-read-in-world-axes", "omega_body = R omega_body", _reading(omega_body=_omega_world)),
    Fault("omega-turned-in-world-axes", "q = exp(h omega) q", _switched(_WORLD_OMEGA)),
    Fault(
        "omega-scaled",
        "omega x 1.0001 when read",
        _reading(omega_body=lambda r: 1.0001 * _held(r.omega_body)),
    ),
    Fault("torque-body-as-world", "tau_body as tau_world", _torques(lambda b, w, _: (np.zeros(3), b + w))),
    Fault("torque-world-as-body", "tau_world as tau_body", _torques(lambda b, w, _: (b + w, np.zeros(3)))),
    Fault("torque-doubled", "tau x 2", _torques(lambda b, w, _: (2.0 * b, 2.0 * w))),
    Fault("torque-missing", "tau x 0", _torques(lambda b, w, _: (0.0 * b, 0.0 * w))),
    Fault("torque-reversed", "tau x -1", _torques(lambda b, w, _: (-b, -w))),
    Fault("torque-frozen", "tau_body in world axes of t = 0", _torques(lambda b, w, r: (0.0 * b, w + r @ b))),
    Fault("load-late", "each load one step late", _set(load_late=1)),
    Fault("release-late", "each load ends one step late", _set(release_late=True)),
    Fault("first-step-free", "no load in the first step of all", _set(first_step_free=True)),
    Fault("load-kept", "loads are added and never cleared", _set(load_kept=True)),
    Fault("force-at-centre", "a force has no moment", _set(wrench=_at_centre)),
    Fault("lever-in-world-axes", "the arm does not turn", _set(wrench=_lever_in_world)),
    Fault("moment-reversed", "F x a", _set(wrench=_moment_reversed)),
    Fault("force-missing", "F x 0 with its moment kept", _set(wrench=_no_forces)),
    Fault("damping-linear", "v' - 0.04 v", _set(linear_damping=0.04)),
    Fault("damping-angular", "omega' - 0.04 omega", _set(angular_damping=0.04)),
    Fault("omega-clamped", "|omega_i| <= 100 rad/s", _switched(_CLAMP, 100.0)),
    Fault(
        "state-late", "read one step late", _set(stale=("position", "velocity", "quaternion", "omega_body"))
    ),
    Fault("attitude-late", "q read one step late", _set(stale=("quaternion",))),
    Fault("velocity-late", "v read one step late", _set(stale=("velocity",))),
    Fault("quaternion-conjugated", "q* in and out", _quaternions(conjugate, conjugate)),
    Fault("quaternion-conjugated-when-read", "q* out", _quaternions(lambda q: q, conjugate)),
    Fault(
        "quaternion-order",
        "scalar last in and out",
        _quaternions(lambda q: np.roll(q, 1), lambda q: np.roll(q, -1)),
    ),
    Fault("quaternion-not-renormalised", "q + h q' and no more", _additive(0.0), {"rk4": _RK4_ITSELF}),
    Fault("energy-dragged", "E to L^2 / 2 I2 at 1 / s", _switched(_DRAG_ENERGY, 1.0)),
    Fault(
        "turn-clamped", "|omega| h <= pi / 4 a step", _switched(_ANGLE, np.pi / 4.0), _nowhere(_LONG_STEPS)
    ),
    Fault("step-1-percent", "h x 1.01", _set(step_factor=1.01)),
    Fault("step-halved", "h / 2", _set(step_factor=0.5)),
    Fault("step-twice", "each step made twice", _set(steps_factor=2)),
    Fault("velocity-turns-with-body", "v' + omega x v", _switched(_BODY_VELOCITY)),
    Fault("velocity-of-another-point", "v + omega x a when read", _reading(velocity=_other_point)),
    Fault("single-precision-stage", "omega in float32 in each stage", _switched(_SINGLE)),
    Fault(
        "position-by-old-velocity",
        "x + h v before v is new",
        _switched(_OLD_VELOCITY),
        {"m1": _CONSISTENT_M1},
    ),
    Fault("gravity-1-percent", "g x 1.01", _scaled("gravity", 1.01)),
    Fault("gravity-1e-5", "g x 1.00001", _scaled("gravity", 1.00001)),
    Fault("gravity-in-body-axes", "g turns with the body", _gravity_in_body_axes),
    Fault("mass-5-percent", "m x 1.05 under forces", _scaled("mass", 1.05)),
    Fault("mass-1e-4", "m x 1.0001 under forces", _scaled("mass", 1.0001)),
    Fault("inertia-1-percent", "I x 1.01", _inertia(lambda i: 1.01 * i)),
    Fault("moment-1-percent", "largest moment x 1.01", _inertia(_one_moment(2, 1.01))),
    Fault("middle-moment-1e-3", "middle moment x 1.001", _inertia(_one_moment(1, 1.001))),
    Fault("inertia-axes-turned", "principal axes turned by 1e-3", _inertia(_rotated(1e-3))),
    Fault("torque-1-percent", "tau x 1.01", _torques(lambda b, w, _: (1.01 * b, 1.01 * w))),
    Fault("force-1e-3", "F x 1.001", _forces(1.001)),
    Fault("arm-1-percent", "the arms of world forces x 1.01", _set(wrench=_longer_arm)),
    Fault("force-axes-exchanged", "F_body as F_world and back", _set(wrench=_force_axes_exchanged)),
    Fault("damping-linear-1e-3", "v' - 0.001 v", _set(linear_damping=1e-3)),
    Fault("damping-angular-1e-3", "omega' - 0.001 omega", _set(angular_damping=1e-3)),
    Fault("damping-angular-1e-5", "omega' - 1e-5 omega", _set(angular_damping=1e-5)),
    Fault("damping-negative", "omega' + 0.01 omega", _set(angular_damping=-0.01)),
    Fault("damping-quadratic", "v' - 0.001 |v| v", _switched(_QUADRATIC, 1e-3)),
    Fault("omega-clamped-at-175", "|omega_i| <= 175 rad/s", _switched(_CLAMP, 175.0)),
    Fault("speed-clamped", "|v_i| <= 100 m/s", _switched(_SPEED_CLAMP, 100.0)),
    Fault("asleep", "stands still below 0.01 m/s and 0.01 rad/s", _switched(_ASLEEP, 0.01)),
    Fault("load-two-steps-late", "each load two steps late", _set(load_late=2)),
    Fault("omega-late", "omega read one step late", _set(stale=("omega_body",))),
    Fault("position-late", "x read one step late", _set(stale=("position",))),
    Fault("omega-reversed-when-read", "-omega", _reading(omega_body=lambda r: -_held(r.omega_body))),
    Fault(
        "omega-turned-when-read",
        "omega x, -y, -z when read",
        _reading(omega_body=lambda r: _held(r.omega_body) * [1.0, -1.0, -1.0]),
    ),
    Fault("velocity-scaled", "v x 1.0001 when read", _reading(velocity=lambda r: 1.0001 * r.velocity)),
    Fault("position-scaled", "x x 1.0001 when read", _reading(position=lambda r: 1.0001 * r.position)),
    Fault("step-1e-3", "h x 1.001", _set(step_factor=1.001)),
    Fault("energy-dragged-slowly", "E to L^2 / 2 I2 at 0.01 / s", _switched(_DRAG_ENERGY, 0.01)),
    Fault("gyroscopic-term-1-percent", "omega x I omega x 0.99", _set(gyro=0.99)),
    Fault("link-origin", "the link's origin as the position", _link_origin, _nowhere(_NO_LINK)),
    Fault("pivot-ignored", "a pivoted body moves freely", _set(), _nowhere(_NO_PIVOT)),
)
"""The kinds of faults, in both bases unless stated otherwise."""


class FaultySimulation:
    """A scene stepped by a base in which a fault is planted."""

    stepping: Stepping = "native"

    def __init__(self, model: Model, order: int, dt_s: float) -> None:
        self._model, self._order, self._dt_s = model, order, dt_s
        self._constants = model.constants
        self._rotation = model.scene.initial.rotation
        self.reset()

    def reset(self) -> None:
        """Return to the start, without loads."""
        initial = self._model.scene.initial
        quaternion = self._model.start(initial.quaternion)
        self._state = np.concatenate([initial.position, initial.velocity, initial.omega_body, quaternion])
        self._before = self._state.copy()
        self._pending: Array | None = None
        self._waiting = 0
        self._loaded = self._begun = False
        self._load = self._packed(NO_WRENCH)

    def _packed(self, wrench: Wrench) -> Array:
        model = self._model
        changed = model.wrench(wrench, self._rotation)
        return changed.packed(replace(model.scene.body, mass=model.mass), model.gravity)

    def read_back(self) -> ReadBack:
        """Return the read-back of a healthy engine: no fault shows before the first step."""
        scene = self._model.scene
        return ReadBack(scene.body.mass, scene.body.inertia, self._dt_s, scene.gravity, self.read())

    def apply(self, wrench: Wrench) -> None:
        """Take the wrench, as the engine interprets it, now or some steps later."""
        load = self._packed(wrench)
        if self._model.load_kept:
            load = load + self._load - self._packed(NO_WRENCH)
        model = self._model
        unbegun = model.first_step_free and not self._begun
        if model.load_late or unbegun or (model.release_late and self._loaded):
            self._pending, self._waiting = load, max(model.load_late, 1)
        else:
            self._load = load
        self._loaded = not wrench.is_zero

    def advance(self, steps: int) -> None:
        """Make the steps, with the first ones and the last one apart if something is late."""
        if self._pending is not None:
            waited = min(self._waiting, steps)
            self._make(waited)
            self._waiting, steps = self._waiting - waited, steps - waited
            if not self._waiting:
                self._load, self._pending = self._pending, None
        if self._model.stale and steps:
            self._make(steps - 1)
            steps = 1
        self._make(steps)

    def _make(self, steps: int) -> None:
        # imported late: numba takes half the start of a worker
        from tests.helpers.faulty_steps import advance

        if not steps:
            return
        self._before, self._begun = self._state.copy(), True
        model = self._model
        dt_s, made = self._dt_s * model.step_factor, steps * model.steps_factor
        advance(self._state, self._load, self._constants, model.switches, dt_s, made, self._order)

    def read(self) -> Reading:
        """Return the state, as the engine reports it."""
        now, before = (_reading_of(state) for state in (self._state, self._before))
        stale = {name: getattr(before, name) for name in self._model.stale}
        reading = self._model.reading(replace(now, **stale))
        return self._model.later_reading(reading) if self._begun else reading

    def close(self) -> None:
        """Nothing to free."""


def _reading_of(state: Array) -> Reading:
    held = state.copy()
    return Reading(held[0:3], held[3:6], quaternion=held[9:13], omega_body=held[6:9])


class Faulty:
    """An engine with one method per fault in a base, and one for the sound base."""

    version = "1"

    def __init__(self, base: str) -> None:
        self.name = f"faulty-{base}"
        self._order = BASES[base]
        known = replace(Reference().methods[base], continuous_loads="zero-order hold", changed_defaults=())
        names = (NO_FAULT, *(fault.name for fault in FAULTS))
        self.methods: Mapping[str, Method] = {name: replace(known, name=name) for name in names}

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse what the bases do not support."""
        if scene.continuous_loads:
            return "no continuous loads"
        return "no pivot" if scene.pivot is not None and method != "pivot-ignored" else None

    def build(self, scene: Scene, method: str, dt_s: float) -> FaultySimulation:
        """Return a simulation with the fault."""
        model = Model.of(scene)
        for fault in FAULTS:
            if fault.name == method:
                fault.plant(model)
        return FaultySimulation(model, self._order, dt_s)
