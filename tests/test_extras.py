"""An installation without extras works, and says which line brings what is missing."""

from __future__ import annotations

import json
import os
import re
import subprocess
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from bodycheck._util import distributions
from bodycheck._util.compiled_cache import KERNELS_FOR_NOW, cache_directory
from bodycheck.adapters.registry import optional_engines
from bodycheck.reports.document import Sentence, Table
from bodycheck.runs.doctor import MachineCheck, MachineReport, diagnosis_document
from tests.helpers.bare_environment import make_environment
from tests.helpers.doc_pages import ROOT, pages, text_of
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.scenario_texts import SCENARIO

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = PROJECT["optional-dependencies"]


def combined(extra: str) -> set[str]:
    """Return the extras that an extra combines, and itself."""
    named = [re.findall(r"^bodycheck\[(.*)\]$", line) for line in EXTRAS[extra]]
    parts = {part for found in named for names in found for part in names.split(",")}
    return {extra}.union(*map(combined, parts))


def test_named_extras_exist() -> None:
    """Each extra that a message, a page or a workflow tells to install is one of the project."""
    sources = [*ROOT.glob("bodycheck/**/*.py"), *ROOT.glob(".github/workflows/*.yml")]
    texts = [*(path.read_text() for path in sources), *map(text_of, pages())]
    named = [names for text in texts for names in re.findall(r"(?:bodycheck|\.)\[([a-z,-]+)\]", text)]
    found = {name for names in named for name in names.split(",")}
    assert {"engines", "history", "plot", "mcap", "test"} <= found <= set(EXTRAS)


def test_requirements_of_every_notation_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A requirement may have an extra, a marker, both or neither, in the notation of any build backend."""
    lines = [
        "numpy>=2.1",
        'platformdirs>=4.0; sys_platform != "linux"',
        "mujoco>=4.0; extra == 'engines'",
        'pybullet>=3.2.7; (python_version < "3.12") and extra == "engines"',
        "bodycheck[engines,history]; extra == 'all'",
    ]
    monkeypatch.setattr(distributions, "distribution", lambda _: SimpleNamespace(requires=lines))
    assert distributions.requirements() == {
        "": ["numpy", "platformdirs"],
        "engines": ["mujoco", "pybullet"],
        "all": ["bodycheck"],
    }


def test_all_is_what_users_want_and_test_what_tests_need() -> None:
    """The extra `all` brings no engine that runs on request, and `test` brings the engines and histories."""
    assert combined("all") == {"all", "engines", "history", "plot", "versions", "hunt", "mcap"}
    assert combined("all") | {"cluster", "docs", "meshes", "usd"} <= combined("test")
    assert not combined("test") & set(optional_engines())


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the programs of an environment without extras, and a folder of files for its commands."""
    folder = tmp_path_factory.mktemp("bare")
    programs = make_environment(folder / "env", ["bodycheck", "pytest"])
    (folder / "mine.toml").write_text(SCENARIO)
    (folder / "arm.urdf").write_text('<robot name="arm"><link name="a"/></robot>')
    (folder / "arm.usda").write_text("#usda 1.0\n")
    (folder / "part.3mf").write_bytes(b"PK")
    (folder / "log.parquet").write_bytes(b"PAR1PAR1")
    (folder / "log.mcap").write_bytes(b"\x89MCAP0\r\n")
    return programs


def run_bare(bare: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program of the environment, without Node.js and uv on the path."""
    compiled = {KERNELS_FOR_NOW: str(cache_directory())}  # otherwise a folder of this environment's own
    environment = {**os.environ, **compiled, "PATH": str(bare), "PYTHONPATH": str(ROOT), "COLUMNS": "200"}
    return subprocess.run(
        [bare / words[0], *words[1:]],
        cwd=bare.parents[1],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


MISSING = {
    "audit arm.urdf": "engines",
    "fingerprint mujoco": "engines",
    "nightly mine.toml --history nights": "history",
    "judge log.parquet --scenario mine.toml": "history",
    "judge log.mcap --scenario mine.toml": "mcap",
    "plot run --figure order --svg order.svg": "plot",
    "hunt mine.toml --engine reference:rk4 --out worst": "hunt",
    "run mine.toml --cluster tcp://localhost:1": "cluster",
    "versions mujoco --since 3.6": "versions",
    "audit arm.usda": "usd",
    "body part.3mf --density-kg-m3 1000": "meshes",
}


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("line", MISSING)
def test_what_is_missing_is_said_with_the_line_that_installs_it(
    line: str, bare: Path, expected_message: ExpectedMessage
) -> None:
    """A command that needs an extra ends with status 2 and one line, before anything is computed."""
    done = run_bare(bare, "bodycheck", *line.split())
    assert done.returncode == 2
    assert f"pip install 'bodycheck[{MISSING[line]}]'" in done.stderr
    expected_message(done.stderr.splitlines()[-1])
    assert not (bare.parents[1] / "nights").exists()


def test_doctor_begins_with_what_is_broken_and_ends_with_what_nobody_installed() -> None:
    """An extra that is not installed is not a fault of the installation."""
    absent = MachineCheck("usd", False, "usd-core not installed", optional=True)
    broken, sound = MachineCheck("cache", False, "read-only"), MachineCheck("dart", True, "6.20.0")
    for checks, tint in (((absent, sound, broken), "bad"), ((absent, sound), "good")):
        first, table, *_ = diagnosis_document(MachineReport({}, (), checks, {})).parts
        assert isinstance(first, Sentence)
        assert isinstance(table, Table)
        assert first.tint == tint
        assert not any(one.name in first.text for one in (absent, sound))
        assert ("cache" in first.text) == (broken in checks)
        assert [row[0] for row in table.rows] == [*["cache"][: len(checks) - 2], "dart", "usd"]


def test_doctor_works_without_extras(bare: Path) -> None:
    """Every capability that is missing comes with the line that installs it."""
    done = run_bare(bare, "bodycheck", "doctor", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    missing = {check["name"]: check["detail"] for check in found["checks"] if not check["works"]}
    assert {"mujoco", "dart", "pybullet", "history", "plot", "versions", "hunt", "mcap"} <= set(missing)
    how = {name: re.findall(r"'bodycheck\[(.*)\]'", detail) for name, detail in missing.items()}
    assert {name for name, extras in how.items() if not extras} <= {"JavaScript engines", "pybullet"}
    assert set(found["versions"]) >= {"bodycheck", "Python", "numpy"}
    assert run_bare(bare, "bodycheck", "doctor").returncode == 0


@pytest.mark.nightly
def test_plain_run_without_engines_says_so_first(bare: Path) -> None:
    """The first lines of the output and of the summary say that only the reference was measured."""
    words = ("run", "mine.toml", "--no-speed", "--dt", "0.02", "--out", "plain")
    done = run_bare(bare, "bodycheck", *words)
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines()[0].endswith("pip install 'bodycheck[engines]'")
    assert done.stdout.splitlines()[0] == "No engine was measured, only the reference."
    assert len(re.findall(r"^Not measured: ", done.stdout, re.MULTILINE)) == 3
    quiet = run_bare(bare, "bodycheck", *words[:-1], "quiet", "--quiet", "--engine", "reference:m1")
    assert (quiet.stderr, "No engine" in quiet.stdout) == ("", False)


@pytest.mark.nightly
def test_engine_that_cannot_be_had_stops_only_its_own_cases(bare: Path) -> None:
    """An engine without its package and one without Node.js leave the cases of the third; alone they fail."""
    words = ("run", "mine.toml", "--no-speed", "--dt", "0.02", "--json")
    done = run_bare(bare, "bodycheck", *words, "--engine", "reference:m1,dart,cannon-es")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["outcomes"] == {"ok": 1}
    assert set(answer["unavailable"]) == {"dart", "cannon-es"}
    alone = run_bare(bare, "bodycheck", *words, "--engine", "dart,cannon-es")
    assert alone.returncode == 2
    why = alone.stderr.splitlines()[-2:]
    assert ["dart is not installed" in why[0], "Node.js" in why[1]] == [True, True]


@pytest.mark.nightly
def test_fixture_and_judge_work_without_extras(bare: Path) -> None:
    """The pytest fixture, `truth` and `judge` need no extra."""
    folder = bare.parents[1]
    (folder / "test_mine.py").write_text(
        "def test_mine(bodycheck):\n"
        "    found = bodycheck.run('mine.toml', engine='reference', method='rk4', dt_s=0.01)\n"
        "    found.check('orientation_error_rad', upper=1e-3)\n"
    )
    done = run_bare(bare, "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine.py")
    assert "1 passed" in done.stdout, done.stdout
    truth = run_bare(bare, "bodycheck", "truth", "mine.toml", "--at", "0,0.5,1")
    (folder / "true.csv").write_text(truth.stdout)
    judged = run_bare(bare, "bodycheck", "judge", "true.csv", "--scenario", "mine.toml", "--json")
    assert judged.returncode == 0, judged.stderr
