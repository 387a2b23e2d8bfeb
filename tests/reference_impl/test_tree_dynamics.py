"""The exact dynamics of trees, against outside numbers and an independent formulation."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from mpmath import mp, mpf

from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_dynamics import TreeDynamics, paired_tree_dynamics, tree_dynamics
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from tests.helpers.maximal_coordinates import witness
from tests.helpers.tree_oracles import TREES, as_pair, instants, tree


def worst_deviation(found: TreeDynamics, low: TreeDynamics | None, expected: dict[str, list[mpf]]) -> mpf:
    """Return the largest deviation over the largest component of each quantity; q and -q are the same."""
    worst = mpf(0)
    with mp.workdps(40):
        for name, numbers in expected.items():
            parts = [np.ravel(getattr(part, name)) for part in (found, low) if part is not None]
            own = [sum(map(mpf, map(float, both)), mpf(0)) for both in zip(*parts, strict=True)]
            if name == "quaternion":
                signs = np.sign(np.sum(parts[0].reshape(-1, 4) * np.reshape(numbers, (-1, 4)), axis=1))
                numbers = [x * int(sign) for x, sign in zip(numbers, np.repeat(signs, 4), strict=True)]
            scale = max(max(map(abs, numbers)), mpf(1e-9))  # a momentum of 0 is compared as it is
            worst = max(worst, *(abs(x - y) / scale for x, y in zip(own, numbers, strict=True)))
    return worst


@pytest.mark.parametrize("name", TREES)
def test_motion_energy_and_momenta_of_published_states_in_doubles(name: str) -> None:
    """Poses, velocities, energies and momenta follow from q and u to 1e-14 of the largest component."""
    for instant in instants(name):
        q, u = (np.array(numbers, dtype=np.float64) for numbers in (instant.q, instant.u))
        assert worst_deviation(tree_dynamics(tree(name), q, u), None, instant.values) < 1e-14


@pytest.mark.parametrize("name", TREES)
def test_motion_energy_and_momenta_of_published_states_in_double_doubles(name: str) -> None:
    """In double-doubles they follow to 1e-28."""
    for instant in instants(name):
        high, low = paired_tree_dynamics(tree(name), as_pair(instant.q), as_pair(instant.u))
        assert worst_deviation(high, low, instant.values) < 1e-28


def deviations_from_the_witness(scene: TreeScene, t_s: float) -> dict[str, float]:
    """Return the largest deviation of each quantity over its largest component, at the start of a tree.

    That of the accelerations is divided by 10 + cond M.
    """
    found, expected = tree_dynamics(scene, t_s=t_s), witness(scene, scene.q0, scene.u0, t_s)
    deviations = {}
    for field in fields(expected):
        numbers, own = (np.ravel(getattr(one, field.name)) for one in (expected, found))
        scale = max(map(abs, numbers)) or 1
        deviations[field.name] = float(max(abs(x - y) for x, y in zip(own, numbers, strict=True)) / scale)
    deviations["accelerations"] /= 10.0 + float(np.linalg.cond(found.mass_matrix))
    return deviations


@pytest.mark.parametrize("seed", range(6))
def test_dynamics_of_random_trees_by_constraint_forces(seed: int) -> None:
    """M, bias, loads and accelerations agree with bodies held together by forces, in 50 digits."""
    rng = np.random.default_rng(seed)
    found = deviations_from_the_witness(random_tree(rng, int(rng.integers(1, 4)), loads=True), t_s=0.3)
    assert found.pop("accelerations") < 1e-15
    assert found.pop("joint_force") < 1e-13
    assert found.pop("joint_moment") < 1e-13
    assert max(found.values()) < 1e-14
