"""Loads given as formulas move a body as their kernels do, in doubles and in the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.continuous_loads import continuous_wrench_at, packed_continuous_loads
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import ContinuousLoad, Instants
from bodycheck.reference_impl.pivot import about_pivot
from bodycheck.reference_impl.scene import Drag, GravityGradient, RigidBody, Scene, SineTorque, Spring, State
from bodycheck.reference_impl.truth.certification import certified_truth
from bodycheck.reference_impl.truth.motion_distance import distances
from tests.helpers.expected_messages import ExpectedMessage

pytestmark = pytest.mark.slow  # they compile kernels that few others use

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
    """A load that offers only its formula, as if it had no kernel."""

    kind: ClassVar[str] = "recorded"

    load: ContinuousLoad

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:
        """Return the wrench of the load."""
        if isinstance(self.load, Spring):  # its own formula branches at length zero
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
    """At any time and state a formula gives the kernel's wrench to a few roundings."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    at = (float(rng.uniform(0.0, 9.0)), rng.normal(size=3), q * np.linalg.det(q), *rng.normal(size=(2, 3)))
    recorded, known = (
        continuous_wrench_at(*at, packed_continuous_loads(scene_of(one))) for one in (Recorded(load), load)
    )
    np.testing.assert_allclose(recorded, known, rtol=0, atol=4e-15 * max(1.0, np.max(np.abs(known))))


@pytest.mark.nightly
@every_load
@pytest.mark.parametrize("pivot", [None, PIVOT], ids=["free", "pivoted"])
def test_recorded_truth_equals_that_of_the_kernel(load: ContinuousLoad, pivot: Array | None) -> None:
    """The truth of a formula is certified with equally narrow bounds and agrees within them."""
    if pivot is not None and isinstance(load, GravityGradient):
        return  # not allowed with a pivot
    scene = scene_of(load, pivot)
    known, recorded = (
        certified_truth(one, scene.sample_times) for one in (scene, replace(scene, loads=(Recorded(load),)))
    )
    assert recorded.kind == "certified"
    assert np.all(recorded.bounds <= 2.0 * known.bounds)
    apart = distances(scene, known.trajectory, recorded.trajectory)
    # the bound of a recorded spring does not include its potential energy
    assert np.all(np.delete(apart, 1, axis=0) <= np.delete(known.bounds + recorded.bounds, 1, axis=0))


@every_load
def test_recorded_load_about_a_pivot_equals_the_loads_own(load: ContinuousLoad) -> None:
    """The torque of a formula about the pivot equals that of the load's own pivot formula."""
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
    """A torque along z given by a formula of an instant."""

    kind: ClassVar[str] = "formula"

    formula: Callable[[Instants], Array]

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:  # noqa: ARG002 - as of any load
        """Return no force and the torque along z."""
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


@pytest.mark.nightly
@pytest.mark.parametrize("name", FORMULAS)
def test_each_operation_is_recorded(name: str) -> None:
    """A formula with this operation gives numpy's result when recorded, and its truth is certified."""
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


@dataclass(frozen=True, eq=False)
class QuadraticDrag(ContinuousLoad):
    """F = -c |v| v; on a line, |v| v is smooth as a series, but has a kink at v = 0."""

    kind: ClassVar[str] = "quadratic drag"

    coefficient: float

    def wrench(self, scene: Scene, at: Instants) -> tuple[Array, Array]:  # noqa: ARG002 - as of any load
        """Return the drag and no torque."""
        speed = np.sqrt(np.sum(at.velocity**2, axis=-1))[..., None]
        return -self.coefficient * speed * at.velocity, np.zeros_like(at.omega)


def thrown(velocity: tuple[float, float, float]) -> Scene:
    """Return a body of 2 kg under quadratic drag, thrown upward in a gravity of 9.5 m/s^2."""
    start = replace(START, velocity=np.array(velocity))
    body, gravity = replace(BODY, mass=2.0), np.array([0.0, 0.0, -9.5])
    return Scene(body, start, (QuadraticDrag(0.25),), gravity, duration_s=2.0, samples=5)


def test_truth_of_a_formula_holds_up_to_its_kink(expected_message: ExpectedMessage) -> None:
    """A body thrown vertically: v = w tan(atan(v0 / w) - g t / w) up to the apex, and no truth beyond."""
    terminal = np.sqrt(2.0 * 9.5 / 0.25)
    apex = terminal / 9.5 * np.arctan(5.0 / terminal)
    t_s = apex * np.array([0.0, 0.5, 0.99, 0.999999])
    truth = certified_truth(thrown((0.0, 0.0, 5.0)), t_s)
    expected = terminal * np.tan(np.arctan(5.0 / terminal) - 9.5 * t_s / terminal)
    errors = np.abs(truth.trajectory.velocity_m_s[:, 2] - expected)
    assert np.all(errors <= truth.bound_m_s + 4.0 * np.finfo(float).eps * terminal)
    with expected_message.raises(ValueError):
        certified_truth(thrown((0.0, 0.0, 5.0)), np.array([0.0, apex + 0.02]))


def test_formula_that_starts_at_its_kink_has_no_truth(expected_message: ExpectedMessage) -> None:
    """The speed of a body at rest is the square root of 0."""
    with expected_message.raises(ValueError):
        certified_truth(thrown((0.0, 0.0, 0.0)), np.array([0.0, 0.5]))


@pytest.mark.parametrize("sideways", [1e-6, 1e-3])
def test_truth_of_a_formula_passes_near_its_kink(sideways: float) -> None:
    """A body thrown almost vertically turns at its apex as a second method finds."""
    scene = thrown((sideways, 0.0, 5.0))
    truth = certified_truth(scene, np.array([0.0, 0.4, 0.6, 1.0]))

    def rates(_: float, v: Array) -> Array:
        return scene.gravity - 0.125 * np.linalg.norm(v) * v

    other = solve_ivp(
        rates, (0.0, 1.0), scene.initial.velocity, "DOP853", truth.trajectory.t_s, rtol=1e-13, atol=1e-18
    )
    np.testing.assert_allclose(truth.trajectory.velocity_m_s, other.y.T, rtol=0.0, atol=2e-12)
    assert np.max(truth.bound_m_s) < 1e-9


@pytest.mark.parametrize("page", ["scenarios.md", "workers.md"])
def test_every_kind_of_load_is_in_the_docs(page: str) -> None:
    """The pages on the format and on messages list every kind of load with all its keys."""
    text = (DOCS / page).read_text()
    for kind, load in load_kinds().items():
        assert kind in text
        keys = load.keys()
        assert all((key.name if page == "scenarios.md" else name) in text for name, key in keys.items())
