"""The motion of trees against published numbers of 34 digits, and the bounds of their truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp, mpf

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy
from bodycheck.reference_impl.trees.joint_kind import Rotation
from bodycheck.reference_impl.trees.tree_motion import TreeSeries, TreeSolution
from bodycheck.reference_impl.trees.tree_scene import Joint, TreeBody, TreeScene
from bodycheck.reference_impl.trees.tree_truth import certified_tree
from tests.helpers.random_tree_motions import random_motion, tree_ratios
from tests.helpers.tree_oracles import TREES, instants, times, tree

_EPS = 2.0**-52


def followed(scene: TreeScene, t_s: Array, accuracy: SeriesAccuracy) -> TreeSolution:
    """Integrate a scene from its start, taken as exact doubles."""
    none = np.zeros_like
    return TreeSeries(scene, accuracy).solve((scene.q0, none(scene.q0)), (scene.u0, none(scene.u0)), t_s)


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


def pendulum_of_the_four_bar() -> TreeScene:
    """Return the hinge with th'' = 3.5 g / 3 sin th from the upright position, at 1 rad/s."""
    reach = 0.5
    about_centre = 3.0 * reach / 3.5 - reach**2
    joint = Joint("hinge", at_body=np.array([0, 0, -reach]), axis=np.array([0.0, 1, 0]), rate=np.ones(1))
    body = TreeBody("bar", 1.0, np.diag([0.3, about_centre, 0.3]), joint)
    return TreeScene((body,), (), np.array([0, 0, -9.81]), 10.0, 11)


def test_four_bar_mechanism_as_a_pendulum() -> None:
    """The published position of the mechanism of two bars at 10 s follows to its 14 digits."""
    angle = certified_tree(pendulum_of_the_four_bar(), np.array([10.0])).motion.q[0, 0]
    assert [np.sin(angle), np.cos(angle)] == pytest.approx([0.32845811154082, 0.9445185381786], abs=1e-13)


def chain() -> TreeScene:
    """Return a free body with two links on hinges at right angles, whose motion another program published."""
    spin = np.array([0, 0, 0, 0.2, 0.1, -0.3])
    base = TreeBody("base", 2.0, np.diag([0.05, 0.08, 0.10]), Joint("free", rate=spin))
    first, second = np.array([0.25, 0.02, 0.03]), np.array([0.15, -0.01, 0.02])
    one = Joint("hinge", 0, np.array([0.3, 0.05, -0.02]), -first, axis=np.array([0, 0, 1.0]))
    two = Joint("hinge", 1, np.array([0.5, 0, 0.04]) - first, -second, axis=np.array([0, 1.0, 0]))
    links = (
        TreeBody("one", 1.0, np.diag([0.01, 0.02, 0.025]), one),
        TreeBody("two", 0.5, np.diag([0.002, 0.003, 0.004]), two),
    )
    still = TreeScene((base, *links), (), np.zeros(3), 2.0, 11)
    start = np.array([0, 0, 0, 1.0, 0, 0, 0, 0.3, -0.4])
    return still.with_state(start, np.concatenate([spin, [1.0, -0.7]]))


def test_free_chain_of_another_program() -> None:
    """The two angles at 2 s are the published ones to their eight digits."""
    found = certified_tree(chain(), np.array([2.0])).motion.q[0, -2:]
    assert found == pytest.approx([1.86060429, 0.50077265], abs=6e-9)


@pytest.mark.parametrize("exponent", [40, -40, 300])
def test_other_units_of_time(exponent: int) -> None:
    """A motion that is 2^40 or 2^300 times slower, or faster, has the same angles."""
    scene, t_s = chain(), np.array([0.5, 1.0])
    plain = certified_tree(scene, t_s)
    slow = certified_tree(scene.in_time_unit(-exponent), np.ldexp(t_s, exponent))
    assert np.max(np.abs(slow.motion.q - plain.motion.q)) < 1e-15
    assert np.max(np.abs(np.ldexp(slow.motion.u, exponent) - plain.motion.u)) < 1e-15
    assert slow.bounds["rad"] == pytest.approx(plain.bounds["rad"], rel=0.1)


@pytest.mark.parametrize("times", [[-1.0], [np.nan], [np.inf]])
def test_wrong_times_are_refused(times: list[float]) -> None:
    """A time must be finite and not negative."""
    with pytest.raises(ValueError, match="finite and not negative"):
        certified_tree(chain(), np.array(times))


def test_singular_mass_matrix_has_no_truth() -> None:
    """A link without mass at the end of a tree is refused."""
    scene = chain()
    light = replace(scene.bodies[-1], mass=0.0, inertia=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="singular"):
        certified_tree(replace(scene, bodies=(*scene.bodies[:-1], light)), np.array([1.0]))


def test_chaos_ends_the_trust() -> None:
    """The truth of a double pendulum that was let go high is trusted for a time only, and says so."""
    upper = TreeBody(
        "upper",
        1.0,
        np.diag([0.1, 0.1, 0.01]),
        Joint("hinge", -1, at_body=np.array([0, 0, 0.5]), axis=np.array([0, 1.0, 0]), start=np.array([2.5])),
    )
    joint = Joint(
        "hinge",
        0,
        np.array([0, 0, -0.5]),
        np.array([0, 0, 0.5]),
        axis=np.array([0, 1.0, 0]),
        start=np.array([1.0]),
    )
    scene = TreeScene(
        (upper, replace(upper, name="lower", joint=joint)), (), np.array([0, 0, -9.81]), 40.0, 41
    )
    truth = certified_tree(scene, scene.sample_times)
    assert 5.0 < truth.trusted_until_s < 40.0
    before = scene.sample_times < truth.trusted_until_s
    assert np.all(truth.bounds["joint_rad"][before] < 1e-9)


@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "seed", [4, pytest.param(12, marks=pytest.mark.slow), pytest.param(14, marks=pytest.mark.slow)]
)
def test_errors_of_random_trees_are_within_their_bounds(seed: int) -> None:
    """Bodies held together by forces, to forty digits, differ from the truth by less than its bounds."""
    ratios = tree_ratios(random_motion(seed, 4))
    assert max(ratios.values()) <= 1.0
    assert max(ratios["q"], ratios["u"]) > 1e-9  # the comparison is not of nothing
