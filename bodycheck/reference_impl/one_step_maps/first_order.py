"""Steps with one velocity update and one pose update: the maps of most engines, M1 to M4 among them.

Each is a rule for omega, the omega with which the pose is updated (the new, the old or the mean one), and
an update of the attitude. omega is carried in body axes or in world axes, or as the angular momentum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array, solved
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Attitude,
    Loads,
    Motion,
    OneStepMap,
    Solid,
    back,
    rotated,
    stepped,
    times,
)
from bodycheck.reference_impl.rotations import (
    cross,
    hat,
    matrix_to_quaternion,
    normalised,
    project_to_so3,
    quaternion_product,
)

Pose: TypeAlias = Literal["new", "old", "mean"]
Carried: TypeAlias = Literal["body", "world", "momentum"]
"""What a method carries from step to step: omega in body or in world axes, or the angular momentum."""
CARRIED: dict[Carried, str] = {
    "body": "",
    "world": ", omega in world axes",
    "momentum": ", angular momentum in world axes",
}
"""The end of a map's name that states what it carries."""
Rule: TypeAlias = Callable[[Solid, Array, Array, Array], Array]
"""rule(solid, omega, torque, dt (..., 1)) -> the next omega; all (n, 3) in the body axes before the step."""

_NEWTON_STEPS = 12  # quadratic: five suffice at |omega| dt = 1


def gyroscopic(solid: Solid, omega: Array) -> Array:
    """omega x I omega (n, 3)."""
    return cross(omega, times(solid.inertia, omega))


def gyroscopic_derivative(solid: Solid, omega: Array) -> Array:
    """D = [omega]x I - [I omega]x (n, 3, 3), the derivative of omega x I omega."""
    return np.asarray(hat(omega) @ solid.inertia - hat(times(solid.inertia, omega)))


def _explicit(solid: Solid, omega: Array, torque: Array, dt: Array) -> Array:
    return omega + dt * times(solid.inverse, torque - gyroscopic(solid, omega))


def _linearised(
    solid: Solid, omega: Array, torque: Array, dt: Array, *, weight: float = 1.0, torque_inside: bool = True
) -> Array:
    matrix = solid.inertia + weight * dt[..., None] * gyroscopic_derivative(solid, omega)
    gyroscopic_torque = gyroscopic(solid, omega)
    if torque_inside:
        return omega + dt * solved(matrix, torque - gyroscopic_torque)
    return omega - dt * solved(matrix, gyroscopic_torque) + dt * times(solid.inverse, torque)


def _implicit(
    solid: Solid, omega: Array, torque: Array, dt: Array, *, weight: float = 1.0, torque_inside: bool = True
) -> Array:
    """Solve I (w+ - w) = dt (tau - w* x I w*), w* = w + weight (w+ - w), by Newton's iterations.

    Without the torque inside, dt I^-1 tau is added afterwards.
    """
    acting = torque if torque_inside else np.zeros_like(torque)
    found = omega
    for _ in range(_NEWTON_STEPS):
        at = omega + weight * (found - omega)
        residual = times(solid.inertia, found - omega) - dt * (acting - gyroscopic(solid, at))
        matrix = solid.inertia + weight * dt[..., None] * gyroscopic_derivative(solid, at)
        found = found - solved(matrix, residual)
    return found if torque_inside else found + dt * times(solid.inverse, torque)


def _trapezoidal(solid: Solid, omega: Array, torque: Array, dt: Array) -> Array:
    """I (w+ - w) = dt (tau - (w x I w + w+ x I w+) / 2)."""
    gyroscopic_torque, found = gyroscopic(solid, omega), omega
    for _ in range(_NEWTON_STEPS):
        mean = 0.5 * (gyroscopic_torque + gyroscopic(solid, found))
        matrix = solid.inertia + 0.5 * dt[..., None] * gyroscopic_derivative(solid, found)
        found = found - solved(matrix, times(solid.inertia, found - omega) - dt * (torque - mean))
    return found


def _no_gyroscopic_term(solid: Solid, omega: Array, torque: Array, dt: Array) -> Array:
    return omega + dt * times(solid.inverse, torque)


def _rescaled_momentum(
    solid: Solid, omega: Array, torque: Array, dt: Array, *, torque_first: bool = False
) -> Array:
    pushed = dt * times(solid.inverse, torque)
    if torque_first:
        omega = omega + pushed
    momentum = times(solid.inertia, omega)
    turned = momentum - dt * cross(omega, momentum)
    length, turned_length = (np.linalg.norm(m, axis=-1, keepdims=True) for m in (momentum, turned))
    kept = times(solid.inverse, turned * (length / np.where(turned_length > 0.0, turned_length, 1.0)))
    return kept if torque_first else kept + pushed


def _linear_in_new_omega(solid: Solid, omega: Array, torque: Array, dt: Array) -> Array:
    momentum = times(solid.inertia, omega)
    return solved(solid.inertia - dt[..., None] * hat(momentum), momentum) + dt * times(solid.inverse, torque)


@dataclass(frozen=True)
class _OmegaRule:
    """A rule for omega; name of the map with its usual pose update, and the order of that map."""

    name: str
    rule: Rule
    formula: str
    source: str
    default_pose: Pose = "new"
    order: int = 1
    aliases: tuple[str, ...] = ()
    reversible: bool = False


_RULES = (
    _OmegaRule(
        "M1",
        _explicit,
        "omega+ = omega + dt I^-1 (tau - omega x I omega)",
        "MuJoCo Euler, Bullet's btMultiBody, DART, Pinocchio with aba and integrate",
        aliases=("semi-implicit Euler",),
    ),
    _OmegaRule(
        "M2",
        _linearised,
        "omega+ = omega + dt (I + dt D)^-1 (tau - omega x I omega), D = [omega]x I - [I omega]x",
        "MuJoCo implicit, and implicitfast since 3.11",
        aliases=("linearly implicit Euler",),
    ),
    _OmegaRule(
        "M3",
        partial(_linearised, torque_inside=False),
        "omega+ = omega - dt (I + dt D)^-1 (omega x I omega) + dt I^-1 tau",
        "Bullet's btRigidBody; Catto (2015), Physics for game programmers: numerical methods, GDC",
    ),
    _OmegaRule(
        "implicit Euler",
        _implicit,
        "I (omega+ - omega) = dt (tau - omega+ x I omega+)",
        "Euler's equations by the backward Euler method, solved to convergence",
    ),
    _OmegaRule(
        "implicit gyroscopic term",
        partial(_implicit, torque_inside=False),
        "as implicit Euler without torque, then omega+ += dt I^-1 tau",
        "Bullet's BT_ENABLE_GYROSCOPIC_FORCE_IMPLICIT_WORLD, solved to convergence",
    ),
    _OmegaRule(
        "implicit midpoint",
        partial(_implicit, weight=0.5),
        "I (omega+ - omega) = dt (tau - w x I w), w = (omega + omega+) / 2",
        "Austin, Krishnaprasad and Wang (1993), J. Comput. Phys. 107, 105",
        default_pose="mean",
        order=2,
        reversible=True,
    ),
    _OmegaRule(
        "linearised midpoint",
        partial(_linearised, weight=0.5),
        "omega+ = omega + dt (I + dt D / 2)^-1 (tau - omega x I omega)",
        "the implicit midpoint rule with one Newton iteration (Rosenbrock 1963)",
        default_pose="mean",
        order=2,
    ),
    _OmegaRule(
        "linearised midpoint gyroscopic term",
        partial(_linearised, weight=0.5, torque_inside=False),
        "omega+ = omega - dt (I + dt D / 2)^-1 (omega x I omega) + dt I^-1 tau",
        "as M3 about the midpoint",
        default_pose="mean",
        order=2,
    ),
    _OmegaRule(
        "trapezoidal rule",
        _trapezoidal,
        "I (omega+ - omega) = dt (tau - (omega x I omega + omega+ x I omega+) / 2)",
        "Simo and Wong (1991), Int. J. Numer. Meth. Eng. 31, 19",
        default_pose="mean",
        order=2,
        reversible=True,
    ),
    _OmegaRule(
        "rescaled momentum",
        _rescaled_momentum,
        "I omega+ = |L| (L - dt omega x L) / |L - dt omega x L| + dt tau, L = I omega",
        "Jolt's MotionProperties::ApplyGyroscopicForceInternal",
        aliases=("Jolt",),
    ),
    _OmegaRule(
        "rescaled momentum, torque first",
        partial(_rescaled_momentum, torque_first=True),
        "w' = omega + dt I^-1 tau, L = I w', I omega+ = |L| (L - dt w' x L) / |L - dt w' x L|",
        "PhysX 5's gyroscopic forces; Rapier's, in its solver's iterations",
        aliases=("PhysX 5",),
    ),
    _OmegaRule(
        "gyroscopic term of the new omega and the old momentum",
        _linear_in_new_omega,
        "I w' + dt w' x L = L, L = I omega; omega+ = w' + dt I^-1 tau",
        "ODE's dWorldStep with dBodySetGyroscopicMode",
        aliases=("ODE",),
    ),
    _OmegaRule(
        "no gyroscopic term",
        _no_gyroscopic_term,
        "omega+ = omega + dt I^-1 tau",
        "cannon-es; Rapier, Jolt and PhysX by default",
        order=0,
    ),
)


def _rotated_at_most(q: Array, angle: Array) -> Array:
    """As rotated up to pi/4; beyond, q (cos(pi/8), sin(pi/8) angle / (pi/4)), normalised (Bullet)."""
    size = np.linalg.norm(angle, axis=-1, keepdims=True)
    limited = np.minimum(size, 0.25 * np.pi)
    scale = np.sin(0.5 * limited) / np.where(limited > 0.0, limited, 1.0)
    return normalised(quaternion_product(q, np.concatenate([np.cos(0.5 * limited), scale * angle], axis=-1)))


def _added(q: Array, angle: Array) -> Array:
    """q + q angle / 2, not normalised."""
    pure = np.concatenate([np.zeros_like(angle[..., :1]), 0.5 * angle], axis=-1)
    return q + quaternion_product(q, pure)


def _added_and_normalised(q: Array, angle: Array) -> Array:
    return normalised(_added(q, angle))


@dataclass(frozen=True)
class _Update:
    """How the attitude is advanced with w: by a function of the quaternion, or by adding to a matrix."""

    suffix: str
    """The end of a map's name."""
    formula: str
    attitude: Attitude
    of_quaternion: Callable[[Array, Array], Array] | None = None


def _updates(matrix_rate: str) -> tuple[_Update, ...]:
    """Return every update; matrix_rate: the formula of R'."""
    return (
        _Update("", "q+ = q exp(dt w / 2)", "group", rotated),
        _Update(
            ", step angle at most pi/4",
            "q+ = q (cos(a/2), dt w sin(a/2) / a) normalised, a = dt |w| up to pi/4",
            "group",
            _rotated_at_most,
        ),
        _Update(", additive quaternion", "q+ = q + dt q w / 2, never renormalised", "quaternion", _added),
        _Update(
            ", additive quaternion renormalised",
            "q+ = q + dt q w / 2, divided by |q+|",
            "unit quaternion",
            _added_and_normalised,
        ),
        _Update(", additive matrix", f"R+ = R + dt {matrix_rate}", "matrix"),
        _Update(
            ", additive matrix projected",
            f"R+ = R + dt {matrix_rate}, projected onto SO(3)",
            "projected matrix",
        ),
    )


_POSES: dict[Pose, str] = {"new": "w = omega+", "old": "w = omega", "mean": "w = (omega + omega+) / 2"}


@dataclass(frozen=True)
class _Scheme:
    """One map of this family as a callable."""

    rule: Rule | None
    pose: Pose
    carried: Carried
    update: _Update

    def __call__(self, solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        h = np.asarray(dt)[..., None]
        rotation = motion.orthogonal
        advanced = self.update.of_quaternion
        matrix = motion.matrix if advanced is None else rotation
        omega_world = times(rotation, motion.omega)
        force, torque = loads(motion.t, motion.position, matrix, motion.velocity, omega_world)
        velocity = motion.velocity + h * force / solid.mass[..., None]
        position = motion.position + h * _chosen(self.pose, motion.velocity, velocity)
        if self.carried == "momentum":
            momentum = momentum_of(solid, matrix, omega_world) + h * times(matrix, torque)
            new_world = times(matrix, times(solid.inverse, back(matrix, momentum)))
            old, new = back(rotation, omega_world), back(rotation, new_world)
        else:
            assert self.rule is not None
            old, new = motion.omega, self.rule(solid, motion.omega, torque, h)
        angle = h * _chosen(self.pose, old, new)
        after = replace(stepped(motion, np.asarray(dt)), position=position, velocity=velocity)
        if advanced is None:
            projected = self.update.attitude == "projected matrix"
            after = _with_matrix(after, _advanced_matrix(matrix, rotation, angle, self.carried, projected))
        else:
            after = replace(after, quaternion=advanced(motion.quaternion, angle), rotation=None)
        if self.carried == "body":
            return replace(after, omega=new)
        if self.carried == "world":
            return replace(after, omega=back(after.orthogonal, times(rotation, new)))
        return replace(after, omega=_omega_of(solid, after, momentum))


def _chosen(pose: Pose, old: Array, new: Array) -> Array:
    return new if pose == "new" else old if pose == "old" else 0.5 * (old + new)


def _advanced_matrix(
    matrix: Array, rotation: Array, angle: Array, carried: Carried, projected: bool
) -> Array:
    if carried == "body":
        advanced = matrix + matrix @ hat(angle)
    else:
        advanced = matrix + hat(times(rotation, angle)) @ matrix
    return project_to_so3(advanced) if projected else advanced


def _with_matrix(motion: Motion, matrix: Array) -> Motion:
    return replace(motion, rotation=matrix, quaternion=matrix_to_quaternion(project_to_so3(matrix)))


def momentum_of(solid: Solid, matrix: Array, omega_world: Array) -> Array:
    """L (n, 3) with omega = R I^-1 R^T L, for an R that need not be orthogonal."""
    inward = solved(matrix, omega_world)
    return solved(np.swapaxes(matrix, -1, -2), times(solid.inertia, inward))


def _omega_of(solid: Solid, after: Motion, momentum: Array) -> Array:
    """omega in body axes of the momentum (n, 3) in world axes."""
    omega_world = times(after.matrix, times(solid.inverse, back(after.matrix, momentum)))
    return back(after.orthogonal, omega_world)


def first_order_maps() -> Iterator[OneStepMap]:
    """Yield every map of this family once."""
    for rule in _RULES:
        poses: tuple[Pose, ...] = ("new", "old", "mean")
        for pose in poses:
            # a step about omega+ leaves omega+ as it is, in both frames
            frames: tuple[Carried, ...] = ("body",) if pose == "new" else ("body", "world")
            for carried in frames:
                yield from _with_updates(rule, pose, carried)
    yield from _momentum_maps()


def _with_updates(rule: _OmegaRule, pose: Pose, carried: Carried) -> Iterator[OneStepMap]:
    name = rule.name
    if pose != rule.default_pose:
        name += f", pose from the {pose} omega"
    if carried == "world":
        name += ", omega in world axes"
    natural = pose == rule.default_pose and carried == "body"
    reversible = rule.reversible and natural
    order = rule.order if natural else min(rule.order, 1)
    for update in _updates("R [w]x"):
        full = name + update.suffix
        yield OneStepMap(
            full,
            f"{rule.formula}; {update.formula}, {_POSES[pose]}",
            rule.source,
            order,
            _Scheme(rule.rule, pose, carried, update),
            update.attitude,
            aliases=_ALIASES.get(full, rule.aliases if full == rule.name else ()),
            reversible=reversible and update.of_quaternion is not None,
        )


_ALIASES = {
    "M1, additive quaternion": ("M4", "Drake discrete"),
    "M1, additive quaternion renormalised": ("Newton SemiImplicit", "M1 by the Cayley map"),
    "M1, step angle at most pi/4": ("Bullet's btMultiBody",),
    "M3, step angle at most pi/4": ("Bullet's btRigidBody",),
    "M1, pose from the old omega": ("explicit Euler on the rotation group",),
    "M1, pose from the old omega, additive quaternion": ("explicit Euler", "quaternion-euler"),
    "Buss 2000, order 1": ("lie-euler",),
    "Buss 2000, order 1, additive matrix": ("Baraff and Witkin 1997",),
    "Buss 2000, order 1, additive matrix projected": ("euler-svd",),
}


def _momentum_maps() -> Iterator[OneStepMap]:
    """Yield the maps that carry the angular momentum: L+ = L + dt tau, omega+ = I(R+)^-1 L+."""
    names: dict[Pose, str] = {
        "old": "Buss 2000, order 1",
        "new": "angular momentum",
        "mean": "angular momentum, mean omega",
    }
    for pose, name in names.items():
        shared = f"L+ = L + dt tau, omega+ = I(R+)^-1 L+, {_POSES[pose]} with I(R)^-1 L+ for omega+"
        source = "Buss (2000), J. Comput. Phys. 164, 377" if pose == "old" else "Baraff and Witkin (1997)"
        for update in _updates("[w]x R"):
            full = name + update.suffix
            yield OneStepMap(
                full,
                f"{shared}; {update.formula}",
                source,
                1,
                _Scheme(None, pose, "momentum", update),
                update.attitude,
                aliases=_ALIASES.get(full, ()),
            )
