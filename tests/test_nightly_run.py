"""A nightly run whose measurement and judgement are replaced: what is run, stored and reported."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.document import Document, Sentence
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import SUMMARY_KEYS, check_files, read_summary, seal_run
from bodycheck.runs import nightly_run
from bodycheck.runs.nightly_run import resume_nightly, run_nightly, store_nightly
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import no_progress
from tests.helpers.expected_messages import ExpectedMessage

EARLIER, TONIGHT = "20260101T000000Z-000001", "20260102T000000Z-000002"
FUTURE = "29990101T000000Z-000003"


def write_told(folder: Path) -> None:
    """Write the summary of a nightly run, named after its folder."""
    reported = {**dict.fromkeys(SUMMARY_KEYS, 0), "run_id": folder.name.removeprefix(".unfinished-")}
    (folder / "night.json").write_text(json.dumps(reported))
    seal_run(folder)


@pytest.fixture
def history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> History:
    """Return a history of an earlier and a future run, with stand-ins for the judgement and the report."""
    for name in (EARLIER, FUTURE):
        (tmp_path / name).mkdir()
        write_told(tmp_path / name)
    monkeypatch.setattr(nightly_run, "write_tables", lambda _, folder: write_told(folder))
    monkeypatch.setattr(nightly_run, "report_pages", lambda _: ())
    monkeypatch.setattr(nightly_run, "write_trajectories", lambda *_: None)
    monkeypatch.setattr(nightly_run, "trends_page", lambda _: "the trends")
    monkeypatch.setattr(nightly_run, "read_tables", lambda folder: folder.name)
    monkeypatch.setattr(nightly_run, "judge_run", lambda *words: words)
    monkeypatch.setattr(nightly_run, "_with_causes", lambda run, _: run)
    monkeypatch.setattr(nightly_run, "write_judgement", lambda *_: None)
    monkeypatch.setattr(nightly_run, "nightly_page", lambda _: "a pagé\n")
    monkeypatch.setattr(nightly_run, "nightly_document", lambda _: Document("", (Sentence("a téxt"),)))
    return History(tmp_path)


RUN = cast(Any, SimpleNamespace(run_id=TONIGHT))


def test_nightly_run_is_carried_out_with_a_journal_in_its_history(
    history: History, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is stored under its own id, and an interruption names the command that continues it."""
    begun: list[tuple[Any, ...]] = []

    def begin(*words: Any) -> Any:
        begun.append(words)
        return words[-1].store(RUN)

    monkeypatch.setattr(nightly_run, "begin", begin)
    (judged, run) = run_nightly(cast(Request, "a request"), history.folder, no_progress, Thresholds(0.25))
    ((request, identity, out, progress, storage),) = begun
    assert (request, progress) == ("a request", no_progress)
    assert out == history.folder / identity.run_id
    assert storage.again == ("nightly", "--history", str(history.folder), "--resume")
    assert cast(Any, judged) == (history, f".unfinished-{TONIGHT}", Thresholds(0.25))
    assert run == history.folder / TONIGHT


def test_newest_interrupted_run_is_resumed(history: History, monkeypatch: pytest.MonkeyPatch) -> None:
    """Older ones are removed once it is stored, except one on which a process still works."""
    with pytest.raises(InputError, match="has no interrupted nightly run"):
        resume_nightly(history.folder, no_progress)
    older, working, newest = (f"2026010{day}T00000{day}Z-00000{day}" for day in (1, 1, 2))
    working = working.replace("000001Z", "000003Z")
    for name in (older, working, newest):
        (history.folder / f"{name}.partial").mkdir()
        (history.folder / f"{name}.partial" / "request.json").write_text("{}")
    resumed: list[tuple[Any, ...]] = []

    def proceed(*words: Any, **named: Any) -> Any:
        resumed.append((words[0], named))
        return words[-1].store(RUN)

    monkeypatch.setattr(nightly_run, "proceed", proceed)
    with Journal(history.folder / f"{working}.partial" / "journal"):
        _, run = resume_nightly(history.folder, no_progress, allow_code=True)
    assert resumed == [(history.folder / newest, {"allow_code": True})]
    assert run == history.folder / TONIGHT
    left = sorted(path.name for path in history.folder.glob("*.partial"))
    assert left == [f"{working}.partial", f"{newest}.partial"]


def test_stored_run_has_its_pages_and_is_sealed(history: History) -> None:
    """The pages are stored in UTF-8 with their hashes, and the default thresholds are used."""
    judged, run = store_nightly(RUN, history)
    assert cast(Any, judged)[2] is DEFAULT_THRESHOLDS
    assert (run / "night.html").read_bytes() == "a pagé\n".encode()
    assert "a téxt".encode() in (run / "night.md").read_bytes()
    reported = read_summary(run)
    assert reported["sha256"].keys() == {"night.html", "night.md"}
    check_files(run, reported)


def test_feed_lists_the_runs_up_to_the_stored_one(history: History, monkeypatch: pytest.MonkeyPatch) -> None:
    """The feed lists the oldest run first and no run dated in the future."""
    listed: list[tuple[Path, list[str]]] = []
    monkeypatch.setattr(
        nightly_run,
        "write_feed",
        lambda folder, reported, _: listed.append((folder, [one["run_id"] for one, _ in reported])),
    )
    store_nightly(RUN, history)
    assert listed == [(history.folder, [EARLIER, TONIGHT])]


def test_feed_that_cannot_be_written_loses_no_run(
    history: History, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The run is stored and judged, and one line on standard error states that the feed lacks it."""

    def full(*_: object) -> None:
        raise InputError("feed.xml: cannot be written: No space left on device")

    monkeypatch.setattr(nightly_run, "write_feed", full)
    judged, run = store_nightly(RUN, history)
    assert judged
    assert run.is_dir()
    printed = capsys.readouterr()
    assert printed.out == ""
    assert (
        printed.err
        == "feed.xml: cannot be written: No space left on device; the feed and the trends lack this run\n"
    )


def test_run_that_cannot_be_judged_is_stored_and_raised(
    history: History, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """An unexpected error is noted in the folder and raised; if the disk is full nothing is stored."""
    written: list[Path] = []

    def broken(*_: object) -> None:
        raise error

    monkeypatch.setattr(nightly_run, "judge_run", broken)
    monkeypatch.setattr(nightly_run, "write_unjudged", lambda _, folder: written.append(folder))
    error: Exception = OSError(28, "No space left on device")
    with expected_message.raises(InputError):
        store_nightly(RUN, history)
    assert (written, (history.folder / TONIGHT).exists()) == ([], False)
    error = TypeError("unexpected")
    with pytest.raises(TypeError) as raised:
        store_nightly(RUN, history)
    run = history.folder / TONIGHT
    assert raised.value.__notes__ == [f"the run is stored in {run}, but could not be judged"]
    assert len(written) == 1
    assert "sha256" in read_summary(run)
