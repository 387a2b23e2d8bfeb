"""Nights that are killed, that change nothing, and that are simulated from measured noise.

    python tests/long/night_trials.py --kills 50 --unchanged 20 --measured 20 --sequences 100 --seed 1

Kills: `bodycheck nightly` is killed with all its workers at random moments; afterwards the history must be
readable, what was stored before unchanged, and the next night succeed. Unchanged: so many nights of a real
engine, none of which may tell anything of accuracy. Measured: so many runs of the smoke suite with speeds; a
simulated night takes for each case, as a night does, the quickest of three of them, drawn at random. Of
sequences of 30 such nights none may tell a speed; of those in which one engine takes a fifth longer from some
night on, each has to tell it within five nights. Prints the figures; status 1 where a trial failed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

import numpy as np
import pandas as pd
from scenario_file import SCENARIO

from bodycheck.night import SPEED_PASSES
from bodycheck.reports.history.levels import LEAST_AFTER, usual_spread
from bodycheck.reports.history.nights import History
from bodycheck.reports.history.queries import nights_table, query
from bodycheck.reports.history.speeds import Speeds, speeds_of

_QUICK = ["tumble.toml", "--engine", "mujoco:euler,reference:rk4", "--no-speed"]
_SCENARIO = SCENARIO.replace("mine", "tumble").replace("samples = 11", "samples = 101")
_CASE = ["engine", "method", "scenario", "control", "dt_s", "tolerance"]
_WITHIN = 5
_SLOWER = 1.2


def main() -> int:
    """Run the trials that are asked for; return the exit status."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--unchanged", type=int, default=20)
    parser.add_argument("--measured", type=int, default=20)
    parser.add_argument("--sequences", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="a folder of measured runs, made or gone on with")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tumble.toml").write_text(_SCENARIO)
        failed = killed(folder, asked.kills, asked.seed) if asked.kills else 0
        failed += unchanged(folder, asked.unchanged) if asked.unchanged else 0
        if asked.measured:
            kept = (asked.keep or folder / "measured").absolute()
            measure(folder, kept, asked.measured)
            failed += simulated(kept, asked.sequences, asked.seed)
    return 1 if failed else 0


def begin(folder: Path, history: Path, words: list[str]) -> subprocess.Popen[str]:
    """Start a night in a session of its own, so that all of it can be killed at once."""
    return subprocess.Popen(
        [sys.executable, "-m", "bodycheck", "nightly", *words, "--history", str(history)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def digests(history: Path) -> dict[str, str]:
    """Return the hash of every file of every night that is stored."""
    files = (file for night in History(history).nights() for file in night.iterdir())
    return {
        f"{file.parent.name}/{file.name}": hashlib.sha256(file.read_bytes()).hexdigest() for file in files
    }


def killed(folder: Path, kills: int, seed: int) -> int:
    """Kill nights at random moments, half of them while they are stored; return how many trials failed."""
    history, chance = folder / "killed", random.Random(seed)
    lengths, failed, stored = [], 0, 0
    for _ in range(2):  # the first compiles what the second does not
        start = time.monotonic()
        begin(folder, history, _QUICK).communicate()
        lengths.append(time.monotonic() - start)
    for trial in range(kills):
        before = digests(history)
        process = begin(folder, history, _QUICK)
        if trial % 2:
            time.sleep(chance.uniform(0.0, lengths[-1]))
        else:
            while process.poll() is None and not any(history.glob(".unfinished-*")):
                time.sleep(0.001)
            time.sleep(chance.uniform(0.0, 0.3))
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        after = digests(history)
        stored += len(after) > len(before)
        lost = before.items() - after.items()
        readable = len(nights_table(History(history).nights())) == len(History(history).nights())
        asked = query(History(history), "SELECT count(DISTINCT run_id) AS n FROM results")["n"][0]
        if lost or not readable or asked != len(History(history).nights()):
            failed += 1
            print(f"kill {trial}: lost {sorted(lost)}, readable {readable}, {asked} nights in the tables")
    last = begin(folder, history, _QUICK)
    told, _ = last.communicate()
    left = [path.name for path in history.glob(".unfinished-*")]
    if last.returncode != 0 or left:
        failed += 1
        print(f"the night after: status {last.returncode}, left {left}\n{told}")
    print(f"kills: {kills}, of which {stored} came too late; failed: {failed}", flush=True)
    return failed


def unchanged(folder: Path, nights: int) -> int:
    """Run the same night again and again; return on how many nights anything was told."""
    history, told = folder / "unchanged", 0
    for night in range(nights + 1):
        process = begin(folder, history, _QUICK)
        text, _ = process.communicate()
        if process.returncode != (3 if night == 0 else 0):
            told += 1
            print(f"night {night}: status {process.returncode}\n{text}")
    found = int(query(History(history), "SELECT count(*) AS n FROM changes")["n"][0])
    print(f"unchanged nights: {nights}, changes told: {found}", flush=True)
    return told + found


def measure(folder: Path, kept: Path, runs: int) -> None:
    """Store runs of the smoke suite, with their speeds, until there are so many."""
    while len(list(kept.glob("*/results.csv"))) < runs:
        words = ["run", "smoke", "--out", str(kept / f"{time.time_ns()}")]
        subprocess.run(
            [sys.executable, "-m", "bodycheck", *words], cwd=folder, stdout=subprocess.DEVNULL, check=True
        )


def simulated(kept: Path, sequences: int, seed: int) -> int:
    """Draw sequences of nights from the runs that were measured; return how many were judged wrongly."""
    tables = [
        pd.read_csv(path).set_index(_CASE)["relative_cpu"] for path in sorted(kept.glob("*/results.csv"))
    ]
    passes = pd.concat(tables, axis=1).dropna()
    chance = np.random.default_rng(seed)
    usual = usual_spread(drawn(passes, chance, 30).series.decades)
    print(
        f"{len(tables)} runs measured; chance changes a night by {100.0 * (10.0**usual - 1.0):.1f} % (sigma)"
    )
    false = sum(bool(alarms(drawn(passes, chance, 30))) for _ in range(sequences))
    print(f"unchanged sequences of 30 nights: {sequences}, with a speed told: {false}", flush=True)
    engines = sorted(set(passes.index.get_level_values("engine")) - {"reference"})
    delays: list[int] = []
    for _ in range(sequences):
        engine, first = str(chance.choice(engines)), int(chance.integers(10, 25))
        speeds = drawn(passes, chance, first + _WITHIN, slower=engine, first=first)
        told = [at for (who, _), at, size in alarms(speeds) if who == engine and size > 0.0 and at >= first]
        delays += [min(told) - first + 1] if told else []
    print(f"one engine {_SLOWER} times as slow: {sequences}, told within {_WITHIN} nights: {len(delays)}")
    if delays:
        middle, latest = np.median(delays), max(delays)
        print(f"told on night {middle:.0f} (median), {latest} (latest); at the earliest {LEAST_AFTER}")
    return false + sequences - len(delays)


def drawn(
    passes: pd.DataFrame, chance: np.random.Generator, nights: int, slower: str = "", first: int = 0
) -> Speeds:
    """Return the speeds of nights drawn at random; from `first` on, an engine is slower."""
    picked = chance.integers(0, passes.shape[1], (nights, SPEED_PASSES))
    quickest = passes.to_numpy()[:, picked].min(axis=2)
    quickest[np.ix_(passes.index.get_level_values("engine") == slower, np.arange(nights) >= first)] *= _SLOWER
    names = [f"night {number:03d}" for number in range(nights)]
    table = pd.DataFrame(quickest, index=passes.index, columns=names)
    cases = table.melt(var_name="night", value_name="relative_cpu", ignore_index=False).reset_index()
    return speeds_of(names, cases)


def alarms(speeds: Speeds) -> list[tuple[tuple[str, str], int, float]]:
    """Return method, night and size of each step that is told."""
    return [(method, step.told, step.size) for method, steps in speeds.steps.items() for step in steps]


if __name__ == "__main__":
    sys.exit(main())
