"""The exact dynamics of trees, against outside numbers and an independent formulation."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from mpmath import mp, mpf

from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_dynamics import TreeDynamics, paired_tree_dynamics, tree_dynamics
from tests.helpers.maximal_coordinates import Witness, witness
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


def deviations(parts: tuple[TreeDynamics, ...], expected: Witness) -> dict[str, float]:
    """Return the largest deviation of each quantity from the witness, over its largest component.

    parts: what was found, as a sum. Force and moment of the joints are one quantity, the wrench; the
    deviation of the accelerations is divided by 10 + cond M.
    """
    deviations = {}
    names = {field.name: (field.name,) for field in fields(expected) if not field.name.startswith("joint")}
    with mp.workdps(40):
        for name, members in {**names, "wrench": ("joint_force", "joint_moment")}.items():
            numbers = np.concatenate([np.ravel(getattr(expected, member)) for member in members])
            own = [np.concatenate([np.ravel(getattr(part, member)) for member in members]) for part in parts]
            sums = [sum(map(mpf, map(float, terms)), mpf(0)) for terms in zip(*own, strict=True)]
            scale = max(map(abs, numbers)) or 1  # nothing acts on some trees
            deviations[name] = float(max(abs(x - y) for x, y in zip(sums, numbers, strict=True)) / scale)
    deviations["accelerations"] /= 10.0 + float(np.linalg.cond(parts[0].mass_matrix))
    return deviations


def assert_agreement_with_the_witness(seed: int, bodies: int) -> None:
    """Compare a random tree of up to some bodies, in doubles and in double-doubles."""
    rng = np.random.default_rng(seed)
    scene = random_tree(rng, int(rng.integers(1, bodies + 1)), loads=True)
    expected = witness(scene, scene.q0, scene.u0, 0.3)
    found = deviations((tree_dynamics(scene, t_s=0.3),), expected)
    assert found.pop("accelerations") < 1e-15
    assert max(found.values()) < 1e-14
    assert max(deviations(paired_tree_dynamics(scene, t_s=0.3), expected).values()) < 1e-28


@pytest.mark.parametrize("seed", range(4))
def test_dynamics_of_small_random_trees_by_constraint_forces(seed: int) -> None:
    """M, bias, loads, accelerations and wrenches agree with bodies held together by forces, in 50 digits."""
    assert_agreement_with_the_witness(seed, 3)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("seed", [*range(10, 16), 20, 25])
def test_dynamics_of_random_trees_by_constraint_forces(seed: int) -> None:
    """The same up to 20 bodies, with condition numbers of M above 1e4."""
    assert_agreement_with_the_witness(seed, 20)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(200))
def test_dynamics_of_200_random_trees_by_constraint_forces(seed: int) -> None:
    """The same for 200 trees."""
    assert_agreement_with_the_witness(seed, 20)
