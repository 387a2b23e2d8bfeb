"""Continuous loads, pivots and link frames in every engine: maps, orders and invariance."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.adapters.contract import Adapter, Simulation, read_back_mismatch
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.kinds.magnetic_dipole import MagneticDipole
from bodycheck.reference_impl.loads.load import ContinuousLoad
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    Link,
    Load,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
    TorsionSpring,
)
from bodycheck.reference_impl.wrench import wrench_between
from tests.helpers.engine_methods import ADAPTERS, adapter_of, engine_methods, state_of
from tests.helpers.first_order_maps import SpinStep, explicit_step, implicit_gyroscopic_step, implicit_step
from tests.helpers.textbook_motion import solved_end, wrench_at


def stepping(adapter: Adapter, method: str) -> bool:
    """Return whether a method runs by default and has a step."""
    facts = adapter.methods[method]
    return facts.control == "dt" and not facts.on_request


METHODS = engine_methods(ADAPTERS, stepping)
every_method = pytest.mark.parametrize(("adapter", "method"), METHODS)

INERTIA = np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]])
LOADS: dict[str, tuple[Load, ...]] = {
    "sine torque in body axes": (SineTorque("body", np.array([0.9, -1.2, 0.7]), 2.3, 0.4),),
    "sine torque in world axes": (SineTorque("world", np.array([0.9, -1.2, 0.7]), 2.3, 0.4),),
    "drag": (Drag(0.8, np.array([[0.5, 0.1, 0.0], [-0.2, 0.4, 0.1], [0.0, 0.3, 0.6]])),),
    "spring": (Spring(np.array([1.0, 0.5, -0.3]), np.array([0.4, -0.1, 0.2]), 3.0, 0.5),),
    "torsion spring": (TorsionSpring(2.5),),
    "gravity gradient": (GravityGradient(0.9),),
    "magnetic dipole": (MagneticDipole(np.array([0.8, -0.5, 0.6]), np.array([0.9, 0.7, -1.1])),),
}
LOADS["with constant ones"] = (
    *LOADS["spring"],
    Torque("body", np.array([0.3, -0.2, 0.1])),
    Torque("world", np.array([0.1, 0.3, -0.2])),
    PointForce("body", np.array([0.5, 0.3, -0.8]), np.array([0.2, -0.4, 0.3])),
    PointForce("world", np.array([-0.4, 0.3, 0.6]), np.array([0.5, 0.1, 0.0])),
    PointForce("world", np.array([0.2, 0.1, -0.3]), np.zeros(3)),
)


def of_everything(t: float, x: Array, r: Array, v: Array, omega: Array) -> tuple[Array, Array]:
    """Return a force and a torque that depend on every argument of the function."""
    force = -2.0 * x - 0.3 * v + np.sin(3.0 * t) * r[:, 0]
    torque = np.array([np.sin(2.0 * t), r[1, 2], -0.4]) - 0.2 * omega + np.cross(x, v)
    return force, torque


LOADS["a function"] = (CallbackLoad("loads:of_everything", of_everything), *LOADS["with constant ones"])
every_load = pytest.mark.parametrize("loads", LOADS.values(), ids=LOADS.keys())
PIVOT = np.array([0.1, -0.2, -0.7])


def scene_of(loads: tuple[Load, ...] = (), pivot: Array | None = None) -> Scene:
    """Return a scene of one second under gravity."""
    quaternion = np.array([0.5, -0.1, 0.7, 0.3])
    start = State(
        position=np.array([0.3, -0.2, 0.1]),
        quaternion=quaternion / np.linalg.norm(quaternion),
        velocity=np.array([0.3, 0.1, -0.2]),
        omega_body=np.array([0.9, 1.3, -0.8]),
    )
    if pivot is not None:
        start = replace(start, velocity=np.cross(start.omega_world, start.rotation @ -pivot))
    gravity = np.array([0.2, -0.1, -1.8])
    return Scene(RigidBody(1.3, INERTIA), start, loads, gravity, duration_s=1.0, samples=2, pivot=pivot)


def supports(adapter: Adapter, scene: Scene, method: str) -> bool:
    """Return whether the method supports the scene; otherwise it must have a reason."""
    reason = adapter.unsupported(scene, method)
    assert reason is None or len(reason) > 10
    return reason is None


@contextmanager
def built(adapter: Adapter, scene: Scene, method: str, dt_s: float) -> Iterator[Simulation]:
    """Build a simulation with all loads applied, and close it."""
    simulation = adapter.build(scene, method, dt_s)
    simulation.apply(wrench_between(scene, 0.0, scene.duration_s))
    try:
        yield simulation
    finally:
        simulation.close()


Motion = tuple[Array, Array, Array, Array]


def gap(one: Motion, other: Motion) -> float:
    """Return the largest difference in any component."""
    return max(float(np.max(np.abs(a - b))) for a, b in zip(one, other, strict=True))


def moment_of_inertia(scene: Scene) -> Array:
    """Return the tensor about the pivot, or about the centre of mass of a free body."""
    if scene.pivot is None:
        return scene.body.inertia
    c = scene.pivot
    return scene.body.inertia + scene.body.mass * (c @ c * np.eye(3) - np.outer(c, c))


def accelerations(scene: Scene, t: float, x: Array, r: Array, v: Array, w: Array) -> tuple[Array, Array]:
    """Return v' of a free body, world axes, and the moment about pivot or centre of mass, body axes."""
    force, torque = wrench_at(scene, t, x, r, v, r @ w)
    arm = np.zeros(3) if scene.pivot is None else r @ -scene.pivot
    return force / scene.body.mass, r.T @ (torque + np.cross(arm, force))


def seen(scene: Scene, x: Array, r: Array, v: Array, w: Array) -> tuple[Array, Array]:
    """Return position and velocity of the centre of mass, which the rotation determines at a pivot."""
    if scene.pivot is None:
        return x, v
    arm = r @ -scene.pivot
    place = scene.initial.position + scene.initial.rotation @ scene.pivot
    return place + arm, np.cross(r @ w, arm)


def test_loads_contain_every_continuous_kind() -> None:
    """The loads of these tests include each kind of continuous load."""
    kinds = {kind for kind, load in load_kinds().items() if issubclass(load, ContinuousLoad)}
    assert {load.kind for loads in LOADS.values() for load in loads} >= kinds


# ------------------------------------------------------------------------------------------ the maps

FREE: dict[str, SpinStep] = {
    **dict.fromkeys(
        ("mujoco:euler", "pybullet:multibody", "dart:semi-implicit", "reference:m1"), explicit_step
    ),
    **dict.fromkeys(
        ("mujoco:implicit", "mujoco:implicitfast", "mujoco:discrete", "reference:m2"), implicit_step
    ),
    **dict.fromkeys(("pybullet:maximal", "reference:m3"), implicit_gyroscopic_step),
}
# on a ball joint MuJoCo has no gyroscopic derivative in implicitfast and discrete
PIVOTED: dict[str, SpinStep] = {
    **FREE,
    **dict.fromkeys(("mujoco:implicitfast", "mujoco:discrete"), explicit_step),
}


@cache  # methods with the same map share its motion
def mapped(
    loads: tuple[Load, ...], spin_step: SpinStep, h: float, steps: int, *, pivoted: bool = False
) -> Motion:
    """Return the state after these steps of a semi-implicit map, with loads constant over each step."""
    scene = scene_of(loads, PIVOT if pivoted else None)
    start, inertia = scene.initial, moment_of_inertia(scene)
    x, v, w = start.position, start.velocity, start.omega_body
    turn = Rotation.from_quat(start.quaternion, scalar_first=True)
    for step in range(steps):
        r = turn.as_matrix()
        linear_acceleration, moment = accelerations(scene, step * h, x, r, v, w)
        w = w + spin_step(inertia, w, moment, h)
        v = v + h * linear_acceleration
        turn = turn * Rotation.from_rotvec(h * w)
        x, v = seen(scene, x + h * v, turn.as_matrix(), v, w)
    return x, v, turn.as_matrix(), w


def mapped_methods(maps: dict[str, SpinStep]) -> pytest.MarkDecorator:
    """Return the mark for the methods with a known map."""
    known = [case for case in METHODS if case.id in maps or case.values[0] is None]
    return pytest.mark.parametrize(("adapter", "method"), known)


@pytest.mark.slow
@mapped_methods(FREE)
@every_load
def test_step_under_zero_order_hold_equals_its_map(
    adapter: Adapter, method: str, loads: tuple[Load, ...]
) -> None:
    """100 steps of 1e-2 s end within 1e-12 of the map with all loads evaluated at the start of each step."""
    scene = scene_of(loads)
    with built(adapter, scene, method, 1e-2) as simulation:
        simulation.advance(60)
        simulation.advance(40)
        found = state_of(simulation.read())
    assert gap(found, mapped(loads, FREE[f"{adapter.name}:{method}"], 1e-2, 100)) < 1e-12


@pytest.mark.slow(after=24)
@mapped_methods(PIVOTED)
@every_load
def test_step_about_a_pivot_equals_its_map(adapter: Adapter, method: str, loads: tuple[Load, ...]) -> None:
    """With a pivot the map is that of the rotation about it, with the moments of all loads and the weight."""
    scene = scene_of(loads, PIVOT)
    if supports(adapter, scene, method):
        with built(adapter, scene, method, 1e-2) as simulation:
            simulation.advance(100)
            found = state_of(simulation.read())
        expected = mapped(loads, PIVOTED[f"{adapter.name}:{method}"], 1e-2, 100, pivoted=True)
        assert gap(found, expected) < 1e-12


@pytest.mark.slow
@pytest.mark.nightly(after=9)
@every_method
@pytest.mark.parametrize("pivot", [None, PIVOT], ids=["free", "pivoted"])
def test_callback_load_equals_the_loads_it_computes(
    adapter: Adapter, method: str, pivot: Array | None
) -> None:
    """A callback that computes loads of every kind moves a body as the loads themselves do, to round-off."""
    kinds = [name for name in LOADS if not (pivot is not None and name == "gravity gradient")]
    scene = scene_of(tuple(load for name in kinds[:-1] for load in LOADS[name]), pivot)
    weightless = replace(scene, loads=scene.continuous_loads, gravity=np.zeros(3))

    def function(t: float, x: Array, r: Array, v: Array, omega: Array) -> tuple[Array, Array]:
        return wrench_at(weightless, t, x, r, v, omega)

    hidden = replace(scene, loads=(CallbackLoad("loads:function", function), *scene.piecewise_constant_loads))
    if (adapter.name, method) == ("reference", "euler"):
        return  # its R does not stay a rotation, so two formulas for one load differ
    if not (supports(adapter, scene, method) and supports(adapter, hidden, method)):
        return
    ends = []
    for each in (scene, hidden):
        with built(adapter, each, method, 1e-2) as simulation:
            simulation.advance(60)
            simulation.advance(40)
            ends.append(state_of(simulation.read()))
            stepping = simulation.stepping
    assert gap(*ends) < 1e-12
    assert stepping == "python"


# ---------------------------------------------------------------------------------------- the orders


def solved(scene: Scene) -> Motion:
    """Return the end of the textbook's motion, about the pivot where there is one."""

    def wrench(t: float, x: Array, r: Array, v: Array, omega: Array) -> tuple[Array, Array]:
        w = r.T @ omega
        x, v = seen(scene, x, r, v, w)
        acceleration, moment = accelerations(scene, t, x, r, v, w)
        return scene.body.mass * acceleration, r @ moment

    body = RigidBody(scene.body.mass, moment_of_inertia(scene))
    end = solved_end(body, scene.initial, wrench, scene.duration_s)
    found = seen(scene, end.position, end.rotation, end.velocity, end.omega_body)
    return *found, end.rotation, end.omega_body


@cache
def solved_under(name: str, *, pivoted: bool) -> Motion:
    """Solve the scene under these loads once for all methods."""
    return solved(scene_of(LOADS[name], PIVOT if pivoted else None))


# order -> the numbers of steps
REFINEMENTS: dict[int, tuple[int, ...]] = {
    1: (128, 256, 512),
    2: (64, 128, 256),
    3: (32, 48, 64),
    4: (16, 24, 32),
    5: (6, 8, 12),
    6: (2, 3, 4, 6),
    7: (2, 3, 4, 6, 8),
    8: (1, 2, 3, 4, 6, 8),
}


@pytest.mark.slow
@pytest.mark.nightly(after=25)
@every_method
@pytest.mark.parametrize("pivoted", [False, True], ids=["free", "pivoted"])
@pytest.mark.parametrize("name", LOADS)
def test_order_is_one_under_zero_order_hold(adapter: Adapter, method: str, name: str, pivoted: bool) -> None:
    """Position, velocity, orientation and omega converge at the order that the facts imply."""
    scene, facts = scene_of(LOADS[name], PIVOT if pivoted else None), adapter.methods[method]
    if not supports(adapter, scene, method):
        return
    order = facts.order if facts.continuous_loads == "every stage" else 1
    assert order is not None
    truth = solved_under(name, pivoted=pivoted)
    errors: dict[int, float] = {}
    for n in REFINEMENTS[order]:
        with built(adapter, scene, method, scene.duration_s / n) as simulation:
            simulation.advance(n)
            errors[n] = gap(state_of(simulation.read()), truth)
    resolved_errors = {n: error for n, error in errors.items() if error > 5e-13}
    steps = list(resolved_errors)[-3:]
    assert len(steps) == 3
    slope = -np.polyfit(np.log(steps), np.log([resolved_errors[n] for n in steps]), 1)[0]
    assert slope > order - 0.4
    assert order > 1 or slope < 1.2


# -------------------------------------------------------------------------------------- the heavy top

TOP = Scene(
    RigidBody(1.0, np.diag([1.0, 2.0, 3.0])),
    State(
        position=np.array([0.0, -np.sin(0.5), np.cos(0.5)]),
        quaternion=np.array([np.cos(0.25), np.sin(0.25), 0.0, 0.0]),
        velocity=np.zeros(3),
        omega_body=np.array([0.1, 0.2, 5.0]),
    ),
    (),
    np.array([0.0, 0.0, -9.81]),
    duration_s=2.0,
    samples=2,
    pivot=np.array([0.0, 0.0, -1.0]),
)
TOP = replace(
    TOP, initial=replace(TOP.initial, velocity=np.cross(TOP.initial.omega_world, TOP.initial.position))
)


@pytest.mark.slow(after=1)
@pytest.mark.nightly(after=3)
@pytest.mark.parametrize(
    ("engine", "method", "expected"),
    [
        ("mujoco", "euler", 1.69e-3),
        ("mujoco", "implicitfast", 1.69e-3),
        ("mujoco", "implicit", 2.56e-3),
        ("pybullet", "multibody", 1.69e-3),
        ("dart", "semi-implicit", 1.69e-3),
        ("reference", "m1", 1.69e-3),
    ],
)
def test_heavy_top_has_the_measured_error(engine: str, method: str, expected: float) -> None:
    """The heavy top's angle after 2 s has the error recorded for each engine at 1e-3 s."""
    pytest.importorskip({"dart": "dartpy", "reference": "numpy"}.get(engine, engine))
    adapter = adapter_of(engine)
    with built(adapter, TOP, method, 1e-3) as simulation:
        simulation.advance(2000)
        found = state_of(simulation.read())[2]
    angle = Rotation.from_matrix(solved(TOP)[2].T @ found).magnitude()
    assert angle == pytest.approx(expected, rel=6e-3)


@pytest.mark.parametrize("engine", ["mujoco", "reference"])
def test_heavy_top_by_rk4_is_exact_to_1e_11(engine: str) -> None:
    """A method that rotates the weight's moment at each stage is accurate to 1e-11 at 1e-3 s."""
    pytest.importorskip({"reference": "numpy"}.get(engine, engine))
    adapter = adapter_of(engine)
    with built(adapter, TOP, "rk4", 1e-3) as simulation:
        simulation.advance(2000)
        found = state_of(simulation.read())
    assert gap(found, solved(TOP)) < 1e-11


# ------------------------------------------------------------------------------------------ invariance

ANY_TURN = Rotation.from_rotvec([0.4, -1.1, 0.6]).as_quat(scalar_first=True)
LINKS = {
    "elsewhere": Link(np.array([0.3, -0.4, 0.2]), np.array([1.0, 0.0, 0.0, 0.0])),
    "turned": Link(np.zeros(3), ANY_TURN),
    "both": Link(np.array([0.0, 0.7, -0.1]), ANY_TURN),
}


@pytest.mark.slow
@pytest.mark.nightly(after=12)
@every_method
@pytest.mark.parametrize("link", LINKS.values(), ids=LINKS.keys())
@pytest.mark.parametrize("pivot", [None, PIVOT], ids=["free", "pivoted"])
@pytest.mark.parametrize(
    "kind",
    [*(pytest.param(k, marks=pytest.mark.nightly) for k in ("drag", "with constant ones")), "a function"],
)
def test_link_frame_does_not_matter(
    adapter: Adapter, method: str, kind: str, pivot: Array | None, link: Link
) -> None:
    """An engine built in any frame of the body reads back and moves the same scene to round-off.

    Free bodies that are stepped with their link's origin are in test_link_variants.py.
    """
    scene = scene_of(LOADS[kind], pivot)
    linked = replace(scene, link=link)
    by_the_origin = adapter.name == "dart" and pivot is None and bool(np.any(link.offset))
    if by_the_origin or not supports(adapter, linked, method):
        return
    ends = []
    for each in (scene, linked):
        with built(adapter, each, method, 1e-2) as simulation:
            assert read_back_mismatch(each, 1e-2, simulation.read_back()) is None
            simulation.advance(100)
            ends.append(state_of(simulation.read()))
    assert gap(*ends) < 100 * 100 * float(np.finfo(np.float64).eps)


@pytest.mark.slow
@pytest.mark.nightly(after=16)
@every_method
@pytest.mark.parametrize("pivot", [None, PIVOT], ids=["free", "pivoted"])
def test_reset_resets_the_time(adapter: Adapter, method: str, pivot: Array | None) -> None:
    """A second run after reset is bit for bit the same, whatever time the first one ended at."""
    scene = scene_of(LOADS["sine torque in body axes"], pivot)
    with built(adapter, scene, method, 1e-2) as simulation:
        ends = []
        for _ in range(2):
            simulation.apply(wrench_between(scene, 0.0, 1.0))
            simulation.advance(37)
            ends.append(state_of(simulation.read()))
            simulation.reset()
    assert gap(*ends) == 0.0


@every_method
def test_pivot_stays_where_it_is(adapter: Adapter, method: str) -> None:
    """The pivot, computed from position and orientation of a reading, moves by round-off only."""
    scene = scene_of(LOADS["with constant ones"], PIVOT)
    if not supports(adapter, scene, method):
        return
    place = scene.initial.position + scene.initial.rotation @ PIVOT
    with built(adapter, scene, method, 1e-2) as simulation:
        assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None
        simulation.advance(200)
        position, velocity, r, omega = state_of(simulation.read())
    np.testing.assert_allclose(position + r @ PIVOT, place, rtol=0, atol=1e-14)
    if (
        method != "euler" or adapter.name != "reference"
    ):  # its R does not stay a rotation and no longer rotates omega
        np.testing.assert_allclose(velocity, r @ np.cross(omega, -PIVOT), rtol=0, atol=1e-13)


# ------------------------------------------------------------------------------ engines by default


def untouched(engine: str) -> Adapter:
    """Return the engine, or skip the test."""
    pytest.importorskip({"dart": "dartpy"}.get(engine, engine))
    adapter: Adapter = adapter_of(engine)
    return adapter


UNTOUCHED = [
    ("mujoco", "euler"),
    ("pybullet", "multibody"),
    ("pybullet", "maximal"),
    ("dart", "semi-implicit"),
]


@pytest.mark.parametrize(("engine", "method"), UNTOUCHED)
def test_engine_with_its_defaults_holds_and_moves_the_scene(engine: str, method: str) -> None:
    """With its defaults an engine reads back the scene and, except for damping, moves it in the same way."""
    adapter, scene = untouched(engine), scene_of(LOADS["with constant ones"])
    ends = []
    for name in (method, f"{method}@defaults"):
        assert adapter.methods[name].on_request == name.endswith("@defaults")
        with built(adapter, scene, name, 1e-2) as simulation:
            assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None
            simulation.advance(100)
            ends.append(state_of(simulation.read()))
    assert (gap(*ends) > 1e-2) == (method == "multibody")
    assert gap(*ends) < 1e-12 or method == "multibody"


def test_multibody_with_defaults_is_damped_and_clamped() -> None:
    """PyBullet's defaults slow a body to 0.9245 of its speed in one second, and 200 m/s to 100."""
    adapter = untouched("pybullet")
    slow = replace(scene_of(), gravity=np.zeros(3))
    slow = replace(slow, initial=replace(slow.initial, velocity=np.array([1.0, 0.0, 0.0])))
    fast = replace(slow, initial=replace(slow.initial, velocity=np.array([200.0, 0.0, 0.0])))
    speeds = []
    for scene in (slow, fast):
        with built(adapter, scene, "multibody@defaults", 1e-3) as simulation:
            simulation.advance(1000)
            speeds.append(float(simulation.read().velocity[0]))
    assert speeds[0] == pytest.approx(0.9245, abs=5e-4)
    assert speeds[1] <= 100.0
