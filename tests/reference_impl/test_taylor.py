"""The Taylor integrator, in both precisions, compared with forty digits in another formulation.

The forty digits are of R' = [omega]x R and L' = torque in world axes, with each load as it is defined there,
by the Gragg-Bulirsch-Stoer method in mpmath: neither its variables nor its method are those of the kernels.
"""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import mpmath
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.pivot import kinetic_energies
from bodycheck.reference_impl.rotations import normalised, rotate
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
    TorsionSpring,
)
from bodycheck.reference_impl.taylor.solution import (
    SeriesAccuracy,
    Solution,
    forcings_of,
    resolution_for,
    solve,
)
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.motion_distance import potential_energy
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.kernel_programs import printed_json

pytestmark = pytest.mark.slow  # they compile kernels that few others use

EPS = float(np.finfo(np.float64).eps)
COLUMNS = 16
Vector = list[mpmath.mpf]

# ----------------------------------------------------------------------------------------- forty digits


def exactly(values: Array) -> Vector:
    """Return doubles as mpmath numbers."""
    return [mpmath.mpf(float(x)) for x in np.ravel(values)]


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def times(m: Vector, v: Vector) -> Vector:
    """M v, M row by row."""
    return [m[3 * i] * v[0] + m[3 * i + 1] * v[1] + m[3 * i + 2] * v[2] for i in range(3)]


def transposed(m: Vector) -> Vector:
    """M^T."""
    return [m[3 * j + i] for i in range(3) for j in range(3)]


def rotation_vector(m: Vector) -> Vector:
    """Return the vector a u of a rotation matrix with a < pi."""
    axis = [(m[7] - m[5]) / 2, (m[2] - m[6]) / 2, (m[3] - m[1]) / 2]
    sine = mpmath.sqrt(sum(x * x for x in axis))
    if not sine:
        return axis
    angle = mpmath.atan2(sine, (m[0] + m[4] + m[8] - 1) / 2)
    return [angle / sine * x for x in axis]


def matrix_of(q: Array) -> Vector:
    """R(q / |q|), row by row."""
    w, x, y, z = exactly(q)
    s = 2 / (w * w + x * x + y * y + z * z)
    rows = [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)]
    rows += [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)]
    return [*rows, s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)]


class Oracle:
    """The right-hand side of one scene: y = R row by row, L, v, x, all in world axes."""

    def __init__(self, scene: Scene) -> None:
        self.scene, body = scene, scene.body
        self.mass = mpmath.mpf(body.mass)
        self.inertia = exactly(body.inertia)
        self.inverse = list(mpmath.matrix(body.inertia.tolist()) ** -1)
        self.first = matrix_of(scene.initial.quaternion)

    def start(self) -> Vector:
        """y(0)."""
        initial = self.scene.initial
        spin = times(self.first, times(self.inertia, exactly(initial.omega_body)))
        return [*self.first, *spin, *exactly(initial.velocity), *exactly(initial.position)]

    def omega_body(self, y: Vector) -> Vector:
        """I^-1 R^T L."""
        return times(self.inverse, times(transposed(y[:9]), y[9:12]))

    def __call__(self, t: mpmath.mpf, y: Vector) -> Vector:
        """y'."""
        rotation, omega_body = y[:9], self.omega_body(y)
        omega = times(rotation, omega_body)
        rates = transposed([x for i in range(3) for x in cross(omega, rotation[i::3])])
        force, torque = [self.mass * g for g in exactly(self.scene.gravity)], [mpmath.mpf(0)] * 3
        for load in self.scene.loads:
            push, turn = self.act(load, t, y, omega_body)
            force = [a + b for a, b in zip(force, push, strict=True)]
            torque = [a + b for a, b in zip(torque, turn, strict=True)]
        return [*rates, *torque, *(f / self.mass for f in force), *y[12:15]]

    def act(self, load: Load, t: mpmath.mpf, y: Vector, omega_body: Vector) -> tuple[Vector, Vector]:
        """Return the force and torque of a load in world axes, by its definition."""
        rotation, none = y[:9], [mpmath.mpf(0)] * 3
        match load:
            case Torque():
                value = exactly(load.value)
                return none, times(rotation, value) if load.axes == "body" else value
            case PointForce():
                value = exactly(load.value)
                value = times(rotation, value) if load.axes == "body" else value
                return value, cross(times(rotation, exactly(load.at)), value)
            case SineTorque():
                sine = mpmath.sin(mpmath.mpf(load.rate) * t + mpmath.mpf(load.phase))
                value = [sine * x for x in exactly(load.amplitude)]
                return none, times(rotation, value) if load.axes == "body" else value
            case Drag():
                damped = times(rotation, times(exactly(load.angular), omega_body))
                return [-mpmath.mpf(load.linear) * v for v in y[12:15]], [-x for x in damped]
            case Spring():
                arm = times(rotation, exactly(load.at))
                d = [x + a - b for x, a, b in zip(y[15:18], arm, exactly(load.anchor), strict=True)]
                length = mpmath.sqrt(sum(x * x for x in d))
                pull = -mpmath.mpf(load.stiffness) * (1 - mpmath.mpf(load.rest_length) / length)
                force = [pull * x for x in d]
                return force, cross(arm, force)
            case TorsionSpring():
                turned = [
                    sum(rotation[3 * i + a] * self.first[3 * j + a] for a in range(3))
                    for i in range(3)
                    for j in range(3)
                ]
                return none, [-mpmath.mpf(load.stiffness) * x for x in rotation_vector(turned)]
            case GravityGradient():
                n = mpmath.mpf(load.rate)
                u = [-mpmath.sin(n * t), mpmath.mpf(0), -mpmath.cos(n * t)]
                spun = times(rotation, times(self.inertia, times(transposed(rotation), u)))
                return none, [3 * n * n * x for x in cross(u, spun)]


def extrapolated(rate: Callable[..., Vector], t: mpmath.mpf, y: Vector, h: mpmath.mpf) -> Vector:
    """Make one step of order 2 COLUMNS: modified midpoint rules of 2, 4, 6 .. parts, extrapolated to none."""
    table: list[Vector] = []
    for column in range(1, COLUMNS + 1):
        n = 2 * column
        part = h / n
        before, now = y, [a + part * b for a, b in zip(y, rate(t, y), strict=True)]
        for i in range(1, n):
            slope = rate(t + i * part, now)
            before, now = now, [a + 2 * part * b for a, b in zip(before, slope, strict=True)]
        row = [now]
        for j in range(1, column):
            ratio = (mpmath.mpf(column) / (column - j)) ** 2 - 1
            row.append(
                [a + (a - b) / ratio for a, b in zip(row[j - 1], table[j - 1], strict=True)]  # Neville
            )
        table = row
    return table[-1]


@cache
def forty_digits(name: str, fineness: int) -> tuple[Vector, Vector]:
    """Return (q up to its sign .. as R, omega_body, v, x) halfway and at the end of a scene of CASES."""
    scene = CASES[name]
    with mpmath.workdps(45):
        oracle = Oracle(scene)
        y, found = oracle.start(), []
        h = mpmath.mpf(scene.duration_s) / fineness
        for i in range(fineness):
            y = extrapolated(oracle, i * h, y, h)
            if i + 1 in (fineness // 2, fineness):
                found.append([*y[:9], *oracle.omega_body(y), *y[12:18]])
    return found[0], found[1]


# ----------------------------------------------------------------------------------------- the scenes

TENSOR = np.array([[1.3, 0.1, -0.2], [0.1, 1.7, 0.15], [-0.2, 0.15, 2.1]])
A, B = np.array([0.7, -0.4, 0.9]), np.array([0.2, 0.35, -0.15])
ANGULAR = np.array([[0.3, 0.05, 0.0], [-0.1, 0.2, 0.02], [0.0, 0.04, 0.5]])
LOADS: dict[str, tuple[Load, ...]] = {
    "free": (),
    "torque body": (Torque("body", A),),
    "torque world": (Torque("world", A),),
    "force body": (PointForce("body", A, B),),
    "force world": (PointForce("world", A, B),),
    "sine body": (SineTorque("body", A, 1.7, 0.3), SineTorque("body", B, 0.9, -2.0)),
    "sine world": (SineTorque("world", A, 1.7, 0.3), SineTorque("world", B, -0.9, 2.0)),
    "drag": (Drag(0.6, ANGULAR),),
    "angular drag": (Drag(0.0, ANGULAR),),
    "spring": (Spring(A, B, 3.0, 0.4),),
    "two springs": (Spring(A, B, 3.0, 0.4), Spring(-A, -B, 2.0, 0.0)),
    "torsion spring": (TorsionSpring(2.5),),
    "gravity gradient": (GravityGradient(0.8),),
    "mixture": (
        Torque("world", 0.5 * A),
        PointForce("body", B, A),
        SineTorque("body", B, 1.1, 0.4),
        SineTorque("world", B, 0.7, 0.1),
        Drag(0.2, 0.5 * ANGULAR),
        Spring(A, B, 1.5, 0.3),
        TorsionSpring(0.8),
        GravityGradient(0.5),
    ),
}


def scene_under(*loads: Load, duration_s: float = 2.0) -> Scene:
    """Return a scene of a moving body with a full tensor and rotated axes under gravity and the loads."""
    start = State(
        np.array([0.1, -0.2, 0.3]),
        normalised(np.array([0.8, -0.3, 0.4, 0.2])),
        np.array([0.5, 0.2, -0.4]),
        np.array([0.3, 1.4, -0.2]),
    )
    return Scene(RigidBody(1.7, TENSOR), start, loads, np.array([0.1, 0.2, -1.5]), duration_s, 5)


CASES = {name: scene_under(*loads) for name, loads in LOADS.items()}
OWN_KERNEL = {"sine body", "sine world", "spring", "two springs", "torsion spring", "gravity gradient"}
"""Loads whose kernels take up to 10 s to compile; the mixture contains them too."""
every_load = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.nightly] * (n in OWN_KERNEL)) for n in LOADS]
)

TRUE = SeriesAccuracy(30, 1e-32, 19)
FINE = SeriesAccuracy(18, 1e-17)


def distances(solution: Solution, row: int, expected: Vector) -> Array:
    """Return the largest differences of R, omega, v and x from the oracle's, at its precision, (4,)."""
    with mpmath.workdps(50):
        q = [
            mpmath.mpf(float(a)) + mpmath.mpf(float(b))
            for a, b in zip(solution.high[row], solution.low[row], strict=True)
        ]
        found = [*rotation_of(q[:4]), *q[4:]]
        gaps = [abs(a - b) for a, b in zip(found, expected, strict=True)]
        parts = (gaps[:9], gaps[9:12], gaps[12:15], gaps[15:18])
        return np.array([float(max(part)) for part in parts])


def rotation_of(q: Vector) -> Vector:
    """Return R(q), quadratic in q, so that a norm other than 1 is visible."""
    w, x, y, z = q
    rows = [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)]
    rows += [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)]
    return [*rows, 2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z]


# ----------------------------------------------------------------------------------------------- tests


@pytest.mark.nightly(after=1)
@every_load
def test_double_doubles_are_right_to_thirty_digits(name: str) -> None:
    """R, omega, v and x under each load agree with the oracle to 1e-28, halfway and at the end."""
    scene = CASES[name]
    solution = solve(forcings_of(scene, 2.0), scene.initial, np.array([1.0, 2.0]), TRUE)
    for row, expected in enumerate(forty_digits(name, 6)):
        assert np.max(distances(solution, row, expected)) <= 1e-28


@every_load
def test_doubles_are_right_to_their_round_off(name: str) -> None:
    """The doubles agree within ten times eps times the sensitivity, which is small within two seconds."""
    scene = CASES[name]
    solution = solve(forcings_of(scene, 2.0), scene.initial, np.array([1.0, 2.0]), FINE)
    for row, expected in enumerate(forty_digits(name, 6)):
        assert np.max(distances(solution, row, expected)) <= 10.0 * EPS * 4.0


@pytest.mark.nightly(after=1)
@every_load
def test_truth_lies_within_its_bounds(name: str) -> None:
    """A certified truth is within bound_rad of forty digits, and that bound is below 1e-15 rad."""
    truth = solve_truth(CASES[name], np.array([1.0, 2.0]))
    assert truth.kind == ("certified" if LOADS[name] else "exact")
    assert truth.trusted_until_s == np.inf
    for row, expected in enumerate(forty_digits(name, 6)):
        with mpmath.workdps(50):
            rotation = matrix_of(truth.trajectory.attitude[row])
            gap = mpmath.sqrt(sum((a - b) ** 2 for a, b in zip(rotation, expected[:9], strict=True)))
            angle = float(2 * mpmath.asin(gap / mpmath.sqrt(8)))
        assert angle <= truth.bound_rad[row]
        omega = np.array([float(x) for x in expected[9:12]])
        assert np.max(np.abs(truth.trajectory.omega_body[row] - omega)) <= 4 * EPS
        position = np.array([float(x) for x in expected[15:18]])
        assert np.max(np.abs(truth.trajectory.position_m[row] - position)) <= 8 * EPS
        if truth.kind == "certified":
            assert truth.bound_rad[row] <= 1e-15


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["spring", "two springs", "torsion spring"])
def test_springs_conserve_the_energy(name: str) -> None:
    """K + U of gravity and springs is constant along the truth, within its bound."""
    scene = replace(CASES[name], duration_s=8.0, samples=41)
    truth = solve_truth(scene, scene.sample_times)
    kinetic, _ = kinetic_energies(scene, truth.trajectory)
    energy = kinetic + potential_energy(scene, truth.trajectory)
    scale = np.max(kinetic)
    allowed = truth.bound_energy + 16 * EPS * np.max(np.abs(energy)) / scale
    assert np.all(np.abs(energy - energy[0]) / scale <= allowed)


def test_gravity_gradient_conserves_the_jacobi_integral() -> None:
    """K - n . L + 3/2 n^2 u . I u is constant, with n along -y of the orbit's frame."""
    scene = replace(CASES["gravity gradient"], gravity=np.zeros(3), duration_s=10.0, samples=51)
    motion = solve_truth(scene, scene.sample_times).trajectory
    n, t, tensor = 0.8, motion.t_s, scene.body.inertia
    u = np.stack([-np.sin(n * t), np.zeros_like(t), -np.cos(n * t)], axis=-1)
    u_body = np.einsum("nji,nj->ni", motion.rotation_matrices, u)
    spin = rotate(motion.attitude, motion.omega_body @ tensor)
    kinetic = 0.5 * np.sum(motion.omega_body * (motion.omega_body @ tensor), axis=-1)
    # u' = n y x u: the frame of the orbit rotates about +y
    jacobi = kinetic - n * spin[:, 1] + 1.5 * n**2 * np.sum(u_body * (u_body @ tensor), axis=-1)
    assert np.max(np.abs(jacobi - jacobi[0])) <= 32 * EPS * np.max(kinetic)


@pytest.mark.nightly(after=7)
@every_load
def test_calls_of_few_steps_continue_bit_for_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled code that returns after every second step gives the same states as one call."""
    scene, times = CASES[name], np.array([0.0, 0.1, 0.77, 1.1, 2.0])
    whole = solve(forcings_of(scene, 2.0), scene.initial, times, FINE)
    monkeypatch.setattr("bodycheck.reference_impl.taylor.solution._STEPS_PER_CALL", 2)
    parts = solve(forcings_of(scene, 2.0), scene.initial, times, FINE)
    assert whole.steps > 2
    assert (parts.steps, parts.lost) == (whole.steps, whole.lost)
    assert parts.high.tobytes() == whole.high.tobytes()
    assert parts.low.tobytes() == whole.low.tobytes()


def test_signal_interrupts_a_motion_of_millions_of_steps() -> None:
    """Compiled code returns regularly, so that the process can handle a signal."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    scene, until = CASES["gravity gradient"], 1e6
    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with pytest.raises(KeyboardInterrupt):
            solve(forcings_of(scene, until), scene.initial, np.array([until]), FINE)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.nightly
def test_specialised_kernels_equal_the_general_one() -> None:
    """Loads of zero strength change nothing, so the general kernel gives the free motion."""
    idle: tuple[Load, ...] = (
        Torque("world", np.zeros(3)),
        PointForce("body", np.zeros(3), B),
        SineTorque("body", np.zeros(3), 1.0, 0.0),
        SineTorque("world", np.zeros(3), 1.0, 0.0),
        Drag(0.0, np.zeros((3, 3))),
        Spring(A, B, 0.0, 0.3),
        TorsionSpring(0.0),
        GravityGradient(0.0),
    )
    free, general = scene_under(), scene_under(*idle)
    times = np.array([0.0, 0.7, 2.0])
    for resolution in (FINE, TRUE):
        one, other = (solve(forcings_of(s, 2.0), s.initial, times, resolution) for s in (free, general))
        gap = np.abs((one.high - other.high) + (one.low - other.low))
        assert np.max(gap) <= (1e-14 if resolution is FINE else 1e-29)


@pytest.mark.nightly
@pytest.mark.parametrize("omega", [(0.1, 2.0, 0.1), (0.7, -0.4, 0.9), (1.0, 0.2, -0.5)])
def test_million_steps_conserve_to_4e_15(omega: tuple[float, float, float]) -> None:
    """With four orders in double-doubles |dE/E|, |dL|/|L| and ||q| - 1| stay below 4e-15."""
    body = RigidBody(1.0, np.diag([1.0, 2.0, 3.0]))
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array(omega))
    scene = Scene(body, start, (), np.zeros(3), 4e5, 2)
    forcings = forcings_of(scene, 4e5)
    found = solve(forcings, start, np.array([4e5]), SeriesAccuracy(18, 1e-17, 4))
    q, spin = found.high[0, 0:4], body.inertia @ found.high[0, 4:7]
    first = body.inertia @ start.omega_body
    energy = (found.high[0, 4:7] @ spin) / (start.omega_body @ first)
    assert found.steps > 500_000
    assert abs(energy - 1.0) <= 4e-15
    assert abs(np.linalg.norm(q) - 1.0) <= 4e-15
    assert np.linalg.norm(rotate(q, spin) - first) <= 4e-15 * np.linalg.norm(first)


def test_bound_grows_in_a_chaotic_motion() -> None:
    """A weight at an arm is chaotic: the bound grows, and the truth states until when it is valid."""
    tumbling = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1]))
    body = RigidBody(1.0, np.diag([1.0, 2.0, 3.0]))
    weight = PointForce("world", np.array([0.0, 0.0, -2.0]), np.array([0.0, 0.0, 1.0]))
    scene = Scene(body, tumbling, (weight,), np.zeros(3), 200.0, 201)
    truth = solve_truth(scene, scene.sample_times)
    assert 100.0 < truth.trusted_until_s < 200.0
    late = truth.trajectory.t_s >= truth.trusted_until_s
    assert np.all(truth.bound_rad[late] > 1e-10)
    assert np.all(truth.bound_rad[~late] <= 1e-10)
    assert truth.bound_rad[10] <= 1e-15


def test_dense_output_equals_short_runs() -> None:
    """Dense output and a run that ends there agree to 1e-29, also with switching loads."""
    load = Torque("body", A, from_s=0.3, until_s=1.1)
    scene = scene_under(load, SineTorque("world", B, 1.7, 0.3))
    times = np.array([0.0, 0.1, 0.3, 0.77, 1.1, 1.3, 2.0])
    many = solve(forcings_of(scene, 2.0), scene.initial, times, TRUE)
    for k, t in enumerate(times):
        alone = solve(forcings_of(scene, float(t)), scene.initial, times[k : k + 1], TRUE)
        assert np.max(np.abs((alone.high[0] - many.high[k]) + (alone.low[0] - many.low[k]))) <= 1e-29


def test_motion_without_a_series_is_refused(expected_message: ExpectedMessage) -> None:
    """A torsion spring wound to pi and a spring shortened to length zero have no truth."""
    wound = replace(scene_under(TorsionSpring(0.01)), gravity=np.zeros(3))
    with expected_message.raises(ValueError):
        solve_truth(wound, np.array([5.0]))
    start = replace(wound.initial, position=np.array([0.0, 0.0, 1.0]), velocity=np.zeros(3))
    through = replace(wound, initial=start, loads=(Spring(np.array([0.0, 0.0, 1.0]), np.zeros(3), 2.0, 0.5),))
    resting = solve_truth(through, np.array([1.0]))
    assert np.array_equal(resting.trajectory.position_m[0], start.position)
    pushed = replace(through, gravity=np.array([0.0, 0.0, -1.0]))
    with expected_message.raises(ValueError):
        solve_truth(pushed, np.array([1.0]))


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1.0, 1e-20, float("nan")])
def test_impossible_tolerances_are_refused(tolerance: float) -> None:
    """A tolerance that doubles cannot meet is refused with its value."""
    with pytest.raises(ValueError, match="tolerance") as refusal:
        resolution_for(tolerance)
    assert repr(tolerance) in str(refusal.value)


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("tolerance", [1e-9, 1e-12, 1e-15])
def test_errors_follow_the_tolerance(tolerance: float) -> None:
    """The error after two seconds of the mixture is below a hundred tolerances."""
    scene = CASES["mixture"]
    solution = solve(forcings_of(scene, 2.0), scene.initial, np.array([1.0, 2.0]), resolution_for(tolerance))
    assert np.max(distances(solution, 1, forty_digits("mixture", 6)[1])) <= 100.0 * tolerance + 40.0 * EPS


SHORT_MOTIONS = """
import json, sys
import numpy as np
from bodycheck.reference_impl.scene import *
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy, forcings_of, solve

tensor = np.array([[1.3, 0.1, -0.2], [0.1, 1.7, 0.15], [-0.2, 0.15, 2.1]])
a, b = np.array([0.7, -0.4, 0.9]), np.array([0.2, 0.35, -0.15])
loads = (Torque("world", a), PointForce("body", b, a), SineTorque("body", b, 1.1, 0.4),
         Drag(0.2, 0.1 * tensor), SineTorque("world", b, 0.7, 0.1), Spring(a, b, 1.5, 0.3),
         TorsionSpring(0.8), GravityGradient(0.5))
start = State(b, np.array([1.0, 0.0, 0.0, 0.0]), a, np.array([0.3, 1.4, -0.2]))
found = []
for acting in ((), loads):
    scene = Scene(RigidBody(1.7, tensor), start, acting, np.array([0.0, 0.0, -1.5]), 0.1, 2)
    for resolution in (SeriesAccuracy(12, 1e-14), SeriesAccuracy(20, 1e-30, 13)):
        out = solve(forcings_of(scene, 0.1), start, np.array([0.05, 0.1]), resolution)
        found.append([out.high.tolist(), out.low.tolist()])
print(json.dumps(found))
"""


@pytest.mark.nightly  # test_small_vectors.py and test_taylor_motion.py test this at each push
def test_compiled_kernels_equal_their_python_source() -> None:
    """Compiled and interpreted doubles agree to 1e-14 and double-doubles to 1e-29."""
    compiled, interpreted = (
        np.array(printed_json(SHORT_MOTIONS, interpreted=plain)) for plain in (False, True)
    )
    gap = np.max(np.abs(np.sum(compiled - interpreted, axis=1)), axis=(1, 2))
    assert np.all(gap <= np.array([1e-14, 1e-29, 1e-14, 1e-29]))
