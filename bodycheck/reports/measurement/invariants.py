"""Invariants of a scene besides energy and momentum, and their drift along a trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.dynamics import angular_momentum, principal_axes, rotational_energy
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.rotations import normalised, rotate
from bodycheck.reference_impl.scene import GravityGradient, Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.tree_bodies import tree_momenta
from bodycheck.reference_impl.trees.tree_scene import WORLD, BodyLoad, TreeScene

_EQUAL = 1e-12  # relative tolerance: equal moments, and arms along or across an axis
_ORBIT_NORMAL = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Invariant:
    """A quantity (n,) that the true motion conserves.

    needs: which of attitude and omega it depends on. size: the scale of its drift, computed from the truth.
    """

    name: str
    needs: frozenset[str]
    of: Callable[[Trajectory], Array]
    size: Callable[[Trajectory], float]


@dataclass(frozen=True, eq=False)
class InvariantDrift:
    """The signed departure of an invariant from the truth over time (n,), in its SI unit, and its size."""

    name: str
    departure: Array
    size: float

    @property
    def relative(self) -> Array | None:
        """The departure over the size (n,); None where the size is 0."""
        return self.departure / self.size if self.size > 0.0 else None

    @property
    def columns(self) -> dict[str, Any]:
        """The columns of results.csv."""
        largest = float(np.max(np.abs(self.departure)))
        columns = {"invariant": self.name, "invariant_drift_abs": largest}
        return columns | ({"invariant_drift": largest / self.size} if self.size > 0.0 else {})


def invariant_drifts(
    invariants: Sequence[Invariant], truth: Trajectory, trajectory: Trajectory
) -> list[InvariantDrift]:
    """Return the drift of each invariant along a trajectory, at the samples of the truth."""
    return [
        InvariantDrift(one.name, one.of(trajectory) - one.of(truth), one.size(truth)) for one in invariants
    ]


def worst_drift(drifts: Sequence[InvariantDrift]) -> InvariantDrift | None:
    """Return the drift that is largest relative to its size; None if there are no invariants."""
    return max(drifts, key=lambda drift: drift.columns.get("invariant_drift", -1.0), default=None)


def invariants_of(scene: Scene | TreeScene) -> list[Invariant]:
    """Return the invariants of the scene besides energy and momentum."""
    if isinstance(scene, TreeScene):
        return list(_momentum_of_the_root(scene))
    return [*_spin(scene), *_vertical_momentum(scene), *_jacobi(scene), *_kovalevskaya(scene)]


def symmetry_axis(inertia: Array) -> Array | None:
    """Return the symmetry axis (3,) of a symmetric top in body axes; None for a sphere or a triaxial body."""
    moments, axes = principal_axes(inertia)
    low, high = (abs(moments[i + 1] - moments[i]) <= _EQUAL * moments[2] for i in (0, 1))
    return None if low == high else np.asarray(axes[:, 2 if low else 0])


def _is_heavy_top(scene: Scene) -> bool:
    """Whether gravity is the only load on a pivoted body."""
    return scene.pivot is not None and not scene.loads and bool(scene.gravity.any())


def _spin(scene: Scene) -> Iterator[Invariant]:
    """omega . axis of a symmetric top, free or heavy with its centre of mass on the axis."""
    axis = symmetry_axis(rotational_inertia(scene))
    if axis is None:
        return
    on_axis = scene.pivot is not None and _is_zero(np.cross(scene.pivot, axis), scene.pivot)
    if scene.is_free_rotation or (_is_heavy_top(scene) and on_axis):
        yield Invariant(
            "spin about the symmetry axis",
            frozenset({"omega"}),
            lambda motion: motion.omega_body @ axis,
            lambda truth: largest_norm(truth.omega_body),
        )


def _vertical_momentum(scene: Scene) -> Iterator[Invariant]:
    """L . g / |g| about the pivot: the weight has no torque about the vertical."""
    if _is_heavy_top(scene):
        vertical = scene.gravity / np.linalg.norm(scene.gravity)
        yield Invariant(
            "vertical angular momentum about the pivot",
            frozenset({"attitude", "omega"}),
            lambda motion: _momentum(scene, motion) @ vertical,
            lambda truth: largest_norm(_momentum(scene, truth)),
        )


def _jacobi(scene: Scene) -> Iterator[Invariant]:
    """1/2 omega . I omega - n h . L + 3/2 n^2 u . I u, with h the orbit normal and u the radial direction.

    h = y for u(t) = (-sin nt, 0, -cos nt). Source: Hughes (1986), Spacecraft Attitude Dynamics, section 9.1.
    """
    gradients = [load for load in scene.loads if isinstance(load, GravityGradient)]
    if len(gradients) != 1 or len(scene.loads) != 1:
        return
    rate, inertia = gradients[0].rate, scene.body.inertia

    def jacobi(motion: Trajectory) -> Array:
        angle = rate * motion.t_s
        u = np.stack([-np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
        radial_body = np.einsum("nji,nj->ni", motion.rotation_matrices, u)
        field = 3.0 * rate**2 * rotational_energy(inertia, radial_body)
        turning = rotational_energy(inertia, motion.omega_body)
        return turning - rate * (_momentum(scene, motion) @ _ORBIT_NORMAL) + field

    def size(truth: Trajectory) -> float:
        return float(np.max(rotational_energy(inertia, truth.omega_body)))

    yield Invariant("Jacobi integral", frozenset({"attitude", "omega"}), jacobi, size)


def _kovalevskaya(scene: Scene) -> Iterator[Invariant]:
    """|(p + i q)^2 - c (a + i b)|^2, c = m g l / I3, p along the arm of the centre of mass, (a, b, .) upward.

    Holds for I1 = I2 = 2 I3 about the pivot and the centre of mass in the plane of axes 1 and 2. Source:
    Kovalevskaya (1889), Acta Mathematica 12, 177.
    """
    if not _is_heavy_top(scene):
        return
    inertia = rotational_inertia(scene)
    axis, arm = symmetry_axis(inertia), -np.asarray(scene.pivot)
    length = float(np.linalg.norm(arm))
    if axis is None or not length or not _is_zero(np.array([arm @ axis]), arm):
        return
    first = arm / length
    second = np.cross(axis, first)
    smallest, equatorial = axis @ inertia @ axis, first @ inertia @ first
    if abs(equatorial - 2.0 * smallest) > _EQUAL * equatorial:
        return
    weight = float(np.linalg.norm(scene.gravity))
    up, c = -scene.gravity / weight, scene.body.mass * weight * length / smallest

    def parts(motion: Trajectory) -> tuple[Array, Array]:
        up_body = np.einsum("nji,j->ni", motion.rotation_matrices, up)
        spin = motion.omega_body @ first + 1j * (motion.omega_body @ second)
        return spin**2, c * (up_body @ first + 1j * (up_body @ second))

    def kovalevskaya(motion: Trajectory) -> Array:
        spin, pull = parts(motion)
        return np.asarray(np.abs(spin - pull) ** 2)

    def size(truth: Trajectory) -> float:
        spin, pull = parts(truth)
        return float(np.max((np.abs(spin) + np.abs(pull)) ** 2))

    yield Invariant("Kovalevskaya's invariant", frozenset({"attitude", "omega"}), kovalevskaya, size)


def _momentum_of_the_root(scene: TreeScene) -> Iterator[Invariant]:
    """L . e about the root's joint, or P . e along it, where nothing outside the tree acts so."""
    roots = [k for k, body in enumerate(scene.bodies) if body.joint.parent == WORLD]
    joint = scene.bodies[roots[0]].joint
    pushed = [load for load in scene.loads if isinstance(load, BodyLoad) or load.body == roots[0]]
    kind, weight = joint.of_kind, float(np.linalg.norm(scene.gravity))
    if len(roots) > 1 or pushed or joint.stiffness or joint.damping or kind.translation is Translation.SPACE:
        return
    along = rotate(normalised(joint.zero), normalised(joint.axis)) if kind.has_axis else None
    if kind.rotation is Rotation.NONE and along is not None:
        if abs(scene.gravity @ along) > _EQUAL * weight:
            return
        slide = along
        yield Invariant(
            "momentum along the root's slide",
            frozenset({"velocity"}),
            lambda motion: tree_momenta(scene, motion)[0] @ slide,
            lambda truth: largest_norm(tree_momenta(scene, truth)[0]),
        )
        return
    if along is None and weight:
        along = scene.gravity / weight
    if along is None or kind.translation or np.linalg.norm(np.cross(scene.gravity, along)) > _EQUAL * weight:
        return

    axis = along

    def about(motion: Trajectory) -> Array:
        linear, angular = tree_momenta(scene, motion)
        return angular - np.cross(joint.at_parent, linear)

    yield Invariant(
        "angular momentum about the root's axis" if kind.has_axis else "vertical angular momentum",
        frozenset({"position", "velocity", "attitude", "omega"}),
        lambda motion: about(motion) @ axis,
        lambda truth: largest_norm(about(truth)),
    )


def _momentum(scene: Scene, motion: Trajectory) -> Array:
    return angular_momentum(motion.rotation_matrices, rotational_inertia(scene), motion.omega_body)


def _is_zero(vector: Array, reference: Array) -> bool:
    return bool(np.linalg.norm(vector) <= _EQUAL * np.linalg.norm(reference))
