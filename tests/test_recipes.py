"""A measure and a fault, added as CONTRIBUTING.md says, are known wherever measures and faults are."""

from __future__ import annotations

from pathlib import Path
from textwrap import indent

import pandas as pd
import pytest

from tests.helpers.changed_package import copy_with, printed_by
from tests.helpers.doc_pages import blocks
from tests.helpers.scenario_texts import tumbling

pytestmark = pytest.mark.slow

HALF = """
from dataclasses import replace
import numpy as np
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product

def step(state, dt):
    inertia, omega = state.body.inertia, state.omega_body
    omega = omega - 0.5 * dt * np.linalg.solve(inertia, np.cross(omega, inertia @ omega))
    turned = quaternion_product(state.quaternion, exp_quaternion(dt * omega))
    return replace(state, quaternion=turned, omega_body=omega)
"""
"""M1 with half of the gyroscopic term."""


def entry(name: str) -> str:
    """Return what CONTRIBUTING.md assigns to a name in its example, from the first bracket on."""
    (text,) = [one.text for one in blocks("CONTRIBUTING.md", "python") if f"\n{name} = " in one.text]
    return text.partition(f"\n{name} = ")[2]


def test_a_new_measure_is_known_wherever_measures_are(tmp_path: Path) -> None:
    """A line in measures.py adds it to the tables, with orders and floors, to lists and to judgements."""
    file = "bodycheck/reports/measurement/measures.py"
    copy_with(tmp_path, file, '    Measure(\n        "energy_drift",', f"{indent(entry('SPIN'), ' ' * 4)},\n")
    (tmp_path / "mine.toml").write_text(tumbling())
    methods = ("--engine", "reference:m1,reference:rk4", "--dt", "0.1,0.05,0.02,0.01")
    printed_by(tmp_path, "run", "mine.toml", *methods, "--no-speed", "--quiet", "--out", "run")
    results = pd.read_csv(tmp_path / "run/results.csv")
    assert len(results) == 8
    assert (results["spin_error"] > 0.0).all()
    orders = pd.read_csv(tmp_path / "run/methods.csv").set_index(["quantity", "method"])["order"]
    assert orders["spin_error", "m1"] == pytest.approx(1.0, abs=0.1)
    assert orders["spin_error", "rk4"] == pytest.approx(4.0, abs=0.3)
    assert "spin_error" in printed_by(tmp_path, "list", "measures")
    (motion,) = (tmp_path / "run/trajectories/mine").glob("*m1_0.1.npz")
    assert "spin_error" in printed_by(tmp_path, "judge", str(motion), "--scenario", "mine.toml")
    assert "spin_error" in (tmp_path / "run/report.html").read_text()


def test_a_new_fault_is_known_wherever_faults_are(tmp_path: Path) -> None:
    """A line in map_faults.py names it in the explanation of a run and in the judgement of a recording."""
    file = "bodycheck/examine/diagnosis/faults/map_faults.py"
    first = '    yield Fault(\n        "gyroscopic-term",'
    copy_with(tmp_path, file, first, indent(f"yield {entry('HALF_OF_THE_TERM')}", " " * 4))
    (tmp_path / "mine.py").write_text(HALF)
    (tmp_path / "mine.toml").write_text(tumbling())
    own = ("--engine", "mine:step", "--allow-code")
    printed_by(tmp_path, "run", "mine.toml", *own, "--dt", "0.02", "--no-speed", "--quiet", "--out", "run")
    (motion,) = (tmp_path / "run/trajectories/mine").glob("mine_step*.npz")
    for answer in (
        printed_by(tmp_path, "explain", "run", "--case", "mine,mine:step", "--allow-code"),
        printed_by(tmp_path, "judge", str(motion), "--scenario", "mine.toml", "--dt", "0.02"),
    ):
        assert "x I omega has the weight 0.5" in " ".join(answer.split()), answer
