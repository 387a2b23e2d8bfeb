"""The contract between bodycheck and an engine.

An adapter is an object with the attributes of `Adapter`; nothing is inherited. `build` gives a
`Simulation` of one scene by one method at one step. The caller reads it back, applies the wrench of
each leg, advances it, and reads the state at each sample; building, reading and comparing are never
timed, only `apply` and `advance` are. A method without steps of a given length, controlled by a
tolerance or by nothing, gives a `Solver` instead (`SolvingAdapter`), which goes through all samples in
one call.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import Wrench

Stepping: TypeAlias = Literal["native", "python"]
VARIANT = "@"
"""Parts the name of a variant into the method and how the engine is set up: METHOD@VARIANT."""
DEFAULTS = f"{VARIANT}defaults"
"""The end of a method's name that leaves the engine's defaults as they are."""
UNALIGNED = f"{VARIANT}unaligned"
"""The end of a method's name that steps a free body by its link's origin, wherever that is."""
Control: TypeAlias = Literal["dt", "tolerance", "none"]
BuildKind: TypeAlias = Literal["installed", "development", "plug-in", "handed over"]
"""installed: a release of an engine that bodycheck knows. development: such an engine, editable or in a
source folder. plug-in: of another package. handed over: an object of the run's own process."""


@dataclass(frozen=True)
class Method:
    """One integrator or mode of an engine, and what is known of it.

    order is that of a smooth, torque-free motion in theory, None where there is none to expect.
    evaluations counts right-hand sides in a step. torque says when a torque is evaluated: at every
    stage, once and held over the step, or nowhere but in a closed form; lasting says the same of loads that
    vary with the time or the motion, a user's function among them: held, they make any method one of order 1.
    control says what it is told: the step, a tolerance, or nothing; tolerances are those that a run uses
    unless told otherwise.
    """

    name: str
    formula: str
    order: int | None
    evaluations: int | None
    torque: Literal["every stage", "held over the step", "in closed form"]
    keeps: str
    source: str
    control: Control = "dt"
    changed_defaults: tuple[str, ...] = ()
    tolerances: tuple[float, ...] = ()
    lasting: Literal["every stage", "held over the step", "in closed form"] = "held over the step"

    @property
    def on_request(self) -> bool:
        """Whether this is a variant of another method, which runs only where its name is requested."""
        return VARIANT in self.name

    @property
    def is_for_off_centre_links(self) -> bool:
        """Whether this variant runs without a request too where a link is off the centre of mass."""
        return self.name.endswith(UNALIGNED)


@dataclass(frozen=True)
class Build:
    """What a worker has loaded of an engine.

    id: a hash over all parts, by which answers of earlier runs are found again; empty where it is not known,
    and then every case is run again. kind: where the engine comes from. parts: what the hash is over, by
    name, for people.
    """

    id: str = ""
    kind: BuildKind = "plug-in"
    parts: Mapping[str, str] = field(default_factory=dict)

    @property
    def short(self) -> str:
        """As many digits of the identity as a table shows."""
        return self.id[:12]


@dataclass(frozen=True, eq=False)
class Engine:
    """An engine as it announces itself: its name, its version, its methods by name, what it has loaded."""

    name: str
    version: str
    methods: Mapping[str, Method]
    build: Build = Build()


@dataclass(frozen=True)
class Setting:
    """How finely a method is told to work: by a step in s, by a tolerance, or, with neither, not at all."""

    dt_s: float | None = None
    tolerance: float | None = None

    @property
    def fineness(self) -> float | None:
        """The one number of it."""
        return self.tolerance if self.dt_s is None else self.dt_s


@dataclass(frozen=True, eq=False)
class Reading:
    """The state as the engine itself holds it.

    position (3,) in m and velocity (3,) in m/s of the centre of mass in world axes, quaternion (4,) scalar
    first and/or rotation (3, 3), body to world, omega (3,) in rad/s in one of the two axes.
    rotation is filled only with a matrix that the engine itself gives for this very state.
    """

    position: Array
    velocity: Array
    quaternion: Array | None = None
    rotation: Array | None = None
    omega_world: Array | None = None
    omega_body: Array | None = None


@dataclass(frozen=True, eq=False)
class ReadBack:
    """What the engine says it was given.

    mass in kg, inertia (3, 3) in kg m^2 in body axes, the step in s (of one step, where one call makes
    several; None of a method without), gravity (3,) in m/s^2, and the initial state.
    """

    mass: float
    inertia: Array
    dt_s: float | None
    gravity: Array
    state: Reading


class Simulation(Protocol):
    """One scene in one engine, by one method, at one step. Always closed after use.

    The scene's timed loads are handed over by `apply`; its lasting loads act from the start, and the
    simulation answers for them itself.
    """

    stepping: Stepping
    """native: one call makes many steps; python: a Python call for each step."""

    def read_back(self) -> ReadBack:
        """Return what the engine holds, asked from the engine and not from what it was given."""

    def reset(self) -> None:
        """Go back to the initial state at t = 0, as freshly built."""

    def apply(self, wrench: Wrench) -> None:
        """Let this wrench act, in place of the one before, until told otherwise."""

    def advance(self, steps: int) -> None:
        """Make this many steps."""

    def read(self) -> Reading:
        """Return copies of the state that the engine holds now."""

    def close(self) -> None:
        """Free what the engine holds; calling it twice does nothing."""


class Solver(Protocol):
    """One scene in one engine, by one method that chooses its own steps or has none. Closed after use."""

    steps: int | None
    """How many steps the last `solve` made; None for a method that has none."""

    def read_back(self) -> ReadBack:
        """Return what the engine holds, its step being None."""

    def solve(self) -> Trajectory:
        """Go from the initial state through all the scene's samples, anew at every call."""

    def close(self) -> None:
        """Free what the engine holds; calling it twice does nothing."""


class Adapter(Protocol):
    """One engine."""

    name: str
    version: str
    methods: Mapping[str, Method]

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Return why this method cannot represent the scene, or None if it can."""

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Make a minimal model: nothing in it that the scene has not."""


class SolvingAdapter(Adapter, Protocol):
    """An engine some of whose methods are controlled by a tolerance or by nothing."""

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:
        """Make a solver by such a method; the tolerance is None for one that has no control."""


_STATE = 4e-15  # relative: a state passes at most through one change of axes
_BODY = 1e-12  # relative: an inertia may have been through an eigen-analysis


def read_back_mismatch(scene: Scene, dt_s: float | None, found: ReadBack) -> str | None:
    """Say which of mass, inertia, step, gravity or initial state the engine holds wrongly, or None.

    A quaternion may have changed its sign. What an engine holds of a place or an inertia with reference to
    a pivot or to a link is compared to a part of that. A state without an attitude, or without omega, is a
    mismatch too: nothing would have been compared.
    """
    body, initial = scene.body, scene.initial
    faults: list[str] = []
    arm = _arm(scene)
    swing = arm * float(np.linalg.norm(initial.omega_body)) if arm else 0.0

    def compare(
        name: str, asked: Array | float, held: Array | float, relative: float = _STATE, beside: float = 0.0
    ) -> None:
        asked, held = np.asarray(asked, dtype=np.float64), np.asarray(held, dtype=np.float64)
        if np.array_equal(asked, held):  # as nearly always: it saves the rest a thousand times a run
            return
        slack = relative * (float(np.max(np.abs(asked))) + beside)
        if held.shape != asked.shape or not np.all(np.abs(held - asked) <= slack):
            faults.append(f"{name} is {_words(held)} in the engine, not {_words(asked)}")

    compare("mass", body.mass, found.mass)
    compare("inertia", body.inertia, found.inertia, _BODY, body.mass * arm * arm)
    if dt_s is not None:
        compare("step", dt_s, math.nan if found.dt_s is None else found.dt_s)
    compare("gravity", scene.gravity, found.gravity)
    state = found.state
    compare("position", initial.position, state.position, beside=arm)
    compare("velocity", initial.velocity, state.velocity, beside=swing)
    if state.quaternion is None and state.rotation is None:
        faults.append("the engine gives back no quaternion and no rotation")
    if state.omega_body is None and state.omega_world is None:
        faults.append("the engine gives back no omega")
    if state.quaternion is not None:
        turned = state.quaternion.shape == (4,) and float(state.quaternion @ initial.quaternion) < 0.0
        compare("quaternion", initial.quaternion, -state.quaternion if turned else state.quaternion)
    if state.rotation is not None:
        compare("rotation", initial.rotation, state.rotation)
    # an engine that holds the angular momentum has omega by solving I omega = L
    through_momentum = float(np.linalg.cond(body.inertia) * np.linalg.norm(initial.omega_body))
    if state.omega_body is not None:
        compare("omega_body", initial.omega_body, state.omega_body, beside=through_momentum)
    if state.omega_world is not None:
        compare("omega_world", initial.omega_world, state.omega_world, beside=through_momentum)
    return "; ".join(faults) or None


def _arm(scene: Scene) -> float:
    """The distances in m from the centre of mass to where an engine may have its reference."""
    link = 0.0 if scene.link is None else float(np.linalg.norm(scene.link.offset))
    return link if scene.pivot is None else link + float(np.linalg.norm(scene.pivot))


def _words(value: Array) -> str:
    return np.array2string(value, precision=17, separator=", ", floatmode="unique").replace("\n", "")
