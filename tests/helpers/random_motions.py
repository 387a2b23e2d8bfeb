"""Random scenes of every kind, and their motion to fifty digits by solvers independent of bodycheck."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from decimal import localcontext
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import (
    CallbackLoad,
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
from bodycheck.reference_impl.truth.truth import Truth
from bodycheck.reference_impl.wrench import sum_of_wrenches
from tests.helpers.decimal_gauss_solver import DIGITS, Oracle
from tests.helpers.integer_taylor_series import (
    BITS,
    advanced,
    exact_states,
    fixed,
    rational_inverse,
    rational_rotation,
)

MP = mpmath.mp.clone()
MP.dps = 80
QUANTITIES = ("attitude", "omega", "position", "velocity")
BOUNDS = ("bound_rad", "bound_omega_rad_s", "bound_m", "bound_m_s")
_CLOSE = 1e-22  # largest difference of two solutions by Gauss's method with different steps
_NO_GRAVITY = np.zeros(3)

# ------------------------------------------------------------------------------------------------ scenes


def turned_tensor(rng: np.random.Generator, moments: Array) -> Array:
    """Return a full tensor with approximately these moments, exactly symmetric."""
    q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tensor = q @ np.diag(moments) @ q.T
    return 0.5 * (tensor + tensor.T)


def random_moments(rng: np.random.Generator) -> Array:
    """Return the moments of a body of any shape, in any order."""
    shapes: list[Array] = [
        np.array([1.0, 2.0, 2.6]),
        np.array([1.0, 2.0, 3.0]),
        np.array([1.5, 1.5, 1.5]),
        np.array([1.5, 1.5, 2.5]),
        np.array([2.0, 2.0, 0.4]),
        np.array([1.0, 1.0 + 10.0 ** rng.uniform(-12.0, -2.0), 1.7]),
        np.array([10.0 ** rng.uniform(-5.0, -1.0), 1.0, 1.0]),
        np.sort(rng.uniform(1.0, 1.9, size=3)),
    ]
    return np.asarray(rng.permutation(shapes[rng.integers(len(shapes))]))


def random_start(rng: np.random.Generator, spin: float) -> State:
    """Return a start whose quaternion is not quite of unit norm; half of them have omega in world axes."""
    quaternion = rng.normal(size=4)
    quaternion *= (1.0 + rng.uniform(-1e-6, 1e-6)) / np.linalg.norm(quaternion)
    omega, direction = np.zeros(3), rng.normal(size=3)
    if rng.uniform() < 0.3:  # close to an axis
        direction = np.roll([1.0, *10.0 ** rng.uniform(-16.0, -1.0, size=2)], rng.integers(3))
    omega = spin * direction / np.linalg.norm(direction)
    start = State(rng.normal(size=3), quaternion, rng.normal(size=3), omega)
    if rng.uniform() < 0.5:
        return start
    world = start.rotation @ omega
    return replace(start, omega_body=start.rotation.T @ world, exact_omega_world=world)


def free_scene(seed: int) -> tuple[Scene, list[float]]:
    """Return a free body of any shape, and times up to some twenty radians."""
    rng = np.random.default_rng([1, seed])
    moments = random_moments(rng)
    tensor = turned_tensor(rng, moments) if rng.uniform() < 0.4 else np.diag(moments)
    spin = 10.0 ** rng.uniform(-3.0, 2.0)
    start = random_start(rng, spin)
    if rng.uniform() < 0.2:  # next to the separatrix, or on it
        tensor, start = np.diag([4.0, 5.0, 9.0]), replace(start, exact_omega_world=None)
        start = replace(
            start, omega_body=np.array([3.0 * (1.0 + rng.choice([0.0, 1e-15, 1e-9, 1e-3])), 2.0, 1.0])
        )
        spin = 3.7
    gravity = rng.normal(size=3) if rng.uniform() < 0.5 else _NO_GRAVITY
    until = float(rng.uniform(1.0, 20.0) / spin)
    return Scene(RigidBody(2.0, tensor), start, (), gravity, until, 2), [0.0, 0.3 * until, until]


def far_scene(seed: int) -> tuple[Scene, list[float]]:
    """Return a body with three different moments, and one time up to 1e9 s."""
    rng = np.random.default_rng([2, seed])
    moments = rng.permutation([1.0, 1.0 + rng.uniform(0.1, 0.5), 1.9])
    tensor = turned_tensor(rng, moments) if rng.uniform() < 0.4 else np.diag(moments)
    start, spin = random_start(rng, 1.0), float(10.0 ** rng.uniform(-1.0, 1.0))
    # away from the axes, so that the period is well determined by the start
    omega = spin * rng.uniform(0.3, 1.0, size=3) * rng.choice([-1.0, 1.0], size=3)
    if start.exact_omega_world is not None:
        start = replace(start, exact_omega_world=start.rotation @ omega)
    start = replace(start, omega_body=omega)
    scene = Scene(RigidBody(2.0, tensor), start, (), 1e-3 * rng.normal(size=3), 1.0, 2)
    return scene, [float(10.0 ** rng.uniform(2.0, 9.0))]


def _pulses(rng: np.random.Generator, size: float) -> tuple[Load, ...]:
    """Return torques and forces of every kind, some of which act for a limited time."""
    ends = np.sort(rng.uniform(0.0, 3.0, size=6))
    loads: list[Load] = [
        PointForce("world", size * rng.normal(size=3), 0.4 * rng.normal(size=3), ends[0], ends[4]),
        PointForce("body", size * rng.normal(size=3), 0.4 * rng.normal(size=3), ends[1]),
        Torque("world", size * rng.normal(size=3), until_s=ends[5]),
        Torque("body", size * rng.normal(size=3), ends[2], ends[3]),
    ]
    return tuple(load for load in loads if rng.uniform() < 0.7)


def _torques(rng: np.random.Generator) -> tuple[Load, ...]:
    return (Torque("body", rng.normal(size=3), 0.0, float(rng.uniform(0.5, 3.0))),)


def _drag(rng: np.random.Generator) -> tuple[Load, ...]:
    root = rng.normal(size=(3, 3))
    return (Drag(float(rng.uniform()), 0.2 * root @ root.T),)


def _sines(rng: np.random.Generator) -> tuple[Load, ...]:
    return (
        SineTorque("world", rng.normal(size=3), float(rng.uniform(0.1, 4.0)), float(rng.normal())),
        SineTorque("body", rng.normal(size=3), float(rng.uniform(0.1, 4.0)), float(rng.normal())),
    )


def _spring(rng: np.random.Generator) -> tuple[Load, ...]:
    # far enough not to pass too closely for steps of constant length
    anchor = 4.0 * np.array([1.0, 1.0, 1.0]) + rng.normal(size=3)
    return (
        Spring(anchor, 0.4 * rng.normal(size=3), float(rng.uniform(0.5, 3.0)), float(rng.uniform(0.0, 2.0))),
    )


def _torsion(rng: np.random.Generator) -> tuple[Load, ...]:
    return (TorsionSpring(float(rng.uniform(4.0, 8.0))),)


def _gradient(rng: np.random.Generator) -> tuple[Load, ...]:
    return (GravityGradient(float(rng.uniform(0.2, 1.0))),)


def _mixture(rng: np.random.Generator) -> tuple[Load, ...]:
    return (*_sines(rng), *_spring(rng), *_torsion(rng), *_drag(rng), *_gradient(rng), *_torques(rng))


def _scene(
    seed: int, family: int, loads: Callable[[np.random.Generator], tuple[Load, ...]], spin: float
) -> Scene:
    rng = np.random.default_rng([family, seed])
    moments = np.sort(rng.uniform(1.0, 1.9, size=3))
    tensor = turned_tensor(rng, moments) if rng.uniform() < 0.5 else np.diag(rng.permutation(moments))
    start = random_start(rng, spin * float(rng.uniform(0.3, 1.0)))
    gravity = rng.normal(size=3) if rng.uniform() < 0.5 else _NO_GRAVITY
    return Scene(RigidBody(2.0, tensor), start, loads(rng), gravity, 3.0, 2)


def pivoted_scene(seed: int) -> Scene:
    """Return a heavy body that rotates about a pivot, with drag."""
    scene = _scene(seed, 20, _drag, 2.0)
    rng = np.random.default_rng([21, seed])
    return replace(scene, gravity=np.array([0.0, 0.0, -4.0]), pivot=0.4 * rng.normal(size=3))


def fixed_axis_scene(seed: int) -> Scene:
    """Return a body that rotates about a principal axis, under a pulse, and drag or a sine."""
    rng = np.random.default_rng([22, seed])
    axis, moments = np.eye(3)[rng.integers(3)], rng.permutation([1.0, 1.4, 1.9])
    loads: list[Load] = [Torque("body", rng.normal() * axis, 0.3, float(rng.uniform(0.5, 2.5)))]
    if seed % 2:
        loads.append(
            SineTorque("body", rng.normal() * axis, float(rng.uniform(0.1, 4.0)), float(rng.normal()))
        )
    else:
        loads.append(Drag(0.3, np.diag(rng.uniform(0.01, 1.0, size=3))))
    start = replace(random_start(rng, 1.0), exact_omega_world=None)
    start = replace(start, omega_body=rng.normal() * axis)
    return Scene(RigidBody(2.0, np.diag(moments)), start, tuple(loads), rng.normal(size=3), 3.0, 2)


def hidden_scene(seed: int) -> Scene:
    """Return a scene whose sines and drag become a function in truth_scene."""
    return _scene(seed, 23, lambda rng: (*_sines(rng), *_drag(rng)), 1.0)


FORCED: dict[str, tuple[int, Callable[[int], Scene]]] = {
    "torques and forces": (80, lambda seed: _scene(seed, 10, lambda rng: _pulses(rng, 1.0), 2.0)),
    "body torque": (20, lambda seed: _scene(seed, 11, _torques, 2.0)),
    "fixed axis": (30, fixed_axis_scene),
    "drag": (20, lambda seed: _scene(seed, 12, _drag, 2.0)),
    "sines": (30, lambda seed: _scene(seed, 13, _sines, 2.0)),
    "spring": (30, lambda seed: _scene(seed, 14, _spring, 2.0)),
    "torsion spring": (20, lambda seed: _scene(seed, 15, _torsion, 1.0)),
    "gravity gradient": (20, lambda seed: _scene(seed, 16, _gradient, 2.0)),
    "pivot": (30, pivoted_scene),
    "mixture": (10, lambda seed: _scene(seed, 17, _mixture, 1.0)),
    "function": (10, hidden_scene),
}
"""Kind -> its number of the 300 scenes, and the function from a seed to its scene."""


def truth_scene(kind: str, scene: Scene) -> Scene:
    """Return the scene of which the truth is requested: loads of the last kind become a function."""
    if kind != "function":
        return scene
    wrench = sum_of_wrenches(scene.continuous_loads, replace(scene, gravity=np.zeros(3)))
    return replace(scene, loads=(CallbackLoad("tests:hidden", wrench),))


# ---------------------------------------------------------------------------------------- fifty digits

Exact = list[tuple[Any, Any, Any, Any]]
"""At each time R (3, 3), omega in body axes, x and v, as matrices of mpmath."""


def exact_motion(kind: str, scene: Scene, times: list[float]) -> Exact:
    """Return the motion of a scene by the solver for its kind."""
    if kind == "far":
        return [_far(scene, times[0])]
    if kind in ("free", "torques and forces", "body torque"):
        return [_parts(scene, state.state) for state in exact_states(scene, times)]
    with localcontext() as context:
        context.prec = DIGITS
        return _by_gauss(scene, times)


def _by_gauss(scene: Scene, times: list[float]) -> Exact:
    """Solve with shorter and shorter steps until two solutions agree to 1e-22."""
    oracle, step = Oracle(scene), 1.0 / 4.0
    coarse = oracle.states(times, step)
    while True:
        step *= 0.6
        fine = oracle.states(times, step)
        if (
            max(abs(x - y) for a, b in zip(coarse, fine, strict=True) for x, y in zip(a, b, strict=True))
            < _CLOSE
        ):
            break
        assert step > 1e-3, "fifty digits do not settle"
        coarse = fine
    found = []
    for y in fine:
        rotation, _, spin, position, velocity = oracle.parts(y)
        parts = (spin, position, velocity)
        found.append((_matrix(rotation), *(MP.matrix([MP.mpf(str(x)) for x in part]) for part in parts)))
    return found


def _matrix(rows: Any) -> Any:
    return MP.matrix([[MP.mpf(str(x)) for x in row] for row in rows])


def _parts(scene: Scene, state: list[int]) -> tuple[Any, Any, Any, Any]:
    y = [MP.mpf(x) / (1 << BITS) for x in state]
    rotation = MP.matrix(3, 3)
    for i in range(9):
        rotation[i // 3, i % 3] = y[i]
    momentum, velocity, position = (MP.matrix(y[i : i + 3]) for i in (9, 12, 15))
    inverse = MP.matrix(
        [[MP.mpf(x.numerator) / x.denominator for x in row] for row in rational_inverse(scene.body.inertia)]
    )
    return rotation, inverse * rotation.T * momentum, position, velocity


def _far(scene: Scene, t_s: float) -> tuple[Any, Any, Any, Any]:
    """R(n P + s) = Z^n R(s): omega repeats after its period P, and Z = R(P) R(0)^T rotates about L."""
    inverse = [[fixed(x) for x in row] for row in rational_inverse(scene.body.inertia)]
    none = [([0] * 3, [0] * 27), ([0] * 3, [0] * 27)]
    begin = exact_states(scene, [0.0])[0].state
    resting = [*begin[:12], *[0] * 6]
    period, after = _period(scene, resting, inverse, none)
    count = int(Fraction(t_s) / period)
    rest = advanced(resting, Fraction(t_s) - count * period, inverse, none)
    first, spin, _, _ = _parts(scene, rest)
    start, turned = _parts(scene, resting)[0], _parts(scene, after)[0]
    around = turned * start.T
    momentum = MP.matrix([MP.mpf(x) / (1 << BITS) for x in begin[9:12]])
    axis = momentum / MP.norm(momentum)
    sine = (
        sum(axis[i] * (around[(i + 2) % 3, (i + 1) % 3] - around[(i + 1) % 3, (i + 2) % 3]) for i in range(3))
        / 2
    )
    cosine = (around[0, 0] + around[1, 1] + around[2, 2] - 1) / 2
    t, gravity = MP.mpf(t_s), MP.matrix(scene.gravity.tolist())
    x, v = (MP.matrix(part.tolist()) for part in (scene.initial.position, scene.initial.velocity))
    return (
        _about(axis, count * MP.atan2(sine, cosine)) * first,
        spin,
        x + v * t + gravity * t**2 / 2,
        v + gravity * t,
    )


def _about(axis: Any, angle: Any) -> Any:
    """Return the matrix of a rotation (Rodrigues)."""
    a, b, c = axis
    cross = MP.matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    return MP.eye(3) + MP.sin(angle) * cross + (1 - MP.cos(angle)) * cross * cross


def _period(scene: Scene, start: list[int], inverse: Any, none: Any) -> tuple[Fraction, list[int]]:
    """Return the period of omega to fifty digits, by Newton's method, and the state after it."""
    first = _parts(scene, start)[1]
    guess = Fraction(float(_rough_period(scene, [float(x) for x in first])))
    state = advanced(start, guess, inverse, none)
    inertia = MP.matrix(scene.body.inertia.tolist())
    for _ in range(8):
        spin = _parts(scene, state)[1]
        momentum = inertia * spin
        push = MP.matrix(
            [
                momentum[(i + 1) % 3] * spin[(i + 2) % 3] - momentum[(i + 2) % 3] * spin[(i + 1) % 3]
                for i in range(3)
            ]
        )
        rate = inertia**-1 * push
        late = -sum(rate[i] * (spin[i] - first[i]) for i in range(3)) / sum(x**2 for x in rate)
        change = Fraction(int(MP.nint(late * (1 << BITS))), 1 << BITS)
        if abs(change) < Fraction(1, 10**40):
            return guess, state
        guess += change
        back = [*state] if change >= 0 else [*start]
        state = advanced(back, change if change >= 0 else guess, inverse, none)
    raise AssertionError("the period does not settle")


def _rough_period(scene: Scene, spin: list[float]) -> float:
    """4 K / lambda in doubles (Landau and Lifshitz, Mechanics, par. 37)."""
    moments, axes = np.linalg.eigh(scene.body.inertia)
    a, b, c = moments
    w = axes.T @ np.array(spin)
    energy, square = float(moments @ w**2), float((moments * w) @ (moments * w))
    if square < energy * b:
        a, c = c, a
    rate = np.sqrt((c - b) * (square - energy * a) / (a * b * c))
    modulus = (b - a) * (energy * c - square) / ((c - b) * (square - energy * a))
    return float(4.0 * MP.ellipk(MP.mpf(float(modulus))) / rate)


# ------------------------------------------------------------------------------------------- comparison


def ratios(truth: Truth, exact: Exact) -> tuple[Array, Array]:
    """Return the errors of attitude, omega, position, velocity over their bounds, and the errors, (4, n)."""
    motion = truth.trajectory
    errors = np.zeros((4, len(exact)))
    for k, (rotation, spin, position, velocity) in enumerate(exact):
        found = MP.matrix(
            [
                [MP.mpf(x.numerator) / x.denominator for x in row]
                for row in rational_rotation(motion.attitude[k])
            ]
        )
        gaps = [2 * MP.asin(MP.norm(found - rotation) / MP.sqrt(8))]
        for value, true in (
            (motion.omega_body, spin),
            (motion.position_m, position),
            (motion.velocity_m_s, velocity),
        ):
            gaps.append(MP.norm(MP.matrix(value[k].tolist()) - true))
        errors[:, k] = [float(gap) for gap in gaps]
    bounds = np.array([getattr(truth, name) for name in BOUNDS])
    return errors / bounds, errors
