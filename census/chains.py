"""A free chain without loads, by every engine with trees: which agree, and which are right."""

from __future__ import annotations

import csv
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from bodycheck._util.formatting import scientific
from census.finding import HERE

CHAINS = HERE / "chains.csv"
COMMAND = (
    "bodycheck run free-chain --engine mujoco,dart,pybullet,drake,newton,mujoco-warp,mjx,pinocchio "
    "--dt 1e-2 --no-speed"
)
HEADER = ("engine", "release", "method", "error of a joint, rad", "change of momentum", "one-step map")


def run_chains() -> None:
    """Run the command and write chains.csv, the largest error first."""
    with tempfile.TemporaryDirectory() as folder:
        words = [*shlex.split(COMMAND)[1:], "--quiet", "--out", "run"]
        subprocess.run([sys.executable, "-m", "bodycheck", *words], cwd=folder, check=True)
        write_chains(Path(folder) / "run" / "results.csv")


def write_chains(results: Path) -> None:
    """Write chains.csv from the results of a run."""
    with results.open(newline="", encoding="utf-8") as file:
        found = [row for row in csv.DictReader(file) if row["joint_error_rad"]]
    found.sort(key=lambda row: -float(row["joint_error_rad"]))
    with CHAINS.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        for row in found:
            numbers = [
                scientific(float(row[name])) if row[name] else ""
                for name in ("joint_error_rad", "linear_momentum_drift")
            ]
            writer.writerow(
                [
                    row["engine"].partition("==")[0],
                    row["engine_version"],
                    row["method"],
                    *numbers,
                    row["tree_map"],
                ]
            )
