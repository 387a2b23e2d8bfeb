"""A link off the centre of mass as engines step it by default: with the velocity of the link's origin."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bodycheck.adapters.contract import VARIANT, Simulation, read_back_mismatch
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Link, Load, PointForce, RigidBody, Scene, SineTorque, State, Torque
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.wrench import wrench_between
from tests.helpers.engine_methods import adapter_of, state_of
from tests.helpers.first_order_maps import skew
from tests.helpers.textbook_motion import wrench_at

BUILDS = ("unaligned", "welded")
EXPLICIT = ("mujoco:euler", "dart:semi-implicit")
IMPLICIT = ("mujoco:implicit", "mujoco:implicitfast", "mujoco:discrete")
BY_THE_ORIGIN = (
    *(
        f"mujoco:{name}@{build}"
        for name, build in product(("euler", "implicit", "implicitfast", "discrete"), BUILDS)
    ),
    *("mujoco:euler@defaults", "dart:semi-implicit", "dart:semi-implicit@defaults"),
)
RK4 = tuple(f"mujoco:rk4@{build}" for build in BUILDS)

INERTIA = np.array([[2.0, 0.1, -0.2], [0.1, 2.5, 0.3], [-0.2, 0.3, 3.0]])
OFFSET = np.array([0.2, 0.1, -0.15])
ANY_TURN = Rotation.from_rotvec([0.4, -1.1, 0.6]).as_quat(scalar_first=True)
LINKS = {"unturned": Link(OFFSET, np.array([1.0, 0.0, 0.0, 0.0])), "turned": Link(OFFSET, ANY_TURN)}
LOADS: dict[str, tuple[Load, ...]] = {
    "free": (),
    "constant": (
        Torque("body", np.array([0.3, -0.2, 0.1])),
        Torque("world", np.array([0.1, 0.3, -0.2])),
        PointForce("body", np.array([0.5, 0.3, -0.8]), np.array([0.2, -0.4, 0.3])),
        PointForce("world", np.array([-0.4, 0.3, 0.6]), np.array([0.5, 0.1, 0.0])),
        PointForce("world", np.array([0.2, 0.1, -0.3]), np.zeros(3)),
    ),
    "continuous": (SineTorque("body", np.array([0.9, -1.2, 0.7]), 2.3, 0.4),),
}


def scene_of(loads: tuple[Load, ...] = (), link: Link | None = LINKS["unturned"]) -> Scene:
    """Return a scene of two seconds under gravity, with a link 0.27 m off the centre of mass."""
    quaternion = np.array([0.5, -0.1, 0.7, 0.3])
    start = State(
        position=np.array([0.3, -0.2, 0.1]),
        quaternion=quaternion / np.linalg.norm(quaternion),
        velocity=np.array([0.3, 0.1, -0.2]),
        omega_body=np.array([0.9, 1.5, -1.5]),
    )
    gravity = np.array([0.2, -0.1, -1.8])
    return Scene(RigidBody(1.3, INERTIA), start, loads, gravity, duration_s=2.0, samples=2, link=link)


@contextmanager
def built(name: str, scene: Scene, dt_s: float) -> Iterator[Simulation]:
    """Build ENGINE:METHOD with its loads applied, and close it; skip the test if the engine is missing."""
    engine, method = name.split(":")
    pytest.importorskip({"dart": "dartpy"}.get(engine, engine))
    adapter = adapter_of(engine)
    assert adapter.unsupported(scene, method) is None
    simulation = adapter.build(scene, method, dt_s)
    simulation.apply(wrench_between(scene, 0.0, scene.duration_s))
    try:
        yield simulation
    finally:
        simulation.close()


def by_the_origin(scene: Scene, h: float, *, implicit: bool) -> tuple[Array, Array, Array, Array]:
    """Step (v of the link's origin in world axes, omega in body axes), then the pose.

    M = [[m, -m R [c]x], [m [c]x R^T, I_o]], bias b = (m R omega x (omega x c), omega x I_o omega), c the
    centre of mass from the origin; (M + h D) du = h (f - b), D = db/du, or 0 where explicit.
    """
    m, initial = scene.body.mass, scene.initial
    assert scene.link is not None
    c = -scene.link.offset
    about_origin = scene.body.inertia - m * skew(c) @ skew(c)
    turn, w = Rotation.from_quat(initial.quaternion, scalar_first=True), initial.omega_body
    r = turn.as_matrix()
    x, v = initial.position - r @ c, initial.velocity - r @ np.cross(w, c)
    for step in range(round(scene.duration_s / h)):
        r = turn.as_matrix()
        force, torque = wrench_at(scene, step * h, x, r, v, r @ w)
        mass = np.block([[m * np.eye(3), -m * r @ skew(c)], [m * skew(c) @ r.T, about_origin]])
        bias = np.concatenate([m * r @ np.cross(w, np.cross(w, c)), np.cross(w, about_origin @ w)])
        if implicit:
            swing = np.outer(w, c) + (w @ c) * np.eye(3) - 2.0 * np.outer(c, w)
            gyroscopic = skew(w) @ about_origin - skew(about_origin @ w)
            mass[:3, 3:] += h * m * r @ swing
            mass[3:, 3:] += h * gyroscopic
        push = np.concatenate([force, r.T @ torque + np.cross(c, r.T @ force)])
        change = np.linalg.solve(mass, h * (push - bias))
        v, w = v + change[:3], w + change[3:]
        x, turn = x + h * v, turn * Rotation.from_rotvec(h * w)
    r = turn.as_matrix()
    return x + r @ c, v + r @ np.cross(w, c), r, w


@pytest.mark.slow(after=4)
@pytest.mark.nightly(after=13)
@pytest.mark.parametrize("name", BY_THE_ORIGIN)
@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("kind", LOADS)
def test_step_equals_the_map_of_the_links_origin(name: str, link: str, kind: str) -> None:
    """200 steps of 1e-2 s end within 1e-11 of the map in plain numpy, for any rotation of the link."""
    scene = scene_of(LOADS[kind], LINKS[link])
    with built(name, scene, 1e-2) as simulation:
        simulation.advance(200)
        found = state_of(simulation.read())
    expected = by_the_origin(scene, 1e-2, implicit=name.partition(VARIANT)[0] in IMPLICIT)
    for value, want in zip(found, expected, strict=True):
        np.testing.assert_allclose(value, want, rtol=0, atol=1e-11)


def errors(name: str, scene: Scene, dt_s: float) -> list[float]:
    """Return the errors of position in m, of velocity in m/s and of orientation in rad at the end."""
    truth = solve_truth(scene, np.array([0.0, scene.duration_s])).trajectory
    with built(name, scene, dt_s) as simulation:
        simulation.advance(round(scene.duration_s / dt_s))
        position, velocity, r, _ = state_of(simulation.read())
    return [
        float(np.linalg.norm(position - truth.position_m[-1])),
        float(np.linalg.norm(velocity - truth.velocity_m_s[-1])),
        float(Rotation.from_matrix(truth.rotation_matrices[-1].T @ r).magnitude()),
    ]


@pytest.mark.parametrize("name", [*BY_THE_ORIGIN, *RK4])
def test_centre_of_mass_drifts_at_the_order_of_the_method(name: str) -> None:
    """The error of a free body without gravity has the order of the method."""
    scene = replace(scene_of(), gravity=np.zeros(3))
    coarse, fine = (errors(name, scene, dt_s) for dt_s in (1e-2, 5e-3))
    order = 4.0 if name in RK4 else 1.0
    np.testing.assert_allclose(np.log2(np.divide(coarse, fine)), order, atol=0.1)
    assert 1e-3 < coarse[0] < 3e-2 or name in RK4


@pytest.mark.parametrize("name", ["mujoco:euler", "mujoco:implicit", "mujoco:discrete"])
def test_aligned_body_moves_straight(name: str) -> None:
    """With the default changed as `changed_defaults` states, the body moves straight to round-off."""
    scene = replace(scene_of(), gravity=np.zeros(3))
    assert max(errors(name, scene, 1e-2)[:2]) < 1e-13


@pytest.mark.parametrize("name", [*BY_THE_ORIGIN, *RK4])
@pytest.mark.parametrize("link", LINKS)
def test_engine_reads_back_the_scene(name: str, link: str) -> None:
    """Mass, inertia, step, gravity and initial state are read back, summed over the bodies of the model."""
    scene = scene_of(LOADS["constant"], LINKS[link])
    with built(name, scene, 1e-2) as simulation:
        assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None


PLANTED: dict[str, tuple[str, Any]] = {
    "a heavier child": ("body_mass", 1.01),
    "a stouter child": ("body_inertia", 1.01),
    "a child elsewhere": ("body_pos", 1.01),
    "a child turned": ("body_quat", [1.0, 1.0, 1.0, 1.01]),
}


@pytest.mark.parametrize("planted", PLANTED)
def test_read_back_reads_the_welded_child(planted: str) -> None:
    """A changed value of the child in the compiled model changes the value read back."""
    scene = scene_of(link=LINKS["turned"])
    with built("mujoco:euler@welded", scene, 1e-2) as simulation:
        assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None
        field, factor = PLANTED[planted]
        getattr(simulation._model, field)[2] *= factor  # type: ignore[attr-defined]
        assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is not None


@pytest.mark.parametrize("name", [*BY_THE_ORIGIN, *RK4])
def test_reset_repeats_the_run_bitwise(name: str) -> None:
    """A second run after reset is bit for bit the same."""
    scene = scene_of(LOADS["continuous"], LINKS["turned"])
    ends = []
    with built(name, scene, 1e-2) as simulation:
        for _ in range(2):
            simulation.advance(37)
            ends.append(state_of(simulation.read()))
            simulation.reset()
            simulation.apply(wrench_between(scene, 0.0, scene.duration_s))
    for first, second in zip(*ends, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("method", ["euler", "implicit", "implicitfast", "discrete", "rk4"])
@pytest.mark.parametrize("link", LINKS)
def test_mass_in_a_welded_child_moves_as_mass_in_the_body(method: str, link: str) -> None:
    """Two descriptions of one body give the same state to 1e-13, under constant loads of every kind."""
    scene = scene_of(LOADS["constant"], LINKS[link])
    ends = []
    for build in BUILDS:
        with built(f"mujoco:{method}@{build}", scene, 1e-2) as simulation:
            simulation.advance(200)
            ends.append(state_of(simulation.read()))
    for own, welded in zip(*ends, strict=True):
        np.testing.assert_allclose(welded, own, rtol=0, atol=1e-13)
