"""Recordings of trees: the truth is true, a wrong joint is named with its error, and its map or fault."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bodycheck.reference_impl.one_step_maps.tree_maps import TREE_MAPS
from bodycheck.reference_impl.trees.tree_bodies import tree_trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reports.run_files.trajectory_files import COLUMNS, npz, stored_arrays, tree_table
from bodycheck.scenarios.library import load_trees
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck

_STEP_S = 1e-2


def _scene() -> TreeScene:
    ((_, tree),) = load_trees("free-chain")
    return tree.scene


def _m1(path: Path, digits: int | None = None) -> None:
    """Write the motion of M1 on the free chain, rounded to some decimals."""
    scene = _scene()
    states = [(scene.q0, scene.u0)]
    for time in scene.sample_times[:-1]:
        states.append(TREE_MAPS["M1"].step(scene, float(time), *states[-1], _STEP_S, 5))
    q, u = (np.array(part) for part in zip(*states, strict=True))
    table = tree_table(scene, tree_trajectory(scene, scene.sample_times, q, u))
    (table if digits is None else table.round(digits)).to_csv(path, index=False)


def _judged(folder: Path, *words: str) -> dict[str, object]:
    shown = run_bodycheck(folder, "judge", "m.csv", "--scenario", "free-chain", "--json", *words)
    assert shown.returncode == 0, shown.stderr
    found: dict[str, object] = json.loads(shown.stdout)
    return found


@pytest.mark.parametrize("digits", [None, 6])
def test_the_truth_is_true(tmp_path: Path, digits: int | None) -> None:
    """The output of `truth` has no wrong quantity, also where it is rounded to six decimals."""
    from bodycheck.runs.runner import truth

    scene = _scene()
    table = tree_table(scene, truth("free-chain", scene.sample_times.tolist()).trajectory)
    (table if digits is None else table.round(digits)).to_csv(tmp_path / "m.csv", index=False)
    errors = _judged(tmp_path)["errors"]
    assert isinstance(errors, list)
    assert not [one for one in errors if one["is_wrong"]]
    assert len(errors) == 3 * 5 + 2 * 2  # of three bodies, and of two joints


def test_motion_of_a_map_is_wrong_by_its_error_and_named(tmp_path: Path) -> None:
    """M1 errs by 4.97e-2 rad in the second joint; with its step it is known as M1, on the page too."""
    _m1(tmp_path / "m.csv")
    found = _judged(tmp_path, "--dt", str(_STEP_S), "--html", "m.html")
    errors = found["errors"]
    assert isinstance(errors, list)
    (joint,) = [one for one in errors if (one["name"], one["quantity"]) == ("joint of l2", "angle")]
    assert round(joint["error"], 4) == 0.0497
    assert "semi-implicit Euler (M1) of trees" in str(found["cause"])
    page = (tmp_path / "m.html").read_text()
    assert all(str(one[key]) in page for one in errors for key in ("name", "quantity", "unit"))
    assert "semi-implicit Euler (M1) of trees" in page


def test_the_arrays_that_a_run_stores_are_read(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The file of a tree is judged as its columns are; of another tree, it is refused with the shape."""
    _m1(tmp_path / "m.csv")
    scene = _scene()
    motion = pd.read_csv(tmp_path / "m.csv")
    q = motion[[f"joint.{name}.q_rad" for name in ("l1", "l2")]].to_numpy()
    u = motion[[f"joint.{name}.rate" for name in ("l1", "l2")]].to_numpy()
    base = motion[
        [f"body.base.{name}" for name in (*COLUMNS["position_m"], *COLUMNS["quaternion"])]
    ].to_numpy()
    speed = motion[
        [f"body.base.{name}" for name in (*COLUMNS["velocity_m_s"], *COLUMNS["omega_body_rad_s"])]
    ].to_numpy()
    stored = tree_trajectory(scene, scene.sample_times, np.hstack([base, q]), np.hstack([speed, u]))
    (tmp_path / "m.npz").write_bytes(npz(stored_arrays(stored)))
    read = [
        json.loads(run_bodycheck(tmp_path, "judge", name, "--scenario", "free-chain", "--json").stdout)[
            "errors"
        ]
        for name in ("m.csv", "m.npz")
    ]
    errors = [{(one["name"], one["quantity"]): one["error"] for one in each} for each in read]
    assert errors[1] == pytest.approx(errors[0], abs=1e-12)
    shown = run_bodycheck(tmp_path, "judge", "m.npz", "--scenario", "double-pendulum")
    assert (shown.returncode, shown.stdout) == (2, "")
    expected_message(shown.stderr)


def test_a_column_of_another_tree_is_refused(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The message names the column; nothing is printed."""
    (tmp_path / "m.csv").write_text("t_s,joint.elbow.q_rad\n0,0.1\n1,0.2\n")
    shown = run_bodycheck(tmp_path, "judge", "m.csv", "--scenario", "free-chain")
    assert (shown.returncode, shown.stdout) == (2, "")
    expected_message(shown.stderr)
