"""Commands on a real terminal: at any width every line is complete and no cell is lost."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import re
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from bodycheck.cli.commands import app
from bodycheck.cli.options import ADAPTERS, ASK, MEASURE, PROJECT, WATCH
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.summary.cells import overviews, summary_cells
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck

WIDTHS = (60, 80, 120)


def on_terminal(folder: Path, columns: int, code: str) -> str:
    """Return what Python code prints on a pseudo-terminal with this number of columns."""
    reader, writer = pty.openpty()
    fcntl.ioctl(writer, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
    unwanted = ("COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR")
    environment = {name: value for name, value in os.environ.items() if name not in unwanted}
    with subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**environment, "TERM": "xterm-256color"},
        stdin=writer,
        stdout=writer,
        stderr=subprocess.DEVNULL,
    ) as process:
        os.close(writer)
        shown = b""
        while part := _read(reader):
            shown += part
    os.close(reader)
    assert process.returncode == 0
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode()).replace("\r\n", "\n")


def _read(reader: int) -> bytes:
    try:
        return os.read(reader, 65536)
    except OSError:  # the other end is closed
        return b""


def command(*words: str) -> str:
    """Return Python code that runs a command."""
    return f"app({list(words)!r}, standalone_mode=False)"


RELEASES = """
from bodycheck.reports.comparison.release_results import ReleaseFinding
from bodycheck.reports.comparison.release_results import Found, Track, found_document
from bodycheck.reports.document import print_document

versions = tuple(f"3.{k}.0" for k in range(4))
findings = {v: ReleaseFinding(2.0 if v < "3.2" else 4.0, "") for v in versions}
methods = ("euler", "implicitfast", "implicit", "rk4", "discrete@defaults", "implicitfast@defaults")
tracks = tuple(Track(name, findings, (("3.1.0", "3.2.0"),)) for name in methods)
failed = {"3.4.0": "toy==3.4.0 cannot be installed: no wheel for this system"}
print_document(found_document(Found("toy", "free", "order.energy_drift", versions, tracks, failed)))
"""
"""The output of `versions` without a search, which would need a package index."""


@pytest.fixture(scope="module")
def folder(stored_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the runs `run` and `other`, in which many cells are worse."""
    folder = tmp_path_factory.mktemp("console")
    for name in ("run", "other"):
        shutil.copytree(stored_run, folder / name)
    table = folder / "other/results.csv"
    table.write_text(re.sub(r"(,m1,dt,0\.01,.*),ok,", r"\1,failed,", table.read_text()))
    manifest = json.loads((folder / "other/manifest.json").read_text())
    moved = table.read_text().count(",failed,") - manifest["outcomes"]["failed"]
    manifest["outcomes"] |= {
        "ok": manifest["outcomes"]["ok"] - moved,
        "failed": manifest["outcomes"]["failed"] + moved,
    }
    (folder / "other/manifest.json").write_text(json.dumps(manifest))
    shutil.copytree(folder / "run", folder / "parent/run")
    shutil.copytree(folder / "run", folder / "reports/test_it/kept")
    (folder / "parent/bodies").mkdir()
    (folder / "parent/bodies/manifest.json").write_text("{}")  # of an ensemble, which is no run
    (folder / "gates.toml").write_text(
        '[[gate]]\nengine = "reference"\nmeasure = "orientation_error_rad"\nupper = 1e-99\nreason = "any"\n'
    )
    return folder


SUMMARY = """
from pathlib import Path
from bodycheck.reports.document import print_document
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.summary.sentences import run_document
print_document(run_document(read_tables(Path("run"))))
"""
"""The output of `run` at its end."""

SHOWN = {
    "run": SUMMARY,
    "advise": command("advise", "--error", "1e-3", "--run", "run"),
    "compare": command("compare", "run", "other"),
    "versions": RELEASES,
    **{
        f"list {what}": command("list", what)
        for what in ("scenarios", "suites", "engines", "methods", "measures")
    },
    "gate": command("gate", "--gates", "gates.toml", "--run", "run", "--badge", "badge.json"),
    "movie": command("movie", "run", "--scenario", "free", "--svg", "film.svg"),
}


MARK = "=== "
ALL = "from bodycheck.cli.commands import app\n" + "\n".join(
    f"print({MARK + name!r}, flush=True)\n{code}" for name, code in SHOWN.items()
)


def parted(shown: str) -> dict[str, str]:
    """Return the output of each command."""
    return {name: text for name, _, text in (part.partition("\n") for part in shown.split(MARK)[1:])}


@pytest.fixture(scope="module")
def piped(folder: Path) -> dict[str, str]:
    """Return the output of a command that writes to a pipe."""
    words = [sys.executable, "-c", ALL]
    return parted(subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True).stdout)


@pytest.fixture(
    scope="module",
    params=[pytest.param(width, marks=() if width == 80 else pytest.mark.nightly) for width in WIDTHS],
)
def terminal(folder: Path, request: pytest.FixtureRequest) -> tuple[int, dict[str, str]]:
    """Return a width and the output on a terminal of that width."""
    return request.param, parted(on_terminal(folder, request.param, ALL))


HEADS = {"engine:method", "scenario", "reproduce", "toy", "gate"}
"""A row shown as text has no heading for its first cell and no command below it."""


COPIED = ("    bodycheck ", "measured by: bodycheck ", "confirm with: bodycheck ", "use ")
"""The beginnings of lines that users copy and that are therefore never wrapped."""


def words(text: str) -> set[str]:
    """Return the words of a text without the punctuation that the layout adds."""
    return {word.rstrip(";,") for word in text.split()} - HEADS


@pytest.mark.nightly
@pytest.mark.parametrize("what", SHOWN)
def test_every_line_is_complete_at_every_width(
    what: str, piped: dict[str, str], terminal: tuple[int, dict[str, str]]
) -> None:
    """A terminal shows each word that a pipe receives, with whole commands and no line that is too wide."""
    columns, shown = terminal
    lines = shown[what].splitlines()
    assert all(len(line) <= columns for line in lines if not line.startswith(COPIED))
    reproducing = r"bodycheck run \S+ --engine \S+(?: --dt \S+)?"
    assert set(re.findall(reproducing, piped[what])) <= set(re.findall(reproducing, shown[what]))
    found = words(shown[what])
    shortened = [word.split("...") for word in found if "..." in word]
    for word in words(piped[what]) - found:
        assert any(word.startswith(head) and word.endswith(tail) for head, tail in shortened), word


@pytest.mark.slow
def test_the_verdict_of_each_method_is_second_and_whole(
    folder: Path, terminal: tuple[int, dict[str, str]]
) -> None:
    """The verdict is next to the name of the method or directly below it, and each error has its step."""
    lines = terminal[1]["run"].splitlines()
    lines = lines[lines.index("Methods") : lines.index("Worst result of each method")]
    for one in overviews(summary_cells(read_tables(folder / "run"))):
        head, tail = re.escape(one.method[:5]), re.escape(one.method[-5:])
        (place,) = [k for k, line in enumerate(lines) if re.match(rf"{head}\S*{tail}( |$)", line)]
        rest = " ".join([lines[place].partition(" ")[2], *lines[place + 1 : place + 4]]).split()
        first = rest[1] if rest[0] == "verdict" else rest[0]
        assert first.rstrip(",;") == STATES[next(iter(one.states))].word.split()[0]
        if one.largest_error[0]:
            error, step = one.largest_error[0], one.largest_error[1].split()[1].rstrip(",")
            assert error in [word.rstrip(";") for word in rest]
            assert any(word.rstrip(",") == step for word in rest)


@pytest.mark.slow
def test_colour_is_off_where_no_color_is_set(folder: Path) -> None:
    """With NO_COLOR set no colour code is sent to a terminal."""
    coloured = subprocess.run(
        [sys.executable, "-c", SUMMARY],
        cwd=folder,
        env={**os.environ, "FORCE_COLOR": "1", "TERM": "xterm"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert re.search(r"\x1b\[[0-9;]*3[0-7]m", coloured)
    plain = subprocess.run(
        [sys.executable, "-c", SUMMARY],
        cwd=folder,
        env={**os.environ, "FORCE_COLOR": "1", "TERM": "xterm", "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert not re.search(r"\x1b\[[0-9;]*3[0-7]m", plain)


ANSWERS = {
    "compare": (("compare", "run", "other"), {"before", "after", "sentences", "changes"}),
    "advise": (("advise", "--error", "1e-3", "--run", "run"), {"error", "measure", "run", "answers"}),
    "doctor": (("doctor",), {"versions", "caches", "checks"}),
    "truth": (("truth", "free-flight", "--at", "0,1"), None),
    "list": (("list", "suites"), None),
    "environments": (("environments", "list"), None),
    "body": (("body", "sphere", "--size-m", "1", "--density-kg-m3", "1"), {"body", "solid"}),
}


@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_as_json_is_json_alone(name: str, folder: Path) -> None:
    """Standard output is valid JSON and contains the result of the command."""
    requested, keys = ANSWERS[name]
    done = run_bodycheck(folder, *requested, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert isinstance(found, list) if keys is None else keys <= found.keys()


@pytest.mark.slow
def test_a_quiet_run_has_nothing_on_standard_error(folder: Path) -> None:
    """Standard error is empty; standard output has verdicts, errors and report path, also with --json."""
    requested = (
        "run",
        "free-flight",
        "--engine",
        "reference:m1",
        "--dt",
        "0.01",
        "--no-speed",
        "--out",
        "new",
    )
    done = run_bodycheck(folder, *requested, "--quiet", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert found["report"] == "new/report.html"
    assert found["methods"]["reference:m1"]["free-flight"]["at"] == "dt 0.01 s"


SUGGESTED = {
    "engine": ("run", "free-flight", "--engine", "mujco"),
    "method": ("run", "free-flight", "--engine", "reference:splitting"),
    "suite": ("run", "standrad"),
    "figure": ("plot", "run", "--figure", "work-precison", "--svg", "a.svg"),
    "measure": ("advise", "--error", "1", "--measure", "energy-drfit", "--run", "run"),
    "column": ("table", "run", "--columns", "scenrio"),
    "command": ("comapre", "run", "other"),
    "run": ("compare", "run", "othre"),
    "parent": ("explain", "parent"),
    "grandparent": ("explain", "reports"),
    "file": ("judge", "motoin.csv", "--inertia-kg-m2", "1,2,3"),
    "listed": ("list", "methods", "--engine", "mujco"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", SUGGESTED)
def test_a_misspelt_name_is_suggested(what: str, folder: Path, expected_message: ExpectedMessage) -> None:
    """A misspelt name gives status 2 and a message with the nearest valid name."""
    (folder / "motion.csv").touch()
    done = run_bodycheck(folder, *SUGGESTED[what])
    assert (done.returncode, done.stdout) == (2, "")
    expected_message(done.stderr.strip())


COMPLETED = {
    "run inter": "intermediate-axis",
    "run free-flight --engine muj": "mujoco",
    "run free-flight --engine dart,reference:splitting": "dart,reference:splitting6",
    "truth free-fl": "free-flight",
    "list meth": "methods",
    "run free-flight --dt 0.1 --dt 0.2 --engine muj": "mujoco",
}


@pytest.mark.slow
@pytest.mark.nightly(after=2)
@pytest.mark.parametrize("typed", COMPLETED)
def test_names_are_completed(typed: str, folder: Path) -> None:
    """Bash completion offers scenarios, engines and the methods of an engine."""
    line = f"bodycheck {typed}"
    done = subprocess.run(
        [sys.executable, "-m", "bodycheck"],
        cwd=folder,
        env={
            **os.environ,
            "_BODYCHECK_COMPLETE": "complete_bash",
            "COMP_WORDS": line,
            "COMP_CWORD": str(len(line.split()) - 1),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert COMPLETED[typed] in done.stdout.split()


def test_the_bare_command_names_three_to_begin_with(folder: Path) -> None:
    """Each of its commands exists, and its lines fit into 80 columns."""
    done = run_bodycheck(folder)
    assert done.returncode == 0
    named = re.findall(r"^  bodycheck (\w+)", done.stdout, flags=re.MULTILINE)
    assert len(named) == len({*named} & {*get_command(app).commands}) == 3
    assert max(map(len, done.stdout.splitlines())) <= 80


@pytest.mark.slow
def test_lists_are_filtered_by_engine_and_by_text(folder: Path) -> None:
    """Only lines of these engines or methods, or with this text, are printed."""
    done = run_bodycheck(folder, "list", "methods", "--engine", "reference:m1,rapier", "--json")
    engines = [entry["name"].split(":")[0] for entry in json.loads(done.stdout)]
    assert engines.count("reference") == 1
    assert {*engines} == {"reference", "rapier"}
    assert run_bodycheck(folder, "list", "scenarios", "--match", "NOTHING OF THIS").stdout == "none matches\n"
    found = json.loads(run_bodycheck(folder, "list", "suites", "--match", "tumbling", "--json").stdout)
    assert {"standard", "full"} <= {entry["name"] for entry in found}


def test_every_command_is_in_a_named_group_of_the_help() -> None:
    """Each option and command is in a named group of the help."""
    commands: Any = get_command(app)
    groups = {command.rich_help_panel for command in commands.commands.values()}
    assert groups == {MEASURE, ASK, WATCH, ADAPTERS, PROJECT}


def test_help_has_groups_and_examples(folder: Path) -> None:
    """The help shows commands and options in groups, and one example per line."""
    commands = run_bodycheck(folder, "--help").stdout
    for group in ("Measure:", "Query stored runs:", "Detect changes:"):
        assert group in commands.splitlines()
    options = run_bodycheck(folder, "run", "--help").stdout.splitlines()
    for group in ("Arguments:", "What to run:", "How to run:", "Output:", "Examples:"):
        assert group in options
    assert "  bodycheck run --resume first" in options
