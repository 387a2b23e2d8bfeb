"""Closed forms of forced motion against forty digits, the certified solver, and their limits.

The forty digits are those of Euler's equations as they stand, with omega and R in body axes, whose Taylor
series are summed in integers; they know neither a fixed axis nor a stretched time.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from operator import add, mul
from typing import Any

import mpmath
import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.exact_motion import ExactMotion, closed_form_of
from bodycheck.reference_impl.closed_forms.fixed_axis import swing
from bodycheck.reference_impl.closed_forms.flight import decay_means, exponential
from bodycheck.reference_impl.rotations import normalised
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
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy, forcings_of, solve
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.motion_distance import distances
from tests.helpers.expected_messages import ExpectedMessage

MP = mpmath.MPContext()
MP.dps = 60
EPS = float(np.finfo(np.float64).eps)
TOLERANCE = 4e-15
"""The accuracy that ExactMotion.at promises: of attitude in rad, and of omega relative."""

# ---------------------------------------------------------------------------------------------- scenes

_Q = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
_TENSOR = _Q @ np.diag([1.0, 2.0, 2.5]) @ _Q.T
FULL: Array = 0.5 * (_TENSOR + _TENSOR.T)
BRICK: Array = np.diag([1.0, 2.0, 2.5])
BALL: Array = np.diag([2.0, 2.0, 2.0])
DIAGONAL: Array = np.array(
    [[5.0, 1.0, 0.0], [1.0, 5.0, 0.0], [0.0, 0.0, 5.0]]
)  # axes (1, 1, 0), (1, -1, 0), z
TILTED = (0.9, -0.3, 0.2, 0.5)
QUARTER_TURN = (1.0, 1.0, 0.0, 0.0)  # about x
TIMES = np.array([0.0, 0.1, 1.0, 2.5, 2.6, 5.3])


def body_torque(x: float, y: float, z: float, from_s: float = 0.0, until_s: float = math.inf) -> Torque:
    """Return a torque in body axes."""
    return Torque("body", np.array([x, y, z]), from_s, until_s)


def world_torque(x: float, y: float, z: float) -> Torque:
    """Return a torque in world axes."""
    return Torque("world", np.array([x, y, z]))


def drag(linear: float, angular: Any) -> Drag:
    """Return a drag whose angular part is a matrix or a diagonal."""
    matrix = np.asarray(angular, dtype=np.float64)
    return Drag(linear, np.diag(matrix) if matrix.ndim == 1 else matrix)


def scene_of(
    inertia: Array, omega: tuple[float, float, float], *loads: Load, quaternion: Any = TILTED
) -> Scene:
    """Return a scene of a body of 1.7 kg thrown in uniform gravity."""
    start = State(
        np.array([1.0, 2.0, 3.0]),
        normalised(np.array(quaternion)),
        np.array([0.3, -0.2, 0.5]),
        np.array(omega, dtype=np.float64),
    )
    return Scene(RigidBody(1.7, inertia), start, loads, np.array([0.1, 0.0, -9.81]), 10.0, 11)


def sine(axes: Any, amplitude: tuple[float, float, float], rate: float, phase: float) -> SineTorque:
    """Return a sine torque."""
    return SineTorque(axes, np.array(amplitude), rate, phase)


SCENES: dict[str, Scene] = {
    "spun up": scene_of(BRICK, (0, 0, 2), body_torque(0, 0, 0.7)),
    "slowed down and reversed": scene_of(BRICK, (0, 0, 2), body_torque(0, 0, -1.3)),
    "from rest": scene_of(BRICK, (0, 0, 0), body_torque(0, 0.3, 0)),
    "pulses": scene_of(BRICK, (0, 0, 0), body_torque(0, 0.7, 0, 1.0, 4.0), body_torque(0, -0.9, 0, 2.5)),
    "pulses and drag": scene_of(
        BRICK, (0, 1.1, 0), body_torque(0, 0.7, 0, 1.0, 4.0), drag(0.3, [0.1, 0.2, 0.3])
    ),
    "drag alone": scene_of(BRICK, (1.3, 0, 0), drag(0.3, [0.1, 0.25, 0.3])),
    "drag of full tensor": scene_of(
        DIAGONAL, (0.7, 0.7, 0), drag(0.0, [[0.3, 0.1, 0], [0.1, 0.3, 0], [0, 0, 1]])
    ),
    "about a held axis": scene_of(DIAGONAL, (0.7, -0.7, 0), body_torque(0.25, -0.25, 0)),
    "a couple of thrusters": scene_of(
        BRICK,
        (0, 0, 0),
        PointForce("body", np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.5, 0.0]), 0.5, 2.5),
        PointForce("body", np.array([-0.3, 0.0, 0.0]), np.array([0.0, -0.5, 0.0]), 0.5, 2.5),
    ),
    "sine": scene_of(BRICK, (0, 1.1, 0), sine("body", (0, 0.7, 0), 3.3, 0.4), body_torque(0, -0.3, 0, 2.5)),
    "two sines": scene_of(
        BRICK, (0, 0, 0), sine("body", (0, 0.7, 0), 30.0, -2.0), sine("body", (0, 0.2, 0), -0.7, 0.0)
    ),
    "sine of rate 0": scene_of(BRICK, (0, 0, 0), sine("body", (0, 0, 0.7), 0.0, 1.0)),
    "ball, world torque": scene_of(BALL, (0, 0, 0), world_torque(0.3, -0.5, 0.7)),
    "ball, world torque and drag": scene_of(
        BALL, (0, 0, 0), world_torque(0.3, -0.5, 0.7), drag(0.1, [0.3, 0.3, 0.3])
    ),
    "ball, body torque along spin": scene_of(BALL, (0.5, 1.0, -0.25), body_torque(-1.0, -2.0, 0.5)),
    "world torque on an axis": scene_of(
        BRICK,
        (1, 0, 0),
        world_torque(0.3, 0, 0),
        sine("world", (0.3, 0, 0), 1.0, 0.0),
        quaternion=QUARTER_TURN,
    ),
    "both axes": scene_of(
        BRICK, (0, 1, 0), world_torque(0, 0, 0.5), body_torque(0, -0.7, 0), quaternion=QUARTER_TURN
    ),
    "stretched": scene_of(BRICK, (0.3, 2, 0.1), drag(0.4, 0.25 * BRICK)),
    "stretched, full tensor": scene_of(FULL, (0.3, 2, 0.1), drag(0.4, 0.25 * FULL)),
    "stretched, hardly": scene_of(FULL, (0.3, 2, 0.1), drag(1e-9, 2.0**-40 * FULL)),
    "stretched, strongly": scene_of(FULL, (30, 200, 10), drag(40.0, 64.0 * FULL)),
    "stretched backwards": scene_of(BRICK, (0.3, 0.2, 0.1), drag(-0.05, -0.125 * BRICK)),
    "central force": scene_of(
        FULL,
        (0.3, 2, 0.1),
        PointForce("world", np.array([0.3, 1.0, 2.0]), np.zeros(3), 1.0, 2.5),
        drag(0.7, np.zeros(3)),
    ),
}


def closed(scene: Scene) -> ExactMotion:
    """Return the closed form of a scene that must have one."""
    motion = closed_form_of(scene)
    assert motion is not None
    return motion


# ------------------------------------------------------------------------------ forty digits, in integers

BITS = 190
ORDER = 40


def fixed(x: Any) -> int:
    """Return x as an integer over 2^BITS."""
    exact = Fraction(x)
    return (exact.numerator << BITS) // exact.denominator


def fixed_mp(x: Any) -> int:
    """Return an mpmath number as an integer over 2^BITS."""
    return int(MP.floor(x * MP.mpf(2) ** BITS))


def convolved(a: list[int], b: list[int], k: int) -> int:
    """sum over n of a_n b_(k - n)."""
    return sum(map(mul, a[: k + 1], b[k::-1])) >> BITS


def times(matrix: list[list[int]], vector: list[int]) -> list[int]:
    """Matrix times vector."""
    return [sum(map(mul, row, vector)) >> BITS for row in matrix]


def sine_coefficients(load: SineTorque, begin: Fraction) -> list[int]:
    """Taylor coefficients of sin(rate t + phase) at a time."""
    start = MP.mpf(load.rate) * MP.mpf(begin.numerator) / begin.denominator + MP.mpf(load.phase)
    values = [MP.sin(start), MP.cos(start), -MP.sin(start), -MP.cos(start)]
    rate = MP.mpf(load.rate)
    return [fixed_mp(values[k % 4] * rate**k / MP.factorial(k)) for k in range(ORDER)]


class FortyDigits:
    """The motion of a scene by Taylor series: R (9), omega (3), v (3) and x (3) in fixed point."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        tensor = scene.body.inertia.tolist()
        self.inertia = [[fixed(x) for x in row] for row in tensor]
        self.inverse = [[fixed_mp(x) for x in row] for row in (MP.matrix(tensor) ** -1).tolist()]
        w, x, y, z = (Fraction(c) for c in scene.initial.quaternion.tolist())
        s = 2 / (w * w + x * x + y * y + z * z)
        rotation = [
            *(1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
            *(s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
            *(s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
        ]
        start = scene.initial
        vectors = (start.omega_body, start.velocity, start.position)
        self.state = [fixed(x) for x in (*rotation, *(x for vector in vectors for x in vector.tolist()))]

    def push(self, load: Load, velocity: list[list[int]], k: int) -> list[int]:
        """Return the k-th coefficients of m v' = F; forces fixed in the body act as couples here."""
        match load:
            case PointForce(axes="world") if k == 0:
                return [fixed(x) for x in load.value.tolist()]
            case Drag():
                return [fixed(-load.linear) * v[k] >> BITS for v in velocity]
        return [0, 0, 0]

    def torque(
        self, load: Load, sines: list[int], r: list[list[int]], omega: list[list[int]], k: int
    ) -> list[int]:
        """Return the k-th coefficients of a load's torque in body axes."""
        match load:
            case Torque(axes="body") if k == 0:
                return [fixed(x) for x in load.value.tolist()]
            case Torque(axes="world"):
                return self.to_body(load.value, [1 << BITS] + [0] * ORDER, r, k)
            case SineTorque(axes="body"):
                return [fixed(x) * sines[k] >> BITS for x in load.amplitude.tolist()]
            case SineTorque(axes="world"):
                return self.to_body(load.amplitude, sines, r, k)
            case PointForce(axes="body") if k == 0:
                return [fixed(x) for x in np.cross(load.at, load.value).tolist()]
            case Drag():
                return times(
                    [[fixed(-x) for x in row] for row in load.angular.tolist()], [w[k] for w in omega]
                )
        return [0, 0, 0]

    def to_body(self, value: Array, factor: list[int], r: list[list[int]], k: int) -> list[int]:
        """Return the k-th coefficients of factor R^T value."""
        turned = [convolved(component, factor, k) for component in r]
        return [
            sum(turned[3 * j + i] * fixed(x) for j, x in enumerate(value.tolist())) >> BITS for i in range(3)
        ]

    def advance(self, begin: Fraction, h: Fraction) -> None:
        """Advance by h, within which no load switches."""
        acting = [
            load
            for load in self.scene.loads
            if not isinstance(load, Torque | PointForce) or load.from_s <= begin < load.until_s
        ]
        sines = [sine_coefficients(load, begin) if isinstance(load, SineTorque) else [] for load in acting]
        series = [[x] for x in self.state]
        r, omega, velocity = series[:9], series[9:12], series[12:15]
        momentum: list[list[int]] = [[], [], []]
        mass, gravity = Fraction(self.scene.body.mass), self.scene.gravity.tolist()
        for k in range(ORDER):
            for component, value in zip(momentum, times(self.inertia, [w[k] for w in omega]), strict=True):
                component.append(value)
            # L x omega
            torque = [
                convolved(momentum[i], omega[j], k) - convolved(momentum[j], omega[i], k)
                for i, j in ((1, 2), (2, 0), (0, 1))
            ]
            force = [0, 0, 0]
            for load, coefficients in zip(acting, sines, strict=True):
                torque = list(map(add, torque, self.torque(load, coefficients, r, omega, k)))
                force = list(map(add, force, self.push(load, velocity, k)))
            rates: list[int] = []
            for row in (r[0:3], r[3:6], r[6:9]):
                rates += [
                    convolved(row[a], omega[b], k) - convolved(row[b], omega[a], k)
                    for a, b in ((1, 2), (2, 0), (0, 1))
                ]
            rates += times(self.inverse, torque)
            rates += [
                int(f / mass) + (fixed(g) if k == 0 else 0) for f, g in zip(force, gravity, strict=True)
            ]
            rates += [v[k] for v in velocity]
            for component, rate in zip(series, rates, strict=True):
                component.append(rate // (k + 1))
        assert all(abs(component[-1]) * h**ORDER < 1 << (BITS - 130) for component in series)
        self.state = [horner(component, fixed(h)) for component in series]


def horner(coefficients: list[int], h: int) -> int:
    """Sum a series at h."""
    total = 0
    for coefficient in reversed(coefficients):
        total = (total * h >> BITS) + coefficient
    return total


def forty_digits(scene: Scene, t_s: Array, longest: float) -> list[list[Any]]:
    """Return R (9), omega, v and x (3 each) at ascending times, by steps no longer than the one given."""
    motion = FortyDigits(scene)
    edges = sorted({0.0, *t_s.tolist(), *scene.switches_before(float(t_s[-1]))})
    found = {0.0: motion.state}
    for begin, end in pairwise(map(Fraction, edges)):
        count = math.ceil((end - begin) / Fraction(longest))
        for i in range(count):
            motion.advance(begin + (end - begin) * i / count, (end - begin) / count)
        found[float(end)] = motion.state
    return [[MP.mpf(x) / (1 << BITS) for x in found[t]] for t in t_s.tolist()]


def matrix_of(q: Array) -> list[Any]:
    """R(q / |q|) (9,) in 60 digits."""
    w, x, y, z = (MP.mpf(float(c)) for c in q)
    s = 2 / (w * w + x * x + y * y + z * z)
    return [
        *(1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        *(s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)),
        *(s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)),
    ]


def gap(found: Any, true: list[Any]) -> Any:
    """|found - true|."""
    return MP.norm(MP.matrix([MP.mpf(float(a)) - b for a, b in zip(found, true, strict=True)]))


LONGEST_STEP = {"stretched, strongly": 2.0**-10, "two sines": 2.0**-6, "sine": 2.0**-3}
SHORT = {"stretched, strongly": 0.03}


@pytest.mark.slow
@pytest.mark.nightly(after=7)
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.nightly if name == "stretched" else ()) for name in SCENES]
)
def test_closed_forms_match_forty_digits(name: str) -> None:
    """Attitude and omega are accurate to 4e-15, position and velocity to rounding, under every load."""
    scene, t_s = SCENES[name], TIMES * SHORT.get(name, 1.0)
    motion = closed(scene).at(t_s)
    omega_size = position_size = velocity_size = MP.mpf(0)
    for k, state in enumerate(forty_digits(scene, t_s, LONGEST_STEP.get(name, 0.25))):
        turned = [a - b for a, b in zip(matrix_of(motion.attitude[k]), state[:9], strict=True)]
        angle = 2 * MP.asin(MP.norm(MP.matrix(turned)) / MP.sqrt(8))  # |R - S| = 2 sqrt(2) sin(angle / 2)
        assert angle <= TOLERANCE
        omega, velocity, position = state[9:12], state[12:15], state[15:18]
        omega_size = max(omega_size, MP.norm(MP.matrix(omega)))
        velocity_size = max(velocity_size, MP.norm(MP.matrix(velocity)))
        position_size = max(position_size, MP.norm(MP.matrix(position)))
        assert gap(motion.omega_body[k], omega) <= TOLERANCE * omega_size
        assert gap(motion.velocity_m_s[k], velocity) <= EPS * velocity_size
        assert gap(motion.position_m[k], position) <= EPS * position_size


# ----------------------------------------------------------------------------------- the certified solver

FINE = SeriesAccuracy(30, 1e-32, 19)


def certified(scene: Scene, t_s: Array) -> Trajectory:
    """Return the motion by the double-double Taylor solver."""
    state = solve(forcings_of(scene, float(t_s[-1])), scene.initial, t_s, FINE).high
    return Trajectory(t_s, state[:, 10:13], state[:, 7:10], state[:, 0:4], None, None, state[:, 4:7])


def random_scene(seed: int) -> Scene:
    """Return a random body about one of its axes, with pulses, constant torque, and drag or a sine."""
    rng = np.random.default_rng(seed)
    moments = 10.0 ** rng.uniform(-3.0, 3.0) * np.array([1.0, 1.3, 1.9])[rng.permutation(3)]
    axis = np.eye(3)[rng.integers(3)]

    def strength() -> Array:
        return axis * float(rng.normal() * moments[0] * 10.0 ** rng.uniform(-6.0, 1.0))

    ends = np.sort(rng.uniform(0.0, 8.0, size=4))
    loads: list[Load] = [Torque("body", strength())]
    loads += [Torque("body", strength(), float(a), float(b)) for a, b in (ends[:2], ends[1:3], ends[2:])]
    loads.append(PointForce("world", rng.normal(size=3), np.zeros(3), float(ends[0]), float(ends[3])))
    if seed % 2:
        loads.append(
            SineTorque("body", strength(), float(10.0 ** rng.uniform(-9.0, 1.5)), float(rng.normal()))
        )
        loads.append(drag(float(10.0 ** rng.uniform(-9.0, 2.0)), np.zeros(3)))
    else:
        angular = moments * 10.0 ** rng.uniform([-9.0] * 3, [1.5] * 3)
        loads.append(drag(float(10.0 ** rng.uniform(-9.0, 2.0)), angular))
    omega = axis * float(rng.choice([0.0, rng.normal()]))
    scene = scene_of(np.diag(moments), (0, 0, 0), *loads, quaternion=rng.normal(size=4))
    return replace(scene, initial=replace(scene.initial, omega_body=omega))


def random_stretched(seed: int) -> Scene:
    """Return a random full tensor tumbling under weak to strong drag that is a multiple of the tensor."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tensor = axes @ np.diag([1.0, 1.0 + 10.0 ** rng.uniform(-9.0, -0.3), 1.9]) @ axes.T
    tensor = 0.5 * (tensor + tensor.T)
    load = drag(float(rng.uniform()), 2.0 ** int(rng.integers(-30, 5)) * tensor)
    scene = scene_of(tensor, (0, 0, 0), load, quaternion=rng.normal(size=4))
    return replace(scene, initial=replace(scene.initial, omega_body=rng.normal(size=3)))


OWN_KERNEL = pytest.mark.nightly  # for loads in no other test a certified solver takes 13 s to compile


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("make", "seed"),
    [
        *((random_stretched, seed) for seed in range(8)),
        *(pytest.param(random_scene, seed, marks=[OWN_KERNEL] * (seed % 2)) for seed in range(8)),
    ],
)
def test_truth_lies_within_its_bounds_of_the_certified_solver(
    make: Callable[[int], Scene], seed: int
) -> None:
    """For random bodies and loads the truth is exact, and the certified solver agrees within its bounds."""
    scene, t_s = make(seed), np.array([0.0, 1e-9, 0.3, 2.0, 5.0, 10.0])
    truth = solve_truth(scene, t_s)
    assert truth.kind == "exact"
    off = distances(scene, certified(scene, t_s), truth.trajectory)
    assert np.all(off <= truth.bounds)
    assert np.max(truth.bound_rad) <= 5e-15


def nearly(scene: Scene) -> Scene:
    """Return the same scene with a load so small that it changes only the method of the truth."""
    return replace(scene, loads=(*scene.loads, Torque("world", np.array([1e-60, 1e-60, 1e-60]))))


@pytest.mark.parametrize(
    "name",
    [
        "spun up",
        *(
            pytest.param(name, marks=OWN_KERNEL)
            for name in ("sine", "stretched", "pulses and drag", "central force")
        ),
    ],
)
def test_round_off_is_that_of_the_certified_truth(name: str) -> None:
    """The stated round-off of a stepper does not depend on how the truth was computed."""
    scene = SCENES[name]
    exact, other = solve_truth(scene, TIMES), solve_truth(nearly(scene), TIMES)
    assert (exact.kind, other.kind) == ("exact", "certified")
    assert exact.round_offs == pytest.approx(other.round_offs, rel=1e-3)


# ------------------------------------------------------------------------------------------- long times


@pytest.mark.parametrize("t_s", [1e3, 1e6, 3e7])
def test_long_spin_up_keeps_its_digits(t_s: float) -> None:
    """theta = w0 t + tau t^2 / 2I is reduced from 1e15 rad without losing a digit."""
    scene = scene_of(BRICK, (0, 0, 2), body_torque(0, 0, 0.7), quaternion=(1, 0, 0, 0))
    motion = closed(scene).at(np.array([t_s]))
    rate = MP.mpf(0.7) / MP.mpf(2.5)
    half = (2 * MP.mpf(t_s) + rate * MP.mpf(t_s) ** 2 / 2) / 2
    assert gap(motion.attitude[0], [MP.cos(half), 0, 0, MP.sin(half)]) <= TOLERANCE / 2
    assert gap(motion.omega_body[0], [0, 0, 2 + rate * MP.mpf(t_s)]) <= 2 * EPS * motion.omega_body[0, 2]


@pytest.mark.parametrize("k", [0.75 * 2.0**-20, 0.125, 8.0])
def test_drag_for_long_ends_at_rest(k: float) -> None:
    """After 1e9 s the body rests where the free one is at s = 1 / k; a fixed axis has rotated by w0 / k."""
    inertia, omega = np.array([1.0, 2.0, 4.0]), (0.0, 3.0, 0.0)
    motion = closed(scene_of(np.diag(inertia), omega, drag(0.0, k * inertia), quaternion=(1, 0, 0, 0)))
    half = MP.mpf(3.0) / MP.mpf(k) * (1 - MP.exp(-MP.mpf(k) * 10**9)) / 2
    found = motion.at(np.array([1e9]))
    assert gap(found.attitude[0], [MP.cos(half), 0, MP.sin(half), 0]) <= TOLERANCE / 2
    assert found.omega_body[0, 1] == pytest.approx(float(3 * MP.exp(-MP.mpf(k) * 10**9)), rel=1e-12, abs=0.0)


def test_torque_that_reverses_returns_to_the_start() -> None:
    """A torque that stops and reverses the body returns it to its start, to the last digit."""
    scene = scene_of(BRICK, (0, 0, 1e6), body_torque(0, 0, -2.5e3), quaternion=(1, 0, 0, 0))
    motion = closed(scene).at(np.array([0.0, 2e3]))
    assert np.abs(motion.attitude[1] - motion.attitude[0]).max() <= EPS
    assert motion.omega_body[1, 2] == -1e6


# ---------------------------------------------------------------------------- scenes without closed form

BALANCED = scene_of(
    BRICK, (0, 0, 0), body_torque(0.7, 0, 0), world_torque(-0.7, 0, 0), quaternion=(1, 0, 0, 0)
)

NO_CLOSED_FORM: dict[str, Scene] = {
    "torque on a tumbling body": scene_of(BRICK, (0, 0.1, 2), body_torque(0, 0, 0.7)),
    "spin one ulp of nothing off the axis": scene_of(BRICK, (0, 5e-324, 2), body_torque(0, 0, 0.7)),
    "torque off the axis": scene_of(BRICK, (0, 0, 2), body_torque(0, 1e-300, 0.7)),
    "pulse off the axis": scene_of(BRICK, (0, 0, 2), body_torque(1, 0, 0, 9.0, 9.5)),
    "not a principal axis": scene_of(BRICK, (0, 0, 0), body_torque(0, 1, 1)),
    "principal but for a rounding": scene_of(FULL, (0, 0, 0), Torque("body", _Q[:, 0])),
    "world torque off the axis": scene_of(BRICK, (0, 0, 2), world_torque(0, 0, 0.7)),
    "world torque on a spinning ball": scene_of(BALL, (1, 0, 0), world_torque(0, 0, 0.7)),
    "sine off the axis": scene_of(BRICK, (0, 0, 2), sine("body", (0, 0.1, 0), 1.0, 0.0)),
    "sine and drag": scene_of(BRICK, (0, 0, 2), sine("body", (0, 0, 0.1), 1.0, 0.0), drag(0, [1, 1, 1])),
    "drag all but proportional": scene_of(
        np.diag([1.0, 2.0, 3.0]), (0.1, 1, 0.1), drag(0.0, [0.1, 0.2, 0.3])
    ),
    "drag not proportional": scene_of(BRICK, (0.1, 1, 0.1), drag(0.0, [0.1, 0.1, 0.1])),
    "drag that turns the axis": scene_of(BRICK, (0, 0, 1), drag(0.0, [[1, 0, 0.1], [0, 1, 0], [0.1, 0, 1]])),
    "thruster": scene_of(BRICK, (0, 0, 0), PointForce("body", np.ones(3), np.zeros(3))),
    "world force at a point": scene_of(BRICK, (0, 0, 0), PointForce("world", np.ones(3), np.ones(3))),
    "gravity gradient": scene_of(BRICK, (0, 0, 0), GravityGradient(1e-3)),
    "torques that cancel": BALANCED,
    "spring": scene_of(BRICK, (0, 0, 0), Spring(np.zeros(3), np.zeros(3), 1.0, 0.0)),
}


@pytest.mark.parametrize("name", NO_CLOSED_FORM)
def test_scene_near_a_closed_form_has_none(name: str) -> None:
    """A scene that does not have a closed form exactly, in its doubles, is not given one."""
    assert closed_form_of(NO_CLOSED_FORM[name]) is None


@pytest.mark.slow
def test_what_has_no_closed_form_is_certified() -> None:
    """Drag of 0.1, 0.2, 0.3 on moments 1, 2, 3 is not 0.1 of them in doubles, so its truth is certified."""
    scene = NO_CLOSED_FORM["drag all but proportional"]
    assert solve_truth(scene, TIMES).kind == "certified"


def test_cancelling_torques_leave_a_body_at_rest() -> None:
    """A body whose torques cancel has a truth and stays at rest."""
    truth = solve_truth(BALANCED, TIMES)
    assert not truth.trajectory.omega_body.any()
    assert np.ptp(truth.trajectory.attitude, axis=0).max() == 0.0


# -------------------------------------------------------------------------------------- many times


def test_times_may_come_in_any_order() -> None:
    """Times may come in any order, twice or not at all; at a switch both sides agree."""
    motion = closed(SCENES["pulses and drag"])
    picks = np.array([4, 0, 3, 3, 1])
    shuffled, ordered = motion.at(TIMES[picks]), motion.at(TIMES)
    np.testing.assert_array_equal(shuffled.attitude, ordered.attitude[picks])
    np.testing.assert_array_equal(shuffled.position_m, ordered.position_m[picks])
    assert motion.at(np.zeros(0)).attitude.shape == (0, 4)
    around = motion.at(np.nextafter(4.0, [0.0, 4.0, 9.0]))
    assert np.ptp(around.omega_body[:, 1]) <= 4 * EPS


@pytest.mark.parametrize("name", ["spun up", "stretched", "central force"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_impossible_times_are_refused(name: str, bad: float) -> None:
    """An impossible time is refused with its value."""
    with pytest.raises(ValueError, match=repr(bad)):
        closed(SCENES[name]).at(np.array([0.0, bad]))


@pytest.mark.parametrize("name", ["spun up", "two sines", "sine of rate 0"])
def test_times_beyond_the_known_angle_are_refused(name: str, expected_message: ExpectedMessage) -> None:
    """A time at which no digit of the angle would be known is refused with its value."""
    with expected_message.raises(ValueError):
        closed(SCENES[name]).at(np.array([0.0, 1e18]))


def test_limit_on_the_angle_counts_the_whole_path(expected_message: ExpectedMessage) -> None:
    """The total angle counts, not the final rate, because a body may have stopped or swung back."""
    stopped = closed(scene_of(BRICK, (0, 0, 1e13), body_torque(0, 0, -2.5e10)))
    swung = closed(scene_of(BRICK, (0, 0, 0), sine("body", (0, 0, 1e6), 1.0, 0.0)))
    whole_turns_s = float(2 * MP.pi * 1600000000000)
    for motion, t_s in ((stopped, 1e3), (swung, whole_turns_s)):
        with expected_message.raises(ValueError):
            motion.at(np.array([t_s]))


def test_impossible_body_is_refused(expected_message: ExpectedMessage) -> None:
    """An impossible tensor is refused with its value, free or under drag."""
    for loads in ((), (drag(0.0, [1, -2, 3]),)):
        with expected_message.raises(ValueError):
            closed_form_of(scene_of(np.diag([1.0, -2.0, 3.0]), (0.1, 0.2, 0.3), *loads))


# ------------------------------------------------------------------------------------------ functions


def mp_pair(x: tuple[float, float]) -> Any:
    """Return a double-double as one number."""
    return MP.mpf(x[0]) + MP.mpf(x[1])


def log_uniform(seed: int, low: float, high: float) -> list[float]:
    """Return numbers of either sign on a logarithmic scale, on both sides of 1/2."""
    rng = np.random.default_rng(seed)
    sizes = [*10.0 ** rng.uniform(low, high, size=200), 0.5, float(np.nextafter(0.5, 0.0))]
    return [float(sign * size) for size in sizes for sign in (1.0, -1.0)]


def test_exponential_matches_mpmath() -> None:
    """e^x is accurate to (1 + |x|) 2^-102 and has the right limits."""
    for x in log_uniform(1, -20.0, 2.8):
        true = MP.exp(MP.mpf(x))
        assert abs(mp_pair(exponential((x, 0.0))) / true - 1) <= (1 + abs(x)) * MP.mpf(2) ** -102
    assert exponential((-1e300, 0.0)) == (0.0, 0.0)
    assert exponential((710.0, 0.0))[0] == math.inf


def test_decay_means_match_mpmath() -> None:
    """e^-z, (1 - e^-z) / z and (z - 1 + e^-z) / z^2 are accurate to 2^-100, also if digits cancel."""
    with MP.workdps(120):
        for z in log_uniform(2, -30.0, 2.5):
            exact = MP.mpf(z)
            true = (MP.exp(-exact), -MP.expm1(-exact) / exact, (exact + MP.expm1(-exact)) / exact**2)
            tolerance = (1 + abs(z)) * MP.mpf(2) ** -100
            for found, expected in zip(decay_means((z, 0.0)), true, strict=True):
                assert abs(mp_pair(found) / expected - 1) <= tolerance
    assert decay_means((0.0, 0.0)) == ((1.0, 0.0), (1.0, 0.0), (0.5, 0.0))


def test_sine_torque_matches_mpmath() -> None:
    """theta and w of a sine torque are accurate to 2^-98 of their largest value, over 1e-20 to 1e6 rad."""
    phases = np.random.default_rng(3).uniform(-7.0, 7.0, size=500)
    for z, p in zip(log_uniform(4, -20.0, 6.0), phases.tolist(), strict=False):
        t = 3.7
        rate, phase, exact_t = z / t, MP.mpf(p), MP.mpf(t)
        angle, speed = swing((0.3, 1e-18), rate, p, t)
        with MP.workdps(100):
            a, r = MP.mpf(0.3) + MP.mpf(1e-18), MP.mpf(rate)
            end = r * exact_t + phase
            true_speed = a * (MP.cos(phase) - MP.cos(end)) / r
            true_angle = a * (exact_t * MP.cos(phase) / r - (MP.sin(end) - MP.sin(phase)) / r**2)
            largest = a * exact_t * min(MP.mpf(1), 2 / abs(r * exact_t))
            slack = (1 + abs(z)) * MP.mpf(2) ** -98
            assert abs(mp_pair(speed) - true_speed) <= slack * largest
            assert abs(mp_pair(angle) - true_angle) <= slack * largest * exact_t


# --------------------------------------------------------- a reference if the attitude has no closed form


@pytest.mark.parametrize("torque", [0.4, -0.9])
def test_symmetric_top_spun_up(torque: float) -> None:
    """For a symmetric top under a torque about its axis w3 is linear; omega across it has a quadratic phase.

    With sigma = (I3 - I1) / I1: w1 + i w2 = (w1 + i w2)(0) exp(i sigma int w3 dt). The attitude has no
    elementary form, so the truth is certified; this test checks its omega. Source: Euler's equations.
    """
    inertia, omega = np.diag([1.5, 1.5, 2.0]), (0.7, -0.3, 1.1)
    scene = scene_of(inertia, omega, body_torque(0, 0, torque))
    t_s = np.array([0.0, 0.5, 3.0, 10.0])
    truth = solve_truth(scene, t_s)
    assert truth.kind == "certified"
    for k, t in enumerate(map(MP.mpf, t_s.tolist())):
        rate = MP.mpf(torque) / 2
        phase = (MP.mpf(2.0) - MP.mpf(1.5)) / MP.mpf(1.5) * (MP.mpf(1.1) * t + rate * t**2 / 2)
        across = MP.mpc(0.7, -0.3) * MP.expj(phase)
        true = [across.real, across.imag, MP.mpf(1.1) + rate * t]
        assert gap(truth.trajectory.omega_body[k], true) <= 4 * EPS * MP.norm(MP.matrix(true))
