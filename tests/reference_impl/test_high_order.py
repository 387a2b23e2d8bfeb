"""The methods of order 4 to 8 compared with twenty digits in other variables: R and L, both in world axes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.integrate._ivp import dop853_coefficients
from scipy.spatial.transform import Rotation

from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, rotational_energy
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators import splitting as splitting_module
from bodycheck.reference_impl.integrators.dop853 import NODES, ROWS, WEIGHTS
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.kernels.small_vectors import principal_frame
from bodycheck.reference_impl.rotations import (
    exp_matrix,
    geodesic_angle,
    matrix_to_quaternion,
    normalised,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench, wrench_of

EPS = float(np.finfo(np.float64).eps)

CF4, SPLITTING6, DOP853 = (INTEGRATORS[name] for name in ("cf4", "splitting6", "dop853"))


def where(promised: Callable[[Integrator], bool]) -> pytest.MarkDecorator:
    """Return the mark for a law of the methods of order 4 or more whose facts state it."""
    methods = [method for method in INTEGRATORS.values() if method.order >= 4 and promised(method)]
    return pytest.mark.parametrize("method", methods, ids=[method.name for method in methods])


every_method = where(lambda _: True)


def turned_tensor(moments: tuple[float, float, float]) -> Array:
    """Return a tensor with these principal moments and rotated axes."""
    tilt = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
    tensor = tilt @ np.diag(moments) @ tilt.T
    return np.asarray(0.5 * (tensor + tensor.T))


BODY = RigidBody(1.3, turned_tensor((1.0, 1.8, 2.5)))
START = State(
    position=np.array([0.3, -0.2, 0.1]),
    quaternion=normalised(np.array([0.5, -0.1, 0.7, 0.3])),
    velocity=np.array([0.3, 0.1, -0.2]),
    omega_body=np.array([1.9, 2.3, -1.8]),
)
DURATION = 2.0

LOADS: dict[str, tuple[Torque | PointForce, ...]] = {
    "free": (),
    "body torque": (Torque("body", np.array([0.9, -1.2, 0.7])),),
    "world torque": (Torque("world", np.array([0.9, -1.2, 0.7])),),
    "body force": (PointForce("body", np.array([1.5, 0.9, -2.4]), np.array([0.6, -0.4, 0.5])),),
    "world force": (PointForce("world", np.array([1.5, 0.9, -2.4]), np.array([0.6, -0.4, 0.5])),),
}
LOADS["all at once"] = tuple(load for loads in LOADS.values() for load in loads)


def wrench_named(kind: str) -> Wrench:
    """Return the wrench of a kind of load."""
    return wrench_of(tuple((load, 1.0) for load in LOADS[kind]))


# ------------------------------------------------------------------------- twenty digits, by mpmath


def times(m: list[Any], v: list[Any]) -> list[Any]:
    """m v, m row by row."""
    return [m[3 * i] * v[0] + m[3 * i + 1] * v[1] + m[3 * i + 2] * v[2] for i in range(3)]


def transposed(m: list[Any]) -> list[Any]:
    """m^T, row by row."""
    return [m[3 * j + i] for i in range(3) for j in range(3)]


def cross(a: list[Any], b: list[Any]) -> list[Any]:
    """a x b."""
    return [a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3] for i in range(3)]


@cache
def solved(kind: str) -> tuple[Array, Array, Array, Array]:
    """Return position, velocity, R and omega in body axes at the end, to the last bit or so."""
    with mpmath.workdps(24):
        inverse = list(mpmath.matrix(BODY.inertia.tolist()) ** -1)
        norm = mpmath.sqrt(sum(mpmath.mpf(x) ** 2 for x in START.quaternion))
        w, x, y, z = (mpmath.mpf(c) / norm for c in START.quaternion)
        rotation = [
            *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        ]
        tensor = [mpmath.mpf(c) for c in BODY.inertia.ravel()]
        momentum = times(rotation, times(tensor, [mpmath.mpf(c) for c in START.omega_body]))

        def rates(_t: Any, state: list[Any]) -> list[Any]:
            r, spin, v = state[:9], state[9:12], state[15:18]
            omega = times(inverse, times(transposed(r), spin))
            force, torque = [mpmath.mpf(0)] * 3, [mpmath.mpf(0)] * 3
            for load in LOADS[kind]:
                value = [mpmath.mpf(c) for c in load.value]
                value = times(r, value) if load.axes == "body" else value
                if isinstance(load, PointForce):
                    force = [a + b for a, b in zip(force, value, strict=True)]
                    value = cross(times(r, [mpmath.mpf(c) for c in load.at]), value)
                torque = [a + b for a, b in zip(torque, value, strict=True)]
            matrix_rate = [-c for row in range(3) for c in cross(omega, r[3 * row : 3 * row + 3])]
            return [*matrix_rate, *torque, *v, *(c / mpmath.mpf(BODY.mass) for c in force)]

        start = [*rotation, *momentum, *map(mpmath.mpf, START.position), *map(mpmath.mpf, START.velocity)]
        end = mpmath.odefun(rates, 0, start, tol=mpmath.mpf("1e-18"))(DURATION)
        omega = times(inverse, times(transposed(end[:9]), end[9:12]))
        parts = (end[12:15], end[15:18], end[:9], omega)
        x_end, v_end, r_end, omega_end = (np.array([float(c) for c in part]) for part in parts)
    return x_end, v_end, r_end.reshape(3, 3), omega_end


# ------------------------------------------------------------------------------ orders and their floor


def packed_start(method: Integrator, start: State = START, body: RigidBody = BODY) -> Array:
    """Return the initial state in the variables of the method."""
    spin = start.omega_body
    if method.spin == "angular_momentum":
        spin = start.rotation @ (body.inertia @ spin)
    return np.concatenate([start.position, start.velocity, spin, start.quaternion])


def omega_of(state: Array, method: Integrator, body: RigidBody = BODY) -> Array:
    """Return omega in body axes."""
    if method.spin == "omega_body":
        return state[6:9]
    return np.asarray(np.linalg.inv(body.inertia) @ quaternion_to_matrix(state[9:]).T @ state[6:9])


def errors(method: Integrator, kind: str, steps: int) -> dict[str, float]:
    """Return the errors after this many steps, quantity by quantity."""
    state = packed_start(method)
    load = wrench_named(kind).packed(BODY, np.zeros(3))
    method.advance(state, packed_body(BODY), load, DURATION / steps, steps)
    position, velocity, rotation, omega = solved(kind)
    return {
        "orientation": float(geodesic_angle(state[9:], matrix_to_quaternion(rotation))),
        "omega": float(np.linalg.norm(omega_of(state, method) - omega)),
        "position": float(np.linalg.norm(state[0:3] - position)),
        "velocity": float(np.linalg.norm(state[3:6] - velocity)),
    }


def slope(steps: tuple[int, ...], found: list[float]) -> float:
    """Return the order: minus the slope of log error over log steps."""
    return -float(np.polyfit(np.log(steps), np.log(found), 1)[0])


# order -> the numbers of steps between which the order is visible, and the tolerance of slopes
REFINEMENTS: dict[int, tuple[tuple[int, ...], float]] = {
    4: ((80, 113, 160), 0.1),
    5: ((113, 160, 226), 0.6),
    6: ((24, 34, 48), 0.1),
    7: ((28, 40, 56), 0.6),
    8: ((16, 20, 24, 28, 32), 0.4),
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("kind", LOADS)
@every_method
def test_error_has_the_stated_order(method: Integrator, kind: str) -> None:
    """Under every kind of wrench orientation, omega, position and velocity have the stated order."""
    steps, tolerance = REFINEMENTS[method.order]
    found = [errors(method, kind, n) for n in steps]
    assert slope(steps, [error["orientation"] for error in found]) == pytest.approx(
        method.order, abs=tolerance
    )
    for quantity in ("omega", "position", "velocity"):
        run = [error[quantity] for error in found]
        if max(run) > max(steps) * 8 * EPS:  # otherwise exact to round-off, if no force acts
            assert slope(steps, run) >= method.order - tolerance, quantity


@pytest.mark.nightly
@pytest.mark.parametrize("kind", LOADS)
def test_order_eight_reaches_round_off(kind: str) -> None:
    """With 64 steps of 1/32 s the error of dop853 is round-off."""
    assert max(errors(DOP853, kind, 64).values()) <= 64 * EPS


def test_dop853_tableau_equals_hairers() -> None:
    """The coefficients equal those in scipy, from dop853.f, and sum_j b_j a_ji = b_i (1 - c_i)."""
    a = np.array([[row.get(j, 0.0) for j in range(1, 13)] for row in ROWS])
    b, c = np.array([WEIGHTS.get(j, 0.0) for j in range(1, 13)]), np.array(NODES)
    assert np.array_equal(a, dop853_coefficients.A[:12, :12])
    assert np.array_equal(b, dop853_coefficients.B)
    assert np.array_equal(c, dop853_coefficients.C[:12])
    assert np.max(np.abs(b @ a - b * (1.0 - c))) <= 16 * EPS


# ------------------------------------------------------------------------------ conserved quantities


def free_run(method: Integrator, dt: float, portions: int, each: int) -> list[Array]:
    """Return copies of the state of the free body, one after each portion of steps."""
    state, load = packed_start(method), NO_WRENCH.packed(BODY, np.zeros(3))
    states = []
    for _ in range(portions):
        method.advance(state, packed_body(BODY), load, dt, each)
        states.append(state.copy())
    return states


@where(lambda method: method.spin == "angular_momentum")
def test_momentum_is_conserved_to_the_bit(method: Integrator) -> None:
    """Without torque L in world axes does not change at all, for any step."""
    assert np.array_equal(free_run(method, 0.2, 1, 1000)[0][6:9], packed_start(method)[6:9])


@where(lambda method: "angular momentum" in method.preserves)
def test_momentum_of_the_reported_motion_is_conserved(method: Integrator) -> None:
    """R I omega of the reported motion is constant to 1e-14 over 1e5 steps."""
    simulation = Reference().build(
        Scene(BODY, START, (), np.zeros(3), duration_s=1000.0, samples=2), method.name, 0.01
    )
    first = START.rotation @ BODY.inertia @ START.omega_body
    for _ in range(100):
        simulation.advance(1000)
        reading = simulation.read()
        assert reading.quaternion is not None
        assert reading.omega_world is not None
        rotation = quaternion_to_matrix(reading.quaternion)
        momentum = angular_momentum(rotation, BODY.inertia, rotation.T @ reading.omega_world)
        assert np.linalg.norm(momentum - first) <= 1e-14 * np.linalg.norm(first)


@where(lambda method: "rotation group" in method.preserves)
def test_norm_of_the_quaternion_is_conserved(method: Integrator) -> None:
    """|q| drifts from 1 by round-off, about 1e-13 in 1e5 steps, without normalisation."""
    norms = [float(np.linalg.norm(state[9:])) for state in free_run(method, 0.05, 100, 1000)]
    assert max(abs(norm - 1.0) for norm in norms) <= 5e-13


def energy_errors(method: Integrator, dt: float) -> Array:
    """Return the relative errors of the energy at 200 times through 1e5 steps."""
    first = float(rotational_energy(BODY.inertia, START.omega_body))
    states = free_run(method, dt, 200, 500)
    return np.array(
        [float(rotational_energy(BODY.inertia, omega_of(state, method))) / first - 1.0 for state in states]
    )


@where(lambda method: "symplectic form" in method.preserves)
def test_energy_error_of_a_symplectic_method_is_bounded(method: Integrator) -> None:
    """Over 1e5 steps of 0.2 s the error of the energy oscillates and does not grow."""
    found = energy_errors(method, 0.2)
    assert np.max(np.abs(found)) <= 1e-8
    assert np.max(np.abs(found[-50:])) <= 1.5 * np.max(np.abs(found[:50]))
    assert abs(np.mean(found[-50:]) - np.mean(found[:50])) <= 0.3 * np.std(found)


def test_energy_error_of_a_method_that_is_not_symplectic_grows() -> None:
    """Over 1e5 steps of 0.05 s the error of cf4 more than doubles."""
    drifting = energy_errors(CF4, 0.05)
    assert np.max(np.abs(drifting[-50:])) > 2.0 * np.max(np.abs(drifting[:50]))


def test_splitting_conserves_under_a_force_with_a_potential() -> None:
    """With a constant world force F at a: E = T - F . (x + R a) is bounded, L . F constant to round-off."""
    pull = next(load for load in LOADS["world force"] if isinstance(load, PointForce))
    load, state = wrench_named("world force").packed(BODY, np.zeros(3)), packed_start(SPLITTING6)
    still = np.concatenate([np.zeros(6), state[6:]])  # the centre of mass is in free fall and left out of E

    def spin_energy() -> float:
        rotation = quaternion_to_matrix(still[9:])
        kinetic = float(rotational_energy(BODY.inertia, omega_of(still, SPLITTING6)))
        return kinetic - float(pull.value @ rotation @ pull.at)

    energy, along = spin_energy(), float(still[6:9] @ pull.value)
    worst_energy = worst_along = 0.0
    for _ in range(100):
        SPLITTING6.advance(still, packed_body(BODY), load, 0.05, 1000)
        worst_energy = max(worst_energy, abs(spin_energy() / energy - 1.0))
        worst_along = max(worst_along, abs(float(still[6:9] @ pull.value) / along - 1.0))
    assert worst_energy <= 1e-7
    assert worst_along <= 1e-12


def test_splitting_is_reversible() -> None:
    """The composition is symmetric, so the reversed steps lead back to the start to round-off."""
    load, body = wrench_named("all at once").packed(BODY, np.zeros(3)), packed_body(BODY)
    state = packed_start(SPLITTING6)
    first = state.copy()
    SPLITTING6.advance(state, body, load, 0.1, 100)
    state[3:9] *= -1.0
    SPLITTING6.advance(state, body, load, 0.1, 100)
    state[3:9] *= -1.0
    assert np.max(np.abs(state - first)) <= 1e-11


@pytest.mark.parametrize("moments", [(2.0, 2.0, 3.0), (1.0, 2.0, 2.0), (1.5, 1.5, 1.5)])
def test_splitting_is_exact_for_a_symmetric_body(moments: tuple[float, float, float]) -> None:
    """With two equal moments a free body follows the closed form, for steps of any length."""
    body = RigidBody(1.0, turned_tensor(moments))
    state = packed_start(SPLITTING6, body=body)
    SPLITTING6.advance(state, packed_body(body), NO_WRENCH.packed(body, np.zeros(3)), 1.7, 10)
    exact = FreeRotation.from_state(body.inertia, START.quaternion, START.omega_body)
    quaternion, omega = exact.at(np.array([17.0]))
    assert geodesic_angle(state[9:], quaternion[0]) <= 1e-12
    assert np.linalg.norm(omega_of(state, SPLITTING6, body) - omega[0]) <= 1e-12


@pytest.mark.slow
def test_equal_halves_of_the_drifts_lose_the_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """With each drift divided into equal halves, as if it were the exact flow, order 6 becomes 2."""
    plain: Callable[..., None] = splitting_module.advance.py_func

    def error(steps: int) -> float:
        state = packed_start(SPLITTING6)
        plain(state, packed_body(BODY), NO_WRENCH.packed(BODY, np.zeros(3)), DURATION / steps, steps)
        return float(geodesic_angle(state[9:], matrix_to_quaternion(solved("free")[2])))

    assert slope((10, 20), [error(10), error(20)]) == pytest.approx(6.0, abs=0.2)
    monkeypatch.setattr(splitting_module, "FIRST_PARTS", 0.5 * splitting_module.DRIFTS)
    assert slope((10, 20), [error(10), error(20)]) == pytest.approx(2.0, abs=0.2)


def test_cf4_is_exact_for_a_sphere() -> None:
    """If omega is constant two exponentials of it are one, so a sphere is exact after steps of any length."""
    sphere = RigidBody(1.0, 1.5 * np.eye(3))
    state = packed_start(CF4, body=sphere)
    CF4.advance(state, packed_body(sphere), NO_WRENCH.packed(sphere, np.zeros(3)), 1.7, 10)
    rotation = exp_matrix(17.0 * START.rotation @ START.omega_body) @ START.rotation
    assert geodesic_angle(state[9:], matrix_to_quaternion(rotation)) <= 1e-13


# ------------------------------------------------------------------------------- the principal frame


def framed(inertia: Array) -> tuple[Array, Array]:
    """Return moments (3,) and axes (3, 3) by Jacobi's method."""
    moments, axes = principal_frame(tuple(inertia.ravel()))
    return np.array(moments), np.array(axes).reshape(3, 3)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("spread", [1.0, 1e-3, 1e-9, 1e-14, 0.0])
def test_principal_frame_reproduces_the_tensor(spread: float, seed: int) -> None:
    """A diag(J) A^T = I, A^T A = 1, det A = 1 and J is ascending, however close the moments are."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(rng=rng).as_matrix()
    tensor = turn @ np.diag(2.0 + spread * rng.uniform(-0.9, 0.9, size=3)) @ turn.T
    tensor = 0.5 * (tensor + tensor.T)
    moments, axes = framed(tensor)
    assert np.max(np.abs(axes @ np.diag(moments) @ axes.T - tensor)) <= 32 * EPS
    assert np.max(np.abs(axes.T @ axes - np.eye(3))) <= 16 * EPS
    assert np.linalg.det(axes) == pytest.approx(1.0, abs=16 * EPS)
    assert moments[0] <= moments[1] <= moments[2]
    assert np.max(np.abs(moments - np.linalg.eigvalsh(tensor))) <= 32 * EPS


@pytest.mark.parametrize("moments", [(1.0, 2.0, 2.5), (2.5, 2.0, 1.0), (2.0, 1.0, 2.0), (2.0, 2.0, 2.0)])
def test_principal_frame_of_a_diagonal_tensor_is_exact(moments: tuple[float, float, float]) -> None:
    """Without rotation nothing is rounded, and the axes are those of the body in ascending order."""
    found, axes = framed(np.diag(moments))
    assert np.array_equal(found, np.sort(moments))
    assert np.array_equal(np.abs(axes).sum(axis=0), np.ones(3))
    assert np.array_equal(axes @ np.diag(found) @ axes.T, np.diag(moments))
    assert np.linalg.det(axes) == 1.0


def test_principal_frame_of_a_needle_is_accurate_in_each_moment() -> None:
    """Jacobi's method computes the least moment of a graded diagonal to its own last digits."""
    found, _ = framed(np.diag([1.0, 1e-9, 1.0 + 1e-9]))
    assert found[0] == 1e-9
