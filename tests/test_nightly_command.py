"""The commands `nightly` and `history`: exit status, output and files."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from bodycheck._util.errors import InputError, StoppedError
from bodycheck.adapters.contract import Method, Reading, Simulation
from bodycheck.adapters.dart import Dart
from bodycheck.adapters.dart_tree import DartTree
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import registered
from bodycheck.cli import commands
from bodycheck.reference_impl.rotations import quaternion_product
from bodycheck.reference_impl.scene import Scene
from bodycheck.reports.document import Document, Sentence, markdown
from bodycheck.runs.request import TIMEOUT_S
from tests.helpers import my_integrator
from tests.helpers.scenario_texts import SCENARIO, tumbling
from tests.helpers.weakened_engine import Weakened

_SCENARIO = SCENARIO.replace("mine", "tumble")


class TurnedSimulation:
    """A simulation whose orientations are read as rotated by an angle about the body's x axis."""

    def __init__(self, sound: Simulation, angle_rad: float) -> None:
        self._sound, self._angle_rad = sound, angle_rad
        self.stepping = sound.stepping
        self.read_back, self.reset, self.apply = sound.read_back, sound.reset, sound.apply
        self.advance, self.close = sound.advance, sound.close

    def read(self) -> Reading:
        """Return the rotated state."""
        reading, half = self._sound.read(), 0.5 * self._angle_rad
        turn = np.array([np.cos(half), np.sin(half), 0.0, 0.0])
        return replace(reading, quaternion=quaternion_product(reading.quaternion, turn))


class Turned:
    """The reference under another name, with a small rotation that may change between nightly runs."""

    name = "turned"
    version = "1"

    def __init__(self, angle_rad: float) -> None:
        self._sound, self._angle_rad = Reference(), angle_rad
        self.methods: Mapping[str, Method] = {"m1": self._sound.methods["m1"]}

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Support every scene."""
        del scene, method
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> TurnedSimulation:
        """Build a simulation of the reference and rotate its readings."""
        return TurnedSimulation(cast(Simulation, self._sound.build(scene, method, dt_s)), self._angle_rad)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to an empty folder with a scenario."""
    (tmp_path / "tumble.toml").write_text(_SCENARIO)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def bodycheck(*words: str | Path) -> Result:
    """Run `bodycheck words` in this process and return its result."""
    return CliRunner().invoke(commands.app, list(map(str, words)))


def run(*words: str, angle_rad: float = 0.0) -> Result:
    """Return the result of a nightly run of the rotated engine."""
    with registered(Turned(angle_rad)):
        return bodycheck(
            "nightly", "tumble.toml", "--engine", "turned", "--history", "kept", "--no-speed", *words
        )


@pytest.mark.nightly
def test_nightly_run_fails_on_a_regression(folder: Path) -> None:
    """The status is 3 without a baseline, 0 without a regression, and 1 if an orientation is worse."""
    first, second, moved = run(), run(), run(angle_rad=1e-9)
    third, fourth = run("--markdown", "changes.md", angle_rad=1e-2), run()
    assert [done.exit_code for done in (first, second, moved, third, fourth)] == [3, 0, 0, 1, 0], third.output
    assert first.stdout.startswith("First nightly run: ")
    assert "Nothing changed" in second.stdout
    assert "turned:m1: law permute holds -> broken." in moved.stdout
    assert fourth.stdout.startswith("No regression; turned:m1 back at its level.")
    assert "turned:m1: back at its level in tumble; it was worse since" in fourth.stdout
    reported = (folder / "changes.md").read_text()
    assert third.stdout.startswith("turned:m1: ")
    for text in (third.stdout, reported):
        assert "error at" in text
        assert "turned:m1" in text
        assert "tumble" in text
    assert Path(third.stdout.splitlines()[-1]).read_text().startswith("<!doctype html>")
    assert len(reported.splitlines()) < 60


@pytest.mark.nightly
def test_broken_engine_stays_a_regression_until_accepted(folder: Path) -> None:
    """The first line names method, quantity, factor and cause; the command that it prints accepts it."""

    def night(factor: float, *words: str) -> Result:
        with registered(Weakened(factor)):
            steps = ["nightly", "tumble.toml", "--engine", "weakened", "--history", "kept", "--no-speed"]
            return bodycheck(*steps, *words)

    (folder / "tumble.toml").write_text(
        tumbling("tumble", omega_body_rad_s=(0.3, 4.0, -0.2), steps_s=[0.05, 0.02, 0.01, 0.005])
    )
    files = "--junit", "night.xml", "--markdown", "night.md"
    sound, broken, still = night(1.0), night(0.9, *files, "--github"), night(0.9)
    old_way = night(0.9, "--fail-on", "newly-worse")
    assert [done.exit_code for done in (sound, broken, still, old_way)] == [3, 1, 1, 0]
    line = broken.stdout.splitlines()[0]
    assert line == (
        "weakened:euler: no longer converges, error at dt 0.005 s x 50 in tumble (the gyroscopic term "
        "omega x I omega is multiplied by 0.9, explains all of the error)"
    )
    assert re.fullmatch(
        rf"Still worse since \d{{4}}-\d\d-\d\d \(2 nightly runs\): {re.escape(line)}",
        still.stdout.splitlines()[0],
    )
    assert "improved" not in broken.stdout
    (page,) = (Path(line).read_text() for line in broken.stdout.splitlines() if line.endswith("night.html"))
    assert f"::error title=bodycheck nightly::{line}" in broken.stdout
    for text in (page, (folder / "night.xml").read_text(), (folder / "night.md").read_text(), broken.stdout):
        assert line in text
    assert '<h1 class="tint-bad">weakened:euler: no longer converges in tumble</h1>' in page
    (command,) = re.findall("^To accept it: bodycheck (.*) --reason TEXT$", still.stdout, re.MULTILINE)
    assert bodycheck(*command.split(), "--reason", "as meant", "--author", "Ada").exit_code == 0
    accepted = night(0.9)
    assert accepted.exit_code == 0, accepted.stdout
    assert "by Ada: as meant" in accepted.stdout
    assert line in (folder / "kept" / "feed.xml").read_text()


@pytest.mark.nightly
def test_a_users_function_that_became_worse_has_its_cause(folder: Path) -> None:
    """Nobody states its order, so that no verdict counts against it; `explain` of the run names it too."""
    sound = "(k1 + 2.0 * k2 + 2.0 * k3 + k4)"
    text = Path(my_integrator.__file__).read_text()
    assert sound in text

    def answer(*words: str) -> tuple[int, str]:
        done = subprocess.run(
            [sys.executable, "-m", "bodycheck", *words], capture_output=True, text=True, check=False
        )
        return done.returncode, done.stdout.splitlines()[0]

    def night(weighted: str) -> tuple[int, str]:
        (folder / "mine.py").write_text(text.replace(sound, weighted))
        named = ("--engine", "mine:step", "--allow-code", "--no-speed", "--history", "kept")
        return answer("nightly", "tumble.toml", *named)

    assert night(sound)[0] == 3
    for _ in range(2):  # the regression stays open
        status, first = night("(k1 + 3.0 * k2 + k3 + k4)")
        assert status == 1
        assert "the weights of the stages are 0.16667, 0.5, 0.16667 and 0.16667" in first
    newest = max(path for path in (folder / "kept").glob("2*"))
    assert "0.16667, 0.5, 0.16667" in answer("explain", str(newest), "--allow-code")[1]
    assert night(sound) == (0, "No regression; mine:step back at its level.")


class FasterTree(DartTree):
    """A tree whose steps are 1 % too long."""

    def _step(self, dt_s: float) -> None:
        super()._step(1.01 * dt_s)


class Trees(Dart):
    """DART under another name, with a model of trees that may change between nightly runs."""

    name = "trees"
    tree_model = DartTree

    def __init__(self, model: type[DartTree]) -> None:
        self.tree_model = model


@pytest.mark.nightly
@pytest.mark.usefixtures("folder")
def test_a_tree_that_moves_otherwise_is_a_regression_with_its_cause() -> None:
    """The first line names the method, the tree and the fault; the regression ends with the fault."""

    def night(model: type[DartTree]) -> Result:
        with registered(Trees(model)):
            return bodycheck("nightly", "free-chain", "--engine", "trees", "--history", "kept", "--no-speed")

    first, broken, sound = night(DartTree), night(FasterTree), night(DartTree)
    assert [done.exit_code for done in (first, broken, sound)] == [3, 1, 0], broken.output
    line = broken.stdout.splitlines()[0]
    assert line.startswith("trees:semi-implicit: ")
    for text in ("free-chain", "1.01"):
        assert text in line
    assert "trees:semi-implicit: back at its level" in sound.stdout


@pytest.mark.nightly
def test_history_is_listed_queried_and_pruned(folder: Path) -> None:
    """`list` prints one line per run, `query` a CSV of the result, and `prune` the names of removed runs."""
    run(), run()
    listed = bodycheck("history", "list", "kept")
    heads, *lines, engines, machine = listed.stdout.splitlines()
    assert heads.split() == ["run", "status", "changes", "cases"]
    assert [line.split()[1:-1] for line in lines] == [
        ["insufficient", "history", "none"],
        ["no", "regression", "none"],
    ]
    assert engines == "Engines: turned 1"
    assert machine.startswith("Machine: ")
    queried = bodycheck("history", "query", "kept", "SELECT count(*) AS nights FROM nights")
    assert queried.stdout.split() == ["nights", "2"]
    oldest = min(path.name for path in (folder / "kept").glob("2*"))
    assert bodycheck("history", "prune", "kept", "--keep", "1").stdout.split() == [oldest]
    assert len(bodycheck("history", "list", "kept").stdout.splitlines()) == 4


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (("nightly", "absent", "--history", "kept"), "absent"),
        (("nightly", "tumble.toml", "--engine", "absent", "--history", "kept"), "absent"),
        (("nightly", "--history", "tumble.toml"), "cannot be written"),
        (("nightly", "tumble.toml", "--history", "kept", "--threshold", "-1"), "--threshold -1.0: must be"),
        (("nightly", "tumble.toml", "--history", "kept", "--thresholds", "absent.toml"), "absent.toml"),
        (("nightly", "tumble.toml"), "--history: required"),
        (("nightly", "tumble.toml", "--out", "x"), "--out: requires --shard"),
        (("nightly", "tumble.toml", "--shard", "1/2"), "--shard 1/2: requires --out"),
        (("history", "list", "kept"), "no nightly runs"),
        (("history", "query", "absent", "SELECT 1"), "no nightly runs"),
    ],
)
def test_wrong_input_is_refused_in_one_line(folder: Path, words: tuple[str, ...], reported: str) -> None:
    """Invalid input is refused before anything is run or stored."""
    done = bodycheck(*words)
    assert isinstance(done.exception, InputError)
    assert reported in str(done.exception)
    assert "\n" not in str(done.exception)
    assert not (folder / "kept").exists()


@pytest.mark.nightly
def test_interrupted_nightly_run_is_resumed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C prints the command that continues the run, and leaves the history unchanged."""

    def stopped(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("bodycheck.runs.runner.compile_kernels", stopped)
        done = run()
    assert isinstance(done.exception, StoppedError)
    command = str(done.exception).removeprefix("stopped; continue with: bodycheck ")
    assert command == "nightly --history kept --resume"
    assert not list(folder.glob("kept/2*Z-??????"))
    with registered(Turned(0.0)):
        refused = bodycheck(*command.split(), "--engine", "turned")
        assert "does not apply" in str(refused.exception)
        resumed = bodycheck(*command.split())
    assert resumed.exit_code == 3, resumed.output
    assert len(list(folder.glob("kept/2*"))) == 1


REQUESTS: dict[str, tuple[list[str], dict[str, Any]]] = {
    "nothing": (
        [],
        {
            "scenarios": ["standard"],
            "engines": None,
            "speed": True,
            "jobs": None,
            "timeout_s": TIMEOUT_S,
            "fresh": True,
            "shard": None,
            "speed_passes": 10,
            "allow_code": False,
        },
    ),
    "scenarios": (["tumble.toml", "smoke"], {"scenarios": ["tumble.toml", "smoke"]}),
    "engines": (["--engine", "mujoco,reference:m1"], {"engines": ["mujoco", "reference:m1"]}),
    "no speed": (["--no-speed"], {"speed": False}),
    "jobs": (["--jobs", "3"], {"jobs": 3}),
    "timeout": (["--timeout-s", "7.5"], {"timeout_s": 7.5}),
    "code": (["--allow-code"], {"allow_code": True}),
    "quiet": (["--quiet"], {}),
}


class RequestedError(Exception):
    """Ends a nightly run before it starts and stores the request."""


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("what", REQUESTS)
def test_nightly_run_does_what_the_options_request(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each option reaches the run, and all others keep their defaults."""

    def ended(*requested: object) -> None:
        raise RequestedError(*requested)

    monkeypatch.setattr("bodycheck.runs.nightly_run.run_nightly", ended)
    monkeypatch.setattr("bodycheck.cli.nightly.progress_of", lambda *, quiet: f"quiet: {quiet}")
    words, changed = REQUESTS[what]
    done = bodycheck("nightly", *words, "--history", "kept", "--threshold", "0.25")
    assert isinstance(done.exception, RequestedError), done.output
    requested_run, history, watching, thresholds = done.exception.args
    expected = {**REQUESTS["nothing"][1], **changed}
    assert {name: getattr(requested_run, name) for name in expected} == expected
    assert (history, thresholds.default) == (Path("kept"), 0.25)
    assert watching == f"quiet: {what == 'quiet'}"


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("words", [[], ["--quiet"]])
def test_a_resumed_nightly_run_shows_progress_unless_quiet(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its other settings are those of the interrupted run."""

    def ended(*requested: object, allow_code: bool) -> None:
        raise RequestedError(*requested, allow_code)

    monkeypatch.setattr("bodycheck.runs.nightly_run.resume_nightly", ended)
    monkeypatch.setattr("bodycheck.cli.nightly.progress_of", lambda *, quiet: f"quiet: {quiet}")
    done = bodycheck("nightly", "--history", "kept", "--resume", *words)
    assert isinstance(done.exception, RequestedError), done.output
    history, watching, _, allow_code = done.exception.args
    assert (history, watching, allow_code) == (Path("kept"), f"quiet: {bool(words)}", False)


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("words", [[], ["--quiet"]])
def test_shard_of_a_nightly_run_is_stored_in_its_own_folder(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shard runs with the same settings and prints the path of its report; `merge` judges the shards."""
    requested: list[tuple[Any, ...]] = []

    def run(*request: object) -> tuple[None, Path]:
        requested.append(request)
        return None, Path("part/report.html")

    monkeypatch.setattr("bodycheck.runs.directory.run_to_folder", run)
    monkeypatch.setattr("bodycheck.cli.nightly.progress_of", lambda *, quiet: f"quiet: {quiet}")
    done = bodycheck("nightly", "tumble.toml", "--shard", "1/2", "--out", "part", *words)
    assert (done.exit_code, done.stdout) == (0, "part/report.html\n"), done.output
    ((requested_run, part, watching),) = requested
    expected = {**REQUESTS["nothing"][1], "scenarios": ["tumble.toml"], "shard": "1/2"}
    assert {name: getattr(requested_run, name) for name in expected} == expected
    assert (part, watching) == (Path("part"), f"quiet: {bool(words)}")


@pytest.mark.parametrize("as_json", [False, True])
@pytest.mark.parametrize(
    ("status", "code"),
    [("no regression", 0), ("regression", 1), ("nothing measured", 1), ("insufficient history", 3)],
)
def test_status_and_files_are_those_of_the_judgement(
    status: str, code: int, as_json: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last line is the path of the page, and each file has the format of its option and valid links."""
    run = folder / "kept" / "a night"
    run.mkdir(parents=True)
    judged = SimpleNamespace(status=status)
    module = "bodycheck.reports.history.history_output"
    monkeypatch.setattr("bodycheck.runs.nightly_run.run_nightly", lambda *_: (judged, run))
    monkeypatch.setattr(f"{module}.nightly_document", lambda of: Document(of.status, (Sentence("Done."),)))
    monkeypatch.setattr(f"{module}.nightly_data", lambda of: {"status": of.status})
    monkeypatch.setattr(f"{module}.nightly_page", lambda of, place: f"{of.status}: {place}report.html")
    (folder / "public").mkdir()
    files = ("--html", "public/page.html", "--markdown", "changes.md")
    done = bodycheck("nightly", "--history", "kept", *files, *(["--json"] if as_json else []))
    assert done.exit_code == code, done.output
    data = {"status": status, "folder": str(run)}
    if as_json:
        assert json.loads(done.stdout) == data
    else:
        assert "Done." in done.stdout
        assert done.stdout.splitlines()[-1] == str(run / "night.html")
    assert (folder / "public/page.html").read_text() == f"{status}: ../kept/a night/report.html"
    assert (folder / "changes.md").read_text() == markdown(Document(status, (Sentence("Done."),)))


@pytest.mark.usefixtures("folder")
def test_pruning_reports_a_run_of_the_future_apart_from_the_removed_ones(folder: Path) -> None:
    """Standard output has only the removed names, so that a script can read them."""
    names = ["20260101T000000Z-000001", "20260102T000000Z-000002", "29990101T000000Z-000003"]
    for name in names:
        (folder / "kept" / name).mkdir(parents=True)
    done = bodycheck("history", "prune", "kept", "--keep", "1")
    assert (done.exit_code, done.stdout.split()) == (0, names[:1])
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{Path('kept', names[2])}: is dated in the future")
    assert sorted(path.name for path in (folder / "kept").glob("2*")) == names[1:]
    refused = bodycheck("history", "prune", "kept", "--keep", "0")
    assert str(refused.exception) == "--keep 0: must be 1 or more"
    assert sorted(path.name for path in (folder / "kept").glob("2*")) == names[1:]


@pytest.mark.parametrize("name", ["list", "query", "prune"])
def test_help_of_a_history_command_names_its_folder(name: str) -> None:
    """The help shows the folder as a required argument in capitals; the group's help lists the command."""
    reported = bodycheck("history", name, "--help").stdout
    assert f"history {name} [OPTIONS] {{HISTORY}}" in reported
    assert "Folder of a history." in reported
    assert bodycheck("history").output == bodycheck("history", "--help").output
    about, _, listed = bodycheck("history", "--help").stdout.partition("\nCommands:")
    assert "nightly runs" in about
    assert f"\n  {name} " in listed


@pytest.mark.nightly
def test_cron_script_keeps_a_log_and_prints_regressions(folder: Path) -> None:
    """The status of the script is that of the nightly run; without a regression it prints nothing."""
    script = Path(__file__).parents[1] / "scripts" / "nightly.sh"
    words = [script, folder / "kept", "tumble.toml", "--engine", "reference:m1", "--no-speed"]
    program = f"{sys.executable} -m bodycheck"
    (folder / "bodycheck").write_text(f'#!/bin/sh\nexec {program} "$@"\n')
    (folder / "bodycheck").chmod(0o755)
    surroundings = {**os.environ, "BODYCHECK": str(folder / "bodycheck")}
    first, second = (
        subprocess.run(words, env=surroundings, capture_output=True, text=True, check=False) for _ in range(2)
    )
    assert (first.returncode, second.returncode) == (3, 0), first.stdout + first.stderr
    assert first.stdout.startswith("First nightly run: ")
    assert second.stdout == ""
    log = (folder / "kept.log").read_text()
    assert log.count("night.html") == 2
