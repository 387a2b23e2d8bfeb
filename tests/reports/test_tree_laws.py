"""Laws of trees: engines obey them, and each of some mistakes breaks the law that is about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import Build, Engine
from bodycheck.adapters.dart import Dart
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.examine.probes.tree_laws import TREE_LAWS, check_tree_laws
from bodycheck.reference_impl.trees.tree_scene import TreeScene

_NAMES = [law.name for law, _ in TREE_LAWS]


def _verdicts(
    adapter: Any, method: str, change: Callable[[TreeScene], TreeScene] | None = None
) -> dict[str, str]:
    """Return the verdict of each law, of an engine that takes each tree for another one."""

    def ask(_engine: Engine, case: Case, *, again: bool = False) -> Answer:
        assert isinstance(case.scene, TreeScene)
        return record(
            adapter, case if change is None else replace(case, scene=change(case.scene)), again=again
        )

    engine = Engine(adapter.name, "", adapter.methods, Build("", "installed", {}), moves_trees=True)
    found = check_tree_laws(
        engine, adapter.methods[method], ask, lambda one, case: ask(one, case, again=True)
    )
    return {one.law.name: one.verdict for one in found}


@pytest.mark.parametrize(
    ("adapter", "method"), [(MuJoCo(), "euler"), (MuJoCo(), "rk4"), (Dart(), "semi-implicit")]
)
def test_engines_obey_the_laws_of_trees(adapter: Any, method: str) -> None:
    """All laws hold to round-off but that of the root, whose coordinates are others."""
    verdicts = _verdicts(adapter, method)
    assert verdicts == {**dict.fromkeys(_NAMES, "holds"), "tree-root": "property"}


def _axes_upwards(scene: TreeScene) -> TreeScene:
    """Take each hinge's axis with a positive sum of components."""
    bodies = (
        replace(body, joint=replace(body.joint, axis=body.joint.axis * np.sign(np.sum(body.joint.axis))))
        for body in scene.bodies
    )
    return replace(scene, bodies=tuple(bodies))


def _down(scene: TreeScene) -> TreeScene:
    """Let gravity act along -z, whatever its direction."""
    return replace(scene, gravity=np.array([0.0, 0.0, -np.linalg.norm(scene.gravity)]))


def _last_is_heavier(scene: TreeScene) -> TreeScene:
    """Take the last body of the list as twice as heavy."""
    last = scene.bodies[-1]
    return replace(scene, bodies=(*scene.bodies[:-1], replace(last, mass=2.0 * last.mass)))


def _without_products(scene: TreeScene) -> TreeScene:
    """Take each tensor without its products of inertia."""
    bodies = (replace(body, inertia=np.diag(np.diag(body.inertia))) for body in scene.bodies)
    return replace(scene, bodies=tuple(bodies))


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        (_axes_upwards, "tree-flip"),
        (_down, "tree-rotate"),
        (_last_is_heavier, "tree-order"),
        (_without_products, "tree-divide"),
    ],
)
def test_a_mistake_breaks_its_law(change: Callable[[TreeScene], TreeScene], broken: str) -> None:
    """An engine that forgets part of a description moves another tree."""
    assert _verdicts(MuJoCo(), "rk4", change)[broken] == "broken"
