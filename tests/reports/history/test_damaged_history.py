"""A history with a damaged run: it is named, and the others are used."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from bodycheck._util.errors import InputError
from bodycheck.cli import commands
from bodycheck.reports.history.baseline import SUMMARY_KEYS, seal_run
from bodycheck.reports.history.queries import QUERIED

NAMES = [f"2026010{day}T000000Z-00000{day}" for day in (1, 2, 3)]


@pytest.fixture
def history(tmp_path: Path) -> Path:
    """Return the folder of three nightly runs with one row per table."""
    for name in NAMES:
        (tmp_path / name).mkdir()
        summary = {**dict.fromkeys(SUMMARY_KEYS, 0), "run_id": name, "status": "no regression"}
        (tmp_path / name / "night.json").write_text(json.dumps(summary))
        for table in QUERIED:
            (tmp_path / name / f"{table}.csv").write_text(f"run_id\n{name}\n")
        seal_run(tmp_path / name)
    return tmp_path


def requested(*words: str | Path) -> Result:
    """Return what `bodycheck history words` did in this process."""
    return CliRunner().invoke(commands.app, ["history", *map(str, words)])


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"run_id": "x"}', None])
@pytest.mark.parametrize("words", [["list"], ["query", "SELECT run_id FROM results ORDER BY 1"]])
def test_damaged_run_is_named_and_the_others_are_listed(
    history: Path, words: list[str], text: str | None
) -> None:
    """One line names the file; the status is 1, so that the damage is not hidden."""
    damaged = history / NAMES[1] / "night.json"
    damaged.unlink()
    if text is not None:
        damaged.write_text(text)
    done = requested(words[0], history, *words[1:])
    assert done.exit_code == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{damaged}: ")
    assert line.endswith("; this nightly run is excluded")
    assert [name in done.stdout for name in NAMES] == [True, False, True]


@pytest.mark.slow(after=2)
@pytest.mark.nightly(after=6)
@pytest.mark.parametrize("table", QUERIED)
def test_query_omits_a_run_with_a_truncated_table(history: Path, table: str) -> None:
    """Whichever table is truncated or queried, the run is in no result, and is named."""
    torn = history / NAMES[2] / f"{table}.csv"
    torn.write_bytes(torn.read_bytes()[:-1])
    sql = " UNION ALL ".join(f"SELECT run_id FROM {name}" for name in ("nights", *QUERIED))
    done = requested("query", history, sql)
    assert (done.exit_code, done.stderr) == (
        1,
        f"{torn}: is damaged: changed after it was written; this nightly run is excluded\n",
    )
    assert [done.stdout.count(name) for name in NAMES] == [1 + len(QUERIED)] * 2 + [0]


def test_history_of_damaged_runs_only_is_refused(history: Path) -> None:
    """One line per run gives the reason."""
    for name in NAMES:
        (history / name / "night.json").write_text("")
    done = requested("list", history)
    assert isinstance(done.exception, InputError)
    assert [line.split(": ")[0] for line in str(done.exception).splitlines()] == [
        str(history / name / "night.json") for name in NAMES
    ]


def test_undamaged_runs_are_all_listed(history: Path) -> None:
    """The status is 0, and standard error is empty."""
    done = requested("list", history)
    assert (done.exit_code, done.stderr) == (0, "")
    assert [name in done.stdout for name in NAMES] == [True] * 3
