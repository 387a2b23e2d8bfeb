"""The truth of a scene compared with forty digits, with R and the momentum in world axes as variables."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import normalised
from bodycheck.reference_impl.scene import PointForce, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.integer_taylor_series import Exact, exact_states, rational_rotation

EPS = float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Errors:
    """The errors of a truth relative to forty digits at each time, with its bounds: (n,) each."""

    angle: Array
    energy: Array
    momentum: Array
    omega: Array
    position: Array
    velocity: Array


def errors(scene: Scene, truth: Truth, exact: list[Exact]) -> Errors:
    """Return the errors of a truth in doubles relative to forty digits."""
    motion, tensor = truth.trajectory, scene.body.inertia
    assert motion.quaternion is not None
    found: dict[str, list[mpmath.mpf]] = {
        name: [] for name in ("angle", "energy", "momentum", "omega", "position", "velocity")
    }
    kinetic, momenta = [], []
    with mpmath.workdps(50):
        inertia = mpmath.matrix(tensor.tolist())
        inverse, mass = inertia**-1, mpmath.mpf(float(scene.body.mass))
        pull = mpmath.matrix(scene.gravity.tolist())

        def energy_of(
            spin: mpmath.matrix, velocity: mpmath.matrix, position: mpmath.matrix
        ) -> list[mpmath.mpf]:
            rotational = (spin.T * inertia * spin)[0] / 2
            translational = mass * (velocity.T * velocity)[0] / 2
            return [rotational + translational, rotational + translational - mass * (pull.T * position)[0]]

        for k, state in enumerate(exact):
            y = state.values()
            rotation = mpmath.matrix(3, 3)
            for i in range(9):
                rotation[i // 3, i % 3] = y[i]
            momentum, velocity, position = (mpmath.matrix(y[i : i + 3]) for i in (9, 12, 15))
            spin = inverse * rotation.T * momentum
            found_rotation = mpmath.matrix(
                [
                    [mpmath.mpf(x.numerator) / x.denominator for x in line]
                    for line in rational_rotation(motion.quaternion[k])
                ]
            )
            found_spin, found_velocity, found_position = (
                mpmath.matrix(values[k].tolist())
                for values in (motion.omega_body, motion.velocity_m_s, motion.position_m)
            )
            # |R - S|_F = 2 sqrt(2) sin(angle / 2)
            found["angle"].append(2 * mpmath.asin(mpmath.norm(found_rotation - rotation) / mpmath.sqrt(8)))
            true_energy = energy_of(spin, velocity, position)
            found["energy"].append(
                abs(energy_of(found_spin, found_velocity, found_position)[1] - true_energy[1])
            )
            found["momentum"].append(mpmath.norm(found_rotation * inertia * found_spin - momentum))
            found["omega"].append(mpmath.norm(found_spin - spin))
            found["position"].append(mpmath.norm(found_position - position))
            found["velocity"].append(mpmath.norm(found_velocity - velocity))
            kinetic.append(float(true_energy[0]))
            momenta.append(float(mpmath.norm(momentum)))
    arrays = {name: np.array([float(x) for x in values]) for name, values in found.items()}
    return Errors(
        arrays["angle"],
        arrays["energy"] / (max(kinetic) or 1.0),
        arrays["momentum"] / (max(momenta) or 1.0),
        arrays["omega"],
        arrays["position"],
        arrays["velocity"],
    )


def check_bounds(scene: Scene, times: Sequence[float]) -> tuple[Truth, Errors]:
    """Assert that the truth lies within all of its bounds of forty digits."""
    truth = solve_truth(scene, np.array(times))
    off = errors(scene, truth, exact_states(scene, times))
    assert np.all(off.angle <= truth.bound_rad), off.angle / truth.bound_rad
    assert np.all(off.energy <= truth.bound_energy), off.energy / truth.bound_energy
    assert np.all(off.momentum <= truth.bound_momentum), off.momentum / truth.bound_momentum
    assert np.all(off.omega <= truth.bound_omega_rad_s), off.omega / truth.bound_omega_rad_s
    assert np.all(off.position <= truth.bound_m), off.position / truth.bound_m
    assert np.all(off.velocity <= truth.bound_m_s), off.velocity / truth.bound_m_s
    return truth, off


TIMES = (0.0, 0.1, 1.0, 2.5, 5.0, 6.2, 7.77, 10.0)
KINDS = {
    **dict.fromkeys(("body-torque", "world-torque", "thruster", "pulsed-torque"), "certified"),
    **dict.fromkeys(("torus-spin-up",), "certified"),
    **dict.fromkeys(("tumbling", "intermediate-axis", "near-separatrix", "sphere", "symmetric-top"), "exact"),
    **dict.fromkeys(("boxes", "free-body", "full-tensor", "t-handle"), "exact"),
}


# ------------------------------------------------------------------------------------ the library


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", KINDS)
def test_truth_of_the_library_lies_within_its_bounds(name: str) -> None:
    """Angle, energy and momentum are within the bounds of forty digits, and the bounds are narrow."""
    scene = load_scenario(name).scene
    times = [t for t in TIMES if t <= scene.duration_s]
    truth, _ = check_bounds(scene, times)
    assert truth.kind == KINDS[name]
    assert np.max(truth.bound_rad) <= 1e-11
    assert np.max(truth.bound_energy) <= 1e-11
    assert np.max(truth.bound_momentum) <= 1e-11


# ------------------------------------------------------------------------------------ random scenes


def random_scene(seed: int, strength: float) -> Scene:
    """Return a full tensor, an initial rotation, gravity, and a load of each kind, two of which switch."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    a, b, c = rng.uniform(0.5, 1.5, size=3)
    tensor = turn @ np.diag([b + c, a + c, a + b]) @ turn.T

    def vector(size: float) -> Array:
        return size * rng.normal(size=3)

    loads: tuple[Torque | PointForce, ...] = (
        PointForce("world", vector(strength), vector(0.4), from_s=1.25, until_s=3.7),
        PointForce("body", vector(strength), vector(0.4), from_s=0.3),
        Torque("world", vector(0.5 * strength), until_s=4.1),
        Torque("body", vector(0.5 * strength), from_s=2.0, until_s=2.3),
        PointForce("world", vector(strength), np.zeros(3), from_s=-1.0, until_s=20.0),
    )
    start = State(vector(2.0), normalised(rng.normal(size=4)), vector(1.0), vector(0.7))
    return Scene(
        RigidBody(1.7, 0.5 * (tensor + tensor.T)), start, loads, np.array([0.3, 0.1, -9.81]), 5.0, 51
    )


@pytest.mark.parametrize("seed", range(4))
def test_truth_of_random_scenes_lies_within_its_bounds(seed: int) -> None:
    """World forces at body points, switching loads and full tensors are within the bounds."""
    truth, _ = check_bounds(random_scene(seed, 0.3), (0.0, 0.3, 1.3, 2.3, 3.7, 5.0))
    assert truth.kind == "certified"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("seed", range(10, 14))
def test_truth_under_strong_loads_lies_within_its_bounds(seed: int) -> None:
    """If strong loads amplify every error, the bound grows and still holds."""
    check_bounds(random_scene(seed, 3.0), (0.0, 0.3, 1.3, 2.3, 3.7, 5.0))


def torqued_from_rest(acceleration: float) -> Scene:
    """Return a body at rest that a torque in its own axes accelerates."""
    body = RigidBody(1.0, np.diag([1.0, 2.0, 2.5]))
    still = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3))
    load = Torque("body", acceleration * np.array([1.0, 0.5, -0.3]))
    return Scene(body, still, (load,), np.zeros(3), 1.0, 11)


@pytest.mark.parametrize("acceleration", [1e-6, 1.0, 10.0, 50.0, 1e3, 1e9])
def test_truth_of_a_body_that_starts_from_rest(acceleration: float) -> None:
    """A torque may accelerate any body from rest, since scaling by sqrt(1 / a) gives the same motion."""
    unit = 1.0 / math.sqrt(max(acceleration, 1.0))
    scene = torqued_from_rest(acceleration)
    check_bounds(scene, (0.0, 0.1 * unit, unit))


def test_truth_of_rest_is_rest() -> None:
    """Without loads and motion the truth is the initial state, and every bound is finite."""
    scene = replace(torqued_from_rest(0.0), loads=())
    for still in (scene, torqued_from_rest(0.0)):
        truth = solve_truth(still, np.array([0.0, 1.0, 100.0]))
        assert np.array_equal(truth.trajectory.attitude, np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
        assert not np.any(truth.trajectory.omega_body)
        assert not np.any(truth.trajectory.position_m)
        for bound in (truth.bound_rad, truth.bound_energy, truth.bound_momentum):
            assert np.all(np.isfinite(bound))


def test_central_force_does_not_rotate_the_body() -> None:
    """Under a world force at the centre the rotation is the free one, within both bounds."""
    free = replace(random_scene(3, 1.0), loads=(), gravity=np.zeros(3))
    pushed = replace(free, loads=(PointForce("world", np.array([1.0, -2.0, 0.5]), np.zeros(3)),))
    times = np.array([0.0, 1.0, 5.0])
    one, other = solve_truth(free, times), solve_truth(pushed, times)
    same = np.abs(np.sum(one.trajectory.attitude * other.trajectory.attitude, axis=-1))
    assert np.all(np.sqrt(np.maximum(2.0 - 2.0 * same, 0.0)) <= 1e-7)  # the square root of eps
    assert np.max(np.abs(one.trajectory.omega_body - other.trajectory.omega_body)) <= 10 * np.max(
        other.bound_rad
    )


# --------------------------------------------------------------------------------------- gravity


@pytest.mark.parametrize("name", ["boxes", "free-body"])
def test_gravity_alone_is_a_parabola(name: str) -> None:
    """x = x0 + v0 t + g t^2 / 2 and v = v0 + g t to round-off at any time, and the kind is exact."""
    scene = load_scenario(name).scene
    t = np.array([0.0, 1e-9, 0.3, 10.0, 1000.0])[:, None]
    truth = solve_truth(scene, t[:, 0])
    start, g = scene.initial, scene.gravity
    assert truth.kind == "exact"
    assert np.allclose(truth.trajectory.velocity_m_s, start.velocity + g * t, rtol=4 * EPS, atol=4 * EPS)
    fallen = start.position + start.velocity * t + 0.5 * g * t**2
    scale = np.abs(start.position) + np.abs(start.velocity * t) + np.abs(0.5 * g * t**2)
    assert np.all(np.abs(truth.trajectory.position_m - fallen) <= 4 * EPS * scale)
    assert np.all((truth.bound_rad >= 4e-15) & (truth.bound_rad <= 5e-15))


def test_gravity_does_not_rotate_the_body() -> None:
    """With and without gravity the rotation is the same, bit for bit."""
    scene = load_scenario("boxes").scene
    weightless = replace(scene, gravity=np.zeros(3))
    one, other = (solve_truth(s, np.array([0.0, 3.0, 10.0])).trajectory for s in (scene, weightless))
    assert np.array_equal(one.attitude, other.attitude)
    assert np.array_equal(one.omega_body, other.omega_body)


# ----------------------------------------------------------------------------------------- times

both_kinds = pytest.mark.parametrize("name", ["tumbling", "pulsed-torque"])


@both_kinds
def test_times_may_come_in_any_order_and_twice(name: str) -> None:
    """Shuffled times with duplicates give the rows of the sorted ones, bit for bit."""
    scene = load_scenario(name).scene
    ascending = np.array([0.0, 0.5, 1.0, 1.7, 2.5, 6.0, 6.1, 6.2, 9.9, 10.0])
    sorted_truth = solve_truth(scene, ascending)
    picks = np.array([9, 0, 4, 4, 7, 1, 2, 9, 3, 8, 6, 5, 0, 4])
    shuffled = solve_truth(scene, ascending[picks])
    assert np.array_equal(shuffled.trajectory.t_s, ascending[picks])
    for name_of in ("attitude", "omega_body", "position_m", "velocity_m_s"):
        assert np.array_equal(
            getattr(shuffled.trajectory, name_of), getattr(sorted_truth.trajectory, name_of)[picks]
        )
    for bound in ("bound_rad", "bound_energy", "bound_momentum", "round_off_rad"):
        assert np.array_equal(getattr(shuffled, bound), getattr(sorted_truth, bound)[picks])


@both_kinds
def test_truth_does_not_depend_on_the_other_times(name: str) -> None:
    """The state at a time is the same within the bound, whatever other times are requested."""
    scene = load_scenario(name).scene
    many = solve_truth(scene, scene.sample_times)
    for k in (0, 1, 25, 60, 61, 100):
        alone = solve_truth(scene, scene.sample_times[k : k + 1])
        gap = np.max(np.abs(alone.trajectory.attitude[0] - many.trajectory.attitude[k]))
        assert gap <= many.bound_rad[k]
        assert np.max(np.abs(alone.trajectory.omega_body[0] - many.trajectory.omega_body[k])) <= 1e-13


@both_kinds
def test_truth_at_zero_is_the_initial_state(name: str) -> None:
    """At t = 0 the truth is the initial state with a normalised quaternion; no times give no rows."""
    scene = load_scenario(name).scene
    for times in ([0.0], [0.0, 0.0], [4.0, 0.0], [-0.0]):
        motion = solve_truth(scene, np.array(times)).trajectory
        row = times.index(0.0)
        assert np.max(np.abs(motion.attitude[row] - scene.initial.quaternion)) <= 8 * EPS
        assert np.max(np.abs(motion.omega_body[row] - scene.initial.omega_body)) <= 8 * EPS
        assert np.array_equal(motion.position_m[row], scene.initial.position)
        assert np.array_equal(motion.velocity_m_s[row], scene.initial.velocity)
    empty = solve_truth(scene, np.zeros(0))
    assert empty.trajectory.attitude.shape == (0, 4)
    assert empty.bound_rad.shape == (0,)


@both_kinds
@pytest.mark.parametrize("bad", [-1e-300, -1.0, math.nan, math.inf, -math.inf])
def test_impossible_times_are_refused(name: str, bad: float, expected_message: ExpectedMessage) -> None:
    """A time that is negative or not finite is refused, and the message names it."""
    with expected_message.raises(ValueError) as refusal:
        solve_truth(load_scenario(name).scene, np.array([1.0, bad, 0.5]))
    assert repr(bad) in str(refusal.value)


@both_kinds
def test_quaternions_have_unit_length(name: str) -> None:
    """Every returned quaternion has unit length to round-off, over the whole duration."""
    scene = load_scenario(name).scene
    q = solve_truth(scene, scene.sample_times).trajectory.attitude
    assert np.max(np.abs(np.linalg.norm(q, axis=-1) - 1.0)) <= 4 * EPS
    # the sign never jumps, so successive quaternions are close
    assert np.min(np.sum(q[1:] * q[:-1], axis=-1)) > 0.9


@both_kinds
def test_bounds_never_shrink(name: str) -> None:
    """Bounds and round-off do not decrease with time."""
    scene = load_scenario(name).scene
    truth = solve_truth(scene, scene.sample_times)
    for bound in (truth.bound_rad, truth.bound_energy, truth.bound_momentum, truth.round_off_rad):
        assert np.all(np.diff(bound) >= 0.0)
        assert np.all(bound > 0.0)


@pytest.mark.nightly
def test_sensitivity_of_a_chaotic_motion_is_not_saturated() -> None:
    """A perturbation of 1e-13 grows as the truth states in forty digits; in doubles it saturates."""
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1]))
    torque = Torque("world", np.array([0.3, -0.2, 0.1]))
    scene = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 3.0])), start, (torque,), np.zeros(3), 50.0, 2)
    predicted = float(solve_truth(scene, np.array([50.0])).round_off_rad[0]) / EPS
    nudge = 1e-13
    pushed = replace(start, omega_body=start.omega_body + np.array([0.0, 0.0, nudge]))
    (there,), (elsewhere,) = (
        exact_states(replace(scene, initial=initial), [50.0]) for initial in (start, pushed)
    )
    apart = [float(a - b) for a, b in zip(there.values()[:9], elsewhere.values()[:9], strict=True)]
    # |R - S|_F = sqrt(2) angle for a small angle; the truth's perturbations are relative to max |omega|
    grown = float(np.linalg.norm(apart)) / math.sqrt(2.0) / nudge
    assert grown > 1e8
    assert grown < predicted < 30.0 * grown
