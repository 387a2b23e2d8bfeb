"""Print which planted faults of trees `bodycheck dynamics` names, and how healthy engines do.

    python tools/dynamics_trials.py faults [--trees 8] [NAME ...]
    python tools/dynamics_trials.py healthy [--trees 100] [ENGINE ...]

faults: each fault of tests/helpers/faulty_tree_models.py on random trees; exit status 1 if one is not named
first with its parameters within 5 %. healthy: mujoco, dart and pinocchio; exit status 1 if one is accused.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from bodycheck.adapters.registry import registered
from bodycheck.examine.dynamics.dynamics_document import dynamics_document
from bodycheck.examine.dynamics.engine_dynamics import EngineDynamics
from bodycheck.reports.document import print_document
from bodycheck.runs.dynamics_run import DynamicsOptions, dynamics
from tests.helpers.faulty_tree_models import PLANTED, FaultyTrees, PlantedTreeFault

_HEALTHY = ("mujoco", "dart", "pinocchio")
_CLOSE = 0.05


def is_named(fault: PlantedTreeFault, found: EngineDynamics) -> bool:
    """Whether the first cause is the planted one, with its parameters within 5 %."""
    if not found.causes or found.causes[0].fault != fault.expected:
        return False
    values = found.causes[0].parameters
    return all(
        abs(values[name] - value) <= _CLOSE * max(abs(value), 1.0) for name, value in fault.parameters.items()
    )


def faults(names: list[str], trees: int) -> int:
    """Print a line per fault, and return the number of those that are not named."""
    missed = 0
    for fault in PLANTED:
        if names and fault.name not in names:
            continue
        with registered(FaultyTrees(fault)):
            found = dynamics(f"faulty-{fault.name}", (), DynamicsOptions(random=trees))
        named = is_named(fault, found)
        missed += not named
        causes = (
            "; ".join(f"{cause.fault}: {cause.text} {cause.readings}" for cause in found.causes) or "nothing"
        )
        print(f"{'named ' if named else 'MISSED'} {fault.kind:14} {fault.name:24} {causes}", flush=True)
    print(f"{missed} missed")
    return missed


def healthy(names: list[str], trees: int) -> int:
    """Print the answers of healthy engines, and return the number of wrong readings."""
    accused = 0
    for engine in names or _HEALTHY:
        found = dynamics(engine, (), DynamicsOptions(random=trees))
        print_document(dynamics_document([found]))
        accused += len(found.wrong)
    print(f"{accused} readings of healthy engines accused")
    return accused


def main() -> int:
    """Run a trial."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("trial", choices=("faults", "healthy"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--trees", type=int)
    given = parser.parse_intermixed_args()
    if given.trial == "faults":
        return int(bool(faults(given.names, given.trees or 8)))
    return int(bool(healthy(given.names, given.trees or 100)))


if __name__ == "__main__":
    raise SystemExit(main())
