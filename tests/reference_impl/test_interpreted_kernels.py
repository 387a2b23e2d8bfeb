"""Interpreted kernels give the bits of compiled ones, and are used while that takes less time."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from bodycheck.reference_impl import precompile
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import exact_kernel, interpreted
from bodycheck.reference_impl.one_step_maps import TREE_MAPS
from bodycheck.reference_impl.trees.tree_motion import TreeMotion, tree_motion
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.scenarios.library import load_scenarios, load_trees, tree_names

FREE = [
    (name, scenario.scene)
    for name, scenario in load_scenarios(["standard", "hard", "smoke"])
    if scenario.scene.is_free_rotation
]


@pytest.mark.slow(after=7)
@pytest.mark.parametrize("name", [name for name, _ in FREE])
def test_interpreted_truth_equals_compiled_truth_bit_for_bit(name: str) -> None:
    """Motion, bounds and sensitivities of each free body of the suites agree at every ninth sample."""
    scene = dict(FREE)[name]
    times = scene.sample_times[::9]
    with interpreted():
        one = solve_truth(scene, times)
    other = solve_truth(scene, times)
    for part in fields(one.trajectory):
        np.testing.assert_array_equal(
            getattr(one.trajectory, part.name), getattr(other.trajectory, part.name), strict=True
        )
    for field in fields(one):
        if isinstance(getattr(one, field.name), np.ndarray):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.mark.parametrize("name", tree_names())
def test_interpreted_kernels_of_trees_agree_with_compiled_ones(name: str) -> None:
    """What the bodies do at the start, and one step of RK4; interpreted kernels check every index."""
    ((_, scenario), *_) = load_trees(name)
    scene = scenario.scene

    def found() -> tuple[TreeMotion, tuple[Array, Array]]:
        motion = tree_motion(scene, np.zeros(1), scene.q0[None], scene.u0[None])
        return motion, TREE_MAPS["RK4"].step(scene, 0.0, scene.q0, scene.u0, 1e-3)

    with interpreted():
        one, one_step = found()
    other, other_step = found()
    for part in fields(one):
        np.testing.assert_array_equal(getattr(one, part.name), getattr(other, part.name))
    for ours, theirs in zip(one_step, other_step, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=1e-15)


def test_kernel_is_interpreted_only_within_the_context() -> None:
    """A division by zero raises an error if interpreted, and gives inf in compiled code."""
    inverse = exact_kernel(_inverse)
    with interpreted(), pytest.raises(ZeroDivisionError):
        inverse(0.0)
    assert inverse(0.0) == np.inf


def _inverse(x: float) -> float:
    return 1.0 / x


def test_closed_forms_are_interpreted_until_compiling_takes_less_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only a few samples are interpreted, and none after much time was spent or if kernels are compiled."""
    monkeypatch.setattr(precompile, "cache_directory", lambda: tmp_path)
    monkeypatch.setattr(precompile, "_interpreted_s", 0.0)
    assert precompile.interprets_closed_forms([101, 201])
    assert not precompile.interprets_closed_forms([101] * 100)
    assert not precompile.interprets_closed_forms([1_000_000])
    monkeypatch.setattr(precompile, "_interpreted_s", 4.9)
    assert not precompile.interprets_closed_forms([101])
    monkeypatch.setattr(precompile, "_interpreted_s", 0.0)
    for name in ("frames", "tumbling"):
        (tmp_path / f"{name}.compiled").touch()
    assert not precompile.interprets_closed_forms([1])
