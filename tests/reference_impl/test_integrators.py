"""Laws that every fixed-step integrator must satisfy."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl import integrators
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators import INTEGRATORS, splitting
from bodycheck.reference_impl.integrators.facts import Integrator, Tableau
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.rotations import (
    exp_matrix,
    exp_quaternion,
    geodesic_angle,
    hat,
    matrix_to_quaternion,
    normalised,
    project_to_so3,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.wrench import wrench_between
from tests.helpers.textbook_motion import solved_end, wrench_at

EPS = float(np.finfo(np.float64).eps)

Load: TypeAlias = Torque | PointForce


def where(promised: Callable[[Integrator], bool]) -> pytest.MarkDecorator:
    """Return the mark for a law of the methods whose facts state it."""
    methods = [method for method in INTEGRATORS.values() if promised(method)]
    return pytest.mark.parametrize("method", methods, ids=[method.name for method in methods])


every_integrator = where(lambda _: True)


# ------------------------------------------------------------------------- scenes and their motions

TILT = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
TENSOR = TILT @ np.diag([2.0, 2.5, 3.0]) @ TILT.T
BODY = RigidBody(1.3, 0.5 * (TENSOR + TENSOR.T))
START = State(
    position=np.array([3.0, -2.0, 1.0]),
    quaternion=normalised(np.array([0.5, -0.1, 0.7, 0.3])),
    velocity=np.array([0.3, 0.1, -0.2]),
    omega_body=np.array([0.9, 1.3, -0.8]),
)
GRAVITY = np.array([0.2, -0.1, -9.81])

LOADS: dict[str, tuple[Load, ...]] = {
    "free": (),
    "body torque": (Torque("body", np.array([0.9, -1.2, 0.7])),),
    "world torque": (Torque("world", np.array([0.9, -1.2, 0.7])),),
    "body force": (PointForce("body", np.array([1.5, 0.9, -2.4]), np.array([0.6, -0.4, 0.5])),),
    "world force": (PointForce("world", np.array([1.5, 0.9, -2.4]), np.array([0.6, -0.4, 0.5])),),
}
LOADS["all at once"] = tuple(load for loads in LOADS.values() for load in loads)
every_load = pytest.mark.parametrize("loads", LOADS.values(), ids=LOADS.keys())


def scene_of(loads: tuple[Load, ...] = (), body: RigidBody = BODY, start: State = START) -> Scene:
    """Return a scene of one second in free space."""
    return Scene(body, start, loads, np.zeros(3), duration_s=1.0, samples=2)


def constant_loads(scene: Scene) -> list[Load]:
    """Return the loads of a scene, all of which must be of the kinds that these tests know."""
    known = [load for load in scene.loads if isinstance(load, Torque | PointForce)]
    assert len(known) == len(scene.loads)
    return known


@dataclass(frozen=True)
class Motion:
    """A state of any method in common quantities."""

    position: Array
    velocity: Array
    quaternion: Array
    """Unchanged, or that of the polar factor."""
    omega_body: Array
    momentum: Array
    """Angular momentum about the centre of mass, world axes."""
    attitude: Array
    """Quaternion or matrix, as the method stores it."""


def packed_start(scene: Scene, method: Integrator) -> Array:
    """Return the initial state in the variables of the method."""
    start, rotation = scene.initial, scene.initial.rotation
    spin = {
        "omega_body": start.omega_body,
        "omega_world": rotation @ start.omega_body,
        "angular_momentum": rotation @ scene.body.inertia @ start.omega_body,
    }[method.spin]
    attitude = start.quaternion if method.attitude == "quaternion" else rotation.ravel()
    return np.concatenate([start.position, start.velocity, spin, attitude])


def packed_load(scene: Scene) -> Array:
    """Return the load of a scene whose loads act from beginning to end."""
    return wrench_between(scene, 0.0, scene.duration_s).packed(scene.body, scene.gravity)


def unpacked(state: Array, scene: Scene, method: Integrator) -> Motion:
    """Return the method's state in the common quantities."""
    attitude = state[9:] if method.attitude == "quaternion" else state[9:].reshape(3, 3)
    matrix = project_to_so3(attitude) if attitude.ndim == 2 else quaternion_to_matrix(attitude)
    quaternion = matrix_to_quaternion(matrix) if attitude.ndim == 2 else normalised(attitude)
    spin, tensor = state[6:9], scene.body.inertia
    omega: Array = {
        "omega_body": spin,
        "omega_world": matrix.T @ spin,
        "angular_momentum": np.linalg.inv(tensor) @ (matrix.T @ spin),
    }[method.spin]
    return Motion(state[0:3], state[3:6], quaternion, omega, matrix @ tensor @ omega, attitude)


def stepped(scene: Scene, method: Integrator, steps: int, dt_s: float | None = None) -> Motion:
    """Return the state after this many steps, by default those of the scene's duration."""
    state = packed_start(scene, method)
    dt = scene.duration_s / steps if dt_s is None else dt_s
    method.advance(state, packed_body(scene.body), packed_load(scene), dt, steps)
    return unpacked(state, scene, method)


def solved(scene: Scene) -> Motion:
    """Return the end of the textbook's motion."""
    end = solved_end(scene.body, scene.initial, partial(wrench_at, scene), scene.duration_s)
    momentum = end.rotation @ scene.body.inertia @ end.omega_body
    return Motion(end.position, end.velocity, end.quaternion, end.omega_body, momentum, end.rotation)


def gaps(one: Motion, other: Motion) -> dict[str, float]:
    """Return the distance of two motions, quantity by quantity."""
    return {
        "orientation": float(geodesic_angle(one.quaternion, other.quaternion)),
        "omega": float(np.linalg.norm(one.omega_body - other.omega_body)),
        "position": float(np.linalg.norm(one.position - other.position)),
        "velocity": float(np.linalg.norm(one.velocity - other.velocity)),
    }


def slope(steps: tuple[int, ...], errors: list[float]) -> float:
    """Return the order: minus the slope of log error over log steps."""
    return -float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


# -------------------------------------------------------------------------------- order, convergence


def test_every_method_of_the_package_is_found() -> None:
    """The registry has one entry with a unique name for each module that assigns METHOD."""
    sources = [path.read_text() for path in Path(integrators.__path__[0]).glob("*.py")]
    assert len(INTEGRATORS) == sum(source.count("\nMETHOD = ") for source in sources)


@pytest.mark.parametrize("module", ["continuous_loads", "integrators.facts", "integrators.callback_motion"])
def test_a_module_that_the_methods_import_can_be_imported_first(module: str) -> None:
    """The package imports the methods, so they import nothing that imports the package."""
    code = f"import bodycheck.reference_impl.{module}"
    subprocess.run([sys.executable, "-c", code], check=True)


@every_integrator
def test_method_states_its_facts(method: Integrator) -> None:
    """A method has a lower-case name, a formula, what it conserves and a source."""
    assert INTEGRATORS[method.name] is method
    assert method.name == method.name.lower()
    assert method.formula
    assert method.conserves
    assert method.source
    assert method.order >= 1
    assert method.evaluations >= 1


# order -> the numbers of steps, and the limit of the orientation error after the last
REFINEMENTS: dict[int, tuple[tuple[int, ...], float]] = {
    1: ((256, 512, 1024, 2048), 3e-3),
    2: ((64, 90, 128, 181, 256), 3e-5),
    3: ((32, 45, 64, 90, 128), 3e-6),
    4: ((20, 28, 40, 56, 80), 3e-7),
}


@every_load
@where(lambda method: method.order in REFINEMENTS)  # the others: test_high_order.py
def test_error_has_the_stated_order(method: Integrator, loads: tuple[Load, ...]) -> None:
    """The orientation converges to an independent solution with the order that the method states."""
    scene = scene_of(loads)
    exact = solved(scene)
    steps, bound = REFINEMENTS[method.order]
    found = [gaps(stepped(scene, method, n), exact) for n in steps]
    assert slope(steps, [gap["orientation"] for gap in found]) == pytest.approx(method.order, abs=0.15)
    assert found[-1]["orientation"] < bound
    for quantity in ("omega", "position", "velocity"):
        errors = [gap[quantity] for gap in found]
        if max(errors) > max(steps) * 4 * EPS:  # otherwise exact to round-off, as a free body's position
            assert slope(steps, errors) >= method.order - 0.15, quantity


@every_integrator
def test_motion_of_the_centre_is_exact_without_force(method: Integrator) -> None:
    """Without force x = x0 + v t and v = v0 to round-off while the body rotates."""
    found = stepped(scene_of(LOADS["world torque"]), method, 1000)
    assert np.array_equal(found.velocity, START.velocity)
    assert np.max(np.abs(found.position - START.position - START.velocity)) <= 1000 * EPS * 3.0


# ------------------------------------------------------------------------------------- one step of it


def torque_at(rotation: Array, load: Array) -> Array:
    """Return the torque of a packed load, in body axes."""
    moment = load[12:].reshape(3, 3) @ rotation
    gyroscopic_torque = np.array(
        [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]
    )
    return np.asarray(load[6:9] + rotation.T @ load[9:12] + gyroscopic_torque)


def acceleration_at(rotation: Array, load: Array, mass: float) -> Array:
    """Return v' under a packed load."""
    return np.asarray((rotation @ load[0:3] + load[3:6]) / mass)


def rotation_of(state: Array) -> Array:
    """Return the attitude of a state as a matrix, converted from a quaternion if necessary."""
    return state[9:].reshape(3, 3) if len(state) == 18 else quaternion_to_matrix(state[9:])


def rates_at(state: Array, body: RigidBody, load: Array) -> Array:
    """Return the rates of x, v, omega and q under a packed load."""
    omega, q = state[6:9], state[9:]
    matrix = quaternion_to_matrix(q)
    net_torque = torque_at(matrix, load) - np.cross(omega, body.inertia @ omega)
    attitude = 0.5 * quaternion_product(q, np.array([0.0, *omega]))
    angular_acceleration = np.linalg.inv(body.inertia) @ net_torque
    return np.concatenate(
        [state[3:6], acceleration_at(matrix, load, body.mass), angular_acceleration, attitude]
    )


def explicit_step(tableau: Tableau, state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step of an explicit Runge-Kutta method."""
    k = np.zeros((len(tableau.b), 13))
    for i, row in enumerate(tableau.a):
        k[i] = rates_at(state + dt * row @ k, body, load)
    return np.asarray(state + dt * tableau.b @ k)


def turned_by(q: Array, rotation_vector: Array) -> Array:
    """Return q exp(rotation_vector / 2)."""
    return quaternion_product(q, exp_quaternion(rotation_vector))


def commutator_free_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step of CF4."""
    inverse = np.linalg.inv(body.inertia)
    velocity, momentum, q = state[3:6], state[6:9], state[9:]

    def rates(q: Array, moved: Array) -> tuple[Array, Array]:
        """Return omega in body axes, and the rates of x, v, L, after moving them by these increments."""
        matrix = quaternion_to_matrix(q)
        omega = inverse @ matrix.T @ (momentum + moved[6:])
        acceleration = acceleration_at(matrix, load, body.mass)
        return omega, np.concatenate([velocity + moved[3:6], acceleration, matrix @ torque_at(matrix, load)])

    w1, k1 = rates(q, np.zeros(9))
    q2 = turned_by(q, 0.5 * dt * w1)
    w2, k2 = rates(q2, 0.5 * dt * k1)
    w3, k3 = rates(turned_by(q, 0.5 * dt * w2), 0.5 * dt * k2)
    w4, k4 = rates(turned_by(q2, dt * (w3 - 0.5 * w1)), dt * k3)
    q = turned_by(q, dt / 12.0 * (3.0 * w1 + 2.0 * w2 + 2.0 * w3 - w4))
    q = turned_by(q, dt / 12.0 * (-w1 + 2.0 * w2 + 2.0 * w3 + 3.0 * w4))
    return np.concatenate([state[:9] + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4), q])


def split_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step of splitting6: a chain of kick-and-drifts and their adjoints."""
    shares = [splitting.KICKS[0]]
    for after, drift in zip(splitting.KICKS[1:], splitting.DRIFTS, strict=True):
        shares.append(drift - shares[-1])
        shares.append(after - shares[-1])
    moments, axes = np.linalg.eigh(body.inertia)
    y = state.copy()

    def kick(h: float) -> None:
        matrix = quaternion_to_matrix(y[9:])
        y[3:6] += h * acceleration_at(matrix, load, body.mass)
        y[6:9] += h * matrix @ torque_at(matrix, load)

    def turn(h: float, axis: int) -> None:
        along = float(axes[:, axis] @ quaternion_to_matrix(y[9:]).T @ y[6:9])
        rate = along * (1.0 / moments[axis] - 1.0 / moments[1])
        y[9:] = turned_by(y[9:], h * rate * axes[:, axis])

    def drift_evenly(h: float) -> None:
        y[0:3] += h * y[3:6]
        y[9:] = quaternion_product(exp_quaternion(h / moments[1] * y[6:9]), y[9:])

    flows = (kick, drift_evenly, partial(turn, axis=0), partial(turn, axis=2))
    for i, share in enumerate(shares[:-1]):
        for flow in flows if i % 2 == 0 else flows[::-1]:
            flow(dt * share)
    return y


def explicit_euler_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step y + dt y'."""
    return np.asarray(state + dt * rates_at(state, body, load))


def turn_of(state: Array, body: RigidBody, dt: float) -> Array:
    """dt omega = dt R I^-1 R^T L, in world axes."""
    matrix = rotation_of(state)
    return np.asarray(dt * matrix @ np.linalg.solve(body.inertia, matrix.T @ state[6:9]))


def explicit_pose(state: Array, body: RigidBody, load: Array, dt: float, attitude: Array) -> Array:
    """Return the state with this attitude, and with x, v and L after a step of Euler's method."""
    matrix = rotation_of(state)
    rates = [state[3:6], acceleration_at(matrix, load, body.mass), matrix @ torque_at(matrix, load)]
    return np.concatenate([state[:9] + dt * np.concatenate(rates), attitude.ravel()])


def euler_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step with R + [dt omega]x R."""
    matrix = rotation_of(state)
    return explicit_pose(state, body, load, dt, matrix + hat(turn_of(state, body, dt)) @ matrix)


def euler_svd_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step with the rotation nearest to R + [dt omega]x R."""
    matrix = rotation_of(state)
    moved = project_to_so3(matrix + hat(turn_of(state, body, dt)) @ matrix)
    return explicit_pose(state, body, load, dt, moved)


def lie_euler_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step with exp(dt omega) R."""
    turned = quaternion_product(exp_quaternion(turn_of(state, body, dt)), state[9:])
    return explicit_pose(state, body, load, dt, turned)


def semi_implicit_pose(state: Array, body: RigidBody, load: Array, dt: float, omega: Array) -> Array:
    """Return the state with this omega, and with x and q moved by the new velocities."""
    velocity = state[3:6] + dt * acceleration_at(rotation_of(state), load, body.mass)
    position = state[0:3] + dt * velocity
    return np.concatenate([position, velocity, omega, turned_by(state[9:], dt * omega)])


def torques_of(state: Array, body: RigidBody, load: Array) -> tuple[Array, Array]:
    """tau and omega x I omega, in body axes."""
    return torque_at(rotation_of(state), load), np.cross(state[6:9], body.inertia @ state[6:9])


def newton_matrix(state: Array, body: RigidBody, dt: float) -> Array:
    """I + dt D, D the derivative of omega x I omega."""
    tensor, omega = body.inertia, state[6:9]
    return np.asarray(tensor + dt * (hat(omega) @ tensor - hat(tensor @ omega)))


def m1_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step with omega + dt I^-1 (tau - omega x I omega)."""
    torque, gyroscopic = torques_of(state, body, load)
    change = dt * np.linalg.solve(body.inertia, torque - gyroscopic)
    return semi_implicit_pose(state, body, load, dt, state[6:9] + change)


def m2_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step with omega + dt (I + dt D)^-1 (tau - omega x I omega)."""
    torque, gyroscopic = torques_of(state, body, load)
    change = dt * np.linalg.solve(newton_matrix(state, body, dt), torque - gyroscopic)
    return semi_implicit_pose(state, body, load, dt, state[6:9] + change)


def m3_step(state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after a step with omega + dt I^-1 tau - dt (I + dt D)^-1 omega x I omega."""
    torque, gyroscopic = torques_of(state, body, load)
    change = dt * np.linalg.solve(body.inertia, torque)
    change -= dt * np.linalg.solve(newton_matrix(state, body, dt), gyroscopic)
    return semi_implicit_pose(state, body, load, dt, state[6:9] + change)


FORMULAS: dict[str, Callable[[Array, RigidBody, Array, float], Array]] = {
    "euler": euler_step,
    "euler-svd": euler_svd_step,
    "lie-euler": lie_euler_step,
    "quaternion-euler": explicit_euler_step,
    "m1": m1_step,
    "m2": m2_step,
    "m3": m3_step,
    "cf4": commutator_free_step,
    "splitting6": split_step,
}
"""One step in numpy for the methods without a tableau."""


def one_step(method: Integrator, state: Array, body: RigidBody, load: Array, dt: float) -> Array:
    """Return the state after one step in numpy, by the tableau or the formula that the method states."""
    if method.tableau is not None:
        return explicit_step(method.tableau, state, body, load, dt)
    return FORMULAS[method.name](state, body, load, dt)


@where(lambda method: method.tableau is not None or method.name in FORMULAS)
@pytest.mark.parametrize("seed", range(5))
def test_one_step_is_the_stated_formula(method: Integrator, seed: int) -> None:
    """One step from any state under any packed load equals the method's formula, computed by numpy."""
    rng = np.random.default_rng(seed)
    load = rng.normal(size=21)
    start = State(
        rng.normal(size=3), normalised(rng.normal(size=4)), rng.normal(size=3), 2 * rng.normal(size=3)
    )
    state = packed_start(scene_of(start=start), method)
    expected = one_step(method, state, BODY, load, 0.1)
    method.advance(state, packed_body(BODY), load, 0.1, 1)
    assert np.max(np.abs(state - expected)) <= 64 * EPS * float(np.max(np.abs(expected)))


# ---------------------------------------------------------------------------- laws of all methods


@every_load
@every_integrator
def test_steps_may_be_made_in_any_portions(method: Integrator, loads: tuple[Load, ...]) -> None:
    """advance(n) twice is advance(2 n) and n times advance(1), to the last bit; advance(0) does nothing."""
    scene = scene_of(loads)
    body, load = packed_body(BODY), packed_load(scene)
    whole, halves, single = (packed_start(scene, method) for _ in range(3))
    method.advance(whole, body, load, 0.01, 60)
    for _ in range(2):
        method.advance(halves, body, load, 0.01, 30)
        method.advance(halves, body, load, 0.01, 0)
    for _ in range(60):
        method.advance(single, body, load, 0.01, 1)
    assert np.array_equal(whole, halves)
    assert np.array_equal(whole, single)
    assert np.array_equal(body, packed_body(BODY))
    assert np.array_equal(load, packed_load(scene))


def in_turned_world(scene: Scene, turn: Array) -> Scene:
    """Return the same scene in other world axes."""
    start, q = scene.initial, matrix_to_quaternion(turn)
    initial = State(
        turn @ start.position,
        quaternion_product(q, start.quaternion),
        turn @ start.velocity,
        start.omega_body,
    )
    loads = tuple(
        replace(load, value=turn @ load.value) if load.axes == "world" else load
        for load in constant_loads(scene)
    )
    return replace(scene, initial=initial, loads=loads, gravity=turn @ scene.gravity)


def in_turned_body(scene: Scene, turn: Array) -> Scene:
    """Return the same scene in other body axes: components are multiplied by turn^T."""
    start, q = scene.initial, matrix_to_quaternion(turn)
    tensor = turn.T @ scene.body.inertia @ turn
    initial = replace(
        start, quaternion=quaternion_product(start.quaternion, q), omega_body=turn.T @ start.omega_body
    )
    loads: list[Load] = []
    for load in constant_loads(scene):
        value = turn.T @ load.value if load.axes == "body" else load.value
        if isinstance(load, PointForce):
            loads.append(replace(load, value=value, at=turn.T @ load.at))
        else:
            loads.append(replace(load, value=value))
    return replace(scene, body=replace(scene.body, inertia=tensor), initial=initial, loads=tuple(loads))


TURN = Rotation.from_rotvec([-1.1, 0.8, 2.0]).as_matrix()
# 100 steps, about 30 roundings each of numbers up to 10, with little growth of errors within a second
ROUND_OFF = 100 * 30 * EPS * 2


@every_load
@every_integrator
def test_world_axes_do_not_matter(method: Integrator, loads: tuple[Load, ...]) -> None:
    """In a rotated world the motion is rotated, to round-off."""
    scene = replace(scene_of(loads), gravity=GRAVITY)
    one, other = stepped(scene, method, 100), stepped(in_turned_world(scene, TURN), method, 100)
    q = matrix_to_quaternion(TURN)
    expected = replace(
        one,
        position=TURN @ one.position,
        velocity=TURN @ one.velocity,
        quaternion=quaternion_product(q, one.quaternion),
    )
    assert max(gaps(other, expected).values()) <= ROUND_OFF


@every_load
@every_integrator
def test_body_axes_do_not_matter(method: Integrator, loads: tuple[Load, ...]) -> None:
    """With other body axes, and thus another tensor, the motion is the same to round-off."""
    scene = replace(scene_of(loads), gravity=GRAVITY)
    one, other = stepped(scene, method, 100), stepped(in_turned_body(scene, TURN), method, 100)
    expected = replace(
        one,
        quaternion=quaternion_product(one.quaternion, matrix_to_quaternion(TURN)),
        omega_body=TURN.T @ one.omega_body,
    )
    assert max(gaps(other, expected).values()) <= ROUND_OFF


# order -> the numbers of steps there and back, and the limit of the distance from the start after the last
REVERSALS: dict[int, tuple[tuple[int, ...], float]] = {
    1: ((256, 512, 1024), 1e-2),
    2: ((64, 128, 256), 1e-4),
    3: ((32, 64, 128), 1e-5),
    4: ((20, 40, 80), 1e-6),
    5: ((12, 18, 27), 1e-6),
    6: ((8, 12, 18), 1e-7),
    7: ((5, 7, 10), 1e-8),
    8: ((3, 4, 6), 1e-10),
}


@every_load
@every_integrator
def test_motion_is_reversible_to_the_methods_order(method: Integrator, loads: tuple[Load, ...]) -> None:
    """If omega and v are reversed, the body returns to its start within an error of the method's order."""
    scene = scene_of(loads)
    steps, bound = REVERSALS[method.order]
    returned = []
    for n in steps:
        there = stepped(scene, method, n)
        back = State(there.position, there.quaternion, -there.velocity, -there.omega_body)
        again = stepped(replace(scene, initial=back), method, n)
        returned.append(float(geodesic_angle(again.quaternion, START.quaternion)))
    if "time reversal" in method.preserves:  # each step is its own inverse
        assert max(returned) <= 200 * EPS
        return
    assert slope(steps, returned) >= method.order - 0.15
    assert returned[-1] < bound


@every_integrator
def test_rest_stays_at_rest(method: Integrator) -> None:
    """Without loads a body at rest does not change by a bit."""
    still = replace(START, velocity=np.zeros(3), omega_body=np.zeros(3))
    scene = scene_of(start=still)
    state = packed_start(scene, method)
    before = state.copy()
    method.advance(state, packed_body(BODY), packed_load(scene), 0.01, 1000)
    if method.attitude == "matrix" and "rotation group" in method.preserves:  # the projection rounds R
        assert np.max(np.abs(state - before)) <= 1000 * 4 * EPS
        assert np.array_equal(state[:9], before[:9])
    else:
        # the product with the unit quaternion and sums with zero are exact
        assert np.array_equal(state, before)


# ---------------------------------------------------------------------------------- closed forms

SPHERE = RigidBody(2.5, np.eye(3))


@every_integrator
def test_sphere_spins_steadily(method: Integrator) -> None:
    """omega is constant, and every step rotates the sphere by the angle that the method states."""
    scene = scene_of(body=SPHERE, start=replace(START, omega_body=np.array([1.0, -2.0, 0.5])))
    omega, steps, dt = scene.initial.omega_body, 500, 0.02
    found = stepped(scene, method, steps, dt)
    assert np.max(np.abs(found.omega_body - omega)) <= steps * 8 * EPS
    speed = float(np.linalg.norm(omega))
    turn = steps * method.step_angle(dt * speed) / speed
    expected = quaternion_product(scene.initial.quaternion, exp_quaternion(turn * omega))
    assert geodesic_angle(found.quaternion, expected) <= steps * 8 * EPS


@every_integrator
def test_spin_about_a_principal_axis_is_steady(method: Integrator) -> None:
    """About the axis of the largest and of the least moment any body rotates as a sphere does."""
    for axis in (0, 2):
        spun = State(START.position, START.quaternion, START.velocity, 1.7 * np.eye(3)[axis])
        found = stepped(
            scene_of(body=RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), start=spun), method, 500, 0.02
        )
        turn = 500 * method.step_angle(0.02 * 1.7)
        expected = quaternion_product(START.quaternion, exp_quaternion(turn * np.eye(3)[axis]))
        assert geodesic_angle(found.quaternion, expected) <= 500 * 16 * EPS


@every_integrator
def test_projectile_is_ahead_by_the_stated_weight(method: Integrator) -> None:
    """v is exact; x is (w - 1/2) g dt T beyond the parabola, w the weight of the force in the position."""
    scene = replace(scene_of(), gravity=GRAVITY)
    steps, dt = 1000, 1e-3
    found, time = stepped(scene, method, steps, dt), steps * dt
    parabola = START.position + time * START.velocity + 0.5 * time**2 * GRAVITY
    ahead = (method.position_weight - 0.5) * dt * time * GRAVITY
    assert np.max(np.abs(found.velocity - START.velocity - time * GRAVITY)) <= steps * 10 * EPS
    assert np.max(np.abs(found.position - parabola - ahead)) <= steps * 10 * EPS


# ------------------------------------------------------------------------------ conserved quantities


@where(lambda method: method.spin == "angular_momentum")
def test_momentum_is_conserved_exactly(method: Integrator) -> None:
    """Without torque the state's L does not change by a bit, with or without gravity."""
    scene = replace(scene_of(), gravity=GRAVITY)
    state = packed_start(scene, method)
    before = state[6:9].copy()
    method.advance(state, packed_body(BODY), packed_load(scene), 1e-2, 1000)
    assert np.array_equal(state[6:9], before)


INTERMEDIATE = Scene(
    RigidBody(1.0, np.diag([1.0, 2.0, 3.0])),
    State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1])),
    (),
    np.zeros(3),
    duration_s=10.0,
    samples=2,
)


@where(lambda method: "angular momentum" in method.preserves)
def test_momentum_of_the_reported_motion_is_conserved(method: Integrator) -> None:
    """L = I(R) omega of the reported motion is constant to 1e-14 over 1e4 steps."""
    simulation = Reference().build(INTERMEDIATE, method.name, 1e-3)
    first = np.array([0.1, 4.0, 0.3])
    worst = 0.0
    for _ in range(100):
        simulation.advance(100)
        reading = simulation.read()
        assert reading.omega_world is not None
        if reading.rotation is None:
            assert reading.quaternion is not None
            rotation = quaternion_to_matrix(reading.quaternion)
        else:
            rotation = reading.rotation
        momentum = rotation @ INTERMEDIATE.body.inertia @ rotation.T @ reading.omega_world
        worst = max(worst, float(np.linalg.norm(momentum - first)))
    assert worst <= 1e-14 * float(np.linalg.norm(first))


@where(lambda method: "rotation group" in method.preserves)
def test_attitude_stays_a_rotation(method: Integrator) -> None:
    """|q| = 1, or R^T R = 1, to one eps per step."""
    attitude = stepped(INTERMEDIATE, method, 10_000).attitude
    defect = attitude @ attitude - 1.0 if attitude.ndim == 1 else attitude.T @ attitude - np.eye(3)
    assert np.max(np.abs(defect)) <= 2 * 10_000 * EPS


def test_quaternion_euler_grows_as_stated() -> None:
    """|q|^2 grows by the factor 1 + (dt omega / 2)^2 per step, exactly so for a sphere."""
    found = stepped(scene_of(body=SPHERE), INTEGRATORS["quaternion-euler"], 500, 0.02)
    x = 0.5 * 0.02 * float(np.linalg.norm(START.omega_body))
    assert np.linalg.norm(found.attitude) == pytest.approx((1.0 + x * x) ** 250, rel=500 * 4 * EPS, abs=0.0)


@where(lambda method: method.tableau is not None)
def test_norm_follows_the_stability_function(method: Integrator) -> None:
    """|q| changes by the factor |R(i dt omega / 2)| per step, exactly so for a sphere."""
    assert method.tableau is not None
    found = stepped(scene_of(body=SPHERE), method, 500, 0.2)
    x = 0.5 * 0.2 * float(np.linalg.norm(START.omega_body))
    expected = abs(method.tableau.stability_function(1j * x)) ** 500
    assert np.linalg.norm(found.attitude) == pytest.approx(expected, rel=500 * 8 * EPS, abs=0.0)


def test_rk4_norm_follows_its_polynomial() -> None:
    """|q|^2 shrinks by 1 - x^6/72 + x^8/576 per step, x = dt omega / 2: an error of order 5."""
    found = stepped(scene_of(body=SPHERE), INTEGRATORS["rk4"], 500, 0.2)
    x = 0.5 * 0.2 * float(np.linalg.norm(START.omega_body))
    expected = (1.0 - x**6 / 72.0 + x**8 / 576.0) ** 250
    assert np.linalg.norm(found.attitude) == pytest.approx(expected, rel=500 * 8 * EPS, abs=0.0)
    assert 1.0 - expected > 1e-6  # otherwise nothing is tested


def test_euler_loses_orthogonality_and_the_projection_keeps_it() -> None:
    """R^T R grows by about T dt omega^2 across omega under Euler; with the SVD it is I to round-off."""
    scene, dt, steps = scene_of(body=SPHERE), 0.01, 100
    speed = float(np.linalg.norm(START.omega_body))
    loose, kept = (stepped(scene, INTEGRATORS[name], steps, dt).attitude for name in ("euler", "euler-svd"))
    growth = (1.0 + (dt * speed) ** 2) ** steps - 1.0  # twice, in the plane across omega
    assert np.linalg.norm(loose.T @ loose - np.eye(3)) == pytest.approx(
        math.sqrt(2.0) * growth, rel=1e-12, abs=0.0
    )
    assert np.linalg.norm(kept.T @ kept - np.eye(3)) <= 16 * EPS
    tumbling = stepped(INTERMEDIATE, INTEGRATORS["euler-svd"], 1000).attitude
    assert np.linalg.norm(tumbling.T @ tumbling - np.eye(3)) <= 16 * EPS
    assert abs(np.linalg.det(tumbling) - 1.0) <= 16 * EPS


def test_projection_holds_for_steps_of_any_size() -> None:
    """det(I + dt [omega]x) = 1 + dt^2 omega^2 > 0, so a projected step always gives a rotation."""
    fast = replace(START, omega_body=np.array([300.0, -200.0, 500.0]))
    found = stepped(scene_of(start=fast), INTEGRATORS["euler-svd"], 20, 0.1).attitude
    assert np.max(np.abs(found.T @ found - np.eye(3))) <= 16 * EPS
    assert np.linalg.det(found) == pytest.approx(1.0, abs=16 * EPS)


def test_exponential_step_is_the_rotation_of_the_matrix_exponential() -> None:
    """lie-euler multiplies R by exp(dt [omega]x) from the left, omega in world axes."""
    found = stepped(scene_of(), INTEGRATORS["lie-euler"], 1, 0.3)
    rotation = START.rotation
    expected = exp_matrix(0.3 * rotation @ START.omega_body) @ rotation
    assert np.max(np.abs(quaternion_to_matrix(found.quaternion) - expected)) <= 16 * EPS
