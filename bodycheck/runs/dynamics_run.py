"""Ask an engine's worker what it reports of trees: library trees, random ones, and those of model files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck.adapters.reading_names import READINGS
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.adapters.workers.protocol import Message
from bodycheck.adapters.workers.tree_readings import (
    TreeReadings,
    dynamics_request,
    readings_of,
    without_loads,
)
from bodycheck.examine.dynamics.engine_dynamics import EngineDynamics, ReadTree, engine_dynamics
from bodycheck.examine.dynamics.tree_case import TreeCase, TreeState
from bodycheck.reference_impl.trees.random_trees import random_state, random_tree
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.scenarios.library import load_trees
from bodycheck.scenarios.model_files import read_model
from bodycheck.scenarios.model_files.model_tree import model_trees

RANDOM_TREES, SEED, STATES = 20, 1, 5
_CHANGED_TREES, _MASSES_WERE = 3, 2.0
_MOST_BODIES = 8
_GRAVITY = np.array([0.0, 0.0, -9.81])
_MODELS = (".urdf", ".xml", ".mjcf", ".sdf", ".usd", ".usda")


@dataclass(frozen=True)
class DynamicsOptions:
    """random: the number of random trees; seed: of them and of all states. timeout_s: of one tree."""

    random: int = RANDOM_TREES
    seed: int = SEED
    timeout_s: float = 60.0


def dynamics(engine: str, specs: Sequence[str], options: DynamicsOptions) -> EngineDynamics:
    """Return what an engine reports of trees.

    specs: names of built-in trees, scenario files and model files; random trees are added. Raises
    InputError for an unknown engine or tree.
    """
    cases = list(_cases(specs, options))
    found = announced([engine])[engine]
    if isinstance(found, str):
        raise InputError(found)
    with closing(EnginePool()) as pool:
        trees = [_read(pool, engine, case, options.timeout_s) for case in cases]
    return engine_dynamics(found.name, found.version, trees, options.seed)


def _cases(specs: Sequence[str], options: DynamicsOptions) -> Iterator[TreeCase]:
    """Yield each tree in states of which the first is at rest; some again with a change of mass."""
    named = list(_trees_of(specs))
    made = [_random(options.seed, number) for number in range(options.random)]
    for number, (name, scene) in enumerate([*named, *made]):
        yield _case(name, scene, np.random.default_rng([options.seed, number, 1]))
    for number, (name, scene) in enumerate((made or named)[:_CHANGED_TREES]):
        rng = np.random.default_rng([options.seed, number, 2])
        yield _case(f"{name}, changed mass", scene, rng, _MASSES_WERE)


def _trees_of(specs: Sequence[str]) -> Iterator[tuple[str, TreeScene]]:
    """Yield the trees of names, scenario files and model files; raise InputError if there is no such tree."""
    for spec in specs:
        if Path(spec).suffix.lower() in _MODELS:
            model = read_model(Path(spec))
            trees = model_trees(model)
            if not trees:
                raise InputError(f"{spec}: has no joint that moves")
            for number, tree in enumerate(trees, start=1):
                name = Path(spec).name if len(trees) == 1 else f"{Path(spec).name} ({number})"
                yield name, replace(tree.scene, gravity=_GRAVITY)
        else:
            yield from ((name, tree.scene) for name, tree in load_trees(spec))


def _random(seed: int, number: int) -> tuple[str, TreeScene]:
    rng = np.random.default_rng([seed, number])
    scene = random_tree(rng, int(rng.integers(1, _MOST_BODIES + 1)))
    return f"random-{number + 1}", scene


def _case(name: str, scene: TreeScene, rng: np.random.Generator, masses_were: float = 1.0) -> TreeCase:
    bare, states = without_loads(scene), []
    for number in range(STATES):
        q, u = random_state(bare, rng)
        states.append(TreeState(bare, q, u if number else np.zeros_like(u)))
    return TreeCase(name, tuple(states), masses_were)


def _read(pool: EnginePool, engine: str, case: TreeCase, timeout_s: float) -> ReadTree:
    """Ask for all readings together; if the worker fails, for each alone, to know which one it is."""
    answer = _ask(pool, engine, case, timeout_s, READINGS)
    if answer["outcome"] == "ok":
        return ReadTree(case, readings_of(answer))
    if answer["outcome"] == "unsupported":
        return ReadTree(case, None, "unsupported", str(answer["message"]))
    parts = {name: _ask(pool, engine, case, timeout_s, (name,)) for name in READINGS}
    fine = {name: readings_of(part) for name, part in parts.items() if part["outcome"] == "ok"}
    if not fine:
        return ReadTree(case, None, str(answer["outcome"]), str(answer["message"]))
    return ReadTree(case, _together(fine, {name: part for name, part in parts.items() if name not in fine}))


def _together(fine: dict[str, TreeReadings], lost: dict[str, Message]) -> TreeReadings:
    first = next(iter(fine.values()))
    reasons = {name: f"failed: {part['message']}" for name, part in lost.items()}
    for one in fine.values():
        reasons |= one.reasons
    values = {name: one.values[name] for name, one in fine.items() if name in one.values}
    after = {name: one.after[name] for name, one in fine.items() if name in one.after}
    return replace(first, values=values, after=after, reasons=reasons)


def _ask(pool: EnginePool, engine: str, case: TreeCase, timeout_s: float, readings: Sequence[str]) -> Message:
    q, u = (np.array([getattr(state, name) for state in case.states]) for name in ("q", "u"))
    return pool.ask(engine, dynamics_request(case.scene, q, u, case.masses_were, readings), timeout_s)
