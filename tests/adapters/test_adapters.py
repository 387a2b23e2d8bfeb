"""Laws that every method of every engine must satisfy, and the map that each engine's step must equal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.adapters.contract import DEFAULTS, VARIANT, Adapter, Reading, Simulation, read_back_mismatch
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle, matrix_to_quaternion
from bodycheck.reference_impl.scene import ConstantLoad, PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.wrench import Wrench, wrench_between
from tests.helpers.engine_methods import adapter_of, engine_methods, state_of
from tests.helpers.first_order_maps import SpinStep, explicit_step, implicit_gyroscopic_step, implicit_step
from tests.helpers.textbook_motion import solved_end, wrench_at

ENGINES = ("mujoco", "pybullet", "dart")

# The maps below, by method; each applies to all variants of the method. No map describes rk4.
EXPLICIT = ("mujoco:euler", "pybullet:multibody", "dart:semi-implicit")
IMPLICIT = ("mujoco:implicit", "mujoco:implicitfast", "mujoco:discrete")
IMPLICIT_GYROSCOPIC = ("pybullet:maximal",)


def methods(*, but: tuple[str, ...] = ()) -> list[Any]:
    """Return a test parameter (adapter, method) for each method of the engines that can be imported.

    but: parts of the names to leave out; methods with untouched defaults are left out too.
    """
    return engine_methods(ENGINES, lambda _, method: not any(part in method for part in (*but, DEFAULTS)))


every_method = pytest.mark.parametrize(("adapter", "method"), methods())
# without a link an unaligned body is built like an aligned one; test_link_variants.py tests links
first_order_methods = pytest.mark.parametrize(("adapter", "method"), methods(but=("rk4", "@unaligned")))


@contextmanager
def built(adapter: Adapter, scene: Scene, method: str, dt_s: float) -> Iterator[Simulation]:
    """Build a simulation, and close it."""
    assert adapter.unsupported(scene, method) is None
    simulation = adapter.build(scene, method, dt_s)
    try:
        yield simulation
    finally:
        simulation.close()


DIAGONAL = np.diag([1.0, 2.0, 3.0])
TILT = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
FULL = TILT @ np.diag([0.7, 1.9, 2.3]) @ TILT.T
FULL = 0.5 * (FULL + FULL.T)
ROTATED_PLATE = TILT @ np.diag([1.0, 2.0, 3.0]) @ TILT.T
ROTATED_PLATE = 0.5 * (ROTATED_PLATE + ROTATED_PLATE.T)

BODIES = {
    "diagonal": RigidBody(1.3, DIAGONAL),
    "unsorted": RigidBody(1.3, np.diag([3.0, 1.0, 2.5])),
    "full": RigidBody(1.3, FULL),
    "plate": RigidBody(1.0 / 3.0, np.diag([0.1, 0.2, 0.1 + 0.2])),
    "plate beyond the limit by a round-off": RigidBody(1.0, np.diag([1.0, 2.0, np.nextafter(3.0, 4.0)])),
    "rotated plate": RigidBody(1.0, ROTATED_PLATE),
    "sphere": RigidBody(1.0 / 3.0, np.eye(3) / 7.0),
    "1e-9 kg": RigidBody(1e-9 / 3.0, 1e-9 * FULL),
    "1e9 kg": RigidBody(1e9 / 3.0, 1e9 * FULL),
}

LOADS: dict[str, tuple[ConstantLoad, ...]] = {
    "free": (),
    "body torque": (Torque("body", np.array([0.3, -0.2, 0.1])),),
    "world torque": (Torque("world", np.array([0.3, -0.2, 0.1])),),
    "central body force": (PointForce("body", np.array([0.5, 0.3, -0.8]), np.zeros(3)),),
    "central world force": (PointForce("world", np.array([0.5, 0.3, -0.8]), np.zeros(3)),),
    "body force": (PointForce("body", np.array([0.5, 0.3, -0.8]), np.array([0.2, -0.4, 0.3])),),
    "world force": (PointForce("world", np.array([0.5, 0.3, -0.8]), np.array([0.2, -0.4, 0.3])),),
}
LOADS["everything"] = (
    *(load for loads in LOADS.values() for load in loads),
    PointForce("world", np.array([-0.1, 0.2, 0.4]), np.array([0.5, 0.1, 0.0])),
)


def scene_of(
    body: RigidBody = BODIES["full"],
    loads: tuple[ConstantLoad, ...] = (),
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Scene:
    """Return a scene with an initial position, rotation and motion that are not zero."""
    quaternion = np.array([0.5, -0.1, 0.7, 0.3])
    initial = State(
        position=np.array([3.0, -2.0, 1.0]),
        quaternion=quaternion / np.linalg.norm(quaternion),
        velocity=np.array([0.3, 0.1, -0.2]),
        omega_body=np.array([0.1, 2.0, 0.1]),
    )
    return Scene(body, initial, loads, np.array(gravity), duration_s=2.0, samples=3)


def wrench_of_all(scene: Scene) -> Wrench:
    """Return the wrench of loads that act from the start to the end."""
    return wrench_between(scene, 0.0, scene.duration_s)


def packed(reading: Reading) -> Array:
    """Return all values of a reading in one array."""
    parts = [getattr(reading, name) for name in Reading.__dataclass_fields__]
    return np.concatenate([np.ravel(part) for part in parts if part is not None])


@every_method
def test_method_states_its_facts(adapter: Adapter, method: str) -> None:
    """A method has a lower-case name, a formula, what it conserves and the source of these facts."""
    facts = adapter.methods[method]
    assert facts.name == method == method.lower()
    assert facts.formula
    assert facts.conserves
    assert facts.source
    assert facts.changed_defaults
    assert adapter.version


# ---------------------------------------------------------------------------------- the simulated scene


@every_method
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES.keys())
def test_engine_reads_back_the_scene(adapter: Adapter, method: str, body: RigidBody) -> None:
    """Mass, inertia, step, gravity and initial state are read back from the engine as given."""
    scene = scene_of(body, gravity=(0.1, -0.2, -9.81))
    with built(adapter, scene, method, 1.0 / 300.0) as simulation:
        assert read_back_mismatch(scene, 1.0 / 300.0, simulation.read_back()) is None


@every_method
def test_engine_reads_back_any_initial_state(adapter: Adapter, method: str) -> None:
    """Any initial state is read back: half turns, large numbers, and small numbers next to large ones."""
    rng = np.random.default_rng(20)
    for _ in range(25):
        quaternion = rng.normal(size=4) * np.array([rng.choice([0.0, 1e-12, 1e-6, 1.0]), 1.0, 1.0, 1.0])
        initial = State(
            position=rng.normal(size=3) * 10.0 ** rng.integers(-6, 6),
            quaternion=quaternion / np.linalg.norm(quaternion),
            velocity=rng.normal(size=3) * 10.0 ** rng.integers(-6, 6),
            omega_body=rng.normal(size=3) * 10.0 ** rng.integers(-6, 6),
        )
        scene = replace(scene_of(), initial=initial)
        with built(adapter, scene, method, 1e-3) as simulation:
            assert read_back_mismatch(scene, 1e-3, simulation.read_back()) is None


def heavier(scene: Scene) -> Scene:
    """Increase the mass by a factor of 1 + 1e-12."""
    return replace(scene, body=replace(scene.body, mass=scene.body.mass * (1.0 + 1e-12)))


def stouter(scene: Scene) -> Scene:
    """Increase the inertia by a factor of 1 + 1e-11."""
    return replace(scene, body=replace(scene.body, inertia=scene.body.inertia * (1.0 + 1e-11)))


def mirrored(scene: Scene) -> Scene:
    """Change the sign of the products of inertia."""
    products = scene.body.inertia * (1.0 - np.eye(3))
    return replace(scene, body=replace(scene.body, inertia=scene.body.inertia - 2.0 * products))


def faster(scene: Scene) -> Scene:
    """Increase omega by a factor of 1 + 1e-13."""
    omega = scene.initial.omega_body * (1.0 + 1e-13)
    return replace(scene, initial=replace(scene.initial, omega_body=omega))


def lighter(scene: Scene) -> Scene:
    """Reduce gravity by a factor of 1 - 1e-13."""
    return replace(scene, gravity=scene.gravity * (1.0 - 1e-13))


@every_method
@pytest.mark.parametrize(
    ("plant", "named"),
    [(heavier, "mass"), (stouter, "inertia"), (mirrored, "inertia"), (faster, "omega"), (lighter, "gravity")],
)
def test_wrong_scene_in_the_engine_is_reported(
    adapter: Adapter, method: str, plant: Callable[[Scene], Scene], named: str
) -> None:
    """If an engine is built with a wrong mass, inertia, omega or gravity, the quantity is reported."""
    scene = scene_of(gravity=(0.0, 0.0, -9.81))
    with built(adapter, plant(scene), method, 1e-3) as simulation:
        assert named in str(read_back_mismatch(scene, 1e-3, simulation.read_back()))


@every_method
def test_wrong_step_in_the_engine_is_reported(adapter: Adapter, method: str) -> None:
    """If an engine is built with a wrong step, the step is reported."""
    scene = scene_of()
    with built(adapter, scene, method, 1e-3 * (1.0 + 1e-13)) as simulation:
        assert "step" in str(read_back_mismatch(scene, 1e-3, simulation.read_back()))


# --------------------------------------------------------------------------------------- the calls


@every_method
@pytest.mark.parametrize("kind", ["free", "everything"])
def test_reset_repeats_the_run_bitwise(adapter: Adapter, method: str, kind: str) -> None:
    """A second run after reset equals the first, and a run of a new simulation, bit for bit."""
    scene = scene_of(loads=LOADS[kind], gravity=(0.0, 0.0, -9.81))

    def run(simulation: Simulation) -> list[bytes]:
        simulation.apply(wrench_of_all(scene))
        digits = [packed(simulation.read()).tobytes()]
        for steps in (1, 20, 7):
            simulation.advance(steps)
            digits.append(packed(simulation.read()).tobytes())
        return digits

    with built(adapter, scene, method, 1e-2) as simulation:
        first = run(simulation)
        simulation.reset()
        assert run(simulation) == first
    with built(adapter, scene, method, 1e-2) as simulation:
        assert run(simulation) == first


@every_method
def test_reset_removes_the_wrench(adapter: Adapter, method: str) -> None:
    """After reset no wrench acts, as in a simulation that never received one."""
    scene = scene_of(loads=LOADS["everything"])
    with built(adapter, scene, method, 1e-2) as simulation:
        simulation.advance(5)
        never_loaded = packed(simulation.read())
        simulation.apply(wrench_of_all(scene))
        simulation.reset()
        simulation.advance(5)
        np.testing.assert_array_equal(packed(simulation.read()), never_loaded)


@every_method
@pytest.mark.parametrize("kind", LOADS)
@pytest.mark.parametrize("dt_s", [1e-2, pytest.param(1.0 / 300.0, marks=pytest.mark.nightly)])
def test_n_steps_in_one_call_equal_n_calls(adapter: Adapter, method: str, kind: str, dt_s: float) -> None:
    """n steps in one call end where n calls of one step end, within 1e-12."""
    scene = scene_of(loads=LOADS[kind], gravity=(0.2, 0.3, -9.81))
    for steps in (3, 49, 100):
        with built(adapter, scene, method, dt_s) as at_once, built(adapter, scene, method, dt_s) as singly:
            at_once.apply(wrench_of_all(scene))
            singly.apply(wrench_of_all(scene))
            at_once.advance(steps)
            for _ in range(steps):
                singly.advance(1)
            np.testing.assert_allclose(packed(at_once.read()), packed(singly.read()), rtol=0, atol=1e-12)


@every_method
def test_wrench_acts_until_the_next_replaces_it(adapter: Adapter, method: str) -> None:
    """Legs of constant wrenches end within 1e-12 of a loop that sets the wrench at each step."""
    loads = tuple(
        replace(load, from_s=0.01 * first, until_s=0.01 * (first + 9))
        for first, load in enumerate(LOADS["everything"], start=3)
    )
    scene = scene_of(loads=loads, gravity=(0.0, 0.0, -9.81))
    ends = {end for load in loads for end in (load.from_s, load.until_s)}
    edges = sorted({0, 30} | {round(100 * end) for end in ends})
    with built(adapter, scene, method, 1e-2) as by_legs, built(adapter, scene, method, 1e-2) as by_steps:
        for first, last in pairwise(edges):
            by_legs.apply(wrench_between(scene, first / 100, last / 100))
            by_legs.advance(last - first)
        for step in range(30):
            by_steps.apply(wrench_between(scene, step / 100, (step + 1) / 100))
            by_steps.advance(1)
        np.testing.assert_allclose(packed(by_legs.read()), packed(by_steps.read()), rtol=0, atol=1e-12)


@every_method
def test_simulations_are_independent(adapter: Adapter, method: str) -> None:
    """A run is bit for bit the same next to another simulation, and after others were closed twice."""
    scene = scene_of(loads=LOADS["body torque"], gravity=(0.0, 0.0, -9.81))
    other = scene_of(BODIES["plate"], gravity=(0.0, 1.0, 0.0))
    with built(adapter, scene, method, 1e-2) as alone:
        alone.apply(wrench_of_all(scene))
        alone.advance(20)
        expected = packed(alone.read())
    alone.close()
    with built(adapter, scene, method, 1e-2) as simulation, built(adapter, other, method, 1e-3) as beside:
        simulation.apply(wrench_of_all(scene))
        simulation.advance(10)
        beside.advance(10)
        simulation.advance(10)
        np.testing.assert_array_equal(packed(simulation.read()), expected)


@every_method
def test_readings_are_copies(adapter: Adapter, method: str) -> None:
    """A reading keeps its values when the engine continues."""
    with built(adapter, scene_of(), method, 1e-2) as simulation:
        reading = simulation.read()
        before = packed(reading).copy()
        simulation.advance(3)
        np.testing.assert_array_equal(packed(reading), before)


@every_method
def test_rotation_and_quaternion_are_of_the_same_state(adapter: Adapter, method: str) -> None:
    """The matrix and the quaternion of one reading agree to 1e-15 rad: neither is one step old."""
    with built(adapter, scene_of(), method, 1e-2) as simulation:
        simulation.advance(13)
        reading = simulation.read()
        assert reading.rotation is not None
        if reading.quaternion is not None:
            assert geodesic_angle(reading.quaternion, matrix_to_quaternion(reading.rotation)) < 1e-15


# -------------------------------------------------------------------------------------- the motion


def matrix_of(q: Array) -> Array:
    """R of a quaternion (w, x, y, z)."""
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


@cache  # methods with the same map share its motion
def mapped(
    body: str,
    kind: str,
    gravity: tuple[float, float, float],
    spin_step: SpinStep,
    h: float,
    steps: int,
    substeps: int,
) -> tuple[Array, Array, Array, Array]:
    """Return position, velocity, rotation and omega_body after these steps of the map.

    Within the substeps of a step the loads are constant in world axes.
    """
    scene = scene_of(BODIES[body], LOADS[kind], gravity)
    initial = scene.initial
    x, v, q, w = initial.position, initial.velocity, initial.quaternion, initial.omega_body
    for _ in range(steps):
        r = matrix_of(q)
        force, torque_world = wrench_at(scene, 0.0, x, r, v, r @ w)
        for _ in range(substeps):
            w = w + spin_step(scene.body.inertia, w, matrix_of(q).T @ torque_world, h / substeps)
            v = v + h / substeps * force / scene.body.mass
            x = x + h / substeps * v
            turned = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(h / substeps * w)
            q = turned.as_quat(scalar_first=True)
    return x, v, matrix_of(q), w


def spin_step_of(adapter: Adapter, method: str) -> SpinStep:
    """Return the function by which the method steps omega_body."""
    name = f"{adapter.name}:{method.partition(VARIANT)[0]}"
    if name in EXPLICIT:
        return explicit_step
    if name in IMPLICIT:
        return implicit_step
    assert name in IMPLICIT_GYROSCOPIC
    return implicit_gyroscopic_step


def substeps_of(method: str) -> int:
    """Return the number of steps of the map in one step of the method."""
    return 4 if method.endswith("@substeps") else 1


@first_order_methods
@pytest.mark.parametrize(
    "gravity",
    [
        pytest.param((0.0, 0.0, 0.0), id="weightless", marks=pytest.mark.nightly),
        pytest.param((0.3, -0.4, -9.81), id="heavy"),
    ],
)
@pytest.mark.parametrize(
    "body",
    [
        pytest.param("diagonal", marks=pytest.mark.nightly),
        "full",
        "plate beyond the limit by a round-off",
    ],
)
@pytest.mark.parametrize("kind", LOADS)
def test_step_equals_its_map(
    adapter: Adapter, method: str, kind: str, body: str, gravity: tuple[float, float, float]
) -> None:
    """100 steps of 1e-2 s end within 1e-11 of 100 steps of the method's map in plain numpy."""
    scene = scene_of(BODIES[body], LOADS[kind], gravity)
    with built(adapter, scene, method, 1e-2) as simulation:
        simulation.apply(wrench_of_all(scene))
        simulation.advance(100)
        found = state_of(simulation.read())
    spin_step, substeps = spin_step_of(adapter, method), substeps_of(method)
    expected = mapped(body, kind, gravity, spin_step, 1e-2, 100, substeps)
    for value, want in zip(found, expected, strict=True):
        np.testing.assert_allclose(value, want, rtol=0, atol=1e-11)


@first_order_methods
def test_semi_implicit_fall_is_ahead_by_half_a_step(adapter: Adapter, method: str) -> None:
    """After 10 s of free fall the position error is g h T / 2, within 1e-9 m.

    With substeps h is the length of a substep.
    """
    gravity = np.array([0.0, 0.0, -9.81])
    scene = scene_of(gravity=(0.0, 0.0, -9.81))
    with built(adapter, scene, method, 1e-3) as simulation:
        simulation.advance(10_000)
        position = simulation.read().position
    truth = scene.initial.position + 10.0 * scene.initial.velocity + 50.0 * gravity
    ahead = gravity * 1e-3 / substeps_of(method) * 10.0 / 2.0
    np.testing.assert_allclose(position - truth, ahead, rtol=0, atol=1e-9)


def true_motion(scene: Scene) -> tuple[Array, Array, Array, Array]:
    """Return the end of the textbook's motion as the tuple of state_of."""
    end = solved_end(scene.body, scene.initial, partial(wrench_at, scene), scene.duration_s)
    return end.position, end.velocity, end.rotation, end.omega_body


@pytest.mark.parametrize("kind", LOADS)
def test_rk4_is_of_order_4_under_every_load(kind: str) -> None:
    """MuJoCo's rk4 has order 4 +- 0.2, because loads are rotated with the body at each stage."""
    pytest.importorskip("mujoco")
    adapter = adapter_of("mujoco")
    scene = scene_of(loads=LOADS[kind], gravity=(0.0, 0.0, -9.81))
    truth = true_motion(scene)
    errors = []
    for dt_s in (0.04, 0.02):
        with built(adapter, scene, "rk4", dt_s) as simulation:
            simulation.apply(wrench_of_all(scene))
            simulation.advance(round(scene.duration_s / dt_s))
            found = state_of(simulation.read())
        errors.append([float(np.linalg.norm(a - b)) for a, b in zip(found, truth, strict=True)])
    coarse, fine = np.transpose([pair for pair in zip(*errors, strict=True) if pair[0] > 1e-10])
    orders = np.log2(coarse / fine)
    assert len(orders) >= 2
    np.testing.assert_allclose(orders, 4.0, atol=0.2)
