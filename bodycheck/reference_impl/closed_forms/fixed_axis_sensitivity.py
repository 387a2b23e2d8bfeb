"""Departures of nearby motions from a rotation about a fixed axis, at a cost independent of the time.

With w' = J^-1 (tau - d w) about the axis e, and body axes throughout, small departures obey

    delta omega' = w K delta omega - I^-1 C delta omega + I^-1 (tau_w x delta theta),
    K delta omega = I^-1 (I delta omega x e + I e x delta omega),
    delta theta' = delta omega - w e x delta theta,

tau_w the torque constant in world axes. The terms in w are solved exactly, with the angle from the closed
form; so are the remaining terms; the two parts alternate (Strang splitting, 1968). Few nodes suffice for
many revolutions, because the splitting error averages out over them.
"""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.closed_forms.fixed_axis import FixedAxisRotation
from bodycheck.reference_impl.closed_forms.piecewise_constant_loads import PiecewiseLoads, loads_of
from bodycheck.reference_impl.rotations import hat
from bodycheck.reference_impl.scene import Scene

_NODES = 1024  # evenly spaced, and as many again clustered at the start
_MAX_TIMES = 4096  # times of a truth that are themselves nodes
_SHORTEST = 1e-9  # of the whole: the first of the clustered nodes
_TERMS = 12  # of the exponential series, for norms up to 1/4
_LARGEST = 1e100  # limit of a departure: beyond it no digit is meaningful


def departures(scene: Scene, rotation: FixedAxisRotation, t_s: Array) -> Array:
    """Return the matrices (n, 6, 6) from (delta omega, delta theta) at t = 0 to ascending times t_s (n,)."""
    loads = loads_of(scene)
    assert loads is not None
    nodes = _nodes(scene, t_s)
    steps = _steps(scene, loads, rotation, nodes)
    propagated = np.empty((len(nodes), 6, 6))
    propagated[0] = np.eye(6)
    for k, step in enumerate(steps):
        propagated[k + 1] = np.clip(step @ propagated[k], -_LARGEST, _LARGEST)
    return propagated[np.searchsorted(nodes, t_s)]


def _nodes(scene: Scene, t_s: Array) -> Array:
    """Return ascending times from 0 to the last of t_s (n,), including the switches."""
    end = float(t_s[-1]) if len(t_s) else 0.0
    graded = np.geomspace(_SHORTEST, 1.0, _NODES)
    own = t_s if len(t_s) <= _MAX_TIMES else t_s[-1:]
    grid = [[0.0], own, scene.switches_before(end), end * graded, end * np.linspace(0.0, 1.0, _NODES)]
    nodes = np.unique(np.concatenate([np.asarray(part, dtype=np.float64) for part in grid]))
    return nodes[nodes <= end]


def _steps(scene: Scene, loads: PiecewiseLoads, rotation: FixedAxisRotation, nodes: Array) -> Array:
    """Return the matrices (n - 1, 6, 6) from each node (n,) to the next."""
    axis, inertia = rotation.axis, scene.body.inertia
    inverse = np.linalg.inv(inertia)
    half = 0.5 * np.diff(rotation.angle(nodes))
    half_rotation = np.zeros((len(half), 6, 6))
    half_rotation[:, :3, :3] = _swept(inverse @ (hat(inertia @ axis) - hat(axis) @ inertia), half)
    half_rotation[:, 3:, 3:] = _swept(-hat(axis), half)
    rate = np.zeros((len(half), 6, 6))
    drag = np.array(loads.angular_drag, dtype=np.float64).reshape(3, 3)
    rate[:, :3, :3] = -inverse @ drag
    rate[:, :3, 3:] = _world_torques(scene, loads, axis, nodes)[:, None, None] * (inverse @ hat(axis))
    rate[:, 3:, :3] = np.eye(3)
    linear_flow = _exponential(np.diff(nodes)[:, None, None] * rate)
    return np.asarray(half_rotation @ linear_flow @ half_rotation)


def _world_torques(scene: Scene, loads: PiecewiseLoads, axis: Array, nodes: Array) -> Array:
    """Return the mean torque about the axis between nodes (n - 1,), of loads in world axes, N m."""
    in_world = scene.initial.rotation @ axis
    starts = np.array([piece.begin_s for piece in loads.pieces])
    torques = np.array([piece.torque_world for piece in loads.pieces], dtype=np.float64) @ in_world
    means = torques[np.searchsorted(starts, nodes[:-1], side="right") - 1]
    for sine in loads.sines:
        if sine.axes == "world":
            phase = sine.rate * nodes + sine.phase
            mean, swept = np.sin(0.5 * (phase[1:] + phase[:-1])), 0.5 * np.diff(phase)
            means = means + (sine.amplitude @ in_world) * mean * np.sinc(swept / np.pi)
    return np.asarray(means)


def _swept(matrix: Array, angle: Array) -> Array:
    """exp(a M) = 1 + M sin(r a) / r + M^2 (1 - cos(r a)) / r^2, M^3 = -r^2 M: (3, 3), (n,) -> (n, 3, 3)."""
    square = matrix @ matrix
    mu = 0.5 * float(np.trace(square))
    root = np.sqrt(abs(mu))
    x = root * angle
    if root == 0.0:
        first, second = angle, 0.5 * angle**2
    elif mu < 0.0:
        first, second = np.sin(x) / root, 2.0 * (np.sin(0.5 * x) / root) ** 2
    else:
        x = np.clip(x, -200.0, 200.0)  # e^200 exceeds every meaningful departure
        first, second = np.sinh(x) / root, 2.0 * (np.sinh(0.5 * x) / root) ** 2
    return np.asarray(np.eye(3) + first[:, None, None] * matrix + second[:, None, None] * square)


def _exponential(exponents: Array) -> Array:
    """e^X for each X (n, 6, 6): the series of X / 2^k, squared k times."""
    size = float(np.max(np.abs(exponents).sum(axis=-1), initial=0.0))
    squarings = max(int(np.ceil(np.log2(size))) + 2, 0) if size > 0.0 else 0
    small = exponents / 2.0**squarings
    total = np.broadcast_to(np.eye(6), exponents.shape)
    for k in range(_TERMS, 0, -1):
        total = np.eye(6) + small @ total / k
    for _ in range(squarings):
        total = np.clip(total @ total, -_LARGEST, _LARGEST)
    return total
