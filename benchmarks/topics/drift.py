"""Drift of what a free body keeps, over a million Taylor steps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.effort import Effort
from benchmarks.figures import Measured
from benchmarks.problems import FREE
from benchmarks.timing import Spread
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, rotational_energy
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.taylor import Resolution, course_of, solve

_RESOLUTION = Resolution(18, 1e-17, 4)
_PLAIN = Resolution(18, 1e-17)
_PILOT_S = 200.0  # enough steps to know their mean length
_SHARES = np.array([1e-2, 1e-1, 1.0])
_QUANTITIES = ("energy", "momentum", "norm")
_SEED = 1


def drift(effort: Effort) -> list[Measured]:
    """Follow neighbouring orbits; sizes are rms over the orbits, growths fitted to them."""
    scenes = _orbits(effort.orbits)
    drifts = np.array([_drifts(scene, _RESOLUTION, effort.steps) for scene in scenes])
    plain = np.array([_drifts(scene, _PLAIN, effort.steps) for scene in scenes])
    measured = []
    for i, name in enumerate(_QUANTITIES):
        spread = Spread.of(drifts[:, i, -1])
        note = (
            f"rms of {len(scenes)} orbits after {effort.steps:.0e} steps, four orders in double-doubles; "
            f"all in doubles {_rms(plain[:, i, -1]):.1e}"
        )
        size = float(_rms(drifts[:, i, -1]))
        measured.append(Measured(f"drift.{name}.size", size, spread.low, spread.high, note))
        measured.append(_growth(name, _rms(drifts[:, i]), len(scenes)))
    return measured


def _growth(name: str, sizes: Array, orbits: int) -> Measured:
    """Fit log size = p log steps + const; the value is the least p that the orbits' chance allows, p - 2 s.e.

    The rms of m orbits that drift by chance is known to 1 in sqrt(2 m). Growth by chance has p = 1/2: half
    of all fits would lie above, so that p itself proves nothing.
    """
    if not sizes.all():
        return Measured(f"drift.{name}.growth", None, note="no drift yet")
    logs = np.log(_SHARES) - np.mean(np.log(_SHARES))
    power = float(logs @ np.log(sizes) / (logs @ logs))
    error = 1.0 / math.sqrt(2.0 * orbits * (logs @ logs))
    low, high = power - 2.0 * error, power + 2.0 * error
    return Measured(f"drift.{name}.growth", low, low, high, f"fitted p = {power:.2f}")


def _drifts(scene: Scene, resolution: Resolution, steps: int) -> Array:
    """(3, shares): |E/E0 - 1|, |L - L0| / |L0|, ||q| - 1| after those shares of the steps."""
    pilot = solve(course_of(scene, _PILOT_S), scene.initial, np.array([_PILOT_S]), resolution)
    t_s = np.concatenate([[0.0], steps / pilot.steps * _PILOT_S * _SHARES])
    state = solve(course_of(scene, t_s[-1]), scene.initial, t_s, resolution).high
    q, omega, inertia = state[:, :4], state[:, 4:7], scene.body.inertia
    energy = rotational_energy(inertia, omega)
    momentum = angular_momentum(quaternion_to_matrix(q), inertia, omega)
    turned = np.linalg.norm(momentum - momentum[0], axis=-1) / np.linalg.norm(momentum[0])
    drifts = np.stack([np.abs(energy / energy[0] - 1.0), turned, np.abs(np.linalg.norm(q, axis=-1) - 1.0)])
    return np.asarray(drifts[:, 1:])


def _rms(values: Array) -> Array:
    """Root mean square over the first axis."""
    return np.sqrt(np.mean(values**2, axis=0))


def _orbits(count: int) -> list[Scene]:
    """Return the free body from starts within a thousandth of its own."""
    random = np.random.default_rng(_SEED)
    start = FREE.scene.initial
    factors = 1.0 + 1e-3 * random.uniform(-1.0, 1.0, (count, 3))
    return [
        replace(FREE.scene, initial=replace(start, omega_body=start.omega_body * factor))
        for factor in factors
    ]
