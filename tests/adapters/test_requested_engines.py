"""Engines that run only on request and are installed, compared with drivers that do not use bodycheck.

Run `bodycheck environments make --all`, then `pytest -m engines`; engines without an environment are skipped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bodycheck
from bodycheck.adapters.contract import DEFAULTS, Setting, read_back_mismatch
from bodycheck.adapters.execution import Answer, Case
from bodycheck.adapters.registry import optional_engines, stated_by
from bodycheck.adapters.versions.environments import (
    NODE_PACKAGES,
    is_made,
    needed_environment,
    program_in,
    python_of,
)
from bodycheck.adapters.workers.engine_pool import EnginePool
from bodycheck.reference_impl.imu import ImuReadings, imu_mistake
from bodycheck.reference_impl.rotations import (
    cross,
    geodesic_angle,
    matrix_to_quaternion,
    project_to_so3,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Torque
from bodycheck.reports.cache.answers import Answers
from bodycheck.reports.run_files.method_words import NOT_MEASURED
from bodycheck.runs.dynamics_run import DynamicsOptions, dynamics
from bodycheck.runs.engine_checks import check_adapter, fingerprints
from tests.helpers.engine_methods import expected_map

pytestmark = [pytest.mark.engines, pytest.mark.slow]

DRIVERS = Path(__file__).parents[1] / "helpers"
METHODS = [(engine, name) for engine in optional_engines() for name in stated_by(engine).methods]
FAIR = [(engine, name) for engine, name in METHODS if DEFAULTS not in name]
START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1]))
SCENE = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 3.0])), START, (), np.zeros(3), 1.0, 2)
ROUND_OFF = {"float64": 1e-11, "float32": 2e-5}
"""For 100 steps: about 100 times eps of the precision times the number of steps."""


def made_or_skipped(engine: str) -> None:
    """Skip the test unless the engine is installed or has an environment."""
    needed = needed_environment(engine)
    if needed is not None and not is_made(needed):
        pytest.skip(f"no environment: bodycheck environments make {engine}")


def driven(engine: str, method: str) -> dict[str, list[float]]:
    """Return the last state computed by the driver, which runs in the engine's environment."""
    needed = needed_environment(engine)
    program = None if needed is None else program_in(needed)
    if program is not None:
        command = ["node", str(DRIVERS / "engine_drivers.mjs"), engine, method]
        variables = {NODE_PACKAGES: program.environment[NODE_PACKAGES], "PATH": _path()}
    else:
        python = sys.executable if needed is None else str(python_of(needed))
        command = [python, "-P", str(DRIVERS / "engine_drivers.py"), engine, method]
        variables = {"PATH": _path(), "HOME": str(Path.home())}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=variables)
    found: dict[str, list[float]] = json.loads(done.stdout.splitlines()[-1])
    return found


def _path() -> str:
    return os.environ["PATH"]


def recorded(engine: str, method: str) -> Answer:
    """Return the answer of the adapter in a worker."""
    facts = stated_by(engine).methods[method]
    setting = Setting(dt_s=1e-2) if facts.control == "dt" else Setting(tolerance=1e-12)
    pool = EnginePool()
    try:
        announced = pool.announced(engine)
        return Answers(None, None, 300.0).ask(pool, announced, Case(SCENE, method, setting))
    finally:
        pool.close()


@pytest.mark.parametrize(("engine", "method"), METHODS)
def test_adapter_gives_the_state_of_a_driver_without_bodycheck(engine: str, method: str) -> None:
    """After 100 steps attitude and omega equal the driver's to the round-off of the precision."""
    made_or_skipped(engine)
    answer, expected = recorded(engine, method), driven(engine, method)
    precision = stated_by(engine).methods[method].precision
    assert answer.outcome == "ok", answer.message
    assert answer.read_back is not None
    assert answer.trajectory is not None
    dt_s = 1e-2 if stated_by(engine).methods[method].control == "dt" else None
    assert read_back_mismatch(SCENE, dt_s, answer.read_back, precision) is None
    quaternion = np.array(expected.get("quaternion", [0.0] * 4))
    if "rotation" in expected:
        quaternion = matrix_to_quaternion(project_to_so3(np.array(expected["rotation"])))
    turn = quaternion_to_matrix(quaternion)
    omega = np.array(expected.get("omega_body", 0.0))
    if "omega_world" in expected:
        omega = turn.T @ np.array(expected["omega_world"])
    angle = float(geodesic_angle(answer.trajectory.attitude[-1], quaternion / np.linalg.norm(quaternion)))
    apart = float(np.max(np.abs(answer.trajectory.omega_body[-1] - omega)))
    print(f"{engine}:{method} {angle:.1e} rad, {apart:.1e} rad/s from its driver")
    assert angle <= ROUND_OFF[precision]
    assert apart <= ROUND_OFF[precision]


@pytest.mark.parametrize(("engine", "method"), FAIR)
def test_adapter_meets_the_contract(engine: str, method: str) -> None:
    """`bodycheck check-adapter` passes for every method with fair settings."""
    made_or_skipped(engine)
    found = check_adapter(f"{engine}:{method}", timeout_s=600.0)
    assert not found.failures


WRONG = [
    ("jolt-js", "semi-implicit@defaults"),
    ("cannon-es", "leapfrog@defaults"),
    ("newton", "semi-implicit@defaults"),
    ("sapien", "physx@defaults"),
]
HEALTHY = [
    ("rapier", "semi-implicit@defaults"),
    ("rapier-js", "semi-implicit@defaults"),
    ("newton", "xpbd"),
    ("newton", "featherstone"),
]


@pytest.mark.parametrize(("engine", "method"), [*WRONG, *HEALTHY])
def test_defaults_that_change_the_motion_are_reported(engine: str, method: str) -> None:
    """A damped method or one without the gyroscopic term does not converge; other methods do."""
    made_or_skipped(engine)
    run = bodycheck.run(["free-flight"], engines=[f"{engine}:{method}"], speed=False)
    verdicts = set(run.methods["verdict"])
    assert ("does-not-converge" in verdicts) == ((engine, method) in WRONG)
    assert set(run.results["outcome"]) == {"ok"}


@pytest.mark.parametrize(
    ("engine", "method", "tolerance"),
    [("basilisk", "rk4", 1e-9), ("simbody", "runge-kutta-merson", 1e-8)],
)
def test_published_attitude_is_reproduced(engine: str, method: str, tolerance: float) -> None:
    """The attitude of test_SCTransAndRotation of Basilisk's test_spacecraft.py after 10 s."""
    made_or_skipped(engine)
    omega = np.array([0.5, -0.4, 0.7])
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), omega)
    scene = Scene(RigidBody(100.0, np.diag([500.0, 200.0, 300.0])), start, (), np.zeros(3), 10.0, 2)
    pool = EnginePool()
    try:
        case = Case(scene, method, Setting(dt_s=1e-3))
        answer = Answers(None, None, 300.0).ask(pool, pool.announced(engine), case)
    finally:
        pool.close()
    assert answer.trajectory is not None
    q = answer.trajectory.attitude[-1]
    q = -q if q[0] < 0.0 else q
    published = np.array([0.373034285, -0.00239564413, 0.208570797])
    assert np.abs(q[1:] / (1.0 + q[0]) - published).max() < tolerance


@pytest.mark.parametrize(
    ("engine", "method", "tolerance"),
    [
        ("drake", "runge-kutta3", 1e-12),
        ("drake", "discrete", 1e-12),
        ("newton", "mujoco-euler", 1e-6),
        ("newton", "mujoco-rk4", 1e-6),
    ],
)
def test_sensors_read_the_exact_specific_force(engine: str, method: str, tolerance: float) -> None:
    """Accelerometer and gyro agree with their own motion, and a dropped omega x v is named."""
    made_or_skipped(engine)
    loads = (Torque("body", np.array([0.1, 0.2, 0.3])),)
    start = State(np.zeros(3), np.array([0.8, 0.2, -0.4, 0.4]), np.array([0.5, -0.1, 0.2]), np.ones(3))
    body = RigidBody(1.3, np.array([[0.8, 0.1, -0.15], [0.1, 1.0, 0.05], [-0.15, 0.05, 1.2]]))
    scene = Scene(body, start, loads, np.array([0.0, 0.0, -9.81]), 1.0, 11)
    pool = EnginePool()
    try:
        case = Case(scene, method, Setting(dt_s=1e-2))
        answer = Answers(None, None, 300.0).ask(pool, pool.announced(engine), case)
    finally:
        pool.close()
    motion = answer.trajectory
    assert motion is not None
    true = ImuReadings.of(scene, motion)
    assert np.max(np.abs(true.departure(motion))) < tolerance  # type: ignore[arg-type]
    faulty = motion.specific_force_m_s2 - cross(motion.omega_body, true.velocity)
    named = imu_mistake(scene, replace(motion, specific_force_m_s2=faulty))
    assert named == "accelerometer: omega x v is missing"


def test_accelerometer_of_basilisk_reads_the_mean_of_its_step() -> None:
    """Its ImuSensor departs from the exact reading in proportion to the step, and has omega x v."""
    made_or_skipped("basilisk")
    needed = needed_environment("basilisk")
    python = sys.executable if needed is None else str(python_of(needed))
    command = [python, "-P", str(DRIVERS / "basilisk_imu.py")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    fine, middle, coarse = json.loads(done.stdout.splitlines()[-1]).values()
    assert fine["accelerometer"] < 1e-7 < 1e-6 < fine["omega x v"]
    assert fine["gyro"] == middle["gyro"] == coarse["gyro"] == 0.0
    for finer, coarser in ((fine, middle), (middle, coarse)):
        assert coarser["accelerometer"] / finer["accelerometer"] == pytest.approx(100.0, rel=0.05)


TREES = ["double-pendulum", "free-chain", "free-ball"]
ALL = {"mass_matrix", "bias", "gravity_bias", "accelerations", "wrenches", "energy", "momenta", "poses"}
REPORTED = {
    "pinocchio": ALL,
    "drake": ALL,
    "exudyn": ALL - {"wrenches", "energy"},
    "sapien": ALL - {"energy"},
    "rapier": {"accelerations", "energy", "momenta", "poses"},
}


@pytest.mark.parametrize("engine", REPORTED)
def test_readings_of_trees_are_right(engine: str) -> None:
    """What an engine reports of built-in and random trees agrees with the exact values."""
    made_or_skipped(engine)
    found = dynamics(engine, TREES, DynamicsOptions(random=3))
    verdicts = {one.reading: one.verdict for one in found.readings}
    assert {reading for reading, verdict in verdicts.items() if verdict == "right"} == REPORTED[engine]
    assert not found.wrong


@pytest.mark.parametrize(
    ("engine", "method", "order", "trees"),
    [
        ("exudyn", "explicit-midpoint", 2.0, {"free-chain", "free-ball"}),
        ("exudyn", "rk44", 4.0, {"free-chain", "free-ball"}),
        ("exudyn", "trapezoidal-index2", 2.0, {"free-chain", "free-ball"}),
        ("sapien", "physx", 1.0, {"free-chain"}),
        ("rapier", "semi-implicit", 1.0, {"free-chain", "free-ball"}),
    ],
)
def test_motion_of_trees_is_of_the_order_of_the_method(
    engine: str, method: str, order: float, trees: set[str]
) -> None:
    """Trees are built as stated and converge to the truth; joints that an engine lacks are refused."""
    made_or_skipped(engine)
    run = bodycheck.run(
        ["free-chain", "free-ball"], engines=[f"{engine}:{method}"], dt_s=[1e-2, 5e-3, 2.5e-3], speed=False
    )
    assert {row.scenario for row in run.results.itertuples() if row.outcome == "ok"} == trees
    assert set(run.results["outcome"]) <= {"ok", "unsupported"}
    for scenario in trees:
        errors = run.results[run.results["scenario"] == scenario].set_index("dt_s")["joint_error_rad"]
        measured = np.log2(errors[1e-2] / errors[2.5e-3]) / 2.0
        assert measured == pytest.approx(order, abs=0.25), scenario


def test_trapezoidal_rule_of_jsbsim_errs_twice_as_much_as_its_default() -> None:
    """JSBSim's own analysis (pull request 1453): order 1, with twice the error of Euler's method."""
    made_or_skipped("jsbsim")
    methods = ["jsbsim:default", "jsbsim:trapezoidal"]
    run = bodycheck.run(["free-flight"], engines=methods, dt_s=[2e-3, 1e-3], speed=False)
    errors = run.results.pivot_table(index="dt_s", columns="method", values="orientation_error_rad")
    ratios = errors["trapezoidal"] / errors["default"]
    assert ratios.to_numpy() == pytest.approx(2.0, rel=0.01)


@pytest.mark.parametrize("engine", optional_engines())
def test_formula_of_each_method_is_its_measured_map(engine: str) -> None:
    """The fingerprint of a method is the map that it states, if a known one."""
    made_or_skipped(engine)
    for row in fingerprints(engine, timeout_s=600.0):
        if row["fingerprint"] != NOT_MEASURED:
            assert row["fingerprint"].startswith(expected_map(stated_by(engine).methods[row["method"]])), row
