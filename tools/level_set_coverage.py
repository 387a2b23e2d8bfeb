"""Measure how often the 95 % intervals of estimated solids contain the exact numbers; goal: 93 to 97 %.

    python tools/level_set_coverage.py --seeds 100 --columns 10,12 --jobs 2

Estimates level sets whose mass properties are known in closed form: a smooth solid (a rotated ellipsoid), a
tilted box, and thick and thin shells, the thinnest a hundredth of a cell of the grid.
Counts, over the seeds, how often the intervals of mass, centre and inertia (ten numbers) contain the exact
ones. Prints a row per solid and number of columns: the coverage of the mass and of all ten together, each
with its own standard error over the seeds; the median half width of the mass's interval relative to the mass;
and the scatter of the mass over the seeds, in standard errors, which should be 1. Exit status 1 if the
coverage of all ten is outside 93 to 97 %. Set OMP_NUM_THREADS=1, or the jobs compete for the cores.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from trials import command

from bodycheck.reference_impl.arrays import Array
from bodycheck.scenarios.level_sets import HALF_WIDTH, Estimate, estimate
from bodycheck.scenarios.mass_properties.implicit import LevelSet
from bodycheck.scenarios.mass_properties.solid import MassProperties, primitive

_RANGE = 0.93, 0.97
_TURN = np.linalg.qr(np.array([[0.9, 0.3, -0.2], [0.1, 0.8, 0.5], [0.4, -0.3, 0.7]]))[0]
_TURN = _TURN * np.linalg.det(_TURN)


class Solid(NamedTuple):
    """The level set f <= 0 in a cube with this half edge, and the exact numbers."""

    function: Callable[[Array], Array]
    reach: float
    exact: MassProperties


def _ellipsoid(points: Array) -> Array:
    return np.asarray(np.sum((points @ _TURN / [1.0, 0.7, 0.4]) ** 2, axis=1) - 1.0)


def _box(points: Array) -> Array:
    return np.asarray(np.max(np.abs(points @ _TURN) - [0.5, 0.35, 0.2], axis=1))


def _shell(thickness: float, points: Array) -> Array:
    return np.abs(np.linalg.norm(points, axis=1) - 1.0 + 0.5 * thickness) - 0.5 * thickness


def _exact_shell(thickness: float) -> MassProperties:
    outer, inner = primitive("sphere", [1.0]), primitive("sphere", [1.0 - thickness])
    return MassProperties(outer.mass - inner.mass, outer.centre, outer.inertia - inner.inertia)


SOLIDS = {
    "ellipsoid, turned": Solid(_ellipsoid, 1.1, primitive("ellipsoid", [1.0, 0.7, 0.4]).rotated(_TURN)),
    "box, tilted": Solid(_box, 0.75, primitive("box", [1.0, 0.7, 0.4]).rotated(_TURN)),
    **{
        f"shell, {thickness:g} of its radius": Solid(
            partial(_shell, thickness), 1.05, _exact_shell(thickness)
        )
        for thickness in (0.1, 0.01, 1e-3, 3e-4)
    },
}


def numbers(properties: MassProperties) -> Array:
    """Return mass, centre and inertia as ten numbers."""
    return np.concatenate([[properties.mass], properties.centre, properties.inertia[np.triu_indices(3)]])


def half_widths(found: Estimate) -> Array:
    """Return the half widths of their intervals, in the same order."""
    half = found.half_widths()
    return np.concatenate([[half.mass], half.centre, half.inertia[np.triu_indices(3)]])


def trial(name: str, columns_log2: int, seed: int) -> tuple[Array, Array]:
    """Return the errors (10,) and the half widths (10,) of one estimate."""
    function, reach, exact = SOLIDS[name]
    corner = np.full(3, reach)
    found = estimate(LevelSet(function, -corner, corner), columns_log2=columns_log2, seed=seed)
    return numbers(found.properties) - numbers(exact), half_widths(found)


def coverage(name: str, columns_log2: int, seeds: int, run: Any) -> float:
    """Print a row, and return the fraction of intervals that contain the exact number."""
    errors, halves = map(np.array, zip(*run(partial(trial, name, columns_log2), range(seeds)), strict=True))
    held = np.abs(errors) <= halves
    mass = SOLIDS[name].exact.mass
    scatter = HALF_WIDTH * np.std(errors[:, 0], ddof=1) / np.median(halves[:, 0])
    print(
        f"{name:28} 2^{columns_log2:<3}  {_share(held[:, 0])}  {_share(held.mean(axis=1))}  "
        f"{np.median(halves[:, 0]) / mass:15.1e}  {scatter:7.2f}",
        flush=True,
    )
    return float(held.mean())


def _share(held: Array) -> str:
    """Return '94.5 +- 1.1': the mean over the seeds (n,) and its standard error, in percent."""
    error = np.std(held, ddof=1) / np.sqrt(len(held))
    return f"{100 * held.mean():5.1f} +- {100 * error:3.1f}"


def main(
    seeds: int = 100, columns: str = "10,12", solid: tuple[str, ...] = (*SOLIDS,), jobs: int = 2
) -> bool:
    """Print the figures of these solids; columns: their numbers as powers of two."""
    print(f"{'solid':28} {'':5}  {'mass, %':12}  {'all ten, %':12}  half width/mass  scatter")
    with ProcessPoolExecutor(jobs) as pool:
        found = [
            coverage(name, int(power), seeds, pool.map) for power in columns.split(",") for name in solid
        ]
    return not all(_RANGE[0] <= share <= _RANGE[1] for share in found)


if __name__ == "__main__":
    command(main)
