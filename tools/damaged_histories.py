"""Damage a history of nightly runs in one place: the next run must be stored and must name the damaged file.

    python tools/damaged_histories.py --nights 30 --trials 300 --seed 1

All nightly runs are made from one run that is measured once. Each trial damages one file of one nightly run,
byte by byte or by its grammar, or deletes it, and stores one further run. Prints the figures. Exit status 1
if a run was not stored, had no baseline although there is a valid one, or did not name the file.
"""

from __future__ import annotations

import json
import random
import shutil
import tempfile
from functools import partial
from pathlib import Path

from trials import FaultFound, Planted, command

import bodycheck
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import read_summary
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.nightly_run import store_nightly
from tests.helpers.file_mutations import any_bytes, csv_cell, json_value, toml_line
from tests.helpers.nightly_runs import as_nightly_run, store_nightly_runs, unchanged
from tests.helpers.scenario_texts import SCENARIO

LIMIT_S, MAX_MEGABYTES = 60.0, 500.0
GRAMMARS = {".json": json_value, ".csv": csv_cell, ".toml": toml_line}


def damage(path: Path, dice: random.Random) -> str:
    """Damage a file until it reads otherwise, and return how it was damaged."""
    before = path.read_bytes()
    if dice.random() < 0.05:
        path.unlink()
        return "gone"
    by_grammar = path.suffix in GRAMMARS and dice.random() < 0.5
    change = GRAMMARS[path.suffix] if by_grammar else any_bytes
    while _read_alike(path.read_bytes(), before):
        path.write_bytes(change(before, dice))
    return "by its grammar" if by_grammar else "bytes"


def _read_alike(content: bytes, before: bytes) -> bool:
    """Whether two files are equal, or are JSON of equal content, as with a key that is there twice."""
    try:
        return content == before or bool(json.loads(content) == json.loads(before))
    except (ValueError, RecursionError):
        return False


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


def main(nights: int = 30, trials: int = 300, seed: int = 1) -> bool:
    """Run the trials; return whether one failed."""
    planted = Planted(seed, MAX_MEGABYTES)
    with tempfile.TemporaryDirectory(prefix="damaged-histories-") as place:
        scenario, history = Path(place, "mine.toml"), Path(place, "history")
        scenario.write_text(SCENARIO)
        run = bodycheck.run([scenario], engines=["reference:m1", "reference:rk4"], jobs=1)
        store_nightly_runs(run, history, [unchanged] * nights)
        for number in range(trials):
            dice = random.Random(f"{seed}/{number}")
            files = [one for one in dice.choice(History(history).runs()).rglob("*") if one.is_file()]
            # what an empty file says is its name, which no byte in it can change
            path = dice.choice(sorted(one for one in files if one.suffix != ".npz" and one.stat().st_size))
            content = path.read_bytes()
            way = f"{path.suffix[1:]} {damage(path, dice)}"
            ended = planted.in_child(partial(trial, run, history, nights, path), LIMIT_S)
            planted.add(number, way, ended.error, f" ({path.name}, {way})")
            path.write_bytes(content)
            for extra in History(history).runs()[nights:]:
                shutil.rmtree(extra)
    print(f"a history of {nights} nightly runs")
    return planted.summed_up("damaged histories")


if __name__ == "__main__":
    command(main, own_cache=True)
