"""The motion of trees against published numbers of 34 digits, and the bounds of their truth."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from mpmath import mp, mpf

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.tree_motion import TreeSolution, follow_tree
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.trees.tree_truth import certified_tree
from tests.helpers.tree_oracles import TREES, instants, times, tree

_EPS = 2.0**-52


def followed(scene: TreeScene, t_s: Array, accuracy: SeriesAccuracy) -> TreeSolution:
    """Integrate a scene from its start, taken as exact doubles."""
    none = np.zeros_like
    return follow_tree(scene, (scene.q0, none(scene.q0)), (scene.u0, none(scene.u0)), t_s, accuracy)


def deviation(scene: TreeScene, numbers: list[mpf], high: Array, low: Array) -> mpf:
    """Return the largest deviation of q and u at one time; the sign of a quaternion is arbitrary."""
    with mp.workdps(40):
        errors = [mpf(float(a)) + mpf(float(b)) - x for a, b, x in zip(high, low, numbers, strict=True)]
        for body, place in zip(scene.bodies, scene.coordinate_slices, strict=True):
            if body.joint.of_kind.rotation is Rotation.BALL:
                for i in range(place.stop - 4, place.stop):
                    if (
                        high[place.stop - 4 : place.stop]
                        @ np.array(numbers[place.stop - 4 : place.stop], float)
                        < 0
                    ):
                        errors[i] += 2 * numbers[i]
        return max(map(abs, errors))


def worst(name: str, accuracy: SeriesAccuracy) -> Iterator[tuple[mpf, float]]:
    """Yield the deviation and the sensitivity of a published motion at its times."""
    scene, published = tree(name), list(instants(name))
    t_s = times(name)
    found = followed(scene, t_s, accuracy)
    truth = certified_tree(scene, t_s)
    for k, instant in enumerate(published):
        high, low = (np.concatenate([found.q[part][k], found.u[part][k]]) for part in (0, 1))
        sensitivity = max(1.0, *(row[k] for row in truth.round_offs.values())) / _EPS
        yield deviation(scene, instant.q + instant.u, high, low), sensitivity


@pytest.mark.parametrize("name", TREES)
@pytest.mark.parametrize(
    ("accuracy", "digits"), [(SeriesAccuracy(30, 1e-32, 19), 1e-28), (SeriesAccuracy(20, 1e-16), 1e-13)]
)
def test_published_motions(name: str, accuracy: SeriesAccuracy, digits: float) -> None:
    """Coordinates and rates are the published ones to 1e-28 and, in doubles, 1e-13 of the sensitivity."""
    for error, sensitivity in worst(name, accuracy):
        assert error < digits * sensitivity
