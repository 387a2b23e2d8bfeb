"""Check that an invalid message from a worker fails a case or its engine, but never the run.

    python tools/lying_workers.py --trials 200 --seed 1 --patience 1

Each trial runs a scenario by a worker whose messages have one of many faults, and by the reference. The run
must end with status 0 and the reference's rows as without the other engine, or with status 2 and a line that
names the engine; with complete output or none, within its time limit, in at most 500 MB. Prints the figures.
Patience is a factor on all time limits: a busy machine needs more, or cases of the reference time out, too.
Exit status 1 if a trial failed, or if no worker received a case.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parents[1]))

import pandas as pd

from bodycheck._util.untrusted import LONGEST_LINE
from bodycheck.adapters import registry
from bodycheck.adapters.workers import worker_process
from bodycheck.reports.run_files.run_reader import read_tables
from tests.helpers import faulty_worker
from tests.helpers.child_process import run_in_child
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import RUN_SPECIFIC_COLUMNS, SCENARIO

TIMEOUT_S, START_S, LIMIT_S, MAX_MEGABYTES = 2.0, 10.0, 120.0, 500.0


class FaultFound(Exception):  # noqa: N818 - the result that the trials search for
    """A run that did not end as required."""


def trial(folder: Path, seed: str, engines: str, timeout_s: float, start_s: float = START_S) -> str:
    """Return how a run by these engines ended; raise FaultFound if that is not allowed."""
    (folder / "mine.toml").write_text(SCENARIO)
    words = [
        "run",
        "mine.toml",
        "--engine",
        engines,
        "--dt",
        "0.05,0.02",
        "--out",
        "out",
        "--fresh",
        "--jobs",
        "1",
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


def main() -> int:
    """Run the trials and print the number of each kind of ending."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--trials", type=int, default=200)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--patience", type=float, default=1.0)
    requested = options.parse_args()
    limits_s = requested.patience * TIMEOUT_S, requested.patience * START_S
    begin, endings, failed = time.monotonic(), Counter[str](), []
    megabytes, slowest = 0.0, 0.0
    with tempfile.TemporaryDirectory(prefix="lying-workers-") as place:
        sound = Path(place, "sound")
        sound.mkdir()
        # a time limit that includes compiling the reference, so that no trial has to compile it
        run_in_child(lambda: trial(sound, "sound", "reference:m1", LIMIT_S), 10 * LIMIT_S)
        expected = reference_rows(sound)
        if set(expected["outcome"]) != {"ok"}:
            raise FaultFound(f"the reference alone: {expected['message'].tolist()}")
        for number in range(requested.trials):
            folder, seed = Path(place, str(number)), f"{requested.seed}/{number}"
            folder.mkdir()
            ended = run_in_child(
                lambda folder=folder, seed=seed: trial(folder, seed, "liar,reference:m1", *limits_s),  # type: ignore[misc]
                requested.patience * LIMIT_S,
            )
            megabytes, slowest = max(megabytes, ended.megabytes), max(slowest, ended.seconds)
            fault = ended.error
            if fault is None and (folder / "out").exists():
                rows = reference_rows(folder)
                differing = [name for name in rows if not rows[name].equals(expected[name])]
                fault = f"the reference's rows differ in {', '.join(differing)}" if differing else None
            if fault is not None:
                failed.append(number)
                print(f"trial {number}: {fault[-1500:]}", flush=True)
            endings[str(ended.value) if fault is None else "failed"] += 1
            shutil.rmtree(folder)
    print(f"{requested.trials} lying workers of seed {requested.seed} in {time.monotonic() - begin:.0f} s")
    print(dict(endings))
    print(f"slowest run {slowest:.1f} s, at most {megabytes:.0f} MB")
    print(f"{len(failed)} failed" + (f": {failed}" if failed else ""))
    if endings["engine unavailable"] == requested.trials:
        print("no worker got as far as a case: the trials show nothing")
        return 1
    return 1 if failed or megabytes > MAX_MEGABYTES else 0


if __name__ == "__main__":
    os.environ.setdefault("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    sys.exit(main())
