from __future__ import annotations

import pytest

import bodycheck
from bodycheck.reports.run_files.run_tables import Run
from tests.helpers.scenario_texts import tumbling


@pytest.fixture(scope="session")
def nightly_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run of two scenarios by three methods of the reference, with their speeds."""
    folder = tmp_path_factory.mktemp("run")
    files = []
    for name, omega in (("slow", [0.3, 1.0, -0.2]), ("quick", [0.6, 2.0, -0.4])):
        files.append(folder / f"{name}.toml")
        files[-1].write_text(tumbling(name, omega_body_rad_s=omega, steps_s=[0.05, 0.02, 0.01, 0.005]))
    return bodycheck.run(files, engines=["reference:m1", "reference:m2", "reference:rk4"], jobs=1)
