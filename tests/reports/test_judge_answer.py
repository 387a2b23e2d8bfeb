"""`judge` without a scenario: the conclusion, the measures, the page and the ranking of recordings."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Error, expect
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import bodycheck
from bodycheck._util.errors import InputError
from bodycheck.recordings import judge
from bodycheck.recordings.judge import Ranking, explained_motion
from bodycheck.recordings.judge_document import conclusion, conclusions, judgement_document
from bodycheck.recordings.judge_page import judgement_page
from bodycheck.recordings.judged_motion import Start
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.document import Sentence, markdown
from bodycheck.runs.runner import rank
from bodycheck.scenarios.given_motion import GivenMotion
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck

INERTIA = (40.0, 60.0, 85.0)
OMEGA = (0.3, 1.2, 0.2)
BODY = GivenMotion(INERTIA)
DEGREES = (
    "t_s=time, wx_body_rad_s=gx*deg, wy_body_rad_s=gy*deg, wz_body_rad_s=gz*deg, "
    "euler_1_rad=yaw*deg, euler_2_rad=pitch*deg, euler_3_rad=roll*deg, euler=ZYX"
)


def solved(t_s: Array, tolerance: float = 1e-12, torque: Array | None = None) -> tuple[Array, Array]:
    """Return attitude (n, 4), scalar first, and omega in body axes (n, 3) by SciPy."""
    inertia, load = np.array(INERTIA), np.zeros(3) if torque is None else torque

    def rates(_: float, state: Array) -> Array:
        q, w = state[:4], state[4:]
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return np.concatenate([dq, (load + np.cross(inertia * w, w)) / inertia])

    start = np.array([1.0, 0, 0, 0, *OMEGA])
    found = solve_ivp(rates, (0.0, t_s[-1]), start, "DOP853", t_s, rtol=tolerance, atol=tolerance).y.T
    return found[:, :4] / np.linalg.norm(found[:, :4], axis=1, keepdims=True), found[:, 4:]


def stepped(t_s: Array, strides: int, damping: float = 0.0) -> tuple[Array, Array]:
    """Return the same by semi-implicit Euler, with omega damped at a rate in 1/s."""
    h, inertia = t_s[1] / strides, np.array(INERTIA)
    w, q = np.array(OMEGA), Rotation.identity()
    attitudes, rates = [q.as_quat(scalar_first=True)], [w]
    for k in range(1, strides * (len(t_s) - 1) + 1):
        w = (w + h * np.cross(inertia * w, w) / inertia) * (1.0 - damping * h)
        q = q * Rotation.from_rotvec(h * w)
        if k % strides == 0:
            attitudes.append(q.as_quat(scalar_first=True))
            rates.append(w)
    return np.array(attitudes), np.array(rates)


def write(path: Path, t_s: Array, motion: tuple[Array, Array], digits: str = "%.17g") -> Path:
    """Write a motion as a CSV that needs no map."""
    head = "t_s,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(path, np.column_stack([t_s, *motion]), digits, ",", header=head, comments="")
    return path


def write_degrees(path: Path, t_s: Array, motion: tuple[Array, Array], digits: str = "%.9f") -> Path:
    """Write gyro rates and Euler angles in degrees, from a clock that does not start at 0."""
    q, w = motion
    angles = Rotation.from_quat(q, scalar_first=True).as_euler("ZYX", degrees=True)
    rows = np.column_stack([t_s + 1000.0, np.rad2deg(w), angles])
    np.savetxt(path, rows, digits, ",", header="time,gx,gy,gz,yaw,pitch,roll", comments="")
    return path


T_S = np.arange(201) * 0.05


def judged(path: Path, **others: Any) -> Ranking:
    """Return the judgement of one file about the body."""
    return rank([path], body=BODY, **others)


def told(ranking: Ranking, dt_s: float | None = None) -> str:
    """Return the conclusion about a single file, with its diagnosis."""
    (motion,) = ranking.motions
    return conclusion(motion, explained_motion(motion, dt_s))


@pytest.mark.parametrize("digits", ["%.17g", "%.9g", "%.6f", "%.4f"])
def test_a_right_motion_is_the_true_one_to_its_digits(digits: str, tmp_path: Path) -> None:
    """Whatever the digits of the file, the exact motion from its first row is not accused."""
    path = write(tmp_path / "sim.csv", T_S, solved(T_S), digits)
    ranking = judged(path)
    (motion,) = ranking.motions
    text = conclusion(motion, None)
    assert motion.is_true == (digits != "%.17g")  # the solver is off by 1e-11
    assert conclusions(motion, None)[0].tint == ("good" if motion.is_true else "open")
    assert "is conserved" in text
    assert "not conserved" not in text
    row = ranking.rows[0]
    assert row["orientation_error_rad"] <= 3.0 * row["truth_bound_rad"] + 1e-10


def test_attitudes_that_resolve_nothing_are_not_called_true(tmp_path: Path) -> None:
    """Attitudes of three decimals alone, sampled fast, do not tell a sphere from the body: both stay open."""
    q, w = solved(T_S)
    for motion in ((q, w), stepped(T_S, 5, 0.05)):
        path = write(tmp_path / "sim.csv", T_S, motion, "%.3f")
        lines = [line.split(",")[:5] for line in path.read_text().splitlines()]
        path.write_text("\n".join(map(",".join, lines)) + "\n")
        (ranked,) = judged(path).motions
        assert ranked.without_omega
        assert not ranked.is_true
        assert conclusions(ranked, None)[0].tint == "open"
        assert "true one for" not in conclusion(ranked, None)


@pytest.mark.parametrize(
    ("decimals", "said"), [(3, "is the true one for 10 s"), (2, "does not show whether")]
)
def test_a_constant_omega_of_few_decimals_is_not_accused(decimals: int, said: str, tmp_path: Path) -> None:
    """Beside attitudes of six decimals, 0.031 and 0.03 rad/s are what is written of 0.0312 rad/s."""
    path, rate = tmp_path / "spin.csv", 0.0312
    rows = ["t_s,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"]
    for t in T_S:
        q = f"{np.cos(rate * t / 2):.6f},0.000000,0.000000,{np.sin(rate * t / 2):.6f}"
        rows.append(f"{t:.6f},{q}," + ",".join(f"{one:.{decimals}f}" for one in (0.0, 0.0, rate)))
    path.write_text("\n".join(rows) + "\n")
    assert said in told(judged(path))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (1.02, True)])
def test_a_quaternion_that_is_not_normalised_is_said_to_be(factor: float, said: bool, tmp_path: Path) -> None:
    """The attitude of q/|q| is right, so that no error of the motion shows the factor."""
    q, w = solved(T_S)
    text = told(judged(write(tmp_path / "sim.csv", T_S, (factor * q, w))))
    assert ("not normalised: |q| differs from 1 by up to 2 %" in text) == said


@pytest.mark.nightly
@pytest.mark.parametrize("digits", ["%.17g", "%.6f"])
def test_a_wrong_omega_beside_a_right_attitude_is_stated_first(digits: str, tmp_path: Path) -> None:
    """The attitude alone would be called right, to 1e-12 rad or to the digits of the file."""
    q, w = solved(T_S)
    off = w + 0.01 * np.outer(np.sin(T_S), [1.0, 2.0, 3.0])
    path = write(tmp_path / "sim.csv", T_S, (q, off), digits)
    for dt_s in (0.05, None):
        text = told(judged(path), dt_s)
        cause = r"[^.]*o known fault[^.]*\."
        assert re.match(rf"Omega is up to \S+ % of \|omega\| from the truth\. {cause} The attitude is ", text)
        assert "of a solver" not in text


@pytest.mark.nightly
def test_a_smooth_error_of_omega_is_not_that_of_a_solver(tmp_path: Path) -> None:
    """At close rows it is small in each of them, but the attitude would show an error of a solver."""
    t_s = np.arange(1001) * 0.01
    q, w = solved(t_s)
    w *= 1.0 + 0.01 * np.sin(t_s)[:, None]
    text = told(judged(write(tmp_path / "sim.csv", t_s, (q, w), "%.6f")))
    assert "Omega is not the rate of this attitude" in text
    assert "of a solver" not in text


@pytest.mark.slow(after=1)
@pytest.mark.nightly(after=4)
@pytest.mark.parametrize("start", ["scenario", "first-sample"])
@pytest.mark.parametrize("digits", ["%.17g", "%.6f"])
@pytest.mark.parametrize(("of_omega", "rows"), [(True, 1), (False, 1), (True, -1), (False, -1)])
def test_attitude_and_omega_of_different_rows_are_said_to_be(
    of_omega: bool, rows: int, digits: str, start: Start, tmp_path: Path
) -> None:
    """One is logged before a step and the other after it; a torque makes the time matter."""
    scenario = tmp_path / "turned.toml"
    scenario.write_text(
        'name = "turned"\nduration_s = 10.0\nsamples = 201\n[body]\nmass_kg = 1.0\n'
        f"inertia_kg_m2 = {list(INERTIA)}\n[initial]\nomega_body_rad_s = {list(OMEGA)}\n"
        '[[forcing]]\nkind = "torque"\naxes = "body"\nvalue_n_m = [2.0, 0.0, 1.0]\n'
    )
    right = solved(T_S, torque=np.array([2.0, 0.0, 1.0]))
    places = np.clip(np.arange(len(T_S)) - rows, 0, len(T_S) - 1)
    moved = [values[places] if k == of_omega else values for k, values in enumerate(right)]
    path = write(tmp_path / "sim.csv", T_S, (moved[0], moved[1]), digits)
    # of the last row or two, one quantity is there twice
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-2]))
    (motion,) = rank([path], scenario, start=start).motions
    explained = explained_motion(motion, None)
    said = (
        "Omega is one row behind the attitude" if of_omega == (rows > 0) else "The attitude is one row behind"
    )
    assert said in conclusion(motion, explained)
    assert not motion.is_true
    assert explained.diagnosis is None


@pytest.mark.slow
@pytest.mark.parametrize("digits", ["%.17g", "%.6f"])
def test_a_late_omega_and_a_wrong_row_of_it_are_both_stated(digits: str, tmp_path: Path) -> None:
    """The one does not hide the other, and nothing is left to search."""
    q, w = solved(T_S)
    late = np.concatenate([w[:1], w[:-1]])
    late[60] += 0.3
    path = write(tmp_path / "sim.csv", T_S, (q, late), digits)
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))  # which has an omega twice
    (motion,) = judged(path).motions
    explained = explained_motion(motion, None)
    text = conclusion(motion, explained)
    assert "Omega is one row behind the attitude. Moved by one row: Only 1 of 19" in text
    assert "rows is off in omega, by 0.52 rad/s, 3 s after the first row" in text
    assert explained.diagnosis is None


@pytest.mark.slow
@pytest.mark.parametrize("torque", [None, (2.0, 0.0, 1.0)])
def test_a_first_omega_of_zero_and_a_late_omega_are_told_apart(
    torque: tuple[float, float, float] | None, tmp_path: Path
) -> None:
    """At close rows either leaves little of the error of the other; both begin with an omega of zero."""
    t_s = np.arange(501) * 1e-3
    q, w = solved(t_s, torque=None if torque is None else np.array(torque))
    first, late = w.copy(), np.concatenate([w[:1], w[:-1]])
    first[0] = late[0] = 0.0
    body = GivenMotion(INERTIA, torque_body_n_m=torque or (0.0, 0.0, 0.0))
    texts = []
    for omega in (first, late):
        path = write(tmp_path / "sim.csv", t_s, (q, omega), "%.9f")
        path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
        texts.append(told(rank([path], body=body)))
    assert ["Only the first row" in text for text in texts] == [True, False]
    assert ["Omega is one row behind the attitude" in text for text in texts] == [False, True]


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.005, 1.04])
def test_a_wrong_row_does_not_change_the_cause_of_the_other_errors(factor: float, tmp_path: Path) -> None:
    """It is part of no motion, whether it is ten times as far off as the others or stands out of them."""
    q, w = solved(T_S)
    q[120] = [0.0, 1.0, 0.0, 0.0]
    path = write(tmp_path / "sim.csv", T_S, (q, w))
    text = told(rank([path], body=GivenMotion((40.0, 60.0, 85.0 / factor))))
    assert text.startswith("Only 1 of 201 rows is off, by ")
    assert f"largest principal moment of inertia is multiplied by {factor} (explains all" in text


@pytest.mark.slow
def test_a_wrong_row_of_omega_is_no_noise_of_the_others(tmp_path: Path) -> None:
    """Without attitudes, one row was taken for the noise in which a wrong moment of inertia is lost."""
    _, w = solved(T_S)
    w[120] += 0.5
    path = tmp_path / "sim.csv"
    head = "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(path, np.column_stack([T_S, w]), "%.17g", ",", header=head, comments="")
    text = told(rank([path], body=GivenMotion((40.0, 60.0, 85.0 / 1.005))))
    assert text.startswith("Only 1 of 201 rows is off in omega, by ")
    assert "No fault" not in text
    assert "multiplied by 1.005 (explains all of the error)" in text


def test_wrong_rows_of_different_sizes_are_counted(tmp_path: Path) -> None:
    """The largest does not hide a smaller one among those that are right."""
    q, w = solved(T_S)
    w[50] += 1.0
    w[90] += 0.01
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, w))))
    assert text.startswith("Only 2 of 201 rows are off in omega, by up to 1.7 rad/s, the first 2.5 s after")


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("noise", [0.0, 1e-4, 2e-3])
def test_a_scaled_axis_of_a_gyro_is_named(axis: int, noise: float, tmp_path: Path) -> None:
    """One component of omega that is 2 % too large is neither all of omega nor the body's."""
    q, w = solved(T_S)
    scale = np.where(np.arange(3) == axis, 1.02, 1.0)
    w = w * scale + noise * np.random.default_rng(axis).standard_normal(w.shape)
    turned = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(
        noise * np.random.default_rng(9).standard_normal(w.shape)
    )
    motion = (turned.as_quat(scalar_first=True), w)
    text = told(judged(write(tmp_path / "sim.csv", T_S, motion, "%.9f")))
    found = re.search(rf"Likely cause: omega about {'xyz'[axis]} is multiplied by (1\.0\d+) when it is", text)
    assert found, text
    assert float(found[1]) == pytest.approx(1.02, abs=max(3e-4, 3.0 * noise))


@pytest.mark.slow
@pytest.mark.parametrize("axis", range(3))
def test_a_component_of_the_wrong_sign_is_not_all_of_the_velocity(axis: int, tmp_path: Path) -> None:
    """As of a program whose axis points the other way."""
    at, velocity = fallen(GRAVITY)
    velocity[:, axis] *= -1.0
    text = told(thrown(tmp_path / "sim.csv", at, velocity))
    assert f"the velocity along {'xyz'[axis]} is read with the opposite sign" in text
    assert "the velocity is read" not in text


@pytest.mark.slow
def test_each_of_two_faults_is_the_right_one(tmp_path: Path) -> None:
    """A quadratic damping, which alone leaves less than a linear one, is exchanged for it."""

    def rates(_: float, y: Array) -> Array:
        q, w = y[:4], y[4:]
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return np.concatenate([dq, 0.97 * np.cross(INERTIA * w, w) / INERTIA - 0.005 * w])

    t_s, start = np.arange(401) * 0.05, np.array([1.0, 0, 0, 0, *OMEGA])
    found = solve_ivp(rates, (0.0, t_s[-1]), start, "DOP853", t_s, rtol=1e-12, atol=1e-12).y.T
    text = told(judged(write(tmp_path / "sim.csv", t_s, (found[:, :4], found[:, 4:]), "%.12g")))
    assert "omega is damped at the rate 0.005 1/s" in text
    assert "the gyroscopic term omega x I omega is multiplied by 0.97 (explains all of the error)" in text


MISREAD: dict[str, Callable[[Array, Array], Array]] = {
    "omega is read in degrees per second, not rad/s": lambda _, w: np.degrees(w),
    "omega is read in revolutions per minute, not rad/s": lambda _, w: w * 30.0 / np.pi,
    "omega is read in the other axes": lambda q, w: Rotation.from_quat(q, scalar_first=True).apply(w),
    "omega is read with the opposite sign": lambda _, w: -w,
    "the axes of omega are permuted when it is read: x, y, z as y, x, z": lambda _, w: w[:, [1, 0, 2]],
    "the axes of omega are turned when it is read: x, y, z as x, -y, -z": lambda _, w: w * [1, -1, -1],
    "the axes of omega are turned when it is read: x, y, z as x, -z, y": lambda _, w: (
        w[:, [0, 2, 1]] * [1, -1, 1]
    ),
    "omega is read in the other axes, world for body or body for world; and omega is read in degrees": (
        lambda q, w: np.degrees(Rotation.from_quat(q, scalar_first=True).apply(w))
    ),
}


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("cause", MISREAD)
def test_a_misread_omega_does_not_accuse_the_attitude(cause: str, noise: float, tmp_path: Path) -> None:
    """The truth starts at the omega that was meant, and the first line is about omega, not the attitude."""
    q, w = solved(T_S)
    w = w + noise * np.random.default_rng(1).standard_normal(w.shape)
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, MISREAD[cause](q, w)), "%.12g")))
    first, likely = text.split(". ")[:2]
    assert first.startswith("Omega is up to ")
    assert likely.startswith(f"Likely cause: {cause}")
    if noise == 0.0:
        assert "The attitude is the true one for 10 s" in text
    assert "of its rotational energy" not in text
    assert "not conserved" not in text


def test_a_first_row_without_omega_is_no_instability_in_noise(tmp_path: Path) -> None:
    """Next to the energy of its noise, that of the later rows is large."""
    q, w = solved(T_S)
    noise = 1e-3 * np.random.default_rng(4).standard_normal(w.shape)
    read = np.where(np.arange(len(w))[:, None] == 0, 0.0, w) + noise
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, read), "%.12g")))
    assert text.startswith("Only the first row, or the step from it, is wrong.")
    assert "unstable" not in text


def test_an_axis_of_omega_that_nothing_fills_is_no_start(tmp_path: Path) -> None:
    """Omega then follows from the attitudes; of a turn about z alone the others are 0, whatever the noise."""
    q, w = solved(T_S)
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, w * [0.0, 0.0, 1.0]), "%.12g")))
    assert text.startswith("The attitude is the true one for 10 s")
    assert "only zeros as omega about x and y" in text
    rng, spin = np.random.default_rng(0), 12.0 * T_S
    flat = np.stack([np.cos(spin / 2.0), 0.0 * spin, 0.0 * spin, np.sin(spin / 2.0)], axis=-1)
    noisy = flat + 1e-2 * rng.standard_normal(flat.shape)
    noisy /= np.linalg.norm(noisy, axis=1, keepdims=True)
    rows = noisy, np.tile([0.0, 0.0, 12.0], (len(T_S), 1))
    assert "only zeros" not in told(judged(write(tmp_path / "flat.csv", T_S, rows, "%.6f")))


@pytest.mark.slow(after=1)
@pytest.mark.parametrize(
    "cause",
    [
        "omega is read in degrees per second, not rad/s",
        "the axes of omega are turned when it is read: x, y, z as x, -y, -z",
    ],
)
def test_a_misread_omega_is_known_where_rows_are_as_near_as_their_noise(cause: str, tmp_path: Path) -> None:
    """Its integral over several rows is compared: between two rows the attitudes turn by 20 mrad."""
    t_s, rng = np.arange(501) * 0.02, np.random.default_rng(3)
    q, w = solved(t_s)
    noisy = q + 1e-3 * rng.standard_normal(q.shape)
    read = MISREAD[cause](q, w + 1e-3 * rng.standard_normal(w.shape))
    rows = noisy / np.linalg.norm(noisy, axis=1, keepdims=True), read
    text = told(judged(write(tmp_path / "sim.csv", t_s, rows, "%.6f")))
    assert text.startswith("Omega is up to ")
    assert f"Likely cause: {cause}" in text
    assert "which the noise of the first row can make" in text


def test_a_column_of_omega_that_nothing_fills_is_no_start(tmp_path: Path) -> None:
    """Zeros beside attitudes that turn are not the rates of a body; those of one at rest are."""
    q, w = solved(T_S)
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, 0.0 * w), "%.12g")))
    assert text.startswith("The attitude is the true one for 10 s")
    assert "only zeros as omega" in text
    still = np.tile([1.0, 0.0, 0.0, 0.0], (len(q), 1))
    text = told(judged(write(tmp_path / "rest.csv", T_S, (still, 0.0 * w), "%.12g")))
    assert text.startswith("The attitude is the true one for 10 s")
    assert "as omega" not in text


def test_a_column_of_velocities_that_nothing_fills_is_no_start(tmp_path: Path) -> None:
    """A position that moves is then not compared; one at rest, with noise, is."""
    at, velocity = fallen(GRAVITY)
    text = told(thrown(tmp_path / "sim.csv", at, 0.0 * velocity))
    assert text.startswith("The attitude is the true one for 10 s")
    assert "only zeros as velocity" in text
    noisy = 1.0 + 1e-3 * np.random.default_rng(2).standard_normal(at.shape)
    assert "as velocity" not in told(thrown(tmp_path / "rest.csv", noisy, 0.0 * velocity))


@pytest.mark.slow
def test_a_fault_beside_an_omega_in_degrees_is_named(tmp_path: Path) -> None:
    """It is looked for in the motion with the omega that was meant."""
    q, w = solved(T_S)
    path = write(tmp_path / "sim.csv", T_S, (q, np.degrees(w)), "%.12g")
    (motion,) = rank([path], body=GivenMotion((40.0, 60.0, 85.0 * 1.05))).motions
    text = conclusion(motion, explained_motion(motion, None))
    assert (
        "omega is read in degrees per second, not rad/s; and the largest principal moment of inertia" in text
    )
    assert "multiplied by 0.95238 (explains all of the error)" in text


@pytest.mark.slow
def test_each_alternative_to_two_faults_is_whole(tmp_path: Path) -> None:
    """A slow clock and a gyro that is as much too fast cannot be told apart, in degrees either."""
    q, w = solved(T_S)
    text = told(judged(write(tmp_path / "sim.csv", 0.98 * T_S, (q, np.degrees(w)), "%.12g")))
    causes = text.partition("Likely cause: ")[2].partition(" (explains all of the error)")[0].split("; or ")
    assert len(causes) == 2
    assert all(one.startswith("omega is read in degrees per second, not rad/s; and ") for one in causes)


def test_a_ranking_states_an_omega_that_is_wrong_beside_a_right_attitude(tmp_path: Path) -> None:
    """Files are ranked by their attitudes."""
    q, w = solved(T_S)
    files = [
        write(tmp_path / "right.csv", T_S, (q, w)),
        write(tmp_path / "degrees.csv", T_S, (q, np.degrees(w))),
    ]
    text = markdown(judgement_document(rank(files, body=BODY)))
    assert "degrees.csv: Omega is up to 5.63e3 % of " in text
    assert "right.csv: Omega" not in text


def test_a_first_row_beyond_all_bodies_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """No truth starts there; in a later row it is an instability."""
    q, w = solved(T_S)
    w[0] = 1e200
    with expected_message.raises(InputError):
        judged(write(tmp_path / "sim.csv", T_S, (q, w)))


@pytest.mark.parametrize("cause", MISREAD)
def test_a_misread_omega_excuses_no_wrong_motion(cause: str, tmp_path: Path) -> None:
    """The attitude of another method is off, however omega is read."""
    q, w = stepped(T_S, 5)
    (motion,) = judged(write(tmp_path / "sim.csv", T_S, (q, MISREAD[cause](q, w)))).motions
    assert "The attitude is the true one" not in conclusion(motion, None)
    assert motion.row["orientation_error_rad"] > 1e-3
    assert not motion.is_omega_misread


@pytest.mark.slow
def test_an_explained_difference_is_not_that_of_the_first_row(tmp_path: Path) -> None:
    """A wrong sign of one component turns the motion, not the errors of the solver beside it."""
    t_s = np.arange(301) * 0.05
    q, w = solved(t_s, 1e-13)  # with errors like noise of 1e-13
    text = told(judged(write(tmp_path / "sim.csv", t_s, (q, w * [1.0, 1.0, -1.0]))))
    assert text.startswith("Omega is up to ")
    assert "omega about z is read with the opposite sign (explains all of the error)" in text
    assert "The truth starts at the first row" not in text


@pytest.mark.nightly
def test_a_wrong_motion_is_not_called_right_but_for_a_row(tmp_path: Path) -> None:
    """Damped, with an omega that is one row late as well: both are wrong."""
    q, w = stepped(T_S, 5, 0.05)
    late = np.concatenate([w[:1], w[:-1]])
    assert "one row behind" not in told(judged(write(tmp_path / "sim.csv", T_S, (q, late))))


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(("first", "rows", "said"), [(50, 1, True), (200, 1, True), (50, 3, False)])
def test_one_wrong_row_is_not_taken_for_the_motion(first: int, rows: int, said: bool, tmp_path: Path) -> None:
    """One of 201 rows is said to be off, also the last; more than a hundredth of them are no outliers."""
    q, w = solved(T_S)
    q[first : first + rows] = q[30]
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, w))))
    assert ("Only 1 of 201 rows is off, by " in text) == said
    assert "noise" not in text


@pytest.mark.nightly
@pytest.mark.parametrize(("rows", "said"), [(2, False), (4, False), (5, True)])
def test_one_of_few_rows_that_is_off_is_no_exception(rows: int, said: bool, tmp_path: Path) -> None:
    """A body that stands still where the truth has turned by the last row, once there are few rows."""
    q, w = solved(T_S[:rows])
    q[-1] = solved(T_S)[0][60]
    text = told(judged(write(tmp_path / "sim.csv", T_S[:rows], (q, w))))
    assert ("rows is off, by " in text) == said


@pytest.mark.parametrize(("off", "digits"), [(0.05, "%.9f"), (2.5, "%.9f"), (0.05, "%.17g")])
def test_one_wrong_omega_beside_right_attitudes_is_no_fault_of_integration(
    off: float, digits: str, tmp_path: Path
) -> None:
    """It is as large as noise could be, but the attitude follows from no omega by a rule of integration.

    To all digits, the file also shows the errors of the solver.
    """
    q, w = solved(T_S)
    w[77, 1] += off
    ranking = judged(write(tmp_path / "sim.csv", 3.0 + T_S, (q, w), digits))
    (motion,) = ranking.motions
    explained = explained_motion(motion, None)
    text = conclusion(motion, explained)
    assert text.startswith("Only 1 of 201 rows is off in omega, by ")
    assert "3.85 s after the first row" in text
    assert "No known fault" not in text
    assert explained.diagnosis is None  # where the search, which takes minutes, could only end at this row


@pytest.mark.slow
def test_attitudes_integrated_from_a_noisy_omega_are_named(tmp_path: Path) -> None:
    """They follow from it to the digits of the file."""
    _, omega = solved(T_S)
    omega += 0.01 * np.random.default_rng(1).standard_normal(omega.shape)
    attitudes = [Rotation.identity()]
    for angle in 0.5 * 0.05 * (omega[:-1] + omega[1:]):
        attitudes.append(attitudes[-1] * Rotation.from_rotvec(angle))
    quaternions = Rotation.concatenate(attitudes).as_quat(scalar_first=True)
    ranking = judged(write(tmp_path / "sim.csv", T_S, (quaternions, omega)))
    found = explained_motion(ranking.motions[0], None).diagnosis
    assert found is not None
    assert found.base == "mean-rate exponential"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("what", "digits"), [("attitude", "%.9f"), ("omega", "%.9f"), ("attitude", "%.17g"), ("omega", "%.17g")]
)
def test_a_wrong_first_row_is_not_taken_for_the_motion(what: str, digits: str, tmp_path: Path) -> None:
    """From its second row on, the motion is the true one, or that of a solver; a wrong motion is not."""
    q, w = solved(T_S)
    if what == "omega":
        w[0] = 0.0
    else:
        q[0] = q[1]
    ranking = judged(write(tmp_path / "sim.csv", T_S, (q, w), digits))
    assert "Only the first row, or the step from it, is wrong" in told(ranking)
    assert not ranking.motions[0].is_true
    damped, slowed = stepped(T_S, 5, 0.05)
    slowed[0] = 0.0
    assert "Only the first row" not in told(judged(write(tmp_path / "damped.csv", T_S, (damped, slowed))))


def test_an_error_that_grows_up_to_the_last_row_is_one_of_the_motion(tmp_path: Path) -> None:
    """Only the last rows of a damped motion are far off, but those before come near to them."""
    t_s = np.arange(201) * 0.002
    text = told(judged(write(tmp_path / "sim.csv", t_s, stepped(t_s, 5, 1.0))))
    assert "rows" not in text


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(("damping", "word"), [(0.05, "loses"), (-0.05, "gains")])
def test_a_damped_motion_is_named_with_what_it_loses(damping: float, word: str, tmp_path: Path) -> None:
    """The lines have the distance, the cause and the conservation; a gain is not a loss."""
    path = write(tmp_path / "sim.csv", T_S, stepped(T_S, 5, damping))
    ranking = judged(path)
    text = told(ranking, 0.01)
    row = ranking.rows[0]
    assert np.sign(row["rotational_energy_drift_signed"]) == -np.sign(damping)
    lost = 1.0 - np.exp(-0.5 * 2.0)  # |omega| falls as exp(-0.05 t), its square as exp(-0.1 t)
    if damping > 0.0:
        assert -row["rotational_energy_drift_signed"] == pytest.approx(lost, rel=2e-3)
        assert re.search(r"Likely cause: omega is .*\b0\.05\b", text)
    assert "Angular momentum is not conserved: " in text
    assert f"The body {word} " in text
    assert re.match(r"The attitude is \S+ rad \(\S+ degrees\) from the truth after 10 s", text)


def test_degrees_and_another_clock_give_the_same_figures(tmp_path: Path) -> None:
    """Gyro rates and Euler angles in degrees are judged like the same motion in SI units."""
    motion = stepped(T_S, 5, 0.02)
    own = judged(write(tmp_path / "own.csv", T_S, motion)).rows[0]
    degrees = write_degrees(tmp_path / "log.csv", T_S, motion)
    row = judged(degrees, column_map=DEGREES).rows[0]
    for name in ("orientation_error_rad", "rotational_energy_drift_signed", "angular_momentum_drift"):
        assert row[name] == pytest.approx(own[name], rel=1e-6)
    by_python = bodycheck.judge(degrees, column_map=DEGREES, inertia_kg_m2=INERTIA)
    assert by_python["orientation_error_rad"] == row["orientation_error_rad"]


def test_a_torque_is_a_load_of_the_truth(tmp_path: Path) -> None:
    """A motion under a constant torque is right with it, and wrong without it."""
    torque = np.array([0.5, -0.2, 1.0])
    path = write(tmp_path / "sim.csv", T_S, solved(T_S, torque=torque))
    loaded = rank([path], body=GivenMotion(INERTIA, 1.0, torque)).rows[0]
    assert loaded["orientation_error_rad"] < 1e-9
    assert judged(path).rows[0]["orientation_error_rad"] > 1e-2


def test_a_tensor_and_gravity_are_read(tmp_path: Path) -> None:
    """Nine numbers are a tensor; a thrown body follows its parabola from its first row."""
    q, w = solved(T_S)
    path = tmp_path / "sim.csv"
    gravity, velocity = np.array([0.0, 0.0, -9.81]), np.array([3.0, 0.0, 8.0])
    at = velocity * T_S[:, None] + 0.5 * gravity * T_S[:, None] ** 2
    columns = [T_S, *at.T, *q.T, *(velocity + gravity * T_S[:, None]).T, *w.T]
    head = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,vx_m_s,vy_m_s,vz_m_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=head, comments="")
    found = rank([path], body=GivenMotion(np.diag(INERTIA).ravel().tolist(), 2.0, None, gravity)).rows[0]
    assert found["position_error"] < 1e-13
    assert found["orientation_error_rad"] < 1e-9
    assert judged(path).rows[0]["position_error"] > 0.1


def thrown(path: Path, at: Array, velocity: Array, digits: str = "%.9f") -> Ranking:
    """Return the judgement of a right rotation on a path (n, 3) with velocities (n, 3), under gravity."""
    q, w = solved(T_S)
    head = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,vx_m_s,vy_m_s,vz_m_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(path, np.column_stack([T_S, at, q, velocity, w]), digits, ",", header=head, comments="")
    return rank([path], body=GivenMotion(np.diag(INERTIA).ravel().tolist(), 12.0, None, GRAVITY))


GRAVITY = np.array([0.0, 0.0, -9.81])
THROWN = np.array([3.0, -1.0, 12.0])


def fallen(gravity: Array) -> tuple[Array, Array]:
    """Return the parabola of a throw, and its velocities."""
    t = T_S[:, None]
    return 1.0 + THROWN * t + 0.5 * gravity * t**2, THROWN + gravity * t


@pytest.mark.slow(after=1)
@pytest.mark.parametrize(
    ("factor", "unit", "size", "cause"),
    [
        (1.62 / 9.81, 1.0, "The position is 410 m from the truth.", "gravity is multiplied by 0.1651"),
        (-1.0, 1.0, "The position is 981 m from the truth.", "gravity is reversed"),
        (1.0, 1000.0, "The position is ", "the position is read in mm"),
    ],
)
def test_a_wrong_path_of_a_right_rotation_is_stated_first_with_its_cause(
    factor: float, unit: float, size: str, cause: str, tmp_path: Path
) -> None:
    """A right attitude does not hide that the body is elsewhere."""
    at, velocity = fallen(factor * GRAVITY)
    ranking = thrown(tmp_path / "sim.csv", unit * at, velocity)
    (motion,) = ranking.motions
    case = explained_motion(motion, None)
    first, second, *others = conclusions(motion, case)
    assert first.text.startswith(size)
    assert first.tint == "bad"
    assert cause in second.text
    assert others[0].text.startswith("The attitude is the true one")


@pytest.mark.parametrize("digits", ["%.17g", "%.9f", "%.3f", "%.2f"])
def test_a_right_path_is_not_accused_whatever_its_digits(digits: str, tmp_path: Path) -> None:
    """A rounded start leaves the later positions open; only an error beyond that is stated."""
    (motion,) = thrown(tmp_path / "sim.csv", *fallen(GRAVITY), digits).motions
    assert not motion.path_errors
    assert "position" not in conclusion(motion, None)


def test_a_wrong_row_of_a_right_path_is_stated(tmp_path: Path) -> None:
    """One position that is off is the row's, not that of the motion."""
    at, velocity = fallen(GRAVITY)
    at[90] += 5.0
    ranking = thrown(tmp_path / "sim.csv", at, velocity)
    assert told(ranking).startswith("Only 1 of 201 rows is off in position, by 8.7 m, 4.5 s after the first")


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_noise_of_rows_at_irregular_times_is_no_fault(seed: int, tmp_path: Path) -> None:
    """The rows are compared at their own times, not at those of evenly spaced ones."""
    rng = np.random.default_rng(seed)
    t_s = np.sort(np.r_[0.0, rng.uniform(0.0, 10.0, 180), 10.0])
    q, w = solved(t_s)
    noisy = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(rng.normal(0.0, 2e-3, (182, 3)))
    motion = (noisy.as_quat(scalar_first=True), w + rng.normal(0.0, 3e-3, (182, 3)))
    text = told(judged(write(tmp_path / "sim.csv", t_s, motion)))
    found = re.search(r"No fault: .* to the noise of the file, (\S+) rad in attitude and (\S+) rad/s", text)
    assert found, text
    assert [float(one) for one in found.groups()] == pytest.approx([2e-3, 3e-3], rel=0.2)


def noisy(seed: int, draw: Callable[[np.random.Generator], Array]) -> tuple[Array, Array]:
    """Return a right motion with noise of 2e-3 rad and rad/s; draw: (201, 6) numbers of deviation 1."""
    q, w = solved(T_S)
    noise = 2e-3 * draw(np.random.default_rng(seed))
    turned = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(noise[:, :3])
    return turned.as_quat(scalar_first=True), w + noise[:, 3:]


def normal(rng: np.random.Generator) -> Array:
    """Return white noise (201, 6)."""
    return rng.standard_normal((201, 6))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("quantity", "of"), [("attitude", ""), ("omega", " in omega")])
def test_a_wrong_row_is_told_from_noise(seed: int, quantity: str, of: str, tmp_path: Path) -> None:
    """It is 20 times as far off, but nearer to the truth than what the noise of the first row leads to."""
    q, w = noisy(seed, normal)
    if quantity == "omega":
        w[120, 1] += 0.04
    else:
        turned = Rotation.from_quat(q[120], scalar_first=True) * Rotation.from_rotvec([0.0, 0.04, 0.0])
        q[120] = turned.as_quat(scalar_first=True)
    (motion,) = judged(write(tmp_path / "sim.csv", T_S, (q, w))).motions
    text = conclusion(motion, None)
    assert re.match(
        rf"Only 1 of 201 rows is off{of}, by 0\.0[34]\d+ rad(/s)?, 6 s after the first row; ", text
    )
    assert float(text.split("the noise of the others is ")[1].split()[0]) == pytest.approx(2e-3, rel=0.2)


@pytest.mark.slow
def test_a_wrong_row_in_noise_hides_no_cause(tmp_path: Path) -> None:
    """The motion beside it is that of another moment of inertia."""
    q, w = noisy(1, normal)
    w[60, 1] += 0.05
    ranking = rank([write(tmp_path / "sim.csv", T_S, (q, w))], body=GivenMotion((40.0, 66.0, 85.0)))
    text = told(ranking)
    assert text.startswith("Only 1 of 201 rows is off in omega, by 0.048 rad/s, 3 s after the first row; ")
    assert "the middle principal moment of inertia is multiplied by 0.909" in text or "by 0.908" in text
    assert "whose noise makes part of these differences" in text


def thrown_in_noise(seed: int, at: Array, velocity: Array, path: Path) -> Ranking:
    """Return the judgement of a right rotation and a path (n, 3), both in noise."""
    rng = np.random.default_rng(seed)
    q, w = noisy(seed, normal)
    at, velocity = (one + 0.01 * rng.standard_normal((201, 3)) for one in (at, velocity))
    head = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,vx_m_s,vy_m_s,vz_m_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(path, np.column_stack([T_S, at, q, velocity, w]), "%.7f", ",", header=head, comments="")
    return rank([path], body=GivenMotion(np.diag(INERTIA).ravel().tolist(), 12.0, None, GRAVITY))


@pytest.mark.parametrize("seed", range(4))
def test_the_first_line_of_a_right_file_has_its_noise(seed: int, tmp_path: Path) -> None:
    """The truth starts at a noisy row, which is no error of the program; nothing else is called wrong."""
    (motion,) = judged(write(tmp_path / "sim.csv", T_S, noisy(seed, normal))).motions
    assert re.fullmatch(
        r"The attitude is 0\.\d+ rad \(\S+ degrees\) from the truth after 10 s(, \S+ rad at most before)?, "
        r"which the noise of the first row can make\.",
        conclusion(motion, None),
    )


@pytest.mark.slow
def test_a_fault_that_reverses_the_motion_is_named_alone(tmp_path: Path) -> None:
    """The differences are weighed by the derivatives of the faulty map; no second one of 1e-11 is added."""
    t_s, inertia = np.arange(501) * 0.02, np.array([0.02, 0.035, 0.05])

    def rates(_: float, state: Array) -> Array:
        q, w = state[:4], state[4:]
        dq = 0.5 * np.array([-q[1:] @ w, *(q[0] * w + np.cross(q[1:], w))])
        return np.concatenate([dq, np.cross(w, inertia * w) / inertia])  # of the wrong sign

    found = solve_ivp(
        rates, (0.0, 10.0), [1.0, 0, 0, 0, 0.3, 4.0, 0.5], "DOP853", t_s, rtol=1e-12, atol=1e-13
    )
    path = write(tmp_path / "sim.csv", t_s, (found.y.T[:, :4], found.y.T[:, 4:]), "%.9g")
    text = told(rank([path], body=GivenMotion(tuple(inertia))))
    assert "Likely cause: the gyroscopic term omega x I omega has the wrong sign (explains all" in text


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_wrong_path_comes_before_the_noise_of_the_attitude(seed: int, tmp_path: Path) -> None:
    """And the fault of one axis is not that of all, which the noise excludes."""
    at, velocity = fallen(GRAVITY)
    ranking = thrown_in_noise(seed, at * [1.0, 1.0, 1.02], velocity, tmp_path / "sim.csv")
    text = told(ranking)
    assert text.startswith("The position is ")
    assert "Likely cause: the position along z is multiplied by 1.0" in text
    assert "the position is multiplied" not in text
    assert "Angular momentum is not conserved" not in text


@pytest.mark.slow
def test_a_missing_part_of_a_torque_is_named_in_noise(tmp_path: Path) -> None:
    """It is far more than the noise, and no error of a solver."""
    stated, noise = np.array([0.8, -0.5, 1.1]), 1e-3 * normal(np.random.default_rng(3))
    q, w = solved(T_S, torque=stated * [1.0, 0.0, 1.0])
    turned = Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(noise[:, :3])
    path = write(tmp_path / "sim.csv", T_S, (turned.as_quat(scalar_first=True), w + noise[:, 3:]))
    text = told(rank([path], body=GivenMotion(INERTIA, torque_body_n_m=tuple(stated))))
    found = re.search(r"a spurious constant torque of \((\S+), (\S+), (\S+)\) N m in body axes acts", text)
    assert found, text
    assert [float(one) for one in found.groups()] == pytest.approx([0.0, 0.5, 0.0], abs=0.02)
    assert "solver" not in text


@pytest.mark.parametrize("late", ["position", "velocity"])
def test_a_path_that_is_one_row_late_is_no_single_row(late: str, tmp_path: Path) -> None:
    """All rows but the first are off."""
    at, velocity = fallen(GRAVITY)
    moved = at if late == "position" else velocity
    moved[1:] = moved[:-1].copy()
    (motion,) = thrown(tmp_path / "sim.csv", at, velocity).motions
    assert conclusion(motion, None).startswith(f"The {late} is ")


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "draw",
    [
        normal,
        lambda rng: rng.laplace(0.0, math.sqrt(0.5), (201, 6)),
        lambda rng: rng.standard_t(5, (201, 6)) * math.sqrt(0.6),
        lambda rng: rng.uniform(-math.sqrt(3.0), math.sqrt(3.0), (201, 6)),
        lambda rng: normal(rng) * np.where(np.arange(201) < 100, 1.0, 10.0)[:, None],
        lambda rng: normal(rng) + 30.0 * (np.arange(201) >= 100)[:, None],
        lambda rng: normal(rng) + 30.0 * np.isin(np.arange(201), [60, 61])[:, None],
    ],
    ids=["normal", "Laplace", "t5", "uniform", "growing", "a step", "two rows"],
)
def test_noise_and_steps_are_no_single_wrong_rows(
    seed: int, draw: Callable[[np.random.Generator], Array], tmp_path: Path
) -> None:
    """Noise of any usual distribution, and what changes from one row on, accuse no row."""
    (motion,) = judged(write(tmp_path / "sim.csv", T_S, noisy(seed, draw))).motions
    assert " off" not in conclusion(motion, None)


@pytest.mark.slow
def test_a_wrong_inertia_is_found_at_irregular_times(tmp_path: Path) -> None:
    """Times that are not evenly spaced do not hide a cause."""
    t_s = np.sort(np.r_[0.0, np.random.default_rng(4).uniform(0.0, 10.0, 180), 10.0])
    path = write(tmp_path / "sim.csv", t_s, solved(t_s), "%.9f")
    ranking = rank([path], body=GivenMotion((40.0, 63.0, 85.0)))
    assert "the middle principal moment of inertia is multiplied by 0.952" in told(ranking)


def test_a_step_is_not_asked_for_where_times_take_none(tmp_path: Path) -> None:
    """The rows of a program whose cause is not found have to be evenly spaced to be made by its steps."""
    q, w = stepped(T_S, 1)
    w += np.outer(0.02 * np.sin(3.0 * T_S), [0.0, 1.0, 0.0])
    for rows, asks in (
        (slice(None), True),
        (np.sort(np.random.default_rng(1).permutation(201)[:150]), False),
    ):
        motion = (q[rows], w[rows])
        path = write(tmp_path / "sim.csv", T_S[rows] - T_S[rows][0], motion)
        text = told(judged(path))
        assert ("--dt" in text) == asks, text


@pytest.mark.slow
def test_rates_alone_are_judged_by_energy_and_omega(tmp_path: Path) -> None:
    """Without an attitude, momentum and orientation are left out, and not diagnosed."""
    _, w = stepped(T_S, 5, 0.05)
    path = tmp_path / "gyro.csv"
    head = "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    np.savetxt(path, np.column_stack([T_S, w]), "%.17g", ",", header=head, comments="")
    text = told(judged(path))
    assert "The body loses " in text
    assert text.startswith("Omega is ")
    assert "ngular momentum" not in text


WRONG: dict[str, tuple[list[str], str]] = {
    "no scenario and no body": ([], "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s\n0,0,0,1\n1,0,0,1\n"),
    "a load without a body": (["--gravity", "0,0,-9.81"], "t_s\n"),
    "an impossible body": (
        ["--inertia-kg-m2", "1,1,3"],
        "t_s,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s\n0,1,0,0,0,0,0,1\n1,1,0,0,0,0,0,1\n",
    ),
    "four moments": (
        ["--inertia-kg-m2", "1,1,1,1"],
        "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s\n0,0,0,1\n1,0,0,1\n",
    ),
    "a scenario too": (
        ["--inertia-kg-m2", "1,1,1", "--scenario", "boxes"],
        "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s\n0,0,0,1\n1,0,0,1\n",
    ),
    "no omega": (["--inertia-kg-m2", "1,1,1"], "t_s,qw,qx,qy,qz\n0,1,0,0,0\n1,1,0,0,0\n"),
    "one row": (["--inertia-kg-m2", "1,1,1"], "t_s,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s\n0,0,0,1\n"),
    "a page without a folder": (["--inertia-kg-m2", "1,1,1", "--html", "none/sim.html"], "t_s\n"),
    "a start": (["--inertia-kg-m2", "1,1,1", "--start", "scenario"], "t_s\n"),
}


@pytest.mark.slow(after=2)
@pytest.mark.parametrize("what", WRONG)
def test_wrong_options_are_refused_in_one_line(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the option, and nothing is written."""
    options, text = WRONG[what]
    (tmp_path / "sim.csv").write_text(text)
    done = run_bodycheck(tmp_path, "judge", "sim.csv", *options)
    assert (done.returncode, done.stdout) == (2, "")
    expected_message(done.stderr.strip(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["sim.csv"]


@pytest.mark.slow
def test_the_command_prints_the_conclusion_first_and_writes_the_page(
    tmp_path: Path,
) -> None:
    """One command gives the conclusion, three digits, all digits as JSON, and a page without the network."""
    write(tmp_path / "sim.csv", T_S, stepped(T_S, 5, 0.05))
    command = ["judge", "sim.csv", "--inertia-kg-m2", "40,60,85", "--dt", "0.01"]
    lines = run_bodycheck(tmp_path, *command, "--html", "sim.html").stdout.splitlines()
    assert lines[0].startswith("The attitude is ")
    assert lines[1].startswith("Likely cause: ")
    assert lines[-1] == "sim.html"
    shown = dict(re.split(r"\s{2,}", line) for line in lines if re.match(r"\w+_\w+\s", line))
    data = json.loads(run_bodycheck(tmp_path, *command, "--json").stdout)
    assert data["conclusions"] == [" ".join(lines[: lines.index("")])]
    exact = data["orientation_error_rad"]
    assert len(repr(exact)) > 15
    assert float(shown["orientation_error_rad"]) == pytest.approx(exact, rel=5e-3)
    assert len(re.sub(r"\D", "", shown["orientation_error_rad"].split("e")[0]).lstrip("0")) <= 3
    page = (tmp_path / "sim.html").read_text()
    for part in ("data-motion", 'data-plot="drift"', "Angular momentum is not conserved", "Likely cause"):
        assert part in page
    assert 'src="http' not in page


def test_the_page_plots_nothing_that_is_only_rounding(tmp_path: Path) -> None:
    """Drifts within the digits of a file are named, not drawn; those of a damped motion are drawn."""
    drawn = {}
    for name, motion in (("right", solved(T_S)), ("damped", stepped(T_S, 4, damping=0.05))):
        page = judgement_page(judged(write(tmp_path / f"{name}.csv", T_S, motion, "%.6f")), [])
        _, _, left_out = page.partition("Not drawn, because")
        drawn[name] = page.count('data-plot="drift"'), "energy drift" in left_out.partition("</p>")[0]
    assert drawn == {"right": (0, True), "damped": (2, False)}


def test_the_error_is_printed_before_the_search_for_its_cause(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The search takes minutes on a busy machine; JSON stays one document."""

    def interrupted(*_: object) -> None:
        raise InputError("interrupted")

    monkeypatch.setattr(judge, "explained_motion", interrupted)
    write(tmp_path / "sim.csv", T_S, stepped(T_S, 5, 0.05))
    command = ["judge", "sim.csv", "--inertia-kg-m2", "40,60,85"]
    assert run_bodycheck(tmp_path, *command).stdout.startswith("The attitude is 2.69 rad")
    assert run_bodycheck(tmp_path, *command, "--json").stdout == ""


@pytest.mark.nightly
@pytest.mark.parametrize("width", [pytest.param(1440, marks=pytest.mark.nightly), 390])
def test_the_page_draws_the_motion_and_fits_its_window(width: int, chromium: Browser, tmp_path: Path) -> None:
    """Both plots over time and the motion are drawn, without an error of a script, also on a phone."""
    files = [write(tmp_path / f"{dt}.csv", T_S, stepped(T_S, round(0.05 / dt))) for dt in (0.025, 0.0125)]
    ranking = rank(files, body=BODY)
    path = tmp_path / "judged.html"
    path.write_text(judgement_page(ranking, [explained_motion(motion, None) for motion in ranking.motions]))
    page = chromium.new_page(viewport={"width": width, "height": 9000})
    errors: list[Error] = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto(path.as_uri())
    expect(page.locator("[data-plot=drift][data-drawn]")).to_have_count(2)
    expect(page.locator("[data-motion][data-drawn]")).to_have_count(1)
    assert page.locator("[data-plot=drift] g[class^='trace scatter']").count() >= 4
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.close()
    assert errors == []


@pytest.mark.nightly
def test_conservation_is_judged_from_the_first_row_whatever_the_scenario_starts_with(tmp_path: Path) -> None:
    """A motion that starts elsewhere conserves what it has, although it is far from the truth."""
    scenario = tmp_path / "other.toml"
    scenario.write_text(
        'name = "other"\nduration_s = 10.0\nsamples = 201\n[body]\nmass_kg = 1.0\n'
        f"inertia_kg_m2 = {list(INERTIA)}\n[initial]\nomega_body_rad_s = [0.3, 1.0, 0.2]\n"
    )
    (motion,) = rank([write(tmp_path / "sim.csv", T_S, solved(T_S), "%.9g")], scenario).motions
    text = conclusion(motion, explained_motion(motion, None))
    assert "Angular momentum is conserved" in text
    assert "energy" not in text
    assert "The start differs" in text
    assert motion.row["angular_momentum_drift"] > 0.1


def test_several_files_are_ranked_with_their_order_or_the_reason(tmp_path: Path) -> None:
    """Four steps give an order near 1; fewer, or none, give the reason."""
    t_s = np.arange(21) * 0.1
    steps = [0.02, 0.01, 0.005, 0.0025]
    files = [write(tmp_path / f"{dt}.csv", t_s, stepped(t_s, round(0.1 / dt))) for dt in steps]
    with_order = rank(files, steps_s=steps, body=BODY)
    assert [Path(row["file"]).stem for row in with_order.rows] == ["0.0025", "0.005", "0.01", "0.02"]
    texts = [part.text for part in judgement_document(with_order).parts if isinstance(part, Sentence)]
    assert "0.0025.csv is nearest to the truth" in texts[0]
    assert with_order.orders["orientation_error_rad"].order == pytest.approx(1.0, abs=0.1)
    assert texts[1].startswith("Order ")
    for some in (files[:3], files):
        given = steps[: len(some)] if len(some) < 4 else None
        texts = [
            part.text
            for part in judgement_document(rank(some, steps_s=given, body=BODY)).parts
            if isinstance(part, Sentence)
        ]
        assert texts[1].startswith("No order: ")


def test_wrong_rows_of_one_of_several_files_are_stated(tmp_path: Path) -> None:
    """The errors of the attitude, by which files are ranked and orders fitted, do not show a wrong omega."""
    right, wrong, late = solved(T_S), solved(T_S), solved(T_S)
    wrong[1][77] *= 1.01
    late[1][1:] = solved(T_S)[1][:-1]
    motions = {"a.csv": right, "b.csv": wrong, "c.csv": late}
    files = [write(tmp_path / name, T_S, motion) for name, motion in motions.items()]
    document = judgement_document(rank(files, body=BODY))
    texts = [part.text for part in document.parts if isinstance(part, Sentence)]
    said = sorted(text for text in texts if text.startswith(tuple(f"{name}: " for name in motions)))
    assert texts[0].startswith("a.csv is nearest to the truth: omega error ")
    assert set(texts[1:3]) == set(said)
    assert [text.partition(" of 201")[0].partition(" behind")[0] for text in said] == [
        "b.csv: Only 1",
        "c.csv: Omega is one row",
    ]


def test_equal_files_are_equally_near(tmp_path: Path) -> None:
    """None of them is called the nearest or the farthest."""
    files = [write(tmp_path / name, T_S, solved(T_S)) for name in ("a.csv", "b.csv")]
    first = judgement_document(rank(files, body=BODY)).parts[0]
    assert isinstance(first, Sentence)
    assert first.text.startswith("a.csv and b.csv are equally near to the truth: ")


def test_files_that_differ_by_their_rounding_are_equally_near(tmp_path: Path) -> None:
    """Beside a worse one, those of equal attitudes are ranked by omega."""
    q, w = solved(T_S)
    off = w.copy()
    off[77] *= 1.01
    files = [
        write(tmp_path / "a.csv", T_S, (q, w), "%.6f"),
        write(tmp_path / "b.csv", T_S, (q, w + 2e-7), "%.6f"),
        write(tmp_path / "c.csv", T_S, (q, off), "%.6f"),
        write(tmp_path / "d.csv", T_S, stepped(T_S, 5), "%.6f"),
    ]
    assert rank(files[:2], body=BODY).ranks == [1, 1]
    ranking = rank(files, body=BODY)
    assert ranking.quantity == "orientation_error_rad"
    assert [Path(row["file"]).stem for row in ranking.rows] == ["a", "b", "c", "d"]
    assert ranking.ranks == [1, 1, 3, 4]


def test_wrong_rows_of_attitude_and_of_omega_are_both_stated(tmp_path: Path) -> None:
    """One row of the attitude is off, and another one of omega."""
    q, w = solved(T_S)
    q[50], w[77] = q[30], 1.01 * w[77]
    text = told(judged(write(tmp_path / "sim.csv", T_S, (q, w))))
    assert re.findall(r"Only 1 of 201 rows is off( in omega)?, ", text) == ["", " in omega"]


@pytest.mark.nightly
def test_files_of_the_same_name_are_told_apart_by_their_folders(tmp_path: Path) -> None:
    """Every sentence and every line of a figure names one file."""
    paths = []
    for rate in (0.0, 0.1):
        folder = tmp_path / f"damping-{rate}"
        folder.mkdir()
        paths.append(write(folder / "sim.csv", T_S, stepped(T_S, 5, damping=rate), "%.9g"))
    ranking = rank(paths, body=BODY)
    called = [motion.name for motion in ranking.motions]
    assert called == [str(path) for path in paths]
    assert [motion.case.columns["engine"] for motion in ranking.motions] == called
    cases = [explained_motion(motion, None) for motion in ranking.motions]
    texts = [part.text for part in judgement_document(ranking, cases).parts if isinstance(part, Sentence)]
    assert texts[0].startswith(f"{called[0]} is nearest")
    assert f"{called[1]} is farthest" in texts[0]
    assert [text.partition(":")[0] for text in texts[2:]] == called
    assert "Likely cause: the error of a method without a fault: the motion is that of semi-" in texts[2]


def attitudes_alone(path: Path, attitude: Array) -> Path:
    """Write attitudes (n, 4) with five decimals, without omega."""
    np.savetxt(path, np.column_stack([T_S, attitude]), "%.5f", ",", header="t_s,qw,qx,qy,qz", comments="")
    return path


def test_omega_is_derived_where_a_file_has_attitudes_alone(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The right motion is the true one to what the derivative leaves open, and its omega is within that."""
    attitude, omega = solved(T_S)
    ranking = judged(attitudes_alone(tmp_path / "sim.csv", attitude))
    (motion,) = ranking.motions
    assert motion.is_true
    derived = motion.case.trajectory
    assert derived is not None
    off = np.max(np.abs(derived.omega_body - omega))
    assert 0.02 * motion.resolution.omega < off < motion.resolution.omega
    expected_message(told(ranking))


@pytest.mark.parametrize(("lost", "reason"), [(0.0, "is zero at"), (np.nan, "is not finite from")])
def test_a_lost_attitude_is_named_and_not_the_omega_that_is_derived_from_it(
    lost: float, reason: str, tmp_path: Path
) -> None:
    """The derivative is lost a few samples before the row that the file has lost."""
    attitude, _ = solved(T_S)
    attitude[40] = lost
    text = told(judged(attitudes_alone(tmp_path / "sim.csv", attitude)))
    assert re.search(rf"quaternion {reason} t = 2 s", text)


@pytest.mark.slow
def test_a_reading_of_attitudes_alone_is_the_one_that_conserves_momentum(tmp_path: Path) -> None:
    """Conjugates rotate another body; damping is no reading, so that no cause is named."""
    attitude, _ = solved(T_S)
    wrong = attitudes_alone(tmp_path / "conjugated.csv", attitude * np.array([1.0, -1.0, -1.0, -1.0]))
    assert "Likely cause: the quaternion that is read is world to body" in told(judged(wrong))
    damped, _ = stepped(T_S, 50, damping=0.05)
    text = told(judged(attitudes_alone(tmp_path / "damped.csv", damped)))
    assert "Angular momentum is not conserved" in text
    assert "Likely cause" not in text
    assert "No wrong reading of the attitudes explains it" in text


@pytest.mark.nightly
def test_a_position_without_a_velocity_is_not_compared_and_this_is_stated(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """Nothing tells with which velocity the position starts."""
    path = tmp_path / "sim.csv"
    head = "t_s,x_m,y_m,z_m,qw,qx,qy,qz,wx_body_rad_s,wy_body_rad_s,wz_body_rad_s"
    rows = np.column_stack([T_S, np.outer(T_S, [1.0, 2.0, 3.0]), *solved(T_S)])
    np.savetxt(path, rows, "%.9f", ",", header=head, comments="")
    ranking = judged(path)
    assert not {"position_error", "position_error_abs"} & ranking.rows[0].keys()
    expected_message(told(ranking))


def test_times_in_another_unit_are_suspected(tmp_path: Path) -> None:
    """In milliseconds the body seems to turn many times between two samples, which no search follows."""
    path = write(tmp_path / "sim.csv", 1e3 * T_S, stepped(T_S, 5), "%.9g")
    ranking = rank([path], body=BODY)
    case = explained_motion(ranking.motions[0], None)
    document = judgement_document(ranking, [case])
    texts = [part.text for part in document.parts if isinstance(part, Sentence)]
    assert case.diagnosis is None
    assert any(case.reason in text for text in texts)
