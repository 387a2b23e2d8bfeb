"""`judge`: trajectories of other programs get the measures of a run, for the quantities that they have."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bodycheck
from bodycheck.recordings.judge_document import judgement_document
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reports.document import Table
from bodycheck.reports.run_files.trajectory_files import trajectory_table
from bodycheck.runs.runner import rank
from tests.helpers.expected_messages import ExpectedMessage

GROUPS = {
    "position": ["x_m", "y_m", "z_m"],
    "velocity": ["vx_m_s", "vy_m_s", "vz_m_s"],
    "attitude": ["qw", "qx", "qy", "qz"],
    "omega_body": ["wx_body_rad_s", "wy_body_rad_s", "wz_body_rad_s"],
}


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pd.Series]:
    """Return the npz of one case and its row of results.csv."""
    folder = tmp_path_factory.mktemp("run") / "out"
    run = bodycheck.run(["boxes"], engines=["reference:m1"], dt_s=[1e-3], speed=False)
    bodycheck.write_run(run, folder)
    return folder / "trajectories/boxes/reference_m1_0.001.npz", run.results.iloc[0]


@pytest.mark.slow
def test_stored_trajectory_has_the_measures_of_its_case(stored: tuple[Path, pd.Series]) -> None:
    """Every measure of the row is the same, digit for digit."""
    path, row = stored
    judged = bodycheck.judge(path, "boxes")
    assert judged.pop("compared_until_s") == 10.0
    for name, value in judged.items():
        assert row[name.removesuffix("_from_start")] == value, name  # the case starts at the truth
    assert row.dropna().filter(regex="drift|error|balance").index.isin(list(judged)).all()


def write(table: pd.DataFrame, path: Path) -> Path:
    """Write a table as CSV and return the path."""
    table.to_csv(path, index=False, na_rep="nan")
    return path


def truth_table() -> pd.DataFrame:
    """Return the truth of a scenario as a table, moved by a known amount in every quantity."""
    table = trajectory_table(bodycheck.truth("boxes", list(np.linspace(0.0, 10.0, 11))).trajectory)
    table["x_m"] += 0.5
    table["vy_m_s"] += 0.25
    return table


EXPECTED = {
    ("position",): {"position_error", "position_error_abs"},
    ("velocity",): {
        *("velocity_error", "velocity_error_abs"),
        *("linear_momentum_drift", "linear_momentum_drift_abs"),
    },
    ("attitude",): {"orientation_error_rad", "orientation_error_final_rad", "quaternion_norm_error"},
    ("omega_body",): {
        *("omega_error", "omega_error_abs"),
        *("rotational_energy_drift", "rotational_energy_drift_abs", "rotational_energy_drift_from_start"),
        "rotational_energy_drift_signed",
    },
}


@pytest.mark.parametrize("groups", EXPECTED)
def test_only_available_quantities_are_measured(groups: tuple[str, ...], tmp_path: Path) -> None:
    """A measure whose quantities are not in the file is left out."""
    columns = ["t_s", *(column for group in groups for column in GROUPS[group]), "bound_rad"]
    table = truth_table().assign(bound_rad=0.0)[columns]
    judged = bodycheck.judge(write(table, tmp_path / "part.csv"), "boxes")
    who = {"scenario", "outcome", "message", "truth", "truth_bound_rad", "compared_until_s"}
    assert set(judged) - who == EXPECTED[groups]


def test_planted_offset_is_the_position_error(tmp_path: Path) -> None:
    """A trajectory moved by half a metre has a position error of half a metre."""
    judged = bodycheck.judge(write(truth_table(), tmp_path / "all.csv"), "boxes")
    assert judged["position_error_abs"] == pytest.approx(0.5, rel=1e-12, abs=0.0)
    assert judged["velocity_error_abs"] == pytest.approx(0.25, rel=1e-12, abs=0.0)
    assert judged["orientation_error_rad"] < 1e-14


def test_rotation_matrix_replaces_a_quaternion(tmp_path: Path) -> None:
    """Columns r00 to r22 give the same orientation error."""
    truth = bodycheck.truth("boxes", [0.0, 1.0, 2.0]).trajectory
    matrices = truth.rotation_matrices.reshape(3, 9)
    names = [f"r{i}{j}" for i in range(3) for j in range(3)]
    table = pd.DataFrame({"t_s": truth.t_s} | {name: matrices[:, i] for i, name in enumerate(names)})
    judged = bodycheck.judge(write(table, tmp_path / "matrix.csv"), "boxes")
    assert judged["orientation_error_rad"] < 1e-15
    assert judged["orthogonality_error"] < 1e-15


def test_trajectory_is_read_from_a_pipe(tmp_path: Path) -> None:
    """As from `bodycheck truth ... | bodycheck judge /dev/stdin`."""
    content = write(truth_table(), tmp_path / "truth.csv").read_bytes()
    reading, writing = os.pipe()
    os.write(writing, content)
    os.close(writing)
    judged = bodycheck.judge(f"/dev/fd/{reading}", "boxes")
    os.close(reading)
    assert judged["orientation_error_rad"] < 1e-15


def test_trajectory_with_nan_is_unstable(tmp_path: Path) -> None:
    """NaN in a file is an outcome, without measures."""
    table = truth_table()
    table.loc[4, "qx"] = np.nan
    judged = bodycheck.judge(write(table, tmp_path / "nan.csv"), "boxes")
    assert judged["outcome"] == "unstable"
    assert judged["message"] == "quaternion is not finite from t = 4 s on"
    assert "orientation_error_rad" not in judged


def test_trajectory_with_infinite_energy_is_unstable(tmp_path: Path) -> None:
    """Infinite energy is an outcome, without a warning of numpy."""
    table = truth_table()
    table.loc[4, "wx_body_rad_s"] = 1e200
    judged = bodycheck.judge(write(table, tmp_path / "wild.csv"), "boxes")
    assert judged["outcome"] == "unstable"
    assert judged["message"].endswith("the true maximum from t = 4 s on")


WRONG = {
    "no file": None,
    "empty": "",
    "no rows": "t_s,qw,qx,qy,qz\n",
    "no time": "qw,qx,qy,qz\n1,0,0,0\n",
    "time alone": "t_s\n0\n",
    "half a vector": "t_s,x_m\n0,0\n",
    "unknown column": "t_s,q0\n0,0\n",
    "text in a cell": "t_s,x_m,y_m,z_m\n0,0,0,0\n1,0,high,0\n",
    "an empty cell": "t_s,x_m,y_m,z_m\n0,0,,0\n",
    "one cell too many": "t_s,x_m,y_m,z_m\n0,1,0,0,0\n1,1,0,0,0\n",
    "time stands still": "t_s,x_m,y_m,z_m\n0,0,0,0\n0,0,0,0\n",
    "negative time": "t_s,x_m,y_m,z_m\n-1,0,0,0\n",
    "past the end": "t_s,x_m,y_m,z_m\n11,0,0,0\n",
    "omega in world axes alone": "t_s,wx_world_rad_s,wy_world_rad_s,wz_world_rad_s\n0,1,0,0\n1,1,0,0\n",
}


def test_files_that_end_at_different_times_are_not_ranked(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A program that stopped early would be the best one."""
    whole, short = (write(truth_table()[:rows], tmp_path / f"{rows}.csv") for rows in (11, 4))
    assert bodycheck.judge(short, "boxes")["compared_until_s"] == 3.0
    assert [row["compared_until_s"] for row in rank([whole, whole], "boxes").rows] == [10.0, 10.0]
    with expected_message.raises(bodycheck.InputError):
        rank([whole, short], "boxes")


def test_files_within_the_bound_of_the_truth_share_a_rank(tmp_path: Path) -> None:
    """Errors that the truth cannot distinguish are not ranked; a file with a larger error is behind them."""
    files = []
    for name, angle in (("right", 0.0), ("as-right", 1e-16), ("wrong", 1e-9)):
        table = truth_table()
        table["qx"] += angle
        files.append(write(table, tmp_path / f"{name}.csv"))
    ranking = rank(files[::-1], "boxes")
    (_, _, table, _) = judgement_document(ranking).parts
    assert [row["rank"] for row in ranking.data["files"]] == ranking.ranks == [1, 1, 3]
    assert isinstance(table, Table)
    assert [(row[0], Path(str(row[1])).stem) for row in table.rows] == [
        ("1", "as-right"),
        ("1", "right"),
        ("3", "wrong"),
    ]


MATRIX = [f"r{row}{column}" for row in range(3) for column in range(3)]


@pytest.mark.parametrize("fault", ["a transposed matrix", "omega in the same axes", "none"])
def test_a_file_that_contradicts_itself_is_refused(
    fault: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A quantity that is given twice is measured once, and the other one may be wrong."""
    table = truth_table()
    matrices = quaternion_to_matrix(table[GROUPS["attitude"]].to_numpy())
    if fault == "a transposed matrix":
        matrices = matrices.transpose(0, 2, 1)
    table[MATRIX] = matrices.reshape(len(table), 9)
    if fault == "omega in the same axes":
        table[[name.replace("body", "world") for name in GROUPS["omega_body"]]] = table[GROUPS["omega_body"]]
    path = write(table.round(6), tmp_path / "other.csv")
    if fault == "none":
        assert bodycheck.judge(path, "boxes")["outcome"] == "ok"
    else:
        with expected_message.raises(bodycheck.InputError):
            bodycheck.judge(path, "boxes")


def test_a_step_given_twice_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Two files cannot have the same step, because an order could not be fitted."""
    files = [write(truth_table(), tmp_path / f"{number}.csv") for number in range(2)]
    with expected_message.raises(bodycheck.InputError):
        rank(files, "boxes", [1e-3, 1e-3])


@pytest.mark.parametrize("what", WRONG)
def test_wrong_file_is_refused_in_one_line(
    what: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The message names the file and the error."""
    path = tmp_path / "other.csv"
    if (text := WRONG[what]) is not None:
        path.write_text(text)
    with expected_message.raises(bodycheck.InputError):
        bodycheck.judge(path, "boxes")


def test_invalid_npz_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """Text, pickled objects, a single array and damaged archives are refused."""
    text, pickled, alone, damaged = (
        tmp_path / f"{name}.npz" for name in ("text", "pickled", "npy", "damaged")
    )
    text.write_text("hello")
    np.savez(pickled, t_s=np.array([object()]), allow_pickle=True)
    with alone.open("wb") as file:
        np.save(file, np.arange(3.0))
    np.savez_compressed(damaged, t_s=np.arange(100.0))
    content = bytearray(damaged.read_bytes())
    content[len(content) // 2 - 40 : len(content) // 2] = bytes(range(40))
    damaged.write_bytes(content)
    for path in (text, pickled, alone, damaged):
        with expected_message.raises(bodycheck.InputError):
            bodycheck.judge(path, "boxes")
