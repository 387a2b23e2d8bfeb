"""Check that an invalid message from a worker fails a case or its engine, but never the run.

    python tools/lying_workers.py --trials 200 --seed 1 --patience 1

Each trial runs a scenario by a worker whose messages have one of many faults, and by the reference. The run
must end with status 0 and the reference's rows as without the other engine, or with status 2 and a line that
names the engine; with complete output or none, within its time limit, in at most 500 MB. Prints the figures.
Patience is a factor on all time limits: a busy machine needs more, or cases of the reference time out, too.
Exit status 1 if a trial failed, or if no worker received a case.
"""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import tempfile
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pandas as pd
from trials import FaultFound, Planted, command

from bodycheck._util.untrusted import LONGEST_LINE
from bodycheck.adapters import registry
from bodycheck.adapters.workers import worker_process
from bodycheck.reports.run_files.run_reader import read_tables
from tests.helpers import faulty_worker
from tests.helpers.child_process import run_in_child
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import RUN_SPECIFIC_COLUMNS, SCENARIO

TIMEOUT_S, START_S, LIMIT_S, MAX_MEGABYTES = 2.0, 10.0, 120.0, 500.0


def trial(folder: Path, seed: str, engines: str, timeout_s: float, start_s: float = START_S) -> str:
    """Return how a run by these engines ended; raise FaultFound if that is not allowed."""
    (folder / "mine.toml").write_text(SCENARIO)
    words = [
        "run",
        "mine.toml",
        "--engine",
        engines,
        *["--dt", "0.05,0.02", "--out", "out", "--fresh", "--jobs", "1"],
    ]
    speed = [] if random.Random(seed).random() < 0.3 else ["--no-speed"]
    with (
        patch.object(
            registry,
            "_plugged_in",
            lambda: {"liar": EntryPoint("liar", "liar:Liar", "bodycheck.adapters")},
        ),
        patch.object(worker_process, "_START_S", start_s),
        patch.object(worker_process.subprocess, "Popen", _popen(seed)),
    ):
        done = run_bodycheck(folder, *words, *speed, "--timeout-s", str(timeout_s))
    lines = done.stderr.splitlines()
    if any(len(line) > LONGEST_LINE or not line.isprintable() for line in lines):
        raise FaultFound(f"a line that is too long or not printable: {lines}")
    left = sorted(path.name for path in folder.iterdir())
    if done.returncode == 2:
        if left != ["mine.toml"] or not done.stderr.strip().splitlines()[-1].startswith("liar"):
            raise FaultFound(f"status 2 with {left}: {done.stderr}")
        return "engine unavailable"
    if done.returncode != 0 or left != ["mine.toml", "out"]:
        raise FaultFound(f"status {done.returncode} with {left}: {done.stderr}")
    tables = read_tables(folder / "out")
    mine = [case.columns["outcome"] for case in tables.cases if case.columns["engine"] == "liar"]
    return "taken" if set(mine) <= {"ok"} else "outcome of its case: " + ", ".join(sorted(set(mine) - {"ok"}))


def _popen(seed: str) -> Any:
    start = subprocess.Popen

    def popen(command: list[str], **options: Any) -> Any:
        lies = "liar" in command
        return start([sys.executable, "-m", faulty_worker.__name__, seed] if lies else command, **options)

    return popen


def reference_rows(folder: Path) -> pd.DataFrame:
    """Return the rows of the reference without the columns that differ between equal runs."""
    rows = pd.read_csv(folder / "out/results.csv", dtype=str)
    return rows[rows["engine"] == "reference"].drop(columns=RUN_SPECIFIC_COLUMNS).reset_index(drop=True)


def main(trials: int = 200, seed: int = 1, patience: float = 1.0) -> bool:
    """Run the trials; return whether one failed, or none got as far as a case."""
    os.environ.setdefault("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    limits_s = patience * TIMEOUT_S, patience * START_S
    planted = Planted(seed, MAX_MEGABYTES)
    with tempfile.TemporaryDirectory(prefix="lying-workers-") as place:
        sound = Path(place, "sound")
        sound.mkdir()
        # a time limit that includes compiling the reference, so that no trial has to compile it
        run_in_child(partial(trial, sound, "sound", "reference:m1", LIMIT_S), 10 * LIMIT_S)
        expected = reference_rows(sound)
        if set(expected["outcome"]) != {"ok"}:
            raise FaultFound(f"the reference alone: {expected['message'].tolist()}")
        for number in range(trials):
            folder = Path(place, str(number))
            folder.mkdir()
            act = partial(trial, folder, f"{seed}/{number}", "liar,reference:m1", *limits_s)
            ended = planted.in_child(act, patience * LIMIT_S)
            fault = ended.error
            if fault is None and (folder / "out").exists():
                rows = reference_rows(folder)
                differing = [name for name in rows if not rows[name].equals(expected[name])]
                fault = f"the reference's rows differ in {', '.join(differing)}" if differing else None
            planted.add(number, "failed" if fault else str(ended.value), fault)
            shutil.rmtree(folder)
    failed = planted.summed_up("lying workers")
    if planted.endings["engine unavailable"] == trials:
        print("no worker got as far as a case: the trials show nothing")
    return failed or planted.endings["engine unavailable"] == trials


if __name__ == "__main__":
    command(main)
