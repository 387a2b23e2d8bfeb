"""Check that any command line is carried out or refused: no traceback, no hang, no incomplete output.

    python tools/command_trials.py --trials 1000 --seed 1

Draws command lines of all commands except those that download packages, with valid, odd and damaged files,
names and numbers, and runs each in a separate process. Prints the figures. Exit status 1 if a command ended
with an invalid status, wrote a line that is too long or not printable, left something incomplete, took too
long, or needed more than 500 MB.
"""

from __future__ import annotations

import random
import shutil
import tempfile
from functools import partial
from pathlib import Path
from subprocess import CompletedProcess

from trials import Planted, command

import bodycheck
from bodycheck._util.untrusted import LONGEST_LINE
from tests.helpers.file_mutations import any_bytes
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.nightly_runs import store_nightly_runs, unchanged
from tests.helpers.scenario_texts import SCENARIO

LIMIT_S, MAX_MEGABYTES = 60.0, 500.0
STATUSES = {0, 1, 2, 3}
WITHOUT_VERDICT = {"run", "truth", "judge", "body", "list", "compare", "advise", "report", "table", "plot"}
"""The commands that have no gate and no regression, for which status 1 would be wrong."""
GATES = '[[gate]]\nmeasure = "orientation_error_rad"\nupper = 1e-3\nreason = "small"\n'

TOML = ("mine.toml", "bad.toml", "caf\udce9.toml", "nowhere.toml", "free-body", "separatrix/1", "x" * 300, "")
ANY = (*TOML, "run", "out", "history", "gates.toml", "judged.csv", "judged.npz", "judged.csv.zip", "part.stl")
ODD = (
    "\x1b[31m",
    "-1",
    "0",
    "nan",
    "inf",
    "1e999",
    "9" * 400,
    "9" * 5000,
    "x",
    "'",
    "a\nb",
    "/dev/null",
    "..",
)
NUMBERS = ("0.05", "0.05,0.02", "0,0.5,1", "1e-3", *ODD)
ENGINES = ("reference:m1", "reference:m1,reference:nothing", "nothing", "reference:", ":m1", ",", *ODD)
PATHS = (*ANY, *ODD, "new", "no/such/place", "mine.toml/x")
COMMANDS: dict[str, tuple[tuple[str, ...], dict[str, tuple[str, ...]]]] = {
    "run": (
        TOML,
        {"--engine": ENGINES, "--dt": NUMBERS, "--tolerance": NUMBERS, "--out": PATHS, "--jobs": ("1", *ODD)}
        | {"--timeout-s": ("5", *ODD), "--resume": PATHS, "--nothing": ODD},
    ),
    "truth": (TOML, {"--at": NUMBERS}),
    "judge": (PATHS, {"--scenario": TOML}),
    "body": (
        (*PATHS, "box", "sphere", "torus", "math:sin"),
        {"--density-kg-m3": NUMBERS, "--size-m": ("1,2,3", *NUMBERS), "--box-m": NUMBERS},
    ),
    "list": (("scenarios", "suites", "measures", *ODD), {}),
    "gate": (
        TOML,
        {"--gates": PATHS, "--run": PATHS, "--junit": PATHS, "--json": (), "--margin": ODD},
    ),
    "compare": (PATHS, {"--html": PATHS, "--markdown": PATHS, "--json": ()}),
    "advise": (TOML, {"--error": NUMBERS, "--measure": ("energy_drift", *ODD), "--run": PATHS}),
    "report": (PATHS, {"--markdown": PATHS}),
    "table": (PATHS, {"--format": ("csv", "json", "md", *ODD), "--columns": ODD, "--parquet": PATHS}),
    "plot": (
        PATHS,
        {"--figure": ("order", "stability", *ODD), "--svg": ("new.svg", *PATHS), "--scenario": TOML},
    ),
    "nightly": (TOML, {"--history": PATHS, "--engine": ENGINES, "--markdown": PATHS, "--timeout-s": ODD}),
    "history list": (PATHS, {}),
    "history query": (PATHS, {}),
    "history prune": (PATHS, {"--keep": ("1", "100", *ODD)}),
}
SOUND = {
    "run": ["mine.toml"],
    "judge": ["judged.csv"],
    "compare": ["run", "run"],
    "report": ["run"],
    "table": ["run"],
    "plot": ["run"],
    "history list": ["history"],
    "history query": ["history", "SELECT run_id FROM nights"],
    "history prune": ["history"],
    "gate": ["mine.toml"],
}
NEEDED = {
    "run": {"--engine": "reference:m1", "--dt": "0.05"},
    "truth": {"--at": "0,1"},
    "judge": {"--scenario": "mine.toml"},
    "body": {"--density-kg-m3": "1000"},
    "gate": {"--gates": "gates.toml", "--run": "run"},
    "advise": {"--error": "1e-3", "--run": "run"},
    "plot": {"--figure": "order", "--svg": "new.svg"},
    "nightly": {"--history": "nowhere/\x00", "--engine": "reference:m1"},
    "history prune": {"--keep": "1"},
}


def drawn(dice: random.Random) -> list[str]:
    """Return one command line; most of its words are valid for the command."""
    command = dice.choice(sorted(COMMANDS))
    arguments, options = COMMANDS[command]
    words = list(SOUND.get(command, ["mine.toml"]))
    if dice.random() < 0.5:
        words[dice.randrange(len(words))] = dice.choice(arguments)
    if dice.random() < 0.1:
        words.append(dice.choice((*arguments, "SELECT", "DROP TABLE nights", "SELECT * FROM results")))
    if dice.random() < 0.05:
        words.pop()
    chosen = dict(NEEDED.get(command, {}))
    if command == "run":
        words.append("--no-speed")
    for option in dice.sample(sorted(options), dice.randint(0, min(2, len(options)))):
        chosen[option] = dice.choice(options[option]) if options[option] else ""
    for option in list(chosen):
        if dice.random() < 0.03:
            del chosen[option]
    line = [*command.split(), *words]
    for option, value in chosen.items():
        line += [option] if option == "--json" else [option, value]
    return [word.replace("\x00", "") for word in line]


def fault_of(words: list[str], done: CompletedProcess[str], before: set[str], after: set[str]) -> str | None:
    """Return what is wrong with the end of a command, or None."""
    allowed = STATUSES - {1, 3} if words[0] in WITHOUT_VERDICT else STATUSES
    if done.returncode not in allowed:
        return f"status {done.returncode}"
    if done.returncode == 2 and not done.stderr.strip():
        return "status 2 without a word"
    wrong = [line for line in done.stderr.split("\n") if len(line) > LONGEST_LINE or not line.isprintable()]
    if wrong:
        return f"a line that is too long or not printable: {wrong[0]!r:.300}"
    if "\x1b" in done.stdout:
        return "an escape sequence on standard output"
    if done.returncode == 2 and after - before - {"bodycheck-runs"}:
        return f"left behind: {after - before}"
    if unfinished := [name for name in after - before if ".partial" in name or "/." in f"/{name}"]:
        return f"unfinished: {unfinished}"
    return None


def main(trials: int = 1000, seed: int = 1) -> bool:
    """Run the trials; return whether one failed."""
    planted = Planted(seed, MAX_MEGABYTES)
    with tempfile.TemporaryDirectory(prefix="command-trials-") as place:
        sound = prepared(Path(place, "sound"))
        for number in range(trials):
            words = drawn(random.Random(f"{seed}/{number}"))
            folder = Path(place, "tried")
            shutil.copytree(sound, folder)
            before = {path.name for path in folder.iterdir()}
            ended = planted.in_child(partial(run_bodycheck, folder, *words), LIMIT_S)
            after = {path.name for path in folder.iterdir()}
            fault = ended.error or fault_of(words, ended.value, before, after)
            printed = "" if ended.value is None else f"\n    {ended.value.stderr[-400:]}"
            ending = "failed" if fault else f"status {ended.value.returncode}"
            planted.add(number, ending, fault and fault + printed, f": {words!r:.500}")
            shutil.rmtree(folder)
    return planted.summed_up("command lines")


def prepared(folder: Path) -> Path:
    """Return a folder with valid and damaged files of every kind."""
    folder.mkdir()
    for name in ("mine.toml", "caf\udce9.toml"):
        (folder / name).write_text(SCENARIO)
    (folder / "bad.toml").write_bytes(any_bytes(SCENARIO.encode(), random.Random(1)))
    (folder / "gates.toml").write_text(GATES)
    run = bodycheck.run([folder / "mine.toml"], engines=["reference:m1", "reference:rk4"], jobs=1)
    bodycheck.write_run(run, folder / "run")
    store_nightly_runs(run, folder / "history", [unchanged, unchanged])
    table = run_bodycheck(folder, "truth", "mine.toml", "--at", "0,0.5,1").stdout
    for name in ("judged.csv", "judged.npz", "judged.csv.zip", "part.stl"):
        (folder / name).write_text(table)
    return folder


if __name__ == "__main__":
    command(main, own_cache=True)
