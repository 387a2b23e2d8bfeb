"""The fast Taylor integrator against closed forms and certified truths in other axes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mpmath
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rational import fractions
from bodycheck.reference_impl.rotations import normalised, quaternion_to_matrix, rotate
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
)
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion
from bodycheck.reference_impl.taylor.principal_frame import axes_of, in_axes_of, principal_quaternion
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.motion_distance import distances
from bodycheck.reference_impl.truth.truth import Truth
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.kernel_programs import printed_json

pytestmark = pytest.mark.nightly  # they compile kernels that few others use

EPS = float(np.finfo(np.float64).eps)
A, B = np.array([0.1, 0.2, 0.3]), np.array([0.2, 0.35, -0.15])
LOADS: dict[str, tuple[Load, ...]] = {
    "free": (),
    "torque body": (Torque("body", A),),
    "torque world": (Torque("world", A),),
    "force body": (PointForce("body", A, B),),
    "heavy top": (PointForce("world", np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, 1.0])),),
    "sine body": (SineTorque("body", A, 1.3, 0.2), SineTorque("body", B, -0.7, 2.0)),
    "sine world": (SineTorque("world", A, 1.3, 0.2), SineTorque("world", B, -0.7, 2.0)),
    "angular drag": (Drag(0.0, np.array([[0.3, 0.05, 0.0], [-0.1, 0.2, 0.02], [0.0, 0.04, 0.5]])),),
    "drag": (Drag(0.4, np.diag(A)),),
    "gravity gradient": (GravityGradient(0.5),),
    "spring": (Spring(A, B, 1.5, 0.3),),
    "mixture": (
        Torque("body", A),
        Torque("world", B),
        PointForce("world", A, B),
        SineTorque("body", B, 1.1, 0.4),
        SineTorque("world", B, 0.7, 0.1),
        Drag(0.0, np.diag(A)),
        GravityGradient(0.3),
    ),
    "switched": (
        Torque("world", A, from_s=1.0, until_s=4.0),
        PointForce("world", B, A, from_s=2.5, until_s=7.0),
        Torque("body", B, until_s=2.5),
    ),
}
every_load = pytest.mark.parametrize("name", LOADS)
OWN_KERNEL = {"sine body", "sine world", "gravity gradient", "spring"}
"""Loads whose truths have kernels that take 5 s to compile; the mixture contains all but the spring."""

BODIES = {
    "brick": np.diag([1.0, 2.0, 3.0]),
    "plate": np.diag([3.0, 1.0, 2.0]),
    "sphere": 2.0 * np.eye(3),
    "needle": np.diag([1.0, 1e-6, 1.0]),
    "nearly a needle": np.diag([1e-6, 1.0, 1.0 + 1e-6]),
    "nearly symmetric": np.diag([1.0, 1.0 + 1e-9, 2.0]),
}


def scene_of(inertia: Array, *loads: Load, duration_s: float = 10.0) -> Scene:
    """Return a tumbling motion about the intermediate axis of (1, 2, 3) under gravity."""
    start = State(
        np.array([0.1, -0.2, 0.3]),
        normalised(np.array([0.8, -0.3, 0.4, 0.2])),
        np.array([0.5, 0.2, -0.4]),
        np.array([0.1, 2.0, 0.1]),
    )
    return Scene(RigidBody(1.7, inertia), start, loads, np.array([0.1, 0.2, -1.5]), duration_s, 21)


@cache
def truth_of(name: str) -> tuple[Scene, Truth]:
    """Return a scene of LOADS and its truth at the samples."""
    scene = scene_of(BODIES["brick"], *LOADS[name])
    return scene, solve_truth(scene, scene.sample_times)


def askew(inertia: Array) -> Array:
    """Return the same body in other axes, symmetric to the last bit."""
    r = quaternion_to_matrix(normalised(np.array([0.3, 0.7, -0.5, 0.4])))
    turned = r @ inertia @ r.T
    return 0.5 * (turned + turned.T)


# ----------------------------------------------------------------------------------------------- accuracy


@pytest.mark.nightly(after=7)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.nightly] * (name in OWN_KERNEL)) for name in LOADS]
)
def test_errors_are_those_of_doubles(name: str) -> None:
    """Orientation, energy and momentum at each sample are within ten times eps x sensitivity of the truth."""
    scene, truth = truth_of(name)
    motion = TaylorMotion.of(scene, 1e-17).solve(scene.sample_times).trajectory
    allowed = truth.round_offs
    assert np.all(distances(scene, truth.trajectory, motion) <= 10.0 * allowed)


@pytest.mark.nightly(after=5)
@every_load
@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
def test_errors_follow_the_tolerance(name: str, tolerance: float) -> None:
    """The angle error after ten seconds is at most tolerance x sensitivity; looser ones need fewer steps."""
    scene, truth = truth_of(name)
    loose = TaylorMotion.of(scene, tolerance).solve(scene.sample_times)
    sensitivity = truth.round_off_rad[-1] / EPS
    assert distances(scene, truth.trajectory, loose.trajectory)[0, -1] <= tolerance * sensitivity
    assert loose.steps < TaylorMotion.of(scene, 1e-3 * tolerance).solve(scene.sample_times).steps


@every_load
def test_the_centre_of_mass_is_that_of_the_truth(name: str) -> None:
    """x and v are within 32 eps of the largest values of the truth, also across switches."""
    scene, truth = truth_of(name)
    motion = TaylorMotion.of(scene, 1e-17).solve(scene.sample_times).trajectory
    for found, expected in (
        (motion.position_m, truth.trajectory.position_m),
        (motion.velocity_m_s, truth.trajectory.velocity_m_s),
    ):
        assert np.max(np.abs(found - expected)) <= 32 * EPS * np.max(np.abs(expected))


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("turned", [False, True], ids=["principal axes", "askew"])
def test_any_body_in_any_axes_follows_its_closed_form(name: str, turned: bool) -> None:
    """A free body, with principal axes or not, is within ten times eps x sensitivity of the exact motion."""
    inertia = askew(BODIES[name]) if turned else BODIES[name]
    scene = scene_of(inertia)
    exact = solve_truth(scene, scene.sample_times)
    motion = TaylorMotion.of(scene, 1e-17).solve(scene.sample_times).trajectory
    allowed = exact.round_offs
    assert exact.kind == "exact"
    assert np.all(distances(scene, exact.trajectory, motion) <= 10.0 * allowed)


@pytest.mark.parametrize("omega", [(0.1, 2.0, 0.1), (0.7, -0.4, 0.9), (1.0, 0.2, -0.5)])
def test_hundred_thousand_steps_conserve_to_3e_14(omega: tuple[float, float, float]) -> None:
    """|dE/E|, |dL|/|L| and ||q| - 1| stay below 3e-14 in plain doubles over about 1e5 steps."""
    scene = scene_of(BODIES["brick"], duration_s=4e4)
    scene = replace(scene, initial=replace(scene.initial, omega_body=np.array(omega)))
    found = TaylorMotion.of(scene, 1e-17).solve(np.array([4e4]))
    q, spin = found.states[0, 0:4], scene.body.inertia @ found.states[0, 4:7]
    first = scene.body.inertia @ scene.initial.omega_body
    before, after = rotate(scene.initial.quaternion, first), rotate(q, spin)
    assert found.steps > 80_000
    assert abs(found.states[0, 4:7] @ spin / (scene.initial.omega_body @ first) - 1.0) <= 3e-14
    assert abs(np.linalg.norm(q) - 1.0) <= 3e-14
    assert np.linalg.norm(after - before) <= 3e-14 * np.linalg.norm(first)


# ------------------------------------------------------------------------------------------ principal axes


@pytest.mark.parametrize("name", BODIES)
def test_principal_axes_are_right_to_thirty_digits(name: str) -> None:
    """R(p)^T I R(p) is diagonal to 2^-105 of its moments, which are mpmath's eigenvalues; R is orthogonal."""
    inertia = fractions(askew(BODIES[name]))
    p, moments = principal_quaternion(inertia)
    turned, r = in_axes_of(p, inertia), axes_of(p)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        assert turned[3 * i + j] ** 2 <= turned[4 * i] * turned[4 * j] / 2**210
    for i in range(3):
        for j in range(3):
            assert sum(r[3 * i + k] * r[3 * j + k] for k in range(3)) == (i == j)
    with mpmath.workdps(60):
        tensor = mpmath.matrix(3, 3)
        for i in range(9):
            tensor[i // 3, i % 3] = mpmath.mpf(inertia[i].numerator) / inertia[i].denominator
        expected = sorted(mpmath.eigsy(tensor, eigvals_only=True))
        found = sorted(mpmath.mpf(x.numerator) / x.denominator for x in moments)
        assert all(abs(a - b) <= mpmath.mpf(10) ** -40 for a, b in zip(found, expected, strict=True))


@pytest.mark.parametrize("name", BODIES)
def test_diagonal_tensor_is_its_own_frame(name: str) -> None:
    """The principal frame of a diagonal tensor is the body's own frame, bit for bit."""
    p, moments = principal_quaternion(fractions(BODIES[name]))
    assert p == (1, 0, 0, 0)
    assert [float(x) for x in moments] == np.diag(BODIES[name]).tolist()


# ------------------------------------------------------------------------------------ the requested times


@every_load
def test_solve_is_repeatable(name: str) -> None:
    """A motion that is solved again after other times is the same bit for bit, as is each of its samples."""
    scene, _ = truth_of(name)
    motion = TaylorMotion.of(scene, 1e-14)
    once = motion.solve(scene.sample_times)
    motion.solve(np.array([0.5, 3.0]))
    assert np.array_equal(motion.solve(scene.sample_times).states, once.states)


@every_load
def test_dense_output_equals_shorter_runs(name: str) -> None:
    """Dense output equals a run that ends there, to 1e-12; a time given twice is returned twice."""
    scene, _ = truth_of(name)
    times = np.array([0.0, 0.0, 0.31, 1.0, 2.5, 2.5, 3.77, 4.0, 5.0])
    motion = TaylorMotion.of(scene, 1e-16)
    many = motion.solve(times)
    for k, t in enumerate(times):
        alone = motion.solve(np.array([t]))
        assert np.max(np.abs(many.states[k] - alone.states[0])) <= 1e-12
        assert alone.steps <= many.steps


def test_no_times_give_no_states() -> None:
    """An empty list of times gives empty arrays."""
    found = TaylorMotion.of(scene_of(BODIES["brick"]), 1e-12).solve(np.empty(0))
    assert found.states.shape == (0, 13)
    assert found.steps == 0


@pytest.mark.parametrize("times", [[1.0, 0.5], [-1.0], [0.0, np.nan], [1.0, np.inf]], ids=str)
def test_impossible_times_are_refused(times: list[float], expected_message: ExpectedMessage) -> None:
    """A time that is out of order, negative or not finite is refused with its value."""
    with expected_message.raises(ValueError):
        TaylorMotion.of(scene_of(BODIES["brick"]), 1e-12).solve(np.array(times))


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, 1e-20, float("nan")])
def test_impossible_tolerances_are_refused(tolerance: float) -> None:
    """A tolerance that doubles cannot meet is refused with its value."""
    with pytest.raises(ValueError, match="tolerance") as refusal:
        TaylorMotion.of(scene_of(BODIES["brick"]), tolerance)
    assert repr(tolerance) in str(refusal.value)


@pytest.mark.parametrize("loads", [(), (Torque("world", A),)], ids=["free", "forced"])
def test_overflowing_motion_ends_in_nan(loads: tuple[Load, ...]) -> None:
    """If the coefficients overflow, the states are NaN from that time on and finite before."""
    scene = scene_of(BODIES["brick"], *loads)
    scene = replace(scene, initial=replace(scene.initial, omega_body=np.full(3, 1e200)))
    found = TaylorMotion.of(scene, 1e-12).solve(np.array([0.0, 1.0, 2.0]))
    assert np.isfinite(found.states[0]).all()
    assert np.isnan(found.states[1:, 0:7]).all()


# ---------------------------------------------------------------------------------------- the plain Python

SHORT_MOTIONS = """
import json
import numpy as np
from bodycheck.reference_impl.scene import *
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion

tensor = np.array([[1.3, 0.1, -0.2], [0.1, 1.7, 0.15], [-0.2, 0.15, 2.1]])
a, b = np.array([0.7, -0.4, 0.9]), np.array([0.2, 0.35, -0.15])
loads = (Torque("world", a), PointForce("world", b, a), SineTorque("body", b, 1.1, 0.4),
         Drag(0.0, 0.1 * tensor), SineTorque("world", b, 0.7, 0.1), GravityGradient(0.5))
start = State(b, np.array([1.0, 0.0, 0.0, 0.0]), a, np.array([0.3, 1.4, -0.2]))
found = []
for acting in ((), loads):
    scene = Scene(RigidBody(1.7, tensor), start, acting, np.array([0.0, 0.0, -1.5]), 2.0, 2)
    found.append(TaylorMotion.of(scene, 1e-14).solve(np.array([0.05, 2.0])).states.tolist())
print(json.dumps(found))
"""


@pytest.mark.nightly
def test_compiled_kernels_equal_their_python_source() -> None:
    """Compiled and interpreted states agree to 1e-14, free and under every load that the frame supports."""
    compiled, interpreted = (
        np.array(printed_json(SHORT_MOTIONS, interpreted=plain)) for plain in (False, True)
    )
    assert np.max(np.abs(compiled - interpreted)) <= 1e-14
