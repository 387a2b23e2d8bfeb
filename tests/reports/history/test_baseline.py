"""Baseline runs: of the same machine class, undamaged, not dated in the future."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.document import Sentence, Table
from bodycheck.reports.history import baseline
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import (
    SUMMARY_KEYS,
    NightlyRun,
    baseline_of,
    check_files,
    machine_class,
    read_summary,
    read_summary_file,
    seal_run,
)
from bodycheck.reports.history.history_output import history_document
from tests.helpers.expected_messages import ExpectedMessage

MANIFEST: dict[str, Any] = {
    "cpu": "a processor",
    "cores": 4,
    "system": "Linux x86_64",
    "platform": "Linux-6.1",
    "python": "3.12.1",
    "libraries": {"numpy": "2.4.6"},
    "engines": {},
}


@pytest.mark.parametrize("changed", [{"cpu": "another"}, {"cores": 8}, {"system": "Linux aarch64"}])
def test_another_machine_is_of_another_class(changed: dict[str, Any]) -> None:
    """Each property by itself: a speed on twice the cores is not comparable."""
    assert machine_class({**MANIFEST, **changed}) != machine_class(MANIFEST)


@pytest.mark.parametrize(
    "changed", [{"platform": "Linux-6.2"}, {"python": "3.13.0"}, {"libraries": {}}, {"engines": {"a": {}}}]
)
def test_machine_with_other_software_is_of_the_same_class(changed: dict[str, Any]) -> None:
    """The effect of an update must be visible."""
    assert machine_class({**MANIFEST, **changed}) == machine_class(MANIFEST)


SUMMARY: dict[str, Any] = {
    "run_id": "20260101T000000Z-000001",
    "status": "no regression",
    "worse": 0,
    "missing": 1,
    "improved": 2,
    "moved": 3,
    "new": 4,
    "open": 0,
    "cases": 5,
    "engines": "reference 1",
    "machine": "a processor, 4 cores, Linux x86_64",
}


@pytest.fixture
def sealed(tmp_path: Path) -> Path:
    """Return the folder of a nightly run with a page, sealed."""
    (tmp_path / "night.json").write_text(json.dumps(SUMMARY))
    (tmp_path / "night.html").write_text("a page\n")
    seal_run(tmp_path)
    return tmp_path


def test_sealed_run_holds_what_sha256sum_prints(sealed: Path) -> None:
    """Runs stored by other releases are checked by the same keys and the same sums."""
    summary = json.loads((sealed / "night.json").read_text())
    assert summary["sha256"] == {"night.html": hashlib.sha256(b"a page\n").hexdigest()}
    content = {name: value for name, value in summary.items() if name != "seal"}
    assert summary["seal"] == hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    assert {name: summary[name] for name in SUMMARY} == SUMMARY
    read = read_summary(sealed)
    assert read == {**SUMMARY, "sha256": summary["sha256"]}
    check_files(sealed, read)


def test_sealed_report_is_written_for_readers(sealed: Path) -> None:
    """The report has one line per entry, indented by two spaces, and a newline at the end."""
    text = (sealed / "night.json").read_text()
    assert '\n  "status": "no regression",\n' in text
    assert text.endswith("}\n")


def test_control_characters_of_a_sealed_report_are_escaped(tmp_path: Path) -> None:
    """No control character reaches a terminal, and none counts as damage."""
    (tmp_path / "night.json").write_text(json.dumps({**SUMMARY, "engines": "red \x1b[31m"}))
    seal_run(tmp_path)
    assert read_summary(tmp_path)["engines"] == "red \\x1b[31m"


@pytest.mark.parametrize("name", SUMMARY)
@pytest.mark.parametrize("value", [[], {}])
def test_report_with_nested_data_is_damaged(
    name: str, value: object, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """An entry that is listed is text or a number."""
    (tmp_path / "night.json").write_text(json.dumps({**SUMMARY, name: value}))
    seal_run(tmp_path)
    with expected_message.raises(InputError):
        read_summary(tmp_path)


def test_table_that_is_gone_cannot_be_read(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """The line names it and the reason; files that are not requested are not read."""
    sums = {"sha256": {"results.csv": "0"}}
    with expected_message.raises(InputError):
        check_files(tmp_path, sums, ["results.csv"])
    check_files(tmp_path, sums, [])


@pytest.mark.parametrize("name", [*SUMMARY, "sha256", "seal"])
def test_change_of_a_sealed_report_is_detected(
    name: str, sealed: Path, expected_message: ExpectedMessage
) -> None:
    """Each entry is checked by itself, and so is the seal."""
    summary = json.loads((sealed / "night.json").read_text())
    (sealed / "night.json").write_text(json.dumps({**summary, name: "another"}))
    with expected_message.raises(InputError):
        read_summary_file(sealed)


def test_changed_file_of_a_sealed_run_is_named(sealed: Path, expected_message: ExpectedMessage) -> None:
    """A page that was edited or removed is no longer the one that was stored."""
    summary = read_summary(sealed)
    (sealed / "night.html").write_text("a Page\n")
    with expected_message.raises(InputError):
        check_files(sealed, summary)
    (sealed / "night.html").unlink()
    with expected_message.raises(InputError):
        check_files(sealed, summary)


@pytest.mark.parametrize("name", ["run_id", "status", "worse", "cases", "engines", "machine"])
def test_report_without_a_needed_key_is_damaged(
    name: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """The other counts are 0 where they are missing."""
    (tmp_path / "night.json").write_text(json.dumps({key: SUMMARY[key] for key in SUMMARY if key != name}))
    seal_run(tmp_path)
    with expected_message.raises(InputError):
        read_summary(tmp_path)


def test_counts_of_former_releases_are_read(tmp_path: Path) -> None:
    """What is `improved` and `moved` now was `better` and `other`; a missing count is 0."""
    now = ("improved", "moved", "new")
    former = {key: value for key, value in SUMMARY.items() if key not in now}
    (tmp_path / "night.json").write_text(json.dumps({**former, "better": 6, "other": 7}))
    seal_run(tmp_path)
    summary = read_summary(tmp_path)
    assert [summary[name] for name in now] == [6, 7, 0]


def test_only_unchanged_scenarios_are_the_same() -> None:
    """A scenario that was redefined, or that one of the runs lacks, is not compared."""
    mine = {"brick": {"mass": 1.0}, "plate": {"mass": 1.0}, "rod": {"mass": 1.0}}
    other = {"brick": {"mass": 1.0}, "plate": {"mass": 2.0}, "disk": {"mass": 1.0}, "rod": {"mass": 1.0}}
    run = NightlyRun(Path("run"), {"scenarios": mine}, {})
    assert run.same_scenarios({"scenarios": other}) == {"brick", "rod"}


@pytest.fixture
def sound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every stored run undamaged and on one machine."""
    monkeypatch.setattr(baseline, "read_manifest", lambda _: MANIFEST)
    monkeypatch.setattr(baseline, "read_summary", lambda _: SUMMARY)
    monkeypatch.setattr(baseline, "check_files", lambda *_: None)


@pytest.mark.usefixtures("sound")
def test_sixty_runs_of_the_same_machine_are_the_baseline(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The newest ones; of another machine none."""
    monkeypatch.setattr(NightlyRun, "levels", property(lambda _: object()))
    names = [f"20260101T0000{second:02d}Z-000000" for second in range(60)] + ["20260102T000000Z-000000"]
    for name in names:
        (tmp_path / name).mkdir()
    baseline = baseline_of(History(tmp_path), {**MANIFEST, "run_id": "20260104T000000Z-000004"})
    assert [run.name for run in baseline.runs] == names[:0:-1]
    other = baseline_of(History(tmp_path), {**MANIFEST, "run_id": "20260104T000000Z-000004", "cores": 8})
    assert (other.runs, other.left_out) == ((), ())
    assert other.other is not None
    assert other.other.name == names[-1]


def test_nightly_run_reads_the_tables_of_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The accepted levels of a nightly run are those of its tables."""
    monkeypatch.setattr(baseline, "read_tables", lambda folder: f"tables of {folder}")
    monkeypatch.setattr(baseline, "read_levels", lambda *words: words)
    run: Any = NightlyRun(tmp_path, {}, {})
    assert run.tables == f"tables of {tmp_path}"
    assert run.levels == (tmp_path, run.tables)


@pytest.mark.usefixtures("sound")
def test_run_that_was_not_judged_is_no_baseline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What became worse in it was never reported, so it must not be what the next run is compared with."""
    monkeypatch.setattr(NightlyRun, "levels", property(lambda _: object()))
    judged, failed = (f"2026010{day}T000000Z-00000{day}" for day in (1, 2))
    for name in (judged, failed):
        (tmp_path / name).mkdir()
    status = {tmp_path / failed: "not judged"}
    monkeypatch.setattr(
        baseline, "read_summary", lambda run: {**SUMMARY, "status": status.get(run, SUMMARY["status"])}
    )
    found = baseline_of(History(tmp_path), {**MANIFEST, "run_id": "20260104T000000Z-000004"})
    assert [run.name for run in found.runs] == [judged]
    assert found.left_out == (f"{tmp_path / failed}: was not judged",)


@pytest.mark.usefixtures("sound")
def test_only_the_newest_run_needs_readable_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next run is compared with its accepted levels; of older runs only recorded errors are used."""
    names = [f"2026010{day}T000000Z-00000{day}" for day in (1, 2, 3)]
    unreadable, read = {names[0], names[2]}, []

    def levels(run: NightlyRun) -> object:
        read.append(run.name)
        if run.name in unreadable:
            raise InputError(f"{run.folder}: is damaged")
        return object()

    monkeypatch.setattr(NightlyRun, "levels", property(levels))
    for name in names:
        (tmp_path / name).mkdir()
    baseline = baseline_of(History(tmp_path), {**MANIFEST, "run_id": "20260104T000000Z-000004"})
    assert [run.name for run in baseline.runs] == [names[1], names[0]]
    assert baseline.left_out == (f"{tmp_path / names[2]}: is damaged",)
    assert read == [names[2], names[1]]


def test_each_unusable_run_is_left_out_with_its_reason(tmp_path: Path) -> None:
    """Those of the future first, then the damaged ones, the newest first."""
    names = [f"2026010{day}T000000Z-00000{day}" for day in (1, 2, 3)]
    coming = [f"2999010{day}T000000Z-00000{day}" for day in (1, 2)]
    for name in (*names, *coming):
        (tmp_path / name).mkdir()
    for future in (coming, []):
        baseline = baseline_of(History(tmp_path), {"run_id": "20260104T000000Z-000004"})
        assert baseline.runs == ()
        faults, expected = [why.split(": ")[:2] for why in baseline.left_out], [*future, *reversed(names)]
        assert [Path(file).relative_to(tmp_path).parts[0] for file, _ in faults] == expected
        assert [why == "is dated in the future" for _, why in faults] == [name in future for name in expected]
        for name in future:
            (tmp_path / name).rmdir()


@pytest.mark.parametrize("name", ["engines", "machine"])
def test_what_all_runs_have_is_listed_once(name: str) -> None:
    """Beside the rows, of which each has its changes; a column has it where the runs differ."""
    kept = {key: SUMMARY.get(key, 0) for key in SUMMARY_KEYS}
    for other, is_once in ((kept[name], True), ("another", False)):
        table, *sentences = history_document(pd.DataFrame([kept, {**kept, name: other}])).parts
        assert isinstance(table, Table)
        assert [row[2] for row in table.rows] == ["1 missing, 2 improved, 3 moved, 4 new"] * 2
        said = [one.text for one in sentences if isinstance(one, Sentence)]
        assert (f"{name.capitalize()}: {kept[name]}" in said) == is_once
        assert (name in [column.head for column in table.columns]) != is_once
