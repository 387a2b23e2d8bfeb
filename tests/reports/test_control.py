"""Methods that are controlled by a tolerance, and motions whose truth ends early."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bodycheck
from bodycheck._util.formatting import number
from bodycheck.reports.measurement.convergence import Criteria, Point, tolerance_convergence
from bodycheck.reports.render.page.scenario_section import scenario_facts
from bodycheck.reports.run_files.trajectory_files import trajectory_table
from bodycheck.runs.runner import rank
from tests.helpers.expected_messages import ExpectedMessage

CHAOTIC = """
name = "long torque"
duration_s = 100.0
samples = 201
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 3.0]
[initial]
omega_body_rad_s = [0.1, 2.0, 0.1]
[[forcing]]
kind = "torque"
axes = "world"
value_n_m = [0.3, -0.2, 0.1]
"""


@pytest.fixture(scope="module")
def obedient() -> bodycheck.Run:
    """Return a run of the Taylor method on a free and a forced scenario, at its own tolerances."""
    return bodycheck.run(
        ["full-tensor", "body-torque"], engines=["reference:taylor"], speed=False, laws=False
    )


@pytest.mark.slow
def test_errors_fall_with_the_tolerance(obedient: bodycheck.Run) -> None:
    """From one tolerance to the next finer one the error falls, down to round-off."""
    for _, rows in obedient.results.groupby("scenario"):
        assert rows["dt_s"].isna().all()
        assert (rows["control"] == "tolerance").all()
        assert rows["tolerance"].is_monotonic_decreasing
        errors = rows["orientation_error_rad"].to_numpy()
        assert np.all((errors[1:] < errors[:-1]) | (errors[1:] < 1e-14))
        assert errors[-1] < 1e-14
        assert rows["steps"].is_monotonic_increasing


@pytest.mark.slow
def test_method_with_a_tolerance_has_a_verdict_and_no_order(obedient: bodycheck.Run) -> None:
    """It converges if its errors follow the tolerance; a slope over tolerances is not an order."""
    assert set(obedient.methods["verdict"]) <= {"converges", "at-floor"}
    assert obedient.methods["order"].isna().all()


@pytest.mark.slow
def test_method_with_a_tolerance_has_no_best_step(obedient: bodycheck.Run) -> None:
    """Its floor does not follow from a number of steps that it chooses itself."""
    assert obedient.methods["finest_error"].notna().all()
    columns = ["best_dt_s", "least_error", "predicted_floor", "measured_floor"]
    assert obedient.methods[columns].isna().all(axis=None)


@pytest.mark.slow
def test_requested_tolerances_replace_the_default_ones() -> None:
    """The reproducing command repeats --tolerance."""
    run = bodycheck.run(
        ["full-tensor"], engines=["reference:taylor"], tolerances=[1e-9], speed=False, laws=False
    )
    (row,) = run.results.to_dict("records")
    assert row["tolerance"] == 1e-9
    assert row["reproduce"] == "bodycheck run full-tensor --engine reference:taylor --tolerance 1e-09"


@pytest.mark.parametrize(
    "tolerances",
    [
        [0.0],
        [float("nan")],
        [1.0],
        [1e-6, 1e-6],
    ],
)
def test_impossible_tolerance_is_refused(tolerances: list[float], expected_message: ExpectedMessage) -> None:
    """One line names the value."""
    with expected_message.raises(bodycheck.InputError):
        bodycheck.run(["full-tensor"], engines=["reference:taylor"], tolerances=tolerances)


def points(*errors: float | None) -> list[Point]:
    """Return errors at tolerances from 1e-3 on, a thousandfold finer each."""
    return [Point(10.0 ** (-3 * (i + 1)), error) for i, error in enumerate(errors)]


@pytest.mark.parametrize(
    ("found", "verdict"),
    [
        (points(1e-3, 1e-6, 1e-9), "converges"),
        (points(1e-2, 1e-14, 2e-14), "converges"),
        (points(2e-14, 1e-14, 1e-14), "at-floor"),
        (points(1e-3, 9e-4, 8e-4), "does-not-converge"),
        (points(1e-3), "too-few-points"),
        (points(None, None), "unstable"),
    ],
)
def test_tolerance_convergence_is_judged_over_all_tolerances(found: list[Point], verdict: str) -> None:
    """Errors that fall as the tolerance's root or reach the floor converge; constant ones do not."""
    assert tolerance_convergence(found, Criteria(1e-14)).verdict == verdict


def test_lost_motion_is_chaotic() -> None:
    """If round-off alone exceeds a hundredth of 0.3, the verdict is chaotic."""
    assert tolerance_convergence(points(0.1, 0.2), Criteria(0.01)).verdict == "chaotic"


@pytest.mark.slow
def test_chaotic_motion_is_compared_until_its_truth_ends(tmp_path: Path) -> None:
    """Nothing is measured beyond; the row has the time, and the verdict is chaotic."""
    path = tmp_path / "chaotic.toml"
    path.write_text(CHAOTIC)
    run = bodycheck.run([path], engines=["reference:rk4"], dt_s=[0.05, 0.025], speed=False, laws=False)
    (problem,) = run.problems
    until = problem.truth.trusted_until_s
    assert 50.0 < until < 100.0
    last = problem.truth.trajectory.t_s[problem.compared - 1]
    assert last < until <= problem.truth.trajectory.t_s[problem.compared]
    assert (run.results["compared_until_s"] == last).all()
    assert run.results["message"].str.contains(f"compared until t = {last:.6g} s").all()
    (bound,) = run.results["truth_bound_rad"].unique()
    assert bound < 1e-10
    assert f"bound {number(bound, 2)} rad, " in dict(scenario_facts(problem))["Truth"]
    assert all(len(values) == problem.compared for case in run.cases for values in case.series.values())
    verdicts = run.methods.set_index("quantity")["verdict"]
    assert verdicts["orientation_error_rad"] == "chaotic"


@pytest.mark.slow
def test_files_with_other_samples_of_a_chaotic_motion_are_ranked(tmp_path: Path) -> None:
    """Their last samples before the end of the truth differ, but both files cover the same time span."""
    path = tmp_path / "chaotic.toml"
    path.write_text(CHAOTIC)
    run = bodycheck.run([path], engines=["reference:cf4"], dt_s=[0.025], speed=False, laws=False)
    table = trajectory_table(run.cases[0].trajectory)
    files = [tmp_path / f"every-{stride}.csv" for stride in (1, 8)]
    for file, stride in zip(files, (1, 8), strict=True):
        table[::stride].to_csv(file, index=False)
    rows = rank(files, path).rows
    assert len({row["compared_until_s"] for row in rows}) == 2


@pytest.mark.slow
def test_horizon_is_where_a_case_leaves_the_truth(tmp_path: Path) -> None:
    """Up to the horizon no error exceeds 0.3 rad, the next one does; finer steps have a later horizon."""
    path = tmp_path / "chaotic.toml"
    path.write_text(CHAOTIC)
    run = bodycheck.run(
        [path], engines=["reference:rk4", "reference:cf4"], dt_s=[0.05, 0.025], speed=False, laws=False
    )
    for case in run.cases:
        error = case.series["orientation_error_rad"]
        kept = run.problems[0].times <= case.columns["horizon_s"]
        assert error[kept].max() <= 0.3
        assert kept.all() or error[~kept][0] > 0.3
    for _, rows in run.results.groupby("method"):
        assert rows["horizon_s"].is_monotonic_increasing
    assert (
        bodycheck.run(["full-tensor"], engines=["reference:m1"], dt_s=[0.01], speed=False, laws=False)
        .results["horizon_s"]
        .isna()
        .all()
    )


@pytest.mark.slow
def test_speed_is_relative_to_the_reference_measurement() -> None:
    """A case's time has quartiles in order and a ratio; the machine's noise is known."""
    run = bodycheck.run(["full-tensor"], engines=["reference:m1"], dt_s=[0.01, 0.005])
    rows: pd.DataFrame = run.results
    assert (rows["cpu_s"] > 0.0).all()
    assert (rows["cpu_s_low"] <= rows["cpu_s"]).all()
    assert (rows["cpu_s"] <= rows["cpu_s_high"]).all()
    assert (rows["relative_cpu"] > 0.0).all()
    assert np.allclose(rows["ns_per_step"], 1e9 * rows["cpu_s"] / rows["steps"].astype(float))
    assert run.manifest["speed_noise"] >= 0.0
