"""float32: kernels of the reference, the declaration of an engine, the floor, the verdict, the advice."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import count
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from bodycheck import StepState
from bodycheck.adapters.contract import Engine, Precision, Setting, read_back_mismatch
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.step_function import StepFunction
from bodycheck.examine.probes.probe import built_in_probes, precision_finding
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_acceleration
from bodycheck.reference_impl.integrators import INTEGRATORS, SINGLE_PRECISION
from bodycheck.reference_impl.kernels.jit import in_single_precision
from bodycheck.reference_impl.loads.kinds.drag import Drag
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reports.measurement.case import CaseResult, measured_by
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.convergence import Criteria, Point, convergence_of
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.measurement.round_off import RoundOff, fitted
from bodycheck.reports.measurement.study import Study, study
from bodycheck.reports.summary.advice import settings_within
from bodycheck.reports.summary.error_curve import ErrorCurve
from bodycheck.scenarios.library import load_scenario
from tests.helpers.single_stages import PARTS, STAGES, rk4_with_a_single_stage

NAMES = sorted(SINGLE_PRECISION)
ERROR = "orientation_error_rad"
SINGLE = 2.0**-24


def kernels_of(function: FunctionType) -> Iterator[FunctionType]:
    """Yield a function and all functions of bodycheck that it calls."""
    yield function
    for name in function.__code__.co_names:
        called = getattr(function.__globals__.get(name), "py_func", function.__globals__.get(name))
        if isinstance(called, FunctionType):
            yield from kernels_of(called)


@pytest.mark.parametrize("name", NAMES)
def test_no_constant_of_a_single_precision_kernel_is_a_double(name: str) -> None:
    """A double constant would widen the arithmetic, as it does in the original kernel."""
    double = INTEGRATORS[name.removesuffix("-f32")].advance
    single = in_single_precision(double)
    kinds = []
    for compiled in (double, single):
        constants: set[Any] = set()
        for function in kernels_of(getattr(compiled, "py_func", compiled)):
            used = [function.__globals__.get(name) for name in function.__code__.co_names]
            constants |= {type(value) for value in (*function.__code__.co_consts, *used)}
        kinds.append(constants)
    assert float in kinds[0]
    assert float not in kinds[1]
    assert np.float32 in kinds[1]


@cache
def problem_of(name: str) -> Problem:
    """Return a scenario of the library with its truth."""
    return Problem.of(load_scenario(name), name)


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
def test_a_single_precision_method_is_the_double_one_to_float32(name: str) -> None:
    """After one step each number is a float32 within four roundings of the double method's number."""
    scene = replace(load_scenario("tumbling").scene, duration_s=0.01, samples=2)
    setting, adapter = Setting(dt_s=0.01), Reference()
    single, double = (
        record(adapter, Case(scene, method, setting)).trajectory
        for method in (name, name.removesuffix("-f32"))
    )
    assert single is not None
    assert double is not None
    assert single.omega_body_rad_s is not None
    assert single.quaternion is not None
    for found, expected in (
        (single.omega_body_rad_s, double.omega_body),
        (single.quaternion, double.attitude),
    ):
        np.testing.assert_array_equal(found, found.astype(np.float32))
        difference = np.max(np.abs(found[1] - expected[1])) / np.max(np.abs(expected[1]))
        assert 0.0 < difference < 4.0 * SINGLE


@pytest.mark.parametrize("name", NAMES)
def test_a_single_precision_method_runs_on_request_and_takes_constant_loads(name: str) -> None:
    """The method is not a default of a run, and names the loads that its kernels do not support."""
    method, scene = Reference().methods[name], load_scenario("tumbling").scene
    assert method.on_request
    assert method.precision == "float32"
    dragged = replace(scene, loads=(Drag(0.1, 0.1 * np.eye(3)),))
    assert Reference().unsupported(scene, name) is None
    assert Reference().unsupported(dragged, name) == f"{name} supports only constant loads"


def test_read_back_is_compared_in_the_precision_of_the_method() -> None:
    """Rounded numbers are right for a float32 method and not for a float64 one; wrong ones for neither."""
    scene = load_scenario("boxes").scene
    held = Reference().build(scene, "rk4-f32", 2e-3).read_back()
    assert held.mass == scene.body.mass
    assert read_back_mismatch(scene, 2e-3, held, "float32") is None
    assert read_back_mismatch(scene, 2e-3, held, "mixed") is None
    assert "inertia" in str(read_back_mismatch(scene, 2e-3, held, "float64"))
    wrong = replace(held, inertia=held.inertia * (1.0 + 2e-5))
    assert "inertia" in str(read_back_mismatch(scene, 2e-3, wrong, "float32"))
    late = replace(held, dt_s=2e-3 * (1.0 + 5e-6))
    assert "step" in str(read_back_mismatch(scene, 2e-3, late, "float32"))


def free_probe(stage: int | None, part: str, *, of_rate: bool, place: int = -1) -> Trajectory:
    """Return the free probe at its finest step, or another one, by an rk4 with a stage rounded to float32."""
    probe = built_in_probes()[1]
    step = probe.steps_s[place]
    scene = replace(probe.scene, samples=round(probe.scene.duration_s / step) + 1)
    engine = StepFunction(rk4_with_a_single_stage(scene, stage, part, of_rate=of_rate))
    found = record(engine, Case(scene, "step", Setting(dt_s=step))).trajectory
    assert found is not None
    return found


# a constant acceleration, and a position that affects nothing, are not rounded at random
CASTS = [
    pytest.param(stage, part, of_rate, id=f"{'rate' if of_rate else 'state'} of {part} in stage {stage + 1}")
    for stage in STAGES
    for part in PARTS
    for of_rate in (True, False)
    if part != ("velocity" if of_rate else "position")
]


@pytest.mark.slow(after=4)
@pytest.mark.nightly(after=11)
@pytest.mark.parametrize(("stage", "part", "of_rate"), CASTS)
def test_a_cast_in_one_stage_is_detected(stage: int, part: str, of_rate: bool) -> None:
    """A float64 rk4 with one stage rounded to float32 is inconsistent."""
    paths = (free_probe(stage, part, of_rate=of_rate, place=place) for place in (-1, -3))
    found = precision_finding(next(paths), "float64", next(paths))
    assert found.verdict == "inconsistent"
    assert "not all of the arithmetic is float64" in found.message


def euler_step(state: StepState, h: float, *, turn_first: bool) -> StepState:
    """Return the state after a symplectic Euler step of a free body, or after its adjoint."""
    omega, turned = state.omega_body, state.omega_body
    omega = omega + h * angular_acceleration(state.body.inertia, omega, np.zeros(3))
    turn = exp_quaternion(h * (turned if turn_first else omega))
    velocity = state.velocity + h * np.array([1.2, -2.3, -9.4])
    position = state.position + h * (state.velocity if turn_first else velocity)
    quaternion = quaternion_product(state.quaternion, turn)
    return replace(state, position=position, velocity=velocity, quaternion=quaternion, omega_body=omega)


def every(period: int) -> Callable[[], Callable[[StepState, float], StepState]]:
    """Return what makes a method that takes the adjoint step in each of these periods."""

    def make() -> Callable[[StepState, float], StepState]:
        made = count()

        def step(state: StepState, h: float) -> StepState:
            return euler_step(state, h, turn_first=next(made) % period == 0)

        return step

    return make


def two_step() -> Callable[[StepState, float], StepState]:
    """Return Adams-Bashforth 2 in omega, started by an Euler step."""
    before: list[Array] = []

    def step(state: StepState, h: float) -> StepState:
        rate = angular_acceleration(state.body.inertia, state.omega_body, np.zeros(3))
        old = before[0] if before else rate
        before[:] = [rate]
        moved = euler_step(state, h, turn_first=False)
        omega = state.omega_body + h * (1.5 * rate - 0.5 * old)
        turn = exp_quaternion(0.5 * h * (state.omega_body + omega))
        return replace(moved, omega_body=omega, quaternion=quaternion_product(state.quaternion, turn))

    return step


def own_steps() -> Callable[[StepState, float], StepState]:
    """Return a method with steps of 0.37 h of its own: two in some steps, three in others."""
    made = count(1)

    def step(state: StepState, h: float) -> StepState:
        number = next(made)
        lengths = math.floor(number / 0.37) - math.floor((number - 1) / 0.37)
        for _ in range(lengths):
            state = euler_step(state, h / lengths, turn_first=False)
        return state

    return step


@pytest.mark.parametrize(
    ("make", "verdict"),
    [
        pytest.param(every(2), "consistent", id="a map and its adjoint"),
        pytest.param(every(3), "consistent", id="two steps of a map and one of its adjoint"),
        pytest.param(every(5), "consistent", id="a period of five"),
        pytest.param(two_step, "consistent", id="a multistep method and its start"),
        pytest.param(own_steps, "not-measured", id="an irregular number of substeps"),
    ],
)
def test_a_method_without_one_smooth_map_is_not_accused(
    make: Callable[[], Callable[[StepState, float], StepState]], verdict: str
) -> None:
    """In double precision its round-off is measured, or the probe states that it cannot tell."""
    probe = built_in_probes()[1]
    paths = []
    for step in probe.steps_s:
        scene = replace(probe.scene, samples=round(probe.scene.duration_s / step) + 1)
        found = record(StepFunction(make()), Case(scene, "step", Setting(dt_s=step))).trajectory
        assert found is not None
        paths.append(found)
    result = precision_finding(paths[-1], "float64", paths[-3])
    assert result.verdict == verdict
    assert bool(result.message) == (verdict == "not-measured")


def test_a_cast_in_an_alternating_method_is_detected() -> None:
    """A splitting and its adjoint, with omega rounded to float32 before each step."""
    probe = built_in_probes()[1]
    paths = []
    for dt_s in probe.steps_s:
        made = count()

        def step(state: StepState, h: float, made: Iterator[int] = made) -> StepState:
            omega = state.omega_body.astype(np.float32).astype(np.float64)
            turned = euler_step(replace(state, omega_body=omega), h, turn_first=next(made) % 2 == 0)
            return replace(turned, omega_body=turned.omega_body + (state.omega_body - omega))

        scene = replace(probe.scene, samples=round(probe.scene.duration_s / dt_s) + 1)
        found = record(StepFunction(step), Case(scene, "step", Setting(dt_s=dt_s))).trajectory
        assert found is not None
        paths.append(found)
    result = precision_finding(paths[-1], "float64", paths[-3])
    assert result.verdict == "inconsistent"
    assert "not all of the arithmetic is float64" in result.message


def test_a_statement_that_the_numbers_contradict_is_inconsistent() -> None:
    """Doubles may be declared float64 only, float32 numbers float32 or mixed."""
    doubles = free_probe(None, "position", of_rate=True)
    names = ("position_m", "velocity_m_s", "quaternion", "omega_body_rad_s")
    singles = replace(doubles, **{n: getattr(doubles, n).astype(np.float32).astype(float) for n in names})
    stated: list[tuple[Precision, Trajectory, bool]] = [
        ("float64", doubles, True),
        ("float32", doubles, False),
        ("mixed", doubles, False),
        ("float64", singles, False),
        ("float32", singles, True),
        ("mixed", singles, True),
    ]
    for precision, path, right in stated:
        found = precision_finding(path, precision)
        assert (found.verdict == "consistent") is right, precision
        assert bool(found.message) is not right


def test_the_floor_grows_with_the_root_of_the_steps_or_with_the_steps() -> None:
    """Rounding errors of a tumbling body are random; those of a steady spin-up about an axis are alike."""
    for name, exponent in (("tumbling", 0.5), ("torus-spin-up", 1.0)):
        found = RoundOff.of(problem_of(name), ERROR, "float32")
        steps = (1e-2, 1e-3)
        least = found.unit * found.largest  # the error of a single rounding
        grown = (found.at(steps[1]) - least) / (found.at(steps[0]) - least)
        assert math.log10(grown) == pytest.approx(exponent, abs=0.1), name


def test_curvatures_are_those_of_a_regular_precession() -> None:
    """omega_x = omega_1 cos(k t), k = (I3 - I1) omega_3 / I1 (Landau and Lifshitz, Mechanics, section 35)."""
    found = RoundOff.of(problem_of("symmetric-top"), ERROR, "float32")
    k, t_s = (3.0 - 2.0) / 2.0 * 2.0, np.linspace(0.0, 10.0, 101)
    angles = k * t_s[1:-1]
    curvatures = [k * k * np.sqrt(np.mean(wave**2)) for wave in (np.cos(angles), np.sin(angles))]
    assert [curvature for _, curvature in found.components[0]] == pytest.approx(curvatures, rel=2e-3)


def test_the_floor_is_proportional_to_the_unit_round_off_where_roundings_are_independent() -> None:
    """At a coarse step the floors of float32 and float64 differ by 2^29."""
    single, double = (RoundOff.of(problem_of("tumbling"), ERROR, kind) for kind in ("float32", "float64"))
    assert single.at(1e-2) == pytest.approx(2.0**29 * double.at(1e-2), rel=0.05)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("name", ["tumbling", "symmetric-top", "full-tensor"])
@pytest.mark.parametrize("bias", [3.0, 30.0])
def test_a_bias_of_rounding_errors_grows_with_the_steps(name: str, bias: float) -> None:
    """A Runge-Kutta 4 that makes omega too small by B u in every step has the error predicted for this B."""
    problem, dt_s = problem_of(name), 1e-2
    advance = rk4_with_a_single_stage(problem.scenario.scene, None, "position", of_rate=True)

    def step(state: StepState, dt: float) -> StepState:
        state = advance(state, dt)
        return replace(state, omega_body=state.omega_body * (1.0 - bias * SINGLE))

    predicted = RoundOff.of(problem, ERROR, "float32", bias).at(dt_s)
    unbiased = RoundOff.of(problem, ERROR, "float32").at(dt_s)
    errors = []
    for function in (step, advance):
        found = record(StepFunction(function), Case(problem.scenario.scene, "step", Setting(dt_s=dt_s)))
        assert found.trajectory is not None
        motion = EnergyAndMomentum.of(problem.scenario.scene, found.trajectory)
        errors.append(measured_by(problem, found.trajectory, motion)[0][ERROR])
    assert errors[1] < 0.1 * errors[0]  # the method's own error
    assert 1.0 / 3.0 < errors[0] / predicted < 3.0
    assert predicted > 3.0 * unbiased


@pytest.mark.parametrize("level", [0.2, 1.0, 5.0])
@pytest.mark.parametrize("order", [1, 4])
def test_the_fitted_branches_predict_finer_steps(order: int, level: float) -> None:
    """c h^p + a N^(1/2), scattered by 0.3, is predicted at two finer steps to within a factor of 2."""
    rng = np.random.default_rng(order)
    steps = 0.2 / 2.0 ** np.arange(12)
    floors = 1e-6 * np.sqrt(1.0 / steps)
    errors = 3.0 * 0.1 ** (4 - order) * steps**order * 1e-2 + level * floors
    scattered = errors * np.exp(0.3 * rng.standard_normal(len(steps)))
    branches = fitted(steps[:-2], scattered[:-2], floors[:-2], order)
    for step, floor, error in zip(steps[-2:], floors[-2:], errors[-2:], strict=True):
        assert 0.5 < error / branches.error(step, floor) < 2.0


def points(errors: dict[float, float], level: float) -> list[Point]:
    """Return points whose round-off is predicted to be level / sqrt(h)."""
    return [Point(dt, error, None, level / math.sqrt(dt)) for dt, error in errors.items()]


@pytest.mark.parametrize(
    "steps", [(0.02, 0.01, 0.005, 0.002, 0.001), (0.02, 0.01, 0.005, 0.002, 0.001, 2e-4, 1e-5)]
)
def test_steps_dominated_by_round_off_do_not_hide_a_wrong_limit(steps: tuple[float, ...]) -> None:
    """An error of 0.1 + 3 h, with a predicted round-off of 1e-7 / h, does not converge to the truth."""
    made = [Point(dt, 0.1 + 3.0 * dt, None, 1e-7 / dt) for dt in steps]
    assert convergence_of(made, Criteria(floor=1e-14)).verdict == "does-not-converge"


def test_the_verdict_names_the_floor_of_the_arithmetic() -> None:
    """Errors that finer steps do not reduce are at the floor only if the arithmetic explains them."""
    criteria, flat = Criteria(floor=1e-14), {0.02: 3e-5, 0.01: 5e-6, 0.005: 7e-6, 0.002: 9e-6, 0.001: 8e-6}
    assert convergence_of(points(flat, 1e-6), criteria).verdict == "at-precision-floor"
    assert convergence_of(points(flat, 1e-10), criteria).verdict != "at-precision-floor"
    assert convergence_of(points(flat, 0.0), criteria).verdict != "at-precision-floor"
    exact = {0.02: 3e-3, 0.01: 0.0}
    assert convergence_of(points(exact, 0.0), criteria).verdict == "too-few-points"
    falling = {dt: 1e-2 * dt for dt in flat}
    assert convergence_of(points(falling, 1e-9), criteria).verdict == "converges"


@cache
def studied(method: str, scenario: str = "tumbling") -> Study:
    """Return the study of a method of the reference, with the steps that it adds itself."""
    adapter, problem = Reference(), problem_of(scenario)
    return study(
        problem,
        Engine(adapter.name, adapter.version, adapter.methods),
        adapter.methods[method],
        [Setting(dt_s=step) for step in problem.scenario.steps],
        adaptive=True,
        ask=lambda _, case: record(adapter, case),
        search=None,
        case_done=lambda: None,
    )


@pytest.mark.parametrize("scenario", ["tumbling", "sphere", "torus-spin-up"])
def test_an_honest_float32_method_reaches_its_floor_and_is_not_accused(scenario: str) -> None:
    """Best step, least error and both floors are given, and no quantity of rk4-f32 is reported as wrong."""
    found = studied("rk4-f32", scenario)
    assert all(case.ok for case in found.cases)
    verdicts = {row["quantity"]: row["verdict"] for row in found.method_rows}
    assert not {"does-not-converge", "lower-order", "unstable"} & set(verdicts.values())
    row = next(row for row in found.method_rows if row["quantity"] == ERROR)
    assert row["verdict"] == "at-precision-floor"
    errors = {case.dt_s: case.columns[ERROR] for case in found.cases}
    assert row["least_error"] == min(errors.values()) == errors[row["best_dt_s"]]
    assert 0.1 < row["least_error"] / row["predicted_floor"] < 10.0
    assert 0.1 < row["measured_floor"] / row["predicted_floor"] < 10.0


def test_a_method_above_its_floor_has_no_measured_one() -> None:
    """rk4 in double precision has the finest step as its best, and does not reach its predicted floor."""
    row = next(row for row in studied("rk4").method_rows if row["quantity"] == ERROR)
    assert row["verdict"] == "converges"
    assert row["best_dt_s"] == row["finest_dt_s"]
    assert row["predicted_floor"] < 0.1 * row["least_error"]
    assert "measured_floor" not in row


def test_no_step_finer_than_the_best_one_is_advised() -> None:
    """Finer float32 steps miss the tolerance by round-off, so the best or a coarser step is recommended."""

    def case(dt_s: float, error: float, precision: str) -> CaseResult:
        who = {
            "scenario": "free",
            "engine": "e",
            "method": precision,
            "control": "dt",
            "precision": precision,
        }
        return CaseResult(
            {
                **who,
                "dt_s": dt_s,
                "outcome": "ok",
                "message": "",
                "reproduce": f"bodycheck run free --engine e:{precision} --dt {dt_s}",
                "truth_bound_rad": 0.0,
                ERROR: error,
                "cpu_s": 1.0,
            }
        )

    def curve(method: str, cases: list[CaseResult]) -> dict[tuple[str, tuple[str, str]], ErrorCurve]:
        finest_first = tuple(sorted(cases, key=lambda one: one.columns["dt_s"]))
        return {("free", ("e", method)): ErrorCurve(finest_first, ERROR, 1.0, 0.1)}

    errors = {0.1: 1e-2, 0.05: 8e-4, 0.02: 3e-5, 0.01: 6e-4, 0.005: 2e-3}
    for tolerance, step in ((1e-3, 0.05), (1e-4, 0.02)):
        cases = [case(dt, error, "float32") for dt, error in errors.items()]
        (answer,) = settings_within(curve("float32", cases), tolerance, ["free"])
        assert [(option.setting, option.basis) for option in answer.options] == [(step, "measured")]
    doubles = [case(dt, error, "float64") for dt, error in errors.items()]
    (answer,) = settings_within(curve("float64", doubles), 1e-3, ["free"])
    assert [option for option in answer.options if option.basis == "measured"] == []
