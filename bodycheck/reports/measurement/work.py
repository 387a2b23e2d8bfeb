"""Work of the loads along the samples of a case, for the energy balance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.load import Instants, Load, checked_continuous
from bodycheck.reference_impl.scene import Scene, Torque
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_bodies import joints_of
from bodycheck.reference_impl.trees.tree_scene import BodyLoad, JointSineTorque, TreeScene, interval
from bodycheck.reference_impl.wrench import constant_loads_between, wrench_at

_DEGREES = (7, 5)  # of the splines through the power; their difference estimates the error


def working_loads(scene: Scene, start_s: float, end_s: float) -> list[Load]:
    """Return the loads that act throughout [start_s, end_s) and have no potential energy."""
    continuous = [
        load
        for load in scene.continuous_loads
        if not checked_continuous(load, "the balance of energy").potential_needs
    ]
    return [*constant_loads_between(scene, start_s, end_s), *continuous]


def does_work(scene: Scene | TreeScene) -> bool:
    """Whether any load, or any damper of a tree, does work that no potential accounts for."""
    if isinstance(scene, TreeScene):
        return bool(scene.loads) or any(body.joint.damping for body in scene.bodies)
    return bool(scene.piecewise_constant_loads or working_loads(scene, 0.0, scene.duration_s))


def work_done(scene: Scene | TreeScene, motion: Trajectory) -> tuple[Array, float] | None:
    """W_k = integral from 0 to t_k of F . v + tau . omega, without loads that have a potential.

    The power at the samples is integrated by splines between the switches. Returns (n,) in J and its error in
    J; None where a switch lies between samples, an interval between switches has too few samples, the scene
    has a continuous load, or the body has a pivot. Of a tree, sines and dampers count too.
    """
    if not isinstance(scene, TreeScene) and (scene.continuous_loads or scene.pivot is not None):
        return None
    t, n = motion.t_s, len(motion.t_s)
    ends = [0.0, *scene.switches_before(scene.duration_s), scene.duration_s]
    indices = [int(np.argmin(np.abs(t - end))) for end in ends]
    if any(abs(t[k] - end) > 1e-9 * scene.sample_interval_s for k, end in zip(indices, ends, strict=True)):
        return None
    work, error = np.zeros(n), 0.0
    for (first, last), (start, end) in zip(pairwise(indices), pairwise(ends), strict=True):
        inside = slice(first, last + 1)
        if isinstance(scene, TreeScene):
            powers = _tree_power(scene, start, end, motion)
        elif loads := constant_loads_between(scene, start, end):
            powers = power(scene, loads, motion)
        else:
            work[inside] = work[first]
            continue
        if last - first < _DEGREES[0]:
            return None
        done, gap = _integrals(t[inside], powers[inside])
        work[inside] = work[first] + done
        error += gap
    return work, error


def _integrals(t: Array, power: Array) -> tuple[Array, float]:
    fine, coarse = (running_integral(t.tobytes(), degree)(power) for degree in _DEGREES)
    return fine, float(np.max(np.abs(fine - coarse)))


@lru_cache(maxsize=64)  # all cases of a scenario have the same samples, and each costs a factorisation
def running_integral(samples: bytes, degree: int) -> Callable[[Array], Array]:
    """W_k = integral from t_0 to t_k of the spline through the values at t: c = B^-1 P, W = A (sum of h c).

    samples: the times t (n,) in s, as the bytes of their doubles, n > degree. The spline has this odd degree
    k and no knots at the (k - 1) / 2 samples next to either end. B holds its basis at t, A the basis of its
    antiderivative, of degree k + 1, and h is the width of a basis function over k + 1. The returned function
    takes and returns (n,). Source: de Boor (2001), A Practical Guide to Splines, chapter X, equations 22 and
    27.
    """
    # imported here: takes half a second, and only forced scenes need it
    from scipy.interpolate import BSpline
    from scipy.sparse.linalg import splu

    t, half = np.frombuffer(samples), (degree + 1) // 2
    knots = np.concatenate([np.repeat(t[0], degree + 1), t[half:-half], np.repeat(t[-1], degree + 1)])
    solve = splu(BSpline.design_matrix(t, knots, degree).tocsc()).solve
    widths = (knots[degree + 1 :] - knots[: -degree - 1]) / (degree + 1)
    wider = np.concatenate([knots[:1], knots, knots[-1:]])
    antiderivative = BSpline.design_matrix(t, wider, degree + 1)

    def integral(values: Array) -> Array:
        heights = np.concatenate([[0.0], np.cumsum(widths * solve(values))])
        return np.asarray(antiderivative @ heights)

    return integral


def power(scene: Scene, loads: Sequence[Load], motion: Trajectory) -> Array:
    """P = F . v + tau . omega of these loads at each sample, (n,) in W."""
    instants = Instants(
        t=motion.t_s,
        position=motion.position_m,
        rotation=motion.rotation_matrices,
        velocity=motion.velocity_m_s,
        omega=motion.omega_world,
    )
    total = np.zeros(len(motion.t_s))
    for load in loads:
        force, torque = wrench_at(load, scene, instants)
        total += np.sum(force * instants.velocity + torque * instants.omega, axis=-1)
    return total


def _tree_power(scene: TreeScene, start_s: float, end_s: float, motion: Trajectory) -> Array:
    """P = sum of tau u, F . v and tau . omega of the loads that act throughout, less d u^2: (n,) in W."""
    u = np.hstack([one.u for one in joints_of(scene, motion)]) if motion.u is None else motion.u
    total = np.zeros(len(motion.t_s))
    for body, rates in zip(scene.bodies, scene.rate_slices, strict=True):
        total -= body.joint.damping * np.sum(u[:, rates] ** 2, axis=1)
    for load in scene.loads:
        from_s, until_s = interval(load)
        if not (from_s <= start_s and end_s <= until_s):
            continue
        if isinstance(load, JointSineTorque):
            sine = load.amplitude * np.sin(load.rate * motion.t_s + load.phase)
            total += sine * u[:, scene.rate_slices[load.body].start]
        elif not isinstance(load, BodyLoad):
            total += u[:, scene.rate_slices[load.body]] @ load.value
        else:
            one, rotation = load.load, motion.rotation_matrices[:, load.body]
            omega = motion.omega_world[:, load.body]
            value = rotation @ one.value if one.axes == "body" else np.broadcast_to(one.value, omega.shape)
            at = np.zeros_like(omega) if isinstance(one, Torque) else rotation @ one.at
            moved = motion.velocity_m_s[:, load.body] + np.cross(omega, at)
            total += np.sum(value * (omega if isinstance(one, Torque) else moved), axis=1)
    return total
