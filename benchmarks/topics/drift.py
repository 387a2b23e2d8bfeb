"""Drift of what a free body and a heavy top keep, over a million Taylor steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.figures import Measured
from benchmarks.problems import FREE, HEAVY_TOP
from benchmarks.timing import Effort, Spread
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, rotational_energy
from bodycheck.reference_impl.pivot import rotational_inertia
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy, forcings_of, solve

# a tolerance of 1e-17 would leave a remainder that pulls |q| one way: 2e-15 over the steps, in proportion
_RESOLUTION = SeriesAccuracy(20, 1e-20, 6)
_PLAIN = SeriesAccuracy(18, 1e-17)
_PILOT_S = 200.0  # enough steps to know their mean length
_SHARES = np.array([1e-2, 1e-1, 1.0])
_SEED = 1
_LAST_DIGIT = 2.0**-53  # smaller departures are those of the readings, and no drift

Departures = Callable[[Scene, Array], Array]
"""A scene and its states (n, 13) -> (kept quantities, n): how far from the first state's, relative."""


@dataclass(frozen=True, eq=False)
class _Keeping:
    """A body, the names of what it keeps, and how far those are from where they were."""

    scene: Scene
    kept: tuple[str, ...]
    departures: Departures


def drift(effort: Effort) -> list[Measured]:
    """Follow neighbouring orbits of both bodies; sizes are rms over the orbits, growths fitted to them."""
    return [measured for keeping in (_FREE, _TOP) for measured in _drift(keeping, effort)]


def _drift(keeping: _Keeping, effort: Effort) -> list[Measured]:
    scenes = _orbits(keeping.scene, effort.orbits)
    drifts = np.array([_drifts(keeping, scene, _RESOLUTION, effort.steps) for scene in scenes])
    plain = np.array([_drifts(keeping, scene, _PLAIN, effort.steps) for scene in scenes])
    measured = []
    for i, name in enumerate(keeping.kept):
        spread = Spread.of(drifts[:, i, -1])
        note = (
            f"rms of {len(scenes)} orbits after {effort.steps:.0e} steps, six orders in double-doubles; "
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
    logs = np.log(_SHARES) - np.mean(np.log(_SHARES))
    power = float(logs @ np.log(np.maximum(sizes, _LAST_DIGIT)) / (logs @ logs))
    error = 1.0 / math.sqrt(2.0 * orbits * (logs @ logs))
    low, high = power - 2.0 * error, power + 2.0 * error
    return Measured(f"drift.{name}.growth", low, low, high, f"fitted p = {power:.2f}")


def _drifts(keeping: _Keeping, scene: Scene, resolution: SeriesAccuracy, steps: int) -> Array:
    """(kept quantities, shares): how far each is from its start after those shares of the steps."""
    pilot = solve(forcings_of(scene, _PILOT_S), scene.initial, np.array([_PILOT_S]), resolution)
    t_s = np.concatenate([[0.0], steps / pilot.steps * _PILOT_S * _SHARES])
    state = solve(forcings_of(scene, t_s[-1]), scene.initial, t_s, resolution).high
    return np.asarray(keeping.departures(scene, state)[:, 1:])


def _free_departures(scene: Scene, state: Array) -> Array:
    """|E/E0 - 1|, |L - L0| / |L0|, ||q| - 1|."""
    q, omega, inertia = state[:, :4], state[:, 4:7], scene.body.inertia
    energy = rotational_energy(inertia, omega)
    momentum = angular_momentum(quaternion_to_matrix(q), inertia, omega)
    turned = np.linalg.norm(momentum - momentum[0], axis=-1) / np.linalg.norm(momentum[0])
    return np.stack([np.abs(energy / energy[0] - 1.0), turned, np.abs(np.linalg.norm(q, axis=-1) - 1.0)])


def _top_departures(scene: Scene, state: Array) -> Array:
    """|E - E0| / K0 and |L_up - L_up0| / |L0|, about the pivot; E = omega . J omega / 2 - m g . R c."""
    assert scene.pivot is not None
    rotation, omega, inertia = quaternion_to_matrix(state[:, :4]), state[:, 4:7], rotational_inertia(scene)
    kinetic = rotational_energy(inertia, omega)
    energy = kinetic + scene.body.mass * (rotation @ scene.pivot) @ scene.gravity
    momentum = angular_momentum(rotation, inertia, omega)
    upward = momentum @ scene.gravity / np.linalg.norm(scene.gravity)
    size = np.linalg.norm(momentum[0])
    return np.stack([np.abs(energy - energy[0]) / kinetic[0], np.abs(upward - upward[0]) / size])


_FREE = _Keeping(FREE.scene, ("energy", "momentum", "norm"), _free_departures)
_TOP = _Keeping(HEAVY_TOP, ("top-energy", "top-momentum"), _top_departures)


def _rms(values: Array) -> Array:
    """Root mean square over the first axis."""
    return np.sqrt(np.mean(values**2, axis=0))


def _orbits(scene: Scene, count: int) -> list[Scene]:
    """Return the scene from starts within a thousandth of its own."""
    random = np.random.default_rng(_SEED)
    start = scene.initial
    factors = 1.0 + 1e-3 * random.uniform(-1.0, 1.0, (count, 3))
    return [
        replace(scene, initial=replace(start, omega_body=start.omega_body * factor)) for factor in factors
    ]
