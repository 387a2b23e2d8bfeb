"""The gates of this repository."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import pytest

from bodycheck.reports.gates.gate import read_gates
from bodycheck.reports.gates.verdict import check_gates
from bodycheck.runs.gate_run import run_for_gates
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import NULL_PROGRESS
from bodycheck.scenarios.library import suites

ROOT = Path(__file__).parents[1]


@pytest.mark.nightly  # .ci/run checks all gates
def test_gates_of_the_intermediate_axis_hold() -> None:
    """All gates that match the intermediate-axis scenario pass, and each has measured something."""
    gates = [
        gate for gate in read_gates(ROOT / "tolerances.toml") if gate.matches_scenario("intermediate-axis")
    ]
    run = run_for_gates(gates, ["intermediate-axis"], Request(), lambda _: nullcontext(NULL_PROGRESS))
    results = check_gates(gates, run)
    lost = run.manifest["engines"].get("pybullet", {}).get("unavailable")
    wanted = {"passed"} if lost is None else {"passed", "nothing"}  # no PyBullet on later versions of Python
    assert {result.status for result in results} == wanted
    assert all(result.gate.engine == "pybullet" for result in results if result.status == "nothing")


def test_every_gate_matches_the_standard_suite() -> None:
    """Each gate matches a scenario of the suite, so `bodycheck gate` without names measures every gate."""
    for gate in read_gates(ROOT / "tolerances.toml"):
        assert any(gate.matches_scenario(name) for name in suites()["standard"]), gate.title
