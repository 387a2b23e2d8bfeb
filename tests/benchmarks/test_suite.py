"""The benchmark as a whole at reduced sizes, and the committed results of the full one."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, cast

import pandas as pd
import pytest

from benchmarks.__main__ import main
from benchmarks.figures import FIGURES, Figure, Measured
from benchmarks.picture import PICTURE, work_precision_picture
from benchmarks.readme import BEGIN, END, markdown_table, terminal_table, with_table
from benchmarks.readme import main as rewrite_readme
from benchmarks.store import NOT_LIKE_FOR_LIKE, read_points, read_results, write_results
from benchmarks.suite import Measurements
from bodycheck._util.errors import InputError
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.file_size_limit import file_size_limit

ROOT = Path(__file__).parents[2]
COMMITTED = ROOT / "benchmarks"


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the benchmark in its own process, as a user does, and return its folder."""
    out = tmp_path_factory.mktemp("benchmarks") / "new"
    command = [sys.executable, "-W", "error", "-m", "benchmarks", "--quick", "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert NOT_LIKE_FOR_LIKE in done.stdout
    return out


@pytest.mark.nightly
def test_smoke_test_has_every_figure_and_no_verdict(quick: Path) -> None:
    """results.csv has the figures in order and no verdict; a figure that was not measured has the reason."""
    results = read_results(quick)
    assert list(results["figure"]) == [figure.name for figure in FIGURES]
    assert results.loc[results["value"].isna(), "note"].all()
    assert not results["verdict"].any()
    start = results["figure"].str.startswith("start.")
    assert results.loc[start, "value"].isna().all()
    assert results.loc[~start, "value"].notna().mean() > 0.8


@pytest.mark.nightly
def test_tuned_contenders_meet_the_target(quick: Path) -> None:
    """Each timed point's error is at most its target; one without a time has an error above it."""
    points = read_points(quick)
    timed = points["time_s"].notna()
    assert {"Taylor", "closed form", "MuJoCo rk4", "scipy DOP853"} <= set(points.loc[timed, "contender"])
    assert (points.loc[timed, "error"] <= points.loc[timed, "target_error"]).all()
    assert (points.loc[~timed, "error"] > points.loc[~timed, "target_error"]).all()
    assert (points.loc[timed, ["time_low_s", "time_s", "time_high_s"]].diff(axis=1).iloc[:, 1:] >= 0.0).all(
        axis=None
    )


@pytest.mark.nightly
def test_machine_is_described_without_paths(quick: Path) -> None:
    """machine.json has processor, cores, versions and the note that sizes differ; no path."""
    text = (quick / "machine.json").read_text()
    facts = json.loads(text)
    assert facts["note"] == NOT_LIKE_FOR_LIKE
    assert {"cpu", "cores", "python", "libraries", "load_average"} <= facts.keys()
    assert str(ROOT) not in text


def ended(words: list[str], monkeypatch: pytest.MonkeyPatch) -> object:
    """Run `python -m benchmarks words` in this process, and return its status."""
    monkeypatch.setattr("sys.argv", ["benchmarks", *words])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def not_to_be_reached(*reported: object) -> Measurements:
    """Fail in place of a measurement that must not begin."""
    raise AssertionError(reported)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--quick"], "--quick: benchmarks is for what was measured in full; name another folder by --out"),
        (["--quick", "--out", str(COMMITTED)], f"--quick: {COMMITTED} is for what was measured in full; .*"),
        (["--out", "file"], "--out file: cannot be written: Not a directory"),
        (["--out", "file/new"], "--out file/new: cannot be written: Not a directory"),
        (["--out", "/proc/new"], "--out /proc/new: cannot be written: .+"),
    ],
    ids=["no folder", "the committed ones", "a file", "within a file", "no place for files"],
)
def test_wrong_output_folder_is_refused_before_measuring(
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The refusal is one line with status 2; reduced sizes never replace the committed figures."""
    (tmp_path / "file").touch()
    monkeypatch.chdir(ROOT if words == ["--quick"] else tmp_path)
    monkeypatch.setattr("benchmarks.suite.measure", not_to_be_reached)
    assert ended(words, monkeypatch) == 2
    assert re.fullmatch(message + "\n", capsys.readouterr().err)


def test_interrupt_ends_in_one_line_without_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C during a measurement gives the status of an interrupt, and no folder."""

    def interrupted(*reported: object) -> Measurements:
        raise KeyboardInterrupt(reported)

    monkeypatch.setattr("benchmarks.suite.measure", interrupted)
    assert ended(["--out", str(tmp_path / "new")], monkeypatch) == 130
    assert capsys.readouterr().err == "stopped; nothing was written\n"
    assert not list(tmp_path.iterdir())


def test_full_disk_leaves_no_truncated_file(tmp_path: Path, expected_message: ExpectedMessage) -> None:
    """A file that cannot be written completely is absent, and one line names it."""
    points = read_points(COMMITTED)
    results = Measurements([Measured(figure.name, None) for figure in FIGURES], cast("Any", points))
    with pytest.MonkeyPatch.context() as patched, file_size_limit(10_000):
        patched.setattr("benchmarks.store.points_table", lambda measured: measured.points)
        with expected_message.raises(InputError):
            write_results(results, tmp_path, command="", quick=False)
    assert [file.name for file in tmp_path.iterdir()] == ["results.csv"]
    assert len(read_results(tmp_path)) == len(FIGURES)


@pytest.mark.parametrize(
    ("figure", "value", "verdict"),
    [
        (Figure("a", "", "", at_most=2.0), 2.0, "pass"),
        (Figure("a", "", "", at_most=2.0), 2.1, "miss"),
        (Figure("a", "", "", at_least=2.0), 2.0, "pass"),
        (Figure("a", "", "", at_least=2.0), 1.9, "miss"),
        (Figure("a", "", "", at_least=2.0), float("nan"), "miss"),
        (Figure("a", "", "", at_least=2.0), None, "not measured"),
        (Figure("a", "", ""), 2.0, ""),
    ],
)
def test_a_target_is_met_or_missed(figure: Figure, value: float | None, verdict: str) -> None:
    """A value at the bound meets it, a value beyond it or NaN misses it; a missing value does neither."""
    assert figure.verdict(value) == verdict


def test_names_of_figures_are_unique() -> None:
    """No two figures share a row."""
    assert len({figure.name for figure in FIGURES}) == len(FIGURES)


def test_committed_results_match_the_list() -> None:
    """results.csv has every figure with the targets of the code and their verdicts."""
    results = read_results(COMMITTED)
    assert list(results["figure"]) == [figure.name for figure in FIGURES]
    for figure, (_, row) in zip(FIGURES, results.iterrows(), strict=True):
        assert row["target"] == figure.target
        assert row["verdict"] == figure.verdict(None if pd.isna(row["value"]) else row["value"])
    against = results["figure"].str.startswith("against.")
    assert results.loc[against, "note"].str.contains(NOT_LIKE_FOR_LIKE, regex=False).all()


def test_readme_has_the_committed_numbers() -> None:
    """The README's table is generated from the committed results."""
    page = (ROOT / "README.md").read_text()
    assert with_table(page, markdown_table(read_results(COMMITTED))) == page


def test_picture_shows_the_committed_points() -> None:
    """The committed picture is generated from the committed points, and is well-formed."""
    drawn = work_precision_picture(read_points(COMMITTED))
    assert (COMMITTED / PICTURE).read_text() == drawn
    ET.fromstring(drawn)


def test_page_without_markers_is_refused(expected_message: ExpectedMessage) -> None:
    """The table is only put between the markers."""
    assert with_table(f"a\n{BEGIN}old\n{END}b\n", "new\n") == f"a\n{BEGIN}new\n{END}b\n"
    with expected_message.raises(ValueError):
        with_table(f"a\n{END}b\n{BEGIN}", "new\n")


@pytest.mark.parametrize(("word", "status"), [("--help", 0), ("quick", 2)])
def test_readme_is_written_only_without_arguments(
    word: str, status: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Help and unknown options leave it unchanged."""
    (tmp_path / "README.md").write_text("a page")
    monkeypatch.setattr("benchmarks.readme.ROOT", tmp_path)
    monkeypatch.setattr("sys.argv", ["readme", word])
    with pytest.raises(SystemExit) as end:
        rewrite_readme()
    assert end.value.code == status
    assert (tmp_path / "README.md").read_text() == "a page"


def test_terminal_counts_every_verdict() -> None:
    """The table counts met, missed and unmeasured targets."""
    rows = {
        "verdict": ["pass", "miss", "miss", "not measured"],
        "value": [1.0, 2.0, 3e8, float("nan")],
        "unit": ["us", "", "1/s", "x"],
        "target": ["<= 2", "<= 1", ">= 4e+08", ""],
        "what": ["first", "second", "third", "fourth"],
    }
    text = terminal_table(pd.DataFrame(rows))
    assert text.endswith("1 pass, 2 miss, 1 not measured")
    assert "3e+08 1/s" in text
    assert re.search(r"^not measured +- +fourth$", text, flags=re.MULTILINE)
