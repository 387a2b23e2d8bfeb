"""Kill or interrupt runs, fill the disk or revoke permissions at random moments, and resume the runs.

    python tools/fault_trials.py --trials 200 --seed 1

Each trial starts a run, disturbs it, and continues as a user would. Afterwards nothing that was on disk may
be missing or changed, nothing may have been requested twice, and the tables must equal those of an
undisturbed run. Prints the figures. Exit status 1 if a trial failed.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from trials import FaultFound, Planted, command

from bodycheck._util.files import opened
from bodycheck.runs.directory import partial_of
from tests.helpers import scenario_texts
from tests.helpers.file_permissions import obey_file_permissions
from tests.helpers.worker_processes import all_gone, workers_of

SCENARIO = scenario_texts.SCENARIO.replace("samples = 11", "samples = 101")
WORDS = ["run", "mine.toml", "--engine", "reference:m1,reference:rk4,mujoco:euler", "--no-speed"]
PATIENCE_S = 120.0

Tables = dict[str, pd.DataFrame]


@dataclass
class Trial:
    """One run in a separate folder, with its state."""

    folder: Path
    dice: random.Random
    notes: Counter[str] = field(default_factory=Counter)

    @property
    def out(self) -> Path:
        """Return the folder of the results."""
        return self.folder / "out"

    @property
    def journal(self) -> Path:
        """Return the journal of the run, which exists until the run is complete."""
        return partial_of(self.out) / "journal"

    def start(self, *words: str, harm: Callable[[], None] = obey_file_permissions) -> subprocess.Popen[str]:
        """Start a command in the folder; its process calls `harm` before it begins."""
        return subprocess.Popen(
            [sys.executable, "-m", "bodycheck", *words],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=harm,
        )

    def begin(self, harm: Callable[[], None] = obey_file_permissions) -> subprocess.Popen[str]:
        """Start the run; one in four may reuse results of earlier runs."""
        fresh = [] if self.dice.random() < 0.25 else ["--fresh"]
        return self.start(*WORDS, *fresh, "--out", "out", harm=harm)

    def wait_for_a_moment(self, process: subprocess.Popen[str], most_lines: int) -> None:
        """Wait until some lines are in the journal and a little longer, or for a random time."""
        end = time.monotonic() + self.dice.uniform(0.0, 5.0)
        if self.dice.random() < 0.7:
            lines = self.dice.randint(0, most_lines)
            while process.poll() is None and self.lines() < lines:
                time.sleep(0.002)
            end = time.monotonic() + self.dice.choice([0.0, 0.0, 0.01, 0.05, 0.2])
        while process.poll() is None and time.monotonic() < end:
            time.sleep(0.002)

    def lines(self) -> int:
        """Return the number of lines in the journal."""
        try:
            return self.journal.read_bytes().count(b"\n")
        except OSError:
            return 0


def ended(process: subprocess.Popen[str], statuses: set[int]) -> str:
    """Wait for a command and return its standard error, which must not contain a traceback."""
    _, printed = process.communicate(timeout=PATIENCE_S)
    if process.returncode not in statuses or "Traceback" in printed or "unexpected error" in printed:
        raise FaultFound(f"ended with status {process.returncode}: {printed[-2000:]}")
    if not all_gone(process.pid):
        raise FaultFound(f"left workers behind: {workers_of(process.pid)}")
    return printed


def kill_run(trial: Trial, most_lines: int) -> None:
    """Kill the run with SIGKILL at a random moment."""
    process = trial.begin()
    trial.wait_for_a_moment(process, most_lines)
    process.kill()
    ended(process, {0, -signal.SIGKILL})


def kill_workers(trial: Trial, most_lines: int) -> None:
    """Kill a worker with SIGKILL at a random moment; another one must be started."""
    process = trial.begin()
    trial.wait_for_a_moment(process, most_lines)
    kill_one_worker(trial, process)
    ended(process, {0})


def kill_both(trial: Trial, most_lines: int) -> None:
    """Kill a worker with SIGKILL, and the run a little later."""
    process = trial.begin()
    trial.wait_for_a_moment(process, most_lines)
    kill_one_worker(trial, process)
    time.sleep(trial.dice.uniform(0.0, 0.5))
    process.kill()
    ended(process, {0, 2, -signal.SIGKILL})


def kill_one_worker(trial: Trial, process: subprocess.Popen[str]) -> None:
    """Kill one of the workers of a run with SIGKILL, if there is one."""
    if found := sorted(workers_of(process.pid)):
        with suppress(ProcessLookupError):
            os.kill(trial.dice.choice(found), signal.SIGKILL)
            trial.notes["workers killed"] += 1


def interrupt(trial: Trial, most_lines: int) -> None:
    """Press Ctrl-C at a random moment."""
    stop_by(signal.SIGINT, trial, most_lines)


def terminate(trial: Trial, most_lines: int) -> None:
    """End the run as a batch system does at its time limit."""
    stop_by(signal.SIGTERM, trial, most_lines)


def hang_up(trial: Trial, most_lines: int) -> None:
    """Close the terminal from which the run was started."""
    stop_by(signal.SIGHUP, trial, most_lines)


def stop_by(number: signal.Signals, trial: Trial, most_lines: int) -> None:
    """Send a signal at a random moment; it ends a run that is still importing without a message."""
    process = trial.begin()
    trial.wait_for_a_moment(process, most_lines)
    process.send_signal(number)
    printed = ended(process, {0, 128 + number, -number})
    if process.returncode == 128 + number and trial.lines() and "bodycheck run --resume out" not in printed:
        raise FaultFound(f"does not say how to go on: {printed}")


def fill_disk(trial: Trial, most_lines: int) -> None:  # noqa: ARG001 - every harm has the same signature
    """Limit the size of every file to a random number of bytes."""
    size = int(10.0 ** trial.dice.uniform(1.0, 6.7))

    def harm() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

    process = trial.begin(harm)
    printed = ended(process, {0, 2})
    if process.returncode == 2 and "cannot be written" not in printed:
        raise FaultFound(f"does not say what is wrong: {printed}")


def lock_out(trial: Trial, most_lines: int) -> None:
    """Remove the write permission of one of the folders during the run."""
    process = trial.begin()
    trial.wait_for_a_moment(process, most_lines)
    place = trial.dice.choice([trial.folder, partial_of(trial.out)])
    try:
        place.chmod(0o555)
    except FileNotFoundError:
        place = trial.folder
        place.chmod(0o555)
    try:
        printed = ended(process, {0, 2})
    finally:
        for path in (trial.folder, partial_of(trial.out)):
            if path.exists():
                path.chmod(0o755)
    if process.returncode == 2 and "cannot be written: Permission denied" not in printed:
        raise FaultFound(f"does not say what is wrong: {printed}")


HARMS = (fill_disk, lock_out, kill_both, kill_run, kill_workers, interrupt, terminate, hang_up)


def go_on(trial: Trial) -> None:
    """Continue like a user whose run has stopped: resume it, or run it again if nothing was stored."""
    if trial.out.exists():
        trial.notes["complete all the same"] += 1
        if partial_of(trial.out).exists():
            printed = ended(trial.start("run", "--resume", "out"), {2})
            if "that run is complete" not in printed:
                raise FaultFound(printed)
        return
    if not (partial_of(trial.out) / "request.json").exists():
        trial.notes["begun again"] += 1
        ended(trial.start(*WORDS, "--out", "out"), {0})
        return
    stored = whole_lines(trial.journal)
    trial.notes["resumed"] += 1
    trial.notes["results kept"] += len(stored)
    kept = trial.folder / "kept"
    trial.journal.touch()
    os.link(trial.journal, kept)  # the run removes its journal when it is complete
    ended(trial.start("run", "--resume", "out"), {0})
    final = whole_lines(kept)
    kept.unlink()
    if final[: len(stored)] != stored:
        raise FaultFound("a result that was stored is missing or changed")
    keys = [json.loads(line.partition(b" ")[2])["key"] for line in final]
    if len(set(keys)) != len(keys):
        raise FaultFound("something that was stored was requested again")


def whole_lines(journal: Path) -> list[bytes]:
    """Return the complete lines of a journal."""
    if not journal.exists():
        return []
    return [line for line in journal.read_bytes().splitlines(keepends=True) if opened(line) is not None]


def tables(folder: Path) -> Tables:
    """Return the tables of a run as text, also without the column on reused answers."""
    found = scenario_texts.comparable_tables(folder)
    return {name: table.drop(columns="reused", errors="ignore") for name, table in found.items()}


def check(trial: Trial, expected: Tables) -> None:
    """Raise FaultFound unless the run is complete, as expected, and nothing else is left."""
    left = sorted(path.name for path in trial.folder.iterdir())
    if left != ["mine.toml", "out"]:
        raise FaultFound(f"left behind: {left}")
    for name, table in tables(trial.out).items():
        right = expected[name]
        if table.shape != right.shape or list(table) != list(right):
            columns = set(table).symmetric_difference(right)
            raise FaultFound(
                f"{name}.csv has {len(table)} rows, not {len(right)}, and other columns: {columns}"
            )
        if not table.equals(right):
            raise FaultFound(f"{name}.csv differs:\n{table.compare(right)}")
    if not (trial.out / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>"):
        raise FaultFound("the report is cut off")


def main(trials: int = 200, seed: int = 1) -> bool:
    """Run the trials; return whether one failed."""
    planted = Planted(seed)
    notes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="fault-trials-") as place:
        sound = prepared(Path(place, "sound"), random.Random(0))
        ended(sound.start(*WORDS, "--fresh", "--out", "out"), {0})
        expected = tables(sound.out)
        most_lines = len(expected["results"])
        for number in range(trials):
            trial = prepared(Path(place, str(number)), random.Random(f"{seed}/{number}"))
            harm, fault = HARMS[number % len(HARMS)], None
            try:
                harm(trial, most_lines)
                go_on(trial)
                check(trial, expected)
            except (FaultFound, subprocess.TimeoutExpired, OSError) as found:
                fault = str(found)
            planted.add(number, harm.__name__, fault, f" ({harm.__name__})")
            notes += trial.notes
            shutil.rmtree(trial.folder, ignore_errors=True)
    print(f"{dict(notes)}; {most_lines} results a run")
    return planted.summed_up("trials")


def prepared(folder: Path, dice: random.Random) -> Trial:
    """Return a trial in a new folder that contains the scenario."""
    folder.mkdir()
    (folder / "mine.toml").write_text(SCENARIO, encoding="utf-8")
    return Trial(folder, dice)


if __name__ == "__main__":
    command(main)
