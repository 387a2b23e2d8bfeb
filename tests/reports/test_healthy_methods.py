"""No healthy method is reported, whatever the body, its motion and the loads."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path

import pytest

import bodycheck
from tests.helpers.random_scenarios import KINDS, write_scenario
from tests.helpers.reported_results import reported_results

METHODS = ("reference:rk4", "reference:m1", "mujoco:implicit", "pybullet:multibody", "dart:semi-implicit")
MODULES = {"dart": "dartpy"}
KINDS_OF_CONSTANT_LOADS = 4
"""The first so many seeds; the kernels of continuous loads take a compiler a minute."""


def check_healthy(seeds: Iterable[int], folder: Path) -> None:
    """Nothing may be found of any method but properties of its state."""
    engines = [name for name in METHODS if _is_installed(name.partition(":")[0])]
    run = bodycheck.run([write_scenario(seed, folder) for seed in seeds], engines=engines, speed=False)
    accused = {
        method: [one.sentence for one in results if one.kind != "property"]
        for method, results in reported_results(run).items()
    }
    assert not any(accused.values()), accused


@pytest.mark.nightly
def test_no_healthy_method_is_reported_under_switching_loads(tmp_path: Path) -> None:
    """One random scenario of each kind of constant load."""
    check_healthy(range(KINDS_OF_CONSTANT_LOADS), tmp_path)


BALANCED = """
name = "balanced"
duration_s = 4.189
samples = 21
[body]
mass_kg = 54.1
inertia_kg_m2 = [
    [0.0872, 0.00054, 0.0114],
    [0.00054, 0.0839, 0.0019],
    [0.0114, 0.0019, 0.1222],
]
[initial]
quaternion = [0.577, 0.276, -0.23, 0.7334814244410011]
velocity_m_s = [-0.0089, 0.0026, -0.0071]
omega_body_rad_s = [0.104, 0.109, -0.055]
[[forcing]]
kind = "force"
axes = "body"
value_n = [-0.024, 0.037, 0.086]
at_m = [0.02, 0.012, 0.015]
[[forcing]]
kind = "gravity"
acceleration_m_s2 = [0.22, -0.11, -0.045]
"""


@pytest.mark.slow
def test_accurate_energy_at_coarse_tolerances_is_not_a_plateau(tmp_path: Path) -> None:
    """At tolerances of 1e-4 and 1e-6 the energy error is 1e-11, and at finer ones below that of its work."""
    path = tmp_path / "balanced.toml"
    path.write_text(BALANCED)
    run = bodycheck.run([path], engines=["reference:taylor"], speed=False)
    measured = run.results["energy_balance"].notna()
    assert measured.iloc[0]
    assert not measured.iloc[-1]
    assert reported_results(run) == {}


@pytest.mark.nightly
def test_no_healthy_method_is_reported_under_any_kind_of_load(tmp_path: Path) -> None:
    """One random scenario of each other kind: continuous loads, pivots, and all at once."""
    check_healthy(range(KINDS_OF_CONSTANT_LOADS, len(KINDS)), tmp_path)


def _is_installed(engine: str) -> bool:
    return engine == "reference" or find_spec(MODULES.get(engine, engine)) is not None
