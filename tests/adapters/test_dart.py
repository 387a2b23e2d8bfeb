"""Behaviour that is specific to DART."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import read_back_mismatch
from bodycheck.reference_impl.scene import RigidBody, Scene, State

dartpy = pytest.importorskip("dartpy")

from bodycheck.adapters.dart import Dart, DartSimulation  # noqa: E402 - it imports the engine

INERTIA = np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 2.5]])


def scene_of() -> Scene:
    """Return a scene of a turning body in gravity."""
    initial = State(
        np.zeros(3), np.array([0.5, -0.5, 0.1, 0.7]), np.array([0.3, 0.1, -0.2]), np.array([0.1, 2.0, 0.1])
    )
    gravity = np.array([0.0, 0.0, -9.81])
    return Scene(RigidBody(1.3, INERTIA), initial, (), gravity, duration_s=1.0, samples=2)


def built(scene: Scene, dt_s: float = 1e-2) -> DartSimulation:
    """Build a simulation; DART needs no closing."""
    return Dart().build(scene, "semi-implicit", dt_s)


def in_a_world(simulation: DartSimulation) -> Any:
    """Put the skeleton of a simulation into a world with the same gravity, and step it."""
    world = dartpy.simulation.World()
    world.setGravity(simulation._skeleton.getGravity())
    world.setTimeStep(simulation._skeleton.getTimeStep())
    deactivation = world.getDeactivationOptions()
    deactivation.mEnabled = False
    world.setDeactivationOptions(deactivation)
    world.addSkeleton(simulation._skeleton)
    return world


def test_step_equals_that_of_a_world() -> None:
    """200 steps end bit for bit where World.step ends, although the adapter has no world."""
    alone, inside = built(scene_of()), built(scene_of())
    world = in_a_world(inside)
    alone.advance(200)
    for _ in range(200):
        world.step()
    for name in ("position", "velocity", "rotation", "omega_world"):
        np.testing.assert_array_equal(getattr(alone.read(), name), getattr(inside.read(), name))


def test_no_body_is_put_to_sleep() -> None:
    """A body of 1e-7 m/s still moves after 100 s."""
    scene = replace(scene_of(), gravity=np.zeros(3))
    slow = replace(scene.initial, velocity=np.array([1e-7, 0.0, 0.0]), omega_body=np.zeros(3))
    simulation = built(replace(scene, initial=slow))
    simulation.advance(10_000)
    np.testing.assert_allclose(simulation.read().position, [1e-5, 0.0, 0.0], rtol=1e-9, atol=1e-18)


def test_lost_state_reads_as_nan_and_stops_stepping(capfd: pytest.CaptureFixture[str]) -> None:
    """If DART replaces a lost rotation by the identity, NaN is read and stepping stops."""
    scene = scene_of()
    fast = replace(scene, initial=replace(scene.initial, omega_body=np.array([10.0, 200.0, 10.0])))
    simulation = built(fast, 0.5)
    simulation.advance(20)
    np.testing.assert_array_equal(simulation._body.getWorldTransform().rotation(), np.eye(3))
    rotation = simulation.read().rotation
    assert rotation is not None
    assert np.all(np.isnan(rotation))
    capfd.readouterr()
    simulation.advance(1000)
    assert capfd.readouterr() == ("", "")
    simulation.reset()
    simulation.advance(1)
    np.testing.assert_allclose(simulation.read().position[:2], 0.5 * fast.initial.velocity[:2], rtol=1e-12)


@pytest.mark.parametrize("planted", ["mass", "inertia", "step", "gravity"])
def test_read_back_reads_the_engine(planted: str) -> None:
    """A value that is changed in the engine changes the value read back."""
    scene = scene_of()
    simulation = built(scene)
    assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None
    match planted:
        case "mass":
            simulation._body.setMass(1.31)
        case "inertia":
            simulation._body.setMomentOfInertia(1.0, 2.0, 2.5, 0.1, 0.2, -0.3)
        case "step":
            simulation._skeleton.setTimeStep(1e-3)
        case "gravity":
            simulation._skeleton.setGravity(np.zeros(3))
    assert planted in str(read_back_mismatch(scene, 1e-2, simulation.read_back()))


def test_release_with_other_velocities_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before 6.17 the velocities of a free joint have body axes: motions from turned poses would differ."""
    monkeypatch.setattr(Dart, "version", "6.16.7")
    with pytest.raises(ImportError, match=r"6\.16\.7"):
        Dart()
