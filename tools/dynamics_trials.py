"""Print what cond M costs the accelerations of engines, and what is said about healthy motions of trees.

    python tools/dynamics_trials.py conditions [ENGINE ...]
    python tools/dynamics_trials.py healthy-motions [--trees 50] [ENGINE[:METHOD] ...]

conditions: the worst accelerations and wrenches, also over 10 + cond M, of the trees of
tests/oracles/joints.json that bodies can have, and of 20 random ones.
healthy-motions: mujoco, dart, pybullet and reference on the built-in and on random trees, and how much
farther than its map the next one is; exit status 1 if one has a fault, or is not explained.
"""

from __future__ import annotations

from collections import Counter
from contextlib import closing

import numpy as np
from trials import command

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record, refusal
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.examine.dynamics.tree_motion_diagnosis import diagnosed_tree
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.wrench import plan_steps
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.measurement.case import stable_motion
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.scales import scene_scales
from bodycheck.reports.measurement.tree_map_made import DISTANCE, NEXT, made_map
from bodycheck.runs.dynamics_run import DynamicsOptions, _case, _random, _read
from bodycheck.scenarios.library import load_trees, tree_names
from tests.helpers.tree_oracles import TREES as HANDED
from tests.helpers.tree_oracles import tree as handed_tree

_MOVING = ("mujoco", "dart", "pybullet", "reference")
_READ = ("mujoco", "dart", "pinocchio")


def conditions(*names: str) -> None:
    """Print the worst deviations of each engine, and those over 10 + cond M."""
    seed = DynamicsOptions().seed
    handed = [(name, handed_tree(name)) for name in HANDED if name != "physical-pendulum"]
    sets = {"joints.json": handed, "random": [_random(seed, number) for number in range(20)]}
    for engine in names or _READ:
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
    command(conditions, healthy_motions)
