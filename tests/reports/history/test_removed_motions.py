"""The motions of a nightly run: kept for some runs, then removed, and computed again when needed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bodycheck._util.errors import InputError
from bodycheck.cli import commands
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.nightly_files import remove_old_motions
from bodycheck.reports.run_files.run_reader import read_run
from bodycheck.reports.run_files.run_tables import Run
from tests.helpers.nightly_runs import scaled, store_nightly_runs, unchanged

NEWER = [Path("newer")] * 7
ERROR = "orientation_error_rad"


@pytest.fixture(scope="module")
def stored(nightly_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the second of two nightly runs, in which one error is worse."""
    folder = tmp_path_factory.mktemp("nights")
    store_nightly_runs(nightly_run, folder, [unchanged, scaled(1.5, "m1")])
    return History(folder).runs()[-1]


@pytest.mark.nightly
def test_motions_are_removed_and_computed_again(stored: Path, nightly_run: Run) -> None:
    """The newest seven runs have all; older ones those of changed cases; the rest is the same when needed."""
    motions = stored / "trajectories"
    everything = sorted(motions.glob("*/*.npz"))
    remove_old_motions([stored, *NEWER[1:]])
    assert sorted(motions.glob("*/*.npz")) == everything
    remove_old_motions([stored, *NEWER])
    left = sorted(path.relative_to(motions).as_posix() for path in motions.glob("*/*.npz"))
    assert left == ["slow/reference_m1_0.01.npz", "slow/truth.npz"]
    run = read_run(stored, allow_code=False, cache=None)
    changed = [case for case in run.cases if case.columns["method"] == "m1" and case.dt_s == 0.01]
    assert len(run.cases) == len(nightly_run.cases)
    for case, measured in list(zip(run.cases, nightly_run.cases, strict=True))[::5]:
        if case is not changed[0]:
            assert case.trajectory is not None
            assert measured.trajectory is not None
            assert np.array_equal(case.trajectory.quaternion, measured.trajectory.quaternion)
    table = CliRunner().invoke(commands.app, ["table", str(stored), "results", "--columns", "method,dt_s"])
    assert len(table.stdout.splitlines()) == 1 + len(run.cases)


@pytest.mark.slow
def test_motion_is_computed_only_by_the_same_version(stored: Path, tmp_path: Path) -> None:
    """Another version of the engine may move otherwise, so the message names both."""
    remove_old_motions([stored, *NEWER])
    other = tmp_path / "other"
    other.mkdir()
    for path in stored.iterdir():
        if path.is_file():
            (other / path.name).write_bytes(path.read_bytes())
    table = other / "results.csv"
    version = read_run(stored, allow_code=False, cache=None).cases[0].columns["engine_version"]
    table.write_text(table.read_text().replace(f",{version},", ",0.0.1,"))
    case = read_run(other, allow_code=False, cache=None).cases[-1]
    with pytest.raises(InputError, match=f"needs reference 0.0.1, but version {version} is installed"):
        _ = case.trajectory


def content(folder: Path) -> dict[Path, bytes]:
    """Return every file of a folder."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.nightly
def test_report_of_a_nightly_run_is_rendered_elsewhere(stored: Path, tmp_path: Path) -> None:
    """In the run it would change a file whose checksum is stored."""
    before, page, summary = content(stored), tmp_path / "page.html", tmp_path / "summary.md"
    for place in ([], ["--html", str(stored / "new.html")], ["--markdown", str(stored / "new.md")]):
        done = CliRunner().invoke(commands.app, ["report", str(stored), *place])
        assert "belongs to a nightly run, which is not changed" in str(done.exception)
    command = ["report", str(stored), "--html", str(page), "--markdown", str(summary)]
    done = CliRunner().invoke(commands.app, command, catch_exceptions=False)
    assert done.stdout.split() == [str(summary), str(page)]
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert "reference:m1" in summary.read_text(encoding="utf-8")
    assert content(stored) == before


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("command", "kind", "first"),
    [
        (["plot", "--figure", "drift", "--scenario", "slow"], "svg", b"<?xml"),
        (["movie", "--scenario", "slow"], "gif", b"GIF89a"),
        (["explain", "--case", "slow,reference:m1,0.05"], "html", b"<!doctype html>"),
    ],
    ids=["plot", "movie", "explain"],
)
def test_motions_of_a_nightly_run_are_drawn_and_explained(
    command: list[str], kind: str, first: bytes, stored: Path, tmp_path: Path
) -> None:
    """Like those of any run; the files of the nightly run are the same afterwards."""
    before, file = content(stored), tmp_path / f"file.{kind}"
    name, *options = command
    arguments = [name, str(stored), *options, f"--{kind}", str(file)]
    done = CliRunner().invoke(commands.app, arguments, catch_exceptions=False)
    assert (done.exit_code, file.read_bytes()[: len(first)]) == (0, first)
    assert content(stored) == before


@pytest.mark.slow
def test_trends_have_every_measure_with_its_level_and_when_it_was_worse(stored: Path) -> None:
    """One series per case and measure; equal values of successive runs are stored once."""
    page = (stored.parent / "trends.html").read_text()
    data = json.loads(re.findall(r'id="data">(.*?)</script>', page, re.DOTALL)[0])
    assert data["start"] == "reference:m1|slow|orientation_error_rad"  # the measure of the headline
    assert data["runs"] == [run.name for run in History(stored.parent).runs()]
    series = {(one["m"], one["s"], one["q"], one["f"]): one for one in data["series"]}
    worse = series["reference:m1", "slow", ERROR, "dt 0.01 s"]
    (first, _, before), (second, _, after) = worse["v"]
    assert (first, second, worse["w"], worse["l"]) == (0, 1, [1], [[0, before]])
    assert after == pytest.approx(1.5 * before, rel=1e-4)
    same = series["reference:m1", "slow", ERROR, "dt 0.005 s"]
    assert ([len(same["v"]), same["v"][0][:2]], "w" in same) == ([1, [0, 2]], False)
    assert {q for _, _, q, _ in series} > {"energy_drift", "omega_error", "relative_cpu"}
    assert "reference:m1|slow|orientation_error_rad" in page
