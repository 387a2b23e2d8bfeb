"""Small scenarios as TOML texts, and what equal runs have in common."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

_STEPLESS = """
name = "{name}"
duration_s = 1.0
samples = 11
{steps}[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
[initial]
omega_body_rad_s = {omega}
"""


def tumbling(
    name: str = "mine",
    *,
    omega_body_rad_s: Sequence[float] = (0.3, 1.0, -0.2),
    steps_s: Sequence[float] | None = None,
) -> str:
    """Return the text of a body that rotates freely, with its own steps or the default ones."""
    steps = "" if steps_s is None else f"steps_s = {list(steps_s)}\n"
    return _STEPLESS.format(name=name, steps=steps, omega=list(omega_body_rad_s))


SCENARIO = tumbling()

RUN_SPECIFIC_COLUMNS = ["run_id", "cpu_s", "cpu_s_low", "cpu_s_high", "ns_per_step", "relative_cpu"]
"""The columns in which equal runs differ."""


def comparable_tables(folder: Path) -> dict[str, pd.DataFrame]:
    """Return the tables of a run as text, without the columns in which equal runs differ."""
    names = ("results", "methods", "stability", "probes")
    found = {name: pd.read_csv(folder / f"{name}.csv", dtype=str, keep_default_na=False) for name in names}
    return {name: table.drop(columns=RUN_SPECIFIC_COLUMNS, errors="ignore") for name, table in found.items()}
