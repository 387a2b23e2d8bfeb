"""Accepting open regressions, and withdrawing an acceptance."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bodycheck._util.errors import InputError
from bodycheck.cli import commands
from bodycheck.reports.history.acceptances import FILE, accept, open_runs, read_acceptances, withdraw
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import read_summary
from bodycheck.reports.history.open_regressions import open_lines
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs import nightly_run as nightly_run_module
from tests.helpers.nightly_runs import Change, judged_nightly_runs, scaled, unchanged

Night = Callable[[Change, int], Judgement]


@pytest.fixture(scope="module")
def _one_open(nightly_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("open")
    judged_nightly_runs(nightly_run, folder, [unchanged, scaled(2.0, "m1"), scaled(2.0, "m1")])
    return folder


@pytest.fixture
def history(_one_open: Path, tmp_path: Path) -> History:
    """Return a history in which one error is twice as large since the second of three runs."""
    return History(shutil.copytree(_one_open, tmp_path / "nights"))


@pytest.fixture
def night(nightly_run: Run, history: History) -> Night:
    """Return a function that stores a further run with a change and returns its judgement."""

    def stored(change: Change, number: int) -> Judgement:
        (judged,) = judged_nightly_runs(nightly_run, history.folder, [change], first=number)
        return judged

    return stored


def ids(history: History) -> list[str]:
    """Return the ids of what is open."""
    return [one.id for state in open_runs(history).values() for one in state.regressions]


@pytest.mark.nightly
@pytest.mark.parametrize("by", ["change", "run", "newest"])
def test_accepted_change_is_the_level_of_the_next_run(by: str, history: History, night: Night) -> None:
    """By id or with the whole run; worse than accepted is a new regression, back again an improvement."""
    (change,) = ids(history)
    run = history.runs()[1].name if by == "run" else None
    (made,) = accept(
        history, run_id=run, ids=[change] if by == "change" else [], reason="as meant", author="Ada"
    )
    assert ids(history) == []
    assert read_acceptances(history) == (made,)
    assert (made.author, made.reason, made.run_id) == (
        "Ada",
        "as meant",
        history.runs()[1 if run else 2].name,
    )
    same, worse, better = night(scaled(2.0), 3), night(scaled(3.0), 4), night(scaled(1.0), 5)
    assert [judged.status for judged in (same, worse, better)] == [
        "no regression",
        "regression",
        "no regression",
    ]
    (again,) = worse.open
    (value,) = made.values
    assert (again.change.before, again.runs, again.newly) == (value.change.after, 1, True)
    assert [one.status for one in better.changes] == ["improved"]
    assert same.acceptances == (made,)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("between", [0, 1])
def test_withdrawn_acceptance_opens_the_regression_again(
    between: int, history: History, night: Night
) -> None:
    """Whether or not a run was judged with it."""
    (change,) = ids(history)
    (made,) = accept(history, run_id=None, ids=[change], reason="by mistake", author=None)
    for number in range(between):
        assert night(scaled(2.0), 3 + number).status == "no regression"
    assert withdraw(history, made.id).withdrawn
    judged = night(scaled(2.0), 5)
    assert judged.status == "regression"
    assert [one.id for one in judged.open] == [change]
    assert judged.open[0].runs == (1 if between else 3)
    assert night(scaled(1.0), 6).status == "no regression"


@pytest.mark.slow
def test_wrong_acceptances_are_refused(history: History) -> None:
    """Nothing is written; each message says what is available."""
    (change,) = ids(history)
    (line,) = (one.id for state in open_runs(history).values() for one in open_lines(state.regressions))
    for named, fault in (
        ({"run_id": "2025", "ids": []}, "--run 2025: no such nightly run"),
        ({"run_id": "2026", "ids": []}, "--run 2026: 3 nightly runs begin with it"),
        ({"run_id": history.runs()[0].name, "ids": []}, "no open regression of "),
        ({"run_id": None, "ids": ["0000"]}, f"--change 0000: is not open (open: {line})"),
    ):
        with pytest.raises(InputError) as refused:
            accept(history, reason="why", author=None, **named)  # type: ignore[arg-type]
        assert fault in str(refused.value)
    with pytest.raises(InputError, match="--reason"):
        accept(history, run_id=None, ids=[change], reason=" ", author=None)
    with pytest.raises(InputError, match="no such acceptance"):
        withdraw(history, change)
    assert not (history.folder / FILE).exists()


@pytest.mark.slow
def test_damaged_acceptances_accept_nothing(history: History, night: Night) -> None:
    """The next run is stored, names the file, and keeps the regression open; no further one is accepted."""
    (change,) = ids(history)
    accept(history, run_id=None, ids=[change], reason="as meant", author=None)
    (history.folder / FILE).write_text("[{}]")
    judged = night(scaled(2.0), 3)
    assert judged.status == "regression"
    assert any(FILE in why for why in judged.baseline.left_out)
    with pytest.raises(InputError, match=FILE):
        accept(history, run_id=None, ids=[change], reason="as meant", author=None)


def test_commands_accept_and_withdraw(history: History, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each prints the id of the acceptance, its author and its reason; the id of a line names all of it."""
    monkeypatch.chdir(history.folder.parent)
    (change,) = ids(history)
    (line,) = (one.id for state in open_runs(history).values() for one in open_lines(state.regressions))

    def bodycheck(*words: str) -> str:
        done = CliRunner().invoke(commands.app, ["history", *words])
        assert done.exit_code == 0, done.output
        return done.stdout

    (made,) = json.loads(bodycheck("accept", "nights", "--change", line, "--reason", "meant", "--json"))
    printed = bodycheck("withdraw", "nights", made["id"])
    assert printed.startswith(f"{made['id']}: 1 value of reference:m1 in {history.runs()[-1].name}, ")
    assert "meant (withdrawn on " in printed
    assert ids(history) == [change]


@pytest.mark.slow
def test_history_of_an_earlier_version_is_continued(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What it accepted by itself is the level; from then on nothing is."""
    with zipfile.ZipFile(Path(__file__).with_name("former_history.zip")) as packed:
        packed.extractall(tmp_path)
    history = History(tmp_path)
    before = history.runs()
    statuses = ["insufficient history", "no regression", "regression", "no regression"]
    assert [read_summary(run)["status"] for run in before] == statuses
    monkeypatch.setattr(nightly_run_module, "report_pages", lambda _: ())  # needs the motions
    run = as_run(before[-1])
    same, worse, still = judged_nightly_runs(
        run, tmp_path, [unchanged, scaled(2.0, "euler", scenario="tumble"), unchanged]
    )
    assert [judged.baseline.left_out for judged in (same, worse, still)] == [()] * 3
    assert [judged.status for judged in (same, worse, still)] == statuses[1:]
    assert same.comparison is not None
    assert same.comparison.before.run_id == before[-1].name


def as_run(folder: Path) -> Run:
    """Return a stored run as if it had been measured now, without its motions."""
    return Run(**vars(read_tables(folder)), problems=())
