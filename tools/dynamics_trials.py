"""Print which planted faults of trees `bodycheck dynamics` and `explain` name, and how healthy engines do.

    python tools/dynamics_trials.py faults [--trees 8] [NAME ...]
    python tools/dynamics_trials.py healthy [--trees 100] [ENGINE ...]
    python tools/dynamics_trials.py conditions [ENGINE ...]
    python tools/dynamics_trials.py motions [NAME ...]
    python tools/dynamics_trials.py healthy-motions [--trees 50] [ENGINE[:METHOD] ...]

faults: each fault of tests/helpers/faulty_tree_models.py on random trees; exit status 1 if one is not named
first with its parameters within 5 %. healthy: mujoco, dart and pinocchio; exit status 1 if one is accused.
conditions: the worst accelerations and wrenches, also over 10 + cond M, of the trees of
tests/oracles/joints.json that bodies can have, and of 20 random ones.
motions: each fault of tests/helpers/faulty_tree_motions.py on three trees; exit status 1 if fewer than 90 %
are named first with their parameters within 5 %. healthy-motions: mujoco, dart, pybullet and reference on
the built-in and on random trees, and how much farther than its map the next one is; exit status 1 if one has
a fault, or is not explained.
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing

import numpy as np
from trials import command

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record, refusal
from bodycheck.adapters.registry import get_adapter, registered
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.examine.dynamics.dynamics_document import dynamics_document
from bodycheck.examine.dynamics.engine_dynamics import EngineDynamics
from bodycheck.examine.dynamics.tree_motion_diagnosis import diagnosed_tree
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.document import print_document
from bodycheck.reports.measurement.case import stable_motion
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.scales import scene_scales
from bodycheck.reports.measurement.tree_map_made import DISTANCE, NEXT, made_map
from bodycheck.runs.dynamics_run import DynamicsOptions, _case, _random, _read, dynamics
from bodycheck.scenarios.library import load_trees, tree_names
from tests.helpers.faulty_tree_models import PLANTED, FaultyTrees, PlantedTreeFault
from tests.helpers.faulty_tree_motions import FAULTS, TREES, diagnosed_fault, loaded_tree
from tests.helpers.faulty_tree_motions import is_named as motion_is_named
from tests.helpers.tree_oracles import TREES as HANDED
from tests.helpers.tree_oracles import tree as handed_tree

_MOVING = ("mujoco", "dart", "pybullet", "reference")
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


def faults(*names: str, trees: int = 8) -> int:
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


def healthy(*names: str, trees: int = 100) -> int:
    """Print the answers of healthy engines, and return the number of wrong readings."""
    accused = 0
    for engine in names or _HEALTHY:
        found = dynamics(engine, (), DynamicsOptions(random=trees))
        print_document(dynamics_document([found]))
        accused += len(found.wrong)
    print(f"{accused} readings of healthy engines accused")
    return accused


def conditions(*names: str) -> None:
    """Print the worst deviations of each engine, and those over 10 + cond M."""
    seed = DynamicsOptions().seed
    handed = [(name, handed_tree(name)) for name in HANDED if name != "physical-pendulum"]
    sets = {"joints.json": handed, "random": [_random(seed, number) for number in range(20)]}
    for engine in names or _HEALTHY:
        with closing(EnginePool()) as pool:
            for label, trees in sets.items():
                cases = [_case(*named, np.random.default_rng([seed, k, 1])) for k, named in enumerate(trees)]
                read = [_read(pool, engine, case, 60.0) for case in cases]
                for name in ("accelerations", "wrenches"):
                    found = [
                        (one.case.deviation(name, one.readings.values[name]), one.case.largest_condition)
                        for one in read
                        if one.readings is not None and name in one.readings.values
                    ]
                    (worst, cond), shares = max(found), [one / (10.0 + cond) for one, cond in found]
                    print(
                        f"{engine} {label} {name}: {worst:.1e} at cond M = {cond:.0e}, "
                        f"over 10 + cond M {max(shares):.1e}",
                        flush=True,
                    )


def motions(*names: str) -> bool:
    """Print a line per fault and tree, and return whether fewer than 90 % are named."""
    named = trials = 0
    for tree in TREES:
        for fault in FAULTS:
            kind = loaded_tree(tree).bodies[-1].joint.kind
            if (names and fault.name not in names) or kind not in fault.kinds:
                continue
            found = diagnosed_fault(fault, tree)
            right, trials = motion_is_named(fault, found), trials + 1
            named += right
            text = "not examined" if found is None else f"{found.base}: {found.sentence}"
            print(f"{'named ' if right else 'MISSED'} {tree:12} {fault.name:20} {text}", flush=True)
    print(f"{named} of {trials} named first, with parameters within 5 %")
    return named < 0.9 * trials


def healthy_motions(*names: str, trees: int = 50) -> int:
    """Print a line per method, and return the number of motions that are accused."""
    scenes = [tree.scene for name in tree_names() for _, tree in load_trees(name)]
    for number in range(trees):
        rng = np.random.default_rng([number, 51])
        scenes.append(random_tree(rng, int(rng.integers(2, 9)), loads=number % 2 == 0))
    truths = [known_truth(scene, scene.sample_times, None).trajectory for scene in scenes]
    accused = 0
    for name, _, only in (one.partition(":") for one in names or _MOVING):
        engine = get_adapter(name)
        for method in engine.methods.values():
            verdicts: Counter[str] = Counter()
            ratios = []
            if only and method.name != only:
                continue
            for number, (scene, truth) in enumerate(zip(scenes, truths, strict=True)):
                dt_s = scene.sample_interval_s / 10
                refused = method.control != "dt" or refusal(engine, scene, method.name)
                if refused or method.on_request:
                    continue
                answer = record(engine, Case(scene, method.name, Setting(dt_s=dt_s)))
                motion = answer.trajectory
                if motion is None:
                    verdicts[answer.outcome] += 1
                    continue
                if isinstance(stable_motion(scene, motion, EnergyAndMomentum.of(scene, truth)), str):
                    verdicts["unstable, of these"] += 1
                scales, order = scene_scales(scene, truth), method.order
                found = diagnosed_tree(scene, motion, scales, dt_s, order=order, precision=method.precision)
                verdicts["not examined" if found is None else f"{found.verdict} {found.base}"] += 1
                if found is not None and found.verdict != "healthy":
                    accused += 1
                    print(f"  tree {number}: {found.sentence}", flush=True)
                if made := made_map(scene, motion, plan_steps(scene, dt_s), method.precision, scales):
                    ratios.append(made[NEXT] / max(made[DISTANCE], 1e-17))
            if verdicts:
                nearest = f"next map at least {min(ratios):.1e} times farther" if ratios else ""
                print(f"{engine.name}:{method.name}", dict(verdicts), nearest, flush=True)
    print(f"{accused} motions of healthy methods accused, in {len(scenes)} trees")
    return accused


if __name__ == "__main__":
    command(faults, healthy, conditions, motions, healthy_motions)
