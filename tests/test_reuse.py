"""What a command reuses from earlier runs: nothing, truths, answers of installed engines or all answers."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

import bodycheck
from bodycheck.adapters import registry
from bodycheck.cli import commands
from bodycheck.pytest_plugin import fixtures
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.comparison.comparison_document import comparison_document
from bodycheck.reports.document import print_document
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs import runner
from bodycheck.runs.request import Request
from bodycheck.runs.selection import Selection
from tests.helpers.compiled_engine_package import build_library, needs_a_compiler, write_shaky
from tests.helpers.scenario_texts import SCENARIO

GATE = """
[[gate]]
scenario = "mine"
engine = "reference"
method = "m1"
measure = "energy_drift"
upper = 1.0
reason = "r"
"""
RUN = ["run", "mine.toml", "--engine", "reference:m1", "--no-speed"]
HELD = ["gate", "mine.toml", "--gates", "gates.toml"]
NIGHT = ["nightly", "mine.toml", "--engine", "reference:m1", "--no-speed", "--history", "kept"]
COMMANDS = [
    (RUN, "installed"),
    ([*RUN, "--fresh"], "nothing"),
    ([*RUN, "--reuse"], "everything"),
    (HELD, "truths"),
    ([*HELD, "--fresh"], "nothing"),
    ([*HELD, "--reuse"], "everything"),
    (NIGHT, "nothing"),
]


class ManagedError(Exception):
    """Ends a command before its run starts and stores what it would reuse."""

    def __init__(self, options: Request) -> None:
        super().__init__(options.reuse)
        self.options = options


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Change to a folder with a scenario and gates."""
    (tmp_path / "mine.toml").write_text(SCENARIO)
    (tmp_path / "gates.toml").write_text(GATE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def _no_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def ended(_: object, options: Request, *__: object, **___: object) -> None:
        raise ManagedError(options)

    def nothing(*_: object, **__: object) -> Selection:
        return Selection((), (), {}, None, None)

    for module in ("directory", "gate_run", "runner"):
        monkeypatch.setattr(f"bodycheck.runs.{module}.run_selection", ended)
        monkeypatch.setattr(f"bodycheck.runs.{module}.select", nothing)  # no worker is started


@pytest.mark.usefixtures("folder", "_no_run")
@pytest.mark.parametrize(("words", "reuse"), COMMANDS, ids=lambda part: " ".join(part[:1] + part[-1:]))
def test_command_reuses_what_its_purpose_allows(words: list[str], reuse: str) -> None:
    """A gate and a nightly run measure again; a run may reuse answers of the same build."""
    done = CliRunner().invoke(commands.app, words)
    assert isinstance(done.exception, ManagedError), done.output
    assert str(done.exception) == reuse


@pytest.mark.usefixtures("folder", "_no_run")
def test_nightly_run_times_all_cases_in_ten_passes() -> None:
    """A nightly run times each case in ten passes, one of which should be undisturbed; other runs in one."""
    passes = [
        CliRunner().invoke(commands.app, words).exception.options.speed_passes for words in (NIGHT, RUN)
    ]
    assert passes == [10, 1]


@pytest.mark.usefixtures("folder", "_no_run")
@pytest.mark.parametrize(("fresh", "reuse"), [(None, "installed"), (True, "nothing"), (False, "everything")])
def test_run_from_python_reuses_the_same(fresh: bool | None, reuse: str) -> None:
    """fresh=True is equivalent to --fresh, and fresh=False to --reuse."""
    with pytest.raises(ManagedError, match=f"^{reuse}$"):
        runner.run(["mine.toml"], engines=["reference:m1"], fresh=fresh)


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(("requested", "reuse"), [(False, "truths"), (True, "everything")])
def test_gates_in_tests_measure_again(requested: bool, reuse: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The fixture reuses what the command reuses, and --bodycheck-reuse is equivalent to --reuse."""
    reported = {
        "--bodycheck-gates": "gates.toml",
        "--bodycheck-suite": "mine.toml",
        "--bodycheck-reuse": requested,
    }
    params: list[Any] = []
    metafunc = SimpleNamespace(
        config=SimpleNamespace(getoption=reported.get),
        definition=SimpleNamespace(nodeid="t"),
        parametrize=lambda _name, values, **_: params.extend(values),
    )
    fixtures.parametrize_gates(metafunc)  # type: ignore[arg-type]

    def ended(_gates: object, _scenarios: object, options: Request, _watching: object) -> None:
        raise ManagedError(options)

    monkeypatch.setattr(fixtures, "run_for_gates", ended)
    (gate,) = params
    with pytest.raises(ManagedError, match=f"^{reuse}$"):
        gate.within(SimpleNamespace(node=SimpleNamespace(user_properties=[]))).check()


@pytest.mark.nightly
@needs_a_compiler
def test_rebuilt_engine_is_run_again_and_named_after_its_changes(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """No answer of the old build is reused if the numbers change but the version does not."""
    site = folder / "site"
    write_shaky(site)
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("BODYCHECK_CACHE_DIR", str(folder / "cache"))
    monkeypatch.setenv("BODYCHECK_KERNELS_FOR_NOW", str(_kernels()))
    registry._plugged_in.cache_clear()

    def measured(name: str, **options: Any) -> Run:
        found = bodycheck.run(
            ["mine.toml"], engines=["shaky"], dt_s=[0.1, 0.05], speed=False, jobs=1, **options
        )
        bodycheck.write_run(found, folder / name)
        return found

    try:
        first, again = measured("a", fresh=False), measured("b", fresh=False)
        unasked = measured("c")
        build_library(site, 1.0 + 1e-6)
        rebuilt = measured("d", fresh=False)
    finally:
        registry._plugged_in.cache_clear()
    runs = (first, again, unasked, rebuilt)
    assert [run.results["reused"].tolist() for run in runs] == [[False] * 2, [True] * 2, *[[False] * 2] * 2]
    builds = [run.results["build"].unique().tolist() for run in runs]
    assert builds[0] == builds[1] == builds[2] != builds[3]
    errors = [run.results["omega_error"].tolist() for run in runs]
    assert errors[0] == errors[1] == errors[2]
    assert all(new != old for new, old in zip(errors[3], errors[0], strict=True))
    before, after = read_tables(folder / "a"), read_tables(folder / "d")
    reported = f"build of shaky 1.0: {builds[0][0]} -> {builds[3][0]} (adapter)"
    assert compare(before, after).environment == (reported,)
    assert compare(before, read_tables(folder / "c")).environment == ()
    print_document(comparison_document(compare(before, after)))
    first, second, *_ = capsys.readouterr().out.splitlines()
    assert (first.partition(":")[0], second) == ("shaky", f"Different environment: {reported}.")
    assert rebuilt.manifest["engines"]["shaky"]["builds"] == builds[3]
    assert rebuilt.manifest["engines"]["shaky"]["build"]["id"].startswith(builds[3][0])
    assert after.results["reused"].tolist() == [False, False]


def _kernels() -> Path:
    """Return the folder of the compiled kernels, so that a separate cache does not compile them again."""
    from bodycheck._util.compiled_cache import cache_directory

    return cache_directory()
