"""probes.csv: every healthy method is consistent with itself; a wrong reading, load or delay is not."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeAlias
from unittest import mock

import numpy as np
import pandas as pd
import pytest

import bodycheck
from bodycheck.adapters.contract import Adapter, Engine, Method, Precision, ReadBack, Reading, Simulation
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.probes import probe
from bodycheck.examine.probes.finding import limit, noise
from bodycheck.examine.probes.probe import built_in_probes, probe_rows
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import diagonalised
from bodycheck.reference_impl.rotations import exp_matrix, normalised, quaternion_to_matrix
from bodycheck.reference_impl.scene import RigidBody, Scene, Torque
from bodycheck.reference_impl.wrench import Wrench
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.tables import TABLES
from tests.helpers.planted_faults import Faulty

ENGINES = {"reference": "Reference", "mujoco": "MuJoCo", "pybullet": "PyBullet", "dart": "Dart"}
DAMPED = "pybullet:multibody@defaults"
"""Damps by 0.04 and clamps omega at 100 rad/s, as Bullet does by default."""

Rows = list[dict[str, Any]]


def methods() -> list[Any]:
    """Return a test parameter (adapter, method) for each method of each engine that imports."""
    found: list[Any] = []
    for engine, class_name in ENGINES.items():
        try:
            module = importlib.import_module(f"bodycheck.adapters.{engine}")
        except ImportError as error:
            found.append(pytest.param(None, "", id=engine, marks=pytest.mark.skip(reason=str(error))))
            continue
        adapter: Adapter = getattr(module, class_name)()
        found += [pytest.param(adapter, name, id=f"{engine}:{name}") for name in adapter.methods]
    return found


def engine_of(adapter: Adapter) -> Engine:
    """Return the adapter as a run knows it."""
    return Engine(adapter.name, adapter.version, adapter.methods)


def probed(
    adapter: Adapter, method: str, changed: Callable[[Scene], Scene] | None = None
) -> dict[str, dict[str, Any]]:
    """Return the rows of one method by their checks; changed: what is made of the scenes."""
    engine, probes = engine_of(adapter), built_in_probes()
    if changed is not None:
        loaded, free = (replace(one, scene=changed(one.scene)) for one in probes)
        probes = loaded, free
    with mock.patch.object(probe, "built_in_probes", return_value=probes):
        rows = probe_rows(engine, adapter.methods[method], lambda _, case: record(adapter, case))
    assert len({row["check"] for row in rows}) == len(rows)
    return {row["check"]: row for row in rows}


def accused(rows: Mapping[str, Mapping[str, Any]]) -> set[str]:
    """Return the checks that a method did not pass."""
    return {check for check, row in rows.items() if row["verdict"] == "inconsistent"}


HEALTHY = [param for param in methods() if param.id != DAMPED]


@pytest.mark.slow
@pytest.mark.nightly(after=13)
@pytest.mark.parametrize(("adapter", "method"), HEALTHY)
def test_no_healthy_method_is_reported(adapter: Adapter, method: str) -> None:
    """Each check of each method is consistent by a factor of ten, those of methods without loads too."""
    rows = probed(adapter, method)
    assert accused(rows) == set()
    for check, row in rows.items():
        if row["tolerance"] is not None and not check.endswith("delay"):
            assert row["deviation"] <= 0.1 * row["tolerance"], check
        if check.endswith("delay"):
            assert row["deviation"] <= 0.01, check
    refused = adapter.methods[method].control == "none"
    assert ("responses" in rows) == refused
    assert {"gravity_response", "velocity_reading"} <= rows.keys()
    if not refused:
        assert [row["verdict"] for row in rows.values()] == ["consistent"] * len(rows)


def random_body(seed: int) -> RigidBody:
    """Return a body with mass and size over many decades, its moments up to the triangle inequality."""
    draw = np.random.default_rng(seed)
    mass = 10.0 ** draw.uniform(-3.0, 4.0)
    second = mass * 10.0 ** draw.uniform(-4.0, 2.0) * draw.uniform(0.05, 1.0, 3)
    axes = exp_matrix(draw.uniform(-3.0, 3.0, 3))
    inertia = axes @ np.diag(np.sum(second) - second) @ axes.T
    return RigidBody(mass, 0.5 * (inertia + inertia.T))


def of_another_body(seed: int, scene: Scene) -> Scene:
    """Return a probe of another body, attitude, place and motion, its loads in proportion to that body."""
    draw, body = np.random.default_rng(1000 + seed), random_body(seed)
    start = replace(
        scene.initial,
        position=10.0 ** draw.uniform(-2.0, 2.0) * draw.normal(size=3),
        quaternion=normalised(draw.normal(size=4)),
        omega_body=np.linalg.norm(scene.initial.omega_body) * normalised(draw.normal(size=3)),
    )
    moments, _ = diagonalised(body.inertia)
    reach = np.sqrt(np.min(moments) / body.mass)
    loads = tuple(
        replace(load, value=np.min(moments) * load.value)
        if isinstance(load, Torque)
        else replace(load, value=body.mass * reach * load.value, at=reach * load.at)  # type: ignore[call-arg]
        for load in scene.piecewise_constant_loads
    )
    return replace(scene, body=body, initial=start, loads=loads)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (1, 2, 3))])
@pytest.mark.parametrize(("adapter", "method"), HEALTHY)
def test_no_healthy_method_is_reported_for_any_body(adapter: Adapter, method: str, seed: int) -> None:
    """For any mass, size, moments, axes, attitude and position: the tolerances follow the motion."""
    assert accused(probed(adapter, method, partial(of_another_body, seed))) == set()


def test_defaults_of_an_engine_are_detected() -> None:
    """Bullet's damping of 0.04 and its clamp at 100 rad/s are visible in responses and conservation."""
    pytest.importorskip("pybullet")
    from bodycheck.adapters.pybullet import PyBullet

    rows = probed(PyBullet(), DAMPED.partition(":")[2])
    assert {"gravity_response", "angular_momentum_change"} <= accused(rows)
    # v' = g - (0.04 + 0.04 |v|) v, over the 16 ms in which gravity is the only force
    gravity, until = float(np.linalg.norm([1.2, -2.3, -9.4])), 0.016
    lost = 0.04 * until / 2.0 + 0.04 * gravity * until**2 / 3.0
    assert rows["gravity_response"]["measured"] == pytest.approx(1.0 - lost, abs=1e-6)


def _with_all_axes(reading: Reading) -> Reading:
    """Return a reading with its rotation matrix, and with omega in world axes."""
    assert reading.quaternion is not None
    assert reading.omega_body is not None
    rotation = quaternion_to_matrix(reading.quaternion)
    return replace(reading, rotation=rotation, omega_world=rotation @ reading.omega_body)


Turned: TypeAlias = Callable[[Array, Array], Array]
"""(R, load in body axes) -> the load that an engine applies in its place, in body axes."""


class Altered:
    """A simulation of the reference of which a reading or a load is altered."""

    stepping = "python"

    def __init__(
        self,
        inner: Simulation,
        reading: Callable[[Reading], Reading] | None = None,
        late: bool = False,
        stale: tuple[str, ...] = (),
        single: bool = False,
        all_axes: bool = False,
        turned: Turned | None = None,
    ) -> None:
        """late: a load acts one step later; stale: read one step late; single: the state is float32.

        all_axes: the matrix and omega in world axes are read too. turned: rotates loads in body axes.
        """
        self._inner: Any = inner
        self._reading, self._late, self._stale, self._single = reading, late, stale, single
        self._all_axes, self._turned = all_axes, turned
        self.close, self.read_back = inner.close, inner.read_back
        self._before = inner.read()
        self._wrench: Wrench | None = None
        self._given: Wrench | None = None
        self.steps = 0

    def reset(self) -> None:
        """Start again."""
        self._inner.reset()
        self._before = self._inner.read()

    def apply(self, wrench: Wrench) -> None:
        """Apply the load, now or after the next step."""
        self._given = wrench
        if self._late:
            self._wrench = wrench
        else:
            self._inner.apply(wrench)

    def advance(self, steps: int) -> None:
        """Make the steps one by one."""
        for _ in range(steps):
            self._before = self._inner.read()
            if self._turned is not None and self._given is not None:
                turn = partial(self._turned, quaternion_to_matrix(self._before.quaternion))
                force, torque = turn(self._given.force_body), turn(self._given.torque_body)
                self._inner.apply(replace(self._given, force_body=force, torque_body=torque))
            self._inner.advance(1)
            self.steps += 1
            if self._single:
                self._inner._state[:] = self._inner._state.astype(np.float32)
            if self._wrench is not None:
                self._inner.apply(self._wrench)
                self._wrench = None

    def read(self) -> Reading:
        """Return the state, altered."""
        reading, before = (
            _with_all_axes(one) if self._all_axes else one for one in (self._inner.read(), self._before)
        )
        reading = replace(reading, **{name: getattr(before, name) for name in self._stale})
        return reading if self._reading is None else self._reading(reading)


class Altering:
    """The reference under another name, each of its simulations altered."""

    name, version = "altered", "1"

    def __init__(self, precision: Precision = "float64", **how: Any) -> None:
        self._sound, self._how = Reference(), how
        self.methods: Mapping[str, Method] = {
            name: replace(self._sound.methods[name], precision=precision) for name in ("rk4", "m1")
        }

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse what the reference refuses."""
        return self._sound.unsupported(scene, method)

    def build(self, scene: Scene, method: str, dt_s: float) -> Any:
        """Return an altered simulation."""
        return Altered(self._sound.build(scene, method, dt_s), **self._how)


def scaled(name: str, factor: float) -> Callable[[Reading], Reading]:
    """Return a reading of which one quantity is too large."""
    return lambda reading: replace(reading, **{name: factor * getattr(reading, name)})


def rounded(reading: Reading) -> Reading:
    """Return the reading as an engine of single precision holds it."""
    held = {name: getattr(reading, name) for name in Reading.__dataclass_fields__}
    single = {name: None if v is None else v.astype(np.float32).astype(float) for name, v in held.items()}
    return Reading(**single)


STATE = ("position", "velocity", "quaternion", "omega_body")

READINGS: dict[str, tuple[dict[str, Any], set[str]]] = {
    "omega 1e-6 too large": ({"reading": scaled("omega_body", 1.0 + 1e-6)}, {"omega_body_reading"}),
    "velocity 1e-6 too large": ({"reading": scaled("velocity", 1.0 + 1e-6)}, {"velocity_reading"}),
    "position 1e-6 too large": ({"reading": scaled("position", 1.0 + 1e-6)}, {"velocity_reading"}),
    "late loads": ({"late": True}, {"body_torque_delay", "world_force_delay", "world_force_moment_delay"}),
    "late state": ({"stale": STATE}, {"gravity_delay", "body_torque_delay", "attitude_delay"}),
    "late velocity": ({"stale": ("velocity",)}, {"gravity_delay", "body_force_delay"}),
    "late attitude": ({"stale": ("quaternion",)}, {"attitude_delay"}),
    "late position": ({"stale": ("position",)}, {"position_delay"}),
    "late omega": ({"stale": ("omega_body",)}, {"body_torque_delay", "world_torque_delay"}),
    "late matrix": ({"stale": ("rotation",), "all_axes": True}, {"rotation_delay"}),
    "late omega in world axes": ({"stale": ("omega_world",), "all_axes": True}, {"omega_world_delay"}),
}


@pytest.mark.slow(after=6)
@pytest.mark.parametrize("method", ["rk4", "m1"])
@pytest.mark.parametrize("fault", READINGS)
def test_wrong_reading_or_delay_is_reported_by_its_quantity(fault: str, method: str) -> None:
    """Each is reported under its own name, whatever the order of the method."""
    how, expected = READINGS[fault]
    rows = probed(Altering(**how), method)
    assert expected <= accused(rows)
    assert all(row["message"] for row in rows.values() if row["verdict"] == "inconsistent")
    for check in expected:
        if check.endswith("delay"):
            assert rows[check]["measured"] == pytest.approx(1.0, abs=0.02)
            assert " step late" in rows[check]["message"]


@pytest.mark.parametrize("method", ["rk4", "m1"])
@pytest.mark.parametrize("how", [{"reading": rounded}, {"single": True}], ids=["read", "held"])
def test_stated_single_precision_is_not_a_fault(how: dict[str, Any], method: str) -> None:
    """Deviations within the scatter of the readings are not reported, whatever the body."""
    single = Altering("float32", **how)
    assert accused(probed(single, method)) == set()
    assert accused(probed(Altering(**how), method)) == {"precision"}
    for seed in range(5):
        assert accused(probed(single, method, partial(of_another_body, seed))) == set()


class Flipping(Altered):
    """A simulation whose quaternion has another sign after each step."""

    def read(self) -> Reading:
        """Return the same attitude by q or -q."""
        reading = super().read()
        sign = -1.0 if self.steps % 2 else 1.0
        assert reading.quaternion is not None
        return replace(reading, quaternion=sign * reading.quaternion)


def test_sign_of_the_quaternion_is_no_fault() -> None:
    """q and -q are the same attitude, whichever an engine returns."""
    flipping = Altering()
    flipping.build = lambda scene, method, dt_s: Flipping(Reference().build(scene, method, dt_s))  # type: ignore[method-assign]
    assert accused(probed(flipping, "rk4")) == set()


@pytest.mark.parametrize("method", ["rk4", "m1"])
def test_readings_in_all_axes_agree(method: str) -> None:
    """A second reading of attitude and omega adds no fault."""
    rows = probed(Altering(all_axes=True), method)
    assert accused(rows) == set()
    assert {"rotation_delay", "omega_world_delay"} <= rows.keys()


def test_quaternion_that_is_not_renormalised_is_a_property() -> None:
    """It is reported with its size and order, and is not a fault."""
    row = probed(Reference(), "quaternion-euler")["quaternion_norm"]
    assert row["verdict"] == "consistent"
    assert "not renormalised: |q| - 1 = 0.000156 at 1.25e-05 s, order 1.00" in row["message"]
    # |q| grows by sqrt(1 + (h omega / 2)^2) per step, and omega changes a little
    omega, h, steps = float(np.linalg.norm([120.0, -200.0, 90.0])), 1.25e-5, 128
    assert row["measured"] == pytest.approx((1.0 + (h * omega / 2.0) ** 2) ** (steps / 2.0) - 1.0, rel=5e-3)
    assert probed(Reference(), "m1")["quaternion_norm"]["message"] == ""


class Wrong:
    """The reference, whose answers are replaced."""

    def __init__(self, answer: Callable[[Case, Answer], Answer]) -> None:
        self._sound, self._answer = Reference(), answer
        self.requested = 0

    def rows(self, method: str = "m1") -> dict[str, dict[str, Any]]:
        """Return the rows of a method."""
        engine = engine_of(self._sound)

        def ask(_: Engine, case: Case) -> Answer:
            self.requested += 1
            return self._answer(case, record(self._sound, case))

        return {row["check"]: row for row in probe_rows(engine, engine.methods[method], ask)}


@pytest.mark.parametrize(("outcome", "cases"), [("failed", 2), ("unsupported", 2), ("timeout", 1)])
def test_failed_probe_has_the_reason(outcome: Any, cases: int) -> None:
    """One case of each probe is tried; after a time-out it is not repeated."""
    engine = Wrong(lambda _, __: Answer(outcome, "for a reason"))
    rows = engine.rows()
    assert {check: row["verdict"] for check, row in rows.items()} == {
        "responses": "not-measured",
        "readings": "not-measured",
    }
    assert {row["message"] for row in rows.values()} == {f"{outcome}: for a reason"}
    assert engine.requested == cases


def test_motion_that_is_not_finite_is_not_measured() -> None:
    """A state that is not finite gives no finding and ends nothing."""

    def lost(_: Case, answer: Answer) -> Answer:
        path = answer.trajectory
        assert path is not None
        return replace(answer, trajectory=replace(path, position_m=np.full_like(path.position_m, np.nan)))

    rows = Wrong(lost).rows()
    assert {row["verdict"] for row in rows.values()} == {"not-measured"}
    assert all("unstable: position_m is not finite" in row["message"] for row in rows.values())


@pytest.mark.parametrize("name", ["velocity_m_s", "omega_body_rad_s", "position_m"])
def test_reading_of_zeros_is_inconsistent(name: str) -> None:
    """A reading that an engine never fills in is reported, without a division by zero."""

    def empty(_: Case, answer: Answer) -> Answer:
        path = answer.trajectory
        assert path is not None
        zeros = np.zeros_like(getattr(path, name))
        return replace(answer, trajectory=replace(path, **{name: zeros}))

    rows = Wrong(empty).rows()
    reading = "omega_body_reading" if name == "omega_body_rad_s" else "velocity_reading"
    assert reading in accused(rows)
    assert rows[reading]["message"]


def test_wrong_read_back_is_inconsistent() -> None:
    """A read-back that does not match is reported, next to the motion's own findings."""

    def other_mass(_: Case, answer: Answer) -> Answer:
        held = answer.read_back
        assert isinstance(held, ReadBack)
        return replace(answer, read_back=replace(held, mass=2.0))

    rows = Wrong(other_mass).rows()
    assert accused(rows) == {"read_back", "free_read_back"}
    assert "mass is 2. in the engine, not 3." in rows["read_back"]["message"]


@cache
def small_run() -> Any:
    """Return a run of two methods at one step, which is read by several tests."""
    return bodycheck.run(["sphere"], engines=["reference:m1", "reference:rk4"], dt_s=[0.1], speed=False)


@pytest.mark.slow
def test_every_run_has_the_probes_of_its_methods() -> None:
    """One row per method and check with its command, also if steps were specified."""
    table = small_run().probes
    assert tuple(table.columns) == TABLES["probes"].columns
    assert list(dict.fromkeys(table["method"])) == ["m1", "rk4"]
    assert not table.duplicated(["engine", "method", "check"]).any()
    assert set(table["verdict"]) == {"consistent"}
    assert set(table["reproduce"]) == {
        f"bodycheck run {probe} --engine reference:{method} --dt {step}"
        for probe, step in (("probe", "0.000125"), ("probe-free", "1.25e-05"))
        for method in ("m1", "rk4")
    }


@pytest.mark.slow
def test_probes_of_a_stored_run_are_read_back(tmp_path: Path) -> None:
    """probes.csv has the findings to the last digit; an older run without it has no rows."""
    run = small_run()
    bodycheck.write_run(run, tmp_path / "run")
    pd.testing.assert_frame_equal(read_tables(tmp_path / "run").probes, run.probes)
    (tmp_path / "run/probes.csv").unlink()
    old = read_tables(tmp_path / "run").probes
    assert (len(old), tuple(old.columns)) == (0, TABLES["probes"].columns)


def test_limit_is_distinguished_from_a_shrinking_mismatch() -> None:
    """h, h^2 and h^3 have limit zero at any ratio of steps; another limit is found to its digits."""
    steps = [1.0, 0.5, 0.25, 0.125]
    shrinking = [np.array([[0.3 * h, -2.0 * h**2, 5.0 * h**3]]) for h in steps]
    found = limit(steps, shrinking, 0.0)
    assert found.size <= 1e-12
    stays = np.array([[0.0, 1e-4, 0.0]])
    found = limit([1e-3 * h for h in steps], [1e-3 * m + stays for m in shrinking], 0.0)
    assert found.value == pytest.approx(stays, abs=1e-12)


def test_round_off_is_measured_through_kinks_and_outliers() -> None:
    """The scatter of a smooth series is found although loads switch and one sample is wrong."""
    draw, t = np.random.default_rng(7), np.linspace(0.0, 1.0, 400)
    smooth: Array = np.stack([np.sin(t), np.abs(t - 0.5)], axis=1)
    smooth[100] += 1.0
    found = noise(smooth + 1e-7 * draw.normal(size=smooth.shape))
    assert 0.3e-7 < found < 3e-7  # a median of |x| is 0.67 sigma


def _sentence(name: str, *values: float) -> str:
    return next(fault for fault in FAULTS if fault.name == name).text(values)


@pytest.mark.parametrize(
    ("turned", "force", "torque"),
    [
        (
            lambda rotation, load: rotation.T @ rotation.T @ load,
            "wrench-body-by-transpose",
            "torque-body-rotated-twice",
        ),
        (lambda rotation, load: rotation @ load, "wrench-body-rotated-twice", "torque-body-rotated"),
        (lambda rotation, load: rotation.T @ load, "wrench-body-as-world", "torque-body-as-world"),
    ],
)
def test_load_that_is_rotated_wrongly_is_named(turned: Turned, force: str, torque: str) -> None:
    """A load in body axes that acts as R^T F, R R F or F in world axes has the sentence of the catalogue."""
    rows = probed(Altering(turned=turned), "rk4")
    wrong = {
        "body_force_response": force,
        "body_force_moment_response": force,
        "body_torque_response": torque,
    }
    assert set(wrong) <= accused(rows)
    for check, fault in wrong.items():
        assert rows[check]["message"].startswith(f"{_sentence(fault)}: ")


NAMED = {
    "gravity-doubled": {"gravity_response": ("gravity", 2.0)},
    "gravity-reversed": {"gravity_response": ("gravity", -1.0)},
    "gravity-axes": {"gravity_response": ("gravity-axes-xzy",)},
    "gravity-in-body-axes": {"gravity_response": ("gravity-in-body-axes",)},
    "torque-body-as-world": {
        "body_torque_response": ("torque-body-as-world",),
        "body_force_moment_response": ("applied-torque-body-as-world",),
    },
    "torque-world-as-body": {"world_torque_response": ("torque-world-as-body",)},
    "torque-missing": {
        "body_torque_response": ("torque", 0.0),
        "world_torque_response": ("torque", 0.0),
        "body_force_moment_response": ("moment", 0.0),
    },
    "torque-frozen": {
        "body_torque_response": ("torque-frozen",),
        "body_force_moment_response": ("applied-torque-frozen",),
    },
    "force-at-centre": {
        "body_force_moment_response": ("moment", 0.0),
        "world_force_moment_response": ("moment", 0.0),
    },
    "lever-in-world-axes": {"world_force_moment_response": ("arm-rotated",)},
    "moment-reversed": {
        "body_force_moment_response": ("moment", -1.0),
        "world_force_moment_response": ("moment", -1.0),
    },
    "force-missing": {
        "body_force_response": ("force-without-moment", 0.0),
        "world_force_response": ("force", 0.0),
        "world_force_moment_response": ("force", 0.0),
    },
    "force-axes-exchanged": {
        "body_force_response": ("force-body-as-world",),
        "world_force_response": ("force-world-as-body",),
    },
}
"""A planted fault -> its checks, each with the fault of the catalogue that is named."""


@pytest.mark.parametrize("fault", NAMED)
def test_fault_of_a_load_has_the_sentence_of_the_catalogue(fault: str) -> None:
    """A wrong load is named as a diagnosis names it, in each check that it fails, whatever the map is."""
    rows = probed(Faulty("rk4"), fault)
    for check, named in NAMED[fault].items():
        assert rows[check]["message"].startswith(f"{_sentence(*named)}: ")
        assert check in accused(rows)
    others = (rows[check]["message"] for check in accused(rows) - NAMED[fault].keys())
    assert all(message.startswith("the momentum gained") or "while" in message for message in others)


def test_doubled_torque_is_reported_alone() -> None:
    """Responses are separate: a fault of one load is not reported for the others."""
    sound = Reference()

    def twice(_: Engine, case: Case) -> Answer:
        first, *others = case.scene.loads or (None,)
        loads = () if first is None else (replace(first, value=2.0 * first.value), *others)
        return record(sound, replace(case, scene=replace(case.scene, loads=loads)))

    rows = {row["check"]: row for row in probe_rows(engine_of(sound), sound.methods["rk4"], twice)}
    assert accused(rows) == {"body_torque_response"}
    assert rows["body_torque_response"]["measured"] == pytest.approx(2.0)
    assert rows["body_torque_response"]["message"].endswith(": the momentum gained is 2 times the impulse")
