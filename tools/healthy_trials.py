"""Check that a run accuses no healthy method, over random scenarios with every kind of load.

    python tools/healthy_trials.py --scenarios 200 --seed 1

Runs every method of every installed engine on the scenarios of tests/helpers/random_scenarios.py; if links
are off the centre of mass also the methods for these, and in turn those that run on request. Prints each
finding with its command and counts them by kind. Bullet's default damping and clamp are departures, so
findings on pybullet's @defaults are counted separately. Exit status 1 if a healthy method is accused; a case
that is unstable has grown beyond all bounds, which is a fact and not a verdict.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from trials import command

import bodycheck
from bodycheck.adapters.registry import default_engines
from bodycheck.reports.summary.cells import summary_cells
from tests.helpers.random_scenarios import write_scenario
from tests.helpers.reported_results import reported_results

_DEPARTING = ("pybullet:multibody@defaults", "pybullet:maximal@defaults")
_ON_REQUEST = (
    "mujoco:euler@defaults",
    *_DEPARTING,
    "pybullet:multibody@substeps",
    "pybullet:maximal@substeps",
    "dart:semi-implicit@defaults",
    "reference:rk4-f32",
    "reference:m1-f32",
)
_AT_ONCE = 10
_TRUE = ("property", "unstable")


def main(scenarios: int = 200, seed: int = 1) -> int:
    """Run the trials from the first seed on; return the number of accusations."""
    begin = time.perf_counter()
    found: Counter[tuple[bool, str]] = Counter()
    states: Counter[str] = Counter()
    cases = 0
    seeds = range(seed, seed + scenarios)
    with tempfile.TemporaryDirectory() as folder:
        paths = [write_scenario(seed, Path(folder)) for seed in seeds]
        for first in range(0, len(paths), _AT_ONCE):
            some = paths[first : first + _AT_ONCE]
            requested = _ON_REQUEST[first // _AT_ONCE % len(_ON_REQUEST)]
            run = bodycheck.run(some, engines=[*default_engines(), requested], speed=False)
            cases += len(run.cases)
            states.update(c.state for methods in summary_cells(run).values() for c in methods.values())
            for method, results in reported_results(run).items():
                for one in results:
                    found[method in _DEPARTING, one.kind] += 1
                    if method not in _DEPARTING and one.kind != "property":
                        print(f"{method}: {one.sentence}\n    {one.reproduce}", flush=True)
            print(f"{first + len(some)} done in {time.perf_counter() - begin:.0f} s", file=sys.stderr)
    print(f"{scenarios} scenarios, {cases} cases in {time.perf_counter() - begin:.0f} s")
    print("pairs of method and scenario: " + ", ".join(f"{n} {state}" for state, n in states.most_common()))
    for departing, whose in ((False, "healthy methods"), (True, "pybullet's @defaults")):
        kinds = {kind: n for (of, kind), n in found.items() if of == departing}
        print(f"findings of {whose}: " + (", ".join(f"{n} {kind}" for kind, n in kinds.items()) or "none"))
    return sum(n for (departing, kind), n in found.items() if not departing and kind not in _TRUE)


if __name__ == "__main__":
    command(main)
