"""Trials of nightly runs: killed ones, ones without a change, and ones with speeds of this machine.

    python tools/night_trials.py --kills 50 --unchanged 20 --measured 31 --sequences 100 --seed 1

Kills: `bodycheck nightly` is killed with all its workers at random moments; afterwards the history must be
readable, earlier runs unchanged, and the next nightly run successful. Resumed: this many nightly runs, with
speeds, are killed at random moments and resumed; their tables must be those of an undisturbed run, except for
the times. Unchanged: this many nightly runs of a
real engine, none of which may report a change of accuracy. Measured: this many successive nightly runs with
speeds, of the smoke suite in all engines and the reference's rk4. No change of speed may be reported, neither
in the measured order nor in any of the sequences of 30 runs drawn from them at random. If one engine takes a
fifth longer from some run on, in the measured order or in drawn runs, that must be reported within five runs.
Creeping: of this many synthetic series with a spread of 2.8 %, each disturbed in 15 % of 120 runs, at least
90 % must be reported before they are 20 % slower, where they become 0.4 % slower in each run; of five times
as many constant ones at most 1 % may be reported.
Prints the figures. Exit status 1 if a trial failed.
"""

from __future__ import annotations

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

import numpy as np
import pandas as pd
from trials import command

from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.queries import history_table, query, recorded_cases
from bodycheck.reports.history.regression import Speeds, speeds_of
from bodycheck.reports.history.step_detection import MIN_AFTER, MIN_BEFORE, detect_steps, pooled_spread
from tests.helpers.scenario_texts import RUN_SPECIFIC_COLUMNS, SCENARIO

_QUICK = ["tumble.toml", "--engine", "mujoco:euler,reference:rk4", "--no-speed"]
_TIMED_RUN = ["tumble.toml", "--engine", "mujoco:euler,reference:rk4"]
_SCENARIO = SCENARIO.replace("mine", "tumble").replace("samples = 11", "samples = 101")
_CASE = ["engine", "method", "scenario", "control", "dt_s", "tolerance"]
_TIMED = "mujoco,pybullet,dart,reference:rk4"
_WITHIN = 5
_SLOWER = 1.2


def main(
    kills: int = 50,
    resumed: int = 20,
    unchanged: int = 20,
    measured: int = 20,
    sequences: int = 100,
    creeping: int = 40,
    seed: int = 1,
    keep: Path | None = None,
) -> int:
    """Run so many trials of each kind; keep: the history of the measured nightly runs, to be continued."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tumble.toml").write_text(_SCENARIO)
        failed = killed(folder, kills, seed) if kills else 0
        failed += killed_and_resumed(folder, resumed, seed) if resumed else 0
        failed += repeated(folder, unchanged) if unchanged else 0
        failed += crept(creeping, seed) if creeping else 0
        if measured:
            kept = (keep or folder / "measured").absolute()
            measure(folder, kept, measured)
            nights = measured_nights(kept)
            failed += as_they_came(nights) + simulated(nights, sequences, seed)
    return failed


def killed_and_resumed(folder: Path, kills: int, seed: int) -> int:
    """Kill nightly runs at random moments and resume them; return how many differ from an undisturbed one."""
    history, chance, failed, late = folder / "resumed", random.Random(seed), 0, 0
    for _ in range(2):  # the first one compiles
        start = time.monotonic()
        begin(folder, history, _TIMED_RUN).communicate()
        length = time.monotonic() - start
    expected = run_tables(History(history).runs()[-1])
    trial = 0
    while trial < kills:
        known = set(History(history).runs())
        process = begin(folder, history, _TIMED_RUN)
        while process.poll() is None and not [*history.glob("*.partial/request.json")]:
            time.sleep(0.001)
        time.sleep(chance.uniform(0.0, 0.8 * length))
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        stored = set(History(history).runs()) - known
        if stored:
            late += 1
            continue
        trial += 1
        process = begin(folder, history, ["--resume"])
        output, _ = process.communicate()
        stored = set(History(history).runs()) - known
        left = [*history.glob("*.partial/request.json")]
        if len(stored) != 1 or left or run_tables(stored.pop()) != expected:
            failed += 1
            print(f"resumed {trial}: status {process.returncode}, {len(stored)} stored\n{output}")
    print(
        f"killed and resumed: {kills} ({late} others were killed too late); other tables: {failed}",
        flush=True,
    )
    return failed


def run_tables(run: Path) -> dict[str, str]:
    """Return the tables of a nightly run as text, without what differs between equal runs."""
    found = {}
    for path in (*run.glob("*.csv"), *run.glob("accepted/*.csv")):
        table = pd.read_csv(path, dtype=str)
        table = table.drop(columns=[*RUN_SPECIFIC_COLUMNS, "compared_with"], errors="ignore")
        found[path.relative_to(run).as_posix()] = table.to_csv(index=False)
    return found


def begin(folder: Path, history: Path, words: list[str]) -> subprocess.Popen[str]:
    """Start a nightly run in a separate session, so that all its processes can be killed at once."""
    return subprocess.Popen(
        [sys.executable, "-m", "bodycheck", "nightly", *words, "--history", str(history)],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def digests(history: Path) -> dict[str, str]:
    """Return the hash of every file of every stored nightly run."""
    files = (file for night in History(history).runs() for file in night.iterdir())
    return {
        f"{file.parent.name}/{file.name}": hashlib.sha256(file.read_bytes()).hexdigest() for file in files
    }


def killed(folder: Path, kills: int, seed: int) -> int:
    """Kill nightly runs at random moments, half of them while they are stored; return the failed trials."""
    history, chance = folder / "killed", random.Random(seed)
    lengths, failed, stored = [], 0, 0
    for _ in range(2):  # the first one compiles
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
        readable = len(history_table(History(history).runs())) == len(History(history).runs())
        requested = query(History(history).runs(), "SELECT count(DISTINCT run_id) AS n FROM results")["n"][0]
        if lost or not readable or requested != len(History(history).runs()):
            failed += 1
            print(f"kill {trial}: lost {sorted(lost)}, readable {readable}, {requested} nights in the tables")
    last = begin(folder, history, _QUICK)
    reported, _ = last.communicate()
    left = [path.name for path in history.glob(".unfinished-*")]
    if last.returncode != 0 or left:
        failed += 1
        print(f"the night after: status {last.returncode}, left {left}\n{reported}")
    print(f"kills: {kills}, of which {stored} came too late; failed: {failed}", flush=True)
    return failed


def repeated(folder: Path, nights: int) -> int:
    """Repeat the same nightly run; return the number of wrong exit statuses and reported changes."""
    history, reported = folder / "unchanged", 0
    for night in range(nights + 1):
        process = begin(folder, history, _QUICK)
        text, _ = process.communicate()
        if process.returncode != (3 if night == 0 else 0):
            reported += 1
            print(f"night {night}: status {process.returncode}\n{text}")
    found = int(query(History(history).runs(), "SELECT count(*) AS n FROM changes")["n"][0])
    print(f"unchanged nightly runs: {nights}, changes reported: {found}", flush=True)
    return reported + found


def measure(folder: Path, kept: Path, nights: int) -> None:
    """Store nightly runs of the smoke suite with their speeds until there are this many."""
    words = [
        sys.executable,
        *["-m", "bodycheck", "nightly", "smoke", "--engine"],
        _TIMED,
        "--history",
        str(kept),
    ]
    while len(History(kept).runs()) < nights:
        process = subprocess.run(words, cwd=folder, capture_output=True, text=True)
        if process.returncode not in (0, 3):
            sys.exit(
                f"a nightly run ended with status {process.returncode}\n{process.stdout}{process.stderr}"
            )


def measured_nights(kept: Path) -> pd.DataFrame:
    """Return relative_cpu with a row for each case that every run has, and a column for each run."""
    cases = recorded_cases(History(kept).runs())
    return cases.set_index([*_CASE, "run"])["relative_cpu"].unstack("run").dropna()


def engines_of(nights: pd.DataFrame) -> list[str]:
    """Return the engines that can become slower: all except the reference."""
    return sorted(set(nights.index.get_level_values("engine")) - {"reference"})


def as_they_came(nights: pd.DataFrame) -> int:
    """Judge the runs in order, then with each engine slower from each run on; return the number of faults."""
    count = nights.shape[1]
    reported = alarms(judged(nights))
    print(f"{count} nightly runs as measured, speeds reported: {reported or 'none'}", flush=True)
    first_nights = range(MIN_BEFORE, count - _WITHIN + 1)
    planted = [(engine, first) for engine in engines_of(nights) for first in first_nights]
    delays = [delay(slowed(nights, engine, first), engine, first) for engine, first in planted]
    return len(reported) + report(delays)


def simulated(nights: pd.DataFrame, sequences: int, seed: int) -> int:
    """Draw sequences from the measured runs; return how many were judged wrongly."""
    chance = np.random.default_rng(seed)
    sample = judged(drawn(nights, chance, 30))
    usual = pooled_spread(sample.series.decades, list(sample.steps.values()))
    print(f"chance changes a nightly run by {100.0 * (10.0**usual - 1.0):.1f} % (sigma)")
    false = sum(bool(alarms(judged(drawn(nights, chance, 30)))) for _ in range(sequences))
    print(
        f"unchanged sequences of 30 nightly runs drawn: {sequences}, with a speed reported: {false}",
        flush=True,
    )
    engines = engines_of(nights)
    delays: list[int | None] = []
    for _ in range(sequences):
        engine, first = str(chance.choice(engines)), int(chance.integers(10, 25))
        slower = slowed(drawn(nights, chance, first + _WITHIN), engine, first)
        delays.append(delay(slower, engine, first))
    return false + report(delays)


def crept(count: int, seed: int) -> int:
    """Judge series that creep and series that do not; return 1 if too few or too many are reported."""
    runs, first, chance = 120, 20, np.random.default_rng(seed)

    def constant(methods: int) -> Array:
        shape = (first + runs, methods)
        load = np.where(chance.random(shape) < 0.15, chance.random(shape), 0.0)
        return np.asarray(0.012 * chance.normal(size=shape) + np.log10(1.5) * load)

    shift = np.maximum(np.arange(first + runs) - first + 1.0, 0.0) * np.log10(1.004)
    late = first + int(np.argmax(shift > np.log10(_SLOWER)))
    moved = detect_steps(constant(count) + shift[:, None])
    found = sum(any(s.size > 0.0 and first <= s.detected_at < late for s in steps) for steps in moved)
    false = sum(map(bool, detect_steps(constant(5 * count))))
    print(f"0.4 % slower in each run: {count}, reported before 20 %: {found}; constant: {5 * count}, {false}")
    return int(found < 0.9 * count or false > 0.05 * count)


def report(delays: list[int | None]) -> int:
    """Print the run in which a slower engine was reported; return how often it was too late."""
    late = sum(each is None or each > _WITHIN for each in delays)
    print(f"one engine {_SLOWER} times as slow: {len(delays)}, not reported within {_WITHIN} runs: {late}")
    if reported := [each for each in delays if each is not None]:
        median, latest = np.median(reported), max(reported)
        print(f"reported in run {median:.0f} (median), {latest} (latest); earliest {MIN_AFTER}")
    return late


def drawn(nights: pd.DataFrame, chance: np.random.Generator, count: int) -> pd.DataFrame:
    """Return this many runs, each drawn at random from all."""
    picked = nights.iloc[:, chance.integers(0, nights.shape[1], count)]
    return picked.set_axis([f"night {number:03d}" for number in range(count)], axis=1)


def slowed(nights: pd.DataFrame, engine: str, first: int) -> pd.DataFrame:
    """Return the runs with an engine slower from the run `first` on."""
    factor = np.ones(nights.shape)
    factor[np.ix_(nights.index.get_level_values("engine") == engine, np.arange(nights.shape[1]) >= first)] = (
        _SLOWER
    )
    return nights * factor


def judged(nights: pd.DataFrame) -> Speeds:
    """Return the speeds of runs, judged as a nightly run judges them."""
    cases = nights.melt(var_name="run", value_name="relative_cpu", ignore_index=False).reset_index()
    return speeds_of(list(nights.columns), cases)


def delay(nights: pd.DataFrame, engine: str, first: int) -> int | None:
    """Return the number of slower runs until the change was reported, or None if it was not."""
    reported = [
        at for (who, _), at, size in alarms(judged(nights)) if who == engine and size > 0.0 and at >= first
    ]
    return min(reported) - first + 1 if reported else None


def alarms(speeds: Speeds) -> list[tuple[tuple[str, str], int, float]]:
    """Return method, run and size of each reported step."""
    return [(method, step.detected_at, step.size) for method, steps in speeds.steps.items() for step in steps]


if __name__ == "__main__":
    command(main)
