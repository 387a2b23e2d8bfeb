"""A run that was stopped in any way can be resumed and gives the same results as an uninterrupted run."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pytest
from typer.testing import CliRunner

from bodycheck._util.errors import InputError
from bodycheck.cli import commands
from bodycheck.reports.cache.journal import Journal
from bodycheck.runs import directory
from bodycheck.runs.directory import resume, run_to_folder
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import no_progress
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.scenario_texts import SCENARIO, comparable_tables, tumbling
from tests.helpers.worker_processes import all_gone, workers_of

ROOT = Path(__file__).parents[1]
PATIENCE_S = 600.0
"""A command that takes longer is assumed to hang; the machine may be busy and kernels may need compiling."""
STEPS = ["--dt", "0.05,0.02,0.01"]


def hanging(kind: str = "sleep") -> list[str]:
    """Return the arguments of a run in which an engine hangs in one case."""
    return [
        "run",
        "mine.toml",
        "--engine",
        f"misbehaving:{kind},reference:m1",
        *STEPS,
        "--no-speed",
        "--fresh",
    ]


Command = Callable[..., "subprocess.Popen[str]"]


def heed_interrupts() -> None:
    """Let Ctrl-C end the process, because a shell starts background jobs with Ctrl-C ignored."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def commands_in(folder: Path) -> Iterator[Command]:
    """Yield a function that starts commands in a folder with a scenario and a plug-in engine."""
    (folder / "mine.toml").write_text(SCENARIO)
    package = folder / "package"
    facts = package / "misbehaving-1.0.dist-info"
    facts.mkdir(parents=True)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: misbehaving\nVersion: 1.0\n")
    engine = "misbehaving = misbehaving_engine:Misbehaving"
    (facts / "entry_points.txt").write_text(f"[bodycheck.adapters]\n{engine}\n")
    shutil.copy(ROOT / "tests/helpers/misbehaving_engine.py", package)
    path = os.pathsep.join([str(package), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    started: list[subprocess.Popen[str]] = []

    def start(*words: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "bodycheck", *words],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=heed_interrupts,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def command(tmp_path: Path) -> Iterator[Command]:
    """Return a function that starts commands in the test's folder."""
    with commands_in(tmp_path) as start:
        yield start


class Whole(NamedTuple):
    """The tables of an uninterrupted run with one hanging case, and the number of lines of its journal."""

    tables: dict[str, pd.DataFrame]
    answers: int


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """Run to the end without an interruption."""
    folder = tmp_path_factory.mktemp("whole")
    with commands_in(folder) as start:
        process = start(*hanging(), "--timeout-s", "5", "--out", "out")
        answered(process, folder, 1)
        os.link(folder / "out.partial/journal", folder / "kept")
        assert finished(process)[0] == 0
    return Whole(comparable_tables(folder / "out"), (folder / "kept").read_bytes().count(b"\n"))


def finished(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Return the status of a command and its last line on standard error; no worker may survive it."""
    _, errors = process.communicate(timeout=PATIENCE_S)
    assert "Traceback" not in errors
    assert all_gone(process.pid)
    return process.returncode, (errors.splitlines() or [""])[-1]


def answered(process: subprocess.Popen[str], folder: Path, count: int, what: bytes = b"\n") -> None:
    """Wait until the journal of a running run has `what` this many times; each line is an answer."""
    journal = folder / "out.partial/journal"
    while not journal.exists() or journal.read_bytes().count(what) < count:
        assert process.poll() is None
        time.sleep(0.01)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("blow", "status"),
    [
        (signal.SIGINT, 130),
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.nightly),
        pytest.param(signal.SIGKILL, -9, marks=pytest.mark.nightly),
    ],
    ids=str,
)
def test_stopped_run_continues_to_the_same_tables(
    blow: signal.Signals, status: int, command: Command, tmp_path: Path, whole: Whole
) -> None:
    """A hanging engine ends with the run, and stored answers are not computed again."""
    stopped = command(*hanging(), "--timeout-s", "5", "--out", "out")
    answered(stopped, tmp_path, whole.answers // 2)  # one engine hangs, the other answers
    assert workers_of(stopped.pid)
    stopped.send_signal(blow)
    ended = finished(stopped)
    assert ended[0] == status
    if blow != signal.SIGKILL:
        assert ended[1] == "stopped; continue with: bodycheck run --resume out"
    assert not (tmp_path / "out").exists()
    stored = (tmp_path / "out.partial/journal").read_bytes()
    os.link(tmp_path / "out.partial/journal", tmp_path / "kept")
    assert finished(command("run", "--resume", "out"))[0] == 0
    kept = (tmp_path / "kept").read_bytes()
    assert kept.startswith(stored)
    assert kept.count(b"\n") == whole.answers
    for name, table in whole.tables.items():
        pd.testing.assert_frame_equal(comparable_tables(tmp_path / "out")[name], table)
    assert not (tmp_path / "out.partial").exists()
    assert whole.tables["results"]["outcome"].tolist() == ["ok", "ok", "timeout", "ok", "ok", "ok"]


@pytest.mark.nightly
def test_killed_run_leaves_no_engine(command: Command, tmp_path: Path, whole: Whole) -> None:
    """An engine that never releases the interpreter's lock is ended too."""
    killed = command(*hanging("c-loop"), "--out", "out")
    answered(killed, tmp_path, whole.answers - 1)
    assert workers_of(killed.pid)
    killed.kill()
    assert finished(killed)[0] == -signal.SIGKILL


@pytest.mark.nightly
def test_second_process_on_the_same_run_is_refused(command: Command, tmp_path: Path, whole: Whole) -> None:
    """Resuming or starting it gives one line and status 2, and does not disturb the first process."""
    first = command(*hanging(), "--timeout-s", "5", "--out", "out")
    answered(first, tmp_path, whole.answers // 2)
    first.send_signal(signal.SIGSTOP)  # stopped, so that it cannot finish before the other commands
    status, words = finished(command("run", "--resume", "out"))
    assert status == 2
    assert words.startswith("out.partial/journal: another process is using this run")
    status, words = finished(command(*hanging(), "--out", "out"))
    assert status == 2
    assert words.startswith("out.partial: holds an interrupted run; continue with --resume out")
    first.send_signal(signal.SIGCONT)
    assert finished(first)[0] == 0
    assert finished(command("run", "--resume", "out")) == (2, "--resume out: that run is complete")


@pytest.mark.slow
def test_run_that_cannot_be_resumed_is_refused(command: Command, tmp_path: Path) -> None:
    """A missing run, a damaged request and additional options give one line each; nothing is written."""
    assert finished(command("run", "--resume", "out")) == (2, "--resume out: there is no interrupted run")
    status, words = finished(command("run", "mine.toml", "--resume", "out"))
    assert status == 2
    assert words == "--resume: continues a run with its original settings; SCENARIOS does not apply"
    (tmp_path / "out.partial").mkdir()
    (tmp_path / "out.partial/request.json").write_text('{"request": {')
    status, words = finished(command("run", "--resume", "out"))
    assert status == 2
    assert words.startswith("--resume out: out.partial/request.json: is not JSON: ")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.toml", "out.partial", "package"]


@pytest.mark.slow
def test_run_whose_scenario_has_changed_is_not_continued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """Its results would be of two definitions under one name."""
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(tumbling(steps_s=[0.05]))

    def stopped(*_: object, **__: object) -> None:
        raise InputError("the disk is full")

    request = Request(scenarios=["mine.toml"], engines=["reference:m1"], speed=False)
    with monkeypatch.context() as patched:
        patched.setattr(Journal, "is_empty", False)
        patched.setattr(directory, "run_selection", stopped)
        with pytest.raises(InputError):
            run_to_folder(request, Path("out"), no_progress)
    text = Path("mine.toml").read_text()
    Path("mine.toml").write_text(text + "\n# a comment changes nothing\n")
    with monkeypatch.context() as patched:
        patched.setattr(Journal, "is_empty", False)
        patched.setattr(directory, "run_selection", stopped)
        with pytest.raises(InputError, match="the disk is full"):
            resume(Path("out"), no_progress)
    Path("mine.toml").write_text(tumbling(steps_s=[0.05], omega_body_rad_s=[0.3, 1.0, 0.2]))
    with expected_message.raises(InputError):
        resume(Path("out"), no_progress)
    assert Path("out.partial").exists()


@pytest.mark.slow
def test_run_with_wrong_input_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A function that fails while the truth is computed leaves no folder that could be resumed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(
        SCENARIO + '[[forcing]]\nkind = "callable"\nfunction = "math:hypot"\n'
    )
    words = ["run", "mine.toml", "--engine", "mujoco:rk4", "--no-speed", "--allow-code", "--out", "out"]
    for _ in range(2):  # the first run must leave nothing that changes the second
        done = CliRunner().invoke(commands.app, words)
        assert isinstance(done.exception, InputError)
        assert str(done.exception).startswith("mine.toml: math:hypot: failed at t = 0.0 s: TypeError")
        assert "continue with" not in str(done.exception)
        assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


@pytest.mark.slow
def test_folder_without_a_request_is_replaced(command: Command, tmp_path: Path) -> None:
    """A run killed before it wrote its request has no results, so a new run may use its folder."""
    (tmp_path / "out.partial").mkdir()
    (tmp_path / "out.partial/.request.json-killed").write_text("{")
    words = ["run", "mine.toml", "--engine", "reference:m1", "--dt", "0.05", "--no-speed", "--out", "out"]
    assert finished(command(*words))[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.toml", "out", "package"]


@pytest.mark.nightly
def test_speeds_of_a_killed_run_stem_from_one_sitting(command: Command, tmp_path: Path) -> None:
    """All are measured again unless all were measured; the motions are those before the interruption."""
    words = ["run", "mine.toml", "--engine", "reference:m1,reference:rk4,misbehaving:nan", *STEPS]
    stopped = command(*words, "--out", "out")
    answered(stopped, tmp_path, 9, b"trajectory")
    stopped.kill()
    finished(stopped)
    journal = tmp_path / "out.partial/journal"
    assert b"own_s" not in journal.read_bytes()
    assert finished(command("run", "--resume", "out"))[0] == 0
    assert len(pd.read_csv(tmp_path / "out/results.csv")["cpu_s"].dropna()) == 8


@pytest.mark.slow
@pytest.mark.nightly
def test_answers_of_other_packages_are_reused_on_request(command: Command, tmp_path: Path) -> None:
    """Answers are stored until the package's code changes, and are used only with --reuse."""
    kinds = "misbehaving:abort,misbehaving:raw-flood,misbehaving:nan"
    words = ["run", "mine.toml", "--engine", kinds, *STEPS, "--no-speed"]
    module = tmp_path / "package/misbehaving_engine.py"
    build = "simulation = _stepper("
    requested = f"open({str(tmp_path / 'requested')!r}, 'a').write('.')\n        {build}"
    assert build in module.read_text()
    module.write_text(module.read_text().replace(build, requested))

    def times_asked(*options: str, out: str) -> int:
        (tmp_path / "requested").write_text("")
        assert finished(command(*words, *options, "--out", out))[0] == 0
        outcomes = comparable_tables(tmp_path / out)["results"]["outcome"].tolist()
        assert outcomes == ["ok", "ok", "failed", "ok", "ok", "ok", "ok", "ok", "unstable"]
        return len((tmp_path / "requested").read_text())

    every_time = times_asked(out="a")
    assert every_time > 8
    assert times_asked("--reuse", out="b") in (1, 2)  # a crash is repeated if the worker had run other cases
    assert times_asked("--fresh", out="c") == times_asked(out="f") == every_time
    module.write_text(module.read_text() + "\n# another version of the code\n")
    assert times_asked("--reuse", out="d") == every_time
    for out in "bcdf":
        for name, table in comparable_tables(tmp_path / "a").items():
            same, first = (
                t.drop(columns=["reused", "build"], errors="ignore")
                for t in (comparable_tables(tmp_path / out)[name], table)
            )
            pd.testing.assert_frame_equal(same, first)
    reused = {
        out: comparable_tables(tmp_path / out)["results"]["reused"].tolist().count("True") for out in "abcdf"
    }
    assert reused == {"a": 0, "b": 8, "c": 0, "d": 0, "f": 0}


@pytest.mark.nightly
def test_fault_trials_find_no_fault(tmp_path: Path) -> None:
    """Three trials of tools/fault_trials.py, each with another fault, pass."""
    script = Path(__file__).parents[1] / "tools/fault_trials.py"
    done = subprocess.run(
        [sys.executable, str(script), "--trials", "3", "--seed", "7"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"^0 failed$", done.stdout, flags=re.MULTILINE)
