"""Behaviour that is specific to MuJoCo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bodycheck.adapters.contract import read_back_mismatch
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum
from bodycheck.reference_impl.scene import (
    ConstantLoad,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    State,
    Torque,
)
from bodycheck.reference_impl.wrench import wrench_between
from tests.helpers.expected_messages import ExpectedMessage

mujoco = pytest.importorskip("mujoco")

from bodycheck.adapters.mujoco import MuJoCo, MuJoCoSimulation  # noqa: E402 - it imports the engine

BEYOND_THE_LIMIT = np.array([1.0, 2.0, np.nextafter(3.0, 4.0)])  # a plate with one round-off too much


def scene_of(inertia: Array, loads: tuple[ConstantLoad, ...] = (), *, mass: float = 1.0) -> Scene:
    """Return a scene of a turning body."""
    initial = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1]))
    return Scene(RigidBody(mass, inertia), initial, loads, np.zeros(3), duration_s=1.0, samples=2)


def built(scene: Scene, method: str = "euler", dt_s: float = 1e-2) -> MuJoCoSimulation:
    """Build a simulation; MuJoCo needs no closing."""
    return MuJoCo().build(scene, method, dt_s)


def model_arrays(simulation: MuJoCoSimulation) -> dict[str, Array]:
    """Return every array of the compiled model."""
    model = simulation._model
    found = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: np.copy(value) for name, value in found.items() if isinstance(value, np.ndarray)}


def test_every_integrator_of_the_installed_version_is_a_method() -> None:
    """Each integrator of the installed MuJoCo is a method with facts; a new one makes this test fail."""
    names = {name.removeprefix("mjINT_").lower() for name in mujoco.mjtIntegrator.__members__}
    assert {name for name, facts in MuJoCo.methods.items() if not facts.on_request} == names


def test_compiler_still_refuses_what_the_adapter_works_around(expected_message: ExpectedMessage) -> None:
    """MuJoCo's compiler refuses moments that violate the triangle inequality by one round-off."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=1.0, inertia=BEYOND_THE_LIMIT)
    body.add_freejoint()
    with expected_message.raises(ValueError):
        spec.compile()


def test_plate_has_exactly_its_moments() -> None:
    """Moments that the compiler refuses are in the model, bit for bit."""
    simulation = built(scene_of(np.diag(BEYOND_THE_LIMIT)))
    np.testing.assert_array_equal(simulation._model.body_inertia[1], BEYOND_THE_LIMIT)


def test_setting_the_moments_afterwards_changes_nothing_else() -> None:
    """A plate's model differs from that of a body on the limit by a few round-offs."""
    plate, inside = (
        model_arrays(built(scene_of(np.diag(moments)))) for moments in (BEYOND_THE_LIMIT, [1.0, 2.0, 3.0])
    )
    for name, value in plate.items():
        np.testing.assert_allclose(value, inside[name], rtol=2e-15, atol=0, err_msg=name)


def test_mass_matrix_follows_the_moments_set_afterwards() -> None:
    """If real and compiled moments differ by 10 %, a torque from rest has the effect of the real ones."""
    impossible = scene_of(np.diag([1.0, 2.0, 3.3]), (Torque("body", np.array([0.1, 0.2, 0.3])),))
    impossible = replace(impossible, initial=replace(impossible.initial, omega_body=np.zeros(3)))
    simulation = built(impossible)
    simulation.apply(wrench_between(impossible, 0.0, 1.0))
    simulation.advance(1)
    omega = simulation.read().omega_body
    np.testing.assert_allclose(omega, 1e-2 * np.array([0.1, 0.2 / 2.0, 0.3 / 3.3]), rtol=1e-15)


@pytest.mark.parametrize(
    ("loads", "actuators"),
    [
        ((), 0),
        ((Torque("body", np.ones(3)), Torque("world", np.ones(3))), 0),
        ((PointForce("world", np.ones(3), np.zeros(3)),), 0),
        ((PointForce("body", np.ones(3), np.ones(3)), PointForce("body", np.ones(3), np.zeros(3))), 1),
        ((PointForce("world", np.ones(3), np.ones(3)), PointForce("world", -np.ones(3), np.ones(3))), 1),
        ((PointForce("world", np.ones(3), np.ones(3)), PointForce("body", np.ones(3), np.ones(3))), 2),
    ],
)
def test_model_has_only_the_actuators_that_the_loads_need(
    loads: tuple[ConstantLoad, ...], actuators: int
) -> None:
    """There is one actuator for all body-fixed forces and one per point of a world force, and no other."""
    assert built(scene_of(np.eye(3), loads))._model.nu == actuators


def test_force_at_a_point_without_actuator_is_refused(expected_message: ExpectedMessage) -> None:
    """A force at a point that the model has no actuator for is an error."""
    strange = scene_of(np.eye(3), (PointForce("world", np.ones(3), np.ones(3)),))
    with expected_message.raises(ValueError):
        built(scene_of(np.eye(3))).apply(wrench_between(strange, 0.0, 1.0))


@pytest.mark.parametrize(
    "planted", ["body_mass", "body_inertia", "body_iquat", "opt.timestep", "opt.gravity"]
)
def test_read_back_reads_the_engine(planted: str) -> None:
    """A value that is changed in the compiled model changes the value read back."""
    scene = scene_of(np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 2.5]]))
    simulation = built(scene)
    assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is None
    match planted:
        case "opt.timestep":
            simulation._model.opt.timestep = 1e-3
        case "opt.gravity":
            simulation._model.opt.gravity[2] = -9.81
        case _:
            getattr(simulation._model, planted)[1] *= 1.01
    assert read_back_mismatch(scene, 1e-2, simulation.read_back()) is not None


def test_unstable_body_is_not_reset_to_rest() -> None:
    """At |omega| h = 20 rad, Euler ends in an unstable state; autoreset would return a body at rest."""
    scene = scene_of(np.diag([1.0, 2.0, 3.0]))
    fast = replace(scene, initial=replace(scene.initial, omega_body=np.array([10.0, 200.0, 10.0])))
    simulation = built(fast, dt_s=0.1)
    simulation.advance(100)
    omega = simulation.read().omega_body
    assert omega is not None
    assert not np.linalg.norm(omega) < 1e10


def test_large_acceleration_alone_is_not_an_error() -> None:
    """A spin with |omega|^2 above 1e10, for which MuJoCo warns, keeps its angular momentum to 1e-5."""
    scene = scene_of(np.diag([1.0, 2.0, 3.0]))
    spinning = replace(scene, initial=replace(scene.initial, omega_body=np.array([2e5, 1e5, 2e5])))
    simulation = built(spinning, "rk4", dt_s=1e-7)
    simulation.advance(100)
    reading = simulation.read()
    assert reading.rotation is not None
    assert reading.omega_body is not None
    assert simulation._data.warning.number[mujoco.mjtWarning.mjWARN_BADQACC] > 0
    momentum = angular_momentum(reading.rotation, spinning.body.inertia, reading.omega_body)
    np.testing.assert_allclose(momentum, [2e5, 2e5, 6e5], rtol=1e-5)


def test_warning_of_altered_numbers_is_raised() -> None:
    """When MuJoCo replaces a singular inertia by a larger one, reading the state raises RuntimeError."""
    simulation = built(scene_of(np.diag([1.0, 2.0, 3.0])))
    simulation._model.dof_M0[3:] = 1e-17
    simulation.advance(1)
    with pytest.raises(RuntimeError, match="mjWARN_INERTIA"):
        simulation.read()


def test_warnings_are_neither_printed_nor_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """An unstable run prints and writes nothing, and the user's own handler stays installed."""
    monkeypatch.chdir(tmp_path)
    messages: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(messages.append)
    try:
        test_unstable_body_is_not_reset_to_rest()
        mujoco.get_mju_user_warning()("still mine")
    finally:
        mujoco.set_mju_user_warning(before)
    assert messages == ["still mine"]
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("scene", [scene_of(np.eye(3), mass=1e-16), scene_of(1e-16 * np.eye(3))])
def test_body_below_the_compilers_minimum_is_unsupported(scene: Scene) -> None:
    """A mass or moment below mjMINVAL is unsupported with the reason, as the compiler would refuse it."""
    assert "1e-15" in str(MuJoCo().unsupported(scene, "euler"))
    with pytest.raises(ValueError, match="mjMINVAL"):
        built(scene)


# -------------------------------------------------------------------------------- the passive callback


def loaded_by_a_sine() -> Scene:
    """Return a scene under a sine torque."""
    return replace(scene_of(np.eye(3)), loads=(SineTorque("body", np.array([1.0, 0.0, 0.0]), 3.0, 0.5),))


def test_callback_is_removed_after_each_call() -> None:
    """Between two calls MuJoCo has no callback of bodycheck, even if the last call raised an error."""
    simulation = built(loaded_by_a_sine())
    simulation.advance(3)
    assert mujoco.get_mjcb_passive() is None
    passive_loads = simulation._continuous
    assert passive_loads is not None
    with pytest.raises(ZeroDivisionError), passive_loads.acting_on(simulation._data, 1):
        raise ZeroDivisionError
    assert mujoco.get_mjcb_passive() is None


def test_callback_acts_on_its_own_model_only() -> None:
    """Stepping a model without loads applies no load of another model."""
    loaded, free = built(loaded_by_a_sine()), built(loaded_by_a_sine())
    passive_loads = loaded._continuous
    assert passive_loads is not None
    before = free.read()
    with passive_loads.acting_on(loaded._data, 0):
        mujoco.mj_step(free._model, free._data, nstep=5)
    after = free.read()
    assert before.omega_body is not None
    np.testing.assert_array_equal(after.omega_body, before.omega_body)


def test_unexpected_evaluations_are_reported(expected_message: ExpectedMessage) -> None:
    """It is an error if MuJoCo evaluates forces more often than a step has stages."""
    simulation = built(loaded_by_a_sine(), "rk4")
    passive_loads = simulation._continuous
    assert passive_loads is not None
    with expected_message.raises(RuntimeError), passive_loads.acting_on(simulation._data, 1):
        mujoco.mj_step(simulation._model, simulation._data, nstep=2)
