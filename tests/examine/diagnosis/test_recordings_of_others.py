"""Recordings of other programs: their start, their digits, and what made them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import bodycheck
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.examine.diagnosis.diagnosis import Diagnosis
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product
from bodycheck.reports.run_files.trajectory_files import trajectory_table
from bodycheck.runs import runner
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.scenario_texts import tumbling

IN_OTHER_AXES = "as if omega is read in the other axes, world for body or body for world"
CASES = Path(__file__).parent / "cases"
NIGHTLY = pytest.mark.nightly


def diagnosis_of(case: str, file: str, scenario: str, dt_s: float | None = None) -> Diagnosis:
    """Return the diagnosis of a recording of a case."""
    (folder,) = CASES.glob(f"{case}-*")
    found = runner.explain(folder / file, folder / scenario, dt_s=dt_s).diagnosis
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("scenario", "size", "meaning"),
    [
        ("same.toml", None, ""),
        ("start-off.toml", 0.1, ""),
        (
            "start-in-world-axes.toml",
            5.06,
            "as if omega is read in the other axes, world for body or body for world",
        ),
    ],
)
def test_the_start_is_a_finding_of_its_own(scenario: str, size: float | None, meaning: str) -> None:
    """Rows that are steps of a map are healthy wherever they start; the difference of the start is stated."""
    found = diagnosis_of("01", "healthy.csv", scenario, 0.01)
    assert (found.verdict, found.base) == ("healthy", "M1")
    if size is None:
        assert found.start is None
    else:
        assert found.start is not None
        assert found.start.sizes == {"omega": pytest.approx(size, rel=1e-3)}
        assert found.start.meaning == meaning


def test_a_start_in_the_other_axes_is_not_a_reading(expected_message: ExpectedMessage) -> None:
    """Only the start of the program is in the other axes; no row is read so."""
    found = diagnosis_of("01", "fine-steps.csv", "fine-steps-start-in-world-axes.toml", 0.002)
    assert (found.verdict, found.base) == ("healthy", "M1")
    assert found.start is not None
    expected_message(found.start.sentence)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("file", ["full.csv", "six-decimals.csv"])
def test_a_map_is_named_to_the_digits_of_the_file(file: str) -> None:
    """Rounding to six decimals is no float32; of 820 maps, only those that equal M1 here are listed."""
    found = diagnosis_of("02", file, "top.toml", 0.01)
    assert (found.verdict, found.base, found.start) == ("healthy", "M1", None)
    assert found.equal_maps == ("M1, step angle at most pi/4",)
    assert found.within == ("the 6 decimals of the file" if file.startswith("six") else "")


def test_a_log_that_begins_after_the_first_step_is_late() -> None:
    """Row k holds the state after step k + 1: the start differs by one step of the map of the rows."""
    found = diagnosis_of("03", "late.csv", "top.toml", 0.01)
    assert (found.verdict, found.base) == ("healthy", "M1")
    assert found.start is not None
    assert found.start.begins_late
    assert set(found.start.sizes) == {"attitude", "omega"}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("matrix-euler.csv", "Buss 2000, order 1, additive matrix"),
        ("lie-euler.csv", "Buss 2000, order 1"),
    ],
)
def test_maps_that_fingerprints_know_are_known(file: str, name: str) -> None:
    """The maps of reference:euler and reference:lie-euler are named, with those that are equal here."""
    found = diagnosis_of("05", file, "top.toml", 0.01)
    assert (found.verdict, found.base) == ("healthy", name)
    assert all(other.startswith(("Buss", "angular momentum")) for other in found.equal_maps)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("dt_s", [None, 0.005])
@pytest.mark.parametrize(
    ("name", "order"), [("left-rate exponential", 1), ("mean-rate exponential", 2), ("mean-rate additive", 2)]
)
def test_strapdown_integration_is_recognised(name: str, order: int, dt_s: float | None) -> None:
    """An attitude that is integrated from the true omega is named with its rule, not as a fault."""
    found = diagnosis_of("06", f"{name.replace(' ', '-')}.csv", "coning.toml", dt_s)
    assert (found.verdict, found.base, found.equal_maps) == ("strapdown", name, ())
    assert f"of order {order}" in found.base_words


@pytest.mark.slow
@pytest.mark.parametrize(("decimals", "slower", "rows"), [(2, 1.0, 601), (3, 100.0, 201), (3, 10.0, 201)])
@pytest.mark.parametrize("factor", [1.0, 1.1])
def test_a_coarse_omega_beside_a_fine_attitude_is_no_fault_and_hides_none(
    decimals: int, slower: float, rows: int, factor: float, tmp_path: Path
) -> None:
    """An exact motion is named, and a wrong tensor, where omega has fewer decimals than the attitude."""
    text = tumbling(omega_body_rad_s=[1.2 / slower, 3.1 / slower, -1.7 / slower])
    text = text.replace("duration_s = 1.0\nsamples = 11", f"duration_s = {30.0 * slower}\nsamples = {rows}")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(text)
    motion = bodycheck.truth(scenario, np.linspace(0.0, 30.0 * slower, rows).tolist()).trajectory
    names = ["t_s", *("qw", "qx", "qy", "qz"), *(f"w{axis}_body_rad_s" for axis in "xyz")]
    table = trajectory_table(motion)[names].round(dict(zip(names, [6] * 5 + [decimals] * 3, strict=True)))
    table.to_csv(tmp_path / "log.csv", index=False)
    scenario.write_text(text.replace("2.0, 2.5]", f"{2.0 * factor}, 2.5]"))
    found = runner.explain(tmp_path / "log.csv", scenario).diagnosis
    assert found is not None
    if factor == 1.0:
        assert (found.verdict, found.base) == ("healthy", "exact")
    else:
        assert ("middle-moment",) in listed(found)


def test_a_step_is_found_where_it_is_one_per_sample() -> None:
    """Without a step, a map with one step per sample is tried after the exact motion."""
    found = diagnosis_of("02", "full.csv", "top.toml")
    assert (found.verdict, found.base) == ("healthy", "M1")


@pytest.mark.nightly
def test_a_fault_changes_the_verdict_of_a_healthy_log(tmp_path: Path) -> None:
    """The checks can fail: a row that is moved by ten resolutions is no longer a step of the map."""
    (folder,) = CASES.glob("02-*")
    lines = (folder / "six-decimals.csv").read_text().splitlines()
    values = np.array([line.split(",") for line in lines[1:]], dtype=float)
    values[100:, 5] += 1e-4
    rows = [lines[0], *(",".join(f"{value:.6f}" for value in row) for row in values)]
    (tmp_path / "moved.csv").write_text("\n".join(rows))
    found = runner.explain(tmp_path / "moved.csv", folder / "top.toml", dt_s=0.01).diagnosis
    assert found is not None
    assert found.verdict != "healthy"


def listed(found: Diagnosis) -> set[tuple[str, ...]]:
    """The names of the faults, and of those that make the same motion."""
    return {tuple(fault.name for fault in found.faults), *found.alike_names}


@pytest.mark.slow
def test_a_free_motion_determines_the_tensor_up_to_a_factor() -> None:
    """xy and xz of the file's body are exchanged: five numbers are determined, at the same trace."""
    found = diagnosis_of("04", "free-swapped-xy-xz.csv", "free.toml", 0.01)
    assert listed(found) == {("inertia-tensor-up-to-a-factor",)}
    mean = (14.13762 + 11.98389 + 7.37877) / 3.0
    change = (-0.28782 - 0.9963) / mean
    values = {parameter.name: parameter.value for parameter in found.faults[0].parameters}
    assert values == pytest.approx({"xx": 0.0, "yy": 0.0, "xy": change, "xz": -change, "yz": 0.0}, abs=1e-9)


@pytest.mark.slow
def test_a_torque_determines_the_whole_tensor() -> None:
    """Under a torque, all six numbers are determined."""
    found = diagnosis_of("04", "torque-swapped-xy-xz.csv", "torque.toml", 0.01)
    assert listed(found) == {("inertia-tensor",)}
    assert all(np.isfinite(parameter.high) for parameter in found.faults[0].parameters)


@pytest.mark.slow
def test_damping_after_the_kick_is_one_fault() -> None:
    """omega+ = (1 - 0.05 h)(omega + h omega') is no pair of damping and another gyroscopic term."""
    found = diagnosis_of("07", "damped.csv", "top.toml", 0.01)
    assert listed(found) == {("damping-angular-after-kick",)}
    (rate,) = found.faults[0].parameters
    assert rate.value == pytest.approx(0.05, rel=1e-9)
    assert 0.0 < rate.high - rate.low < 1e-9


@pytest.mark.slow
def test_only_the_arm_across_the_force_is_determined() -> None:
    """The arm was longer by (0, 0, 0.05) m: the fault is that vector but for a part along the force."""
    found = diagnosis_of("08", "off.csv", "lever.toml", 0.01)
    assert ("arm-shifted",) in listed(found)
    fault = next(fault for fault in found.faults if fault.name == "arm-shifted")
    force = np.array([0.3, 0.2, 1.0])
    off = np.array([parameter.value for parameter in fault.parameters])
    assert np.cross(off, force) == pytest.approx(np.cross([0.0, 0.0, 0.05], force), abs=1e-9)
    (direction,) = fault.undetermined
    assert np.abs(direction) == pytest.approx(force / np.linalg.norm(force), abs=1e-4)
    assert all(np.isinf(parameter.high) for parameter in fault.parameters)


@pytest.mark.slow
def test_a_force_by_the_transpose_is_named() -> None:
    """R^T F in place of R F; the right motion of the same scene is healthy."""
    found = diagnosis_of("09", "body-force-by-transpose.csv", "body.toml", 0.01)
    assert listed(found) == {("force-body-by-transpose",)}
    right = diagnosis_of("09", "body-force-right.csv", "body.toml", 0.01)
    assert (right.verdict, right.base) == ("healthy", "M1")


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("file", ["inverse-of-the-inertia.csv", "six-decimals.csv"])
def test_equal_diagnoses_are_always_listed_together(file: str) -> None:
    """For a sphere, more torque and less inertia are one motion, at any digits."""
    found = diagnosis_of("15", file, "sphere.toml", 0.01)
    assert listed(found) == {("inertia-scaled",), ("torque",)}
    assert all(
        text in found.sentence
        for text in ("inertia is multiplied by 0.35355", "torques are multiplied by 2.8284")
    )


SCALAR_LAST = "t_s=time, qw=q[0], qx=q[1], qy=q[2], qz=q[3]"


def test_a_scalar_last_quaternion_is_recognised_without_omega() -> None:
    """The attitude alone is compared with the truth: read as scalar last, it is the true one."""
    (folder,) = CASES.glob("13-*")
    wrong = runner.explain(folder / "xyzw.npz", "symmetric-top", column_map=SCALAR_LAST).diagnosis
    assert wrong is not None
    assert listed(wrong) == {("quaternion-order-when-read",)}
    right = "t_s=time, qw=q[3], qx=q[0], qy=q[1], qz=q[2]"
    found = runner.explain(folder / "xyzw.npz", "symmetric-top", column_map=right).diagnosis
    assert found is not None
    assert found.verdict == "healthy"


def test_the_reason_why_nothing_is_examined_is_the_one_that_applies(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """An attitude that no reading brings to the truth needs omega to be examined."""
    t_s = np.linspace(0.0, 1.0, 11)
    np.savez(tmp_path / "turned.npz", t_s=t_s, quaternion=np.tile([0.5, 0.5, -0.5, 0.5], (11, 1)))
    one = runner.explain(tmp_path / "turned.npz", "symmetric-top")
    assert one.diagnosis is None
    expected_message(one.reason)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("reversed_axis", [None, "y"])
def test_a_log_of_gyro_rates_alone_is_examined(reversed_axis: str | None, tmp_path: Path) -> None:
    """Free rates need no attitude; the flipped axis is named, and nothing that the file lacks."""
    (folder,) = CASES.glob("02-*")
    lines = (folder / "six-decimals.csv").read_text().splitlines()
    rows = [[line.split(",")[k] for k in (0, 5, 6, 7)] for line in lines]
    if reversed_axis == "y":
        rows[1:] = [[t, x, str(-float(y)), z] for t, x, y, z in rows[1:]]
    (tmp_path / "rates.csv").write_text("\n".join(",".join(row) for row in rows))
    found = runner.explain(tmp_path / "rates.csv", folder / "top.toml", dt_s=0.01).diagnosis
    assert found is not None
    if reversed_axis is None:
        assert found.verdict == "healthy"
        assert "M1" in (found.base, *found.equal_maps)
    else:
        assert ("omega-y-read-scaled",) in listed(found)
        assert found.start is not None
        assert found.start.meaning == "as if omega about y is read with the opposite sign"
    assert "attitude" not in " ".join(fault.sentence for fault in found.faults)


INERTIA = np.array([[0.05, 0.004, -0.003], [0.004, 0.07, 0.006], [-0.003, 0.006, 0.09]])
ROWS = "t_s,x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
FREE = f"""
name = "free"
duration_s = 2.0
samples = 201
[body]
mass_kg = 2.0
inertia_kg_m2 = {INERTIA.tolist()}
[initial]
omega_body_rad_s = [1.0, -2.0, 3.0]
"""


def diagnosis_of_rates(folder: Path, omega: Array) -> Diagnosis:
    """Return the diagnosis of rates (201, 3) of the free body alone, without the step that made them."""
    table = np.column_stack([np.linspace(0.0, 2.0, 201).round(2), omega])
    head = "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(folder / "rates.csv", table, "%.17g", ",", header=head, comments="")
    (folder / "free.toml").write_text(FREE)
    found = runner.explain(folder / "rates.csv", folder / "free.toml").diagnosis
    assert found is not None
    return found


def solved_rates(solver: str, tolerance: float, *, damping: float = 0.0, inertia: Array = INERTIA) -> Array:
    """Return the rates (201, 3) of the dense output of a solver."""

    def change(_: float, omega: Array) -> Array:
        return np.linalg.solve(inertia, -np.cross(omega, inertia @ omega)) - damping * omega

    t_s = np.linspace(0.0, 2.0, 201)
    found = solve_ivp(
        change, (0.0, 2.0), [1.0, -2.0, 3.0], solver, t_s, rtol=tolerance, atol=1e-2 * tolerance
    )
    return np.asarray(found.y.T)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("rate", [0.05, -0.02])
def test_damping_of_a_map_is_named_without_its_step(rate: float, tmp_path: Path) -> None:
    """Steps of h = 0.01 s of omega+ = omega + h (omega' - rate omega) are no exact motion of a solver."""
    omega = [np.array([1.0, -2.0, 3.0])]
    for _ in range(200):
        now = omega[-1]
        change = np.linalg.solve(INERTIA, -np.cross(now, INERTIA @ now)) - rate * now
        omega.append(now + 0.01 * change)
    found = diagnosis_of_rates(tmp_path, np.array(omega))
    assert ("damping-angular",) in listed(found)
    assert found.faults[0].parameters[0].value == pytest.approx(rate, rel=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "solver", ["RK45", *(pytest.param(one, marks=NIGHTLY) for one in ("LSODA", "DOP853"))]
)
@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_a_solver_that_chooses_its_steps_is_right(solver: str, tolerance: float, tmp_path: Path) -> None:
    """What remains of the exact motion varies with the steps, or is not as one-sided as damping."""
    found = diagnosis_of_rates(tmp_path, solved_rates(solver, tolerance))
    assert (found.verdict, found.base) == ("healthy", "exact")


@pytest.mark.nightly
@pytest.mark.parametrize("solver", ["RK45", pytest.param("LSODA", marks=NIGHTLY)])
@pytest.mark.parametrize(
    "fault",
    ["damped", *(pytest.param(one, marks=NIGHTLY) for one in ("anti-damped", "another moment"))],
)
def test_the_errors_of_a_coarse_solver_hide_no_fault(solver: str, fault: str, tmp_path: Path) -> None:
    """At a tolerance of 1e-3, the energy that is lost or gained, or the other tensor, still shows."""
    other = INERTIA * np.where(np.eye(3) * [1, 0, 0], 1.02, 1.0)
    damping = {"damped": 0.05, "anti-damped": -0.05}.get(fault, 0.0)
    inertia = other if fault == "another moment" else INERTIA
    found = diagnosis_of_rates(tmp_path, solved_rates(solver, 1e-3, damping=damping, inertia=inertia))
    assert found.verdict != "healthy"
    named = {one.name for one in (*found.faults, *found.nearly)}
    assert named & ({"smallest-moment"} if fault == "another moment" else {"damping-angular"})


@pytest.mark.slow
def test_an_attitude_half_a_step_late_is_named(tmp_path: Path) -> None:
    """Row k has omega after k steps of M1, and the attitude after k - 1 steps and one of half the length."""

    def step(q: Array, omega: Array, h: float) -> tuple[Array, Array]:
        after = omega - h * np.linalg.solve(INERTIA, np.cross(omega, INERTIA @ omega))
        return quaternion_product(q, exp_quaternion(h * after)), after

    q, omega = np.array([1.0, 0.0, 0.0, 0.0]), np.array([1.0, -2.0, 3.0])
    rows = [[*q, *omega]]
    for _ in range(200):
        late, _ = step(q, omega, 0.005)
        q, omega = step(q, omega, 0.01)
        rows.append([*late, *omega])
    table = np.column_stack([np.linspace(0.0, 2.0, 201).round(2), rows])
    head = "t_s,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(tmp_path / "late.csv", table, "%.9f", ",", header=head, comments="")
    (tmp_path / "free.toml").write_text(FREE)
    found = runner.explain(tmp_path / "late.csv", tmp_path / "free.toml", dt_s=0.01).diagnosis
    assert found is not None
    assert "the attitude is read half a step late" in found.sentence


def noisy_rates(*, inertia: Array = INERTIA) -> Array:
    """Return the rates (201, 3) of the exact motion with white noise of 3e-3 rad/s."""
    noise = 3e-3 * np.random.default_rng(5).normal(size=(201, 3))
    return solved_rates("DOP853", 1e-11, inertia=inertia) + noise


def test_noise_of_a_sensor_is_no_fault(tmp_path: Path) -> None:
    """White noise has another structure than the effects of faults, and is stated with its size."""
    found = diagnosis_of_rates(tmp_path, noisy_rates())
    assert (found.verdict, found.base, found.is_within_noise) == ("healthy", "exact", True)
    assert float(found.within.split()[5]) == pytest.approx(3e-3, rel=0.15)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "fault", ["smallest-moment", pytest.param("inertia-tensor-up-to-a-factor", marks=NIGHTLY)]
)
def test_noise_hides_no_other_tensor(fault: str, tmp_path: Path) -> None:
    """A moment, or an entry, that is 5 % larger moves the motion far more than the noise within the log."""
    moments, axes = np.linalg.eigh(INERTIA)
    smallest = (axes * moments * [1.05, 1.0, 1.0]) @ axes.T
    entry = INERTIA * np.where(np.eye(3) * [1, 0, 0], 1.05, 1.0)
    inertia = smallest if fault == "smallest-moment" else entry
    assert (fault,) in listed(diagnosis_of_rates(tmp_path, noisy_rates(inertia=inertia)))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_the_bias_of_a_gyro_is_named(noise: float, tmp_path: Path) -> None:
    """A constant that is added to omega is found with and without noise, within its interval."""
    bias = np.array([0.03, -0.02, 0.05])
    exact = solved_rates("DOP853", 1e-13)
    found = diagnosis_of_rates(tmp_path, exact + bias + noise * (noisy_rates() - exact))
    assert ("omega-read-shifted",) in listed(found)
    for one, planted in zip(found.faults[0].parameters, bias, strict=True):
        assert one.value == pytest.approx(planted, abs=3.0 * (one.high - one.value) + 1e-9)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("rows", [1, 10])
def test_degrees_are_named_where_they_would_turn_the_body_between_samples(rows: int, tmp_path: Path) -> None:
    """Omega in degrees per second, 2 and 21 rad a sample if taken for rad/s, is no factor of nearly 57."""
    t_s = np.linspace(0.0, 5.0, 501)

    def change(_: float, state: Array) -> Array:
        q, omega = state[:4], state[4:]
        turn = 0.5 * quaternion_product(q, np.array([0.0, *omega]))
        return np.concatenate([turn, np.linalg.solve(INERTIA, -np.cross(omega, INERTIA @ omega))])

    begin = np.array([1.0, 0.0, 0.0, 0.0, 1.0, -2.0, 3.0])
    states = solve_ivp(change, (0.0, 5.0), begin, "DOP853", t_s, rtol=1e-12, atol=1e-14).y.T
    table = np.column_stack([t_s, states[:, :4], np.rad2deg(states[:, 4:])])[::rows]
    head = "t_s,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(tmp_path / "degrees.csv", table, "%.9f", ",", header=head, comments="")
    text = FREE.replace("2.0\nsamples = 201", f"5.0\nsamples = {len(table)}")
    (tmp_path / "free.toml").write_text(text)
    found = runner.explain(tmp_path / "degrees.csv", tmp_path / "free.toml").diagnosis
    assert found is not None
    assert (found.verdict, listed(found)) == ("explained", {("omega-read-scaled",)})
    assert "degrees per second" in found.sentence


@pytest.mark.nightly
@pytest.mark.parametrize("stepped", [True, False])
def test_a_wrong_fall_is_no_strapdown_integration(stepped: bool, tmp_path: Path) -> None:
    """A body that spins about one axis satisfies every rule for attitudes, and yet falls 2 % too slowly."""
    t_s, spin = np.linspace(0.0, 2.0, 201), 1.7
    text = FREE.replace(str(INERTIA.tolist()), "[0.05, 0.07, 0.09]").replace(
        "1.0, -2.0, 3.0", f"0.0, 0.0, {spin}"
    )
    (tmp_path / "fall.toml").write_text(
        f"{text}\n[[forcing]]\nkind = 'gravity'\nacceleration_m_s2 = [0, 0, -9.81]\n"
    )
    none = 0.0 * t_s
    fall = [none, none, -0.49 * 9.81 * t_s**2, none, none, -0.98 * 9.81 * t_s]
    turned = [np.cos(0.5 * spin * t_s), none, none, np.sin(0.5 * spin * t_s), none, none, none + spin]
    np.savetxt(
        tmp_path / "fall.csv", np.column_stack([t_s, *fall, *turned]), "%.9f", ",", header=ROWS, comments=""
    )
    found = runner.explain(
        tmp_path / "fall.csv", tmp_path / "fall.toml", dt_s=0.01 if stepped else None
    ).diagnosis
    assert found is not None
    assert (found.verdict, listed(found)) == ("explained", {("gravity",)})
    assert found.faults[0].parameters[0].value == pytest.approx(0.98, abs=1e-6)


@pytest.mark.nightly
def test_rows_that_are_rounded_alike_do_not_narrow_an_interval(tmp_path: Path) -> None:
    """A body that coasts after a push has one velocity, whose decimals are off by the same in each row."""
    dt_s, mass, spin = 0.01, 2.0, 1.7
    push, steps = np.array([0.31, -0.23, 0.47]), np.arange(201)
    t_s = dt_s * steps
    text = FREE.replace(str(INERTIA.tolist()), "[0.05, 0.07, 0.09]").replace(
        "1.0, -2.0, 3.0", f"0.0, 0.0, {spin}"
    )
    (tmp_path / "pushed.toml").write_text(
        f"{text}\n[[forcing]]\nkind = 'force'\naxes = 'world'\nvalue_n = {push.tolist()}\nuntil_s = 0.3\n"
    )
    off = []
    for factor in np.random.default_rng(3).uniform(1.02, 1.04, 8):
        pushed = np.minimum(steps, 30)
        velocity = factor * dt_s / mass * pushed[:, None] * push
        position = dt_s * np.cumsum(velocity, axis=0)
        turned = np.array([np.cos(0.5 * spin * t_s), 0.0 * t_s, 0.0 * t_s, np.sin(0.5 * spin * t_s)]).T
        omega = np.tile([0.0, 0.0, spin], (len(t_s), 1))
        table = np.column_stack([t_s, position, velocity, turned, omega])
        np.savetxt(tmp_path / "pushed.csv", table, "%.6f", ",", header=ROWS, comments="")
        found = runner.explain(tmp_path / "pushed.csv", tmp_path / "pushed.toml", dt_s=dt_s).diagnosis
        assert found is not None
        assert ("force",) in listed(found)
        (fault,), planted = found.faults, {"force": factor, "mass-scaled": 1.0 / factor}
        one = fault.parameters[0]
        off.append(1.96 * (one.value - planted[fault.name]) / (one.high - one.value))
    assert 0.2 < float(np.sqrt(np.mean(np.square(off)))) < 1.6


@pytest.mark.nightly
def test_many_steps_of_euler_between_two_rows_are_no_slip_of_one_long_step(tmp_path: Path) -> None:
    """20 steps of order 1 leave what one of RK4 with its third stage at 0.425 leaves, which is not named."""
    dt_s, omega, attitude, rows = 1e-3, np.array([0.1, 0.9, 0.2]), np.array([1.0, 0.0, 0.0, 0.0]), []
    for step in range(20 * 100 + 1):
        if step % 20 == 0:
            rows.append([dt_s * step, *np.zeros(6), *attitude, *omega])
        turned = 0.5 * quaternion_product(attitude, np.array([0.0, *omega]))
        omega = omega + dt_s * np.linalg.solve(INERTIA, -np.cross(omega, INERTIA @ omega))
        attitude = attitude + dt_s * turned
        attitude /= np.linalg.norm(attitude)
    np.savetxt(tmp_path / "euler.csv", rows, "%.6f", ",", header=ROWS, comments="")
    (tmp_path / "free.toml").write_text(FREE.replace("1.0, -2.0, 3.0", "0.1, 0.9, 0.2"))
    found = runner.explain(tmp_path / "euler.csv", tmp_path / "free.toml").diagnosis
    assert found is not None
    assert found.faults == ()
    found = runner.explain(tmp_path / "euler.csv", tmp_path / "free.toml", dt_s=dt_s).diagnosis
    assert found is not None
    assert found.verdict == "healthy"


TORQUE = np.array([0.05, -0.04, 0.06])


def buss_motion(factor: float, *, additive: bool) -> tuple[Array, Array]:
    """Return R (121, 3, 3) and omega (121, 3) in world axes under a torque that is constant in body axes.

    R+ = exp(h w) R or (1 + h [w]x) R, L+ = L + h factor R tau, w+ = R+ I^-1 R+^T L+ even if R+ is not
    orthogonal.
    """
    h, rotation, rates = 0.01, [np.eye(3)], [np.array([1.0, -2.0, 3.0])]
    momentum = INERTIA @ rates[0]
    for _ in range(120):
        turn = h * np.cross(np.eye(3), rates[-1])
        momentum = momentum + h * factor * rotation[-1] @ TORQUE
        rotation.append((np.eye(3) + turn if additive else expm(turn)) @ rotation[-1])
        rates.append(rotation[-1] @ np.linalg.inv(INERTIA) @ rotation[-1].T @ momentum)
    return np.array(rotation), np.array(rates)


def diagnosis_of_matrices(folder: Path, factor: float, *, additive: bool, digits: str) -> Diagnosis:
    """Return the diagnosis of such a motion, in a scene whose torque has the factor 1."""
    rotations, rates = buss_motion(factor, additive=additive)
    table = np.column_stack([0.01 * np.arange(121), rotations.reshape(-1, 9), rates])
    head = ",".join(["t_s", *(f"r{i}{j}" for i in range(3) for j in range(3)),
                     *(f"w{axis}_world_rad_s" for axis in "xyz")])  # fmt: skip
    np.savetxt(folder / "motion.csv", table, digits, ",", header=head, comments="")
    torque = f'[[forcing]]\nkind = "torque"\naxes = "body"\nvalue_n_m = {TORQUE.tolist()}\n'
    (folder / "torque.toml").write_text(FREE.replace("2.0\nsamples = 201", "1.2\nsamples = 121") + torque)
    found = runner.explain(folder / "motion.csv", folder / "torque.toml", dt_s=0.01).diagnosis
    assert found is not None
    return found


@pytest.mark.slow
def test_matrices_that_lost_their_orthogonality_are_those_of_a_map(tmp_path: Path) -> None:
    """A map that multiplies by them is far from the exact motion, however small its step: it is tried."""
    found = diagnosis_of_matrices(tmp_path, 1.0, additive=True, digits="%.6f")
    assert found.verdict == "healthy"
    assert "Buss 2000, order 1, additive matrix" in (found.base, *found.equal_maps)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("additive", "name"), [(True, "Buss 2000, order 1, additive matrix"), (False, "Buss 2000, order 1")]
)
def test_a_fault_is_named_in_any_map_of_the_library(additive: bool, name: str, tmp_path: Path) -> None:
    """The maps of reference:euler and reference:lie-euler carry faults as M1 does."""
    found = diagnosis_of_matrices(tmp_path, 1.02, additive=additive, digits="%.17g")
    assert found.base == name
    assert ("torque",) in listed(found)
    assert "torques are multiplied by 1.02" in found.sentence


@pytest.mark.nightly
def test_a_fault_is_named_that_is_smaller_than_the_differences_between_maps(tmp_path: Path) -> None:
    """Faults that fit the map that is nearest at first are not the only ones that are tried with others."""
    loads = """[[forcing]]
kind = "gravity"
acceleration_m_s2 = [0.0, 0.0, -9.81]
[[forcing]]
kind = "force"
axes = "body"
value_n = [0.3, 0.2, 1.0]
at_m = [0.05, -0.02, 0.1]
"""
    (tmp_path / "thrown.toml").write_text(FREE + loads)
    scene = load_scenario(tmp_path / "thrown.toml").scene
    wrong = replace(scene, gravity=1.001 * scene.gravity)
    path = record(Reference(), Case(wrong, "lie-euler", Setting(dt_s=0.01))).trajectory
    assert path is not None
    arrays = {name: value for name, value in vars(path).items() if value is not None}
    np.savez(tmp_path / "motion.npz", **arrays)
    found = runner.explain(tmp_path / "motion.npz", tmp_path / "thrown.toml", dt_s=0.01).diagnosis
    assert found is not None
    assert (found.verdict, found.base) == ("explained", "Buss 2000, order 1")
    assert [fault.name for fault in found.faults] == ["gravity"]
    assert found.faults[0].parameters[0].value == pytest.approx(1.001, abs=1e-6)


def mapped_rates(steps: int, *, midpoint: bool, damping: float = 0.0) -> Array:
    """Return the rates (201, 3) of steps of Euler's or of the midpoint method, so many per sample."""

    def change(omega: Array) -> Array:
        return np.linalg.solve(INERTIA, -np.cross(omega, INERTIA @ omega)) - damping * omega

    h, omega = 0.01 / steps, [np.array([1.0, -2.0, 3.0])]
    for _ in range(200):
        now = omega[-1]
        for _ in range(steps):
            now = now + h * change(now + 0.5 * h * change(now) if midpoint else now)
        omega.append(now)
    return np.array(omega)


@pytest.mark.slow
@pytest.mark.parametrize("steps", [2, *(pytest.param(steps, marks=NIGHTLY) for steps in (4, 10))])
def test_several_steps_per_sample_are_found_without_the_step(steps: int, tmp_path: Path) -> None:
    """n steps of a map leave 1 / n of the error of one; rates alone are enough to see it."""
    found = diagnosis_of_rates(tmp_path, mapped_rates(steps, midpoint=False))
    assert (found.verdict, found.base) == ("healthy", "M1")
    assert found.base_words.endswith(f"with {steps} steps per sample")


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("steps", [1, 3])
def test_the_error_of_a_method_is_no_second_fault(steps: int, tmp_path: Path) -> None:
    """Damping in the midpoint method is named alone, whether its step is found or not."""
    found = diagnosis_of_rates(tmp_path, mapped_rates(steps, midpoint=True, damping=0.05))
    assert ("damping-angular",) in listed(found)
    assert len(found.faults) == 1
    fault = next(fault for fault in found.faults if fault.name == "damping-angular")
    assert fault.parameters[0].value == pytest.approx(0.05, rel=1e-2)
