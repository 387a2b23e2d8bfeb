"""Damage a history of nightly runs in one place: the next run must be stored and must name the damaged file.

    python tools/damaged_histories.py --nights 30 --trials 300 --seed 1

All nightly runs are made from one run that is measured once. Each trial damages one file of one nightly run,
byte by byte or by its grammar, or deletes it, and stores one further run. Prints the figures. Exit status 1
if a run was not stored, had no baseline although there is a valid one, or did not name the file.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import bodycheck
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import read_summary
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.nightly_run import store_nightly
from tests.helpers.child_process import run_in_child
from tests.helpers.file_mutations import any_bytes, csv_cell, json_value, toml_line
from tests.helpers.nightly_runs import as_nightly_run, store_nightly_runs, unchanged
from tests.helpers.scenario_texts import SCENARIO

LIMIT_S, MAX_MEGABYTES = 60.0, 500.0
GRAMMARS = {".json": json_value, ".csv": csv_cell, ".toml": toml_line}


class FaultFound(Exception):  # noqa: N818 - the result that the trials search for
    """A nightly run that was not stored and judged as required."""


def damage(path: Path, dice: random.Random) -> str:
    """Damage a file until it differs, and return how it was damaged."""
    before = path.read_bytes()
    if dice.random() < 0.05:
        path.unlink()
        return "gone"
    by_grammar = path.suffix in GRAMMARS and dice.random() < 0.5
    change = GRAMMARS[path.suffix] if by_grammar else any_bytes
    while path.read_bytes() == before:
        path.write_bytes(change(before, dice))
    return "by its grammar" if by_grammar else "bytes"


def trial(run: Run, folder: Path, number: int, damaged: Path) -> None:
    """Store a further nightly run; raise FaultFound unless it is judged and names the damaged file."""
    judged, night = store_nightly(as_nightly_run(run, number), History(folder))
    if History(folder).runs()[-1] != night or read_summary(night)["status"] != judged.status:
        raise FaultFound("it is not stored")
    expected = History(folder).runs()
    baseline = next(one for one in reversed(expected[:-1]) if one not in damaged.parents)
    if judged.comparison is None or judged.comparison.before.run_id != baseline.name:
        raise FaultFound("it was not compared with the newest sound night")
    if judged.status != "no regression":
        raise FaultFound(f"its status is {judged.status}")
    named = [why for why in judged.baseline.left_out if str(damaged) in why]
    if len(judged.baseline.left_out) != 1 or not named:
        raise FaultFound(f"{damaged} is not named in {judged.baseline.left_out}")
    if named[0].split(": ")[0].rpartition("/")[2] not in (night / "night.md").read_text(encoding="utf-8"):
        raise FaultFound("the page does not name it")


def main() -> int:
    """Run the trials and print the number of each kind of ending."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--nights", type=int, default=30)
    options.add_argument("--trials", type=int, default=300)
    options.add_argument("--seed", type=int, default=1)
    requested = options.parse_args()
    begin, ways, failed = time.monotonic(), Counter[str](), []
    megabytes, slowest = 0.0, 0.0
    with tempfile.TemporaryDirectory(prefix="damaged-histories-") as place:
        (Path(place) / "mine.toml").write_text(SCENARIO)
        run = bodycheck.run([Path(place) / "mine.toml"], engines=["reference:m1", "reference:rk4"], jobs=1)
        history = Path(place, "history")
        store_nightly_runs(run, history, [unchanged] * requested.nights)
        for number in range(requested.trials):
            dice = random.Random(f"{requested.seed}/{number}")
            night = dice.choice(History(history).runs())
            # what an empty file says is its name, which no byte in it can change
            files = [
                one
                for one in night.rglob("*")
                if one.is_file() and one.suffix != ".npz" and one.stat().st_size
            ]
            path = dice.choice(sorted(files))
            content = path.read_bytes()
            way = f"{path.suffix[1:]} {damage(path, dice)}"
            ways[way] += 1
            ended = run_in_child(lambda path=path: trial(run, history, requested.nights, path), LIMIT_S)  # type: ignore[misc]
            megabytes, slowest = max(megabytes, ended.megabytes), max(slowest, ended.seconds)
            if ended.error is not None:
                failed.append(number)
                print(f"trial {number} ({path.name}, {way}): {ended.error[-1500:]}", flush=True)
            path.write_bytes(content)
            for extra in History(history).runs()[requested.nights :]:
                shutil.rmtree(extra)
    print(f"{requested.trials} trials of seed {requested.seed} in {time.monotonic() - begin:.0f} s")
    print(dict(sorted(ways.items())))
    print(
        f"a history of {requested.nights} nightly runs; slowest {slowest:.1f} s, at most {megabytes:.0f} MB"
    )
    print(f"{len(failed)} failed" + (f": {failed}" if failed else ""))
    return 1 if failed or megabytes > MAX_MEGABYTES else 0


if __name__ == "__main__":
    os.environ.setdefault("BODYCHECK_CACHE_DIR", tempfile.mkdtemp())
    sys.exit(main())
