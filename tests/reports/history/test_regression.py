"""The judgement of a nightly run: what is worse, what recovers, what is left out."""

from __future__ import annotations

import json
import math
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reports.comparison.change import Change as OneChange
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.history import regression
from bodycheck.reports.history.acceptances import accept
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import seal_run
from bodycheck.reports.history.headline import headline
from bodycheck.reports.history.history_output import nightly_commands, nightly_sentences
from bodycheck.reports.history.levels import ABSENT, Levels, LevelSource, read_levels, write_levels
from bodycheck.reports.history.open_regressions import NightlyState, open_lines
from bodycheck.reports.history.queries import history_table, query
from bodycheck.reports.history.regression import Judgement, judge_run, speeds_of
from bodycheck.reports.measurement.measures import SIGNED
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Run, Tables
from bodycheck.reports.run_files.tables import TABLES, as_csv, as_table
from tests.helpers.gate_tables import METHOD, make_tables, with_tables
from tests.helpers.nightly_runs import (
    Change,
    as_nightly_run,
    judged_nightly_runs,
    scaled,
    slower,
    store_nightly_runs,
    unchanged,
)

NOTHING_OPEN = NightlyState()
ERROR = "orientation_error_rad"
COLUMNS = ["engine", "method", "scenario", "control", "dt_s", "tolerance", "relative_cpu", ERROR]


def tables(number: int, *cases: dict[str, Any], **parts: Any) -> Tables:
    """Return the tables of one nightly run; by default of one case."""
    made = make_tables(list(cases or ({},)), **{"scenarios": {"brick": {}, "plate": {}}, **parts})
    return replace(made, run_id=f"night {number}")


def judgements_of(*runs: Tables, monkeypatch: pytest.MonkeyPatch) -> list[Judgement]:
    """Return the judgement of each of these runs, made when it was stored."""
    before: list[SimpleNamespace] = []
    judged: list[Judgement] = []
    for newest in runs:
        judged.append(judged_after(before, newest, monkeypatch))
        before.insert(0, run_of(newest, judged[-1].levels, judged[-1].state))
    return judged


def judgement_of(*runs: Tables, monkeypatch: pytest.MonkeyPatch) -> Judgement:
    """Return the judgement of the last of these runs, after each was judged when it was stored."""
    return judgements_of(*runs, monkeypatch=monkeypatch)[-1]


def run_of(found: Tables, levels: Levels, state: NightlyState = NOTHING_OPEN) -> SimpleNamespace:
    """Return an earlier nightly run, with the levels accepted after it and what was open."""

    def same_scenarios(manifest: dict[str, Any]) -> set[str]:
        mine = found.manifest["scenarios"]
        return {name for name, about in mine.items() if manifest["scenarios"].get(name) == about}

    return SimpleNamespace(
        name=found.run_id,
        folder=Path(found.run_id),
        tables=found,
        levels=levels,
        state=state,
        same_scenarios=same_scenarios,
        manifest=found.manifest,
    )


def judged_after(before: list[SimpleNamespace], newest: Tables, monkeypatch: pytest.MonkeyPatch) -> Judgement:
    """Return the judgement of a nightly run against its baseline runs, newest first."""
    by_folder = {run.folder: run.tables for run in before}

    def recorded(folders: list[Path]) -> pd.DataFrame:
        found = [by_folder[one].results.assign(run=one.name) for one in folders]
        well = [cases.loc[cases["outcome"] == "ok", ["run", *COLUMNS]] for cases in found]
        return pd.concat(well) if well else pd.DataFrame(columns=["run", *COLUMNS])

    baseline = SimpleNamespace(runs=list(before), other=None, left_out=(), first=())
    monkeypatch.setattr(regression, "baseline_of", lambda _, manifest: baseline if manifest else None)
    monkeypatch.setattr(regression, "_with_acceptances", lambda _, baseline: (baseline, ()))
    monkeypatch.setattr(regression, "recorded_cases", recorded)
    return judge_run(History(Path("nights")), newest)


def kinds_and_steps(found: Judgement) -> list[tuple[str, str, float | None]]:
    """Return kind, status and step of each change."""
    assert found.comparison is not None
    return [(one.kind, one.status, one.fineness) for one in found.comparison.changes]


FAILED = {"outcome": "failed", "message": "boom", ERROR: None}
WORSE = {ERROR: 1e-6}
SOUND = (1e-9, 4.0, "converges")
LOWER_ORDER = (1e-6, 1.0, "converges")
DIVERGENT = (1e-6, None, "does-not-converge")


@pytest.mark.parametrize(
    ("runs", "status"),
    [
        ((tables(0),), "insufficient history"),
        ((tables(0, FAILED),), "nothing measured"),
        ((tables(0), tables(1)), "no regression"),
        ((tables(0), tables(1, WORSE)), "regression"),
        ((tables(0, WORSE), tables(1)), "no regression"),
        ((tables(0), tables(1, FAILED)), "nothing measured"),
        ((tables(0), tables(1, FAILED, {"dt_s": 0.02})), "regression"),
        ((tables(0), tables(1, {"method": "euler"})), "regression"),
        ((tables(0, {}, {"dt_s": 0.02}), tables(1)), "regression"),
        ((tables(0), tables(1, {}, {"dt_s": 0.02})), "no regression"),
        ((tables(0, {"omega_error": 1.0}), tables(1)), "regression"),
        ((tables(0), tables(1, {"omega_error": 1.0})), "no regression"),
    ],
)
def test_run_is_a_regression_if_anything_is_worse_or_missing(
    runs: tuple[Tables, ...], status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A missing case or measure is worse, a new one is not; a run that measured nothing never passes."""
    found = judgement_of(*runs, monkeypatch=monkeypatch)
    assert found.status == status
    assert ("; boom." in headline(found)) == (status == "nothing measured")
    assert found.newest is runs[-1]
    assert (found.comparison is None) == (len(runs) == 1)


def test_recovered_case_is_compared_with_its_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long ago it last ended well, each case with its own; that it failed is over."""
    other = {"dt_s": 0.02}
    runs = [
        tables(0, {}, {**other, ERROR: 1e-8}),
        tables(1, {}, {**other, **FAILED}),
        tables(2, FAILED, {**other, **FAILED}),
        tables(3, WORSE, {**other, **WORSE}),
    ]
    found = judgement_of(*runs, monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == [("accuracy", "worse", 0.01), ("accuracy", "worse", 0.02)]
    assert [one.change.before for one in found.open] == [1e-9, 1e-8]
    assert sorted((one.change.kind, one.since) for one in found.state.closed) == [
        ("outcome", "night 1"),
        ("outcome", "night 2"),
    ]


def test_a_method_has_not_recovered_while_one_of_its_values_is_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    """An order that a worse verdict replaces is neither open nor recovered."""
    runs = [
        with_tables(
            tables(k, {ERROR: error}),
            methods=[METHOD | {"order": order, "order_low": order, "order_high": order, "verdict": verdict}],
        )
        for k, (error, order, verdict) in enumerate([SOUND, LOWER_ORDER, DIVERGENT, SOUND])
    ]
    open_kinds, recovered = [], []
    for found in judgements_of(*runs, monkeypatch=monkeypatch)[1:]:
        open_kinds.append({one.change.kind for one in found.open})
        recovered.append({one.change.kind for one in found.state.recovered})
    assert open_kinds == [{"accuracy", "order"}, {"accuracy", "verdict"}, set()]
    assert recovered == [set(), set(), {"accuracy", "verdict"}]


def test_a_worse_verdict_is_new_again_once_it_is_more_severe(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lower order that becomes a motion without convergence is reported again, the way back is not."""
    verdicts = ["converges", "lower-order", "does-not-converge", "lower-order"]
    runs = [
        with_tables(
            tables(k, WORSE if k else {}),
            methods=[METHOD | {"order": None, "order_low": None, "order_high": None, "verdict": verdict}],
        )
        for k, verdict in enumerate(verdicts)
    ]
    newly = [
        [one.newly for one in found.open if one.change.kind == "verdict"]
        for found in judgements_of(*runs, monkeypatch=monkeypatch)[1:]
    ]
    assert newly == [[True], [True], [False]]


@pytest.mark.parametrize(("order", "is_open"), [(None, True), (4.0, False)])
def test_a_lower_order_stays_open_until_an_order_is_measured(
    monkeypatch: pytest.MonkeyPatch, order: float | None, is_open: bool
) -> None:
    """An undecided verdict closes it with an order as before, and does not without one."""
    orders = [(4.0, "converges"), (1.0, "converges"), (order, "undecided")]
    runs = [
        with_tables(
            tables(k),
            methods=[METHOD | {"order": p, "order_low": p, "order_high": p, "verdict": verdict}],
        )
        for k, (p, verdict) in enumerate(orders)
    ]
    found = judgement_of(*runs, monkeypatch=monkeypatch).open
    assert ("order" in {one.change.kind for one in found}) == is_open


def test_another_map_is_new_until_the_next_night(monkeypatch: pytest.MonkeyPatch) -> None:
    """A map that differs from that of the night before is new, one that stays is not."""
    method = {name: METHOD[name] for name in ("engine", "method")}
    runs = [
        with_tables(tables(k), fingerprints=[method | {"fingerprint": name}])
        for k, name in enumerate(("M1", "M2", "M2", "M3"))
    ]
    found = [judged.other_maps for judged in judgements_of(*runs, monkeypatch=monkeypatch)[1:]]
    assert [[(one.runs, one.newly) for one in maps] for maps in found] == [
        [(1, True)],
        [(2, False)],
        [(3, True)],
    ]


def test_the_cause_of_an_open_regression_is_that_of_the_night(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault that another one replaces is no longer named, although the same value stays worse."""
    study = {name: METHOD[name] for name in ("scenario", "engine", "method")}

    def night(number: int, error: float, *faults: str) -> Tables:
        told = [
            study | {"verdict": "explained", "faults": fault, "diagnosis": f"{fault} (explains all)"}
            for fault in faults
        ]
        return with_tables(tables(number, {ERROR: error}), diagnoses=told)

    runs = [night(0, 1e-9), night(1, 1e-6, "damping"), night(2, 1e-4), night(3, 1e-4, "gravity")]
    found = judgements_of(*runs, monkeypatch=monkeypatch)[1:]
    causes = [[one.cause for one in judged.open] for judged in found]
    assert causes == [["damping, explains all"], [""], ["gravity, explains all"]]


def test_a_new_cause_is_not_that_of_what_was_as_bad_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """What two nights made worse of a method is two lines, each with its age, its cause and one id."""
    study = {name: METHOD[name] for name in ("scenario", "engine", "method")}
    why = [study | {"verdict": "explained", "faults": "gravity", "diagnosis": "gravity (explains all)"}]
    maps = [{name: METHOD[name] for name in ("engine", "method")} | {"fingerprint": f"M{k}"} for k in (1, 2)]
    sound, worse, norm = 1e-9, 1e-4, "quaternion_norm_error"

    def night(number: int, error: float, of_norm: float, diagnoses: list[dict[str, Any]]) -> Tables:
        found = tables(number, {ERROR: error, norm: of_norm})
        return with_tables(found, diagnoses=diagnoses, fingerprints=[maps[of_norm > sound]])

    runs = [night(1, sound, 0.0, []), night(2, sound, 1e-7, []), night(3, worse, 1e-7, why)]
    *_, second, third = judgements_of(*runs, night(4, worse, 1e-7, why), monkeypatch=monkeypatch)
    for judged, runs_since in ((second, {norm: 2, ERROR: 1}), (third, {norm: 3, ERROR: 2})):
        lines = {one.line.main.quantity: one for one in open_lines(judged.open)}
        assert {name: one.regressions[0].runs for name, one in lines.items()} == runs_since
        assert {name: one.line.cause for name, one in lines.items()} == {
            norm: "",
            ERROR: "gravity, explains all",
        }
        (command,) = nightly_commands(judged)  # that of the first line: the map has the id of a line
        assert open_lines(judged.open)[0].id in command.text


def test_a_fault_that_replaces_another_is_as_old_as_its_night(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first line counts the nightly runs of the cause that it names, whatever its numbers."""
    study = {name: METHOD[name] for name in ("scenario", "engine", "method")}

    def night(number: int, *faults: str) -> Tables:
        rows = [study | {"verdict": "explained", "faults": "one", "diagnosis": fault} for fault in faults]
        return with_tables(tables(number, {ERROR: 1e-4 if faults else 1e-9}), diagnoses=rows)

    runs = [night(0), night(1, "damping 0.1/s"), night(2, "damping 0.1001/s"), night(3, "gravity")]
    found = [judged.open for judged in judgements_of(*runs, monkeypatch=monkeypatch)[1:]]
    assert [[(one.runs, one.newly) for one in open_now] for open_now in found] == [
        [(1, True)],
        [(2, False)],
        [(1, True)],
    ]


def creeping(*errors: float | None, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the status of the error in each run after the first; None: the case failed."""
    runs = [tables(k, FAILED if error is None else {ERROR: error}, OTHER) for k, error in enumerate(errors)]
    found = []
    for judged in judgements_of(*runs, monkeypatch=monkeypatch)[1:]:
        changes = judged.comparison
        assert changes is not None
        found.append(" ".join(one.status for one in changes.changes if one.kind == "accuracy"))
    return found


OTHER = {"method": "euler"}  # a case that always ends well


@pytest.mark.slow(after=3)
@pytest.mark.parametrize(
    ("errors", "statuses"),
    [
        ((1.0, 1.01, 1.02, 1.03, 1.03), ["moved", "moved", "worse", "worse"]),
        ((1.0, 0.99, 0.98, 0.97, 0.97), ["moved", "improved", "improved", "moved"]),
        ((1.0, 0.5, 1.0, 0.5, 0.5, 0.5), ["improved", "", "improved", "improved", ""]),
        ((1.0, 0.5, 0.7, 0.7), ["improved", "improved", ""]),
        ((1.0, 0.7, 0.5, 0.7), ["improved", "improved", ""]),
        ((1.0, 0.5, None, 0.5, 0.5), ["improved", "", "improved", ""]),
        ((1.0, 1.01, 1.0, 1.01, 1.0), ["moved", "", "moved", ""]),
        ((1.0, 1.05, 1.04, 1.03, 1.02), ["worse", "worse", "worse", "moved"]),
        ((1.0, 1.01, None, 1.025, 1.025), ["moved", "", "worse", "worse"]),
        ((1.0, 1.0 + 1e-15, 1.0, 2.0, 1.0), ["", "", "worse", ""]),
    ],
)
def test_error_is_compared_with_its_accepted_level(
    errors: tuple[float | None, ...], statuses: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small steps add up; only an improvement that two runs show is a level, the worse of the two."""
    scaled = (error if error is None else 1e-3 * error for error in errors)
    assert creeping(*scaled, monkeypatch=monkeypatch) == statuses


def test_each_measure_has_its_own_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new level of one measure does not change that of another."""
    runs = [
        tables(k, {ERROR: 1e-3 * error, "omega_error": 1e-3 * omega})
        for k, (error, omega) in enumerate(((1.0, 1.0), (0.5, 1.01), (0.5, 1.01), (0.5, 1.03)))
    ]
    found = judgement_of(*runs, monkeypatch=monkeypatch)
    assert found.comparison is not None
    (change,) = found.comparison.changes
    assert (change.quantity, change.status, change.before) == ("omega_error", "worse", 1e-3)
    assert found.levels.setting(change) == LevelSource("night 0", "first value")
    improved = replace(change, quantity=ERROR)
    assert found.levels.setting(improved) == LevelSource("night 2", "improvement")


def test_changed_scenario_starts_with_new_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    """No level of the old scenario counts for the new one."""
    scenarios = {"brick": {"mass": 2.0}, "plate": {}}
    runs = [tables(0), tables(1, WORSE, scenarios=scenarios), tables(2, WORSE, scenarios=scenarios)]
    found = judgement_of(*runs, monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == []
    assert [row[ERROR] for row in found.levels.rows("results").values()] == [1e-6]


def without_plate(number: int, *cases: dict[str, Any]) -> Tables:
    """Return the tables of a nightly run that does not have the scenario `plate`."""
    return tables(number, *(cases or ({},)), scenarios={"brick": {}})


def test_case_that_returns_after_a_run_without_it_is_compared_with_its_level(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A case is missing until it returns; if it then fails, it became worse."""
    plate = {"scenario": "plate"}
    runs = [tables(0, {}, plate), without_plate(1)]
    assert kinds_and_steps(judgement_of(*runs, monkeypatch=monkeypatch)) == [("case", "missing", 0.01)]
    found = judgement_of(*runs, without_plate(2), monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == [("case", "missing", 0.01)]
    assert [(one.since, one.runs, one.newly) for one in found.open] == [("night 1", 2, False)]
    for cells, kind in ((FAILED, "outcome"), (WORSE, "accuracy")):
        found = judgement_of(*runs, without_plate(2), tables(3, {}, plate | cells), monkeypatch=monkeypatch)
        assert kinds_and_steps(found) == [(kind, "worse", 0.01)]
        assert found.status == "regression"
    found = judgement_of(*runs, tables(2, {}, plate), monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == []


def test_engine_that_returns_in_another_version_is_compared_with_its_level(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its versions are one engine, also if a run lacked it."""
    other = {"engine": "dart"}
    runs = [tables(0, {"engine": "mujoco==1"}, other), tables(1, other)]
    failed = tables(2, {"engine": "mujoco==2"} | FAILED, other)
    found = judgement_of(*runs, failed, monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == [("outcome", "worse", 0.01)]
    drifted = [
        tables(2 + k, {"engine": f"mujoco=={2 + k}", ERROR: 1e-9 * (1.0 + 0.015 * k)}, other)
        for k in range(3)
    ]
    found = judgement_of(*runs, *drifted, monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == [("accuracy", "worse", 0.01)]
    assert sorted(row["engine"] for row in found.levels.rows("results").values()) == ["dart", "mujoco==4"]


@pytest.mark.parametrize("between", [0, 1, 3])
def test_scenario_redefined_while_it_was_missing_starts_with_new_levels(
    between: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is compared with its newest definition, in whichever run that is."""
    plate = {"scenario": "plate"}
    runs = [tables(0, {}, plate), *(without_plate(1 + number) for number in range(between))]
    changed = tables(9, {}, plate | WORSE, scenarios={"brick": {}, "plate": {"duration_s": 2.0}})
    found = judgement_of(*runs, changed, monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == []
    assert found.comparison is not None
    assert found.comparison.redefined == ("plate",)
    assert {row["scenario"]: row[ERROR] for row in found.levels.rows("results").values()} == {
        "brick": 1e-9,
        "plate": 1e-6,
    }


def test_level_of_a_scenario_that_no_run_defines_any_more_is_discarded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The runs that defined it are no baseline any more, so nobody knows whether it is the same."""
    plate = {"scenario": "plate"}
    judged_after([], tables(0), monkeypatch)
    old = run_of(without_plate(1), Levels.of(tables(1, {}, plate)))
    found = judged_after([old], tables(2, {}, plate | WORSE), monkeypatch)
    assert kinds_and_steps(found) == [("case", "new", 0.01)]
    assert {row["scenario"]: row[ERROR] for row in found.levels.rows("results").values()} == {
        "brick": 1e-9,
        "plate": 1e-6,
    }


def test_another_version_of_an_engine_keeps_the_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    """`mujoco==3.16.0`, `mujoco==3.17.0` and the installed one are one engine with one error."""
    runs = [
        tables(k, {"engine": name, ERROR: 1e-3 * error})
        for k, (name, error) in enumerate(
            (("mujoco==3.16.0", 1.0), ("mujoco", 1.015), ("mujoco==3.17.0", 1.03))
        )
    ]
    found = judgement_of(*runs, monkeypatch=monkeypatch)
    assert kinds_and_steps(found) == [("accuracy", "worse", 0.01)]
    assert [row["engine"] for row in found.levels.rows("results").values()] == ["mujoco==3.17.0"]


def test_speed_is_judged_by_all_baseline_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """1.5 times as slow in five runs is one change, reported once; in one run it is none."""
    timed = [
        {"relative_cpu": 1.0, "cpu_s_low": 1.0, "cpu_s": 1.0, "cpu_s_high": 1.0},
        {"relative_cpu": 1.5, "cpu_s_low": 1.5, "cpu_s": 1.5, "cpu_s_high": 1.5},
    ]
    usual = [tables(k, timed[0]) for k in range(8)]
    once = judgement_of(*usual, tables(8, timed[1]), monkeypatch=monkeypatch)
    assert kinds_and_steps(once) == []
    assert once.comparison is not None
    assert once.comparison.timed == 0
    slow = judgement_of(*usual, *(tables(k, timed[1]) for k in range(8, 13)), monkeypatch=monkeypatch)
    assert kinds_and_steps(slow) == [("speed", "worse", None)]
    assert slow.status == "regression"
    assert slow.speeds.series.runs == tuple(f"night {k}" for k in range(13))


def test_series_of_errors_has_successful_cases_of_equal_scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    """The largest deviation of a method's cases from the median over its runs, oldest first."""
    plate = {"scenario": "plate", ERROR: 1e-5}
    runs = [tables(k, {}, {"dt_s": 0.02, ERROR: 1e-7}, plate) for k in range(3)]
    runs[0] = replace(runs[0], manifest={**runs[0].manifest, "scenarios": {"brick": {}, "plate": {"x": 1}}})
    last = tables(3, {ERROR: 1e-8}, {"dt_s": 0.02, ERROR: 1e-9}, {**plate, "outcome": "failed"})
    found = judgement_of(*runs, last, monkeypatch=monkeypatch)
    assert found.errors.runs == tuple(f"night {k}" for k in range(4))
    assert found.errors.methods == (("mujoco", "rk4"),)
    assert found.errors.decades[:, 0] == pytest.approx([0.0, 0.0, 0.0, -2.0])
    alone = judgement_of(tables(0), monkeypatch=monkeypatch)
    assert alone.errors.runs == ("night 0",)
    assert math.isclose(alone.errors.decades[0, 0], 0.0)
    nothing = judgement_of(tables(0, FAILED), monkeypatch=monkeypatch)
    assert nothing.errors.methods == ()


# ------------------------------------------------------------------------------------------ stored histories


def of(results: pd.DataFrame, method: str, dt_s: float | None = None, scenario: str = "slow") -> Any:
    """Return a condition that selects the rows of a method on a scenario, at one step or at all steps."""
    mine = (results["scenario"] == scenario) & (results["method"] == method)
    return mine if dt_s is None else mine & (results["dt_s"] == dt_s)


def planted(measure: str, amount: float, method: str = "m1", dt_s: float = 0.01) -> Change:
    """Return a change that adds an amount to one cell, and to its size with its sign."""

    def change(results: pd.DataFrame) -> pd.DataFrame:
        mine, signed = of(results, method, dt_s), f"{measure}{SIGNED}"
        results.loc[mine, measure] += amount
        if signed in results:
            results.loc[mine, signed] = np.copysign(results.loc[mine, measure], results.loc[mine, signed])
        return results

    return change


def ended(outcome: str, method: str = "m1", dt_s: float = 0.01) -> Change:
    """Return a change that gives one case another outcome, with nothing measured."""

    def change(results: pd.DataFrame) -> pd.DataFrame:
        mine = of(results, method, dt_s)
        kept = ["run_id", "scenario", "engine", "engine_version", "method", "control", "dt_s", "reproduce"]
        kept.append("reused")  # a Boolean is never missing
        results.loc[mine, [name for name in results.columns if name not in kept]] = None
        results.loc[mine, "outcome"] = outcome
        return results

    return change


def changes_of(judged: Judgement) -> list[tuple[str, str, str]]:
    """Return kind, quantity and status of each change."""
    assert judged.comparison is not None
    return [(change.kind, change.quantity, change.status) for change in judged.comparison.changes]


@pytest.fixture(scope="module")
def _two_runs(nightly_run: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("two")
    store_nightly_runs(nightly_run, folder, [unchanged, unchanged])
    return folder


@pytest.fixture
def two_runs(_two_runs: Path, tmp_path: Path) -> Path:
    """Return a history of two unchanged runs, to be extended."""
    return shutil.copytree(_two_runs, tmp_path / "two")


@pytest.fixture(scope="module")
def one_worse(nightly_run: Run, tmp_path_factory: pytest.TempPathFactory) -> History:
    """Return a history in which the energy drifts more in the second run, to be queried."""
    folder = tmp_path_factory.mktemp("worse")
    store_nightly_runs(nightly_run, folder, [unchanged, planted("energy_drift", 0.1)])
    return History(folder)


@pytest.mark.nightly
@pytest.mark.parametrize("count", [6, pytest.param(20, marks=pytest.mark.nightly)])
def test_unchanged_runs_report_nothing(nightly_run: Run, tmp_path: Path, count: int) -> None:
    """With random times, no change of a measure or speed is reported."""
    rng = np.random.default_rng(0)

    def by_chance(results: pd.DataFrame) -> pd.DataFrame:
        results["relative_cpu"] *= 10.0 ** rng.normal(0.0, 0.02, len(results))
        return results

    runs = judged_nightly_runs(nightly_run, tmp_path, (count + 1) * [by_chance])
    assert [judged.status for judged in runs[1:]] == count * ["no regression"]
    assert [changes_of(judged) for judged in runs[1:]] == count * [[]]


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("factor", "status"), [(1.0 + 1e-7, "moved"), (0.99, "moved"), (1.05, "worse"), (0.95, "improved")]
)
def test_change_is_named_and_only_worse_fails(
    nightly_run: Run, tmp_path: Path, factor: float, status: str
) -> None:
    """Engine, method, scenario, step and measure; below 2 % it has moved, above it is worse or improved."""
    *_, judged = judged_nightly_runs(nightly_run, tmp_path, [unchanged, scaled(factor)])
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


def test_levels_of_an_earlier_version_are_read_as_they_stand(tmp_path: Path) -> None:
    """Its file has the errors; outcomes and verdicts are those of the run; a case it lacks is accepted."""
    row = {"scenario": "slow", "engine": "reference", "method": "m1", "control": "dt", "outcome": "ok"}
    own = make_tables([{**row, "dt_s": 0.1}, {**row, "dt_s": 0.2, "outcome": "failed", ERROR: None}], [{}])
    of_version = [{**row, "run_id": "a run", "dt_s": 0.1 * k, ERROR: 2e-5} for k in (1, 2, 3)]
    (tmp_path / "accepted.csv").write_bytes(as_csv(as_table(of_version, TABLES["results"])))
    levels = read_levels(tmp_path, own)
    found = [(one["outcome"], one[ERROR]) for one in levels.rows("results").values()]
    assert found == [("ok", 2e-5), ("failed", 2e-5), (ABSENT, 2e-5)]
    for returned, outcomes in (((), ["ok", "failed"]), (levels.rows("results"), ["ok", "failed", "ok"])):
        assert [case.columns["outcome"] for case in levels.as_tables(own, returned).cases] == outcomes
    assert len(levels.rows("methods")) == 1


def test_stored_levels_are_read_as_written(tmp_path: Path) -> None:
    """Rows, settings and acceptances are the same."""
    levels = Levels.of(tables(0, {}, {"dt_s": 0.02}))
    change = OneChange("accuracy", "brick", "mujoco", "rk4", ERROR, 1e-9, 2e-9, "worse", "dt", 0.02)
    speed = OneChange("speed", None, "mujoco", "rk4", "relative_cpu", None, None, "improved")
    levels = levels.with_cells(change, {ERROR: 2e-9}, LevelSource("night 7", "accepted", "0123abcd"))
    levels = levels.with_cells(speed, {}, LevelSource("night 8", "improvement"))
    write_levels(levels, tmp_path)
    read = read_levels(tmp_path, tables(0))
    assert read.settings == levels.settings
    assert (read.rows("methods"), read.rows("stability")) == ({}, {})
    assert [one[ERROR] for one in read.rows("results").values()] == [1e-9, 2e-9]
    assert read.setting(change) == LevelSource("night 7", "accepted", "0123abcd")
    assert read.cells(change) == {ERROR: 2e-9}


@pytest.mark.nightly
@pytest.mark.parametrize("percent", [0.5, pytest.param(-0.5, marks=pytest.mark.nightly)])
def test_small_steps_add_up(nightly_run: Run, tmp_path: Path, percent: float) -> None:
    """Ten steps of 0.5 % are reported when their sum passes 2 %: worse until accepted, or improved."""
    step = 1.0 + percent / 100.0
    runs = judged_nightly_runs(nightly_run, tmp_path, [scaled(step**k) for k in range(11)])
    found = [judged.comparison.changes[0].status for judged in runs[1:] if judged.comparison]
    key = "slow", "reference", "m1", "dt", 0.01
    levels = [
        read_levels(run, read_tables(run)).rows("results")[key][ERROR] for run in History(tmp_path).runs()
    ]
    if percent > 0.0:
        assert found == [*3 * ["moved"], *7 * ["worse"]]
        assert len(set(levels)) == 1
        assert [(one.since[:11], one.runs) for one in runs[-1].open] == [("20260101T04", 7)]
    else:
        # the larger error of both improved runs, the fourth and the fifth, is the level of the sixth
        assert found == [*3 * ["moved"], *2 * ["improved"], *2 * ["moved"], *2 * ["improved"], "moved"]
        assert len(set(levels)) == 3  # the first level, and one for each confirmed improvement


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "percent"), [("order", 1.2), ("stability", 0.9)])
def test_orders_and_stable_steps_that_creep_are_reported(
    nightly_run: Run, tmp_path: Path, kind: str, percent: float
) -> None:
    """They are compared with the accepted level: none changes beyond its threshold in a single run."""
    opened = []
    for number in range(6):
        factor = (1.0 - percent / 100.0) ** number
        found = {"methods": nightly_run.methods.copy(), "stability": nightly_run.stability.copy()}
        if kind == "order":
            order = factor * found["methods"]["order"]
            found["methods"] = found["methods"].assign(
                order=order, order_low=order - 1e-3, order_high=order + 1e-3
            )
        else:
            limits = {"dt_stable_s": 0.1 * factor, "dt_unstable_s": 0.1001 * factor}
            found["stability"] = found["stability"].assign(**limits, outcome="ok")
        run = with_tables(nightly_run, **found)
        (judged,) = judged_nightly_runs(run, tmp_path, [unchanged], first=number)
        opened.append({one.change.kind for one in judged.open})
    assert opened[:3] == 3 * [set()]
    assert opened[-1] == {kind}
    since = opened.index({kind})
    assert {(one.since[9:11], one.runs) for one in judged.open} >= {(f"{since:02d}", 6 - since)}


@pytest.mark.nightly
def test_another_map_stays_open_until_it_returns_or_is_accepted(nightly_run: Run, tmp_path: Path) -> None:
    """It is compared with the accepted map and law, not with the run before, and fails nothing."""

    def night(number: int, fingerprint: str, verdict: str) -> Judgement:
        row = {"engine": "reference", "method": "m1", "engine_version": "1", "reproduce": "bodycheck list"}
        run = nightly_run.with_rows(
            fingerprints=[{**row, "fingerprint": fingerprint}],
            laws=[{**row, "law": "boost", "verdict": verdict}],
        )
        (judged,) = judged_nightly_runs(run, tmp_path, [unchanged], first=number)
        assert judged.status in ("no regression", "insufficient history")
        assert judged.open == ()
        return judged

    def found(judged: Judgement) -> list[tuple[Any, ...]]:
        return [(one.change.before, one.change.after, one.runs, one.newly) for one in judged.other_maps]

    assert found(night(0, "M1", "holds")) == []
    assert found(night(1, "M2", "broken")) == [("M1", "M2", 1, True), ("holds", "broken", 1, True)]
    still = night(2, "M2", "broken")
    assert found(still) == [("M1", "M2", 2, False), ("holds", "broken", 2, False)]
    maps = "semi-implicit Euler (M1) -> linearly implicit Euler (M2)"
    assert f"reference:m1: one-step map {maps}, law boost holds -> broken." in nightly_sentences(still)
    assert found(night(3, "not measured", "not-measured")) == [
        ("M1", "M2", 3, False),
        ("holds", "broken", 3, False),
    ]
    assert found(night(4, "M3", "holds")) == [("M1", "M3", 4, True)]
    assert found(night(5, "M1", "holds")) == []
    changed = night(6, "M2", "holds")
    accept(History(tmp_path), run_id=None, ids=[changed.other_maps[0].id], reason="as meant", author="Ada")
    assert found(night(7, "M2", "holds")) == []
    assert found(night(8, "M1", "holds")) == [("M2", "M1", 1, True)]


@pytest.mark.slow
def test_one_command_accepts_a_regression_and_the_map_that_changed_with_it(
    nightly_run: Run, tmp_path: Path
) -> None:
    """It is listed once, and nothing is open after it."""

    def night(number: int, fingerprint: str, factor: float) -> Judgement:
        row = {"engine": "reference", "method": "m1", "engine_version": "1", "reproduce": "bodycheck list"}
        run = nightly_run.with_rows(fingerprints=[{**row, "fingerprint": fingerprint}])
        (judged,) = judged_nightly_runs(run, tmp_path, [scaled(factor)], first=number)
        return judged

    night(0, "M1", 1.0)
    worse = night(1, "M2", 50.0)
    assert (len(worse.open), len(worse.other_maps)) == (1, 1)
    (command,) = nightly_commands(worse)
    name = shlex.split(command.text)[shlex.split(command.text).index("--change") + 1]
    (sentence,) = (text for text in nightly_sentences(worse) if "one-step map" in text)
    assert sentence.endswith(f"(1 nightly run), {name}.")
    accept(History(tmp_path), run_id=None, ids=[name], reason="as meant", author="Ada")
    after = night(2, "M2", 50.0)
    assert (after.open, after.other_maps) == ((), ())


@pytest.mark.slow
def test_what_was_better_with_an_accepted_deterioration_is_no_improvement(
    nightly_run: Run, tmp_path: Path
) -> None:
    """Its level is the accepted run's; a later loss of it is worse, and a later gain has improved."""

    def night(number: int, factor: float) -> Judgement:
        def change(results: pd.DataFrame) -> pd.DataFrame:
            return scaled(factor)(planted("energy_drift", 0.1 if number else 0.0)(results))

        (judged,) = judged_nightly_runs(nightly_run, tmp_path, [change], first=number)
        return judged

    night(0, 1.0)
    assert night(1, 0.1).status == "regression"
    accept(History(tmp_path), run_id=None, ids=[], reason="as meant", author="Ada")
    after = night(2, 0.1)
    assert (headline(after), changes_of(after)) == ("No regression.", [])
    assert changes_of(night(3, 0.01)) == [("accuracy", "orientation_error_rad", "improved")]
    assert night(4, 1.0).status == "regression"


@pytest.mark.slow
def test_custom_threshold_is_used(nightly_run: Run, tmp_path: Path) -> None:
    """Half of it has moved, and beyond it is worse."""
    thresholds = Thresholds(0.2)
    runs = judged_nightly_runs(nightly_run, tmp_path, map(scaled, (1.0, 1.1, 1.3)), thresholds=thresholds)
    assert [judged.status for judged in runs] == ["insufficient history", "no regression", "regression"]


@pytest.mark.slow
def test_history_without_levels_is_compared_with_its_values(nightly_run: Run, two_runs: Path) -> None:
    """Runs that were stored without levels have their values as levels."""
    for run in History(two_runs).runs():
        shutil.rmtree(run / "accepted")
        seal_run(run)
    (judged,) = judged_nightly_runs(nightly_run, two_runs, [scaled(1.05)], first=2)
    assert judged.status == "regression"


@pytest.mark.nightly
def test_missing_measurement_is_a_regression(nightly_run: Run, tmp_path: Path) -> None:
    """A missing case, a failed one and an empty measure are; a new case is not."""

    def gone(results: pd.DataFrame) -> pd.DataFrame:
        return results[~of(results, "m2")]

    def emptied(results: pd.DataFrame) -> pd.DataFrame:
        results.loc[of(results, "rk4", 0.01), ["energy_drift", f"energy_drift{SIGNED}"]] = np.nan
        return results

    for place, (change, kind, how) in enumerate(
        (
            (gone, "case", "missing"),
            (ended("failed"), "outcome", "worse"),
            (emptied, "accuracy", "missing"),
        )
    ):
        _, judged, back = judged_nightly_runs(
            nightly_run, tmp_path / str(place), [unchanged, change, unchanged]
        )
        assert judged.status == "regression"
        assert {(found, status) for found, _, status in changes_of(judged)} == {(kind, how)}
        assert back.status == "no regression"


@pytest.mark.nightly
def test_stored_history_has_the_last_success_of_a_case(nightly_run: Run, tmp_path: Path) -> None:
    """Failures in three runs hide no change of what the case measures."""
    judged_nightly_runs(nightly_run, tmp_path / "worse", [unchanged, *3 * [ended("failed")]])
    shutil.copytree(tmp_path / "worse", tmp_path / "same")
    (judged,) = judged_nightly_runs(
        nightly_run, tmp_path / "worse", [planted("orientation_error_rad", 0.1)], first=4
    )
    assert ("accuracy", "orientation_error_rad", "worse") in changes_of(judged)
    (same,) = judged_nightly_runs(nightly_run, tmp_path / "same", [unchanged], first=4)
    assert changes_of(same) == []
    assert {one.change.kind for one in same.state.closed} == {"outcome"}


@pytest.mark.nightly
def test_slower_engine_is_reported_until_accepted(nightly_run: Run, tmp_path: Path) -> None:
    """A fifth more time in each run from the eighth on is reported within five runs, and stays open."""
    rng = np.random.default_rng(1)

    def run(number: int) -> Change:
        def change(results: pd.DataFrame) -> pd.DataFrame:
            results["relative_cpu"] *= 10.0 ** rng.normal(0.0, 0.01, len(results))
            return slower(results, "reference", 1.2) if number >= 8 else results

        return change

    runs = judged_nightly_runs(nightly_run, tmp_path, [run(number) for number in range(18)])
    alarms = {
        (number, change.method)
        for number, judged in enumerate(runs)
        for change in (judged.comparison.changes if judged.comparison else ())
        if change.kind == "speed" and change.status == "worse"
    }
    assert {method for _, method in alarms} == {"m1", "m2", "rk4"}
    assert all(8 <= min(number for number, who in alarms if who == one) <= 12 for _, one in alarms)
    assert {(17, "m1"), (17, "m2"), (17, "rk4")} <= alarms
    assert all(int(one.since[9:11]) == 18 - one.runs for one in runs[-1].open)


@pytest.mark.parametrize(("factor", "status"), [(1.2, "worse"), (1.0 / 1.2, "improved")])
def test_step_in_the_speed_is_reported_with_its_size(factor: float, status: str) -> None:
    """A method that takes a fifth more or less time from the eighth run on: one change, of its decades."""
    names = [f"night {number}" for number in range(14)]
    case = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "control": "dt", "dt_s": 0.01}
    rows = [
        {**case, "run": name, "tolerance": None, "relative_cpu": factor if number >= 8 else 1.0}
        for number, name in enumerate(names)
    ]
    reported = [
        change
        for last in range(1, len(names))
        for change in speeds_of(names[: last + 1], pd.DataFrame(rows[: last + 1])).changes
    ]
    (change,) = reported
    assert (change.kind, change.engine, change.method, change.status) == ("speed", "mujoco", "rk4", status)
    assert (change.quantity, change.scenario, change.fineness) == ("relative_cpu", None, None)
    assert change.decades == pytest.approx(math.log10(factor), rel=1e-6)


@pytest.mark.slow
def test_runs_of_another_machine_class_are_not_compared(nightly_run: Run, two_runs: Path) -> None:
    """Two classes share a folder, and each run is compared with its own class."""
    (other,) = judged_nightly_runs(
        nightly_run, two_runs, [planted("energy_drift", 0.1)], first=2, cpu="another processor"
    )
    assert other.status == "insufficient history"
    assert "on other machines" in headline(other)
    (mine,) = judged_nightly_runs(nightly_run, two_runs, [unchanged], first=3)
    assert mine.status == "no regression"
    assert mine.comparison is not None
    assert mine.comparison.before.run_id == as_nightly_run(nightly_run, 1).run_id


@pytest.mark.slow
def test_run_of_changed_scenarios_has_insufficient_history(nightly_run: Run, two_runs: Path) -> None:
    """If no scenario is the same, there is nothing to compare with."""
    known = nightly_run.manifest["scenarios"]
    longer = {name: {**scenario, "duration_s": 2.0} for name, scenario in known.items()}
    (judged,) = judged_nightly_runs(nightly_run, two_runs, [slower_all], first=2, scenarios=longer)
    assert judged.status == "insufficient history"
    assert judged.comparison is not None
    assert set(judged.comparison.redefined) == {"slow", "quick"}
    assert "no earlier nightly run has one of these cases" in headline(judged)
    assert float(np.nanmax(np.abs(judged.speeds.series.decades))) == 0.0


def slower_all(results: pd.DataFrame) -> pd.DataFrame:
    """Return the results of an engine three times as slow."""
    return slower(results, "reference", 3.0)


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "file",
    [
        "manifest.json",
        "results.csv",
        "night.json",
        "methods.csv",
        "accepted/results.csv",
        "accepted/settings.csv",
        "regressions.json",
    ],
)
def test_damaged_run_is_left_out_and_named(nightly_run: Run, two_runs: Path, file: str) -> None:
    """The new run is compared with the one before the damaged one, and stored."""
    damaged = two_runs / as_nightly_run(nightly_run, 1).run_id / file
    damaged.write_bytes(damaged.read_bytes()[: damaged.stat().st_size // 2])
    (judged,) = store_nightly_runs(nightly_run, two_runs, [planted("energy_drift", 0.1)], first=2)
    assert judged.status == "regression"
    assert judged.comparison is not None
    assert judged.comparison.before.run_id == as_nightly_run(nightly_run, 0).run_id
    assert any(damaged.parent.name in sentence for sentence in nightly_sentences(judged))


@pytest.mark.slow
def test_stored_run_is_complete(nightly_run: Run, one_worse: History) -> None:
    """Its folder can be read as a run; night.json counts the changes."""
    run = one_worse.runs()[-1]
    assert len(read_tables(run).cases) == len(nightly_run.results)
    found = json.loads((run / "night.json").read_text())
    assert [found[name] for name in ("status", "worse", "missing", "improved", "moved")] == [
        "regression",
        *(1, 0, 0, 0),
    ]
    (change,) = pd.read_csv(run / "changes.csv").to_dict("records")
    assert (change["quantity"], change["method"], change["fineness"]) == ("energy_drift", "m1", 0.01)
    for page in ("night.html", "report.html", "night.md"):
        assert "m1" in (run / page).read_text()


@pytest.mark.slow
def test_history_is_queried_in_sql(nightly_run: Run, one_worse: History) -> None:
    """Every table of every run is present with the values measured."""
    sql = (
        "SELECT run_id, max(energy_drift) AS most FROM results WHERE method = 'm1' GROUP BY run_id ORDER BY 1"
    )
    found = query(one_worse.runs(), sql)
    mine = nightly_run.results[nightly_run.results["method"] == "m1"]["energy_drift"].max()
    assert found["run_id"].tolist() == [run.name for run in one_worse.runs()]
    assert found["most"][0] == mine
    (counted,) = query(
        one_worse.runs(),
        "SELECT (SELECT count(*) FROM nights) AS nights, (SELECT count(*) FROM changes) AS changes, "
        "(SELECT count(*) FROM methods) AS methods, (SELECT count(*) FROM stability) AS stability",
    ).to_dict("records")
    assert counted == {
        "nights": 2,
        "changes": 1,
        "methods": 2 * len(nightly_run.methods),
        "stability": 2 * len(nightly_run.stability),
    }
    assert history_table(one_worse.runs())["status"].tolist() == ["insufficient history", "regression"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "sql",
    [
        "SELECT * FROM absent",
        "SELECT lacking(1)",
        "SELEC",
        "",
        "COPY (SELECT 1) TO '{file}' (FORMAT parquet)",
        "ATTACH '{file}'",
        "SELECT 1; SELECT 2",
        "DROP VIEW results",
    ],
)
def test_wrong_query_is_refused_in_one_line(one_worse: History, sql: str, tmp_path: Path) -> None:
    """Anything but one SELECT is refused, so that no query can write a file."""
    with pytest.raises(InputError) as refused:
        query(one_worse.runs(), sql.format(file=tmp_path / "written"))
    assert "\n" not in str(refused.value)
    assert ("(available: nights, results, methods, " in str(refused.value)) == ("absent" in sql)
    assert not any(tmp_path.iterdir())
