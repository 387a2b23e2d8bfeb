"""Shards: a run divided among machines and merged again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bodycheck._util.errors import InputError, StoppedError
from bodycheck._util.shard import Shard
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.sentinels import disagreements, read_sentinels
from bodycheck.runs import directory
from bodycheck.runs.directory import resume, run_to_folder, write_run
from bodycheck.runs.merge import _rebuilt, merge
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import no_progress
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import comparable_tables, tumbling

COUNT = 3
TABLES = ("results", "methods", "stability", "probes")
Message = Callable[..., None]


def request(folder: Path, **others: Any) -> Request:
    """Return a run of two scenarios by four methods whose steps the run refines."""
    engines = ["reference:m1,reference:rk4,reference:exact,mujoco:euler"]
    scenarios = [str(folder / "mine.toml"), str(folder / "other.toml")]
    given: dict[str, Any] = {"scenarios": scenarios, "engines": engines[0].split(","), "speed": False}
    return Request(**{**given, "fresh": True, **others})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a whole run `whole` and its shards `part-1` to `part-3`."""
    folder = tmp_path_factory.mktemp("shards")
    (folder / "mine.toml").write_text(tumbling())
    (folder / "other.toml").write_text(tumbling("other", omega_body_rad_s=(2.0, 0.1, 0.1)))
    run_to_folder(request(folder), folder / "whole", no_progress)
    for k in range(1, COUNT + 1):
        run_to_folder(request(folder, shard=f"{k}/{COUNT}"), folder / f"part-{k}", no_progress)
    return folder


@pytest.fixture
def parts(folder: Path, tmp_path: Path) -> list[Path]:
    """Return copies of the shards."""
    copies = [tmp_path / f"part-{k}" for k in range(1, COUNT + 1)]
    for copy in copies:
        shutil.copytree(folder / copy.name, copy)
    return copies


def edit_manifest(part: Path, **changes: Any) -> None:
    """Change entries in a shard's manifest."""
    path = part / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def findings(parts: list[Path]) -> list[str]:
    """Return the findings of a merge."""
    found: list[str] = merge(parts).manifest["merged"]["findings"]
    return found


@pytest.mark.parametrize("count", [1, 2, 7, 64])
def test_every_unit_is_in_exactly_one_shard(count: int) -> None:
    """Each unit has one shard for any number of shards; with many units no shard is empty."""
    shards = [Shard(k, count) for k in range(1, count + 1)]
    units = [("study", f"scenario-{i}", "engine", f"method-{i % 7}") for i in range(1000)]
    owners = [[shard.index for shard in shards if shard.has(*unit)] for unit in units]
    assert all(len(found) == 1 for found in owners)
    assert {found[0] for found in owners} == set(range(1, count + 1))


def test_owner_of_a_unit_never_changes() -> None:
    """The division is part of the format, so shards of different versions fit together."""
    owners = [Shard(1, 8).owner("study", "free-flight", "mujoco", f"m{k}") for k in range(8)]
    digests = [sha256(f"study\0free-flight\0mujoco\0m{k}".encode()).digest()[:8] for k in range(8)]
    assert owners == [1 + int.from_bytes(digest, "big") % 8 for digest in digests] == [3, 1, 5, 6, 5, 5, 6, 8]


@pytest.mark.parametrize("text", ["0/3", "4/3", "1/0", "1", "a/b", "1/3/5", "-1/3", "1/100001", "", "1/ 3"])
def test_wrong_shard_is_refused(text: str, expected_message: Message) -> None:
    """One line states the valid form."""
    with pytest.raises(InputError) as refused:
        Shard.parse(text)
    expected_message(str(refused.value))


@pytest.mark.nightly
def test_merged_shards_equal_one_run(folder: Path, tmp_path: Path) -> None:
    """Merged shards equal one run in every cell except those of speed, and can be read like any run."""
    ended = run_bodycheck(tmp_path, "merge", *(str(folder / f"part-{k}") for k in (2, 3, 1)), "--out", "all")
    assert ended.returncode == 0, ended.stderr
    whole = comparable_tables(folder / "whole")
    for name, table in comparable_tables(tmp_path / "all").items():
        pd.testing.assert_frame_equal(table, whole[name])
    assert len(whole["results"]) > 2 * (3 + 3 + 1 + 3)
    read_tables(tmp_path / "all")
    sizes = [len(pd.read_csv(folder / f"part-{k}/results.csv")) for k in (1, 2, 3)]
    assert sum(sizes) == len(whole["results"])
    assert max(sizes) < len(whole["results"])


@pytest.mark.slow
def test_agreeing_machines_have_no_finding(parts: list[Path]) -> None:
    """Shards of one machine have the same bits for every sentinel."""
    assert findings(parts) == []
    sentinels = [read_sentinels(part) for part in parts]
    assert [one.answer.name for one in sentinels[0]] == [one.answer.name for one in sentinels[1]]
    assert len(sentinels[0]) == 4


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 1e-15, 1e-9])
def test_disagreeing_sentinel_is_a_finding(parts: list[Path], size: float) -> None:
    """A finding names the engine, the case, the machines and the digits; the run is merged anyway."""
    sentinels = {part.name: list(read_sentinels(part)) for part in parts}
    sound = sentinels["part-2"][1]
    assert sound.trajectory is not None
    moved = sound.trajectory.velocity_m_s.copy()
    spin = np.array(sound.trajectory.omega_body_rad_s)
    spin[-1] *= 1.0 + size
    trajectory = replace(sound.trajectory, omega_body_rad_s=spin, velocity_m_s=moved)
    sentinels["part-2"][1] = replace(sound, trajectory=trajectory)
    found = disagreements({part: [one.answer for one in each] for part, each in sentinels.items()})
    if size < np.finfo(float).eps:
        assert found == ([] if size == 0.0 else found)
        return
    assert len(found) == 1
    words = f"{sound.answer.name}: compared with shards part-1, part-3, shard part-2 agrees to "
    assert found[0].startswith(words)
    digits = float(found[0].removeprefix(words).split()[0])
    assert abs(digits + np.log10(size)) < 0.3


@pytest.mark.slow
def test_different_outcome_of_a_sentinel_is_a_finding(parts: list[Path]) -> None:
    """A sentinel that failed on one machine is reported with both outcomes."""
    answers = {part.name: [one.answer for one in read_sentinels(part)] for part in parts}
    answers["part-3"][0] = answers["part-3"][0]._replace(outcome="failed", arrays={})
    (found,) = disagreements(answers)
    assert found.endswith("shard part-3 ended failed, not ok")


@pytest.mark.slow
def test_other_python_is_named(parts: list[Path]) -> None:
    """Merging shards of two Python versions reports both with their shards."""
    python = json.loads((parts[0] / "manifest.json").read_text())["python"]
    edit_manifest(parts[1], python="3.99.1")
    assert f"shards differ in python: {python} in shards 1/3, 3/3; 3.99.1 in shard 2/3" in findings(parts)


def test_other_build_of_an_engine_is_named(expected_message: Message) -> None:
    """The finding names the parts that differ or are missing; a shard without the engine does not count."""
    builds = ({"lib": "1", "numpy": "2"}, {"lib": "1", "numpy": "3", "extra": "4"}, None)
    entries = [{} if parts is None else {"engine": {"build": {"parts": parts}}} for parts in builds]
    shards = [SimpleNamespace(manifest={"engines": entry}) for entry in entries]
    (found,) = _rebuilt(shards)  # type: ignore[arg-type]
    expected_message(found)
    assert list(_rebuilt([shards[0], shards[0], shards[2]])) == []  # type: ignore[list-item]


@pytest.mark.slow
def test_cases_of_an_engine_that_a_shard_lacks_are_failed(parts: list[Path]) -> None:
    """The tables have these cases with the reason, and the engine is reported as a finding."""
    for part in parts:
        told = json.loads((part / "manifest.json").read_text())
        rows = pd.read_csv(part / "results.csv")
        if "mujoco" not in set(rows["engine"]):
            continue
        told["engines"]["mujoco"] = {"unavailable": "mujoco cannot be imported"}
        told["shard"]["methods"] = [pair for pair in told["shard"]["methods"] if pair[0] != "mujoco"]
        kept = rows[rows["engine"] != "mujoco"]
        told["outcomes"] = kept["outcome"].value_counts().to_dict()
        edit_manifest(part, **told)
        for name in TABLES:
            table = pd.read_csv(part / f"{name}.csv", dtype=str)
            table[table["engine"] != "mujoco"].to_csv(part / f"{name}.csv", index=False)
        broken = told["shard"]["shard"]
        break
    merged = merge(parts)
    lost = merged.results[merged.results["outcome"] == "failed"]
    assert set(lost["engine"]) == {"mujoco"}
    assert set(lost["message"]) == {f"not run in shard {broken}: mujoco cannot be imported"}
    reported = merged.manifest["merged"]["findings"]
    assert any(finding.startswith("mujoco:euler: ") and "not run" in finding for finding in reported)


@pytest.mark.slow
def test_speeds_are_those_of_one_class_of_machines(parts: list[Path]) -> None:
    """Times of another processor are omitted and reported; all other values are kept."""
    for part in parts:
        rows = pd.read_csv(part / "results.csv", dtype=str)
        for column in ("cpu_s", "cpu_s_low", "cpu_s_high"):
            rows[column] = "1.0"
        rows.to_csv(part / "results.csv", index=False)
        edit_manifest(part, speed=True)
    fewest = min(parts, key=lambda part: len(pd.read_csv(part / "results.csv")))
    edit_manifest(fewest, cpu="another")
    merged = merge(parts)
    timed = merged.results["cpu_s"].notna()
    assert timed.sum() == len(merged.results) - len(pd.read_csv(fewest / "results.csv"))
    assert any(
        finding.startswith("speeds are those of ") for finding in merged.manifest["merged"]["findings"]
    )
    assert "another" not in merged.manifest["cpu"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    ["missing", "twice", "no shard", "other steps", "other division", "no run", "rows of a method of none"],
)
def test_shards_that_do_not_fit_are_refused(
    fault: str, parts: list[Path], folder: Path, tmp_path: Path, expected_message: Message
) -> None:
    """Each error gives one line and status 2, and nothing is written."""
    match fault:
        case "missing":
            parts = parts[:1]
        case "twice":
            parts = [*parts, parts[0]]
        case "no shard":
            parts = [folder / "whole", *parts[1:]]
        case "other steps":
            edit_manifest(parts[2], dt_s=[0.1])
        case "other division":
            told = json.loads((parts[2] / "manifest.json").read_text())
            edit_manifest(parts[2], shard={**told["shard"], "shard": "3/4"})
        case "no run":
            parts = [*parts, tmp_path / "nothing"]
        case "rows of a method of none":
            for part in parts:
                told = json.loads((part / "manifest.json").read_text())["shard"]
                left = [pair for pair in told["methods"] if pair[0] != "mujoco"]
                edit_manifest(part, shard={**told, "methods": left})
    ended = run_bodycheck(tmp_path, "merge", *map(str, parts), "--out", "all")
    assert ended.returncode == 2
    assert not (tmp_path / "all").exists()
    expected_message(ended.stderr.replace(str(folder), "WHOLE").strip(), tmp_path)


@pytest.mark.nightly
def test_stopped_shard_is_resumed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """A resumed shard has the tables of an uninterrupted one; `merge` refuses an incomplete shard."""

    def stop(*_: Any, **__: Any) -> Path:
        raise KeyboardInterrupt

    out = tmp_path / "part-2"
    with monkeypatch.context() as patched:
        patched.setattr(directory, "write_run", stop)
        with pytest.raises(StoppedError):
            run_to_folder(request(folder, shard="2/3"), out, no_progress)
    with expected_message.raises(InputError):
        merge([folder / "part-1", out, folder / "part-3"])
    resume(out, no_progress)
    for name, table in comparable_tables(out).items():
        pd.testing.assert_frame_equal(table, comparable_tables(folder / "part-2")[name])


@pytest.mark.nightly
def test_shard_without_cases_is_a_shard(folder: Path, tmp_path: Path) -> None:
    """With more shards than studies some shards are empty, and merged they equal the run."""
    requested = replace(request(folder), scenarios=[str(folder / "mine.toml")], engines=["reference:m1"])
    run_to_folder(requested, tmp_path / "whole", no_progress)
    outs = [tmp_path / f"part-{k}" for k in range(1, 4)]
    for k, out in enumerate(outs, start=1):
        run_to_folder(replace(requested, shard=f"{k}/3"), out, no_progress)
    assert 0 in [len(pd.read_csv(out / "results.csv")) for out in outs]
    write_run(merge(outs), tmp_path / "merged")
    for name, table in comparable_tables(tmp_path / "merged").items():
        pd.testing.assert_frame_equal(table, comparable_tables(tmp_path / "whole")[name])


@pytest.mark.nightly
def test_questions_about_a_shard_without_cases_are_answered(folder: Path, tmp_path: Path) -> None:
    """The report says that there is none, and there is no setting to advise."""
    requested = replace(request(folder), scenarios=[str(folder / "mine.toml")], engines=["reference:m1"])
    outs = [tmp_path / f"part-{k}" for k in (1, 2)]
    for k, out in enumerate(outs, start=1):
        run_to_folder(replace(requested, shard=f"{k}/2"), out, no_progress)
    (empty,) = (out for out in outs if not len(pd.read_csv(out / "results.csv")))
    assert run_bodycheck(tmp_path, "report", empty.name).returncode == 0
    assert "This run has no cases." in (empty / "report.html").read_text()
    advised = run_bodycheck(tmp_path, "advise", "--run", empty.name, "--error", "1e-3")
    assert (advised.returncode, advised.stderr) == (2, f"{empty.name}: has no cases\n")


@pytest.mark.nightly
def test_shards_of_a_nightly_run_are_judged_as_one(folder: Path, tmp_path: Path) -> None:
    """The merged run is stored in a history and compared: the status is 3 the first time and 0 the second."""
    (tmp_path / "mine.toml").write_text((folder / "mine.toml").read_text())
    words = ["nightly", "mine.toml", "--engine", "reference:m1,reference:rk4", "--no-speed", "--quiet"]
    for k in (1, 2):
        ended = run_bodycheck(tmp_path, *words, "--shard", f"{k}/2", "--out", f"part-{k}")
        assert ended.returncode == 0, ended.stderr
    for status in (3, 0):
        ended = run_bodycheck(tmp_path, "merge", "part-1", "part-2", "--history", "nights")
        assert ended.returncode == status, ended.stderr
    refused = run_bodycheck(tmp_path, *words, "--shard", "1/2", "--history", "nights")
    assert refused.returncode == 2
