"""A night beside its past: what changed is named, nothing else is, and no damage is taken for a result."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from made_nights import Change, run_of_night, slower, stored, unchanged

from bodycheck._util.errors import InputError
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.history.accepted_levels import read_accepted
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import seal_night
from bodycheck.reports.history.history_output import night_sentences
from bodycheck.reports.history.queries import nights_table, query
from bodycheck.reports.history.regression import Judgement
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Run

pytestmark = pytest.mark.slow


def of(results: pd.DataFrame, method: str, dt_s: float | None = None, scenario: str = "slow") -> Any:
    """Return which rows are those of a method on a scenario, at any step or at one."""
    mine = (results["scenario"] == scenario) & (results["method"] == method)
    return mine if dt_s is None else mine & (results["dt_s"] == dt_s)


def planted(measure: str, amount: float, method: str = "m1", dt_s: float = 0.01) -> Change:
    """Return what adds something to one cell."""

    def change(results: pd.DataFrame) -> pd.DataFrame:
        results.loc[of(results, method, dt_s), measure] += amount
        return results

    return change


def scaled(factor: float, method: str = "m1", dt_s: float = 0.01) -> Change:
    """Return what multiplies the orientation error of one case."""

    def change(results: pd.DataFrame) -> pd.DataFrame:
        results.loc[of(results, method, dt_s), "orientation_error_rad"] *= factor
        return results

    return change


def ended(outcome: str, method: str = "m1", dt_s: float = 0.01) -> Change:
    """Return what lets one case end otherwise, with nothing measured."""

    def change(results: pd.DataFrame) -> pd.DataFrame:
        mine = of(results, method, dt_s)
        kept = ["run_id", "scenario", "engine", "engine_version", "method", "control", "dt_s", "reproduce"]
        kept.append("reused")  # a yes or no is never missing
        results.loc[mine, [name for name in results.columns if name not in kept]] = None
        results.loc[mine, "outcome"] = outcome
        return results

    return change


def told(judged: Judgement) -> list[tuple[str, str, str]]:
    """Return kind, what and status of each change."""
    assert judged.comparison is not None
    return [(change.kind, change.quantity, change.status) for change in judged.comparison.changes]


@pytest.fixture(scope="module")
def _two_nights(night_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    stored(night_run, folder, [unchanged, unchanged])
    return folder


@pytest.fixture
def two_nights(_two_nights: Path, tmp_path: Path) -> Path:
    """Return a history of two unchanged nights, to be added to."""
    return shutil.copytree(_two_nights, tmp_path / "two")


@pytest.fixture(scope="module")
def one_worse(night_run: Run, tmp_path_factory: pytest.TempPathFactory) -> History:
    """Return a history in which the energy drifts more on the second night, to be asked."""
    folder = tmp_path_factory.mktemp("worse")
    stored(night_run, folder, [unchanged, planted("energy_drift", 0.1)])
    return History(folder)


def test_the_first_night_has_no_past_and_the_second_has(night_run: Run, tmp_path: Path) -> None:
    """History is insufficient on the first; an unchanged second is no regression."""
    first, second = stored(night_run, tmp_path, [unchanged, unchanged])
    assert (first.status, first.comparison) == ("insufficient history", None)
    assert second.status == "no regression"
    assert told(second) == []


def test_twenty_unchanged_nights_tell_nothing(night_run: Run, tmp_path: Path) -> None:
    """Whatever the times do by chance, no measure and no speed is said to have changed."""
    rng = np.random.default_rng(0)

    def by_chance(results: pd.DataFrame) -> pd.DataFrame:
        results["relative_cpu"] *= 10.0 ** rng.normal(0.0, 0.02, len(results))
        return results

    nights = stored(night_run, tmp_path, 21 * [by_chance])
    assert [judged.status for judged in nights[1:]] == 20 * ["no regression"]
    assert [told(judged) for judged in nights[1:]] == 20 * [[]]


@pytest.mark.parametrize(
    ("factor", "status"), [(1.0 + 1e-7, "moved"), (0.99, "moved"), (1.05, "worse"), (0.95, "improved")]
)
def test_a_change_is_named_and_only_what_is_worse_fails(
    night_run: Run, tmp_path: Path, factor: float, status: str
) -> None:
    """Engine, method, scenario, step and measure; below 2 % it has moved, above it is worse or improved."""
    *_, judged = stored(night_run, tmp_path, [unchanged, scaled(factor)])
    assert judged.comparison is not None
    (change,) = judged.comparison.changes
    assert (change.scenario, change.engine, change.method, change.fineness) == (
        "slow",
        "reference",
        "m1",
        0.01,
    )
    assert (change.quantity, change.status) == ("orientation_error_rad", status)
    assert judged.status == ("regression" if status == "worse" else "no regression")


@pytest.mark.parametrize("percent", [0.5, -0.5])
def test_small_steps_cannot_creep(night_run: Run, tmp_path: Path, percent: float) -> None:
    """Ten nights of half a percent each are reported where their sum passes 2 %, and from there anew."""
    step = 1.0 + percent / 100.0
    nights = stored(night_run, tmp_path, [scaled(step**k) for k in range(11)])
    found = [judged.comparison.changes[0].status for judged in nights[1:] if judged.comparison]
    reported = "worse" if percent > 0.0 else "improved"
    assert found == [*3 * ["moved"], reported, *3 * ["moved"], reported, *2 * ["moved"]]
    levels = [read_accepted(night, read_tables(night)) for night in History(tmp_path).nights()]
    values = [
        case.columns["orientation_error_rad"]
        for tables in levels
        for case in tables.cases
        if (case.columns["scenario"], case.columns["method"], case.dt_s) == ("slow", "m1", 0.01)
    ]
    assert len(dict.fromkeys(values)) == 3  # the first level, and one for each report


def test_a_threshold_of_its_own_holds_for_the_nights_that_are_given_it(
    night_run: Run, tmp_path: Path
) -> None:
    """Half of it moves, and what passes it is worse."""
    thresholds = Thresholds(0.2)
    nights = stored(night_run, tmp_path, map(scaled, (1.0, 1.1, 1.3)), thresholds=thresholds)
    assert [judged.status for judged in nights] == ["insufficient history", "no regression", "regression"]


def test_a_history_without_levels_is_compared_with_what_was_measured(
    night_run: Run, two_nights: Path
) -> None:
    """Nights that were stored before there were levels are their own."""
    for night in History(two_nights).nights():
        (night / "accepted.csv").unlink()
        seal_night(night)
    (judged,) = stored(night_run, two_nights, [scaled(1.05)], first=2)
    assert judged.status == "regression"


def test_a_change_is_told_once(night_run: Run, tmp_path: Path) -> None:
    """The night after is compared with the night that told it."""
    worse = planted("energy_drift", 0.1)
    nights = stored(night_run, tmp_path, [unchanged, worse, worse])
    assert [judged.status for judged in nights] == ["insufficient history", "regression", "no regression"]


def test_what_is_not_measured_any_more_is_a_regression(night_run: Run, tmp_path: Path) -> None:
    """A case that is gone, one that fails, a measure that is empty; a new case is none."""

    def gone(results: pd.DataFrame) -> pd.DataFrame:
        return results[~of(results, "m2")]

    def emptied(results: pd.DataFrame) -> pd.DataFrame:
        results.loc[of(results, "rk4", 0.01), "energy_drift"] = np.nan
        return results

    for place, (change, kind, how) in enumerate(
        (
            (gone, "case", "missing"),
            (ended("failed"), "outcome", "worse"),
            (emptied, "accuracy", "missing"),
        )
    ):
        _, judged, back = stored(night_run, tmp_path / str(place), [unchanged, change, unchanged])
        assert judged.status == "regression"
        assert {(found, status) for found, _, status in told(judged)} == {(kind, how)}
        assert back.status == "no regression"


def test_a_night_that_measured_nothing_never_passes(night_run: Run, tmp_path: Path) -> None:
    """Neither the first, nor one that is no worse than the night before."""

    def all_failed(results: pd.DataFrame) -> pd.DataFrame:
        return results.assign(outcome="failed")

    nights = stored(night_run, tmp_path, [all_failed, all_failed])
    assert [judged.status for judged in nights] == 2 * ["nothing measured"]


def test_a_case_that_comes_back_is_compared_with_when_it_last_ended_well(
    night_run: Run, tmp_path: Path
) -> None:
    """A crash for three nights hides no change of what the case measures."""
    stored(night_run, tmp_path / "worse", [unchanged, *3 * [ended("failed")]])
    shutil.copytree(tmp_path / "worse", tmp_path / "same")
    (judged,) = stored(night_run, tmp_path / "worse", [planted("orientation_error_rad", 0.1)], first=4)
    assert ("accuracy", "orientation_error_rad", "worse") in told(judged)
    (same,) = stored(night_run, tmp_path / "same", [unchanged], first=4)
    assert told(same) == [("outcome", "outcome", "improved")]


def test_a_slower_engine_is_told_and_then_usual(night_run: Run, tmp_path: Path) -> None:
    """A fifth more time on each night from the eighth on: told once a method, within five nights."""
    rng = np.random.default_rng(1)

    def night(number: int) -> Change:
        def change(results: pd.DataFrame) -> pd.DataFrame:
            results["relative_cpu"] *= 10.0 ** rng.normal(0.0, 0.01, len(results))
            return slower(results, "reference", 1.2) if number >= 8 else results

        return change

    nights = stored(night_run, tmp_path, [night(number) for number in range(18)])
    alarms = {
        (number, change.method)
        for number, judged in enumerate(nights)
        for change in (judged.comparison.changes if judged.comparison else ())
        if change.kind == "speed" and change.status == "worse"
    }
    assert {method for _, method in alarms} == {"m1", "m2", "rk4"}
    assert len(alarms) == 3
    assert all(8 <= number <= 12 for number, _ in alarms)


def test_nights_of_other_machines_are_another_past(night_run: Run, two_nights: Path) -> None:
    """Two classes of machines share a folder, and each night is compared with its own."""
    (other,) = stored(night_run, two_nights, [planted("energy_drift", 0.1)], first=2, cpu="another processor")
    assert other.status == "insufficient history"
    (mine,) = stored(night_run, two_nights, [unchanged], first=3)
    assert mine.status == "no regression"
    assert mine.comparison is not None
    assert mine.comparison.before.run_id == run_of_night(night_run, 1).run_id


def test_a_scenario_that_means_another_thing_is_not_compared(night_run: Run, two_nights: Path) -> None:
    """Where no scenario is what it was, there is nothing to compare with: insufficient history."""
    known = night_run.manifest["scenarios"]
    longer = {name: {**scenario, "duration_s": 2.0} for name, scenario in known.items()}
    (judged,) = stored(night_run, two_nights, [slower_all], first=2, scenarios=longer)
    assert judged.status == "insufficient history"
    assert judged.comparison is not None
    assert set(judged.comparison.redefined) == {"slow", "quick"}
    assert float(np.nanmax(np.abs(judged.speeds.series.decades))) == 0.0


def slower_all(results: pd.DataFrame) -> pd.DataFrame:
    """Return the results of an engine three times as slow."""
    return slower(results, "reference", 3.0)


@pytest.mark.parametrize(
    "file",
    ["manifest.json", "results.csv", "results.parquet", "night.json", "methods.csv", "accepted.csv"],
)
def test_a_damaged_night_is_left_out_and_named(night_run: Run, two_nights: Path, file: str) -> None:
    """Tonight is compared with the night before it, and stored."""
    damaged = two_nights / run_of_night(night_run, 1).run_id / file
    damaged.write_bytes(damaged.read_bytes()[: damaged.stat().st_size // 2])
    (judged,) = stored(night_run, two_nights, [planted("energy_drift", 0.1)], first=2)
    assert judged.status == "regression"
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == run_of_night(night_run, 0).run_id
    assert any(damaged.parent.name in sentence for sentence in night_sentences(judged))


def test_a_night_keeps_all_that_was_measured_and_told(night_run: Run, one_worse: History) -> None:
    """Its folder is a run that can be read; CSV and Parquet hold the same; night.json counts the changes."""
    night = one_worse.nights()[-1]
    assert len(read_tables(night).cases) == len(night_run.results)
    found = json.loads((night / "night.json").read_text())
    assert [found[name] for name in ("status", "worse", "missing", "improved", "moved")] == [
        "regression",
        *(1, 0, 0, 0),
    ]
    (change,) = pd.read_csv(night / "changes.csv").to_dict("records")
    assert (change["quantity"], change["method"], change["fineness"]) == ("energy_drift", "m1", 0.01)
    for page in ("night.html", "report.html", "night.md"):
        assert "m1" in (night / page).read_text()


def test_a_history_is_asked_in_sql(night_run: Run, one_worse: History) -> None:
    """Every table of every night is there, under its night, as it was measured."""
    sql = (
        "SELECT run_id, max(energy_drift) AS most FROM results WHERE method = 'm1' GROUP BY run_id ORDER BY 1"
    )
    found = query(one_worse.nights(), sql)
    mine = night_run.results[night_run.results["method"] == "m1"]["energy_drift"].max()
    assert found["run_id"].tolist() == [night.name for night in one_worse.nights()]
    assert found["most"][0] == mine
    (counted,) = query(
        one_worse.nights(),
        "SELECT (SELECT count(*) FROM nights) AS nights, (SELECT count(*) FROM changes) AS changes, "
        "(SELECT count(*) FROM methods) AS methods, (SELECT count(*) FROM stability) AS stability",
    ).to_dict("records")
    assert counted == {
        "nights": 2,
        "changes": 1,
        "methods": 2 * len(night_run.methods),
        "stability": 2 * len(night_run.stability),
    }
    assert nights_table(one_worse.nights())["status"].tolist() == ["insufficient history", "regression"]


@pytest.mark.parametrize("sql", ["SELECT * FROM absent", "SELEC", ""])
def test_a_wrong_question_is_one_line(one_worse: History, sql: str) -> None:
    """What the database says of it, and nothing else."""
    with pytest.raises(InputError) as refused:
        query(one_worse.nights(), sql)
    assert "\n" not in str(refused.value)
