"""The contract between bodycheck and an engine.

An adapter is an object with the attributes of `Adapter`; it need not inherit from anything. `build` returns
a `Simulation` of one scene by one method at one step size. The caller reads it back, applies the wrench of
each leg, advances it, and reads the state at each sample. Only `apply` and `advance` are timed; building,
reading and comparing are not. For a method without a fixed step size, controlled by a tolerance or by
nothing, `solver` returns a `Solver` instead (`SolvingAdapter`), which computes all samples in one call.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import Wrench

Stepping: TypeAlias = Literal["native", "python"]
VARIANT = "@"
"""Separates the method from the variant of the engine's setup in a name: METHOD@VARIANT."""
DEFAULTS = f"{VARIANT}defaults"
"""Suffix of a method that leaves the engine's defaults unchanged."""
UNALIGNED = f"{VARIANT}unaligned"
"""Suffix of a method that steps a free body by its link's origin, which may be off the centre of mass."""
Control: TypeAlias = Literal["dt", "tolerance", "none"]
Precision: TypeAlias = Literal["float64", "float32", "mixed"]
"""mixed: the state is handed over in float32, and some of the arithmetic is float64."""
BuildKind: TypeAlias = Literal["installed", "development", "plug-in", "handed over"]
"""installed: a release of an engine that bodycheck supports. development: such an engine, installed editable
or in a source folder. plug-in: an adapter of another package. handed over: an object of the run's process."""


@dataclass(frozen=True)
class Method:
    """One integrator or mode of an engine, and its properties.

    formula: the name of a known one-step map (`reference_impl.one_step_maps.MAPS`), "MAP" or "MAP; REMARK",
    whose formula is then shown and which fingerprints must agree with; or the formula of another method.
    order: theoretical order on a smooth, torque-free motion, None if none is expected. evaluations:
    right-hand sides per step. torque: when a torque is evaluated: at every stage, once per step and held
    constant over it (zero-order hold), or in a closed form only. continuous_loads: the same for loads that
    vary with time or motion, including user's functions; a zero-order hold reduces any method to order 1.
    control: what the caller sets: the step size, a tolerance, or nothing. tolerances: the defaults of a run.
    snippet: the statements with which a user's own program selects this method, such as
    "world.setTimeStep({dt_s})"; {dt_s} stands for the step in s.
    precision: of the state and the arithmetic. rounding_bias: the mean rounding error of omega per step, in
    unit round-offs, where it has the same direction at every step, as where omega is rotated into body axes
    and back; 0 where rounding errors only scatter. only_on_request: the method runs only if requested by
    name, as every variant does.
    """

    name: str
    formula: str
    order: int | None
    evaluations: int | None
    torque: Literal["every stage", "zero-order hold", "in closed form"]
    conserves: str
    source: str
    control: Control = "dt"
    changed_defaults: tuple[str, ...] = ()
    tolerances: tuple[float, ...] = ()
    continuous_loads: Literal["every stage", "zero-order hold", "in closed form"] = "zero-order hold"
    snippet: str = ""
    precision: Precision = "float64"
    rounding_bias: float = 0.0
    only_on_request: bool = False

    @classmethod
    def of(cls, facts: Mapping[str, Any]) -> Method:
        """Return the method that JSON states; keys of other versions are ignored."""
        known: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in facts.items()
        }
        return cls(**{one.name: known[one.name] for one in fields(cls) if one.name in known})

    @property
    def on_request(self) -> bool:
        """Whether the method runs only if requested by name."""
        return self.only_on_request or VARIANT in self.name

    @property
    def is_for_off_centre_links(self) -> bool:
        """Whether this variant also runs unrequested where a link is off the centre of mass."""
        return self.name.endswith(UNALIGNED)

    @property
    def finest_tolerance(self) -> float | None:
        """The finest default tolerance of a method that is controlled by one."""
        return min(self.tolerances, default=None) if self.control == "tolerance" else None

    def setting(self, dt_s: float) -> Setting:
        """Return the setting of this method at a step, or at its finest default tolerance."""
        return Setting(dt_s if self.control == "dt" else None, self.finest_tolerance)


@dataclass(frozen=True)
class Build:
    """The identity of the code of an engine that a worker has loaded.

    id: hash over all parts, the key of results of earlier runs; empty if unknown, in which case every case
    runs again. kind: where the engine comes from. parts: the hashed parts by name, for people to read.
    """

    id: str = ""
    kind: BuildKind = "plug-in"
    parts: Mapping[str, str] = field(default_factory=dict)

    @property
    def short(self) -> str:
        """The first 12 digits of the id, as shown in tables."""
        return self.id[:12]


@dataclass(frozen=True, eq=False)
class Engine:
    """An engine as announced by its worker: name, version, methods by name, build, and trees or not."""

    name: str
    version: str
    methods: Mapping[str, Method]
    build: Build = Build()
    moves_trees: bool = False


@dataclass(frozen=True)
class Setting:
    """The step size in s or the tolerance of a method; neither for a method without control."""

    dt_s: float | None = None
    tolerance: float | None = None

    @property
    def fineness(self) -> float | None:
        """The step size or the tolerance, whichever is set."""
        return self.tolerance if self.dt_s is None else self.dt_s


@dataclass(frozen=True, eq=False)
class Reading:
    """The state as stored in the engine.

    position (3,) in m and velocity (3,) in m/s of the centre of mass in world axes, quaternion (4,) scalar
    first and/or rotation (3, 3), body to world, omega (3,) in rad/s in world or in body axes. Set rotation
    only if the engine itself returns a matrix for this state. specific_force (3,) in m/s^2 and gyro (3,) in
    rad/s: readings of the engine's own sensors at `imu.imu_point`, in body axes.
    """

    position: Array
    velocity: Array
    quaternion: Array | None = None
    rotation: Array | None = None
    omega_world: Array | None = None
    omega_body: Array | None = None
    specific_force: Array | None = None
    gyro: Array | None = None


@dataclass(frozen=True, eq=False)
class ReadBack:
    """The model as stored in the engine.

    mass in kg, inertia (3, 3) in kg m^2 in body axes, step size in s (of a single step, also if one call
    makes several; None for a method without steps), gravity (3,) in m/s^2, and the initial state.
    """

    mass: float
    inertia: Array
    dt_s: float | None
    gravity: Array
    state: Reading


@dataclass(frozen=True, eq=False)
class TreeReadBack:
    """A tree as stored in an engine: the step in s, and arrays named as in `JointedLink` and `Joint`.

    mass, stiffness, rest, damping and armature (b,); inertia (b, 3, 3); centre, place and axis (b, 3); zero
    (b, 4); gravity (3,); q and u. What the engine does not store is absent.
    """

    dt_s: float | None
    numbers: Mapping[str, Array]


class Simulation(Protocol):
    """One scene in one engine, by one method, at one step size. Close it after use.

    The caller passes the scene's piecewise constant loads to `apply`. The simulation itself applies the
    continuous loads, which act from the start.
    """

    stepping: Stepping
    """native: one call makes many steps; python: one Python call per step."""

    def read_back(self) -> ReadBack:
        """Return the model as read from the engine, not from the scene."""

    def reset(self) -> None:
        """Restore the initial state at t = 0, as freshly built."""

    def apply(self, wrench: Wrench) -> None:
        """Replace the acting wrench, (3,) per force in N and torque in N m, until the next call."""

    def advance(self, steps: int) -> None:
        """Make this many steps."""

    def read(self) -> Reading:
        """Return copies of the engine's present state."""

    def close(self) -> None:
        """Free the engine's resources; a second call does nothing."""


class Solver(Protocol):
    """One scene in one engine, by one method that chooses its own steps or has none. Close it after use."""

    steps: int | None
    """Number of steps of the last `solve`; None for a method without steps."""

    def read_back(self) -> ReadBack | TreeReadBack:
        """Return the model as read from the engine, with a step of None."""

    def solve(self) -> Trajectory:
        """Compute all samples of the scene, starting from the initial state at every call."""

    def close(self) -> None:
        """Free the engine's resources; a second call does nothing."""


class SceneSolver:
    """The base of a solver without an engine, which solves the equations of the scene itself."""

    steps: int | None = None

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def read_back(self) -> ReadBack:
        """Return the scene's own numbers: there is no engine between."""
        scene, start = self._scene, self._scene.initial
        state = Reading(start.position, start.velocity, start.quaternion, omega_body=start.omega_body)
        return ReadBack(scene.body.mass, scene.body.inertia, None, scene.gravity, state)

    def close(self) -> None:
        """Nothing to free."""


class Adapter(Protocol):
    """One engine.

    An adapter may also state what its engine needs, by the attributes of `Requirements`.
    """

    name: str
    version: str
    methods: Mapping[str, Method]

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Return why this method cannot represent the scene, or None if it can."""

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a minimal model, without anything that is not in the scene."""


class Requirements(Protocol):
    """What the engine of an adapter needs, as attributes of its class; each of them is optional.

    The adapter's module must not import the engine at its top, so that these can be read where the engine is
    not installed.
    """

    distribution: str
    """The package that provides the engine, such as "drake": NAME==VERSION installs that version of it."""
    requires: tuple[str, ...]
    """Requirements in pip's notation, such as ("drake>=1.51",). Where they are not installed next to
    bodycheck, the engine runs in an environment of its own."""
    requires_python: str
    """The versions of Python of that environment, such as ">=3.12,<3.13" [default: the current one, or
    another one for which the requirements have wheels]."""
    system_library: str
    """A shared library of the system in place of a package, which ctypes loads, such as "ode"."""
    install: str
    """The command that installs this library, such as "apt install libode8"."""


class SolvingAdapter(Adapter, Protocol):
    """An engine some of whose methods are controlled by a tolerance or by nothing."""

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:
        """Build a solver for such a method; the tolerance is None for a method without control."""


_STATE: Mapping[Precision, float] = {"float64": 4e-15, "float32": 2e-6, "mixed": 2e-6}
"""Relative: some 18 eps, as a state goes through at most one change of axes."""
_BODY: Mapping[Precision, float] = {"float64": 1e-12, "float32": 8e-6, "mixed": 8e-6}
"""Relative, as an inertia may go through an eigendecomposition."""


def read_back_mismatch(
    scene: Scene, dt_s: float | None, found: ReadBack | TreeReadBack, precision: Precision = "float64"
) -> str | None:
    """Return how mass, inertia, step, gravity or initial state differ from the scene; None if they do not.

    Numbers are compared with those of the scene rounded to the precision of the method. A quaternion may have
    the opposite sign. For an engine whose positions and inertia refer to a pivot or a link, the tolerance is
    relative to those quantities. A state without attitude or without omega is a
    mismatch too, because it could not be compared.
    """
    if isinstance(found, TreeReadBack):
        return "the engine read back a tree, not one body"
    different = _differences(scene, dt_s, found, precision)
    if different and precision == "float64" and not _differences(scene, dt_s, found, "float32"):
        return f'the engine holds float32: state precision="float32" in its Method; {different[0]}'
    return "; ".join(different) or None


def _differences(scene: Scene, dt_s: float | None, found: ReadBack, precision: Precision) -> list[str]:
    body, initial = scene.body, scene.initial
    faults: list[str] = []
    arm = _arm(scene)
    swing = arm * float(np.linalg.norm(initial.omega_body)) if arm else 0.0

    state_slack, body_slack = _STATE[precision], _BODY[precision]
    real = np.float64 if precision == "float64" else np.float32

    def compare(
        name: str,
        expected: Array | float,
        stored: Array | float,
        relative: float = state_slack,
        extra: float = 0.0,
    ) -> None:
        with np.errstate(over="ignore"):
            expected = np.asarray(expected, dtype=real).astype(np.float64)
        stored = np.asarray(stored, dtype=np.float64)
        if np.array_equal(expected, stored):  # the common case, and much faster
            return
        slack = relative * (float(np.max(np.abs(expected))) + extra)
        if stored.shape != expected.shape or not np.all(np.abs(stored - expected) <= slack):
            faults.append(f"{name} is {_words(stored)} in the engine, not {_words(expected)}")

    compare("mass", body.mass, found.mass)
    compare("inertia", body.inertia, found.inertia, body_slack, body.mass * arm * arm)
    if dt_s is not None:
        compare("step", dt_s, math.nan if found.dt_s is None else found.dt_s)
    compare("gravity", scene.gravity, found.gravity)
    state = found.state
    compare("position", initial.position, state.position, extra=arm)
    compare("velocity", initial.velocity, state.velocity, extra=swing)
    if state.quaternion is None and state.rotation is None:
        faults.append("the engine returns neither a quaternion nor a rotation")
    if state.omega_body is None and state.omega_world is None:
        faults.append("the engine returns no omega")
    if state.quaternion is not None:
        is_opposite = state.quaternion.shape == (4,) and float(state.quaternion @ initial.quaternion) < 0.0
        compare("quaternion", initial.quaternion, -state.quaternion if is_opposite else state.quaternion)
    if state.rotation is not None:
        compare("rotation", initial.rotation, state.rotation)
    # an engine that stores the angular momentum computes omega by solving I omega = L
    through_momentum = float(np.linalg.cond(body.inertia) * np.linalg.norm(initial.omega_body))
    if state.omega_body is not None:
        compare("omega_body", initial.omega_body, state.omega_body, extra=through_momentum)
    if state.omega_world is not None:
        compare("omega_world", initial.omega_world, state.omega_world, extra=through_momentum)
    return faults


def _arm(scene: Scene) -> float:
    """Return the distances in m from the centre of mass to the possible reference points, summed."""
    link = 0.0 if scene.link is None else float(np.linalg.norm(scene.link.offset))
    return link if scene.pivot is None else link + float(np.linalg.norm(scene.pivot))


def _words(value: Array) -> str:
    return np.array2string(value, precision=17, separator=", ", floatmode="unique").replace("\n", "")
