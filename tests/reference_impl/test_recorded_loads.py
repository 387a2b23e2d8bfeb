"""Loads given as formulas: the same motion as by kernels, in doubles and in the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench_at, packed_continuous_loads
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants
from bodycheck.reference_impl.pivot import about_pivot
from bodycheck.reference_impl.scene import Drag, GravityGradient, RigidBody, Scene, SineTorque, Spring, State
from bodycheck.reference_impl.truth.certification import certified_truth
from bodycheck.reference_impl.truth.motion_distance import distances
from tests.helpers.expected_messages import ExpectedMessage

DOCS = Path(__file__).parents[2] / "docs"
START = State(
    position=np.array([0.3, -0.2, 0.1]),
    quaternion=np.array([0.5, -0.5, 0.5, 0.5]),
    velocity=np.array([0.3, 0.1, -0.2]),
    omega_body=np.array([0.9, 1.3, -0.8]),
)
BODY = RigidBody(1.3, np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]]))


@dataclass(frozen=True, eq=False)
class Recorded(ContinuousLoad):
    """A load by its formula alone, as if it had no kernel."""

    kind: ClassVar[str] = "recorded"

    load: ContinuousLoad

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return what the load does."""
        if isinstance(self.load, Spring):  # whose own formula branches at no length
            arm = at.rotated(self.load.at)
            d = at.position + arm - self.load.anchor
            length = np.sqrt(np.sum(d**2, axis=-1))
            force = -self.load.stiffness * (length - self.load.rest_length) / length * d
            return force, np.cross(arm, force)
        return self.load.wrench(scene, at)


LOADS: dict[str, ContinuousLoad] = {
    "sine torque in body axes": SineTorque("body", np.array([0.9, -1.2, 0.7]), 2.3, 0.4),
    "sine torque in world axes": SineTorque("world", np.array([0.9, 0.0, 1.0]), 2.3, 0.0),
    "drag": Drag(0.8, np.array([[0.5, 0.1, 0.0], [-0.2, 0.4, 0.1], [0.0, 0.3, 0.6]])),
    "spring": Spring(np.array([1.0, 0.5, -0.3]), np.array([0.4, -0.1, 0.2]), 3.0, 0.5),
    "gravity gradient": GravityGradient(0.9),
}
every_load = pytest.mark.parametrize("load", LOADS.values(), ids=LOADS.keys())
PIVOT = np.array([0.1, -0.2, -0.7])


def scene_of(load: ContinuousLoad, pivot: Array | None = None) -> Scene:
    """Return a scene of two seconds in gravity."""
    gravity = np.array([0.2, -0.1, -1.8])
    return Scene(BODY, START, (load,), gravity, duration_s=2.0, samples=5, pivot=pivot)


@every_load
@pytest.mark.parametrize("seed", range(5))
def test_recorded_wrench_equals_that_of_the_kernel(load: ContinuousLoad, seed: int) -> None:
    """At any time and state a formula gives the kernel's wrench, to a few roundings."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    at = (float(rng.uniform(0.0, 9.0)), rng.normal(size=3), q * np.linalg.det(q), *rng.normal(size=(2, 3)))
    recorded, known = (
        continuous_wrench_at(*at, packed_continuous_loads(scene_of(one))) for one in (Recorded(load), load)
    )
    np.testing.assert_allclose(recorded, known, rtol=0, atol=4e-15 * max(1.0, np.max(np.abs(known))))


@every_load
@pytest.mark.parametrize("pivot", [None, PIVOT], ids=["free", "pivoted"])
def test_recorded_truth_equals_that_of_the_kernel(load: ContinuousLoad, pivot: Array | None) -> None:
    """The truth of a formula is certified with equally narrow bounds, and within them the same."""
    if pivot is not None and isinstance(load, GravityGradient):
        return  # which no pivot allows
    scene = scene_of(load, pivot)
    known, recorded = (
        certified_truth(one, scene.sample_times) for one in (scene, replace(scene, loads=(Recorded(load),)))
    )
    assert recorded.kind == "certified"
    assert np.all(recorded.bounds <= 2.0 * known.bounds)
    apart = distances(scene, known.trajectory, recorded.trajectory)
    # the potential energy of a spring is no part of the recorded one's bound
    assert np.all(np.delete(apart, 1, axis=0) <= np.delete(known.bounds + recorded.bounds, 1, axis=0))


@every_load
def test_recorded_load_about_a_pivot_equals_the_loads_own(load: ContinuousLoad) -> None:
    """The torque of a formula about the pivot is that of the load with its own pivot form."""
    if isinstance(load, GravityGradient):
        return
    rotation, omega = START.rotation, START.omega_world
    at = (0.4, np.array([0.2, 0.5, -0.1]), np.ascontiguousarray(rotation), np.zeros(3), omega)
    recorded, known = (
        continuous_wrench_at(*at, packed_continuous_loads(about_pivot(scene_of(one, PIVOT))))
        for one in (Recorded(load), load)
    )
    np.testing.assert_allclose(recorded[3:], known[3:], rtol=0, atol=1e-14)


@dataclass(frozen=True, eq=False)
class Formula(ContinuousLoad):
    """A torque along z by a formula of an instant."""

    kind: ClassVar[str] = "formula"

    formula: Callable[[Instants], Array]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:  # noqa: ARG002 - as of any load
        """Return no force."""
        return np.zeros_like(at.omega), np.asarray(self.formula(at))[..., None] * np.array([0.0, 0.0, 1.0])


FORMULAS: dict[str, Callable[[Instants], Array]] = {
    "sums and differences": lambda at: 2.0 + at.t - at.omega[..., 0] - 0.5 + (1.0 - at.t),
    "products": lambda at: at.t * at.velocity[..., 1] * 0.25 - (-at.t) * at.t**2,
    "quotients": lambda at: (1.0 / (2.0 + at.t) + at.t / 3.0) / (at.position[..., 2] ** 2 + 1.0),
    "roots": lambda at: np.sqrt(1.0 + at.omega[..., 2] ** 2),
    "circles": lambda at: np.sin(3.0 * at.t) * np.cos(at.position[..., 0] - at.t) + np.cos(3.0 * at.t),
    "an index after arithmetic": lambda at: (np.sin(2.0 * at.t)[..., None] * np.array([0.5, 2.0]))[..., 1],
    "no motion": lambda at: 0.0 * at.t + 1.5,
}


@pytest.mark.parametrize("name", FORMULAS)
def test_each_operation_is_recorded(name: str) -> None:
    """A formula with the operation is recorded with numpy's result, and its truth is certified."""
    load = Formula(FORMULAS[name])
    scene = scene_of(load)
    at = (0.7, START.position, np.ascontiguousarray(START.rotation), START.velocity, START.omega_world)
    expected = load.wrench(scene, Instants(np.array(at[0]), *at[1:]))
    np.testing.assert_allclose(
        continuous_wrench_at(*at, packed_continuous_loads(scene)), np.concatenate(expected), rtol=4e-15
    )
    truth = certified_truth(scene, scene.sample_times)
    assert np.max(truth.bound_rad) < 1e-14


@pytest.mark.parametrize(
    "formula",
    [
        lambda at: at.t if at.t > 1.0 else 0.0 * at.t,
        lambda at: np.exp(at.t),
        lambda at: at.t**3,
    ],
)
def test_unsupported_operation_is_refused(
    formula: Callable[[Instants], Array], expected_message: ExpectedMessage
) -> None:
    """A branch and a function without a known series are refused by name."""
    with expected_message.raises(TypeError):
        packed_continuous_loads(scene_of(Formula(formula)))


@pytest.mark.parametrize("page", ["scenarios.md", "workers.md"])
def test_every_kind_of_load_is_in_the_docs(page: str) -> None:
    """The pages on the format and on messages list every kind with all its keys."""
    text = (DOCS / page).read_text()
    for kind, load in load_kinds().items():
        assert kind in text
        keys = load.keys()
        assert all((key.name if page == "scenarios.md" else name) in text for name, key in keys.items())
